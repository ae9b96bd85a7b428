"""Every block by itself: its parameters with units and ranges, its memory, and one step in numbers."""

from __future__ import annotations

import dataclasses
import inspect

import casadi as ca
import numpy as np
import pytest

from gnc_opt.errors import ArgumentError, DesignError
from gnc_opt.model import Layout, Variable
from gnc_opt.simulation import (
    Allocation,
    Bias,
    Block,
    ConstantDisturbance,
    Deadband,
    Delay,
    ExpressionDisturbance,
    Lag,
    MinimumImpulse,
    Mixer,
    Noise,
    NonNegativeAllocation,
    PiecewiseConstantNoise,
    Pwm,
    Pwpf,
    Quantisation,
    RandomWalk,
    RateLimit,
    Sampling,
    Saturation,
    Scale,
    ScaleFactor,
    SchmittTrigger,
    SensorDelay,
    SensorOutage,
    SinusoidalDisturbance,
    ThrusterSet,
    WheelArray,
    ZeroOrderHold,
)
from gnc_opt.simulation.actuators.on_off import trigger
from gnc_opt.simulation.allocation import effect_matrix, pseudo_inverse
from gnc_opt.simulation.block import POSITIVE, Tick, clip, differs, rows, scalar, values
from gnc_opt.simulation.intersample_input import Wave
from gnc_opt.simulation.signals import chain, kinds, put, take

INF = np.inf
H, DT = 0.1, 0.4
EYE = np.eye(2)


def moment(t=0.0, **x):
    return Tick(t, H, DT, 0, {name: ca.SX(ca.DM(value)) for name, value in x.items()})


def numbers(column):
    return np.asarray(ca.evalf(ca.SX(column)).full()[:, 0])


def parameters(block, size, **changes):
    found = {name: value for name, (value, _) in block.parameters(size, "N").items()} | changes
    return {name: ca.SX(ca.DM(value)) for name, value in found.items()}


def advance(block, signal, state=None, *, tick=None, noise=(), **changes):
    """Signal, memory and saturation after one step; from the first memory if none is given."""
    tick = tick or moment()
    p, column = parameters(block, np.size(signal), **changes), ca.SX(ca.DM(signal))
    before = block.start(column, p, tick) if state is None else ca.SX(ca.DM(state))
    _, step = block.flow(tick, Wave(column), before, p, ca.SX(ca.DM(list(noise))))
    return (
        numbers(step.signal),
        numbers(step.state),
        step.saturated if step.saturated is None else numbers(step.saturated),
    )


# --- what can be dispersed, and between which limits ------------------------------------------------------


