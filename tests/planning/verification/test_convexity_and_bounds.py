"""Convex problems, lower bounds and the least cost."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing import constructed_solutions as by_hand
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import Verdict
from gnc_opt.planning.study.cost_lower_bounds import CONVEX, LINEAR_TIME_OPTIMAL, find_sufficiency_theorem
from gnc_opt.planning.study.state_subset_relaxation import list_problem_relaxations
from gnc_opt.planning.verification.optimality_check import _mark_inconclusive_by_convexity
from gnc_opt.planning.verification.solution_data_check import recompute_stored_data
from gnc_opt.planning.verification.sufficient_conditions import (
    _list_summands,
    attains_lower_bound,
    compute_cost_lower_bound,
    has_unique_solution,
    is_convex,
)
from gnc_opt.report import summary_dict

# Convex problems: where the first order suffices, nothing may be told to curve downwards.


def stated(change: Any = None, rate: Any = None, cost: Any = None, final: Any = 2.0) -> go.Problem:
    """A cart with a parameter k; the cost is the integral of u^2 if nothing else is asked for."""
    model = go.Model("cart")
    x, v, u = model.state("x"), model.state("v"), model.control("u")
    k = model.parameter("k", 1.0)
    model.ode({x: v, v: u + k if rate is None else rate(model.time, x, u, k)})
    problem, leg = one_phase("move", model, initial=0.0, final=final)
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
        {"rate": lambda t, x, u, k: u + ca.sign(x)},
        {"rate": lambda t, x, u, k: u + ca.floor(x)},
        {"rate": lambda t, x, u, k: u * k, "change": free_k},
        {"change": lambda p, leg, x, u: leg.path("p", x**2, lower=0.0)},
        {"change": lambda p, leg, x, u: p.constrain("e", leg.integral(u**2, "i"), lower=4.0)},
        {"change": lambda p, leg, x, u: p.constrain("e", leg.final_state("x") ** 2, equals=1.0)},
        {"cost": lambda p, leg, x, u: p.maximize(leg.integral(u**2))},
        {"cost": lambda p, leg, x, u: p.minimize(leg.integral(u**2 - 1e-13 * x**2))},
        {"cost": lambda p, leg, x, u: p.minimize(leg.integral(u**2 + 1e-13 * x * u))},
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


def test_a_curvature_that_fails_or_is_inconclusive_says_that_the_problem_is_convex() -> None:
    made = go.Condition(
        "second order", go.ConditionResult.FAIL, 1.0, 0.0, "there", "meaning", sufficient=True
    )
    assert _mark_inconclusive_by_convexity(made).result is go.ConditionResult.INCONCLUSIVE
    assert "there; the problem is convex" in _mark_inconclusive_by_convexity(made).where
    open_ = _mark_inconclusive_by_convexity(replace(made, result=go.ConditionResult.INCONCLUSIVE))
    assert open_.result is go.ConditionResult.INCONCLUSIVE and "the problem is convex" in open_.where
    passed, first = replace(made, result=go.ConditionResult.PASS), replace(made, sufficient=False)
    assert _mark_inconclusive_by_convexity(passed) is passed
    assert _mark_inconclusive_by_convexity(first) is first


@pytest.mark.slow
@pytest.mark.parametrize("push", [1.0, 0.8])
def test_the_least_peak_of_a_state_is_an_answer_and_a_higher_one_is_none(push: float) -> None:
    """Rest to rest over 1 in 3 s, pushed by at most 1: push, coast at the peak top, push; top (3 - top / push) = 1.

    With the strongest push nothing else gets there below that peak: a strict minimum.
    """
    model, _q, v, _a = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("least peak of speed", model, 0.0, 3.0)
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


def has_one_solution(problem: go.Problem) -> bool:
    """Whether it has, with no control known beforehand."""
    legs = problem.phases.values()
    return has_unique_solution(
        problem, {leg.name: np.zeros(leg.model.controls.size, dtype=bool) for leg in legs}
    )


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
        {"change": lambda p, leg, x, u: started_by(p, leg, (leg.final_time - 1) * leg.final_state("x"))},
    ],
)
def test_what_may_have_many(other: dict[str, Any]) -> None:
    assert not has_one_solution(stated(**other))


def pushed_by_two(cost: Any) -> go.Problem:
    model, x, u = dynamics("two engines", "x", "u:2", lambda x, u: {x: u[0] + u[1]})
    problem, leg = one_phase("engines", model, initial=0.0, final=1.0)
    leg.initial(x=1.0)
    leg.bounds(u=([-1.0, -1.0], [1.0, 1.0]))
    problem.minimize(leg.integral(cost(x, u)))
    return problem


def test_which_of_two_engines_pushes_is_reported_only_by_a_cost_of_their_difference() -> None:
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


def test_a_singular_minimum_that_no_curvature_detects_is_the_only_one() -> None:
    """Least int x^2 with |u| <= 1 from x = 1: down for 1 s, then nothing; 1 / 3. No test by switch times tells it."""
    model, x, _u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("down", model, initial=0.0, final=3.0)
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
    problem, leg = one_phase("priced", model, 0.0, 2.0)
    leg.initial(**dict.fromkeys("qv"[:order], 0.0))
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(price(model.time, x[0], u)))
    t = np.linspace(0.0, 2.0, 41)
    chain = [-most * t**2 / 2, -most * t] if order == 2 else [-most * t]
    return go.verify_trajectory(problem, t, chain, -most + 0 * t)


@pytest.mark.slow
@pytest.mark.parametrize("order", [2])
def test_one_bang_whose_costate_vanishes_at_a_free_end_is_the_only_minimum(order: int) -> None:
    """The switching function has a zero of that order at the end, which no curvature of switch times tells."""
    assert priced(lambda t, q, u: q, order).minimum
    assert not priced(lambda t, q, u: q, order, 0.999).ok
    assert not priced(lambda t, q, u: -q, order).ok


@pytest.mark.slow
def test_a_switching_function_that_touches_zero_leaves_nothing_open_and_one_that_rests_there_does() -> None:
    touching = priced(lambda t, q, u: (t - 1) ** 2 * u)
    assert touching.minimum and "only one solution" in touching["switching times"].where
    resting = priced(lambda t, q, u: ca.if_else(t < 1, 1 - t, 0.0) * u)  # from 1 s on any push costs nothing
    assert resting.ok and not resting.minimum
    assert not priced(lambda t, q, u: (t - 0.9) * u).ok


# Lower bounds: what a part of a problem costs by itself, and the problems that bound themselves.


def two_carts(first: float, second: float, drag: float = 0.2) -> go.Problem:
    """Rest to rest at one time, the first cart without drag: alone it takes 2 sqrt(distance)."""
    carts = go.Model("carts")
    q, v, a = carts.state("q", 2, unit="m"), carts.state("v", 2, unit="m/s"), carts.control("a", 2)
    carts.ode({q: v, v: ca.vertcat(a[0], a[1] - drag * v[1] ** 3)})
    problem, leg = one_phase("two carts arrive together", carts, 0.0, (0.1, 20.0))
    leg.initial(q=[first, second], v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=([-1.0, -1.0], [1.0, 1.0]))
    problem.minimize(leg.final_time)
    return problem


@pytest.fixture(scope="module")
def together() -> go.Solution:
    return go.lower_bound(go.solve(two_carts(4.0, 1.0)))


@pytest.mark.slow
def test_the_slower_of_two_decoupled_carts_bounds_both_and_is_attained(together: go.Solution) -> None:
    assert together.bound is not None
    assert together.bound.states == ("q[0]", "v[0]")
    assert together.bound.theorem == LINEAR_TIME_OPTIMAL and together.bound.certified
    assert together.bound.value == pytest.approx(2.0 * math.sqrt(4.0), abs=1e-8)
    assert together.gap == pytest.approx(0.0, abs=1e-8)


def test_a_solution_the_verdict_and_their_reports_tell_the_bound(together: go.Solution) -> None:
    assert (
        "bound        at least 4 from the subsystem q[0], v[0] (global minimum: linear and time-optimal)"
        in str(together)
    )
    verdict = go.verify(together)
    assert verdict.bound is together.bound and verdict.gap == together.gap
    assert "from the global optimum" in verdict.headline
    told = summary_dict(together)["bound"]
    assert told == {
        "value": together.bound.value,
        "gap": together.gap,
        "states": ["q[0]", "v[0]"],
        "certified": True,
        "theorem": LINEAR_TIME_OPTIMAL,
    }


def test_the_gap_is_that_of_the_objective_at_hand(together: go.Solution) -> None:
    assert replace(together, objective=5.0).gap == pytest.approx((5.0 - 4.0) / 5.0, abs=1e-8)
    assert replace(together, objective=-5.0, maximised=True).gap == pytest.approx(9.0 / 5.0, abs=1e-8)
    assert replace(together, bound=None).gap is None


def test_files_keep_no_bound(together: go.Solution, tmp_path) -> None:
    known = go.load(together.save(tmp_path / "plan.npz"), problem=two_carts(4.0, 1.0))
    assert known.bound is None and known.gap is None
    assert "bound" not in {line.split()[0] for line in str(known).splitlines()}


@pytest.mark.slow
def test_a_part_that_others_wait_for_leaves_a_gap() -> None:
    """The cart with drag is slower: no theorem speaks for it, but the other one's 2 s hold for both."""
    bounded = go.lower_bound(go.solve(two_carts(1.0, 4.0), check=False))
    assert bounded.bound is not None
    assert bounded.bound.certified and bounded.bound.value == pytest.approx(2.0, abs=1e-8)
    assert bounded.objective > 4.0
    assert bounded.gap == pytest.approx(1.0 - 2.0 / bounded.objective, abs=1e-7)


