"""Multipliers: saddle-point systems, first-order points, and the least of several."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.constructed_solutions import interval
from testing.internals import SCHEMES, ScaledNlp, Scheme, transcribe_problem
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.numerical_tolerances import ACTIVE, SMALL
from gnc_opt.planning.direct.minimum_norm_multipliers import _project_to_null_space, minimise_multiplier_norm
from gnc_opt.planning.optimality.kkt_system import (
    ProgramLimits,
    ProgramPoint,
    build_kkt_matrix,
    compute_quadrature_weights,
)
from gnc_opt.planning.study import kkt_sensitivity as saddle
from gnc_opt.planning.study.kkt_sensitivity import SaddlePointSystem, take_newton_step
from gnc_opt.planning.transcription.collocation_families import GAUSS

# Saddle points: against dense algebra; what is not determined, and what contradicts itself.


RNG = np.random.default_rng(3)


def system(hessian: Any, rows: Any, labels: str = "abcdefgh") -> SaddlePointSystem:
    hessian, rows = np.atleast_2d(np.asarray(hessian, float)), np.atleast_2d(np.asarray(rows, float))
    return SaddlePointSystem(
        scipy.sparse.csc_array(dense(hessian, rows)), len(hessian), list(labels), "by hand"
    )


def dense(hessian: Any, rows: Any) -> Any:
    return np.block([[hessian, np.transpose(rows)], [rows, np.zeros((len(rows), len(rows)))]])


def test_a_badly_scaled_system_is_solved_as_a_dense_one() -> None:
    """Rows that differ by 1e4 in size; the answer is known beforehand."""
    rough = RNG.standard_normal((5, 5))
    size = 10.0 ** np.array([0, 2, -2, 1, -1])
    hessian = (rough @ rough.T + np.eye(5)) * np.outer(size, size)
    rows = RNG.standard_normal((2, 5)) * size
    matrix, wanted = dense(hessian, rows), RNG.standard_normal(7)
    found = system(hessian, rows)
    assert not found.redundant
    assert found.solve_saddle_point_system(matrix @ wanted) == pytest.approx(wanted, rel=1e-9)


def test_redundant_rows_are_borne_and_the_answer_is_as_sharp_as_without_them() -> None:
    """x = (1, 2) is the least of |x|^2 / 2 - 5 x_1 + 3 x_2 where x_1 + x_2 = 3, stated once, twice, and doubled."""
    for rows in ([[1, 1]], [[1, 1], [1, 1]], [[1, 1], [-2, -2], [1, 1]]):
        found = system(np.eye(2), rows)
        assert bool(found.redundant) is (len(rows) > 1)
        limits = 3 * np.asarray(rows, float)[:, 0]
        solved = found.solve_saddle_point_system(np.concatenate([[5.0, -3.0], limits]))
        x, multipliers = solved[:2], solved[2:]
        assert x == pytest.approx([5.5, -2.5], abs=1e-12)
        assert x + np.asarray(rows).T @ multipliers == pytest.approx([5.0, -3.0], abs=1e-12)


def test_rows_that_are_nearly_the_same_are_not_redundant() -> None:
    """They differ by 1e-4: two conditions, two multipliers."""
    rows = np.array([[1.0, 1.0], [1.0, 1.0001]])
    found = system(np.eye(2), rows)
    assert not found.redundant
    wanted = np.array([1.0, 2.0, 3.0, 4.0])
    assert found.solve_saddle_point_system(dense(np.eye(2), rows) @ wanted) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize(
    ("hessian", "rows", "culprit"),
    [
        (np.diag([1.0, 0.0, 2.0]), [[1.0, 0.0, 1.0]], "b"),  # structurally singular
        ([[2, 0, 0], [0, 1, 1], [0, 1, 1]], [[1.0, 0.0, 0.0]], "b|c"),
        (
            [[1, 0, 0], [0, 1, 0.25], [0, 0.25, 0.0625]],
            [[1.0, 0.0, 0.0]],
            "c",
        ),  # c moves four times as far as b
    ],
)
def test_what_nothing_determines_is_named(hessian: Any, rows: Any, culprit: str) -> None:
    with pytest.raises(go.GncOptError, match=f"'by hand' do not determine '({culprit})'"):
        system(hessian, rows)


@pytest.mark.parametrize("share", [0.3, 1 / 3, 0.9, 1.1])
def test_what_is_singular_but_for_rounding_is_distinguished_from_its_condition(share: float) -> None:
    """(a + share b)^2 / 2 leaves a line open; its last pivot is rounding, not zero."""
    matrix = np.array([[1.0, share], [share, share * share]])
    with pytest.raises(go.GncOptError, match=r"do not determine '(a|b)'"):
        SaddlePointSystem(scipy.sparse.csc_array(matrix), 2, ["a", "b"], "by hand")


def test_a_free_direction_shows_among_redundant_rows_too() -> None:
    """Two equal rows hold a; nothing holds b + c."""
    with pytest.raises(go.GncOptError, match=r"do not determine '(b|c)'"):
        system([[1, 0, 0], [0, 1, -1], [0, -1, 1]], [[1.0, 0, 0], [1.0, 0, 0]])
    assert SMALL < 1.0


def test_rows_that_contradict_each_other_are_named() -> None:
    found = system(np.eye(2), [[1, 1], [1, 1]])
    assert np.all(np.isfinite(found.solve_saddle_point_system(np.array([0.0, 0.0, 2.0, 2.0]))))
    with pytest.raises(go.GncOptError, match=r"contradict its constraints, at '(c|d)'"):
        found.solve_saddle_point_system(np.array([0.0, 0.0, 2.0, 2.001]))
    # A difference of rounding is none.
    assert found.solve_saddle_point_system(np.array([0.0, 0.0, 2.0, 2.0 + 1e-9]))[:2] == pytest.approx(
        [1.0, 1.0], abs=1e-6
    )
    assert found.solve_saddle_point_system(np.zeros(4)) == pytest.approx(np.zeros(4))


def test_a_single_unknown() -> None:
    found = SaddlePointSystem(scipy.sparse.csc_array(np.array([[4.0]])), 1, ["a"], "by hand")
    assert not found.redundant and found.solve_saddle_point_system(np.array([2.0])).tolist() == [0.5]


def test_scale_factors_bring_the_largest_entry_of_every_row_to_one() -> None:
    rough = np.random.default_rng(0).standard_normal((6, 6))
    size = 10.0 ** np.array([0, 6, -6, 3, -3, 1])
    matrix = (rough + rough.T) * np.outer(size, size)
    matrix[2] = matrix[:, 2] = 0.0
    scale = saddle._equilibrate_rows(scipy.sparse.csc_array(matrix))
    largest = np.max(np.abs(scale[:, None] * matrix * scale), axis=1)
    assert scale[2] == 1.0 and np.all(scale > 0)
    assert np.all(largest <= 1.02) and np.all(np.delete(largest, 2) > 0.3)
    diagonal = scipy.sparse.csc_array(np.diag([1e8, -1e-8, 4.0]))
    assert saddle._equilibrate_rows(diagonal) == pytest.approx([1e-4, 1e4, 0.5])


# A solution as a point of its program: which limits are active, and derivatives, against closed forms.


INF, NAN = np.inf, np.nan


def test_a_limit_is_active_if_its_multiplier_outweighs_the_distance() -> None:
    values = np.array([0.01, 0.01, 0.99, 0.99, 0.01, 0.99, 2.0, 0.5, -0.01, 1.02, 0.5])
    multipliers = np.array([-0.02, -0.005, 0.02, 0.005, 0.02, -0.02, 9.0, 0.0, -1e-9, 1e-9, 0.0])
    lower = np.array([0.0] * 6 + [2.0, -INF, 0.0, 0.0, 0.0])
    upper = np.array([1.0] * 6 + [2.0, INF, 1.0, 1.0, 0.5])
    box, labels = interval(lower, upper), tuple("abcdefghijk")
    found = ProgramLimits.determine_active_set(box, values, multipliers, labels)
    below, above, fixed = [0, 8], [2, 9], [6]
    assert np.flatnonzero(found.active).tolist() == sorted(below + above + fixed)
    assert found.at.tolist() == [0, 0, 1, 0, 0, 0, 2, 0, 0, 1, 0] and found.labels == tuple("abcdefghijk")
    push = np.full(11, NAN)
    push[[0, 2, 8, 9]] = [0.02, 0.02, 1e-9, 1e-9]
    np.testing.assert_allclose(found.get_active_multipliers(multipliers), push)
    room = np.array([NAN, 0.01, NAN, 0.01, 0.01, 0.01, NAN, INF, NAN, NAN, 0.0])
    np.testing.assert_allclose(found.compute_slack(values), room, atol=1e-15)
    # Needed by less than 1e-5, or closer than that without being needed.
    assert np.flatnonzero(found.mask_weakly_active_limits(values, multipliers)).tolist() == [8, 9, 10]
    assert 1e-9 < ACTIVE < 5e-3


@pytest.mark.parametrize("scheme", SCHEMES)
def test_sums_with_the_weights_are_integrals_over_shares_of_the_phase(scheme: Scheme) -> None:
    problem = coupled()
    transcription = transcribe_problem(problem, {"leg": go.Mesh((0.0, 0.25, 1.0), (3, 4))}, scheme)
    part = transcription.parts["leg"].collocation
    variables, rows = compute_quadrature_weights(transcription)
    controls, s = part.point_controls[0], part.normalised_point_times
    for power in range(4):
        assert variables[controls] @ s**power == pytest.approx(1 / (power + 1))
        assert rows[part.path_rows[0]] @ s**power == pytest.approx(1 / (power + 1))
    inner = ~np.isin(part.point_states, part.boundary_states)
    assert variables[part.point_states[inner]] == pytest.approx(
        np.broadcast_to(variables[controls], inner.shape)[inner]
    )
    assert np.all(variables[part.boundary_states] == 1) and np.all(
        variables[transcription.parts["leg"].times[-1]] == 1
    )
    assert np.all(rows[np.setdiff1d(np.arange(rows.size), part.path_rows)] == 1)


def coupled() -> go.Problem:
    """x' = u, y' = x u, in a free time: every second derivative has something to say. u is at its limit first."""
    model, x, y, u = dynamics("coupled", "x y", "u", lambda x, y, u: {x: u, y: x * u + y**2})
    problem, leg = one_phase("coupled", model, 0.0, (0.5, 6.0))
    leg.initial(x=0.0, y=0.0)
    leg.final(x=1.0)
    leg.bounds(u=(-3.0, 1.5))
    leg.path("both", x + 0.1 * u, upper=5.0)
    problem.minimize(leg.integral(u**2 + x**2 * y) + leg.final_time**2)
    return problem


@pytest.fixture(scope="module")
def point() -> ProgramPoint:
    return ProgramPoint.from_solution(
        go.solve(coupled(), mesh="2x4", options=go.SolverOptions(tolerance=1e-11), tol=None)
    )


def test_a_solution_meets_the_first_order_conditions(point: ProgramPoint) -> None:
    assert point.is_finite and np.max(np.abs(point.kkt_residual)) < 1e-8
    assert point.kkt_residual.size == np.sum(~point.variables.active) + np.sum(point.rows.active)
    assert np.all(point.lam[~point.rows.active] == 0) and np.max(np.abs(point.lam)) > 1e-3
    active = point.variables.active
    assert np.array_equal(point.x[active], point.variables.at[active])


def test_multipliers_of_a_control_at_its_limit_are_densities() -> None:
    """x' = u, least x at T = 4 with u >= -1: mu = -1 per second, -4 per phase, at every point; in any units."""
    for unit in (1.0, 1e3):
        model, _x, u = dynamics("down", "x", "u", lambda x, u: {x: u})
        problem, leg = one_phase("down", model, 0.0, 4.0)
        leg.initial(x=0.0)
        leg.bounds(u=(-unit, 2 * unit))
        leg.path("floor", u, upper=1.9 * unit)
        problem.minimize(leg.final_state("x"))
        here = ProgramPoint.from_solution(go.solve(problem, mesh="2x3", tol=None))
        places = here.transcription.parts["leg"].collocation.point_controls
        densities, row_densities = here.multiplier_densities
        scales = here.scaling.variables[places] * here.scaling.objective
        assert densities[places] / scales == pytest.approx(-4.0 + 0 * scales, rel=1e-6)
        assert here.variables.active[places].all()
        assert here.variables.get_active_multipliers(densities)[places] == pytest.approx(
            4.0 * scales, rel=1e-6
        )
        floor = here.transcription.parts["leg"].collocation.path_rows
        assert not here.rows.active[floor].any() and np.all(row_densities[floor] == 0)


