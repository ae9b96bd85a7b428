r"""Rendezvous with minimum fuel: six body-fixed thrusters on a circular orbit.

This example shows an L1 cost. Thrusters are fixed to the body: the fuel is the sum of the absolute values of three
accelerations, not their norm. With ``fabs`` it has a kink where the optimum coasts; `Model.split_control` makes two
one-sided controls of each, and the cost is linear. The optimum is bang-off-bang, and each axis has its own switching
times.

States: ``r`` (m), ``v`` (m/s) relative to the target, in radial, along-track and cross-track direction. Controls:
``a`` (m/s^2), within 0.02 m/s^2, split. n = 0.00113 rad/s.

.. math::
   \ddot x = 3 n^2 x + 2 n \dot y + a_x, \quad \ddot y = -2 n \dot x + a_y, \quad \ddot z = -n^2 z + a_z, \quad
   J = \int_0^T (|a_x| + |a_y| + |a_z|)\,dt
"""

from __future__ import annotations

import casadi as ca

import gnc_opt as go
from gnc_opt.plot import View
from problems._example import Reference, example_main

RATE = 0.00113
"""Of the orbit, rad/s."""
DURATION = 4500.0
"""s."""
LIMIT = 0.02
"""Of each acceleration, m/s^2."""
START = {"r": [-2000.0, -5000.0, 300.0], "v": [0.5, 1.0, -0.2]}


def build(duration: float = DURATION, limit: float = LIMIT) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    duration : float
        s.
    limit : float
        Of each acceleration, m/s^2.
    """
    chaser = go.Model("Clohessy-Wiltshire")
    r = chaser.state("r", 3, unit="m")
    v = chaser.state("v", 3, unit="m/s")
    a, size = chaser.split_control("a", 3, unit="m/s^2")
    drift = ca.vertcat(3 * RATE**2 * r[0] + 2 * RATE * v[1], -2 * RATE * v[0], -(RATE**2) * r[2])
    chaser.ode({r: v, v: drift + a})

    problem = go.Problem("rendezvous with the least fuel")
    approach = problem.phase("approach", chaser)
    approach.time(initial=0.0, final=duration)
    approach.initial(**START)
    approach.final(r=[0.0, 0.0, 0.0], v=[0.0, 0.0, 0.0])
    approach.bounds(a=(-limit, limit))
    problem.minimize(approach.integral(ca.sum1(size), "fuel"), unit="m/s")
    return problem


REFERENCE = Reference(3.913602, "linear programme of 8000 steps", 3e-6, "m/s")

VIEW = View("r", force="a", bodies={"target": (0.0, 0.0, 0.0)})
"""What a report shows moving."""


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
