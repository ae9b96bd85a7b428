"""What designs are made of, by hand: poles, samples, schedules, limits, references, weights, Riccati equations."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import minimize_scalar

from gnc_opt.control import (
    Controller,
    DesignReport,
    ErrorDynamics,
    Reference,
    ReportEntry,
    bryson,
    feedforward,
    initial_state_function,
    law,
    riccati,
    trim,
)
from gnc_opt.control.control_limits import clip, read_limits, require_reserve, reserve_shares, saturated
from gnc_opt.control.design_report import number_text
from gnc_opt.control.error_dynamics import evaluate_columns
from gnc_opt.control.feedforward import ReferenceSchedule, reference_signals, reference_times
from gnc_opt.control.loop_margins import _frequencies, _met, margins
from gnc_opt.control.quadratic_cost import QuadraticCost, read_cost, read_weight
from gnc_opt.control.riccati import (
    gain_of,
    require_detectable,
    require_stabilizable,
    residual,
    steady,
    unreached,
)
from gnc_opt.control.sampled_data import (
    continuous_poles,
    real_polynomial,
    sample,
    sample_along,
    spectral_radius,
    zero_order_hold,
)
from gnc_opt.control.tvlqr_gains import (
    LinearizationTable,
    SampledGains,
    cost_defect,
    resting_control,
    riccati_defect,
    riccati_gains,
)
from gnc_opt.errors import ArgumentError, DesignError, UnknownNameError
from gnc_opt.model import Layout, Model, Variable

NAN, INF = np.nan, np.inf


def cart(drag: float = 0.0) -> Model:
    model = Model("cart")
    q, v = model.state("q", unit="m"), model.state("v", unit="m/s")
    a, c = model.control("a", unit="N"), model.parameter("c", drag)
    model.ode({q: v, v: a - c * v})
    return model


def ramp(jumps=(), tail="hold"):
    """q = t^2, v = 2 t, a = 2, then at rest in name only; from 1 s to 3 s."""
    return Reference.from_functions(
        cart(), lambda t: [t**2, 2 * t], lambda t: [2.0 + 3.0 * (t >= 2.0)], 1.0, 3.0, jumps=jumps, tail=tail
    )


# --- poles ------------------------------------------------------------------------------------------------


def test_polynomials_of_poles():
    assert real_polynomial([-1.0, -2.0]) == pytest.approx([1, 3, 2])
    assert real_polynomial([-1 + 2j, -1 - 2j]) == pytest.approx([1, 2, 5])
    assert real_polynomial([]) == pytest.approx([1.0]) and real_polynomial([3.0]).dtype == float
    assert real_polynomial([-1 + 2j]) is None and real_polynomial([-1 + 2j, -1 - 2.001j]) is None
    assert real_polynomial([-1 + 2j, -1 - 2j * (1 + 1e-12)]) is not None
    poles = np.array([-1 + 2j, -3.0])
    assert continuous_poles(poles, None) is poles
    assert continuous_poles(np.exp(0.1 * poles), 0.1) == pytest.approx(poles)
    assert np.isfinite(continuous_poles(np.array([-0.5]), 0.1)).all()


# --- samples ----------------------------------------------------------------------------------------------

A, B = np.array([[0.0, 1.0], [-2.0, -0.3]]), np.array([[0.5], [1.0]])
Q, R, N = np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([[0.7]]), np.array([[0.2], [-0.1]])


def by_quadrature(a, b, q, r, n, dt):
    """The step and its cost from the flow of (e, v)."""
    size, m = b.shape
    flow = np.block([[a, b], [np.zeros((m, size + m))]])
    weight = np.block([[q, n], [n.T, r]])

    def part(i, j):
        return quad(lambda t: (expm(flow * t).T @ weight @ expm(flow * t))[i, j], 0.0, dt, epsabs=1e-13)[0]

    cost = np.array([[part(i, j) for j in range(size + m)] for i in range(size + m)])
    return expm(flow * dt), cost


@pytest.mark.parametrize("dt", [0.1, 2.0, 9.0])
def test_a_sampled_step_is_exact_however_long(dt):
    step = sample(A, B, Q, R, N, dt)
    phi, cost = by_quadrature(A, B, Q, R, N, dt)
    assert step.a == pytest.approx(phi[:2, :2], abs=1e-10) and step.b == pytest.approx(phi[:2, 2:], abs=1e-10)
    assert step.q == pytest.approx(cost[:2, :2], rel=1e-9) and step.r == pytest.approx(cost[2:, 2:], rel=1e-9)
    assert step.n == pytest.approx(cost[:2, 2:], rel=1e-9, abs=1e-9)
    held = zero_order_hold(A, B, dt)
    assert held[0] == pytest.approx(step.a, abs=1e-10) and held[1] == pytest.approx(step.b, abs=1e-10)


def test_constant_dynamics_sampled_along_a_reference_are_those_sampled_at_once():
    once, along = (
        sample(A, B, Q, R, N, 0.2),
        sample_along(lambda t: (A, B), Q, R, N, 3.0, 0.2, np.array([3.05])),
    )
    for name in ("a", "b", "q", "r", "n"):
        assert getattr(along, name) == pytest.approx(getattr(once, name), abs=1e-8)


@pytest.mark.parametrize("jumps", [[], [0.1], [0.07, 0.19], [-0.1, 0.1, 0.5], [0.0, 0.3]])
def test_a_step_over_dynamics_that_change_and_jump(jumps):
    """The flow of (e, v) integrated by SciPy from jump to jump, and its cost."""
    dt = 0.3

    def linearize(t):
        return A * (1 + np.sin(t) + sum(t > j for j in jumps)), B * np.cos(t)

    weight = np.block([[Q, N], [N.T, R]])

    def rate(t, y):
        a, b = linearize(t)
        phi = y[:9].reshape(3, 3)
        flow = np.vstack([np.hstack([a, b]), np.zeros((1, 3))])
        return np.concatenate([(flow @ phi).ravel(), (phi.T @ weight @ phi).ravel()])

    y, edges = np.concatenate([np.eye(3).ravel(), np.zeros(9)]), [0.0, *[j for j in jumps if 0 < j < dt], dt]
    for left, right in itertools.pairwise(edges):
        y = solve_ivp(rate, (left + 1e-12, right - 1e-12), y, rtol=1e-11, atol=1e-13, method="DOP853").y[
            :, -1
        ]
    phi, cost = y[:9].reshape(3, 3), y[9:].reshape(3, 3)
    step = sample_along(linearize, Q, R, N, 0.0, dt, np.array(jumps))
    assert step.a == pytest.approx(phi[:2, :2], abs=1e-5) and step.b == pytest.approx(phi[:2, 2:], abs=1e-5)
    assert step.q == pytest.approx(cost[:2, :2], abs=1e-5) and step.n == pytest.approx(cost[:2, 2:], abs=1e-5)
    assert step.r == pytest.approx(cost[2:, 2:], abs=1e-5)


def test_spectral_radius_is_the_largest_magnitude():
    assert spectral_radius(np.array([[0.5, 9.0], [0.0, -0.8]])) == pytest.approx(0.8)
    assert spectral_radius(np.array([[0.0, 1.0], [-0.25, 0.0]])) == pytest.approx(0.5)


# --- schedules --------------------------------------------------------------------------------------------


def test_signals_of_a_schedule_have_names_and_units():
    layout = reference_signals(ramp(), Variable("K", 2))
    assert [(v.name, v.size, v.unit) for v in layout.variables] == [
        ("q_ref", 1, "m"), ("v_ref", 1, "m/s"), ("a_ff", 1, "N"), ("K", 2, "")
    ]  # fmt: skip
    rows = ReferenceSchedule(ramp(jumps=[2.0]))(np.array([1.0, 1.9]), 0.2)
    assert rows == pytest.approx(np.array([[1.0, 3.61], [2.0, 3.8], [2.0, 0.5 * 2 + 0.5 * 5]]))


def test_a_design_looks_at_ends_jumps_and_both_sides_of_them():
    times = reference_times(ramp(jumps=[2.0]), 5)
    assert times == pytest.approx([1, 1 + 2e-9, 1.5, 2 - 2e-9, 2, 2 + 2e-9, 2.5, 3 - 2e-9, 3], abs=1e-12)
    assert np.all(np.diff(times) > 0) and times[0] == 1.0 and times[-1] == 3.0
    assert reference_times(Reference.constant(cart(), [1.0, 0.0])).tolist() == [0.0]
    assert reference_times(ramp()).size >= 101


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.1 + 0j, "0.1"),
        (0.1 + 1e-17j, "0.1"),
        (1 + 2j, "1+2j"),
        (np.array([-1 + 0j, -2 + 0j]), "[-1., -2.]"),
        (np.array([-1 + 2j, -1 - 2j]), "[-1.+2.j, -1.-2.j]"),
        (1e-20j, "0+1e-20j"),
    ],
)
def test_eigenvalues_are_told_as_real_where_they_are(value, text):
    """NumPy returns them as complex numbers or as real ones, one version so and another so."""
    assert number_text(value) == text


def test_feedforward_commands_the_mean_and_nothing_else():
    open_loop = feedforward(ramp(jumps=[2.0]))
    u, z = open_loop(1.9, [7.0, 8.0], dt=0.2)
    assert u == pytest.approx([3.5]) and z.size == 0
    assert open_loop.span == (1.0, 3.0) and open_loop.dt is None and open_loop.name == "feedforward"
    assert open_loop.explain()["feedback"] == "none"
    with pytest.raises(ArgumentError, match="what feedforward"):
        feedforward(cart())


# --- controllers ------------------------------------------------------------------------------------------


def controller(dt=0.5, **changes):
    t, x, r, z = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("r", 1), ca.SX.sym("z", 1)
    fields = {
        "name": "by hand", "step": law(t, x, r, z, x[0] + 10 * r + 100 * z + 1000 * t, z + x[1]),
        "start": initial_state_function(t, x, r, x[1] + r + t), "states": Layout("state", (Variable("x", 2),)),
        "commands": Layout("command", (Variable("u"),)), "signals": Layout("signal", (Variable("s"),)),
        "memory": Layout("memory", (Variable("z"),)), "schedule": lambda times, dt: times[None, :] * dt,
        "explanation": DesignReport("by hand", (ReportEntry("k", 2.0),)), "dt": dt,
    }  # fmt: skip
    return Controller(**(fields | changes))


def test_a_step_of_a_controller():
    one = controller()
    u, z = one(2.0, [3.0, 4.0], [5.0])
    assert u == pytest.approx([3 + 10 * 1.0 + 500 + 2000]) and z.tolist() == [9.0]
    first, z = one(2.0, [3.0, 4.0])
    assert first == pytest.approx([3 + 10 + 100 * 7 + 2000]) and z.tolist() == [11.0]
    assert one.initial_memory(2.0, [3.0, 4.0]).tolist() == [7.0] and one.signal(2.0).tolist() == [1.0]
    assert controller(None).signal(2.0, 0.25).tolist() == [0.5] and one.explain()["k"] == 2.0
    for act in (lambda: one(2.0, [1.0] * 3), lambda: one.initial_memory(2.0, [1.0] * 3)):
        with pytest.raises(ArgumentError, match="the state given to 'by hand'"):
            act()


def test_the_length_of_a_step():
    assert controller().step_length() == 0.5 and controller().step_length(0.5 * (1 + 1e-12)) == pytest.approx(
        0.5
    )
    assert controller(None).step_length(0.3) == 0.3
    for dt, given, message in (
        (None, None, "give dt"),
        (0.5, 0.6, r"0\.5 s, not 0\.6 s"),
        (0.5, -0.5, "control step of"),
    ):
        with pytest.raises(ArgumentError, match=message):
            controller(dt).step_length(given)


@pytest.mark.parametrize(
    "changes",
    [{"states": Layout("state", (Variable("x", 3),))}, {"commands": Layout("command", (Variable("u", 2),))},
     {"signals": Layout("signal", ())}, {"memory": Layout("memory", (Variable("z", 2),))}],
)  # fmt: skip
def test_a_law_has_the_sizes_of_its_layouts(changes):
    with pytest.raises(ArgumentError, match="its layouts ask for"):
        controller(**changes)


def test_alarms_are_entries_of_the_memory():
    assert controller(alarms=("z",)).alarms == ("z",)
    with pytest.raises(UnknownNameError):
        controller(alarms=("zz",))


def test_explanations_are_read_by_name_and_printed():
    facts = (
        ReportEntry("gain", np.array([1.0, 2.5]), "N", "why"),
        ReportEntry("pole", -1.25),
        ReportEntry("law", "LQR", remark="best"),
    )
    explanation = DesignReport("title", facts)
    assert [str(f) for f in explanation] == ["gain: [1. , 2.5] N (why)", "pole: -1.25", "law: LQR (best)"]
    assert (
        str(ReportEntry("third", np.array([1 / 3]))) == "third: [0.333333]"
        and str(ReportEntry("third", 1 / 3)) == "third: 0.333333"
    )
    assert (
        str(ReportEntry("two", 2.0)) == "two: 2" and str(ReportEntry("small", 1e-9, "s")) == "small: 1e-09 s"
    )
    lines = str(explanation).splitlines()
    assert lines[0] == "title" and lines[1].split() == ["quantity", "value", "unit", "remark"]
    assert [line[: lines[1].index("value")].strip() for line in lines[2:]] == [f.name for f in facts]
    assert explanation["pole"] == -1.25
    with pytest.raises(UnknownNameError, match="no fact 'pale': did you mean 'pole'"):
        explanation["pale"]


# --- deviations -------------------------------------------------------------------------------------------


def pendulum() -> Model:
    model = Model("pendulum")
    q, w = model.state("q"), model.state("w")
    u, g = model.control("u"), model.parameter("g", 4.0)
    model.ode({q: w, w: -g * ca.sin(q) + u * ca.cos(q)})
    model.output("height", g * ca.cos(q) + model.time)
    model.output("power", u * w)
    return model


def test_deviations_are_linearised_about_the_reference():
    """d/dq of -4 sin q + u cos q is -4 cos q - u sin q, at u of the reference."""
    deviation, x, u = ErrorDynamics(pendulum()), np.array([0.3, 0.5]), np.array([2.0])
    a, b = deviation.linearize(1.0, x, u)
    assert a == pytest.approx(np.array([[0, 1], [-4 * np.cos(0.3) - 2 * np.sin(0.3), 0]]))
    assert b == pytest.approx(np.array([[0], [np.cos(0.3)]]))
    states, controls = np.array([[0.3, 0.1, -1.0], [0.5, 0.0, 2.0]]), np.array([[2.0, 0.0, 1.0]])
    many = deviation.linearize_many(np.array([1.0, 2.0, 3.0]), states, controls)
    for k in range(3):
        each = deviation.linearize(1.0 + k, states[:, k], controls[:, k])
        assert many[0][k] == pytest.approx(each[0]) and many[1][k] == pytest.approx(each[1])
    assert deviation([1.0, 2.0], [0.25, 0.5]).tolist() == [0.75, 1.5]
    assert deviation(states, np.zeros((2, 3))).tolist() == states.tolist()


def test_outputs_of_states_alone_are_linearised():
    deviation = ErrorDynamics(pendulum())
    assert deviation.linearize_output("height", 1.0, [0.3, 0.5], [2.0]) == pytest.approx(
        np.array([[-4 * np.sin(0.3), 0]])
    )
    value = deviation.output("height", ca.SX(2.0), ca.SX(ca.DM([0.3, 0.0])))
    assert float(ca.evalf(value)) == pytest.approx(4 * np.cos(0.3) + 2)
    with pytest.raises(DesignError, match="output 'power' of model 'pendulum' depends on a control"):
        deviation.output("power", ca.SX(0.0), ca.SX(ca.DM([0.3, 0.0])))


def test_columns_are_evaluated_one_by_one():
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y", 2)
    function = ca.Function("f", [x, y], [x + 10 * y])
    assert evaluate_columns(function, [1.0, 2.0], [3.0, 4.0]).tolist() == [31, 42]
    assert evaluate_columns(function, [1.0, 2.0], [[3.0], [4.0]]).tolist() == [[31], [42]]


# --- limits -----------------------------------------------------------------------------------------------


def test_limits_are_read_for_every_control():
    model = cart()
    assert read_limits(model, None) is None
    lower, upper = read_limits(model, (-1, [2.0]))
    assert (lower.tolist(), upper.tolist()) == ([-1], [2])
    for limits, error, message in (
        ((1.0, 1.0), DesignError, "'a' has no authority"), ((NAN, 1.0), DesignError, "no authority"),
        ([-1.0, 1.0], ArgumentError, r"give \(lower, upper\)"), ((1.0,), ArgumentError, r"give \(lower, upper\)"),
        (([-1.0, -1.0], 1.0), ArgumentError, "the lower limits"),
        ((-1.0, [1.0, 1.0]), ArgumentError, "the upper limits"),
    ):  # fmt: skip
        with pytest.raises(error, match=message):
            read_limits(model, limits)
    assert [float(clip(v, -1.0, 2.0)) for v in (-3.0, 0.5, 3.0)] == [-1, 0.5, 2]
    assert saturated(5.0, None) == 5.0 and float(saturated(ca.DM(5.0), (-1.0, 2.0))) == 2.0


def test_what_a_reference_leaves_of_its_limits():
    """Between -10 and 10 N the control of 2 N and then 5 N leaves 5 N of 10: one half of it."""
    limits = (np.array([-10.0]), np.array([10.0]))
    (share,) = reserve_shares(ramp(jumps=[2.0]), limits)
    assert share.value == pytest.approx([0.5]) and reserve_shares(ramp(), None) == []
    (share,) = reserve_shares(ramp(jumps=[2.0]), (np.array([1.0]), np.array([21.0])))
    assert share.value == pytest.approx([0.1])
    resting = Reference.from_functions(cart(), lambda t: [1.0, 0.0], lambda t: [1.0], 0.0, 1.0, tail="trim")
    assert reserve_shares(resting, (np.array([-5.0]), np.array([5.0])))[0].value == pytest.approx([0.8])


def test_the_least_reserve_has_its_time_and_place():
    limits, times = (np.array([-10.0]), np.array([10.0])), np.array([1.0, 1.9, 2.5])
    (fact,) = require_reserve(ramp(jumps=[2.0]), limits, times)
    assert fact.value == pytest.approx(5.0) and "control 'a' at t = 2.5 s" in fact.remark and fact.unit == "N"
    (held,) = require_reserve(ramp(jumps=[2.0]), limits, times[:2], dt=0.2)
    assert held.value == pytest.approx(6.5)
    (gained,) = require_reserve(ramp(jumps=[2.0]), limits, times, gain=np.array([[4.0, 1.0, 1.0]]))
    assert gained.value == pytest.approx(4.0) and "feedforward and gain" in gained.remark
    (rest,) = require_reserve(Reference.constant(cart(), [1.0, 0.0]), limits, np.array([0.0]), dt=0.2)
    assert rest.value == pytest.approx(10.0)
    assert require_reserve(ramp(), None, times) == []
    tight = (np.array([-10.0]), np.array([4.0]))
    with pytest.raises(
        DesignError, match=r"reference is beyond the authority: control 'a' needs 5 at t = 2\.5 s"
    ):
        require_reserve(ramp(jumps=[2.0]), tight, times)
    with pytest.raises(
        DesignError, match=r"the switching gain .* needs 9 besides its feedforward 2 at t = 1 s"
    ):
        require_reserve(ramp(jumps=[2.0]), limits, times, gain=np.array([[9.0, 0.0, 0.0]]))


# --- references -------------------------------------------------------------------------------------------


def test_a_reference_is_followed_within_and_rests_after_its_end():
    reference = ramp(jumps=[2.0])
    assert (reference.initial_time, reference.final_time, reference.duration) == (1.0, 3.0, 2.0)
    assert reference.x(1.5).tolist() == [2.25, 3.0] and reference.u([1.5, 2.5]).tolist() == [[2.0, 5.0]]
    assert reference.x([9.0]).tolist() == [[9.0], [6.0]] and reference.u(9.0).tolist() == [5.0]
    assert reference.x(1.0 - 1e-10).tolist() == [1.0, 2.0] and reference.tail_control.tolist() == [5.0]
    assert repr(reference) == "Reference('cart', 1 s to 3 s)" and reference.jumps.tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(ArgumentError, match=r"from 1 s to 3 s, not at 0\.5 s"):
        reference.x(0.5)
    strict = ramp(tail="none")
    assert strict.tail_control is None and strict.u(3.0).tolist() == [5.0]
    for t in (3.1, [1.5, 3.1]):
        with pytest.raises(ArgumentError, match=r"not at 3\.1 s"):
            strict.u(t)


def test_where_two_phases_meet_the_later_one_holds():
    """In any order of times; each phase is asked for no time but its own."""

    def phase(begin, end, value):
        def signal(t):
            assert np.all((begin <= t) & (t <= end))
            return np.array([value + 0 * t, t])

        return signal

    reference = Reference.__new__(Reference)
    phases = [phase(0.0, 1.0, 10.0), phase(1.0, 2.5, 20.0), phase(2.5, 3.0, 30.0)]
    reference._set(cart(), phases, [lambda t: 0 * t[None, :]] * 3, [0.0, 1.0, 2.5, 3.0], np.zeros(0), "hold")
    times = [2.5, 0.0, 1.0, 0.999, 3.0, 2.499]
    assert reference.x(times).tolist() == [[30.0, 10.0, 20.0, 10.0, 30.0, 20.0], times]
    assert reference.x(1.0).tolist() == [20.0, 1.0]
    assert reference.x([-1e-10, 3.0 + 1e-10])[1].tolist() == [0.0, 3.0]


def test_a_mean_command_has_the_impulse_of_the_reference():
    reference = Reference.from_functions(
        cart(), lambda t: [0.0, 0.0], lambda t: [t**5 if t < 2 else -t], 0.0, 3.0, jumps=[2.0], tail="hold"
    )
    means = reference.mean_control([0.0, 1.5, 2.75, 5.0], 1.0)
    second = (2**6 - 1.5**6) / 6 - (2.5**2 - 4) / 2
    third = -(9 - 2.75**2) / 2 - 3 * 0.75
    assert means == pytest.approx(np.array([[1 / 6, second, third, -3.0]]), rel=1e-12)
    assert reference.mean_control(0.0, 0.5).shape == (1, 1)


@pytest.mark.parametrize(("start", "end"), [(2.0, 1.0), (NAN, 1.0), (0.0, INF)])
def test_a_reference_between_times_that_are_none_is_refused(start, end):
    with pytest.raises(ArgumentError, match="give increasing times"):
        Reference.from_functions(cart(), lambda t: [0, 0], lambda t: [0], start, end)


def test_what_cannot_be_followed_is_refused():
    with pytest.raises(ArgumentError, match="no tail 'coast'"):
        ramp(tail="coast")
    with pytest.raises(
        ArgumentError, match="no control keeps the final state of 'cart' at rest: 'q' still moves at 6"
    ):
        ramp(tail="trim")
    with pytest.raises(ArgumentError, match="the state of a constant reference"):
        Reference.constant(cart(), [1.0, 2.0, 3.0])
    with pytest.raises(ArgumentError, match="the control of a constant reference"):
        Reference.constant(cart(), [1.0, 0.0], [1.0, 2.0])


def test_trim_is_found_by_newtons_method():
    model = Model("valve")
    x, u = model.state("x"), model.control("u", 2)
    model.ode({x: u[0] ** 3 + 4 * u[0] - 5 + 2 * u[1]})
    found = trim(model, 0.0, [0.0])
    assert found[0] ** 3 + 4 * found[0] - 5 + 2 * found[1] == pytest.approx(0.0, abs=1e-12)
    assert trim(cart(0.5), 0.0, [3.0, 0.0]).tolist() == [0.0]
    resting = Reference.constant(pendulum(), [0.3, 0.0])
    assert resting.u(7.0) == pytest.approx([4 * np.tan(0.3)]) and resting.x(-0.0).tolist() == [0.3, 0.0]
    own = Reference.constant(pendulum(), [0.3, 0.0], [9.0])
    assert own.u(0.0).tolist() == [9.0] and own.tail_control.tolist() == [9.0]


def test_what_rests_nearly_counts_as_at_rest():
    """Up to a millionth of the state's size, if that is above one."""
    model = Model("drift")
    x, u = model.state("x"), model.control("u")
    model.ode({x: 0 * u + 1e-5})
    assert trim(model, 0.0, [11.0]).tolist() == [0.0]
    for value in (9.0, 0.0):
        with pytest.raises(ArgumentError, match="'x' still moves"):
            trim(model, 0.0, [value])


