"""Convex problems: where the first order suffices, nothing may be told to curve downwards."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.planning.verification.engine import _of_convex
from gnc_opt.planning.verification.sufficiency import has_one_solution, is_convex


def stated(change: Any = None, rate: Any = None, cost: Any = None, final: Any = 2.0) -> go.Problem:
    """A cart with a parameter k; the cost is the integral of u^2 if nothing else is asked for."""
    model = go.Model("cart")
    x, v, u = model.state("x"), model.state("v"), model.control("u")
    k = model.parameter("k", 1.0)
    model.ode({x: v, v: u + k if rate is None else rate(model.time, x, u, k)})
    problem = go.Problem("move")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=final)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    leg.bounds(u=(-3.0, 3.0))
    if change:
        change(problem, leg, x, u)
    if cost is None:
        problem.minimize(leg.integral(u**2))
    else:
        cost(problem, leg, x, u)
    return problem


def free_k(problem: go.Problem, *_: Any) -> None:
    problem.parameter("k", lower=0.0, upper=2.0)


@pytest.mark.parametrize(
    "convex",
    [
        {},
        {"rate": lambda t, x, u, k: ca.sin(t) * x + ca.exp(k) * u},  # k is a number here
        {"change": free_k},
        {"change": lambda p, leg, x, u: leg.path("p", x + 2 * u, upper=4.0)},
        {
            "change": lambda p, leg, x, u: p.constrain(
                "e", leg.integral(x, "i") + leg.final_state("v"), upper=4.0
            )
        },
        {"cost": lambda p, leg, x, u: p.minimize(leg.integral(u))},
        {"cost": lambda p, leg, x, u: p.maximize(-leg.integral((x - u) ** 2) - leg.final_state("x") ** 2)},
        {"cost": lambda p, leg, x, u: p.minimize(2 * leg.integral(u**2) - 3 * leg.integral(x))},
    ],
)
def test_what_is_convex(convex: dict[str, Any]) -> None:
    assert is_convex(stated(**convex))


@pytest.mark.parametrize(
    "other",
    [
        {"final": (0.5, 4.0)},
        {"rate": lambda t, x, u, k: u - x**2},
        {"rate": lambda t, x, u, k: u * k, "change": free_k},
        {"change": lambda p, leg, x, u: leg.path("p", x**2, lower=0.0)},
        {"change": lambda p, leg, x, u: p.constrain("e", leg.integral(u**2, "i"), lower=4.0)},
        {"change": lambda p, leg, x, u: p.constrain("e", leg.final_state("x") ** 2, equals=1.0)},
        {"cost": lambda p, leg, x, u: p.maximize(leg.integral(u**2))},
        {"cost": lambda p, leg, x, u: p.minimize(leg.integral(u**2 - x**2))},
        {
            "cost": lambda p, leg, x, u: p.minimize(leg.integral(ca.cosh(u)))
        },  # convex, which no constant tells
        {"cost": lambda p, leg, x, u: p.minimize(-leg.integral(u**2) + leg.final_state("v"))},
        # Without a second derivative anywhere but at their kinks, these are not convex there.
        {"cost": lambda p, leg, x, u: p.minimize(leg.integral(u**2 - 3 * ca.fabs(u)))},
        {"cost": lambda p, leg, x, u: p.minimize(leg.integral(ca.fmin(u, 0)))},
        {"cost": lambda p, leg, x, u: p.minimize(leg.integral(ca.if_else(u > 0, -u, u)))},
        {"cost": lambda p, leg, x, u: p.minimize(-ca.fabs(leg.final_state("v") - 1))},
        {"cost": lambda p, leg, x, u: p.minimize(leg.integral(u) * leg.final_state("x"))},
    ],
)
def test_what_is_not_or_is_not_known_to_be(other: dict[str, Any]) -> None:
    assert not is_convex(stated(**other))


def test_a_curvature_that_fails_or_cannot_be_told_says_that_the_problem_is_convex() -> None:
    made = go.Condition(
        "second order", go.ConditionResult.FAIL, 1.0, 0.0, "there", "meaning", sufficient=True
    )
    assert _of_convex(made).result is go.ConditionResult.INCONCLUSIVE
    assert "there; the problem is convex" in _of_convex(made).where
    open_ = _of_convex(replace(made, result=go.ConditionResult.INCONCLUSIVE))
    assert open_.result is go.ConditionResult.INCONCLUSIVE and "the problem is convex" in open_.where
    passed, first = replace(made, result=go.ConditionResult.PASS), replace(made, sufficient=False)
    assert _of_convex(passed) is passed
    assert _of_convex(first) is first


@pytest.mark.parametrize("push", [1.0, 0.8])
def test_the_least_peak_of_a_state_is_an_answer_and_a_higher_one_is_none(push: float) -> None:
    """Rest to rest over 1 in 3 s, pushed by at most 1: push, coast at the peak top, push; top (3 - top / push) = 1.

    With the strongest push nothing else gets there below that peak: a strict minimum.
    """
    model = go.Model("cart")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    problem = go.Problem("least peak of speed")
    leg = problem.phase("leg", model)
    leg.time(0.0, 3.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    peak = problem.parameter("peak", lower=0.0, upper=2.0)
    leg.path("speed", v - peak, upper=0.0)
    problem.minimize(peak)
    top = 0.5 * push * (3.0 - np.sqrt(9.0 - 4.0 / push))
    ends = np.array([0.0, top / push, 3.0 - top / push, 3.0])
    t = np.concatenate([np.linspace(a, b, 21) for a, b in pairwise(ends)])
    arc = np.repeat([0, 1, 2], 21)
    speed = np.minimum(np.minimum(push * t, top), push * (3.0 - t))
    way = np.select(
        [arc == 0, arc == 1],
        [0.5 * push * t**2, top * (t - 0.5 * top / push)],
        1.0 - 0.5 * push * (3.0 - t) ** 2,
    )
    flown = {"q": way, "v": speed}, {"a": np.array([push, 0.0, -push])[arc]}, {"peak": top}
    verdict = go.verify_trajectory(problem, t, *flown)
    assert verdict.ok is (push == 1.0)
    if push == 1.0:
        assert verdict.minimum
        assert top == pytest.approx((3.0 - np.sqrt(5.0)) / 2.0)


# --- one solution only ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "one",
    [
        {},
        {"cost": lambda p, leg, x, u: p.minimize(leg.integral(x**2))},  # x(t) tells v, and v tells u
        {"cost": lambda p, leg, x, u: p.minimize(leg.integral(1e6 * (x - 1e-3 * u) ** 2))},
        {
            "rate": lambda t, x, u, k: 1e-4 * u - k * x,
            "cost": lambda p, leg, x, u: p.minimize(leg.integral(x**2)),
        },
    ],
)
def test_what_has_one_solution(one: dict[str, Any]) -> None:
    assert has_one_solution(stated(**one))


def started_by(problem: go.Problem, leg: Any, amount: Any) -> None:
    """Start where an integral says, which is no given place."""
    leg.initial(x=(0.0, 2.0))
    problem.constrain("start", leg.initial_state("x") + amount, equals=1.0)


@pytest.mark.parametrize(
    "other",
    [
        {"cost": lambda p, leg, x, u: p.minimize(leg.integral(u))},  # any push of the same impulse
        {"cost": lambda p, leg, x, u: p.minimize(leg.final_state("v") ** 2)},
        {"change": lambda p, leg, x, u: leg.initial(x=(0.0, 1.0))},
        {"rate": lambda t, x, u, k: t * u},  # not constant
        {"rate": lambda t, x, u, k: 0 * u, "cost": lambda p, leg, x, u: p.minimize(leg.integral(x**2))},
        {"change": free_k},
        {"final": (0.5, 4.0)},
        {"change": lambda p, leg, x, u: started_by(p, leg, leg.integral(x, "area"))},
    ],
)
def test_what_may_have_many(other: dict[str, Any]) -> None:
    assert not has_one_solution(stated(**other))


def pushed_by_two(cost: Any) -> go.Problem:
    model = go.Model("two engines")
    x, u = model.state("x"), model.control("u", 2)
    model.ode({x: u[0] + u[1]})
    problem = go.Problem("engines")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=1.0)
    leg.initial(x=1.0)
    leg.bounds(u=([-1.0, -1.0], [1.0, 1.0]))
    problem.minimize(leg.integral(cost(x, u)))
    return problem


def test_which_of_two_engines_pushes_is_told_only_by_a_cost_of_their_difference() -> None:
    assert not has_one_solution(pushed_by_two(lambda x, u: x**2))
    assert has_one_solution(pushed_by_two(lambda x, u: x**2 + (u[0] - u[1]) ** 2))
    assert not has_one_solution(pushed_by_two(lambda x, u: (u[0] - u[1]) ** 2))


@pytest.mark.parametrize(("joined", "one"), [(("x", "v"), True), (("x",), False), ((), False)])
def test_a_later_phase_starts_where_end_conditions_put_it(joined: tuple[str, ...], one: bool) -> None:
    """Conditions by hand, with a jump; a start that is left free may be any."""

    def cost(problem: go.Problem, leg: Any, x: Any, u: Any) -> None:
        later = problem.phase("later", leg.model)
        later.time(initial=2.0, final=3.0)
        for name in joined:
            problem.constrain(name, 2 * leg.final_state(name) - later.initial_state(name), equals=0.5)
        problem.minimize(leg.integral(u**2) + later.integral(u**2))

    assert has_one_solution(stated(cost=cost)) is one


def test_a_singular_minimum_that_no_curvature_tells_is_the_only_one() -> None:
    """Least int x^2 with |u| <= 1 from x = 1: down for 1 s, then nothing; 1 / 3. No test by switch times tells it."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("down")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=3.0)
    leg.initial(x=1.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(x**2))
    solution = go.solve(problem)
    assert solution.objective == pytest.approx(1 / 3, abs=1e-7)
    verdict = go.verify(solution)
    assert verdict.minimum, verdict.explain()


