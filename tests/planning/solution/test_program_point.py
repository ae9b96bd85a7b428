"""A solution as a point of its program: which limits are active, and derivatives, against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy
from testing.constructed_solutions import interval
from testing.internals import SCHEMES, Scheme, transcribe

import gnc_opt as go
from gnc_opt.planning.optimality.program_point import (
    WEAKLY_ACTIVE_TOLERANCE,
    ProgramLimits,
    ProgramPoint,
    quadrature_weights,
    saddle_matrix,
)

INF, NAN = np.inf, np.nan


def test_a_limit_is_active_if_its_multiplier_outweighs_the_distance() -> None:
    values = np.array([0.01, 0.01, 0.99, 0.99, 0.01, 0.99, 2.0, 0.5, -0.01, 1.02, 0.5])
    multipliers = np.array([-0.02, -0.005, 0.02, 0.005, 0.02, -0.02, 9.0, 0.0, -1e-9, 1e-9, 0.0])
    lower = np.array([0.0] * 6 + [2.0, -INF, 0.0, 0.0, 0.0])
    upper = np.array([1.0] * 6 + [2.0, INF, 1.0, 1.0, 0.5])
    found = ProgramLimits.of(interval(lower, upper), values, multipliers, tuple("abcdefghijk"))
    below, above, fixed = [0, 8], [2, 9], [6]
    assert np.flatnonzero(found.active).tolist() == sorted(below + above + fixed)
    assert found.at.tolist() == [0, 0, 1, 0, 0, 0, 2, 0, 0, 1, 0] and found.labels == tuple("abcdefghijk")
    push = np.full(11, NAN)
    push[[0, 2, 8, 9]] = [0.02, 0.02, 1e-9, 1e-9]
    np.testing.assert_allclose(found.push(multipliers), push)
    room = np.array([NAN, 0.01, NAN, 0.01, 0.01, 0.01, NAN, INF, NAN, NAN, 0.0])
    np.testing.assert_allclose(found.room(values), room, atol=1e-15)
    # Needed by less than 1e-5, or closer than that without being needed.
    assert np.flatnonzero(found.weak(values, multipliers)).tolist() == [8, 9, 10]
    assert 1e-9 < WEAKLY_ACTIVE_TOLERANCE < 5e-3


@pytest.mark.parametrize("scheme", SCHEMES)
def test_sums_with_the_weights_are_integrals_over_shares_of_the_phase(scheme: Scheme) -> None:
    problem = coupled()
    transcription = transcribe(problem, {"leg": go.Mesh((0.0, 0.25, 1.0), (3, 4))}, scheme)
    part = transcription.parts["leg"].collocation
    variables, rows = quadrature_weights(transcription)
    controls, s = part.point_controls[0], part.fractions
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


# --- a solution ---------------------------------------------------------------------------------------------


def coupled() -> go.Problem:
    """x' = u, y' = x u, in a free time: every second derivative has something to say. u is at its limit first."""
    model = go.Model("coupled")
    x, y, u = model.state("x"), model.state("y"), model.control("u")
    model.ode({x: u, y: x * u + y**2})
    problem = go.Problem("coupled")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.5, 6.0))
    leg.initial(x=0.0, y=0.0)
    leg.final(x=1.0)
    leg.bounds(u=(-3.0, 1.5))
    leg.path("both", x + 0.1 * u, upper=5.0)
    problem.minimize(leg.integral(u**2 + x**2 * y) + leg.final_time**2)
    return problem


@pytest.fixture(scope="module")
def point() -> ProgramPoint:
    return ProgramPoint.of(
        go.solve(coupled(), mesh="2x4", options=go.SolverOptions(tolerance=1e-11), tol=None)
    )


def test_a_solution_meets_the_first_order_conditions(point: ProgramPoint) -> None:
    assert point.is_finite and np.max(np.abs(point.residual)) < 1e-8
    assert point.residual.size == np.sum(~point.variables.active) + np.sum(point.rows.active)
    assert np.all(point.lam[~point.rows.active] == 0) and np.max(np.abs(point.lam)) > 1e-3
    active = point.variables.active
    assert np.array_equal(point.x[active], point.variables.at[active])


def test_multipliers_of_a_control_at_its_limit_are_densities() -> None:
    """x' = u, least x at T = 4 with u >= -1: mu = -1 per second, -4 per phase, at every point; in any units."""
    for unit in (1.0, 1e3):
        model = go.Model("down")
        x, u = model.state("x"), model.control("u")
        model.ode({x: u})
        problem = go.Problem("down")
        leg = problem.phase("leg", model)
        leg.time(0.0, 4.0)
        leg.initial(x=0.0)
        leg.bounds(u=(-unit, 2 * unit))
        leg.path("floor", u, upper=1.9 * unit)
        problem.minimize(leg.final_state("x"))
        here = ProgramPoint.of(go.solve(problem, mesh="2x3", tol=None))
        places = here.transcription.parts["leg"].collocation.point_controls
        densities, row_densities = here.multiplier_densities
        scales = here.scaling.variables[places] * here.scaling.objective
        assert densities[places] / scales == pytest.approx(-4.0 + 0 * scales, rel=1e-6)
        assert here.variables.active[places].all()
        assert here.variables.push(densities)[places] == pytest.approx(4.0 * scales, rel=1e-6)
        floor = here.transcription.parts["leg"].collocation.path_rows
        assert not here.rows.active[floor].any() and np.all(row_densities[floor] == 0)


