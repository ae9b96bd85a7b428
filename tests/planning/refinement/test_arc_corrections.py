"""Corrections of arcs: switches that coincide, arcs on bounds, mixed constraints."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.constructed_solutions import interval
from testing.internals import ArcMesh, Junction, PhaseCollocation, PhaseStructure, SubarcMesh
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import ArcKind, Mesh
from gnc_opt.planning.refinement.arcs.hamiltonian_convexity import LinearPathLimits
from gnc_opt.planning.refinement.arcs.switching_time_optimization import (
    FREE_INTERVAL,
    FREE_INTERVAL_POINTS,
    find_simultaneous_switches,
    split_simultaneous_switch_times,
)
from gnc_opt.planning.transcription.arc_constraints import find_controls_at_junction

# Several controls that change at one time, with arcs on limits of states: closed forms, and their
# multipliers.


LOW, UP, FREE, SING = ArcKind.LOWER, ArcKind.UPPER, ArcKind.INTERIOR, ArcKind.SINGULAR


def gantry(distance: float, speed: float) -> go.Problem:
    """Least time from rest to rest along two axes at once, |a| <= 1 and |v| <= speed in both."""
    model, _x, _v, _a = dynamics("gantry", "x:2 v:2", "a:2", lambda x, v, a: {x: v, v: a})
    problem, leg = one_phase("gantry", model, initial=0.0, final=(0.5, 20.0), name="move")
    leg.initial(x=[0.0, 0.0], v=[0.0, 0.0])
    leg.final(x=[distance, distance], v=[0.0, 0.0])
    leg.bounds(v=([-speed] * 2, [speed] * 2), a=([-1.0] * 2, [1.0] * 2))
    problem.minimize(leg.final_time)
    return problem


@pytest.fixture(scope="module")
def moved() -> go.Solution:
    return go.solve(gantry(1.0, 0.5))


def test_two_axes_reach_and_leave_their_speed_together(moved: go.Solution) -> None:
    """t_f = d / V + V; neither axis could be faster, so each has a share of the costates."""
    assert moved.converged and go.verify(moved).ok
    assert moved.objective == pytest.approx(2.5, rel=1e-10)
    costates = moved.phases["move"].lam(np.array([0.1, 1.25, 2.4]))
    np.testing.assert_allclose(np.sum(costates[:2], axis=0), -1 / 0.5, rtol=1e-5)
    # lam_v = -lam_x (t - V) before the limit and 0 on it, for each axis: it vanishes at the shared time
    np.testing.assert_allclose(costates[2:, 0], -costates[:2, 0] * (0.1 - 0.5), atol=1e-5)
    np.testing.assert_allclose(costates[2:, 1], 0.0, atol=1e-5)


def test_boundaries_are_shared_where_several_controls_change_and_there_is_room() -> None:
    """Rows: two controls, a state of each that it can hold."""
    kinds = (
        (UP, UP, FREE, FREE),
        (SING, SING, UP, UP),
        (LOW, SING, FREE, UP),
        (UP, LOW, FREE, FREE),
        (LOW, UP, FREE, FREE),
    )
    near = PhaseStructure((0.0, 1.0, 2.0, 3.0, 3.0 + 1e-6, 4.0), kinds, (), 2, orders=(0, 0, 1, 1))
    assert find_simultaneous_switches(near) == (1,)
    assert find_simultaneous_switches(near.with_switch_times((0.0, 1.0, 2.0, 3.0, 3.5, 4.0))) == (1, 3, 4)


def test_instants_are_free_for_what_changes() -> None:
    """Three pieces, the second boundary shared by both controls."""
    kinds = ((LOW, LOW, FREE), (LOW, UP, FREE), (UP, SING, FREE))
    plan = ArcMesh(
        PhaseStructure((0.0, 0.25, 0.5, 1.0), kinds, (), 2), tuple(SubarcMesh(1, n) for n in (4, 5, 6))
    )
    split = split_simultaneous_switch_times(plan)
    assert split.structure.kinds == (*kinds[:2], (FREE,) * 3, (FREE,) * 3, kinds[2])
    mesh = split.build_mesh()
    np.testing.assert_allclose(
        mesh.breaks, [0.0, 0.25, 0.5 - FREE_INTERVAL, 0.5, 0.5 + FREE_INTERVAL, 1.0], atol=1e-15
    )
    assert mesh.degrees == (4, 5, FREE_INTERVAL_POINTS, FREE_INTERVAL_POINTS, 6)


# Path constraints that limit one control linearly, by hand: which those are, how far they let it go, what
# is held.


X = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
INF = np.inf
LOWER, UPPER = [-INF, -9.0, -9.0, -3.0, 1.0, -1.0], [4.0, 9.0, 9.0, 6.0, 1.0, 1.8]
ROWS = ["2 u + x", "u + w", "u^2", "-3 w", "u = 1", "x u"]


def paths(t: Any, x: Any, u: Any) -> Any:
    a, w = u
    return np.array([2 * a + x[0], a + w, a**2, -3 * w, a, x[0] * a])


def slopes(t: Any, x: Any, u: Any) -> Any:
    one, none = np.ones(x.shape[1]), np.zeros(x.shape[1])
    by_a = [2 * one, one, 2 * u[0], none, one, x[0]]
    by_w = [none, one, none, -3 * one, none, none]
    return np.stack([by_a, by_w], axis=1)


def flight(bounds: Any = ((-1.0, -1.0), (1.5, 1.5)), values: Any = 0.25) -> Any:
    leg = SimpleNamespace(
        path_labels=tuple(ROWS),
        path_bounds=interval(LOWER, UPPER),
        control_bounds=interval(*bounds),
        controls=SimpleNamespace(size=2),
    )
    return SimpleNamespace(
        phase=leg,
        times=np.arange(5.0),
        x=X[None, :],
        u=np.full((2, 5), values),
        control_scale=np.array([2.5, 2.5]),
        functions=SimpleNamespace(path_constraints=paths, path_control_jacobian=slopes),
    )


LIMITS = LinearPathLimits.from_samples(flight(), np.array([True, True]))


def test_only_inequalities_that_are_linear_in_one_control_count() -> None:
    assert LIMITS.rows == {0: (0, 5), 1: (3,)}
    assert LIMITS.slopes.tolist() == [[2.0] * 5, [0.0] * 5, [0.0] * 5, [-3.0] * 5, [0.0] * 5, X.tolist()]
    assert LinearPathLimits.from_samples(flight(), np.array([False, True])).rows == {1: (3,)}
    none = LinearPathLimits.from_samples(flight(), np.array([False, False]))
    assert none.rows == {} and none.slopes.shape == (6, 5)


@pytest.mark.parametrize("u", [0.25, -0.7, 3.0])
def test_reaches_are_those_of_the_limits_wherever_the_control_is(u: float) -> None:
    """2 u + x <= 4; x u between -1 and 1.8, whatever the sign of x; -3 w between -3 and 6."""
    limits = LinearPathLimits.from_samples(flight(values=u), np.array([True, True]))
    above, below = limits._compute_admissible_controls(0)
    assert above[0] == pytest.approx((4 - X) / 2) and np.all(below[0] == -INF)
    assert above[5] == pytest.approx([0.5, 1.0, INF, 1.8, 0.9])
    assert below[5] == pytest.approx([-0.9, -1.8, -INF, -1.0, -0.5])
    above, below = limits._compute_admissible_controls(1)
    assert above[3] == pytest.approx([1.0] * 5) and below[3] == pytest.approx([-2.0] * 5)


@pytest.mark.parametrize(
    ("control", "bounds", "ended"),
    [
        (0, (-1.0, 1.5), True),
        (0, (-INF, INF), False),
        (1, (-INF, INF), True),
        (0, (-1.0, INF), True),
        (0, (-INF, 1.5), False),
    ],
)
def test_a_control_ends_at_its_bounds_or_at_what_limits_it_all_along(
    control: int, bounds: Any, ended: bool
) -> None:
    both = ((bounds[0],) * 2, (bounds[1],) * 2)
    limits = LinearPathLimits.from_samples(flight(both), np.array([True, True]))
    assert np.all(np.isfinite(limits.find_tightest_limits(control))) == ended


def test_the_tightest_limit_holds_a_control_that_is_sent_up_or_down() -> None:
    """Up to 1.5 at most, down to -1: -1 <= x u <= 1.8 is tighter where |x| is large, than 2 u + x <= 4 too."""
    everywhere = np.ones(5, dtype=bool)
    own, held = LIMITS.label_control_arcs(0, everywhere)
    assert own.tolist() == [SING, SING, UP, UP, SING]
    assert held[0].tolist() == [FREE] * 5 and held[5].tolist() == [LOW, LOW, FREE, FREE, UP]
    own, held = LIMITS.label_control_arcs(0, ~everywhere)
    assert own.tolist() == [SING, LOW, LOW, LOW, SING]
    assert held[5].tolist() == [UP, FREE, FREE, FREE, LOW] and held[0].tolist() == [FREE] * 5
    own, held = LIMITS.label_control_arcs(1, np.array([True, False, True, False, True]))
    assert own.tolist() == [SING, LOW, SING, LOW, SING]
    assert set(held) == {3} and held[3].tolist() == [LOW, FREE, LOW, FREE, LOW]


def test_a_later_limit_that_is_tighter_frees_the_one_before() -> None:
    wide = LinearPathLimits.from_samples(flight(((-9.0, -9.0), (9.0, 9.0))), np.array([True, True]))
    own, held = wide.label_control_arcs(0, np.ones(5, dtype=bool))
    assert own.tolist() == [SING] * 5
    assert held[0].tolist() == [FREE, FREE, UP, UP, FREE] and held[5].tolist() == [LOW, LOW, FREE, FREE, UP]


# Vector controls bounded in norm that hold state constraints: arcs along which the whole vector is
# singular.


def flight_of_vector_limits(start: list[float], target: list[float], fuel: bool = False) -> go.Problem:
    """Least time to rest at a target with |acceleration| and |speed| at most 1; or least fuel in 7 s."""
    size = len(start)
    model = go.Model("craft")
    r, v = model.state("r", size), model.state("v", size)
    a, norm = model.vector_control("a", size)
    model.ode({r: v, v: a})
    problem, leg = one_phase("top speed", model, initial=0.0, final=7.0 if fuel else (0.1, 20.0))
    leg.initial(r=[0.0] * size, v=start)
    leg.final(r=target, v=[0.0] * size)
    leg.norm_bounds(a=(0.0, 1.0))
    leg.path("speed", ca.sumsqr(v), upper=1.0)
    problem.minimize(leg.integral(norm, "fuel") if fuel else leg.final_time)
    return problem


@pytest.fixture(scope="module")
def straight() -> go.Solution:
    return go.solve(flight_of_vector_limits([0.0, 0.0], [2.0, 1.0]), mesh="10x3")


@pytest.mark.slow
def test_from_rest_to_rest_at_top_speed(straight: go.Solution) -> None:
    """Up to speed in 1 s, L / V + V / a in all; in between the vector is zero though its limit is not."""
    assert straight.converged and go.verify(straight).ok
    assert straight.objective == pytest.approx(math.sqrt(5.0) + 1.0, abs=1e-8)
    held = [(arc.start, arc.end) for arc in straight.structure if arc.channel == "speed"]
    np.testing.assert_allclose(held, [(1.0, math.sqrt(5.0))], atol=1e-6)
    times = np.array([0.5, 1.5, straight.objective - 0.5])
    pushes = np.array([2.0, 1.0])[:, None] / math.sqrt(5.0) * np.array([1.0, 0.0, -1.0])
    np.testing.assert_allclose(straight.phase().saturated_control("a")(times), pushes, atol=1e-6)


TURNING = PhaseStructure(
    (0.0, 1.0, 2.0, 3.0, 4.0),
    (
        (UP, FREE, FREE, FREE, FREE),
        (UP, FREE, FREE, FREE, UP),
        (UP, SING, SING, FREE, UP),
        (UP, FREE, FREE, FREE, FREE),
    ),
    (),
    3,
    2,
    orders=(0, 0, 0, 0, 1),
    effects=((), (), (), ((1, 0), (2, 0)), ((2, 0), (1, 0), (0, 0))),
)
"""Magnitude, direction; length of the direction, speed."""


def test_one_constraint_determines_one_of_several_singular_controls() -> None:
    """That which holds it best; those at their limits, or on the sphere, are no others'."""
    assert [TURNING.find_controls_fixed_by_limits(k) for k in range(4)] == [set(), {0, 1, 2}, {0, 2}, set()]


def test_controls_at_the_end_of_a_segment() -> None:
    """The weights are exact for polynomials of lower degree than there are points."""
    collocation = PhaseCollocation("LG", Mesh((0.0, 0.4, 1.0), (3, 4), ()), 1, 2, 0, 0, 0)
    for tangent, segment, end in ((-1, 0, 1.0), (1, 1, -1.0)):
        beside = find_controls_at_junction(collocation, Junction(0, 1, UP, 1, tangent))
        tau = collocation.collocation_rules[segment].points
        assert (tau**2 - tau) @ beside.weights == pytest.approx(end**2 - end, abs=1e-13)
        first = collocation.mesh.point_offsets[segment]
        assert np.array_equal(beside.points, collocation.point_controls[:, first : first + tau.size])
    assert find_controls_at_junction(collocation, Junction(0, 1, UP, 1)).points.shape == (2, 0)
