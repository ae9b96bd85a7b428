r"""Docking with a tumbling target: a chaser reaches a rotating port in minimum time.

The chaser must have the velocity of the port. This example shows end conditions that depend on the free final time:
the port moves on a circle. The thrust is a vector of limited length.

States: ``r`` (m), ``v`` (m/s) in the target's plane of rotation. Control: vector ``a`` (m/s^2).

.. math::
   \dot r = v, \quad \dot v = a, \quad \|a\| \le a_{max}, \qquad
   r(t_f) = \rho (\cos\phi, \sin\phi), \quad v(t_f) = \dot r_{port}, \quad \phi = \phi_0 + \Omega t_f

Source: own statement; the setting of G. Boyarko, O. Yakimenko and M. Romano, Optimal rendezvous trajectories of a
controlled spacecraft and a tumbling object, J. Guidance 34 (2011) 1239-1252.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MAX_ACCELERATION, PORT, SPIN, PHASE = 0.05, 2.0, float(np.radians(3.0)), 2.0
"""m/s^2, m, rad/s, rad."""
START, START_SPEED = np.array([12.0, -5.0]), np.array([-0.05, 0.1])
"""m, m/s."""


def build() -> go.Problem:
    """Return the problem."""
    chaser = go.Model("chaser")
    r, v = chaser.state("r", 2, unit="m"), chaser.state("v", 2, unit="m/s")
    a, _ = chaser.vector_control("a", 2, unit="m/s^2")
    chaser.ode({r: v, v: a})

    problem = go.Problem("docking with a tumbling target")
    approach = problem.phase("approach", chaser)
    approach.time(initial=0.0, final=(5.0, 200.0))
    approach.initial(r=START, v=START_SPEED)
    approach.norm_bounds(a=(0.0, MAX_ACCELERATION))
    angle = PHASE + SPIN * approach.final_time
    port = PORT * ca.vertcat(ca.cos(angle), ca.sin(angle))
    speed = PORT * SPIN * ca.vertcat(-ca.sin(angle), ca.cos(angle))
    problem.constrain("at the port", approach.final_state("r") - port, equals=[0.0, 0.0])
    problem.constrain("with the port", approach.final_state("v") - speed, equals=[0.0, 0.0])
    problem.minimize(approach.final_time)
    return problem


REFERENCE = Reference(33.947949, "independent Radau collocation, converges to it", 5e-05, "s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
