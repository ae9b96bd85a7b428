"""Laws as a whole against formulas written out by hand: regulators with integrals, horizons, guards, hierarchies."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize

from gnc_opt.control import (
    ConstantRate,
    Reference,
    SaturationLayer,
    design_feedback_linearization,
    design_integral_sliding_mode,
    design_lqr,
    design_mpc,
    design_tvlqr,
    output_errors,
)
from gnc_opt.control.decoupling import check_zero_dynamics, guarded_inverse
from gnc_opt.control.feedback_linearization import _sampling_facts
from gnc_opt.control.hierarchical_sliding_mode import hierarchical_errors
from gnc_opt.control.loop_margins import margins
from gnc_opt.control.sampled_data import sample, zero_order_hold
from gnc_opt.errors import ArgumentError, DesignError, UnknownNameError
from gnc_opt.model import Model
from gnc_opt.simulation import ClosedLoop


def cart(**units) -> Model:
    model = Model("cart")
    q, v = model.state("q", unit="m"), model.state("v", unit="m/s")
    a = model.control("a", unit="N")
    model.ode({q: v, v: a})
    model.output("twice", 2 * q, unit=units.get("unit", "m"))
    return model


def climbing(tail="hold"):
    return Reference.from_functions(cart(), lambda t: [t, 1.0], lambda t: [0.25], 0.0, 2.0, tail=tail)


# --- regulators -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [None, 0.1])
@pytest.mark.parametrize("limits", [None, (-1.0, 2.0)])
@pytest.mark.parametrize(("name", "factor"), [("q", 1.0), ("twice", 2.0)])
def test_a_regulator_with_an_integral_is_its_formula(dt, limits, name, factor):
    """u = u_ff - K e - K_i z, z grows by dt times the error, set back by what the limits cut."""
    law = design_lqr(cart(), climbing(), Q=[2.0, 1.0], R=0.5, dt=dt, integral={name: 0.3}, limits=limits)
    gain = np.asarray(law.explain()["gain"])
    assert gain.shape == (1, 3) and law.memory.names[0] == f"integral_{name}"
    assert law.memory.variables[0].unit == "m s"
    step, x, z = 0.1, np.array([3.0, -0.5]), 0.7
    e = x - [0.4, 1.0]
    u = 0.25 - gain[0, :2] @ e - gain[0, 2] * z
    cut = 0.0 if limits is None else u - np.clip(u, *limits)
    memory = law.initial_memory(0.4, x, step)
    assert memory[0] == 0.0
    memory[0] = z
    found, after = law(0.4, x, memory, dt=step)
    assert found == pytest.approx([u]) and after[0] == pytest.approx(
        z + step * factor * e[0] + cut / gain[0, 2]
    )
    assert law.span == (0.0, 2.0) and law.dt == dt
    facts = {f.name for f in law.explain()}
    assert ("sampled poles" in facts) is (dt is not None) and ("control authority margin" in facts) is (
        limits is not None
    )


def test_the_gain_of_a_regulator_is_optimal_for_the_held_plant_with_its_integral():
    """The discrete Riccati equation of (e, z) with plant and cost sampled exactly; poles are told as rates."""
    dt = 0.1
    law = design_lqr(cart(), climbing(), Q=[2.0, 1.0], R=0.5, dt=dt, integral={"q": 0.3})
    a, b = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    held = sample(a, b, np.diag([2.0, 1.0]), np.array([[0.5]]), np.zeros((2, 1)), dt)
    wide_a = np.block([[held.a, np.zeros((2, 1))], [dt * np.array([[1.0, 0.0]]), np.eye(1)]])
    wide_b, wide_n = np.vstack([held.b, [[0.0]]]), np.vstack([held.n, [[0.0]]])
    wide_q = np.block([[held.q, np.zeros((2, 1))], [np.zeros((1, 2)), dt * 0.3 * np.eye(1)]])
    p = solve_discrete_are(wide_a, wide_b, wide_q, held.r, s=wide_n)
    gain = np.linalg.solve(held.r + wide_b.T @ p @ wide_b, wide_b.T @ p @ wide_a + wide_n.T)
    assert law.explain()["gain"] == pytest.approx(gain, rel=1e-8)
    z = np.linalg.eigvals(wide_a - wide_b @ gain)
    assert np.sort(np.abs(law.explain()["sampled poles"])) == pytest.approx(np.sort(np.abs(z)))
    rates = np.asarray(law.explain()["closed-loop poles"])
    assert np.sort_complex(np.exp(dt * rates)) == pytest.approx(np.sort_complex(z.astype(complex)))
    assert law.explain()["damping"] == pytest.approx(-rates.real / np.abs(rates))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"integral": {"z": 1.0}}, "no state or output 'z'"),
        ({"integral": {"q": 0.0}}, "the weight of 'integral_q' is 0"),
        ({"integral": {"q": [1.0, 2.0]}}, "weight of the integral of 'q'"),
        ({"dt": -1.0}, "control step dt"),
    ],
)
def test_integrals_that_are_none_are_refused(options, message):
    with pytest.raises((ArgumentError, DesignError, UnknownNameError), match=message):
        design_lqr(cart(), climbing(), Q=1.0, R=1.0, **options)


def test_a_regulator_needs_constant_dynamics():
    model = Model("bent")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u - x**2})
    moving = Reference.from_functions(model, lambda t: [t], lambda t: [1.0 + t**2], 0.0, 1.0)
    with pytest.raises(
        DesignError, match="A of 'bent' changes along the reference, by 2 between 0 s and 1 s"
    ):
        design_lqr(model, moving, Q=1.0, R=1.0)
    steep = Model("steep")
    x, u = steep.state("x"), steep.control("u")
    steep.ode({x: u * (1 + x)})
    with pytest.raises(DesignError, match="B of 'steep' changes"):
        design_lqr(
            steep, Reference.from_functions(steep, lambda t: [t], lambda t: [0.0], 0.0, 1.0), Q=1.0, R=1.0
        )


def test_facts_of_a_regulator_are_its_margins():
    law = design_lqr(cart(), climbing(), Q=[2.0, 1.0], R=0.5)
    gain = np.asarray(law.explain()["gain"])
    found = margins(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), gain)
    assert gain == pytest.approx(np.array([[2.0, np.sqrt(2 * 2.0 + 2)]]))  # sqrt(q1 / r), sqrt(2 k1 + q2 / r)
    for name, value in (
        ("gain margin up", found.gain_up),
        ("gain margin down", found.gain_down),
        ("phase margin", np.degrees(found.phase)),
        ("delay margin", found.delay),
        ("disk margin", found.disk),
    ):
        assert law.explain()[name] == pytest.approx(value)
    assert law.explain()["Riccati residual"] < 1e-12


def test_a_time_varying_regulator_takes_its_gain_from_the_schedule():
    """Rows are x_ref, u_ff and K row by row."""
    model = Model("two")
    x, u = model.state("x", 2), model.control("u", 2)
    model.ode({x: u})
    reference = Reference.from_functions(model, lambda t: [t, 2 * t], lambda t: [1.0, 2.0], 0.0, 1.0)
    q, r = np.array([[3.0, 1.0], [1.0, 2.0]]), np.diag([1.0, 2.0])
    law = design_tvlqr(model, reference, Q=q, R=r, terminal=np.diag([0.5, 0.25]))
    gain = law.schedule.gains.K(0.5)
    row = law.signal(0.5, 0.01)
    assert row == pytest.approx([0.5, 1.0, 1.0, 2.0, *gain.ravel()]) and abs(gain[0, 1] - gain[1, 0]) > 1e-3
    u_found, _ = law(0.5, [1.5, 0.0], dt=0.01)
    assert u_found == pytest.approx(np.array([1.0, 2.0]) - gain @ [1.0, -1.0])
    explained = law.explain()
    assert explained["smallest eigenvalue of P"] == pytest.approx(0.25, abs=1e-9)
    times = np.linspace(0, 1, 40)
    largest = np.max([np.linalg.eigvalsh(law.schedule.gains.P(t))[-1] for t in times])
    assert (
        explained["largest eigenvalue of P"] == pytest.approx(largest)
        and explained["Riccati residual along the reference"] < 1e-6
    )
    assert np.asarray(explained["largest gain"]) == pytest.approx(
        np.max([np.abs(law.schedule.gains.K(t)) for t in [*times, 1.0]], axis=0), rel=1e-6
    )
    assert np.asarray(explained["gain after the end"]) == pytest.approx(law.schedule.gains.tail)


# --- horizons ---------------------------------------------------------------------------------------------


def predictive(**changes):
    options = {"Q": [2.0, 1.0], "R": 0.5, "horizon": 0.6, "dt": 0.2, "limits": (-2.0, 3.0)} | changes
    return design_mpc(cart(), climbing(), **options)


def test_without_a_limit_in_reach_the_horizon_commands_the_sampled_regulator():
    law = predictive(limits=(-99.0, 99.0))
    regulator = design_lqr(cart(), climbing(), Q=[2.0, 1.0], R=0.5, dt=0.2)
    x = np.array([0.7, 0.4])
    assert law(0.4, x)[0] == pytest.approx(regulator(0.4, x)[0], rel=1e-7)
    assert np.asarray(law.explain()["gain at the start"]) == pytest.approx(
        np.asarray(regulator.explain()["gain"]), rel=1e-9
    )
    assert (
        law.explain()["horizon"] == pytest.approx(0.6)
        and law.explain()["dynamics along the horizon"] == "constant"
    )


def test_the_schedule_of_a_horizon_holds_what_lies_ahead():
    """x_ref, u_ff of every step, then the limited states at the ends of the steps."""
    law = predictive(state_limits={"v": (-5.0, 1.5), "q": (-9.0, 9.0)})
    assert [(v.name, v.size) for v in law.signals.variables] == [
        ("q_ref", 1),
        ("v_ref", 1),
        ("a_ff", 1),
        ("horizon_ff", 2),
        ("horizon_ref", 6),
    ]
    assert law.signal(0.4) == pytest.approx([0.4, 1.0, 0.25, 0.25, 0.25, 1.0, 0.6, 1.0, 0.8, 1.0, 1.0])
    late = law.signal(1.8)
    assert late[5:] == pytest.approx([1.0, 2.0, 1.0, 2.0, 1.0, 2.0])
    both = law.schedule(np.array([0.4, 0.6]), 0.2)
    assert both[:, 0] == pytest.approx(law.signal(0.4)) and both[:, 1] == pytest.approx(law.signal(0.6))


@pytest.mark.parametrize("solver", ["piqp", "osqp", "daqp"])
def test_commands_within_limits_of_size_and_rate_are_those_of_the_programme(solver):
    """Against a general solver on the same three steps, with the cost to go at their end."""
    law = predictive(limits=(-1.0, 1.5), rate_limits=3.0, solver=solver)
    a, b = zero_order_hold(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), 0.2)
    held = sample(
        np.array([[0.0, 1.0], [0.0, 0.0]]),
        np.array([[0.0], [1.0]]),
        np.diag([2.0, 1.0]),
        np.array([[0.5]]),
        np.zeros((2, 1)),
        0.2,
    )
    p = solve_discrete_are(held.a, held.b, held.q, held.r, s=held.n)
    x, before = np.array([1.4, 0.6]), 0.25
    z = law.initial_memory(0.4, x)
    assert z[0] == pytest.approx(before)

    def cost(v):
        e, total = x - [0.4, 1.0], 0.0
        for k in range(3):
            total += e @ held.q @ e + held.r[0, 0] * v[k] ** 2 + 2 * (held.n[:, 0] @ e) * v[k]
            e = a @ e + b[:, 0] * v[k]
        return total + e @ p @ e

    def steps(v):
        return np.diff([before, *(v + 0.25)])

    best = minimize(
        cost,
        np.zeros(3),
        bounds=[(-1.25, 1.25)] * 3,
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 200},
        constraints=[
            {"type": "ineq", "fun": lambda v: 0.6 - steps(v)},
            {"type": "ineq", "fun": lambda v: 0.6 + steps(v)},
        ],
    )
    u, after = law(0.4, x, z)
    assert u == pytest.approx([best.x[0] + 0.25], abs=1e-5) and u[0] == pytest.approx(before - 0.6, abs=1e-6)
    assert after[0] == pytest.approx(u[0]) and after[law.memory.slice("qp_failed")].tolist() == [0.0]


def swinging() -> tuple[Model, Reference]:
    """A pendulum that is swung along cos t, so that A and B change with time; two controls."""
    model = Model("pendulum")
    q, w = model.state("q"), model.state("w")
    u, c = model.control("u"), model.control("c")
    model.ode({q: w + 0.1 * c, w: -4 * ca.sin(q) + u * ca.cos(q)})
    return model, Reference.from_functions(
        model, lambda t: [np.cos(t), -np.sin(t)], lambda t: [0.3, 0.0], 0.0, 3.0
    )


def test_a_horizon_over_dynamics_that_change_takes_them_from_its_schedule():
    """Without a limit in reach the time-varying regulator; with limits the programme, by a general solver."""
    model, reference = swinging()
    options = {"Q": [3.0, 1.0], "R": [0.5, 1.0], "horizon": 0.6, "dt": 0.2}
    free = design_mpc(model, reference, limits=(-99.0, 99.0), **options)
    regulator = design_tvlqr(model, reference, Q=[3.0, 1.0], R=[0.5, 1.0], dt=0.2)
    x = np.array([0.5, 0.9])
    for t in (0.0, 0.4, 2.6):
        assert free(t, x)[0] == pytest.approx(regulator(t, x)[0], rel=1e-6)
    names = {v.name: v.size for v in free.signals.variables}
    assert names == {
        "q_ref": 1,
        "w_ref": 1,
        "u_ff": 1,
        "c_ff": 1,
        "horizon_ff": 4,
        "horizon_A": 12,
        "horizon_F": 12,
        "horizon_K": 12,
        "horizon_G": 12,
    }
    assert free.explain()["dynamics along the horizon"] == "from the schedule"

    tight = design_mpc(model, reference, limits=([-1.0, -0.5], [2.0, 0.5]), **options)
    gains, t = regulator.schedule.gains, 0.4
    steps, p = gains.steps[2:5], gains.P(1.0)
    ahead = reference.mean_control(t + 0.2 * np.arange(3), 0.2)

    def cost(v):
        e, total = x - reference.x(t), 0.0
        for k, s in enumerate(steps):
            w = v[2 * k : 2 * k + 2] - ahead[:, k]
            total += e @ s.q @ e + w @ s.r @ w + 2 * e @ s.n @ w
            e = s.a @ e + s.b @ w
        return total + e @ p @ e

    best = minimize(
        cost,
        np.zeros(6),
        bounds=[(-1.0, 2.0), (-0.5, 0.5)] * 3,
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 300},
    )
    u, after = tight(t, x)
    assert u == pytest.approx(best.x[:2], abs=1e-4) and np.max(np.abs(u - free(t, x)[0])) > 0.05
    assert after[tight.memory.slice("qp_failed")].tolist() == [0.0]


def test_a_limited_state_is_kept_by_a_soft_row():
    """v_ref = 1 m/s and at most 1.2 m/s: from 1.5 m/s the command brakes harder than without, and recovers."""
    free, kept = predictive(), predictive(state_limits={"v": (-np.inf, 1.2)})
    x = np.array([0.4, 1.5])
    assert free(0.4, x)[0][0] > -0.9
    assert kept(0.4, x)[0] == pytest.approx([(1.2 - 1.5) / 0.2 + 0.25], abs=1e-6)  # at 1.2 m/s after one step
    assert kept(0.4, [0.4, 1.0])[0] == pytest.approx(free(0.4, [0.4, 1.0])[0], abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"solver": "ipopt"}, "no QP solver 'ipopt'"),
        ({"terminal": "none"}, "terminal is 'none'"),
        ({"horizon": 0.5}, "no whole number"),
        ({"dt": 0.0}, "control step dt"),
        ({"state_penalty": 0.0}, "state penalty"),
        ({"terminal": [-1.0, 0.0]}, "terminal weight"),
    ],
)
def test_horizons_that_are_none_are_refused(changes, message):
    with pytest.raises((ArgumentError, DesignError), match=message):
        predictive(**changes)


def test_a_terminal_weight_takes_the_place_of_the_cost_to_go():
    """One step, by hand: the gain that minimises the step's cost and the weight after it."""
    law = predictive(horizon=0.2, terminal=[7.0, 3.0], limits=(-99.0, 99.0))
    held = sample(
        np.array([[0.0, 1.0], [0.0, 0.0]]),
        np.array([[0.0], [1.0]]),
        np.diag([2.0, 1.0]),
        np.array([[0.5]]),
        np.zeros((2, 1)),
        0.2,
    )
    p = np.diag([7.0, 3.0])
    gain = np.linalg.solve(held.r + held.b.T @ p @ held.b, held.b.T @ p @ held.a + held.n.T)
    assert law(0.4, [0.7, 0.4])[0] == pytest.approx(0.25 - gain @ [0.3, -0.6], rel=1e-6)


