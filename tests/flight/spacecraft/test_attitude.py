"""Attitude and rigid body: against scipy, closed forms, conservation laws; symbols against numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import gnc_opt.spacecraft as sc

Array = NDArray[np.float64]

ROUNDING = 1e-13
"""A few dozen operations on numbers of order one (sigma up to 3) in double precision."""

INTEGRATED = 1e-10
"""DOP853 at relative and absolute tolerance 1e-12, errors growing over tens of seconds."""

INERTIA = np.array([5621.0, 4547.0, 2364.0])


def random_vectors(n: int = 40, size: float = 1.0, seed: int = 1) -> Array:
    return size * np.random.default_rng(seed).standard_normal((3, n))


def integrate(rate: Callable[[Array], Any], start: Any, duration: float) -> Array:
    run = solve_ivp(
        lambda _, y: rate(y), (0.0, duration), np.asarray(start), method="DOP853", rtol=1e-12, atol=1e-12
    )
    return np.asarray(run.y[:, -1])


def cross_matrix(a: Array) -> Array:
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def test_dcm_is_the_transpose_of_scipys_active_rotation() -> None:
    sigma = random_vectors()
    expected = np.swapaxes(Rotation.from_mrp(sigma.T).as_matrix(), 1, 2)
    np.testing.assert_allclose(np.moveaxis(sc.mrp_to_dcm(sigma), 2, 0), expected, atol=ROUNDING)


def test_dcm_takes_reference_components_to_body_components() -> None:
    """After +90 degrees about y the body's z axis lies along the old x axis."""
    dcm_BL = sc.mrp_to_dcm(sc.mrp_from_axis_angle([0, 1, 0], np.pi / 2))
    np.testing.assert_allclose(dcm_BL @ [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], atol=ROUNDING)


def test_mrp_from_axis_angle_ignores_the_length_of_the_axis() -> None:
    np.testing.assert_allclose(
        sc.mrp_from_axis_angle([0.0, 7.0, 0.0], np.pi / 2), [0.0, np.sqrt(2) - 1, 0.0], atol=ROUNDING
    )
    with pytest.raises(ValueError, match="axis"):
        sc.mrp_from_axis_angle([0.0, 0.0, 0.0], 1.0)


def test_quaternion_agrees_with_scipy_scalar_first() -> None:
    sigma = random_vectors(size=0.4)
    expected = np.roll(Rotation.from_mrp(sigma.T).as_quat(), 1, axis=1)
    quaternion = sc.mrp_to_quaternion(sigma).T
    same_sign = np.sign(np.sum(quaternion * expected, axis=1, keepdims=True))
    np.testing.assert_allclose(quaternion, same_sign * expected, atol=ROUNDING)
    assert quaternion[0, 0] > 0  # less than half a turn: the scalar part comes first and is positive


@pytest.mark.parametrize(
    "function",
    [
        pytest.param(lambda a, b: sc.mrp_to_dcm(a), id="mrp_to_dcm"),
        pytest.param(sc.mrp_rate, id="mrp_rate"),
        pytest.param(lambda a, b: sc.mrp_to_quaternion(a), id="mrp_to_quaternion"),
        pytest.param(sc.cross, id="cross"),
        pytest.param(lambda a, b: sc.apply(sc.transpose(sc.mrp_to_dcm(a)), b), id="apply"),
        pytest.param(lambda a, b: sc.angular_acceleration(INERTIA, a, b), id="angular_acceleration"),
        pytest.param(lambda a, b: sc.hill_acceleration(a, b, 1e-3), id="hill_acceleration"),
    ],
)
def test_symbolic_and_numeric_versions_agree(function: Callable[..., Any]) -> None:
    a, b = random_vectors(6), random_vectors(6, seed=2)
    xs, ys = ca.SX.sym("x", 3), ca.SX.sym("y", 3)
    symbolic = ca.Function("f", [xs, ys], [function(xs, ys)])
    numeric = np.asarray(function(a, b))
    for k in range(6):
        value = np.asarray(symbolic(a[:, k], b[:, k]).full())
        expected = numeric[..., k]
        np.testing.assert_allclose(value.reshape(expected.shape), expected, rtol=ROUNDING, atol=ROUNDING)
        single = np.asarray(function(a[:, k], b[:, k]))
        np.testing.assert_allclose(single, expected, rtol=ROUNDING, atol=ROUNDING)


