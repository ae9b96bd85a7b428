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

import gnc_opt as go
from gnc_opt.planning import Condition, History, RefinementStatus, Verdict
from gnc_opt.planning.refinement.attempt import RefinementAttempt, _least_wrong
from gnc_opt.planning.refinement.iterations import PassLimits
from gnc_opt.planning.refinement.mesh.refinement import refine_mesh
from problems.classics import van_der_pol


def rest_to_rest() -> go.Problem:
    """Over 3 m with accelerations between -2 and 1 m/s^2: one switch, t = 3 s."""
    model = go.Model("cart")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    problem = go.Problem("rest to rest")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=(0.1, 20.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=3.0, v=0.0)
    leg.bounds(a=(-2.0, 1.0))
    problem.minimize(leg.final_time)
    return problem


def swing() -> go.Problem:
    """Smooth and nonlinear: x' = u - x^3 from 1.5 to 1 with least effort."""
    model = go.Model("cubic")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u - x**3})
    problem = go.Problem("cubic")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=8.0)
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
    import importlib

    module = importlib.import_module("gnc_opt.planning.verification.engine")
    real, calls = module._judge, []

    def judge(solution: go.Solution, tol: float) -> Verdict:
        calls.append(tol)
        verdict: Verdict = real(solution, tol)
        return verdict

    monkeypatch.setattr(module, "_judge", judge)
    return calls


# --- one meaning of converged ---------------------------------------------------------------------------------


def test_converged_means_that_error_and_verdict_pass(cart: go.Solution) -> None:
    refined = go.refine(cart, tol=1e-7)
    history = told(refined)
    assert refined.converged and go.verify(refined).ok
    assert history.tolerance == 1e-7 and history.final.error <= 1e-7
    assert refined.objective == pytest.approx(3.0, abs=1e-9)
    text = str(refined)
    assert "refined (converged)" in text and "(wanted 1.0e-07)" in text and "strict local minimum" in text
    assert f"{history.final.error:.1e}" in text and len(text.splitlines()) == 6


@pytest.mark.parametrize("structure", ["auto", "bang-bang", "none"])
def test_a_verdict_that_fails_is_no_convergence(
    cart: go.Solution, monkeypatch: pytest.MonkeyPatch, structure: Any, tmp_path: Path
) -> None:
    """Whichever way it went, the ending and what is printed name the condition and its place."""
    import importlib

    module = importlib.import_module("gnc_opt.planning.verification.engine")
    real = module._judge

    def judge(solution: go.Solution, tol: float) -> Verdict:
        open_one = Condition("stationarity", go.Result.FAIL, 2e-4, tol, "phase leg, t = 1 s, a", "It is not.")
        verdict: Verdict = real(solution, tol)
        return replace(verdict, conditions=(open_one, *verdict.conditions))

    monkeypatch.setattr(module, "_judge", judge)
    refined = go.refine(cart, tol=1e-5, structure=structure)
    history = told(refined)
    assert history.status is RefinementStatus.VERDICT_FAILS and not refined.converged
    assert history.final.error <= 1e-5
    assert "stationarity 2.0e-04 (tolerance 1e-05) at phase leg, t = 1 s, a" in history.message
    text = str(refined)
    assert "NOT CONVERGED (verdict fails)" in text and "optimal" not in text
    assert (
        "verdict      NOT ok" in text
        and "open         stationarity 2.0e-04" in text
        and "(wanted 1.0e-05)" in text
    )
    loaded = str(go.load(refined.save(tmp_path / "failed.npz")))
    assert "NOT CONVERGED (verdict fails)" in loaded and "NOT ok when it was refined" in loaded