def follower() -> go.Problem:
    """A pendulum in the least time, and a cart that its angle pushes: the pendulum needs no cart."""
    model = go.Model("pendulum and cart")
    angle = model.state("angle")
    rate = model.state("rate")
    q = model.state("q")
    torque = model.control("torque")
    model.ode({angle: rate, rate: torque - ca.sin(angle), q: ca.sin(angle)})
    problem, leg = one_phase("swing", model, 0.0, (0.1, 20.0))
    leg.initial(angle=1.0, rate=0.0, q=0.0)
    leg.final(angle=0.0, rate=0.0)
    leg.bounds(torque=(-2.0, 2.0))
    problem.minimize(leg.final_time)
    return problem


def test_a_part_that_no_theorem_certifies_is_said_to_be_a_local_minimum() -> None:
    bounded = go.lower_bound(go.solve(follower()))
    assert bounded.bound is not None
    assert bounded.bound.states == ("angle", "rate")
    assert not bounded.bound.certified and bounded.bound.theorem == ""
    assert bounded.gap == pytest.approx(0.0, abs=1e-8)
    assert "no bound if the subsystem has a lower one" in str(bounded.bound)
    assert go.verify(bounded).headline.endswith("from a local minimum of a relaxation")


def test_a_relaxation_that_costs_more_than_the_flight_is_no_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """The flight is one of its trajectories: its minimum was a local one."""
    solution = go.solve(follower(), tol=None)
    dear = replace(go.solve(follower()), objective=solution.objective * 1.1)
    monkeypatch.setattr(
        sys.modules["gnc_opt.planning.study.cost_lower_bounds"], "solve", lambda *_, **__: dear
    )
    assert go.lower_bound(solution).bound is None


