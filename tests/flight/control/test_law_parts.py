"""What laws are made of, by hand: reaching laws, surfaces, chains, horizons, predictive reaching, C texts."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad

from gnc_opt.control import (
    ConstantRate,
    Controller,
    DesignReport,
    ErrorDynamics,
    ExponentialRate,
    PowerRate,
    Reference,
    SaturationLayer,
    Sign,
    SuperTwisting,
    SuperTwistingObserver,
    TanhLayer,
    design_lqr,
    export_c,
    initial_state_function,
    law,
    lie_derivative,
    output_errors,
    zero_dynamics,
)
from gnc_opt.control import active_set_qp as programme_code
from gnc_opt.control.active_set_qp import ProgrammeCode, _Numbered
from gnc_opt.control.c_export.c_writer import DOUBLE, wrapped
from gnc_opt.control.c_export.export import _entries, _identifier, _plain, _read_prefix
from gnc_opt.control.c_export.schedule_table import flight_table
from gnc_opt.control.decoupling import Inverse, Memory, _solve
from gnc_opt.control.feedback_linearization import _chains, _gain, _optimal_gain, _places, _polynomial
from gnc_opt.control.feedforward import StackedSchedule
from gnc_opt.control.horizon_qp import Horizon, Programme, Rows
from gnc_opt.control.input_output_linearization import Pair, _labels, _output, given_for
from gnc_opt.control.integral_sliding_mode import _nominal, _poles, _surface
from gnc_opt.control.mpc import _error_scale, _rates, _state_rows, _steps, _subtracts, _Windows
from gnc_opt.control.reaching_laws import read_bounds
from gnc_opt.control.sampled_data import SampledStep
from gnc_opt.control.sliding_mode import (
    SlidingOptions,
    Switching,
    _coefficients,
    _peak_gain,
    _require_decay,
    _weigh,
)
from gnc_opt.control.super_twisting import _lyapunov, check_gains, convergence_time, sampled_band
from gnc_opt.control.tvlqr_gains import SampledGains
from gnc_opt.errors import ArgumentError, DesignError, UnknownNameError
from gnc_opt.model import Layout, Model, Variable

INF = np.inf
SIGN, SAT, TANH = Sign(), SaturationLayer(0.5), TanhLayer(0.5)


def number(value):
    return float(ca.evalf(ca.SX(value)))


# --- reaching laws ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "boundary", "s", "rate"),
    [
        (ConstantRate(3.0), SIGN, -0.2, -3.0),
        (ConstantRate(3.0), SAT, 0.2, 1.2),
        (ConstantRate(3.0), SAT, -9.0, -3.0),
        (ConstantRate(3.0), TANH, 0.2, 3 * np.tanh(0.4)),
        (ExponentialRate(3.0, 2.0), SIGN, -0.2, -3.4),
        (ExponentialRate(3.0, 2.0), SAT, 0.2, 1.6),
        (PowerRate(3.0, 0.5), SIGN, -0.25, -1.5),
        (PowerRate(3.0, 0.5), SAT, 0.25, 0.75),
        (SuperTwisting(3.0, 2.0), SIGN, -0.25, -1.5),
    ],
)
def test_rates_of_reaching_laws(law, boundary, s, rate):
    assert number(law.rate(ca.SX(s), boundary)) == pytest.approx(rate)


@pytest.mark.parametrize(
    "law", [ConstantRate(3.0), ExponentialRate(3.0, 2.0), PowerRate(3.0, 0.4), SuperTwisting(3.0, 2.0)]
)
@pytest.mark.parametrize("boundary", [SAT, TANH])
def test_the_steepest_slope_of_a_law_in_its_layer_bounds_its_differences(law, boundary):
    s = np.linspace(-2.0, 2.0, 4001)
    x = ca.SX.sym("x")
    rates = np.array(ca.Function("rho", [x], [law.rate(x, boundary)])(s[None, :])).ravel()
    steepest = np.max(np.diff(rates) / np.diff(s))
    assert steepest <= law.slope(boundary) * (1 + 1e-9)
    assert steepest > law.slope(boundary) * (0.99 if boundary is SAT else 0.55)


def test_without_a_layer_the_slope_is_infinite():
    for each in (ConstantRate(3.0), ExponentialRate(3.0, 2.0), PowerRate(3.0, 0.4), SuperTwisting(3.0, 2.0)):
        assert each.slope(SIGN) == INF
    assert SIGN.slope == INF and SAT.slope == 2.0 == TANH.slope


@pytest.mark.parametrize(
    ("law", "bound"),
    [
        (ConstantRate(3.0), 0.0),
        (ConstantRate(3.0), 1.0),
        (ExponentialRate(3.0, 2.0), 1.0),
        (PowerRate(3.0, 0.4), 0.0),
    ],
)
@pytest.mark.parametrize("start", [2.0, -0.5])
def test_reaching_times_are_those_of_the_differential_equation(law, bound, start):
    """The time is the integral of ds / (rho - bound)."""

    def slowness(s):
        return 1 / (number(law.rate(ca.SX(s), SIGN)) - bound)

    expected = quad(slowness, 0.0, abs(start), epsabs=1e-10)[0]
    assert law.reaching_time(start, bound) == pytest.approx(expected, rel=1e-6)


def test_a_power_rate_never_quite_arrives_disturbed():
    assert PowerRate(3.0, 0.4).reaching_time(1.0, 0.1) == INF
    assert PowerRate(3.0, 0.4).gain == INF and ConstantRate(3.0).gain == 3.0


@pytest.mark.parametrize("law", [ConstantRate(3.0), PowerRate(3.0, 0.4)])
@pytest.mark.parametrize("boundary", [SAT, TANH])
def test_in_its_band_a_law_balances_the_disturbance(law, boundary):
    band = law.band(boundary, 1.2)
    assert number(law.rate(ca.SX(band), boundary)) == pytest.approx(1.2)


def test_bands_without_a_layer():
    assert ConstantRate(3.0).band(SIGN, 1.2) == 0.0 and ExponentialRate(3.0, 2.0).band(SAT, 1.5) == 0.25
    assert PowerRate(3.0, 0.5).band(SIGN, 1.5) == pytest.approx(0.25)
    assert SuperTwisting(3.0, 2.0).band(SAT, 1.0) == 0.25 and SuperTwisting(3.0, 2.0).band(SIGN, 1.0) == 0.0
    assert PowerRate(0.01, 0.5).band(SAT, 5.0) == pytest.approx(250000.0)  # far outside the layer


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: ConstantRate(0.0), "gain eta"),
        (lambda: ExponentialRate(1.0, 0.0), "rate k"),
        (lambda: PowerRate(0.0, 0.5), "gain k"),
        (lambda: PowerRate(1.0, 1.0), "between 0 and 1"),
        (lambda: PowerRate(1.0, 0.0), "exponent"),
        (lambda: SuperTwisting(0.0, 1.0), "k1"),
        (lambda: SuperTwisting(1.0, 0.0), "k2"),
        (lambda: SaturationLayer(0.0), "phi"),
        (lambda: TanhLayer(-1.0), "phi"),
        (lambda: read_bounds(3.0, 0.0, ("a",)), "the reaching law is 3.0"),
        (lambda: read_bounds(ConstantRate(2.0), 2.0, ("a",)), "surface of 'a'"),
        (lambda: read_bounds(ConstantRate(2.0), [1.0, 2.1], ("a", "b")), "surface of 'b'"),
        (lambda: read_bounds(ConstantRate(2.0), -1.0, ("a",)), "give finite numbers >= 0"),
        (lambda: read_bounds(PowerRate(2.0, 0.5), INF, ("a",)), "give finite numbers >= 0"),
        (lambda: read_bounds(SuperTwisting(3.0, 2.0), 2.0, ("a",)), "raise k2"),
        (lambda: check_gains(2.0, 3.0, 1.0, "it"), "raise k1"),
        (lambda: SuperTwistingObserver(2.0, 3.0, 1.0), "raise k1"),
        (lambda: SuperTwistingObserver(1.0, 1.0, -1.0), "bound of an observer"),
    ],
)
def test_gains_that_make_no_sense_are_refused(wrong, message):
    with pytest.raises((ArgumentError, DesignError), match=message):
        wrong()


def test_gains_that_do_are_not():
    assert read_bounds(ConstantRate(2.0), 1.9, ("a", "b")).tolist() == [1.9, 1.9]
    assert read_bounds(PowerRate(2.0, 0.5), 99.0, ("a",)).tolist() == [99.0]
    check_gains(2.01, 3.0, 1.0, "it")


# --- super-twisting ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("k1", "k2", "s", "z", "bound"),
    [(3.0, 2.0, 2.0, 0.0, 0.0), (3.0, 2.0, -0.5, 1.0, 0.3), (30.0, 200.0, 2.0, 0.0, 0.0)],
)
def test_convergence_times_bound_what_happens(k1, k2, s, z, bound):
    """With the disturbance at its largest rate, against the return."""
    limit = convergence_time(k1, k2, s, z=z, bound=bound)

    h, now, drift = limit / 40000, s, z
    for _ in range(40000):
        side = np.sign(now)
        now, drift = now + h * (-k1 * np.sqrt(abs(now)) * side + drift), drift + h * (bound - k2) * side
    assert np.isfinite(limit) and abs(now) < 1e-3 * abs(s) and abs(drift) < 1e-2 * max(abs(z), k2 * limit)
    assert convergence_time(k1, k2, 4 * s, z=2 * z, bound=bound) == pytest.approx(2 * limit)
    assert convergence_time(k1, k2, -s, z=-z, bound=bound) == pytest.approx(limit)


@pytest.mark.parametrize("bound", [0.0, 0.3])
def test_the_decay_is_that_of_the_worst_disturbance_for_a_form_of_the_undisturbed_law(bound):
    """A' P + P A = -diag(1, weight) without a disturbance; with one, the least decay over |w| <= 1."""
    k2 = 0.4
    p, decay = _lyapunov(k2, bound)

    def rate(w):
        a = np.array([[-0.5, 0.5], [-k2 + w * bound, 0.0]])
        return -(a.T @ p + p @ a)

    still = rate(0.0)
    assert still[0, 0] == pytest.approx(1.0) and abs(still[0, 1]) < 1e-12 and still[1, 1] > 0
    assert np.log10(still[1, 1]) * 10 == pytest.approx(
        round(np.log10(still[1, 1]) * 10)
    )  # ten weights a decade
    shares = [np.linalg.eigvalsh(rate(w))[0] for w in np.linspace(-1, 1, 41)]
    assert decay == pytest.approx(min(shares)) and np.all(np.linalg.eigvalsh(p) > 0)


