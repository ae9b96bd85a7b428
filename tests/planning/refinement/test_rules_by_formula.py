"""Rules of refinement, error estimates, bounds and sensitivities on values chosen by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import fake, interval
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning.refinement.arcs import arc_mesh
from gnc_opt.planning.refinement.arcs.contact_detection import ContactNodes
from gnc_opt.planning.refinement.mesh.hp_refinement import _Refinement
from gnc_opt.planning.solution import objective_error
from gnc_opt.planning.solution.state_and_control_scales import estimate_required_controls
from gnc_opt.planning.study import kkt_sensitivity
from gnc_opt.planning.study.cost_lower_bounds import _is_time_optimal


def test_controls_required_for_a_motion_have_an_effect() -> None:
    """x moves by 6 in 3 s, y by 1: u needs 1 for x' = 2 u, w 2 / 3 for y' = w / 2; v has a slope, but no effect."""
    times = np.array([0.0, 1.0, 3.0])
    leg = fake(
        breaks=times, sample_times=lambda: times, x=lambda t: np.stack([2 * t, t / 3]), states=fake(size=2),
        applied=lambda t: np.zeros((3, t.size)), vector_controls=(),
    )  # fmt: skip
    leg.states = go.Model("two").states
    gains = np.array([[2.0, 0.0, 4.0], [0.0, 0.5, 0.0]])
    functions = fake(
        input_jacobian=lambda t, x, u: np.repeat(gains[:, :, None], t.size, axis=2),
        rates=lambda t, x, u: 7.0 + gains[:, :2] @ u[:2],
    )
    np.testing.assert_allclose(estimate_required_controls(leg, functions), [1.0, 2 / 3, 0.0])
    leg.vector_controls, leg.controls = (fake(direction="n"),), fake(slice=lambda name: slice(0, 1))
    leg.x = lambda t: np.stack([20 * t, t / 3])
    np.testing.assert_allclose(estimate_required_controls(leg, functions), [1.0, 2 / 3, 0.0])


def test_violations_cost_their_multipliers_of_the_correct_sign(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows: above 1 by 2 at +3, below 0 by 1 at -4, both at the wrong sign, and an equality off by 1 and -2."""
    monkeypatch.setattr(
        objective_error, "_compute_segment_integrals", lambda s, v: np.cumsum(v, axis=1)[:, 1:]
    )
    values = np.array([[3.0, -1.0], [3.0, -1.0], [6.0, 3.0]])
    bounds = interval([0.0, 0.0, 5.0], [1.0, 1.0, 5.0])
    multipliers = np.array([[3.0, -4.0], [-3.0, 4.0], [2.0, 7.0]])
    found = objective_error._weight_by_multipliers(fake(), values, bounds, multipliers)
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
    coarsest = arc_mesh.PieceMesh(1, 3, 2)
    found = arc_mesh._read_piece_resolution(mesh, 1, 4, coarsest)
    assert (found.segments, found.degree, found.smooth) == (3, 6, min(9, arc_mesh.MAX_SINGULAR_DEGREE))
    np.testing.assert_allclose(found.edges, [0.25, 0.5])
    assert arc_mesh._read_piece_resolution(mesh, 1, 4, arc_mesh.PieceMesh(1, 3, 0)).smooth == 0
    assert arc_mesh._read_piece_resolution(mesh, 1, 2, arc_mesh.PieceMesh(1, 3, 3)).smooth == 3
    assert arc_mesh.count_uniform_points(mesh) == pytest.approx(5 / 0.4)


def test_midpoints_before_nodes_and_at_the_ends() -> None:
    find = ContactNodes._compute_midpoint_before
    own = fake(times=np.array([1.0, 2.0, 4.0]))
    assert [find(own, node, 0.0) for node in (1, 2)] == [1.5, 3.0]
    assert (find(own, 0, 0.5), find(own, 0, -0.5)) == (0.5, 1.0)
    assert (find(own, 3, 6.0), find(own, 3, 6.5)) == (6.0, 4.0)
    assert find(fake(times=np.array([1.0])), 1, 3.0) == 1.0
    records = [fake(work=w) for w in (5.0, 2.0, 1.0)]
    assert _Refinement._spent_work.fget(fake(_tabular_data=records)) == 3.0  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("sizes", "steps"),
    [
        ([1.0, 0.5, 9e-11, 1e-14], 3), ([9e-11, 8e-11], 1), ([1.0, 9e-11, 8e-13, 5e-13], 3), ([1e-14], 0)
    ],
)  # fmt: skip
def test_newton_ends_at_rounding_or_if_a_small_residual_stagnates(sizes: list[float], steps: int) -> None:
    taken: list[float] = []
    points = iter(sizes)

    def point() -> Any:
        size = next(points)
        return fake(
            kkt_residual=np.array([0.0, -size]),
            problem=fake(name="p"),
            take_step=lambda s: (taken.append(s), point())[1],
        )

    own = fake(program=point(), _factorise_kkt_system=lambda: None)
    own._system = fake(solve_system=lambda right: right[1], labels=("a", "b"))
    assert kkt_sensitivity.KktPoint._solve_newton(own) == ""
    assert taken == sizes[:steps]
    points = iter([1.0] * 9)
    own.program = point()
    assert "do not hold at 'b' (residual 1.0e+00)" in kkt_sensitivity.KktPoint._solve_newton(own)
