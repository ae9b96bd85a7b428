r"""Ducted fan: a sideways motion by 1 m with a cost of time and thrust.

Time costs a thousand times as much as thrust. This example shows a state limit that is entered smoothly: the fan may
tilt by at most 30 degrees, and does so twice.

States: ``x1``, ``x2`` (m), ``v1``, ``v2`` (m/s), tilt ``alpha`` (rad), ``w`` (rad/s). Controls: forces ``u1`` across
and ``u2`` along the fan (N).

.. math::
   m \ddot x_1 = u_1 \cos\alpha - u_2 \sin\alpha, \quad m \ddot x_2 = -m g + u_1 \sin\alpha + u_2 \cos\alpha

.. math:: J \ddot\alpha = r u_1, \qquad J = \int 2 u_1^2 + u_2^2 \, dt + 1000 \, t_f

Source: K. Graichen and N. Petit, Incorporating a class of constraints into the dynamics of optimal control problems,
Optimal Control Applications and Methods 30 (2009) 537-561; the problem ``ducted_fan`` of OptimalControlProblems.jl.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MASS, WEIGHT, INERTIA, ARM = 2.2, 4.0, 0.05, 0.2
"""kg, N (less than m g: the stand carries the rest), kg m^2, m."""
MAX_TILT = np.radians(30.0)
"""rad."""


def build() -> go.Problem:
    """Return the problem."""
    fan = go.Model("ducted fan")
    x1, v1 = fan.state("x1", unit="m"), fan.state("v1", unit="m/s")
    x2, v2 = fan.state("x2", unit="m"), fan.state("v2", unit="m/s")
    alpha, w = fan.state("alpha", unit="rad"), fan.state("w", unit="rad/s")
    u1, u2 = fan.control("u1", unit="N"), fan.control("u2", unit="N")
    fan.ode(
        {
            x1: v1,
            v1: (u1 * ca.cos(alpha) - u2 * ca.sin(alpha)) / MASS,
            x2: v2,
            v2: (u1 * ca.sin(alpha) + u2 * ca.cos(alpha) - WEIGHT) / MASS,
            alpha: w,
            w: ARM * u1 / INERTIA,
        }
    )

    problem = go.Problem("ducted fan")
    move = problem.phase("move", fan)
    move.time(initial=0.0, final=(0.1, 20.0))
    rest = {"v1": 0.0, "x2": 0.0, "v2": 0.0, "alpha": 0.0, "w": 0.0}
    move.initial(x1=0.0, **rest)
    move.final(x1=1.0, **rest)
    move.bounds(alpha=(-MAX_TILT, MAX_TILT), u1=(-5.0, 5.0), u2=(0.0, 17.0))
    problem.minimize(move.integral(2 * u1**2 + u2**2) + 1000 * move.final_time)
    return problem


REFERENCE = Reference(1909.3007, "independent Radau collocation, two meshes agree", 2e-3)


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