def test_gains_that_converge_without_a_bound_of_this_kind():
    assert convergence_time(1.99, 2.0, 1.0, bound=1.9) == INF


def test_the_band_of_the_sampled_law_falls_with_the_square_of_the_step():
    band = sampled_band(3.0, 2.0, 0.01)
    assert sampled_band(3.0, 2.0, 0.02) == pytest.approx(4 * band)
    s, z, tail = 50 * band, 0.0, []
    for k in range(20000):
        side = np.sign(s)
        s, z = s + 0.01 * (-3 * np.sqrt(abs(s)) * side + z), z - 0.01 * 2 * side
        tail += [abs(s)] * (k > 10000)
    assert 0.2 * band < max(tail) <= band * (1 + 1e-9)


def test_an_observer_over_one_step():
    assert SuperTwistingObserver(0.2, 0.01).bound == 0.0  # what is constant asks for no least gains
    observer = SuperTwistingObserver(3.0, 2.0)
    assert number(observer.estimate(ca.SX(1.0), ca.SX(1.25), ca.SX(0.5))) == pytest.approx(0.5 - 1.5)
    s_hat, q = observer.update(ca.SX(1.0), ca.SX(1.25), ca.SX(0.5), ca.SX(7.0), 0.1)
    assert (number(s_hat), number(q)) == pytest.approx((1.25 + 0.1 * (7 - 1.0), 0.5 - 0.2))
    _, q = observer.update(ca.SX(1.0), ca.SX(0.75), ca.SX(0.5), ca.SX(7.0), 0.1)
    assert number(q) == pytest.approx(0.7)


# --- surfaces ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("c", "gain"),
    [
        ([1.0], 1.0),
        ([2.0, 1.0], 0.5),
        ([6.0, 5.0, 1.0], 1 / 6),
        ([1.0, 1.0, 1.0], None),
        ([5.0, 0.4, 1.0], None),
    ],
)
def test_the_largest_error_that_a_band_allows(c, gain):
    """Of real poles the gain at rest; of others the integral of |exp(-a t) sin(b t)| / b, cut by its zeros."""
    if gain is None:
        a, b = c[1] / 2, np.sqrt(c[0] - c[1] ** 2 / 4)
        swing = np.exp(-a * np.pi / b)
        gain = (1 + swing) / (1 - swing) / c[0]
    assert _peak_gain(np.array(c)) == pytest.approx(gain, rel=1e-3)


def switching(reaching, boundary, dt=None, bounds=(0.0,), limits=None):
    return Switching(reaching, boundary, np.array(bounds), dt, limits)


