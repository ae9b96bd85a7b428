"""Conjugate points: which phases are judged, the parts of the linear Hamiltonian system, and what is told of times."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from testing import constructed_solutions as by_hand

import gnc_opt as go
from gnc_opt.planning import ConditionResult
from gnc_opt.planning.optimality.accessory import on_free
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.verification import conjugate_points
from gnc_opt.planning.verification.conjugate_points import (
    END,
    START,
    _angles,
    _conjugate_times,
    _end_derivatives,
    _is_smooth,
    _only_adds,
    _worth,
)
from gnc_opt.tolerances import AT_LIMIT, CONVEX

Array = NDArray[np.float64]
FAIL = ConditionResult.FAIL


def planar(bend: float = 2.5, extra: Any = None) -> go.Problem:
    """x' = u and y' = w at the cost of u^2 + bend w^2 / 2 + 2 u w cos t."""
    model = go.Model("plane")
    x, y = model.state("x"), model.state("y")
    u, w = model.control("u"), model.control("w")
    model.ode({x: u, y: w})
    problem = go.Problem("plane")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    leg.path("sum", x + y, upper=100.0)
    cost = leg.integral(u**2 + bend * w**2 / 2 + 2 * u * w * ca.cos(model.time))
    problem.minimize(cost if extra is None else extra(leg, cost))
    return problem


def flight(problem: go.Problem | None = None, **changes: Any) -> PhaseSamples:
    """x = 1 + t, y = t^2 - t over 2 s; u = 1, w = 2 t - 1."""
    return by_hand.samples(
        planar() if problem is None else problem,
        lambda t, k: np.array([1 + t, t**2 - t]),
        lambda t, k: np.array([1 + 0 * t, 2 * t - 1]),
        lambda t, k: np.array([1 + t, 1 - t]),
        weights=(1.0,),
        breaks=(0.0, 0.5, 2.0),
        **changes,
    )


# --- what is smooth ---------------------------------------------------------------------------------------


def test_smooth_unless_a_limit_of_states_or_paths_is_met_on_the_way() -> None:
    """x grows to 3, and y falls to -1/4 at 0.5 s; ends may be at a limit, and lower limits count as upper ones do."""
    assert _is_smooth(planar(), flight())
    wide = {"state_bounds": by_hand.interval([-9.0, -9.0], [9.0, 9.0])}
    assert _is_smooth(planar(), flight(**wide))
    for lower, upper, smooth in (
        ([1.0, -9.0], [3.0, 2.0], True),  # at the ends only
        ([-9.0, -0.25], [9.0, 9.0], False),
        ([-9.0, -9.0], [9.0, 1.0], False),
        ([-9.0, -9.0], [2.5, 9.0], False),
        ([1.5, -9.0], [9.0, 9.0], False),
    ):
        s = flight(state_bounds=by_hand.interval(lower, upper))
        assert _is_smooth(planar(), s) is smooth, (lower, upper)
    for lower, upper, smooth in ((1.0, 5.0, True), (1.0, 4.0, False), (1.5, 9.0, False)):
        s = flight(path_bounds=by_hand.interval(lower, upper))
        assert _is_smooth(planar(), s) is smooth, (lower, upper)


def test_smooth_only_where_the_hamiltonian_is_strictly_convex_in_free_controls() -> None:
    """The Hessian ((2, 2 cos t), (2 cos t, bend)) is indefinite at the start if bend < 2; of w alone it is bend."""
    box = by_hand.interval([-9.0, -9.0], [9.0, 9.0])
    assert _is_smooth(planar(2.5), flight(planar(2.5), control_bounds=box))
    assert not _is_smooth(planar(1.5), flight(planar(1.5), control_bounds=box))
    all_held = by_hand.interval([1.0, -1.0], [1.0, -1.0])
    assert not _is_smooth(planar(), flight(planar(), control_bounds=all_held))  # there is nothing to vary
    u_held = by_hand.interval([1.0, -9.0], [9.0, 9.0])
    assert _is_smooth(planar(1.5), flight(planar(1.5), control_bounds=u_held))
    assert not _is_smooth(planar(-1.5), flight(planar(-1.5), control_bounds=u_held))


def test_convexity_is_told_in_shares_of_the_hamiltonian_and_of_the_ranges() -> None:
    held = by_hand.interval([1.0, -9.0], [9.0, 9.0])
    scale = flight(planar(1e-9), control_bounds=held).hamiltonian_scale
    for factor, smooth in ((0.9, False), (1.1, True)):
        bend = factor * CONVEX * scale / 18.0**2
        problem = planar(bend)
        assert _is_smooth(problem, flight(problem, control_bounds=held)) is smooth


def test_a_phase_without_controls_or_length_is_not_smooth() -> None:
    model = go.Model("clock")
    x = model.state("x")
    model.ode({x: 1.0})
    problem = go.Problem("clock")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    problem.minimize(leg.integral(x**2))
    signals = (lambda t, k: np.array([t]), lambda t, k: np.zeros((0, t.size)), lambda t, k: np.array([t]))
    s = by_hand.samples(problem, *signals, weights=(1.0,), breaks=(0.0, 1.0))
    assert not _is_smooth(problem, s)
    short = {"final_time": 0.0, "final_time_bounds": by_hand.interval(0.0, 0.0)}
    assert not _is_smooth(planar(), flight(**short))


@pytest.mark.parametrize(
    ("extra", "adds"),
    [
        (lambda leg, cost: 3 * cost, True),
        (lambda leg, cost: cost + leg.final_state("x") ** 2, True),
        (lambda leg, cost: cost**2, False),
        (lambda leg, cost: cost * leg.final_state("x"), False),
        (lambda leg, cost: cost * leg.initial_state("y"), False),
        (lambda leg, cost: cost * leg.final_time, False),
        (lambda leg, cost: cost * leg.initial_time, False),
    ],
)
def test_integrals_must_only_add(extra: Any, adds: bool) -> None:
    problem = planar(extra=extra)
    assert _only_adds(problem, "leg") is adds
    assert _is_smooth(problem, flight(problem)) is adds


def test_integrals_times_a_parameter_or_in_a_constraint_do_not_only_add() -> None:
    for weighed in (False, True):
        model = go.Model("point")
        x, u = model.state("x"), model.control("u")
        model.ode({x: u})
        problem = go.Problem("weighed")
        k, leg = problem.parameter("k"), problem.phase("leg", model)
        problem.minimize(leg.integral(u**2) * k if weighed else leg.integral(u**2) + k)
        assert _only_adds(problem, "leg") is not weighed
    other = planar()
    leg = other.get_phase()
    other.constrain("end", leg.final_state("x"), upper=9.0)
    assert _only_adds(other, "leg")
    other.constrain("area", leg.integral(leg.model.symbol("x")), upper=9.0)
    assert not _only_adds(other, "leg")


# --- its parts --------------------------------------------------------------------------------------------


def test_free_controls_in_a_hessian() -> None:
    hessians = np.array([[[2.0, 3.0], [3.0, 5.0]]] * 4)
    free = np.array([[True, True], [True, False], [False, True], [False, False]])
    found = on_free(hessians, free)
    np.testing.assert_array_equal(
        found, [[[2, 3], [3, 5]], [[2, 0], [0, 1]], [[1, 0], [0, 5]], [[1, 0], [0, 1]]]
    )


def test_controls_are_free_a_millionth_of_their_range_off_their_bounds() -> None:
    """u = 1 throughout, between -7 and 1 + d, or 1 - d and 9."""
    for d, free in ((0.9 * AT_LIMIT * 8, False), (1.2 * AT_LIMIT * 8, True)):
        for box in (([-7.0 + d, -9.0], [1.0 + d, 9.0]), ([1.0 - d, -9.0], [9.0 - d, 9.0])):
            s = flight(control_bounds=by_hand.interval(*box))
            found = conjugate_points._free(s, s.u)
            assert found.shape == (s.times.size, 2)
            assert np.all(found[:, 0] == free) and np.all(found[:, 1])


def test_worth_is_the_median_curvature_over_the_duration() -> None:
    """Over ranges of 18 and 4 the Hessian at t has the entries 2 18^2, 1 4^2 and, twice, 2 cos(t) 18 4."""
    s = flight(planar(1.0), control_bounds=by_hand.interval([-9.0, -2.0], [9.0, 2.0]))
    norms = np.sqrt((2 * 18**2) ** 2 + 16**2 + 2 * (2 * np.cos(s.times) * 72) ** 2)
    assert _worth(s) == pytest.approx(2.0 * np.median(norms), rel=1e-12)


def test_angles_of_a_plane_that_turns() -> None:
    """X = diag(sin a t, sin b t), Lambda = diag(cos a t, cos b t): M M^T = -exp(-2 i a t), the angle from -1."""
    rates, step = np.array([0.3, 0.4]), 0.5
    cosine, sine = np.diag(np.cos(rates * step)), np.diag(np.sin(rates * step))
    flow = np.block([[cosine, sine], [-sine, cosine]])
    frame = np.vstack([np.zeros((2, 2)), np.eye(2)])
    angles = np.sort(_angles(frame, np.zeros((2, 0)), np.array([flow, flow, flow])), axis=1)
    assert angles.shape == (4, 2) and np.all(angles[0] == 0.0)
    for k in (1, 2, 3):
        np.testing.assert_allclose(angles[k], np.sort(2 * np.pi - 2 * rates * step * k), rtol=1e-12)


def test_ends_of_the_second_of_two_phases() -> None:
    """Jacobian of the constraints and Hessian of their Lagrangian by the states at one end of one phase only."""
    model = go.Model("point")
    x, y, u = model.state("x"), model.state("y"), model.control("u")
    model.ode({x: u, y: 0.0})
    problem = go.Problem("two")
    legs = [problem.phase(name, model) for name in ("one", "two")]
    legs[0].time(0.0, 1.0)
    legs[1].time(1.0, 2.0)
    ends = {
        (name, end): ca.vertcat(*(getattr(leg, f"{end}_state")(label) for label in "xy"))
        for name, leg in zip(("one", "two"), legs, strict=True)
        for end in ("initial", "final")
    }
    factors = dict(zip(ends, (2.0, 3.0, 5.0, 7.0), strict=True))
    terms = [factor * ends[at][0] * ends[at][1] for at, factor in factors.items()]
    problem.constrain("c", terms[0] + terms[1] + terms[2] + terms[3], upper=99.0)
    problem.minimize(sum(10 * factor * ends[at][0] ** 2 for at, factor in factors.items()))
    values = {at: np.array([0.5 + k, -1.0 - k]) for k, at in enumerate(ends)}
    for (name, word), factor in factors.items():
        function = _end_derivatives(problem, name, START if word == "initial" else END)
        arguments = []
        for leg in ("one", "two"):
            arguments += [values[leg, "initial"], values[leg, "final"], 0.0, 1.0, [], []]
        row, curvature = (v.full() for v in function(*arguments, [], [0.25]))
        a, b = values[name, word]
        np.testing.assert_allclose(row, [[factor * b, factor * a]])
        np.testing.assert_allclose(curvature, factor * np.array([[20.0, 0.25], [0.25, 0.0]]))


# --- times ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("frame", "crossings", "found"),
    [
        (1.0, {1: 0.5, 2: 0.5}, [(START, 0.5), (END, 0.5)]),
        (1.0, {1: 0.5, 2: 0.51}, [(START, 0.51), (END, 0.51)]),
        (1.0, {1: 0.5, 2: 0.53}, [(START, None), (END, None)]),
        (1.0, {1: 0.53, 2: 0.5}, [(START, None), (END, None)]),
        (1.0, {1: 0.5, 2: None}, [(START, None), (END, None)]),
        (1.0, {1: np.inf, 2: 0.5}, [(START, np.inf), (END, np.inf)]),
        (1.0, {1: None, 2: 0.5}, [(START, None), (END, None)]),
        (0.0, {1: np.inf, 2: np.inf}, [(START, np.inf)]),
        ("partly", {1: np.inf, 2: np.inf}, [(START, np.inf), (END, np.inf)]),
    ],
)
def test_times_that_two_grids_agree_on(
    monkeypatch: pytest.MonkeyPatch, frame: Any, crossings: dict[int, Any], found: list[Any]
) -> None:
    """Within a hundredth of 2 s; where all states are given at the end, it is the same as from the start."""
    states = np.diag([1.0, 0.0]) if frame == "partly" else frame * np.eye(2)
    frames = {START: np.eye(4)[:, 2:], END: np.vstack([states, np.eye(2)])}
    monkeypatch.setattr(conjugate_points, "_end_frame", lambda solution, s, end: frames[end])
    monkeypatch.setattr(conjugate_points, "fine_times", lambda leg, steps, least: steps)
    monkeypatch.setattr(conjugate_points, "_system", lambda s, steps: steps)

    def crossing(s: Any, system: int, frame: Array, end: int) -> Any:
        assert frame is frames[end]
        return crossings[system // conjugate_points.CONJUGATE_STEPS_PER_PHASE]

    monkeypatch.setattr(conjugate_points, "_first_crossing", crossing)
    s: Any = SimpleNamespace(leg=SimpleNamespace(duration=2.0, states=SimpleNamespace(size=2)))
    none: Any = None
    assert _conjugate_times(none, s) == found


@pytest.mark.parametrize(
    ("times", "result", "value", "where"),
    [
        ({"a": [(START, np.inf)], "b": [(START, np.inf)]}, ConditionResult.PASS, 0.0, "none along phase a, phase b"),
        (
            {"a": [(START, np.inf), (END, np.inf)], "b": [(START, None)]},
            ConditionResult.PASS,
            0.0,
            "none along phase a",
        ),
        ({"a": [(START, None)], "b": [(START, 2.5)]}, FAIL, 0.25, "phase b, t = 2.5 s is conjugate to its start"),
        ({"a": [(END, 2.5)], "b": [(START, np.inf)]}, FAIL, 0.75, "phase a, t = 2.5 s is conjugate to its end"),
        ({"a": [(START, np.inf), (END, 1.5)], "b": []}, FAIL, 0.25, "phase a, t = 1.5 s is conjugate to its end"),
    ],
)  # fmt: skip
def test_what_is_told_of_conjugate_times(
    monkeypatch: pytest.MonkeyPatch, times: dict[str, Any], result: ConditionResult, value: float, where: str
) -> None:
    """Phases from 1 s to 3 s; the value is the share that lies beyond the time, as seen from that end."""
    samples: Any = [
        SimpleNamespace(leg=SimpleNamespace(name=name, initial_time=1.0, final_time=3.0, duration=2.0))
        for name in (*times, "rough")
    ]
    monkeypatch.setattr(conjugate_points, "_is_smooth", lambda problem, s: s.leg.name != "rough")
    monkeypatch.setattr(conjugate_points, "_conjugate_times", lambda solution, s: times[s.leg.name])
    solution: Any = SimpleNamespace(need_problem=lambda what: None)
    (condition,) = conjugate_points.conjugate_points(solution, samples)
    assert (condition.name, condition.result, condition.where) == ("conjugate points", result, where)
    assert condition.value == pytest.approx(value) and condition.tolerance == 0.0 and condition.sufficient


def test_nothing_is_told_where_nothing_is_smooth(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conjugate_points, "_is_smooth", lambda problem, s: False)
    solution: Any = SimpleNamespace(need_problem=lambda what: None)
    samples: Any = [SimpleNamespace(leg=None)]
    assert conjugate_points.conjugate_points(solution, samples) == []
