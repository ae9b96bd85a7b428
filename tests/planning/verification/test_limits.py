"""Limits are judged by what they allow: a distance, found between the samples, however the constraint is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.wrong_solutions import double_integrator, energy, with_leg

import gnc_opt as go
from gnc_opt.planning.optimality.reference_scales import Scales
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.verification.engine import CONDITION_TOLERANCE
from gnc_opt.planning.verification.feasibility import limits
from gnc_opt.planning.verification.recomputed import from_problem

RADIUS = 10.0
FREE = -1e30
"""A lower limit that no value comes near to: solutions ignore it, until another is put in its place."""


def fly_by(
    miss: float,
    length: float,
    time: float,
    keep_out: Callable[[Any], Any] | None = None,
    origin: float = 0.0,
    limit: float = RADIUS**2,
) -> go.Problem:
    """A straight flight of 10 km that passes a point at a distance; ``origin`` (m) is where that is."""
    model = go.Model("chaser")
    r, v, a = model.state("r", 3), model.state("v", 3), model.control("a", 3)
    model.ode({r: v, v: a})
    problem = go.Problem("fly-by")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1000.0 * time)
    leg.initial(r=np.array([origin - 5000.0, miss, 0.0]) * length, v=0.0)
    leg.final(r=np.array([origin + 5000.0, miss, 0.0]) * length, v=0.0)
    if keep_out is not None:
        square = ((r[0] - origin * length) ** 2 + r[1] ** 2 + r[2] ** 2) / length**2
        leg.path("keep_out", keep_out(square), lower=limit)
    problem.minimize(leg.integral((a[0] ** 2 + a[1] ** 2 + a[2] ** 2) / length**2 * time**3))
    return problem


@cache
def flown(miss: float, length: float, time: float, origin: float) -> go.Solution:
    return go.solve(fly_by(miss, length, time, origin=origin), tol=None)


def flown_by(
    form: Callable[[Any], Any], limit: float, miss: float, length: float, time: float, origin: float = 0.0
) -> go.Condition:
    """Judge the straight flight against a lower limit on form(r^2) that the solver did not know of.

    ``length`` and ``time`` are how many of the units in use one metre and one second are; ``form`` takes m^2.
    """
    solution = flown(miss, length, time, origin)
    limited = with_leg(
        solution,
        path_labels=("keep_out",),
        path_bounds=Interval(np.array([limit]), np.array([np.inf])),
        path_multipliers=np.zeros((1, solution.phase().point_times.size)),
    )
    judged = from_problem(replace(limited, problem=fly_by(miss, length, time, form, origin, limit)))
    samples = list(judged.samples().values())
    return limits(judged, samples, Scales.of(judged, samples), CONDITION_TOLERANCE)


FORMS: dict[str, tuple[Callable[[Any], Any], float]] = {
    "square": (lambda square: square, RADIUS**2),
    "distance": (lambda square: ca.sqrt(square), RADIUS),
    "shifted share": (lambda square: square / RADIUS**2 - 1.0, 0.0),
    "inverse": (lambda square: -(RADIUS**2) / square, -1.0),
}
UNITS = {"m, s": (1.0, 1.0), "km, min": (1e-3, 1 / 60), "mm, ms": (1e3, 1e3)}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("units", UNITS)
def test_flight_through_a_small_sphere_fails_in_every_form_and_unit(form: str, units: str) -> None:
    """1 m inside of 10 m: a depth of 1 m to first order, as the curvature of the forms allows."""
    through, grazing, outside = (flown_by(*FORMS[form], miss, *UNITS[units]) for miss in (0.0, 9.0, 10.001))
    assert through.result is grazing.result is go.ConditionResult.FAIL
    assert (outside.result, outside.value) == (go.ConditionResult.PASS, 0.0)


@pytest.mark.parametrize("miss", [0.0, 9.0])
def test_flight_far_from_the_origin_fails_too(miss: float) -> None:
    """Coordinates of 7000 km, as in orbit: the depth of 1 m is 1e-7 of them, the sphere's width decides."""
    assert (
        flown_by(lambda square: square, RADIUS**2, miss, 1.0, 1.0, origin=7e6).result
        is go.ConditionResult.FAIL
    )


