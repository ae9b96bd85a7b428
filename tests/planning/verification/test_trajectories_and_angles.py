"""Trajectories given as samples, and states that are angles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from testing.internals import Interval
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning.optimality.trajectory_interpolation import (
    FittedPhase,
    SampledPhase,
    _build_control_interpolants,
    _ControlFit,
    _find_curve_intersection,
    _Jump,
    _propagate_states,
    fit_trajectory_polynomials,
)
from gnc_opt.planning.problem.angle_valued_controls import UnboundedAngles

# Polynomials through samples of known trajectories: values, and the places of jumps and kinks.


Array = NDArray[np.float64]


def pushed(t: Array, x: Array, u: Array) -> Array:
    """x' = u, y' = w + t^2."""
    return np.array([u[0], u[1] + t**2]) + 0 * x


def test_runge_kutta_is_exact_for_cubics_in_time() -> None:
    """x' = t^3 from a = (-1, 0.5) to b = (2, 3)."""
    a, b = np.array([-1.0, 0.5]), np.array([2.0, 3.0])
    ends = _propagate_states(
        np.array([[1.0, 2.0]]), a, b, lambda t, m: np.zeros((1, 2)), lambda t, x, u: t**3 + 0 * x
    )
    np.testing.assert_allclose(ends, [[1.0, 2.0] + (b**4 - a**4) / 4], rtol=1e-13)


def test_runge_kutta_multiplies_by_the_exponential_series_to_fourth_order() -> None:
    """x' = -2 x + u in four steps over 2 s, u = 3 where the middle of the interval is 1 s."""
    z = -2.0 * 0.5
    factor = (1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24) ** 4
    ends = _propagate_states(
        np.array([[5.0]]),
        np.zeros(1),
        np.full(1, 2.0),
        lambda t, m: 3.0 * m + 0 * t,
        lambda t, x, u: -2 * x + u,
    )
    np.testing.assert_allclose(ends, [[1.5 + 3.5 * factor]], rtol=1e-13)


@pytest.mark.parametrize("n", [2, 3, 4, 7])
def test_interpolants_are_exact_for_polynomials_of_their_degree(n: int) -> None:
    t = np.linspace(1.0, 3.0, n) ** 2
    degree = n - 1 if n < 4 else 5 if n > 5 else 3
    u = (t - 2.0) ** degree
    smooth, _ = _build_control_interpolants(t, u)
    at = np.linspace(1.0, 9.0, 11)
    np.testing.assert_allclose(smooth(at), (at - 2.0) ** degree, atol=1e-9)


def test_where_two_lines_meet() -> None:
    def line(slope: float, zero: float) -> Any:
        return lambda t: slope * (t - zero)

    assert _find_curve_intersection(line(1.0, 0.0), line(-1.0, 1.0), 0.0, 2.0, 1e-9) == pytest.approx(0.5)
    assert _find_curve_intersection(line(-1.0, 0.0), line(1.0, 1.0), 0.0, 2.0, 1e-9) == pytest.approx(0.5)
    assert _find_curve_intersection(line(1.0, 0.0), line(-1.0, 1.0), 0.6, 2.0, 1e-9) is None
    assert _find_curve_intersection(line(1.0, 0.0), line(1.0, 1.0), 0.0, 2.0, 1e-9) is None
    # Within the slack of an end, at the end.
    assert _find_curve_intersection(line(1.0, 0.0), line(-1.0, 1.0), 0.49, 2.0, 0.03) == 0.49
    assert _find_curve_intersection(line(1.0, 0.0), line(-1.0, 1.0), -3.0, 0.51, 0.03) == 0.51
    assert _find_curve_intersection(line(1.0, 0.0), line(-1.0, 1.0), 0.49, 2.0, 0.01) == pytest.approx(0.5)


def flown(
    t: Array, switches: tuple[float, float] = (0.55, 1.13), levels: Array | None = None
) -> SampledPhase:
    """u jumps from 1 to -2, w from 0.5 to 2.5; states from the integrals."""
    (s, r), (a, b, c, d) = switches, (1.0, -2.0, 0.5, 2.5) if levels is None else levels
    u = np.array([np.where(t <= s, a, b), np.where(t <= r, c, d)])
    x = np.array(
        [a * np.minimum(t, s) + b * np.maximum(t - s, 0), c * np.minimum(t, r) + d * np.maximum(t - r, 0)]
    )
    x[1] += t**3 / 3
    return SampledPhase(t, x, u)


