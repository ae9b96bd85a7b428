"""A reference that does not obey its model is told, with the residual that it has in closed form."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.errors import ProblemWarning

GRAVITY = 9.81


def lift(unit: float = 1.0) -> go.Model:
    """h'' = F / 2 - g; lengths in so many metres."""
    model = go.Model("lift")
    h, w, F = model.state("h", unit="m"), model.state("w", unit="m/s"), model.control("F", unit="N")
    model.ode({h: w, w: (F / 2 - GRAVITY) / unit})
    return model


def wave(rate: float, unit: float = 1.0, push: float = 1.0):
    """h = sin(rate t), with the force that this takes, times ``push``."""
    return go.Reference.from_functions(
        lift(unit), lambda t: np.array([np.sin(rate * t), rate * np.cos(rate * t)]) / unit,
        lambda t: [push * 2 * (GRAVITY - rate**2 * np.sin(rate * t))], 0.0, 10.0,
    )  # fmt: skip


@pytest.mark.parametrize("rate", [1e-4, 1.0, 900.0])
def test_what_moves_as_its_model_says_is_not_reported(rate):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wave(rate)
        wave(rate, unit=1000.0)


@pytest.mark.parametrize("unit", [1.0, 1000.0])
@pytest.mark.parametrize("push", [0.0, 0.9, 0.995])
def test_a_wrong_force_is_reported_with_its_residual(push, unit):
    """(1 - push) (g - sin t) in the unit of the model, and a share that has none."""
    with pytest.warns(
        ProblemWarning,
        match="does not satisfy the dynamics of 'lift': the rate of 'w' differs by .* give consistent functions",
    ) as told:
        wave(1.0, unit, push)
    by, at, share = (
        float(re.search(p, str(told[0].message))[1])
        for p in (r"by ([\d.e+-]+) m/s per", r"t = ([\d.]+) s", r"([\d.e+-]+) % of")
    )
    assert by * unit == pytest.approx((1 - push) * (GRAVITY - np.sin(at)), rel=1e-2)
    assert 100 * (1 - push) / 3 < share < 100


def test_a_rate_that_is_not_that_of_the_place_is_reported():
    with pytest.warns(ProblemWarning, match="the rate of 'h' differs by 0.0"):
        go.Reference.from_functions(
            lift(), lambda t: [np.sin(t), 1.01 * np.cos(t)], lambda t: [2 * (GRAVITY - 1.01 * np.sin(t))], 0,
            9,
        )  # fmt: skip
