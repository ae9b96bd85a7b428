r"""Costs that cannot be less: what they are made of is as small as it can be.

A sum of squares is not negative. With the least value of every integrand, times the duration, and of the cost of these
and of the ends, for states and controls within their bounds, interval arithmetic (module `ranges`) bounds the cost from
below. A flight that reaches that bound is a global minimum, whatever its costates say: they vanish there,
:math:`\partial L/\partial x = 0` as well, and what is left of them is rounding. It may be one of many.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.problem.interval import Interval, intersect
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.problem import Problem
from gnc_opt.problem.ranges import ranges_of
from gnc_opt.problem.symbols import parameter_arguments
from gnc_opt.solution.samples import PhaseSamples


def least_cost(problem: Problem) -> float:
    """Return what the minimised cost is at least, by interval arithmetic; minus infinity if nothing is known."""
    q, boxes = problem.parameter_interval(), []
    for leg in problem.phases.values():
        p = _given(leg)
        ends = [intersect(given, leg.numbers.states) for given in (leg.numbers.initial, leg.numbers.final)]
        boxes += [*ends, *leg.times(), _integrals(problem, leg, q), p]
    return float(ranges_of(problem.once("cost of ends", lambda: _cost(problem)), [*boxes, q]).lower[0])


def reaches_least_cost(
    problem: Problem, samples: Sequence[PhaseSamples], cost: float, amount: float, tolerance: float
) -> bool:
    """Whether the cost is at its least possible value but for rounding, and so are its costates.

    Where the first derivatives of a cost with second derivatives are within the share ``tolerance`` of what it amounts
    to, the cost is within the square of that.

    Parameters
    ----------
    cost : float
        As the problem states it.
    amount : float
        What the cost amounts to (module `magnitude`).
    """
    above = problem.sense * cost - least_cost(problem)
    worths = [np.max(np.abs(s.lam_polynomial) * s.state_scale[:, None], initial=0.0) for s in samples]
    return bool(above <= tolerance**2 * amount and max(worths) <= tolerance * amount)


def _given(leg: Phase) -> Interval:
    return Interval(leg.model.parameter_values, leg.model.parameter_values)


def _integrals(problem: Problem, leg: Phase, q: Interval) -> Interval:
    """Between which values the integrals of a phase lie."""
    (initial, final), numbers = leg.times(), leg.numbers
    times = Interval(initial.lower, final.upper)
    integrands = leg.once("integrands by all", lambda: _integrands(problem, leg))
    rates = ranges_of(integrands, [times, numbers.states, numbers.controls, _given(leg), q])
    least = max(float(numbers.duration.lower[0]), float(final.lower[0] - initial.upper[0]), 0.0)
    most = min(float(numbers.duration.upper[0]), float(final.upper[0] - initial.lower[0]))
    spans = Interval(np.full(rates.lower.size, least), np.full(rates.lower.size, most))
    rate, span = ca.SX.sym("rate", rates.lower.size), ca.SX.sym("span", rates.lower.size)
    return ranges_of(ca.Function("integrals", [rate, span], [rate * span]), [rates, spans])


def _integrands(problem: Problem, leg: Phase) -> Any:
    arguments = [*leg.model.arguments(), problem.parameter_symbols()]
    return ca.Function("integrands", arguments, [ca.densify(problem.bind(leg, leg.integrand_expression()))])


def _cost(problem: Problem) -> Any:
    cost, arguments = problem.sense * problem.cost, []
    legs = problem.phases.values()
    for leg, parameters in zip(legs, parameter_arguments(legs), strict=True):
        cost = problem.bind(leg, cost)
        arguments += [leg.ends("initial"), leg.ends("final"), leg.initial_time, leg.final_time]
        arguments += [leg.integral_symbols(), parameters]
    return ca.Function("cost", [*arguments, problem.parameter_symbols()], [ca.densify(cost)])
