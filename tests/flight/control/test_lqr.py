"""Linear-quadratic regulators: closed forms, published gains, sampling, integral action, margins, refusals."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import bisect
from testing.internals import (
    compute_stability_margins,
    discretize_plant_and_cost,
    discretize_time_varying_plant,
    discretize_zero_order_hold,
    find_uncontrollable_modes,
    solve_algebraic_riccati,
)
from testing.models import dynamics

import gnc_opt as go
from gnc_opt.control import Reference, bryson, design_lqr
from gnc_opt.errors import ArgumentError, DesignError, UnknownNameError

ORBIT_RATE = np.sqrt(398600.0 / 7171.0**3)
"""rad/s, of the formation's leader."""


def cart() -> go.Model:
    model = go.Model("cart")
    q, v = model.state("q", unit="m"), model.state("v", unit="m/s")
    a = model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    model.output("twice", 2 * q, unit="m")
    return model


def wheels(inertia: tuple[float, ...] = (4.0, 4.0, 3.0)) -> go.Model:
    """Attitude by reaction wheels from rest: the gyroscopic term vanishes; quaternion with the scalar last."""
    model = go.Model("wheels")
    w, q = model.state("omega", 3, unit="rad/s"), model.state("q", 4)
    torque = model.control("T", 3, unit="N m")
    vector, scalar = q[:3], q[3]
    model.ode(
        {
            w: torque / ca.DM(inertia),
            q: 0.5 * ca.vertcat(scalar * w + ca.cross(vector, w), -ca.dot(vector, w)),
        }
    )
    # Vector part of ref^-1 (x) q.
    model.difference(q, lambda x, ref: ref[3] * x[:3] - x[3] * ref[:3] - ca.cross(ref[:3], x[:3]))
    return model


def formation() -> go.Model:
    n = ORBIT_RATE
    model = go.Model("formation")
    r, v = model.state("r", 3, unit="m"), model.state("v", 3, unit="m/s")
    u = model.control("u", 3, unit="m/s^2")
    pull = ca.vertcat(2 * n * v[1] + 3 * n**2 * r[0], -2 * n * v[0], -(n**2) * r[2])
    model.ode({r: v, v: pull + u})
    return model


def gain(controller) -> np.ndarray:
    return np.asarray(controller.explain()["gain"])


def test_wheel_gains_equal_the_closed_form_in_quaternion_errors():
    model = wheels()
    assert model.errors.size == 6
    rest = [0, 0, 0, 0, 0, 0, 1]
    k = gain(design_lqr(model, rest, Q={"omega": 13131, "q": 170}, R={"T": 2500}))
    proportional = np.sqrt(170 / 2500)
    rate = np.sqrt(13131 / 2500 + np.array([4, 4, 3]) * proportional)
    assert np.allclose(k, np.hstack([np.diag(rate), proportional * np.eye(3)]), rtol=0, atol=1e-12)
    # as printed: 0.2608, 2.5091, 2.4566; and six digits of the independent computation
    assert np.round(k[0, 3], 6) == 0.260768
    assert np.round([k[0, 0], k[2, 2]], 6).tolist() == [2.509078, 2.456564]
    assert np.round([k[0, 3], k[0, 0], k[2, 2]], 4).tolist() == [0.2608, 2.5091, 2.4566]


def test_double_integrator_gains_equal_the_closed_form():
    k = gain(design_lqr(cart(), [0, 0], Q=0.1, R=100))
    root = np.sqrt(0.001)
    assert np.allclose(k, [[root, np.sqrt(root**2 + 2 * root)]], rtol=1e-14)
    assert np.round(k, 7).tolist() == [[0.0316228, 0.2534671]]


