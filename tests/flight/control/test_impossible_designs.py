"""Designs that cannot work are refused with numbers: no authority, steps too long for the switching gain."""

import re

import numpy as np
import pytest
from testing.controller_steps import step_through
from testing.models import cart_with_units as cart

import gnc_opt as go
from gnc_opt.control import (
    ConstantRate,
    ExponentialRate,
    Reference,
    SaturationLayer,
    Sign,
    SuperTwisting,
    bryson,
    design_integral_sliding_mode,
    design_lqr,
    design_mpc,
    design_sliding_mode,
    design_tvlqr,
    feedforward,
    with_dropout_handling,
)
from gnc_opt.errors import ArgumentError, DesignError
from gnc_opt.estimation import Measurement, design_ekf, design_ukf, output_feedback
from gnc_opt.guidance import design_neighbouring_optimal
from gnc_opt.simulation import SensorOutage


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


def chain(order: int) -> go.Model:
    model = go.Model("chain")
    x = [model.state(f"x{i}") for i in range(order)]
    model.ode(dict(zip(x, [*x[1:], model.control("u")], strict=True)))
    return model


@pytest.mark.parametrize(
    "reaching", [ConstantRate(0.1), SuperTwisting(0.3, 0.05)], ids=lambda law: type(law).__name__
)
@pytest.mark.parametrize("boundary", [Sign(), SaturationLayer(1.0)], ids=lambda layer: type(layer).__name__)
@pytest.mark.parametrize(("order", "largest"), [(2, 2.0), (3, 1.0)])
def test_steps_too_long_for_the_surface_are_refused(order, largest, boundary, reaching):
    """Held over a step, the rates have the polynomials z - 1 + l (one) and z^2 + (l^2/2 + 2 l - 2) z + ... (two).

    l = lambda dt; Jury's conditions are l < 2, and 4 - 4 l > 0 at z = -1.
    """

    def design(share, dt=0.1):
        return design_sliding_mode(
            chain(order), [0.0] * order, outputs="x0", slopes=share * largest / dt, reaching=reaching,
            boundary=boundary, dt=dt,
        )  # fmt: skip

    design(0.99)
    for share in (1.0, 2.5):
        with pytest.raises(DesignError, match=r"control steps of 0.1 s are too long for the surface of 'x0'"):
            design(share)


def test_steps_too_long_for_the_linear_part_of_a_reaching_law_are_refused():
    """s+ = (1 - k dt) s from afar, with and without a boundary layer; two integrators: 4 - 2 (lambda + k) dt > 0."""
    for order, slopes, k in ((1, (), 20.0), (2, 5.0, 15.0)):
        options = {"outputs": "x0", "slopes": slopes, "boundary": Sign(), "dt": 0.1}
        design_sliding_mode(chain(order), [0.0] * order, reaching=ExponentialRate(0.1, 0.99 * k), **options)
        with pytest.raises(DesignError, match="are too long for the surface of 'x0'"):
            design_sliding_mode(
                chain(order), [0.0] * order, reaching=ExponentialRate(0.1, 1.01 * k), **options
            )


def test_the_slope_that_a_step_can_carry_is_where_the_loop_runs_away():
    """Outside the layer the rate is multiplied by 1 - lambda dt per step: beyond 2 it grows, whatever the gain."""
    model, dt = chain(2), 0.1
    options = {"outputs": "x0", "reaching": ConstantRate(0.1), "boundary": SaturationLayer(1.0)}
    law = design_sliding_mode(model, [0.0, 0.0], slopes=18.0, dt=dt, **options)
    assert abs(step_through(law, model, [0.1, 0.0], dt=dt, tf=60.0).x[0, -1]) < 0.01
    free = design_sliding_mode(model, [0.0, 0.0], slopes=25.0, **options)  # no step, no promise
    ends = [step_through(free, model, [0.1, 0.0], dt=dt, tf=tf).x[1, -1] for tf in (10.0, 11.0)]
    assert abs(ends[1] / ends[0]) == pytest.approx(1.5**10, rel=0.5)


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


