"""Every block by itself: its parameters with units and ranges, its memory, and one step in numbers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.internals import (
    ActuatorWaveform,
    StepContext,
    connect_block_chain,
    pseudo_inverse,
    read_effectiveness_matrix,
)

from gnc_opt.errors import ArgumentError, DesignError
from gnc_opt.numerical_tolerances import TINY
from gnc_opt.simulation import (
    Allocation,
    Bias,
    ConstantDisturbance,
    Deadband,
    Delay,
    ExpressionDisturbance,
    Lag,
    Mixer,
    Noise,
    PiecewiseConstantNoise,
    Pwm,
    Pwpf,
    Quantisation,
    RandomWalk,
    RateLimit,
    Saturation,
    ScaleFactor,
    SchmittTrigger,
    SensorOutage,
    SinusoidalDisturbance,
    WheelArray,
    ZeroOrderHold,
    thruster_effects,
)

INF = np.inf
H, DT = 0.1, 0.4
EYE = np.eye(2)


def moment(t=0.0, **x):
    return StepContext(t, H, DT, {name: ca.SX(ca.DM(value)) for name, value in x.items()})


def numbers(column):
    return np.asarray(ca.evalf(ca.SX(column)).full()[:, 0])


def parameters(block, size, **changes):
    found = {name: value for name, (value, _) in block.parameters(size, "N").items()} | changes
    return {name: ca.SX(ca.DM(value)) for name, value in found.items()}


def advance(block, signal, state=None, *, tick=None, noise=(), **changes):
    """Signal, memory and saturation after one step; from the first memory if none is given."""
    tick = tick or moment()
    p, column = parameters(block, np.size(signal), **changes), ca.SX(ca.DM(signal))
    before = block.initial_memory(column, p, tick) if state is None else ca.SX(ca.DM(state))
    _, step = block.propagate_wave(tick, ActuatorWaveform(column), before, p, ca.SX(ca.DM(list(noise))))
    return (
        numbers(step.signal),
        numbers(step.state),
        step.saturated if step.saturated is None else numbers(step.saturated),
    )


@pytest.mark.parametrize(
    ("block", "expected", "limits"),
    [
        (Saturation("b"), {"lower": ([-INF, -INF], "N"), "upper": ([INF, INF], "N")}, {}),
        (Saturation("b", 2, [2, 3]), {"lower": ([2, 2], "N"), "upper": ([2, 3], "N")}, {}),
        (ScaleFactor("b"), {"factor": ([1, 1], ""), "bias": ([0, 0], "N")}, {}),
        (Deadband("b", 0.3), {"width": ([0.3, 0.3], "N")}, {"width": (0.0, INF)}),
        (Quantisation("b", 0.3), {"step_size": ([0.3, 0.3], "N")}, {"step_size": (TINY, INF)}),
        (Lag("b", 0.3), {"tau": ([0.3, 0.3], "s")}, {"tau": (0.0, INF)}),
        (Lag("b", 0.3, initial=2), {"tau": ([0.3, 0.3], "s"), "initial": ([2, 2], "N")}, {"tau": (0.0, INF)}),
        (RateLimit("b", 0.3), {"rate": ([0.3, 0.3], "N/s")}, {"rate": (TINY, INF)}),
        (Delay("b", 0.25), {"delay": ([0.25], "s")}, {"delay": (0.0, pytest.approx(0.3, rel=1e-9))}),
        (Delay("b", 0.25, 0.4), {"delay": ([0.25], "s")}, {"delay": (0.0, pytest.approx(0.4, rel=1e-9))}),
        (Pwm("b", 2.0), {"thrust": ([2, 2], "N"), "minimum_on": ([0], "s")},
         {"thrust": (TINY, INF), "minimum_on": (0.0, INF)}),
        (SchmittTrigger("b", 2, 0.8, [0.3, 0.8]),
         {"thrust": ([2, 2], "N"), "on_level": ([0.8, 0.8], "N"), "off_level": ([0.3, 0.8], "N")}, {}),
        (Pwpf("b", 2, 0.8, 0.3, 0.2),
         {"thrust": ([2, 2], "N"), "on_level": ([0.8, 0.8], "N"), "off_level": ([0.3, 0.3], "N"),
          "tau": ([0.2], "s"), "gain": ([1], "")}, {"tau": (1e-12, INF)}),
        (ZeroOrderHold("b", 0.2), {}, {}),
        (Noise("b", 0.3), {"sigma": ([0.3, 0.3], "N")}, {"sigma": (0.0, INF)}),
        (Noise("b", [1, 2, 3], lambda x, e: x), {"sigma": ([1, 2, 3], "N")}, {"sigma": (0.0, INF)}),
        (Bias("b", 0.3), {"bias": ([0.3, 0.3], "N")}, {}),
        (Bias("b", [1, 2, 3], lambda x, e: x), {"bias": ([1, 2, 3], "N")}, {}),
        (RandomWalk("b", 0.3), {"sigma": ([0.3, 0.3], "N/s^0.5")}, {"sigma": (0.0, INF)}),
        (SensorOutage("b", 2.0, 2.0), {"begin": ([2], "s"), "end": ([2], "s")}, {}),
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
    assert block.parameter_limits(H, DT) == limits


@pytest.mark.parametrize("longest", [-0.1, np.nan, INF])
def test_a_longest_delay_that_is_none_is_refused(longest):
    with pytest.raises(ArgumentError, match="longest delay of 'b'"):
        Delay("b", 0.0, maximum=longest).parameter_limits(H, DT)


@pytest.mark.parametrize(
    ("block", "message"),
    [
        (ZeroOrderHold("b", 0.0), "number of minor steps in the period of 'b'"), (ZeroOrderHold("b", 0.25), "multiple"),
        (PiecewiseConstantNoise("b", 1.0, 0.3, on="x"), "multiple"),
    ],
)  # fmt: skip
def test_periods_that_are_not_steps_are_refused_beforehand(block, message):
    with pytest.raises(ArgumentError, match=message):
        block.check_sizes(1, H, DT)


@pytest.mark.parametrize(
    ("t", "lost"), [(1.99, False), (2.0 - 1e-12, True), (2.0, True), (2.99, True), (3.0 - 1e-12, False), (3.0, False)]
)  # fmt: skip
def test_an_outage_lasts_from_its_begin_until_before_its_end(t, lost):
    """A time that is off by rounding counts as the step that is meant."""
    assert np.isnan(advance(SensorOutage("b", 2.0, 3.0), [1.0], tick=moment(t))[0][0]) == lost


@pytest.mark.parametrize(
    ("t", "rate", "lost"),
    [
        (2.0, 3.1, True), (2.0, 3.0, False), (2.0, -4.0, False), (1.0, 3.1, False), (2.0, np.nan, True),
        (1.0, np.nan, False),
    ],
)  # fmt: skip
def test_an_outage_can_be_where_the_plant_is(t, rate, lost):
    blind = SensorOutage("b", 1.5, where=lambda t, x: x["w"] - 3.0)
    assert np.isnan(advance(blind, [1.0], tick=moment(t, w=rate))[0][0]) == lost


# --- allocation -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: Allocation("b", EYE, method="best"), "cannot allocate by 'best'"),
        (lambda: Allocation("b", EYE, to="a b"), "name of a signal"),
        (lambda: Allocation("b", np.ones((1, 3)), method="min-max"), "2 null directions"),
        (lambda: Allocation("b", EYE).check_sizes(3, H, DT), "allocates 2 components, but gets 3"),
        (lambda: Mixer("b", EYE).check_sizes(3, H, DT), "mixes 2 outputs, but gets 3"),
        (lambda: Mixer("b", EYE, {"f": 3}).output_sizes({}, {}), "2 rows for 3 components"),
        (lambda: read_effectiveness_matrix([1.0, 2.0], (), "it"), "shape"),
        (lambda: read_effectiveness_matrix([[1.0, np.nan]], (), "it"), "finite"),
        (lambda: read_effectiveness_matrix(EYE, (2,), "it"), "no actuator 2: it has 0 to 1"),
        (lambda: read_effectiveness_matrix(EYE, (-1,), "it"), "no actuator -1"),
        (lambda: pseudo_inverse([[1.0], [2.0]]), "1 actuators span 1 of 2 directions"),
        (lambda: thruster_effects(np.zeros((3, 2)), np.zeros((3, 2))), "zero length"),
        (lambda: thruster_effects(np.zeros((3, 2)), np.ones((3, 1))), r"give \(3, n\)"),
        (lambda: thruster_effects(np.zeros((2, 2)), np.ones((2, 2))), r"give \(3, n\)"),
        (lambda: thruster_effects(np.zeros(3), np.ones(3)), r"give \(3, n\)"),
    ],
)  # fmt: skip
def test_allocations_that_do_not_fit_are_refused(act, message):
    with pytest.raises((DesignError, ArgumentError), match=message):
        act()


def test_a_pseudo_inverse_of_nearly_dependent_actuators_uses_what_it_counts():
    """One part in a million of a second axis is enough to span the plane: the inverse is the exact one."""
    effects = np.array([[1.0, 1.0], [0.0, 1e-6]])
    assert pseudo_inverse(effects) == pytest.approx(np.array([[1.0, -1e6], [0.0, 1e6]]), rel=1e-8)
    with pytest.raises(DesignError, match="span 1 of 2"):
        pseudo_inverse([[1.0, 1.0], [0.0, 1e-11]])


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


@pytest.mark.parametrize("name", ["plant", "initial", "a.b", "", "a[0]", 3])
def test_names_that_would_be_mistaken_are_refused(name):
    with pytest.raises(ArgumentError):
        Lag(name, 0.1)


SIGNALS = {"f": (3, "N"), "t": (3, "N m"), "g": (1, "N")}


def test_a_second_signal_of_one_name_is_refused():
    with pytest.raises(ArgumentError, match="defines 't' again"):
        connect_block_chain([Mixer("mix", np.ones((2, 3)), "t", on="f")], SIGNALS, "command")
    _, left = connect_block_chain([Mixer("mix", np.ones((2, 3)), "f", on="f")], SIGNALS, "command")
    assert left["f"] == (2, "")


def test_a_disturbance_without_a_place_is_refused():
    with pytest.raises(ArgumentError, match="acts on nothing"):
        ConstantDisturbance("b", 1.0)