def jumps_of(fitted: FittedPhase, t: Array) -> Array:
    """Times of the movable breaks."""
    return t[0] + np.array(fitted.mesh.breaks)[list(fitted.mesh.movable)] * (t[-1] - t[0])


def check(fitted: FittedPhase, switches: tuple[float, float], last: float) -> None:
    """States and controls between the samples are those of `flown`."""
    at = np.linspace(0.0, last, 203)[1:-1]
    exact = flown(at, switches)
    np.testing.assert_allclose(fitted.x(at), exact.x, atol=1e-9)
    np.testing.assert_allclose(fitted.u(at), exact.u, atol=1e-9)


@pytest.mark.parametrize(
    "switches", [(0.55, 1.13), (1.13, 0.55), (0.84, 0.91), (0.91, 0.84), (0.5, 1.13), (0.1, 1.9)]
)
def test_jumps_between_samples(switches: tuple[float, float]) -> None:
    """Apart, both between the same two samples, at a sample, or in the first and the last interval."""
    t = np.linspace(0.0, 2.0, 9)
    fitted = fit_trajectory_polynomials(flown(t, switches), pushed)
    np.testing.assert_allclose(jumps_of(fitted, t), sorted(switches), atol=1e-9)
    check(fitted, switches, 2.0)
    breaks = np.union1d(t, switches) / 2
    np.testing.assert_allclose(fitted.mesh.breaks, breaks, atol=1e-9)
    np.testing.assert_allclose(fitted.x.breaks, 2 * breaks, atol=1e-9)
    assert fitted.mesh.degrees == (4,) * (breaks.size - 1)


def test_jump_in_the_first_and_in_the_last_interval() -> None:
    t = np.linspace(0.0, 2.0, 9)
    fitted = fit_trajectory_polynomials(flown(t, (0.1, 1.9)), pushed)
    np.testing.assert_allclose(jumps_of(fitted, t), [0.1, 1.9], atol=1e-9)
    check(fitted, (0.1, 1.9), 2.0)


def test_jump_at_a_time_given_twice() -> None:
    """Of both controls; before it the samples are left values."""
    t = np.array([0.0, 0.3, 0.7, 0.7, 1.1, 1.6, 2.0])
    early = np.array([True, True, True, False, False, False, False])
    samples = flown(t, (0.7, 0.7))
    u = np.where(early, [[1.0], [0.5]], [[-2.0], [2.5]])
    fitted = fit_trajectory_polynomials(SampledPhase(t, samples.x, u), pushed)
    np.testing.assert_allclose(jumps_of(fitted, t), [0.7])
    assert fitted.mesh.breaks == tuple(np.unique(t) / 2)
    check(fitted, (0.7, 0.7), 2.0)


def test_states_that_jump_keep_both_values() -> None:
    """At a time given twice the left polynomial ends with the first, the right one begins with the second."""
    t = np.array([0.0, 0.5, 1.0, 1.0, 1.5, 2.0])
    x = np.where(np.arange(6) < 3, 0.0, 7.0)[None]
    fitted = fit_trajectory_polynomials(SampledPhase(t, x, np.zeros((1, 6))), lambda t, x, u: 0 * x)
    assert fitted.x(1.0, "left")[0] == pytest.approx(0.0) and fitted.x(1.0)[0] == pytest.approx(7.0)


def test_few_samples_small_steps_and_rounding_have_no_jumps() -> None:
    """Three samples have nothing to compare with, a step of a thousandth of the range is none, nor a smooth change."""

    def count_jumps(t: Array, u: Array, x: Array | None = None, least: float = 0.0) -> int:
        samples = SampledPhase(t, u[None] if x is None else x, u[None])
        return len(fit_trajectory_polynomials(samples, lambda t, x, u: u, least).mesh.movable)

    t = np.array([0.0, 1.0, 2.0])
    assert fit_trajectory_polynomials(flown(t), pushed).mesh.movable == ()
    t = np.linspace(0.0, 2.0, 11)
    small = np.where(t <= 0.5, 0.0, 1e-4) + np.where(t <= 1.5, 0.0, 1.0)
    x = np.array([1e-4 * np.maximum(t - 0.5, 0) + np.maximum(t - 1.5, 0)])
    assert count_jumps(t, small, x) == 1 and count_jumps(t, 0.125 * 9.0 ** np.arange(11)) == 0
    rounded = 20.0 + 4e-15 * (np.arange(20) % 4 > 1)
    t = np.repeat(t, 2)[1:-1]
    assert count_jumps(t, rounded[:20]) == 9 and count_jumps(t, rounded, least=2e-8) == 0
    assert count_jumps(t, (t - 0.9) ** 2) == 0  # equal before and after a time given twice


