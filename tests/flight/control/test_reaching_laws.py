"""Reaching laws: rates, reaching times, steepest slopes and bands in every boundary layer."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad
from testing.internals import check_super_twisting_gains, read_disturbance_bounds
from testing.models import dynamics

import gnc_opt as go
from gnc_opt.control import (
    ConstantRate,
    ExponentialRate,
    SaturationLayer,
    Sign,
    SuperTwisting,
    SuperTwistingObserver,
)
from gnc_opt.errors import ArgumentError, DesignError

LAWS = [
    ConstantRate(0.7), ExponentialRate(0.7, 1.3), SuperTwisting(1.5, 1.1),
]  # fmt: skip


LAYERS = [SaturationLayer(0.05), SaturationLayer(2.0)]


def rates(law, boundary, values):
    s = ca.SX.sym("s")
    return np.asarray(ca.Function("rate", [s], [law.rate(s, boundary)])(np.asarray(values)).full()).ravel()


@pytest.mark.parametrize("law", LAWS, ids=repr)
@pytest.mark.parametrize("boundary", LAYERS, ids=repr)
def test_no_rate_is_steeper_than_stated(law, boundary):
    """What the sampling rate is judged by: an equality at the edge of a saturation layer."""
    s = np.linspace(-3 * boundary.phi, 3 * boundary.phi, 60001)
    steepest = np.max(np.diff(rates(law, boundary, s)) / np.diff(s))
    stated = law.max_slope(boundary)
    assert steepest <= stated * (1 + 1e-9)
    if isinstance(boundary, SaturationLayer) or isinstance(law, (ConstantRate, ExponentialRate)):
        assert steepest == pytest.approx(stated, rel=1e-3)


def test_super_twisting_is_infinitely_steep_at_zero_without_a_layer():
    law = SuperTwisting(1.5, 1.1)
    assert law.max_slope(Sign()) == np.inf
    assert rates(law, Sign(), [1e-12])[0] / 1e-12 > 1e3


@pytest.mark.parametrize("law", LAWS, ids=repr)
@pytest.mark.parametrize("boundary", [Sign(), *LAYERS], ids=repr)
def test_rates_are_odd_and_drive_towards_zero(law, boundary):
    s = np.array([1e-3, 0.04, 0.06, 1.0, 3.0])
    up, down = rates(law, boundary, s), rates(law, boundary, -s)
    assert np.all(up > 0) and down == pytest.approx(-up, rel=1e-14)


def designed(law, boundary, dt):
    model, *_ = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    rest = go.Reference.constant(model, [0])
    return go.design_sliding_mode(model, rest, outputs="x", reaching=law, boundary=boundary, dt=dt)


@pytest.mark.parametrize("boundary", [SaturationLayer(0.5)], ids=repr)
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


INF = np.inf


SIGN, SAT = Sign(), SaturationLayer(0.5)


def number(value):
    return float(ca.evalf(ca.SX(value)))


@pytest.mark.parametrize(
    ("law", "boundary", "s", "rate"),
    [
        (ConstantRate(3.0), SIGN, -0.2, -3.0),
        (ConstantRate(3.0), SAT, 0.2, 1.2),
        (ConstantRate(3.0), SAT, -9.0, -3.0),
        (ExponentialRate(3.0, 2.0), SIGN, -0.2, -3.4),
        (ExponentialRate(3.0, 2.0), SAT, 0.2, 1.6),
        (SuperTwisting(3.0, 2.0), SIGN, -0.25, -1.5),
    ],
)
def test_rates_of_reaching_laws(law, boundary, s, rate):
    assert number(law.rate(ca.SX(s), boundary)) == pytest.approx(rate)


@pytest.mark.parametrize(
    ("law", "bound"), [(ConstantRate(3.0), 0.0), (ConstantRate(3.0), 1.0), (ExponentialRate(3.0, 2.0), 1.0)]
)
@pytest.mark.parametrize("start", [2.0, -0.5])
def test_reaching_times_are_those_of_the_differential_equation(law, bound, start):
    """The time is the integral of ds / (rho - bound)."""

    def slowness(s):
        return 1 / (number(law.rate(ca.SX(s), SIGN)) - bound)

    expected = quad(slowness, 0.0, abs(start), epsabs=1e-10)[0]
    assert law.reaching_time(start, bound) == pytest.approx(expected, rel=1e-6)


def test_bands_without_a_layer():
    assert ConstantRate(3.0).sliding_band(SIGN, 1.2) == 0.0
    assert ExponentialRate(3.0, 2.0).sliding_band(SAT, 1.5) == 0.25
    assert SuperTwisting(3.0, 2.0).sliding_band(SAT, 1.0) == 0.25
    assert SuperTwisting(3.0, 2.0).sliding_band(SIGN, 1.0) == 0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: ConstantRate(0.0), "gain eta"),
        (lambda: ExponentialRate(1.0, 0.0), "rate k"),
        (lambda: SuperTwisting(0.0, 1.0), "k1"),
        (lambda: SuperTwisting(1.0, 0.0), "k2"),
        (lambda: SaturationLayer(0.0), "phi"),
        (lambda: read_disturbance_bounds(3.0, 0.0, ("a",)), "the reaching law is 3.0"),
        (lambda: read_disturbance_bounds(ConstantRate(2.0), 2.0, ("a",)), "surface of 'a'"),
        (lambda: read_disturbance_bounds(ConstantRate(2.0), [1.0, 2.1], ("a", "b")), "surface of 'b'"),
        (lambda: read_disturbance_bounds(ConstantRate(2.0), -1.0, ("a",)), "give finite numbers >= 0"),
        (lambda: read_disturbance_bounds(ConstantRate(2.0), INF, ("a",)), "give finite numbers >= 0"),
        (lambda: read_disturbance_bounds(SuperTwisting(3.0, 2.0), 2.0, ("a",)), "raise k2"),
        (lambda: check_super_twisting_gains(2.0, 3.0, 1.0, "it"), "raise k1"),
        (lambda: SuperTwistingObserver(2.0, 3.0, 1.0), "raise k1"),
        (lambda: SuperTwistingObserver(1.0, 1.0, -1.0), "bound of an observer"),
    ],
)
def test_gains_that_make_no_sense_are_refused(wrong, message):
    with pytest.raises((ArgumentError, DesignError), match=message):
        wrong()
