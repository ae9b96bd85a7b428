"""Several controls that change at one time, with arcs on limits of states: closed forms, and their multipliers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.internals import Junction, PhaseStructure, Smooth

import gnc_opt as go
from gnc_opt.planning import ArcKind, Mesh
from gnc_opt.planning.refinement.arcs.split_switches import INSTANT, POINTS, _Cuts, shared

LOW, UP, FREE, SINGULAR = ArcKind.LOWER, ArcKind.UPPER, ArcKind.INTERIOR, ArcKind.SINGULAR


def gantry(distance: float, speed: float) -> go.Problem:
    """Least time from rest to rest along two axes at once, |a| <= 1 and |v| <= speed in both."""
    model = go.Model("gantry")
    x, v = model.state("x", 2), model.state("v", 2)
    a = model.control("a", 2)
    model.ode({x: v, v: a})
    problem = go.Problem("gantry")
    leg = problem.phase("move", model)
    leg.time(initial=0.0, final=(0.5, 20.0))
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


@pytest.mark.slow
def test_a_slew_from_standstill_fills_its_wheels_together() -> None:
    """About (1, 1, 1) by 90 deg: 0.5 N m s at 0.1 N m fill and empty every wheel in 5 s.

    Multiple shooting by RK4 with 100, 200, 400 constant torques (CasADi alone) takes 28.28039, 28.27781, 28.27708 s:
    what is above the limit falls to less than a third each time.
    """
    craft = go.Model("satellite")
    q, w, h = craft.state("q", 4), craft.state("w", 3), craft.state("h", 3)
    torque = craft.control("torque", 3)
    inertia = np.diag([12.0, 14.0, 9.0])
    vector, scalar = q[:3], q[3]
    attitude = 0.5 * ca.vertcat(scalar * w + ca.cross(vector, w), -ca.dot(vector, w))
    rate = np.linalg.inv(inertia) @ (-torque - ca.cross(w, inertia @ w + h))
    craft.ode({q: attitude, w: rate, h: torque})
    problem = go.Problem("slew from standstill")
    leg = problem.phase("slew", craft)
    leg.time(initial=0.0, final=(5.0, 300.0))
    leg.initial(q=[0, 0, 0, 1.0], w=[0, 0, 0], h=[0, 0, 0])
    leg.final(q=[*(np.sin(np.pi / 4) / np.sqrt(3) * np.ones(3)), np.cos(np.pi / 4)], w=[0, 0, 0])
    leg.bounds(torque=([-0.1] * 3, [0.1] * 3), h=([-0.5] * 3, [0.5] * 3))
    problem.minimize(leg.final_time)
    slew = go.solve(problem)
    assert slew.converged and go.verify(slew).ok
    assert slew.objective == pytest.approx(28.27688, abs=1e-4)
    left = [max(a.end for a in slew.structure if a.channel == f"h[{i}]") for i in range(3)]
    np.testing.assert_allclose(
        left[:2], slew.objective - 5.0, atol=1e-6
    )  # the third one has the least inertia


# --- boundaries, and instants beside them -------------------------------------------------------------------------


def test_a_slew_about_one_axis_reverses_two_torques_at_half_time() -> None:
    """60 deg about x, inertias 120, 100, 80 kg m^2, 1 N m about each axis: the others help by precession.

    Backwards in time it is the same slew, so that torques which are odd or even about half time solve it: T_x and T_y
    both reverse there. In either order of the two switches the piece between them wants to vanish, ever more weakly.
    """
    craft = go.Model("spacecraft")
    q, w, T = craft.state("q", 4), craft.state("w", 3, unit="rad/s"), craft.control("T", 3, unit="N m")
    inertia = ca.DM([120.0, 100.0, 80.0])
    turn = 0.5 * ca.vertcat(q[3] * w + ca.cross(q[:3], w), -ca.dot(q[:3], w))
    craft.ode({q: turn, w: (T - ca.cross(w, inertia * w)) / inertia})
    problem = go.Problem("slew")
    leg = problem.phase("slew", craft)
    leg.time(0.0, final=(5.0, 300.0))
    leg.initial(q=[0.0, 0.0, 0.0, 1.0], w=[0.0, 0.0, 0.0])
    leg.final(q=[0.5, 0.0, 0.0, np.sqrt(0.75)], w=[0.0, 0.0, 0.0])
    leg.bounds(T=(-1.0, 1.0), q=(-1.1, 1.1))
    problem.minimize(leg.final_time)
    rough = {"x": [10.0], "y": [2.0, 10.0, 18.0], "z": [5.0, 15.0]}  # there are other minima, 0.1 s slower
    signs = [(-1.0) ** np.searchsorted(t, np.linspace(0.0, 20.0, 81)) for t in rough.values()]
    leg.guess(np.linspace(0.0, 20.0, 81), T=np.array([[1.0], [-1.0], [-1.0]]) * signs)
    found = go.solve(problem)
    assert found.converged and go.verify(found).ok
    assert found.objective < 2 * np.sqrt(120.0 * np.pi / 3)  # about its own axis alone
    half = 0.5 * found.objective
    for torque in ("T[0]", "T[1]"):
        ends = [arc.end for arc in found.structure if arc.channel == torque]
        assert min(abs(t - half) for t in ends) < 1e-9 * half


def test_boundaries_are_shared_where_several_controls_change_and_there_is_room() -> None:
    """Rows: two controls, a state of each that it can hold."""
    kinds = (
        (UP, UP, FREE, FREE),
        (SINGULAR, SINGULAR, UP, UP),
        (LOW, SINGULAR, FREE, UP),
        (UP, LOW, FREE, FREE),
        (LOW, UP, FREE, FREE),
    )
    near = PhaseStructure((0.0, 1.0, 2.0, 3.0, 3.0 + 1e-6, 4.0), kinds, n_controls=2, orders=(0, 0, 1, 1))
    assert shared(near) == (1,)
    assert shared(near.at((0.0, 1.0, 2.0, 3.0, 3.5, 4.0))) == (1, 3, 4)


def test_instants_are_free_for_what_changes() -> None:
    """Three segments, the second boundary shared."""
    cuts = _Cuts(3, (2,))
    first, second = cuts.kinds(((LOW, LOW, LOW), (LOW, UP, FREE)))
    assert list(first) == [LOW] * 5 and list(second) == [LOW, UP, FREE, FREE, FREE]
    mesh = cuts.mesh(Mesh((0.0, 0.25, 0.5, 1.0), (4, 5, 6), (1, 2)))
    np.testing.assert_allclose(mesh.breaks, [0.0, 0.25, 0.5 - INSTANT, 0.5, 0.5 + INSTANT, 1.0], atol=1e-15)
    assert mesh.degrees == (4, 5, POINTS, POINTS, 6) and mesh.movable == (1,)
    assert [cuts.boundary(k) for k in range(4)] == [0, 1, 3, 5]
    inner, junction = Smooth(0, 1, 2, 4), Junction(0, 2, UP, 1)
    assert (cuts.first(inner.first), cuts.last(inner.last)) == (1, 2)
    assert (cuts.first(2), cuts.last(3), cuts.boundary(junction.boundary)) == (4, 5, 3)
