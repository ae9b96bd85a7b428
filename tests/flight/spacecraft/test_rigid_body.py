"""A rigid body alone and with wheels: energy and momentum."""

import casadi as ca
import numpy as np
import pytest
from testing.flows import flow

from gnc_opt.errors import ArgumentError
from gnc_opt.spacecraft import (
    PYRAMID_ELEVATION,
    angular_acceleration,
    angular_momentum,
    array_momentum,
    quaternion_rate,
    quaternion_to_dcm,
    relative_angular_acceleration,
    total_momentum,
    transpose,
    wheel_body_acceleration,
    wheel_pyramid,
)

INERTIA = np.array([5621.0, 4547.0, 2364.0])


def test_free_body_keeps_energy_and_momentum():
    """Drift below 1e-12 in 1000 s, in the inertial frame too."""

    def rate(_, y):
        return np.concatenate(
            [angular_acceleration(INERTIA, y[:3], np.zeros(3)), quaternion_rate(y[3:], y[:3])]
        )

    start = np.array([0.01, -0.02, 0.015, 1, 0, 0, 0])
    y = flow(rate, start, np.linspace(0, 1000, 51), tol=3e-14)
    momentum = angular_momentum(INERTIA, y[:3])
    energy = 0.5 * np.sum(y[:3] * momentum, axis=0)
    assert np.max(np.abs(energy / energy[0] - 1)) < 1e-12
    length = np.linalg.norm(momentum, axis=0)
    assert np.max(np.abs(length / length[0] - 1)) < 1e-12
    inertial = np.einsum("ijt,jt->it", transpose(quaternion_to_dcm(y[3:])), momentum)
    assert np.max(np.abs(inertial - inertial[:, :1])) < 1e-12 * length[0]


def test_a_matrix_of_principal_moments_is_the_same_body():
    w, torque = np.array([0.1, -0.3, 0.2]), np.array([1.0, 2.0, -3.0])
    np.testing.assert_allclose(
        angular_acceleration(np.diag(INERTIA), w, torque),
        angular_acceleration(INERTIA, w, torque),
        rtol=1e-15,
    )


def test_relative_rate_in_a_turning_frame_is_the_inertial_motion():
    """omega_BL plus the frame's rate seen in B is the inertial rate: both ways give one motion."""
    frame_rate = np.array([0.0, -0.02, 0.0])

    def relative(_, y):
        w = quaternion_to_dcm(y[3:]) @ frame_rate
        return np.concatenate(
            [relative_angular_acceleration(INERTIA, y[:3], w, np.zeros(3)), quaternion_rate(y[3:], y[:3])]
        )

    def inertial(_, w):
        return angular_acceleration(INERTIA, w, np.zeros(3))

    start = np.array([0.05, 0.02, -0.03, 1, 0, 0, 0])
    end = flow(relative, start, [0.0, 200.0])[:, -1]
    absolute = flow(inertial, start[:3] + frame_rate, [0.0, 200.0])[:, -1]
    np.testing.assert_allclose(end[:3] + quaternion_to_dcm(end[3:]) @ frame_rate, absolute, atol=1e-11)


def test_pyramid_of_the_paper():
    """Navabi and Hosseini 2018: L = a [[1,-1,-1,1],[1,1,-1,-1],[1,1,1,1]], a = 1/sqrt 3, L L^T = 4/3."""
    axes = wheel_pyramid()
    a = 1 / np.sqrt(3)
    np.testing.assert_allclose(axes, a * np.array([[1, -1, -1, 1], [1, 1, -1, -1], [1, 1, 1, 1]]), atol=1e-15)
    np.testing.assert_allclose(axes @ axes.T, 4 / 3 * np.eye(3), atol=1e-15)
    assert np.degrees(PYRAMID_ELEVATION) == pytest.approx(35.264, abs=1e-3)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=0), 1)
    np.testing.assert_allclose(array_momentum(axes, [1, -1, 1, -1]), 0, atol=1e-15)
    with pytest.raises(ArgumentError, match="at least 3"):
        wheel_pyramid(wheels=2)


def test_wheels_and_body_keep_their_total_momentum():
    axes, inertia = wheel_pyramid(), np.array([4.0, 4.0, 3.0])

    def rate(t, y):
        omega, q, h = y[:3], y[3:7], y[7:]
        torques = 0.05 * np.array([np.sin(t), np.cos(0.7 * t), -np.sin(1.3 * t), 0.5])
        turning = wheel_body_acceleration(inertia, axes, omega, h, torques, np.zeros(3))
        return np.concatenate([turning, quaternion_rate(q, omega), -torques])

    start = np.concatenate([[0.02, -0.01, 0.03], [1, 0, 0, 0], [0.1, -0.2, 0.05, 0.3]])
    y = flow(rate, start, np.linspace(0, 30, 21), tol=3e-14)
    momentum = total_momentum(inertia, axes, y[:3], y[7:])
    inertial = np.einsum("ijt,jt->it", transpose(quaternion_to_dcm(y[3:7])), momentum)
    assert np.max(np.abs(inertial - inertial[:, :1])) < 1e-12
    assert np.ptp(y[:3]) > 0.1  # it does move


def test_from_rest_the_gyroscopic_term_vanishes_and_wheels_add_up():
    axes, inertia = wheel_pyramid(), np.array([4.0, 4.0, 3.0])
    torques = np.array([0.02, -0.01, 0.03, 0.005])

    def rate(_, y):
        return np.concatenate(
            [wheel_body_acceleration(inertia, axes, y[:3], y[3:], torques, np.zeros(3)), -torques]
        )

    end = flow(rate, np.zeros(7), [0.0, 50.0])[:, -1]
    np.testing.assert_allclose(end[:3], 50.0 * (axes @ torques) / inertia, rtol=1e-11)
    A, h = ca.SX.sym("A", 3, 4), ca.SX.sym("h", 4)
    for given in (A, axes, axes.tolist()):
        found = ca.Function("sum", [A, h], [array_momentum(given, h)])(axes, torques)
        np.testing.assert_allclose(found.full().ravel(), axes @ torques, rtol=1e-14)
