"""Wheel pyramid: optimal slews against theory, tracking, flight code."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import astuple

import numpy as np
import pytest
from scipy.integrate import simpson, solve_bvp, solve_ivp

import gnc_opt as go
from benchmarks.validation.published.comparison import FlightMeasures, known
from benchmarks.validation.published.reaction_wheels import FLOWN, flight, measures, plan
from gnc_opt.spacecraft import quaternion_angle
from problems.reaction_wheels import (
    AXES,
    DESIGN_SPEED,
    INERTIA,
    INVERSE,
    NULL,
    REFERENCE,
    REST,
    build,
    published_peak_torque,
    target_quaternion,
)
from problems.reaction_wheels.control import peak_speed
from problems.reaction_wheels.optimal import MANOEUVRE, SLEWS, fastest_wheel, optimal_slew

# --- optimal slews --------------------------------------------------------------------------------------


def boundary_value_energy(manoeuvre: int, duration: float) -> float:
    """The least energy by the minimum principle alone: T = -(2/3) lam_w / J in body torques, wheels' share 3/4."""
    moments, target = np.array(INERTIA)[:, None], target_quaternion(manoeuvre)
    half = np.arccos(target[0])
    axis = target[1:] / np.sin(half)

    def rates(_: np.ndarray, y: np.ndarray) -> np.ndarray:
        q, w, lam, mu = y[:4], y[4:7], y[7:10], y[10:13]
        turn = 0.5 * np.vstack([-np.sum(q[1:] * w, axis=0), q[0] * w + np.cross(q[1:], w, axis=0)])
        # mu, the attitude's costate, is constant in inertial space
        return np.vstack([turn, -2 / 3 * lam / moments**2, -mu, -np.cross(w, mu, axis=0)])

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.concatenate([a[:4] - REST[:4], a[4:7], b[4:7], b[1:4] - target[1:]])

    t = np.linspace(0, duration, 60)
    s = t / duration
    angle, rate = half * (3 * s**2 - 2 * s**3), 12 * half * (s - s**2) / duration
    lam = -1.5 * moments**2 * np.outer(axis, 2 * half * (6 - 12 * s) / duration**2)
    mu = -np.outer(lam[:, -1] - lam[:, 0], np.ones_like(t)) / duration
    guess = np.vstack([np.cos(angle), np.outer(axis, np.sin(angle)), np.outer(axis, rate), lam, mu])
    found = solve_bvp(rates, ends, t, guess, tol=1e-11, max_nodes=20000)
    assert found.success
    fine = np.linspace(0, duration, 20001)
    torque = -2 / 3 * found.sol(fine)[7:10] / moments
    return float(simpson(0.75 * np.sum(torque**2, axis=0), x=fine))


def eigenaxis_energy(inertia: float, angle: float, duration: float) -> float:
    """Return the least energy (N^2 m^2 s) of a body with equal moments (kg m^2): a turn about one axis, in closed form.

    The least integral of the squared torque on a double integrator is 12 (J angle)^2 / duration^3, and the wheels of
    this pyramid need 3/4 of it.
    """
    return 0.75 * 12 * (inertia * angle) ** 2 / duration**3


def test_least_energy_is_that_of_the_boundary_value_problem() -> None:
    least = boundary_value_energy(3, 34.6)
    assert least == pytest.approx(REFERENCE.value, rel=1e-11)
    assert optimal_slew("energy").objective == pytest.approx(least, rel=0, abs=REFERENCE.tolerance)
    # the best turn about one axis is a little dearer, because the moments differ
    target = target_quaternion(3)
    half = np.arccos(target[0])
    moment = float(np.linalg.norm(np.array(INERTIA) * target[1:]) / np.sin(half))
    assert least < eigenaxis_energy(moment, 2 * half, 34.6) < 1.01 * least


def test_least_energy_of_equal_moments_is_an_eigenaxis_slew_in_closed_form() -> None:
    ball = build(manoeuvre=2, duration=40.0).with_parameters(inertia=(4.0, 4.0, 4.0))
    angle = 2 * float(np.arccos(target_quaternion(2)[0]))
    assert go.solve(ball, tol=1e-8, check=False).objective == pytest.approx(
        eigenaxis_energy(4.0, angle, 40.0), rel=1e-10
    )


