"""Actuators followed within the minor step: against SciPy's integration of plant and actuators together."""

import casadi as ca
import numpy as np
import pytest
import scipy

import gnc_opt as go
from gnc_opt.simulation import ClosedLoop, Delay, Lag, Mixer, RateLimit, Saturation, ScaleFactor

DT = 0.05
START = [0.4, -0.2]
DELAY, RATE = 0.03, 60.0


def pendulum() -> go.Model:
    model = go.Model("pendulum")
    th, w, T = model.state("th"), model.state("w"), model.control("T")
    model.ode({th: w, w: 9.81 * ca.sin(th) - 0.1 * w + T})
    return model


@pytest.fixture(scope="module")
def regulator():
    return go.design_lqr(pendulum(), [0, 0], Q=[10, 1], R=[0.5], dt=DT)


def truth(regulator, *, delay=0.0, rate=np.inf, tau=1e-9, tf=2.0, gain=1.0, limit=8.0):
    """Return the states (2, n + 1) with the actuators' outputs as states beside the plant's own."""
    x, commands, states = np.array([*START, 0.0, 0.0]), [], [START]

    def commanded(t):
        return 0.0 if t < delay else commands[int((t - delay) / DT + 1e-9)]

    for k in range(round(tf / DT)):
        commands.append(float(np.clip(regulator(k * DT, x[:2])[0][0], -limit, limit)))
        for begin, end in ((0.0, delay), (delay, DT)):
            if end <= begin:
                continue
            begin, end = k * DT + begin, k * DT + end
            target = commanded(0.5 * (begin + end))
            if np.isinf(rate):
                x[2] = target
            kink = min(begin + abs(target - x[2]) / rate, end)
            slew = rate * np.sign(target - x[2]) if np.isfinite(rate) else 0.0
            for left, right, slope in ((begin, kink, slew), (kink, end, 0.0)):
                if right - left < 1e-14:
                    continue

                def f(t, y, slope=slope):
                    return [y[1], 9.81 * np.sin(y[0]) - 0.1 * y[1] + gain * y[3], slope, (y[2] - y[3]) / tau]

                method = "Radau" if tau < 1e-3 else "DOP853"
                found = scipy.integrate.solve_ivp(f, (left, right), x, rtol=1e-12, atol=1e-13, method=method)
                x = found.y[:, -1]
        states.append(x[:2])
    return np.array(states).T


@pytest.mark.parametrize(("tau", "tf"), [(1e-4, 0.2), (5e-3, 1.0), (0.05, 1.0), (10.0, 1.0)])
def test_lag_is_exact_whatever_its_time_constant(regulator, tau, tf):
    chain = [Saturation("limit", -8, 8), Lag("lag", tau)]
    run = ClosedLoop(pendulum(), regulator, chain).simulate(START, tf=tf)
    apart = np.max(np.abs(run.states - truth(regulator, tau=tau, tf=tf)))
    assert run.outcome.ok and max(apart, run.integration_error) < 1e-9


def test_delay_rate_limit_and_lag_in_a_row_are_exact(regulator):
    actuators = [Saturation("limit", -8, 8), Delay("pipe", DELAY), RateLimit("slew", RATE), Lag("lag", 0.04)]
    run = ClosedLoop(pendulum(), regulator, actuators).simulate(START, tf=2.0)
    apart = np.max(np.abs(run.states - truth(regulator, delay=DELAY, rate=RATE, tau=0.04)))
    assert run.outcome.ok and max(apart, run.integration_error) < 1e-9
    assert run.saturation_time("T")[0] > 0


def test_minor_steps_change_nothing(regulator):
    actuators = [Saturation("limit", -8, 8), Delay("pipe", DELAY), RateLimit("slew", RATE), Lag("lag", 0.04)]
    runs = [
        ClosedLoop(pendulum(), regulator, actuators, minor_steps=m).simulate(START, tf=1.0) for m in (1, 3)
    ]
    assert np.max(np.abs(runs[0].states - runs[1].states)) < 1e-9


def test_blocks_without_memory_act_at_every_time(regulator):
    chain = [
        Saturation("limit", -8, 8),
        Lag("lag", 0.05),
        ScaleFactor("weak", 0.7),
        Mixer("mix", [[1.0]], "T"),
    ]
    run = ClosedLoop(pendulum(), regulator, chain).simulate(START, tf=1.0)
    assert run.outcome.ok
    assert np.max(np.abs(run.states - truth(regulator, tau=0.05, gain=0.7, tf=1.0))) < 1e-9


@pytest.mark.parametrize(("eccentricity", "revolutions"), [(0.0, 1), (0.0, 60), (0.5, 60)])
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
    ending = flight.final(flight.nominal[:, None], [0])
    apart = float(np.max(np.abs(ending.states[:, 0] - start)))
    assert ending.outcomes[0].ok
    assert apart <= ending.integration_error[0] <= 1e-6