def test_steps_over_which_errors_grow_from_afar_are_refused():
    """e' = -c0 e held over dt is 1 - c0 dt; with k it is the double chain of (k c0, k + c0)."""
    c = np.array([3.0, 1.0])
    _require_decay(("a",), [c], switching(ConstantRate(1.0), SIGN, 0.66))
    _require_decay(("a",), [c], switching(ConstantRate(1.0), SIGN))
    _require_decay(("a",), [np.array([1.0])], switching(ConstantRate(1.0), SIGN, 99.0))
    with pytest.raises(DesignError, match=r"surface of 'a'.* grow by a factor of 1\.01 per step"):
        _require_decay(("a",), [c], switching(ConstantRate(1.0), SIGN, 0.67))
    _require_decay(("a",), [np.array([1.0])], switching(ExponentialRate(1.0, 4.0), SIGN, 0.49))
    with pytest.raises(DesignError, match="surface of 'b'"):
        _require_decay(("a", "b"), [np.array([1.0]), c], switching(ExponentialRate(1.0, 0.5), SIGN, 0.67))
    with pytest.raises(DesignError, match="surface of 'a'"):
        _require_decay(("a",), [np.array([1.0])], switching(ExponentialRate(1.0, 4.0), SIGN, 0.51))


def test_sums_of_derivatives():
    chain = ca.SX(ca.DM([1.0, 10.0, 100.0]))
    assert (
        number(_weigh(np.array([2.0, 3.0]), chain, 0)) == 32.0
        and number(_weigh(np.array([2.0, 3.0]), chain, 1)) == 320.0
    )


@pytest.mark.parametrize(
    ("slopes", "found"),
    [
        (2.0, [[1.0], [4.0, 4.0, 1.0]]),
        ([1.0, [-1.0, -3.0]], [[1.0], [3.0, 4.0, 1.0]]),
        ({"b": [-1 + 1j, -1 - 1j]}, [[1.0], [2.0, 2.0, 1.0]]),
    ],
)
def test_coefficients_of_surfaces(slopes, found):
    errors = SimpleNamespace(labels=("a", "b"), degrees=(1, 3), size=2)
    assert [c.tolist() for c in _coefficients(errors, slopes)] == [pytest.approx(f) for f in found]


@pytest.mark.parametrize(
    ("slopes", "message"),
    [
        ([1.0], "1 slopes are given for 2 surfaces"),
        ([1.0, [-1.0]], "relative degree 3: give lambda, or 2 poles, not 1"),
        ([1.0, -2.0], "give lambda > 0"),
        ([1.0, [-1.0, 1.0]], "negative"),
        ([1.0, [-1 + 1j, -1.0]], "conjugate pairs"),
        ({}, "'b' has relative degree > 1"),
        ({"c": 1.0}, "no output 'c'"),
    ],
)
def test_slopes_that_make_no_surface_are_refused(slopes, message):
    errors = SimpleNamespace(labels=("a", "b"), degrees=(1, 3), size=2)
    with pytest.raises((DesignError, UnknownNameError), match=message):
        _coefficients(errors, slopes)


def test_the_demand_of_a_law_and_its_memory():
    s, drift = ca.SX(ca.DM([0.2, -0.4])), ca.SX(ca.DM([1.0, 2.0]))
    wanted, memory = switching(ConstantRate(3.0), SIGN, bounds=(0.0, 0.0)).demand(s, drift)
    assert np.array(ca.evalf(wanted)).ravel() == pytest.approx([-4.0, 1.0]) and memory == []
    wanted, (twist,) = switching(SuperTwisting(3.0, 2.0), SIGN, 0.1, (0.0, 0.0)).demand(s, drift)
    f = ca.Function("f", [twist.symbol], [wanted, twist.after])
    found, after = (np.array(v).ravel() for v in f([10.0, 20.0]))
    assert found == pytest.approx([9 - 3 * np.sqrt(0.2), 18 + 3 * np.sqrt(0.4)]) and after == pytest.approx(
        [9.8, 20.2]
    )
    assert twist.name == "twist" and np.array(ca.evalf(twist.start)).tolist() == [[0], [0]]
    assert twist.variable == Variable("twist", 2)


def test_facts_of_switching():
    def names(*arguments):
        return [f.name for f in switching(*arguments).facts()]

    assert names(ConstantRate(3.0), SIGN) == ["band of s"]
    assert names(ConstantRate(3.0), SIGN, 0.1) == ["band of s", "chattering band of s"]
    assert names(PowerRate(3.0, 0.5), SIGN, 0.1) == ["band of s"]
    assert names(ConstantRate(3.0), SAT, 0.1) == ["band of s", "sampling limit"]
    band, chatter = switching(ConstantRate(3.0), SIGN, 0.1).facts()
    assert chatter.value == pytest.approx(0.3) and band.value.tolist() == [0.0]
    assert switching(ConstantRate(3.0), SAT, 0.1, (1.5,)).facts()[1].value == pytest.approx(2 / 6.0)
    assert switching(ConstantRate(3.0), SAT, 0.1, (1.5,)).bands.tolist() == [0.25]
    twisting = switching(SuperTwisting(3.0, 2.0), SIGN, 0.1).facts()[1]
    assert twisting.value == sampled_band(3.0, 2.0, 0.1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (SlidingOptions(ConstantRate(3.0), "sign"), "the boundary is 'sign'"),
        (SlidingOptions(SuperTwisting(3.0, 2.0), SIGN), "give dt, in s"),
        (SlidingOptions(ConstantRate(3.0), SIGN, observer=SuperTwistingObserver(3.0, 2.0)), "give dt, in s"),
        (SlidingOptions(ConstantRate(3.0), SAT, dt=2 / 6.0), r"gain \* dt / phi = 2 is not below 2"),
        (SlidingOptions(ConstantRate(3.0), SAT, dt=0.0), "control step dt"),
        (SlidingOptions(ConstantRate(3.0), SIGN, 3.0), "surface of 'a'"),
        (SlidingOptions(ConstantRate(3.0), SIGN, limits=(1.0, 1.0)), "no authority"),
    ],
)
def test_switching_that_cannot_be_is_refused(options, message):
    with pytest.raises((ArgumentError, DesignError), match=message):
        options.switching(chain_model(), ("a",))


def test_switching_that_can_be():
    found = SlidingOptions(ConstantRate(3.0), SAT, 1.0, dt=0.33, limits=(-1.0, 2.0)).switching(
        chain_model(), ("a", "b")
    )
    assert (found.bounds.tolist(), found.dt, found.limits[1].tolist()) == ([1.0, 1.0], 0.33, [2.0])
    free = SlidingOptions(ConstantRate(3.0), SAT).switching(chain_model(), ("a",))
    assert free.dt is None and free.limits is None


# --- Lie derivatives and chains ---------------------------------------------------------------------------


def chain_model(extra: float = 0.0) -> Model:
    """q' = v, v' = 2 a - q, w' = extra w + v."""
    model = Model("chain")
    q, v, w = model.state("q"), model.state("v"), model.state("w")
    a = model.control("a")
    model.ode({q: v, v: 2 * a - q, w: extra * w + v})
    model.output("sum", q + 3 * v)
    return model


def at_rest(model):
    return Reference.constant(model, np.zeros(model.states.size), np.zeros(model.controls.size))