def test_value_that_is_no_number_fails() -> None:
    """The logarithm has none within 1 km of the point."""
    condition = flown_by(lambda square: ca.log(square - 1e6), -1e3, 9.0, 1.0, 1.0)
    assert condition.result is go.ConditionResult.FAIL
    assert condition.value == np.inf


def test_default_solution_through_the_centre_fails() -> None:
    """The solver's own answer: no node lies within the sphere."""
    problem = fly_by(0.0, 1.0, 1.0, lambda square: square)
    condition = go.verify(go.solve(problem, tol=None))["limits"]
    assert condition.result is go.ConditionResult.FAIL
    assert condition.where.startswith("phase leg, t = 500 s, keep_out = ")
    assert condition.where.endswith(" (at least 100)")


@cache
def passing(point: float) -> go.Solution:
    """Minimum energy over 1 m with a path quantity (q - point)^2, on segments without a boundary in the middle."""
    model = double_integrator()
    problem = go.Problem("minimum energy")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(v=(-5.0, 5.0))
    leg.path("gap", (model.symbol("q") - point) ** 2, lower=FREE)
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2))
    return go.solve(problem, mesh="3x5", tol=None)


@pytest.mark.parametrize("gap", [1e-3, 1e-4, 1e-5])
def test_narrow_dip_between_two_samples_is_found(gap: float) -> None:
    """The square has no gradient in its middle: no distance restores it."""
    solution = with_leg(passing(0.31), path_bounds=Interval(np.array([gap**2]), np.array([np.inf])))
    sampled = solution.samples()["leg"]
    assert np.min(np.abs(sampled.x[0] - 0.31)) > 1.001e-3, "a sample sees the dip: choose another point"
    condition = go.verify(solution)["limits"]
    assert condition.result is go.ConditionResult.FAIL
    beside = with_leg(passing(1.1), path_bounds=Interval(np.array([0.0999**2]), np.array([np.inf])))
    assert go.verify(beside)["limits"].value == 0.0


def test_top_of_a_state_between_samples_is_found() -> None:
    """The speed peaks at 1.5 m/s in the middle, a few 1e-3 above all samples."""
    solution = passing(0.31)
    assert np.max(solution.samples()["leg"].x[1]) < 1.5 - 1e-4
    bounds = Interval(np.array([-9.0, -9.0]), np.array([9.0, 1.5 - 1e-4]))
    assert go.verify(with_leg(solution, state_bounds=bounds))["limits"].value == pytest.approx(
        1e-4 / 1.5, rel=0.5
    )


@pytest.mark.parametrize("span", [0.15, 3e-3, 1e-6])
@pytest.mark.parametrize("kind", ["path_bounds", "state_bounds"])
def test_a_narrow_range_is_left_by_shares_of_what_moves(kind: str, span: float) -> None:
    """A speed from 0 to 1.5 is to stay in a range near its top."""
    top, free = 1.5 - 1e-3, np.array([9.0])
    low, high = np.array([top - span]), np.array([top])
    box = (
        Interval(low, high)
        if kind == "path_bounds"
        else Interval(np.append(-free, low), np.append(free, high))
    )
    condition = go.verify(with_leg(energy(), **{kind: box}))["limits"]
    assert condition.value == pytest.approx((top - span) / 1.5, rel=1e-3)


def test_what_no_state_can_restore_counts_in_shares_of_its_values() -> None:
    """A limit on time alone: 1 s where 0.9 is allowed."""
    model = double_integrator()
    problem = go.Problem("clock")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.path("clock", model.time, lower=FREE)
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2))
    late = with_leg(go.solve(problem, tol=None), path_bounds=Interval(np.array([-np.inf]), np.array([0.9])))
    condition = go.verify(late)["limits"]
    assert condition.result is go.ConditionResult.FAIL


def test_rounding_beyond_a_limit_passes() -> None:
    """A limit on the speed 1e-7 of its size below the top."""
    tight = with_leg(energy(), path_bounds=Interval(np.array([-np.inf]), np.array([1.5 * (1 - 1e-7)])))
    condition = go.verify(tight)["limits"]
    assert condition.result is go.ConditionResult.PASS
    assert condition.value == pytest.approx(1e-7, rel=1e-2)
