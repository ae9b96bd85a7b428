r"""Slew past two cones: a minimum-energy turn away from Sun and Moon.

This example shows two keep-out cones: the direct turn enters one of them, and one way around it leads into the other.

States: ``q`` (attitude, scalar first), ``w`` (body rates, rad/s). Control: ``u`` (N m).

.. math::
   \dot q = \tfrac12 \, q \otimes \omega, \qquad J \dot\omega = -\omega \times J \omega + u, \qquad
   b(q)^T s_i \le \cos\theta_i, \qquad J = \int u^T u \, dt

Source: own statement; the setting of U. Lee and M. Mesbahi, Feedback control for spacecraft reorientation under
attitude constraints via convex potentials, IEEE Trans. Aerospace and Electronic Systems 50 (2014) 2578-2592.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

INERTIA = np.array([35.0, 28.0, 42.0])
"""kg m^2."""
TURN, DURATION, MAX_TORQUE = float(np.radians(150.0)), 120.0, 0.4
"""About z, rad; s; N m."""
CONES = ((60.0, 8.0, 22.0), (105.0, -32.0, 18.0))
"""Longitude, latitude and half angle of each cone, degrees."""
END = np.array([np.cos(TURN / 2), 0.0, 0.0, np.sin(TURN / 2)])


def build() -> go.Problem:
    """Return the problem."""
    satellite = go.Model("satellite")
    q, w = satellite.state("q", 4), satellite.state("w", 3, unit="rad/s")
    u = satellite.control("u", 3, unit="N m")
    inertia = ca.DM(INERTIA)
    satellite.ode(
        {
            q: 0.5 * ca.vertcat(-ca.dot(q[1:], w), q[0] * w + ca.cross(q[1:], w)),
            w: (u - ca.cross(w, inertia * w)) / inertia,
        }
    )
    tracker = ca.vertcat(
        1 - 2 * (q[2] ** 2 + q[3] ** 2), 2 * (q[1] * q[2] + q[0] * q[3]), 2 * (q[1] * q[3] - q[0] * q[2])
    )

    problem = go.Problem("slew past two cones")
    slew = problem.phase("slew", satellite)
    slew.time(initial=0.0, final=DURATION)
    slew.initial(q=[1.0, 0.0, 0.0, 0.0], w=np.zeros(3))
    slew.final(q=END, w=np.zeros(3))
    slew.bounds(u=(-MAX_TORQUE, MAX_TORQUE), q=(-1.1, 1.1))
    for i, angles in enumerate(CONES, 1):
        east, north, half = np.radians(angles)
        axis = ca.DM([np.cos(east) * np.cos(north), np.sin(east) * np.cos(north), np.sin(north)])
        slew.path(f"cone {i}", ca.dot(tracker, axis), upper=np.cos(half))
    problem.minimize(slew.integral(ca.dot(u, u)), unit="N^2 m^2 s")
    return problem


REFERENCE = Reference(0.09843442, "independent Radau collocation, converges to it", 1e-07, "N^2 m^2 s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
