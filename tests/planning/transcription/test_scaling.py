"""Scales that the solver rests on: what they are, and that problems which bad scales break are solved."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.internals import (
    NEARBY_SHIFT,
    UNBOUNDED_STATE_MAX_RATIO,
    Scheme,
    Transcription,
    build_nlp_point_from_guess,
    choose_row_scales,
    choose_variable_scales,
    estimate_state_and_control_magnitudes,
)
from testing.models import dynamics, one_phase

import gnc_opt as go


def double_integrator(**control_bounds: tuple[float, float]) -> tuple[go.Problem, go.Phase]:
    model, *_ = dynamics("double integrator", "x v", "u", lambda x, v, u: {x: v, v: u})
    problem, leg = one_phase("double integrator", model, initial=0.0, final=4.0)
    leg.bounds(**control_bounds)
    return problem, leg


def test_a_control_without_bounds_and_guess_is_of_order_one() -> None:
    """The perturbation of the default guess, one per cent, is no magnitude; neither is it for the states."""
    problem, leg = double_integrator()
    leg.initial(x=0.0, v=0.0)
    states, controls = estimate_state_and_control_magnitudes(leg)
    np.testing.assert_array_equal(controls, [1.0])
    assert states[1] == pytest.approx(0.5 * 4.0)  # half of what one unit of u does in 4 s
    problem.get_phase().guess(u=(0.0, -30.0))
    np.testing.assert_array_equal(estimate_state_and_control_magnitudes(leg)[1], [30.0])


def test_bounds_and_user_come_first() -> None:
    _, leg = double_integrator(u=(-3.0, 2.0))
    leg.bounds(v=(-7.0, 5.0))
    leg.initial(x=2.0, v=0.0)
    states, controls = estimate_state_and_control_magnitudes(leg)
    assert (states[1], controls[0]) == (7.0, 3.0)
    leg.scale(v=0.25, u=11.0)
    states, controls = estimate_state_and_control_magnitudes(leg)
    assert (states[1], controls[0]) == (0.25, 11.0)


def test_a_small_guess_does_not_hide_what_the_dynamics_do() -> None:
    """v starts at 0.001 and u moves it by 4: ten times the guess is believed, which is nearer."""
    _, leg = double_integrator(u=(-2.0, 2.0))
    leg.initial(x=0.0, v=1e-3)
    assert estimate_state_and_control_magnitudes(leg)[0][1] == pytest.approx(UNBOUNDED_STATE_MAX_RATIO * 1e-3)
    leg.initial(v=1.0)
    assert estimate_state_and_control_magnitudes(leg)[0][1] == pytest.approx(4.0)
    leg.initial(v=50.0)
    assert estimate_state_and_control_magnitudes(leg)[0][1] == pytest.approx(50.0)


def test_what_zero_is_rounded_to_is_no_magnitude() -> None:
    """A flight due east: the latitude of the guess is 1e-17, its rate too. What moves it nearby tells."""
    model = go.Model("point over a sphere")
    latitude, heading = model.state("latitude", unit="rad"), model.state("heading", unit="rad")
    turn = model.control("turn", unit="rad/s")
    model.ode({latitude: 1e-3 * ca.cos(heading), heading: turn})
    problem, leg = one_phase("east", model, initial=0.0, final=100.0)
    leg.bounds(turn=(-0.01, 0.01))
    leg.initial(latitude=0.0, heading=np.pi / 2)
    nearby = estimate_state_and_control_magnitudes(leg)[0][0]
    assert 1e-4 < nearby < 0.1  # 1e-3 rad/s for 100 s at most
    flown = problem.with_guess("leg", latitude=(0.0, 6e-18), heading=np.pi / 2)
    assert estimate_state_and_control_magnitudes(flown.get_phase())[0][0] == pytest.approx(nearby, rel=1e-6)
    best = 1e-3 * (1 - np.cos(0.01 * 100.0)) / 0.01  # turning at the limit all the time
    problem.maximize(leg.final_state("latitude"))
    found = go.solve(
        problem.with_guess("leg", latitude=(0.0, 6e-18), heading=np.pi / 2), mesh="6x6", tol=None
    )
    assert found.objective == pytest.approx(best, rel=1e-8)


def test_wheels_that_cancel_each_other_at_their_bounds_tell_how_fast_the_body_turns() -> None:
    """Four wheels on the corners of a pyramid: together they turn about its axis, one alone about all three."""
    model = go.Model("wheels")
    w, T = model.state("w", 3, unit="rad/s"), model.control("T", 4, unit="N m")
    lean, around = np.deg2rad(35.26), np.deg2rad([45.0, 135.0, 225.0, 315.0])
    axes = np.array([np.cos(lean) * np.cos(around), np.cos(lean) * np.sin(around), np.full(4, np.sin(lean))])
    inertia = np.array([120.0, 100.0, 80.0])
    model.ode({w: ca.DM(axes / inertia[:, None]) @ T})
    leg = go.Problem("spin").phase("leg", model)
    leg.time(initial=0.0, final=10.0)
    leg.initial(w=[0.0, 0.0, 0.0])
    leg.bounds(T=(-0.2, 0.2))
    assert np.max(np.abs(axes[:2] @ np.ones(4))) < 1e-15
    states, _ = estimate_state_and_control_magnitudes(leg)
    about = np.array([axes[0, 0], axes[1, 0], 4.0 * axes[2, 0]])  # of one wheel alone, and of all four
    np.testing.assert_allclose(states, 0.5 * 10.0 * 0.2 * about / inertia, rtol=1e-12)


def test_a_path_constraint_of_a_free_parameter_implies_no_magnitude() -> None:
    problem, leg = double_integrator()
    most = problem.parameter("most", lower=1.0, upper=9.0)
    leg.path("limit", leg.model.symbol("u") - most, upper=0.0)
    np.testing.assert_array_equal(estimate_state_and_control_magnitudes(leg)[1], [1.0])


def test_a_guess_that_tracks_perfectly() -> None:
    """The gradient of the tracking cost is rounding at the guess: its inverse is no scale for the cost."""
    problem, leg = double_integrator(u=(-10.0, 10.0))
    model = leg.model
    x, v = model.symbol("x"), model.symbol("v")
    leg.time(initial=0.0, final=3.0)
    leg.initial(x=0.0, v=0.7)
    leg.final(v=0.0)
    leg.guess(x=(0.0, 2.1), v=0.7)
    problem.minimize(leg.integral(100 * (x - 0.7 * model.time) ** 2 + 500 * (v - 0.7) ** 2))
    solution = go.solve(problem, options=go.SolverOptions(max_iterations=50), tol=None)
    # The track is followed until full brake for 0.07 s: 500 times the integral of (10 s)^2. The mesh is coarse for it.
    assert solution.objective == pytest.approx(500 * 100 * 0.07**3 / 3, rel=0.1)


def test_state_that_sums_up_an_unbounded_control() -> None:
    """Bryson-Denham as Mayer problem: q collects u^2/2, both unknown to the guess; J = 4 / (9 l) = 4."""
    model, *_ = dynamics("Bryson-Denham", "x v q", "u", lambda x, v, q, u: {x: v, v: u, q: u**2 / 2})
    problem, leg = one_phase("Bryson-Denham", model, initial=0.0, final=1.0)
    leg.initial(x=0.0, v=1.0, q=0.0)
    leg.final(x=0.0, v=-1.0)
    leg.bounds(x=(None, 1 / 9))
    problem.minimize(leg.final_state("q"))
    for mesh in ("30x4", "60x4"):  # with nodes on entry and exit, so that 4 is exact
        solution = go.solve(problem, mesh=mesh, options=go.SolverOptions(max_iterations=60), tol=None)
        assert solution.objective == pytest.approx(4.0, abs=1e-8)


def test_the_barrier_does_not_cost_digits() -> None:
    """t_f of 240 nodes on their bounds is right to 1e-9; with mu = 1e-9 it was 1.5e-8 too long."""
    problem, leg = double_integrator(u=(-2.0, 1.0))
    leg.time(initial=0.0, final=(1.0, 100.0))
    leg.initial(x=0.0, v=0.0)
    leg.final(x=300.0, v=0.0)
    problem.minimize(leg.final_time)
    solution = go.solve(problem, mesh="60x4", tol=None)
    assert solution.objective == pytest.approx(30.0, rel=1e-9)


def test_a_steep_hamiltonian_does_not_fail_a_good_control() -> None:
    """Zermelo's problem, right to 1e-12: between nodes the heading is off by 1e-6 of its range, not more."""
    model = go.Model("boat")
    x, y, heading = model.state("x"), model.state("y"), model.control("heading")
    model.ode({x: ca.cos(heading) - y, y: ca.sin(heading)})
    problem, leg = one_phase("Zermelo", model, initial=0.0, final=(0.5, 20.0))
    leg.initial(x=3.66, y=-1.86)
    leg.final(x=0.0, y=0.0)
    leg.bounds(heading=(-2 * np.pi, 2 * np.pi))
    leg.guess(time=[0.0, 5.0], heading=0.75 * np.pi)
    problem.minimize(leg.final_time)
    solution = go.solve(problem, tol=None)
    assert solution.objective == pytest.approx(5.457865263560509, rel=1e-11)
    verdict = go.verify(solution)
    assert verdict.ok, verdict.explain()