@pytest.mark.parametrize(
    ("block", "expected", "limits"),
    [
        (Saturation("b"), {"lower": ([-INF, -INF], "N"), "upper": ([INF, INF], "N")}, {}),
        (Saturation("b", -1, [2, 3]), {"lower": ([-1, -1], "N"), "upper": ([2, 3], "N")}, {}),
        (ScaleFactor("b"), {"factor": ([1, 1], ""), "bias": ([0, 0], "N")}, {}),
        (Deadband("b", 0.3), {"width": ([0.3, 0.3], "N")}, {"width": (0.0, INF)}),
        (Quantisation("b", 0.3), {"step_size": ([0.3, 0.3], "N")}, {"step_size": (POSITIVE, INF)}),
        (MinimumImpulse("b", 0.3), {"impulse": ([0.3, 0.3], "N s")}, {"impulse": (0.0, INF)}),
        (Lag("b", 0.3), {"tau": ([0.3, 0.3], "s")}, {"tau": (0.0, INF)}),
        (Lag("b", 0.3, initial=2), {"tau": ([0.3, 0.3], "s"), "initial": ([2, 2], "N")}, {"tau": (0.0, INF)}),
        (RateLimit("b", 0.3), {"rate": ([0.3, 0.3], "N/s")}, {"rate": (POSITIVE, INF)}),
        (Delay("b", 0.25), {"delay": ([0.25], "s")}, {"delay": (0.0, pytest.approx(0.3, rel=1e-9))}),
        (Delay("b", 0.25, 0.4), {"delay": ([0.25], "s")}, {"delay": (0.0, pytest.approx(0.4, rel=1e-9))}),
        (Pwm("b", 2.0), {"thrust": ([2, 2], "N"), "minimum_on": ([0], "s")},
         {"thrust": (POSITIVE, INF), "minimum_on": (0.0, INF)}),
        (SchmittTrigger("b", 2, 0.8, 0.3),
         {"thrust": ([2, 2], "N"), "on_level": ([0.8, 0.8], "N"), "off_level": ([0.3, 0.3], "N")}, {}),
        (Pwpf("b", 2, 0.8, 0.3, 0.2),
         {"thrust": ([2, 2], "N"), "on_level": ([0.8, 0.8], "N"), "off_level": ([0.3, 0.3], "N"),
          "tau": ([0.2], "s"), "gain": ([1], "")}, {"tau": (1e-12, INF)}),
        (ZeroOrderHold("b", 0.2), {}, {}),
        (Noise("b", 0.3), {"sigma": ([0.3, 0.3], "N")}, {"sigma": (0.0, INF)}),
        (Noise("b", [1, 2, 3], lambda x, e: x), {"sigma": ([1, 2, 3], "N")}, {"sigma": (0.0, INF)}),
        (Bias("b", 0.3), {"bias": ([0.3, 0.3], "N")}, {}),
        (Bias("b", [1, 2, 3], lambda x, e: x), {"bias": ([1, 2, 3], "N")}, {}),
        (RandomWalk("b", 0.3), {"sigma": ([0.3, 0.3], "N/s^0.5")}, {"sigma": (0.0, INF)}),
        (Scale("b", 1.1), {"factor": ([1.1, 1.1], "")}, {}),
        (SensorOutage("b", 2.0), {"begin": ([2], "s"), "end": ([INF], "s")}, {}),
        (SensorOutage("b"), {"begin": ([-INF], "s"), "end": ([INF], "s")}, {}),
        (ConstantDisturbance("b", 2.0, on="x"), {"level": ([2, 2], "N")}, {}),
        (SinusoidalDisturbance("b", 2.0, 3.0, on="x"),
         {"amplitude": ([2, 2], "N"), "frequency": ([3], "rad/s"), "phase": ([0, 0], "rad")}, {}),
        (PiecewiseConstantNoise("b", 0.3, on="x"), {"sigma": ([0.3, 0.3], "N")}, {"sigma": (0.0, INF)}),
        (ExpressionDisturbance("b", lambda t, x, p: 0, {"k": [[1, 2], [3, 4]]}, on="x"), {"k": ([1, 2, 3, 4], "")}, {}),
        (ExpressionDisturbance("b", lambda t, x, p: 0, on="x"), {}, {}),
        (WheelArray("b", EYE, 0.5, [1, 2], initial=0.1),
         {"max_torque": ([0.5, 0.5], "N m"), "max_momentum": ([1, 2], "N m s"),
          "momentum": ([0.1, 0.1], "N m s"), "health": ([1, 1], "")},
         {"max_torque": (0.0, INF), "max_momentum": (0.0, INF), "health": (0.0, 1.0)}),
        (Allocation("b", EYE), {}, {}),
    ],
    ids=lambda case: type(case).__name__,
)  # fmt: skip
def test_parameters_have_values_units_and_permitted_ranges(block, expected, limits):
    found = block.parameters(2, "N")
    assert {name: (list(value), unit) for name, (value, unit) in found.items()} == expected
    assert block.limits(H, DT) == limits


def test_an_impulse_without_a_unit_is_in_seconds():
    assert MinimumImpulse("b", 0.3).parameters(1, "")["impulse"][1] == "s"


@pytest.mark.parametrize(
    ("block", "memory", "noise"),
    [
        (Saturation("b"), 0, 0), (Lag("b", 0.3), 2, 0), (Delay("b", 0.25), 6, 0), (Delay("b", 0.0), 0, 0),
        (Pwm("b", 1.0), 3, 0), (SchmittTrigger("b", 1, 0.8, 0.3), 2, 0), (Pwpf("b", 1, 0.8, 0.3, 0.1), 4, 0),
        (ZeroOrderHold("b", 0.2), 3, 0), (Noise("b", 0.3), 0, 2), (Noise("b", [1, 2, 3], lambda x, e: x), 0, 3),
        (RandomWalk("b", 0.3), 2, 2), (Sampling("b", 0.8), 3, 0), (SensorDelay("b", 0.8), 4, 0),
        (PiecewiseConstantNoise("b", 0.3, on="x"), 3, 2), (ConstantDisturbance("b", 1.0, on="x"), 0, 0),
    ],
    ids=lambda case: type(case).__name__,
)  # fmt: skip
def test_memories_and_random_numbers_of_two_components(block, memory, noise):
    assert block.start(ca.SX.zeros(2), parameters(block, 2), moment()).shape == (memory, 1)
    assert block.noise(2) == noise