def test_derivatives_are_those_of_differences(point: ProgramPoint) -> None:
    rng, step = np.random.default_rng(1), 1e-6
    free, held = ~point.variables.active, point.rows.active
    n = int(free.sum())
    direction = np.concatenate([rng.standard_normal(n), np.zeros(held.sum())])
    here, there = take_newton_step(point, -step * direction), take_newton_step(point, step * direction)
    full = np.zeros(point.x.size)
    full[free] = direction[:n]
    assert there.x == pytest.approx(point.x + step * full, abs=1e-14) and np.array_equal(there.lam, point.lam)
    assert point.lagrangian_hessian @ full == pytest.approx(
        (there.lagrangian_gradient - here.lagrangian_gradient) / (2 * step), abs=1e-6
    )
    assert point.constraint_jacobian @ full == pytest.approx(
        (there.constraint_values - here.constraint_values) / (2 * step), abs=1e-6
    )
    assert (point.lagrangian_hessian - point.lagrangian_hessian.T).nnz == 0 or abs(
        point.lagrangian_hessian - point.lagrangian_hessian.T
    ).max() == 0
    # The Lagrangian is linear in its multipliers.
    twice = point.evaluate_hessian(2.0, 3 * point.lam) - point.evaluate_hessian(1.0, 2 * point.lam)
    assert (twice - point.lagrangian_hessian).toarray() == pytest.approx(
        np.zeros((point.x.size,) * 2), abs=1e-9
    )