# --- weights ----------------------------------------------------------------------------------------------


def test_weights_are_matrices_diagonals_numbers_or_names():
    layout = Layout("state", (Variable("r", 2), Variable("v")))
    assert read_weight(2.0, layout, "Q").tolist() == np.diag([2.0] * 3).tolist()
    assert read_weight([1, 2, 3], layout, "Q").tolist() == np.diag([1.0, 2, 3]).tolist()
    assert read_weight({"r": [1, 2]}, layout, "Q").tolist() == np.diag([1.0, 2, 0]).tolist()
    assert read_weight({"r": 4, "v": 5}, layout, "Q").tolist() == np.diag([4.0, 4, 5]).tolist()
    full = np.array([[2.0, 1, 0], [1, 3, 0], [0, 0, 1]])
    assert read_weight(full, layout, "Q").tolist() == full.tolist()
    for value, message in (
        ([1.0, 2.0], "Q is given 2 values"), (np.ones((2, 2)), r"shape \(2, 2\)"),
        (full + np.eye(3, k=1), "not symmetric"),
        (np.diag([1, INF, 1]), "not finite"), ({"r": [1, 2, 3]}, "Q of 'r'"), ({"z": 1.0}, "no state 'z'"),
    ):  # fmt: skip
        with pytest.raises((ArgumentError, DesignError, UnknownNameError), match=message):
            read_weight(value, layout, "Q")


