"""Lags followed within the minor step: against SciPy's integration of plant and actuators together."""

import casadi as ca
import numpy as np
import pytest
import scipy

import gnc_opt as go
from gnc_opt.simulation import ClosedLoop, Lag, Mixer, Saturation, ScaleFactor

DT = 0.05
START = [0.4, -0.2]


def pendulum() -> go.Model:
    model = go.Model("pendulum")
    th, w, T = model.state("th"), model.state("w"), model.control("T")
    model.ode({th: w, w: 9.81 * ca.sin(th) - 0.1 * w + T})
    return model


@pytest.fixture(scope="module")
def regulator():
    return go.design_lqr(pendulum(), [0, 0], Q=[10, 1], R=[0.5], dt=DT)


def truth(regulator, *, tau, tf, gain=1.0, limit=8.0):
    """Return the states (2, n + 1) with the lag's output as a state beside the plant's own."""
    x, states = np.array([*START, 0.0]), [START]
    for k in range(round(tf / DT)):
        u = float(np.clip(regulator(k * DT, x[:2])[0][0], -limit, limit))

        def f(t, y, u=u):
            return [y[1], 9.81 * np.sin(y[0]) - 0.1 * y[1] + gain * y[2], (u - y[2]) / tau]

        method = "Radau" if tau < 1e-3 else "DOP853"
        x = scipy.integrate.solve_ivp(f, (0.0, DT), x, rtol=1e-12, atol=1e-13, method=method).y[:, -1]
        states.append(x[:2])
    return np.array(states).T


@pytest.mark.parametrize(("tau", "tf"), [(1e-4, 0.1), (5e-3, 1.0), (0.05, 1.0), (10.0, 1.0)])
def test_lag_is_exact_whatever_its_time_constant(regulator, tau, tf):
    chain = [Saturation("limit", -8, 8), Lag("lag", tau)]
    run = ClosedLoop(pendulum(), regulator, chain).simulate(START, tf=tf)
    apart = np.max(np.abs(run.states - truth(regulator, tau=tau, tf=tf)))
    assert run.outcome.ok and max(apart, run.integration_error) < 1e-9


def test_blocks_without_memory_act_at_every_time(regulator):
    chain = [
        Saturation("limit", -8, 8), Lag("lag", 0.05), ScaleFactor("weak", 0.7), Mixer("mix", [[1.0]], "T"),
    ]  # fmt: skip
    run = ClosedLoop(pendulum(), regulator, chain).simulate(START, tf=1.0)
    assert run.outcome.ok
    assert np.max(np.abs(run.states - truth(regulator, tau=0.05, gain=0.7, tf=1.0))) < 1e-9


@pytest.mark.parametrize(("eccentricity", "revolutions"), [(0.0, 1), (0.5, 30)])
def test_the_error_of_a_long_orbit_is_not_printed_too_small(eccentricity, revolutions):
    """Errors of single steps grow along the orbit; after whole revolutions the state is that of the start."""
    model = go.Model("orbit")
    p, v, u = model.state("p", 2), model.state("v", 2), model.control("u", 2)
    model.ode({p: v, v: -p / ca.norm_2(p) ** 3 + u})
    coasting = go.feedforward(
        go.Reference.from_functions(model, lambda t: [1, 0, 0, 1], lambda t: [0, 0], 0, 1e4)
    )
    start = [1 - eccentricity, 0, 0, np.sqrt((1 + eccentricity) / (1 - eccentricity))]
    loop = ClosedLoop(model, coasting, dt=2 * np.pi / 50, accuracy=1e-6)
    flight = loop.compile(start, tf=2 * np.pi * revolutions)
    ending = flight.final_values(flight.nominal[:, None], [0])
    apart = float(np.max(np.abs(ending.states[:, 0] - start)))
    assert ending.outcomes[0].ok
    assert apart <= ending.integration_error[0] <= 1e-6
