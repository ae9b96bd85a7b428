"""refine as a whole: what converged means, what is kept, and how it ends when it is stopped."""

from __future__ import annotations

import importlib
import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import Condition, History, RefinementStatus, Verdict
from gnc_opt.planning.refinement import best_solution_selection
from gnc_opt.planning.refinement.best_solution_selection import (
    Candidate,
    _describe_lower_cost_on_coarse_mesh,
    select_best_candidate,
)
from problems.classics import van_der_pol


def rest_to_rest() -> go.Problem:
    """Over 3 m with accelerations between -2 and 1 m/s^2: one switch, t = 3 s."""
    model, *_ = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("rest to rest", model, initial=0.0, final=(0.1, 20.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=3.0, v=0.0)
    leg.bounds(a=(-2.0, 1.0))
    problem.minimize(leg.final_time)
    return problem


def swing() -> go.Problem:
    """Smooth and nonlinear: x' = u - x^3 from 1.5 to 1 with least effort."""
    model, x, u = dynamics("cubic", "x", "u", lambda x, u: {x: u - x**3})
    problem, leg = one_phase("cubic", model, initial=0.0, final=8.0)
    leg.initial(x=1.5)
    leg.final(x=1.0)
    problem.minimize(leg.integral((x**2 + u**2) / 2))
    return problem


@pytest.fixture(scope="module")
def cart() -> go.Solution:
    return go.solve(rest_to_rest(), mesh="7x3", tol=None)


@pytest.fixture(scope="module")
def cubic() -> go.Solution:
    return go.solve(swing(), mesh="4x4", tol=None)


def told(solution: go.Solution) -> History:
    assert solution.history is not None
    return solution.history


def counted(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return a list that grows by an entry whenever a verdict is computed."""
    module = importlib.import_module("gnc_opt.planning.verification.optimality_check")
    real, calls = module._check_optimality_conditions, []

    def judge(solution: go.Solution, tol: float) -> Verdict:
        calls.append(tol)
        verdict: Verdict = real(solution, tol)
        return verdict

    monkeypatch.setattr(module, "_check_optimality_conditions", judge)
    return calls


def test_converged_means_that_error_and_verdict_pass(cart: go.Solution) -> None:
    refined = go.refine(cart, tol=1e-7)
    history = told(refined)
    assert refined.converged and go.verify(refined).ok
    assert history.tolerance == 1e-7 and history.final_iteration.error <= 1e-7
    assert refined.objective == pytest.approx(3.0, abs=1e-9)
    text = str(refined)
    assert "refined (converged)" in text and "tolerance 1e-07" in text and "strict local optimum" in text
    assert f"{history.final_iteration.error:.1e}" in text and len(text.splitlines()) == 7


def test_a_verdict_that_fails_is_no_convergence(tmp_path: Path) -> None:
    """A cost that rewards switching: the ending and what is printed name the condition and its place."""
    model, x, u = dynamics("point", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("switching", model, initial=0.0, final=1.0)
    leg.initial(x=0.1)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(x**2 - u**2))
    refined = go.solve(problem, mesh="5x3", structure="none")
    history = told(refined)
    assert history.status is RefinementStatus.CONDITIONS_FAIL and not refined.converged
    assert history.final_iteration.error <= history.tolerance
    assert re.search(r"minimum principle \S+ \(tolerance 1e-05\) at phase leg, t = \S+ s", history.message)
    text = str(refined)
    assert "NOT CONVERGED (conditions fail)" in text and "(optimal)" not in text
    assert "optimality   NOT ok: " in text and "fails        minimum principle" in text
    loaded = str(go.load(refined.save(tmp_path / "failed.npz")))
    assert "NOT CONVERGED (conditions fail)" in loaded and "FAILED at the end of the refinement" in loaded


def test_a_structure_that_stands_but_is_not_accurate_is_no_convergence(
    cart: go.Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The verdict is ok, but the error is above what was asked for: the message gives both."""
    module = importlib.import_module("gnc_opt.planning.refinement.staged_refinement")
    real: Callable[..., Any] = module.optimise_switching_times
    given: dict[str, Any] = {}

    def coarse(*args: Any, **more: Any) -> Any:
        solution, history = real(*args, **more)
        passes = tuple(replace(p, error=3e-8) for p in history.passes)
        return solution, replace(history, passes=passes, **given)

    monkeypatch.setattr(module, "optimise_switching_times", coarse)
    refined = go.refine(cart, tol=1e-8)
    assert told(refined).status is RefinementStatus.STALLED and go.verify(refined).ok
    assert "error 3.0e-08 (tolerance 1.0e-08)" in told(refined).message
    assert go.refine(cart, tol=1e-7).converged
    given["status"] = RefinementStatus.STALLED
    found = told(go.refine(cart, tol=1e-8, structure="bang-bang"))
    assert found.passes[-1].objective == cart.objective and found.chosen == 0


@pytest.mark.slow
def test_a_refinement_that_does_not_reach_its_tolerance_says_so(cubic: go.Solution) -> None:
    refined = go.refine(cubic, tol=1e-12, structure="none", limits=go.RefinementLimits(max_passes=1))
    assert told(refined).status is RefinementStatus.ITERATION_LIMIT
    assert "NOT CONVERGED (iteration limit)" in str(refined)


def test_the_history_goes_to_files_and_back(cart: go.Solution, tmp_path: Path) -> None:
    refined = go.refine(cart)
    again = go.load(refined.save(tmp_path / "refined.npz"))
    assert again.history == refined.history and again.converged
    assert "passed at the end of the refinement" in str(again)
    assert go.load(cart.save(tmp_path / "first.npz")).history is None


def test_the_verdict_is_computed_once(cart: go.Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = counted(monkeypatch)
    refined = go.refine(cart)
    assert len(calls) == 1
    assert go.verify(refined).ok and go.verify(refined) is go.verify(refined)
    assert len(calls) == 1
    go.verify(refined, tol=1e-6)
    assert calls == [1e-5, 1e-6]


def test_a_kept_verdict_is_that_of_the_same_numbers(cart: go.Solution) -> None:
    """A copy with other fields or another problem is checked again; numbers cannot be changed in place."""
    refined = go.refine(cart)
    verdict = go.verify(refined)
    assert go.verify(replace(refined, objective=refined.objective + 1.0)) is not verdict
    other = replace(refined, problem=rest_to_rest().with_bounds(a=(-2.0, 0.5)).frozen())
    assert verdict.ok and not go.verify(other).ok
    with pytest.raises(ValueError, match="read-only"):
        refined.phase().x.values[0] += 0.1


def interrupt_after(count: int, monkeypatch: pytest.MonkeyPatch, module: str, name: str) -> None:
    """Press Ctrl-C when a function is called for the last of so many times."""
    place = importlib.import_module(module)
    real, calls = getattr(place, name), []

    def pressed(*args: Any, **more: Any) -> Any:
        calls.append(name)
        if len(calls) == count:
            raise KeyboardInterrupt
        return real(*args, **more)

    monkeypatch.setattr(place, name, pressed)


@pytest.mark.parametrize(
    ("module", "name", "count"),
    [
        ("gnc_opt.planning.refinement.hp_refinement", "solve_problem_on_mesh", 2),
        ("gnc_opt.planning.refinement.hp_refinement", "estimate_segment_errors", 2),
        ("gnc_opt.planning.refinement.staged_refinement", "detect_arc_structures", 1),
        ("gnc_opt.planning.refinement.best_solution_selection", "verify", 1),
    ],
)
def test_ctrl_c_keeps_the_best_solution_wherever_it_comes(
    cubic: go.Solution, monkeypatch: pytest.MonkeyPatch, module: str, name: str, count: int
) -> None:
    interrupt_after(count, monkeypatch, module, name)
    stopped = go.refine(cubic, tol=1e-9)
    history = told(stopped)
    assert history.status is RefinementStatus.INTERRUPTED and not stopped.converged
    assert history.final_iteration.error == min(p.error for p in history.passes)
    assert stopped.status.solved and "NOT CONVERGED (interrupted)" in str(stopped)


@pytest.mark.parametrize("count", [1, 2])
def test_ctrl_c_in_the_structure_loop_ends_it_all(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """No mesh is refined afterwards, and what is returned is no worse than what was given."""
    start = go.solve(van_der_pol.build(), tol=None)  # three passes
    interrupt_after(
        count, monkeypatch, "gnc_opt.planning.refinement.arcs.switching_time_optimization", "record_iteration"
    )
    module = importlib.import_module("gnc_opt.planning.refinement.staged_refinement")
    monkeypatch.setattr(module, "refine_mesh", lambda *_, **__: pytest.fail("went on"))
    history = told(go.refine(start, tol=1e-9))
    assert history.status is RefinementStatus.INTERRUPTED
    assert history.final_iteration.error == min(p.error for p in history.passes)


def test_no_time_left_returns_what_was_given(cubic: go.Solution) -> None:
    stopped = go.refine(cubic, tol=1e-9, limits=go.RefinementLimits(max_wall_time=1e-9))
    assert told(stopped).status is RefinementStatus.INTERRUPTED
    assert stopped.objective == cubic.objective and stopped.phase() is cubic.phase()
    with pytest.raises(go.GncOptError, match="max_wall_time of RefinementLimits"):
        go.RefinementLimits(max_wall_time=-1.0)


def test_the_limit_of_solve_covers_refining(monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module("gnc_opt.planning.optimal_control_solver")
    ends: list[float] = []

    def refined(stages: Any, _: str) -> go.Solution:
        ends.append(stages.budget.deadline)
        first: go.Solution = stages.first
        return first

    monkeypatch.setattr(module.StagedRefinement, "run_stages", refined)
    begin = time.perf_counter()
    go.solve(swing(), mesh="4x4", tol=1e-8, options=go.SolverOptions(max_wall_time=100.0))
    assert begin < ends[0] - 100.0 < begin + 1.0


def test_work_that_is_spent_ends_it_and_is_reported(cart: go.Solution) -> None:
    refined = go.refine(cart, structure="none", limits=go.RefinementLimits(max_work=1e-9))
    history = told(refined)
    assert history.status is RefinementStatus.BUDGET_LIMIT and len(history.passes) == 2
    assert "NOT CONVERGED (budget limit)" in str(refined) and "max_work" in history.message
    with pytest.raises(go.GncOptError, match="max_work of RefinementLimits"):
        go.RefinementLimits(max_work=0.0)


@pytest.mark.parametrize("structure", ["bang-bang", "none"])
def test_progress_shows_the_tolerance_that_was_asked_for(
    cart: go.Solution, structure: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    go.refine(cart, tol=1e-4, structure=structure, progress=True)
    assert "refining to 1.0e-04" in capsys.readouterr().err


@pytest.mark.slow
def test_an_arc_that_chatters_is_reported() -> None:
    """An aircraft turns with a limited bank rate: straight flight is singular of second order, phi and psi held by u.

    One pass of each kind is not enough for it, nor would any number be.
    """
    aircraft = go.Model("aircraft")
    r, heading, bank = aircraft.state("r", 2), aircraft.state("heading"), aircraft.state("bank")
    rate = aircraft.control("rate")
    turn = 9.81 / 20.0 * ca.tan(bank)
    aircraft.ode({r: 20.0 * ca.vertcat(ca.cos(heading), ca.sin(heading)), heading: turn, bank: rate})
    problem, leg = one_phase("turn", aircraft, initial=0.0, final=(3.0, 120.0), name="turn")
    leg.initial(r=[0.0, 0.0], heading=0.0, bank=0.0)
    leg.final(r=[-200.0, 300.0], heading=np.pi, bank=0.0)
    leg.bounds(rate=(-0.5, 0.5), bank=(-0.7, 0.7))
    problem.minimize(leg.final_time)
    coarse = go.solve(problem, mesh="6x4", tol=None)
    told = go.refine(coarse, tol=1e-6, limits=go.RefinementLimits(max_passes=1)).history
    assert not told.converged and "adaptive barrier" in {p.stage for p in told.passes}
    assert re.search(r"A singular arc, from phase turn, t = \S+ s, rate, .* only by chattering", told.message)


def condition(value: float, *, sufficient: bool = False) -> Condition:
    return Condition("c", go.ConditionResult.FAIL, value, 1e-5, "", "", sufficient=sufficient)


def candidate(
    cost: float,
    estimate: float,
    passes: bool = False,
    loss: float = 0.0,
    error: float = 0.0,
    suboptimal: float = 0.0,
) -> Any:
    """An answer with a cost, its estimated and local errors, and whether it passes the optimality check."""
    made = SimpleNamespace(
        is_solved=True,
        minimised_cost=cost,
        is_verdict_ok=passes,
        integrated_hamiltonian_excess=loss,
        largest_local_error=error,
        stage="60",
    )
    made.solution = SimpleNamespace(
        objective=cost,
        objective_error=SimpleNamespace(
            absolute_error=estimate, scale=cost, suboptimality=suboptimal, infeasibility=estimate - suboptimal
        ),
    )
    made.objective_error = Candidate.objective_error.fget(made)  # type: ignore[attr-defined]
    made.get_errors_for_solution_ranking = lambda tol: Candidate.get_errors_for_solution_ranking(made, tol)
    made.has_lower_cost = lambda other, **margin: Candidate.has_lower_cost(made, other, **margin)
    return made


@pytest.mark.parametrize(
    ("excess", "scale", "loss"), [(np.nan, 2.0, np.nan), (0.0, 2e9, np.nan), (0.5, 2e9, 0.5), (0.0, 2.0, 0.0)]
)
def test_the_loss_is_unknown_if_h_is_not_finite_or_its_decrease_is_not_resolved(
    monkeypatch: pytest.MonkeyPatch, excess: float, scale: float, loss: float
) -> None:
    monkeypatch.setattr(best_solution_selection, "integrate_hamiltonian_excess", lambda solution: excess)
    solution: Any = SimpleNamespace(objective=-2.0, objective_error=SimpleNamespace(scale=scale))
    history: Any = None
    np.testing.assert_equal(Candidate(solution, history, "60").integrated_hamiltonian_excess, loss)


@pytest.mark.parametrize(
    ("found", "kept"),
    [
        ([candidate(2.0, 1e-2), candidate(2.001, 1e-4)], 1),  # the one with the least estimate
        ([candidate(2.0, 90.0, suboptimal=90.0), candidate(2.0, 1.0)], 0),  # the loss is zero, not 90
        ([candidate(2.0, 1e-6), candidate(2.0, 1e-4, passes=True)], 1),  # one that passes the check
        ([candidate(2.0, 1e-4, passes=True), candidate(2.0, 1e-6, passes=True)], 1),
        ([candidate(2.0, 1e-6, passes=True), candidate(1.9, 1e-3)], 1),  # another minimum
        ([candidate(2.0, 1e-6, passes=True), candidate(1.9, 1e-1)], 0),  # a coarse one that is lower by less
        (
            [candidate(2.0, 1e-6, passes=True), candidate(1.9999, 1e-6)],
            0,
        ),  # by less than an unknown error may be
        ([candidate(2.0, 1e-6), candidate(1.9, 1e-6, loss=1.0)], 0),  # a false extremal, by its loss
        ([candidate(8.6, 1e-2), candidate(1.0, 1e-9, error=3.2)], 0),  # no trajectory between its points
        ([candidate(11.0, 1e-5, error=1e-7), candidate(10.4, 0.04, error=0.04)], 0),  # nor is this one
        (
            [candidate(2.0, 1e-9), candidate(1.99999, 1e-9, error=9e-6)],
            0,
        ),  # lower by less than the local errors
        ([candidate(2.0, 90.0, loss=np.nan, suboptimal=90.0), candidate(2.0, 1.0)], 1),  # an unknown loss
        (
            [candidate(2.0, 1e-13, error=1e-5), candidate(2.0, 1e-9, error=1e-7)],
            1,
        ),  # both within the tolerance
    ],
)
def test_the_best_candidate_is_kept(found: list[Any], kept: int) -> None:
    assert select_best_candidate(found, tol=1e-8) == kept


@pytest.mark.parametrize(
    ("estimate", "hint"),
    [
        (0.05, {"also seen": "objective 1.9 on a coarse mesh (stage 60): try multistart"}),
        (0.15, {}),  # the difference may be an error of the coarse mesh
    ],
)
def test_a_lower_coarse_solve_is_reported(estimate: float, hint: dict[str, str]) -> None:
    found = [candidate(1.9, estimate), candidate(2.0, 1e-6, passes=True)]
    assert select_best_candidate(found, tol=1e-8) == 1
    assert _describe_lower_cost_on_coarse_mesh(found, found[1]) == hint


def test_without_a_check_the_answer_is_within_the_tolerance_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Least time of the cart: 3 s. No condition is looked at until `verify` is asked."""
    calls = counted(monkeypatch)
    fast = go.solve(rest_to_rest(), tol=1e-6, check=False)
    assert told(fast).status is RefinementStatus.UNCHECKED and not calls
    assert fast.objective == pytest.approx(3.0, rel=1e-6) and fast.objective_error.relative_error <= 1e-6
    assert "switched off" in told(fast).message and fast.provenance["stage"] in {
        p.stage for p in told(fast).passes
    }
    assert go.verify(fast).ok and len(calls) == 1


def test_without_a_check_an_extremal_of_another_well_of_the_hamiltonian_is_left() -> None:
    """x' = u with (u^2 - 1)^2 + 0.1 u over 1 s: every solve from u = 1 ends in the higher well."""
    model, _x, u = dynamics("drift", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("wells", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-2.0, 2.0))
    problem.minimize(leg.integral((u**2 - 1) ** 2 + 0.1 * u))
    lowest = min(np.roots([4.0, 0.0, -4.0, 0.1]).real)
    found = go.solve(problem.with_guess(u=1.0), check=False).objective
    assert found == pytest.approx((lowest**2 - 1) ** 2 + 0.1 * lowest, rel=1e-6)


def two_wells(start: float, sign: float = 1.0) -> go.Problem:
    """min (e^2 - 1)^2 + 0.3 e + 0.01 int u^2 for x' = u, x(0) = 0, x(1) = e: a minimum on either side."""
    model, _x, u = dynamics("drift", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("two wells", model, initial=0.0, final=1.0)
    leg.initial(x=0.0)
    leg.guess(x=(0.0, start), u=start)
    end = leg.final_state("x")
    cost = (end**2 - 1) ** 2 + 0.3 * end + 0.01 * leg.integral(u**2)
    (problem.minimize if sign > 0 else problem.maximize)(sign * cost)
    return problem


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_better_coarse_solve_is_known_by_its_estimates(sign: float) -> None:
    """u = e is constant and e a root of 4 e^3 - 4 e + 0.02 e + 0.3 = 0: meshes are exact."""
    found = {}
    for side in (1.0, -1.0):
        solution = go.solve(two_wells(side, sign), mesh="3x3", tol=None)
        roots = np.roots([4.0, 0.0, 0.02 - 4.0, 0.3]).real
        e = roots[np.argmin(np.abs(roots - side))]
        assert sign * solution.objective == pytest.approx((e**2 - 1) ** 2 + 0.3 * e + 0.01 * e**2, rel=1e-8)
        found[side] = Candidate.from_solve(solution, 1e-6, time.perf_counter(), "first")
    assert found[-1.0].has_lower_cost(found[1.0]) and not found[1.0].has_lower_cost(found[-1.0])
