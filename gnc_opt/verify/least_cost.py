r"""Costs that cannot be less: what they are made of is as small as it can be.

A sum of squares is not negative. With the least value of every integrand, times the duration, and of the cost of these
and of the ends, for states and controls within their bounds, interval arithmetic (module `ranges`) bounds the cost from
below. A flight that reaches that bound is a global minimum, whatever its costates say: they vanish there,
:math:`\partial L/\partial x = 0` as well, and what is left of them is rounding. It may be one of many.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.problem.constraint import make_constraint
from gnc_opt.problem.interval import Interval, intersect
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.problem import Problem
from gnc_opt.problem.ranges import ranges_of
from gnc_opt.problem.symbols import parameter_arguments
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.solution.solution import Solution
from gnc_opt.verify.judged import ends_of, from_problem
from gnc_opt.verify.magnitude import Magnitudes


def least_cost(problem: Problem) -> float:
    """Return what the minimised cost is at least, by interval arithmetic; minus infinity if nothing is known."""
    return float(_least(problem, [problem.sense * problem.cost])[0])


def _least(problem: Problem, expressions: Sequence[Any]) -> Array:
    """Return what expressions of the ends are at least."""
    q, boxes = problem.parameter_interval(), []
    for leg in problem.phases.values():
        p = _given(leg)
        ends = [intersect(given, leg.numbers.states) for given in (leg.numbers.initial, leg.numbers.final)]
        boxes += [*ends, *leg.times(), _integrals(problem, leg, q), p]
    return ranges_of(_of_ends(problem, expressions), [*boxes, q]).lower


def reaches_least_cost(
    solution: Solution, samples: Sequence[PhaseSamples], cost: float, amount: float, tolerance: float
) -> bool:
    """Whether the cost is at its least possible value but for rounding, and so are its costates.

    Where the first derivatives of a cost with second derivatives are within the share ``tolerance`` of what it amounts
    to, the cost is within the square of that.

    Parameters
    ----------
    solution : Solution
        With all that its problem tells (`from_problem`).
    cost : float
        As the problem states it.
    amount : float
        What the cost amounts to (module `magnitude`).
    """
    problem = solution.need_problem("verify")
    above = problem.sense * cost - least_cost(problem)
    worths = [np.max(np.abs(s.lam_polynomial) * s.state_scale[:, None], initial=0.0) for s in samples]
    near = above <= tolerance**2 * amount and max(worths) <= tolerance * amount
    return bool(near and np.all(_above_least(solution) <= tolerance**2))


def _above_least(solution: Solution) -> Array:
    """Return how far each term of the cost is above its least value, in shares of what it amounts to.

    Each is a boundary constraint of a problem of its own, which the verdict's yardsticks are taken of.
    """
    problem = solution.need_problem("verify").clone()
    terms = list(_addends(problem.sense * problem.cost))
    for leg in problem.phases.values():
        for symbol, integrand in list(leg.integrands.values()):
            shares = [leg.integral(part) for part in _addends(integrand)]
            terms = [
                part
                for term in terms
                for part in _addends(ca.substitute(term, symbol, sum(shares[1:], shares[0])))
            ]
    problem.constraints = {
        f"term {k}": make_constraint(f"term {k}", term, None, 0.0, None, "a term of the cost")
        for k, term in enumerate(terms)
    }
    problem.changed()
    none = {name: np.zeros(len(leg.integrands)) for name, leg in problem.phases.items()}
    apart = replace(
        solution,
        problem=problem,
        phases={
            k: replace(v, integrals=none[k], integral_weights=none[k]) for k, v in solution.phases.items()
        },
        constraint_labels=problem.constraint_labels(),
        constraint_values=np.zeros(len(terms)),
        constraint_multipliers=np.zeros(len(terms)),
    )
    apart = from_problem(apart)
    amounts = Magnitudes.of(apart, list(apart.samples().values())).constraints
    return np.asarray((ends_of(apart).constraints - _least(problem, terms)) / amounts)


def _addends(expression: Any, factor: float = 1.0) -> Iterator[Any]:
    """Yield what a sum is made of, multiplied out where a factor is a number."""
    if expression.op() in (ca.OP_ADD, ca.OP_SUB):
        first, second = (expression.dep(k) for k in range(2))
        yield from _addends(first, factor)
        yield from _addends(second, -factor if expression.op() == ca.OP_SUB else factor)
    elif expression.op() in (ca.OP_NEG, ca.OP_TWICE):
        yield from _addends(expression.dep(0), -factor if expression.op() == ca.OP_NEG else 2.0 * factor)
    elif expression.op() == ca.OP_MUL and expression.dep(0).is_constant():
        yield from _addends(expression.dep(1), factor * float(expression.dep(0)))
    elif expression.op() == ca.OP_MUL and expression.dep(1).is_constant():
        yield from _addends(expression.dep(0), factor * float(expression.dep(1)))
    elif expression.op() == ca.OP_DIV and expression.dep(1).is_constant():
        yield from _addends(expression.dep(0), factor / float(expression.dep(1)))
    else:
        yield factor * expression


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


def _of_ends(problem: Problem, expressions: Sequence[Any]) -> Any:
    column, arguments = ca.vertcat(*expressions), []
    legs = problem.phases.values()
    for leg, parameters in zip(legs, parameter_arguments(legs), strict=True):
        column = problem.bind(leg, column)
        arguments += [leg.ends("initial"), leg.ends("final"), leg.initial_time, leg.final_time]
        arguments += [leg.integral_symbols(), parameters]
    return ca.Function("of_ends", [*arguments, problem.parameter_symbols()], [ca.densify(column)])