def test_sampled_plant_and_cost_are_exact():
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(4, 4)), rng.normal(size=(4, 2))
    root = rng.normal(size=(6, 6))
    weight = root @ root.T
    q, n, r = weight[:4, :4], weight[:4, 4:], weight[4:, 4:]
    dt, e, v = 1.7, rng.normal(size=4), rng.normal(size=2)

    def rate(t, y):
        both = np.concatenate([y[:4], v])
        return np.append(a @ y[:4] + b @ v, both @ weight @ both)

    flown = solve_ivp(rate, (0, dt), np.append(e, 0), rtol=1e-12, atol=1e-12, method="DOP853").y[:, -1]
    step = discretize_plant_and_cost(a, b, q, r, n, dt)
    assert np.allclose(step.a, expm(a * dt), rtol=1e-11)
    assert np.allclose(step.a @ e + step.b @ v, flown[:4], rtol=1e-9)
    assert e @ step.q @ e + v @ step.r @ v + 2 * e @ step.n @ v == pytest.approx(flown[4], rel=1e-9)


def test_sampling_along_a_reference_is_of_fourth_order_and_sees_jumps():
    def linearize(t):
        slow = 1.0 if t < 0.3 else 3.0
        return np.array([[0, 1], [-1 - np.cos(3 * t), -0.1]]), np.array([[0], [slow + np.sin(t)]])

    def linearize_many(times):
        return tuple(np.stack(matrices) for matrices in zip(*map(linearize, times), strict=True))

    q, r, n, jumps = np.eye(2), np.eye(1), np.zeros((2, 1)), np.array([0.3])

    def flown(t, dt):
        def rate(s, y):
            a, b = linearize(s)
            return np.append(a @ y[:2] + b[:, 0], y[:2] @ y[:2] + 1.0)

        y = np.array([0.0, 0.0, 0.0])
        for left, right in ((t, 0.3 - 1e-15), (0.3, t + dt)):
            y = solve_ivp(rate, (left, right), y, rtol=1e-12, atol=1e-13, method="DOP853").y[:, -1]
        return y

    errors = []
    for dt in (0.4, 0.2):
        t = 0.3 - dt / 2
        step = discretize_time_varying_plant(linearize_many, q, r, n, t, dt, jumps)
        exact = flown(t, dt)
        errors.append(max(np.max(np.abs(step.b[:, 0] - exact[:2])), abs(step.r[0, 0] - exact[2])))
    assert errors[0] < 1e-4
    assert errors[1] < errors[0] / 2**3.5  # the steps are one half as long; order four of the method
    constant = discretize_plant_and_cost(*linearize(0.1), q, r, n, 0.1)
    same = discretize_time_varying_plant(
        lambda times: linearize_many(np.full(times.shape, 0.1)), q, r, n, 5.0, 0.1, np.zeros(0)
    )
    assert np.allclose(same.q, constant.q, rtol=1e-12)
    assert np.allclose(same.b, constant.b, rtol=1e-12)


def test_sampled_gain_tends_to_the_continuous_one():
    model = cart()
    exact = gain(design_lqr(model, [0, 0], Q=1, R=1))
    coarse, fine = (
        np.max(np.abs(gain(design_lqr(model, [0, 0], Q=1, R=1, dt=h)) - exact)) for h in (0.02, 0.01)
    )
    assert coarse < 0.03
    assert fine == pytest.approx(coarse / 2, rel=0.05)  # first order: the mean delay of half a step


def test_sampled_regulator_costs_what_its_riccati_matrix_says():
    a, b = np.array([[0.0, 1.0], [0.5, -0.2]]), np.array([[0.0], [2.0]])
    step = discretize_plant_and_cost(a, b, np.diag([2.0, 1.0]), np.eye(1), np.zeros((2, 1)), 0.3)
    found = solve_algebraic_riccati(step.a, step.b, step.q, step.r, step.n, ("p", "w"), sampled=True)
    e, cost = np.array([1.0, -0.7]), 0.0
    start = e
    for _ in range(400):
        v = -found.gain @ e
        cost += e @ step.q @ e + v @ step.r @ v + 2 * e @ step.n @ v
        e = step.a @ e + step.b @ v
    assert cost == pytest.approx(start @ found.cost @ start, rel=1e-12)


