"""Solving again with other numbers: the closed forms of the double integrator, and what is refused."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from testing.internals import (
    ArcMesh,
    optimise_switching_times,
    solve_problem_on_mesh,
)
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import Resolver
from gnc_opt.planning.nlp.nlp_solver import NlpSolver
from gnc_opt.planning.optimal_control_solver import SolveMethod
from gnc_opt.planning.problem.initial_state_clipping import clip_initial_states_to_bounds
from gnc_opt.planning.refinement.warm_start_from_known_arcs import (
    KnownArcs,
    KnownSwitches,
    restore_initial_refinement_meshes,
)
from gnc_opt.planning.solution.phase_solution import truncate_phase_to_start_time


def cart(cost: str = "time") -> go.Problem:
    """A cart of acceleration gain * u to rest at the origin."""
    m = go.Model("cart")
    q, v = m.state("q"), m.state("v")
    u, gain = m.control("u"), m.parameter("gain", 1.0)
    m.ode({q: v, v: gain * u})
    p = go.Problem("cart")
    leg = p.phase("leg", m)
    if cost == "time":
        leg.time(initial=0.0, final=(0.1, 20.0))
        p.minimize(leg.final_time)
    else:
        leg.time(initial=0.0, final=1.0)
        p.minimize(leg.integral(u**2))
    leg.bounds(u=(-1.0, 1.0) if cost == "time" else (-50.0, 50.0))
    leg.initial(q=-1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    return p


@pytest.fixture(scope="module")
def fast() -> Resolver:
    return Resolver(go.solve(cart(), mesh="6x3", tol=1e-8))


@pytest.mark.parametrize("distance", [1.0, 1.01, 1.4, 0.5])
def test_switch_times_are_those_of_the_closed_form(fast: Resolver, distance: float) -> None:
    """Half of 2 sqrt(d) forwards, half backwards; costates -(1, sqrt(d) - t) / sqrt(d)."""
    problem = fast.solution.need_problem("").with_initial(q=-distance)
    found = fast.solve(problem)
    assert found.provenance["way"] == SolveMethod.SWITCH_TIMES.value
    assert found.objective == pytest.approx(2 * distance**0.5, rel=1e-9)
    switches = [arc.end for arc in found.structure[:-1]]
    assert switches == pytest.approx([distance**0.5], rel=1e-7)
    leg = found.phase()
    assert leg.x(0.0) == pytest.approx([-distance, 0.0], abs=1e-12)
    assert leg.lam(0.0) == pytest.approx([-1 / distance**0.5, -1.0], rel=1e-6)
    assert go.verify(found).minimum


def test_parameters_change_the_flight(fast: Resolver) -> None:
    found = fast.solve(fast.solution.need_problem("").with_parameters(gain=4.0))
    assert found.provenance["way"] == SolveMethod.SWITCH_TIMES.value
    assert found.objective == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("begin", [0.3, 1.6])
def test_a_start_on_the_way_is_solved_from_the_rest(fast: Resolver, begin: float) -> None:
    """From (q, v) the origin is reached after 2 s - v, s = sqrt(v^2/2 - q) the speed at the switch."""
    known = fast.solution
    q, v = known.phase().x(begin) + np.array([-0.01, 0.02])
    speed = np.sqrt(0.5 * v**2 - q)
    problem = known.need_problem("").with_time(initial=begin).with_initial(q=q, v=v)
    if begin > 1.0:  # the switch has passed: no arc is left that could be moved, and v^2/2 + q is not 0
        assert fast.solve(problem).provenance["way"] == SolveMethod.COLD.value
        with pytest.raises(go.ProblemError, match="cold=False excludes a cold solve"):
            Resolver(known, cold=False).solve(problem)
        return
    found = fast.solve(problem)
    assert found.provenance["way"] == SolveMethod.SWITCH_TIMES.value
    assert found.objective == pytest.approx(begin + 2 * speed - v, rel=1e-9)
    assert found.phase().initial_time == begin and found.phase().x(begin) == pytest.approx([q, v], abs=1e-12)
    near = found.phase().x(begin + 0.1)
    later = problem.with_time(initial=begin + 0.1).with_initial(q=near[0], v=near[1])
    assert fast.solve(later, near=found).objective == pytest.approx(found.objective, rel=1e-9)


def test_a_start_on_a_smooth_way_is_solved_from_the_rest() -> None:
    """Least integral of u^2 from (q, v) in T = 0.6 s: 12 q^2/T^3 + 12 q v/T^2 + 4 v^2/T."""
    first = go.solve(cart("effort"), mesh="4x3", tol=None)
    problem = first.need_problem("").with_time(initial=0.4).with_initial(q=-0.7, v=1.5)
    found = Resolver(first, cold=False).solve(problem)
    assert found.provenance["way"] == SolveMethod.WARM.value
    cost = 12 * 0.7**2 / 0.6**3 - 12 * 0.7 * 1.5 / 0.6**2 + 4 * 1.5**2 / 0.6
    assert found.objective == pytest.approx(cost, rel=1e-8)


@pytest.mark.parametrize("begin", [0.3, 0.5, 0.0])
@pytest.mark.parametrize("scheme", ["LG", "LGR"])
def test_the_rest_of_a_solution_is_the_same_flight(begin: float, scheme: Any) -> None:
    first = go.solve(cart("effort"), mesh="4x3", scheme=scheme, tol=None)
    rest = truncate_phase_to_start_time(first.phase(), begin)
    times = np.linspace(begin, 1.0, 57)
    whole = first.phase()
    assert rest.initial_time == begin and rest.final_time == 1.0
    for name in ("x", "u", "lam", "applied"):
        same = getattr(whole, name)(times, "left")[:, 1:]
        assert getattr(rest, name)(times, "left")[:, 1:] == pytest.approx(same, abs=1e-9)
    assert rest.lam_start[:, 0] == pytest.approx(whole.lam(begin), abs=1e-12)
    assert rest.point_costates.shape == (2, rest.point_times.size)


def test_a_limit_that_the_flight_would_exceed_is_kept(fast: Resolver) -> None:
    """At most 0.8 m/s: 0.8 s up and down each, and (1 - 0.64) / 0.8 = 0.45 s between."""
    found = Resolver(fast.solution, tol=1e-4).solve(fast.solution.need_problem("").with_bounds(v=(-1.0, 0.8)))
    assert found.provenance["way"] == SolveMethod.COLD.value
    assert found.objective == pytest.approx(2.05, abs=1e-4)


def test_a_smooth_solution_is_solved_again_on_its_mesh() -> None:
    """Least integral of u^2 in 1 s: 12 d^2."""
    first = go.solve(cart("effort"), mesh="4x3", tol=None)
    found = Resolver(first).solve(first.need_problem("").with_initial(q=-2.0))
    assert found.provenance["way"] == SolveMethod.WARM.value
    assert found.objective == pytest.approx(48.0, rel=1e-8)


def test_what_is_no_variation_is_refused(fast: Resolver) -> None:
    with pytest.raises(go.ProblemError, match="not a variation of the resolver's problem"):
        fast.solve(cart())


@pytest.mark.parametrize("given", [None, "cart", 3])
def test_what_is_no_problem_or_solution_is_refused(fast: Resolver, given: Any) -> None:
    with pytest.raises(go.GncOptError, match=r"argument of Resolver.solve\(\)"):
        fast.solve(given)
    with pytest.raises(go.GncOptError, match=r"argument of Resolver\(\)"):
        Resolver(given)


def test_what_is_not_solved_is_refused(fast: Resolver) -> None:
    problem = fast.solution.need_problem("").with_initial(q=-3.0)
    options = go.SolverOptions(max_iterations=0)
    unsolved = go.solve(problem, mesh="2x2", tol=None, options=options, throw=False)
    with pytest.raises(go.GncOptError, match="cannot solve the solution"):
        Resolver(unsolved)
    with pytest.raises(go.GncOptError, match="tolerance of Resolver"):
        Resolver(fast.solution, tol=-1.0)


def test_a_guess_of_a_variation_is_solved_by_its_switch_times(fast: Resolver) -> None:
    """Unless a mesh, a tolerance or options are given, which ask for a collocated solution; all say how."""
    known = fast.solution
    problem = known.need_problem("").with_initial(q=-1.44)
    found = go.solve(problem, guess=known)
    assert found.provenance["way"] == SolveMethod.SWITCH_TIMES.value
    assert found.objective == pytest.approx(2.4, rel=1e-9)
    again = go.solve(problem.with_initial(q=-1.69), guess=found)
    assert again.provenance["way"] == SolveMethod.SWITCH_TIMES.value and again.objective == pytest.approx(
        2.6, rel=1e-9
    )
    for asked in (
        {"mesh": "6x3"},
        {"tol": 1e-6},
        {"tol": None},
        {"options": go.SolverOptions()},
        {"structure": "none"},
    ):
        other = go.solve(problem, guess=known, **asked)
        assert other.provenance["way"] == SolveMethod.WARM.value and other.objective == pytest.approx(
            2.4, rel=1e-3
        )
    assert "way" not in go.solve(problem, mesh="6x3", tol=None).provenance


def test_a_guess_of_another_problem_or_beyond_a_limit_is_a_start(fast: Resolver) -> None:
    assert go.solve(cart(), guess=fast.solution).provenance["way"] == SolveMethod.WARM.value
    limited = fast.solution.need_problem("").with_bounds(v=(-1.0, 0.8))
    found = go.solve(limited, guess=fast.solution)
    assert found.provenance["way"] == SolveMethod.WARM.value and found.objective == pytest.approx(
        2.05, rel=1e-9
    )
    assert found.converged and go.verify(found).minimum


def test_a_guess_that_leads_astray_is_left(fast: Resolver, monkeypatch: pytest.MonkeyPatch) -> None:
    limited = fast.solution.need_problem("").with_bounds(v=(-1.0, 0.8))
    module = importlib.import_module("gnc_opt.planning.optimal_control_solver")
    usual = solve_problem_on_mesh

    def lost(problem: go.Problem, mesh: Any = None, *, guess: Any = None, **given: Any) -> go.Solution:
        brief = {"options": go.SolverOptions(max_iterations=0)} if guess is not None else {}
        return usual(problem, mesh, guess=guess, **given | brief)

    monkeypatch.setattr(module, "solve_problem_on_mesh", lost)
    found = go.solve(limited, guess=fast.solution)
    assert found.provenance["way"] == SolveMethod.COLD.value and found.converged
    assert found.objective == pytest.approx(2.05, rel=1e-9)


def test_a_guess_by_switch_times_is_refined_where_these_fail(fast: Resolver) -> None:
    """Newton's method leaves no history, but its answer is as accurate as a refined one, and so is the next."""
    known = fast.solution.need_problem("")
    flown = go.solve(known.with_initial(q=-1.1), guess=fast.solution)
    assert flown.history is None
    found = go.solve(known.with_bounds(v=(-1.0, 0.8)), guess=flown)
    assert found.converged and found.objective == pytest.approx(2.05, rel=1e-9)