@pytest.mark.parametrize("name", SLEWS)
def test_optimal_slews_obey_the_minimum_principle_and_the_limits(name: str) -> None:
    solution = optimal_slew(name)
    verdict = go.verify(solution)
    assert verdict.ok, verdict.explain()
    # on the speed limit the torque is between its bounds, and H is linear in it: the limit determines it
    assert {c.name for c in verdict.inconclusive} <= {"second order"}
    assert fastest_wheel(solution) <= DESIGN_SPEED * (1 + 1e-9)
    assert (fastest_wheel(solution) > DESIGN_SPEED * (1 - 1e-9)) == ("half" in name or "speed" in name)
    end = solution.phase().final_time
    assert quaternion_angle(solution.state("q")(end), target_quaternion(MANOEUVRE[name])) < 1e-9
    np.testing.assert_allclose(solution.state("omega")(end), 0.0, atol=1e-12)
    if name.startswith("energy"):
        np.testing.assert_allclose(solution.state("h")(end), 0.0, atol=1e-12)


def first_torque(target: np.ndarray) -> float:
    """Of the published law from rest, 2 K1 J q on the body, the largest of a wheel."""
    return float(np.max(np.abs(INVERSE @ (2 * 0.0316 * np.array(INERTIA) * target[1:]))))


@pytest.mark.parametrize(
    ("name", "manoeuvre", "torque", "bias"),
    [("time, small", 5, first_torque, 0.0), ("time, speed limit", 1, lambda target: 0.05, 300.0)],
)
def test_least_time_ends_at_rest_when_its_switches_are_flown_with_the_stated_torque(
    name: str, manoeuvre: int, torque: Callable[[np.ndarray], float], bias: float
) -> None:
    """Euler's equations in numbers: a torque that is 0.01 % off, or switches that are late, miss the target.

    A wheel has the stated torque, one way or the other, or none while its speed is at the limit.
    """
    target, leg = target_quaternion(manoeuvre), optimal_slew(name).phase()
    moments, limit = np.array(INERTIA), torque(target)
    ends = np.concatenate([[0.0], [t for t in leg.breaks if 0 < t < leg.final_time], [leg.final_time]])
    # 5e-4 kg m^2 each
    start = np.concatenate([REST[:4], np.zeros(3), 5e-4 * bias * 2 * np.pi / 60 * NULL])

    def flown(limit: float) -> np.ndarray:
        y = start
        for a, b in itertools.pairwise(ends):
            wheels = limit * np.round(leg.saturated_control("T")((a + b) / 2) / limit)

            def rates(_: float, y: np.ndarray, wheels: np.ndarray = wheels) -> np.ndarray:
                q, w, h = y[:4], y[4:7], y[7:]
                turn = 0.5 * np.concatenate([[-q[1:] @ w], q[0] * w + np.cross(q[1:], w)])
                momentum = moments * w + AXES @ h
                return np.concatenate([turn, (AXES @ wheels - np.cross(w, momentum)) / moments, -wheels])

            y = solve_ivp(rates, (a, b), y, rtol=1e-11, atol=1e-13).y[:, -1]
        return np.concatenate([y[1:4] - target[1:], y[4:7]])

    assert np.max(np.abs(flown(limit))) < 1e-7
    assert np.max(np.abs(flown(1.0001 * limit))) > 1e-6


def test_least_time_beats_the_best_turn_about_one_axis() -> None:
    """Bang-bang about the eigenaxis with the best null torques: t = 2 (angle / acceleration)^(1/2)."""
    target = target_quaternion(5)
    half = np.arccos(target[0])
    signed = NULL * (INVERSE @ (np.array(INERTIA) * target[1:] / np.sin(half)))
    acceleration = published_peak_torque(5) / (np.ptp(signed) / 2)
    eigenaxis = 2 * np.sqrt(2 * half / acceleration)
    assert optimal_slew("time, small").objective < eigenaxis < 1.2 * optimal_slew("time, small").objective