def test_lie_derivatives_of_any_order():
    model = chain_model()
    x = ca.vertcat(*[ca.SX(model.symbol(n)) for n in ("q", "v", "w")])
    f = ca.Function(
        "f",
        [model.time, x, ca.SX(model.symbol("a"))],
        [lie_derivative(model, model.symbol("q") * model.time), lie_derivative(model, model.symbol("q"), 2)],
    )
    first, second = (float(v) for v in f(2.0, [3.0, 5.0, 7.0], 11.0))
    assert (first, second) == (3 + 2 * 5, 22 - 3)


def test_chains_end_where_the_control_enters():
    model = chain_model()
    errors = output_errors(model, at_rest(model), "w")
    assert errors.degrees == (2,) and errors.labels == ("w",) and errors.size == 1
    f = ca.Function(
        "f",
        [errors.pair.x, errors.pair.x_ref, errors.pair.u_ref],
        [errors.chains[0], errors.drift, errors.decoupling],
    )
    chain, _, decoupling = (np.array(v).ravel() for v in f([1.0, 2.0, 3.0], [0.5, 0.25, 1.0], 0.0))
    assert chain == pytest.approx([2.0, 1.75]) and decoupling == pytest.approx([2.0])
    assert np.array(
        ca.evalf(ca.substitute(ca.SX(errors.determinant), errors.pair.x, 0))
    ).ravel() == pytest.approx([2.0])
    assert output_errors(model, at_rest(model), "sum").degrees == (1,)


@pytest.mark.parametrize(
    ("outputs", "message"),
    [
        ([], "no outputs are given"),
        ("z", "no state or output 'z'"),
        (["q", "v"], "1 control for 2 outputs"),
        ("loose", "its relative degree is not defined"),
        ("direct", "a control enters output 'direct' itself"),
    ],
)
def test_outputs_that_cannot_be_steered(outputs, message):
    model = Model("m")
    q, v, free = model.state("q"), model.state("v"), model.state("free")
    a = model.control("a")
    model.ode({q: v, v: a, free: -free})
    model.output("loose", free**2)
    model.output("direct", q + a)
    with pytest.raises((DesignError, UnknownNameError), match=message):
        output_errors(model, at_rest(model), outputs)


def test_controls_must_enter_affinely():
    model = Model("bent")
    q = model.state("q")
    a, b = model.control("a"), model.control("b")
    model.ode({q: a + b**2})
    with pytest.raises(DesignError, match="control 'b' of model 'bent' does not enter its dynamics affinely"):
        Pair.of(model)


def test_zero_dynamics_are_what_the_output_does_not_see():
    """q + 3 v held at zero: v = -q / 3, so q' = -q / 3, and w gathers v: the eigenvalues are -1/3 and 0."""
    model = chain_model()
    errors = output_errors(model, at_rest(model), "sum")
    zeros = zero_dynamics(errors, 0.0, np.zeros(3), np.zeros(1))
    assert zeros.dimension == 2 and sorted(zeros.eigenvalues.real) == pytest.approx([-1 / 3, 0.0], abs=1e-12)
    assert zeros.growth == pytest.approx(0.0, abs=1e-12)
    all_seen = Model("seen")
    x = all_seen.state("x")
    all_seen.ode({x: all_seen.control("u")})
    none = zero_dynamics(output_errors(all_seen, at_rest(all_seen), "x"), 0.0, [0.0], [0.0])
    assert none.dimension == 0 and none.growth == -INF


def test_names_of_components():
    assert (
        _labels("a", 1) == ["a"]
        and _labels("a", 2) == ["a[0]", "a[1]"]
        and _output("a[1]") == "a" == _output("a")
    )
    errors = SimpleNamespace(labels=("a[0]", "a[1]", "b"))
    assert (
        given_for("a[1]", {"a": 1, "a[1]": 2}, errors, "it") == 2
        and given_for("a[0]", {"a": 1}, errors, "it") == 1
    )
    assert given_for("b", {"a": 1}, errors, "it") is None
    with pytest.raises(UnknownNameError, match="no output 'c'"):
        given_for("b", {"c": 1}, errors, "it")


def chains(degrees, labels=("a", "b")):
    return SimpleNamespace(degrees=degrees, labels=labels, size=len(degrees))


def test_places_and_chains_go_by_order_then_by_component():
    errors = chains((1, 3))
    assert _places(errors) == [(0, 0), (1, 0), (1, 1), (1, 2)]
    a, b = _chains(errors)
    assert a.tolist() == [[0] * 4, [0, 0, 1, 0], [0, 0, 0, 1], [0] * 4] and b.tolist() == [
        [1, 0],
        [0, 0],
        [0, 0],
        [0, 1],
    ]
    same = chains((2, 2))
    assert _places(same) == [(0, 0), (1, 0), (0, 1), (1, 1)]


def test_gains_of_chains_have_the_poles_that_are_asked_for():
    errors = chains((2, 2))
    gain = _gain(errors, [-1.0, -3.0], None, None, None)
    assert gain.tolist() == [[3, 0, 4, 0], [0, 3, 0, 4]]
    gain = _gain(errors, {"a": [-1.0, -2.0], "b": [-2 + 1j, -2 - 1j]}, None, None, None)
    assert gain == pytest.approx(np.array([[2, 0, 3, 0], [0, 5, 0, 4.0]]))
    assert _gain(errors, None, [[1.0, 2.0], 3.0], None, None).tolist() == [[1, 0, 3, 0], [0, 2, 0, 3]]
    a, b = _chains(errors)
    best = _gain(errors, None, None, 4.0, 1.0)
    assert best[:, [0, 2]][0] == pytest.approx([2.0, np.sqrt(4 + 4)])  # q^(1/2), (q + 2 q^(1/2))^(1/2)
    assert np.max(np.linalg.eigvals(a - b @ best).real) < 0


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ((None, None, None, None), "one choice of dynamics"),
        (([-1.0, -2.0], [1.0, 2.0], None, None), "one choice"),
        (([-1.0], None, None, None), "give 2 poles, not 1"),
        (([-1.0, 2.0], None, None, None), "would not decay"),
        (([-1.0 + 1j, -1.0], None, None, None), "not in conjugate pairs"),
        (({"a": [-1.0, -2.0]}, None, None, None), "output 'b' has no poles"),
        ((None, [1.0], None, None), "give 2 gains, not 1"),
        ((None, [0.0, 1.0], None, None), "would not decay"),
        ((None, None, 1.0, None), "needs both weights"),
        ((None, None, np.eye(3), 1.0), r"weight Q has the shape \(3, 3\)"),
        ((None, None, 1.0, -np.eye(2)), "R"),
    ],
)
def test_dynamics_that_are_none_are_refused(choice, message):
    with pytest.raises((ArgumentError, DesignError), match=message):
        _gain(chains((2, 2)), *choice)


def test_optimal_gains_take_numbers_or_matrices():
    a, b = np.zeros((1, 1)), np.ones((1, 1))
    assert _optimal_gain(a, b, 9.0, [[4.0]]) == pytest.approx(np.array([[1.5]]))
    assert _polynomial(chains((1,), ("a",)), "a", 1, [-3.0]).tolist() == [3.0]


