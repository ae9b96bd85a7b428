"""The structure loop by hand: plans, kinks, arcs that vanish or are missing, and how it ends."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import cart, interval, phase, samples, solution
from testing.internals import (
    ARC_MAX_DEGREE,
    FIRST_DEGREE,
    PassLimits,
    PhaseSamples,
    PhaseStructure,
    Plan,
    Resolution,
    Smooth,
)

import gnc_opt as go
from gnc_opt.planning import Arc, ArcKind, RefinementStatus, SolverOptions, Status
from gnc_opt.planning.refinement.arcs import arc_refinement as f
from gnc_opt.planning.refinement.arcs import loop as s
from gnc_opt.planning.refinement.arcs import update as m

LOW, FREE, UP, SING = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.SINGULAR
RELEASED = ArcKind.RELEASED
CART = cart()


# --- resolutions ------------------------------------------------------------------------------------------


def test_finer_pieces_get_points_first_as_many_as_there_are_decades_to_gain() -> None:
    assert Resolution() == Resolution(1, FIRST_DEGREE, 0, np.inf, ())
    assert Resolution(1, 6).finer(np.array([0.1])) == Resolution(1, 9)
    assert Resolution(2, 6).finer(np.array([-1.0, 3.5])) == Resolution(2, 10)
    assert Resolution(1, 11).finer(np.array([8.0])) == Resolution(1, ARC_MAX_DEGREE)
    assert Resolution(3, 7).finer(np.array([0.0, -1.0, -9.0])) == Resolution(3, 7)


# --- plans ------------------------------------------------------------------------------------------------

THREE = PhaseStructure((1.0, 2.0, 4.0, 5.0), ((LOW,), (SING,), (UP,)))


def held_by(plan: Plan) -> Any:
    asked: dict[str, Any] = {}
    leg = SimpleNamespace(numbers=SimpleNamespace(initial=SimpleNamespace(fixed=np.ones(1, dtype=bool))))
    problem = SimpleNamespace(
        phases={"leg": leg}, with_fixed_arcs=lambda name, **more: asked.update(more, name=name) or problem
    )
    assert plan.hold(problem, "leg") is problem  # type: ignore[arg-type]
    return asked


def test_controls_paths_and_states_are_held_segment_by_segment() -> None:
    structure = PhaseStructure(
        (0.0, 1.0, 2.0, 3.0),
        ((LOW, FREE, FREE, FREE), (FREE, SING, UP, FREE), (FREE, UP, FREE, LOW)),
        regular=(True, False, True, False), n_controls=2, n_paths=1,
    )  # fmt: skip
    asked = held_by(Plan(structure, (Resolution(1), Resolution(2, 6, 4), Resolution(1))))
    assert asked["name"] == "leg"
    assert asked["arcs"].tolist() == [[LOW, RELEASED, RELEASED, RELEASED], [FREE, FREE, FREE, UP]]
    assert asked["paths"].tolist() == [[RELEASED, UP, UP, RELEASED]]
    assert asked["states"].tolist() == [[FREE, FREE, FREE, LOW]]
    assert asked["smooth"] == (Smooth(1, 1, 3, 4),)
    bang = held_by(Plan.of(PhaseStructure((0.0, 1.0, 2.0), ((LOW, FREE), (UP, FREE)), n_controls=1)))
    assert bang["paths"] is None and bang["states"] is None and bang["smooth"] == ()
    assert bang["arcs"].tolist() == [[LOW, UP]]


# --- kinks ------------------------------------------------------------------------------------------------


# --- arcs that vanish -------------------------------------------------------------------------------------

LEG: Any = SimpleNamespace(leg=SimpleNamespace(name="leg"))


# --- arcs that are missing --------------------------------------------------------------------------------


def line(lam: Any, u: Any, **changes: Any) -> PhaseSamples:
    """x' = u with |u| <= 1 and H = lam u over 4 s; dH/du over its range of 2 in shares of |lam| at most."""
    model = go.Model("integrator")
    x, control = model.state("x"), model.control("u")
    model.ode({x: control})
    problem = go.Problem("integrator")
    leg = problem.phase("leg", model)
    leg.time(0.0, 4.0)
    problem.minimize(leg.integral(x))
    return samples(
        problem, lambda t, k: [0 * t], u, lam, weights=(0.0,), breaks=np.arange(5.0), degree=3,
        control_bounds=interval(-1.0, 1.0), **changes,
    )  # fmt: skip


def rows(found: PhaseSamples, kinds: list[ArcKind]) -> Any:
    return np.array(kinds, dtype=object)[found.segments][None, :]


