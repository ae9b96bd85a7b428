"""The estimated error of the objective against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.internals import PiecewisePolynomial
from testing.models import dynamics, one_phase

import gnc_opt as go

MESHES = ("20x4",)


def cart(acceleration: tuple[float, float] = (-np.inf, np.inf)) -> tuple[go.Problem, go.Phase, Any]:
    """Return a double integrator at rest at 0, without cost, and its acceleration."""
    model, _q, _v, a = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem = go.Problem("cart")
    leg = problem.phase("leg", model)
    leg.initial(q=0.0, v=0.0)
    leg.bounds(a=acceleration)
    return problem, leg, a


def least_time() -> go.Problem:
    """Over 3 m from rest to rest with -2.3 <= a <= 1 m/s^2: sqrt(2 * 3 * (1 + 1 / 2.3)) s, no switch on a boundary."""
    problem, leg, _ = cart((-2.3, 1.0))
    leg.time(initial=0.0, final=(0.1, 20.0))
    leg.final(q=3.0, v=0.0)
    problem.minimize(leg.final_time)
    return problem


def limited_height() -> go.Problem:
    """Bryson, Denham and Dreyfus (1963): from 1 to -1 m/s in 1 s with q <= l = 1/9 m, least effort 4 / (9 l)."""
    problem, leg, a = cart()
    leg.time(initial=0.0, final=1.0)
    leg.initial(q=0.0, v=1.0)
    leg.final(q=0.0, v=-1.0)
    leg.bounds(q=(-np.inf, 1.0 / 9.0))
    problem.minimize(leg.integral(a**2 / 2))
    return problem


def regulator(unit: float = 1.0) -> go.Problem:
    """x' = u from 1, cost of (x^2 + u^2) / 2 over 40 s in some unit; a negative one is maximised."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("regulator", model, initial=0.0, final=40.0)
    leg.initial(x=1.0)
    (problem.minimize if unit > 0 else problem.maximize)(unit * leg.integral((x**2 + u**2) / 2))
    return problem


def brachistochrone() -> go.Problem:
    """From rest to x = 1 at free depth under g = 1: least time sqrt(pi)."""
    model = go.Model("bead")
    x, y, v, angle = model.state("x"), model.state("y"), model.state("v"), model.control("angle")
    model.ode({x: v * ca.sin(angle), y: v * ca.cos(angle), v: ca.cos(angle)})
    problem, leg = one_phase("brachistochrone", model, initial=0.0, final=(0.1, 10.0))
    leg.initial(x=0.0, y=0.0, v=0.0)
    leg.final(x=1.0)
    problem.minimize(leg.final_time)
    return problem


def least_fuel() -> go.Problem:
    """Over 1 m from rest to rest in 3 s with |a| <= 1: |a| over 2 * 1 (3 - sqrt(9 - 4)) / 2 = 0.7639320 s."""
    problem, leg, a = cart((-1.0, 1.0))
    leg.time(initial=0.0, final=3.0)
    leg.final(q=1.0, v=0.0)
    problem.minimize(leg.integral(ca.fabs(a)))
    return problem


CASES: list[tuple[Callable[[], go.Problem], float]] = [
    (least_time, np.sqrt(6.0 * 3.3 / 2.3)),
    (limited_height, 4.0),
    (brachistochrone, np.sqrt(np.pi)),
    (least_fuel, 3.0 - np.sqrt(5.0)),
]


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize(("problem", "exact"), CASES)
def test_error_is_estimated(problem: Callable[[], go.Problem], exact: float, mesh: str) -> None:
    """Between a third of the true error and sixty times as much, rounding of the solver apart."""
    solution = go.solve(problem(), mesh=mesh, tol=None, options=go.SolverOptions(tolerance=1e-12))
    found, error = solution.objective_error, abs(solution.objective - exact)
    assert error / 3 - 1e-9 * exact <= found.absolute_error <= 60 * error + 1e-9 * exact
    assert found.relative_error == pytest.approx(found.absolute_error / solution.objective)


def fishing() -> go.Problem:
    """Lotka-Volterra fishing (Sager 2005): full effort, then a singular arc; least deviation 1.3440812."""
    model, x, y, _u = dynamics(
        "fish", "x y", "u", lambda x, y, u: {x: x * (1.0 - y - 0.4 * u), y: y * (x - 1.0 - 0.2 * u)}
    )
    problem, leg = one_phase("fishing", model, initial=0.0, final=12.0)
    leg.initial(x=0.5, y=0.7)
    leg.bounds(u=(0.0, 1.0))
    problem.minimize(leg.integral((x - 1.0) ** 2 + (y - 1.0) ** 2))
    return problem


