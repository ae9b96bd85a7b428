"""hp refinement delivers costates: the adjoint equation holds between the nodes, where it means something."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.planning.refinement.costate_error import COSTATE_ERROR_WEIGHT, adjoint_density, unconstrained
from gnc_opt.planning.refinement.error import estimate_errors
from gnc_opt.planning.refinement.mesh import coarsen
from gnc_opt.planning.refinement.mesh.refinement import refine_mesh
from gnc_opt.planning.solution.samples import PhaseSamples


def exact_states(duration: float) -> go.Problem:
    """min 1/2 int x^2 + u^2, x' = u, x(0) = 1: lam = -u = sinh(T - t) / cosh T."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("regulator")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=duration)
    leg.initial(x=1.0)
    problem.minimize(leg.integral((x**2 + u**2) / 2))
    return problem


def bounded_height(height: float = 1 / 9, as_path: bool = False) -> go.Problem:
    """Bryson & Denham: for height <= 1/6 the state bound acts for 3 height <= t <= 1 - 3 height."""
    model = go.Model("double integrator")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    problem = go.Problem("height")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=1.0)
    leg.initial(q=0.0, v=1.0)
    leg.final(q=0.0, v=-1.0)
    if as_path:
        leg.path("height", q, upper=height)
    else:
        leg.bounds(q=(None, height))
    problem.minimize(leg.integral(a**2 / 2))
    return problem


def hypersensitive(final_time: float) -> go.Problem:
    model = go.Model("cubic")
    x, u = model.state("x"), model.control("u")
    model.ode({x: -(x**3) + u})
    problem = go.Problem("hyper-sensitive")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=final_time)
    leg.initial(x=1.5)
    leg.final(x=1.0)
    problem.minimize(leg.integral((x**2 + u**2) / 2))
    return problem


def adjoint_residual(solution: go.Solution) -> float:
    """The largest integral of |lam' + H_x| over a segment, in shares of the cost; as `verify` measures it."""
    condition = next(c for c in go.verify(solution).conditions if c.name == "stationarity")
    return float(condition.value)


@pytest.mark.parametrize("final_time", [50.0, 1000.0])
def test_smooth_problems_pass_the_adjoint_equation(final_time: float) -> None:
    solution, history = refine_mesh(go.solve(hypersensitive(final_time), tol=None), tol=1e-8)
    assert history.converged
    assert go.verify(solution).ok
    assert adjoint_residual(solution) <= 1e-4 / COSTATE_ERROR_WEIGHT
    assert solution.objective == pytest.approx(1.3308069049430022, rel=1e-8)


def test_costates_converge_to_the_closed_form() -> None:
    """lam = sinh(T - t) / cosh T, to the accuracy of its own equation."""
    solution, _ = refine_mesh(go.solve(exact_states(10.0), mesh="3x3", tol=None), tol=1e-8)
    times = np.linspace(0.0, 10.0, 400)
    exact = np.sinh(10.0 - times) / np.cosh(10.0)
    assert np.max(np.abs(np.asarray(solution.costate("x")(times)) - exact)) < 1e-5


def test_density_is_the_residual_of_the_costates() -> None:
    """With lam the polynomials of the solution, the density is |lam' + x|, worth max|x| over the cost's scale."""
    solution = go.solve(exact_states(4.0), mesh="3x3", tol=None)
    leg = solution.phase()
    samples = PhaseSamples.of(leg, solution.functions("leg"))
    inner = samples.weights > 0
    times = samples.times[inner]
    residual = np.abs(leg.lam.derivative()(times)[0] + leg.x(times)[0])  # H_x = x
    worth = samples.state_scale[0] / samples.cost_scale
    density = adjoint_density(samples, np.zeros(0))[0, inner]
    assert np.max(residual) > 1e-3, "the mesh would be fine: the test tests nothing"
    np.testing.assert_allclose(density, residual * worth, rtol=1e-9, atol=1e-13)


