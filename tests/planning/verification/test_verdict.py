"""The verdict passes what is right and fails what is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from testing.internals import Interval, PiecewisePolynomial
from testing.models import double_integrator, dynamics, one_phase
from testing.wrong_solutions import added, with_leg

import gnc_opt as go
from gnc_opt.planning import ConditionResult


def minimum_energy() -> go.Problem:
    problem = go.Problem("minimum energy")
    model = double_integrator()
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2))
    return problem


def minimum_time() -> go.Problem:
    problem, leg = one_phase("minimum time", double_integrator(), 0.0, (0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    return problem


def switching(times: list[float], arcs: list[int]) -> go.Solution:
    """The minimum-time problem with a given control structure, switch times optimised."""
    mesh = go.Mesh.at_times(times, 5, movable=True)
    return go.solve(minimum_time().with_fixed_arcs(arcs=[arcs]), mesh=mesh, tol=None)


def scaled(polynomial: PiecewisePolynomial, factor: float) -> PiecewisePolynomial:
    return PiecewisePolynomial(
        polynomial.breaks, polynomial.nodes, tuple(factor * v for v in polynomial.values)
    )


def failed(solution: go.Solution, tol: float = 1e-5) -> set[str]:
    return {c.name for c in go.verify(solution, tol=tol).failed}


@pytest.fixture(scope="module")
def energy() -> go.Solution:
    return go.solve(minimum_energy(), mesh="3x5", tol=None)


@pytest.fixture(scope="module")
def bang_bang() -> go.Solution:
    return switching([0.0, 0.9, 2.0], [-1, 1])


def test_smooth_optimum_holds_to_rounding(energy: go.Solution) -> None:
    verdict = go.verify(energy, tol=1e-10)
    assert verdict.minimum, verdict.explain()


def test_bang_bang_optimum_holds_with_hamiltonian_minus_one(bang_bang: go.Solution) -> None:
    verdict = go.verify(bang_bang, tol=1e-8)
    assert verdict.minimum, verdict.explain()
    assert bang_bang.objective == pytest.approx(2.0, abs=1e-9)
    times = np.linspace(0.0, bang_bang.objective, 101)
    np.testing.assert_allclose(bang_bang.hamiltonian(times), -1.0, atol=1e-8)


def test_perturbed_control_fails(energy: go.Solution) -> None:
    wrong = with_leg(energy, u=scaled(energy.phase().u, 1.01))
    assert {"dynamics", "stationarity", "cost"} <= failed(wrong)
    assert "switch" not in go.verify(wrong)["dynamics"].where
    least = go.verify(wrong).smallest_tolerance  # kinks and second-order conditions have their own measures
    assert least == max(c.value for c in go.verify(wrong).conditions if c.name in failed(wrong))
    for factor, failing in ((0.99, True), (1.01, False)):
        assert bool(go.verify(wrong, tol=factor * least).failed) is failing


def test_flipped_costate_sign_fails(bang_bang: go.Solution, energy: go.Solution) -> None:
    flipped = with_leg(bang_bang, lam=scaled(bang_bang.phase().lam, -1.0))
    assert {"stationarity", "active set", "minimum principle"} <= failed(flipped)
    flipped = with_leg(energy, lam=scaled(energy.phase().lam, -1.0))
    assert {"stationarity", "minimum principle"} <= failed(flipped)


def test_costate_of_wrong_magnitude_fails(bang_bang: go.Solution) -> None:
    doubled = with_leg(bang_bang, lam=scaled(bang_bang.phase().lam, 1.001))
    assert failed(doubled) == {"stationarity"}  # H = -1 is what fixes the magnitude


def test_wrong_switch_structure_fails() -> None:
    """Coasting between the bangs is feasible and optimal for that structure, yet not for the problem."""
    model = double_integrator()
    problem, leg = one_phase("with a useless coast", model, 0.0, (0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    mesh = go.Mesh((0.0, 0.2, 0.8, 1.0), (5, 5, 5))  # the switches may not move
    coast = go.solve(
        problem.with_fixed_arcs(arcs=[[-1, 0, 1]]).with_bounds(v=(-0.5, 0.5)), mesh=mesh, tol=None
    )
    wrong = replace(with_leg(coast, state_bounds=bounds_of(problem)), problem=problem)
    assert coast.objective > 2.1
    assert "minimum principle" in failed(wrong)


def bounds_of(problem: go.Problem) -> Interval:
    return problem.get_phase().numbers.states


def test_misplaced_switch_fails() -> None:
    """Setting off in the wrong direction for a given share of the way is feasible, but a sign is wrong."""
    mesh = go.Mesh((0.0, 0.1, 0.6, 1.0), (5, 5, 5), movable=(2,))
    wrong = go.solve(minimum_time().with_fixed_arcs(arcs=[[1, -1, 1]]), mesh=mesh, tol=None)
    assert wrong.objective > 2.01
    assert {"active set", "minimum principle"} <= failed(wrong)
    assert not {"dynamics", "limits", "boundary conditions"} & failed(wrong)


def test_vanished_arc_on_the_wrong_side_is_named() -> None:
    """A superfluous arc shrinks to nothing; the time is right, but the structure is not that of the optimum."""
    solution = switching([0.0, 0.5, 1.5, 2.5], [1, -1, 1])
    assert solution.objective == pytest.approx(2.0, abs=1e-7)
    # An arc without length changes the cost by nothing.
    assert failed(solution, tol=1e-4) == {"switching times"}


def test_switch_off_the_mesh_boundary_fails() -> None:
    smeared = go.solve(minimum_time(), mesh="7x3", tol=None)
    assert {"dynamics", "stationarity", "minimum principle"} <= failed(smeared)
    assert go.verify(smeared)["dynamics"].where.endswith("; a: a switch within the segment is not resolved")


def test_bound_enforced_only_at_nodes_fails() -> None:
    """One interval of degree 8: J = 3.98 < 4, with the state bound broken between the nodes."""
    problem = (
        minimum_energy().with_initial(q=0.0, v=1.0).with_final(q=0.0, v=-1.0).with_bounds(q=(None, 1 / 9))
    )
    solution = go.solve(problem, mesh="1x8", tol=None)
    assert solution.objective < 3.99
    assert "limits" in failed(solution)
    assert ", q = " in go.verify(solution)["limits"].where


def test_maximum_of_the_hamiltonian_fails() -> None:
    """u = 0 is a stationary point of (u^2 - 1)^2, but a maximum."""
    model, _x, u = dynamics("well", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("double well", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=0.0)
    leg.bounds(u=(-2.0, 2.0))
    problem.minimize(leg.integral((u**2 - 1) ** 2))
    pinned = go.solve(problem.with_bounds(u=(0.0, 0.0)), mesh="4x4", tol=None)
    free = replace(
        with_leg(pinned, control_bounds=Interval(np.array([-2.0]), np.array([2.0]))), problem=problem
    )
    assert failed(free) == {"minimum principle"}


def test_singular_control_of_first_order_is_reported() -> None:
    model, x, _u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("singular", model, 0.0, 2.0)
    leg.initial(x=0.5)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(x**2))  # u = -1 down to x = 0 at t = 0.5 s, then u = 0 is singular
    verdict = go.verify(go.solve(problem, mesh="4x4", tol=None), tol=1e-4)
    assert verdict.minimum


def test_solution_without_costates_is_inconclusive(energy: go.Solution) -> None:
    verdict = go.verify(with_leg(energy, lam=scaled(energy.phase().lam, np.nan)))
    assert verdict["stationarity"].result is ConditionResult.INCONCLUSIVE
    assert verdict["dynamics"].result is ConditionResult.PASS
    assert not verdict.minimum


def test_broken_boundary_value_fails(energy: go.Solution) -> None:
    leg = energy.phase()
    wrong = with_leg(
        energy, final_bounds=Interval(leg.final_bounds.lower + 0.01, leg.final_bounds.upper + 0.01)
    )
    assert "boundary conditions" in failed(wrong)


def test_wrong_objective_fails(energy: go.Solution) -> None:
    assert failed(replace(energy, objective=energy.objective * 1.001)) == {"cost"}


def test_free_final_value_with_wrong_costate_fails(energy: go.Solution) -> None:
    """The same trajectory, had the final speed been free, is not optimal: its costate there is not zero."""
    free = energy.problem.with_final(v=None)
    wrong = replace(with_leg(energy, final_bounds=free.get_phase().numbers.final), problem=free)
    assert failed(wrong) == {"stationarity"}
    assert go.verify(wrong)["stationarity"].where.endswith("costate of v")


def test_unstable_dynamics_are_not_checked_by_a_single_propagation() -> None:
    """Hyper-sensitive problem: errors grow by exp(40), yet the solution is right."""
    _model, *_ = dynamics("hypersensitive", "x", "u", lambda x, u: {x: -(x**3) + u + 0 * x})
    unstable, y, w = dynamics("unstable", "y", "w", lambda y, w: {y: 20 * y + w})
    problem, leg = one_phase("stabilise", unstable, 0.0, 2.0)
    leg.initial(y=1.0)
    leg.final(y=0.0)
    problem.minimize(leg.integral(y**2 + w**2))
    solution = go.solve(problem, mesh="40x8", tol=None)
    verdict = go.verify(solution)
    assert verdict.minimum, verdict.explain()
    assert go.verify(added(solution, "u", 0, 0.1, segment=20))["dynamics"].result is ConditionResult.FAIL


def test_every_condition_reports_number_place_and_meaning(bang_bang: go.Solution) -> None:
    for condition in go.verify(bang_bang).conditions:
        assert np.isfinite(condition.value) or condition.result is ConditionResult.INCONCLUSIVE
        assert condition.where and len(condition.meaning) > 40
    table = str(go.verify(bang_bang))
    assert "stationarity" in table and table.endswith("verdict: ok")


def test_unknown_condition_and_wrong_arguments_are_refused(energy: go.Solution) -> None:
    with pytest.raises(go.UnknownNameError, match="did you mean 'dynamics'"):
        go.verify(energy)["dynamic"]
    with pytest.raises(go.ProblemError, match="positive"):
        go.verify(energy, tol=-1.0)
    with pytest.raises(go.GncOptError, match="needs a Solution"):
        go.verify(minimum_energy())  # type: ignore[arg-type]
    with pytest.raises(go.GncOptError, match="without its problem"):
        go.verify(replace(energy, problem=None))


def test_state_jump_between_segments_fails(energy: go.Solution) -> None:
    x = energy.phase().x
    shifted = (x.values[0], x.values[1] + 0.01, *x.values[2:])
    wrong = with_leg(energy, x=PiecewisePolynomial(x.breaks, x.nodes, shifted))
    assert "dynamics" in failed(wrong)


def test_costates_that_vanish_in_one_phase_only_are_checked() -> None:
    """The cost is the first phase's final time: the second one's costates are zero, and rightly so."""
    problem = go.Problem("one of two matters")
    for name in ("first", "second"):
        leg = problem.phase(name, double_integrator())
        leg.time(0.0, (0.1, 10.0) if name == "first" else 1.0)
        leg.initial(q=1.0, v=0.0)
        leg.bounds(a=(-1.0, 1.0))
    problem.phases["first"].final(q=0.0, v=0.0)
    problem.minimize(problem.phases["first"].final_time)
    meshes = {"first": go.Mesh.uniform(2, 5), "second": go.Mesh.uniform(2, 5)}
    solution = go.solve(problem, mesh=meshes, tol=None)
    second = solution.phases["second"]
    still = {"first": solution.phases["first"], "second": replace(second, lam=scaled(second.lam, 0.0))}
    verdict = go.verify(replace(solution, phases=still), tol=1e-4)
    assert verdict["stationarity"].result is ConditionResult.PASS
    assert verdict["stationarity"].result is ConditionResult.PASS
    none = {name: replace(leg, lam=scaled(leg.lam, 0.0)) for name, leg in still.items()}
    assert go.verify(replace(solution, phases=none))["stationarity"].result is ConditionResult.INCONCLUSIVE