# --- one step ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("block", "signal", "out", "saturated"),
    [
        (Saturation("b", -1, [2, 3, 4]), [-1.5, 2.0, 5.0], [-1, 2, 4], [1, 0, 1]),
        (ScaleFactor("b", 3, [0.1, 0, 0]), [1, 2, -2], [3.1, 6, -6], None),
        (Deadband("b", 0.5), [0.5, -0.49, -0.51], [0.5, 0, -0.51], None),
        (Quantisation("b", 0.5), [0.24, 0.25, -0.6], [0, 0.5, -0.5], None),
        (MinimumImpulse("b", 0.2), [0.5, -0.49, -0.51], [0.5, 0, -0.51], None),
        (Scale("b", 3), [1, 2, -2], [3, 6, -6], None),
        (Bias("b", [1, 2, 3]), [1, 2, -2], [2, 4, 1], None),
        (Bias("b", [1, 2, 3], lambda x, e: x * e), [1, 2, -2], [1, 4, -6], None),
    ],
)
def test_blocks_without_memory(block, signal, out, saturated):
    found, memory, limited = advance(block, signal)
    assert found == pytest.approx(out, abs=1e-15) and memory.size == 0
    assert limited is None if saturated is None else list(limited) == saturated


def test_noise_is_so_many_standard_deviations():
    assert advance(Noise("b", [2.0, 3.0]), [1.0, 1.0], noise=[0.5, -1.0])[0] == pytest.approx([2.0, -2.0])
    moved = Noise("b", [2.0], lambda x, e: x * e)
    assert advance(moved, [1.0, 3.0], noise=[0.5])[0] == pytest.approx([1.0, 3.0])
    after = advance(RandomWalk("b", [2.0, 3.0]), [1.0, 1.0], [0.5, 0.25], noise=[1.0, -1.0])
    assert after[0] == pytest.approx([1.5, 1.25])
    assert after[1] == pytest.approx([0.5 + 2 * np.sqrt(DT), 0.25 - 3 * np.sqrt(DT)])


def test_a_lag_over_one_step():
    tau, first, command = 0.25, 3.0, -1.0
    out, memory, _ = advance(Lag("b", tau, initial=first), [command])
    decay = np.exp(-H / tau)
    assert memory == pytest.approx([command + (first - command) * decay])
    assert out == pytest.approx([command + (first - command) * (1 - decay) * tau / H])


def test_a_rate_limit_over_one_step():
    """Reach 0.2: farther it ramps all along, mean half of it; nearer it ramps for a part of the step."""
    out, memory, saturated = advance(RateLimit("b", 2.0), [1.0, -1.0, 0.1, 0.2], [0.0] * 4)
    assert memory == pytest.approx([0.2, -0.2, 0.1, 0.2]) and list(saturated) == [1, 1, 0, 0]
    assert out == pytest.approx([0.1, -0.1, 0.075, 0.1])


def test_a_delay_mixes_the_two_commands_that_share_a_step():
    out, memory, _ = advance(Delay("b", 0.25, maximum=0.3), [7.0], [5.0, 3.0, 1.0])
    assert out == pytest.approx([0.5 * 3 + 0.5 * 1]) and memory == pytest.approx([7, 5, 3])
    assert advance(Delay("b", 0.1, maximum=0.3), [7.0], [5.0, 3.0, 1.0])[0] == pytest.approx([5.0])
    assert advance(Delay("b", 0.25, maximum=0.3), [np.nan], [5.0, 3.0, 1.0])[0] == pytest.approx([2.0])
    assert np.isnan(advance(Delay("b", 0.05, maximum=0.3), [np.nan], [5.0, 3.0, 1.0])[0][0])


@pytest.mark.parametrize("longest", [-0.1, np.nan, INF])
def test_a_longest_delay_that_is_none_is_refused(longest):
    with pytest.raises(ArgumentError, match="longest delay of 'b'"):
        Delay("b", 0.0, maximum=longest).limits(H, DT)


