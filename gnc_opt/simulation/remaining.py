"""What is left of an optimal control problem once a part of its flight has been flown.

By Bellman's principle the rest of a plan is the plan for the rest, provided that what is asked tells what was flown
from what is to come: time limits move with the clock, but a budget that integrates over the whole phase, or a condition
on where it began, would be granted anew.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.problem import Problem

_A_LITTLE = 0.02
"""Share of the range of a state (of its limit, where there is only one) by which a start beyond it counts as on it."""

_SAME_DIRECTION = 1e-9
"""Two gradients of a cost point the same way if the sine of the angle between them is at most this."""


def remaining(problem: Problem, began: float, begin: float, start: dict[str, Array]) -> Problem:
    """Return what is left of a problem of one phase.

    Parameters
    ----------
    problem : Problem
        Of the whole flight.
    began, begin : float
        Its first time, and that of the rest, s.
    start : dict
        States there, by name; those that are a little beyond a limit begin on it.
    """
    (leg,) = problem.phases.values()
    span, flown = leg.numbers.duration, begin - began
    left = (max(float(span.lower[0]) - flown, 0.0), float(span.upper[0]) - flown)
    return problem.with_time(initial=begin, duration=left).with_initial(**_within(leg, start))


def _within(leg: Phase, start: dict[str, Array]) -> dict[str, Array]:
    """Return states, those that are a little beyond a limit on it.

    A vehicle that flies along a limit is estimated beyond it as often as not; no plan begins there.
    """
    names, lower, upper = leg.model.states, leg.numbers.states.lower, leg.numbers.states.upper
    width = upper - lower
    sizes = np.where(np.isfinite(lower), np.abs(lower), np.abs(upper))
    slack = _A_LITTLE * np.where(np.isfinite(width), width, np.where(np.isfinite(sizes), sizes, 0.0))
    found = {}
    for name, x in start.items():
        at = names.slice(name)
        kept = np.clip(x, lower[at], upper[at])
        found[name] = np.where(np.abs(x - kept) <= slack[at], kept, x)
    return found


def check_remaining(problem: Problem) -> None:
    """Raise `ArgumentError` if the rest of a problem of one phase does not ask for what the whole asks for."""
    (leg,) = problem.phases.values()
    names = [n for n in problem.parameters.names if n in leg.model.parameters]
    if names:
        raise ArgumentError(
            f"parameter '{names[0]}' of model '{leg.model.name}' is chosen along with the plan of the Replanner, but "
            "in flight the vehicle has one already: plan with its number, Model.parameter(name, number)."
        )
    whole = ca.vertcat(leg.ends("initial"), leg.initial_time, leg.integral_symbols())
    for constraint in problem.constraints.values():
        if ca.depends_on(constraint.expression, whole):
            raise ArgumentError(
                f"constraint '{constraint.name}' of problem '{problem.name}' is on the whole flight, and a Replanner "
                "would ask it anew of each rest: limit the final value of a state that has the integrand as its rate, "
                "give time(duration=...), or write numbers for what holds at the start."
            )
    if not _additive(problem, leg):
        raise ArgumentError(
            f"the cost of problem '{problem.name}' weighs the rest of a flight by what was flown before, so that a "
            "Replanner would change the plan: write a sum of integrals and a function of the end."
        )


def _additive(problem: Problem, leg: Phase) -> bool:
    """Whether the best rest is the same whatever was flown: the cost's gradient by the rest keeps its direction."""
    rest = ca.vertcat(leg.ends("final"), leg.final_time, leg.integral_symbols(), problem.parameter_symbols())
    before = ca.vertcat(leg.ends("initial"), leg.initial_time)
    gradient = ca.Function("gradient", [before, rest], [ca.gradient(problem.cost, rest)])
    numbers = np.random.default_rng(0)
    n = leg.model.states.size
    for _ in range(3):
        y, b = numbers.uniform(2.0, 3.0, rest.numel()), numbers.uniform(0.0, 1.0, before.numel())
        later, flown = b + numbers.uniform(0.1, 0.5, b.size), y.copy()
        flown[n + 1 : n + 1 + len(leg.integrands)] += numbers.uniform(0.1, 0.5, len(leg.integrands))
        if not _parallel(gradient(b, flown), gradient(later, y)):
            return False
    return True


def _parallel(first: Any, second: Any) -> bool:
    a, b = (np.asarray(g.full()[:, 0]) for g in (first, second))
    sizes = np.linalg.norm(a), np.linalg.norm(b)
    if not np.isfinite(sizes).all() or min(sizes) == 0:  # cannot tell at these numbers
        return True
    return bool(np.linalg.norm(a / sizes[0] - b / sizes[1]) <= _SAME_DIRECTION)