# --- guards -----------------------------------------------------------------------------------------------


def lever(function) -> Model:
    """The control acts on v by a function of q."""
    model = Model("lever")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a * function(q)})
    return model


def inverse_on(function, begin, end, guard=0.05):
    model = lever(function)
    path = Reference.from_functions(
        model, lambda t: [begin + (end - begin) * t, end - begin], lambda t: [0.0], 0.0, 1.0
    )
    return guarded_inverse(output_errors(model, path, "v"), path, guard)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_inverse_knows_its_range_and_where_to_stop(sign):
    """cos q from 0 to 1.2 rad: largest 1, smallest cos 1.2; it works down to a quarter of the largest."""
    found = inverse_on(lambda q: sign * ca.cos(q), 0.0, 1.2, 0.25)
    assert (found.scale, found.lowest) == pytest.approx((1.0, np.cos(1.2)))
    q = next(s for s in ca.symvar(found.regular) if s.name().startswith("q"))
    regular = ca.Function("f", [q], [found.regular, found.matrix])
    for angle, ok in (
        (0.0, 1),
        (1.3, 1),
        (np.arccos(0.25) - 1e-6, 1),
        (np.arccos(0.25) + 1e-6, 0),
        (2.0, 0),
        (np.nan, 0),
    ):
        flag, matrix = (float(v) for v in regular(angle))
        assert flag == ok and matrix == pytest.approx(sign * np.cos(angle) if ok else 1.0)


