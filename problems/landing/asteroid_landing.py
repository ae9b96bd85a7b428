r"""Asteroid landing: the least propellant to a point on a rotating ellipsoid.

This example shows a rotating frame and a gravity that is not central: the field is that of a sphere with its
second-degree terms, and the probe hovers at first.

States: ``r``, ``v`` (m, m/s) in the frame that rotates with the asteroid; ``m`` (kg). Control: vector ``T`` (N).

.. math::
   \dot v = \frac{T}{m} - 2 \omega \times v - \omega \times (\omega \times r) + \nabla U, \quad
   U = \frac{\mu}{r} \Big( 1 + \frac{R^2}{r^2} \big( \tfrac12 C_{20} (3 s^2 - 1) + 3 C_{22} (c_x^2 - c_y^2) \big) \Big)

with the direction cosines :math:`c_x, c_y, s` of the position.

Source: own statement; the setting of H. Yang, X. Bai and H. Baoyin, Rapid generation of time-optimal trajectories for
asteroid landing via convex optimization, J. Guidance 40 (2017) 628-641.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MU, RADIUS, C20, C22 = 4.463e5, 8000.0, -0.0524, 0.0825
"""m^3/s^2, m, -, -: of the size of Eros."""
SPIN = 2 * np.pi / (5.27 * 3600.0)
"""rad/s."""
MAX_THRUST, EXHAUST_SPEED, START_MASS = 60.0, 225.0 * 9.80665, 1000.0
"""N, m/s, kg."""
START, SITE = np.array([3000.0, 12000.0, 4000.0]), np.array([0.0, 6500.0, 1000.0])
"""m."""
DURATION = 2400.0
"""s."""


def potential(r: Any) -> Any:
    """Return the potential whose gradient is the attraction, m^2/s^2."""
    distance = ca.sqrt(ca.dot(r, r))
    second = 0.5 * C20 * (3 * (r[2] / distance) ** 2 - 1) + 3 * C22 * (r[0] ** 2 - r[1] ** 2) / distance**2
    return MU / distance * (1 + (RADIUS / distance) ** 2 * second)


def build() -> go.Problem:
    """Return the problem."""
    probe = go.Model("probe")
    r, v = probe.state("r", 3, unit="m"), probe.state("v", 3, unit="m/s")
    m = probe.state("m", unit="kg")
    thrust, size = probe.vector_control("T", 3, unit="N")
    spin = ca.DM([0.0, 0.0, SPIN])
    apparent = -2 * ca.cross(spin, v) - ca.cross(spin, ca.cross(spin, r))
    probe.ode({r: v, v: thrust / m + apparent + ca.gradient(potential(r), r), m: -size / EXHAUST_SPEED})

    problem = go.Problem("asteroid landing")
    descent = problem.phase("descent", probe)
    descent.time(initial=0.0, final=DURATION)
    descent.initial(r=START, v=np.zeros(3), m=START_MASS)
    descent.final(r=SITE, v=np.zeros(3))
    descent.bounds(m=(500.0, START_MASS))
    descent.norm_bounds(T=(0.0, MAX_THRUST))
    problem.maximize(descent.final_state("m"))
    return problem


REFERENCE = Reference(997.37037, "independent Radau collocation, converges to it", 0.001, "kg")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
