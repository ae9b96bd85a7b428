r"""Lunar ascent: the fastest ascent from the Moon into an orbit of 15 km.

This example shows the steering law without an atmosphere: over a flat Moon the tangent of the thrust angle is a ratio
of two linear functions of time. Over the round Moon of this problem it holds approximately.

States: ``h`` (m), downrange angle ``theta`` (rad), ``v_r``, ``v_t`` (m/s), ``m`` (kg). Control: thrust angle
``beta`` above the local horizontal (rad).

.. math::
   \dot v_r = \frac{v_t^2}{r} - \frac{\mu}{r^2} + \frac{F}{m} \sin\beta, \qquad
   \dot v_t = -\frac{v_r v_t}{r} + \frac{F}{m} \cos\beta, \qquad \dot m = -\frac{F}{g_0 I_{sp}}

Source: own statement with the ascent stage of the Apollo lunar module (F. V. Bennett, Apollo experience report: mission
planning for lunar module descent and ascent, NASA TN D-6846, 1972).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MU, RADIUS, G0 = 4.9048695e12, 1737.4e3, 9.80665
"""m^3/s^2, m, m/s^2."""
THRUST, ISP, START_MASS = 15600.0, 311.0, 4780.0
"""N, s, kg."""
ALTITUDE, EXTRA_SPEED = 15240.0, 21.0
"""Of insertion, m; above the circular speed, m/s: the orbit rises to 83 km."""


def build(thrust: float = THRUST) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    thrust : float
        Constant thrust, N.
    """
    stage = go.Model("ascent stage")
    h, theta = stage.state("h", unit="m"), stage.state("theta", unit="rad")
    v_r, v_t = stage.state("v_r", unit="m/s"), stage.state("v_t", unit="m/s")
    m = stage.state("m", unit="kg")
    beta = stage.control("beta", unit="rad")
    r = RADIUS + h
    stage.ode(
        {
            h: v_r,
            theta: v_t / r,
            v_r: v_t**2 / r - MU / r**2 + thrust / m * ca.sin(beta),
            v_t: -v_r * v_t / r + thrust / m * ca.cos(beta),
            m: -thrust / (G0 * ISP),
        }
    )

    problem = go.Problem("lunar ascent")
    ascent = problem.phase("ascent", stage)
    ascent.time(initial=0.0, final=(200.0, 600.0))
    ascent.initial(h=0.0, theta=0.0, v_r=0.0, v_t=0.0, m=START_MASS)
    speed = float(np.sqrt(MU / (RADIUS + ALTITUDE))) + EXTRA_SPEED
    ascent.final(h=ALTITUDE, v_r=0.0, v_t=speed)
    ascent.bounds(h=(0.0, None), m=(1000.0, START_MASS), beta=(-np.pi / 2, np.pi / 2))
    problem.minimize(ascent.final_time)
    return problem


REFERENCE = Reference(419.63436085, "independent Radau collocation, two meshes agree", 1e-5, "s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
