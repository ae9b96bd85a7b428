"""Wheel pyramid: published numbers, and where the laws end."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov
from testing.controller_steps import decoupling_matrix

import gnc_opt as go
from benchmarks.validation.published.reaction_wheels import (
    BREAKDOWNS,
    about_z,
    allocated_run,
    breakdown_time,
    fly,
    guarded_run,
    published_slew,
    rerouted_slew,
    unguarded_breakdown,
)
from gnc_opt.spacecraft import quaternion_angle
from problems.reaction_wheels import (
    AXES,
    DESIGN_SPEED,
    INERTIA,
    INVERSE,
    MANOEUVRES,
    NOMINAL_SPEED,
    NULL,
    REST,
    WHEEL_INERTIA,
    paper_quaternion,
    published_peak_torque,
    target_quaternion,
    wheel_model,
)
from problems.reaction_wheels.control import (
    PRINTED_FLC,
    PRINTED_LQR,
    Linear,
    design_flc,
    design_quaternion_lqr,
    flc_gains,
    flc_output,
    lqr_gains,
    peak_speed,
)

BOTH = ("FLC", "LQR")


def lqr_poles(k_q: float, k_w: float, moment: float) -> np.ndarray:
    """Return the poles (1/s) of one axis at small angles: J theta'' + k_w theta' + k_q theta / 2 = 0."""
    return np.sort(np.roots([moment, k_w, k_q / 2]))[::-1]


def test_pyramid_serves_all_axes_alike_and_survives_a_lost_wheel() -> None:
    printed = np.array([[1, -1, -1, 1], [1, 1, -1, -1], [1, 1, 1, 1]]) / np.sqrt(3)
    np.testing.assert_allclose(AXES, printed, atol=1e-15)
    np.testing.assert_allclose(AXES @ AXES.T, 4 / 3 * np.eye(3), atol=1e-15)
    inverse = 3 / (4 * np.sqrt(3)) * np.array([[1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]])
    np.testing.assert_allclose(INVERSE, inverse, atol=1e-15)
    np.testing.assert_allclose(AXES @ NULL, 0.0, atol=1e-15)
    for lost in range(4):
        left = np.delete(AXES, lost, axis=1)
        assert abs(np.linalg.det(left)) == pytest.approx(4 / (3 * np.sqrt(3)), abs=1e-14)
        assert np.linalg.cond(left) == pytest.approx(2.0, abs=1e-13)


@pytest.mark.parametrize(
    ("manoeuvre", "q", "angle"),
    [
        (1, (0.070439, -0.296883, -0.283114, 0.909255), 49.1947),
        (2, (-0.407711, 0.045443, 0.530498, 0.741808), 84.2288),
        (3, (-0.372932, -0.287378, -0.436067, 0.766930), 79.8421),
        (4, (0.041636, 0.045437, 0.041636, 0.997230), 8.5306),
        (5, (-0.044054, 0.025387, 0.018571, 0.998534), 6.2060),
        (6, (-0.018628, 0.025346, -0.341422, 0.939384), 40.1033),
    ],
)
def test_targets_have_the_papers_convention(manoeuvre: int, q: tuple[float, ...], angle: float) -> None:
    target = target_quaternion(manoeuvre)
    np.testing.assert_allclose(paper_quaternion(target), q, atol=1e-6)
    assert np.degrees(quaternion_angle(REST[:4], target)) == pytest.approx(angle, abs=1e-4)


def test_gains_solve_their_riccati_equations() -> None:
    k_q, k_w = lqr_gains()
    np.testing.assert_allclose(k_q, np.sqrt(170 / 2500) * np.eye(3), atol=1e-9)
    moments = np.sqrt(13131 / 2500 + np.array(INERTIA) * np.sqrt(170 / 2500))
    np.testing.assert_allclose(k_w, np.diag(moments), atol=1e-9)
    np.testing.assert_allclose(np.diag(k_q), PRINTED_LQR[0], atol=1e-4)
    np.testing.assert_allclose(np.diag(k_w), PRINTED_LQR[1], atol=1e-4)
    assert flc_gains() == pytest.approx((np.sqrt(0.001), np.sqrt(0.001 + 2 * np.sqrt(0.001))), abs=1e-12)
    assert flc_gains() == pytest.approx(PRINTED_FLC, abs=1e-4)