@pytest.mark.parametrize(
    ("switches", "at", "answer"),
    [
        ((1.0, 1.7, 1.8, 1.9, 2.0, 2.1, 3.0), 2.05, (0, 1.7, 2.1)), ((1.0, 1.7, 1.8, 1.9, 2.1, 3.0), 2.05, None),
        ((1.0, 1.7, 1.8, 1.9, 2.0, 2.1, 3.0), 0.5, None),
        ((1.0, 1.6, 1.75, 1.85, 1.95, 2.1, 3.0), 2.05, (0, 1.75, 2.1)), ((1.0, 1.6, 1.65, 1.85, 1.95, 2.1), 2.05, None),
    ],
)  # fmt: skip
def test_many_switches_of_a_small_switching_function_are_a_singular_arc(
    monkeypatch: pytest.MonkeyPatch, switches: tuple[float, ...], at: float, answer: Any
) -> None:
    """Of (t - 2)^3 / 4, below `SMALL` from t = 1.57 to 2.43, where a violation adds a bang, and below `ALIKE`
    times this from 1.71 to 2.29.

    Where such arcs are of second order, bangs remain bangs.
    """
    found = line(lambda t, k: [((t - 2) / 2) ** 3], lambda t, k: [0 * t])
    kinds = tuple(((LOW, UP)[k % 2], FREE) for k in range(len(switches) + 1))
    structure = PhaseStructure((0.0, *switches, 4.0), kinds, n_controls=1)
    violation = np.zeros((1, found.times.size))
    violation[0, np.argmin(np.abs(found.times - at))] = 2e-4
    problem: Any = None
    monkeypatch.setattr(m, "chatters", lambda *_: False)
    assert m._chatter(found, structure, violation, problem) == answer
    assert (
        m._chatter(found, structure, m.SIGN_ERROR_MIN_SHARE_OF_HAMILTONIAN / 4e-4 * violation, problem)
        is None
    )
    monkeypatch.setattr(m, "chatters", lambda *_: True)
    assert m._chatter(found, structure, violation, problem) is None


# --- resolution -------------------------------------------------------------------------------------------


def plan_of(*resolutions: Resolution, kinds: Any = None) -> Plan:
    n = len(resolutions)
    structure = PhaseStructure(
        tuple(np.linspace(0, 1, n + 1)), kinds or ((LOW, FREE, FREE, FREE, FREE),) * n, (), 1, 2
    )
    return Plan(structure, resolutions)


def test_costates_count_in_shares_of_the_cost() -> None:
    """lam_q' = -1/2 along the second half: 1/4 of 12.25 that the states are worth."""

    def lam(t: Any, k: int) -> Any:
        return [-12 - 0.5 * k * (t - 0.5), -6 + 12 * t + 0.25 * k * (t - 0.5) ** 2]

    plan = plan_of(Resolution(1, 4), Resolution(1, 4))
    wrong = samples(CART, lam=lam)
    share = 0.25 / 12.25
    found = f.finer(wrong, plan, 0.99 * share)
    assert found is not None and [r.degree for r in found.resolutions] == [4, 7]
    assert f.finer(wrong, plan, 1.01 * share) is None
    pushed = samples(CART, lam=lam, states=lambda t, k: [0.5 * k + 0 * t, 0 * t])
    assert f.finer(pushed, plan, 1e-9) is None


TWO_ROWS = PhaseStructure((0.0, 0.5, 1.0), ((LOW,) + (FREE,) * 4, (UP,) + (FREE,) * 4), (), 1, 2)