def test_a_chained_solve_keeps_to_limits_and_check(fast: Resolver) -> None:
    limited = fast.solution.need_problem("").with_bounds(v=(-1.0, 0.8))
    found = go.solve(limited, guess=fast.solution, tol=1e-6, check=False)
    assert found.history is not None and found.verdict is None
    with pytest.raises(go.SolveError):
        go.solve(limited, guess=fast.solution, limits=go.RefinementLimits(max_work=1e-3))


def test_meshes_of_arcs_are_no_first_meshes(limited: Resolver) -> None:
    """A solution with kinks has a mesh for its arcs, which serves no other structure."""
    known = limited.solution
    bent = {"leg": go.Mesh((0.0, 0.1, 0.5, 1.0), (6, 9, 6))}
    passes = tuple(replace(p, stage="nearby", meshes=bent) for p in known.history.passes)
    nearby = replace(known, history=replace(known.history, passes=passes))
    assert restore_initial_refinement_meshes(nearby) == {"leg": go.Mesh.uniform(20, 4)}


@pytest.mark.parametrize("tol", [{}, {"tol": 1e-6}])
def test_a_limit_that_is_no_longer_met(limited: Resolver, tol: dict[str, float]) -> None:
    """Half a metre is flown at 0.71 m/s at most: the arc on the limit is gone, and its boundaries with it."""
    found = go.solve(limited.solution.need_problem("").with_initial(q=-0.5), guess=limited.solution, **tol)
    assert found.objective == pytest.approx(2**0.5, rel=1e-9) and go.verify(found).minimum


