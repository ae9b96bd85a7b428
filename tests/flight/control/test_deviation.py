"""Errors on the right manifold and their linear dynamics, against finite differences of the nonlinear motion."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import gnc_opt as go
from gnc_opt.control import ErrorDynamics, design_lqr
from gnc_opt.errors import DesignError
from gnc_opt.spacecraft import mrp_difference, mrp_from_axis_angle, mrp_rate


def tumbler() -> go.Model:
    """A rigid body with a quaternion (scalar last) and a position that the attitude pushes."""
    model = go.Model("tumbler")
    w, q = model.state("omega", 3, unit="rad/s"), model.state("q", 4)
    y = model.state("y", unit="m")
    torque = model.control("T", 3, unit="N m")
    inertia = ca.DM([2.0, 3.0, 4.0])
    vector, scalar = q[:3], q[3]
    model.ode(
        {
            w: (torque - ca.cross(w, inertia * w)) / inertia,
            q: 0.5 * ca.vertcat(scalar * w + ca.cross(vector, w), -ca.dot(vector, w)),
            y: ca.sin(model.time) * y + vector[0] * scalar,
        }
    )
    model.difference(q, quaternion_error)
    model.output("tilt", vector[0] ** 2 + vector[1] ** 2)
    return model


def quaternion_error(x, ref):
    """Twice the vector part of ref^-1 (x) q: a rotation vector to first order."""
    return 2 * (ref[3] * x[:3] - x[3] * ref[:3] - ca.cross(ref[:3], x[:3]))


def attitude(vector) -> np.ndarray:
    return Rotation.from_rotvec(vector).as_quat()


REFERENCE = np.concatenate([[0.3, -0.2, 0.5], attitude([0.4, -0.9, 0.6]), [0.7]])
TORQUE = np.array([0.2, -0.1, 0.3])


def displaced(x, e) -> np.ndarray:
    """The state whose error is e, to first order."""
    turned = (Rotation.from_quat(x[3:7]) * Rotation.from_rotvec(e[3:6])).as_quat()
    turned = turned * np.sign(turned @ x[3:7])
    return np.concatenate([x[:3] + e[:3], turned, x[7:] + e[6:]])


def test_error_vanishes_on_the_reference_and_is_a_rotation_vector_near_it():
    deviation = ErrorDynamics(tumbler())
    assert deviation.errors.labels == ("omega[0]", "omega[1]", "omega[2]", "q[0]", "q[1]", "q[2]", "y")
    assert np.allclose(deviation(REFERENCE, REFERENCE), 0, atol=1e-16)
    small = 1e-4 * np.arange(1, 8)
    assert np.allclose(deviation(displaced(REFERENCE, small), REFERENCE), small, atol=1e-10)
    many = np.stack([displaced(REFERENCE, k * small) for k in range(4)], axis=1)
    assert deviation(many, REFERENCE[:, None] * np.ones(4)).shape == (7, 4)


def test_linear_dynamics_are_those_of_small_errors_of_the_nonlinear_motion():
    model = tumbler()
    deviation = ErrorDynamics(model)
    a, b = deviation.linearize(0.6, REFERENCE, TORQUE)
    assert (a.shape, b.shape) == ((7, 7), (7, 3))
    h = 1e-3

    def flown(x, u):
        return solve_ivp(lambda t, s: model.f(t, s, u), (0.6, 0.6 + h), x, rtol=1e-13, atol=1e-14).y[:, -1]

    def error_after(e, v):
        """Error of a displaced start, with v beyond the control, after h."""
        return deviation(flown(displaced(REFERENCE, e), TORQUE + v), flown(REFERENCE, TORQUE))

    # central differences in the displacement, and in time the mean slope over h: A + O(h)
    step = 1e-4
    for k in range(7):
        e = step * np.eye(7)[k]
        change = (error_after(e, np.zeros(3)) - error_after(-e, np.zeros(3))) / (2 * step) - np.eye(7)[k]
        assert np.allclose(change / h, a[:, k], atol=2 * h)
    for k in range(3):
        v = np.eye(3)[k]
        change = (error_after(np.zeros(7), v) - error_after(np.zeros(7), -v)) / 2
        assert np.allclose(change / h, b[:, k], atol=h)


def test_length_of_the_quaternion_is_no_error():
    deviation = ErrorDynamics(tumbler())
    a, b = deviation.linearize(0.0, REFERENCE, TORQUE)
    longer = REFERENCE.copy()
    longer[3:7] *= 1.0 + 1e-9
    a_longer, b_longer = deviation.linearize(0.0, longer, TORQUE)
    assert np.allclose(a, a_longer, atol=1e-7)
    assert np.allclose(b, b_longer, atol=1e-7)
    assert np.allclose(a[3:6, :3], np.eye(3), atol=1e-14)  # de/dt = omega - omega_r + ...


def test_without_a_declared_difference_it_is_the_plain_linearisation():
    model = go.Model("plain")
    q, v = model.state("q"), model.state("v")
    a = model.control("a")
    model.ode({q: v * q, v: a * v + ca.sin(q)})
    found = ErrorDynamics(model).linearize(0.0, [0.4, 0.6], [0.2])
    expected = model.linearize(0.0, [0.4, 0.6], [0.2])
    assert all(np.allclose(x, y, rtol=0, atol=1e-15) for x, y in zip(found, expected, strict=True))


def test_output_changes_with_errors():
    deviation = ErrorDynamics(tumbler())
    c = deviation.linearize_output("tilt", 0.0, REFERENCE, TORQUE)

    def tilt(e):
        x = displaced(REFERENCE, e)
        return x[3] ** 2 + x[4] ** 2

    step = 1e-5
    slopes = [(tilt(step * row) - tilt(-step * row)) / (2 * step) for row in np.eye(7)]
    assert np.allclose(c, [slopes], atol=1e-9)


def test_output_that_depends_on_a_control_is_refused():
    model = go.Model("felt")
    q, a = model.state("q"), model.control("a")
    model.ode({q: a})
    model.output("push", a + q)
    with pytest.raises(DesignError, match=r"'push'.*depends on a control"):
        ErrorDynamics(model).output_expression("push", ca.SX.sym("t"), ca.SX.sym("x"))


def test_gains_in_mrp_errors_have_their_closed_form_and_know_the_shadow_set():
    """omega' = T / J, e' = omega near the reference (e is the turn); both MRP of an attitude get the same command."""
    model = go.Model("turning")
    w, sigma = model.state("omega", 3, unit="rad/s"), model.state("sigma", 3)
    torque = model.control("T", 3, unit="N m")
    rate = mrp_rate(sigma, w)
    model.ode({w: torque / 4.0, sigma: rate})
    model.difference(sigma, mrp_difference)
    there = mrp_from_axis_angle([1.0, 2.0, -0.5], np.radians(170))
    controller = design_lqr(model, [0, 0, 0, *there], Q={"omega": 3, "sigma": 2}, R=0.5)
    proportional = np.sqrt(2 / 0.5)
    damping = np.sqrt(3 / 0.5 + 2 * 4.0 * proportional)
    expected = np.hstack([damping * np.eye(3), proportional * np.eye(3)])
    assert np.allclose(controller.explain()["gain"], expected, atol=1e-12)
    near = mrp_from_axis_angle([1.0, 2.1, -0.4], np.radians(176))
    shadow = -near / (near @ near)
    commands = [controller(0.0, [0, 0, 0, *s], dt=0.1)[0] for s in (near, shadow)]
    assert np.linalg.norm(commands[0]) > 0.01
    assert np.allclose(commands[0], commands[1], atol=1e-14)
