"""What violations are measured against: what the flight moves, not how far away the origin or the cost's zero are."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from testing.wrong_solutions import added, double_integrator, failed, scaled, shifted, with_leg

import gnc_opt as go
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.solution.samples import PhaseSamples

Q, V, A = 0, 1, 0


@cache
def soft_end(origin: float) -> go.Solution:
    """Least a^2 / 2 and (q_f - origin - 1)^2 / 2, from rest at the origin to rest in 1 s: q moves by 1/13 m."""
    model = double_integrator()
    problem = go.Problem("soft end")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=origin, v=0.0)
    leg.final(v=0.0)
    aim = leg.final_state("q") - origin - 1
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2) + 0.5 * aim**2)
    return go.solve(problem, mesh="2x5", options=go.SolverOptions(tolerance=1e-11), tol=None)


@pytest.mark.parametrize("origin", [0.0, 7e6])
def test_soft_end_far_from_the_origin(origin: float) -> None:
    """Costates of a flight of 8 cm are not worth what 7000 km of it would be."""
    right = soft_end(origin)
    assert right.objective == pytest.approx(6 / 13, rel=1e-6)
    assert go.verify(right).ok, go.verify(right).explain()
    for wrong in (added(right, "u", A, 2.0), scaled(right, "lam", 1.01), added(right, "lam", Q, 0.01)):
        assert failed(wrong) & {"stationarity"}


def test_constant_in_the_running_cost() -> None:
    """At a given final time it means nothing, and hides nothing."""
    found = []
    for constant in (0.0, 1e6, -1e6):
        model = double_integrator()
        problem = go.Problem("constant")
        leg = problem.phase("leg", model)
        leg.time(0.0, 1.0)
        leg.initial(q=0.0, v=0.0)
        leg.final(q=1.0, v=0.0)
        problem.minimize(leg.integral(0.5 * model.symbol("a") ** 2 + constant))
        right = go.solve(problem, mesh="2x5", tol=None)
        assert go.verify(right).ok, go.verify(right).explain()
        assert {"stationarity", "cost"} <= failed(scaled(right, "u", 1.05))
        found.append(go.verify(scaled(right, "lam", 1.001))["stationarity"].value)
    assert found[0] > 1e-4
    np.testing.assert_allclose(found, found[0], rtol=0.02)


def test_ends_are_missed_in_shares_of_the_flight() -> None:
    found = []
    for reach in (1e-6, 1.0, 1e6):
        model = double_integrator()
        problem = go.Problem("short")
        leg = problem.phase("leg", model)
        leg.time(0.0, 1.0)
        leg.initial(q=0.0, v=0.0)
        leg.final(q=reach, v=0.0)
        problem.minimize(0.5 * leg.integral((model.symbol("a") / reach) ** 2))
        right = go.solve(problem, mesh="1x5", tol=None)
        assert go.verify(right).ok, go.verify(right).explain()
        off = with_leg(right, final_bounds=Interval(np.array([2 * reach, 0.0]), np.array([2 * reach, 0.0])))
        condition = go.verify(off)["boundary conditions"]
        found.append(condition.value)
        assert re.search(rf"q off by {reach:.3g}( m)?$".replace("+", r"\+"), condition.where)
    assert 0.5 < found[0] < 5.0
    np.testing.assert_allclose(found, found[0], rtol=1e-5)


@cache
def orbit() -> go.Solution:
    """A quarter of a low circular orbit in inertial axes, and 500 m farther along it, with the least thrust^2."""
    mu, radius = 3.986004418e14, 7e6
    rate = np.sqrt(mu / radius**3)
    model = go.Model("satellite")
    r, v, a = model.state("r", 2), model.state("v", 2), model.control("a", 2)
    model.ode({r: v, v: -mu * r / ca.sumsqr(r) ** 1.5 + a})
    problem = go.Problem("along the orbit")
    leg = problem.phase("leg", model)
    leg.time(0.0, 0.5 * np.pi / rate)
    leg.initial(r=[radius, 0.0], v=[0.0, rate * radius])
    ahead = 0.5 * np.pi + 500.0 / radius
    leg.final(
        r=[radius * np.cos(ahead), radius * np.sin(ahead)],
        v=[-rate * radius * np.sin(ahead), rate * radius * np.cos(ahead)],
    )
    problem.minimize(0.5 * leg.integral(ca.sumsqr(a)))
    return go.solve(problem, mesh="6x8", options=go.SolverOptions(tolerance=1e-11), tol=None)


def test_end_in_inertial_axes_is_missed_in_shares_of_what_thrust_moves() -> None:
    """The orbit moves the satellite by 7000 km, its thrust by 500 m: 60 m are a large miss."""
    right = orbit()
    assert go.verify(right).ok, go.verify(right).explain()
    off = with_leg(right, final_bounds=shifted(right.phase().final_bounds, np.array([0.0, 60.0, 0.0, 0.0])))  # type: ignore[arg-type]
    condition = go.verify(off)["boundary conditions"]
    assert condition.result is go.ConditionResult.FAIL and condition.value > 5e-4
    assert "off by 60" in condition.where


def test_thrust_that_is_small_beside_gravity_is_judged_by_itself() -> None:
    """lam . g is far larger than what thrust does to H; a thrust 1 % off shows all the same."""
    assert "stationarity" in failed(scaled(orbit(), "u", 1.01))
    assert "stationarity" in failed(scaled(orbit(), "lam", 1 + 1e-4))


def test_control_that_is_worth_little_beside_another_is_judged() -> None:
    """L = F^2 + tau^2 with F ~ 20 N and tau ~ 0.1 N m: tau is worth 2.5e-5 of it, and 20 % off is wrong.

    That is 5e-7 of the cost; less than 3e-7 of it is not told from errors of a solver's multipliers.
    """
    model = go.Model("two axes")
    x, y = model.state("x"), model.state("y")
    force, torque = model.control("F"), model.control("tau")
    model.ode({x: force, y: torque})
    problem = go.Problem("two axes")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0, y=0.0)
    leg.final(x=20.0, y=0.1)
    problem.minimize(leg.integral(force**2 + torque**2))
    right = go.solve(problem, mesh="2x4", options=go.SolverOptions(tolerance=1e-11), tol=None)
    assert go.verify(right).ok, go.verify(right).explain()
    assert "stationarity" in failed(added(right, "u", 1, 0.02))


def spans(solution: go.Solution) -> PhaseSamples:
    leg = solution.phase()
    return PhaseSamples.of(leg, solution.functions(leg.name))


def test_states_that_do_not_move_are_measured_by_what_could_move_them() -> None:
    """Flight along x; along y nothing happens, but thrust could move it by u T and u T^2."""
    model = go.Model("plane")
    x, y, vx, vy = (model.state(name) for name in ("x", "y", "vx", "vy"))
    still = model.state("still")
    ax, ay = model.control("ax"), model.control("ay")
    model.ode({x: vx, y: vy, vx: ax, vy: ay, still: 0 * ax})
    problem = go.Problem("along x")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    leg.initial(x=0.0, y=5.0, vx=0.0, vy=0.0, still=3.0)
    leg.final(x=1.0, y=5.0, vx=0.0, vy=0.0)
    leg.bounds(ax=(-3.0, 3.0), ay=(-2.0, 2.0))
    problem.minimize(0.5 * leg.integral(ax**2 + ay**2))
    solution = go.solve(problem, mesh="2x5", tol=None)
    scale = spans(solution).state_scale
    assert scale == pytest.approx([1.0, 4.0 * 4.0, 0.75, 4.0 * 2.0, 3e-7], rel=1e-6)
    assert go.verify(solution).ok, go.verify(solution).explain()
    assert "boundary conditions" in failed(
        with_leg(solution, final_bounds=replace_row(solution.phase().final_bounds, 1, 5.001))
    )


def replace_row(box: Interval, row: int, value: float) -> Interval:
    lower, upper = box.lower.copy(), box.upper.copy()
    lower[row] = upper[row] = value
    return replace(box, lower=lower, upper=upper)


@pytest.mark.parametrize("horizon", [100.0, 1e4, 1e5])
def test_a_state_that_waits_is_not_measured_by_what_controls_could_do_meanwhile(horizon: float) -> None:
    """Least x^2 + u^2 by x' = u from 1 to 1.5: some seconds of decay, a long rest, some seconds of growth."""
    model = go.Model("waiting")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("waiting")
    leg = problem.phase("leg", model)
    leg.time(0.0, horizon)
    leg.initial(x=1.0)
    leg.final(x=1.5)
    problem.minimize(leg.integral(x**2 + u**2))
    ends = np.array([0.0, 1.0, 3.0, 7.0, 15.0, 35.0]) / horizon
    mesh = go.Mesh(np.concatenate([ends, 1.0 - ends[::-1]]), (12,) * 11)
    right = go.solve(problem, mesh=mesh, tol=None)
    assert right.objective == pytest.approx(1.0 + 1.5**2, rel=1e-5)
    assert right.samples()["leg"].state_scale == pytest.approx([1.0], rel=0.01)  # down to zero, and up again
    assert go.verify(right).ok, go.verify(right).explain()
    assert "dynamics" in failed(added(right, "u", 0, 1e-3, segment=0))


