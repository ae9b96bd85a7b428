"""Thrust as magnitude times unit vector: solved as a vector control, reported as stated."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.internals import build_phase_guess, reformulate_problem
from testing.models import one_phase

import gnc_opt as go

DURATION = 3.0
FUEL = DURATION - np.sqrt(DURATION**2 - 4)
"""Of one unit, rest to rest, acceleration at most 1: two burns of half of it (problems.classics.minimum_fuel)."""


def by_unit_vector(limit: Any = None, *, most: float = 1.0) -> go.Problem:
    """A unit of travel with thrust d n, d in [0, most]; d costs."""
    model = go.Model("cart")
    r, v, d = model.state("r", 2), model.state("v", 2), model.control("d", unit="N")
    n = model.control("n", 2)
    model.ode({r: v, v: d * n})
    problem, leg = one_phase("p", model, 0.0, DURATION)
    leg.initial(r=[0.0, 0.0], v=[0.0, 0.0])
    leg.final(r=[0.6, -0.8], v=[0.0, 0.0])
    leg.bounds(d=(0.0, most))
    leg.path("unit", ca.sumsqr(n), equals=1.0)
    cost = None if limit is None else limit(leg, n, d)
    problem.minimize(leg.integral(d if cost is None else cost))
    return problem


@cache
def coasted() -> go.Solution:
    return go.solve(by_unit_vector())


def test_fuel_meets_its_closed_form_and_is_ok() -> None:
    solution = coasted()
    assert go.verify(solution).ok
    assert solution.objective == pytest.approx(FUEL, rel=1e-9)
    assert "d * n is replaced by d * n_direction" in str(solution)


def test_the_unit_vector_has_its_length_and_points_against_the_primer() -> None:
    solution, burn = coasted(), FUEL / 2
    at = np.linspace(0.0, DURATION, 61)
    n, primer = solution.control("n")(at), solution.costate("v")(at)
    np.testing.assert_allclose(np.linalg.norm(n, axis=0), 1.0, rtol=1e-12)
    away = np.linalg.norm(primer, axis=0) > 1e-6  # the primer passes through zero halfway
    np.testing.assert_allclose(n[:, away], -(primer / np.linalg.norm(primer, axis=0))[:, away], atol=1e-6)
    np.testing.assert_allclose(solution.control("d")([0.5 * burn, 1.5])[:], [1.0, 0.0], atol=1e-7)
    # The primer, linear in time, is of length 1 where a burn ends, by d H / d d = 1 - |lam_v|.
    np.testing.assert_allclose(np.linalg.norm(solution.costate("v")(burn)), 1.0, atol=1e-6)


def test_costates_are_those_with_a_vector_control() -> None:
    model = go.Model("cart")
    r, v = model.state("r", 2), model.state("v", 2)
    T, magnitude = model.vector_control("T", 2)
    model.ode({r: v, v: T})
    problem, leg = one_phase("p", model, 0.0, DURATION)
    leg.initial(r=[0.0, 0.0], v=[0.0, 0.0])
    leg.final(r=[0.6, -0.8], v=[0.0, 0.0])
    leg.norm_bounds(T=(0.0, 1.0))
    problem.minimize(leg.integral(magnitude))
    known = go.solve(problem, check=False)
    for name in ("r", "v"):
        at = np.linspace(0.0, DURATION, 7)
        np.testing.assert_allclose(coasted().costate(name)(at), known.costate(name)(at), atol=1e-6)


def test_a_solution_is_saved_checked_and_solved_again_in_the_stated_controls(tmp_path: Path) -> None:
    solution, problem = coasted(), by_unit_vector()
    loaded = go.load(solution.save(tmp_path / "s.npz"), problem)
    at = np.array([0.2, 1.2, 2.8])
    np.testing.assert_array_equal(loaded.control("n")(at), solution.control("n")(at))
    assert solution.evaluate("n", 0.2) == pytest.approx(solution.control("n")(0.2))
    leg, burn = solution.phases["leg"], FUEL / 2
    times = np.sort(np.append(np.linspace(0.0, DURATION, 31), np.repeat([burn, DURATION - burn], 2)))
    sides = np.where(np.append(np.diff(times) == 0, False), -1e-9, 1e-9)
    controls = {
        name: leg.saturated_control(name)(np.clip(times + sides, 0.0, DURATION)) for name in ("d", "n")
    }
    verdict = go.verify_trajectory(
        problem, times, {name: leg.state(name)(times) for name in ("r", "v")}, controls
    )
    assert not [c.name for c in verdict.failed]
    warm = go.solve(by_unit_vector(most=1.1), guess=solution, tol=1e-6)
    assert go.verify(warm).ok and warm.objective < FUEL


def test_bounds_that_the_length_implies_guesses_and_scales_are_of_the_direction() -> None:
    problem = by_unit_vector(lambda leg, n, d: leg.bounds(n=([-1.0, -1.5], [1.0, 1.0])))
    problem.phases["leg"].guess(n=[0.6, -0.8])
    problem.phases["leg"].scale(n=1.0)
    solved = reformulate_problem(problem).phases["leg"]
    (vector,) = solved.vector_controls
    assert vector.magnitude == "d" and "unit" not in solved.paths and not solved.has_unit_direction(vector)
    start = build_phase_guess(solved, np.array([0.0, 1.0]), perturbed=False)
    place = solved.model.controls.slice("n_direction")
    np.testing.assert_allclose(start.controls[place][:, 1], [0.6, -0.8])
    assert not np.any(np.isfinite(solved.numbers.controls.lower[place]))
    solution = go.solve(problem, tol=None)
    assert solution.objective == pytest.approx(FUEL, abs=0.02)
    assert np.linalg.norm(solution.control("n")(0.1)) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "limit",
    [
        lambda leg, n, d: leg.bounds(n=([-0.5, -1.0], [1.0, 1.0])),
        lambda leg, n, d: leg.path("cone", n[0], lower=0.1),
        lambda leg, n, d: d + n[0],
        lambda leg, n, d: d + d**2 * n[0],
        lambda leg, n, d: d + d * n[0] ** 2,
        lambda leg, n, d: leg.bounds(d=(0.1, 1.0)),
        lambda leg, n, d: d**2,
        lambda leg, n, d: leg.model.time,
    ],
    ids=[
        "bounds",
        "cone",
        "cost of n",
        "square of d",
        "square of n",
        "no coast",
        "cost squared",
        "d is free",
    ],
)
def test_what_is_no_magnitude_times_unit_vector_stays_as_it_is(limit: Any) -> None:
    problem = by_unit_vector(limit)
    assert "unit" in reformulate_problem(problem).phases["leg"].paths


def test_variations_with_other_bounds_have_their_own_form() -> None:
    problem = by_unit_vector()
    twin = problem.with_bounds("leg", d=(0.1, 1.0))
    assert "unit" not in reformulate_problem(problem).phases["leg"].paths
    assert "unit" in reformulate_problem(twin).phases["leg"].paths


def test_a_length_with_states_implies_bounds_of_its_control() -> None:
    model = go.Model("circle")
    x, z = model.state("x"), model.control("z")
    model.ode({x: z})
    problem = go.Problem("p")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=1.0)
    leg.initial(x=0.0)
    leg.bounds(z=(0.5, 1.0))
    leg.path("unit", x**2 + z**2, equals=1.0)
    leg.guess(z=1.0)
    problem.minimize(-leg.final_state("x"))
    solved = reformulate_problem(problem).phases["leg"].numbers
    upper = np.append(solved.states.upper, solved.controls.upper)
    lower = np.append(solved.states.lower, solved.controls.lower)
    assert not np.any(np.isfinite(upper)) and 0.5 in lower  # z <= 1 is implied, z >= 0.5 is not