def priced(price: Any, order: int = 1, most: float = 1.0) -> go.Verdict:
    """Full push backwards for 2 s, along a chain of integrators; what is priced is the product with the first state."""
    model = go.Model("chain")
    x, u = [model.state(name) for name in "qv"[:order]], model.control("u")
    model.ode(dict(zip(x, [*x[1:], u], strict=True)))
    problem = go.Problem("priced")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    leg.initial(**dict.fromkeys("qv"[:order], 0.0))
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(price(model.time, x[0], u)))
    t = np.linspace(0.0, 2.0, 41)
    chain = [-most * t**2 / 2, -most * t] if order == 2 else [-most * t]
    return go.verify_trajectory(problem, t, chain, -most + 0 * t)


@pytest.mark.parametrize("order", [1, 2])
def test_one_bang_whose_costate_vanishes_at_a_free_end_is_the_only_minimum(order: int) -> None:
    """The switching function has a zero of that order at the end, which no curvature of switch times tells."""
    assert priced(lambda t, q, u: q, order).minimum
    assert not priced(lambda t, q, u: q, order, 0.999).ok
    assert not priced(lambda t, q, u: -q, order).ok


def test_a_switching_function_that_touches_zero_leaves_nothing_open_and_one_that_rests_there_does() -> None:
    touching = priced(lambda t, q, u: (t - 1) ** 2 * u)
    assert touching.minimum and "one solution only" in touching["switching times"].where
    resting = priced(lambda t, q, u: ca.if_else(t < 1, 1 - t, 0.0) * u)  # from 1 s on any push costs nothing
    assert resting.ok and not resting.minimum
    assert not priced(lambda t, q, u: (t - 0.9) * u).ok
