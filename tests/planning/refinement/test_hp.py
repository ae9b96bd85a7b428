"""hp refinement of the mesh, and errors of costates as its indicator."""

from __future__ import annotations

import itertools
import sys
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from testing.constructed_solutions import fake
from testing.internals import WORK_PER_SECOND, WorkBudget, estimate_segment_errors, refine_mesh
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.numerical_tolerances import NOTABLE
from gnc_opt.planning import History, RefinementStatus
from gnc_opt.planning.refinement.collocation_error_estimate import (
    compute_costate_residual,
)
from gnc_opt.planning.refinement.hp_refinement import (
    KINK_ERROR_FACTOR,
    Kink,
    _bracket_activation_time,
    choose_mesh_breaks_around_kinks,
)
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.refinement_history import Actions

# hp refinement against closed forms: honest estimates, errors below tolerance, small meshes, true endings.


def regulator(duration: float = 10.0) -> go.Problem:
    """min 1/2 int x^2 + u^2, x' = u, x(0) = 1: x = cosh(T - t) / cosh T, J = tanh(T) / 2."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("regulator", model, initial=0.0, final=duration)
    leg.initial(x=1.0)
    problem.minimize(leg.integral((x**2 + u**2) / 2))
    return problem


def layered(rate: float = 100.0) -> go.Problem:
    """min 1/2 int x^2 + u^2 / rate^2 over 1 s, x' = u: a boundary layer exp(-rate t), J = tanh(rate) / (2 rate)."""
    model, x, u = dynamics("fast integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("layer", model, initial=0.0, final=1.0)
    leg.initial(x=1.0)
    problem.minimize(leg.integral((x**2 + (u / rate) ** 2) / 2))
    return problem


def pendulum() -> go.Problem:
    """Nonlinear and smooth: swing over half a turn with least effort."""
    model = go.Model("pendulum")
    angle, rate, torque = model.state("angle"), model.state("rate"), model.control("torque")
    model.ode({angle: rate, rate: torque - ca.sin(angle)})
    problem, leg = one_phase("pendulum", model, initial=0.0, final=6.0)
    leg.initial(angle=0.0, rate=0.0)
    leg.final(angle=np.pi, rate=0.0)
    problem.minimize(leg.integral(torque**2 / 2))
    return problem


def double_integrator(speed_limit: float | None = None, height: float | None = None) -> go.Problem:
    model, _q, _v, a = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem = go.Problem("double integrator")
    leg = problem.phase("leg", model)
    if height is not None:  # Bryson & Denham: J = 4 / (9 height) for height <= 1/6
        leg.time(initial=0.0, final=1.0)
        leg.initial(q=0.0, v=1.0)
        leg.final(q=0.0, v=-1.0)
        leg.bounds(q=(None, height))
        problem.minimize(leg.integral(a**2 / 2))
        return problem
    leg.time(initial=0.0, final=(0.1, 20.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=3.0, v=0.0)
    leg.bounds(a=(-2.0, 1.0))
    if speed_limit is not None:
        leg.bounds(v=(None, speed_limit))
    problem.minimize(leg.final_time)
    return problem


def chatter() -> go.Problem:
    """min int x^2 + (u^2 - 1)^2, x' = u: infimum 0 for a control that switches infinitely often."""
    model, x, u = dynamics("chatter", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("chatter", model, initial=0.0, final=1.0)
    leg.initial(x=0.0)
    leg.final(x=0.0)
    leg.bounds(u=(-2.0, 2.0))
    problem.minimize(leg.integral(x**2 + (u**2 - 1) ** 2))
    return problem


def two_phases() -> go.Problem:
    """The regulator in two linked phases, the second with a layer at its end: x(10) = 1 is asked for."""
    problem = go.Problem("two phases")
    legs = []
    for name, start, end in (("first", 0.0, 5.0), ("second", 5.0, 10.0)):
        model, x, u = dynamics(name, "x", "u", lambda x, u: {x: u})
        leg = problem.phase(name, model)
        leg.time(initial=start, final=end)
        legs.append((leg, leg.integral((x**2 + u**2) / 2)))
    legs[0][0].initial(x=1.0)
    legs[1][0].final(x=1.0)
    problem.link(legs[0][0], legs[1][0])
    problem.minimize(legs[0][1] + legs[1][1])
    return problem


def check(history: History, tol: float) -> None:
    assert history.status is RefinementStatus.CONVERGED, str(history)
    assert history.final_iteration.error <= tol


@pytest.mark.parametrize("mesh", ["4x4", "3x8"])
def test_estimate_is_honest_against_an_integrator(mesh: str) -> None:
    """Restarted on every segment, DOP853 departs from the polynomials about as far as the estimate says.

    The residual oscillates, so its integral stays below the integral of its magnitude, by about the number of its
    zeros (the degree); the dynamics amplify it by less than exp(2) over a segment.
    """
    solution = go.solve(pendulum(), mesh=mesh, options=go.SolverOptions(tolerance=1e-11), tol=None)
    error = estimate_segment_errors(solution)["leg"]
    leg, functions = solution.phase(), solution.phase_functions("leg")
    scale = error.samples.state_scale
    for k in range(leg.mesh.segments):
        left, right = leg.breaks[k], leg.breaks[k + 1]
        times = np.linspace(left, right, 60)[1:-1]
        run = solve_ivp(
            lambda t, x: functions.state_rates(t, x, leg.u(t, "right" if t < right else "left")),  # noqa: B023
            (left, right),
            leg.x(left, "right"),
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            t_eval=times,
        )
        departure = float(np.max(np.abs(run.y - leg.x(times)) / scale[:, None]))
        estimate = float(np.max(error.dynamics[:, k]))
        assert departure <= np.exp(2.0) * estimate + 1e-11
        assert estimate <= 10 * leg.mesh.degrees[k] * departure + 1e-11


def test_estimate_falls_like_the_order_of_the_method() -> None:
    """Residuals of degree n on halved segments fall by 2^(n + 1); 2^n is asked for."""
    errors = []
    for segments in (8, 16, 32):
        solution = go.solve(pendulum(), mesh=go.Mesh.uniform(segments, 4), tol=None)
        errors.append(float(np.max(estimate_segment_errors(solution)["leg"].dynamics)))
    assert errors[0] / errors[1] > 2**4 and errors[1] / errors[2] > 2**4


def test_estimate_sees_the_integrand_where_the_dynamics_are_exact() -> None:
    """x' = u is met exactly by polynomials; only the quadrature tells that the mesh is coarse."""
    solution = go.solve(layered(), mesh="4x3", tol=None)
    errors = estimate_segment_errors(solution)["leg"]
    assert np.max(errors.dynamics) < 1e-10
    assert np.max(errors.integrals) > 1e-3


@pytest.mark.parametrize("mesh", ["1x8", "2x4", "2x6", "4x3"])
def test_estimate_sees_the_overshoot_between_nodes(mesh: str) -> None:
    """Bryson & Denham on meshes that do not know the kinks; the parabolas between samples may overstate flat tops."""
    solution = go.solve(double_integrator(height=1 / 9), mesh=mesh, tol=None)
    overshoot = 9 * (np.max(np.asarray(solution.state("q")(solution.phase().sample_times(500)))) - 1 / 9)
    estimate = np.max(estimate_segment_errors(solution)["leg"].overshoot[0])
    assert overshoot > 1e-4
    # relative to the largest q, which exceeds 1/9 by the overshoot itself
    assert 0.8 * overshoot < estimate < 10 * overshoot


@pytest.mark.parametrize("scheme", ["LGR"])
def test_boundary_layer(scheme: str) -> None:
    """The cost to the tolerance, the state to its root (an optimal cost is flat in the state)."""
    first = go.solve(layered(), scheme=scheme, tol=None)  # type: ignore[arg-type]
    solution, history = refine_mesh(first, tol=1e-8)
    check(history, 1e-8)
    error = estimate_segment_errors(first)["leg"]
    assert np.max(error.largest_segment_errors) > 1e-5, "the default mesh would do: the test tests nothing"
    assert solution.objective == pytest.approx(np.tanh(100.0) / 200.0, rel=1e-8)
    times = np.linspace(0.0, 1.0, 1001)
    exact = np.exp(-100.0 * times)
    assert np.max(np.abs(np.asarray(solution.state("x")(times)) - exact)) < 1e-5
    assert solution.phase().scheme == scheme


@pytest.mark.slow
def test_a_thin_layer_is_resolved() -> None:
    """The first mesh has five hundred of its time constants in one segment. J = 1 / (2 k) with k = 1e4."""
    refined, history = refine_mesh(go.solve(layered(1e4), tol=None), tol=1e-8)
    assert history.converged and history.passes[0].error > 1e5 and len(history.passes) <= 16
    assert refined.objective == pytest.approx(1 / 2e4, rel=1e-12)


def test_derivatives_that_are_undefined_at_the_start_alone_do_not_make_errors_infinite() -> None:
    """Quadratic drag from rest: the derivative of |v| v in v is 0/0 at v = 0, and elsewhere defined."""
    model, *_ = dynamics(
        "boat", "r:2 v:2", "a:2", lambda r, v, a: {r: v, v: a - 0.1 * ca.sqrt(ca.sumsqr(v)) * v}
    )
    problem, leg = one_phase("from rest", model, initial=0.0, final=2.0)
    leg.initial(r=[0.0, 0.0], v=[0.0, 0.0])
    leg.final(r=[1.0, 1.0])
    a = model.symbol("a")
    problem.minimize(leg.integral(ca.sumsqr(a)))
    solution = go.solve(problem)
    assert solution.history.converged and solution.history.final_iteration.error < 1e-6


def test_tighter_tolerances_cost_points_and_bring_accuracy() -> None:
    first, exact = go.solve(layered(), tol=None), np.tanh(100.0) / 200.0
    errors, points = [], []
    for tol in (1e-4, 1e-8):
        solution, history = refine_mesh(first, tol=tol)
        check(history, tol)
        errors.append(abs(solution.objective / exact - 1))
        points.append(history.final_iteration.n_points)
    assert errors[0] < 1e-4 and errors[1] < 1e-8 and points[0] < points[1]


@pytest.mark.slow
def test_state_constraint_from_both_sides() -> None:
    """Bryson & Denham with height 1/9: J = 4; node-only constraints make it too small, kinks too large."""
    solution, history = refine_mesh(go.solve(double_integrator(height=1 / 9), tol=None), tol=1e-8)
    check(history, 1e-8)
    assert solution.objective == pytest.approx(4.0, rel=1e-7)


@pytest.mark.parametrize("width", [0.1, 0.3])
def test_a_ridge_that_is_touched_inside_a_segment_gets_a_break(width: float) -> None:
    """Breaks at the ends of the segment alone leave the ridge between its nodes: the refinement then stalls.

    3.5186 is the optimum of a quadratic program with 500 piecewise constant controls, too large by about 6e-5.
    """
    model, *_ = dynamics("glider", "q v a", "u", lambda q, v, a, u: {q: v, v: a, a: (u - a) / 0.3})
    problem, leg = one_phase("ridge", model, 0.0, 10.0)
    leg.initial(q=0.5, v=0.0, a=0.0)
    q, u = model.symbol("q"), model.symbol("u")
    leg.path("clearance", q - 1.0 / ca.cosh((model.time - 4.8) / width) ** 2, lower=0.0)
    problem.minimize(leg.integral(q**2 + u**2))
    solution, history = refine_mesh(go.solve(problem, mesh="5x4", tol=None), tol=1e-5)
    assert history.converged
    assert solution.objective == pytest.approx(3.5185, rel=2e-5)


def test_phases_are_refined_together() -> None:
    """In one phase: x = (cosh(t - 5) / cosh 5), J = tanh 5; both halves cost the same."""
    solution, history = refine_mesh(go.solve(two_phases(), mesh="2x3", tol=None), tol=1e-8)
    check(history, 1e-8)
    assert solution.objective == pytest.approx(np.tanh(5.0), rel=1e-8)
    assert solution.state("x", "second")(5.0) == pytest.approx(1 / np.cosh(5.0), abs=1e-6)
    sizes = [mesh.size for mesh in history.final_iteration.meshes.values()]
    assert all(size > 6 for size in sizes) and abs(sizes[0] - sizes[1]) <= 6


def test_point_limit() -> None:
    first = go.solve(layered(), mesh="6x4", tol=None)
    _, history = refine_mesh(first, tol=1e-10, budget=WorkBudget(max_points=30))
    assert history.status is RefinementStatus.POINT_LIMIT
    assert "max_points" in history.message
    assert all(mesh.size <= 30 for p in history.passes for mesh in p.meshes.values())


def test_pass_limit() -> None:
    solution, history = refine_mesh(go.solve(layered(), tol=None), tol=1e-10, budget=WorkBudget(max_passes=1))
    assert history.status is RefinementStatus.ITERATION_LIMIT and len(history.passes) == 2
    assert "max_passes" in history.message and solution.objective == history.final_iteration.objective


@pytest.mark.slow
def test_chatter_stalls() -> None:
    _, history = refine_mesh(go.solve(chatter(), tol=None), tol=1e-8)
    assert history.status is RefinementStatus.STALLED
    assert "chatter" in history.message


def test_work_limit() -> None:
    """Passes end with the work that is allowed; and the best solution is kept."""
    first = go.solve(layered(), tol=None)
    _, whole = refine_mesh(first, tol=1e-10)
    leg = first.phase()
    enough = whole.passes[1].work * (leg.states.size + leg.controls.size) / WORK_PER_SECOND
    solution, history = refine_mesh(first, tol=1e-10, budget=WorkBudget(1.1 * enough))
    assert history.status is RefinementStatus.BUDGET_LIMIT and len(history.passes) == 3
    assert history.chosen == 1
    assert "max_work" in history.message and solution.objective == history.final_iteration.objective
    _, at_once = refine_mesh(solution, tol=1.0, budget=WorkBudget(0.0))
    assert at_once.converged


def test_interruption_keeps_the_best_solution() -> None:
    first = go.solve(pendulum(), mesh="3x3", tol=None)
    options = go.SolverOptions(max_wall_time=1e-9)
    solution, history = refine_mesh(first, tol=1e-8, options=options)
    assert history.status is RefinementStatus.INTERRUPTED
    assert solution is first and history.chosen == 0


def test_unsolved_and_detached_solutions_are_refused() -> None:
    detached = replace(go.solve(regulator(), mesh="4x4", tol=None), problem=None)
    with pytest.raises(go.GncOptError, match="without its problem"):
        refine_mesh(detached)
    options = go.SolverOptions(max_iterations=1)
    failed = go.solve(pendulum(), options=options, throw=False, tol=None)
    with pytest.raises(go.GncOptError, match="iteration_limit"):
        go.refine(failed)


def test_history_says_what_happened() -> None:
    solution, history = refine_mesh(go.solve(layered(), tol=None), tol=1e-6)
    text = str(history)
    assert text.count("\n") == len(history.passes) + 1 and "converged" in text
    assert history.final_iteration.meshes["leg"] == solution.phase().mesh
    assert history.passes[0].error > history.tolerance >= history.final_iteration.error
    for before, after in itertools.pairwise(history.passes):
        (old,), (new,) = before.meshes.values(), after.meshes.values()
        firsts = np.searchsorted(after.times["leg"], before.times["leg"])
        n_pieces, degrees = np.diff(firsts), np.array(new.degrees)[firsts[:-1]]
        raised = int(np.sum((n_pieces == 1) & (degrees > old.degrees)))
        assert after.actions == Actions(raised, int(np.sum(n_pieces > 1)))


@pytest.mark.parametrize(("row", "at"), [((-4.0, -2.0, 1.0, 3.0), 2), ((-4.0, -2.0, 0.0, 2.0), 2)])
def test_multipliers_point_at_a_jump_between_two_limits(row: tuple[float, ...], at: int) -> None:
    """Multipliers that pass through zero do so where a straight line says, with or without a point between."""
    times, pull = np.arange(4.0), np.array(row)
    zero = float(np.interp(0.0, pull, times))
    for duration in (1e1, 1e3):
        start, end = _bracket_activation_time(times, pull, 1, duration)
        assert 0.5 * (start + end) == pytest.approx(zero) and times[1] <= start < end <= times[at + 1]
    assert end - start == pytest.approx(
        2 * KINK_ERROR_FACTOR * (np.diff(times[pull != 0][1:3])[0]) ** 2 / 1e3
    )


@pytest.mark.parametrize("side", [1, -1])
def test_multipliers_point_at_the_end_of_an_arc(side: int) -> None:
    """From 3 over 1 down to zero in the gap from 1 to 2: at 1.5; and the same way round in reverse."""
    times, pull = np.arange(4.0), np.array([3.0, 1.0, 0.0, 0.0])[::side]
    start, end = _bracket_activation_time(times, pull, 1, 1e3)
    assert 0.5 * (start + end) == pytest.approx(1.5) and end - start == pytest.approx(
        2 * KINK_ERROR_FACTOR / 1e3
    )


def test_a_multiplier_that_points_elsewhere_leaves_the_whole_gap() -> None:
    """Multipliers of constraints on states end with impulses; single ones point nowhere."""
    times = np.arange(4.0)
    for row in ((1.0, 1.0, 0.0, 0.0), (1.0, 3.0, 0.0, 0.0), (9.0, 8.0, 0.0, 0.0)):
        assert _bracket_activation_time(times, np.array(row), 1, 1e3) == (1.0, 2.0)
    assert _bracket_activation_time(times[:2], np.array([1.0, 0.0]), 0, 1e3) == (0.0, 1.0)


@pytest.mark.parametrize(
    ("kinks", "expected"),
    [
        ([(2.2, 2.4)], [2.2, 2.4]),
        ([(2.2, 2.699)], [2.2, 2.699]),  # half of the segment
        ([(2.2, 2.8)], [2.2, 2.5, 2.8]),  # wider: the largest excess, too
        ([(2.3 - 1e-9, 2.3 + 1e-9)], [2.3]),  # its middle
        ([(2.6, 2.8), (2.1, 2.2)], [2.1, 2.2, 2.6, 2.8]),
        ([(2.2, 2.4), (2.41, 2.61)], [2.2, 2.4, 2.61]),  # closer than 0.02 of the segment
        ([(2.2, 2.4), (2.43, 2.63)], [2.2, 2.4, 2.43, 2.63]),
        ([(2.01, 2.4)], [2.4]),
        ([(2.3, 2.31), (2.316, 2.326)], [2.3, 2.31, 2.316, 2.326]),  # half of the narrowest
        ([(2.5, 2.99)], [2.5]),
    ],
)
def test_boundaries_enclose_kinks(kinks: Any, expected: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    """The segment from 2 to 3 of a phase of 4 s."""
    leg = fake(breaks=np.array([0.0, 2.0, 3.0, 4.0]), duration=4.0)
    monkeypatch.setattr(
        sys.modules[choose_mesh_breaks_around_kinks.__module__],
        "_locate_largest_violation",
        lambda error, k: [2.5],
    )
    error: Any = fake(samples=fake(phase=leg))
    found = choose_mesh_breaks_around_kinks(error, 1, [Kink(*kink) for kink in kinks])
    assert found == pytest.approx([2.0, *expected, 3.0], rel=1e-12)


@pytest.mark.slow
def test_a_limit_on_a_path_is_left_at_a_boundary() -> None:
    """From 0 to 3 m with accelerations in (-2, 1) as a path constraint: t_f = 3 s, switch at 2 s."""
    model, _q, _v, a = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v, v: a})
    free, leg = one_phase("limits as a path", model, initial=0.0, final=(0.1, 20.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=3.0, v=0.0)
    leg.path("acceleration", a, lower=-2.0, upper=1.0)
    free.minimize(leg.final_time)
    solution, history = refine_mesh(go.solve(free, tol=None), tol=1e-8)
    check(history, 1e-8)
    assert solution.objective == pytest.approx(3.0, rel=1e-7)
    assert np.min(np.abs(solution.phase().breaks - 2.0)) < 1e-4 and len(history.passes) < 12


def test_a_limit_that_nothing_touches_costs_no_iterations() -> None:
    problem = pendulum().with_bounds(torque=(-5.0, 5.0))
    free, limited = (refine_mesh(go.solve(p, mesh="6x4", tol=None))[1] for p in (pendulum(), problem))
    first = next(k for k, record in enumerate(limited.passes, 1) if record.error < NOTABLE)
    own, others = (sum(p.iterations for p in h.passes[first:]) for h in (limited, free))
    assert len(limited.passes) > first and own <= others, "each barrier beside the last one would cost two"


def test_what_is_accurate_already_is_left_alone() -> None:
    solution = go.solve(regulator(), mesh="12x6", tol=None)
    same, history = refine_mesh(solution, tol=1e-5)
    assert same is solution and len(history.passes) == 1


# hp refinement delivers costates: the adjoint equation holds between the nodes, where it means something.


def test_costates_converge_to_the_closed_form() -> None:
    """lam = sinh(T - t) / cosh T, to the accuracy of its own equation."""
    solution, _ = refine_mesh(go.solve(regulator(10.0), mesh="3x3", tol=None), tol=1e-8)
    times = np.linspace(0.0, 10.0, 400)
    exact = np.sinh(10.0 - times) / np.cosh(10.0)
    assert np.max(np.abs(np.asarray(solution.costate("x")(times)) - exact)) < 1e-5


def test_density_is_the_residual_of_the_costates() -> None:
    """With lam the polynomials of the solution, the density is |lam' + x|, worth max|x| over the cost's scale."""
    solution = go.solve(regulator(4.0), mesh="3x3", tol=None)
    leg = solution.phase()
    samples = PhaseSamples.from_phase(leg, solution.phase_functions("leg"))
    inner = samples.weights > 0
    times = samples.times[inner]
    residual = np.abs(leg.lam.derivative()(times)[0] + leg.x(times)[0])  # H_x = x
    worth = samples.state_scale[0] / samples.cost_scale
    density = compute_costate_residual(samples, np.zeros(0))[0, inner]
    assert np.max(residual) > 1e-3, "the mesh would be fine: the test tests nothing"
    np.testing.assert_allclose(density, residual * worth, rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("unit", [1e-3, 1e4])
@pytest.mark.parametrize("is_bound", [True, False])
def test_segments_along_a_state_constraint_do_not_count_in_any_unit(unit: float, is_bound: bool) -> None:
    """The state approaches 1, but stops at 1/2 of its unit: from there on costates follow from the constraint."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: unit * u})
    problem, leg = one_phase("limited", model, initial=0.0, final=4.0)
    leg.initial(x=0.0)
    if is_bound:
        leg.bounds(x=(None, 0.5 * unit))
    else:
        leg.path("limit", x, upper=0.5 * unit)
    problem.minimize(leg.integral((x / unit - 1) ** 2 + u**2))
    solution = go.solve(problem, mesh="6x3", tol=None)
    errors = estimate_segment_errors(solution)["leg"].costates[0]
    assert errors[0] > 0 and np.all(errors[2:] == 0)


def test_the_error_is_of_second_order_in_the_costates() -> None:
    """Squares: halving segments of degree n divides the error by more than 4^n, asked for: 4^(n - 1)."""
    errors = []
    for segments in (4, 8, 16):
        solution = go.solve(regulator(4.0), mesh=go.Mesh.uniform(segments, 3), tol=None)
        errors.append(float(np.max(estimate_segment_errors(solution)["leg"].costates)))
    assert all(old / new > 4**2 for old, new in itertools.pairwise(errors))
