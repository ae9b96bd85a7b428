"""Nonlinear designs from distant starts: what their closed loops show within limits and with critical zero dynamics."""

import casadi as ca
import numpy as np
import pytest
from testing.models import dynamics

import gnc_opt as go
from gnc_opt.control import (
    ConstantRate,
    ExponentialRate,
    SaturationLayer,
    design_feedback_linearization,
    design_sliding_mode,
)
from gnc_opt.simulation import Saturation

GRAVITY, DT = 9.81, 0.01


def pendulum() -> go.Model:
    model = go.Model("pendulum")
    th, w, T = model.state("th", unit="rad"), model.state("w", unit="rad/s"), model.control("T", unit="N m")
    model.ode({th: w, w: GRAVITY * ca.sin(th) + T})
    return model


def slider() -> go.Controller:
    law = {"reaching": ConstantRate(1.0), "boundary": SaturationLayer(0.05), "bound": 0.2, "dt": DT}
    return design_sliding_mode(pendulum(), [0, 0], outputs="th", slopes=2.0, **law)


def linearised() -> go.Controller:
    return design_feedback_linearization(pendulum(), [0, 0], outputs="th", poles=[-2, -2], dt=DT)


@pytest.mark.parametrize("design", [slider, linearised])
def test_a_torque_limit_holds_the_pendulum_up_to_its_static_balance(design):
    """The torque of 5 N m balances gravity at asin(5 / 9.81) = 0.535 rad: it returns from 0.5 rad, not from 1.2 rad."""
    loop = go.ClosedLoop(pendulum(), design(), [Saturation("motor", -5.0, 5.0)])
    near, far = (loop.simulate([angle, 0.0], tf=8.0) for angle in (0.5, 1.2))
    assert near.outcome.ok and abs(near.states[0, -1]) < 0.01
    assert near.saturation_time("T") > 0
    assert np.max(np.abs(far.states[0])) > 3


def test_the_limit_delays_the_surface_beyond_the_reaching_time():
    """s falls at the rate 1 from 1 to the layer of 0.05 without limits; the motor at its limit leaves it less."""
    start, times = [0.5, 0.0], []
    for actuators in ([], [Saturation("motor", -5.0, 5.0)]):
        run = go.ClosedLoop(pendulum(), slider(), actuators).simulate(start, tf=8.0)
        s = run.states[1] + 2 * run.states[0]
        times.append(run.times[np.argmax(np.abs(s) <= 0.05)])
    ideal = ConstantRate(1.0).reaching_time(1.0 - 0.05, 0.0)
    assert times[0] == pytest.approx(ideal, abs=2 * DT) and times[1] > ideal + 0.1


def cubic(sign: float) -> go.Model:
    """Zero dynamics +-eta^3 with an eigenvalue of zero: from eta_0 they are eta_0 / sqrt(1 -+ 2 eta_0^2 t)."""
    model, *_ = dynamics("cubic", "x1 eta", "u", lambda x1, eta, u: {x1: u, eta: sign * eta**3 + x1})
    return model


def simulated(sign: float, eta: float, tf: float, substeps: int) -> go.Run:
    law = {"reaching": ExponentialRate(1.0, 1.0), "boundary": SaturationLayer(0.1), "dt": DT}
    controller = design_sliding_mode(cubic(sign), [0, 0], outputs="x1", **law)
    return go.ClosedLoop(cubic(sign), controller, accuracy=1e-5, substeps=substeps).simulate(
        [0.0, eta], tf=tf
    )


@pytest.mark.parametrize("eta", [0.3, 0.1])
def test_zero_dynamics_escape_at_their_time_although_the_output_rests(eta):
    run = simulated(1.0, eta, 60.0, 4)
    assert run.outcome.status in (go.RunStatus.DIVERGED, go.RunStatus.NOT_FINITE)
    assert run.outcome.time == pytest.approx(0.5 / eta**2, abs=0.02)
    at = 0.4 / eta**2
    assert run.state("eta")(round(at, 2))[0] == pytest.approx(
        eta / np.sqrt(1 - 2 * eta**2 * round(at, 2)), rel=1e-6
    )


def test_stable_critical_zero_dynamics_return_from_afar():
    """eta' = -eta^3: at eta = 20 its slope is -1200 1/s, at the reference 0."""
    run = simulated(-1.0, 20.0, 10.0, 40)
    assert run.outcome.ok and run.states[1, -1] == pytest.approx(20 / np.sqrt(1 + 800 * 10.0), rel=1e-6)
