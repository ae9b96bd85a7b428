r"""Quadrotor flip: a full turn in minimum time from hover to hover.

This example shows a manoeuvre whose guess must contain the turn: without it the solver does not leave the hover.
Thrust is bang-bang, the turn rate bang-singular.

States: ``x``, ``z`` (m), ``vx``, ``vz`` (m/s), ``theta`` (rad). Controls: thrust ``a`` per mass (m/s^2), turn rate
``w`` (rad/s).

.. math::
   \ddot x = a \sin\theta, \qquad \ddot z = a \cos\theta - g, \qquad \dot\theta = w

Source: M. Hehn, R. Ritz and R. D'Andrea, Performance benchmarking of quadrotor systems using time-optimal control,
Autonomous Robots 33 (2012) 69-88; model and limits from there.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

GRAVITY = 9.81
"""m/s^2."""
THRUST, MAX_RATE = (1.0, 20.0), 10.0
"""m/s^2, rad/s."""


def build() -> go.Problem:
    """Return the problem."""
    quadrotor = go.Model("planar quadrotor")
    x, z = quadrotor.state("x", unit="m"), quadrotor.state("z", unit="m")
    vx, vz = quadrotor.state("vx", unit="m/s"), quadrotor.state("vz", unit="m/s")
    theta = quadrotor.state("theta", unit="rad")
    a, w = quadrotor.control("a", unit="m/s^2"), quadrotor.control("w", unit="rad/s")
    quadrotor.ode({x: vx, z: vz, vx: a * ca.sin(theta), vz: a * ca.cos(theta) - GRAVITY, theta: w})

    problem = go.Problem("quadrotor flip")
    flip = problem.phase("flip", quadrotor)
    flip.time(initial=0.0, final=(0.6, 5.0))
    rest = {"x": 0.0, "z": 0.0, "vx": 0.0, "vz": 0.0}
    flip.initial(theta=0.0, **rest)
    flip.final(theta=2 * np.pi, **rest)
    flip.bounds(a=THRUST, w=(-MAX_RATE, MAX_RATE), x=(-5.0, 5.0), z=(-5.0, 5.0))
    flip.guess(
        [0.0, 0.4, 0.8, 1.2], vz=[0.0, 2.5, -2.5, 0.0], theta=[0.0, 0.5, 5.8, 2 * np.pi], a=10.0, w=5.0
    )
    problem.minimize(flip.final_time)
    return problem


REFERENCE = Reference(0.9124434, "independent Radau collocation, converges to it", 1e-6, "s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
