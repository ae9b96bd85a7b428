"""The verdict on vector controls: the least Hamiltonian over a ball or an annulus is known in closed form."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from testing.second_order import second_order_of

import gnc_opt as go
from gnc_opt.planning.optimality.program_point import ProgramPoint
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.verification.critical_cone import (
    CriticalCone,
    aimed_gradient,
    lone_vector,
    without_idle_directions,
)
from gnc_opt.planning.verification.hamiltonian_minimum import _Search, limits

MAGNITUDE, DIRECTION = 0, slice(1, 3)


@cache
def flight(least: float) -> go.Solution:
    """One unit across in a field of forces, with the least integral of the norm, on a coarse mesh."""
    model = go.Model("cart")
    r, v = model.state("r", 2), model.state("v", 2)
    a, norm = model.vector_control("a", 2)
    model.ode({r: v, v: a - 0.3 * r})
    problem = go.Problem("move")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=3.0)
    leg.initial(r=[0.0, 0.0], v=[0.0, 0.2])
    leg.final(r=[1.0, 0.5], v=[0.0, 0.0])
    leg.norm_bounds(a=(least, 2.0))
    problem.minimize(leg.integral(norm))
    return go.solve(problem, mesh="12x3", tol=None)


def samples(solution: go.Solution, angle: float = 0.0) -> PhaseSamples:
    """The phase sampled, with its direction turned by an angle (rad)."""
    leg = solution.phase()
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    values = tuple(np.vstack([u[:1], turn @ u[DIRECTION]]) for u in leg.u.values)
    turned = replace(leg, u=replace(leg.u, values=values))
    return PhaseSamples.of(turned, solution.functions("leg"))


@pytest.mark.parametrize("least", [0.0, 0.2])
@pytest.mark.parametrize("angle", [0.0, 2.0])
def test_nothing_in_the_annulus_has_a_lower_hamiltonian(least: float, angle: float) -> None:
    s = samples(flight(least), angle)
    every = np.arange(s.times.size)
    (group,) = s.functions.coupled_controls
    vector = lone_vector(s, group)
    assert vector is not None
    search = _Search(s, group, every)
    lower, upper = limits(s)
    best = lower[:, None] + (upper - lower)[:, None] * search.aligned(vector)
    assert np.all(np.isclose(best[MAGNITUDE], least) | np.isclose(best[MAGNITUDE], 2.0))
    np.testing.assert_allclose(np.linalg.norm(best[DIRECTION], axis=0), 1.0, rtol=1e-12)
    lowest = s.functions.hamiltonian(s.times, s.x, best, s.lam)
    rng = np.random.default_rng(1)
    for _ in range(50):
        other = rng.uniform(-1.0, 1.0, best.shape)
        other[DIRECTION] /= np.linalg.norm(other[DIRECTION], axis=0)
        other[MAGNITUDE] = rng.uniform(least, 2.0, best.shape[1])
        assert np.all(s.functions.hamiltonian(s.times, s.x, other, s.lam) >= lowest - 1e-12)


@pytest.mark.parametrize("curve", ["cost", "path"])
def test_closed_form_is_for_affine_hamiltonians_without_other_limits(curve: str) -> None:
    model = go.Model("cart")
    v = model.state("v", 2)
    a, norm = model.vector_control("a", 2)
    model.ode({v: a})
    problem = go.Problem("move")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=3.0)
    leg.initial(v=[0.0, 0.0])
    leg.final(v=[1.0, 0.5])
    leg.norm_bounds(a=(0.0, 2.0))
    if curve == "path":
        leg.path("forwards", a[0] - 0.1 * norm, lower=0.0)
    problem.minimize(leg.integral(norm**2 if curve == "cost" else norm))
    s = samples(go.solve(problem, mesh="2x3", tol=None))
    assert lone_vector(s, s.functions.coupled_controls[0]) is None


def test_optimum_passes_and_a_turned_thrust_fails_the_minimum_principle() -> None:
    solution = go.refine(flight(0.0), tol=1e-7)
    verdict = go.verify(solution)
    assert verdict["minimum principle"].result is go.ConditionResult.PASS
    assert "searched" not in verdict["minimum principle"].meaning
    parts = second_order_of(solution)
    for name in ("Legendre-Clebsch", "singular arcs", "generalised Legendre-Clebsch"):
        assert parts[name].result is go.ConditionResult.PASS, name
    s = samples(solution)
    coasts = s.u[MAGNITUDE] == 0
    assert 0 < np.mean(coasts) < 1
    np.testing.assert_array_equal(s.idle, [np.zeros_like(coasts), coasts, coasts])
    leg = solution.phase()
    turn = np.array([[np.cos(0.02), -np.sin(0.02)], [np.sin(0.02), np.cos(0.02)]])
    values = tuple(np.vstack([u[:1], turn @ u[DIRECTION]]) for u in leg.u.values)
    wrong = replace(solution, phases={"leg": replace(leg, u=replace(leg.u, values=values))})
    assert go.verify(wrong)["minimum principle"].result is go.ConditionResult.FAIL


def test_a_direction_alone_is_judged_to_second_order() -> None:
    """Against a current, at speed 1 through the water: a magnitude that is fixed has no switch that could vary.

    Across a river of unit speed v < 1 the least time is 1 / sqrt(1 - v^2), steering against the current: sin = v.
    """
    model = go.Model("boat")
    r = model.state("r", 2)
    u, _ = model.vector_control("u", 2)
    model.ode({r: u + np.array([0.6, 0.0])})
    problem = go.Problem("across")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=(0.1, 10.0))
    leg.initial(r=[0.0, 0.0])
    leg.final(r=[0.0, 1.0])
    leg.norm_bounds(u=(1.0, 1.0))
    problem.minimize(leg.final_time)
    solution = go.solve(problem, mesh="3x4")
    assert solution.objective == pytest.approx(1 / 0.8, abs=1e-9)
    assert solution.control("u")(0.5) == pytest.approx([-0.6, 0.8], abs=1e-7)
    assert go.verify(solution)["second order"].result is go.ConditionResult.PASS


@pytest.mark.parametrize("angle", [0.0, 2.0])
def test_a_push_would_begin_along_the_primer_vector(angle: float) -> None:
    """Where nothing pushes the norm costs 1 and gains |lambda_v|, whatever the direction that was stored."""
    s = samples(flight(0.0), angle)
    coasts = s.u[MAGNITUDE] < 1e-9
    assert np.sum(coasts) > 20
    found = aimed_gradient(s, s.times, s.x, s.u, s.lam, s.mu)
    primer = np.linalg.norm(s.lam[2:], axis=0)
    np.testing.assert_allclose(found[MAGNITUDE, coasts], 1 - primer[coasts], atol=1e-12)
    np.testing.assert_array_equal(found[:, ~coasts], s.control_gradient[:, ~coasts])


@pytest.mark.parametrize("v0", [(0.3, -0.2), (0.0, 0.0)])
def test_a_coast_leaves_no_doubt_of_a_minimum(v0: tuple[float, float]) -> None:
    """Two burns in the plane with the least fuel: directions along the coast do nothing, and need not curve H."""
    model = go.Model("cart")
    r, v = model.state("r", 2), model.state("v", 2)
    a, norm = model.vector_control("a", 2)
    model.ode({r: v, v: a})
    problem = go.Problem("two burns")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=2.5)
    leg.initial(r=0.0, v=list(v0))
    leg.final(r=[0.6, 0.8], v=0.0)
    leg.norm_bounds(a=(0.0, 1.0))
    problem.minimize(leg.integral(norm))
    solution = go.solve(problem)
    if v0 == (0.0, 0.0):  # s (5/2 - s) = 1
        assert solution.objective == pytest.approx(1.0, abs=1e-7)
    verdict = go.verify(solution)
    assert verdict.minimum, verdict.explain()


def test_directions_are_held_where_their_magnitude_is_and_there_alone() -> None:
    solution = flight(0.0)
    s, cone = samples(solution), CriticalCone.of(ProgramPoint.of(solution))
    collocation = cone.point.transcription.parts["leg"].collocation
    magnitude, direction = collocation.point_controls[MAGNITUDE], collocation.point_controls[DIRECTION]
    length = cone.point.x.size + collocation.path_rows[0]
    strong = cone.strong.copy()
    strong[length] = True  # as if it were 1 along the coast, too
    held = without_idle_directions(replace(cone, strong=strong), [s])
    coasts = cone.point.x[magnitude] < 1e-9
    assert 0 < np.sum(coasts) < coasts.size
    assert np.all(cone.strong[magnitude[coasts]]) and not np.any(cone.strong[direction[:, coasts]])
    np.testing.assert_array_equal(held.strong[direction], [coasts, coasts])
    np.testing.assert_array_equal(held.strong[length], ~coasts)  # of what is held already no row is left
    freed = cone.strong.copy()
    freed[magnitude] = False  # a magnitude that nothing pushes to zero may grow, in any direction
    assert not np.any(without_idle_directions(replace(cone, strong=freed), [s]).strong[direction])