def test_pulses_come_first_and_last_as_long_as_the_share():
    """Four minor steps to a period: 0.6 of the thrust is on for two of them (2.4 + 1/2 rounded down), 0.7 for three."""
    block, state, seen = Pwm("b", [2.0, 2.0]), None, []
    for signal in ([1.2, -1.4], [9.0, 9.0], [9.0, 9.0], [9.0, 9.0], [0.2, 2.5]):
        out, state, saturated = advance(block, signal, state)
        seen.append(list(out))
    assert seen == [[2, -2], [2, -2], [0, -2], [0, 0], [0, 2]]
    assert list(saturated) == [0, 1] and list(state) == [0.2, 2.5, 1]


@pytest.mark.parametrize(("minimum", "out"), [(0.2, 2.0), (0.21, 0.0)])
def test_a_pulse_of_the_minimum_length_is_kept(minimum, out):
    assert advance(Pwm("b", 2.0, minimum_on=minimum), [1.0])[0][0] == out


def test_pwm_needs_two_minor_steps():
    Pwm("b", 2.0).check(1, 0.2, 0.4)
    Pwm("b", 2.0, period=0.2).check(1, 0.1, 0.4)
    for block, h in ((Pwm("b", 2.0), 0.4), (Pwm("b", 2.0, period=0.1), 0.1)):
        with pytest.raises(ArgumentError, match="nothing to modulate"):
            block.check(1, h, 0.4)
    with pytest.raises(ArgumentError, match="multiple"):
        Pwm("b", 2.0, period=0.25).check(1, 0.1, 0.4)


@pytest.mark.parametrize(
    ("signal", "before", "after"),
    [
        (0.9, 0, 1), (-0.9, 0, -1), (0.8, 0, 0), (-0.8, 0, 0), (0.5, 1, 1), (0.3, 1, 1), (0.29, 1, 0),
        (-0.5, 1, 0), (-0.9, 1, -1), (-0.5, -1, -1), (-0.29, -1, 0), (0.9, -1, 1), (0.0, 0, 0),
    ],
)  # fmt: skip
def test_trigger_switches_on_above_one_level_and_off_below_the_other(signal, before, after):
    assert float(ca.evalf(ca.SX(trigger(ca.SX(signal), ca.SX(before), 0.8, 0.3)))) == after


def test_pwpf_over_one_step():
    """On since the lag's output is above the level; then the lag goes towards K (u - F)."""
    out, memory, _ = advance(Pwpf("b", 2.0, 0.8, 0.3, 0.25, 3.0), [1.0, 1.0], [0.9, 0.5, 0.0, 0.0])
    decay = np.exp(-H / 0.25)
    assert out == pytest.approx([2.0, 0.0])
    assert memory == pytest.approx([-3 + 3.9 * decay, 3 - 2.5 * decay, 1, 0])


def test_what_holds_takes_a_new_sample_after_its_period():
    for block in (ZeroOrderHold("b", 0.3), Sampling("b", 1.2)):
        state, seen = None, []
        for k in range(5):
            out, state, _ = advance(block, [float(k), -float(k)], state)
            seen.append(list(out))
        assert seen == [[0, 0], [0, 0], [0, 0], [3, -3], [3, -3]]


@pytest.mark.parametrize(
    ("block", "message"),
    [
        (ZeroOrderHold("b", 0.0), "number of minor steps in the period of 'b'"), (ZeroOrderHold("b", 0.25), "multiple"),
        (Sampling("b", 0.0), "number of control steps in the period of 'b'"), (Sampling("b", 0.3), "multiple"),
        (SensorDelay("b", 0.3), "multiple"), (PiecewiseConstantNoise("b", 1.0, 0.3, on="x"), "multiple"),
    ],
)  # fmt: skip
def test_periods_that_are_not_steps_are_refused_beforehand(block, message):
    with pytest.raises(ArgumentError, match=message):
        block.check(1, H, DT)


def test_periods_that_are_steps_are_not():
    for block in (
        ZeroOrderHold("b", 0.1),
        Sampling("b", 0.4),
        SensorDelay("b", 0.0),
        PiecewiseConstantNoise("b", 1.0, 0.8, on="x"),
    ):
        block.check(1, H, DT)
    PiecewiseConstantNoise("b", 1.0, on="x").check(1, H, DT)