def test_brysons_rule():
    layout = Layout("state", (Variable("r", 2), Variable("v")))
    found = bryson(layout, r=[0.1, 0.2], v=4.0)
    assert found["v"] == 0.0625 and found["r"] == pytest.approx([100.0, 25.0])
    for wrong in ({"v": 0.0}, {"v": INF}, {"r": [1.0, -1.0]}, {"r": [[1.0, 2.0]]}, {"r": []}):
        with pytest.raises(ArgumentError, match="largest acceptable"):
            bryson(layout, **wrong)


@pytest.mark.parametrize(
    ("q", "r", "n", "message"),
    [
        ([1.0, -1.0], 1.0, None, "Q of 'v' is -1"), ([[1.0, 2], [2, 1]], 1.0, None, "Q is not positive semidefinite"),
        ([[0.0, 1], [1, 1]], 1.0, None, "Q is not positive semidefinite"),
        ([[0.0, 1e-12], [1e-12, 1]], 1.0, None, "Q is not positive semidefinite"), (1.0, 0.0, None, "R of 'a' is 0"),
        (1.0, 1.0, [[1.0]], r"N has the shape"), (1.0, 1.0, [[NAN], [0.0]], "N has the shape"),
        (1.0, 1.0, [[2.0], [0.0]], r"\[\[Q, N\], \[N', R\]\]"),
    ],
)  # fmt: skip
def test_costs_that_reward_are_refused(q, r, n, message):
    with pytest.raises((ArgumentError, DesignError), match=message):
        read_cost(cart(), q, r, n)