@pytest.mark.parametrize("rounding", [1e-12, 1e-8])
def test_a_rounded_kink_is_worth_no_more_than_the_kink(rounding: float) -> None:
    """Rest to rest over 1 in 3 s for the least fuel: with 0.8 of the thrust for longer it takes more.

    Beside the coast sqrt(a^2 + e^2) curves as 1 / e, by which violations elsewhere were measured: it was ok.
    """
    model = go.Model("cart")
    q, v, a = model.state("q", 2), model.state("v", 2), model.control("a", 2)
    model.ode({q: v, v: a})
    problem = go.Problem("fuel")
    leg = problem.phase("leg", model)
    leg.time(0.0, 3.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=[1.0, 0.0], v=0.0)
    leg.path("limit", ca.sumsqr(a), upper=1.0)
    problem.minimize(leg.integral(ca.sqrt(ca.sumsqr(a) + rounding)))
    t = np.concatenate([np.linspace(*ends, 21) for ends in ((0.0, 0.5), (0.5, 2.5), (2.5, 3.0))])
    arc, left = np.repeat([0, 1, 2], 21), 3.0 - t
    way = np.choose(arc, [0.4 * t**2, 0.4 * t - 0.1, 1 - 0.4 * left**2])
    speed = np.choose(arc, [0.8 * t, 0 * t + 0.4, 0.8 * left])
    push = np.choose(arc, [0.8, 0.0, -0.8])
    none = 0 * t
    verdict = go.verify_trajectory(problem, t, {"q": [way, none], "v": [speed, none]}, {"a": [push, none]})
    assert {"stationarity", "minimum principle"} <= {c.name for c in verdict.failed}, verdict.explain()
