"""Every actuator against its closed-form response."""

import numpy as np
import pytest
from testing.loops import memory_of_impulse, scheduled

from gnc_opt.control import Reference, feedforward
from gnc_opt.errors import ArgumentError
from gnc_opt.model import Model
from gnc_opt.simulation import (
    ClosedLoop,
    Deadband,
    Delay,
    Lag,
    Noise,
    Pwm,
    Pwpf,
    Quantisation,
    RateLimit,
    Saturation,
    ScaleFactor,
    SchmittTrigger,
    ZeroOrderHold,
)

DT = 0.1


def fly(actuators, command, *, tf=2.0, minor_steps=1, size=1, **more):
    plant = memory_of_impulse(size)
    loop = ClosedLoop(plant, scheduled(plant, command), actuators, dt=DT, minor_steps=minor_steps)
    run = loop.simulate(np.zeros(size), tf=tf, **more)
    assert run.outcome.ok
    # the plant integrates what is applied: the log and the plant must agree, whatever the actuator does
    assert run.states[:, 1:] == pytest.approx(np.cumsum(run.applied, axis=1) * DT, rel=1e-12, abs=1e-12)
    return run


def wave(t):
    return 2.0 * np.sin(3.0 * t)


def test_lag_has_the_exact_response_and_impulse():
    tau = 0.13
    run = fly([Lag("lag", tau)], lambda t: np.ones_like(t))
    impulse = run.times - tau * (1 - np.exp(-run.times / tau))
    assert run.states[0] == pytest.approx(impulse, abs=1e-14)


def test_lag_does_not_depend_on_the_minor_step():
    coarse, fine = (fly([Lag("lag", 0.07)], wave, minor_steps=m) for m in (1, 7))
    assert coarse.states == pytest.approx(fine.states, abs=1e-13)


def test_lag_of_zero_is_none():
    run = fly([Lag("lag", 0.0)], wave)
    assert run.applied[0] == pytest.approx(wave(run.times[:-1]), abs=1e-11)


def test_rate_limit_ramps_then_holds():
    rate, target = 3.0, 1.0
    run = fly([RateLimit("slew", rate)], lambda t: np.full_like(t, target))
    reach = target / rate
    ramp = np.where(
        run.times < reach, rate * run.times**2 / 2, target * reach / 2 + target * (run.times - reach)
    )
    assert run.states[0] == pytest.approx(ramp, abs=1e-14)
    assert run.saturation_time("a")[0] == pytest.approx(
        0.3
    )  # the steps in which the limit acts: reach is in the 4th


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.25, 0.3, 0.4])
def test_delay_shifts_exactly(delay):
    run = fly([Delay("pipe", delay, maximum=0.4)], wave)
    late = run.times[:-1] - delay
    k = np.floor(late / DT + 1e-9)
    share = late / DT - k  # of the newer command in the step

    def commanded(step):
        return np.where(step >= 0, wave(step * DT), 0.0)

    expected = share * commanded(k + 1) + (1 - share) * commanded(k)
    assert run.applied[0] == pytest.approx(expected, abs=1e-12)


def test_delay_beyond_its_line_is_refused():
    plant = memory_of_impulse()
    loop = ClosedLoop(plant, scheduled(plant, wave), [Delay("pipe", 0.2)], dt=DT)
    with pytest.raises(ArgumentError, match=r"'pipe\.delay' is 0\.3, outside \[0, 0\.2\]"):
        loop.simulate([0.0], tf=1.0, parameters={"pipe.delay": 0.3})


GRAVITY = 9.81


def hover(*actuators):
    vehicle = Model("hovering vehicle")
    h, w, f = vehicle.state("h", unit="m"), vehicle.state("w", unit="m/s"), vehicle.control("f", unit="N")
    vehicle.ode({h: w, w: f / 2.0 - GRAVITY})
    loop = ClosedLoop(vehicle, feedforward(Reference.constant(vehicle, [10.0, 0.0])), actuators, dt=DT)
    return loop.simulate([10.0, 0.0], tf=2.0)


ACTUATORS = {
    "lag": lambda **at: Lag("a", 0.3, **at),
    "rate": lambda **at: RateLimit("a", 20.0, **at),
    "delay": lambda **at: Delay("a", 0.25, **at),
}


@pytest.mark.parametrize("kind", ACTUATORS)
def test_a_vehicle_in_trim_hovers_from_the_first_moment(kind):
    """From rest the thrust that is missing is lost for ever: tau, half the time of the ramp, or the delay, times g."""
    actuator = ACTUATORS[kind]
    assert hover(actuator(initial="trim")).states == pytest.approx(
        np.array([[10.0], [0.0]]) * np.ones(21), abs=1e-11
    )
    missing = {"lag": 0.3 * (1 - np.exp(-2.0 / 0.3)), "rate": 0.5 * 2 * GRAVITY / 20.0, "delay": 0.25}[kind]
    assert hover(actuator()).states[1, -1] == pytest.approx(-GRAVITY * missing, rel=1e-9)


