"""Newton's method on switch times, part by part: steps, arcs that stand in the way, arcs that are missing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import cart, interval, phase, samples, solution
from testing.internals import PhaseStructure, Switches

from gnc_opt.planning import ArcKind
from gnc_opt.planning.refinement.switching import newton as n
from gnc_opt.planning.refinement.switching import step as switch_step
from gnc_opt.planning.refinement.switching.flight import (
    INSET,
    SIGN_ERROR_MIN_SHARE,
    SwitchFlight,
    _interpolated,
    forgive,
    wrong_interval,
)
from gnc_opt.planning.refinement.switching.step import SwitchStep, model_minimum

RNG = np.random.default_rng(4)


def switches(
    times: list[float], channels: list[int], first: Any = (-1.0, 4.0), ends: Any = (1.0, 11.0)
) -> Switches:
    """Of two controls, one from -1 to 1, one from 2 to 4."""
    return Switches(
        np.array(times, float), np.array(channels, int), np.array(first, float), np.array(ends, float),
        np.array([0.0, 6.0]), (),
    )  # fmt: skip


def step(*change: float) -> Any:
    return SimpleNamespace(change=np.array(change))


# --- the quadratic model ----------------------------------------------------------------------------------


def test_a_step_is_that_of_the_optimality_system() -> None:
    rough = RNG.standard_normal((5, 5))
    hessian, gradient = rough @ rough.T + np.eye(5), RNG.standard_normal(5)
    rows, misses = RNG.standard_normal((2, 5)), RNG.standard_normal(2)
    system = np.block([[hessian, rows.T], [rows, np.zeros((2, 2))]])
    wanted = np.linalg.solve(system, -np.concatenate([gradient, misses]))[:5]
    assert model_minimum(hessian, gradient, rows, misses) == pytest.approx(wanted)


def test_where_conditions_leave_nothing_open_the_step_meets_them() -> None:
    rows = RNG.standard_normal((3, 3))
    wanted = np.array([1.0, -2.0, 3.0])
    assert model_minimum(np.eye(3), np.ones(3), rows, -rows @ wanted) == pytest.approx(wanted)


def test_conditions_that_are_all_but_one_are_met_on_average() -> None:
    """The step that would meet both is 1e12 long."""
    rows = np.array([[1.0, 0.0], [1.0, 1e-12]])
    found = model_minimum(np.eye(2), np.zeros(2), rows, np.array([-1.0, -2.0]))
    assert found == pytest.approx([1.5, 0.0], abs=1e-9)


def test_negative_curvatures_are_reversed() -> None:
    """x is held; along y and z, curvatures of -2 and 5 and slopes of 4 and -10: down both, by 2 and by 2."""
    hessian, gradient = np.diag([7.0, -2.0, 5.0]), np.array([1.0, 4.0, -10.0])
    found = model_minimum(hessian, gradient, np.array([[2.0, 0.0, 0.0]]), np.array([3.0]))
    assert found == pytest.approx([-1.5, -2.0, 2.0])


@pytest.mark.parametrize(
    ("rows", "independent"),
    [
        ([[1.0, 0.0], [1.0, 1.0]], True), ([[1.0, 0.0], [1e-8, 1e-8]], True), ([[1.0, 2.0], [-2.0, -4.0]], False),
        ([[1.0, 0.0], [0.0, 0.0]], False), ([[1.0, 2.0]], True), ([[1.0, 1.0], [1.0, 1.0 + 1e-10]], False),
        ([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], False),
    ],
)  # fmt: skip
def test_conditions_are_independent_in_any_units(rows: Any, independent: bool) -> None:
    assert switch_step.independent(np.array(rows)) is independent


# --- arcs -------------------------------------------------------------------------------------------------


def test_arcs_of_every_control_from_end_to_end() -> None:
    """The second control switches first, then the first one, twice: unknowns 1 to 3 between 0 and 4."""
    assert n._arcs(switches([4.0, 3.0, 6.0], [0, 1, 0])) == [(0, 1), (1, 3), (3, 4), (0, 2), (2, 4)]
    assert n._arcs(switches([6.0, 4.0], [0, 0])) == [(0, 2), (2, 1), (1, 3), (0, 3)]


def test_a_step_may_move_no_switch_farther_than_a_share_of_the_phase() -> None:
    there = switches([4.0, 6.0], [0, 0])
    assert n._allowed(there, step(0, 0.1, -0.2, 0)) == (1.0, None)
    assert n._allowed(there, step(0, 0.0, -1.6, 0)) == (
        pytest.approx(n.SWITCH_MAX_MOVE_SHARE * 10 / 1.6),
        None,
    )
    assert n._allowed(there, step(0, 0, 0, 0)) == (1.0, None)


def test_an_arc_keeps_some_of_its_length() -> None:
    """Arcs of 3, 0.2 and 6.8 s: the middle one may lose 0.16 s at once, growing is free."""
    there = switches([4.0, 4.2], [0, 0])
    share, arc = n._allowed(there, step(0, 0.15, -0.15, 0))
    assert share == pytest.approx(n.SHRUNK * 0.2 / 0.3) and arc == (1, 2)
    assert n._allowed(there, step(0, -0.15, 0.15, 0)) == (1.0, None)
    assert n._allowed(there, step(0, 0.07, -0.07, 0)) == (1.0, None)
    # The arcs of another control do not meet; the tightest one counts.
    both = switches([4.0, 4.2, 4.1, 4.15], [0, 0, 1, 1])
    share, arc = n._allowed(both, step(0, 0.15, -0.15, 0.1, -0.1, 0))
    assert share == pytest.approx(n.SHRUNK * 0.05 / 0.2) and arc == (3, 4)
    assert n._allowed(switches([4.0, 4.2], [0, 1]), step(0, 0.15, -0.15, 0)) == (1.0, None)
    share, arc = n._allowed(switches([1.1], [0]), step(0.05, -0.15, 0))
    assert share == pytest.approx(n.SHRUNK * 0.1 / 0.2) and arc == (0, 1)
    share, arc = n._allowed(switches([10.9], [0]), step(0, 0.15, -0.05))
    assert share == pytest.approx(n.SHRUNK * 0.1 / 0.2) and arc == (1, 2)


def test_a_step_moves_switches_and_ends() -> None:
    moved = n._moved(switches([4.0, 6.0], [0, 1]), np.array([0.1, 0.2, -0.3, -0.4]))
    assert moved.times == pytest.approx([4.2, 5.7]) and moved.ends == pytest.approx([1.1, 10.6])
    assert SwitchStep(np.array([0.1, -0.5, 0.2]), *[None] * 7).share(moved) == pytest.approx(0.5 / 9.5)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("arc", "times", "channels", "first"),
    [
        ((1, 3), [3.0], [1], [-1.0, 4.0]),
        ((0, 1), [3.0, 6.0], [1, 0], [1.0, 4.0]),  # the first control begins where it was after its switch
        ((0, 2), [4.0, 6.0], [0, 0], [-1.0, 2.0]),
        ((3, 4), [4.0, 3.0], [0, 1], [-1.0, 4.0]),
        ((2, 4), [4.0, 6.0], [0, 0], [-1.0, 4.0]),
    ],
)
def test_an_arc_that_vanishes_takes_its_switches_with_it(
    arc: Any, times: Any, channels: Any, first: Any
) -> None:
    before = switches([4.0, 3.0, 6.0], [0, 1, 0])
    left = n._without(before, arc)
    assert (left.times.tolist(), left.channels.tolist(), left.first.tolist()) == (times, channels, first)
    assert before.first.tolist() == [-1.0, 4.0]


def test_a_phase_without_switches_has_nothing_to_lose() -> None:
    left = n._without(switches([], []), (0, 1))
    assert left.times.size == 0 and left.first.tolist() == [-1.0, 4.0]


# --- arcs that are missing --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "own", "left"),
    [
        ([-1, 2, 3, -1, 4, -1], [2], [-1, 0, 0, -1, 4, -1]),
        ([3, 4, -4, 3, 2], [1], [0, 0, -4, 3, 2]),
        ([2, 3, -4, -5, 1], [2], [0, 0, 0, -5, 1]),
        ([1, 2, 3, 4], [1], [0, 0, 3, 4]),  # it grows: that is no matter of when it switches
        ([1, 2, 1e-9, 3, 4], [2], [1, 2, 0, 3, 4]),  # at rest, with the wrong slope
        ([1, 2, -1e-9, 3, 4], [2], [1, 2, 0, 3, 4]),
        ([-1, -2, -1e-9, 3, -1], [2], [-1, -2, 0, 3, -1]),  # another zero, too near to be seen
        ([1, 0, 2, 3, 0, 1], [3], [1, 0, 0, 0, 0, 1]),
        ([1, 2, 3], [], [1, 2, 3]),
    ],
)
def test_violations_that_are_worst_at_a_switch_are_its_own(wrong: Any, own: Any, left: Any) -> None:
    values = np.array(wrong, float)
    forgive(values, np.array(own, int))
    assert values.tolist() == left


def test_a_missing_arc_lies_between_the_zeros_a_quarter_inside() -> None:
    """The sign is wrong from 1.5 s to 4.25 s by straight lines, or up to an end of the phase."""
    times = np.array([0.0, 1.0, 2.0, 4.0, 5.0, 6.0])
    wrong = np.array([-2.0, -1.0, 1.0, 1.0, -3.0, -1.0])
    inset = INSET * 2.75
    for j in (2, 3):
        assert wrong_interval(times, wrong, j) == pytest.approx((1.5 + inset, 4.25 - inset))
    assert wrong_interval(times, np.array([1.0, 1.0, 1.0, 1.0, -3.0, -1.0]), 1) == pytest.approx(
        (0.0, 4.25 * 0.75)
    )
    assert wrong_interval(times, np.array([-2.0, -1.0, 1.0, 1.0, 1.0, 1.0]), 4) == pytest.approx(
        (1.5 + 4.5 / 4, 6.0)
    )
    assert wrong_interval(times, np.ones(6), 3) == (0.0, 6.0)
    assert wrong_interval(times, np.array([-1.0, 0.0, 1.0, 1.0, 0.0, 5.0]), 2) == pytest.approx((2.0, 4.0))


@pytest.mark.parametrize(
    ("switching", "arc"),
    [
        # At its upper limit until 4 s, then at the lower one: negative, then positive, is right.
        ([[-4, -3, -2, -1, 0.5, 1, 2, 3, 4], [5] * 9], None),
        ([[-4, 1, -2, -1, 0.5, 1, 2, 3, 4], [5] * 9], (0, 0.8, 1 + 1 / 3)),
        ([[-4, -3, -2, -1, 0.5, 1, -2, 3, 4], [5] * 9], (0, 5 + 1 / 3, 6.4)),
        ([[-4, -3, -2, 0.5, 1, 1, 2, 3, 4], [5] * 9], None),  # it switches a little too late
        ([[-4, -3, -2, -1, -0.5, 1, 2, 3, 4], [5] * 9], None),  # too early
        # (t - 1)(4 - t)(8 - t) vanishes at 4 s, but for that time of the switch the cost is the largest.
        ([[-32, 0, 12, 10, 1e-9, -12, -20, -18, 0], [5] * 9], (0, 4.0, 8.0)),
        ([[-32, 0, 12, 10, -1e-9, -12, -20, -18, 0], [5] * 9], (0, 4.0, 8.0)),
        ([[-4, -3, -2, -1, 0.5, 1, 2, 3, 4], [5, 5, -5, 5, 5, 5, 5, 5, 5]], (1, 1.5, 2.5)),
        # What is worst in shares of its own switching function counts.
        (
            [[-4, 1, -2, -1, 0.5, 1, 2, 3, 4], [50, 50, -20, 50, 50, 50, 50, 50, 50]],
            (1, 1 + 5 / 7, 2 + 2 / 7),
        ),
        ([[-4, 3, -2, -1, 0.5, 1, 2, 3, 4], [50, 50, -20, 50, 50, 50, 50, 50, 50]], (0, 4 / 7, 1.6)),
        ([[-4, 3.9 * SIGN_ERROR_MIN_SHARE, -2, -1, 0.5, 1, 2, 3, 4], [5] * 9], None),
        ([[-4, 4.1 * SIGN_ERROR_MIN_SHARE, -2, -1, 0.5, 1, 2, 3, 4], [5] * 9], (0, 1.0, 1.0)),
    ],
)
def test_a_missing_arc_is_where_a_switching_function_has_the_wrong_sign(switching: Any, arc: Any) -> None:
    """The first control, from -1 to 1, is up until 4 s; the second one, from 2 to 4, stays low."""
    leg = SimpleNamespace(control_bounds=interval([-1, 2], [1, 4]))
    functions = SimpleNamespace(switching=lambda *_: np.array(switching, float))
    flight: Any = SimpleNamespace(
        s=SimpleNamespace(leg=leg, functions=functions), times=np.arange(9.0), x=None, lam=None,
        flow=SimpleNamespace(controls=np.array([[1.0] * 4 + [-1.0] * 4, [2.0] * 8])),
    )  # fmt: skip
    found = SwitchFlight.missing_arc.func(flight)  # type: ignore[attr-defined]
    if arc is None:
        assert found is None
        return
    inset = INSET * (arc[2] - arc[1])
    assert found == (arc[0], pytest.approx(arc[1] + inset, abs=1e-5), pytest.approx(arc[2] - inset, abs=1e-5))


def test_an_arc_is_added_between_two_switches_of_its_control() -> None:
    before = switches([3.0], [1])
    inner = n._with_arc(before, 0, 4.0, 6.0)
    assert (inner.times.tolist(), inner.channels.tolist()) == ([3.0, 4.0, 6.0], [1, 0, 0])
    assert inner.first.tolist() == [-1.0, 4.0]
    early = n._with_arc(before, 1, 1.0, 2.0)
    assert (early.times.tolist(), early.channels.tolist()) == ([3.0, 2.0], [1, 1])
    assert early.first.tolist() == [-1.0, 2.0] and before.first.tolist() == [-1.0, 4.0]
    late = n._with_arc(before, 0, 9.0, 11.0)
    assert (late.times.tolist(), late.channels.tolist(), late.first.tolist()) == (
        [3.0, 9.0],
        [1, 0],
        [-1.0, 4.0],
    )
    whole = n._with_arc(before, 0, 1.0, 11.0)
    assert whole.times.tolist() == [3.0] and whole.first.tolist() == [1.0, 4.0]


@pytest.mark.parametrize(
    ("rests", "last"),
    [
        ([(6.0, False)], 6.0),
        ([(6.0, True), (5.0, False)], 5.0),
        ([(6.0, True), (5.0, True), (5.0 + 1e-5, True)], 5.0),  # where it was before: that arc vanishes
        ([(6.0, True), (5.0, True), None], 5.0),
        ([None], None),
    ],
)
def test_arcs_are_added_as_long_as_they_lead_anywhere(
    monkeypatch: pytest.MonkeyPatch, rests: Any, last: Any
) -> None:
    """Flights at rest with a switch at such times, and whether they lack an arc."""
    left = [r and Planned(0.0, (0, 7.0, 8.0) if r[1] else None, switches([r[0]], [0])) for r in rests]
    monkeypatch.setattr(n, "newton_step", lambda *_: SwitchStep(np.zeros(3), *[None] * 7))  # type: ignore[arg-type]
    monkeypatch.setattr(n, "_with_arc", lambda there, *_: there)
    monkeypatch.setattr(n, "_at_rest", lambda *_: left.pop(0))
    found = n._optimum(None, None, switches([4.0], [0]), 1e-8)  # type: ignore[arg-type]
    assert (found and found.switches.times.tolist()) == (last and [last]) and not left


# --- as a guess -------------------------------------------------------------------------------------------


def test_polynomials_through_values_and_rates() -> None:
    """t^7 - 2 t and 4 - t^2 over uneven segments come back, rates and all."""

    def values(t: Any) -> Any:
        return np.array([t**7 - 2 * t, 4 - t**2])

    def rates(t: Any) -> Any:
        return np.array([7 * t**6 - 2, -2 * t])

    breaks = np.array([1.0, 1.5, 4.0])
    given = (breaks[:-1, None] + np.diff(breaks)[:, None] * np.array([0, 1, 2, 3]) / 3).ravel()
    found = _interpolated(breaks, values(given), rates(given))
    t = np.linspace(1.0, 4.0, 13)
    assert found(t) == pytest.approx(values(t)) and found.derivative()(t) == pytest.approx(rates(t))


# --- what the method fits ---------------------------------------------------------------------------------

LOW, FREE, UP = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER
ENDS = {
    "initial_bounds": interval([0, 0], [0, 0]), "final_bounds": interval([1, 0], [1, 0]),
    "final_time_bounds": interval(0.5, 9.0),
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "fits"),
    [
        ({}, True),
        ({"initial_bounds": interval([0, -1], [0, 1])}, False),
        ({"final_bounds": interval([0.5, 0], [2, 0])}, True),
        ({"final_bounds": interval([0.5, 0], [1, 0])}, False),
        ({"final_bounds": interval([1, 0], [2, 0])}, False),
        ({"final_time_bounds": interval(1.0, 1.0)}, True),
        ({"final_time_bounds": interval(0.5, 1.0)}, False),
        ({"initial_time_bounds": interval(-1.0, 1.0)}, True),
        ({"initial_time_bounds": interval(-1.0, 0.0)}, False),
        ({"duration_bounds": interval(0.2, 5.0)}, True),
        ({"duration_bounds": interval(1.0, 5.0)}, False),
    ],
)
def test_everything_is_decided_by_equalities(changes: Any, fits: bool) -> None:
    problem, structure = (
        cart(),
        PhaseStructure((0.0, 0.5, 1.0), ((UP,) + (FREE,) * 4, (LOW,) + (FREE,) * 4), (), 1, 2),
    )
    found = samples(problem, control_bounds=interval(-6.0, 6.0), **(ENDS | changes))
    assert n._fits(problem, found, structure) is fits
    if changes:
        return
    for kinds in ((FREE,) * 5, (UP, LOW, FREE, FREE, FREE), (UP, FREE, FREE, UP, FREE)):
        assert not n._fits(problem, found, replace(structure, kinds=(structure.kinds[0], kinds)))
    free: Any = SimpleNamespace(
        leg=found.leg, x=found.x, span=found.span, state_scale=found.state_scale,
        functions=SimpleNamespace(q=np.zeros(1)),
    )  # fmt: skip
    assert not n._fits(problem, free, structure)
    held, limited, double = cart(), cart(), cart()
    held.constrain("c", held.get_phase().final_state("q"), equals=1.0)
    limited.constrain("c", limited.get_phase().final_state("q"), upper=3.0)
    double.phase("other", held.get_phase().model)
    assert n._fits(held, found, structure)
    assert not n._fits(limited, found, structure) and not n._fits(double, found, structure)


@dataclass(frozen=True)
class Planned:
    """A flight that is off by so many accuracies, at these switches."""

    error: float
    missing_arc: Any = None
    switches: Any = None
    step: Any = None


@pytest.mark.parametrize(
    ("lengths", "newtons", "landings", "rests"),
    [
        ([1e-9], [], [1e-9], True),  # accuracy 1e-8: a share of 1e-6 at rest
        ([1e-3, 1e-7], [], [1e-7], True),
        ([1e-5], [], [1e-9], True),  # so short that what it leaves need not be looked at on the coarser grid
        ([1e-5, 1e-9], [], [2e-5, 1e-9], True),  # unless the finer one tells otherwise
        ([1e-3, 1e-5], [], [1e-7], True),  # a hundredth each time
        ([1e-3, 1e-4, 1e-9], [], [1e-9], True),  # a tenth
        ([1e-3, 3e-4], [1e-7], [1e-7], True),  # a third: too slow, matrices of its own
        ([1e-2], [1e-7], [1e-7], True),  # so long that its matrices are not those of the next one
        ([1e-2], [2e-3, None], [], False),
        ([0.1], [], [], False),  # a switch that would move too far
        ([None], [], [], False),
        ([1e-3, None], [], [], False),
        ([1e-2], [2e-3] * 40, [], False),  # never
    ],
)
def test_matrices_of_an_earlier_step_serve_as_long_as_they_are_worth_it(
    monkeypatch: pytest.MonkeyPatch, lengths: Any, newtons: Any, landings: Any, rests: bool
) -> None:
    """Steps that move the switch by such shares; one at 6 s, from 1 s to 11 s."""

    def planned(left: Any) -> Any:
        length = left.pop(0)
        return length and SwitchStep(np.array([0, 10 * length, 0]), *[None] * 4, 0.0, None, None, 2)  # type: ignore[arg-type]

    def newton(*rest: Any) -> Any:
        assert rest[-1] == 2
        return planned(own)

    def flown(_: Any, __: Any, ___: Any, at: Any, step: Any) -> Any:
        return SimpleNamespace(switches=at, step=planned(landed))

    left, own, landed = ([*lengths], [*newtons], [*landings])
    monkeypatch.setattr(n, "chord_step", lambda *_: planned(left))
    monkeypatch.setattr(n, "newton_step", newton)
    monkeypatch.setattr(n.SwitchFlight, "of", classmethod(flown))
    found = n._at_rest(None, None, switches([6.0], [0]), planned(left), 1e-8)  # type: ignore[arg-type]
    assert (found is not None) is rests and not left and not landed
    if rests:
        assert found is not None and found.switches.times[0] >= 6.0 and not own


@pytest.mark.parametrize(
    ("errors", "arc", "grids"),
    [
        ([0.5], None, [1]), ([2.0, 0.5], None, [1, 2]), ([9.0, 3.0, 2.0, 0.5], None, [1, 2, 4, 8]),
        ([9.0, 9.0, 9.0, 9.0], None, None), ([0.5], (0, 1.0, 2.0), None), ([2.0, None], None, None),
        ([None], None, None),
    ],
)  # fmt: skip
@pytest.mark.parametrize("known", [None, SwitchStep(np.zeros(3), *[None] * 7)])  # type: ignore[arg-type]
def test_when_a_flow_is_accurate(
    monkeypatch: pytest.MonkeyPatch, errors: Any, arc: Any, grids: Any, known: Any
) -> None:
    """Flights off by so many accuracies; signs that do not agree send what is known to the longer way, once."""
    accuracy, seen = 1e-4, []
    left = [e if e is None else Planned(e * accuracy, arc) for e in errors]

    def optimum(*rest: Any) -> Any:
        seen.append(rest[-1] // n.FLOW_INITIAL_STEPS)
        return left.pop(0)

    def near(_: Any, __: Any, ___: Any, step: Any, ____: float, steps: int) -> Any:
        if isinstance(step, SwitchStep):
            return Planned(0.0, (0, 1.0, 2.0))
        seen.append(steps // n.FLOW_INITIAL_STEPS)
        return left.pop(0)

    for name, answer in (
        ("_fits", lambda *_: True), ("_switches", lambda *_: None), ("_optimum", optimum), ("_near", near),
        ("_structure", lambda *_: "structure"),
    ):  # fmt: skip
        monkeypatch.setattr(n, name, answer)
    problem = cart()
    found = n.settle_flow(solution(problem, phase(problem)), None, accuracy, known)  # type: ignore[arg-type]
    assert (found is not None) is (grids is not None)
    if grids:
        assert found is not None and found[0] == "structure" and seen == grids
        assert found[1].error == errors[-1] * accuracy
