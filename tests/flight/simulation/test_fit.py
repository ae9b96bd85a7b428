"""What may be put together, and what a loop refuses as it is made."""

from __future__ import annotations

import numpy as np
import pytest
from testing.loops import controller

from gnc_opt.errors import ArgumentError, GncOptError
from gnc_opt.model import Model
from gnc_opt.simulation import (
    Allocation,
    ClosedLoop,
    ConstantDisturbance,
    Lag,
    PiecewiseConstantNoise,
    Quantity,
    WheelArray,
)


def axis(rate: str, torque: str) -> Model:
    plant = Model("axis")
    w, T = plant.state("w", unit=rate), plant.control("T", unit=torque)
    plant.ode({w: T})
    return plant


def loop(flown: Model, designed: Model) -> ClosedLoop:
    return ClosedLoop(flown, controller(designed, lambda t, x, r, z: (-x, z)), dt=0.1)


@pytest.mark.parametrize(
    ("rate", "torque", "other_rate", "other_torque"),
    [
        ("rad/s", "N m", "rad/s", "N m"),
        ("rad/s", "N*m", "rad / s", "N·m"),  # as people write them
        ("", "N m", "rad/s", ""),  # what is not declared may be anything
        ("deg/s", "N m", "", "N m"),
    ],
)
def test_units_that_are_the_same_or_unknown_fit(rate, torque, other_rate, other_torque):
    assert loop(axis(rate, torque), axis(other_rate, other_torque)).simulate([1.0], tf=0.1).outcome.ok


@pytest.mark.parametrize(
    ("flown", "message"),
    [
        (("deg/s", "N m"), "state 'w' is in deg/s in the plant 'axis' and in rad/s in controller"),
        (("rad/s", "N"), "control 'T' is in N in the plant 'axis' and in N m in controller"),
        (("rad*s", "N m"), "state 'w' is in rad\\*s"),
    ],
)
def test_units_that_differ_are_refused(flown, message):
    with pytest.raises(ArgumentError, match=message):
        loop(axis(*flown), axis("rad/s", "N m"))


@pytest.mark.parametrize(
    "make",
    [
        lambda name: Allocation(name, np.eye(2)),
        lambda name: WheelArray(name, np.eye(3)),
        lambda name: ConstantDisturbance(name, 1.0, on="w"),
        lambda name: PiecewiseConstantNoise(name, 1.0, on="w"),
    ],
)
def test_blocks_that_check_more_check_their_names_too(make):
    with pytest.raises(ArgumentError, match="a block cannot be called"):
        make("plant")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"plant": "axis"}, "the plant of a closed loop must be of type .*not str"),
        ({"controller": None}, "the controller of a closed loop must be of type .*not NoneType"),
        ({"dt": -0.1}, "the control step of 'by hand' is -0.1"),
        ({"minor_steps": 0}, "minor_steps of a closed loop is 0"),
        ({"accuracy": 0.0}, "the accuracy of a closed loop is 0"),
        ({"substeps": 0}, "substeps of a closed loop is 0"),
        ({"actuators": [1.0]}, "one of the actuators of a closed loop must be of type .*not float"),
        ({"sensors": [1.0]}, "one of the sensors of a closed loop must be of type .*not float"),
        ({"disturbances": [Lag("lag", 0.1)]}, "one of the disturbances of a closed loop must be of type .*not Lag"),
        ({"events": ["end"]}, "one of the events of a closed loop must be of type .*not str"),
        ({"quantities": ["tilt"]}, "one of the quantities of a closed loop must be of type .*not str"),
        ({"quantities": [Quantity("a", 1.0), Quantity("a", 2.0)]}, "two quantities of the closed loop are called 'a'"),
        ({"replanner": "again"}, "the replanner of a closed loop must be of type .*not str"),
        ({"divergence_limits": {"v": 1.0}}, "no state 'v'"),
        ({"divergence_limits": 0.0}, "give positive ones"),
    ],
    ids=lambda case: str(case)[:30],
)  # fmt: skip
def test_a_loop_refuses_what_it_could_not_fly_as_it_is_made(changes, message):
    plant = axis("rad/s", "N m")
    given = {"plant": plant, "controller": controller(plant, lambda t, x, r, z: (-x, z)), "dt": 0.1}
    with pytest.raises(GncOptError, match=message):
        ClosedLoop(**(given | changes))


def test_a_plant_without_dynamics_is_refused_as_the_loop_is_made():
    plant = Model("axis")
    plant.state("w")
    plant.control("T")
    with pytest.raises(GncOptError, match="no dynamics for state 'w'"):
        loop(plant, axis("", ""))