def test_units_do_not_change_the_law():
    n, scale = ORBIT_RATE, np.diag([1e3, 1.0, 1e-4])
    a = np.array([[0, 1, 0], [-(n**2), 0, n], [0, 0, -n]])
    b = np.array([[0.0], [0], [n]])
    q, r, labels = np.diag([1.0, 2.0, 0.0]), np.array([[1e4]]), ("a", "b", "c")
    inverse = np.linalg.inv(scale)
    k = solve_algebraic_riccati(a, b, q, r, np.zeros((3, 1)), labels).gain
    other = solve_algebraic_riccati(
        scale @ a @ inverse, scale @ b, inverse @ q @ inverse, r, np.zeros((3, 1)), labels
    ).gain
    assert np.allclose(other @ scale, k, rtol=1e-9)


def fly(controller, dt, disturbance, limit=np.inf, steps=600, start=(0.0, 0.0)):
    x, z, path = np.array(start), None, []
    a, b = np.array([[1, dt], [0, 1]]), np.array([dt**2 / 2, dt])
    for k in range(steps):
        u, z = controller(k * dt, x, z, dt)
        x = a @ x + b * (np.clip(u[0], -limit, limit) + disturbance)
        path.append(x)
    return np.array(path)


@pytest.mark.parametrize("dt", [0.1, None])
def test_integral_action_removes_the_error_of_a_constant_disturbance(dt):
    without = design_lqr(cart(), [0, 0], Q=1, R=1, dt=dt)
    with_integral = design_lqr(cart(), [0, 0], Q=1, R=1, dt=dt, integral={"q": 1.0})
    stiffness = gain(without)[0, 0]
    assert fly(without, 0.1, 0.2)[-1, 0] == pytest.approx(0.2 / stiffness, rel=1e-8)
    assert abs(fly(with_integral, 0.1, 0.2)[-1, 0]) < 1e-10
    plain = with_integral.without_dropout_handling
    assert plain.memory.labels == with_integral.memory.labels[:1] == ("integral_q",)
    assert with_integral.memory.units[0] == "m s"


def test_integral_of_an_output():
    model = cart()
    model.output("range", 2 * model.symbol("q") + 1, unit="m")
    by_output = design_lqr(model, [0, 0], Q=1, R=1, dt=0.1, integral={"range": 0.25})
    by_state = design_lqr(model, [0, 0], Q=1, R=1, dt=0.1, integral={"q": 1.0})
    assert np.allclose(fly(by_output, 0.1, 0.2), fly(by_state, 0.1, 0.2), atol=1e-10)


def test_anti_windup_halves_the_overshoot():
    settings = {"Q": 1, "R": 1, "dt": 0.1, "integral": {"q": 1.0}}
    plain = design_lqr(cart(), [0, 0], **settings)
    guarded = design_lqr(cart(), [0, 0], **settings, limits=(-0.3, 0.3))
    overshoot = [-fly(c, 0.1, 0.0, 0.3, start=(10.0, 0.0))[:, 0].min() for c in (plain, guarded)]
    assert overshoot[1] < 0.5 * overshoot[0]
    # the memory is set back so that the next command of the same error is just at its limit
    x = np.array([10.0, 0.0])
    _, z = guarded(0.0, x)
    z[0] -= 0.1 * x[0]
    u, _ = guarded(0.0, x, z)
    assert u[0] == pytest.approx(-0.3, abs=1e-12)


def test_integral_of_an_output_with_feedthrough_is_refused():
    model = cart()
    model.output("felt", model.symbol("a") + model.symbol("q"))
    with pytest.raises(DesignError, match=r"'felt'.*depends on a control"):
        design_lqr(model, [0, 0], Q=1, R=1, integral={"felt": 1.0})
    with pytest.raises(UnknownNameError, match="state or output 'p'"):
        design_lqr(model, [0, 0], Q=1, R=1, integral={"p": 1.0})


def test_delay_margin_is_where_the_loop_becomes_unstable():
    controller = design_lqr(cart(), [0, 0], Q=1, R=1)
    k, delay = gain(controller)[0], float(np.asarray(controller.explain()["delay margin"])[0])

    def grows(tau):
        """Whether |L(jw) e^(-j w tau)| passes -1 the wrong way: sign of the growth of s + ... near the axis."""
        s = 1j * 1.0
        for _ in range(100):  # Newton on s^2 + (k1 s + k0) e^(-s tau) from the crossover
            g = s**2 + (k[1] * s + k[0]) * np.exp(-s * tau)
            slope = 2 * s + (k[1] - tau * (k[1] * s + k[0])) * np.exp(-s * tau)
            s = s - g / slope
        return s.real

    assert grows(delay * 0.99) < 0 < grows(delay * 1.01)