def test_a_step_of_newton_leads_back(point: ProgramPoint) -> None:
    rng = np.random.default_rng(2)
    free, held = ~point.variables.active, point.rows.active
    off = take_newton_step(point, 1e-5 * rng.standard_normal(point.kkt_residual.size))
    assert np.max(np.abs(off.kkt_residual)) > 1e-6
    matrix = build_kkt_matrix(off.lagrangian_hessian[free][:, free], off.constraint_jacobian[held][:, free])
    assert abs(matrix - matrix.T).max() == 0
    back = take_newton_step(off, -scipy.sparse.linalg.spsolve(matrix, off.kkt_residual))
    assert np.max(np.abs(back.kkt_residual)) < 1e-8
    assert back.x == pytest.approx(point.x, abs=1e-8) and back.lam == pytest.approx(point.lam, abs=1e-6)


def test_other_scales_are_those_that_are_asked_for() -> None:
    solution = go.solve(coupled(), mesh="1x4", tol=None)

    def twos(transcription: Any, problem: go.Problem, x: Any) -> Any:
        return np.full(x.size, 2.0)

    here = ProgramPoint.from_solution(solution, choose_scales=twos)
    times = here.transcription.parts["leg"].times
    assert here.scaling.variables.tolist() == [2.0] * here.x.size
    assert here.x[times[-1]] == pytest.approx(solution.phase().final_time / 2)
    finer = ProgramPoint.from_solution(solution, {"leg": go.Mesh.uniform(3, 5)})
    assert finer.transcription.parts["leg"].collocation.mesh.size == 15
    assert np.max(np.abs(finer.kkt_residual)) < 1e-2


