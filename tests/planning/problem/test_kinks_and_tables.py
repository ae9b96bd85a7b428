"""Kinks beside bounds, states and tables: where they are restated, where they stay, and closed forms."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.internals import reformulate_problem
from testing.models import dynamics, one_phase

import gnc_opt as go


@pytest.mark.parametrize("final", [None, 0.0, 0.5])
def test_signs_that_are_only_presumed_leave_no_kink_of_a_state(final: float | None) -> None:
    """A state without bounds that starts and ends at zero or above may be below it in between."""
    model, x, _a = dynamics("cart", "x", "a", lambda x, a: {x: a})
    problem, leg = one_phase("L1 regulation", model, initial=0.0, final=3.0)
    leg.initial(x=1.0)
    leg.bounds(a=(-1.0, 1.0))
    if final is not None:
        leg.final(x=final)
    problem.minimize(leg.integral(ca.fabs(x)))
    assert list(reformulate_problem(problem).phases["leg"].paths) == ["epigraph"]


def test_a_control_and_its_epigraph_that_a_limit_couples_are_determined() -> None:
    """Of ``a**2 + fabs(a + v)`` H curves along the limit: v'' = 1/2 while a + v > 0, and it is a minimum.

    The control is 10 000 times as large as a: curvatures count for its scale, not for its unit.
    """
    model, v, u = dynamics("speed", "v", "u", lambda v, u: {v: 1e-4 * u})
    a = 1e-4 * u
    problem, leg = one_phase("p", model, initial=0.0, final=1.0)
    leg.initial(v=0.0)
    leg.final(v=1.0)
    problem.minimize(leg.integral(a**2 + ca.fabs(a + v)))
    solution = go.solve(problem)
    assert solution.objective == pytest.approx((1.25**3 - 0.75**3) / 1.5 + 1 + 11 / 24, rel=1e-9)
    assert go.verify(solution).minimum


def test_controls_that_only_their_sum_costs_are_not_determined() -> None:
    model, v, a, b = dynamics("speed", "v", "a b", lambda v, a, b: {v: a + 2 * b})
    problem, leg = one_phase("p", model, initial=0.0, final=1.0)
    leg.initial(v=0.0)
    leg.final(v=1.0)
    leg.bounds(a=(-3.0, 3.0), b=(-3.0, 3.0))
    problem.minimize(leg.integral((a + 2 * b) ** 2 + ca.fabs(a + 2 * b + v)))
    solution = go.solve(problem, tol=None)
    assert not go.verify(solution).minimum


def test_a_path_that_crosses_the_corners_of_a_table_it_pays_for() -> None:
    """No solution came of the table as it stands. Cubics between 0, 0.5 and 1: a = c t + d with a jump of its slope."""
    model, x, _v, a = dynamics("cart", "x v", "a", lambda x, v, a: {x: v, v: a})
    problem, leg = one_phase("p", model, initial=0.0, final=2.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    leg.bounds(x=(0.0, 1.0))
    price = go.table([0.0, 0.5, 1.0], [1.0, 0.0, 1.0], method="linear")
    problem.minimize(leg.integral(a**2 + price(x)))
    solution = go.solve(problem)
    # Half of it: x = 1 (2 x = -slope * -1), x(1) = 0.5, x''(1) = 0 by symmetry.
    t = np.polynomial.Polynomial([0.0, 1.0])
    third = (0.5 - 1 / 24 + 1 / 4) / (1 / 6 - 1 / 2)
    way = t**4 / 24 + third * t**3 / 6 - (1 / 2 + third) * t**2 / 2
    half = (way.deriv(2) ** 2 + 1 - 2 * way).integ()(1.0)
    assert way(1.0) == pytest.approx(0.5) and way.deriv(2)(1.0) == pytest.approx(0.0)
    assert solution.objective == pytest.approx(2 * half, rel=1e-7)
    assert go.verify(solution).ok


def powered(lower: float | None) -> go.Problem:
    """Three units of travel in four seconds with the least total thrust, its power limited."""
    model = go.Model("cart")
    x, v = model.state("x"), model.state("v")
    a, size = model.split_control("a")
    model.ode({x: v, v: a})
    problem, leg = one_phase("p", model, initial=0.0, final=4.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=3.0, v=0.0)
    leg.bounds(a_plus=(0.0, 1.0), a_minus=(0.0, 1.0), v=(0.0, 3.0))
    leg.path("power", model.symbol("a_plus") * v, upper=0.5)
    if lower is not None:
        leg.path("braking power", model.symbol("a_minus") * v, upper=-lower)
    problem.minimize(leg.integral(size))
    return problem


@pytest.mark.slow
@pytest.mark.parametrize("lower", [-0.4])
def test_limits_of_the_parts_of_a_split_control(lower: float | None) -> None:
    """As fast as the thrust, then the power allows up to a speed c, coast, and brake: at the limits, v v' = P."""

    def ramp(c: float, power: float) -> tuple[float, float]:
        """Time and way from rest to c."""
        return power + (c**2 - power**2) / (2 * power), power**2 / 2 + (c**3 - power**3) / (3 * power)

    def missing(c: float) -> float:
        up = ramp(c, 0.5)
        down = (c, c**2 / 2) if lower is None else ramp(c, -lower)
        return up[1] + down[1] + c * (4.0 - up[0] - down[0]) - 3.0

    speed = scipy.optimize.brentq(missing, 0.75, 1.3)
    problem = powered(lower)
    solution = go.solve(problem)
    assert solution.objective == pytest.approx(2 * speed, rel=1e-8)
    assert go.verify(solution).minimum
