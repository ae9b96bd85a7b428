"""Variations of a problem re-use its transcription, and solutions serve as guesses."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle

import casadi as ca
import numpy as np
import pytest
from testing.nonlinear_problems import (
    PROBLEMS,
    SCHEMES,
    orbit_raising,
    relative_difference,
    reorientation,
    solve,
    van_der_pol,
)

import gnc_opt as go

on_schemes = pytest.mark.parametrize("scheme", SCHEMES)

MESH = go.Mesh.uniform(4, 5)


def bounded_van_der_pol(
    x: float = 0.0, end: float = 4.0, limit: float = 0.8, mu: float = 1.0, goal: float | None = None
) -> go.Problem:
    """The regulator with a control limit, stated from scratch with the given numbers."""
    problem = van_der_pol()
    leg = problem.get_phase()
    leg.time(initial=0.0, final=end)
    leg.initial(x=x)
    leg.bounds(u=(-limit, limit))
    if goal is not None:
        leg.final(x=goal)
    return problem.with_parameters(mu=mu)


VARIATIONS: dict[str, tuple[Callable[[go.Problem], go.Problem], Callable[[], go.Problem]]] = {
    "initial": (lambda p: p.with_initial(x=0.3), lambda: bounded_van_der_pol(x=0.3)),
    "final": (lambda p: p.with_final(x=0.1), lambda: bounded_van_der_pol(goal=0.1)),
    "bounds": (lambda p: p.with_bounds(u=(-0.5, 0.5)), lambda: bounded_van_der_pol(limit=0.5)),
    "time": (lambda p: p.with_time(final=3.0), lambda: bounded_van_der_pol(end=3.0)),
    "parameters": (lambda p: p.with_parameters(mu=0.6), lambda: bounded_van_der_pol(mu=0.6)),
}


@pytest.mark.parametrize(("what", "scheme"), [*zip(VARIATIONS, cycle(SCHEMES), strict=False)])
def test_variations_reuse_the_build(what: str, scheme: str) -> None:
    """A varied problem gives what a fresh one gives, without transcription; the old one is unharmed."""
    vary, state_afresh = VARIATIONS[what]
    problem = bounded_van_der_pol()
    first = solve(problem, MESH, scheme)
    varied, fresh = solve(vary(problem), MESH, scheme), solve(state_afresh(), MESH, scheme)
    assert not first.statistics.compiled_before
    assert varied.statistics.compiled_before
    assert not fresh.statistics.compiled_before
    assert varied.objective == pytest.approx(fresh.objective, rel=1e-9)
    assert abs(varied.objective - first.objective) > 1e-3
    times = fresh.phase().sample_times(4)
    np.testing.assert_allclose(varied.phase().x(times), fresh.phase().x(times), atol=1e-6)
    np.testing.assert_allclose(varied.phase().lam(times), fresh.phase().lam(times), atol=1e-6)
    again = solve(problem, MESH, scheme)
    assert again.statistics.compiled_before
    assert again.objective == first.objective


def test_a_time_set_free_builds_anew() -> None:
    """Fixed and free times are different programs; the answer is the free problem's."""
    problem = reorientation()
    fixed = solve(problem, MESH)
    free = solve(problem.with_time(final=(1.0, 3.5)), MESH)
    assert not free.statistics.compiled_before
    assert free.phase().final_time == pytest.approx(3.5, abs=1e-6)
    assert free.objective < fixed.objective


def test_other_meshes_and_schemes_build_anew() -> None:
    """A build belongs to a mesh and a scheme, and all of them are kept."""
    problem = van_der_pol()
    reused = [
        solve(problem, mesh, scheme).statistics.compiled_before
        for mesh, scheme in (("4x5", "LG"), ("5x4", "LG"), ("4x5", "LGR"), ("4x5", "LG"), ("4x5", "LGR"))
    ]
    assert reused == [False, False, False, True, True]