@pytest.mark.parametrize(
    ("begin", "end", "guard"), [(0.0, 2.0, 0.05), (0.0, 1.5, 0.1), (0.0, 1.58, 0.0), (-1.2, -2.0, 0.0)]
)
def test_a_singular_matrix_on_the_reference_is_refused(begin, end, guard):
    with pytest.raises(
        DesignError, match=r"decoupling matrix of outputs v is singular on the reference: det E ="
    ):
        inverse_on(ca.cos, begin, end, guard)


def car(extended: bool) -> Model:
    """A car steered by the rate of its wheel angle, driven by its acceleration or (extended) by the rate of that."""
    model = Model("car")
    x, y, heading, v, wheel = (model.state(k) for k in ("x", "y", "heading", "v", "wheel"))
    drive, steer = model.control("drive"), model.control("steer")
    motion = {x: v * ca.cos(heading), y: v * ca.sin(heading), heading: v * ca.tan(wheel), wheel: steer}
    pull = model.state("pull") if extended else None
    model.ode(motion | ({v: drive} if pull is None else {v: pull, pull: drive}))
    return model


def test_a_control_that_comes_too_early_is_told_and_its_rate_will_do():
    """The acceleration enters both positions before the steering does: the textbook's dynamic extension."""
    for extended in (False, True):
        model = car(extended)
        size = model.states.size
        straight = Reference.from_functions(
            model, lambda t, n=size: [2 * t, 0, 0, 2, 0, 0][:n], lambda t: [0, 0], 0.0, 5.0
        )
        if extended:
            law = design_feedback_linearization(
                model, straight, outputs=["x", "y"], poles=[-1, -2, -3], dt=0.05
            )
            run = ClosedLoop(model, law).simulate([0.3, -0.4, 0.2, 1.8, 0, 0], tf=5.0)
            assert run.states[:2, -1] == pytest.approx([10.0, 0.0], abs=0.05)
        else:
            with pytest.raises(
                DesignError, match=r"singular wherever they are: .* make such a control a state"
            ):
                design_feedback_linearization(model, straight, outputs=["x", "y"], poles=[-1, -2, -3])