def test_the_reserve_is_least_where_the_control_does_least():
    """A gain of 2 on the rate of v takes 2 / cos q: least is left at the end of a reference that turns to 1 rad."""
    turning = Reference.from_functions(crane(), lambda t: [t, 1.0], lambda t: [0.5], 0.0, 1.0)
    errors = output_errors(turning.model, turning, "v")
    limits = (np.array([-5.0]), np.array([5.0]))
    (fact,) = switching(ConstantRate(2.0), SIGN, limits=limits).reserve(errors, turning)
    assert fact.value == pytest.approx(4.5 - 2 / np.cos(1.0)) and "at t = 1 s" in fact.remark
    assert (
        switching(SuperTwisting(9.0, 2.0), SIGN, 0.1, limits=limits).reserve(errors, turning)[0].value == 4.5
    )
    assert switching(PowerRate(2.0, 0.5), SIGN, limits=limits).reserve(errors, turning) == []
    assert switching(ConstantRate(2.0), SIGN).reserve(errors, turning) == []


# --- integral surfaces --------------------------------------------------------------------------------------


def crane() -> Model:
    """The control acts by the cosine of the angle."""
    model = Model("crane")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a * ca.cos(q)})
    return model


@pytest.mark.parametrize(
    ("projection", "effect"), [("pseudo-inverse", lambda q: 1.0), ("transpose", lambda q: np.cos(q) ** 2)]
)
def test_a_matched_disturbance_enters_an_integral_surface(projection, effect):
    """As it is by the pseudo-inverse, by B'B with the transpose; all along a reference that moves."""
    moving = Reference.from_functions(crane(), lambda t: [t, 1.0], lambda t: [0.0], 0.0, 1.0, tail="none")
    pair = Pair.of(moving.model)
    errors, singular = _surface(pair, moving, projection)
    for t, value in zip(
        (0.0, 0.5, 1.0), pair.along(moving, np.array([0.0, 0.5, 1.0]), errors.decoupling), strict=True
    ):
        assert value == pytest.approx(np.array([[effect(t)]]))
    assert errors.degrees == (1,) and singular == pytest.approx([1.0])


def test_integral_surfaces_need_independent_controls_and_a_projection():
    model = Model("twins")
    x, y, u = model.state("x"), model.state("y"), model.control("u", 2)
    model.ode({x: u[0] + u[1], y: u[0] + u[1]})
    with pytest.raises(DesignError, match="act alike"):
        _surface(Pair.of(model), at_rest(model), "pseudo-inverse")
    with pytest.raises(DesignError, match="no projection 'pinv'"):
        _surface(Pair.of(crane()), at_rest(crane()), "pinv")


@pytest.mark.parametrize(
    ("gain", "ok"),
    [([[2.0, 3.0]], True), ([[0.0, 3.0]], False), ([[2.0, 0.0]], False), ([[2.0, 25.0]], False)],
)
def test_a_nominal_gain_must_hold_the_end_of_the_reference(gain, ok):
    """Poles -1 and -2; a pole at zero, an undamped pair, and one that steps of 0.1 s make unstable."""
    pair, rest = Pair.of(crane()), at_rest(crane())
    poles, radius = _poles(pair, rest, np.array(gain), 0.1)
    held_a, held_b = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]])
    assert radius == pytest.approx(np.max(np.abs(np.linalg.eigvals(held_a - held_b @ np.array(gain)))))
    assert np.sort_complex(poles) == pytest.approx(np.sort_complex(np.roots([1.0, gain[0][1], gain[0][0]])))
    if ok:
        inner, _, facts = _nominal(pair, rest, np.array(gain), 0.1)
        assert inner is None and [f.name for f in facts] == ["K", "nominal poles", "nominal spectral radius"]
        return
    with pytest.raises(DesignError, match="nominal gain is not stable"):
        _nominal(pair, rest, np.array(gain), 0.1)


# --- guards -----------------------------------------------------------------------------------------------


def test_inverses_are_exact_or_of_least_length():
    x = ca.SX.sym("x")
    square = ca.vertcat(ca.horzcat(x, 1), ca.horzcat(0, 2))
    wide = ca.horzcat(x, 2)
    for matrix, y in ((square, [3.0, 4.0]), (wide, [5.0])):
        f = ca.Function("f", [x], [_solve(matrix, ca.DM(y)), matrix])
        found, there = (np.array(v) for v in f(1.5))
        assert found.ravel() == pytest.approx(np.linalg.pinv(there) @ y)
    constant = _solve(ca.SX(ca.DM([[1.0, 2.0]])), ca.DM([5.0]))
    assert np.array(ca.evalf(ca.SX(constant))).ravel() == pytest.approx([1.0, 2.0])
    inverse = Inverse(wide, ca.SX(1), 1.0, 1.0)
    assert np.array(ca.Function("f", [x], [inverse(ca.DM([5.0]))])(1.0)).ravel() == pytest.approx([1.0, 2.0])
    assert Memory("m", ca.SX.sym("m", 3), 0, 0, "N").variable == Variable("m", 3, "N")
    both = StackedSchedule(lambda t, dt: t[None, :], lambda t, dt: dt * t[None, :])
    assert both(np.array([1.0, 2.0]), 0.5).tolist() == [[1, 2], [0.5, 1]]


# --- horizons ---------------------------------------------------------------------------------------------

RNG = np.random.default_rng(5)


def rows(change=None, states=(), errors=(), lower=(), upper=(), price=()):
    return Rows(
        np.array([-1.0, -2.0]),
        np.array([1.0, 4.0]),
        change,
        states,
        errors,
        np.array(lower),
        np.array(upper),
        np.array(price),
    )


def test_rows_of_a_step():
    assert rows().count == 2 and rows(np.ones(2)).count == 4
    limited = rows(None, (0, 1, 2), (0, 1, 2), (-1.0, -INF, 2.0), (3.0, 5.0, INF), (1.0, 1.0, 1.0))
    assert limited.count == 2 + 2 + 2 and limited.below == [0, 2] and limited.above == [0, 1]
    assert limited.state_scale.tolist() == [2.0, 5.0, 2.0]
    assert rows(None, (0, 1), (0, 1), (0.0, -INF), (INF, INF), (1.0, 1.0)).state_scale.tolist() == [1.0, 1.0]


def horizon(limited, count=2):
    """A horizon of three errors and two controls over dynamics that change."""
    sizes = ((3, 3), (3, 2), (2, 3), (2, 2))
    matrices = [[ca.DM(RNG.normal(size=size)) for _ in range(count)] for size in sizes]
    return Horizon(limited, matrices, np.array([0.5, 2.0, 3.0]))