@pytest.mark.parametrize(("name", "scheme"), [*zip(PROBLEMS, SCHEMES, strict=True)])
def test_solution_as_guess_on_its_own_mesh(name: str, scheme: str) -> None:
    """States, controls and multipliers of a solution are a solution: two iterations at most."""
    build, mesh = PROBLEMS[name]
    problem = build()
    first = solve(problem, mesh, scheme)
    second = solve(problem, mesh, scheme, guess=first)
    assert second.statistics.iterations <= 2
    assert second.objective == pytest.approx(first.objective, rel=1e-10)
    assert relative_difference(second.phase().lam_start, first.phase().lam_start) < 1e-8


@on_schemes
def test_solution_with_active_constraints_as_guess(scheme: str) -> None:
    """The same with a control on its bounds and a state held by its own (multipliers of bounds, impulses)."""
    problem = bounded_van_der_pol(limit=1.0).with_bounds(x=(-0.4, None))
    first = solve(problem, go.Mesh.uniform(10, 4), scheme)
    assert np.max(np.abs(first.phase().state_multipliers)) > 0.05
    second = solve(problem, go.Mesh.uniform(10, 4), scheme, guess=first)
    assert second.statistics.iterations <= 2
    assert second.objective == pytest.approx(first.objective, abs=1e-8)


@pytest.mark.parametrize(("name", "scheme"), [*zip(PROBLEMS, cycle(SCHEMES), strict=False)])
def test_solution_as_guess_elsewhere(name: str, scheme: str) -> None:
    """From an LG solution to other meshes and schemes: the same answer as cold, within a dozen iterations."""
    build, mesh = PROBLEMS[name]
    problem = build()
    first = solve(problem, mesh, "LG")
    for other in (go.Mesh.uniform(mesh.segments + 3, 4), go.Mesh((0.0, 0.3, 0.55, 0.7, 1.0), (6, 7, 5, 8))):
        warm = solve(problem, other, scheme, guess=first)
        cold = solve(problem, other, scheme)
        assert warm.statistics.iterations <= 12
        assert warm.objective == pytest.approx(cold.objective, rel=1e-8)
        assert warm.objective == pytest.approx(first.objective, rel=1e-3)


def test_solution_as_guess_for_other_numbers() -> None:
    """A warm start with other boundary values converges to what the cold one finds."""
    problem, mesh = orbit_raising(), PROBLEMS["orbit raising"][1]
    first = solve(problem, mesh)
    other = problem.with_initial(vr=0.02).with_time(final=3.4)
    warm, cold = solve(other, mesh, guess=first), solve(other, mesh)
    assert warm.objective == pytest.approx(cold.objective, rel=1e-9)
    assert warm.statistics.iterations <= cold.statistics.iterations


def test_guess_of_several_phases_with_parameters() -> None:
    """Boundary multipliers, free times, parameters and integrals travel with the solution."""
    model = go.Model("two controls")
    x, u, k = model.state("x"), model.control("u"), model.parameter("k", 1.0)
    model.ode({x: u - k * ca.sin(x)})
    problem = go.Problem("two phases")
    first, second = problem.phase("first", model), problem.phase("second", model)
    first.time(initial=0.0, final=(0.5, 2.0))
    second.time(initial=(0.5, 2.0), final=3.0)
    first.initial(x=1.0)
    second.final(x=-1.0)
    gain = problem.parameter("k", lower=0.2, upper=2.0, guess=1.0)
    problem.link(first, second)
    effort = [leg.integral(u**2 + x**2) for leg in (first, second)]
    problem.minimize(effort[0] + ca.sqrt(1 + effort[1]) + (gain - 0.7) ** 2 + first.final_time**2 / 4)
    meshes = {"first": go.Mesh.uniform(3, 4), "second": go.Mesh.uniform(4, 4)}
    once = go.solve(problem, mesh=meshes, tol=None)
    twice = go.solve(problem, mesh=meshes, guess=once, check=False)
    assert twice.statistics.iterations <= 2
    assert twice.parameter("k") == pytest.approx(once.parameter("k"), abs=1e-9)
    assert twice.phase("first").final_time == pytest.approx(once.phase("first").final_time, abs=1e-8)