def kinked(t: Array, kinks: tuple[float, float]) -> tuple[Array, Array]:
    """u = |t - s|, w = -2 |t - r|, and their integrals."""
    away = np.array([t - kinks[0], t - kinks[1]])
    weights = np.array([[1.0], [-2.0]])
    return weights * np.abs(away), weights * away * np.abs(away) / 2


@pytest.mark.parametrize("kinks", [(0.93, 2.04), (2.04, 0.93), (1.0, 2.04), (0.93, 2.0)])
def test_kinks_lie_where_both_sides_meet(kinks: tuple[float, float]) -> None:
    """Between samples or at one; they are no jumps, whose times might be varied."""
    t = np.linspace(0.0, 3.0, 31)
    u, x = kinked(t, kinks)
    fitted = fit_trajectory_polynomials(SampledPhase(t, x, u), lambda t, x, u: u + 0 * x)
    at = np.linspace(0.0, 3.0, 211)[1:-1]
    u, x = kinked(at, kinks)
    np.testing.assert_allclose(fitted.u(at), u, atol=1e-9)
    np.testing.assert_allclose(fitted.x(at), x, atol=1e-9)
    np.testing.assert_allclose(3 * np.array(fitted.mesh.breaks), np.union1d(t, kinks), atol=1e-9)
    assert fitted.mesh.movable == ()


def test_two_kinks_of_one_control() -> None:
    """The first is found from the samples up to the second, beyond which a spline would ripple."""
    t = np.linspace(0.0, 3.0, 31)
    u, x = (
        np.abs(t - 0.93) - 2 * np.abs(t - 2.04),
        (t - 0.93) * np.abs(t - 0.93) / 2 - (t - 2.04) * np.abs(t - 2.04),
    )
    fitted = fit_trajectory_polynomials(SampledPhase(t, x[None], u[None]), lambda t, x, u: u + 0 * x)
    np.testing.assert_allclose(3 * np.array(fitted.mesh.breaks), np.union1d(t, [0.93, 2.04]), atol=1e-9)


def test_kink_after_a_jump_of_the_same_control() -> None:
    """Counted from the jump's own samples; another control has neither."""
    t = np.linspace(0.0, 3.0, 31)
    u = np.where(t <= 0.95, 5.0, np.abs(t - 2.04))
    after = 0.5 * (t - 2.04) * np.abs(t - 2.04) + 0.5 * 1.09**2
    x = np.where(t <= 0.95, 5 * t, 5 * 0.95 + after)
    both = SampledPhase(t, np.array([t**2 / 2, x]), np.array([t, u]))
    fitted = fit_trajectory_polynomials(both, lambda t, x, u: u + 0 * x)
    np.testing.assert_allclose(jumps_of(fitted, t), [0.95], atol=1e-7)
    np.testing.assert_allclose(3 * np.array(fitted.mesh.breaks), np.union1d(t, [0.95, 2.04]), atol=1e-7)
    at = np.array([0.97, 1.5, 2.02, 2.05, 2.95])
    np.testing.assert_allclose(fitted.u(at), [at, np.abs(at - 2.04)], atol=1e-6)


