"""What may be put together: units of plant and controller, names of blocks."""

from __future__ import annotations

import numpy as np
import pytest
from loops import controller

from gnc_opt.errors import ArgumentError
from gnc_opt.model.model import Model
from gnc_opt.simulation import (
    Allocation,
    ClosedLoop,
    Constant,
    NonNegativeAllocation,
    RandomHold,
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


@pytest.mark.parametrize("name", ["plant", "initial", "a.b"])
@pytest.mark.parametrize(
    "make",
    [
        lambda name: Allocation(name, np.eye(2)),
        lambda name: WheelArray(name, np.eye(3)),
        lambda name: NonNegativeAllocation(name, [[1.0, -1.0]]),
        lambda name: Constant(name, 1.0, on="w"),
        lambda name: RandomHold(name, 1.0, on="w"),
    ],
)
def test_blocks_that_check_more_check_their_names_too(make, name):
    with pytest.raises(ArgumentError, match="a block cannot be called"):
        make(name)


def test_allocations_are_equal_where_what_they_are_made_of_is():
    matrix = ((1.0, -1.0, -2.0),)
    assert NonNegativeAllocation("b", matrix) == NonNegativeAllocation("b", matrix)
    assert NonNegativeAllocation("b", matrix) != NonNegativeAllocation("b", ((1.0, -1.0, -3.0),))
    assert "_plus" not in repr(NonNegativeAllocation("b", matrix))
