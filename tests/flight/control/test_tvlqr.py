"""Time-varying regulators: analytic Riccati solutions, the steady limit, optimality, sampling, tails."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from testing.models import cart_with_units as cart
from testing.models import dynamics

import gnc_opt as go
from gnc_opt.control import ErrorDynamics, Reference, design_tvlqr
from gnc_opt.errors import ArgumentError, DesignError


def pendulum() -> go.Model:
    model = go.Model("pendulum")
    q, v = model.state("q", unit="rad"), model.state("v", unit="rad/s")
    a = model.control("a", unit="1/s^2")
    model.ode({q: v, v: a - ca.sin(q)})
    return model


def swing(model: go.Model, duration: float = 4.0, **options) -> Reference:
    """q = cos t on the pendulum."""
    return Reference.from_functions(
        model, lambda t: [np.cos(t), -np.sin(t)], lambda t: [np.sin(np.cos(t)) - np.cos(t)], 0.0, duration,
        **options,
    )  # fmt: skip


def rest(model: go.Model, duration: float, **options) -> Reference:
    return Reference.from_functions(model, lambda t: [0, 0], lambda t: [0], 0.0, duration, **options)


def gains(controller):
    return controller.schedule.gains


@pytest.mark.parametrize("jumps", [(), (0.7, 2.9)])
def test_double_integrator_without_state_weight(jumps):
    """Q = 0, R = 1: inverse of P is linear in the costs: P = Phi' (S^-1 + W)^-1 Phi with the Gramian W to go."""
    weight, t_f = np.array([[3.0, 0.5], [0.5, 2.0]]), 5.0
    controller = design_tvlqr(cart(), rest(cart(), t_f, jumps=jumps), Q=0, R=1, terminal=weight)
    for t in np.linspace(0, t_f, 23):
        left = t_f - t
        phi = np.array([[1, left], [0, 1]])
        gramian = np.array([[left**3 / 3, left**2 / 2], [left**2 / 2, left]])
        p = phi.T @ np.linalg.inv(np.linalg.inv(weight) + gramian) @ phi
        assert np.allclose(gains(controller).P(t), p, rtol=0, atol=1e-10)  # 1e-8 is asked for
        assert np.allclose(gains(controller).K(t), p[[1]], rtol=0, atol=1e-10)


def test_scalar_plant_with_all_weights():
    """x' = a x + u: dp/dtau = 2 a p - p^2 + q has a closed form by its two fixed points."""
    model, *_ = dynamics("scalar", "x", "u", lambda x, u: {x: 0.4 * x + u})
    reference = Reference.from_functions(model, lambda t: [0], lambda t: [0], 0.0, 3.0)
    controller = design_tvlqr(model, reference, Q=2.0, R=1.0, terminal=0.1)
    root = np.sqrt(0.4**2 + 2)
    high, low = 0.4 + root, 0.4 - root
    for t in np.linspace(0, 3, 11):
        ratio = (0.1 - high) / (0.1 - low) * np.exp(-2 * root * (3 - t))
        exact = (high - low * ratio) / (1 - ratio)
        assert gains(controller).P(t)[0, 0] == pytest.approx(exact, rel=1e-10)


