"""Kinks that users write: what costs by them is split or bounded from above, limits by them are several smooth ones."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.internals import reformulate_problem
from testing.models import dynamics, one_phase

import gnc_opt as go

DURATION = 2.0

Cost = Callable[[Any, Any, Any], Any]


def cart(cost: Cost, limit: Cost | None = None, bounds: Any = None) -> go.Problem:
    """A unit of travel, rest to rest, in two seconds."""
    model, x, v, a = dynamics("cart", "x v", "a", lambda x, v, a: {x: v, v: a})
    problem, leg = one_phase("p", model, initial=0.0, final=DURATION)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    if bounds is not None:
        leg.bounds(a=bounds)
    if limit is not None:
        leg.path("limit", limit(x, v, a))
    problem.minimize(leg.integral(cost(x, v, a)))
    return problem


def solved_leg(*arguments: Any) -> Any:
    return reformulate_problem(cart(*arguments)).phases["leg"]


def at(leg: Any, expression: Any, x: Any, u: Any) -> np.ndarray:
    _, states, controls, _ = leg.model.symbolic_arguments()
    return ca.Function("at", [states, controls], [ca.densify(expression)])(x, u).full().ravel()


PIECEWISE: dict[str, tuple[Cost, Callable[[float], float], float]] = {
    "fmax": (lambda x, v, a: ca.fmax(2 * a, -a), lambda a: max(2 * a, -a), 0.0),
    "fmin": (lambda x, v, a: -ca.fmin(-2 * a, a), lambda a: max(2 * a, -a), 0.0),
    "if_else": (
        lambda x, v, a: ca.if_else(a > 0.5, 3 * a, 2 * a + 0.5),
        lambda a: max(3 * a, 2 * a + 0.5),
        0.5,
    ),
    "other units": (lambda x, v, a: ca.fabs(3 - 6 * a) / 6, lambda a: abs(a - 0.5), 0.5),
    "a term twice": (lambda x, v, a: ca.fabs(a) + (x * v + v), lambda a: abs(a) + 0.3, 0.0),
}


@pytest.mark.parametrize("case", PIECEWISE.values(), ids=PIECEWISE)
def test_costs_with_a_corner_of_a_control_are_linear_in_its_parts(case: Any) -> None:
    cost, value, corner = case
    leg = solved_leg(cost, None, (-2.0, 3.0))
    (split,) = leg.model.composed_controls.values()
    assert split.corners == (pytest.approx((corner,)) if corner else ())
    assert not any(ca.which_depends(leg.integrand_expression(), leg.model.symbols("control"), 2, True))
    for a in (-2.0, -0.7, 0.2, 0.9, 3.0):
        parts = np.concatenate(split.decompose_control(np.array([[a]])))[:, 0]
        assert at(leg, leg.integrand_expression(), [0, 0.3], parts) == pytest.approx(value(a))
        np.testing.assert_allclose(at(leg, leg.model.state_derivative(), [0, 0.3], parts), [0.3, a])
        assert split.compose_control(*parts[:, None]) == pytest.approx(a)
    box = leg.numbers.controls
    np.testing.assert_allclose(box.upper, [3.0 - corner, corner + 2.0])
    np.testing.assert_array_equal(box.lower, 0.0)


def test_bounds_that_leave_out_a_corner_are_kept() -> None:
    leg = solved_leg(PIECEWISE["other units"][0], None, (0.7, 2.0))
    np.testing.assert_allclose(leg.numbers.controls.lower, [0.2, 0.0])
    np.testing.assert_allclose(leg.numbers.controls.upper, [1.5, 0.0])


@pytest.mark.parametrize(
    "cost", [lambda a: ca.fmax(ca.fabs(a) - 0.5, 0), lambda a: ca.fabs(a) + 2 * ca.fmax(a - 1, 0)]
)
def test_several_corners_of_a_control_are_epigraphs(cost: Any) -> None:
    leg = solved_leg(lambda x, v, a: cost(a), None, (-2.0, 3.0))
    assert leg.model.controls.names[:2] == ("a", "epigraph")


def test_a_corner_that_moves_with_states_is_an_epigraph() -> None:
    leg = solved_leg(lambda x, v, a: a**2 + ca.fabs(a + v))
    assert leg.model.controls.names == ("a", "epigraph")
    np.testing.assert_allclose(at(leg, leg.integrand_expression(), [0.0, 0.5], [0.2, 7.0]), 7.04)
    np.testing.assert_allclose(np.sort(at(leg, leg.path_expression(), [0.0, 0.5], [0.2, 0.9])), [0.2, 1.6])
    np.testing.assert_array_equal(leg.get_path_bounds().lower, 0.0)


def test_the_largest_of_several_controls_is_one_epigraph() -> None:
    model, _v, a = dynamics("plane", "v:2", "a:2", lambda v, a: {v: a})
    problem, leg = one_phase("p", model, initial=0.0, final=1.0)
    problem.minimize(leg.integral(ca.sumsqr(a) + ca.norm_inf(a)))
    solved = reformulate_problem(problem).phases["leg"]
    assert solved.model.controls.names == ("a", "epigraph")
    values = at(solved, solved.path_expression(), [0.0, 0.0], [0.2, -0.7, 1.0])
    np.testing.assert_allclose(np.sort(values), [0.3, 0.8, 1.2, 1.7])


LIMITS: dict[str, tuple[Cost, list[float]]] = {
    "sum": (lambda x, v, a: ca.fabs(a) + ca.fabs(v) <= 2, [-0.9, -0.1, 0.1, 0.9]),
    "fmax": (lambda x, v, a: ca.fmax(a, 3 * v) <= 2, [0.4, 1.5]),
    "fmin": (lambda x, v, a: ca.fmin(a, 3 * v) >= -2, [0.4, 1.5]),
    "norm_inf": (lambda x, v, a: ca.norm_inf(ca.vertcat(a, v)) <= 2, [-0.5, -0.4, 0.4, 0.5]),
    "of a state": (lambda x, v, a: ca.fmax(a, -a + x) <= 2, [0.4, 0.6]),
    "moving": (lambda x, v, a: ca.fabs(a) <= 1 + x, [-2.4, -1.6]),
}


@pytest.mark.parametrize("case", LIMITS.values(), ids=LIMITS)
def test_limits_of_kinks_are_limits_of_their_pieces(case: Any) -> None:
    limit, values = case
    leg = solved_leg(lambda x, v, a: a**2, limit)
    assert leg.model.controls.names == ("a",)
    np.testing.assert_allclose(np.sort(at(leg, leg.path_expression(), [1.0, 0.5], [0.4])), values)


@pytest.mark.parametrize(
    "limit",
    [
        lambda x, v, a: ca.fabs(a) >= 0.5,
        lambda x, v, a: ca.fabs(a) + v == 0.5,
        lambda x, v, a: ca.fmin(a, v) <= 0.5,
    ],
)
def test_limits_that_leave_holes_stay_and_are_warned_of(limit: Cost) -> None:
    problem = cart(lambda x, v, a: a**2, limit)
    assert reformulate_problem(problem) is problem
    with pytest.warns(go.ProblemWarning, match="kink: its feasible set is not convex"):
        problem.check()


def test_kinks_of_states_are_epigraphs_and_those_of_time_stay() -> None:
    leg = solved_leg(lambda x, v, a: a**2 + ca.fabs(x - 0.5))
    assert leg.model.controls.names == ("a", "epigraph")
    clock = cart(lambda x, v, a: a**2)
    clock.cost += clock.phases["leg"].integral(ca.fabs(clock.phases["leg"].model.time - 0.5))
    assert reformulate_problem(clock) is clock


def hurled(cost: Cost, limit: Cost | None = None) -> go.Problem:
    """A cart at rest that ends anywhere in two seconds, for its effort E and where it ends: (x, v, E).

    The least effort to an end is 1.5 x**2 - 3 x v + 2 v**2 (the inverse of the Gramian).
    """
    problem = cart(lambda x, v, a: 0.0 * a)
    stated = go.Problem("hurled")
    leg = stated.phase("leg", problem.phases["leg"].model)
    leg.time(initial=0.0, final=DURATION)
    leg.initial(x=0.0, v=0.0)
    x, v = leg.final_state("x"), leg.final_state("v")
    effort = leg.integral(leg.model.symbol("a") ** 2)
    if limit is not None:
        stated.constrain("near", limit(x, v, effort))
    stated.minimize(cost(x, v, effort))
    return stated


@pytest.mark.parametrize(
    ("cost", "limit", "least"),
    [
        (lambda x, v, e: e + 4 * ca.fabs(x - 1) + ca.fabs(v), None, 1.0),  # rests on x = 1, at v = 1/2
        (lambda x, v, e: e, lambda x, v, e: ca.fabs(x - 1) + ca.fabs(v) <= 0.2, 0.96),  # at x = 0.8, v = 0
        (lambda x, v, e: ca.fmax(e, 3 * (2 - x)), None, 3 * (2 - (np.sqrt(18) - 3) / 0.75)),
    ],
)
def test_kinks_of_end_costs_and_end_conditions_meet_their_closed_form(
    cost: Any, limit: Any, least: float
) -> None:
    solution = go.solve(hurled(cost, limit), mesh="4x3")
    assert go.verify(solution).ok
    assert solution.objective == pytest.approx(least, rel=1e-7)


def least_cost(corner: float, below: float, above: float) -> float:
    """The least integral of a**2 and what costs by two slopes beside a corner: the costate of v is linear in time."""
    t = np.linspace(0.0, DURATION, 40001)

    def control(line: Any) -> Any:
        wanted = [-(line[0] + line[1] * t + slope) / 2 for slope in (below, above)]
        return np.where(wanted[1] > corner, wanted[1], np.minimum(corner, wanted[0]))

    def misses(line: Any) -> list[float]:
        a = control(line)
        return [scipy.integrate.trapezoid(a, t), scipy.integrate.trapezoid((DURATION - t) * a, t) - 1.0]

    a = control(scipy.optimize.root(misses, [-2.0, 2.0], tol=1e-13).x)
    cost = a**2 + np.where(a > corner, above, below) * (a - corner)
    return float(scipy.integrate.trapezoid(cost, t))


TWO_SLOPES: dict[str, tuple[Cost, float, float, float]] = {
    "fmax": (lambda x, v, a: a**2 + ca.fmax(a, 0), 0.0, 0.0, 1.0),
    "battery": (lambda x, v, a: a**2 + ca.if_else(a > 0, a / 0.8, 0.8 * a), 0.0, 0.8, 1.25),
    "shifted": (lambda x, v, a: a**2 + ca.fabs(a - 0.3), 0.3, -1.0, 1.0),
}


@pytest.mark.parametrize("case", TWO_SLOPES.values(), ids=TWO_SLOPES)
def test_dead_zones_of_costs_with_corners_meet_their_closed_form(case: Any) -> None:
    cost, corner, below, above = case
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solution = go.solve(cart(cost), mesh="10x3")
    assert go.verify(solution).minimum
    assert solution.objective == pytest.approx(least_cost(corner, below, above), rel=1e-7)
    flown = solution.saturated_control("a")(np.linspace(0, DURATION, 201))
    assert 0.05 < np.mean(np.isclose(flown, corner, atol=1e-9)) < 0.95


def dead_zone(a: Any) -> Any:
    return ca.sign(a) * ca.fmax(ca.fabs(a) - 0.2, 0)


def driven(act: Callable[[Any], Any]) -> go.Problem:
    model, _v, a = dynamics("cart", "v", "a", lambda v, a: {v: act(a)})
    problem, leg = one_phase("cart", model, initial=0.0, final=3.0)
    leg.initial(v=0.0)
    leg.final(v=1.0)
    problem.minimize(leg.integral(a**2))
    return problem


@pytest.mark.parametrize(
    ("act", "remedy"),
    [
        (dead_zone, "split_control"),
        (lambda a: ca.if_else(ca.fabs(a) > 0.3, a, 0), "let a phase end there"),
        (lambda a: ca.fmax(ca.fmin(a, 1.0), -1.0), "bounds"),
    ],
)
def test_actuators_with_kinks_are_solved_as_stated_and_reported(act: Any, remedy: str) -> None:
    problem = driven(act)
    assert reformulate_problem(problem) is problem
    with pytest.warns(go.ProblemWarning, match=f"rate of state 'v' .*{remedy}"):
        problem.check()


def pushed(cost: Callable[[Any, Any], Any]) -> go.Problem:
    """Speeds of two axes that grow by one and by zero in a second."""
    model, v, a = dynamics("plane", "v:2", "a:2", lambda v, a: {v: a})
    problem, leg = one_phase("plane", model, initial=0.0, final=1.0)
    leg.initial(v=[0.0, 0.0])
    leg.final(v=[1.0, 0.0])
    problem.minimize(leg.integral(cost(v, a)))
    return problem


def test_path_limits_that_repeat_a_bound_are_reported() -> None:
    """Also up to rounding, 3 * 0.1 = 0.30000000000000004; looser and tighter limits are not."""
    problem = cart(lambda x, v, a: a**2, bounds=(-1.0, 1.0))
    leg = problem.phases["leg"]
    v, a = leg.model.symbol("v"), leg.model.symbol("a")
    leg.bounds(v=(-0.1, 0.1))
    leg.path("looser", 3 * v, upper=0.5)
    leg.path("tighter", 3 * v, upper=0.3 * (1 - 1e-10))
    leg.path("both", ca.vertcat(-2 * a, v + a, 3 * v), upper=[2.0, 1.1, 0.3])
    with pytest.warns(go.ProblemWarning, match="repeats a bound") as found:
        problem.check()
    assert [str(w.message).split("'")[1] for w in found] == ["both[0]", "both[2]"]