def test_the_interpolant_is_the_one_that_carries_the_states() -> None:
    """Beside a kink that is not located, splines ripple; where the control is smooth, they are the closer ones."""
    t = np.array([0.0, 0.4, 0.8, 1.2, 1.6, 2.0, 2.4])
    s = 1.2
    u, x = np.maximum(t - s, 0.0), np.maximum(t - s, 0.0) ** 2 / 2
    samples = SampledPhase(t, np.array([x, t]), u[None])  # time says nothing of either
    controls = _ControlFit(samples, [])
    controls.choose_control_interpolation(samples, lambda t, x, u: np.array([u[0], 1 + 0 * t]))
    at = np.array([0.2, 0.6])
    assert np.max(np.abs(_build_control_interpolants(t, u)[0](at))) > 1e-3  # the ripples
    np.testing.assert_allclose(controls(at, at)[0], 0.0, atol=1e-12)
    smooth = SampledPhase(t, np.array([t**4 / 4]), (t**3)[None])
    controls = _ControlFit(smooth, [])
    controls.choose_control_interpolation(smooth, lambda t, x, u: u + 0 * x)
    np.testing.assert_allclose(controls(at, at)[0], at**3, atol=1e-12)


def test_smooth_controls_beside_others_at_rounding_level() -> None:
    """Errors of idle states select no interpolant."""
    t, noise = np.linspace(0.0, 3.0, 13), 1e-30 * np.random.default_rng(3).uniform(size=(2, 13))
    samples = SampledPhase(t, np.array([np.sin(t), noise[0]]), np.array([np.cos(t), noise[1]]))
    at = t[:-1] + 0.125
    found = fit_trajectory_polynomials(samples, lambda t, x, u: u).u(at)[0]
    np.testing.assert_allclose(found, np.cos(at), atol=3e-5)


def test_controls_are_those_of_the_piece_in_whose_middle_they_are_asked() -> None:
    t = np.linspace(0.0, 4.0, 9)
    u = np.array([np.where(t <= 1.5, 1.0, 2.0), t])
    controls = _ControlFit(SampledPhase(t, u, u), [_Jump(3, 1.7, (0,))])
    np.testing.assert_allclose(controls(1.6, 1.6), [[1.0], [1.6]])
    np.testing.assert_allclose(controls(1.6, 1.8), [[2.0], [1.6]])
    np.testing.assert_allclose(controls([1.0, 3.0], [1.6, 1.8]), [[1.0, 2.0], [1.0, 3.0]])


# Angles without bounds: turns do not count, neither those of the solver nor those of other tools.


def shear(**bounds: tuple[float, float]) -> go.Problem:
    """Zermelo's boat, 1 m/s, where the current is -y (Bryson & Ho 1975, section 2.7)."""
    boat = go.Model("boat")
    x, y, heading = boat.state("x"), boat.state("y"), boat.control("heading")
    boat.ode({x: ca.cos(heading) - y, y: ca.sin(heading)})
    problem, leg = one_phase("shear", boat, 0.0, (0.1, 30.0))
    leg.initial(x=3.66, y=-1.86)
    leg.final(x=0.0, y=0.0)
    leg.bounds(**bounds)
    problem.minimize(leg.final_time)
    return problem


def space(turn: float, speed: float = 0.3, to: Sequence[float] = (1.0, 2.0, 0.7)) -> go.Problem:
    """To a point in least time with one unit of thrust along azimuth and elevation."""
    probe = go.Model("probe")
    r, v = probe.state("r", size=3), probe.state("v", size=3)
    azimuth, elevation = probe.control("azimuth"), probe.control("elevation")
    a, e = (angle * 2 * np.pi / turn for angle in (azimuth, elevation))
    probe.ode({r: v, v: ca.vertcat(ca.cos(e) * ca.cos(a), ca.cos(e) * ca.sin(a), ca.sin(e))})
    problem, leg = one_phase("space", probe, 0.0, (0.1, 30.0))
    leg.initial(r=[0.0, 0.0, 0.0], v=[speed, 0.0, 0.0])
    leg.final(r=list(to))
    problem.minimize(leg.final_time)
    return problem


@pytest.fixture(scope="module")
def crossing() -> go.Solution:
    return go.solve(shear())


def test_a_heading_runs_on_along_zermelo_s_law(crossing: go.Solution) -> None:
    assert go.verify(crossing).minimum
    t = crossing.phase("leg").sample_times()
    slope = np.tan(crossing.control("heading")(t))
    left = crossing.phase("leg").final_time - t
    np.testing.assert_allclose(slope, slope[-1] - left, atol=1e-4)
    assert np.max(np.abs(np.diff(crossing.control("heading")(t)))) < 0.2