def test_trim_is_what_arrives_at_the_actuator():
    """Behind a scale factor of one half and a limit the lag begins at what they leave of the feedforward."""
    weak = hover(
        ScaleFactor("weak", 0.5), Lag("motor", 0.3, initial="trim"), Delay("pipe", 0.1, initial="trim")
    )
    assert weak.applied == pytest.approx(np.full((1, 20), GRAVITY), rel=1e-12)
    low = hover(Saturation("limit", 0.0, 7.0), RateLimit("slew", 1.0, initial="trim"))
    assert low.applied == pytest.approx(np.full((1, 20), 7.0), rel=1e-12)


def test_trim_without_feedforward_is_refused():
    plant = memory_of_impulse()
    with pytest.raises(
        ArgumentError, match="'lag' is to start at trim, but 'by hand' has no feedforward of 'a'"
    ):
        ClosedLoop(plant, scheduled(plant, wave), [Lag("lag", 0.1, initial="trim")], dt=DT)
    with pytest.raises(ArgumentError, match="first output of 'lag'"):
        fly([Lag("lag", 0.1, initial="rest")], wave)


def test_saturation_limits_and_counts_its_time():
    run = fly([Saturation("limit", -1.0, 1.5)], wave)
    u = wave(run.times[:-1])
    assert run.applied[0] == pytest.approx(np.clip(u, -1.0, 1.5), abs=1e-15)
    assert run.saturation_time("a")[0] == pytest.approx(DT * np.sum((u < -1.0) | (u > 1.5)))
    assert run.control_effort("a")[0] == pytest.approx(DT * np.sum(np.abs(np.clip(u, -1.0, 1.5))))
    assert run.control_energy("a")[0] == pytest.approx(DT * np.sum(np.clip(u, -1.0, 1.5) ** 2))
    assert run.total_variation("a")[0] == pytest.approx(np.sum(np.abs(np.diff(u))))


def test_deadband_quantisation_and_scale():
    u = wave(np.arange(20) * DT)
    assert fly([Deadband("dead", 0.7)], wave).applied[0] == pytest.approx(np.where(np.abs(u) < 0.7, 0, u))
    assert fly([Quantisation("adc", 0.25)], wave).applied[0] == pytest.approx(0.25 * np.floor(u / 0.25 + 0.5))
    assert fly([ScaleFactor("weak", 0.9, 0.1)], wave).applied[0] == pytest.approx(0.9 * u + 0.1)


def test_hold_takes_every_third_command():
    run = fly([ZeroOrderHold("slow", 0.3)], wave)
    assert run.applied[0] == pytest.approx(wave(np.floor(np.arange(20) / 3) * 0.3))


@pytest.mark.parametrize("m", [4, 10, 25])
def test_pwm_mean_is_the_command_to_one_minor_step(m):
    thrust = 2.5
    run = fly([Pwm("valve", thrust)], wave, minor_steps=m)
    error = run.applied[0] - wave(run.times[:-1])
    assert np.max(np.abs(error)) <= thrust / (2 * m) + 1e-12
    on_steps = run.applied[0] / thrust * m  # it is on or off, nothing between
    assert on_steps == pytest.approx(np.round(on_steps), abs=1e-9)


def test_pwm_drops_pulses_that_are_too_short():
    run = fly([Pwm("valve", 2.5, minimum_on=0.035)], lambda t: 0.75 + 0 * t, minor_steps=10)
    assert np.all(run.applied == 0)  # 30 ms would be needed
    run = fly([Pwm("valve", 2.5, minimum_on=0.025)], lambda t: 0.75 + 0 * t, minor_steps=10)
    assert run.applied[0] == pytest.approx(0.75)


def test_pwm_over_several_control_steps_keeps_the_command_of_its_beginning():
    run = fly([Pwm("valve", 1.0, period=0.4)], lambda t: np.where(t < 0.05, 0.5, -1.0), tf=0.8, minor_steps=5)
    assert run.applied[0] == pytest.approx([1, 1, 0, 0, -1, -1, -1, -1])


def test_pwm_without_minor_steps_is_refused():
    plant = memory_of_impulse()
    with pytest.raises(ArgumentError, match=r"'valve' is one minor step .* more minor_steps"):
        ClosedLoop(plant, scheduled(plant, wave), [Pwm("valve", 1.0)], dt=DT)


def test_schmitt_trigger_has_its_hysteresis():
    commands = np.array([0.0, 0.5, 0.9, 0.5, 0.35, 0.25, 0.5, -0.5, -0.9, -0.4, 0.9, 0.1])
    run = fly(
        [SchmittTrigger("jet", 2.0, 0.8, 0.3)],
        lambda t: commands[np.minimum(np.round(t / DT).astype(int), 11)],
        tf=1.2,
    )
    assert run.applied[0] == pytest.approx([0, 0, 2, 2, 2, 0, 0, 0, -2, -2, 2, 0])


