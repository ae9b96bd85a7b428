"""Reaching laws: their steepest slope and their band are what their rates do, in every boundary layer."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.control import (
    ConstantRate,
    ExponentialRate,
    PowerRate,
    SaturationLayer,
    Sign,
    SuperTwisting,
    TanhLayer,
)
from gnc_opt.errors import DesignError

LAWS = [
    ConstantRate(0.7),
    ExponentialRate(0.7, 1.3),
    PowerRate(0.7, 0.3),
    PowerRate(0.7, 0.8),
    SuperTwisting(1.5, 1.1),
]
LAYERS = [SaturationLayer(0.05), SaturationLayer(2.0), TanhLayer(0.05), TanhLayer(2.0)]


def rates(law, boundary, values):
    s = ca.SX.sym("s")
    return np.asarray(ca.Function("rate", [s], [law.rate(s, boundary)])(np.asarray(values)).full()).ravel()


@pytest.mark.parametrize("law", LAWS, ids=repr)
@pytest.mark.parametrize("boundary", LAYERS, ids=repr)
def test_no_rate_is_steeper_than_stated(law, boundary):
    """What the sampling rate is judged by: an equality at the edge of a saturation layer."""
    s = np.linspace(-3 * boundary.phi, 3 * boundary.phi, 60001)
    steepest = np.max(np.diff(rates(law, boundary, s)) / np.diff(s))
    stated = law.slope(boundary)
    assert steepest <= stated * (1 + 1e-9)
    if isinstance(boundary, SaturationLayer) or isinstance(law, (ConstantRate, ExponentialRate)):
        assert steepest == pytest.approx(stated, rel=1e-3)


@pytest.mark.parametrize("law", [PowerRate(0.7, 0.3), SuperTwisting(1.5, 1.1)], ids=repr)
def test_powers_are_infinitely_steep_at_zero_without_a_layer(law):
    assert law.slope(Sign()) == np.inf
    assert rates(law, Sign(), [1e-12])[0] / 1e-12 > 1e3


@pytest.mark.parametrize("law", LAWS, ids=repr)
@pytest.mark.parametrize("boundary", [Sign(), *LAYERS], ids=repr)
def test_rates_are_odd_and_drive_towards_zero(law, boundary):
    s = np.array([1e-3, 0.04, 0.06, 1.0, 3.0])
    up, down = rates(law, boundary, s), rates(law, boundary, -s)
    assert np.all(up > 0) and down == pytest.approx(-up, rel=1e-14)


@pytest.mark.parametrize("boundary", [Sign(), *LAYERS], ids=repr)
def test_a_power_rate_balances_the_disturbance_at_its_band(boundary):
    law = PowerRate(0.7, 0.3)
    for bound in (0.05, 0.4, 2.0):
        band = law.band(boundary, bound)
        assert rates(law, boundary, [band])[0] == pytest.approx(bound, rel=1e-9)


def designed(law, boundary, dt):
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    rest = go.Reference.constant(model, [0])
    return go.design_sliding_mode(model, rest, outputs="x", reaching=law, boundary=boundary, dt=dt)


@pytest.mark.parametrize("boundary", [SaturationLayer(0.5), TanhLayer(0.5)], ids=repr)
def test_a_step_at_which_the_sampled_surface_no_longer_decays_is_refused(boundary):
    """s+ = (1 - dt slope) s: at dt slope = 2 it only changes its sign; the slope is 3 / 0.5 = 6."""
    law = ConstantRate(3.0)
    assert designed(law, boundary, 0.33).explain()["sampling limit"] == pytest.approx(2 / 6)
    for dt in (2 / 6, 0.4):
        with pytest.raises(DesignError, match=r"too long for the switching gain: .* give dt < 0\.3333 s"):
            designed(law, boundary, dt)
    designed(law, Sign(), 5.0)
    designed(law, boundary, None)
    with pytest.raises(DesignError, match="give dt"):
        designed(SuperTwisting(1.5, 1.1), boundary, None)
