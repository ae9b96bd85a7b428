"""Rules of refinement, error estimates, bounds and sensitivities on values chosen by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import fake, interval
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning.refinement import best_solution_selection, hp_refinement
from gnc_opt.planning.refinement.arcs import arc_mesh, structure_update
from gnc_opt.planning.refinement.arcs.state_constraint_contact_detection import ContactNodes
from gnc_opt.planning.refinement.collocation_error_estimate import _interpolate_local_maxima
from gnc_opt.planning.solution import solution_accuracy
from gnc_opt.planning.solution.state_and_control_scales import estimate_required_controls
from gnc_opt.planning.study.cost_lower_bounds import _is_time_optimal


def test_controls_required_for_a_motion_have_an_effect() -> None:
    """x moves by 6 in 3 s, y by 1: u needs 1 for x' = 2 u, w 2 / 3 for y' = w / 2; v has a slope, but no effect."""
    times = np.array([0.0, 1.0, 3.0])
    leg = fake(
        breaks=times,
        sample_times=lambda: times,
        x=lambda t: np.stack([2 * t, t / 3]),
        states=fake(size=2),
        applied=lambda t: np.zeros((3, t.size)),
        vector_controls=(),
    )
    leg.states = go.Model("two").states
    gains = np.array([[2.0, 0.0, 4.0], [0.0, 0.5, 0.0]])
    functions = fake(
        dynamics_control_jacobian=lambda t, x, u: np.repeat(gains[:, :, None], t.size, axis=2),
        state_rates=lambda t, x, u: 7.0 + gains[:, :2] @ u[:2],
    )
    np.testing.assert_allclose(estimate_required_controls(leg, functions), [1.0, 2 / 3, 0.0])
    leg.vector_controls, leg.controls = (fake(direction="n"),), fake(slice=lambda name: slice(0, 1))
    leg.x = lambda t: np.stack([20 * t, t / 3])
    np.testing.assert_allclose(estimate_required_controls(leg, functions), [1.0, 2 / 3, 0.0])


def test_violations_cost_their_multipliers_of_the_correct_sign() -> None:
    """Rows: above 1 by 2 at +3, below 0 by 1 at -4, both at the wrong sign, and an equality off by 1 and -2."""
    samples = fake(integrate_over_segments=lambda v: np.cumsum(v, axis=1)[:, 1:])
    values = np.array([[3.0, -1.0], [3.0, -1.0], [6.0, 3.0]])
    bounds = interval([0.0, 0.0, 5.0], [1.0, 1.0, 5.0])
    multipliers = np.array([[3.0, -4.0], [-3.0, 4.0], [2.0, 7.0]])
    found = solution_accuracy._weight_violations_by_multipliers(samples, values, bounds, multipliers)
    np.testing.assert_allclose(found, [3 * 2 + 4 * 1 + abs(2 * 1 - 7 * 2)])


def test_time_optimality_is_of_a_duration_that_may_fall() -> None:
    def optimal(cost: Any, found: float = 4.0, initial: Any = 1.0) -> bool:
        model, *_ = dynamics("one", "x", "u", lambda x, u: {x: u})
        problem, leg = one_phase("one", model, initial, (2.0, 9.0))
        problem.minimize(cost(leg))
        return _is_time_optimal(problem, leg, found)

    assert optimal(lambda leg: 2 * leg.final_time - leg.initial_time)
    assert not optimal(lambda leg: leg.final_time + leg.final_state("x"))
    assert not optimal(lambda leg: -leg.final_time) and not optimal(lambda leg: leg.final_time**2)
    assert not optimal(lambda leg: leg.final_time, found=2.0 + 5e-7) and optimal(
        lambda leg: leg.final_time, found=2.1
    )
    assert not optimal(lambda leg: leg.final_time, initial=(0.0, 1.0))


def test_resolution_of_a_piece_of_a_mesh() -> None:
    """Segments 2 to 4 of five, with the degrees 4, 6 and 5; ends at 1/4 and 1/2 of the piece."""
    mesh = go.Mesh((0.0, 0.1, 0.3, 0.5, 0.9, 1.0), (9, 4, 6, 5, 9))
    coarsest = arc_mesh.SubarcMesh(1, 3, 2)
    found = arc_mesh._read_subarc_mesh(mesh, 1, 4, coarsest)
    assert (found.segments, found.degree, found.smooth) == (3, 6, min(9, arc_mesh.MAX_SINGULAR_DEGREE))
    np.testing.assert_allclose(found.edges, [0.25, 0.5])
    assert arc_mesh._read_subarc_mesh(mesh, 1, 4, arc_mesh.SubarcMesh(1, 3, 0)).smooth == 0
    assert arc_mesh._read_subarc_mesh(mesh, 1, 2, arc_mesh.SubarcMesh(1, 3, 3)).smooth == 3


def test_a_contact_begins_where_its_control_leaves_a_bound_and_ends_where_it_reaches_one() -> None:
    """Controls between 1 s and 2 s off their bounds, in a mesh of 0.25 s; switches up to 0.5 s away count."""
    on, off = fake(is_at_limit=True), fake(is_at_limit=False)

    def find(time: float, side: int, kinds: Any = ((on,), (off,), (on,)), kinks: Any = ()) -> float:
        controls = list(range(len(kinds[0])))
        structure: Any = fake(
            times=(0.0, 1.0, 2.0, 3.0),
            n_subarcs=3,
            kinds=kinds,
            boundary_arc_controls={7: controls},
            has_only_control_kinks=lambda k: k in kinks,
            find_changed_arcs=lambda k: [i for i in controls if kinds[k - 1][i] is not kinds[k][i]],
        )
        samples: Any = fake(phase=fake(breaks=np.linspace(0.0, 3.0, 13)))
        return ContactNodes._find_nearby_switch_time(fake(row=7), structure, time, samples, side)

    assert [find(t, 0) for t in (0.55, 1.45, 1.55, 2.1)] == [1.0, 1.0, 1.55, 2.1]
    assert [find(t, 1) for t in (1.2, 1.45, 1.55, 2.45)] == [1.2, 1.45, 2.0, 2.0]
    pair = ((on, off), (off, off), (off, on))
    assert [find(t, side, pair) for t in (1.1, 2.1) for side in (0, 1)] == [1.0, 1.0, 2.0, 2.0]
    assert find(1.1, 0, kinks=(1,)) == 1.1 and find(1.1, 0, ((off,), (off,), (on,))) == 1.1


def test_midpoints_before_nodes_and_at_the_ends() -> None:
    find = ContactNodes._compute_midpoint_to_previous_node
    own = fake(times=np.array([1.0, 2.0, 4.0]))
    assert [find(own, node, 0.0) for node in (1, 2)] == [1.5, 3.0]
    assert (find(own, 0, 0.5), find(own, 0, -0.5)) == (0.5, 1.0)
    assert (find(own, 3, 6.0), find(own, 3, 6.5)) == (6.0, 4.0)
    assert find(fake(times=np.array([1.0])), 1, 3.0) == 1.0


def test_peaks_of_parabolas_between_samples() -> None:
    """4 - (t - 1.25)^2 at 0, 1 and 3 has the peak 4; duplicated times and valleys stay."""
    times = np.array([0.0, 1.0, 3.0, 3.0, 4.0, 5.0])
    top = 4 - (times[:3] - 1.25) ** 2
    values = np.stack([np.append(top, [9.0, 1.0, 2.0]), np.append(-top, [-9.0, -9.0, -8.0])])
    found = _interpolate_local_maxima(values, times)
    np.testing.assert_allclose(found[0], [*top[:1], 4.0, top[2], 9.0, 1.0, 2.0])
    np.testing.assert_array_equal(found[1], values[1])


def test_status_at_the_end_of_a_refinement() -> None:
    status = go.RefinementStatus

    def choose(
        error: float, ok: Any = None, ended: Any = None, history: Any = status.CONVERGED, **given: Any
    ) -> Any:
        best = fake(
            largest_local_error=error,
            is_cost_accurate=lambda tol: given.get("within", False),
            history=fake(status=history, converged=history is status.CONVERGED),
        )
        verdict = None if ok is None else fake(ok=ok)
        return best_solution_selection._choose_refinement_status(
            best, verdict, ended, given.get("found", set()), 1.0
        )

    budget, points = status.BUDGET_LIMIT, status.POINT_LIMIT
    assert choose(0.5, True, status.INTERRUPTED) is status.INTERRUPTED
    assert choose(0.5) is status.UNCHECKED and choose(2.0, within=True) is status.UNCHECKED
    assert choose(2.0) is status.CONVERGED and choose(2.0, None, budget) is budget
    assert choose(1.0, True) is status.CONVERGED and choose(1.0, False) is status.CONDITIONS_FAIL
    assert choose(2.0, True, budget) is budget and choose(2.0, False, budget) is budget
    assert choose(2.0, True, None, points) is points
    assert choose(2.0, False) is status.STALLED and choose(2.0, False, None, points) is points
    assert choose(2.0, False, None, budget) is status.STALLED
    assert choose(2.0, False, None, budget, found={status.FAILED, points}) is points
    assert choose(2.0, False, None, budget, found={status.FAILED}) is status.FAILED


def test_decay_rates_of_legendre_coefficients() -> None:
    """Coefficients 10^(-k / 2) decay by half a decade; at rounding, with two nodes or NaN the rate is limited."""
    tau = np.polynomial.legendre.leggauss(8)[0]

    def rate(coefficients: Any, nodes: Any = tau) -> float:
        values = np.polynomial.legendre.legval(nodes, coefficients)
        return hp_refinement._fit_decay_rate_of_segment(np.stack([0 * values, values]), nodes)

    assert rate(10.0 ** (-0.5 * np.arange(8))) == pytest.approx(0.5, rel=1e-6)
    assert rate(np.append(1e3, 10.0 ** (-0.5 * np.arange(1, 8)))) == pytest.approx(
        0.5, rel=1e-6
    )  # the mean does not count
    assert rate(10.0 ** (-0.5 * np.arange(5)), tau[1:6]) == pytest.approx(0.5, rel=1e-6)
    assert rate(np.ones(8)) == hp_refinement.DECAY_RATE_MIN
    assert rate(10.0 ** (-3.0 * np.arange(8))) == hp_refinement.DECAY_RATE_MAX
    assert rate([1.0], tau[:2]) == rate([np.nan]) == hp_refinement.DECAY_RATE_MIN
    assert rate([1.0, 0.0, 1e-1, 0.0, 1e-2, 0.0, 1e-3, 0.0]) == pytest.approx(0.5, rel=0.2)


def test_the_largest_violation_extends_between_linearly_interpolated_zeros() -> None:
    t = np.array([0.0, 1.0, 2.0, 4.0, 5.0, 7.0])
    find = structure_update.find_largest_violation_interval
    assert find(t, np.array([-1.0, 3.0, 2.0, 1.0, -1.0, 2.5])) == (0.25, 4.5)
    assert find(t, np.array([2.0, -1.0, 1.0, 1.0, 4.0, 4.5])) == (1.5, 7.0)
    assert find(t, np.array([3.0, 2.0, 0.0, 1.0, 1.0, 2.5])) == (0.0, 2.0)