# --- the loop ---------------------------------------------------------------------------------------------


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The loop with solves and mending as told: `script` is (status, action) of every pass."""
    problem = cart()
    base = solution(problem, phase(problem))

    def run(script: list[tuple[Status, str]], **more: Any) -> Any:
        left, asked, shown = iter(script), [], []
        now: dict[str, Any] = {"passes": 0}

        def solve(problem: Any, plans: Any, guess: Any, options: SolverOptions, *_: Any) -> Any:
            asked.append(options)
            now["status"], now["action"] = next(left)
            now["passes"] += 1
            return replace(base, status=now["status"], objective=float(now["passes"]))

        monkeypatch.setattr(s, "_solve", solve)
        monkeypatch.setattr(s, "pass_meter", lambda *_: nullcontext(shown.append))
        monkeypatch.setattr(s, "_at_solution", lambda plan, found, name: plan)
        monkeypatch.setattr(s, "improve", lambda found, plans, swapped, tol: (plans, now["action"]))
        found, history = s.optimise_switches(base, **more)
        assert shown == list(history.passes)
        return found, history, asked

    return run


@pytest.mark.parametrize(
    ("script", "passes", "status", "actions"),
    [
        ([(Status.OPTIMAL, "")], 40, "converged", ["structure stands"]),
        ([(Status.OPTIMAL, "a"), (Status.ACCEPTABLE, "")], 40, "converged", ["a", "structure stands"]),
        ([(Status.OPTIMAL, "a"), (Status.OPTIMAL, "b")], 2, "pass_limit", ["a", "b"]),
        ([(Status.OPTIMAL, "a"), (Status.INFEASIBLE, "")], 40, "failed", ["a", "not solved (infeasible)"]),
        ([(Status.INTERRUPTED, "")], 40, "interrupted", ["not solved (interrupted)"]),
        ([(Status.OPTIMAL, s.KINKS_MOVED)] * 5, 40, "stalled", [s.KINKS_MOVED] * 5),
        ([(Status.OPTIMAL, s.RAISED)] * 2, 40, "converged", [s.RAISED] * 2),  # the error is rounding already
    ],
)
def test_how_the_loop_ends(scripted: Any, script: Any, passes: int, status: str, actions: list[str]) -> None:
    found, history, _ = scripted(script, limits=PassLimits(passes))
    assert history.status is RefinementStatus(status) and [p.actions for p in history.passes] == actions
    assert [p.solved for p in history.passes] == [st.solved for st, _ in script]
    assert history.message == f"{status}: {actions[-1]}"
    if status == "converged":
        assert found.objective == len(script) and history.chosen == len(script) - 1


def test_where_finer_meshes_end_singular_controls_of_higher_degree_are_tried(
    scripted: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once: the plans that then are asked for are what they are."""
    rows = PhaseStructure(
        (0.0, 0.5, 1.0), ((UP, FREE, FREE, FREE, FREE), (SING, FREE, FREE, FREE, FREE)), (), 1, 2
    )
    smoother = iter([{"leg": Plan.of(rows)}])
    monkeypatch.setattr(s, "smoother", lambda found, plans: next(smoother, plans))
    _, history, _ = scripted([(Status.OPTIMAL, s.RAISED)] * 2 + [(Status.OPTIMAL, "")])
    assert [p.actions for p in history.passes] == [s.RAISED, s.SMOOTHED, "structure stands"]
    assert history.status is RefinementStatus.CONVERGED


@pytest.mark.parametrize(("tol", "asked"), [(1e-3, s.SWITCHING_TIME_TOLERANCE), (1e-12, 1e-12)])
def test_what_was_detected_is_tried_after_a_structure_that_fails(
    monkeypatch: pytest.MonkeyPatch, tol: float, asked: float
) -> None:
    problem = cart()
    base, other = solution(problem, phase(problem)), solution(problem, phase(problem))
    told, calls = {"leg": Plan.of(TWO_ROWS)}, []

    def run(loop: Any, guess: Any, plans: Any, flown: Any = None) -> Any:
        calls.append((guess, plans, loop.aim, loop.limits.passes, loop.options.tolerance))
        return RefinementStatus.FAILED

    monkeypatch.setattr(s, "_settled", lambda *_: (other, told, None))
    monkeypatch.setattr(s._Loop, "run", run)
    limits = PassLimits(7)
    found, history = s.optimise_switches(base, tol=tol, limits=limits, structures={"leg": TWO_ROWS})
    assert found is base and history.status is RefinementStatus.FAILED and history.tolerance == tol
    assert [(c[0] is other, c[0] is base, *c[2:]) for c in calls] == [
        (True, False, asked, 7, s.TIGHT),
        (False, True, asked, 7, s.TIGHT),
    ]
    assert calls[0][1] is told and calls[1][1]["leg"].structure == TWO_ROWS
    monkeypatch.setattr(s, "_settled", lambda *_: (base, told, None))
    calls.clear()
    s.optimise_switches(base, structures={"leg": TWO_ROWS})
    assert len(calls) == 1  # the same guess would fail again


def test_plans_follow_the_switch_times_of_their_solution() -> None:
    plan = Plan(THREE, (Resolution(1), Resolution(2), Resolution(1)))
    leg = SimpleNamespace(breaks=np.array([1.0, 1.5, 2.0, 4.5, 5.0]))
    there: Any = SimpleNamespace(phases={"leg": leg})
    assert s._at_solution(plan, there, "leg").structure.times == (1.0, 1.5, 4.5, 5.0)


def test_arcs_of_all_phases_have_the_names_of_their_rows() -> None:
    problem = cart()
    structure = PhaseStructure((0.0, 1.0), ((UP, FREE, LOW, FREE, FREE),), (), 1, 2)
    found = s._arcs(solution(problem, phase(problem)), {"leg": Plan.of(structure)})
    assert found == (Arc("leg", "a", UP, 0.0, 1.0), Arc("leg", "pure", LOW, 0.0, 1.0))
