"""Sensors: what the controller sees, sample by sample."""

import casadi as ca
import numpy as np
import pytest
from testing.loops import memory_of_impulse, scheduled

from gnc_opt.errors import ArgumentError
from gnc_opt.simulation import Bias, ClosedLoop, Delay, Noise, RandomWalk, ScaleFactor, ZeroOrderHold


def see(sensors, *, tf=3.0, size=1, seed=0):
    plant = memory_of_impulse(size)
    loop = ClosedLoop(plant, scheduled(plant, lambda t: np.ones((size, t.size))), sensors=sensors, dt=0.1)
    return loop.simulate(np.full(size, 2.0), tf=tf, seed=seed)


def test_without_sensors_the_state_is_seen():
    run = see([])
    assert np.array_equal(run.measured, run.states[:, :-1])


def test_bias_and_scale():
    run = see([ScaleFactor("scale", 1.1), Bias("bias", 0.5)])
    assert run.measured == pytest.approx(1.1 * run.states[:, :-1] + 0.5)


def test_sampling_holds_from_sample_to_sample():
    run = see([ZeroOrderHold("slow", 0.4)])
    k = np.arange(30)
    assert np.array_equal(run.measured[0], run.states[0, 4 * (k // 4)])


def test_delay_shifts_exactly_and_begins_with_the_first_sample():
    run = see([Delay("late", 0.3)])
    assert np.array_equal(run.measured[0], run.states[0, np.maximum(np.arange(30) - 3, 0)])


def test_delay_of_zero_is_none():
    run = see([Delay("late", 0.0)])
    assert np.array_equal(run.measured, run.states[:, :-1])


@pytest.mark.slow
def test_random_walk_grows_with_the_root_of_time():
    run = see([RandomWalk("drift", 0.2)], tf=100.0, size=20, seed=2)
    drift = run.measured - run.states[:, :-1]
    assert np.all(drift[:, 0] == 0)
    steps = np.diff(drift, axis=1)
    assert np.std(steps) == pytest.approx(0.2 * np.sqrt(0.1), rel=4 / np.sqrt(2 * steps.size))


def test_noise_on_a_manifold_moves_along_it():
    def turn(x, e):
        return ca.vertcat(ca.cos(e) * x[0] - ca.sin(e) * x[1], ca.sin(e) * x[0] + ca.cos(e) * x[1])

    plant = memory_of_impulse(2)
    loop = ClosedLoop(
        plant, scheduled(plant, lambda t: np.zeros((2, t.size))), sensors=[Noise("star", 0.3, turn)], dt=0.1
    )
    run = loop.simulate([0.6, 0.8], tf=10.0)
    assert np.linalg.norm(run.measured, axis=0) == pytest.approx(1.0, abs=1e-14)
    assert np.ptp(run.measured[0]) > 0.3


def test_periods_that_are_no_multiples_are_refused():
    with pytest.raises(ArgumentError, match=r"period of 'slow' is 0\.25 s, not a multiple"):
        see([ZeroOrderHold("slow", 0.25)])


def test_errors_that_a_retraction_does_not_take_are_refused():
    from gnc_opt.model import Model
    from gnc_opt.simulation import Bias, ClosedLoop, Noise
    from gnc_opt.spacecraft import mrp_rate, mrp_retraction

    body = Model("body")
    sigma, omega = body.state("sigma", 3), body.control("omega", 3)
    body.ode({sigma: mrp_rate(sigma, omega)})
    law = scheduled(body, lambda t: np.zeros((3, 1)) + 0 * t)
    for sensor, words in (
        (
            Noise("tracker", 0.01, mrp_retraction, on="sigma"),
            "given with sigma of 'tracker' .* of 1 component as given",
        ),
        (
            Bias("mount", [0.01, 0.0], mrp_retraction, on="sigma"),
            "given with the bias of 'mount' .* of 2 components as given",
        ),
        (
            Noise("tracker", 0.01, lambda x, e: x[0] + e, on="sigma"),
            r"returns the shape \(1, 1\) where \(3, 1\)",
        ),
    ):
        with pytest.raises(ArgumentError, match=words):
            ClosedLoop(body, law, sensors=[sensor], dt=0.1)
    ClosedLoop(body, law, sensors=[Noise("tracker", [0.01] * 3, mrp_retraction, on="sigma")], dt=0.1)