# Multipliers of conditions that depend on each other: the least ones, whatever a solver drifted to.


def turn(components: int) -> go.Problem:
    """Least w^2 of a unit vector that turns by 1 rad in 1 s; of its end one component is prescribed, or both."""
    model, _q, w = dynamics("pointer", "q:2", "w", lambda q, w: {q: w * ca.vertcat(-q[1], q[0])})
    problem, leg = one_phase("turn", model, 0.0, 1.0)
    leg.initial(q=[1.0, 0.0])
    wanted = np.array([np.cos(1.0), np.sin(1.0)])
    problem.constrain("end", leg.final_state("q")[-components:], equals=wanted[-components:])
    leg.guess([0.0, 1.0], q=np.array([[1.0, wanted[0]], [0.0, wanted[1]]]), w=[1.0, 1.0])
    problem.minimize(leg.integral(w**2))
    return problem


def solved(components: int) -> tuple[Any, Any, Any, Any]:
    """Transcription, point, result, and the Jacobian of the rows (dense)."""
    options = go.SolverOptions(tolerance=1e-12)
    attempt = ScaledNlp.from_problem(turn(components), {"leg": go.Mesh.uniform(3, 4)}, GAUSS, None, options)
    point = attempt.build_scaled_nlp_point(attempt.start)
    result = attempt.solver.solve(point)
    assert result.status.solved
    jacobian = attempt.transcription.nlp.jac_g(result.x, point.p)[1].full()
    return attempt.transcription, point, result, jacobian


