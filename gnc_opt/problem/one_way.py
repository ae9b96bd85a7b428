"""States that only rise, or only fall, whatever the controls do: budgets of fuel, dose, heat.

Once such a budget is used up its bound holds by itself, as long as the controls that use it are on limits of their
own. The multiplier of the bound could then be spread over that time in any way, and so could what follows from it,
costates and switching functions. The bound at the one end says all that it says in between; alone it has one
multiplier, and the costate stays what it is until then. In between there are loose bounds: they keep the solver
where the dynamics mean something, and within them nothing may turn round.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array, Mask
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.ranges import ranges_of
from gnc_opt.problem.statement import Statement

LOOSE = 0.1
"""Share of a state's bounds and start by which bounds are loosened that say nothing."""


def loose_bounds(leg: Phase) -> Interval:
    """Return the bounds of the states of a phase, somewhat wider."""
    bounds, initial = leg.numbers.states, leg.numbers.initial
    reach = np.abs([bounds.lower, bounds.upper, initial.lower, initial.upper])
    room = LOOSE * np.max(np.where(np.isfinite(reach), reach, 0.0), axis=0)
    return Interval(bounds.lower - room, bounds.upper + room)


def one_way_states(problem: Statement, leg: Phase) -> tuple[Mask, Mask]:
    """Return which states of a phase never fall and which never rise.

    They do not while controls keep to their bounds, and states to theirs as `loose_bounds` has them.

    Only states with bounds that controls can bring to rest are looked at. The answer to the last numbers is kept.
    """
    numbers = leg.numbers
    bounded = np.isfinite(numbers.states.lower) | np.isfinite(numbers.states.upper)
    rows, rates = problem.once(("rates by controls", leg.name), lambda: _rates_by_controls(problem, leg))
    if not np.any(bounded[rows]):
        return _none(leg), _none(leg)
    values, times = leg.model.parameter_values, leg.times()
    ranges = [
        Interval(times[0].lower, times[1].upper),
        loose_bounds(leg),
        numbers.controls,
        Interval(values, values),
        problem.parameter_interval(),
    ]
    asked = (bounded.tobytes(), *(end.tobytes() for box in ranges for end in (box.lower, box.upper)))
    place = ("one way", leg.name)
    known: tuple[Any, Mask, Mask] | None = problem.builds.get(place)
    if known is None or known[0] != asked:
        rising, falling, rate = _none(leg), _none(leg), ranges_of(rates, ranges)
        rising[rows], falling[rows] = bounded[rows] & (rate.lower == 0), bounded[rows] & (rate.upper == 0)
        problem.builds[place] = known = (asked, rising, falling)
    return known[1:]


def _none(leg: Phase) -> Mask:
    return np.zeros(leg.model.states.size, dtype=bool)


def kept_later(problem: Statement, leg: Phase) -> tuple[Mask, Mask]:
    """Return which states that never fall, and which that never rise, a later phase takes over as such.

    It takes them without a jump and with the same bound or a tighter one, which so holds here, too.
    """
    kept = np.zeros((2, leg.model.states.size), dtype=bool)
    for later in problem.phases.values():
        for name in later.model.states.names:
            before, jump = later.handed_over(name) or (None, np.zeros(0))
            if before is None or before.name != leg.name or np.any(jump):
                continue
            ours, theirs = leg.model.states.slice(name), later.model.states.slice(name)
            bounds, tighter = leg.numbers.states, later.numbers.states
            ways = one_way_states(problem, later)
            kept[0, ours] = ways[0][theirs] & (tighter.upper[theirs] <= bounds.upper[ours])
            kept[1, ours] = ways[1][theirs] & (tighter.lower[theirs] >= bounds.lower[ours])
    ways = one_way_states(problem, leg)
    return ways[0] & kept[0], ways[1] & kept[1]


def _rates_by_controls(problem: Statement, leg: Phase) -> tuple[Array, Any]:
    """Rows of the states whose rates depend on controls, and their rates as a function."""
    t, x, u, p = leg.model.arguments()
    rates = problem.bind(leg, leg.model.derivative())
    rows = np.unique(np.array(ca.jacobian_sparsity(rates, u).row(), dtype=int))
    arguments = [t, x, u, p, problem.parameter_symbols()]
    return rows, ca.Function("rates", arguments, [ca.densify(rates[rows.tolist()])])