def test_a_sensor_delay_hands_on_the_oldest_sample():
    out, memory, _ = advance(SensorDelay("b", 0.8), [5.0, 6.0], [3.0, 4.0, 1.0, 2.0])
    assert list(out) == [1, 2] and list(memory) == [5, 6, 3, 4]


@pytest.mark.parametrize(
    ("t", "lost"), [(1.99, False), (2.0 - 1e-12, True), (2.0, True), (2.99, True), (3.0 - 1e-12, False), (3.0, False)]
)  # fmt: skip
def test_an_outage_lasts_from_its_begin_until_before_its_end(t, lost):
    """A time that is off by rounding counts as the step that is meant."""
    assert np.isnan(advance(SensorOutage("b", 2.0, 3.0), [1.0], tick=moment(t))[0][0]) == lost


@pytest.mark.parametrize(
    ("t", "rate", "lost"),
    [
        (2.0, 3.1, True),
        (2.0, 3.0, False),
        (2.0, -4.0, False),
        (1.0, 3.1, False),
        (2.0, np.nan, True),
        (1.0, np.nan, False),
    ],
)
def test_an_outage_can_be_where_the_plant_is(t, rate, lost):
    blind = SensorOutage("b", 1.5, where=lambda t, x: x["w"] - 3.0)
    assert np.isnan(advance(blind, [1.0], tick=moment(t, w=rate))[0][0]) == lost


# --- disturbances -----------------------------------------------------------------------------------------


def test_disturbances_in_numbers():
    sine = SinusoidalDisturbance("b", [2.0, 3.0], 0.5, [0.1, 0.2], on="x")
    value = sine.value(ca.SX(4.0), {}, ca.SX(0, 1), parameters(sine, 2))
    assert numbers(value) == pytest.approx([2 * np.sin(2.1), 3 * np.sin(2.2)])
    level = ConstantDisturbance("b", [2.0, 3.0], on="x")
    assert list(numbers(level.value(ca.SX(4.0), {}, ca.SX(0, 1), parameters(level, 2)))) == [2, 3]
    spring = ExpressionDisturbance("b", lambda t, x, p: -p["k"] * x["q"] + t, {"k": 3.0}, on="x")
    assert list(numbers(spring.value(ca.SX(4.0), {"q": ca.SX(2.0)}, None, parameters(spring, 1)))) == [-2]


def test_random_values_are_held_for_their_period_and_scaled():
    gust = PiecewiseConstantNoise("b", [2.0, 3.0], 0.8, on="x")
    p, state, seen = parameters(gust, 2), gust.start(ca.SX.zeros(2), {}, moment()), []
    for k in range(3):
        state = gust.update(moment(), state, p, ca.SX(ca.DM([1.0 + k, -1.0 - k])))
        seen.append(list(numbers(gust.value(ca.SX(0.0), {}, state, p))))
    assert seen == [[2, -3], [2, -3], [6, -9]]
    always = PiecewiseConstantNoise("b", 1.0, on="x")
    state = always.update(moment(), ca.SX(ca.DM([5.0, 0.0])), {}, ca.SX(7.0))
    assert list(numbers(state)) == [7, 0]


def test_a_disturbance_without_a_place_is_refused():
    with pytest.raises(ArgumentError, match="acts on nothing"):
        ConstantDisturbance("b", 1.0)


# --- allocation -------------------------------------------------------------------------------------------