def test_what_hangs_together_has_no_bound() -> None:
    model = go.Model("pendulum")
    angle, rate, torque = model.state("angle"), model.state("rate"), model.control("torque")
    model.ode({angle: rate, rate: torque - ca.sin(angle)})
    problem, leg = one_phase("effort", model, 0.0, 1.0)
    leg.initial(angle=1.0, rate=0.0)
    leg.final(angle=0.0)
    problem.minimize(leg.integral(torque**2) + leg.final_state("rate") ** 2)
    bounded = go.lower_bound(go.solve(problem))
    assert bounded.bound is None and bounded.gap is None
    assert "bound" not in {line.split()[0] for line in str(bounded).splitlines()}


def cart(**given) -> tuple[go.Problem, go.Phase]:
    model = go.Model("cart")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a + given.get("wind", 0.0) * model.time + given.get("lift", 0.0) * v**2})
    problem, leg = one_phase("cart", model, 0.0, given.get("time", (0.1, 10.0)))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=given.get("speed", 0.0))
    leg.bounds(a=given.get("push", (-1.0, 1.0)), v=given.get("speeds"))
    if "path" in given:
        leg.path("limit", given["path"](q, v, a), upper=0.0)
    problem.minimize(
        leg.final_time if "time" not in given or isinstance(given["time"], tuple) else leg.integral(a**2)
    )
    return problem, leg