def test_gains_within_bounds_and_losses_beyond_them_do_not_cancel() -> None:
    """The control polynomial of a segment with a switch inside has a net gain of an eighth of the true error."""
    solution = go.solve(fishing(), mesh="60x4", tol=None)
    error = abs(solution.objective - 1.3440812)
    assert error / 2 <= solution.objective_error.absolute_error <= 2 * error


def ramp(excess: float) -> go.Solution:
    """From 0 to 1 in 1 s by u = 1 + excess (1 - 2 t), exact along its path, with the costate -1 of the optimum."""
    model, _x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("ramp", model, initial=0.0, final=1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    problem.minimize(leg.integral(u**2 / 2))
    solution = go.solve(problem, mesh="1x3", tol=None, options=go.SolverOptions(tolerance=1e-12))
    found = solution.phase()

    def moved(old: PiecewisePolynomial, by: Callable[[np.ndarray], np.ndarray]) -> PiecewisePolynomial:
        times = 0.5 * (1 + old.nodes[0])
        return PiecewisePolynomial(old.breaks, old.nodes, (old.values[0] + excess * by(times),))

    changed = replace(found, x=moved(found.x, lambda t: t - t**2), u=moved(found.u, lambda t: 1 - 2 * t))
    return replace(solution, phases={"leg": changed}, objective=0.5 + excess**2 / 6)


@pytest.mark.parametrize("excess", [0.3, -1e-2])
def test_suboptimal_control_costs_what_it_costs(excess: float) -> None:
    """The cost is (1 + excess^2 / 3) / 2 in the place of 1/2: H is quadratic, so that the estimate is exact."""
    found = ramp(excess).objective_error
    assert found.absolute_error == pytest.approx(excess**2 / 6, rel=1e-6)
    assert found.suboptimality == pytest.approx(found.absolute_error, rel=1e-6)


def test_defect_is_weighted_with_the_costate() -> None:
    """A path that moves by 0.2 t^2 against its control misses 0.2 m at its end, at 1 per metre."""
    solution = ramp(0.0)
    leg = solution.phase()
    times = 0.5 * (1 + leg.x.nodes[0])
    bent = PiecewisePolynomial(leg.breaks, leg.x.nodes, (leg.x.values[0] + 0.2 * times**2,))
    moved = replace(solution, phases={"leg": replace(leg, x=bent)})
    assert moved.objective_error.infeasibility == pytest.approx(0.2, rel=1e-6)


def test_estimate_has_the_unit_of_the_objective() -> None:
    """Cost times 1000 and maximised with the opposite sign: 1000 times the error, the same share."""
    options = go.SolverOptions(tolerance=1e-12)
    one, other = (
        go.solve(regulator(unit), mesh="20x3", tol=None, options=options) for unit in (1.0, -1000.0)
    )
    assert other.objective == pytest.approx(-1000.0 * one.objective)
    assert other.objective_error.absolute_error == pytest.approx(
        1000.0 * one.objective_error.absolute_error, rel=1e-4
    )
    assert other.objective_error.relative_error == pytest.approx(one.objective_error.relative_error, rel=1e-4)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_multiplier_of_the_wrong_sign_gains_nothing(sign: float) -> None:
    """u = 1/2 has no error; a density of -1 (upper limit) or 1 (lower limit) of u^2 <= 1, not active, adds none."""
    model, _x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("disc", model, initial=0.0, final=1.0)
    leg.initial(x=0.0)
    leg.final(x=0.5)
    leg.path("disc", sign * u**2, **{"upper" if sign > 0 else "lower": sign})
    problem.minimize(leg.integral(u**2 / 2))
    solution = go.solve(problem, mesh="2x3", tol=None, options=go.SolverOptions(tolerance=1e-11))
    wrong = np.full_like(solution.phase().path_multipliers, -sign)
    found = replace(
        solution, phases={"leg": replace(solution.phase(), path_multipliers=wrong)}
    ).objective_error
    assert found.suboptimality == pytest.approx(0.0, abs=1e-9)