def test_costs_at_the_edge_are_not():
    cost = read_cost(cart(), [[1.0, 1.0], [1.0, 1.0]], 4.0, [[2.0], [2.0]])
    assert cost.n.tolist() == [[2.0], [2.0]] and read_cost(cart(), 0.0, 1.0, None).n.tolist() == [
        [0.0],
        [0.0],
    ]
    assert read_cost(cart(), [1e-9, 1e9], 1e-12, None).r.tolist() == [[1e-12]]
    two = Model("two")
    x, u = two.state("x"), two.control("u", 2)
    two.ode({x: u[0] + u[1]})
    with pytest.raises(DesignError, match="R is not positive definite"):
        read_cost(two, 1.0, [[1.0, 1.0], [1.0, 1.0]], None)


# --- Riccati equations ------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [0.0, 0.3])
def test_a_scalar_regulator(n):
    """2 a p - (b p + n)^2 / r + q = 0, or its sampled form, solved by hand."""
    a, b, q, r = 0.5, 2.0, 3.0, 0.7
    found = steady(*(np.array([[v]]) for v in (a, b, q, r, n)), ("x",))
    p = float(found.cost[0, 0])
    assert 2 * a * p - (b * p + n) ** 2 / r + q == pytest.approx(0.0, abs=1e-12) and p > 0
    assert found.gain[0, 0] == pytest.approx((b * p + n) / r) and found.poles.real == pytest.approx(
        [a - b * found.gain[0, 0]]
    )
    assert found.residual < 1e-14
    sampled = steady(*(np.array([[v]]) for v in (1.2, b, q, r, n)), ("x",), sampled=True)
    p, k = float(sampled.cost[0, 0]), float(sampled.gain[0, 0])
    assert k == pytest.approx((1.2 * b * p + n) / (r + b * b * p))
    assert 1.44 * p - k * k * (r + b * b * p) + q == pytest.approx(p, rel=1e-12)
    assert abs(sampled.poles[0]) < 1 and sampled.poles.real == pytest.approx([1.2 - b * k])