@pytest.mark.parametrize(
    ("given", "theorem"),
    [
        ({}, LINEAR_TIME_OPTIMAL),
        ({"speeds": (-0.6, None)}, LINEAR_TIME_OPTIMAL),
        ({"path": lambda q, v, a: q + v**2 - 3.0}, LINEAR_TIME_OPTIMAL),
        ({"path": lambda q, v, a: 1e6 * ((0.3 * q + 0.7 * v) ** 2 - 9.0)}, LINEAR_TIME_OPTIMAL),
        ({"path": lambda q, v, a: q * v - 3.0}, ""),
        ({"time": 3.0}, CONVEX),
        ({"speed": -0.5}, ""),  # it cannot stay where it arrives
        ({"time": (3.0, 10.0)}, ""),  # the time is at its limit: nothing is least there
        ({"lift": 0.1}, ""),
        ({"wind": 0.05}, ""),
        ({"path": lambda q, v, a: q - v**2 - 3.0}, ""),  # a set that is not convex
        ({"path": lambda q, v, a: q * a - 3.0}, ""),
    ],
)
def test_only_what_the_hypotheses_hold_for_is_certified(given, theorem) -> None:
    solution = go.solve(cart(**given)[0], tol=None)
    assert find_sufficiency_theorem(solution, Verdict("taken for an extremal", ())) == theorem


def test_what_is_not_ok_is_not_certified() -> None:
    solution = go.solve(cart()[0])
    problem = solution.problem
    assert problem is not None
    late = replace(solution, objective=solution.objective * 1.01)
    assert find_sufficiency_theorem(solution, go.verify(solution))
    assert not find_sufficiency_theorem(late, go.verify(late))


@pytest.mark.slow
def test_a_payoff_is_bounded_from_above() -> None:
    """The swing's height limits the cart, not the other way round: alone it would rise to 1."""
    model, *_ = dynamics("riser", "y z", "u", lambda y, z, u: {y: u, z: y**2 + ca.sin(z)})
    problem, leg = one_phase("as high as possible", model, 0.0, 1.0)
    leg.initial(y=0.0, z=0.0)
    leg.bounds(u=(-1.0, 1.0), z=(None, 0.2))
    problem.maximize(leg.final_state("y"))
    bounded = go.lower_bound(go.solve(problem))
    assert bounded.bound is not None and bounded.bound.states == ("y",)
    assert bounded.bound.value == pytest.approx(1.0, abs=1e-7)
    assert bounded.objective < 0.99
    assert bounded.gap == pytest.approx(1.0 / bounded.objective - 1.0, abs=1e-6)
    assert "at most" in str(bounded) and "from the subsystem y (" in str(bounded)


