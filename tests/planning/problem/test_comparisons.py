"""Constraints as inequalities and equations are those with limits."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go


def leg() -> tuple[go.Problem, Any, Any, Any]:
    model, x, a = dynamics("cart", "x:2", "a", lambda x, a: {x: ca.vertcat(x[1], a)})
    problem, phase = one_phase("p", model, initial=0.0, final=(0.1, 5.0))
    return problem, phase, x, a


@pytest.mark.parametrize(
    ("comparison", "expression", "lower", "upper"),
    [
        (lambda x, a: a**2 <= 4, lambda x, a: a**2, -np.inf, 4.0),
        (lambda x, a: a**2 < 4, lambda x, a: a**2, -np.inf, 4.0),
        (lambda x, a: a**2 >= 4, lambda x, a: a**2, 4.0, np.inf),
        (lambda x, a: a == 0.5, lambda x, a: a, 0.5, 0.5),
        (lambda x, a: a**2 <= x[0] + 1, lambda x, a: a**2 - (x[0] + 1), -np.inf, 0.0),
        (lambda x, a: a**2 == x[0], lambda x, a: a**2 - x[0], 0.0, 0.0),
        (lambda x, a: x >= np.array([1.0, 2.0]), lambda x, a: x, [1.0, 2.0], np.inf),
        (lambda x, a: [x[0] <= 1, a == 2], lambda x, a: ca.vertcat(x[0], a), [-np.inf, 2.0], [1.0, 2.0]),
    ],
)
def test_comparisons_are_limits(comparison: Any, expression: Any, lower: Any, upper: Any) -> None:
    _, phase, x, a = leg()
    phase.path("c", comparison(x, a))
    found = phase.paths["c"]
    same = ca.Function("same", [x, a], [found.expression - expression(x, a)])
    np.testing.assert_allclose(same([0.3, 0.4], 0.7).full(), 0.0, atol=1e-15)
    np.testing.assert_array_equal(found.interval.lower, np.broadcast_to(lower, found.interval.lower.shape))
    np.testing.assert_array_equal(found.interval.upper, np.broadcast_to(upper, found.interval.upper.shape))


def test_ends_can_be_compared() -> None:
    problem, phase, _, _ = leg()
    problem.constrain("late", phase.final_time >= 2 * phase.initial_time + 1)
    box = problem.constraints["late"].interval
    assert {float(box.lower[0]), float(box.upper[0])} in ({-np.inf, 0.0}, {0.0, np.inf})


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (lambda x, a: {"expression": a <= 1, "upper": 3.0}, "is a comparison and has another limit"),
        (lambda x, a: {"expression": a != 1}, "neither an inequality nor an equation"),
        (lambda x, a: {"expression": [a <= 1, x[0]]}, "neither an inequality nor an equation"),
        (lambda x, a: {"expression": a}, "or write it as a <= b"),
        (lambda x, a: {"expression": a <= np.nan}, "contains nan"),
    ],
)
def test_what_is_no_comparison_is_refused(mistake: Any, message: str) -> None:
    _, phase, x, a = leg()
    with pytest.raises(go.ProblemError, match=message):
        phase.path("c", **mistake(x, a))
