"""One solve on one mesh: what is tried when it fails, and what that costs."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from testing.internals import (
    NlpPoint,
    NlpResult,
    NlpSolver,
    WorkBudget,
    has_trajectory_guess,
    solve_problem_on_mesh,
    solve_with_tighter_tolerance,
)
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import Status


def regulator(weight: float = 1.0) -> go.Problem:
    """min 1/2 int x^2 + w u^2, x' = u, x(0) = 1, t in [0, 1]: x = cosh((1 - t) / s) / cosh(1 / s), s = sqrt(w)."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("regulator", model, initial=0.0, final=1.0)
    leg.initial(x=1.0)
    problem.minimize(leg.integral(0.5 * (x**2 + weight * u**2)))
    return problem


def cost(weight: float = 1.0) -> float:
    return 0.5 * np.sqrt(weight) * float(np.tanh(1 / np.sqrt(weight)))


FAILED = [Status.INFEASIBLE] * 3
"""Of the guess, by both barriers, and of a simulation."""


class Stumbling:
    """A solver that ends as told at first; `ways` notes how each solve started."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *endings: Status | None) -> None:
        self.endings, self.ways = list(endings), []  # type: list[Status | None], list[str]
        self.deadlines: list[float | None] = []
        self.costs = []  # type: list[int]
        self.points, self.results = [], []  # type: list[NlpPoint], list[NlpResult]
        original = NlpSolver.solve

        def solve(solver: NlpSolver, point: NlpPoint, way: str | None = None, **more: object) -> NlpResult:
            result = original(solver, point, way, **more)  # type: ignore[arg-type]
            self.ways.append(way or point.warm_or_cold_start)
            self.deadlines.append(more["deadline"])  # type: ignore[arg-type]
            self.costs.append(result.iterations)
            self.points.append(point)
            self.results.append(result)
            ending = self.endings.pop(0) if self.endings else None
            return result if ending is None else replace(result, status=ending)

        monkeypatch.setattr(NlpSolver, "solve", solve)


def test_what_succeeds_is_tried_once(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Stumbling(monkeypatch)
    solution = solve_problem_on_mesh(regulator(), "3x4")
    assert watch.ways == ["cold"]
    assert solution.objective == pytest.approx(cost(), rel=1e-9)


@pytest.mark.parametrize("ending", [Status.RESTORATION_FAILED, Status.INFEASIBLE])
def test_the_first_failure_is_met_by_the_adaptive_barrier(
    monkeypatch: pytest.MonkeyPatch, ending: Status
) -> None:
    watch = Stumbling(monkeypatch, ending)
    solution = solve_problem_on_mesh(regulator(), "3x4")
    assert watch.ways == ["cold", "adaptive"] and solution.status is Status.OPTIMAL
    assert solution.statistics.iterations == sum(watch.costs)


def test_an_infeasible_ending_is_met_by_the_constraints_first(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Stumbling(monkeypatch, *FAILED)
    solution = solve_problem_on_mesh(regulator(), "3x4")
    assert watch.ways[2:] == ["cold", "cold", "cold"], (
        "a simulation, the constraints alone, the cost from there"
    )
    assert solution.objective == pytest.approx(cost(), rel=1e-9)
    assert solution.statistics.iterations == sum(watch.costs)


@pytest.mark.parametrize("ending", [Status.ACCEPTABLE, Status.STEP_TOO_SMALL, Status.SEARCH_DIRECTION_FAILED])
def test_rounding_is_met_by_careful_pivoting_from_where_it_stopped(
    monkeypatch: pytest.MonkeyPatch, ending: Status
) -> None:
    watch = Stumbling(monkeypatch, ending)
    solution = solve_problem_on_mesh(regulator(), "3x4")
    assert watch.ways == ["cold", "careful"] and solution.status is Status.OPTIMAL
    assert watch.points[1].x0 == pytest.approx(watch.results[0].x)
    monkeypatch.undo()
    watch = Stumbling(monkeypatch, ending, Status.STEP_TOO_SMALL, Status.STEP_TOO_SMALL)
    assert solve_problem_on_mesh(regulator(), "3x4").status is ending, "no other one is better"


def hasty() -> go.Problem:
    """1 m from rest to rest with |a| <= 1 in the least time, 2 s, of at most 9 s."""
    model, _q, _v, _a = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("hasty", model, initial=0.0, final=(0.1, 9.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    return problem


def test_the_cost_is_lowered_from_where_the_constraints_are_met(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Stumbling(monkeypatch, *FAILED)
    solve_problem_on_mesh(regulator(), "3x4")
    first, _, _, second, third = watch.points
    assert second.p[-1] == 0.0 < first.p[-1] == third.p[-1]  # the scale of the cost
    assert second.x0 == pytest.approx(first.x0) and np.array_equal(second.lbx, first.lbx)
    assert third.x0 == pytest.approx(watch.results[3].x)
    assert np.max(np.abs(watch.results[3].x - watch.results[0].x)) > 1e-2


def test_where_constraints_are_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """With times free, held at multiples of the guess, each once (9 s is the most), and from random starts."""
    watch = Stumbling(monkeypatch, *[Status.INFEASIBLE] * 20)
    failed = solve_problem_on_mesh(hasty(), "3x4")
    assert failed.status is Status.INFEASIBLE and failed.statistics.iterations == sum(watch.costs)
    held = [set(np.flatnonzero(p.lbx == p.ubx)) - set(np.flatnonzero(watch.points[0].lbx == watch.points[0].ubx))
            for p in watch.points[3:]]  # fmt: skip
    assert [len(h) for h in held] == [0, 1, 1, 0, 0]
    (time,) = set().union(*held)
    scale = failed.phase().final_time / watch.results[0].x[time]
    guess = watch.points[0].x0[time] * scale
    stretched = [p.x0[time] * scale for p, h in zip(watch.points[3:], held, strict=True) if h]
    wanted = list(dict.fromkeys(min(f * guess, 9.0) for f in (1.0, 4.0, 16.0, 64.0)))
    assert stretched == pytest.approx(wanted) and all(p.p[-1] == 0 for p in watch.points[3:])
    last, other = watch.points[-2:]
    assert not np.allclose(last.x0, other.x0) and not np.allclose(last.x0, watch.points[3].x0)


@pytest.mark.parametrize(("ending", "tries"), [(Status.OPTIMAL, 3), (Status.STEP_TOO_SMALL, 5)])
def test_a_guess_that_leads_on_and_on_gives_way_to_a_simulation(
    monkeypatch: pytest.MonkeyPatch, ending: Status, tries: int
) -> None:
    """Here after two iterations, and two with the adaptive barrier; next come points that meet the constraints."""
    for limit in ("WARM_MAX_ITERATIONS", "TRY_MAX_ITERATIONS"):
        monkeypatch.setattr(sys.modules[solve_problem_on_mesh.__module__], limit, 2)
    watch = Stumbling(monkeypatch, None, None, ending, Status.OPTIMAL, Status.OPTIMAL)
    found = solve_problem_on_mesh(hasty().with_initial(v=1.0), "3x4")
    assert watch.results[0].status is Status.INTERRUPTED and watch.costs[:3] == [2, 2, 2]
    lines, again, flight, *last = watch.points
    assert again.x0 == pytest.approx(lines.x0) and watch.ways[:2] == ["cold", "adaptive"]
    assert np.max(np.abs(np.subtract(flight.x0, lines.x0))) > 0.1
    assert len(watch.points) == tries and [p.p[-1] == 0 for p in last] == [True, False][: tries - 3]
    assert found.status.solved and found.statistics.iterations == sum(watch.costs)


def test_the_guess_has_all_iterations_where_nothing_else_leads_on(monkeypatch: pytest.MonkeyPatch) -> None:
    for limit in ("WARM_MAX_ITERATIONS", "TRY_MAX_ITERATIONS"):
        monkeypatch.setattr(sys.modules[solve_problem_on_mesh.__module__], limit, 2)
    watch = Stumbling(monkeypatch)
    found = solve_problem_on_mesh(hasty(), "3x4")
    assert watch.points[-1].x0 == pytest.approx(watch.points[0].x0) and set(watch.costs[:-1]) <= {0, 1, 2}
    assert found.status is Status.OPTIMAL and found.statistics.iterations == sum(watch.costs)


def test_a_failure_on_the_way_leads_to_the_next_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """The constraints can be met, but not with the cost; the second start is met at once."""
    watch = Stumbling(monkeypatch, *FAILED, None, Status.INFEASIBLE)
    found = solve_problem_on_mesh(hasty(), "3x4")
    assert found.status.solved and found.objective == pytest.approx(2.0, rel=2e-2)
    assert [p.p[-1] == 0 for p in watch.points[3:]] == [True, False, True, False]
    assert found.statistics.iterations == sum(watch.costs)


def test_an_interrupt_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Stumbling(monkeypatch, Status.INFEASIBLE, Status.INFEASIBLE, Status.INTERRUPTED)
    assert solve_problem_on_mesh(hasty(), "3x4").status is Status.INFEASIBLE and len(watch.ways) == 3
    late = Stumbling(monkeypatch, Status.INFEASIBLE)
    solve_problem_on_mesh(hasty(), "3x4", budget=WorkBudget(deadline=time.perf_counter() - 1.0))
    assert len(late.ways) == 1


def test_constraints_that_are_not_met_from_one_point_say_nothing_of_the_problem(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All tries with the cost end at their limits: so does the solve."""
    tries = [Status.ITERATION_LIMIT] * 3 + [Status.INFEASIBLE] * 3 + [Status.ITERATION_LIMIT]
    monkeypatch.setattr(sys.modules[solve_problem_on_mesh.__module__], "WARM_MAX_ITERATIONS", 0)
    watch = Stumbling(monkeypatch, *tries)
    found = solve_problem_on_mesh(regulator(), "3x4")
    assert found.status is Status.ITERATION_LIMIT and len(watch.ways) > 4