def test_poles_of_both_laws() -> None:
    errors = Linear()
    poles = np.roots([1.0, errors.k2, errors.k1])
    np.testing.assert_allclose(
        sorted(poles, key=np.imag), [-0.12675 - 0.12464j, -0.12675 + 0.12464j], atol=1e-5
    )
    assert errors.frequency == pytest.approx(0.17776, abs=1e-5)
    assert errors.damping == pytest.approx(0.71302, abs=1e-5)
    assert errors.overshoot == pytest.approx(0.040973, abs=1e-6)
    k_q, (k_xy, _, k_z) = PRINTED_LQR
    # the law (60) has twice the gain of its Riccati equation
    np.testing.assert_allclose(lqr_poles(2 * k_q, k_xy, 4.0), (-0.1315, -0.4958), atol=1e-4)
    np.testing.assert_allclose(lqr_poles(2 * k_q, k_z, 3.0), (-0.1254, -0.6935), atol=1e-4)
    np.testing.assert_allclose(lqr_poles(k_q, k_xy, 4.0), (-0.0572, -0.570), atol=5e-4)


def test_decoupling_and_diffeomorphism_vanish_with_the_scalar_part_only() -> None:
    craft, random = wheel_model(drive="body"), np.random.default_rng(3)
    q, w = craft.symbol("q"), craft.symbol("omega")
    rate = craft.state_derivative()[1:4]
    # in the paper's order of states, scalar part last
    jacobian = ca.jacobian(ca.vertcat(q[1:], q[0], rate), ca.vertcat(q[1:], q[0], w))
    determinant = ca.Function("d", [craft.symbols("state")], [ca.det(jacobian)])
    for _ in range(10):
        x = random.normal(size=11)
        x[:4] /= np.linalg.norm(x[:4])
        e = decoupling_matrix(craft, {"q_v": q[1:]}, x)
        assert np.linalg.det(e) == pytest.approx(x[0] / 384, abs=1e-15)
        assert abs(float(determinant(x))) == pytest.approx(abs(x[0]) / 8, abs=1e-14)


def test_printed_lyapunov_matrix_is_that_of_the_transposed_equation() -> None:
    a = np.array([[0.0, 1.0], [-PRINTED_FLC[0], -PRINTED_FLC[1]]])
    stated = solve_continuous_lyapunov(a.T, -np.eye(2))
    printed = solve_continuous_lyapunov(a, -np.eye(2))
    np.testing.assert_allclose(printed, [[68.4008, -0.5], [-0.5, 2.0347]], atol=1e-4)
    np.testing.assert_allclose(np.linalg.eigvalsh(printed), [2.0309, 68.4045], atol=1e-4)
    np.testing.assert_allclose(stated, [[6.04579, 15.82278], [15.82278, 64.38968]], atol=1e-5)
    np.testing.assert_allclose(np.linalg.eigvalsh(stated), np.linalg.eigvalsh(printed), rtol=1e-12)


@pytest.mark.parametrize("law", BOTH)
@pytest.mark.parametrize("manoeuvre", MANOEUVRES)
def test_invariants_and_what_follows_from_them(manoeuvre: int, law: str) -> None:
    slew = published_slew(manoeuvre, law)
    total = np.array(INERTIA)[:, None] * slew.rates + AXES @ slew.momenta
    assert np.max(np.abs(total)) < 1e-12
    assert np.max(np.abs(NULL @ slew.momenta)) < 1e-12
    assert np.max(np.abs(np.linalg.norm(slew.states[:4], axis=0) - 1)) < 1e-9
    peaks = np.max(np.abs(slew.momenta), axis=1)
    assert slew.work == pytest.approx(np.sum(peaks**2) / WHEEL_INERTIA, rel=0.003)
    assert slew.effort == pytest.approx(2 * np.sum(peaks), rel=0.06 if law == "FLC" else 0.015)
    np.testing.assert_allclose(
        slew.power, np.abs(slew.momenta * slew.torques) / WHEEL_INERTIA, rtol=4e-4, atol=1e-15
    )


@pytest.mark.parametrize("manoeuvre", MANOEUVRES)
def test_feedback_linearisation_is_an_eigenaxis_slew_in_closed_form(manoeuvre: int) -> None:
    slew = published_slew(manoeuvre, "FLC")
    exact = np.degrees(Linear().angle(slew.times, np.radians(slew.angle[0])))
    np.testing.assert_allclose(slew.angle, exact, rtol=0, atol=2e-6)
    vector = slew.states[1:4]
    across = vector - np.outer(slew.target[1:], slew.target[1:] @ vector) / (
        slew.target[1:] @ slew.target[1:]
    )
    assert np.max(np.abs(across)) < 1e-9
    assert np.max(np.abs(slew.torques)) == pytest.approx(published_peak_torque(manoeuvre), rel=1e-9)