REST = Reference.constant(cart(), [0.0, 0.0], [0.0])
WEIGHTS = {"Q": 1.0, "R": 1.0}
LAW = design_lqr(cart(), [0.0, 0.0], **WEIGHTS, dt=0.1)
FILTER = {"sigma0": {"q": 1.0, "v": 1.0}, "dt": 0.1}
SEEN = [Measurement("q", 0.1)]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (lambda: Reference("solution"), "argument of Reference()"),
        (lambda: Reference.constant("cart", [0.0, 0.0]), "model of a reference"),
        (lambda: design_lqr("cart", [0.0, 0.0], **WEIGHTS), "plant of design_lqr()"),
        (lambda: design_tvlqr(cart(), [0.0, 0.0], **WEIGHTS), "reference of design_tvlqr()"),
        (
            lambda: design_mpc("cart", [0.0, 0.0], **WEIGHTS, horizon=1.0, dt=0.1, limits=(-1, 1)),
            "plant of design_mpc()",
        ),
        (
            lambda: design_lqr(cart(), [0.0, 0.0], **WEIGHTS, dt=0.1, integral=np.ones(2)),
            "integral of design_lqr()",
        ),
        (
            lambda: design_mpc(
                cart(), [0.0, 0.0], **WEIGHTS, dt=0.1, horizon=1.0, limits=(-1, 1), state_limits=np.ones(2)
            ),
            "state_limits of design_mpc()",
        ),
        (lambda: feedforward([0.0, 0.0]), "argument of feedforward()"),
        (lambda: bryson(cart(), q=1.0), "layout of bryson()"),
        (lambda: with_dropout_handling("law"), "argument of with_dropout_handling()"),
        (
            lambda: output_feedback("law", design_ekf(cart(), [0, 0], SEEN, **FILTER)),
            "controller of output_feedback()",
        ),
        (lambda: output_feedback(LAW, "filter"), "estimator of output_feedback()"),
        (lambda: design_ekf("cart", [0, 0], SEEN, **FILTER), "model of an estimator"),
        (lambda: design_ekf(cart(), [0, 0], ["q"], **FILTER), "one of the measurements of 'EKF'"),
        (lambda: design_ekf(cart(), [0, 0], SEEN, **FILTER | {"sigma0": [1.0, 1.0]}), "sigma0"),
        (lambda: design_ekf(cart(), [0, 0], SEEN, **FILTER, options={"hold": 3}), "options of 'EKF'"),
        (lambda: design_ukf(cart(), [0, 0], SEEN, **FILTER, options={"hold": 3}), "options of 'UKF'"),
        (
            lambda: design_neighbouring_optimal("plan", LAW, Q=1.0, last=1.0),
            "plan of design_neighbouring_optimal()",
        ),
        (lambda: go.export_c("law", "folder"), "argument of export_c()"),
    ],
)
def test_what_a_function_cannot_take_is_named_with_what_it_takes(asked, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArgumentError, match=f"^(what|the|one|over|its)?.*{re.escape(words)}"):
        asked()


SLIDING = {"outputs": "q", "reaching": ConstantRate(1.0), "boundary": SaturationLayer(0.1)}


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (
            lambda: Reference.constant(cart(), [0.0]),
            "the state of a constant reference is given 1 value in a list",
        ),
        (lambda: design_lqr(cart(), [0.0], **WEIGHTS), "is given 1 value in a list: give 2 values"),
        (lambda: LAW(0.0, [0.0]), "the state given to 'LQR' is given 1 value in a list"),
        (
            lambda: go.ClosedLoop(cart(), LAW).simulate([1.0], tf=1.0),
            "initial state of a run is given 1 value in a",
        ),
        (
            lambda: design_sliding_mode(cart(), REST, **SLIDING, slopes="f"),
            "slope of output 'q' is 'f': give lambda",
        ),
        (
            lambda: design_sliding_mode(cart(), REST, **SLIDING, slopes={"q": "fast"}),
            "slope of output 'q' is 'fast': give lambda",
        ),
        (
            lambda: design_sliding_mode(cart(), REST, **SLIDING, slopes=1.0, guard=-1.0),
            "guard of a design is -1",
        ),
        (lambda: Reference.from_functions(cart(), 3, lambda t: [0], 0, 1), "the states of a reference are 3"),
        (
            lambda: Reference.from_functions(cart(), lambda t: [0], lambda t: [0], 0, 1),
            "is given 1 value in a list",
        ),
        (
            lambda: go.ClosedLoop(cart(), LAW, sensors=[SensorOutage("fog", 2.0, 1.0)]).simulate(
                [1.0, 0.0], tf=1.0
            ),
            "'fog' ends at 1 s, before it begins at 2 s",
        ),
    ],
)
def test_what_could_be_taken_for_something_else_is_refused(asked, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(go.GncOptError, match=re.escape(words)):
        asked()