def test_allocation_and_mixer_by_hand():
    """Two actuators along one axis, the second twice as strong: least length is (1, 2) / 5 of the command."""
    block = Allocation("b", [[1.0, 2.0]], "y", unit="N m")
    assert advance(block, [5.0])[0] == pytest.approx([1.0, 2.0])
    assert block.outputs({}, {}) == {"y": (2, "N m")}
    assert Allocation("b", [[1.0, 2.0]]).outputs({}, {}) == {"outputs": (2, "")}
    peak = advance(Allocation("b", [[1.0, 2.0]], method="min-max"), [6.0])[0]
    assert peak == pytest.approx([2.0, 2.0])
    assert advance(Allocation("b", [[1.0, 2.0]], failed=[1]), [6.0])[0] == pytest.approx([6.0, 0.0])
    mixer = Mixer("b", [[1.0, 2.0], [0.0, 3.0]], {"f": 1, "g": 1}, unit="N")
    assert advance(mixer, [5.0, 7.0])[0] == pytest.approx([19.0, 21.0])
    assert mixer.outputs({}, {}) == {"f": (1, "N"), "g": (1, "N")}
    assert Mixer("b", [[1.0, 2.0]]).outputs({}, {}) == {"outputs": (1, "")}


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: Allocation("b", EYE, method="best"), "cannot allocate by 'best'"),
        (lambda: Allocation("b", EYE, to="a b"), "name of a signal"),
        (lambda: Allocation("b", np.ones((1, 3)), method="min-max"), "2 null directions"),
        (lambda: Allocation("b", EYE).check(3, H, DT), "allocates 2 components, but gets 3"),
        (lambda: Mixer("b", EYE).check(3, H, DT), "mixes 2 outputs, but gets 3"),
        (lambda: Mixer("b", EYE, {"f": 3}).outputs({}, {}), "2 rows for 3 components"),
        (lambda: effect_matrix([1.0, 2.0], (), "it"), "shape"),
        (lambda: effect_matrix([[1.0, np.nan]], (), "it"), "finite"),
        (lambda: effect_matrix(EYE, (2,), "it"), "no actuator 2: it has 0 to 1"),
        (lambda: effect_matrix(EYE, (-1,), "it"), "no actuator -1"),
        (lambda: pseudo_inverse([[1.0], [2.0]]), "1 actuators span 1 of 2 directions"),
        (lambda: NonNegativeAllocation("b", [[1.0, -1.0]]).check(2, H, DT), "allocates 1 components, but gets 2"),
        (lambda: ThrusterSet(np.zeros((3, 2)), np.zeros((3, 2))), "zero length"),
        (lambda: ThrusterSet(np.zeros((3, 2)), np.ones((3, 1))), r"give \(3, n\)"),
        (lambda: ThrusterSet(np.zeros((2, 2)), np.ones((2, 2))), r"give \(3, n\)"),
        (lambda: ThrusterSet(np.zeros(3), np.ones(3)), r"give \(3, n\)"),
        (lambda: ThrusterSet(np.zeros((3, 1)), np.ones((3, 1))).allocation("b"), "name at least one control"),
    ],
)  # fmt: skip
def test_allocations_that_do_not_fit_are_refused(act, message):
    with pytest.raises((DesignError, ArgumentError), match=message):
        act()


def test_allocations_that_fit_are_not():
    Allocation("b", EYE).check(2, H, DT)
    Mixer("b", [[1.0, 2.0]]).check(2, H, DT)
    NonNegativeAllocation("b", [[1.0, -1.0]]).check(1, H, DT)
    assert effect_matrix([[1.0, 2.0]], (0,), "it").tolist() == [[0.0, 2.0]]


def test_a_pseudo_inverse_of_nearly_dependent_actuators_uses_what_it_counts():
    """One part in a million of a second axis is enough to span the plane: the inverse is the exact one."""
    effects = np.array([[1.0, 1.0], [0.0, 1e-6]])
    assert pseudo_inverse(effects) == pytest.approx(np.array([[1.0, -1e6], [0.0, 1e6]]), rel=1e-8)
    with pytest.raises(DesignError, match="span 1 of 2"):
        pseudo_inverse([[1.0, 1.0], [0.0, 1e-11]])


def test_thrusts_of_a_command_of_either_sign():
    """Right, left and a stronger left: the cheapest way to the left is the stronger one."""
    block = NonNegativeAllocation("b", [[1.0, -1.0, -2.0]], unit="N")
    assert advance(block, [3.0])[0] == pytest.approx([3, 0, 0], abs=1e-12)
    assert advance(block, [-3.0])[0] == pytest.approx([0, 0, 1.5], abs=1e-12)
    assert block.outputs({}, {}) == {"thrusts": (3, "N")}