def test_a_smooth_guess_is_as_accurate_again() -> None:
    """Least integral of (q' + q^3)^2 from d to 0 in T: q'^2 - q^6 = E is constant, and the mixed term an exact one.

    From a small d, where nearly nothing bends, the few segments that were enough have to be made more.
    """
    start, duration = 2.0, 1.0

    def integral(energy: float, of: Callable[[float], float]) -> float:
        return float(quad(lambda q: of(q) / np.sqrt(energy + q**6), 0.0, start, epsabs=0.0, epsrel=1e-11)[0])

    energy = brentq(lambda e: integral(e, lambda q: 1.0) - duration, 1e-3, 1e3, xtol=1e-13)
    cost = integral(energy, lambda q: 2 * q**6 + energy) - start**4 / 2
    m, _q, u = dynamics("spring", "q", "u", lambda q, u: {q: u - q**3})
    p, leg = one_phase("spring", m, initial=0.0, final=duration)
    leg.initial(q=0.1)
    leg.final(q=0.0)
    p.minimize(leg.integral(u**2))
    found = go.solve(p.with_initial(q=start), guess=go.solve(p, mesh="2x3"))
    assert found.converged and found.objective == pytest.approx(cost, rel=1e-8)


@pytest.mark.slow
def test_what_two_flights_have_in_common_does_not_depend_on_the_way(fast: Resolver) -> None:
    """Five variations: each by the known matrices and by matrices of its own, equal to the closed form."""
    problem = fast.solution.need_problem("")
    for k in range(5):
        distance = 0.3 * 1.9**k
        assert fast.solve(problem.with_initial(q=-distance)).objective == pytest.approx(
            2 * distance**0.5, rel=1e-9
        )


