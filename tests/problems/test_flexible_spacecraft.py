"""The flexible spacecraft: plant, configurations, the law, chattering, optimal slews, tracking, flight code."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flexible import TRUE, angle, integrated, vibration

import gnc_opt as go
from benchmarks.validation.published import flexible_spacecraft as published
from benchmarks.validation.published.comparison import FlightMeasures, known
from problems.flexible_spacecraft import optimal
from problems.flexible_spacecraft.control import INERTIAL, INERTIAL_ROBUST, quasi_sliding_mode
from problems.flexible_spacecraft.model import BODY, MAX_TORQUE, build_model, initial_state, rest, target

MODEL = build_model()


def test_surface_is_what_the_law_drives_to_zero() -> None:
    """At rest S = -2 c v; later e' is minus twice the rate of v, by differences."""
    gains, dt = published.RUNS["J"]
    run = published.fly(gains, dt=dt, tf=1200 * dt)
    s = published.surface(run, INERTIAL.c)
    np.testing.assert_allclose(s[:, 0], -2 * 0.08 * np.array([0.7, -0.5, -0.4]), atol=1e-12)
    v = run.state("q_BO").values[1:]
    assert np.all(run.state("q_BO").values[0, :1200] > 0)
    slope = (v[:, 1001] - v[:, 999]) / (run.times[1001] - run.times[999])
    np.testing.assert_allclose(s[:, 1000], -2 * slope - 0.16 * v[:, 1000], atol=1e-5)


def test_target_is_an_equilibrium_and_the_law_rests_there() -> None:
    x = rest(MODEL, (1.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(MODEL.f(0.0, x, np.zeros(3)), 0.0, atol=1e-18)
    u, _ = quasi_sliding_mode(MODEL, target(MODEL), INERTIAL)(0.0, x, dt=0.1)
    np.testing.assert_allclose(u, 0.0, atol=1e-18)


def test_law_is_the_same_for_both_signs_of_the_quaternion() -> None:
    law = quasi_sliding_mode(MODEL, target(MODEL), INERTIAL_ROBUST)
    x = initial_state(MODEL)
    x[4:7] += [0.01, -0.02, 0.03]
    mirrored = np.concatenate([-x[:4], x[4:]])
    np.testing.assert_allclose(law(0.0, x, dt=0.1)[0], law(0.0, mirrored, dt=0.1)[0], rtol=1e-12)


def test_law_makes_the_surface_approach_as_the_reaching_law_says() -> None:
    """A rigid body with G = J and q near the target: dS/dt = -eps tanh(S / delta) - k S, up to second order."""
    rigid = replace(BODY, coupling=np.zeros((3, 4)))
    model = build_model(rigid, 0.0)
    gains = INERTIAL_ROBUST
    law = quasi_sliding_mode(model, target(model), gains, body=rigid)
    x = rest(model, (1.0, 0.0, 0.0, 0.0))
    v, omega = 1e-8 * np.array([1.0, -2.0, 0.5]), 1e-8 * np.array([0.3, 0.1, -0.2])
    x[1:4], x[4:7] = v, omega
    turning = model.f(0.0, x, law(0.0, x, dt=0.1)[0])[4:7]
    s = -omega - 2 * gains.c * v
    wanted = -gains.eps * np.tanh(s / gains.delta) - gains.k * s
    np.testing.assert_allclose(-turning - gains.c * omega, wanted, rtol=1e-6)


def test_least_time_is_bang_bang_and_leaves_no_vibration() -> None:
    """Fifteen switches, H = -1 and the signs of the switching functions, by a verdict that recomputes them all."""
    solution = optimal.solved("fast")
    assert solution.objective == pytest.approx(optimal.REFERENCE.value, abs=optimal.REFERENCE.tolerance)
    assert solution.objective < optimal.eigenaxis_time()
    assert sum(arc.start > 0 for arc in solution.structure) == 15
    assert go.verify(solution).ok
    leg = solution.phase()
    t = np.linspace(0.05, leg.final_time - 0.05, 300)
    x, torque = leg.x(t), leg.saturated_control("torque")(t)
    np.testing.assert_allclose(np.abs(torque), MAX_TORQUE, rtol=1e-12)
    lam = np.vstack([leg.costate(name)(t) for name in MODEL.states.names])
    np.testing.assert_allclose(np.sum(lam * MODEL.f(t, x, torque), axis=0), -1.0, atol=1e-6)
    end, energy = leg.x(leg.final_time), BODY.modal_energy(leg.state("eta")(t), leg.state("eta_rate")(t))
    assert BODY.modal_energy(end[7:11], end[11:15]) < 1e-14 * np.max(energy)


def test_plan_that_is_followed_leaves_a_twentieth_of_the_torque(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.475 of 0.5 N m on every axis, 25 mN m for feedback."""
    asked: list[go.Problem] = []
    monkeypatch.setattr(go, "solve", lambda problem, **options: asked.append(problem) or "plan")
    assert optimal.solved.__wrapped__("prompt") == "plan"
    (problem,) = asked
    limits = problem.get_phase().numbers.controls
    np.testing.assert_allclose([limits.lower, limits.upper], [[-0.475] * 3, [0.475] * 3], rtol=1e-12)
    asked.clear()
    optimal.solved.__wrapped__("fast")
    np.testing.assert_allclose(asked[0].get_phase().numbers.controls.upper, 0.5)


def test_a_flight_is_what_another_program_makes_of_the_applied_torques() -> None:
    """Attitude by its angle to the orbital frame, on the plant that is not the one believed."""
    flown = published.flight("published")
    torques = flown.applied
    states = integrated(torques[:, :, None], TRUE)[:, :, 0]
    np.testing.assert_allclose(flown.states.T, states, atol=1e-6)
    late = np.flatnonzero(np.max(np.abs(states[:, 1:4]), axis=1) > 1e-3)[-1]
    effort = float(np.sum(np.abs(torques)) * 0.05)
    found = FlightMeasures(0.05 * float(late), effort, angle(states[-1, :4]))
    time, effort, miss, energy = (
        row["independent"][1]
        for row in known("flexible_spacecraft")
        if row["quantity"].startswith("least vibration, at equal effort, flown") and "independent" in row
    )
    for one in (published.measures(flown), FlightMeasures(time, effort, miss)):
        assert [one.time, one.effort] == pytest.approx([found.time, found.effort], rel=1e-4)
        assert one.miss == pytest.approx(found.miss, rel=1e-3)
    assert energy == pytest.approx(vibration(states[1200], TRUE), rel=1e-3)
    noise = flown.measured[4:7] - flown.states[4:7, :-1]
    np.testing.assert_allclose(np.degrees(np.std(noise, axis=1)), 0.001, rtol=0.06)
    assert np.max(np.abs(torques)) <= 0.3 * (1 + 1e-12)