def flown(found, e, u_ff, omega):
    """Return commands and errors by the recursion."""
    commands, errors = [], []
    for a, f, k, g, w, ff in zip(*found.matrices, omega.reshape(-1, 2), u_ff.reshape(-1, 2), strict=True):
        commands.append(ff - np.array(k) @ e + np.array(g) @ w)
        e = np.array(a) @ e + np.array(f) @ w
        errors.append(e)
    return np.concatenate(commands), np.concatenate(errors)


def test_rows_mean_what_they_say():
    """The recursion, controls, their changes and two limited states: each row is the excess over half its range."""
    limited = rows(np.array([0.5, 0.25]), (2, 0), (2, 0), (-3.0, -INF), (1.0, 2.0), (5.0, 0.0))
    found = horizon(limited)
    e_0, u_ff, x_ref = RNG.normal(size=3), RNG.normal(size=4), RNG.normal(size=4)
    previous = np.array([0.3, -0.2])
    task = found.programme(ca.DM(e_0), ca.DM(u_ff), ca.DM(x_ref), ca.DM(previous))
    omega, slack = RNG.normal(size=4), np.abs(RNG.normal(size=4))
    u, e = flown(found, e_0, u_ff, omega)
    y = np.concatenate([omega, e / np.tile(found.scale, 2), slack])
    a, low, high, g = (np.array(ca.DM(m)) for m in (task.a, task.low, task.high, task.g))
    above_low, below_high = a @ y - low.ravel(), high.ravel() - a @ y
    assert task.equal == found.equations == 6
    assert above_low[:6] == pytest.approx(np.zeros(6), abs=1e-12) == below_high[:6]
    assert np.abs((a @ (y + 0.1 * np.eye(y.size)[4]) - low.ravel())[:6]).max() > 0.05
    lower, upper = np.tile(limited.lower, 2), np.tile(limited.upper, 2)
    scale = 2 / (upper - lower)
    assert above_low[6:10] == pytest.approx((u - lower) * scale)
    assert below_high[6:10] == pytest.approx((upper - u) * scale)
    step, most = u - np.concatenate([previous, u[:2]]), np.tile(limited.change, 2)
    assert above_low[10:14] == pytest.approx((step + most) / most)
    assert below_high[10:14] == pytest.approx((most - step) / most)
    half, root = np.array([2.0, 2.0]), np.sqrt(np.array([5.0 * 4, 1e-6]))
    x = x_ref.reshape(2, 2) + e.reshape(2, 3)[:, [2, 0]]
    excess = slack.reshape(2, 2) / root
    below = (x[:, 0] + 3.0) / half[0] + excess[:, 0]
    above = ((np.array([1.0, 2.0]) - x) / half + excess).ravel()
    assert above_low[14:16] == pytest.approx(below) and np.all(np.isinf(high.ravel()[14:16]))
    assert below_high[16:] == pytest.approx(above) and np.all(np.isinf(low.ravel()[16:]))
    assert g.ravel() == pytest.approx([*np.zeros(10), *root, *root]) and task.free == found.free == 10
    assert np.array(ca.DM(task.h)) == pytest.approx(np.diag([1.0] * 4 + [0.0] * 6 + [1.0] * 4))
    assert a.shape == (20, found.unknowns) == (20, 14)
    rest = np.array(found.alone(ca.DM(e_0), ca.DM(u_ff), ca.DM(x_ref), ca.DM(previous))[0]).ravel()
    alone = flown(found, e_0, u_ff, np.zeros(4))[1]
    assert rest == pytest.approx([*np.zeros(4), *(alone / np.tile(found.scale, 2)), *np.zeros(4)])


def test_left_alone_the_regulator_meets_each_limit_just_where_it_is():
    """Controls, their changes and two limited states, each limit by itself, a little wider or closer than the worst."""
    wide = np.full(2, 1e3)
    limits = Rows(-wide, wide, wide, (2, 0), (2, 0), -wide, wide, np.ones(2))
    found = horizon(limits)
    e_0, u_ff, x_ref, previous = (RNG.normal(size=size) for size in (3, 4, 4, 2))
    u, e = (part.reshape(2, -1) for part in flown(found, e_0, u_ff, np.zeros(4)))
    x, change = x_ref.reshape(2, 2) + e[:, [2, 0]], np.abs(np.diff(np.vstack([previous, u]), axis=0))
    worst = {
        "lower": u.min(axis=0), "upper": u.max(axis=0), "change": change.max(axis=0),
        "state_lower": x.min(axis=0), "state_upper": x.max(axis=0),
    }  # fmt: skip
    for name, values in worst.items():
        for i in range(2):
            for off in (1e-9, -1e-9):
                limit = getattr(limits, name).copy()
                limit[i] = values[i] + (-off if name.endswith("lower") else off)
                here = replace(found, rows=replace(limits, **{name: limit}))
                asked = (ca.DM(values) for values in (e_0, u_ff, x_ref, previous))
                assert bool(here.alone(*asked)[1]) is (off > 0), (name, i)


def test_operations_of_a_programme_by_hand():
    """One control over two errors and one step: a sweep, there and back, is 2 * 3^2 products and 6 for 1 + 3 rows."""
    limits = Rows(np.full(1, -1.0), np.ones(1), None, (), (), np.zeros(0), np.zeros(0), np.zeros(0))
    code = ProgrammeCode(limits, np.zeros(0), (np.zeros((1, 2, 2)),) * 4, True, 1, 2)
    assert code.unknowns == code.limits == 1
    sweep, tries = 2 * 3**2 + 6 * 4, programme_code._ITERATIONS_PER_UNKNOWN * 2
    row = 2 * sweep + 4
    assert code.operations == tries * (2 * sweep + 6 + 2 * 9 + row + 12) + 2 * 3
    assert code.stack == (3 + 5 * 2 + 1) + 4 + 6 * 2 + 4 + 3


def test_steps_have_their_number_in_the_table():
    """From 0 to the step in which the reference ends; times are what a clock tells, with its rounding."""
    row = _Numbered(lambda times, dt: np.zeros((1, times.size)), (1.0, 2.0))
    times = np.array([0.0, 1.0, 1.25 - 1e-9, 1.25, 1.49, 1.75, 2.0, 9.0])
    assert row(times, 0.25)[1].tolist() == [0, 0, 1, 1, 1, 3, 4, 4]
    assert row(np.array([1.9, 2.0, 3.0]), 0.3)[1].tolist() == [3, 3, 4]
    for span in (1.0 - 1e-12, 1.0 + 1e-12):
        assert _Numbered(row.reference, (0.0, span))(np.array([7.0]), 0.1)[1].tolist() == [10]