def test_gain_margin_of_a_sampled_loop_is_where_a_pole_meets_the_circle():
    controller = design_lqr(cart(), [0, 0], Q=1, R=1, dt=0.5)
    up = float(np.asarray(controller.explain()["gain margin up"])[0])
    step = discretize_plant_and_cost(
        np.array([[0, 1.0], [0, 0]]), np.array([[0], [1.0]]), np.eye(2), np.eye(1), np.zeros((2, 1)), 0.5
    )
    poles = np.linalg.eigvals(step.a - up * step.b @ gain(controller))
    assert np.max(np.abs(poles)) == pytest.approx(1.0, abs=1e-9)


def test_delay_margin_of_a_loop_with_three_crossovers_is_the_least_of_theirs():
    """L = 0.5 / s + 0.1 s / (s^2 + 0.05 s + 25): slow, and once more at the resonance, where little delay is needed."""
    a = np.array([[0, 0, 0], [0, 0, 1], [0, -25.0, -0.05]])
    b, k = np.array([[1.0], [0], [1]]), np.array([[0.5, 0, 0.1]])
    found = compute_stability_margins(a, b, k)
    w = np.geomspace(0.01, 100, 400001)
    loop = 0.5 / (1j * w) + 0.1 * 1j * w / ((1j * w) ** 2 + 0.05j * w + 25)
    crossings = np.flatnonzero(np.diff(np.sign(np.abs(loop) - 1)))
    assert crossings.size == 3
    lags = np.angle(-loop[crossings]) % (2 * np.pi)
    delays, phases = lags / w[crossings], np.minimum(lags, 2 * np.pi - lags)
    assert np.argmin(delays) != 0
    assert found.delay[0] == pytest.approx(delays.min(), rel=1e-3)
    assert found.phase[0] == pytest.approx(phases.min(), rel=1e-2)


def test_the_regulator_has_the_margins_that_theory_promises():
    facts = design_lqr(formation(), np.zeros(6), Q={"r": 0.2, "v": 1e5}, R=1e10).explain()
    assert np.all(np.isinf(facts["gain margin up"]))
    assert np.all(np.asarray(facts["gain margin down"]) <= 0.5)
    assert np.all(np.asarray(facts["phase margin"]) >= 60 - 1e-6)
    # |S| <= 1 (Kalman's inequality) bounds the disk of S - 1/2 from below by 2/3
    assert facts["disk margin"] >= 2 / 3
    assert facts["Riccati residual"] < 1e-10


@pytest.mark.parametrize("dt", [None, 0.05])
@pytest.mark.parametrize("price", [1e-4, 1.0, 1e4])
def test_a_statically_unstable_plant_is_lost_where_the_gain_no_longer_carries_it(price, dt):
    """theta'' = g theta + u: a pole comes to 0 where the gain falls to g / k1, whatever the rate's gain."""
    model = go.Model("inverted pendulum")
    theta, rate, u = model.state("theta"), model.state("rate"), model.control("u")
    model.ode({theta: rate, rate: 9.81 * theta + u})
    controller = design_lqr(model, [0, 0], Q=1, R=price, dt=dt)
    down = np.asarray(controller.explain()["gain margin down"])
    assert down == pytest.approx([9.81 / gain(controller)[0, 0]], rel=1e-9)


def test_static_margins_are_those_of_each_channel_with_the_others_closed():
    """L_i at omega = 0 by hand: unstable, an integrator, and a stable plant under positive feedback."""
    a, b, k = np.diag([2.0, 0.0, -1.0]), np.eye(3), np.diag([5.0, 1.0, -0.25])
    k[0, 2] = 3.0  # triangular: the poles stay, and so do the margins
    found = compute_stability_margins(a, b, k)
    assert found.gain_down == pytest.approx([2 / 5, 0, 0], rel=1e-12)
    assert found.gain_up == pytest.approx([np.inf, np.inf, 4], rel=1e-12)