def staged() -> go.Problem:
    """Two phases of a vector each, whose last component drives another state; a free parameter, shared limits."""
    model = go.Model("stage")
    r, v, w = model.state("r", 3, unit="m"), model.state("v", 3, nominal=[1.0, 2.0, 3.0]), model.state("w")
    a, k = model.control("a", 3), model.parameter("k", [1.0, 2.0, 3.0])
    model.parameter("b", [5.0, 7.0])
    gain = model.symbol("b")[1]
    model.ode({r: v, v: k * a, w: v[2] * ca.cos(w) * gain})
    problem = go.Problem("two stages")
    free = problem.parameter("k", 3, lower=0.5, upper=4.0, guess=[1.0, 2.0, 3.0])
    first, second = problem.phase("first", model), problem.phase("second", model)
    first.time(0.0, (0.5, 5.0))
    second.time((0.5, 5.0), (1.0, 9.0))
    first.initial(r=[3.0, 1.0, 0.0], v=0.0, w=0.0)
    second.final(r=0.0, v=0.0)
    for leg in (first, second):
        leg.bounds(r=([-4.0, -5.0, -6.0], [4.0, 5.0, 6.0]))
        leg.path("thrust", ca.sumsqr(a[:2]), upper=1.0)
        leg.path("band", ca.vertcat(v[0] - 9.0, v[2] + w), upper=0.0)
    problem.link(first, second)
    problem.constrain("waypoint", first.final_state("r")[0] + first.final_state("r")[1], upper=3.5)
    problem.minimize(second.final_time + 0.1 * free[0])
    return problem


def test_a_relaxation_states_all_that_concerns_its_states_and_nothing_else() -> None:
    in_plane, other = list_problem_relaxations(staged())
    assert np.flatnonzero(in_plane.states["first"]).tolist() == [0, 1, 3, 4]  # the waypoint ties two axes
    assert np.flatnonzero(other.states["second"]).tolist() == [2, 5, 6]  # the band ties w to the third
    problem = in_plane.problem
    first, second = problem.phases.values()
    assert first.model.states.labels == ("r[0]", "r[1]", "v[0]", "v[1]")
    assert first.model.states["v"].nominal == (1.0, 2.0)
    assert first.model.controls.size == 2
    assert first.model.parameters.names == ("k",) and problem.parameters.names == ("k",)
    assert first.path_labels == ("thrust", "band 0")
    np.testing.assert_array_equal(second.numbers.final.lower, np.zeros(4))
    np.testing.assert_array_equal(first.numbers.states.upper[:2], [4.0, 5.0])
    assert not any("_w" in label for label in problem.constraint_labels())
    assert "waypoint" in problem.constraint_labels()
    assert "link_first_second_time" in problem.constraint_labels()
    problem.check()
    assert other.problem.get_phase("first").model.parameter_values.tolist() == [1.0, 2.0, 3.0, 7.0]
    assert other.problem.get_phase("first").path_labels == ("band 1",)
    other.problem.check()


def test_ties_by_constraints_may_be_cut_where_that_alone_frees_a_part() -> None:
    """The heading needs no position; the corridor in which both stand goes, and with it the position."""
    model = go.Model("rover")
    x, heading, turn = model.state("x"), model.state("heading"), model.control("turn")
    model.ode({x: ca.cos(heading), heading: turn})
    problem, leg = one_phase("turn", model, 0.0, (0.1, 9.0))
    leg.initial(x=0.0, heading=0.0)
    leg.final(heading=2.0)
    leg.bounds(turn=(-1.0, 1.0))
    leg.path("corridor", x + heading, upper=5.0)
    problem.minimize(leg.final_time)
    (only,) = list_problem_relaxations(problem)
    assert only.problem.get_phase().model.states.names == ("heading",)
    assert only.problem.get_phase().path_labels == ()


def test_a_cost_that_needs_all_states_leaves_no_relaxation() -> None:
    _, leg = cart(time=3.0)
    weighed, other = one_phase("weighed", leg.model, 0.0, 1.0)
    weighed.minimize(other.final_state("q"))
    assert list_problem_relaxations(weighed) == []


@pytest.mark.parametrize(("given", "said"), [(3, "lower_bound"), ("x", "lower_bound")])
def test_bad_input_is_refused(given, said) -> None:
    with pytest.raises(go.GncOptError, match=said):
        go.lower_bound(given)


@pytest.mark.parametrize("tol", [0.0, -1.0, math.nan, "fine"])
def test_a_tolerance_is_positive(together: go.Solution, tol) -> None:
    with pytest.raises(go.GncOptError, match="tolerance of lower_bound"):
        go.lower_bound(together, tol=tol)


# Costs that cannot be less, by interval arithmetic: perfect tracking, ends that are met.