def test_pwpf_mean_thrust_follows_the_static_characteristic():
    # quasi-static: y swings between off/on levels along exponentials towards K u and K (u - thrust)
    thrust, on, off, tau, gain, u = 1.0, 0.45, 0.15, 0.2, 4.5, 0.4
    run = fly([Pwpf("jet", thrust, on, off, tau, gain)], lambda t: u + 0 * t, tf=20.0, minor_steps=100)
    rise = tau * np.log((gain * u - off) / (gain * u - on))
    fall = tau * np.log((on - gain * (u - thrust)) / (off - gain * (u - thrust)))
    share = fall / (rise + fall)
    settled = run.times[:-1] > 5
    assert np.mean(run.applied[0][settled]) == pytest.approx(thrust * share, abs=0.02)


def test_a_chain_passes_its_blocks_in_order_and_on_named_controls():
    run = fly(
        [Saturation("limit", -1, 1, on="a"), ScaleFactor("weak", [0.5, 2.0])],
        lambda t: np.vstack([3 + 0 * t, 0.2 + 0 * t]),
        size=2,
    )
    assert run.applied[:, 0] == pytest.approx([0.5, 0.4])


def test_a_scale_factor_without_numbers_changes_nothing():
    assert fly([ScaleFactor("ideal")], wave).applied[0] == pytest.approx(wave(np.arange(20) * DT), abs=1e-15)
    assert fly([ScaleFactor("off", bias=0.2)], wave).applied[0] == pytest.approx(
        wave(np.arange(20) * DT) + 0.2
    )


def test_levels_that_make_no_sense_are_refused():
    plant = memory_of_impulse()
    for block, message in (
        (SchmittTrigger("jet", 1.0, 0.2, 0.3), "'jet' switches on at"),
        (Saturation("limit", 1.0, -1.0), "'limit' has lower limits"),
        (Pwpf("jet", 1.0, 0.4, 0.2, -1.0), "the time constant of 'jet'"),
    ):
        with pytest.raises(ArgumentError, match=message):
            ClosedLoop(plant, scheduled(plant, wave), [block], dt=DT).layout  # noqa: B018


SCALES = np.array([1.0, -0.6, 1.7])


@pytest.mark.parametrize(
    "block",
    [
        Saturation("b", -1.0, 1.5), ScaleFactor("b", 1.2, 0.1), Deadband("b", 0.5), Quantisation("b", 0.3),
        Lag("b", 0.2), RateLimit("b", 3.0), Delay("b", 0.3),
        Pwm("b", 1.5), SchmittTrigger("b", 1.0, 0.8, 0.3), Pwpf("b", 1.0, 0.45, 0.15, 0.2, 4.5),
        ZeroOrderHold("b", 0.4),
    ],
    ids=lambda block: type(block).__name__,
)  # fmt: skip
def test_each_component_is_treated_as_if_it_were_alone(block):
    """Three commands at once, one of them of the other sign: applied, counted and summed as three runs of one."""
    together = fly([block], lambda t: SCALES[:, None] * wave(t + 0.3), size=3, minor_steps=4)
    for i, scale in enumerate(SCALES):
        alone = fly([block], lambda t, scale=scale: scale * wave(t + 0.3), minor_steps=4)
        assert together.applied[i] == pytest.approx(alone.applied[0], abs=1e-13)
        for sum_ in ("effort", "energy", "saturation", "variation"):
            assert getattr(together, sum_)[i] == pytest.approx(getattr(alone, sum_)[0], rel=1e-12, abs=1e-13)


@pytest.mark.parametrize(
    "block", [Pwm("b", 1.5), SchmittTrigger("b", 1.0, 0.8, 0.3)], ids=lambda block: type(block).__name__
)
def test_a_command_that_is_no_number_does_not_become_a_pulse(block):
    plant = memory_of_impulse()
    lost = scheduled(plant, lambda t: np.where(t < 0.95, 1.0, np.nan))
    run = ClosedLoop(plant, lost, [block], dt=DT, minor_steps=4).simulate([0.0], tf=2.0)
    assert not run.outcome.ok
    assert np.all(np.isfinite(run.states[0, :11])) and np.all(np.isnan(run.states[0, 11:]))


@pytest.mark.parametrize("minor_steps", [1, 4])
def test_noise_of_an_actuator_is_drawn_anew_in_every_minor_step(minor_steps):
    """So that the mean over a control step has the standard deviation of a mean."""
    run = fly([Noise("f", 0.2)], lambda t: 0 * t, tf=100.0, minor_steps=minor_steps)
    expected = 0.2 / np.sqrt(minor_steps)
    assert np.std(run.applied[0]) == pytest.approx(expected, rel=4 / np.sqrt(2 * 1000))