def test_poles_are_sorted_slowest_first():
    found = steady(np.diag([0.0, -5.0]), np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), ("x", "y"))
    assert found.poles.real == pytest.approx([-1.0, -np.sqrt(26.0)])
    sampled = steady(
        np.diag([0.1, 0.9]), np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), ("x", "y"), sampled=True
    )
    assert abs(sampled.poles[0]) > abs(sampled.poles[1])


@pytest.mark.parametrize("sampled", [False, True])
def test_a_solution_that_leaves_an_unstable_pole_is_refused(sampled, monkeypatch):
    """The other root of the scalar equation mirrors the pole: from -1.5 to 1.5, or out of the unit circle."""
    a, b = (0.5, 1.0) if not sampled else (1.2, 1.0)
    other = 0.5 - np.sqrt(0.25 + 2.0) if not sampled else None
    if sampled:  # p = q + a^2 p - a^2 b^2 p^2 / (r + b^2 p)
        other = float(np.min(np.roots([1.0, 1.0 - 2.0 - 1.44, -2.0])))
    monkeypatch.setattr(riccati, "_polished", lambda *_: np.array([[other]]))
    with pytest.raises(DesignError, match="leaves a pole at"):
        steady(*(np.array([[v]]) for v in (a, b, 2.0, 1.0, 0.0)), ("x",), sampled=sampled)


def test_a_residual_is_relative_and_tells_a_wrong_cost():
    cost = QuadraticCost(np.eye(2), np.eye(1), np.zeros((2, 1)))
    for is_sampled in (False, True):
        plant = zero_order_hold(A, B, 0.1) if is_sampled else (A, B)
        p = steady(*plant, *cost, ("q", "v"), sampled=is_sampled).cost
        assert residual(*plant, *cost, p, sampled=is_sampled) < 1e-13
        wrong = residual(*plant, *cost, 1.001 * p, sampled=is_sampled)
        assert 1e-5 < wrong < 1e-2
        scale = np.diag([1.0, 1e3])
        back = np.linalg.inv(scale)
        scaled = (scale @ plant[0] @ back, scale @ plant[1], back @ cost.q @ back, cost.r, back @ cost.n)
        assert residual(*scaled, back @ (1.001 * p) @ back, sampled=is_sampled) == pytest.approx(
            wrong, rel=1e-6
        )
    assert residual(0 * A, B, 0 * A, R, 0 * B, 0 * A, sampled=False) == 0.0


