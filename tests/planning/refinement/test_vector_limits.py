"""Vector controls bounded in norm that hold state constraints: arcs along which the whole vector is singular."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from testing.internals import Junction, PhaseCollocation, PhaseStructure, Plan

import gnc_opt as go
from gnc_opt.planning import ArcKind, Mesh
from gnc_opt.planning.refinement.arcs.vector_arcs import product_vectors
from gnc_opt.planning.transcription.arc_constraints import controls_beside

FREE, UP, SINGULAR = ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.SINGULAR


def flight(start: list[float], target: list[float], fuel: bool = False) -> go.Problem:
    """Least time to rest at a target with |acceleration| and |speed| at most 1; or least fuel in 7 s."""
    size = len(start)
    model = go.Model("craft")
    r, v = model.state("r", size), model.state("v", size)
    a, norm = model.vector_control("a", size)
    model.ode({r: v, v: a})
    problem = go.Problem("top speed")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=7.0 if fuel else (0.1, 20.0))
    leg.initial(r=[0.0] * size, v=start)
    leg.final(r=target, v=[0.0] * size)
    leg.norm_bounds(a=(0.0, 1.0))
    leg.path("speed", ca.sumsqr(v), upper=1.0)
    problem.minimize(leg.integral(norm, "fuel") if fuel else leg.final_time)
    return problem


@pytest.fixture(scope="module")
def straight() -> go.Solution:
    return go.solve(flight([0.0, 0.0], [5.0, 2.0]))


def test_from_rest_to_rest_at_top_speed(straight: go.Solution) -> None:
    """Up to speed in 1 s, L / V + V / a in all; in between the vector is zero though its limit is not."""
    assert straight.converged and go.verify(straight).ok
    assert straight.objective == pytest.approx(math.sqrt(29.0) + 1.0, abs=1e-8)
    held = [(arc.start, arc.end) for arc in straight.structure if arc.channel == "speed"]
    np.testing.assert_allclose(held, [(1.0, math.sqrt(29.0))], atol=1e-6)
    told = [arc.kind for arc in straight.structure if arc.channel == "a_magnitude"]
    assert told == [UP, SINGULAR, UP]
    times = np.array([0.5, 3.0, straight.objective - 0.5])
    pushes = np.array([5.0, 2.0])[:, None] / math.sqrt(29.0) * np.array([1.0, 0.0, -1.0])
    np.testing.assert_allclose(straight.phase().saturated_control("a")(times), pushes, atol=1e-6)


@pytest.mark.slow
def test_a_plane_flight_in_space() -> None:
    """It turns at top speed before it flies straight on; what is turned in space lasts as long.

    With an acceleration that is constant on each of N steps, a restriction, it is 5.447761, 5.447362 and 5.447279 s for
    N = 100, 200 and 400 (Opti of CasADi).
    """
    turn, _ = np.linalg.qr(np.array([[1.0, 2.0, -1.0], [0.5, 1.0, 3.0], [2.0, -1.0, 0.5]]))
    start, target = np.array([0.0, -0.4]), np.array([4.0, 1.5])
    plane = go.solve(flight(list(start), list(target)))
    space = go.solve(flight(list(turn[:, :2] @ start), list(turn[:, :2] @ target)))
    for solution in (plane, space):
        assert solution.converged and go.verify(solution).ok
    assert plane.objective == pytest.approx(5.4472458, abs=2e-7)
    assert space.objective == pytest.approx(plane.objective, abs=1e-8)


def test_only_the_product_of_a_vector_that_costs_nothing_matters(straight: go.Solution) -> None:
    (timed,) = straight.samples().values()
    (vector,) = product_vectors(timed)
    assert (vector.magnitude, list(vector.direction), vector.most) == (0, [1, 2], 1.0)
    (fuelled,) = go.solve(flight([0.0, 0.0], [1.0, 0.5], fuel=True), mesh="6x3", tol=None).samples().values()
    assert list(product_vectors(fuelled)) == []
    assert np.all(
        fuelled.control_span < 10.0
    )  # along a coast a direction moves nothing, which makes it no longer


TURNING = PhaseStructure(
    (0.0, 1.0, 2.0, 3.0, 4.0),
    (
        (UP, FREE, FREE, FREE, FREE),
        (UP, FREE, FREE, FREE, UP),
        (UP, SINGULAR, SINGULAR, FREE, UP),
        (UP, FREE, FREE, FREE, FREE),
    ),
    n_controls=3,
    n_paths=2,
    orders=(0, 0, 0, 0, 1),
    holders=((), (), (), (1, 2), (2, 1, 0)),
)
"""Magnitude, direction; length of the direction, speed."""


def test_one_constraint_determines_one_of_several_singular_controls() -> None:
    """That which holds it best; those at their limits, or on the sphere, are no others'."""
    assert [TURNING.determined(k) for k in range(4)] == [set(), {0, 1, 2}, {0, 2}, set()]


def test_a_vector_turns_into_an_arc_on_a_limit() -> None:
    """The time is a variable; there the limit is met with a derivative of zero, and may be left one segment before."""
    assert [TURNING.slides(k) for k in (1, 2, 3)] == [True, False, False]
    plan = Plan.of(TURNING)
    mesh, ends = plan.mesh(), plan.piece_ends
    assert set(mesh.movable) == set(ends[1:-1])
    lengths = np.diff(np.array(mesh.breaks)[: ends[1] + 1])
    np.testing.assert_allclose(lengths[:-1] / lengths[1:], [2.0] * (lengths.size - 2) + [1.0])
    assert plan._junctions() == (Junction(1, ends[1], UP, 1, -1),)
    assert TURNING.on_sphere().tolist() == [[False, True, False, False], [False] * 4]
    assert np.flatnonzero(plan._released()[4]).tolist() == [ends[1] - 1, ends[1]]


def test_controls_at_the_end_of_a_segment() -> None:
    """The weights are exact for polynomials of lower degree than there are points."""
    collocation = PhaseCollocation("LG", Mesh((0.0, 0.4, 1.0), (3, 4), ()), 1, 2, 0, 0, 0)
    for tangent, segment, end in ((-1, 0, 1.0), (1, 1, -1.0)):
        beside = controls_beside(collocation, Junction(0, 1, UP, 1, tangent))
        tau = collocation.rules[segment].points
        assert (tau**2 - tau) @ beside.weights == pytest.approx(end**2 - end, abs=1e-13)
        first = collocation.mesh.offsets[segment]
        assert np.array_equal(beside.points, collocation.point_controls[:, first : first + tau.size])
    assert controls_beside(collocation, Junction(0, 1, UP, 1)).points.shape == (2, 0)