def test_effects_of_thrusters_are_force_and_torque():
    jets = ThrusterSet([[0.0, 1.0], [2.0, 0.0], [0.0, 0.0]], [[3.0, 0.0], [0.0, 0.0], [0.0, -0.5]])
    assert jets.effects.T.tolist() == [[1, 0, 0, 0, 0, -2], [0, 0, -1, 0, 1, 0]]
    assert jets.mixer("m", torque="T").matrix.tolist() == jets.effects[3:].tolist()
    mixer = jets.mixer("m", force="F", torque="T", thrusts="u")
    assert mixer.matrix.tolist() == jets.effects.tolist()
    assert (mixer.to, mixer.on) == ({"F": 3, "T": 3}, "u") and jets.mixer("m", force="F").on == "thrusts"
    both = ThrusterSet(np.zeros((3, 6)), np.hstack([np.eye(3), -np.eye(3)])).allocation(
        "a", force="F", to="y"
    )
    assert (both.on, both.to, both.unit) == (("F",), "y", "N")


def wheels(**changes):
    return WheelArray("b", EYE, **changes)


@pytest.mark.parametrize(
    ("changes", "signal", "torque", "momenta", "saturated"),
    [
        ({}, [0.3, -0.2], [0.3, -0.2], [-0.03, 0.02], [0, 0]),
        ({"max_torque": 0.25}, [0.3, -0.2], [0.25, -0.2], [-0.025, 0.02], [1, 0]),
        ({"max_momentum": 0.5, "initial": [-0.48, 0.48]}, [0.3, -0.3], [0.2, -0.2], [-0.5, 0.5], [1, 1]),
        ({"max_momentum": 0.5, "initial": [-0.48, 0.48]}, [-0.3, 0.3], [-0.3, 0.3], [-0.45, 0.45], [0, 0]),
        ({"max_momentum": 0.5, "max_torque": 1.0, "initial": [0.9, 0.0]}, [0.0, 0.0], [1.0, 0.0], [0.8, 0.0], [1, 0]),
    ],
)  # fmt: skip
def test_wheels_within_their_limits(changes, signal, torque, momenta, saturated):
    """The momenta change by minus the torque times 0.1 s; a wheel beyond its limit comes back with its full torque."""
    block = wheels(to="T", **changes)
    out, memory, limited = advance(block, signal)
    assert out == pytest.approx(torque) and memory == pytest.approx(momenta) and list(limited) == saturated


def test_a_wheel_half_dead_gives_half_its_torque_and_momentum():
    out, memory, _ = advance(wheels(to="T"), [0.4, 0.4], health=[0.5, 1.0])
    assert out == pytest.approx([0.2, 0.4]) and memory == pytest.approx([-0.02, -0.04])


def test_wheels_go_on_under_their_own_name_or_another():
    assert wheels(to="T").outputs({"c": 2}, {"c": "N m"}) == {"T": (2, "N m")}
    assert wheels().outputs({"c": 2}, {"c": "N m"}) is None
    out, _, _ = advance(WheelArray("b", [[0.0, 1.0], [-1.0, 0.0]]), [0.3, -0.2])
    assert out == pytest.approx([0.3, -0.2])


def test_momenta_of_the_plant_are_taken_from_it():
    block = wheels(to="T", momenta="h", max_momentum=0.5)
    out, memory, limited = advance(block, [0.3, 0.3], tick=moment(h=[-0.48, 0.48]))
    assert out == pytest.approx([0.2, 0.3]) and memory.size == 0 and list(limited) == [1, 0]
    with pytest.raises(DesignError, match="holds 3 momenta for 2 wheels"):
        advance(block, [0.3, 0.3], tick=moment(h=[0.0, 0.0, 0.0]))


# --- what all blocks share --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["plant", "initial", "a.b", "", "a[0]", 3])
def test_names_that_would_be_mistaken_are_refused(name):
    with pytest.raises(ArgumentError):
        Lag(name, 0.1)


def test_a_block_by_default_does_nothing_and_fits_everywhere():
    block = Block("b")
    assert (block.on, block.starts_at_trim, block.parameters(2, "N"), block.limits(H, DT)) == (
        None,
        False,
        {},
        {},
    )
    assert block.noise(2) == 0 and block.outputs({}, {}) is None
    assert block.start(ca.SX(2, 1), {}, moment()).shape == (0, 1)
    for function in (block.step, ConstantDisturbance("b", 1.0, on="x").step):
        with pytest.raises(NotImplementedError):
            function(moment(), ca.SX(1), ca.SX(0, 1), {}, ca.SX(0, 1))