def test_modes_out_of_reach_are_named():
    a = np.array([[1.0, 0.0, 0.0], [0.0, -2.0, 5.0], [0.0, 0.0, 3.0]])
    b = np.array([[1.0], [1.0], [0.0]])
    (mode,) = unreached(a, b, ("x", "y", "z"))
    assert mode.eigenvalue == pytest.approx(3.0) and "z" in mode.states and mode.rank_gap < 1e-12
    assert unreached(a, np.eye(3), ("x", "y", "z")) == []
    assert {round(m.eigenvalue.real) for m in unreached(a, np.zeros((3, 1)), ("x", "y", "z"))} == {1, -2, 3}
    with pytest.raises(DesignError, match=r"no control reaches the mode with eigenvalue 3 1/s in 'z'"):
        require_stabilizable(a, b, ("x", "y", "z"))
    require_stabilizable(
        -a * np.array([[1.0], [1], [1]]), np.array([[0.0], [1.0], [0.0]]) + b, ("x", "y", "z")
    )
    with pytest.raises(DesignError, match="costs nothing and does not decay"):
        require_detectable(np.diag([1.0, -1.0]), np.diag([0.0, 1.0]), ("x", "y"))
    require_detectable(np.diag([1.0, -1.0]), np.diag([1.0, 0.0]), ("x", "y"))


def test_a_mode_is_named_by_the_states_that_have_a_part_in_it():
    """Of three integrators with two inputs across (1, 0.4, 0.02): the third has hardly a part."""
    direction = np.array([[1.0, 0.4, 0.02]])
    across = np.linalg.svd(direction)[2][1:].T
    (mode,) = unreached(np.zeros((3, 3)), across, ("x", "y", "z"))
    assert mode.states == ("x", "y") and abs(mode.eigenvalue) < 1e-12


@pytest.mark.parametrize(
    ("value", "sampled", "ok"),
    [
        (-1.0, False, True),
        (0.0, False, False),
        (0.9, True, True),
        (1.0, True, False),
        (-0.9, True, True),
        (-1.1, True, False),
    ],
)
def test_modes_on_the_boundary_do_not_decay(value, sampled, ok):
    a, b = np.diag([value, 0.5]), np.array([[0.0], [1.0]])
    if ok:
        require_stabilizable(a, b, ("x", "y"), sampled=sampled)
        return
    with pytest.raises(DesignError, match="not stabilisable"):
        require_stabilizable(a, b, ("x", "y"), sampled=sampled)


def test_margins_of_an_integrator_with_gain():
    """L = k / s: phase margin 90 deg at k rad/s, delay pi / (2 k), any gain up; sensitivity gives the disk 2."""
    found = margins(np.zeros((1, 1)), np.ones((1, 1)), np.array([[3.0]]))
    assert found.gain_up.tolist() == [INF] and found.gain_down.tolist() == [0.0]
    assert found.phase == pytest.approx([np.pi / 2]) and found.delay == pytest.approx([np.pi / 6])
    assert found.disk == pytest.approx(2.0, rel=1e-4)
    held = margins(np.ones((1, 1)), np.array([[0.1]]), np.array([[3.0]]), 0.1)
    assert held.gain_up == pytest.approx([2 / 0.3])  # z = -1: 1 - 0.1 k g = -1
    unstable = margins(np.ones((1, 1)), np.ones((1, 1)), np.array([[4.0]]))
    assert unstable.gain_down == pytest.approx([0.25]) and unstable.gain_up.tolist() == [INF]


@pytest.mark.parametrize("c", [1.0, 1.9, 1.9999999])
def test_a_sampled_integrator_has_the_phase_margin_of_its_crossing(c):
    """L = c / (z - 1) has the size one at w dt = 2 asin(c / 2), also just below the last frequency there is."""
    dt = 0.1
    found = margins(np.ones((1, 1)), np.array([[dt]]), np.array([[c / dt]]), dt)
    crossing = 2 * np.arcsin(c / 2) / dt
    phase = np.pi / 2 - np.arcsin(c / 2)
    assert found.phase == pytest.approx([phase], abs=1e-9) and found.delay == pytest.approx(
        [phase / crossing], abs=1e-9
    )
    assert found.gain_up == pytest.approx([2 / c])


def test_the_disk_margin_is_that_of_the_highest_peak():
    """Of S - 1/2 = (1 - L) / (2 (1 + L)) over all frequencies, not only those of a grid."""
    a, b, k = np.array([[0.0, 1.0], [0.0, -0.7]]), np.array([[0.0], [1.0]]), np.array([[3.0, 0.2]])

    def height(log_w):
        s = 1j * np.exp(log_w)
        loop = (3.0 + 0.2 * s) / (s * (s + 0.7))
        return -abs((1 - loop) / (2 * (1 + loop)))

    best = minimize_scalar(height, bounds=(0.0, 2.0), method="bounded", options={"xatol": 1e-10})
    assert margins(a, b, k).disk == pytest.approx(-1 / best.fun, rel=1e-9)


def test_a_loop_that_meets_the_positive_axis_alone_bears_any_gain():
    """L = 0.5 s / (s^2 + 0.1 s + 1) is 5 at 1 rad/s: no gain is lost there; |L| = 1 where |1 - w^2| = w sqrt(0.24)."""
    found = margins(np.array([[0.0, 1.0], [-1.0, -0.1]]), np.array([[0.0], [1.0]]), np.array([[0.0, 0.5]]))
    assert found.gain_up.tolist() == [INF] and found.gain_down.tolist() == [0.0]
    w = (np.sqrt(0.24) + np.sqrt(4.24)) / 2  # above the resonance, where L lags
    loop = 0.5j * w / (1 - w**2 + 0.1j * w)
    assert abs(loop) == pytest.approx(1.0) and found.phase == pytest.approx([np.pi + np.angle(loop)])
    assert found.delay == pytest.approx([(np.pi + np.angle(loop)) / w])