def scales_of(problem: go.Problem) -> tuple[Transcription, np.ndarray, float]:
    """The transcription on one segment of three points, its row scales and the objective's, at the problem's guess."""
    transcription = Transcription(problem, {"leg": go.Mesh.uniform(1, 3)}, "LG")
    start = build_nlp_point_from_guess(transcription, problem)
    rows, objective = choose_row_scales(
        transcription, problem, start, choose_variable_scales(transcription, problem, start)
    )
    return transcription, rows, objective


@pytest.mark.parametrize("price", [1e-4, 0.03, 1.0, 500.0, -500.0])
def test_the_steepest_derivative_of_the_scaled_objective_is_one(price: float) -> None:
    """d(price t_f) over t_f's magnitude, that of its guess, the middle of the range."""
    problem, leg = double_integrator(u=(-3.0, 2.0))
    leg.time(0.0, (1.0, 40.0))
    problem.minimize(price * leg.final_time)
    assert scales_of(problem)[2] == pytest.approx(1 / (abs(price) * 20.5), rel=1e-12)


def test_an_objective_without_slope_keeps_its_scale() -> None:
    problem, leg = double_integrator(u=(-3.0, 2.0))
    problem.minimize(0 * leg.final_state("x"))
    assert scales_of(problem)[2] == 1.0


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e-3])
@pytest.mark.parametrize("guess", [0.0, 0.05, -0.05])
def test_a_slope_that_vanishes_at_the_guess_is_seen_nearby(unit: float, guess: float) -> None:
    """u^2 in any unit: its slope 2 u vanishes at u = 0; a tenth of u's magnitude of 5 further it is at most 1."""
    problem, leg = double_integrator(u=(-5.0, 5.0))
    leg.guess(u=guess)
    leg.path("square", unit * leg.model.symbol("u") ** 2, upper=9.0 * unit)
    problem.minimize(leg.final_state("x"))
    transcription, rows, _ = scales_of(problem)
    slopes = 1 / (rows[transcription.parts["leg"].collocation.path_rows] * unit * 5.0)
    assert np.all(slopes <= 2 * (abs(guess) + NEARBY_SHIFT * 5.0))
    assert np.max(slopes) > (0.1 if guess == 0.0 else 2 * abs(guess))
    assert np.all(slopes >= 2 * abs(guess) * (1 - 1e-9))


@pytest.mark.parametrize(
    ("scheme", "points"),
    [
        ("LG", ["point 1", "point 2", "point 3", "end"]),
        ("LGR", ["point 1", "point 2", "point 3"]),
        ("LGL", ["point 2", "point 3"]),
    ],
)
def test_rows_are_called_by_their_points(scheme: Scheme, points: list[str]) -> None:
    """Every row of the dynamics by state and point; Lobatto's first row is its second point."""
    problem, leg = double_integrator(u=(-5.0, 5.0))
    problem.minimize(leg.final_state("x"))
    labels = Transcription(problem, {"leg": go.Mesh.uniform(2, 3)}, scheme).constraint_row_labels
    expected = [
        f"{state} defect, phase leg, segment {k}, {p}" for k in (1, 2) for p in points for state in ("x", "v")
    ]
    assert list(labels[: len(expected)]) == expected