@pytest.mark.parametrize("drift", [6e2, 1e4, -1e8])
def test_what_is_not_determined_is_as_small_as_can_be(drift: float) -> None:
    transcription, point, result, jacobian = solved(2)
    fixed = point.lbx == point.ubx
    null = np.linalg.svd(jacobian[:, ~fixed].T)[2][-1]  # |q| = 1 is kept by itself
    np.testing.assert_allclose(jacobian[:, ~fixed].T @ null, 0.0, atol=1e-12)
    lam_x = result.lam_x - drift * np.where(fixed, jacobian.T @ null, 0.0)
    found = minimise_multiplier_norm(
        transcription, point, replace(result, lam_g=result.lam_g + drift * null, lam_x=lam_x)
    )
    least = result.lam_g - null * (null @ result.lam_g)
    np.testing.assert_allclose(found.lam_g, least, atol=1e-14 * abs(drift) + 1e-10)
    stationary = (
        transcription.nlp.grad_f(result.x, point.p)[1].full()[:, 0] + jacobian.T @ found.lam_g + found.lam_x
    )
    np.testing.assert_allclose(stationary, 0.0, atol=1e-14 * abs(drift) + 1e-9)


def test_large_multipliers_that_are_determined_stay() -> None:
    transcription, point, result, _ = solved(1)
    large = replace(result, lam_g=1e6 * result.lam_g, lam_x=1e6 * result.lam_x)
    assert minimise_multiplier_norm(transcription, point, large) is large


def test_small_ones_are_left_alone() -> None:
    transcription, point, result, _ = solved(2)
    assert np.max(np.abs(result.lam_g)) < 1e2
    assert minimise_multiplier_norm(transcription, point, result) is result


def test_a_limit_that_another_one_implies_has_no_multiplier() -> None:
    """Two rows that a free variable leaves open together, and two states on arcs of their limits."""
    free = scipy.sparse.csc_array(np.array([[1.0], [-1.0]]))
    along = scipy.sparse.csc_array(np.eye(2))
    r = _project_to_null_space(free, along, np.array([60.0, 51.0]), np.array([-50.0, -50.0]))
    assert r == pytest.approx([50.0, 50.0], rel=1e-5)
