"""Accuracy in the user's units: against SciPy's integration, closed forms and known optima."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from testing.models import one_phase

import gnc_opt as go


def cart(limit: float | None = None) -> go.Problem:
    """Rest to rest over 1 m in 1 s with the least effort (12), perhaps below a speed."""
    model = go.Model("cart")
    q, v, a = model.state("q", unit="m"), model.state("v", unit="m/s"), model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    problem, leg = one_phase("cart", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    if limit is not None:
        leg.path("speed", v, upper=limit)
    problem.minimize(leg.integral(a**2))
    return problem


def minimum_time(load: float | None = None) -> go.Problem:
    """Rest to rest over 1 m at 1 m/s^2 at most: 2 s, switching at 1 s; perhaps with a limit of a + v / 5."""
    model = go.Model("cart")
    q, v, a = model.state("q", unit="m"), model.state("v", unit="m/s"), model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    timed = go.Problem("minimum time")
    leg = timed.phase("leg", model)
    leg.time(0.0, (0.1, 10.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    if load is not None:
        leg.path("load", a + 0.2 * v, upper=load)
    timed.minimize(leg.final_time)
    return timed


def flown(solution: go.Solution, times: np.ndarray) -> np.ndarray:
    """States of the applied control by SciPy, restarted at its jumps."""
    leg, x, found = solution.phase(), np.zeros(2), []
    knots = np.union1d(leg.applied.jump_times, times[[0, -1]])
    for left, right in itertools.pairwise(knots):

        def rate(t: float, y: np.ndarray, left: float = left, right: float = right) -> list[float]:
            inside = np.clip(t, left + 1e-9 * (right - left), right - 1e-9 * (right - left))
            return [y[1], float(leg.applied(inside)[0])]

        within = times[(times >= left) & (times < right)]
        run = solve_ivp(rate, (left, right), x, t_eval=[*within, right], rtol=1e-10, atol=1e-12)
        found.append(run.y[:, :-1])
        x = run.y[:, -1]
    return np.hstack([*found, x[:, None]])[:, : times.size]


def test_a_refined_answer_is_accurate_to_rounding() -> None:
    accuracy = go.solve(minimum_time()).accuracy
    assert accuracy.objective == pytest.approx(2.0, abs=1e-9)
    assert accuracy.objective_error < 1e-9 and accuracy.miss < 1e-10 and accuracy.violation == 0.0
    assert str(accuracy).endswith("limits satisfied")


def test_the_stated_error_of_the_objective_is_not_below_rounding() -> None:
    solution = go.solve(minimum_time())
    rounding = 5 * np.finfo(float).eps * solution.objective
    assert solution.objective_error.absolute_error < 2 * rounding
    assert solution.accuracy.objective_error == max(rounding, solution.objective_error.absolute_error)


@pytest.mark.parametrize("mesh", ["5x3", "9x3"])
def test_the_miss_is_that_of_another_integrator(mesh: str) -> None:
    """A mesh boundary is not at the switch: the applied control misses the end."""
    solution = go.solve(minimum_time(), mesh=mesh, tol=None)
    end = flown(solution, np.array([0.0, solution.phase().final_time]))[:, -1]
    accuracy = solution.accuracy
    row = ("q", "v").index(accuracy.miss_where.rpartition(", ")[2].partition(" ")[0])
    assert accuracy.miss > 1e-5
    assert accuracy.miss == pytest.approx(abs(end[row] - [1.0, 0.0][row]), rel=1e-2)


def test_the_miss_is_the_distance_to_the_required_final_state() -> None:
    solution = go.solve(cart(), mesh="2x4", tol=None)
    leg = solution.phase()
    moved = replace(
        leg.final_bounds, lower=leg.final_bounds.lower - 1e-3, upper=leg.final_bounds.upper - 1e-3
    )
    off = replace(solution, phases={leg.name: replace(leg, final_bounds=moved)})
    assert off.accuracy.miss == pytest.approx(1e-3, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("mesh", ["5x4"])
def test_the_violation_is_that_along_another_integration(mesh: str) -> None:
    """The speed is limited at the nodes, and exceeds the limit between them."""
    solution = go.solve(cart(limit=1.2), mesh=mesh, tol=None)
    speed = flown(solution, np.linspace(0.0, 1.0, 501))[1]
    accuracy = solution.accuracy
    assert accuracy.violation == pytest.approx(np.max(speed) - 1.2, rel=1e-2)
    assert accuracy.violation > 1e-5 and "speed" in accuracy.violation_where


def test_the_objective_is_within_its_estimated_error() -> None:
    for mesh in ("5x3", "11x3"):
        solution = go.solve(minimum_time(), mesh=mesh, tol=None)
        assert abs(solution.objective - 2.0) < 2 * solution.accuracy.objective_error


def turning() -> go.Problem:
    """A direction (c, s) on the unit circle, as a norm constraint of two controls."""
    model = go.Model("direction")
    x, y = model.state("x"), model.state("y")
    c, s = model.control("c"), model.control("s")
    model.ode({x: c * (1 + x), y: s})
    problem = go.Problem("direction")
    leg = problem.phase("leg", model)
    leg.time(0.0, 3.0)
    leg.initial(x=0.0, y=0.0)
    leg.final(y=0.5)
    leg.bounds(c=(-1.0, 1.0), s=(-1.0, 1.0))
    leg.path("unit", c**2 + s**2, equals=1.0)
    leg.guess(c=1.0, s=0.0)
    problem.minimize(-leg.final_state("x"))
    return problem


@pytest.mark.slow
def test_a_violation_within_a_held_cell_is_found() -> None:
    """The control is constant over cells of a segment, so that a limit of a + v / 5 is exceeded most at their edges."""
    solution = go.solve(minimum_time(load=1.1), mesh="5x3", tol=None)
    edges = solution.phase().applied.jump_times
    assert edges.size > 6, "no cells"
    inside = np.concatenate([np.linspace(a, b, 202)[1:-1] for a, b in itertools.pairwise(edges)])
    loads = solution.phase().applied(inside)[0] + 0.2 * flown(solution, inside)[1]
    assert solution.accuracy.violation == pytest.approx(np.max(loads) - 1.1, rel=2e-2)


@pytest.mark.slow
def test_errors_of_equations_cancel_within_a_segment() -> None:
    """A norm of interpolated directions is off in both directions; the objective is off by far less."""
    best = go.solve(turning(), tol=1e-9, check=False).objective
    solution = go.solve(turning(), mesh="6x3", tol=None)
    true = abs(solution.objective - best)
    assert 0.5 * true <= solution.objective_error.absolute_error <= 3 * true
