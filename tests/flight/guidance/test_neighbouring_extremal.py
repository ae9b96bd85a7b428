"""Neighbouring-extremal feedback against closed forms, Riccati equations, problems solved again; what is refused."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.c_compiler import compiled, needs_compiler, python, run
from testing.internals import SmoothPlan, conjugate_time, feedback
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.control import export_c
from gnc_opt.errors import ArgumentError, DesignError
from gnc_opt.guidance import design_neighbouring_extremal
from gnc_opt.simulation import ClosedLoop

DT = 0.01


def mass():
    model, *_ = dynamics("mass", "q v", "a", lambda q, v, a: {q: v, v: a})
    return model


def stated(model, cost, time=(0.5, 20.0), end=None, start=(4.0, 0.5), **bounds):
    """A problem with the states q and v, from a start to an end with the least cost(leg, model)."""
    problem, leg = one_phase("plan", model, initial=0.0, final=time, name="p")
    leg.initial(q=start[0], v=start[1])
    if end is not None:
        leg.final(**end)
    if bounds:
        leg.bounds(**bounds)
    problem.minimize(cost(leg, model))
    return problem


REST = {"q": 0.0, "v": 0.0}


def effort_and_time(leg, model):
    return leg.final_time + leg.integral(0.5 * model.symbol("a") ** 2)


@pytest.fixture(scope="module")
def straight():
    """Least time and effort of a double integrator to rest, the end free."""
    return go.solve(stated(mass(), effort_and_time, end=REST))


def best(q, v):
    """Its optimal control and time to go in closed form: a = -6 q / T^2 - 4 v / T with the best T."""
    T = scipy.optimize.brentq(
        lambda T: 1 - 0.5 * (36 * q * q / T**4 + 24 * q * v / T**3 + 4 * v * v / T**2), 0.3, 20, xtol=1e-14
    )
    return np.array([-6 * q / T**2 - 4 * v / T, T])


# --- the feedback -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def controller(straight):
    return design_neighbouring_extremal(straight, last=0.3, dt=DT)


@pytest.mark.parametrize("t", [0.0, 1.3, 3.0])
def test_double_integrator_with_a_free_end(straight, controller, t):
    x, d = straight.phase().x(t), 1e-5
    slopes = np.stack([(best(*(x + e)) - best(*(x - e))) / (2 * d) for e in d * np.eye(2)], axis=1)
    row = controller.signal(t, DT)
    assert -row[controller.signals.slice("K")] == pytest.approx(slopes[0], rel=1e-6, abs=1e-7)
    assert row[controller.signals.slice("end_gain")] == pytest.approx(slopes[1], rel=1e-6)
    assert controller(t, x)[1][0] == pytest.approx(straight.phase().final_time, abs=1e-9)


def test_a_given_time_and_a_cost_of_the_end_is_the_regulator_of_riccati():
    model = mass()
    problem = stated(
        model,
        lambda leg, m: (
            leg.integral(0.5 * m.symbol("a") ** 2 + 2 * m.symbol("q") ** 2)
            + 1.5 * leg.final_state("q") ** 2
            + 0.5 * leg.final_state("v") ** 2
        ),
        time=2.0,
    )
    found = feedback(SmoothPlan.of(go.solve(problem)), 1e-3)
    A, B, Q = np.array([[0.0, 1], [0, 0]]), np.array([[0.0], [1]]), np.diag([4.0, 0.0])

    def rate(t, s):
        S = s.reshape(2, 2)
        return -(S @ A + A.T @ S - S @ B @ B.T @ S + Q).ravel()

    backward = scipy.integrate.solve_ivp(
        rate, (2.0, 0.0), np.diag([3.0, 1.0]).ravel(), rtol=1e-11, atol=1e-12, dense_output=True
    )
    expected = backward.sol(found.times).T.reshape(-1, 2, 2)
    assert found.cost == pytest.approx(expected, abs=1e-7)
    assert found.gain[:, 0] == pytest.approx(expected[:, 1], abs=1e-7)
    assert not found.end_gain.any()


def test_neighbours_solved_again_agree_to_second_order():
    """A pendulum in wind that changes with time, the end free: half the deviation, a quarter of the error."""

    def problem(off):
        model = go.Model("pendulum")
        q, v, a = model.state("q"), model.state("v"), model.control("a")
        model.ode({q: v, v: a - ca.sin(q) + 0.3 * ca.sin(model.time)})
        return stated(
            model,
            lambda leg, m: (
                0.3 * leg.final_time + leg.integral(0.5 * m.symbol("a") ** 2 + 0.1 * m.symbol("q") ** 2)
            ),
            end=REST,
            start=(2.0 + off, -0.5 * off),
        )

    plan = go.solve(problem(0.0), tol=1e-9)
    controller = design_neighbouring_extremal(plan, last=0.2)
    errors = []
    for off in (0.1, 0.05):
        again = go.solve(problem(off), tol=1e-9, guess=plan).phase()
        u, z = controller(0.0, [2.0 + off, -0.5 * off], dt=1e-6)
        moved = np.abs([again.u(0.0)[0] - plan.phase().u(0.0)[0], again.final_time - plan.phase().final_time])
        errors.append(np.array([u[0] - again.u(0.0)[0], z[0] - again.final_time]))
        assert np.all(np.abs(errors[-1]) < 0.2 * moved)
    assert errors[0] / errors[1] == pytest.approx([4.0, 4.0], rel=0.15)


def test_the_end_moves_at_first_as_it_is_told(straight, controller):
    """By deviations of the start, each alone: central differences of the closed form."""
    told = controller.explain()["end by deviation"]
    step = 1e-4
    for i, off in enumerate(step * np.eye(2)):
        q, v = np.array([4.0, 0.5]) + off, np.array([4.0, 0.5]) - off
        assert told[i] == pytest.approx((best(*q)[1] - best(*v)[1]) / (2 * step), rel=1e-4)


def test_a_guided_flight_ends_where_the_plan_ends(straight, controller):
    guided, open_ = (
        ClosedLoop(mass(), law, dt=DT).simulate([4.3, 0.3], tf=straight.phase().final_time)
        for law in (controller, go.feedforward(go.Reference(straight, tail="hold")))
    )
    assert guided.miss("q") < 0.02 * open_.miss("q")
    assert guided.controller_state("final_time")(0.0)[0] == pytest.approx(best(4.3, 0.3)[1], abs=0.02)


@needs_compiler
def test_flight_code_is_the_same_law(straight, controller, tmp_path):
    program = compiled(export_c(controller, tmp_path / "flight"))
    times = DT * np.arange(60)
    states = straight.phase().x(times).T + np.array([0.1, -0.05])
    expected = python(controller, times, states, DT)
    assert np.ptp(expected) > 0.1
    assert np.allclose(run(program, times, states), expected, rtol=1e-10, atol=1e-10)


# --- the second-order condition -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("frequencies", "last"), [((1.0,), 4 - np.pi), ((1.0, 1.0), 4 - np.pi), ((0.5,), None)]
)
def test_conjugate_times_of_oscillators(frequencies, last):
    times = np.linspace(0.0, 4.0, 801)
    angles = np.array([w * (4.0 - times) for w in frequencies])
    X, Lam = (np.stack([np.diag(f(a)) for a in angles.T]) for f in (np.sin, np.cos))
    found = conjugate_time(times, X, Lam)
    assert found == (None if last is None else pytest.approx(last, abs=0.01))


def test_a_plan_beyond_its_conjugate_time_is_refused():
    """Of x' = u with the cost (u^2 - k x^2) / 2 between given ends, rest is a minimum for less than pi / k^0.5."""
    model = go.Model("unit")
    x, u, k = model.state("x"), model.control("u"), model.parameter("k", 0.25)
    model.ode({x: u})
    problem, leg = one_phase("oscillator", model, initial=0.0, final=4.0, name="p")
    leg.initial(x=0.0)
    leg.final(x=0.0)
    problem.minimize(leg.integral(0.5 * (u**2 - k * x**2)))
    plan = go.solve(problem, mesh="4x6", tol=None)
    row = design_neighbouring_extremal(plan, last=0.5).signal(1.0, DT)
    assert row[2] == pytest.approx(0.5 / np.tan(0.5 * 3.0), rel=1e-6)
    stiff = replace(
        plan, phases={"p": replace(plan.phase(), parameters=np.array([1.0]))}
    )  # rest is stationary, too
    with pytest.raises(DesignError, match=r"0\.8\d* s is conjugate to its end"):
        design_neighbouring_extremal(stiff, last=0.5)