def test_a_constant_matrix_is_inverted_once_and_for_all():
    found = inverse_on(lambda q: ca.SX(-4.0), 0.0, 1.0)
    assert (found.scale, found.lowest) == (4.0, 4.0) and float(ca.evalf(found.regular)) == 1.0
    assert float(ca.evalf(ca.SX(found(ca.DM(2.0))))) == -0.5


@pytest.mark.parametrize(("rate", "ok"), [(-0.1, True), (0.0, True), (0.1, False)])
def test_zero_dynamics_that_grow_are_refused(rate, ok):
    model = Model("hidden")
    x, y, u = model.state("x"), model.state("y"), model.control("u")
    model.ode({x: u, y: rate * y})
    rest = Reference.constant(model, [0.0, 0.0])
    errors = output_errors(model, rest, "x")
    if not ok:
        with pytest.raises(
            DesignError, match=r"zero dynamics of outputs x are unstable: eigenvalue 0\.1 1/s of 1"
        ):
            check_zero_dynamics(errors, rest, 1e-9)
        assert len(check_zero_dynamics(errors, rest, 0.2)) == 2
        return
    size, values = check_zero_dynamics(errors, rest, 1e-9)
    assert size.value == 1 and np.real(values.value) == pytest.approx([rate], abs=1e-12)