def test_ctrl_c_ends_a_search_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[solve_problem_on_mesh.__module__], "WARM_MAX_ITERATIONS", 0)
    Stumbling(monkeypatch, *[Status.ITERATION_LIMIT] * 3, Status.INFEASIBLE, Status.INTERRUPTED)
    assert solve_problem_on_mesh(regulator(), "3x4").status is Status.INTERRUPTED


def test_a_given_trajectory_is_tried_with_both_barriers_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """What fails then is reported as the first failure."""
    problem = regulator().with_guess("leg", time=[0.0, 0.5, 1.0], x=[[1.0, 0.8, 0.7]])
    watch = Stumbling(monkeypatch, *[Status.STEP_TOO_SMALL] * 2, Status.RESTORATION_FAILED)
    found = solve_problem_on_mesh(problem, "3x4")
    assert watch.ways == ["cold", "careful", "adaptive"] and found.status is Status.STEP_TOO_SMALL


def test_a_limit_that_the_user_drew_closer_ends_all_tries(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Stumbling(monkeypatch, Status.ITERATION_LIMIT)
    brief = go.SolverOptions(max_iterations=199)
    assert solve_problem_on_mesh(regulator(), "3x4", options=brief).status is Status.ITERATION_LIMIT
    assert watch.ways == ["cold"]


def worth(objective: float, maximised: bool = False) -> Any:
    return SimpleNamespace(objective=objective, maximised=maximised)


def test_a_sharper_solution_is_the_same_one() -> None:
    """Blunt to 1e-3, then sharp to the rounding of its own mesh."""
    blunt = solve_problem_on_mesh(regulator(), "3x4", options=go.SolverOptions(tolerance=1e-3))
    sharp = solve_with_tighter_tolerance(blunt)
    assert sharp.phase().mesh == blunt.phase().mesh and sharp.status.solved
    assert "tolerance=1e-12" in sharp.provenance["options"]


def test_a_solution_that_cannot_be_sharpened_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    blunt = solve_problem_on_mesh(regulator(), "3x4")
    Stumbling(monkeypatch, *[Status.ITERATION_LIMIT] * 5)
    assert solve_with_tighter_tolerance(blunt) is blunt


def test_a_guess_of_other_phases_does_not_give_its_mesh() -> None:
    known = solve_problem_on_mesh(regulator(0.1), "3x4")
    assert solve_problem_on_mesh(regulator(), guess=known).phase().mesh == known.phase().mesh
    assert solve_problem_on_mesh(regulator(), "2x5", guess=known).phase().mesh == go.Mesh.uniform(2, 5)


@pytest.mark.parametrize(
    ("guess", "knows"),
    [
        ({}, False),
        ({"time": [0.0, 1.0], "x": [[1.0, 0.5]]}, False),
        ({"time": [0.0, 0.5, 1.0], "x": [[1.0, 0.5, 0.1]]}, True),
        ({"x": lambda t: 1 - t}, True),
    ],
)
def test_a_trajectory_is_more_than_its_ends(guess: Any, knows: bool) -> None:
    assert has_trajectory_guess(regulator().with_guess("leg", **guess) if guess else regulator()) is knows


def test_a_warm_start_that_loses_its_way_keeps_the_trajectory_only(monkeypatch: pytest.MonkeyPatch) -> None:
    known = solve_problem_on_mesh(regulator(0.1), "3x4")
    watch = Stumbling(monkeypatch, Status.ITERATION_LIMIT)
    solution = solve_problem_on_mesh(regulator(), "3x4", guess=known, budget=WorkBudget(warm_iterations=50))
    assert watch.ways == ["warm", "cold"]
    assert solution.objective == pytest.approx(cost(), rel=1e-9)
    assert solution.statistics.iterations == sum(watch.costs)
    assert solution.problem is not None and solution.problem.get_phase().numbers.guess.values == {}


def test_without_a_limit_a_warm_start_is_the_only_one(monkeypatch: pytest.MonkeyPatch) -> None:
    known = solve_problem_on_mesh(regulator(0.1), "3x4")
    watch = Stumbling(monkeypatch, Status.ITERATION_LIMIT)
    assert solve_problem_on_mesh(regulator(), "3x4", guess=known).status is Status.ITERATION_LIMIT
    assert watch.ways == ["warm"]


def test_all_tries_share_one_limit_of_wall_time(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Stumbling(monkeypatch, *FAILED, Status.ACCEPTABLE)
    begin = time.perf_counter()
    solve_problem_on_mesh(regulator(), "3x4", options=go.SolverOptions(max_wall_time=60.0))
    assert all(deadline is not None and deadline >= begin + 60.0 for deadline in watch.deadlines)
    assert len(watch.deadlines) > 3 and len(set(watch.deadlines)) == 1


def test_the_trajectory_alone_has_what_the_warm_start_left_of_the_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known = solve_problem_on_mesh(regulator(0.1), "3x4")
    original, left = NlpSolver.solve, []  # type: ignore[var-annotated]

    def slow_and_lost(solver: NlpSolver, point: NlpPoint, way: str | None = None, **more: Any) -> NlpResult:
        left.append(more["deadline"] - time.perf_counter())
        result = original(solver, point, way, **more)  # type: ignore[arg-type]
        lost = point.warm_or_cold_start == "warm"
        return replace(result, status=Status.ITERATION_LIMIT, wall_time=500.0) if lost else result

    monkeypatch.setattr(NlpSolver, "solve", slow_and_lost)
    limit = go.SolverOptions(max_wall_time=600.0)
    assert solve_problem_on_mesh(
        regulator(), "3x4", guess=known, options=limit, budget=WorkBudget(warm_iterations=50)
    ).status.solved
    assert left[0] > 500.0 > 100.0 >= left[1]


def test_nothing_is_shown_unless_it_is_asked_for(capfd: pytest.CaptureFixture[str]) -> None:
    solve_problem_on_mesh(regulator(), "3x4")
    assert capfd.readouterr() == ("", "")


# --- fine meshes from coarse ones -----------------------------------------------------------------------