@pytest.mark.parametrize("c", [1e6 / 3, -1e6 / 3, 0.3])
@pytest.mark.parametrize("dt", [None, 0.1])
def test_what_integrates_but_for_rounding_has_no_gain_at_rest(c, dt):
    """A mode of the rate zero, or of one per step, of a matrix whose entries cancel to rounding."""
    rate = np.array([[-c, c], [c / 7, -c / 7]]) * (1 + np.array([[0.0, 1e-16], [0.0, 3e-16]]))
    a = rate if dt is None else np.eye(2) + rate

    def at_rest(a):
        system, none = (a, np.array([1.0, 0.0]), np.array([2.0, 1.0])), np.empty(0)
        return _met(system, lambda w: 0j, np.append(none, 1.0), np.zeros(1), dt)[0]

    assert at_rest(a) == INF
    slow = a - 1e-3 * abs(c) * np.eye(2)
    still = -slow if dt is None else np.eye(2) - slow
    expected = np.array([2.0, 1.0]) @ np.linalg.inv(still) @ np.array([1.0, 0.0])
    assert at_rest(slow) == pytest.approx(expected)


@pytest.mark.parametrize(("rate", "dt"), [(0.5, 0.01), (2.0, 0.005), (2.0, 0.02), (2.0, 0.5)])
def test_loops_that_go_through_infinity_need_no_gain(rate, dt):
    """At an undamped mode of the plant L changes its sign through infinity; any small gain damps it."""
    a, b = zero_order_hold(np.array([[0.0, 1.0], [-(rate**2), 0.0]]), np.array([[0.0], [2e-3]]), dt)
    x = solve_discrete_are(a, b, np.eye(2), np.eye(1))
    k = np.linalg.solve(1 + b.T @ x @ b, b.T @ x @ a)
    assert spectral_radius(a - 1e-3 * b @ k) < 1
    assert margins(a, b, k, dt).gain_down.tolist() == [0.0]


def test_frequencies_reach_four_decades_beyond_the_slowest_and_the_fastest_pole():
    """Rates of 0.01 and 300 per second, and a resonance at 5 rad/s with a node on each side."""
    a = np.zeros((4, 4))
    a[0, 0], a[1, 1], a[2:, 2:] = -0.01, -300.0, [[0.0, 1.0], [-25.0, -1e-6]]
    grid = _frequencies(a, a, None)
    assert grid[[0, -1]] == pytest.approx([1e-6, 3e6]) and np.all(np.diff(grid) > 0)
    below, above = (grid[grid < 5.0][-1], grid[grid > 5.0][0])
    assert 0 < 5.0 - below < 1e-5 and 0 < above - 5.0 < 1e-5
    sampled = _frequencies(np.eye(4) + 1e-4 * a, np.eye(4) + 1e-4 * a, 1e-4)
    assert sampled[-1] == np.pi / 1e-4 and sampled[-2] < sampled[-1] and sampled[0] == pytest.approx(1e-6)
    none = _frequencies(np.zeros((1, 1)), np.zeros((1, 1)), None)
    assert none[[0, -1]] == pytest.approx([1e-4, 1e4])


def test_channels_are_judged_with_the_others_closed():
    a, b = np.diag([0.0, 1.0]), np.eye(2)
    found = margins(a, b, np.diag([3.0, 4.0]))
    assert found.gain_down == pytest.approx([0.0, 0.25]) and found.phase[0] == pytest.approx(np.pi / 2)
    assert found.phase[1] == pytest.approx(np.arccos(1 / 4), rel=1e-6)


# --- gains along a reference ------------------------------------------------------------------------------


def scalar_plant() -> Model:
    model = Model("scalar")
    x, u = model.state("x"), model.control("u")
    model.ode({x: 0 * x + u})
    return model


def moving(final=2.0, tail="hold"):
    return Reference.from_functions(scalar_plant(), lambda t: [t], lambda t: [1.0], 0.0, final, tail=tail)


COST = QuadraticCost(np.array([[4.0]]), np.array([[1.0]]), np.array([[0.0]]))


def test_a_scalar_riccati_equation_has_its_closed_form():
    """-p' = 4 - p^2, p(2) = s: p = 2 tanh(2 (T - t) + artanh(s / 2)); after the end the steady 2."""
    deviation = ErrorDynamics(scalar_plant())
    gains = riccati_gains(deviation, moving(), COST, terminal=1.0)
    for t in (0.0, 0.7, 1.9, 2.0):
        p = 2 * np.tanh(2 * (2.0 - t) + np.arctanh(0.5))
        assert gains.P(t)[0, 0] == pytest.approx(p, rel=1e-9)
        assert gains.K(t)[0, 0] == pytest.approx(p if t < 2.0 else 2.0, rel=1e-9)
    assert gains.P(2.1)[0, 0] == pytest.approx(2.0) and gains.K(9.0)[0, 0] == pytest.approx(2.0)
    assert gains.P(-0.5)[0, 0] == pytest.approx(gains.P(0.0)[0, 0]) and gains.tail[0, 0] == pytest.approx(2.0)
    level = riccati_gains(deviation, moving(), COST)
    assert [level.P(t)[0, 0] for t in (0.0, 1.0, 2.0)] == pytest.approx([2.0] * 3)
    assert riccati_defect(gains, COST) < 1e-6
    assert riccati_defect(gains, QuadraticCost(1.01 * COST.q, COST.r, COST.n)) > 1e-3


def test_the_riccati_equation_is_looked_at_in_the_middle_of_equal_parts_of_each_piece():
    """Eight parts over 4 s: two of them in the first piece, six in the second; the difference quotient beside them."""
    asked = []

    def known(t):
        asked.append(t)
        return np.array([[2.0]])

    gains = SimpleNamespace(
        pieces=((5.0, 6.0, None), (6.0, 9.0, None)), P=known, deviation=ErrorDynamics(scalar_plant()),
        reference=SimpleNamespace(duration=4.0, x=lambda t: [t], u=lambda t: [1.0]),
    )  # fmt: skip
    assert riccati_defect(gains, COST, 8) == 0.0
    middles = np.array([5.25, 5.75, 6.25, 6.75, 7.25, 7.75, 8.25, 8.75])
    assert asked[::5] == pytest.approx(middles)
    steps = np.reshape(asked, (8, 5))[:, 1:] - middles[:, None]
    assert steps / steps[:, -1:] == pytest.approx(np.tile([-1.0, -0.5, 0.5, 1.0], (8, 1)), abs=1e-9)
    assert np.all((steps[:, -1] > 0) & (steps[:, -1] < 0.1))