def test_mrp_rate_turns_the_dcm_at_minus_omega_cross() -> None:
    """dC/dt = -[omega x] C, with C differentiated along sigma' by automatic differentiation."""
    sigma, omega = ca.SX.sym("sigma", 3), ca.SX.sym("omega", 3)
    rate = ca.jtimes(ca.vec(sc.mrp_to_dcm(sigma)), sigma, sc.mrp_rate(sigma, omega))
    function = ca.Function("f", [sigma, omega], [ca.reshape(rate, 3, 3)])
    for s, w in zip(random_vectors(10).T, random_vectors(10, seed=3).T, strict=True):
        expected = -cross_matrix(w) @ sc.mrp_to_dcm(s)
        np.testing.assert_allclose(function(s, w).full(), expected, atol=1e-12)  # |omega| up to 3


def test_integrated_kinematics_give_the_rotation_of_a_constant_rate() -> None:
    start, omega, duration = np.array([0.1, -0.2, 0.05]), np.array([0.03, -0.1, 0.06]), 20.0
    sigma = integrate(lambda s: sc.mrp_rate(s, omega), start, duration)
    expected = Rotation.from_mrp(start) * Rotation.from_rotvec(omega * duration)
    np.testing.assert_allclose(sc.mrp_to_dcm(sigma), expected.as_matrix().T, atol=INTEGRATED)


def test_free_rotation_conserves_energy_and_inertial_angular_momentum() -> None:
    def rate(y: Array) -> Array:
        torque_free = sc.angular_acceleration(INERTIA, y[:3], np.zeros(3))
        return np.concatenate([torque_free, sc.mrp_rate(y[3:], y[:3])])

    def invariants(y: Array) -> tuple[float, Array]:
        momentum_B = sc.angular_momentum(INERTIA, y[:3])
        return float(momentum_B @ y[:3]), sc.apply(sc.transpose(sc.mrp_to_dcm(y[3:])), momentum_B)

    first = np.array([0.1, -0.02, 0.15, 0.0, 0.1, 0.0])
    last = integrate(rate, first, 15.0)
    (energy, momentum), (final_energy, final_momentum) = invariants(first), invariants(last)
    assert np.linalg.norm(last - first) > 0.1
    assert final_energy == pytest.approx(energy, rel=INTEGRATED)
    np.testing.assert_allclose(final_momentum, momentum, atol=float(INTEGRATED * np.linalg.norm(momentum)))


def test_relative_rotation_is_the_inertial_one_seen_from_a_turning_frame() -> None:
    """Integrate the body once relative to the turning frame L, once relative to I, and compare attitudes."""
    omega_LI_L, torque, duration = np.array([0.01, -0.03, 0.02]), np.array([30.0, -50.0, 20.0]), 15.0

    def relative(y: Array) -> Array:
        omega_LI_B = sc.apply(sc.mrp_to_dcm(y[3:]), omega_LI_L)
        acceleration = sc.relative_angular_acceleration(INERTIA, y[:3], omega_LI_B, torque)
        return np.concatenate([acceleration, sc.mrp_rate(y[3:], y[:3])])

    def inertial(y: Array) -> Array:
        return np.concatenate([sc.angular_acceleration(INERTIA, y[:3], torque), sc.mrp_rate(y[3:], y[:3])])

    start_BL = np.array([0.02, -0.01, 0.03])
    seen_from_L = integrate(relative, [*start_BL, 0.0, 0.0, 0.0], duration)
    seen_from_I = integrate(inertial, [*(start_BL + omega_LI_L), 0.0, 0.0, 0.0], duration)
    dcm_LI = Rotation.from_rotvec(omega_LI_L * duration).as_matrix().T
    dcm_BL = sc.mrp_to_dcm(seen_from_L[3:])
    np.testing.assert_allclose(dcm_BL @ dcm_LI, sc.mrp_to_dcm(seen_from_I[3:]), atol=INTEGRATED)
    np.testing.assert_allclose(seen_from_L[:3] + dcm_BL @ omega_LI_L, seen_from_I[:3], atol=INTEGRATED)


def test_inertia_matrix_and_principal_moments_agree_in_turned_axes() -> None:
    turned = sc.mrp_to_dcm([0.1, 0.2, -0.3])
    matrix = turned @ np.diag(INERTIA) @ turned.T
    omega, torque = np.array([0.1, -0.2, 0.3]), np.array([10.0, 20.0, -30.0])
    expected = turned @ sc.angular_acceleration(INERTIA, omega, torque)
    actual = sc.angular_acceleration(matrix, turned @ omega, turned @ torque)
    np.testing.assert_allclose(actual, expected, atol=ROUNDING)
    symbolic = sc.angular_acceleration(ca.DM(matrix), ca.DM(turned @ omega), ca.DM(turned @ torque))
    np.testing.assert_allclose(symbolic.full().ravel(), expected, atol=ROUNDING)