def test_hard_limits_have_no_slack_and_one_step_is_a_horizon():
    limited = rows(None, (2, 0), (2, 0), (-3.0, -INF), (1.0, 2.0), (INF, 1.0))
    assert limited.soft == [1] and horizon(limited).unknowns == 10 + 2
    task = horizon(limited).programme(ca.DM.zeros(3), ca.DM.zeros(4), ca.DM.zeros(4), ca.DM.zeros(2))
    slacks = np.array(ca.DM(task.a))[10:, 10:]  # below: 2 steps of the first; above: both, step by step
    assert np.abs(slacks[:2]).max() == 0 and np.abs(slacks[[2, 4]]).max() == 0
    assert slacks[3, 0] < 0 and slacks[5, 1] < 0 and np.count_nonzero(slacks) == 2
    one = horizon(rows(np.ones(2)), 1)
    task = one.programme(ca.DM.zeros(3), ca.DM.zeros(2), ca.DM(0, 1), ca.DM.zeros(2))
    assert task.a.shape == (3 + 4, 5) and np.array(ca.DM(task.g)).ravel().tolist() == [0.0] * 5


def test_a_solution_has_no_residual_and_anything_else_has_one():
    """min |omega|^2 / 2 within omega_1 + omega_2 >= 1: omega = 1/2, multiplier -1/2 at the lower limit."""

    def task_of(g, a, low, high, equal=0, free=2):
        size = len(g)
        return Programme(ca.DM.eye(size), ca.DM(g), ca.DM(a), ca.DM(low), ca.DM(high), equal, free)

    task = task_of([0.0] * 3, [[1.0, 1.0, 0.0]], [1.0], [INF])
    right = (ca.DM([0.5, 0.5, 0.0]), ca.DM([-0.5]), ca.DM([0.0, 0.0, 0.0]))

    def residual(omega=right[0], lam_a=right[1], lam_x=right[2], task=task):
        return float(task.optimality_residual(omega, lam_a, lam_x))

    assert residual() == 0.0
    assert residual(omega=ca.DM([0.6, 0.6, 0.0])) == pytest.approx(0.1 + 0.2 * 0.5)
    assert residual(omega=ca.DM([0.4, 0.4, 0.0])) == pytest.approx(0.1 + 0.2 + 0.2 * 0.5)
    assert residual(lam_a=ca.DM([0.5])) > 1.0
    assert residual(omega=ca.DM([0.5, 0.5, -0.1])) == pytest.approx(0.1 + 0.1)
    assert residual(lam_x=ca.DM([0.0, 0.0, 0.2])) == pytest.approx(0.2 + 0.2)
    priced = task_of([0.0, 0.0, 4.0], [[1.0, 1.0, 0.0]], [1.0], [INF])
    assert residual(lam_x=ca.DM([0.0, 0.0, -4.0]), task=priced) == 0.0
    assert residual(lam_x=ca.DM([0.0, 0.0, -2.0]), task=priced) == pytest.approx(2 / 4)
    assert not residual(omega=ca.DM([np.nan, 0.5, 0.0])) < 1.0
    hard = task_of([0.0] * 2, [[1.0, 1.0]], [-9.0], [-1.0])
    assert float(hard.optimality_residual(ca.DM([-0.5, -0.5]), ca.DM([0.5]), ca.DM([0.0, 0.0]))) == 0.0
    # an equation, omega_1 + omega_2 = 4, beside a limit that is far: relative to its right side
    equation = task_of([0.0] * 2, [[1.0, 1.0], [1.0, 0.0]], [4.0, -INF], [4.0, 9.0], equal=1)
    exact = (ca.DM([-2.0, 0.0]), ca.DM([0.0, 0.0]))
    assert float(equation.optimality_residual(ca.DM([2.0, 2.0]), *exact)) == 0.0
    off = float(equation.optimality_residual(ca.DM([2.1, 2.1]), ca.DM([-2.1, 0.0]), ca.DM([0.0, 0.0])))
    assert off == pytest.approx(0.2 / 4)


@pytest.mark.parametrize(("horizon", "dt", "count"), [(1.0, 0.1, 10), (0.1, 0.1, 1), (0.3, 0.1, 3)])
def test_whole_steps_of_a_horizon(horizon, dt, count):
    assert _steps(horizon, dt) == count


@pytest.mark.parametrize(("horizon", "dt"), [(0.04, 0.1), (0.25, 0.1), (0.1001, 0.1)])
def test_horizons_of_parts_of_steps_are_refused(horizon, dt):
    with pytest.raises(ArgumentError, match="no whole number of steps"):
        _steps(horizon, dt)


def test_rates_per_step():
    model = chain_model()
    assert _rates(2.0, model, 0.1) == pytest.approx([0.2])
    for wrong in (0.0, -1.0, np.nan):
        with pytest.raises(DesignError, match="rate limit of control 'a'"):
            _rates(wrong, model, 0.1)


def test_only_states_whose_error_is_a_difference_can_be_limited():
    from gnc_opt.spacecraft import mrp_difference

    model = Model("turner")
    sigma, w = model.state("sigma", 3), model.state("w", 3)
    u = model.control("u", 3)
    model.ode({sigma: w, w: u})
    model.difference(sigma, mrp_difference)
    deviation = ErrorDynamics(model)
    assert _subtracts(deviation, "w") and not _subtracts(deviation, "sigma")
    price = np.arange(6.0)
    in_x, in_e, lower, upper, prices = _state_rows(deviation, {"w": (-1.0, [1.0, 2.0, INF])}, (), price)
    assert in_x == (3, 4, 5) == in_e and lower.tolist() == [-1] * 3 and upper.tolist() == [1, 2, INF]
    assert prices.tolist() == [3, 4, 5] and _state_rows(deviation, {}, (), price)[0] == ()
    for limits, message in (
        ({"sigma": (-1, 1)}, "not a difference"),
        ({"w": (1, 1)}, "no room"),
        ({"w": ([1.0] * 2, 2)}, "limits of state 'w'"),
    ):
        with pytest.raises((DesignError, ArgumentError), match=message):
            _state_rows(deviation, limits, (), price)


def scalar_step(a):
    return SampledStep(*(np.array([[v]]) for v in (a, 0.5, 1.0, 2.0, 0.1)))


def test_windows_of_a_horizon_are_the_recursion_from_its_end():
    """By hand for one state; the last step goes on for ever, and so does the last cost."""
    steps = tuple(scalar_step(a) for a in (1.0, 1.1, 1.2))
    costs = tuple(np.array([[p]]) for p in (7.0, 6.0, 5.0))
    gains = SampledGains(0.0, 0.1, steps, (np.zeros((1, 1)),) * 2, costs, np.zeros((1, 1)), None)

    def by_hand(first, p):
        found = []
        for k in reversed(range(first, first + 2)):
            a = (1.0, 1.1, 1.2)[min(k, 2)]
            s = 2.0 + 0.25 * p
            gain = (0.5 * p * a + 0.1) / s
            p = 1.0 + a * a * p - gain**2 * s
            found.append((a - 0.5 * gain, 0.5 / np.sqrt(s), gain, 1 / np.sqrt(s)))
        return np.array(found[::-1]).T

    for first, p in ((0, 5.0), (1, 5.0), (5, 5.0)):
        assert np.array(_Windows(gains, 2, None)(first)).reshape(4, 2) == pytest.approx(by_hand(first, p))
    one = np.array(_Windows(gains, 1, None)(0)).ravel()
    assert one[3] == pytest.approx(1 / np.sqrt(2 + 0.25 * 6.0))
    ended = _Windows(gains, 2, np.array([[9.0]]))
    assert np.array(ended(0)).reshape(4, 2) == pytest.approx(by_hand(0, 9.0))
    assert not ended.constant
    assert _Windows(
        SampledGains(0.0, 0.1, (scalar_step(1.0),) * 2, (), costs, np.zeros((1, 1)), None), 2, None
    ).constant


