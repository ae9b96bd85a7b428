r"""Slew past the Sun: a telescope turns with three wheels outside a cone around the Sun.

The telescope turns by 120 degrees and keeps 30 degrees away from the Sun. This example shows a keep-out cone on an
attitude, and a guess on one side of it: the direct turn would point at the Sun. Torques and momenta of the wheels are
limited, and the wheels have momentum at the start.

States: ``q`` (attitude, scalar first), ``w`` (body rates, rad/s), ``h`` (wheel momenta, N m s). Control: ``u`` (torques
on the wheels, N m).

.. math::
   \dot q = \tfrac12 \, q \otimes \omega, \quad
   J \dot\omega = -\omega \times (J \omega + h) - u, \quad \dot h = u, \qquad
   b(q)^T s \le \cos 30°, \qquad J = \int u^T u \, dt

Source: own statement.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

INERTIA = np.array([120.0, 150.0, 90.0])
"""kg m^2."""
MAX_TORQUE, MAX_MOMENTUM, DURATION = 0.2, 4.0, 90.0
"""N m, N m s, s."""
TURN, SUN, CONE = np.radians([120.0, 60.0, 30.0])
"""Turn about z, direction of the Sun from x towards y, half angle of the cone; rad."""
END = [np.cos(TURN / 2), 0.0, 0.0, np.sin(TURN / 2)]
FIRST_MOMENTA = [1.0, 0.5, 0.0]
"""N m s."""


def boresight(q: Any) -> Any:
    """Return the x axis of the body in the inertial frame."""
    return ca.vertcat(
        1 - 2 * (q[2] ** 2 + q[3] ** 2), 2 * (q[1] * q[2] + q[0] * q[3]), 2 * (q[1] * q[3] - q[0] * q[2])
    )


def build() -> go.Problem:
    """Return the problem."""
    satellite = go.Model("telescope")
    q = satellite.state("q", 4)
    w = satellite.state("w", 3, unit="rad/s")
    h = satellite.state("h", 3, unit="N m s")
    u = satellite.control("u", 3, unit="N m")
    inertia = ca.DM(INERTIA)
    satellite.ode(
        {
            q: 0.5 * ca.vertcat(-ca.dot(q[1:], w), q[0] * w + ca.cross(q[1:], w)),
            w: (-ca.cross(w, inertia * w + h) - u) / inertia,
            h: u,
        }
    )

    problem = go.Problem("slew past the Sun")
    slew = problem.phase("slew", satellite)
    slew.time(initial=0.0, final=DURATION)
    slew.initial(q=[1.0, 0.0, 0.0, 0.0], w=np.zeros(3), h=FIRST_MOMENTA)
    slew.final(q=END, w=np.zeros(3))
    slew.bounds(u=(-MAX_TORQUE, MAX_TORQUE), h=(-MAX_MOMENTUM, MAX_MOMENTUM))
    cosine = boresight(q)[0] * np.cos(SUN) + boresight(q)[1] * np.sin(SUN)
    slew.path("Sun", cosine, upper=np.cos(CONE))
    past = [0.7, 0.1, -0.3, 0.6]
    slew.guess([0.0, DURATION / 2, DURATION], q=np.array([[1.0, 0.0, 0.0, 0.0], past, END]).T)
    problem.minimize(slew.integral(ca.dot(u, u)), unit="N^2 m^2 s")
    return problem


REFERENCE = Reference(2.270513, "independent Radau collocation, three meshes agree", 4e-6, "N^2 m^2 s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
