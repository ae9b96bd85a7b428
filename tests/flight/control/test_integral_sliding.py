"""Integral sliding mode: no reaching phase, invariance of the nominal motion, its integral, a published formation."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are
from testing.controller_steps import step_through
from testing.internals import PlantPair

from gnc_opt.control import (
    ConstantRate,
    Reference,
    SaturationLayer,
    Sign,
    design_integral_sliding_mode,
    design_lqr,
)
from gnc_opt.control.integral_sliding_mode import _build_projected_sliding_surface
from gnc_opt.errors import DesignError
from gnc_opt.model import Model

DT = 5e-3
START = np.array([1.0, -0.3])


def cart(mass: float = 2.0) -> Model:
    model = Model("cart")
    q, v, force = model.state("q"), model.state("v"), model.control("force", unit="N")
    model.ode({q: v, v: force / mass})
    return model


def gain(model: Model, q, r) -> np.ndarray:
    n, m = model.states.size, model.controls.size
    a, b = model.linearize(0.0, np.zeros(n), np.zeros(m))
    return np.linalg.solve(r, b.T @ solve_continuous_are(a, b, q, r))


def design(model=None, **options):
    model = cart() if model is None else model
    options = {
        "nominal": gain(model, np.eye(2), np.eye(1)),
        "reaching": ConstantRate(1.0),
        "boundary": SaturationLayer(0.01),
        "dt": DT,
    } | options
    return design_integral_sliding_mode(model, Reference.constant(model, [0, 0]), **options)


def disturbed(t):
    return (0.5 + 0.4 * np.sin(3 * t))[None]


def test_the_surface_starts_at_zero_exactly_and_there_is_no_reaching_phase():
    """From a large error and with a disturbance from the first moment, |s| never leaves the band."""
    controller = design(bound=0.9)
    run = step_through(controller, cart(), START, dt=DT, tf=8.0, disturbance=disturbed)
    s = run.memory("s")[0]
    assert s[0] == s[1] == 0.0
    assert controller.explain()["s at the start"] == 0.0
    band = controller.explain()["band of s"][0]
    assert band == pytest.approx(0.009)
    assert 0.5 * band < np.max(np.abs(s)) <= band * 1.001


def test_the_nominal_motion_is_invariant_to_disturbances_below_the_gain_only():
    """Against the undisturbed nominal loop; the nominal law alone is moved, and so is anything above the gain."""
    model = cart()
    none = step_through(design(), model, START, dt=DT, tf=8.0)
    robust = step_through(design(bound=0.9), model, START, dt=DT, tf=8.0, disturbance=disturbed)
    alone = step_through(
        design(reaching=ConstantRate(1e-9), boundary=SaturationLayer(1.0)), model, START, dt=DT, tf=8.0,
        disturbance=disturbed,
    )  # fmt: skip
    beyond = step_through(
        design(), model, START, dt=DT, tf=8.0, disturbance=lambda t: np.full((1, t.size), 2.0)
    )
    assert np.max(np.abs(robust.x[0] - none.x[0])) < 0.01
    assert np.max(np.abs(alone.x[0] - none.x[0])) > 0.3
    assert np.max(np.abs(beyond.x[0] - none.x[0])) > 0.3


def pendulum() -> Model:
    model = Model("pendulum")
    angle, rate, torque = model.state("angle"), model.state("rate"), model.control("torque")
    model.ode({angle: rate, rate: -9 * ca.sin(angle) - 0.1 * rate**3 + torque})
    return model


def test_the_integral_is_of_fourth_order_on_a_nonlinear_model():
    """Undisturbed, s is the error of the quadrature alone, if hardly anything acts on it."""
    model = pendulum()
    k = gain(model, np.eye(2), np.eye(1))
    worst = []
    for dt in (0.08, 0.04, 0.02):
        controller = design(
            model, nominal=k, reaching=ConstantRate(1e-9), boundary=SaturationLayer(1.0), dt=dt
        )
        run = step_through(controller, model, [1.5, 0.2], dt=dt, tf=0.4, minor=8)
        worst.append(abs(run.memory("s")[0, -1]))
    orders = np.log2(np.array(worst[:-1]) / worst[1:])
    assert np.all(orders > 3.5), (worst, orders)
    assert worst[-1] < 2e-7


def vehicle() -> Model:
    """A vehicle whose thrust turns with its heading: B depends on the reference."""
    model = Model("vehicle")
    r, v, heading = model.state("r", 2), model.state("v", 2), model.state("heading")
    force, turn = model.control("force_B", 2), model.control("turn")
    c, s = ca.cos(heading), ca.sin(heading)
    model.ode({r: v, v: ca.vertcat(c * force[0] - s * force[1], s * force[0] + c * force[1]), heading: turn})
    return model


@pytest.mark.parametrize("projection", ["pseudo-inverse", "transpose"])
def test_directions_of_thrust_that_turn_with_the_reference(projection):
    """G moves with the reference; the undisturbed surface stays at zero, a disturbed one within its band."""
    model = vehicle()

    def x(t):
        return [np.cos(t), np.sin(t), -np.sin(t), np.cos(t), 2 * t]

    def u(t):  # centripetal acceleration, in axes that turn by 2 t
        return [-np.cos(t - 2 * t), -np.sin(t - 2 * t), 2.0]

    reference = Reference.from_functions(model, x, u, 0.0, 3.0)
    k = np.zeros((3, 5))
    k[2, 4] = 1.0  # heading only: position is left to the feedforward and the sliding mode
    k[0, 0] = k[1, 1] = 1.0
    k[0, 2] = k[1, 3] = 1.0
    dt = 0.01
    # at the end of the reference (heading 6 rad) this gain is stable, as the design checks
    controller, weak = (
        design_integral_sliding_mode(
            model,
            reference,
            nominal=k,
            reaching=ConstantRate(eta),
            boundary=SaturationLayer(0.01),
            dt=dt,
            bound=[0.6 * eta, 0.6 * eta, 0.0],
            projection=projection,
        )
        for eta in (0.5, 1e-9)
    )
    start = np.add(x(0.0), [0.02, -0.01, 0.0, 0.01, 0.05])
    quiet = step_through(controller, model, start, dt=dt, tf=3.0)
    assert np.max(np.abs(quiet.memory("s"))) < 1e-6
    pushed, lost = (
        step_through(
            law,
            model,
            start,
            dt=dt,
            tf=3.0,
            disturbance=lambda t: np.stack([0.2 * np.sin(t), 0.2 * np.cos(t), 0 * t]),
        )
        for law in (controller, weak)
    )
    s = np.abs(pushed.memory("s"))
    assert 0.003 < np.max(s[:2]) < 0.0065
    moved, lost_by = (np.max(np.abs(run.x[:2, -1] - quiet.x[:2, -1])) for run in (pushed, lost))
    assert lost_by > 0.3
    assert moved < lost_by / 10


@pytest.mark.parametrize(("projection", "effect"), [("pseudo-inverse", 1.0), ("transpose", 4.0)])
def test_the_projection_follows_the_directions_of_the_controls(projection, effect):
    """B = 2 R(t): the pseudo-inverse makes G B = 1 at any time, the transpose 4."""
    model = Model("turning")
    v, force = model.state("v", 2), model.control("force", 2)
    c, s = ca.cos(model.time), ca.sin(model.time)
    model.ode({v: 2 * ca.vertcat(c * force[0] - s * force[1], s * force[0] + c * force[1])})
    reference = Reference.from_functions(model, lambda t: [0.0, 0.0], lambda t: [0.0, 0.0], 0.0, 3.0)
    pair = PlantPair.from_affine_model(model)
    errors, singular = _build_projected_sliding_surface(pair, reference, projection)
    np.testing.assert_allclose(singular, [2.0, 2.0])
    for product in pair.evaluate_expression_on_reference(reference, np.r_[0, 1, 2.5], errors.decoupling):
        np.testing.assert_allclose(product, effect * np.eye(2), atol=1e-14)


def test_a_controller_as_nominal_law_equals_its_gain():
    model = cart()
    reference = Reference.constant(model, [0, 0])
    lqr = design_lqr(model, reference, Q=np.eye(2), R=np.eye(1), dt=DT)
    inside = design(nominal=lqr, bound=0.9)
    k = np.stack([-lqr(0.0, column, dt=DT)[0] for column in np.eye(2)], axis=1)
    outside = design(nominal=k, bound=0.9)
    runs = [step_through(c, model, START, dt=DT, tf=2.0, disturbance=disturbed) for c in (inside, outside)]
    assert runs[0].u == pytest.approx(runs[1].u, abs=1e-9)
    assert "nominal_q_ref" in inside.signals


def test_what_limits_cut_does_not_wind_the_surface_up():
    model, limits = cart(), (-1.0, 1.0)
    options = {"reaching": ConstantRate(0.3), "bound": 0.2}
    push = {"disturbance": lambda t: np.full((1, t.size), 0.2)}
    aware, unaware = (
        step_through(
            design(limits=given, **options), model, [8.0, 0.0], dt=DT, tf=12.0, limits=limits, **push
        )
        for given in (limits, None)
    )
    assert np.max(np.abs(aware.memory("s"))) < 0.01 and not aware.memory("switching_gain_exceeded").any()
    assert np.max(np.abs(unaware.memory("s"))) > 1.0
    assert abs(aware.x[0, -1]) < abs(unaware.x[0, -1])


@pytest.mark.parametrize("boundary", [SaturationLayer(0.01), Sign()], ids=str)
@pytest.mark.parametrize(("level", "alarm"), [(0.9, 0.0), (-0.9, 0.0), (1.1, 1.0), (-3.0, 1.0)])
def test_a_disturbance_above_the_gain_raises_an_alarm_and_one_below_does_not(boundary, level, alarm):
    """The gain is 1 N: a step of 0.9 N leaves s where it is, one of 1.1 N drives it away, whatever the nominal law."""
    controller = design(boundary=boundary)
    step = {"disturbance": lambda t: level * (t > 2.0)[None, :]}
    run = step_through(controller, cart(), START, dt=DT, tf=6.0, **step)
    flags = run.memory("switching_gain_exceeded")[0]
    assert "switching_gain_exceeded" in controller.alarms and flags[-1] == alarm
    assert not flags[run.times < 2.0].any()
    if alarm:
        assert 10 * DT < run.times[np.argmax(flags)] - 2.0 < 60 * DT


def test_hopeless_designs_are_refused_with_numbers():
    with pytest.raises(DesignError, match="not less than the gain 1 "):
        design(bound=1.1)
    with pytest.raises(DesignError, match=r"= 2.5 is not below 2"):
        design(dt=0.025)
    with pytest.raises(DesignError, match="the nominal gain is not stable"):
        design(nominal=[[-1.0, 0.0]])
    with pytest.raises(DesignError, match=r"shape \(1, 3\): give \(1, 2\)"):
        design(nominal=[[1.0, 0.0, 0.0]])
    with pytest.raises(DesignError, match="beyond the authority"):
        design(limits=(-0.5, 0.5))
    with pytest.raises(DesignError, match="did you mean 'transpose'"):
        design(projection="transposed")
    twin = Model("twin")
    v, a, b = twin.state("v"), twin.control("a"), twin.control("b")
    twin.ode({v: a + b})
    with pytest.raises(DesignError, match="linearly dependent effects"):
        design_integral_sliding_mode(
            twin, Reference.constant(twin, [0.0], [0.0, 0.0]), nominal=[[1.0], [1.0]],
            reaching=ConstantRate(1.0), boundary=Sign(), dt=DT,
        )  # fmt: skip
