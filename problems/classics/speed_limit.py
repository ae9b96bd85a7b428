r"""Speed limit: 1 m in minimum time at 0.5 m/s or less.

This example shows the simplest state constraint. Its first time derivative contains the control (order one), so on
the limit the control keeps the speed constant and is zero: neither bang nor singular. The multiplier of the limit
replaces the switching function. The cost of a lower limit increases more than linearly.

States: ``x`` (m), ``v`` (m/s, at most 0.5). Control: ``a`` (m/s^2, -1 to 1).

.. math::
   \dot x = v, \qquad \dot v = a, \qquad |v| \le v_{max}

Closed form: the control is 1, 0, -1 with switches at :math:`v_{max}` and :math:`t_f - v_{max}`. The costate
:math:`\lambda_x` is :math:`-1 / v_{max}`; :math:`\lambda_v` rises from -1 to 0 on the first arc, is 0 on the limit, and
rises to 1 on the last arc.
"""

from __future__ import annotations

import numpy as np

import gnc_opt as go
from problems._example import Array, Extremal, Reference, example_main

LIMIT = 0.5
"""v_max, m/s; below 1 it matters."""
LEAST_TIME = 1 / LIMIT + LIMIT
"""s."""


def build(limit: float = LIMIT) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    limit : float
        Largest speed, m/s.
    """
    cart = go.Model("double integrator")
    x = cart.state("x", unit="m")
    v = cart.state("v", unit="m/s")
    a = cart.control("a", unit="m/s^2")
    cart.ode({x: v, v: a})

    problem = go.Problem("minimum time with a speed limit")
    move = problem.phase("move", cart)
    move.time(initial=0.0, final=(0.5, 10.0))
    move.initial(x=0.0, v=0.0)
    move.final(x=1.0, v=0.0)
    move.bounds(v=(-limit, limit), a=(-1.0, 1.0))
    problem.minimize(move.final_time)
    return problem


def closed_form(t: Array) -> Extremal:
    """Return the optimal move and its costates at times t (s)."""
    left = LEAST_TIME - t
    arcs = [t < LIMIT, left < LIMIT]
    return Extremal(
        states={
            "x": np.select(arcs, [t**2 / 2, 1 - left**2 / 2], LIMIT**2 / 2 + LIMIT * (t - LIMIT)),
            "v": np.select(arcs, [t, left], LIMIT),
        },
        controls={"a": np.select(arcs, [1.0, -1.0], 0.0)},
        costates={
            "x": np.full_like(t, -1 / LIMIT),
            "v": np.select(arcs, [t / LIMIT - 1, 1 - left / LIMIT], 0.0),
        },
    )


REFERENCE = Reference(LEAST_TIME, "closed form: 1/v_max + v_max", 1e-7, "s")


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