def test_a_range_of_two_turns_is_no_limit_to_a_heading() -> None:
    found = go.solve(shear(heading=(-2 * np.pi, 2 * np.pi)))
    assert go.verify(found).minimum
    assert found.objective == pytest.approx(5.46, abs=5e-3)  # published
    heading = found.control("heading")(found.phase("leg").sample_times())
    assert np.max(np.abs(heading)) <= 2 * np.pi
    assert np.max(np.abs(np.diff(heading))) < 0.2  # by way of 180 degrees, in one go: there is room for it


def test_bounds_of_a_turn_are_no_limit_to_a_heading_that_crosses_them(
    crossing: go.Solution, tmp_path: Path
) -> None:
    problem = shear(heading=(-np.pi, np.pi))
    found = go.solve(problem)
    assert go.verify(found).minimum
    assert found.objective == pytest.approx(crossing.objective, abs=1e-8)
    t = found.phase("leg").sample_times()
    heading, free = found.control("heading")(t), crossing.control("heading")(crossing.phase("leg").breaks)
    assert np.max(np.abs(heading)) <= np.pi
    assert np.max(np.abs(np.diff(heading))) > 5  # by way of 180 degrees
    np.testing.assert_allclose(np.exp(1j * heading[[0, -1]]), np.exp(1j * free[[0, -1]]), atol=1e-4)
    kept = go.load(found.save(tmp_path / "crossing"), problem=problem)
    np.testing.assert_array_equal(kept.control("heading")(t), heading)
    assert go.verify(kept).minimum


@pytest.mark.slow
def test_what_leaves_bounds_of_a_turn_is_failed(crossing: go.Solution) -> None:
    t = np.linspace(0.0, crossing.phase("leg").final_time, 41)
    x = {name: crossing.state(name)(t) for name in ("x", "y")}
    heading = crossing.control("heading")(t)
    problem = shear(heading=(-np.pi, np.pi))
    assert not go.verify_trajectory(problem, t, x, {"heading": heading}).ok
    assert go.verify_trajectory(problem, t, x, {"heading": np.angle(np.exp(1j * heading))}).minimum


