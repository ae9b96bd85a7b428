"""Outputs of actuators between samples, and the printed error of the integration."""

from decimal import Decimal, localcontext

import casadi as ca
import numpy as np
import pytest
from testing.internals import ActuatorWaveform, stack_actuator_waveforms
from testing.loops import controller, feedback, scheduled

from gnc_opt.model import Model
from gnc_opt.simulation import ClosedLoop, Delay, RateLimit

NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)
NODES, WEIGHTS = 0.5 * (NODES + 1), 0.5 * WEIGHTS
TARGET, GAP = np.array([[1.0], [-2.0]]), np.array([[0.3], [4.0]])


@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize(("begin", "end"), [(0.0, 2.0), (0.5, 1.5)])
@pytest.mark.parametrize("tau", [(0.2, 0.6), (0.05, 50.0), (5.0, 5.0)])
def test_an_integration_step_sees_three_moments_of_a_decay(tau, begin, end, steps):
    """Behind a lag, a held component beside it, and half of both behind a block without memory."""
    taus, sigma = ca.SX(list(tau)), (end - begin) / steps
    lagged = ActuatorWaveform(ca.SX(TARGET), lambda decay: TARGET + GAP * decay(taus))
    value = (
        stack_actuator_waveforms([lagged, ActuatorWaveform(ca.SX(7.0))])
        .apply_function_to_waveform(lambda y: 0.5 * y)
        .sample_runge_kutta_stage_inputs(begin, sigma)
    )
    for k in range(steps):
        s = begin + sigma * (k + NODES)
        wanted = 0.5 * np.vstack([TARGET + GAP * np.exp(-s / np.array(tau)[:, None]), 7.0 + 0 * s])
        found = np.hstack([ca.evalf(value(k, float(node))).full() for node in NODES])
        for j in range(3):
            assert found @ (WEIGHTS * NODES**j) == pytest.approx(wanted @ (WEIGHTS * NODES**j), abs=1e-9)


def test_delays_and_rate_limits_are_exact_in_their_means():
    """Two delays and a rate limit on three controls: held, then held, then a ramp, in one step of 1 s."""
    plant = Model("impulses")
    x = plant.state("x", 3)
    a, b, c = (plant.control(name) for name in "abc")
    plant.ode({x: ca.vertcat(a, b, c)})
    law = scheduled(plant, lambda t: np.tile([[2.0], [3.0], [4.0]], t.size))
    chain = [Delay("late", 0.25, on="a"), Delay("later", 0.75, on="b"), RateLimit("slew", 8.0, on="c")]
    run = ClosedLoop(plant, law, chain, dt=1.0).simulate(np.zeros(3), tf=1.0)
    assert run.applied[:, 0] == pytest.approx([2 * 0.75, 3 * 0.25, 4 * (1 - 0.25)], rel=1e-13)
    assert run.states[:, -1] == pytest.approx(run.applied[:, 0], rel=1e-13)
    assert run.outcome.ok


@pytest.mark.parametrize("options", [{"substeps": 1}, {"accuracy": 0.1}])
def test_the_printed_error_is_that_of_the_end_where_errors_grow(options):
    """x' = 4 x from 1/2 exp(-16), to 1/2 after 4 s: errors of the first steps are multiplied by millions."""
    plant = Model("growing")
    x, u = plant.state("x"), plant.control("u")
    plant.ode({x: 4 * x + u})
    loop = ClosedLoop(plant, feedback(plant, [[0.0]]), dt=0.5, **options)
    flight = loop.compile([0.5 * np.exp(-16.0)], tf=4.0)
    ending = flight.final_values(flight.nominal[:, None], [0])
    assert 1.0 < ending.integration_error[0] / abs(ending.states[0, 0] - 0.5) < 1.4


@pytest.mark.parametrize(
    ("dt", "tf", "accuracy"), [(0.02, 10.0, 1e-6), (0.02, 10.0, 1e-8), (0.1, 40.0, 1e-6)]
)
def test_a_relay_on_an_unstable_plant_is_no_run_that_passes(dt, tf, accuracy):
    """x' = 2 x - sign(x) of the samples: exactly x E - sign(x) (E - 1) / 2 after each, E = exp(2 dt), with 60 digits.

    Nothing damps the difference of two runs whose relay turns at the same samples: it grows as exp(2 t), rounding, too;
    over 40 s by 5e34, and the relays turn at other samples.
    """
    plant = Model("unstable")
    x, u = plant.state("x"), plant.control("u")
    plant.ode({x: 2 * x + u})
    relay = controller(plant, lambda t, x, r, z: (-ca.sign(x), z))
    start = 0.3
    run = ClosedLoop(plant, relay, dt=dt, accuracy=accuracy).simulate([start], tf=tf)
    with localcontext() as context:
        context.prec = 60
        growth, exact = (2 * Decimal(dt)).exp(), Decimal(start)
        for _ in range(run.commands.shape[1]):
            exact = growth * exact - (growth - 1) / 2 * (1 if exact > 0 else -1)
        error = abs(float(Decimal(float(run.states[0, -1])) - exact))
    assert run.outcome.ok == (run.integration_error <= accuracy)
    assert error <= accuracy or not run.outcome.ok
