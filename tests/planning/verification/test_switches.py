"""Switches of bang-bang controls by hand: where they are, in which orders they come, and how steeply."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from testing import constructed_solutions as by_hand
from testing.internals import PhaseSamples, obstacle, strict_switches

import gnc_opt as go
from gnc_opt.planning import ArcKind, ConditionResult
from gnc_opt.planning.optimality.switches import GRAZES, Switches, _joined
from gnc_opt.planning.verification.bang_bang_second_order import is_bang_bang
from gnc_opt.planning.verification.reduced_hessian import _jumping_control, _partly_singular, _rich
from gnc_opt.planning.verification.verify_trajectory import _arcs

Slopes = tuple[Callable[[Any], Any], ...]

ENDS = np.array([0.0, 0.8, 1.4, 2.0])
"""u is 1, -1, 1 between them; w is -2, -2, 3."""

U = ((1.0, -1.0, 1.0), (-2.0, -2.0, 3.0))


def two_ways() -> go.Problem:
    model = go.Model("two ways")
    x, y, z = model.state("x"), model.state("y"), model.state("z")
    u, w, v = model.control("u"), model.control("w"), model.control("v")
    model.ode({x: u, y: w, z: v})
    problem = go.Problem("two ways")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    problem.minimize(leg.final_state("x"))
    return problem


def flight(
    of_u: Slopes,
    of_w: Slopes,
    controls: Any = U,
    upper: float = 1.0,
    level: float = 1.0,
    second: float = 1.0,
    cost: float = 1.0,
) -> PhaseSamples:
    """Switching functions of u and w segment by segment; a third control, v, rests at the bound ``upper``.

    ``second`` and ``cost`` are the units of time and of the costates.
    """

    def costates(t: Any, k: int) -> Any:
        t = t / second
        return cost * np.stack([of_u[k](t) + 0 * t, of_w[k](t) + 0 * t, -level + 0 * t])

    def pushes(t: Any, k: int) -> Any:
        return np.stack([controls[0][k] + 0 * t, controls[1][k] + 0 * t, upper + 0 * t])

    def states(t: Any, k: int) -> Any:
        return np.stack([t, t, t])

    bounds = by_hand.interval([-1.0, -2.0, 0.0], [1.0, 3.0, upper])
    return by_hand.samples(
        two_ways(), states, pushes, costates, weights=(), breaks=second * ENDS, control_bounds=bounds
    )


def arch(c: float) -> Callable[[Any], Any]:
    """Slope 0.6 c at 0.8 s, steeper at 1.4 s."""
    return lambda t: c * (t - 0.8) * (1.4 - t) * (t + 0.2)


def line(slope: float, zero: float) -> Callable[[Any], Any]:
    return lambda t: slope * (t - zero)


FALLS = (line(-7.0, 1.4),) * 3


@pytest.mark.parametrize(
    ("slopes", "least", "time"),
    [((5.0, 10.0, 2.0), 2.0, 1.4), ((5.0, 2.0, 3.0), 1.2, 0.8), ((1.0, 10.0, 2.0), 1.0, 0.8)],
)
def test_least_slope_on_either_side_of_a_switch(
    slopes: tuple[float, float, float], least: float, time: float
) -> None:
    """Over 2 s and the range 2 of u, in shares of H."""
    before, between, after = slopes
    s = flight((line(before, 0.8), arch(between), line(-after, 1.4)), FALLS)
    condition = strict_switches([s])
    assert condition.result is ConditionResult.PASS and condition.sufficient
    assert condition.value == pytest.approx(-least * 2.0 * 2.0 / s.hamiltonian_scale, rel=1e-3)
    assert condition.tolerance == -GRAZES
    assert condition.where == f"phase leg, t = {time:g} s, u"


def test_slope_of_the_wrong_sign() -> None:
    """All are; that of w over its range of 5 is the steepest."""
    s = flight((line(-5.0, 0.8), arch(-10.0), line(2.0, 1.4)), (line(7.0, 1.4),) * 3)
    condition = strict_switches([s])
    assert condition.result is ConditionResult.FAIL
    assert condition.value == pytest.approx(7.0 * 5.0 * 2.0 / s.hamiltonian_scale, rel=1e-3)
    assert condition.where == "phase leg, t = 1.4 s, w"


def test_the_worst_of_several_phases_counts() -> None:
    """The least slope of all, whichever comes first."""
    good = flight((line(5.0, 0.8), arch(10.0), line(-5.0, 1.4)), FALLS)
    bad = flight((line(-5.0, 0.8), arch(-10.0), line(2.0, 1.4)), FALLS)
    for pair in ([good, bad], [bad, good]):
        assert strict_switches(pair).result is ConditionResult.FAIL
    assert strict_switches([good, good]).result is ConditionResult.PASS


def test_a_slope_of_zero_is_not_told() -> None:
    """A cubic zero has the right sign on both sides, and no slope."""
    flat = flight((lambda t: 5 * (t - 0.8) ** 3, arch(10.0), line(-5.0, 1.4)), FALLS)
    condition = strict_switches([flat])
    assert condition.result is ConditionResult.INCONCLUSIVE and condition.where == "phase leg, t = 0.8 s, u"


@pytest.mark.parametrize(
    ("slope", "result"), [(1.4e-5, ConditionResult.INCONCLUSIVE), (5e-5, ConditionResult.FAIL)]
)
def test_a_slope_of_the_wrong_sign_that_is_worth_nothing_is_not_told(
    slope: float, result: ConditionResult
) -> None:
    """The first one makes 2e-6 of H per phase and 8e-7 of H up to the switch: zero within the errors of costates."""
    s = flight((line(-slope, 0.8), arch(-slope), line(-5.0, 1.4)), FALLS)
    condition = strict_switches([s])
    assert condition.result is result
    assert condition.value == pytest.approx(slope * 2.0 * 2.0 / s.hamiltonian_scale, rel=1e-3)
    assert condition.where.startswith("phase leg, t = 0.8 s, u")


def touching(t: Any) -> Any:
    return 100 * (t - 0.8) * (1.4 - t) * (t - 1.1) ** 2


def test_zero_that_is_touched_between_switches() -> None:
    s = flight((line(5.0, 0.8), touching, line(-5.0, 1.4)), FALLS)
    condition = strict_switches([s])
    assert (condition.result, condition.value, condition.tolerance) == (
        ConditionResult.INCONCLUSIVE,
        0.0,
        0.0,
    )
    assert (
        condition.where == "phase leg, t = 1.1 s, u: touches zero between switches" and condition.sufficient
    )
    # A slope of the wrong sign weighs more.
    assert (
        strict_switches([flight((line(-5.0, 0.8), touching, line(-5.0, 1.4)), FALLS)]).result
        is ConditionResult.FAIL
    )


@pytest.mark.parametrize(("second", "cost"), [(1e-3, 1.0), (1e4, 1.0), (1.0, 1e-8), (1.0, 1e8)])
def test_slopes_and_touches_do_not_depend_on_units(second: float, cost: float) -> None:
    units = {"second": second, "cost": cost}
    touch, slopes = (line(5.0, 0.8), touching, line(-5.0, 1.4)), (line(5.0, 0.8), arch(10.0), line(-2.0, 1.4))
    assert strict_switches([flight(touch, FALLS, **units)]).result is ConditionResult.INCONCLUSIVE
    assert strict_switches([flight(slopes, FALLS, **units)]).value == pytest.approx(
        strict_switches([flight(slopes, FALLS)]).value, rel=1e-6
    )


def test_a_zero_right_beside_its_own_switch_is_judged_by_its_slope() -> None:
    """The first sample after 0.8 s lies less than a ten-thousandth of the phase beyond it."""
    ends = np.array([0.0, 0.8, 0.81, 2.0])
    s = flight((line(5.0, 0.8),) * 3, FALLS)
    beside = by_hand.samples(
        two_ways(),
        lambda t, k: np.stack([t, t, t]),
        lambda t, k: np.stack([1 - 2.0 * (k > 0) + 0 * t, -2 + 0 * t, 1 + 0 * t]),
        lambda t, k: np.stack([5 * (t - 0.8) if k != 1 else 5 * (t - 0.8) * (t - 0.80008) ** 2, 9 - t, -1 + 0 * t]),
        weights=(), breaks=ends, control_bounds=s.leg.control_bounds,
    )  # fmt: skip
    assert np.min(np.diff(beside.times[beside.segments == 1])) < 1e-4 * 2.0
    assert "touches" not in strict_switches([beside]).where


def test_zero_that_is_touched_where_another_control_switches() -> None:
    """u stays at -1 while w switches at 1.4 s."""
    once = ((1.0, -1.0, -1.0), (-2.0, -2.0, 3.0))
    touch = (line(5.0, 0.8), lambda t: 5 * (t - 0.8) * (1.4 - t) ** 2, lambda t: 5 * (t - 1.4) ** 2)
    condition = strict_switches([flight(touch, FALLS, once)])
    assert condition.result is ConditionResult.INCONCLUSIVE
    assert condition.where == "phase leg, t = 1.4 s, u: touches zero between switches"


def test_touched_without_any_switch() -> None:
    still = ((-1.0,) * 3, (-2.0,) * 3)
    away, touch = (lambda t: 1.0 + 0 * t,) * 3, (lambda t: (t - 1.1) ** 2,) * 3
    assert strict_switches([flight(touch, away, still)]).result is ConditionResult.INCONCLUSIVE
    condition = strict_switches([flight(away, away, still)])
    assert (condition.result, condition.value, condition.tolerance) == (ConditionResult.PASS, 0.0, 0.0)
    assert condition.where == "no switch" and condition.sufficient


def test_what_touches_zero_matters_only_for_a_control_with_a_range_and_on_it() -> None:
    """v has no range and a switching function of zero; u is between its bounds in a segment."""
    crossing = (line(5.0, 0.8), arch(10.0), line(-5.0, 1.4))
    assert strict_switches([flight(crossing, FALLS, upper=0.0, level=0.0)]).result is ConditionResult.PASS
    between = ((1.0, 0.5, 1.0), (-2.0, -2.0, 3.0))
    away = (lambda t: t, lambda t: (t - 1.1) ** 2, lambda t: t)
    assert strict_switches([flight(away, FALLS, between)]).result is ConditionResult.PASS


def test_switches_and_those_that_may_come_in_from_the_ends() -> None:
    """w's switching function vanishes at the end, u's at the start."""
    late = (line(-7.0, 1.4), line(-7.0, 1.4), lambda t: 7 * (t - 1.4) * (t - 2.0))
    switches = Switches.of(flight((line(5.0, 0.8), arch(10.0), line(-5.0, 1.4)), late))
    np.testing.assert_allclose(switches.times, [0.8, 1.4, 1.4, 2.0])
    np.testing.assert_array_equal(switches.channels, [0, 0, 1, 1])
    np.testing.assert_allclose(switches.first, [1.0, -2.0, 1.0])
    np.testing.assert_allclose(switches.toggled, [0.0, 1.0, 1.0])
    np.testing.assert_allclose(switches.ends, [0.0, 2.0])
    assert switches.labels[2] == "switch of w at 1.4 s"
    early = (lambda t: 5 * t * (t - 0.8), arch(10.0), line(-5.0, 1.4))
    switches = Switches.of(flight(early, FALLS))
    np.testing.assert_allclose(switches.times, [0.0, 0.8, 1.4, 1.4])
    np.testing.assert_array_equal(switches.channels, [0, 0, 0, 1])
    np.testing.assert_allclose(switches.first, [-1.0, -2.0, 1.0])
    none = Switches.of(flight(early, FALLS, ((-1.0,) * 3, (-2.0,) * 3), upper=0.0, level=0.0))
    np.testing.assert_array_equal(none.channels, [0])  # v has nothing to switch between


def test_orders_pieces_and_precedences() -> None:
    late = (line(-7.0, 1.4), line(-7.0, 1.4), lambda t: 7 * (t - 1.4) * (t - 2.0))
    switches = Switches.of(flight((line(5.0, 0.8), arch(10.0), line(-5.0, 1.4)), late))
    assert switches.groups == [[0], [1, 2], [3]] and switches.n_orders == 2
    assert list(switches.orders()) == [(0, 1, 2, 3), (0, 2, 1, 3)]
    pieces = switches.pieces((0, 2, 1, 3))
    np.testing.assert_allclose(pieces.times, [0.0, 0.8, 1.4, 1.4, 2.0, 2.0])
    np.testing.assert_array_equal(pieces.unknowns, [0, 1, 3, 2, 4, 5])
    np.testing.assert_allclose(pieces.controls[0], [1, -1, -1, 1, 1])
    np.testing.assert_allclose(pieces.controls[1], [-2, -2, 3, 3, -2])
    np.testing.assert_allclose(switches.precedences((0, 2, 1, 3)), [[0, 0, 1, -1, 0, 0], [0, 0, 0, 0, -1, 1]])
    np.testing.assert_allclose(switches.precedences((0, 1, 2, 3)), [[0, 0, -1, 1, 0, 0], [0, 0, 0, 0, -1, 1]])
    single = Switches.of(
        flight((line(5.0, 0.8), arch(10.0), line(-5.0, 1.4)), (line(-7.0, 3.0),) * 3, (U[0], (-2.0,) * 3))
    )
    assert single.precedences((0, 1)).shape == (0, 4)


def test_times_that_are_nearly_equal_are_made_equal() -> None:
    times = np.array([5e-8, 0.3, 0.3 + 6e-8, 0.3 + 1.2e-7, 0.5, 1 - 5e-8])
    before = times.copy()
    joined = _joined(times, 1e-7, np.array([0.0, 1.0]))
    np.testing.assert_array_equal(joined, [0.0, 0.3, 0.3, 0.3 + 1.2e-7, 0.5, 1.0])
    np.testing.assert_array_equal(times, before)


# --- what else is made of bangs ---------------------------------------------------------------------------

STRAIGHT = (line(5.0, 0.8), arch(10.0), line(-5.0, 1.4))


def test_controls_that_jump_from_bound_to_bound_are_named() -> None:
    """H is straight in all controls; w does not jump if it stays, nor does what has no curvature in between."""
    once = ((-1.0, -1.0, -1.0), (-2.0, -2.0, 3.0))
    late = "switch times that are not variables of the mesh do not vary"
    assert _jumping_control([flight(STRAIGHT, FALLS)]) == f"phase leg, u: {late}"
    assert _jumping_control([flight(STRAIGHT, FALLS, once)]) == f"phase leg, w: {late}"
    assert _jumping_control([flight(STRAIGHT, FALLS, ((-1.0,) * 3, (-2.0,) * 3))]) == ""
    between = ((-1.0, 0.5, -1.0), (-2.0, 0.0, -2.0))
    assert _jumping_control([flight(STRAIGHT, FALLS, between)]) == ""
    assert not _partly_singular(flight(STRAIGHT, FALLS, between))  # but all along a segment
    assert not _partly_singular(flight(STRAIGHT, FALLS))


@pytest.mark.parametrize("cost", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("bend", [-1.0, 0.0, 1e-8, 1e-4, 1.0])
def test_straight_is_what_does_not_curve_upwards(bend: float, cost: float) -> None:
    """H = u + bend u^2 / 2 at the bound of u, in some unit of the cost; a millionth of H is straight."""
    model = go.Model("bent")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("bent")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    problem.minimize(leg.integral(cost * (0.5 * bend * u**2 + u)))
    s = by_hand.samples(
        problem,
        lambda t, k: np.array([t]),
        lambda t, k: np.array([1 - 2.0 * k + 0 * t]),
        lambda t, k: np.array([0 * t]),
        weights=(1.0,),
        control_bounds=by_hand.interval(-1.0, 1.0),
    )
    assert bool(_jumping_control([s])) is (bend <= 1e-8)


def test_simple_meshes_get_thirty_points() -> None:
    assert _rich(go.Mesh((0.0, 1.0), (4,))).degrees == (30,)
    fine = _rich(go.Mesh((0.0, 0.2, 0.5, 0.7, 1.0), (5, 9, 3, 8), (1, 3)))
    assert (
        fine.degrees == (8, 9, 8, 8) and fine.movable == (1, 3) and fine.breaks == (0.0, 0.2, 0.5, 0.7, 1.0)
    )


def test_arcs_of_a_trajectory_between_its_jumps() -> None:
    """Neighbours on one bound are one arc; a control between its bounds, or no jump at all, and there are none."""
    s = flight(STRAIGHT, FALLS)
    leg = replace(s.leg, mesh=go.Mesh.at_times(ENDS, 4, movable=True))
    found = [(a.channel, a.kind, a.start, a.end) for a in _arcs(leg) if a.channel != "v"]
    lower, upper = ArcKind.LOWER, ArcKind.UPPER
    assert found == [
        ("u", upper, 0.0, 0.8), ("u", lower, 0.8, 1.4), ("u", upper, 1.4, 2.0),
        ("w", lower, 0.0, 1.4), ("w", upper, 1.4, 2.0),
    ]  # fmt: skip
    assert _arcs(s.leg) == []
    between = flight(STRAIGHT, FALLS, ((1.0, -1.0, 1.0), (-2.0, 0.0, 3.0))).leg
    assert _arcs(replace(between, mesh=leg.mesh)) == []


def test_obstacles_are_told_by_their_phase() -> None:
    s = flight(STRAIGHT, FALLS)
    assert obstacle([s]) == "" and is_bang_bang([s]) and not is_bang_bang([])
    between = flight(STRAIGHT, FALLS, ((1.0, 0.25, 1.0), U[1]))
    assert obstacle([s, between]) == "phase leg, t = 0.8 s, u: a control between its bounds"
    assert not is_bang_bang([s, between])
    short = replace(s.leg, final_time=s.leg.initial_time, final_time_bounds=by_hand.interval(0.0, 9.0))
    assert obstacle([PhaseSamples.of(short, s.functions)]) == "phase leg has no length"