# --- C texts ----------------------------------------------------------------------------------------------


def test_constants_and_texts_of_c():
    assert [DOUBLE(v) for v in (np.nan, INF, -INF, 0.1, -2)] == [
        "NAN",
        "INFINITY",
        "-INFINITY",
        "0.1",
        "-2.0",
    ]
    assert (
        _identifier("My law 2 (x)") == "my_law_2__x"
        and _identifier("2nd") == "law_2nd"
        and _identifier("ä!") == "law_"
    )
    assert _plain("a /* b */ ä") == "a / * b * / ?" and DOUBLE.entry(0.1) == "0.1"
    assert wrapped(["1"] * 3) == "1, 1, 1" and wrapped(["1"] * 40).count("\n") >= 1
    assert _entries(Layout("s", (Variable("r", 2, "m"), Variable("n")))) == [
        "[0] r[0], m",
        "[1] r[1], m",
        "[2] n, -",
    ]
    for act in (
        lambda: DOUBLE.entry(INF),
        lambda: _read_prefix("math"),
        lambda: _read_prefix("Math"),
        lambda: _read_prefix("a b"),
    ):
        with pytest.raises(ArgumentError):
            act()
    assert _read_prefix("law") == "law"


def scheduled(rows, signals=1, span=(0.0, 1.0)):
    return SimpleNamespace(name="c", signals=SimpleNamespace(size=signals), span=span, schedule=rows)


def test_the_rows_of_a_schedule_in_c():
    """From the beginning of the span in steps to its end, and the row that is good from there on."""

    def table(law, dt, span=None):
        return flight_table(law, dt, span)

    found = table(scheduled(lambda t, dt: np.minimum(t, 1.0)[None, :], span=(0.5, 1.0)), 0.2)
    assert found.first == 0.5 and found.rows.ravel() == pytest.approx([0.5, 0.7, 0.9, 1.0])
    found = table(scheduled(lambda t, dt: np.minimum(t, 1.0)[None, :]), 0.25)
    assert found.rows.ravel() == pytest.approx([0, 0.25, 0.5, 0.75, 1])
    assert table(scheduled(None, 0), 0.1).rows.shape == (1, 0)
    assert table(scheduled(lambda t, dt: 0 * t[None, :], span=None), 0.1, (2.0, 2.0)).rows.shape == (1, 1)
    for wrong, span, message in (
        (scheduled(lambda t, dt: t[None, :]), None, "still changes by"),
        (scheduled(lambda t, dt: 0 * t[None, :], span=None), None, "does not tell"),
        (scheduled(lambda t, dt: 0 * t[None, :]), (1.0, 0.0), "t_0 <= t_f"),
        (scheduled(lambda t, dt: 0 * t[None, :]), (0.0, INF), "finite"),
    ):
        with pytest.raises(ArgumentError, match=message):
            table(wrong, 0.1, span)


def test_the_header_tells_what_the_arrays_hold(tmp_path):
    """Sizes, the step, the first row, names with units, and the alarms if there are any."""
    t, x, r, z = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("r", 1), ca.SX.sym("z", 1)
    fields = {
        "name": "by hand",
        "step": law(t, x, r, z, x[0] + r, z),
        "start": initial_state_function(t, x, r, 0 * r),
        "states": Layout("state", (Variable("x", 2, "m"),)),
        "commands": Layout("command", (Variable("u", 1, "N"),)),
        "signals": Layout("signal", (Variable("s"),)),
        "memory": Layout("memory", (Variable("z"),)),
        "schedule": lambda times, dt: np.minimum(times, 2.0)[None, :],
        "explanation": DesignReport("by hand"),
        "dt": 0.5,
        "span": (1.0, 2.0),
    }
    for alarms in ((), ("z",)):
        code = export_c(Controller(**fields, alarms=alarms), tmp_path)
        text = code.header.read_text()
        assert (code.name, code.rows, code.dt) == ("by_hand", 3, 0.5)
        for line in (
            "BY_HAND_N_STATES 2",
            "BY_HAND_N_COMMANDS 1",
            "BY_HAND_N_SIGNALS 1",
            "BY_HAND_N_MEMORY 1",
            "BY_HAND_N_ROWS 3",
            "BY_HAND_DT 0.5",
            "BY_HAND_T0 1.0",
            "[1] x[1], m",
            "[0] u, N",
            "[0] s, -",
        ):
            assert line in text
        assert ("alarms" in text) is bool(
            alarms
        ) and "static const double schedule" in code.source.read_text()
    bare = {
        **fields,
        "signals": Layout("signal", ()),
        "schedule": lambda times, dt: np.zeros((0, times.size)),
    }
    nothing = ca.SX.sym("r", 0)
    bare |= {"step": law(t, x, nothing, z, x[0], z), "start": initial_state_function(t, x, nothing, ca.SX(0))}
    assert "schedule[" not in export_c(Controller(**bare), tmp_path, name="bare").source.read_text()


def test_errors_of_a_window_are_measured_in_what_costs_one():
    """Errors that cost nothing, or less, in their own units."""
    gains = SimpleNamespace(costs=[np.eye(3), np.diag([4.0, 0.0, 25.0])])
    assert _error_scale(SimpleNamespace(gains=gains)) == pytest.approx([0.5, 1.0, 0.2])


def test_a_law_that_switches_at_once_has_no_alarm_of_a_strong_disturbance():
    """Without a layer and in continuous time nothing tells how far s may stray; a step of 0.1 s does."""
    s = ca.SX.sym("s")
    assert switching(ConstantRate(3.0), SIGN, dt=None).watch(s) == []
    (away, *_) = switching(ConstantRate(3.0), SIGN, dt=0.1).watch(s)
    outside = ca.substitute(away.after, away.symbol, 0.0)
    found = [float(ca.DM(ca.evalf(ca.substitute(outside, s, v)))) for v in (0.59, 0.61, -0.59, -0.61)]
    assert found == [0.0, 1.0, 0.0, 1.0]


def test_a_memory_of_another_size_is_refused() -> None:
    """CasADi would take one number for all of it."""
    cart = crane()
    regulator = design_lqr(cart, [0.0, 0.0], Q=1, R=1, dt=0.1)
    with pytest.raises(ArgumentError, match="memory given to 'LQR' has 1 entries, not"):
        regulator(0.0, [1.0, 0.0], [1.0])