def test_derivatives_are_those_of_differences(point: ProgramPoint) -> None:
    rng, step = np.random.default_rng(1), 1e-6
    free, held = ~point.variables.active, point.rows.active
    n = int(free.sum())
    direction = np.concatenate([rng.standard_normal(n), np.zeros(held.sum())])
    here, there = point.moved(-step * direction), point.moved(step * direction)
    full = np.zeros(point.x.size)
    full[free] = direction[:n]
    assert there.x == pytest.approx(point.x + step * full, abs=1e-14) and np.array_equal(there.lam, point.lam)
    assert point.hessian @ full == pytest.approx((there.gradient - here.gradient) / (2 * step), abs=1e-6)
    assert point.jacobian @ full == pytest.approx((there.values - here.values) / (2 * step), abs=1e-6)
    assert (point.hessian - point.hessian.T).nnz == 0 or abs(point.hessian - point.hessian.T).max() == 0
    # The Lagrangian is linear in its multipliers.
    twice = point.hessian_of(2.0, 3 * point.lam) - point.hessian_of(1.0, 2 * point.lam)
    assert (twice - point.hessian).toarray() == pytest.approx(np.zeros((point.x.size,) * 2), abs=1e-9)


def test_a_step_of_newton_leads_back(point: ProgramPoint) -> None:
    rng = np.random.default_rng(2)
    free, held = ~point.variables.active, point.rows.active
    off = point.moved(1e-5 * rng.standard_normal(point.residual.size))
    assert np.max(np.abs(off.residual)) > 1e-6
    matrix = saddle_matrix(off.hessian[free][:, free], off.jacobian[held][:, free])
    assert abs(matrix - matrix.T).max() == 0
    back = off.moved(-scipy.sparse.linalg.spsolve(matrix, off.residual))
    assert np.max(np.abs(back.residual)) < 1e-8
    assert back.x == pytest.approx(point.x, abs=1e-8) and back.lam == pytest.approx(point.lam, abs=1e-6)


def test_other_scales_are_those_that_are_asked_for() -> None:
    solution = go.solve(coupled(), mesh="1x4", tol=None)

    def twos(transcription: Any, problem: go.Problem, x: Any) -> Any:
        return np.full(x.size, 2.0)

    here = ProgramPoint.of(solution, scaled_by=twos)
    times = here.transcription.parts["leg"].times
    assert here.scaling.variables.tolist() == [2.0] * here.x.size
    assert here.x[times[-1]] == pytest.approx(solution.phase().final_time / 2)
    finer = ProgramPoint.of(solution, {"leg": go.Mesh.uniform(3, 5)})
    assert finer.transcription.parts["leg"].collocation.mesh.size == 15
    assert np.max(np.abs(finer.residual)) < 1e-2