def test_bounds_that_leave_a_direction_out_are_limits() -> None:
    """Straight to where nothing but a course of 3.05 rad leads, beside which 3 rad is the nearest there is."""
    boat, *_ = dynamics("boat", "x", "heading", lambda x, heading: {x: ca.cos(heading - 3.05)})
    problem, leg = one_phase("course", boat, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(heading=(-3.0, 3.0))
    problem.maximize(leg.final_state("x"))
    found = go.solve(problem.with_guess(heading=2.0), check=False)
    assert found.objective == pytest.approx(np.cos(0.05), abs=1e-8)
    assert found.control("heading")(0.5) == pytest.approx(3.0, abs=1e-6)


def test_a_solver_has_a_turn_of_room_to_both_sides() -> None:
    turns = UnboundedAngles(np.array([-180.0, -np.inf]), np.array([180.0, np.inf]), np.array([360.0, 0.0]))
    box = turns.widen_bounds_for_solver(Interval(np.array([-np.inf, 2.0]), np.array([np.inf, 3.0])))
    assert (box.lower.tolist(), box.upper.tolist()) == ([-540.0, 2.0], [540.0, 3.0])


def test_angles_are_returned_within_their_bounds_or_as_few_turns_away_as_there_are() -> None:
    lower, upper = np.array([-180.0, -360.0, -np.inf]), np.array([180.0, 360.0, np.inf])
    turns = UnboundedAngles(lower, upper, np.array([360.0, 360.0, 0.0]))
    angles = np.array([-190.0, -180.0, -10.0, 180.0, 190.0, 370.0, -800.0])
    told = turns.wrap_angles(np.stack([angles, angles, angles]))
    assert told[0] == pytest.approx([170.0, -180.0, -10.0, 180.0, -170.0, 10.0, -80.0])
    assert told[1] == pytest.approx([-190.0, -180.0, -10.0, 180.0, 190.0, 10.0, -80.0])
    np.testing.assert_array_equal(told[2], angles)


@pytest.mark.parametrize("turn", [2 * np.pi, 360.0])
def test_a_better_heading_half_a_turn_away_is_seen(turn: float) -> None:
    """Speeds of 1.1 and 2.1 m/s at two headings, each the best of those beside it."""
    boat = go.Model("boat")
    x, heading = boat.state("x"), boat.control("heading")
    angle = heading * 2 * np.pi / turn
    boat.ode({x: 1.0 + 0.6 * ca.cos(2 * angle) - 0.5 * ca.cos(angle)})
    problem, leg = one_phase("wells", boat, 0.0, (0.1, 9.0))
    leg.initial(x=0.0)
    leg.final(x=1.0)
    problem.minimize(leg.final_time)
    share = np.linspace(0.0, 1.0, 11)
    worse = go.verify_trajectory(problem, share / 1.1, {"x": share}, {"heading": 0 * share})
    assert [c.name for c in worse.failed] == ["minimum principle"]
    better = {"heading": 0 * share + 0.5 * turn}
    assert go.verify_trajectory(problem, share / 2.1, {"x": share}, better).minimum


@pytest.mark.slow
def test_headings_within_a_turn_are_checked_as_they_run_on(crossing: go.Solution) -> None:
    t = np.linspace(0.0, crossing.phase("leg").final_time, 41)
    x = {name: crossing.state(name)(t) for name in ("x", "y")}
    heading = crossing.control("heading")(t)
    wrapped = np.angle(np.exp(1j * heading))
    assert np.max(np.abs(np.diff(wrapped))) > 5  # by way of 180 degrees
    assert go.verify_trajectory(crossing.problem, t, x, {"heading": wrapped}).minimum
    off = wrapped + 1e-2 * np.sin(t)
    assert not go.verify_trajectory(crossing.problem, t, x, {"heading": off}).ok


def test_an_integral_that_does_not_count_does_not_use_a_control() -> None:
    twin = go.Model("boat")
    x, y, heading, idle = twin.state("x"), twin.state("y"), twin.control("heading"), twin.control("idle")
    twin.ode({x: ca.cos(heading) - y, y: ca.sin(heading)})
    problem, leg = one_phase("idle", twin, 0.0, 1.0)
    leg.integral(idle**2, "told")
    problem.minimize(leg.final_state("y"))
    t = np.linspace(0.0, 1.0, 5)
    with pytest.raises(go.ProblemError, match="control 'idle' of phase 'leg'"):
        problem.check()
    with pytest.raises(go.ProblemError, match="control 'idle' of phase 'leg'"):
        go.verify_trajectory(problem, t, np.zeros((2, 5)), np.zeros((2, 5)))


@pytest.fixture(scope="module")
def waiting() -> go.Solution:
    """Two boats in the current of `shear`, the second of which has time to spare."""
    boats = go.Model("boats")
    names = "first", "second"
    x, y, heading = zip(
        *[(boats.state(f"x_{n}"), boats.state(f"y_{n}"), boats.control(n)) for n in names], strict=True
    )
    boats.ode({x[k]: ca.cos(heading[k]) - y[k] for k in (0, 1)} | {y[k]: ca.sin(heading[k]) for k in (0, 1)})
    problem, leg = one_phase("boats", boats, 0.0, (0.1, 30.0))
    leg.initial(x_first=3.66, y_first=-1.86, x_second=1.66, y_second=-0.86)
    leg.final(x_first=0.0, y_first=0.0, x_second=0.0, y_second=0.0)
    problem.minimize(leg.final_time)
    return go.solve(problem, mesh="10x4")


@pytest.mark.slow
def test_a_boat_with_time_to_spare_is_left_open_and_fails_nothing(
    waiting: go.Solution, crossing: go.Solution
) -> None:
    assert waiting.objective == pytest.approx(crossing.objective, abs=1e-8)
    verdict = go.verify(waiting)
    assert verdict.ok
    assert not verdict.minimum  # it may take any way


@pytest.mark.slow
def test_along_the_pole_any_azimuth_will_do() -> None:
    """2 m straight up from rest to any speed, in 2 s; what H curves by in the azimuth is rounding."""
    problem = space(2 * np.pi, speed=0.0, to=[0.0, 0.0, 2.0])
    found = go.solve(problem, mesh="10x4")
    assert found.objective == pytest.approx(2.0, abs=1e-8)
    assert go.verify(found).ok
