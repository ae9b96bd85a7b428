"""Path constraints that are met at an end of a phase only, where a mesh of Gauss points has no row: closed forms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import ConditionResult

ROOT = 5 * (np.sqrt(1.2) - 1)
"""Where v + v^2 / 10 = 1/2."""


def cart() -> tuple[go.Model, Any, Any, Any]:
    model, q, v, a = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    return model, q, v, a


def effort(d: float, v0: float, v1: float, t: float) -> float:
    """Least integral of a^2 / 2 over a distance between two speeds (Bryson & Ho, 1975, section 5.2)."""
    return 2 / t**3 * (3 * d**2 - 3 * d * t * (v0 + v1) + t**2 * (v0**2 + v0 * v1 + v1**2))


def speed_at_the_end() -> tuple[go.Problem, float]:
    """What is gained by v(1) without the limit leads beyond it; order one."""
    model, _, v, a = cart()
    problem, leg = one_phase("fast at the end", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.path("limit", v + v**2 / 10, upper=0.5)
    problem.minimize(leg.integral(a**2 / 2) - 2 * leg.final_state("v"))
    return problem, ROOT**2 / 2 - 2 * ROOT


def place_at_the_end() -> tuple[go.Problem, float]:
    """The same of q(1); order two."""
    model, q, _, a = cart()
    problem, leg = one_phase("far at the end", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.path("limit", q + q**2, upper=0.5)
    problem.minimize(leg.integral(a**2 / 2) - 3 * leg.final_state("q"))
    end = (np.sqrt(3) - 1) / 2
    return problem, 1.5 * end**2 - 3 * end


def moving_wall() -> tuple[go.Problem, float]:
    """Full thrust until the wall q = 1 - 0.3 t comes, as fast as can be; the time is free."""
    model, q, _, _ = cart()
    problem, leg = one_phase("to the wall", model, 0.0, (0.1, 5.0))
    leg.initial(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    leg.path("wall", q + 0.3 * model.time, upper=1.0)
    problem.minimize(-leg.final_state("v"))
    return problem, 0.3 - np.sqrt(2.09)


def limit_that_costs() -> tuple[go.Problem, float]:
    """The limit of v(1) is a free parameter."""
    model, _, v, a = cart()
    problem = go.Problem("bought speed")
    limit = problem.parameter("limit", lower=0.0, upper=5.0)
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.path("limit", v + v**2 / 10 - limit, upper=0.0)
    problem.minimize(leg.integral(a**2 / 2) - 2 * leg.final_state("v") + limit**2)

    def cost(end: float) -> float:
        return end**2 / 2 - 2 * end + (end + end**2 / 10) ** 2

    return problem, float(
        scipy.optimize.minimize_scalar(cost, bounds=(0.0, 2.0), options={"xatol": 1e-9}).fun
    )


def place_at_the_start() -> tuple[go.Problem, float]:
    """The nearer it starts the less it costs; the limit moves on faster than the cart."""
    model, q, _, a = cart()
    problem, leg = one_phase("near at the start", model, 0.0, 1.0)
    leg.initial(v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.path("limit", q - model.time + q**2 / 2, upper=0.625)
    problem.minimize(leg.integral(a**2 / 2))
    return problem, effort(0.5, 0.0, 0.0, 1.0)


def between_two_phases() -> tuple[go.Problem, float]:
    """The first phase has to end before where both together would have it."""
    model, q, _, a = cart()
    problem = go.Problem("half way")
    first, second = problem.phase("first", model), problem.phase("second", model)
    first.time(0.0, 0.5)
    second.time(0.5, 1.0)
    problem.link(first, second)
    first.initial(q=0.0, v=0.0)
    second.final(q=1.0, v=0.0)
    first.path("limit", q + q**2, upper=0.3125)
    problem.minimize(first.integral(a**2 / 2) + second.integral(a**2 / 2))
    return problem, effort(0.25, 0.0, 1.5, 0.5) + effort(0.75, 1.5, 0.0, 0.5)


@pytest.mark.parametrize(
    "stated",
    [
        speed_at_the_end,
        place_at_the_end,
        moving_wall,
        limit_that_costs,
        place_at_the_start,
        between_two_phases,
    ],
)
def test_a_limit_met_at_an_end_only(stated: Callable[[], tuple[go.Problem, float]]) -> None:
    problem, least = stated()
    found = go.solve(problem, tol=1e-8)
    assert found.objective == pytest.approx(least, abs=1e-9)
    assert go.verify(found).minimum, go.verify(found).explain()


@pytest.mark.parametrize(("pull", "result"), [(2.5, ConditionResult.PASS), (3.5, ConditionResult.FAIL)])
def test_the_nearest_point_of_a_disc_is_the_end_until_going_round_pays(
    pull: float, result: ConditionResult
) -> None:
    # From 3 m straight at a disc of 1 m: c(phi) = (10 - 6 cos phi) / 2 + pull cos phi on its edge, c'' = 3 - pull.
    point, x, y, u = dynamics("point", "x y", "u:2", lambda x, y, u: {x: u[0], y: u[1]})
    problem, leg = one_phase("to a disc", point, 0.0, 1.0)
    leg.initial(x=3.0, y=0.0)
    leg.path("outside", x**2 + y**2, lower=1.0)
    problem.minimize(leg.integral((u[0] ** 2 + u[1] ** 2) / 2) + pull * leg.final_state("x"))
    t = np.linspace(0.0, 1.0, 11)
    straight = np.vstack([0 * t - 2, 0 * t])
    verdict = go.verify_trajectory(problem, t, {"x": 3 - 2 * t, "y": 0 * t}, {"u": straight})
    assert verdict["second order"].result is result, verdict
    assert verdict.minimum == (result is ConditionResult.PASS)


@pytest.mark.slow
@pytest.mark.parametrize(("gain", "result"), [(2.0, ConditionResult.PASS), (0.2, ConditionResult.FAIL)])
def test_a_limit_at_the_end_pushes_but_does_not_pull(gain: float, result: ConditionResult) -> None:
    model, _, v, a = cart()
    problem, leg = one_phase("fast at the end", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.path("limit", v + v**2 / 10, upper=0.5)
    problem.minimize(leg.integral(a**2 / 2) - gain * leg.final_state("v"))
    t = np.linspace(0.0, 1.0, 11)
    verdict = go.verify_trajectory(problem, t, {"q": ROOT * t**2 / 2, "v": ROOT * t}, {"a": 0 * t + ROOT})
    assert verdict["stationarity"].result is result, verdict
    assert verdict.minimum == (result is ConditionResult.PASS)


@pytest.mark.slow
def test_limits_met_at_both_ends_are_found_once() -> None:
    # At constant speed from q - t = -1/5 to 1/5, which costs nothing and gains 3 (6/5 + 1/5).
    model, q, _, a = cart()
    problem, leg = one_phase("corridor that moves", model, 0.0, 1.0)
    leg.path("corridor", (q - model.time) ** 2, upper=0.04)
    problem.minimize(leg.integral(a**2 / 2) + 3 * leg.initial_state("q") - 3 * leg.final_state("q"))
    found = go.solve(problem)
    assert found.objective == pytest.approx(-4.2, abs=1e-8)
    assert go.verify(found).ok and found.history is not None
    assert sum("contact" in str(p.actions) for p in found.history.passes) <= 1