@pytest.fixture(scope="module")
def limited() -> Resolver:
    """At most 0.8 m/s on the way: bounds, the limit, bounds."""
    return Resolver(go.solve(cart().with_bounds(v=(-1.0, 0.8)), mesh="6x3", tol=1e-6), cold=False)


@pytest.mark.parametrize("distance", [1.01, 3.0])
def test_arcs_on_a_limit_serve_on(limited: Resolver, distance: float) -> None:
    """0.8 s up and down each, (d - 0.64) / 0.8 between: to all digits, not to those of a mesh."""
    problem = limited.solution.need_problem("").with_initial(q=-distance)
    expected = 1.6 + (distance - 0.64) / 0.8
    for found in (limited.solve(problem), go.solve(problem, guess=limited.solution)):
        assert found.provenance["way"] == SolveMethod.WARM.value
        assert found.objective == pytest.approx(expected, rel=1e-12)
        assert [arc.end for arc in found.structure[:2]] == pytest.approx([0.8, expected - 0.8], rel=1e-9)
        assert go.verify(found).minimum


def test_a_tolerance_asks_for_the_verdict_as_well(limited: Resolver) -> None:
    problem = limited.solution.need_problem("").with_initial(q=-1.2)
    found = go.solve(problem, guess=limited.solution, tol=1e-8)
    assert found.history is not None and found.history.converged and found.history.tolerance == 1e-8
    assert found.verdict is not None and found.objective == pytest.approx(2.3, rel=1e-12)


