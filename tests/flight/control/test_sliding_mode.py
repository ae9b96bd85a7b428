"""Sliding-mode theory: reaching time, invariance, boundary layer, chattering, refusals; a published formation."""

from __future__ import annotations

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from testing.controller_steps import step_through

from gnc_opt.control import (
    ConstantRate,
    ExponentialRate,
    Reference,
    SaturationLayer,
    Sign,
    SuperTwisting,
    SuperTwistingObserver,
    design_sliding_mode,
)
from gnc_opt.control.sliding_mode import (
    SwitchingControl,
    _compute_sliding_surface_coefficients,
    build_switching_control,
)
from gnc_opt.errors import ArgumentError, DesignError, UnknownNameError
from gnc_opt.model import Model

DT, SLOPE = 1e-3, 2.0
START = np.array([1.0, 0.5])


def integrators(order: int = 2) -> Model:
    model = Model("integrators")
    names = [f"x{i}" for i in range(order)]
    x = [model.state(n) for n in names]
    u = model.control("u", unit="N")
    model.ode(dict(zip(x, [*x[1:], u], strict=True)))
    return model


def design(reaching, boundary, **options):
    model = integrators()
    options = {"slopes": SLOPE, "dt": DT} | options
    return design_sliding_mode(
        model, Reference.constant(model, [0, 0]), outputs="x0", reaching=reaching, boundary=boundary,
        **options,
    )  # fmt: skip


def surface(run, slope=SLOPE):
    return run.x[1] + slope * run.x[0]


def constant(value):
    return lambda t: np.full((1, t.size), value)


@pytest.mark.parametrize(
    ("law", "bound"), [(ConstantRate(1.0), 0.0), (ConstantRate(1.0), 0.6), (ExponentialRate(0.5, 1.5), 0.3)]
)
def test_surface_is_reached_at_the_bound_on_the_reaching_time_and_not_later(law, bound):
    """The disturbance that works hardest against the law makes the bound an equality, up to the step."""
    controller = design(law, Sign(), bound=bound)
    bounded = law.reaching_time(START[1] + SLOPE * START[0], bound)
    run = step_through(controller, integrators(), START, dt=DT, tf=bounded + 1, disturbance=constant(bound))
    s = surface(run)
    reached = run.times[np.argmax(s <= 0.002)]
    assert 0.95 * bounded < reached <= bounded + 2 * DT
    assert np.max(np.abs(s[run.times > bounded + 2 * DT])) < 3 * DT


def test_sliding_is_invariant_to_matched_disturbances_below_the_gain():
    """On s = 0 the error follows exp(-lambda t) whatever the disturbance."""
    controller = design(ConstantRate(1.0), Sign(), bound=0.8)
    runs = [
        step_through(controller, integrators(), [1.0, -SLOPE], dt=DT, tf=3.0, disturbance=d)
        for d in (
            None,
            constant(0.8),
            lambda t: 0.8 * np.sin(7 * t)[None],
            lambda t: 0.8 * np.sign(np.cos(3 * t))[None],
        )
    ]
    for run in runs:
        assert run.x[0] == pytest.approx(np.exp(-SLOPE * run.times), abs=2 * DT)


def test_there_is_no_invariance_above_the_gain():
    """s runs away at the rate by which the disturbance exceeds the gain."""
    run = step_through(
        design(ConstantRate(1.0), Sign()), integrators(), [0.0, 0.0], dt=DT, tf=3.0, disturbance=constant(1.5)
    )
    assert surface(run)[-1] == pytest.approx(0.5 * 3.0, rel=0.01)


@pytest.mark.parametrize("law", [ConstantRate(1.0), ExponentialRate(1.0, 0.01)])
def test_boundary_layer_bounds_the_steady_error(law):
    """A constant disturbance at its bound ends at the stated width; a smaller one stays inside."""
    controller = design(law, SaturationLayer(0.05), bound=0.7)
    stated = controller.explain()["steady error bound"][0]
    at_bound, inside = (
        step_through(controller, integrators(), 0.05 * START, dt=DT, tf=8.0, disturbance=constant(d)).x[0, -1]
        for d in (0.7, 0.35)
    )
    assert at_bound == pytest.approx(stated, rel=2e-3)
    assert at_bound <= stated * (1 + 1e-6)
    assert inside < 0.55 * stated
    assert stated == pytest.approx(0.05 * 0.7 / SLOPE)


