"""One solve on one mesh: what is tried when it fails, and what that costs."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.nlp import NlpPoint, NlpResult, NlpSolver, Status
from gnc_opt.solution.solve_mesh import solve_mesh


def regulator(weight: float = 1.0) -> go.Problem:
    """min 1/2 int x^2 + w u^2, x' = u, x(0) = 1, t in [0, 1]: x = cosh((1 - t) / s) / cosh(1 / s), s = sqrt(w)."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("regulator")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=1.0)
    leg.initial(x=1.0)
    problem.minimize(leg.integral(0.5 * (x**2 + weight * u**2)))
    return problem


def cost(weight: float = 1.0) -> float:
    return 0.5 * np.sqrt(weight) * float(np.tanh(1 / np.sqrt(weight)))


class Stumbling:
    """A solver that ends as told at first; `ways` notes how each solve started."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *endings: Status | None) -> None:
        self.endings, self.ways = list(endings), []  # type: list[Status | None], list[str]
        self.deadlines: list[float | None] = []
        self.costs = []  # type: list[int]
        original = NlpSolver.solve

        def solve(solver: NlpSolver, point: NlpPoint, way: str | None = None, **more: object) -> NlpResult:
            result = original(solver, point, way, **more)  # type: ignore[arg-type]
            self.ways.append(way or point.way)
            self.deadlines.append(more["deadline"])  # type: ignore[arg-type]
            self.costs.append(result.iterations)
            ending = self.endings.pop(0) if self.endings else None
            return result if ending is None else replace(result, status=ending)

        monkeypatch.setattr(NlpSolver, "solve", solve)


def test_what_succeeds_is_tried_once(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Stumbling(monkeypatch)
    solution = solve_mesh(regulator(), "3x4")
    assert watch.ways == ["cold"]
    assert solution.objective == pytest.approx(cost(), rel=1e-9)


@pytest.mark.parametrize("ending", [Status.ACCEPTABLE, Status.STEP_TOO_SMALL, Status.SEARCH_DIRECTION_FAILED])
def test_rounding_is_met_by_careful_pivoting_from_where_it_stopped(
    monkeypatch: pytest.MonkeyPatch, ending: Status
) -> None:
    watch = Stumbling(monkeypatch, ending)
    solution = solve_mesh(regulator(), "3x4")
    assert watch.ways == ["cold", "careful"] and solution.status is Status.OPTIMAL
    assert solution.statistics.iterations == sum(watch.costs)


def test_an_ending_without_a_verdict_is_met_by_the_adaptive_barrier(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Stumbling(monkeypatch, Status.RESTORATION_FAILED)
    solution = solve_mesh(regulator(), "3x4")
    assert watch.ways == ["cold", "adaptive"] and solution.status is Status.OPTIMAL
    assert solution.statistics.iterations == sum(watch.costs)


def test_an_infeasible_ending_is_met_by_the_constraints_first(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Stumbling(monkeypatch, Status.INFEASIBLE)
    solution = solve_mesh(regulator(), "3x4")
    assert watch.ways == ["cold", "cold", "cold"], "the constraints alone, then the cost from there"
    assert solution.objective == pytest.approx(cost(), rel=1e-9)
    assert solution.statistics.iterations == sum(watch.costs)


def test_a_trajectory_of_the_user_is_not_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Stumbling(monkeypatch, Status.INFEASIBLE)
    problem = regulator().with_guess("leg", time=[0.0, 0.5, 1.0], x=[[1.0, 0.8, 0.7]])
    assert solve_mesh(problem, "3x4").status is Status.INFEASIBLE
    assert watch.ways == ["cold"]


def test_a_warm_start_that_loses_its_way_keeps_the_trajectory_only(monkeypatch: pytest.MonkeyPatch) -> None:
    known = solve_mesh(regulator(0.1), "3x4")
    watch = Stumbling(monkeypatch, Status.ITERATION_LIMIT)
    solution = solve_mesh(regulator(), "3x4", guess=known, warm_iterations=50)
    assert watch.ways == ["warm", "cold"]
    assert solution.objective == pytest.approx(cost(), rel=1e-9)
    assert solution.statistics.iterations == sum(watch.costs)
    assert solution.problem is not None and solution.problem.get_phase().numbers.guess.values == {}


def test_without_a_limit_a_warm_start_is_the_only_one(monkeypatch: pytest.MonkeyPatch) -> None:
    known = solve_mesh(regulator(0.1), "3x4")
    watch = Stumbling(monkeypatch, Status.ITERATION_LIMIT)
    assert solve_mesh(regulator(), "3x4", guess=known).status is Status.ITERATION_LIMIT
    assert watch.ways == ["warm"]


def test_all_tries_share_one_limit_of_wall_time(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Stumbling(monkeypatch, Status.RESTORATION_FAILED, Status.RESTORATION_FAILED, Status.ACCEPTABLE)
    solve_mesh(regulator(), "3x4", options=go.SolverOptions(max_wall_time=60.0))
    assert len(watch.deadlines) > 3 and len(set(watch.deadlines)) == 1


def test_the_trajectory_alone_has_what_the_warm_start_left_of_the_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known = solve_mesh(regulator(0.1), "3x4")
    original, left = NlpSolver.solve, []  # type: ignore[var-annotated]

    def slow_and_lost(solver: NlpSolver, point: NlpPoint, way: str | None = None, **more: Any) -> NlpResult:
        left.append(more["deadline"] - time.perf_counter())
        result = original(solver, point, way, **more)  # type: ignore[arg-type]
        lost = point.way == "warm"
        return replace(result, status=Status.ITERATION_LIMIT, wall_time=500.0) if lost else result

    monkeypatch.setattr(NlpSolver, "solve", slow_and_lost)
    limit = go.SolverOptions(max_wall_time=600.0)
    assert solve_mesh(regulator(), "3x4", guess=known, options=limit, warm_iterations=50).status.solved
    assert left[0] > 500.0 > 100.0 >= left[1]


def test_nothing_is_shown_unless_it_is_asked_for(capfd: pytest.CaptureFixture[str]) -> None:
    solve_mesh(regulator(), "3x4")
    assert capfd.readouterr() == ("", "")