@pytest.mark.parametrize(("start", "span"), [(0.0, 2.0), (1e6, 2.0), (0.0, 2e-4)])
def test_gains_early_late_and_brief_know_on_which_side_of_a_jump_they_are(start, span):
    """x' = w x + u about x = 0, where w jumps from 1 to -2 per unit of time: -p' = 2 w p - p^2 + 4, from p = 1."""
    model = Model("switched")
    x, u, w = model.state("x"), model.control("u"), model.control("w")
    model.ode({x: w * x + u})
    unit = span / 2
    jump = start + 0.6 * unit
    reference = Reference.from_functions(
        model,
        lambda t: [0.0],
        lambda t: [0.0, (1.0 if t < jump else -2.0) / unit],
        start,
        start + span,
        jumps=[jump],
    )
    cost = QuadraticCost(np.array([[4.0 / unit]]), unit * np.eye(2), np.zeros((1, 2)))
    gains = riccati_gains(ErrorDynamics(model), reference, cost, terminal=1.0)
    p = 1.0
    for factor, left, right in ((-2.0, 0.6, 2.0), (1.0, 0.0, 0.6)):

        def rate(t, p, factor=factor):
            return -(2 * factor * p - p**2 + 4)

        p = float(solve_ivp(rate, (right, left), [p], rtol=1e-12, atol=1e-13, method="DOP853").y[0, -1])
        assert gains.P(start + left * unit)[0, 0] == pytest.approx(p, rel=2e-8)
    assert riccati_defect(gains, cost) < 1e-5
    assert riccati_defect(gains, cost._replace(q=1.01 * cost.q)) > 1e-3


def test_a_sampled_recursion_by_hand():
    """Steps of 1/2 s over 1.2 s: three, with the plant x + u / 2 and its exact cost."""
    deviation, dt = ErrorDynamics(scalar_plant()), 0.5
    gains = riccati_gains(deviation, moving(1.2), COST, terminal=1.0, dt=dt)
    assert isinstance(gains, SampledGains) and len(gains.gains) == 3 and len(gains.steps) == 4
    step = gains.steps[0]
    assert (step.a[0, 0], step.b[0, 0], step.q[0, 0]) == pytest.approx((1.0, 0.5, 2.0))
    assert (step.r[0, 0], step.n[0, 0]) == pytest.approx((0.5 + 4 * 0.125 / 3, 4 * 0.125))
    p, found = 1.0, []
    for _ in range(3):
        k = (0.5 * p + 0.5) / (step.r[0, 0] + 0.25 * p)
        p = 2.0 + p - (0.5 * p + 0.5) * k
        found.append((k, p))
    for index, (k, p) in enumerate(reversed(found)):
        assert gains.K(dt * index)[0, 0] == pytest.approx(k) and gains.P(dt * index + 0.49)[
            0, 0
        ] == pytest.approx(p)
    assert (
        gains.P(1.5)[0, 0] == pytest.approx(1.0) and gains.index(0.5 - 1e-9) == 1 and gains.index(-3.0) == 0
    )
    steady_one = steady(step.a, step.b, step.q, step.r, step.n, ("x",), sampled=True)
    assert gains.P(2.0)[0, 0] == pytest.approx(steady_one.cost[0, 0]) and gains.K(1.5)[0, 0] == pytest.approx(
        steady_one.gain[0, 0]
    )
    assert cost_defect(gains) < 1e-13
    assert cost_defect(replace(gains, gains=tuple(1.1 * k for k in gains.gains))) > 1e-4
    assert cost_defect(replace(gains, costs=(1.01 * gains.costs[0], *gains.costs[1:]))) > 1e-3


def test_gains_need_a_tail_or_a_terminal_weight():
    """An unstable state out of reach: no steady regulator; with a terminal weight the last gain is held."""
    model = Model("half")
    x, y, u = model.state("x"), model.state("y"), model.control("u")
    model.ode({x: u, y: 0.1 * y})
    reference = Reference.from_functions(model, lambda t: [0.0, 0.0], lambda t: [0.0], 0.0, 1.0)
    deviation, cost = ErrorDynamics(model), read_cost(model, [1.0, 1.0], 1.0, None)
    for dt in (None, 0.25):
        with pytest.raises(DesignError, match=r"after the end of the reference .* or give a terminal weight"):
            riccati_gains(deviation, reference, cost, dt=dt)
        gains = riccati_gains(deviation, reference, cost, terminal=[3.0, 0.0], dt=dt)
        assert gains.steady is None
        if dt is None:
            assert gains.tail == pytest.approx(
                gain_of(
                    np.diag([0, 0.1]),
                    np.array([[1.0], [0]]),
                    cost.r,
                    cost.n,
                    np.diag([3.0, 0]),
                    sampled=False,
                )
            )
            assert gains.P(2.0)[0, 0] == pytest.approx(3.0)
        else:
            assert gains.tail == pytest.approx(gains.gains[-1]) and gains.P(9.0) == pytest.approx(
                gains.costs[-1]
            )
    with pytest.raises(DesignError, match="terminal weight"):
        riccati_gains(deviation, reference, cost, terminal=[-1.0, 0.0])


def test_a_reference_rests_with_its_tail_or_its_last_control():
    assert resting_control(ramp(jumps=[2.0])).tolist() == [5.0] == resting_control(ramp(tail="none")).tolist()
    still = Reference.from_functions(cart(), lambda t: [0.0, 0.0], lambda t: [3.0], 0.0, 1.0, tail="trim")
    assert resting_control(still).tolist() == [0.0]


def test_a_table_of_linearizations_is_the_linearization():
    """Smooth pieces between jumps are interpolated, and so are those that have to be halved; a kink is not."""
    for jumps, control in (
        ((), lambda t: [np.sin(3 * t)]),
        ((1.0,), lambda t: [float(t >= 1.0)]),
        ((), lambda t: [abs(t - 0.777)]),
    ):
        reference = Reference.from_functions(
            pendulum(), lambda t: [np.sin(t), np.cos(t)], control, 0.0, 2.0, jumps=jumps
        )
        deviation = ErrorDynamics(reference.model)
        table = LinearizationTable(deviation, reference)
        smooth = [values is not None for _, _, values in table._parts]
        assert all(smooth) if control(0.5) != [0.277] else not all(smooth)
        assert len(smooth) < 20
        for t in (0.0, 0.3, 0.999, 1.0, 1.5, 2.0):
            a, b = table(t)
            exact = deviation.linearize(t, reference.x(t), reference.u(t))
            assert a == pytest.approx(exact[0], abs=1e-11) and b == pytest.approx(exact[1], abs=1e-11)
    assert LinearizationTable(ErrorDynamics(cart()), Reference.constant(cart(), [1.0, 0.0]))(0.0)[
        1
    ].tolist() == [
        [0],
        [1],
    ]