def tracking(most: float, controls: int = 1, sense: float = 1.0) -> go.Problem:
    """Follow q = t^2 / 2 from rest, which takes an acceleration of 1; the cost is (1 - 0.9)^2 2^5 / 20 with 0.9."""
    cart = go.Model("cart")
    q, v, a = cart.state("q"), cart.state("v"), cart.control("a", controls)
    cart.ode({q: v, v: ca.sum1(a)})
    problem, leg = one_phase("follow", cart, 0.0, 2.0)
    leg.initial(q=0.0, v=0.0)
    leg.bounds(a=([-most] * controls, [most] * controls))
    cost = leg.integral((q - cart.time**2 / 2) ** 2)
    if sense > 0:
        problem.minimize(7.0 + cost)
    else:
        problem.maximize(7.0 - cost)
    return problem


T = np.linspace(0.0, 2.0, 41)
PERFECT = {"q": T**2 / 2, "v": T}


def test_perfect_tracking_by_one_control_is_the_only_minimum() -> None:
    verdict = go.verify_trajectory(tracking(2.0), T, PERFECT, {"a": 0 * T + 1})
    assert verdict.minimum, verdict.explain()


def test_of_two_controls_many_track_as_well() -> None:
    verdict = go.verify_trajectory(tracking(2.0, 2), T, PERFECT, {"a": np.vstack([0.3 + 0 * T, 0.7 + 0 * T])})
    assert verdict.ok and not verdict.minimum
    assert (
        "the cost is at its lower bound, but the minimum may not be unique" in verdict.inconclusive[0].where
    )


def test_tracking_that_cannot_be_perfect_is_checked_by_its_costates() -> None:
    nearest = {"q": 0.45 * T**2, "v": 0.9 * T}
    verdict = go.verify_trajectory(tracking(0.9), T, nearest, {"a": 0 * T + 0.9})
    assert verdict.minimum
    assert not any("the cost is at its lower bound" in c.where for c in verdict.conditions)


def failed(verdict: Verdict) -> set[str]:
    return {c.name for c in verdict.failed}


@pytest.mark.slow
def test_costates_that_are_no_rounding_fail() -> None:
    followed = go.solve(tracking(2.0), mesh="10x4", tol=None)
    leg = followed.phase()
    lam = replace(leg.lam, values=tuple(v + 1.0 for v in leg.lam.values))
    kept = {n: getattr(leg, n) + 1.0 for n in ("lam_start", "lam_end", "point_costates")}
    forged = replace(followed, phases={"leg": replace(leg, lam=lam, **kept)})
    told = {"stationarity"}
    assert not told & failed(go.verify(followed)) and told <= failed(go.verify(forged))


@pytest.mark.slow
def test_a_flight_beside_the_perfect_one_fails() -> None:
    beside = {"q": 0.51 * T**2, "v": 1.02 * T}
    assert not go.verify_trajectory(tracking(2.0), T, beside, {"a": 0 * T + 1.02}).ok


def stiff(weight: float, wrong: bool) -> go.Verdict:
    """Two pushes against each other, which a weight holds together: (u - w - 1)^2 is left to gain."""
    model, _x, u, w = dynamics("pair", "x", "u w", lambda x, u, w: {x: u})
    problem, leg = one_phase("stiff", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-5.0, 5.0), w=(-5.0, 5.0))
    problem.minimize(3.0 * leg.integral((weight * (u + w) ** 2 + (u - w - 1) ** 2) / 2 - 4.0))
    t, push = np.linspace(0.0, 1.0, 11), 0.0 if wrong else 0.5
    return go.verify_trajectory(problem, t, push * t, [push + 0 * t, -push + 0 * t])


@pytest.mark.parametrize("weight", [1.0, 1e12])
def test_what_a_stiff_term_amounts_to_does_not_hide_that_another_could_be_less(weight: float) -> None:
    right, wrong = stiff(weight, False), stiff(weight, True)
    assert right.ok
    assert not any("the cost is at its lower bound" in c.where for c in wrong.conditions)
    assert not wrong.ok