def test_a_hamiltonian_that_is_flat_in_a_control_is_refused():
    model, *_ = dynamics("two pushes", "q v", "a b", lambda q, v, a, b: {q: v, v: a + b})
    problem = stated(
        model, lambda leg, m: leg.integral((m.symbol("a") + m.symbol("b")) ** 2), time=2.0, end=REST
    )
    with pytest.raises(DesignError, match="not strictly convex in its controls"):
        design_neighbouring_extremal(go.solve(problem, tol=None, mesh="4x4"), last=0.2)


# --- what else is refused -----------------------------------------------------------------------------------


def test_a_control_on_its_limit_is_refused():
    problem = stated(mass(), effort_and_time, end=REST, a=(-0.8, 0.8))
    with pytest.raises(DesignError, match="'a' of the plan 'plan' is on its limit"):
        design_neighbouring_extremal(go.solve(problem, tol=None), last=0.2)


def test_a_state_that_no_control_moves_is_refused():
    own, _q, _v, _c, a = dynamics("mass and more", "q v c", "a", lambda q, v, c, a: {q: v, v: a, c: 0 * c})
    problem, leg = one_phase("plan", own, initial=0.0, final=2.0, name="p")
    leg.initial(q=1.0, v=0.0, c=1.0)
    leg.final(q=0.0, v=0.0, c=1.0)
    problem.minimize(leg.integral(a**2))
    plan = go.solve(problem, tol=None, mesh="4x4")
    with pytest.raises(DesignError, match="do not move all of its states"):
        design_neighbouring_extremal(plan, last=0.2)


def test_numbers_that_cannot_be_meant_are_refused(straight):
    for last, words in ((0.0, "is 0"), (9.0, "is no part of a flight of 4.48"), (float("nan"), "last part")):
        with pytest.raises(ArgumentError, match=words):
            design_neighbouring_extremal(straight, last=last)
    with pytest.raises(ArgumentError, match="control step"):
        design_neighbouring_extremal(straight, last=0.2, dt=-1.0)
    with pytest.raises(ArgumentError, match="give a refined Solution"):
        design_neighbouring_extremal(None, last=0.2)