# --- hierarchies and sampled chains -----------------------------------------------------------------------


def test_a_hierarchical_surface_is_the_weighted_sum_of_its_surfaces():
    """S = 2 (3 e_p + e_p') - (5 e_r + e_r'), of relative degree 1: S' = 2 (3 v_p + a) - (5 v_r + 4 a)."""
    model = Model("pair")
    p, vp, r, vr = (model.state(n) for n in ("p", "vp", "r", "vr"))
    a = model.control("a")
    model.ode({p: vp, vp: a, r: vr, vr: 4 * a})
    rest = Reference.constant(model, np.zeros(4))
    errors = hierarchical_errors(model, rest, ["p", "r"], [3.0, 5.0], [2.0, -1.0])
    pair = errors.pair
    f = ca.Function(
        "f", [pair.x, pair.x_ref, pair.u_ref], [errors.chains[0], errors.drift, errors.decoupling]
    )
    s, drift, effect = (float(v) for v in f([1.0, 2.0, 3.0, 4.0], np.zeros(4), 0.0))
    assert (s, drift, effect) == (2 * (3 + 2) - (15 + 4), 2 * 3 * 2 - 5 * 4, 2 - 4) and errors.degrees == (1,)
    for slopes, weights, message in (
        ([3.0, 5.0], [1.0], "for 2 outputs"),
        ([3.0, 5.0], [0.0, 0.0], "not all zero"),
        ([3.0, 5.0], [np.nan, 1.0], "one number for each"),
        ([3.0, 0.0], [1.0, 1.0], "give positive ones"),
        ([3.0] * 3, [1.0, 1.0], "slopes k_i"),
    ):
        with pytest.raises(DesignError, match=message):
            hierarchical_errors(model, rest, ["p", "r"], slopes, weights)
    with pytest.raises(DesignError, match="a control enters the rate of output 'vp'"):
        hierarchical_errors(model, rest, ["p", "vp"], 1.0, [1.0, 1.0])