def test_chattering_falls_more_than_a_hundredfold_from_sign_to_saturation():
    variation = {}
    for boundary in (Sign(), SaturationLayer(0.02)):
        run = step_through(
            design(ConstantRate(1.0), boundary, bound=0.5), integrators(), START, dt=DT, tf=10.0,
            disturbance=lambda t: 0.5 * np.sin(t)[None],
        )  # fmt: skip
        variation[type(boundary)] = np.sum(np.abs(np.diff(run.u[0])))
    assert variation[Sign] > 100 * variation[SaturationLayer]


def test_the_sampling_limit_is_where_the_sampled_surface_begins_to_grow():
    """Inside the layer s+ = (1 - gain dt / phi) s; designed for any step, the law is run on either side of 2."""
    grown = {}
    for ratio in (1.9, 2.1):
        controller = design(ConstantRate(1.0), SaturationLayer(1.0), dt=None, slopes=1e-3)
        run = step_through(controller, integrators(), [0.0, 1e-3], dt=ratio, tf=60 * ratio)
        grown[ratio] = abs(surface(run, 1e-3)[-1]) / 1e-3
    assert grown[1.9] < 0.01 < 100 < grown[2.1]
    with pytest.raises(DesignError, match=r"gain \* dt / phi = 2.1 is not below 2"):
        design(ConstantRate(1.0), SaturationLayer(1.0), dt=2.1)
    facts = design(ConstantRate(1.0), SaturationLayer(1.0), dt=1.9, slopes=1e-3).explain()
    assert facts["sampling limit"] == pytest.approx(2.0) and facts["surface poles of x0"] == [-1e-3]


@pytest.mark.parametrize("poles", [[-1.0, -2.0, -3.0], [-2.0, -1 + 1j, -1 - 1j]])
def test_surfaces_of_higher_relative_degree_have_the_poles_asked_for(poles):
    model = integrators(4)
    controller = design_sliding_mode(
        model, Reference.constant(model, np.zeros(4)), outputs="x0", slopes={"x0": poles},
        reaching=ExponentialRate(1.0, 5.0), boundary=SaturationLayer(0.01), bound=0.5, dt=DT,
    )  # fmt: skip
    c = np.poly(poles)[::-1].real
    run = step_through(controller, model, [1, 0, 0, 0], dt=DT, tf=16.0, disturbance=constant(0.5))
    s = c @ run.x
    facts = controller.explain()
    assert np.sort_complex(facts["surface poles of x0"]) == pytest.approx(np.sort_complex(np.array(poles)))
    assert abs(s[-1]) <= facts["band of s"][0]
    # a constant s makes a constant error s / c_0, which is the bound for real poles
    assert run.x[0, -1] == pytest.approx(s[-1] / c[0], rel=2e-3)
    if np.isreal(poles).all():
        assert s[-1] / c[0] <= facts["steady error bound"][0] * (1 + 1e-9)


def test_an_observer_cancels_what_the_reaching_law_could_not_hold():
    """A disturbance of 2 against a gain of 0.2: with the observer s still ends at zero."""
    observer = SuperTwistingObserver(3.0, 2.0, bound=1.0)
    plain, helped = (
        step_through(
            design(ConstantRate(0.2), SaturationLayer(0.05), observer=o),
            integrators(),
            [0.0, 0.0],
            dt=DT,
            tf=12.0,
            disturbance=lambda t: (2 + np.sin(t))[None],
        )
        for o in (None, observer)
    )
    assert abs(surface(plain)[-1]) > 1
    assert abs(surface(helped)[-1]) < 2e-3
    estimate = helped.memory("disturbance")[0, -1]
    assert estimate == pytest.approx(2 + np.sin(12.0), abs=0.02)


def test_reserve_is_what_the_limits_leave_beside_feedforward_and_gain():
    assert design(ConstantRate(1.0), Sign(), limits=(-1.5, 2.0)).explain()[
        "control authority margin"
    ] == pytest.approx(0.5 / 1.75)
    with pytest.raises(
        DesignError, match=r"control 'u' needs 1 besides its feedforward 0 .* limits are -0.9 and 2"
    ):
        design(ConstantRate(1.0), Sign(), limits=(-0.9, 2.0))
    with pytest.raises(DesignError, match="no authority"):
        design(ConstantRate(1.0), Sign(), limits=(0.0, 0.0))


