r"""Container crane: a load moves in nine seconds with little swing.

This example shows a problem whose state limits and control limits are active in turn; a standard test of direct
methods.

States: trolley ``x``, its speed ``v``, hoist ``l``, its rate ``w``, swing ``phi``, its rate ``q``. Controls: ``u1`` of
the trolley, ``u2`` of the hoist.

.. math::
   \dot v = u_1 + c_4 \phi, \quad \dot w = u_2, \quad
   \dot q = -\frac{u_1 + c_5 \phi + 2 w q}{l}, \qquad
   J = \tfrac12 \int_0^9 \phi^2 + q^2 + 0.01 (u_1^2 + u_2^2) \, dt

Source: Y. Sakawa and Y. Shindo, Optimal control of container cranes, Automatica 18 (1982) 257-266; K. L. Teo, C. J. Goh
and K. H. Wong, A Unified Computational Approach to Optimal Control Problems, Longman 1991; 0.0375195 published.
"""

from __future__ import annotations

import gnc_opt as go
from problems._example import Reference, example_main

DURATION, C4, C5, PENALTY = 9.0, 17.2656, 27.0756, 0.01
"""s, constants of the swing, weight of the controls."""
MAX_TROLLEY, HOIST = 2.83374, (-0.80865, 0.71265)
"""Limits of the controls."""


def build() -> go.Problem:
    """Return the problem."""
    crane = go.Model("container crane")
    x, v, l, w, phi, q = (crane.state(name) for name in ("x", "v", "l", "w", "phi", "q"))  # noqa: E741
    u1, u2 = crane.control("u1"), crane.control("u2")
    crane.ode({x: v, v: u1 + C4 * phi, l: w, w: u2, phi: q, q: -(u1 + C5 * phi + 2 * w * q) / l})

    problem = go.Problem("container crane")
    transfer = problem.phase("transfer", crane)
    transfer.time(initial=0.0, final=DURATION)
    transfer.initial(x=0.0, l=22.0, v=0.0, w=-1.0, phi=0.0, q=0.0)
    transfer.final(x=10.0, l=14.0, v=2.5, w=0.0, phi=0.0, q=0.0)
    transfer.bounds(u1=(-MAX_TROLLEY, MAX_TROLLEY), u2=HOIST, v=(-2.5, 2.5), w=(-1.0, 1.0))
    problem.minimize(0.5 * transfer.integral(phi**2 + q**2 + PENALTY * (u1**2 + u2**2)))
    return problem


REFERENCE = Reference(0.03751946, "independent Radau collocation; 0.0375195 published", 5e-8)


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