def test_integrators_that_are_so_to_rounding_need_next_to_no_gain():
    mixing = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    a = mixing @ np.array([[0, 1.0, 0], [0, 0, 0], [0, 0, -1]]) @ mixing.T
    b, k = mixing @ np.array([[0], [1.0], [0]]), np.array([[1.0, 1.5, 0]]) @ mixing.T
    assert compute_stability_margins(a, b, k).gain_down < 1e-12
    sampled = discretize_zero_order_hold(a, b, 0.1)
    assert compute_stability_margins(*sampled, k, 0.1).gain_down < 1e-12


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("dt", [1e-5, 0.1, 1.0, 1e5])
def test_margins_of_a_loop_with_negative_sampled_poles_do_not_depend_on_the_unit_of_time(dt):
    """A double integrator with K = (1.49 / dt^2, 1.73 / dt): z^2 + a1 z + a0 with both roots negative.

    The characteristic polynomial at z = -1 is 4 - 2 f k2 dt for a gain of f times K.
    """
    a, b = np.array([[1.0, dt], [0, 1]]), np.array([[dt**2 / 2], [dt]])
    k = np.array([[1.49 / dt**2, 1.73 / dt]])
    assert np.all(np.linalg.eigvals(a - b @ k) < 0)
    found = compute_stability_margins(a, b, k, dt)
    assert found.gain_up == pytest.approx([2 / 1.73], rel=1e-9)
    assert found.gain_down == 0

    scaled = np.array([[1.0, 1], [0, 1]]), np.array([[0.5], [1]]), np.array([[1.49, 1.73]])

    def stable(lag: float) -> bool:
        closed = scaled[0] - scaled[1] @ scaled[2] * np.exp(-1j * lag)
        return bool(np.max(np.abs(np.linalg.eigvals(closed))) < 1)

    lag = bisect(lambda lag: 1.0 if stable(lag) else -1.0, 0.0, 1.0, xtol=1e-12)
    assert found.phase == pytest.approx([lag], rel=1e-8)


def test_bryson_makes_the_largest_errors_cost_the_same():
    model = formation()
    weights = bryson(model.states, r=[0.1, 0.2, 0.5], v=0.01)
    assert np.allclose(weights["r"], [100, 25, 4])
    assert weights["v"] == pytest.approx(1e4)
    assert np.allclose(
        gain(design_lqr(model, np.zeros(6), Q=weights, R=bryson(model.controls, u=1e-3))),
        gain(design_lqr(model, np.zeros(6), Q=np.diag([100, 25, 4, 1e4, 1e4, 1e4]), R=1e6)),
    )
    with pytest.raises(UnknownNameError, match="'vv'"):
        bryson(model.states, vv=1.0)
    with pytest.raises(ArgumentError, match="largest acceptable 'v'"):
        bryson(model.states, v=0.0)


def test_a_plant_that_is_not_stabilisable_is_refused_by_mode():
    model, *_ = dynamics("drifting", "q v p", "a", lambda q, v, p, a: {q: v, v: a, p: 0.25 * p})
    with pytest.raises(
        DesignError, match=r"not stabilisable: no control reaches .* eigenvalue 0\.25 1/s in 'p'"
    ):
        design_lqr(model, [0, 0, 0], Q=1, R=1)
    with pytest.raises(DesignError, match=r"eigenvalue 0\.25 1/s in 'p'"):
        design_lqr(model, [0, 0, 0], Q=1, R=1, dt=0.1)


def test_a_stable_mode_out_of_reach_is_no_obstacle():
    model, *_ = dynamics("fading", "q p", "a", lambda q, p, a: {q: a + p, p: -0.25 * p})
    assert gain(design_lqr(model, [0, 0], Q=1, R=1))[0, 0] == pytest.approx(1.0)


def test_defective_modes_out_of_reach_are_found():
    a = np.zeros((5, 5))
    a[0, 1] = a[2, 3] = a[3, 4] = 1.0  # a triple integrator beside a double one that has the control
    mixing = np.linalg.qr(np.random.default_rng(0).normal(size=(5, 5)))[0]
    b = np.array([[0], [1.0], [0], [0], [0]])
    modes = find_uncontrollable_modes(mixing @ a @ mixing.T, mixing @ b, tuple("abcde"))
    assert len(modes) == 3
    assert all(abs(mode.eigenvalue) < 1e-4 and mode.rank_gap < 1e-8 for mode in modes)
    assert find_uncontrollable_modes(
        formation().linearize(0.0, np.zeros(6), np.zeros(3))[0], np.eye(6)[:, [4]], tuple("xyzuvw")
    )