def test_hopeless_designs_are_refused_with_numbers():
    with pytest.raises(DesignError, match=r"disturbed by 1.2, not less than the gain 1 "):
        design(ConstantRate(1.0), Sign(), bound=1.2)
    with pytest.raises(DesignError, match=r"k2 = 0\.5"):
        design(SuperTwisting(2.0, 0.5), Sign(), bound=0.5)
    with pytest.raises(DesignError, match=r"k1 = 1 .* sqrt"):
        design(SuperTwisting(1.0, 1.0), Sign(), bound=0.5)
    with pytest.raises(DesignError, match="give dt"):
        design(SuperTwisting(2.0, 1.0), Sign(), dt=None)
    with pytest.raises(DesignError, match="lambda > 0"):
        design(ConstantRate(1.0), Sign(), slopes=-1.0)
    with pytest.raises(DesignError, match="not 2"):
        design(ConstantRate(1.0), Sign(), slopes={"x0": [-1.0, -2.0]})
    with pytest.raises(DesignError, match="finite numbers >= 0"):
        design(ConstantRate(1.0), Sign(), bound=np.nan)
    with pytest.raises(DesignError, match="the reaching law is 1"):
        design(1.0, Sign())
    with pytest.raises(DesignError, match="the boundary is 0"):
        design(ConstantRate(1.0), 0.1)


def swinging() -> Model:
    """A control that loses its grip at x0 = 0: dx1/dt = x0 u."""
    model = Model("swinging")
    x, v, u = model.state("x"), model.state("v"), model.control("u")
    model.ode({x: v, v: x * u})
    return model


def singular_design(reference):
    return design_sliding_mode(
        reference.model, reference, outputs="x", slopes=1.0, reaching=ConstantRate(1.0),
        boundary=SaturationLayer(0.1), dt=DT,
    )  # fmt: skip


def test_singular_decoupling_on_the_reference_is_refused_with_its_time():
    model = swinging()
    with pytest.raises(DesignError, match="singular on the reference"):
        singular_design(Reference.constant(model, [0.0, 0.0], [0.0]))
    line = Reference.from_functions(model, lambda t: [1 - t, -1.0], lambda t: [0.0], 0.0, 2.0)
    with pytest.raises(DesignError, match=r"det E = -1 at t = 2 s"):
        singular_design(line)


def test_run_time_guards_hold_the_command_and_raise_alarms():
    model = swinging()
    controller = singular_design(Reference.constant(model, [1.0, 0.0], [0.0]))
    u, z = controller(0.0, [1.2, 0.1])
    held = {name: controller.memory.slice(name) for name in ("singular", "u_last", "s")}
    assert z[held["singular"]] == 0
    again, after = controller(DT, [0.01, 0.0], z)
    assert again == pytest.approx(u)
    assert np.all(np.isfinite(after))
    assert after[held["singular"]] == 1
    assert after[held["s"]] == z[held["s"]]
    recovered, later = controller(2 * DT, [1.1, 0.0], after)
    assert later[held["singular"]] == 1
    assert recovered == pytest.approx(controller(2 * DT, [1.1, 0.0])[0])


def test_unstable_zero_dynamics_are_refused_with_their_eigenvalue():
    """y = x0 - x1 of a double integrator: (1 - p) / p^2 has its zero at +1."""
    model = integrators()
    x0, x1 = model.symbol("x0"), model.symbol("x1")
    with pytest.raises(DesignError, match="unstable: eigenvalue 1"):
        design_sliding_mode(
            model, Reference.constant(model, [0, 0]), outputs={"y": x0 - x1}, reaching=ConstantRate(1.0),
            boundary=Sign(),
        )  # fmt: skip


@pytest.mark.parametrize("boundary", [SaturationLayer(0.1), Sign()], ids=str)
@pytest.mark.parametrize(("level", "alarm"), [(0.95, 0.0), (1.05, 1.0), (-1.05, 1.0)])
def test_a_disturbance_above_the_gain_raises_an_alarm_and_one_below_does_not(boundary, level, alarm):
    """The gain is 1: what is below cannot drive s away, what is above does."""
    model = integrators()
    controller = design_sliding_mode(
        model, [0, 0], outputs="x0", slopes=1.0, reaching=ConstantRate(1.0), boundary=boundary, dt=0.01
    )
    run = step_through(
        controller,
        model,
        [0.5, 0.0],
        dt=0.01,
        tf=25.0,
        disturbance=lambda t: level * (t > 20.0)[None, :],  # a step while sliding
    )
    flags = run.memory("switching_gain_exceeded")[0]
    assert flags[-1] == alarm
    assert not flags[run.times < 20.0].any()  # reaching is no alarm, however long it takes
    assert ("switching_gain_exceeded" in controller.alarms) and (
        np.abs(run.memory("s")[0, -1]) > 0.15
    ) == bool(alarm)