def test_steps_too_long_for_the_poles_of_a_chain_are_refused():
    """e'' = -k1 e - k2 e' held over dt: the spectral radius of the sampled double integrator."""
    errors = output_errors(cart(), climbing(), "q")
    gain = np.array([[4.0, 4.0]])
    a, b = np.array([[1.0, 0.4], [0.0, 1.0]]), np.array([[0.08], [0.4]])
    (fact,) = _sampling_facts(errors, gain, 0.4)
    assert fact.value == pytest.approx(np.max(np.abs(np.linalg.eigvals(a - b @ gain)))) and fact.value < 1
    assert _sampling_facts(errors, gain, None) == []
    with pytest.raises(DesignError, match=r"control steps of 1\.1 s are too long"):
        _sampling_facts(errors, gain, 1.1)


def test_an_integral_surface_stays_at_zero_undisturbed_and_sums_a_matched_disturbance():
    """Beside u_nom = -K e, held: over one step of the exact flow s stays zero; a push of 0.3 adds 0.3 dt."""
    dt, gain = 0.1, np.array([[2.0, 3.0]])
    rest = Reference.constant(cart(), [0.0, 0.0])
    law = design_integral_sliding_mode(
        cart(), rest, nominal=gain, reaching=ConstantRate(1.0), boundary=SaturationLayer(0.5), dt=dt
    )
    a, b = zero_order_hold(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), dt)
    for push in (0.0, 0.3):
        x = np.array([1.0, -0.5])
        z = law.initial_memory(0.0, x)
        u, z = law(0.0, x, z)
        assert u == pytest.approx(-gain @ x)
        x = a @ x + b[:, 0] * (u[0] + push)
        u, z = law(dt, x, z)
        s = z[law.memory.slice("s")][0]
        assert s == pytest.approx(push * dt, abs=1e-12)
        assert u == pytest.approx(-gain @ x - s / 0.5)


def test_a_law_around_another_one_has_its_alarms_too():
    rest = Reference.constant(cart(), [0.0, 0.0])
    inner = design_feedback_linearization(cart(), rest, outputs="q", poles=[-1.0, -2.0], dt=0.1)
    outer = design_integral_sliding_mode(
        cart(), rest, nominal=inner, reaching=ConstantRate(1.0), boundary=SaturationLayer(0.5), dt=0.1
    )
    assert "singular" in inner.alarms and {"singular", "nominal_singular"} <= set(outer.alarms)
    assert {"singular", "nominal_singular"} <= set(outer.memory.names)
