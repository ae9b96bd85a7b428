"""Limits of controls: how they are written, and which are refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.internals import clip_to_limits, read_control_limits, saturate_command

from gnc_opt.errors import ArgumentError, DesignError
from gnc_opt.model import Model

NAN, INF = np.nan, np.inf


def cart(drag: float = 0.0) -> Model:
    model = Model("cart")
    q, v = model.state("q", unit="m"), model.state("v", unit="m/s")
    a, c = model.control("a", unit="N"), model.parameter("c", drag)
    model.ode({q: v, v: a - c * v})
    return model


def test_limits_are_read_for_every_control():
    model = cart()
    assert read_control_limits(model, None) is None
    lower, upper = read_control_limits(model, (-1, [2.0]))
    assert (lower.tolist(), upper.tolist()) == ([-1], [2])
    for limits, error, message in (
        ((1.0, 1.0), DesignError, "'a' has no authority"), ((NAN, 1.0), DesignError, "no authority"),
        ([-1.0, 1.0], ArgumentError, r"give \(lower, upper\)"), ((1.0,), ArgumentError, r"give \(lower, upper\)"),
        (([-1.0, -1.0], 1.0), ArgumentError, "the lower limits"),
        ((-1.0, [1.0, 1.0]), ArgumentError, "the upper limits"),
    ):  # fmt: skip
        with pytest.raises(error, match=message):
            read_control_limits(model, limits)
    assert [float(clip_to_limits(v, -1.0, 2.0)) for v in (-3.0, 0.5, 3.0)] == [-1, 0.5, 2]
    assert saturate_command(5.0, None) == 5.0 and float(saturate_command(ca.DM(5.0), (-1.0, 2.0))) == 2.0
