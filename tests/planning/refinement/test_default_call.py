"""What solve() does where nobody says how: refine, judge and tell, but stay cheap where it is called in loops."""

from __future__ import annotations

import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go


def dash(limit: float = 1.0) -> go.Problem:
    """Return rest to rest over 1 m in minimum time, 2 / sqrt(limit)."""
    cart, *_ = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("dash", cart, initial=0.0, final=(0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-limit, limit))
    problem.minimize(leg.final_time)
    return problem


@pytest.fixture(scope="module")
def solution() -> go.Solution:
    """Three segments put no boundary on the switch at half time."""
    return go.solve(dash(), mesh="3x3")


def test_the_default_call_refines_and_judges(solution: go.Solution) -> None:
    history = solution.history
    assert history is not None and history.converged and history.tolerance == 1e-6
    assert solution.objective == pytest.approx(2.0, abs=1e-9)
    verdict = solution.verdict
    assert verdict is not None and verdict.minimum and go.verify(solution) is verdict


def test_the_lines_of_a_person_say_so(solution: go.Solution) -> None:
    lines = str(solution).splitlines()
    assert len(lines) == 7 and "refined (converged)" in lines[0]
    assert lines[1].split(maxsplit=1) == ["optimality", solution.verdict.headline]
    assert "tolerance 1e-06" in lines[4]


def test_an_explicit_mesh_is_where_refining_starts(solution: go.Solution) -> None:
    one_pass = go.solve(dash(), mesh="3x3", tol=None)
    assert one_pass.history is None and str(one_pass.phase().mesh) == "3x3"
    assert one_pass.objective > 2.0 + 1e-3  # no control of three pieces of degree 2 switches in the middle
    assert str(solution.phase().mesh) != "3x3"


def test_a_warm_solve_stays_on_the_mesh_of_its_guess_by_default(solution: go.Solution) -> None:
    start = go.solve(dash(), mesh="4x3", tol=None)
    again = go.solve(dash(1.01), guess=start)
    assert again.history is None and str(again.phase().mesh) == "4x3"
    asked = go.solve(dash(1.01), guess=start, tol=1e-6)
    assert asked.converged and asked.objective == pytest.approx(2.0 / 1.01**0.5, abs=1e-9)


@pytest.mark.parametrize("tol", [0.0, -1e-6, float("nan"), "tight", True])
def test_a_tolerance_that_is_none_is_refused_before_solving(tol: object) -> None:
    with pytest.raises(go.ArgumentError, match=r"the tolerance of solve\(\) is"):
        go.solve(dash(), tol=tol)  # type: ignore[arg-type]


def test_a_phase_without_controls_is_refined_and_checked() -> None:
    """The farthest throw from 2 m with 10 m/s: v sqrt(v^2 + 2 g h) / g."""
    ball = go.Model("ball")
    x, h = ball.state("x"), ball.state("h")
    vx, vh = ball.state("vx"), ball.state("vh")
    ball.ode({x: vx, h: vh, vx: 0.0, vh: -9.81})
    problem, flight = one_phase("throw", ball, initial=0.0, final=(0.1, 10.0), name="flight")
    flight.initial(x=0.0, h=2.0)
    flight.final(h=0.0)
    flight.bounds(vx=(0.0, 20.0), vh=(-20.0, 20.0))
    problem.constrain(
        "speed", flight.initial_state("vx") ** 2 + flight.initial_state("vh") ** 2, equals=100.0
    )
    problem.maximize(flight.final_state("x"))
    thrown = go.solve(problem, mesh="2x4")
    assert thrown.history is not None and thrown.history.converged and go.verify(thrown).ok
    assert thrown.objective == pytest.approx(10.0 * (100.0 + 2 * 9.81 * 2.0) ** 0.5 / 9.81, abs=1e-8)


@pytest.mark.parametrize("unit", [1.0, 7.3])
def test_limits_that_the_optimum_just_touches_are_no_arcs(unit: float) -> None:
    """From rest to rest over 1 m in 1 s with least effort: a = 6 - 12 t m/s2, with limits on a and x right there."""
    model, _x, _v, a = dynamics("double integrator", "x v", "a", lambda x, v, a: {x: v, v: a})
    problem, leg = one_phase("touched", model, initial=0.0, final=1.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=unit, v=0.0)
    leg.bounds(a=(-6.0 * unit, 6.0 * unit), x=(0.0, unit))
    problem.minimize(leg.integral(a**2))
    solution = go.solve(problem)
    assert solution.converged and go.verify(solution).ok
    assert solution.objective == pytest.approx(12.0 * unit**2, rel=1e-9)
    times = np.linspace(0.0, 1.0, 41)
    np.testing.assert_allclose(
        solution.phase("leg").applied(times)[0], unit * (6.0 - 12.0 * times), atol=1e-6 * unit
    )


@pytest.mark.slow
def test_a_bound_reached_before_the_first_point_is_resolved() -> None:
    """From rest to rest with least effort: a = A at first, then on a line to -A, for as long as A is reached.

    With the line c (1/2 - t) and arcs of length s = 1/2 - A / c: 1 = A / 4 - A^3 / (3 c^2).
    """
    limit = 6.0 * (1.0 - 1e-3)
    slope = np.sqrt(limit**3 / (3.0 * (limit / 4.0 - 1.0)))
    start = 0.5 - limit / slope
    problem = go.Problem("clipped")
    model, _x, _v, a = dynamics("double integrator", "x v", "a", lambda x, v, a: {x: v, v: a})
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=1.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    leg.bounds(a=(-limit, limit))
    problem.minimize(leg.integral(a**2))
    solution = go.solve(problem)
    assert solution.converged and go.verify(solution).ok
    effort = 2.0 * limit**2 * start + 2.0 * slope**2 * (0.5 - start) ** 3 / 3.0
    assert solution.objective == pytest.approx(effort, rel=1e-8)
