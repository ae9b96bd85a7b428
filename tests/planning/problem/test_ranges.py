"""Interval arithmetic holds what the expressions take; budgets are told from what comes and goes."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testing.internals import Interval, bound_function_values, find_monotone_states
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning.problem.interval_arithmetic import is_affine

X = ca.SX.sym("x", 2)
EXPRESSIONS = {
    "sum": X[0] + X[1],
    "difference": X[0] - X[1],
    "opposite": -X[0],
    "product": X[0] * X[1],
    "quotient": X[0] / X[1],
    "reciprocal": 1 / X[0],
    "square": X[0] ** 2,
    "cube": X[0] ** 3,
    "root of a square": ca.sqrt(X[0] ** 2 + X[1] ** 2),
    "magnitude": ca.fabs(X[0]),
    "exponential": ca.exp(-X[0]),
    "power": (1 + X[0] ** 2) ** 1.5,
    "falling power": (X[0] ** 2) ** -0.7,
    "varying power": (0.5 + X[0] ** 2) ** X[1],
    "least and largest": ca.fmin(X[0], X[1]) + 2 * ca.fmax(X[0], X[1]),
    "waves": ca.sin(X[0]) + ca.cos(X[1]) + ca.tanh(X[0]),
    "unknown": ca.atan2(X[0], X[1]),
}
numbers = st.floats(-3, 3, allow_subnormal=False)  # whose reciprocals are finite
ends = st.tuples(numbers, numbers).map(sorted)


@pytest.mark.parametrize("name", EXPRESSIONS)
@settings(max_examples=15)
@given(a=ends, b=ends, shares=st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=8))
def test_values_lie_in_their_range(name, a, b, shares) -> None:
    function = ca.Function("f", [X], [EXPRESSIONS[name]])
    box = bound_function_values(function, [Interval(np.array([a[0], b[0]]), np.array([a[1], b[1]]))])
    for s, t in shares:
        at = [a[0] + s * (a[1] - a[0]), b[0] + t * (b[1] - b[0])]
        value = float(function(np.clip(at, *zip(a, b, strict=True))))  # rounding leads out of the range
        if np.isfinite(value):
            assert box.lower[0] - 1e-12 * (1 + abs(value)) <= value <= box.upper[0] + 1e-12 * (1 + abs(value))


@pytest.mark.parametrize(
    ("expression", "lower", "upper"),
    [
        (X[0] * X[1], -2.0, 1.0),  # x in [-1, 1/2], y in [1, 2]
        (X[0] ** 2, 0.0, 1.0),
        (X[0] / X[1], -1.0, 0.5),
        (ca.sqrt(X[0] ** 2 + X[1]), 1.0, np.sqrt(3.0)),
        (1 / X[0], -np.inf, np.inf),
        (ca.fabs(X[0]) * X[1], 0.0, 2.0),
        (X[1] * ca.sin(X[0]), -2.0 * np.sin(1.0), 2.0 * np.sin(0.5)),
        (ca.cos(X[0]), np.cos(1.0), 1.0),
        (ca.sin(4.0 * X[1]), -1.0, 1.0),  # over 4 rad
    ],
)
def test_ranges_in_which_nothing_occurs_twice_are_the_narrowest(expression, lower, upper) -> None:
    box = bound_function_values(
        ca.Function("f", [X], [expression]), [Interval(np.array([-1.0, 1.0]), np.array([0.5, 2.0]))]
    )
    assert box.lower[0] == pytest.approx(lower)
    assert box.upper[0] == pytest.approx(upper)


def test_what_knows_no_limit_has_none() -> None:
    """Zero times a quantity without limits is zero; one without limits less itself may be anything."""
    function = ca.Function("f", [X], [ca.vertcat(0 * X[0], X[0] - X[0] * X[1])])
    box = bound_function_values(function, [Interval(np.array([-np.inf, 1.0]), np.array([np.inf, 2.0]))])
    np.testing.assert_array_equal(box.lower, [0.0, -np.inf])
    np.testing.assert_array_equal(box.upper, [0.0, np.inf])


@pytest.mark.parametrize("expression", [1 / X[0], X[1] / X[0], (1 + X[1]) ** 2.5])
def test_what_leaves_the_numbers_may_be_anything_beyond(expression) -> None:
    """A division by zero, and a power beyond all numbers."""
    function = ca.Function("f", [X], [expression])
    box = bound_function_values(function, [Interval(np.array([0.0, 1.0]), np.array([0.0, 1e200]))])
    assert box.upper[0] == np.inf
    assert box.lower[0] <= 2**2.5


def test_a_rate_that_turns_round_just_beyond_its_bounds_is_no_budget() -> None:
    """Between 0 and 1 it only rises; from 1.05 on it falls, and a flight might come back to its bound."""
    model = go.Model("tank")
    level, other, u = model.state("level"), model.state("other"), model.control("u")
    model.ode({level: u * (1.05 - other), other: u})
    problem, leg = one_phase("tank", model, initial=0.0, final=1.0)
    leg.bounds(u=(0.0, 1.0), level=(0.0, 1.0), other=(0.0, 1.0))
    rising, _ = find_monotone_states(problem, leg)
    assert rising.tolist() == [False, True]


def test_bounds_of_states_that_turn_round_hold_for_the_rates_of_others() -> None:
    """Jackson's reactor: c' = (1 - u) b >= 0 for b >= 0, which comes and goes and keeps its bound."""
    model = go.Model("reactor")
    a, b, c, u = model.state("a"), model.state("b"), model.state("c"), model.control("u")
    model.ode({a: u * (10 * b - a), b: u * (a - 10 * b) - (1 - u) * b, c: (1 - u) * b})
    problem, leg = one_phase("Jackson", model, initial=0.0, final=4.0)
    leg.bounds(a=(0.0, 1.1), b=(0.0, 1.1), c=(0.0, 1.1), u=(0.0, 1.0))
    rising, falling = find_monotone_states(problem, leg)
    assert rising.tolist() == [False, False, True] and not np.any(falling)


def test_budgets_are_distinguished_from_what_comes_and_goes() -> None:
    model = go.Model("vehicle")
    names = ("fuel", "dose", "energy", "charge", "speed", "heat", "free")
    fuel, dose, energy, charge, speed, heat, free = (model.state(name) for name in names)
    u, w = model.control("u"), model.control("w")
    loss = model.parameter("loss", 2.0)
    model.ode(
        {
            fuel: -u / loss,  # rests where u = 0: falls else
            dose: u,
            energy: u**2 + w**2,
            charge: w,  # comes and goes
            speed: -(speed**2),  # no control
            heat: 2 + u,  # never rests
            free: u,  # has no bound
        }
    )
    problem, leg = one_phase("vehicle", model, initial=0.0, final=1.0)
    leg.bounds(u=(0.0, 1.0), w=(-1.0, 1.0), **dict.fromkeys(names[:-1], (0.0, 1.0)))
    rising, falling = find_monotone_states(problem, leg)
    assert [names[i] for i in np.flatnonzero(rising)] == ["dose", "energy"]
    assert [names[i] for i in np.flatnonzero(falling)] == ["fuel"]
    leg.bounds(u=(-1.0, 0.0))
    rising, falling = find_monotone_states(problem, leg)
    assert [names[i] for i in np.flatnonzero(rising)] == ["fuel", "energy"]
    assert [names[i] for i in np.flatnonzero(falling)] == ["dose"]
    rising, falling = find_monotone_states(problem, leg, undriven=True)
    assert [names[i] for i in np.flatnonzero(falling)] == ["dose", "speed"] and not rising[4]


def test_a_budget_is_found_again_for_other_numbers() -> None:
    """What is kept of a problem serves its variations, too: with another sign of the parameter the fuel rises."""
    model = go.Model("tank")
    fuel, u = model.state("fuel"), model.control("u")
    loss = model.parameter("loss", 2.0)
    model.ode({fuel: -loss * u})
    problem, leg = one_phase("tank", model, initial=0.0, final=1.0)
    leg.bounds(u=(0.0, 1.0), fuel=(0.0, 1.0))
    filled = problem.with_parameters(loss=-2.0)
    pumped = problem.with_bounds(u=(-1.0, 1.0))
    for stated, ways in ((problem, (False, True)), (filled, (True, False)), (pumped, (False, False))) * 2:
        assert tuple(bool(way[0]) for way in find_monotone_states(stated, stated.get_phase())) == ways


def test_a_list_of_two_is_the_range_of_a_scalar_and_the_value_of_a_vector() -> None:
    model, _r, _u = dynamics("point", "r:2", "u", lambda r, u: {r: [u, 1.0]})
    leg = go.Problem("probe").phase("leg", model)
    leg.bounds(u=[-1, 2])
    assert (leg.numbers.controls.lower, leg.numbers.controls.upper) == ([-1.0], [2.0])
    leg.bounds(u=[None, 2], r=[3.0, 4.0])
    assert leg.numbers.controls.lower == [-np.inf]
    assert leg.numbers.states.lower.tolist() == leg.numbers.states.upper.tolist() == [3.0, 4.0]
    with pytest.raises(go.ProblemError):
        leg.bounds(u=[2, -1])


def test_jumps_are_not_affine_although_their_derivatives_vanish() -> None:
    u, v = ca.SX.sym("u"), ca.SX.sym("v")
    for jump in (ca.sign(u), ca.floor(u), ca.ceil(u), ca.fmod(u, 2.0), u > v, ca.if_else(u > v, 1.0, 2.0)):
        assert not is_affine(3.0 * u + jump, u)
        assert is_affine(3.0 * v + ca.substitute(jump, v, 0.0), v)
    assert is_affine(ca.if_else(v > 0.0, u, 2.0 * u), u)


def test_a_cost_below_the_least_one_is_not_reported() -> None:
    """Rest to rest over 1 m in 2 s with |u| <= 2 m/s^2 and the cost u + sign(u) of a positive control.

    Full acceleration for t1, coasting, full deceleration: 2 t1 (2 - t1) = 1, the cost is 3 t1 = 3 - 3 / sqrt(2).
    """
    model, *_, u = dynamics("cart", "x v", "u", lambda x, v, u: {x: v, v: u})
    problem, leg = one_phase("move", model, initial=0.0, final=2.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    leg.bounds(u=(-2.0, 2.0))
    problem.minimize(leg.integral(ca.fmax(u + ca.sign(u), 0.0)))
    solution = go.solve(problem, mesh="12x3", tol=None, throw=False)
    assert solution.objective > 3 - 3 / 2**0.5 - 1e-3
