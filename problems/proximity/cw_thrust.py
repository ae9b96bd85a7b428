r"""Rendezvous with minimum fuel by one engine that turns: fuel is the norm of the acceleration.

This example shows a convex problem whose natural form has no derivatives at the optimum: ``norm_2(a)`` at ``a = 0``,
where it coasts most of the time. `Model.vector_control` optimises magnitude and direction, and refinement the
switching times. See also `problems.proximity.cw_fuel`, the same flight with opposed thrusters.

States: ``r`` (m), ``v`` (m/s) relative to the target, in radial, along-track and cross-track direction. Control:
``a`` (m/s^2), at most 0.02 m/s^2. n = 0.00113 rad/s.

.. math::
   \ddot x = 3 n^2 x + 2 n \dot y + a_x, \quad \ddot y = -2 n \dot x + a_y, \quad \ddot z = -n^2 z + a_z, \quad
   J = \int_0^T \|a\|\,dt
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
"""Of the norm of the acceleration, m/s^2."""
START = {"r": [-2000.0, -5000.0, 300.0], "v": [0.5, 1.0, -0.2]}


def build(duration: float = DURATION, limit: float = LIMIT) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    duration : float
        s.
    limit : float
        Of the acceleration, m/s^2.
    """
    chaser = go.Model("Clohessy-Wiltshire")
    r = chaser.state("r", 3, unit="m")
    v = chaser.state("v", 3, unit="m/s")
    a, size = chaser.vector_control("a", 3, unit="m/s^2")
    drift = ca.vertcat(3 * RATE**2 * r[0] + 2 * RATE * v[1], -2 * RATE * v[0], -(RATE**2) * r[2])
    chaser.ode({r: v, v: drift + a})

    problem = go.Problem("rendezvous with the least fuel, one engine")
    approach = problem.phase("approach", chaser)
    approach.time(initial=0.0, final=duration)
    approach.initial(**START)
    approach.final(r=[0.0, 0.0, 0.0], v=[0.0, 0.0, 0.0])
    approach.norm_bounds(a=(0.0, limit))
    problem.minimize(approach.integral(size, "fuel"), unit="m/s")
    return problem


REFERENCE = Reference(3.618759, "second-order cone programme", 2e-6, "m/s")

VIEW = View("r", force="a", bodies={"target": (0.0, 0.0, 0.0)})
"""What a report shows moving."""


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