def test_a_cost_that_does_not_see_a_mode_is_refused():
    with pytest.raises(DesignError, match=r"not detectable.*eigenvalue 0 1/s in 'q'"):
        design_lqr(cart(), [0, 0], Q={"v": 1}, R=1)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ({"Q": {"q": -1}, "R": 1}, "weight Q of 'q' is -1"),
        ({"Q": [[1, 2], [2, 1]], "R": 1}, "weight Q is not positive semidefinite.*-1"),
        ({"Q": [[0, 1e-3], [1e-3, 1]], "R": 1}, "weight Q is not positive semidefinite"),
        ({"Q": [[1, 1], [0, 1]], "R": 1}, "not symmetric"),
        ({"Q": 1, "R": 0}, "weight R of 'a' is 0"),
        ({"Q": 1, "R": 1, "N": [[5], [0]]}, r"\[\[Q, N\], \[N', R\]\] is not positive semidefinite"),
        ({"Q": 1, "R": 1, "limits": (1, 1)}, "'a' has no authority"),
    ],
)
def test_impossible_weights_are_refused_with_numbers(weights, message):
    with pytest.raises(DesignError, match=message):
        design_lqr(cart(), [0, 0], **weights)


def test_weights_of_a_wrong_shape_or_name_are_refused():
    with pytest.raises(ArgumentError, match=r"shape \(3, 3\)"):
        design_lqr(cart(), [0, 0], Q=np.eye(3), R=1)
    with pytest.raises(UnknownNameError, match="'w'"):
        design_lqr(cart(), [0, 0], Q={"w": 1}, R=1)


def test_a_reference_with_changing_dynamics_is_refused():
    model, *_ = dynamics("pendulum", "q v", "a", lambda q, v, a: {q: v, v: a - ca.sin(q)})
    reference = Reference.from_functions(model, lambda t: [t, 1], lambda t: [np.sin(t)], 0, 1)
    with pytest.raises(DesignError, match=r"A of 'pendulum' changes along the reference.*design_tvlqr"):
        design_lqr(model, reference, Q=1, R=1)


def test_saturation_reserve():
    model = cart()
    reference = Reference.from_functions(model, lambda t: [0, 0], lambda t: [0.6], 0, 1)
    facts = design_lqr(model, reference, Q=1, R=1, limits=(-1, 1)).explain()
    assert np.asarray(facts["control authority margin"]) == pytest.approx([0.4])


@pytest.mark.parametrize(("stiffness", "dt"), [(0.0, 1e5), (1.0, 1e5), (1.0, 1e9)])
def test_a_step_that_is_long_beside_the_plant_is_designed_without_noise(stiffness, dt, recwarn):
    """A body that drifts, and one that has come to rest long before the next step: poles at zero, damping one."""
    model, *_ = dynamics("body", "q v", "F", lambda q, v, F: {q: v, v: F - stiffness * (q + 0.1 * v)})
    told = design_lqr(model, [0, 0], Q=[1, 1], R=[1], dt=dt).explain()
    assert not recwarn.list
    assert not any(np.isnan(np.asarray(told[name])).any() for name in ("damping", "closed-loop poles"))
    if stiffness:
        assert told["closed-loop poles"][-1] == complex(-np.inf) and told["damping"][-1] == 1.0


def test_a_step_in_which_an_unstable_plant_overflows_is_refused(recwarn):
    model, *_ = dynamics("unstable", "q v", "F", lambda q, v, F: {q: v, v: F + 0.1 * v - q})
    with pytest.raises(DesignError, match=r"100000 s.*shorter"):
        design_lqr(model, [0, 0], Q=[1, 1], R=[1], dt=1e5)
    with pytest.raises(DesignError, match=r"100000 s.*shorter"):
        go.design_tvlqr(model, Reference.constant(model, [0, 0]), Q=[1, 1], R=[1], dt=1e5)
    assert not recwarn.list