def test_a_start_on_an_arc_on_a_limit_is_solved_from_the_rest(limited: Resolver) -> None:
    """On the limit at 1 s with 0.3 m more to go than before: 0.375 s more."""
    known = limited.solution
    q = known.state("q")(1.0) - 0.3
    found = limited.solve(known.need_problem("").with_time(initial=1.0).with_initial(q=q, v=0.8))
    assert found.provenance["way"] == SolveMethod.WARM.value
    assert found.objective == pytest.approx(known.objective + 0.375, rel=1e-12)


def test_a_refined_smooth_solution_is_followed_on_its_mesh() -> None:
    """Least integral of u^2 in 1 s: 12 d^2; on the mesh of what is known, within its tolerance."""
    first = go.solve(cart("effort"), mesh="4x3")
    found = Resolver(first, cold=False).solve(first.need_problem("").with_initial(q=-2.0))
    assert found.provenance["way"] == SolveMethod.WARM.value
    assert found.phase().mesh == first.phase().mesh and found.objective == pytest.approx(48.0, rel=1e-10)


def test_boundaries_that_arcs_moved_stand_where_these_are_left_out(limited: Resolver) -> None:
    """On three segments that may go where they like, points see a limit where it is not exceeded: 1 % too fast."""
    found = go.solve(limited.solution.need_problem(""), guess=limited.solution, tol=None)
    assert not found.phase().mesh.movable and found.objective == pytest.approx(2.05, rel=1e-9)