def test_only_the_law_as_printed_gives_the_printed_eulerint() -> None:
    target, (k_q, k_w) = target_quaternion(1), PRINTED_LQR
    without_two = design_quaternion_lqr(target, gains=(k_q / 2, k_w))
    without_scalar = design_quaternion_lqr(target, factor="sign")
    assert fly(without_two, target).eulerint == pytest.approx(950, abs=1)
    assert fly(without_scalar, target).eulerint == pytest.approx(474.8, abs=0.1)


def test_statements_of_the_paper() -> None:
    for manoeuvre in MANOEUVRES:
        flc, lqr = (published_slew(manoeuvre, law) for law in BOTH)
        assert flc.eulerint < lqr.eulerint
        assert flc.energy < lqr.energy
        assert flc.effort > lqr.effort  # the paper: smaller
        assert (flc.work > lqr.work) == (manoeuvre in (1, 2, 3))  # the paper: smaller in all
        assert flc.settling_time < 40 and lqr.settling_time < 40
    assert published_slew(3, "FLC").peak_speed > NOMINAL_SPEED > DESIGN_SPEED


def test_third_manoeuvre_in_the_loop_needs_the_null_space_to_respect_the_speed_limit() -> None:
    balanced = allocated_run("momentum", limited=True, duration=40.0)
    assert peak_speed(balanced) == pytest.approx(3846, rel=2e-3)  # commands are held for 0.02 s
    assert np.all(balanced.saturation_time("T_B") == 0)
    plain = allocated_run("none", limited=True, duration=40.0)
    assert peak_speed(plain) == pytest.approx(DESIGN_SPEED, abs=1e-6)
    assert np.all(plain.saturation_time("T_B") > 2.0)


def test_slews_up_to_147_degrees_work() -> None:
    assert np.degrees(Linear().largest_slew) == pytest.approx(147.74, abs=0.005)
    edge = fly(design_flc(about_z(147)), about_z(147), 120.0)
    assert np.min(edge.states[0]) == pytest.approx(0.0615, abs=1e-4)
    assert np.max(np.abs(edge.body_torque)) == pytest.approx(0.182, abs=5e-4)
    assert np.degrees(np.max(np.abs(edge.rates))) == pytest.approx(9.63, abs=5e-3)
    assert edge.peak_speed == pytest.approx(4171, abs=1.0)
    assert fly(design_flc(about_z(145)), about_z(145), 120.0).angle[-1] < 0.01


@pytest.mark.parametrize("angle", BREAKDOWNS)
def test_larger_slews_break_down_where_the_closed_form_says(angle: int) -> None:
    assert unguarded_breakdown(angle) == pytest.approx(breakdown_time(angle), abs=0.01)


def test_larger_slews_are_guarded_or_rerouted() -> None:
    guarded = guarded_run(150)
    assert guarded.outcome.status is go.RunStatus.CONTROLLER_ALARM
    assert guarded.outcome.time < breakdown_time(150)
    assert np.degrees(guarded.attitude_error("q")) < 0.01
    assert [flc_output(about_z(a)) for a in (145, 147, 148, 150, 179)] == ["absolute"] * 2 + ["error"] * 3
    for angle in (150, 170, 179):
        slew = rerouted_slew(angle)
        assert slew.angle[-1] < 0.01
        assert np.max(slew.angle) <= angle + 1e-9
    # the line of the output matters, not only its ends, and both signs of a quaternion are the same attitude
    assert flc_output(-about_z(60)) == "error"
    assert flc_output(about_z(-140), about_z(140)) == "error"


def test_half_a_turn_is_an_equilibrium_of_the_printed_lqr_law() -> None:
    first = {
        angle: float(np.max(np.abs(design_quaternion_lqr(about_z(angle))(0.0, REST, dt=1.0)[0])))
        for angle in (179, 180)
    }
    assert first[179] == pytest.approx(0.00455, abs=1e-5)
    assert first[180] < 1e-15
    assert fly(design_quaternion_lqr(about_z(179)), about_z(179), 120.0).angle[-1] == pytest.approx(
        0.022, abs=5e-4
    )
    assert fly(design_quaternion_lqr(about_z(180)), about_z(180), 120.0).angle[-1] > 179.999
    signed = design_quaternion_lqr(about_z(180), factor="sign")
    assert fly(signed, about_z(180), 120.0).angle[-1] < 0.01
