r"""Docking in a corridor: the fastest approach with limits of thrust, speed and direction.

This example shows state limits that become active several times. Thrust along each axis is limited, and mostly at one
of its limits. Along short arcs two thrusts together keep the chaser on a wall of the corridor or at a speed limit.

States: ``r`` (m), ``v`` (m/s) in radial, along-track and cross-track direction. Control: ``a`` (m/s^2).

.. math::
   \ddot x = 3 n^2 x + 2 n \dot y + a_x, \quad \ddot y = -2 n \dot x + a_y, \quad \ddot z = -n^2 z + a_z, \qquad
   |x|, |z| \le y \tan 10°

Source: own statement; the equations of W. H. Clohessy and R. S. Wiltshire, Terminal guidance system for satellite
rendezvous, J. Aerospace Sciences 27 (1960) 653-658.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MEAN_MOTION, MAX_ACCELERATION = 0.0011, 0.01
"""rad/s, m/s^2."""
MAX_SPEED = np.array([2.0, 1.0, 2.0])
"""m/s."""
CORRIDOR = np.tan(np.radians(10.0))
START, PORT = [25.0, 200.0, 15.0], [0.0, 1.0, 0.0]
"""m."""
CONTACT_SPEED = 0.05
"""m/s."""


def build() -> go.Problem:
    """Return the problem."""
    chaser = go.Model("chaser")
    r = chaser.state("r", 3, unit="m")
    v = chaser.state("v", 3, unit="m/s")
    a = chaser.control("a", 3, unit="m/s^2")
    n = MEAN_MOTION
    gravity = ca.vertcat(3 * n**2 * r[0] + 2 * n * v[1], -2 * n * v[0], -(n**2) * r[2])
    chaser.ode({r: v, v: gravity + a})

    problem = go.Problem("docking in a corridor")
    approach = problem.phase("approach", chaser)
    approach.time(initial=0.0, final=(50.0, 1000.0))
    approach.initial(r=START, v=np.zeros(3))
    approach.final(r=PORT, v=[0.0, -CONTACT_SPEED, 0.0])
    approach.bounds(a=(-MAX_ACCELERATION, MAX_ACCELERATION), v=(-MAX_SPEED, MAX_SPEED))
    for name, offset in (("above", r[0]), ("below", -r[0]), ("right", r[2]), ("left", -r[2])):
        approach.path(f"corridor {name}", CORRIDOR * r[1] - offset, lower=0.0)
    problem.minimize(approach.final_time)
    return problem


REFERENCE = Reference(292.5503, "independent Radau collocation, finest mesh 500 x 3", 6e-4, "s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
