"""Designs that cannot work are refused with numbers: no authority, steps too long for the switching gain."""

import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.control import (
    ConstantRate,
    Reference,
    SaturationLayer,
    design_integral_sliding_mode,
    design_lqr,
    design_mpc,
    design_sliding_mode,
)
from gnc_opt.errors import DesignError


def cart() -> go.Model:
    model = go.Model("cart")
    q, v = model.state("q", unit="m"), model.state("v", unit="m/s")
    a = model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    return model


def slide(dt=0.01, limits=None, layer=0.1):
    return design_sliding_mode(
        cart(), [0.0, 0.0], outputs="q", slopes=1.0, reaching=ConstantRate(1.0), boundary=SaturationLayer(layer),
        dt=dt, limits=limits,
    )  # fmt: skip


def integral(dt=0.01, limits=None):
    return design_integral_sliding_mode(
        cart(), [0.0, 0.0], nominal=np.array([[1.0, 1.5]]), reaching=ConstantRate(1.0), boundary=SaturationLayer(0.1),
        dt=dt, limits=limits,
    )  # fmt: skip


@pytest.mark.parametrize("design", [slide, integral])
def test_steps_too_long_for_the_switching_gain_are_refused(design):
    """The slope eta / phi = 10 per second permits steps below 2 / 10 s."""
    design(dt=0.19)
    with pytest.raises(DesignError, match=r"too long for the switching gain: .* dt < 0\.2 s"):
        design(dt=0.21)


@pytest.mark.parametrize("design", [slide, integral])
def test_no_authority_for_the_switching_gain_is_refused(design):
    design(limits=([-3.0], [3.0]))
    with pytest.raises(DesignError, match="authority"):
        design(limits=([0.0], [0.0]))


def test_predictive_control_without_authority_is_refused():
    with pytest.raises(DesignError):
        design_mpc(
            cart(), Reference.constant(cart(), [0, 0]), Q=1, R=1, horizon=1.0, dt=0.1, limits=([0.0], [0.0])
        )


def test_regulator_of_a_control_without_effect_is_refused():
    model = go.Model("dead cart")
    q, v = model.state("q", unit="m"), model.state("v", unit="m/s")
    a = model.control("a", unit="m/s^2")
    model.ode({q: v, v: 0.0 * a})
    with pytest.raises(DesignError, match="stabilis"):
        design_lqr(model, Reference.constant(model, [0, 0], [0]), Q=1, R=1)