def test_riccati_solution_is_the_cost_to_go_along_a_reference():
    """Fly the linear error dynamics with the law and add up the cost by quadrature."""
    model = pendulum()
    reference = swing(model)
    controller = design_tvlqr(model, reference, Q=[2.0, 1.0], R=0.5, terminal=[1.0, 3.0])
    table, start = gains(controller), np.array([0.3, -0.2])

    def rate(t, y):
        a, b = table.deviation.linearize(t, reference.x(t), reference.u(t))
        v = -table.K(t) @ y[:2]
        return np.append(a @ y[:2] + b @ v, y[:2] @ np.diag([2.0, 1.0]) @ y[:2] + 0.5 * v @ v)

    y = solve_ivp(rate, (0.0, 4.0), np.append(start, 0.0), "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    cost = y[2] + y[:2] @ np.diag([1.0, 3.0]) @ y[:2]
    assert cost == pytest.approx(start @ table.P(0.0) @ start, rel=1e-8)


def test_cross_weight_is_a_change_of_feedback():
    """With N = K0' the problem in v + K0 e has none: the gains differ by K0, the costs to go do not."""
    k0, model = np.array([[0.3, -0.2]]), cart()
    reference = rest(model, 3.0)
    crossed = design_tvlqr(model, reference, Q=np.eye(2) + k0.T @ k0, R=1, N=k0.T, terminal=1.0)
    shifted, *_ = dynamics("shifted", "q v", "a", lambda q, v, a: {q: v, v: a - (0.3 * q - 0.2 * v)})
    plain = design_tvlqr(shifted, rest(shifted, 3.0), Q=1, R=1, terminal=1.0)
    assert np.allclose(gains(crossed).P(0.0), gains(plain).P(0.0), rtol=1e-9)
    assert np.allclose(gains(crossed).K(1.0), gains(plain).K(1.0) + k0, rtol=1e-9)


def test_sampled_gains_tend_to_the_continuous_ones():
    model = pendulum()
    reference = swing(model, 2.0)
    exact = gains(design_tvlqr(model, reference, Q=1, R=1, terminal=2.0)).K(1.0)
    errors = [
        np.max(np.abs(gains(design_tvlqr(model, reference, Q=1, R=1, terminal=2.0, dt=h)).K(1.0) - exact))
        for h in (0.02, 0.01)
    ]
    assert errors[1] == pytest.approx(errors[0] / 2, rel=0.1)


def test_sampled_cost_to_go_is_that_of_small_errors_of_the_nonlinear_plant():
    """Fly plant and reference with the held commands; the cost rate is integrated with them."""
    model, h = pendulum(), 0.1
    reference = swing(model, 2.0)
    controller = design_tvlqr(model, reference, Q=1, R=1, terminal=1.0, dt=h)
    e_0 = 1e-4 * np.array([1.0, 0.5])
    state = np.append(reference.x(0.0) + e_0, 0.0)
    for gain, k in zip(gains(controller).gains, range(20), strict=True):
        v = -gain @ (state[:2] - reference.x(k * h))

        def rate(t, y, v=v):
            e = y[:2] - reference.x(t)
            return np.append(model.f(t, y[:2], reference.u(t) + v), e @ e + v @ v)

        state = solve_ivp(rate, (k * h, (k + 1) * h), state, rtol=1e-10, atol=1e-16).y[:, -1]
    e = state[:2] - reference.x(2.0)
    cost = state[2] + e @ e
    assert cost == pytest.approx(e_0 @ gains(controller).P(0.0) @ e_0, rel=1e-3)


def test_gains_in_quaternion_errors_turn_with_the_reference():
    """A free body about a steady spin: constant in the error coordinates, though the quaternion turns."""
    model = go.Model("spinner")
    w, q = model.state("omega", 3, unit="rad/s"), model.state("q", 4)
    torque = model.control("T", 3, unit="N m")
    vector, scalar = q[:3], q[3]
    model.ode({w: torque, q: 0.5 * ca.vertcat(scalar * w + ca.cross(vector, w), -ca.dot(vector, w))})
    model.difference(q, lambda x, ref: ref[3] * x[:3] - x[3] * ref[:3] - ca.cross(ref[:3], x[:3]))
    rate = 0.5
    reference = Reference.from_functions(
        model, lambda t: [0, 0, rate, 0, 0, np.sin(rate * t / 2), np.cos(rate * t / 2)],
        lambda t: np.zeros(3), 0.0, 10.0,
    )  # fmt: skip
    a, b = ErrorDynamics(model).linearize(7.0, reference.x(7.0), reference.u(7.0))
    cross = np.array([[0, rate, 0], [-rate, 0, 0], [0, 0, 0.0]])  # e' = omega/2 - omega_r x e
    assert np.allclose(
        a, np.block([[np.zeros((3, 3)), np.zeros((3, 3))], [0.5 * np.eye(3), cross]]), atol=1e-13
    )
    assert np.allclose(b, np.vstack([np.eye(3), np.zeros((3, 3))]), atol=1e-14)
    controller = design_tvlqr(model, reference, Q=1, R=1, terminal=1.0)
    with_closed_form = _hamiltonian_solution(a, b, np.eye(6), np.eye(3), np.eye(6), 10.0)
    assert np.allclose(gains(controller).P(0.0), with_closed_form, atol=1e-8)


def _hamiltonian_solution(a, b, q, r, s, duration):
    """P = Y X^-1 with (X, Y)' = [[A, -B R^-1 B'], [-Q, -A']] (X, Y) backward from (1, S)."""
    h = np.block([[a, -b @ np.linalg.solve(r, b.T)], [-q, -a.T]])
    x, y = np.eye(a.shape[0]), s
    for _ in range(50):  # in steps: growing and decaying solutions stay apart
        flow = expm(-h * duration / 50) @ np.vstack([x, y])
        y, x = flow[a.shape[0] :] @ np.linalg.inv(flow[: a.shape[0]]), np.eye(a.shape[0])
    return y


def test_refusals():
    model = pendulum()
    with pytest.raises(DesignError, match=r"after the end of the reference.*not detectable.*terminal weight"):
        design_tvlqr(cart(), rest(cart(), 1.0), Q=0, R=1)
    with pytest.raises(DesignError, match="terminal weight of 'v' is -1"):
        design_tvlqr(model, swing(model), Q=1, R=1, terminal={"v": -1})
    with pytest.raises(ArgumentError, match="Reference"):
        design_tvlqr(model, [0, 0], Q=1, R=1)
    sampled = design_tvlqr(model, swing(model), Q=1, R=1, dt=0.1)
    with pytest.raises(ArgumentError, match=r"control steps of 0\.1 s, not 0\.2 s"):
        sampled.schedule_row(0.0, 0.2)