def test_a_structure_that_stands_but_is_not_accurate_is_no_convergence(
    cart: go.Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The verdict is ok, but the error is above what was asked for: the message gives both."""
    import importlib

    module = importlib.import_module("gnc_opt.planning.refinement.engine")
    real: Callable[..., Any] = module.optimise_switches

    def coarse(*args: Any, **more: Any) -> Any:
        solution, history = real(*args, **more)
        return solution, replace(history, passes=tuple(replace(p, error=3e-8) for p in history.passes))

    monkeypatch.setattr(module, "optimise_switches", coarse)
    refined = go.refine(cart, tol=1e-8)
    assert told(refined).status is RefinementStatus.STALLED and go.verify(refined).ok
    assert "error 3.0e-08 (wanted 1.0e-08)" in told(refined).message
    assert go.refine(cart, tol=1e-7).converged


def test_a_refinement_that_does_not_reach_its_tolerance_says_so(cubic: go.Solution) -> None:
    refined = go.refine(cubic, tol=1e-12, limits=go.RefinementLimits(max_passes=1))
    assert told(refined).status is RefinementStatus.PASS_LIMIT
    assert "NOT CONVERGED (pass limit)" in str(refined) and "(wanted 1.0e-12)" in str(refined)


def test_the_history_goes_to_files_and_back(cart: go.Solution, tmp_path: Path) -> None:
    refined = go.refine(cart)
    again = go.load(refined.save(tmp_path / "refined.npz"))
    assert again.history == refined.history and again.converged
    assert "ok when it was refined" in str(again)
    assert go.load(cart.save(tmp_path / "first.npz")).history is None


# --- one verdict ----------------------------------------------------------------------------------------------


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


# --- stopping -------------------------------------------------------------------------------------------------


def interrupt_after(count: int, monkeypatch: pytest.MonkeyPatch, module: str, name: str) -> None:
    """Press Ctrl-C when a function is called for the last of so many times."""
    import importlib

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
        ("gnc_opt.planning.refinement.mesh.refinement", "solve_mesh", 2),
        ("gnc_opt.planning.refinement.mesh.refinement", "estimate_errors", 2),
        ("gnc_opt.planning.refinement.engine", "structures_of", 1),
        ("gnc_opt.planning.refinement.attempt", "verify", 1),
    ],
)
def test_ctrl_c_keeps_the_best_solution_wherever_it_comes(
    cubic: go.Solution, monkeypatch: pytest.MonkeyPatch, module: str, name: str, count: int
) -> None:
    interrupt_after(count, monkeypatch, module, name)
    stopped = go.refine(cubic, tol=1e-9)
    history = told(stopped)
    assert history.status is RefinementStatus.INTERRUPTED and not stopped.converged
    assert history.final.error == min(p.error for p in history.passes)
    assert stopped.status.solved and "NOT CONVERGED (interrupted)" in str(stopped)


@pytest.mark.parametrize("count", [1, 2])
def test_ctrl_c_in_the_structure_loop_ends_it_all(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """No mesh is refined afterwards, and what is returned is no worse than what was given."""
    start = go.solve(van_der_pol.build(), tol=None)  # three passes
    interrupt_after(count, monkeypatch, "gnc_opt.planning.refinement.arcs.loop", "estimate_errors")
    import importlib

    module = importlib.import_module("gnc_opt.planning.refinement.engine")
    monkeypatch.setattr(module, "refine_mesh", lambda *_, **__: pytest.fail("went on"))
    history = told(go.refine(start, tol=1e-9))
    assert history.status is RefinementStatus.INTERRUPTED
    assert history.final.error == min(p.error for p in history.passes)


def test_no_time_left_returns_what_was_given(cubic: go.Solution) -> None:
    stopped = go.refine(cubic, tol=1e-9, limits=go.RefinementLimits(max_wall_time=1e-9))
    assert told(stopped).status is RefinementStatus.INTERRUPTED
    assert stopped.objective == cubic.objective and stopped.phase() is cubic.phase()
    with pytest.raises(go.GncOptError, match="max_wall_time of RefinementLimits"):
        go.RefinementLimits(max_wall_time=-1.0)


def test_the_limit_of_solve_covers_refining(monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib

    module = importlib.import_module("gnc_opt.planning.solver")
    given: list[float] = []

    def refine(solution: go.Solution, *, limits: go.RefinementLimits, **_: Any) -> go.Solution:
        assert limits.max_wall_time is not None
        given.append(limits.max_wall_time)
        return go.refine(solution, limits=limits)

    monkeypatch.setattr(module, "refine", refine)
    begin = time.perf_counter()
    go.solve(swing(), mesh="4x4", tol=1e-8, options=go.SolverOptions(max_wall_time=100.0))
    assert 100.0 - (time.perf_counter() - begin) <= given[0] < 100.0


def test_seconds_add_up(cart: go.Solution) -> None:
    """Those of all passes and of what lies between them, and no more than have gone by."""
    begin = time.perf_counter()
    history = told(go.refine(cart, structure="none", tol=1e-6))
    gone = time.perf_counter() - begin
    assert sum(p.seconds for p in history.passes) <= history.seconds <= gone
    assert history.seconds > 0.5 * gone


def test_attempts_that_were_given_up_are_told(cart: go.Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    """A structure that does not convince leaves its passes in the record, before those of the mesh."""
    import importlib

    module = importlib.import_module("gnc_opt.planning.refinement.engine")
    real: Callable[..., Any] = module.optimise_switches

    def unconvincing(*args: Any, **more: Any) -> Any:
        solution, history = real(*args, **more)
        passes = (*history.passes[:-1], replace(history.passes[-1], error=1e-4))
        return solution, replace(history, status=RefinementStatus.STALLED, passes=passes)

    monkeypatch.setattr(module, "optimise_switches", unconvincing)
    history = told(go.refine(cart, tol=1e-5))
    kinds = [isinstance(p.actions, str) for p in history.passes]
    assert kinds[0] and not kinds[history.chosen]
    assert history.final.error <= 1e-5


def test_a_structure_without_any_solution_is_not_what_is_kept(
    cart: go.Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It hands back what it was given, with no structure: the mesh that was refined is better."""
    import importlib

    module = importlib.import_module("gnc_opt.planning.refinement.engine")
    real: Callable[..., Any] = module.optimise_switches

    def hopeless(start: go.Solution, **more: Any) -> Any:
        _, history = real(start, **more)
        record = replace(history.passes[0], solved=False, error=1e3)
        return start, replace(history, status=RefinementStatus.FAILED, passes=(record,), chosen=0)

    monkeypatch.setattr(module, "optimise_switches", hopeless)
    monkeypatch.setattr(RefinementAttempt, "final", False)
    history = told(go.refine(cart, tol=1e-5))
    assert history.final.solved and history.final.error <= 1e-5 and history.chosen > 0


def test_work_that_is_spent_ends_it_and_is_told(cart: go.Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib

    module = importlib.import_module("gnc_opt.planning.refinement.engine")
    monkeypatch.setattr(module, "LEAST_WORK", 1.0)
    refined = go.refine(cart, structure="none", limits=go.RefinementLimits(max_work=1e-9))
    history = told(refined)
    assert history.status is RefinementStatus.WORK_LIMIT and len(history.passes) == 2
    assert "NOT CONVERGED (work limit)" in str(refined) and "max_work" in history.message
    with pytest.raises(go.GncOptError, match="max_work of RefinementLimits"):
        go.RefinementLimits(max_work=0.0)


def test_the_same_arcs_are_not_tried_twice(cart: go.Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    """A structure that had a solution and did not convince is not begun again after the mesh."""
    import importlib

    module = importlib.import_module("gnc_opt.planning.refinement.engine")
    real, begun = module.optimise_switches, []

    def unconvincing(*args: Any, structures: Any, **more: Any) -> Any:
        begun.append([structure.at(()) for structure in structures.values()])
        solution, history = real(*args, structures=structures, **more)
        return solution, replace(history, status=RefinementStatus.STALLED)

    monkeypatch.setattr(module, "optimise_switches", unconvincing)
    monkeypatch.setattr(RefinementAttempt, "final", False)
    go.refine(cart, tol=1e-5)
    assert begun and all(begun.count(order) == 1 for order in begun)


@pytest.mark.parametrize("structure", ["bang-bang", "none"])
def test_progress_shows_the_tolerance_that_was_asked_for(
    cart: go.Solution, structure: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    go.refine(cart, tol=1e-4, structure=structure, progress=True)
    assert "refining to 1.0e-04" in capsys.readouterr().err


def test_an_attempt_without_a_solution_convinces_nobody(cart: go.Solution) -> None:
    """What it returns is what it began with, which may pass the verdict; what it tells is that it failed."""
    good = replace(go.refine(cart, tol=1e-6), structure=())
    assert RefinementAttempt(good, told(good)).final
    fruitless = replace(told(good), passes=(replace(told(good).final, solved=False),), chosen=0)
    assert not RefinementAttempt(good, fruitless).final


def test_an_arc_that_chatters_is_told() -> None:
    """An aircraft turns with a limited bank rate: straight flight is singular of second order, phi and psi held by u.

    One pass of each kind is not enough for it, nor would any number be.
    """
    aircraft = go.Model("aircraft")
    r, heading, bank = aircraft.state("r", 2), aircraft.state("heading"), aircraft.state("bank")
    rate = aircraft.control("rate")
    turn = 9.81 / 20.0 * ca.tan(bank)
    aircraft.ode({r: 20.0 * ca.vertcat(ca.cos(heading), ca.sin(heading)), heading: turn, bank: rate})
    problem = go.Problem("turn")
    leg = problem.phase("turn", aircraft)
    leg.time(initial=0.0, final=(3.0, 120.0))
    leg.initial(r=[0.0, 0.0], heading=0.0, bank=0.0)
    leg.final(r=[-200.0, 300.0], heading=np.pi, bank=0.0)
    leg.bounds(rate=(-0.5, 0.5), bank=(-0.7, 0.7))
    problem.minimize(leg.final_time)
    coarse = go.solve(problem, tol=None)
    told = go.refine(coarse, tol=1e-6, limits=go.RefinementLimits(max_passes=1)).history
    assert not told.converged
    assert re.search(r"A singular arc, from phase turn, t = \S+ s, rate, .* chattering only", told.message)


# --- what is worth another attempt ------------------------------------------------------------------------------


def condition(value: float, *, sufficient: bool = False) -> Condition:
    return Condition("c", go.Result.FAIL, value, 1e-5, "", "", sufficient=sufficient)


@pytest.mark.parametrize(
    ("values", "second_order", "in_steps", "resolvable"),
    [
        ((), (), False, False),
        ((), (1.0,), False, False),
        ((), (1.0,), True, False),
        ((9e-4,), (1.0,), False, True),
        ((2e-5, 9e-4), (), False, True),
        ((2e-5, 1.1e-3), (), False, False),
        ((2e-5, 1.1e-3), (), True, True),
    ],
)
def test_a_finer_mesh_mends_what_is_nearly_met(
    values: Any, second_order: Any, in_steps: bool, resolvable: bool
) -> None:
    opened = [condition(v) for v in values] + [condition(v, sufficient=True) for v in second_order]
    attempt = SimpleNamespace(verdict=SimpleNamespace(open=tuple(opened)), in_steps=in_steps)
    assert RefinementAttempt.resolvable.fget(attempt) is resolvable


def attempt(error: float, *values: float, arcs: bool = False) -> Any:
    """One that ended with an error and offences against the verdict, on a mesh or with a structure."""
    opened = tuple(condition(v) for v in values)
    made = SimpleNamespace(
        solution=SimpleNamespace(structure=("an arc",) if arcs else ()),
        history=SimpleNamespace(final=SimpleNamespace(solved=True)),
        error=error,
        begun={} if arcs else None,
        verdict=SimpleNamespace(open=opened),
    )
    made.offence = RefinementAttempt.offence.fget(made)
    return made


@pytest.mark.parametrize(
    ("mesh", "structure", "kept"),
    [
        (attempt(4e-4, 0.46, 1e-3), attempt(3e-7, 2.8e-5, arcs=True), 0),  # more accurate, and nearly right
        (attempt(4e-7, 0.46), attempt(3e-7, 2.8e-5, arcs=True), 1),  # a mesh within the tolerance
        (attempt(4e-4, 0.46), attempt(3e-5, 2.8e-5, arcs=True), 1),  # no structure within it
        (attempt(4e-4, 0.46), attempt(3e-7, 0.9, 1e-5, arcs=True), 1),  # one that offends more
        (attempt(4e-4, 0.46), attempt(3e-7, float("nan"), arcs=True), 1),
    ],
)
def test_of_what_does_not_convince_the_least_wrong_is_kept(mesh: Any, structure: Any, kept: int) -> None:
    assert _least_wrong([structure, mesh], 1e-6) == kept


def test_an_attempt_that_is_on_its_way_is_not_judged() -> None:
    """Its verdict would be thrown away, and may be dear."""
    coarse = go.solve(van_der_pol.build(), mesh="5x3", tol=None)
    solution, history = refine_mesh(coarse, tol=1e-8, limits=PassLimits(1))
    assert history.status is RefinementStatus.PASS_LIMIT
    attempt = RefinementAttempt(solution, history)
    assert attempt.final is False and "verdict" not in vars(attempt)


def test_meshes_without_anything_to_spare_are_told_by_their_errors() -> None:
    module = importlib.import_module("gnc_opt.planning.refinement.mesh.refinement")

    def phase(worst: list[float]) -> Any:
        mesh = go.Mesh.at_times(range(len(worst) + 1), range(2, 2 + len(worst)))
        return SimpleNamespace(worst=np.array(worst), samples=SimpleNamespace(leg=SimpleNamespace(mesh=mesh)))

    state = module._State(None, {"a": phase([1e-12, 1e-9, 1e-10]), "b": phase([0.0])}, None)
    assert state.points_beyond(1e-10) == 2 + 2 and state.points_beyond(1.1e-10) == 2 + 4 + 2
    assert state.points_beyond(1.0) == 2 + 3 + 4 + 2 and state.points_beyond(0.0) == 0
