"""The verdict's signs and scales: both ends, both limits, any units; the right passes and its mirror image fails."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from testing.second_order import second_order_of
from testing.wrong_solutions import double_integrator, failed, free_time, with_leg

import gnc_opt as go
from gnc_opt.planning.problem.interval import Interval

# --- multipliers push one way ---------------------------------------------------------------------------


def move(reach: float = 1.0, time: float = 1.0) -> go.Solution:
    """From rest to rest over ``reach`` with the least energy 6 reach^2 / time^3."""
    model = double_integrator()
    problem = go.Problem("move")
    leg = problem.phase("leg", model)
    leg.time(0.0, time)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=reach, v=0.0)
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2))
    return go.solve(problem, mesh="3x5", tol=None)


@pytest.mark.parametrize("reach", [1.0, -1.0])
@pytest.mark.parametrize("end", ["start", "end"])
def test_end_value_is_held_by_the_limit_that_keeps_it_from_getting_cheaper(reach: float, end: str) -> None:
    """The energy falls as the ends approach: only limits that keep them apart can hold them."""
    solution = move(reach)
    leg = solution.phase()
    place, value = ("initial", 0.0) if end == "start" else ("final", reach)
    outwards = np.sign(reach) if end == "end" else -np.sign(reach)
    box: Interval = getattr(leg, f"{place}_bounds")
    for side in (outwards, -outwards):
        low, high = sorted([value, value + 2.0 * side])
        given = Interval(np.array([low, box.lower[1]]), np.array([high, box.upper[1]]))
        problem = getattr(solution.need_problem("ask"), f"with_{place}")(q=(low, high))
        passed_off = replace(with_leg(solution, **{f"{place}_bounds": given}), problem=problem)
        assert failed(passed_off) == (set() if side == outwards else {"stationarity"})


@pytest.mark.parametrize("end", ["start", "end"])
def test_end_value_on_its_limit_within_the_reach_of_the_trajectory(end: str) -> None:
    """The trajectory sets off from, or arrives at, a limit inside the range: what counts is the very end."""
    model = double_integrator()
    problem = go.Problem("to the limit")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=(0.0, 2.0) if end == "start" else 0.0, v=2.0)
    leg.final(q=1.0 if end == "start" else (-1.0, 1.0), v=2.0)
    tempting = leg.initial_state("q") if end == "start" else -leg.final_state("q")
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2) + 40 * tempting)
    solution = go.solve(problem, mesh="3x5", tol=None)
    found = solution.state("q")(0.0 if end == "start" else 1.0)
    assert found == pytest.approx(0.0 if end == "start" else 1.0, abs=1e-7)
    assert failed(solution) == set()


@pytest.mark.parametrize(("limits", "right"), [((0.2, 1.0), True), ((1.0, 5.0), False)])
def test_final_time_is_held_by_the_limit_that_keeps_it_from_getting_cheaper(
    limits: tuple[float, float], right: bool
) -> None:
    """The energy 6 / t_f^3 falls with t_f: an upper limit holds it, a lower one does not."""
    solution = move()
    box = Interval(np.array([limits[0]]), np.array([limits[1]]))
    problem = solution.need_problem("ask").with_time(final=limits)
    passed_off = replace(with_leg(solution, final_time_bounds=box), problem=problem)
    assert failed(passed_off) == (set() if right else {"stationarity"})


@pytest.mark.parametrize(("distance", "sits"), [(1e-3, True), (1e-2, False)])
def test_a_time_sits_on_its_limit_within_a_millionth_of_the_range(distance: float, sits: bool) -> None:
    """At 2.5 s, later than the best 18^(1/4) s, and a millionth of 2000 s above its lower limit."""
    late, right = free_time(2.5), free_time()
    box = Interval(np.array([2.5 - distance]), np.array([2000.0]))
    problem = right.need_problem("ask").with_time(final=(2.5 - distance, 2000.0))
    passed_off = replace(with_leg(late, final_time_bounds=box), problem=problem)
    assert failed(passed_off) == (set() if sits else {"stationarity"})


def chosen(least: float, most: float, best: float) -> go.Problem:
    """A free parameter k that costs (k - best)^2 beside a trajectory."""
    model = double_integrator()
    problem = go.Problem("chosen")
    k = problem.parameter("k", lower=least, upper=most)
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2) + (k - best) ** 2)
    return problem


@pytest.mark.parametrize(("limits", "best"), [((1.0, 4.0), 0.5), ((-2.0, 1.0), 1.5)])
def test_parameter_is_held_by_the_limit_that_keeps_it_from_getting_cheaper(
    limits: tuple[float, float], best: float
) -> None:
    solution = go.solve(chosen(*limits, best), mesh="3x5", tol=None)
    assert solution.parameter_values[0] == pytest.approx(1.0, abs=1e-7)
    assert failed(solution) == set()
    mirrored = (2.0 - limits[1], 2.0 - limits[0])
    assert failed(replace(solution, problem=chosen(*mirrored, best))) == {"stationarity"}


# --- the duration ---------------------------------------------------------------------------------------


def timed(duration: tuple[float, float], price: float) -> go.Solution:
    """Energy 6 / T^3 + price T, with both end times free and T limited; setting off at 0.3 s is best."""
    model = double_integrator()
    problem = go.Problem("timed")
    leg = problem.phase("leg", model)
    leg.time((-5.0, 5.0), (-5.0, 15.0), duration=duration)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    energy = 0.5 * leg.integral(model.symbol("a") ** 2)
    problem.minimize(energy + price * leg.duration + (leg.initial_time - 0.3) ** 2)
    return go.solve(problem, mesh="3x5", options=go.SolverOptions(tolerance=1e-10), tol=None)


@pytest.mark.parametrize(("duration", "price", "at"), [((0.1, 1.0), 0.0, 1.0), ((2.0, 9.0), 5.0, 2.0)])
def test_limit_of_the_duration_is_paid_for_at_both_ends(
    duration: tuple[float, float], price: float, at: float
) -> None:
    """Its multiplier is -dJ/dT = 18 / T^4 - price, and H = -18 / T^4 all along: minus what the time costs."""
    solution = timed(duration, price)
    leg = solution.phase()
    assert (leg.initial_time, leg.duration) == pytest.approx((0.3, at), abs=1e-6)
    assert leg.duration_multiplier == pytest.approx(18 / at**4 - price, rel=1e-6)
    assert solution.hamiltonian(leg.final_time, side="left") == pytest.approx(-18 / at**4, rel=1e-6)
    assert failed(solution) == set()
    assert failed(with_leg(solution, duration_multiplier=-leg.duration_multiplier)) == {"stationarity"}
    assert failed(with_leg(solution, duration_multiplier=0.0)) == {"stationarity"}


# --- curvature beside a mixed constraint ----------------------------------------------------------------


def ridge(along: float, across: float, side: str, unit: float = 1.0, wide: float = 2.0) -> go.Problem:
    """Two controls with u + w limited at 1; H has one curvature along the limit and another across it."""
    model = go.Model("ridge")
    x = model.state("x")
    u, w = model.control("u"), model.control("w")
    model.ode({x: u - w})
    problem = go.Problem("ridge")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-2.0, 2.0), w=(-wide, wide))
    if side == "upper":
        leg.path("sum", unit * (u + w), upper=unit)
    else:
        leg.path("sum", -unit * (u + w), lower=-unit)
    problem.minimize(leg.integral(along * (u - w) ** 2 / 2 + across * (u + w) ** 2 / 2 - 10 * (u + w)))
    return problem


@pytest.mark.parametrize(
    ("side", "unit", "wide"),
    [
        ("upper", 1.0, 2.0),
        ("lower", 1.0, 2.0),
        ("upper", 1e6, 2.0),
        ("lower", 1e-3, 2.0),
        ("upper", 1.0, 8.0),
    ],
)
def test_curvature_counts_along_an_active_mixed_constraint_and_not_across_it(
    side: str, unit: float, wide: float
) -> None:
    """At u = w = 1/2 the limit is active: what H does across it is no choice of the controls."""
    solution = go.solve(ridge(1.0, -0.5, side, unit, wide), mesh="2x4", tol=None)
    assert np.allclose(np.hstack(solution.phase().u.values), 0.5, atol=1e-6)
    legendre = second_order_of(solution)["Legendre-Clebsch"]
    assert legendre.result is go.ConditionResult.PASS
    hill = second_order_of(replace(solution, problem=ridge(-1.0, 0.5, side, unit, wide)))
    assert hill["Legendre-Clebsch"].result is go.ConditionResult.FAIL
    # (u - w)^2 / 2 has the curvature 4 along (1, -1), which in shares of a and b is (b, -a); these are the ranges over
    # the root of what half of each is worth, by the slope 10.5 of H.
    a, b = 4.0 / np.sqrt(10.5 * 2.0), 2 * wide / np.sqrt(10.5 * wide)
    assert legendre.value == pytest.approx(-4 * (a * b) ** 2 / (a**2 + b**2), rel=1e-5)
