"""Model predictive control: closed forms, limits, and its quadratic programs."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize
from testing.internals import StepLimits, discretize_plant_and_cost, discretize_zero_order_hold
from testing.models import dynamics
from testing.mpc_designs import DT, A, B, cart, pendulum, tracker

import gnc_opt as go
from gnc_opt.control import Reference, design_lqr, design_mpc, design_tvlqr
from gnc_opt.control import active_set_qp_c_code as programme_code
from gnc_opt.control.active_set_qp_c_code import QpCode, _IndexedSchedule
from gnc_opt.errors import ArgumentError, DesignError, UnknownNameError
from gnc_opt.model import Model

# Model predictive control: the regulator where no limit is met, optimality where one is, and failing
# safely.


def test_a_state_is_a_reference_that_rests():
    model, x = cart(), [0.4, 0.1]
    law = design_mpc(model, [0, 0], Q=1, R=1, horizon=2.0, dt=DT, limits=(-1, 1))
    assert law(0.0, x)[0] == pytest.approx(tracker()(0.0, x)[0], abs=1e-12)


def fly(controller, x, steps, disturbance=0.0):
    z, states, commands = None, [], []
    for k in range(steps):
        u, z = controller(k * DT, x, z)
        x = A @ x + B * (u[0] + disturbance)
        states.append(x)
        commands.append(u[0])
    return np.array(states), np.array(commands), z


def test_without_limits_it_is_the_sampled_regulator():
    regulator = design_lqr(cart(), [0, 0], Q=1, R=1, dt=DT)
    controller = tracker(limits=(-100, 100), rate_limits=1e4, state_limits={"v": (-50, 50)})
    for x in np.random.default_rng(1).normal(size=(10, 2)):
        assert controller(0.0, x)[0] == pytest.approx(regulator(0.0, x)[0], abs=1e-9)


def test_without_limits_it_is_the_time_varying_regulator_along_a_reference():
    model, reference = pendulum()
    controller = design_mpc(model, reference, Q=1, R=1, horizon=1.0, dt=DT, limits=(-100, 100))
    regulator = design_tvlqr(model, reference, Q=1, R=1, dt=DT)
    assert controller.explain()["dynamics along the horizon"] == "from the schedule"
    for t in (0.0, 1.3, 2.5, 2.9, 3.0, 8.0):
        x = reference.x(t) + np.array([0.1, -0.2])
        assert controller(t, x)[0] == pytest.approx(regulator(t, x)[0], abs=1e-9)


def test_limits_of_control_rate_and_state_are_kept():
    controller = tracker(rate_limits=5.0, state_limits={"v": (-0.5, np.inf)})
    states, commands, z = fly(controller, np.array([3.0, 0.0]), 150)
    assert np.max(np.abs(commands)) <= 1.0
    assert np.max(np.abs(np.diff(np.append(0.0, commands)))) <= 0.5 + 1e-12
    assert states[:, 1].min() == pytest.approx(-0.5, abs=1e-9)  # met, and kept
    assert np.allclose(states[-1], 0, atol=1e-4)
    assert z[controller.memory.slice("qp_failed")] == 0


def test_a_state_limit_that_cannot_be_kept_is_left_as_little_as_possible():
    controller = tracker(state_limits={"v": (-0.5, 0.5)})
    states, commands, z = fly(controller, np.array([0.0, 2.0]), 40)
    assert z[controller.memory.slice("qp_failed")] == 0
    assert np.allclose(commands[:14], -1.0)  # with all authority back to the limit
    assert np.max(np.abs(states[16:, 1])) <= 0.5 + 1e-9


def test_programmes_far_outside_soft_limits_are_solved():
    """They always have a solution, whose optimality is checked in the law."""
    rng = np.random.default_rng(4)
    for _ in range(3):
        slopes = rng.normal(size=(3, 3))
        slopes -= (np.max(np.linalg.eigvals(slopes).real) - 0.5) * np.eye(3)  # one mode grows
        model = go.Model("any")
        x, u = model.state("x", 3), model.control("u")
        model.ode({x: ca.DM(slopes) @ x + ca.DM(rng.normal(size=3)) * u})
        few = {"x": ([-0.3, -np.inf, -np.inf], [0.3, np.inf, np.inf])}
        task = {"Q": [2, 3, 0.5], "R": 0.3, "horizon": 5.0, "dt": 0.5, "limits": (-1, 1), "state_limits": few}
        controller = design_mpc(model, np.zeros(3), **task, state_penalty=1e5)
        for far in (1.0, 3.0, 10.0):
            _, z = controller(0.0, far * rng.normal(size=3))
            assert z[controller.memory.slice("qp_failed")] == 0


def test_upcoming_change_of_the_reference_is_anticipated():
    model = cart()
    step = Reference.from_functions(
        model, lambda t: [0, 0], lambda t: [0.0 if t < 1.0 else 0.9], 0, 2, jumps=[1.0], tail="hold"
    )
    controller = design_mpc(model, step, Q=1, R=1, horizon=1.5, dt=DT, limits=(-1, 1), rate_limits=2.0)
    u, _ = controller(0.8, [0, 0], np.r_[0.0, controller.initial_memory(0.8, [0, 0])[1:]])
    assert u[0] > 0.01  # the feedforward will jump by more than the rate allows: it begins before


def test_a_programme_that_is_not_solved_raises_the_alarm_and_gives_the_clipped_regulator(monkeypatch):
    import gnc_opt.control.mpc as module

    monkeypatch.setattr(module, "_DAQP", {"iter_limit": 1})
    controller = tracker(rate_limits=5.0)
    regulator = design_lqr(cart(), [0, 0], Q=1, R=1, dt=DT)
    x = np.array([3.0, 0.0])
    u, z = controller(0.0, x)
    alarm = controller.memory.slice("qp_failed")
    assert z[alarm] == 1
    assert u[0] == -0.5  # what limit and rate leave of the regulator's command
    near = np.array([0.3, 0.0])
    assert controller(0.0, near, np.r_[-0.3, z[1:]])[0] == pytest.approx(regulator(0.0, near)[0], abs=1e-6)
    assert controller.alarms == ("qp_failed", "invalid")


def test_refusals():
    with pytest.raises(ArgumentError, match=r"horizon of 0\.25 s is no whole number"):
        tracker(horizon=0.25)
    with pytest.raises(DesignError, match="'a' has no authority"):
        tracker(limits=(1, 1))
    with pytest.raises(DesignError, match="rate limit of control 'a' is 0"):
        tracker(rate_limits=0.0)
    with pytest.raises(DesignError, match="state 'v' are empty"):
        tracker(state_limits={"v": (1, -1)})
    for wrong, message in (
        ({"horizon": 1e4 * DT * 3}, "30000 steps of"),
        ({"limits": None}, "has no limits of the controls"),
        ({"limits": (-np.inf, 0.3)}, "are .*inf.*: give finite limits"),  # left out altogether
        ({"state_limits": {"v": 3}}, r"limits of state 'v' are 3: give \(lower, upper\)"),
        ({"state_limits": [1]}, "state_limits of design_mpc.. must be of type Mapping, not list"),
        ({"hard": "v", "state_limits": {"v": (-1, 1)}}, "hard of design_mpc.. is 'v': give a list"),
        ({"name": ""}, "cannot be the name of a controller"),
    ):
        with pytest.raises(ArgumentError, match=message):
            tracker(**wrong)
    angles, q, _w = dynamics("turning", "q", "w", lambda q, w: {q: w})
    angles.difference(q, lambda x, ref: ca.sin(x - ref))
    with pytest.raises(DesignError, match="error of state 'q' is not a difference"):
        design_mpc(
            angles, Reference.constant(angles, [0]), Q=1, R=1, horizon=1.0, dt=DT, limits=(-1, 1),
            state_limits={"q": (-1, 1)},
        )  # fmt: skip


def test_where_no_limit_is_met_no_solver_is_asked():
    """What a solver finds would differ in the last digits."""
    regulator = design_lqr(cart(), [0, 0], Q=1, R=1, dt=DT)
    controller = tracker(state_limits={"v": (-0.5, 0.5)}, rate_limits=50.0)
    x = np.array([0.2, -0.1])
    u, z = controller(0.0, x)
    assert u[0] == pytest.approx(regulator(0.0, x)[0][0], rel=1e-14)
    assert z[controller.memory.slice("qp_failed")] == 0


@pytest.mark.parametrize("along", [False, True])
def test_hard_limits_of_states_are_those_of_an_independent_optimisation(along):
    """Along a reference, too, where the dynamics change: the plan in controls alone, by SciPy."""
    model, reference = pendulum() if along else (cart(), Reference.constant(cart(), [0, 0]))
    steps, x_0, room = 6, reference.x(0.0) + np.array([0.9, 0.15]), 0.2
    bounds = (np.array([-9.0]), np.array([9.0]))
    limit = reference.x(0.0)[1] + np.array([-room, room]) if along else np.array([-room, room])
    far = np.array([limit[0], np.inf])
    controller = design_mpc(
        model, reference, Q=1, R=0.01, horizon=steps * DT, dt=DT, limits=bounds,
        state_limits={"v": tuple(far)}, hard=["v"],
    )  # fmt: skip
    gains = controller.schedule.windows.gains
    plants = [gains.steps[min(k, len(gains.steps) - 1)] for k in range(steps)]
    e_0 = go.control.ErrorDynamics(model)(x_0, reference.x(0.0))
    end = gains.costs[min(steps, len(gains.costs) - 1)]

    def errors(v):
        path = [e_0]
        for s, u in zip(plants, v, strict=True):
            path.append(s.a @ path[-1] + s.b[:, 0] * u)
        return path

    def cost(v):
        path = errors(v)
        total = path[-1] @ end @ path[-1]
        for s, e, u in zip(plants, path, v, strict=False):
            total += e @ s.q @ e + s.r[0, 0] * u**2 + 2 * (e @ s.n)[0] * u
        return total

    ends = reference.x(DT * np.arange(1, steps + 1))[1]
    kept = {"type": "ineq", "fun": lambda v: np.array([e[1] for e in errors(v)[1:]]) + ends - far[0]}
    best = minimize(
        cost, np.zeros(steps), constraints=kept, method="SLSQP", options={"ftol": 1e-12, "maxiter": 500}
    )
    assert best.success and np.min(kept["fun"](best.x)) < 1e-7  # the limit matters
    u, z = controller(0.0, x_0)
    feedforward = reference.mean_control(np.array([0.0]), DT)[0, 0]
    assert u[0] - feedforward == pytest.approx(best.x[0], abs=2e-5)
    assert z[controller.memory.slice("qp_failed")] == 0


def test_hard_limits_that_cannot_be_kept_raise_the_alarm_and_are_kept_otherwise():
    controller = tracker(state_limits={"v": (-0.5, 0.5)}, hard=["v"])
    assert fly(controller, np.array([0.0, 2.0]), 1)[2][controller.memory.slice("qp_failed")] == 1
    states, _, z = fly(controller, np.array([3.0, 0.0]), 150)
    assert z[controller.memory.slice("qp_failed")] == 0
    assert states[:, 1].min() == pytest.approx(-0.5, abs=1e-9)
    told = controller.explain()
    assert told["hard limits"] == "controls, v"
    soft = tracker(state_limits={"v": (-0.5, 0.5)}, rate_limits=1.0).explain()
    assert (soft["hard limits"], soft["soft limits"]) == ("controls, rates of controls", "v")
    with pytest.raises(UnknownNameError, match="'q'"):
        tracker(state_limits={"v": (-0.5, 0.5)}, hard=["q"])


def test_limits_that_exclude_the_feedforward_are_refused():
    with pytest.raises(
        DesignError, match=r"control 'a' needs 0 at t = 0 s, but its limits are 0\.1 and 0\.2"
    ):
        tracker(limits=(0.1, 0.2))


def axis() -> Model:
    model = Model("cart")
    q, v = model.state("q", unit="m"), model.state("v", unit="m/s")
    a = model.control("a", unit="N")
    model.ode({q: v, v: a})
    model.output("twice", 2 * q, unit="m")
    return model


def climbing(tail="hold"):
    return Reference.from_functions(axis(), lambda t: [t, 1.0], lambda t: [0.25], 0.0, 2.0, tail=tail)


def predictive(**changes):
    options = {"Q": [2.0, 1.0], "R": 0.5, "horizon": 0.6, "dt": 0.2, "limits": (-2.0, 3.0)} | changes
    return design_mpc(axis(), climbing(), **options)


def test_commands_within_limits_of_size_and_rate_are_those_of_the_programme():
    """Against a general solver on the same three steps, with the cost to go at their end."""
    law = predictive(limits=(-1.0, 1.5), rate_limits=3.0)
    a, b = discretize_zero_order_hold(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), 0.2)
    held = discretize_plant_and_cost(
        np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), np.diag([2.0, 1.0]), np.array([[0.5]]),
        np.zeros((2, 1)), 0.2,
    )  # fmt: skip
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
        cost, np.zeros(6), bounds=[(-1.0, 2.0), (-0.5, 0.5)] * 3, method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 300},
    )  # fmt: skip
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


# The active-set solver in C: its bound of operations, and the steps of its table.


def test_operations_of_a_programme_by_hand():
    """One control over two errors and one step: a sweep, there and back, is 2 * 3^2 products and 6 for 1 + 3 rows."""
    limits = StepLimits(np.full(1, -1.0), np.ones(1), None, (), (), np.zeros(0), np.zeros(0), np.zeros(0))
    code = QpCode(limits, np.zeros(0), (np.zeros((1, 2, 2)),) * 4, 1, 2)
    assert code.n_qp_variables == code.n_qp_constraints == 1
    sweep, tries = 2 * 3**2 + 6 * 4, programme_code._ITERATIONS_PER_UNKNOWN * 2
    row = 2 * sweep + 4
    assert code.max_operation_count == tries * (2 * sweep + 6 + 2 * 9 + row + 12) + 2 * 3
    assert code.max_stack_float_count == (3 + 5 * 2 + 1) + 4 + 6 * 2 + 4 + 3


def test_steps_have_their_number_in_the_table():
    """From 0 to the step in which the reference ends; times are what a clock tells, with its rounding."""
    row = _IndexedSchedule(lambda times, dt: np.zeros((1, times.size)), (1.0, 2.0))
    times = np.array([0.0, 1.0, 1.25 - 1e-9, 1.25, 1.49, 1.75, 2.0, 9.0])
    assert row(times, 0.25)[1].tolist() == [0, 0, 1, 1, 1, 3, 4, 4]
    assert row(np.array([1.9, 2.0, 3.0]), 0.3)[1].tolist() == [3, 3, 4]
    for span in (1.0 - 1e-12, 1.0 + 1e-12):
        assert _IndexedSchedule(row.reference, (0.0, span))(np.array([7.0]), 0.1)[1].tolist() == [10]