@pytest.mark.parametrize("boundary", [SaturationLayer(0.1)], ids=str)
@pytest.mark.parametrize(("level", "alarm"), [(0.9, 0.0), (1.1, 1.0), (-0.9, 0.0), (-1.6, 1.0)])
def test_a_disturbance_that_never_lets_s_come_down_raises_the_alarm_too(boundary, level, alarm):
    """From the beginning on, so that sliding never begins: s' = -sign(s) + d has the sign of s where |d| > 1."""
    model = integrators()
    controller = design_sliding_mode(
        model, [0, 0], outputs="x0", slopes=1.0, reaching=ConstantRate(1.0), boundary=boundary, dt=0.01
    )
    run = step_through(
        controller, model, [np.copysign(0.5, level), 0.0], dt=0.01, tf=25.0,
        disturbance=lambda t: level + 0 * t[None, :],
    )  # fmt: skip
    flags = run.memory("switching_gain_exceeded")[0]
    assert flags[-1] == alarm
    if alarm:
        assert run.times[np.argmax(flags)] < 0.2  # ten control steps, and the first two


SIGN, SAT = Sign(), SaturationLayer(0.5)


def switching(reaching, boundary, dt=None, bounds=(0.0,), limits=None):
    return SwitchingControl(reaching, boundary, np.array(bounds), dt, limits)


@pytest.mark.parametrize(
    ("slopes", "message"),
    [
        ([1.0], "1 slopes for 2 surfaces"),
        ([1.0, [-1.0]], "relative degree 3: give lambda, or 2 poles, not 1"),
        ([1.0, -2.0], "give lambda > 0"),
        ([1.0, [-1.0, 1.0]], "negative"),
        ([1.0, [-1 + 1j, -1.0]], "conjugate pairs"),
        ({}, "'b' has relative degree > 1"),
        ({"c": 1.0}, "no output 'c'"),
    ],
)
def test_slopes_that_make_no_surface_are_refused(slopes, message):
    errors = SimpleNamespace(labels=("a", "b"), relative_degrees=(1, 3), n_outputs=2)
    with pytest.raises((DesignError, UnknownNameError), match=message):
        _compute_sliding_surface_coefficients(errors, slopes)


@pytest.mark.parametrize(
    ("law", "options", "message"),
    [
        ((ConstantRate(3.0), "sign"), {}, "the boundary is 'sign'"),
        ((SuperTwisting(3.0, 2.0), SIGN), {}, "give dt, in s"),
        ((ConstantRate(3.0), SIGN), {"memory": True}, "give dt, in s"),
        ((ConstantRate(3.0), SAT), {"dt": 2 / 6.0}, r"gain \* dt / phi = 2 is not below 2"),
        ((ConstantRate(3.0), SAT), {"dt": 0.0}, "control step dt"),
        ((ConstantRate(3.0), SIGN), {"bound": 3.0}, "surface of 'a'"),
        ((ConstantRate(3.0), SIGN), {"limits": (1.0, 1.0)}, "no authority"),
    ],
)
def test_switching_that_cannot_be_is_refused(law, options, message):
    settings = {"bound": 0.0, "limits": None, "dt": None} | options
    with pytest.raises((ArgumentError, DesignError), match=message):
        build_switching_control(*law, (chain_model(), ("a",)), **settings)


def chain_model(extra: float = 0.0) -> Model:
    """q' = v, v' = 2 a - q, w' = extra w + v."""
    model = Model("chain")
    q, v, w = model.state("q"), model.state("v"), model.state("w")
    a = model.control("a")
    model.ode({q: v, v: 2 * a - q, w: extra * w + v})
    model.output("sum", q + 3 * v)
    return model


def test_a_law_that_switches_at_once_has_no_alarm_of_a_strong_disturbance():
    """Without a layer and in continuous time nothing tells how far s may stray; a step of 0.1 s does."""
    s = ca.SX.sym("s")
    assert switching(ConstantRate(3.0), SIGN, dt=None).create_disturbance_exceeds_gain_alarm(s) == []
    (away, *_) = switching(ConstantRate(3.0), SIGN, dt=0.1).create_disturbance_exceeds_gain_alarm(s)
    outside = ca.substitute(away.after, away.symbol, 0.0)
    found = [float(ca.DM(ca.evalf(ca.substitute(outside, s, v)))) for v in (0.59, 0.61, -0.59, -0.61)]
    assert found == [0.0, 1.0, 0.0, 1.0]