def test_the_slew_of_least_energy_is_flown_despite_errors() -> None:
    name = FLOWN[0]
    run, end = flight(name, noise=0.0), plan(name).phase().final_time
    assert run.outcome.status is go.RunStatus.OK
    assert np.degrees(run.attitude_error("q", at=0.0)) > 0.5
    assert np.degrees(run.attitude_error("q", at=end)) < 0.02
    assert np.degrees(run.attitude_error("q")) < 0.002
    assert peak_speed(run) < DESIGN_SPEED
    # What is left in the end holds off the disturbance of (2, -1, 1) 1e-4 N m. The regulator's stiffness is the root of
    # the ratio of its weights, of (e / 0.1 deg)^2 + (T / 0.02 N m)^2 where the wheels' T^2 is 3/4 of the body's.
    stiffness = (0.02 / np.sqrt(0.75)) / np.radians(0.1)
    assert run.attitude_error("q") == pytest.approx(np.sqrt(6) * 1e-4 / stiffness, rel=0.02)


def test_flights_are_what_another_program_makes_of_the_applied_torques() -> None:
    """Euler's equations of the true body with the wheels' momenta and the push, by Runge and Kutta's rule."""
    cases = [(FLOWN[0], law) for law in (False, True)]
    runs = [flight(name, law) for name, law in cases]
    moments = (np.array([4.0, 4.0, 3.0]) * [1.05, 0.97, 1.04])[:, None]
    push, h = np.array([[2e-4], [-1e-4], [1e-4]]), 0.05
    torques = np.stack(
        [run.applied if run.applied.shape[0] == 4 else INVERSE @ run.applied for run in runs], axis=-1
    )

    def rate(y: np.ndarray, wheels: np.ndarray) -> np.ndarray:
        q, w, momenta = y[:4], y[4:7], y[7:]
        turn = 0.5 * np.vstack([-np.sum(q[1:] * w, axis=0), q[0] * w + np.cross(q[1:], w, axis=0)])
        body = AXES @ wheels + push - np.cross(w, moments * w + AXES @ momenta, axis=0)
        return np.vstack([turn, body / moments, -wheels])

    y = np.stack([run.states[:, 0] for run in runs], axis=-1)
    turned = np.degrees([quaternion_angle(q, REST[:4]) for q in y[:4].T])
    np.testing.assert_allclose(turned, np.linalg.norm([0.3, -0.4, 0.2]), rtol=1e-4)
    path = [y]
    for k in range(torques.shape[1]):
        u = torques[:, k]
        k1 = rate(y, u)
        k2 = rate(y + h / 2 * k1, u)
        k3 = rate(y + h / 2 * k2, u)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(y + h * k3, u))
        path.append(y)
    states, times = np.array(path), h * np.arange(len(path))
    for i, (name, law) in enumerate(cases):
        np.testing.assert_allclose(runs[i].states.T, states[:, :, i], atol=1e-6)
        angle = np.degrees(quaternion_angle(states[:, :4, i].T, target_quaternion(MANOEUVRE[name])[:, None]))
        whole = np.degrees(2 * np.arccos(target_quaternion(MANOEUVRE[name])[0]))
        found = FlightMeasures(
            float(times[np.flatnonzero(angle > 0.02 * whole)[-1]]),
            float(np.sum(torques[:, :, i] ** 2) * h),
            float(angle[-1]),
        )
        stated = [
            row["independent"][law]
            for row in known("reaction_wheels")
            if row["quantity"].startswith(f"{name} ({MANOEUVRE[name]}), flown") and "independent" in row
        ]
        expected = pytest.approx([found.time, found.effort, found.miss], rel=2e-3)
        assert list(astuple(measures(name, runs[i]))) == expected and stated == expected
        noise = runs[i].measured[4:7] - runs[i].states[4:7, :-1]
        np.testing.assert_allclose(np.degrees(np.std(noise, axis=1)), 0.001, rtol=0.1)
        assert np.max(np.abs(states[:, 7:, i])) <= 5e-4 * 5000 * 2 * np.pi / 60 * (1 + 1e-6)
