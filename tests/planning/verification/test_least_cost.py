"""Costs that cannot be less, by interval arithmetic: perfect tracking, ends that are met."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.planning import Verdict
from gnc_opt.planning.verification.sufficiency import _addends, least_cost


def tracking(most: float, controls: int = 1, sense: float = 1.0) -> go.Problem:
    """Follow q = t^2 / 2 from rest, which takes an acceleration of 1; the cost is (1 - 0.9)^2 2^5 / 20 with 0.9."""
    cart = go.Model("cart")
    q, v, a = cart.state("q"), cart.state("v"), cart.control("a", controls)
    cart.ode({q: v, v: ca.sum1(a)})
    problem = go.Problem("follow")
    leg = problem.phase("leg", cart)
    leg.time(0.0, 2.0)
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
        "the cost is the least that there can be, and the minimum may be one of many"
        in verdict.inconclusive[0].where
    )


def test_tracking_that_cannot_be_perfect_is_judged_by_its_costates() -> None:
    nearest = {"q": 0.45 * T**2, "v": 0.9 * T}
    verdict = go.verify_trajectory(tracking(0.9), T, nearest, {"a": 0 * T + 0.9})
    assert verdict.minimum
    assert not any("least that there can be" in c.where for c in verdict.conditions)


def failed(verdict: Verdict) -> set[str]:
    return {c.name for c in verdict.failed}


def test_costates_that_are_no_rounding_fail() -> None:
    followed = go.solve(tracking(2.0), mesh="10x4", tol=None)
    leg = followed.phase()
    lam = replace(leg.lam, values=tuple(v + 1.0 for v in leg.lam.values))
    kept = {n: getattr(leg, n) + 1.0 for n in ("lam_start", "lam_end", "point_costates")}
    forged = replace(followed, phases={"leg": replace(leg, lam=lam, **kept)})
    told = {"stationarity"}
    assert not told & failed(go.verify(followed)) and told <= failed(go.verify(forged))


def test_a_flight_beside_the_perfect_one_fails() -> None:
    beside = {"q": 0.51 * T**2, "v": 1.02 * T}
    assert not go.verify_trajectory(tracking(2.0), T, beside, {"a": 0 * T + 1.02}).ok


def stiff(weight: float, wrong: bool) -> go.Verdict:
    """Two pushes against each other, which a weight holds together: (u - w - 1)^2 is left to gain."""
    model = go.Model("pair")
    x, u, w = model.state("x"), model.control("u"), model.control("w")
    model.ode({x: u})
    problem = go.Problem("stiff")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-5.0, 5.0), w=(-5.0, 5.0))
    problem.minimize(3.0 * leg.integral((weight * (u + w) ** 2 + (u - w - 1) ** 2) / 2 - 4.0))
    t, push = np.linspace(0.0, 1.0, 11), 0.0 if wrong else 0.5
    return go.verify_trajectory(problem, t, push * t, [push + 0 * t, -push + 0 * t])


@pytest.mark.parametrize("weight", [1.0, 1e4, 1e8, 1e12])
def test_what_a_stiff_term_amounts_to_does_not_hide_that_another_could_be_less(weight: float) -> None:
    right, wrong = stiff(weight, False), stiff(weight, True)
    assert right.ok
    assert not any("least that there can be" in c.where for c in wrong.conditions)
    assert not wrong.ok


def test_sums_are_taken_apart() -> None:
    x = ca.SX.sym("x", 3)
    parts = ca.vertcat(*_addends(2 * (x[0] - 3 * (x[1] + x[2]) / 4) - (x[0] * x[1] - x[2] * 5.0)))
    assert ca.DM(ca.substitute(parts, x, ca.DM([3.0, 4.0, 8.0]))).full().ravel().tolist() == [
        6,
        -6,
        -12,
        -12,
        40,
    ]


# --- the bound ---------------------------------------------------------------------------------------------


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
    assert least_cost(two_phases(cost)) == pytest.approx(least)


def test_what_is_maximised_is_bounded_from_above() -> None:
    assert least_cost(tracking(2.0, sense=-1.0)) == pytest.approx(-7.0)
    assert least_cost(tracking(2.0)) == pytest.approx(7.0)


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
    assert least_cost(problem) == -2.0