def climbing(tail="hold"):
    return Reference.from_functions(cart(), lambda t: [t, 1.0], lambda t: [0.25], 0.0, 2.0, tail=tail)


@pytest.mark.parametrize("dt", [None, 0.1])
@pytest.mark.parametrize("limits", [None, (-1.0, 2.0)])
@pytest.mark.parametrize(("name", "factor"), [("q", 1.0), ("twice", 2.0)])
def test_a_regulator_with_an_integral_is_its_formula(dt, limits, name, factor):
    """u = u_ff - K e - K_i z, z grows by dt times the error, set back by what the limits cut."""
    law = design_lqr(cart(), climbing(), Q=[2.0, 1.0], R=0.5, dt=dt, integral={name: 0.3}, limits=limits)
    gain = np.asarray(law.explain()["gain"])
    assert gain.shape == (1, 3) and law.memory.names[0] == f"integral_{name}"
    assert law.memory.variables[0].unit == "m s"
    step, x, z = 0.1, np.array([3.0, -0.5]), 0.7
    e = x - [0.4, 1.0]
    u = 0.25 - gain[0, :2] @ e - gain[0, 2] * z
    cut = 0.0 if limits is None else u - np.clip(u, *limits)
    memory = law.initial_memory(0.4, x, step)
    assert memory[0] == 0.0
    memory[0] = z
    found, after = law(0.4, x, memory, dt=step)
    assert found == pytest.approx([u]) and after[0] == pytest.approx(
        z + step * factor * e[0] + cut / gain[0, 2]
    )
    assert law.span == (0.0, 2.0) and law.dt == dt
    facts = {f.name for f in law.explain()}
    assert ("sampled poles" in facts) is (dt is not None) and ("control authority margin" in facts) is (
        limits is not None
    )


def test_the_gain_of_a_regulator_is_optimal_for_the_held_plant_with_its_integral():
    """The discrete Riccati equation of (e, z) with plant and cost sampled exactly; poles are told as rates."""
    dt = 0.1
    law = design_lqr(cart(), climbing(), Q=[2.0, 1.0], R=0.5, dt=dt, integral={"q": 0.3})
    a, b = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    held = discretize_plant_and_cost(a, b, np.diag([2.0, 1.0]), np.array([[0.5]]), np.zeros((2, 1)), dt)
    wide_a = np.block([[held.a, np.zeros((2, 1))], [dt * np.array([[1.0, 0.0]]), np.eye(1)]])
    wide_b, wide_n = np.vstack([held.b, [[0.0]]]), np.vstack([held.n, [[0.0]]])
    wide_q = np.block([[held.q, np.zeros((2, 1))], [np.zeros((1, 2)), dt * 0.3 * np.eye(1)]])
    p = solve_discrete_are(wide_a, wide_b, wide_q, held.r, s=wide_n)
    gain = np.linalg.solve(held.r + wide_b.T @ p @ wide_b, wide_b.T @ p @ wide_a + wide_n.T)
    assert law.explain()["gain"] == pytest.approx(gain, rel=1e-8)
    z = np.linalg.eigvals(wide_a - wide_b @ gain)
    assert np.sort(np.abs(law.explain()["sampled poles"])) == pytest.approx(np.sort(np.abs(z)))
    rates = np.asarray(law.explain()["closed-loop poles"])
    assert np.sort_complex(np.exp(dt * rates)) == pytest.approx(np.sort_complex(z.astype(complex)))
    assert law.explain()["damping"] == pytest.approx(-rates.real / np.abs(rates))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"integral": {"z": 1.0}}, "no state or output 'z'"),
        ({"integral": {"q": 0.0}}, "the weight of 'integral_q' is 0"),
        ({"integral": {"q": [1.0, 2.0]}}, "weight of the integral of 'q'"),
        ({"dt": -1.0}, "control step dt"),
    ],
)
def test_integrals_that_are_none_are_refused(options, message):
    with pytest.raises((ArgumentError, DesignError, UnknownNameError), match=message):
        design_lqr(cart(), climbing(), Q=1.0, R=1.0, **options)
