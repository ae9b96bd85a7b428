r"""Interior point: a scalar state with a prescribed value at a given time.

The state goes from 1 to 0.75 in 1 s and must be 0.9 at 0.75 s. This example shows the simplest linkage. A constraint
inside the interval divides it into two phases; the costate jumps there, and the jump is the derivative of the
optimal cost with respect to the prescribed value.

State: ``x``. Control: ``u``, -1 to 1. No units; time in s.

.. math::
   \dot x = u, \qquad J = \int_0^1 (x^2 + u^2)\,dt, \qquad x(0.75) = 0.9

Closed form in each phase:

.. math::
   x = \frac{x_0 \sinh(t_f - t) + x_f \sinh(t - t_0)}{\sinh(t_f - t_0)}, \qquad \lambda = -2 \dot x

Source: problem "interior point" of the PSOPT manual (0.920531).
"""

from __future__ import annotations

import numpy as np

import gnc_opt as go
from problems._example import Array, Extremal, Reference, example_main

FIRST, WAYPOINT, LAST = 1.0, 0.9, 0.75
"""x at 0, `PASSAGE` and 1 s."""
PASSAGE = 0.75
"""s."""


def build(waypoint: float = WAYPOINT) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    waypoint : float
        x at 0.75 s.
    """
    plant = go.Model("integrator")
    x = plant.state("x")
    u = plant.control("u")
    plant.ode({x: u})

    problem = go.Problem("interior point")
    before = problem.phase("before", plant)
    before.time(initial=0.0, final=PASSAGE)
    before.initial(x=FIRST)
    before.final(x=waypoint)
    after = problem.phase("after", plant)
    after.time(initial=PASSAGE, final=1.0)
    after.final(x=LAST)
    for leg in (before, after):
        leg.bounds(u=(-1.0, 1.0))
    problem.link(before, after, time=False)  # both times are given
    problem.minimize(sum(leg.integral(x**2 + u**2, "cost") for leg in (before, after)))
    return problem


def closed_form(t: Array) -> Extremal:
    """Return the optimum and its costate at times t (s), on either side of the passage."""
    before = t < PASSAGE
    span = np.where(before, PASSAGE, 1 - PASSAGE)
    since = np.where(before, t, t - PASSAGE)
    first, last = np.where(before, FIRST, WAYPOINT), np.where(before, WAYPOINT, LAST)
    x = (first * np.sinh(span - since) + last * np.sinh(since)) / np.sinh(span)
    u = (-first * np.cosh(span - since) + last * np.cosh(since)) / np.sinh(span)
    return Extremal(states={"x": x}, controls={"u": u}, costates={"x": -2 * u})


def _cost(first: float, last: float, span: float) -> float:
    return float(((first**2 + last**2) * np.cosh(span) - 2 * first * last) / np.sinh(span))


REFERENCE = Reference(
    _cost(FIRST, WAYPOINT, PASSAGE) + _cost(WAYPOINT, LAST, 1 - PASSAGE), "closed form", 1e-9
)


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
