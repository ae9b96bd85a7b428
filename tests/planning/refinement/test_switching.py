"""Switch times optimised with their arcs, and the meshes on which they are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from testing.internals import ARC_MAX_DEGREE, ArcMesh, PhaseStructure
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import ArcKind
from problems import rendezvous

# Structure detection and switch-time optimisation against closed forms and the rendezvous' references.


LOW, UP = ArcKind.LOWER, ArcKind.UPPER


def double_integrator(lower: float, upper: float) -> tuple[go.Problem, go.Phase]:
    model, *_ = dynamics("double integrator", "x v", "u", lambda x, v, u: {x: v, v: u})
    problem = go.Problem("double integrator")
    leg = problem.phase("leg", model)
    leg.bounds(u=(lower, upper))
    return problem, leg


def switching_times(solution: go.Solution) -> list[float]:
    """Inner boundaries of all arcs, in order."""
    end = solution.phase().final_time
    return sorted({arc.end for arc in solution.structure if arc.end < end})


def test_asymmetric_bounds() -> None:
    """Rest to rest over L with accelerations -b..a: t_f = sqrt(2 L (a + b) / (a b)), switch at t_f b / (a + b)."""
    a, b, length = 1.0, 2.0, 300.0
    problem, leg = double_integrator(-b, a)
    leg.time(0.0, (1.0, 100.0))
    leg.initial(x=0.0, v=0.0)
    leg.final(x=length, v=0.0)
    problem.minimize(leg.final_time)
    solution = go.solve(problem, tol=1e-8)
    t_f = np.sqrt(2 * length * (a + b) / (a * b))
    assert solution.objective == pytest.approx(t_f, abs=1e-8)
    assert switching_times(solution) == pytest.approx([t_f * b / (a + b)], abs=1e-8)
    assert [arc.kind for arc in solution.structure] == [ArcKind.UPPER, ArcKind.LOWER]
    assert go.verify(solution, tol=1e-8).minimum


def test_minimum_fuel() -> None:
    """Bang-off-bang: with T = 3 and unit thrust the engine burns (3 - sqrt 5) / 2 at each end."""
    model = go.Model("thrusters")
    x, v = model.state("x"), model.state("v")
    plus, minus = model.control("plus"), model.control("minus")
    model.ode({x: v, v: plus - minus})
    problem, leg = one_phase("minimum fuel", model, 0.0, 3.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    leg.bounds(plus=(0.0, 1.0), minus=(0.0, 1.0))
    problem.minimize(leg.integral(plus + minus))
    solution = go.solve(problem, tol=1e-8)
    burn = (3 - np.sqrt(5)) / 2
    assert solution.objective == pytest.approx(2 * burn, abs=1e-9)
    assert switching_times(solution) == pytest.approx([burn, 3 - burn], abs=1e-8)
    assert go.verify(solution, tol=1e-7).ok


def test_soft_lunar_landing() -> None:
    """Meditch 1964: one switch, at (2 sqrt 17 - 4) / 3 for these numbers."""
    model, _h, _v, u = dynamics("lander", "h v", "u", lambda h, v, u: {h: v, v: u - 1.5})
    problem, leg = one_phase("soft landing", model, 0.0, (0.1, 20.0))
    leg.initial(h=10.0, v=-2.0)
    leg.final(h=0.0, v=0.0)
    leg.bounds(u=(0.0, 3.0))
    leg.guess(time=[0.0, 4.0])
    problem.minimize(leg.integral(u))
    solution = go.solve(problem, tol=1e-8, check=False)
    assert solution.objective == pytest.approx(2 * np.sqrt(17), abs=1e-8)
    assert switching_times(solution) == pytest.approx([(2 * np.sqrt(17) - 4) / 3], abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("case", "equation"), [(5, "exact")])
def test_rendezvous_from_the_default_guess(case: int, equation: rendezvous.Equation) -> None:
    """Exact switch times, and a verdict of tolerance 1e-8, second-order conditions included."""
    problem = rendezvous.build(case, equation)
    solution = go.refine(go.solve(problem, mesh=rendezvous.MESH, tol=None), structure="bang-bang")
    reference = rendezvous.REFERENCE[case, equation]["exact"]
    assert solution.history is not None and solution.history.converged, solution.history
    assert solution.objective == pytest.approx(reference.value, abs=1e-9)
    verdict = go.verify(solution, tol=1e-8)
    assert verdict.minimum, verdict.explain()
    assert solution.accuracy.miss < 1e-8
    times = np.linspace(0.0, solution.objective, 10_000)
    np.testing.assert_allclose(np.asarray(solution.hamiltonian(times)), -1.0, atol=2e-8)
    arcs = {1: 24, 2: 25, 3: 20, 4: 24, 5: 24}[case]  # 18, 19, 14, 18, 18 switches and six channels
    assert abs(len(solution.structure) - arcs) <= 1


def test_refine_refuses_what_it_cannot_do() -> None:
    problem, leg = double_integrator(-1.0, 1.0)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=0.1, v=0.0)
    problem.minimize(leg.integral(leg.model.symbol("u") ** 2))
    solution = go.solve(problem, mesh="4x4", tol=None)
    with pytest.raises(go.ProblemError, match="linearly"):
        go.refine(solution, structure="bang-bang")
    with pytest.raises(go.ProblemError, match="did you mean 'bang-bang'"):
        go.refine(solution, structure="bangbang")  # type: ignore[arg-type]
    with pytest.raises(go.GncOptError, match="without its problem"):
        from dataclasses import replace

        go.refine(replace(solution, problem=None))


@pytest.mark.slow
def test_arcs_held_by_hand_are_a_start() -> None:
    """They belong to the mesh of the first solution; the refined one is of the problem without them."""
    problem, leg = double_integrator(-1.0, 1.0)
    leg.time(0.0, (0.1, 10.0))
    leg.initial(x=1.0, v=0.0)
    leg.final(x=0.0, v=0.0)
    problem.minimize(leg.final_time)
    held = problem.with_fixed_arcs(arcs=[[-1, 0, 1]])
    solution = go.solve(held, mesh=go.Mesh.at_times([0.0, 0.9, 1.2, 2.0], 4), tol=None)
    refined = go.refine(solution)
    assert refined.objective == pytest.approx(2.0, abs=1e-7)
    assert refined.problem is not None and refined.problem.fingerprint() == problem.fingerprint()


@pytest.mark.parametrize("structure", ["auto", "none"])
def test_what_is_best_with_arcs_held_by_hand_need_not_be_without(structure: Any) -> None:
    """Thrust up, then down, over 2 s: the first arc vanishes, as u = -1 costs least, 1 - 4/3 - 2 of all controls."""
    model, x, _u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("one switch", model, 0.0, 2.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.final_state("x") - 0.5 * leg.integral(x + x**2))
    mesh = go.Mesh.at_times([0.0, 1.0, 2.0], 4, movable=True)
    held = go.solve(problem.with_fixed_arcs(arcs=[[1, -1]]), mesh=mesh, tol=None)
    assert 0.0 < held.phase().breaks[1] < 1e-6
    refined = go.refine(held, structure=structure)
    assert refined.objective == pytest.approx(-7 / 3, abs=1e-9) and refined.converged
    assert go.verify(refined).minimum, go.verify(refined).explain()


def test_segments_of_a_piece_follow_the_steps_of_an_accurate_integration() -> None:
    """24 steps in the first piece, 3 in the second: 6 segments and 1, all of the highest degree."""
    structure = PhaseStructure((0.0, 1.0, 4.0), ((ArcKind.LOWER,), (ArcKind.UPPER,)), (), 1)
    plan = ArcMesh.from_integration_steps(structure, np.append(np.arange(24) / 24, [1.0, 2.0, 3.0, 4.0]))
    assert [(r.segments, r.degree) for r in plan.subarc_meshes] == [(6, ARC_MAX_DEGREE), (1, ARC_MAX_DEGREE)]
