"""Integral sliding mode: no reaching phase, invariance of the nominal motion, its integral, a published formation."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are
from testing import formation
from testing.controller_steps import step_through

from gnc_opt.control import (
    ConstantRate,
    Reference,
    SaturationLayer,
    Sign,
    SuperTwisting,
    design_integral_sliding_mode,
    design_lqr,
    design_tvlqr,
)
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
        design(reaching=ConstantRate(1e-9), boundary=SaturationLayer(1.0)),
        model,
        START,
        dt=DT,
        tf=8.0,
        disturbance=disturbed,
    )
    beyond = step_through(
        design(), model, START, dt=DT, tf=8.0, disturbance=lambda t: np.full((1, t.size), 2.0)
    )
    assert np.max(np.abs(robust.x[0] - none.x[0])) < 0.01
    assert np.max(np.abs(alone.x[0] - none.x[0])) > 0.3
    assert np.max(np.abs(beyond.x[0] - none.x[0])) > 0.3


def test_chattering_falls_more_than_a_hundredfold_from_sign_to_saturation():
    variation = []
    for boundary in (Sign(), SaturationLayer(0.01)):
        run = step_through(
            design(boundary=boundary, bound=0.9), cart(), START, dt=DT, tf=20.0, disturbance=disturbed
        )
        variation.append(np.sum(np.abs(np.diff(run.u[0]))))
    assert variation[0] > 100 * variation[1]


def test_super_twisting_makes_the_surface_vanish_with_a_continuous_command():
    controller = design(reaching=SuperTwisting(3.0, 2.0), boundary=Sign(), bound=1.5)
    run = step_through(controller, cart(), START, dt=DT, tf=8.0, disturbance=disturbed)
    assert np.max(np.abs(run.memory("s")[0][run.times > 3])) < 1e-3


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


def test_memory_of_the_nominal_law_goes_along():
    """LQR with integral action inside: undisturbed, the command is that of the inner law."""
    model = cart()
    reference = Reference.constant(model, [0, 0])
    lqr = design_lqr(model, reference, Q=np.eye(2), R=np.eye(1), dt=DT, integral={"q": 1.0})
    inside = design(nominal=lqr)
    runs = [step_through(c, model, START, dt=DT, tf=2.0) for c in (inside, lqr)]
    assert runs[0].u == pytest.approx(runs[1].u, abs=1e-9)
    assert set(lqr.unbridged.memory.names) == {
        n.removeprefix("nominal_") for n in inside.memory.names if n.startswith("nominal_")
    }


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


def test_s_that_was_thrown_out_of_its_layer_and_comes_back_is_no_alarm():
    """As by actuators that are late: eight steps at 6 N throw s out, and it takes forty or more to come back at 1 N."""
    controller = design()
    kick = {"disturbance": lambda t: 6.0 * ((t > 2.0) & (t < 2.0 + 8 * DT))[None, :]}
    run = step_through(controller, cart(), START, dt=DT, tf=6.0, **kick)
    s = np.abs(run.memory("s")[0])
    assert np.sum(s > 0.02) > 40 and s[-1] < 0.01  # edge: layer and two steps of the gain
    assert not run.memory("switching_gain_exceeded").any()


def test_formation_keeping_agrees_with_the_published_run():
    """Imani & Bahrami, Table 1, optimal SMC: 0.06 m and 1.825 m/s; gains and surface of the same paper."""
    model, plant, dt = formation.hill(), formation.nonlinear(j2=True), 0.5
    k = gain(model, np.diag([0.2] * 3 + [1e5] * 3), 1e10 * np.eye(3))
    assert k[0] == pytest.approx([7.94113e-6, -2.35212e-6, 0, 4.99387e-3, 2.15700e-4, 0], rel=1e-5)

    def x(t):
        return np.concatenate(formation.circle(t)[:2])

    reference = Reference.from_functions(model, x, lambda _: np.zeros(3), 0.0, 2 * formation.PERIOD)
    controller = design_integral_sliding_mode(
        model,
        reference,
        nominal=k,
        reaching=ConstantRate(5e-4),
        boundary=SaturationLayer(1e-3),
        dt=dt,
        bound=2e-4,
        projection="transpose",
    )
    assert controller.explain()["sampling limit"] == pytest.approx(4.0)
    with_rows = dataclasses.replace(  # the reference needs no averages: its control is zero
        controller, schedule=lambda t, _: np.vstack([*formation.circle(t)[:2], np.zeros((3, t.size))])
    )
    run = step_through(with_rows, plant, formation.START, dt=dt, tf=6043.5)
    position = np.array(
        [
            np.interp(formation.PERIOD, run.times, run.x[i] - formation.circle(run.times)[0][i])
            for i in range(3)
        ]
    )
    assert np.linalg.norm(position) == pytest.approx(0.0613, abs=5e-4)
    assert np.sum(np.abs(run.u)) * dt == pytest.approx(1.8255, abs=5e-4)
    s = run.memory("s")
    assert np.all(s[:, 0] == 0)
    assert np.max(np.abs(s), axis=1) == pytest.approx([5.7e-6, 2.8e-6, 7.6e-6], abs=1e-7)


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
    with pytest.raises(DesignError, match="act alike"):
        design_integral_sliding_mode(
            twin,
            Reference.constant(twin, [0.0], [0.0, 0.0]),
            nominal=[[1.0], [1.0]],
            reaching=ConstantRate(1.0),
            boundary=Sign(),
            dt=DT,
        )


def test_a_time_varying_regulator_along_a_moving_reference_is_made_robust():
    """Disturbed, the errors are those of the undisturbed TVLQR loop, but for the band of s."""
    model = cart()
    reference = Reference.from_functions(
        model, lambda t: [np.sin(t), np.cos(t)], lambda t: [-2 * np.sin(t)], 0.0, 3.0
    )
    dt = 0.01
    inner = design_tvlqr(model, reference, Q=np.eye(2), R=np.eye(1), terminal=10 * np.eye(2))
    controller = design_integral_sliding_mode(
        model,
        reference,
        nominal=inner,
        reaching=ConstantRate(1.0),
        boundary=SaturationLayer(0.01),
        dt=dt,
        bound=0.9,
    )
    start = [0.1, 1.0]
    nominal = step_through(inner, model, start, dt=dt, tf=3.0)
    robust = step_through(controller, model, start, dt=dt, tf=3.0, disturbance=disturbed)
    alone = step_through(inner, model, start, dt=dt, tf=3.0, disturbance=disturbed)
    assert np.max(np.abs(robust.x - nominal.x)) < 0.01
    assert np.max(np.abs(alone.x - nominal.x)) > 0.1
    assert np.max(np.abs(robust.memory("s"))) <= 0.009 * 1.001
