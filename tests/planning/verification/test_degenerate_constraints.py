"""The check of right answers with constraints without a gradient where they hold, or stated twice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import ConditionResult


@pytest.mark.parametrize("unit", [1.0, 1e5, 1e-4])
def test_a_budget_is_no_degenerate_constraint_in_any_unit(unit: float) -> None:
    """Far with a given effort: the budget bends by as much as it slopes, for variations of what the flight moves."""
    model, _x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("budget", model, 0.0, 1.0)
    leg.initial(x=0.0)
    problem.constrain("effort", leg.integral((u / unit) ** 2), upper=4.0)
    problem.minimize((leg.final_state("x") / unit - 3) ** 2)
    t = np.linspace(0.0, 1.0, 11)
    verdict = go.verify_trajectory(problem, t, 2 * unit * t, 0 * t + 2 * unit)
    assert verdict.minimum, verdict.explain()
    assert verdict["second order"].value < 10


def turned(unit: bool) -> go.Solution:
    """Least effort between directions on a circle, whose length is kept by itself and perhaps asked for as well."""
    model, _c, _s, w = dynamics("circle", "c s", "w", lambda c, s, w: {c: -w * s, s: w * c})
    problem, leg = one_phase("turn", model, 0.0, 1.0)
    leg.initial(c=1.0, s=0.0)
    leg.guess(time=[0.0, 1.0], c=[1.0, np.cos(1.0)], s=[0.0, np.sin(1.0)])
    if unit:
        leg.final(c=np.cos(1.0), s=np.sin(1.0))
    else:
        problem.constrain("angle", ca.atan2(leg.final_state("s"), leg.final_state("c")), equals=1.0)
    problem.minimize(leg.integral(0.5 * w**2))
    return go.solve(problem, mesh="4x6", tol=None)


@pytest.mark.parametrize("unit", [False, True])
def test_constraints_that_say_the_same_twice_are_no_harm(unit: bool) -> None:
    """Both final components are one condition too many, as four of a quaternion are: dependent, but not degenerate."""
    solution = turned(unit)
    assert solution.objective == pytest.approx(0.5, abs=1e-8)
    assert go.verify(solution)["second order"].result is ConditionResult.PASS


def test_a_point_target_of_a_distance_has_the_minimum_of_a_point() -> None:
    """|x(1)|^2 = 0 has no gradient where it holds; x(1) = 0 says the same and has one."""
    for degenerate in (True, False):
        model, _x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
        problem, leg = one_phase("to a point", model, 0.0, 1.0)
        leg.initial(x=1.0)
        if degenerate:
            problem.constrain("distance", leg.final_state("x") ** 2, upper=0.0)
        else:
            leg.final(x=0.0)
        problem.minimize(leg.integral(u**2))
        solution = go.solve(problem, mesh="2x3", tol=None)
        assert solution.objective == pytest.approx(1.0, abs=1e-6)
        assert go.verify(solution)["second order"].result is ConditionResult.PASS


def down_and_up(end: Callable[[go.Problem, Any], Any]) -> go.Verdict:
    """x' = u with |u| <= 1 from 0 to an end at 0, the integral of x least: down for half of 1 s, then up."""
    model, x, _u = dynamics("one", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("down and up", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-1.0, 1.0))
    end(problem, leg)
    problem.minimize(leg.integral(x))
    mesh = go.Mesh.at_times([0.0, 0.4, 1.0], 3, movable=True)
    return go.verify(go.solve(problem.with_fixed_arcs(arcs=[[-1, 1]]), mesh=mesh, tol=None))


def test_end_conditions_of_a_bang_bang_control() -> None:
    """The one switch time is determined by the end, by its square, and by the end stated twice."""
    plain = down_and_up(lambda problem, leg: leg.final(x=0.0))
    squared = down_and_up(lambda problem, leg: problem.constrain("sq", leg.final_state("x") ** 2, equals=0.0))

    def twice(problem: go.Problem, leg: Any) -> None:
        leg.final(x=0.0)
        problem.constrain("again", 2 * leg.final_state("x"), equals=0.0)

    again = down_and_up(twice)
    assert plain["second order"].result is ConditionResult.PASS
    assert squared["second order"].result is not ConditionResult.FAIL
    assert again["second order"].result is ConditionResult.PASS


@pytest.mark.parametrize("most", [0.0, 0.5])
def test_abnormal_multipliers_beside_normal_ones_are_no_harm(most: float) -> None:
    """y' = w^2 with y(1) <= 0 leaves w = 0 alone, whatever it costs; the cost wants that too, and multipliers exist."""
    model, _x, _y, u, w = dynamics("two channels", "x y", "u w", lambda x, y, u, w: {x: u, y: w**2})
    problem, leg = one_phase("beside", model, 0.0, 1.0)
    leg.initial(x=0.0, y=0.0)
    leg.final(x=1.0, y=(None, most))
    problem.minimize(leg.integral(u**2 + w**2))
    t = np.linspace(0.0, 1.0, 41)
    verdict = go.verify_trajectory(problem, t, {"x": t, "y": 0 * t}, {"u": 1 + 0 * t, "w": 0 * t})
    assert verdict.minimum, verdict.explain()


@pytest.mark.parametrize(
    ("second", "gain", "result"), [(-2.0, 0.0, "INCONCLUSIVE"), (1.0, 0.0, "PASS"), (1.0, -10.1, "FAIL")]
)
def test_curvature_that_depends_on_the_choice_of_multipliers(second: float, gain: float, result: str) -> None:
    """x <= 1 - y^2 is the active limit; its multiplier 8 may be shared with x + second * y^2 <= 1.

    The cost u^2 + w^2 / 100 - 10 x + gain y^2 has the second derivative 16.02 + 2 gain in y; a share moved to
    the second limit makes it smaller, which is no evidence against the minimum.
    """
    model, _x, _y, u, w = dynamics("two channels", "x y", "u w", lambda x, y, u, w: {x: u, y: w})
    problem, leg = one_phase("shared", model, 0.0, 1.0)
    leg.initial(x=0.0, y=0.0)
    x, y = leg.final_state("x"), leg.final_state("y")
    problem.constrain("first", x + y**2, upper=1.0)
    problem.constrain("second", x + second * y**2, upper=1.0)
    problem.minimize(leg.integral(u**2 + 0.01 * w**2) - 10 * x + gain * y**2)
    t = np.linspace(0.0, 1.0, 41)
    verdict = go.verify_trajectory(problem, t, {"x": t, "y": 0 * t}, {"u": 1 + 0 * t, "w": 0 * t})
    found = verdict["second order"]
    assert found.result is ConditionResult[result]
    assert ("multipliers are not unique" in found.where) == (result == "INCONCLUSIVE")