@pytest.mark.parametrize("kind", [Lag, RateLimit, Delay, Saturation, Noise, ConstantDisturbance, Mixer])
def test_where_a_block_acts_and_begins_is_said_by_keyword(kind):
    signature = inspect.signature(kind)
    for name in {"on", "initial"} & set(signature.parameters):
        assert signature.parameters[name].kind is inspect.Parameter.KEYWORD_ONLY


def test_values_and_scalars():
    assert values(2.0, 3, "it").tolist() == [2, 2, 2] and values([1.0, INF], 2, "it").tolist() == [1, INF]
    assert scalar([2.0], "it").shape == (1,) and scalar(2, "it").tolist() == [2.0]
    for act in (lambda: values([1.0, np.nan], 2, "it"), lambda: values([1.0, 2.0], 3, "it"),
                lambda: scalar([1.0, 2.0], "it"), lambda: scalar(np.nan, "it")):  # fmt: skip
        with pytest.raises(ArgumentError, match="it is"):
            act()


def test_clipped_values_and_what_differs():
    limited = clip(ca.SX(ca.DM([-2.0, 0.5, 2.0, np.nan])), -1.0, 1.0)
    assert list(numbers(limited))[:3] == [-1, 0.5, 1] and np.isnan(numbers(limited)[3])
    assert list(numbers(differs(limited, ca.SX(ca.DM([-2.0, 0.5, 2.0, 0.0])))))[:3] == [1, 0, 1]


def test_no_rows_are_a_column_too():
    column = ca.SX.sym("x", 3)
    assert rows(column, 1, 1).shape == (0, 1) and rows(column, 0, 2).shape == (2, 1)
    assert rows(ca.MX.sym("x", 1), 1, 1).shape == (0, 1) and rows(ca.SX.sym("x", 1), 0, 1).shape == (1, 1)


# --- chains -----------------------------------------------------------------------------------------------

SIGNALS = {"f": (3, "N"), "t": (3, "N m"), "g": (1, "N")}


def test_kinds_of_a_layout():
    assert kinds(Layout("command", (Variable("f", 3, "N"), Variable("g")))) == {"f": (3, "N"), "g": (1, "")}


def test_links_know_what_they_act_on():
    blocks = [Saturation("one", on="f"), Saturation("two", on=("f", "g")), Saturation("all"),
              Mixer("mix", np.ones((2, 4)), {"y": 2}, "V", on=("f", "g")), Lag("late", 0.1)]  # fmt: skip
    links, left = chain(blocks, SIGNALS, "command")
    assert [link.on for link in links] == [
        ("f",), ("f", "g"), ("f", "t", "g"), ("f", "g"), ("t", "y")
    ]  # fmt: skip
    assert [link.size for link in links] == [3, 4, 7, 4, 5]
    assert [link.unit for link in links] == ["N", "N", "", "N", ""]
    assert links[0].outputs == {"f": (3, "N")} and links[3].outputs == {"y": (2, "V")}
    assert left == {"t": (3, "N m"), "y": (2, "V")}


def test_a_second_signal_of_one_name_is_refused():
    with pytest.raises(ArgumentError, match="makes a second 't'"):
        chain([Mixer("mix", np.ones((2, 3)), "t", on="f")], SIGNALS, "command")
    _, left = chain([Mixer("mix", np.ones((2, 3)), "f", on="f")], SIGNALS, "command")
    assert left["f"] == (2, "")


def test_signals_are_taken_and_put_back_in_order():
    signals = {"f": ca.DM([1, 2, 3]), "t": ca.DM([4, 5, 6]), "g": ca.DM(7)}
    assert take(signals, ("g", "f")).full()[:, 0].tolist() == [7, 1, 2, 3]
    (same, other), _ = chain(
        [Saturation("s", on=("f", "g")), Mixer("m", np.ones((3, 4)), {"a": 1, "b": 2}, on=("f", "g"))],
        SIGNALS, "command",
    )  # fmt: skip
    kept = put(signals, same, ca.DM([9, 8, 7, 6]))
    assert {n: v.full()[:, 0].tolist() for n, v in kept.items()} == {"f": [9, 8, 7], "t": [4, 5, 6], "g": [6]}
    new = put(signals, other, ca.DM([9, 8, 7]))
    assert {n: v.full()[:, 0].tolist() for n, v in new.items()} == {"t": [4, 5, 6], "a": [9], "b": [8, 7]}


def test_blocks_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Lag("b", 0.1).tau = 0.2