def test_arcs_that_are_far_from_right_are_given_up_at_once(
    limited: Resolver, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = KnownArcs.from_solution(limited.solution)
    for worst, passes in ((1e-30, 1), (0.1, 2)):
        monkeypatch.setattr(sys.modules[optimise_switching_times.__module__], "NEARBY_MAX_ERROR", worst)
        _, history = optimise_switching_times(
            limited.solution, structures=known.structures, segments="nearby"
        )
        assert (history.converged, len(history.passes) <= passes) == (worst > 1e-3, True)


def test_what_is_no_start_is_refused(fast: Resolver, limited: Resolver) -> None:
    problem = fast.solution.need_problem("")
    other = go.solve(cart("effort"), mesh="4x3", tol=None)
    with pytest.raises(go.GncOptError, match=r"start of Resolver.solve\(\) must be of type .*not int"):
        fast.solve(problem, near=3)  # type: ignore[arg-type]
    strange = replace(other, phases={"other leg": other.phase()})
    with pytest.raises(go.ProblemError, match="other phases, states or controls"):
        limited.solve(limited.solution.need_problem(""), near=strange)


def test_arcs_begin_where_the_mesh_ends_them(limited: Resolver) -> None:
    """Samples show them a little off; on a mesh that has other ends they begin with few segments."""
    leg = limited.solution.phase()
    (found,) = KnownArcs.from_solution(limited.solution).structures.values()
    first, *inner, last = found.times
    known = ArcMesh.from_refined_mesh(
        found.with_switch_times((first, *(t + 1e-4 * leg.duration for t in inner), last)), leg.mesh
    )
    assert known.structure.times == pytest.approx(tuple(leg.breaks), rel=1e-14)
    assert known.build_mesh().degrees == leg.mesh.degrees
    (start, end, *others), (degree, *degrees) = leg.mesh.breaks, leg.mesh.degrees
    finer = go.Mesh((start, 0.5 * (start + end), end, *others), (degree, degree, *degrees))
    assert ArcMesh.from_refined_mesh(found, finer).build_mesh().degrees == finer.degrees
    far = found.with_switch_times((first, *(t + 0.05 * leg.duration for t in inner), last))
    assert ArcMesh.from_refined_mesh(far, leg.mesh) == ArcMesh.from_structure(far)


@pytest.mark.parametrize("cost", ["time", "effort"])
def test_ctrl_c_ends_a_solve_and_begins_no_other(
    limited: Resolver, cost: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The solver returns what it has; neither arcs nor meshes are left for the start then."""
    resolver = limited if cost == "time" else Resolver(go.solve(cart("effort"), mesh="4x3", tol=None))
    attempts, run = [], NlpSolver._run_nlpsol

    def interrupted(solver: NlpSolver, start: Any, arguments: Any, watch: Any) -> Any:
        attempts.append(solver)
        watch.stop = True
        return run(solver, start, arguments, watch)

    monkeypatch.setattr(NlpSolver, "_run_nlpsol", interrupted)
    with pytest.raises(KeyboardInterrupt):
        resolver.solve(resolver.solution.need_problem("").with_initial(q=-1.3))
    assert len(attempts) == 1


def test_newtons_method_is_for_arcs_on_control_bounds(fast: Resolver, limited: Resolver) -> None:
    assert KnownSwitches.from_solution(fast.solution) is not None
    assert KnownSwitches.from_solution(limited.solution) is None  # of the speed limit


def test_arcs_of_a_variation_are_those_listed(limited: Resolver) -> None:
    """Times and kinds of the listed arcs replace those that samples show, unless other rows are at limits."""
    known = limited.solution
    (found,) = KnownArcs.from_solution(known).structures.values()
    arcs, (leg,) = known.structure, known.phases.values()
    assert set(found.times) == {t for arc in arcs for t in (arc.start, arc.end)}
    assert found.list_arcs("leg", (*leg.controls.labels, *leg.path_labels, *leg.states.labels)) == arcs
    begin, reached, left, end = found.times
    shown = found.with_switch_times((begin, reached + 1e-3, left - 0.1, end))
    assert shown.replace_arcs(arcs, leg) == found
    rounded = found.with_switch_times((begin, reached, left, end * (1 + 1e-15)))
    assert rounded.replace_arcs(arcs, leg) == rounded
    assert shown.replace_arcs([arc for arc in arcs if arc.channel == "u"], leg) == shown
    kinds = ((go.ArcKind.LOWER, go.ArcKind.INTERIOR, go.ArcKind.INTERIOR),) * 2
    touches = ((), ((2, go.ArcKind.UPPER),), ())
    touched = replace(found, times=(0.0, 0.5, 1.0), kinds=kinds, touches=touches)
    moved = touched.with_switch_times((0.0, 0.4, 1.0))
    assert moved.replace_arcs(touched.list_arcs("leg", ("u", "q", "v")), leg) == touched


def test_a_measured_start_slightly_beyond_a_bound_begins_on_it(limited: Resolver) -> None:
    """The answer is that of a start on the bound, and says so; a start farther away is refused.

    At 0.8 m/s from 1 m: (1 - 0.32) / 0.8 until the brakes, and 0.8 s with them.
    """
    known = limited.solution
    problem, resolver = known.need_problem(""), Resolver(known)
    for solve in (resolver.solve, lambda varied: go.solve(varied, guess=known)):
        beyond = solve(problem.with_initial(q=-1.0, v=0.8003))
        assert beyond.objective == pytest.approx(1.65, rel=1e-9)
        assert beyond.provenance["start"] == "v = 0.8 (given 0.0003 beyond)"
        assert "v = 0.8 (given 0.0003 beyond)" in str(beyond)
        with pytest.raises(go.GncOptError, match="outside its bounds"):
            solve(problem.with_initial(q=-1.0, v=0.85))
    rounded = resolver.solve(problem.with_initial(q=-1.0, v=0.8 * (1 + 1e-15)))
    assert "start" not in rounded.provenance
    free = (
        clip_initial_states_to_bounds(problem.with_initial(q=None, v=0.8003))[0].phases["leg"].numbers.initial
    )
    assert (free.lower.tolist(), free.upper.tolist()) == ([-np.inf, 0.8], [np.inf, 0.8])