def test_sums_are_taken_apart() -> None:
    x = ca.SX.sym("x", 3)
    total = 2 * (x[0] - 3 * (x[1] + x[2]) / 4) - (x[0] * x[1] - x[2] * 5.0) + (x[0] - x[1]) / 8
    parts = ca.substitute(ca.vertcat(*_list_summands(total)), x, ca.DM([3.0, 4.0, 8.0]))
    assert ca.DM(parts).full().ravel().tolist() == [6, -6, -12, -12, 40, 0.375, -0.5]


def two_phases(cost: Any) -> go.Problem:
    cart = go.Model("cart")
    q, a, k = cart.state("q"), cart.control("a"), cart.parameter("k", 2.0)
    cart.ode({q: k * a})
    problem = go.Problem("two")
    first, second = problem.phase("first", cart), problem.phase("second", cart)
    first.time(0.0, 1.0)
    second.time((1.0, 1.0), (2.0, 4.0))
    problem.link(first, second)
    first.initial(q=3.0)
    for leg in (first, second):
        leg.bounds(q=(-1.0, 4.0), a=(-1.0, 2.0))
    problem.minimize(cost(first, second, q, a, k))
    return problem


@pytest.mark.parametrize(
    ("cost", "least"),
    [
        (lambda one, two, q, a, k: one.integral(a), -1.0),
        (lambda one, two, q, a, k: two.integral(a), -3.0),  # 3 s at most
        (lambda one, two, q, a, k: two.integral(1 + a**2), 1.0),  # 1 s at least
        (lambda one, two, q, a, k: two.integral(k * a) + one.initial_state("q"), -3.0),
        (lambda one, two, q, a, k: two.final_state("q") ** 2 - 5 + two.final_time, -3.0),
        (lambda one, two, q, a, k: one.integral(a**2) * two.integral(q), -12.0),
        (lambda one, two, q, a, k: one.integral(ca.tan(a)), -math.inf),
    ],
)
def test_least_costs(cost: Any, least: float) -> None:
    assert compute_cost_lower_bound(two_phases(cost)) == pytest.approx(least)


def test_what_is_maximised_is_bounded_from_above() -> None:
    assert compute_cost_lower_bound(tracking(2.0, sense=-1.0)) == pytest.approx(-7.0)
    assert compute_cost_lower_bound(tracking(2.0)) == pytest.approx(7.0)


def test_a_range_of_free_parameters_counts() -> None:
    cart = go.Model("cart")
    q, w = cart.state("q"), cart.parameter("w", 1.0)
    cart.ode({q: w})
    problem = go.Problem("free")
    problem.parameter("w", lower=-2.0, upper=1.0)
    leg = problem.phase("leg", cart)
    leg.time(0.0, 1.0)
    leg.initial(q=0.0)
    problem.minimize(leg.integral(w) + leg.final_state("q") ** 2)
    assert compute_cost_lower_bound(problem) == -2.0


@pytest.mark.parametrize("amount", [1e-3, 1e3])
@pytest.mark.parametrize(
    ("moving", "costate", "least"),
    [(None, 0.5, True), (None, 2.0, False), *((k, 0.0, False) for k in range(3))],
)
def test_every_term_of_an_integral_and_the_costates_are_at_their_bounds(
    moving, costate, least, amount
) -> None:
    """x' = a at the cost of a^2 + b^2 + c^2; ``costate`` in shares of the largest one over the size of x."""
    model, _x, *u = dynamics("idle", "x", "a b c", lambda x, a, b, c: {x: a + 0 * (b + c)})
    problem, leg = one_phase("idle", model, 0.0, 2.0)
    problem.minimize(leg.integral(sum(one**2 for one in u[1:]) + u[0] ** 2))
    shares = np.array([0.0 if k != moving else 1.0 for k in range(3)])
    flat = [
        lambda t, k, v=v: np.outer(v, np.ones(t.size)) for v in ([0.0], shares, [1e-5 * costate * amount])
    ]
    base = by_hand.phase(problem, *flat, breaks=(0.0, 2.0))
    solution = recompute_stored_data(by_hand.solution(problem, base))
    (s,) = samples = list(solution.samples().values())
    larger = amount * float(s.state_scale[0])
    assert attains_lower_bound(solution, samples, 0.0, larger, 1e-5) is least