def test_the_error_is_of_second_order_in_the_costates() -> None:
    """Squares: halving segments of degree n divides the error by more than 4^n, asked for: 4^(n - 1)."""
    errors = []
    for segments in (4, 8, 16):
        solution = go.solve(exact_states(4.0), mesh=go.Mesh.uniform(segments, 3), tol=None)
        errors.append(float(np.max(estimate_errors(solution)["leg"].errors.costates)))
    assert all(old / new > 4**2 for old, new in itertools.pairwise(errors))


@pytest.mark.parametrize("as_path", [False, True])
def test_segments_on_a_state_constraint_do_not_count(as_path: bool) -> None:
    """Multipliers of pure state constraints converge weakly: only segments clear of 1/3 <= t <= 2/3 count."""
    solution = go.solve(bounded_height(as_path=as_path), mesh="30x4", tol=None)
    error = estimate_errors(solution)["leg"]
    counts = unconstrained(error.samples, error.yardstick.pure_paths)
    middles = 0.5 * (solution.phase().breaks[1:] + solution.phase().breaks[:-1])
    assert np.all(counts[(middles < 0.28) | (middles > 0.72)])
    # The entry and the exit push at the very least.
    near = np.abs(np.abs(middles - 0.5) - 1 / 6) < 0.02
    assert np.any(~counts[near])
    held = ~counts[error.samples.segments]
    assert np.all(error.adjoint[:, held] == 0.0)


def test_an_impulse_at_either_end_of_a_segment_speaks_against_it() -> None:
    """The costate of q jumps at the entry and the exit of the arc: the segments on both sides do not count.

    Impulses at the ends of the phase are the multipliers of given values and speak against nothing.
    """
    solution = go.solve(
        bounded_height(), mesh=go.Mesh((0.0, 0.15, 1 / 3, 2 / 3, 0.85, 1.0), (5,) * 5), tol=None
    )
    error = estimate_errors(solution)["leg"]
    leg = solution.phase()
    assert np.flatnonzero(np.abs(leg.state_impulses[0]) > 1.0).tolist() == [0, 2, 3, 5]
    samples = replace(error.samples, leg=replace(leg, state_multipliers=0.0 * leg.state_multipliers))
    counts = unconstrained(samples, error.yardstick.pure_paths)
    assert counts.tolist() == [True, False, False, False, True]


def test_state_constraints_still_converge() -> None:
    solution, history = refine_mesh(go.solve(bounded_height(), tol=None), tol=1e-8)
    assert history.converged and solution.objective == pytest.approx(4.0, rel=1e-7)


def test_decades_of_a_square_count_half() -> None:
    """An error 1e-4 of a square must fall by two decades to get to 1e-8, that of a residual by four."""
    errors = estimate_errors(go.solve(exact_states(4.0), mesh="2x4", tol=None))["leg"].errors
    table = errors.table
    least = np.max(np.log10(np.maximum(table[:-1], 1e-99) / 1e-8), axis=0)
    expected = np.maximum(least, 0.5 * np.log10(np.maximum(table[-1], 1e-99) / 1e-8))
    np.testing.assert_allclose(errors.decades(1e-8), expected, rtol=1e-12)


def test_probing_finds_all_mergers_of_a_smooth_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    """The probes only save trials: without them the same mesh comes out."""
    error = estimate_errors(go.solve(exact_states(10.0), mesh="24x7", tol=None))["leg"]
    breaks = error.samples.leg.breaks
    run = [coarsen.Piece(float(a), float(b), 7) for a, b in itertools.pairwise(breaks)]
    slim = coarsen.coarsened(error, run, 1e-8, 20, 1e-5)

    def everything(_: object, run: list[coarsen.Piece], *__: object) -> list[coarsen.Span]:
        n = len(run)
        return [(i, j) for i in range(n) for j in range(i + 1, min(i + coarsen.MERGED_SEGMENTS_MAX, n) + 1)]

    monkeypatch.setattr(coarsen, "_mergeable", everything)
    assert coarsen.coarsened(error, run, 1e-8, 20, 1e-5) == slim
    assert len(slim) < len(run) / 2
