"""Contacts with state limits: found, held, and their junctions."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.constructed_solutions import functions, interval, phase
from testing.internals import PhaseSamples, PhaseStructure
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.planning import ArcKind
from gnc_opt.planning.optimality import active_state_constraints as sc
from gnc_opt.planning.optimality.active_state_constraints import impose_touch_points
from gnc_opt.planning.optimality.kkt_system import ProgramPoint
from gnc_opt.planning.problem.active_constraint_arcs import Junction
from gnc_opt.planning.problem.state_constraint_order import get_constraint_order
from gnc_opt.planning.refinement.arcs import state_constraint_contact_detection as p

# Arcs on state constraints and touches, found on a coarse mesh and refined: closed forms.


LOW, FREE, UP = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER


DRIFT = 0.7
"""Speed of the observer who sees the ceiling move, m/s."""


def throw(limit: float, form: str = "bound", unit: float = 1.0) -> go.Problem:
    """Bryson and Denham's problem (Bryson & Ho 1975, p. 120), x <= limit; x in units of 1 / unit m.

    "curved": the state is z with x = z + z^3 / 3, the limit a path constraint that is not linear in it; "moving": as
    seen by an observer who moves at a constant speed.
    """
    model = go.Model("double integrator")
    x, v = model.state("x"), model.state("v")
    a = model.control("a")
    model.ode({x: v / (1 + x**2) if form == "curved" else unit * v, v: a})
    problem, leg = one_phase(f"throw, {form}", model, initial=0.0, final=1.0)
    drift = DRIFT if form == "moving" else 0.0
    leg.initial(x=0.0, v=1.0 + drift)
    leg.final(x=drift, v=-1.0 + drift)
    if form == "moving":
        leg.path("ceiling", x - drift * model.time, upper=limit)
    elif form == "bound":
        leg.bounds(x=(None, unit * limit))
    else:
        leg.path("ceiling", x + x**3 / 3 if form == "curved" else x, upper=unit * limit)
    problem.minimize(leg.integral(a**2 / 2, "effort"))
    return problem


@cache
def thrown(limit: float, form: str = "bound", unit: float = 1.0, mesh: str = "20x4") -> go.Solution:
    return go.refine(go.solve(throw(limit, form, unit), mesh=mesh, tol=None))


def contact(solution: go.Solution) -> tuple[float, float]:
    """When the one contact begins and ends."""
    (arc,) = [a for a in solution.structure if a.channel in ("x", "ceiling", "v")]
    assert arc.kind is UP
    return arc.start, arc.end


def test_the_order_is_the_first_derivative_with_a_control() -> None:
    model, x, v, _w, _u, s = dynamics(
        "chain", "x v w", "u s", lambda x, v, w, u, s: {x: v**2, v: w, w: u * x}
    )
    problem = go.Problem("chain")
    leg = problem.phase("leg", model)
    leg.path("free", x - s, upper=0.0)
    leg.path("moving", v - model.time**3, upper=0.0)
    leg.path("clock", model.time, upper=0.0)
    found = [get_constraint_order(problem, leg, row) for row in range(6)]
    assert [f.order for f in found] == [0, 2, None, 3, 2, 1]
    assert [f.controls for f in found] == [(1,), (0,), (), (0,), (0,), (0,)]
    assert found[0].label == "free" and found[3].label == "x"
    # (v - t^3)'' = u x - 6 t and (v^2)'' = 2 w^2 + 2 v u x, at t, x, v, w, u = 2, 3, 5, 7, 11
    t, states, controls, p = model.symbolic_arguments()
    at = ca.Function(
        "at", [t, states, controls, p], [f.derivatives[-1] for f in found[1:4:2]], {"allow_free": False}
    )(2, [3, 5, 7], [11, 13], [])
    assert [float(value) for value in at] == [11 * 3 - 12, 2 * 49 + 2 * 5 * 11 * 3]


@pytest.mark.slow
@pytest.mark.parametrize(("form", "unit", "mesh"), [("bound", 1e3, "11x3"), ("curved", 1.0, "20x4")])
def test_an_arc_of_second_order(form: str, unit: float, mesh: str) -> None:
    """On the limit from 3 l to 1 - 3 l; J = 4 / (9 l), lam_x = 2 / (9 l^2) before, 0 on it, -2 / (9 l^2) after."""
    limit = 1 / 9
    solution = thrown(limit, form, unit, mesh)
    assert solution.history.status.value == "converged" and go.verify(solution).minimum
    assert contact(solution) == pytest.approx((1 / 3, 2 / 3), abs=1e-9)
    assert solution.objective == pytest.approx(4.0, abs=1e-11)
    leg, t = solution.phase(), np.array([0.1, 0.3, 0.4, 0.6, 0.7, 0.9])
    side = np.sign(0.5 - t) * (np.abs(t - 0.5) > 1 / 6)
    slope = 1 + leg.state("x")(t) ** 2 if form == "curved" else unit**-1.0
    np.testing.assert_allclose(leg.costate("x")(t), 18 * side * slope, rtol=1e-6, atol=2e-6 / unit)
    a = -6 * np.maximum(1 - 3 * np.minimum(t, 1 - t), 0)
    np.testing.assert_allclose(leg.control("a")(t), a, atol=1e-8)
    np.testing.assert_allclose(leg.costate("v")(t), -a, atol=1e-8)


def test_the_bound_s_impulses_are_the_atoms_at_entry_and_exit() -> None:
    leg = thrown(1 / 9).phase()
    at_ends = np.min(np.abs(leg.breaks[:, None] - np.array([1 / 3, 2 / 3])), axis=1) < 1e-6
    np.testing.assert_allclose(leg.state_impulses[0, 1:-1], 18.0 * at_ends[1:-1], atol=5e-5)
    np.testing.assert_allclose(leg.state_impulses[1, 1:-1], 0.0, atol=1e-7)


@pytest.mark.slow
def test_an_arc_of_first_order() -> None:
    """Least effort from rest to rest over 1 m in 1 s, v <= V = 5/4: on the limit from t1 = 3/2 (1 - 1/V) to 1 - t1.

    Before, v = V (1 - (1 - t / t1)^2); hence J = 4 V^2 / (3 t1).
    """
    model, _x, v, a = dynamics("cart", "x v", "a", lambda x, v, a: {x: v, v: a})
    problem, leg = one_phase("limited speed", model, initial=0.0, final=1.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    leg.path("v", v, upper=1.25)
    problem.minimize(leg.integral(a**2 / 2, "effort"))
    solution = go.refine(go.solve(problem, tol=None))
    assert solution.history.converged and go.verify(solution).minimum
    assert contact(solution) == pytest.approx((0.3, 0.7), abs=1e-9)
    assert solution.objective == pytest.approx(4 * 1.25**2 / 0.9, abs=1e-10)


@pytest.mark.parametrize("limit", [0.1, 0.2])
def test_a_moving_limit(limit: float) -> None:
    """The same flight; H differs by lam_x times the drift, and so jumps with lam_x, at the touch by -48 (1 - 4 l)."""
    solution = thrown(limit, "moving")
    assert solution.history.converged and go.verify(solution).ok
    arc = limit < 1 / 6
    exact = 4 / (9 * limit) if arc else 2 + 6 * (1 - 4 * limit) ** 2
    assert solution.objective == pytest.approx(exact, abs=1e-9)
    assert contact(solution) == pytest.approx((3 * limit, 1 - 3 * limit) if arc else (0.5, 0.5), abs=1e-7)
    hamiltonian = solution.hamiltonian
    lam_x = 2 / (9 * limit**2) if arc else 24 * (1 - 4 * limit)
    assert hamiltonian(0.9) - hamiltonian(0.1) == pytest.approx(-2 * DRIFT * lam_x, rel=1e-6)


@pytest.mark.parametrize("form", ["bound", "ceiling", "curved"])
def test_where_a_touch_moves(form: str) -> None:
    """With v(0) = w, J(s) = 6 l^2/s^3 - 6 l w/s^2 + 2 w^2/s + the same of 1 - s and w = 1 is least at the touch s.

    Hence at w = 1, s = 1/2: ds/dw = -(96 l - 16) / (4608 l^2 - 1152 l + 64), which takes the second order right.
    """
    limit = 0.2
    moved = go.sensitivity(thrown(limit, form, 1.0, "20x4" if form == "bound" else "11x4"), initial="v")
    exact = -(96 * limit - 16) / (4608 * limit**2 - 1152 * limit + 64)
    assert moved.phases["leg"].switching_times == pytest.approx([exact], abs=1e-6)
    assert moved.objective == pytest.approx(8 - 24 * limit, abs=1e-6)


@pytest.mark.parametrize("form", ["bound", "ceiling"])
def test_a_touch_is_held_where_it_pushes(form: str) -> None:
    """At the boundary where the costate jumps inwards; not if it jumps the other way, and not on a mesh that stays."""
    touched = thrown(0.2, form, 1.0, "20x4" if form == "bound" else "11x4")
    leg = touched.phase()
    held = impose_touch_points(touched).phases["leg"].numbers.arcs
    assert held is not None and held.junctions == (Junction(0, *leg.mesh.movable, UP, 2),)
    pulled = replace(leg, lam=replace(leg.lam, values=tuple(-v for v in leg.lam.values)))
    stays = replace(leg, mesh=replace(leg.mesh, movable=()))
    for other in (pulled, stays):
        assert impose_touch_points(replace(touched, phases={"leg": other})).phases["leg"].numbers.arcs is None


@pytest.mark.parametrize("form", ["ceiling", "curved"])
def test_a_touch_has_the_multiplier_of_its_jump(form: str) -> None:
    """lam_x falls by 48 (1 - 4 l) = 9.6 at 1/2 s: with that the conditions of first order hold, without it not."""
    point = ProgramPoint.from_solution(thrown(0.2, form, 1.0, "11x4"))
    assert np.max(np.abs(point.kkt_residual)) < 1e-5
    ((_, junction, rows),) = point.transcription.junctions
    assert junction.kind is UP and len(rows) == 2
    multipliers = point.lam[rows] * point.scaling.rows[rows] / point.scaling.objective
    assert multipliers == pytest.approx([9.6, 0.0], abs=1e-4)
    bare = replace(point, lam=np.where(np.isin(np.arange(point.lam.size), rows), 0.0, point.lam))
    assert np.max(np.abs(bare.kkt_residual)) > 0.1


def test_a_saddle_beside_a_touch_fails() -> None:
    """Beside the throw y = 0, y' = w, least int (w^2 - k y^2) / 2: y = 0 is a minimum just for k < pi^2."""
    model = go.Model("double integrator and another")
    x, v, y = model.state("x"), model.state("v"), model.state("y")
    a, w = model.control("a"), model.control("w")
    k = model.parameter("k", 8.0)
    model.ode({x: v, v: a, y: w})
    problem, leg = one_phase("throw beside a saddle", model, initial=0.0, final=1.0)
    leg.initial(x=0.0, v=1.0, y=0.0)
    leg.final(x=0.0, v=-1.0, y=0.0)
    leg.bounds(x=(None, 0.24))
    problem.minimize(leg.integral((a**2 + w**2 - k * y**2) / 2, "effort"))
    solution = go.refine(go.solve(problem, mesh="11x4", tol=None))
    assert contact(solution)[0] == pytest.approx(0.5, abs=1e-8) and solution.phase().mesh.movable
    assert go.verify(solution)["second order"].result.value == "PASS"
    for k, told in ((9.0, "PASS"), (11.0, "FAIL")):
        other = replace(solution, problem=problem.with_parameters(k=k))
        assert go.verify(other)["second order"].result.value == told


def test_a_mesh_of_one_segment() -> None:
    solution = go.refine(go.solve(throw(0.2), mesh="1x12", tol=None))
    assert solution.history.converged and contact(solution) == pytest.approx((0.5, 0.5), abs=1e-8)


def test_a_limit_out_of_reach_is_no_contact() -> None:
    solution = thrown(0.26)
    assert solution.objective == pytest.approx(2.0, abs=1e-9)
    assert not any(a.channel == "x" for a in solution.structure)


@pytest.mark.parametrize("limit", [1 / 9, 0.2])
def test_a_wrong_jump_fails(limit: float) -> None:
    """Costates a thousandth off after the last contact: a jump of another size, and one of another state."""
    solution = thrown(limit)
    leg = solution.phase()
    after = contact(solution)[1]
    for row, offset in ((0, 0.02), (1, 0.01)):
        values = [v.copy() for v in leg.lam.values]
        for k, start in enumerate(leg.breaks[:-1]):
            if start >= after - 1e-6:
                values[k][row] += offset
        lam = type(leg.lam)(leg.breaks, leg.lam.nodes, tuple(values))
        wrong = replace(solution, phases={"leg": replace(leg, lam=lam)})
        failed = {c.name for c in go.verify(wrong).failed}
        assert ("stationarity" in failed) if row == 1 else failed


def test_touches_stay_with_their_times() -> None:
    free = PhaseStructure((0.0, 4.0), ((FREE, FREE),), (), 1, 0, (0, 2))
    one = free.with_touch_point(1, 1.0, UP)
    two = one.with_touch_point(1, 3.0, UP)
    assert (two.times, two.touches) == ((0.0, 1.0, 3.0, 4.0), ((), ((1, UP),), ((1, UP),), ()))
    assert two.kinds == ((FREE, FREE),) * 3 and not two.has_only_control_kinks(1)
    assert two.merge_equal_adjacent_arcs() == two
    assert two.list_touch_times(1, UP) == [1.0, 3.0]
    assert two.list_touch_times(1, LOW) == []
    assert two.with_switch_times((0.0, 1.0, 1.0, 4.0)).without_subarc(1).touches == ((), ((1, UP),), ())
    held = two.with_inserted_arc(1, 0.5, 2.0, UP)
    assert held.times == (0.0, 0.5, 2.0, 3.0, 4.0) and held.touches == ((), (), (), ((1, UP),), ())
    assert held.has_only_control_kinks(1) and held.has_only_control_kinks(2)
    assert held.replace_subarc_by_touch(1).list_touch_times(1, UP) == [1.25, 3.0]
    assert held.mask_constraints_near_contacts(False).tolist() == [[False] * 4, [True, False, True, False]]
    assert held.mask_constraints_near_contacts(True).tolist() == [[False] * 4, [True, False, True, True]]
    np.testing.assert_array_equal(
        held.is_at_limit(1, np.array([0.4, 0.5, 1.0, 2.0, 2.5, 3.0, 3.5])),
        [False, True, True, True, False, True, False],
    )
    arcs = [(a.channel, a.start, a.end) for a in held.list_arcs("leg", ("a", "x")) if a.channel == "x"]
    assert arcs == [("x", 0.5, 2.0), ("x", 3.0, 3.0)]


def test_a_touch_in_any_piece_leaves_what_the_others_do() -> None:
    mixed = PhaseStructure((0.0, 1.0, 3.0, 4.0), ((LOW, FREE), (FREE, FREE), (UP, FREE)), (), 1, 0, (0, 2))
    for k, time in enumerate((0.5, 2.0, 3.5)):
        touched = mixed.with_touch_point(1, time, UP)
        assert touched.times == tuple(sorted((*mixed.times, time)))
        assert touched.kinds == (*mixed.kinds[: k + 1], *mixed.kinds[k:])
        assert touched.touches == (*[()] * (k + 1), ((1, UP),), *[()] * (3 - k))
        held = mixed.with_inserted_arc(1, time - 0.25, time + 0.25, UP)
        assert held.kinds == (*mixed.kinds[: k + 1], (mixed.kinds[k][0], UP), *mixed.kinds[k:])


def test_what_vanishes_passes_its_touches_on() -> None:
    """Inside both ends' touches go to the middle; at an end of the phase there is none; a contact leaves a touch."""
    pieces = ((FREE, FREE), (LOW, FREE), (FREE, FREE))
    touched = PhaseStructure(
        (0.0, 1.0, 2.0, 4.0), pieces, (), 1, 0, (0, 2), ((), ((1, UP),), ((1, UP), (1, LOW)), ())
    )
    inner = touched.without_subarc(1)
    assert (inner.times, inner.touches) == ((0.0, 1.5, 4.0), ((), ((1, UP), (1, LOW)), ()))
    assert touched.without_subarc(0).touches == ((), ((1, UP), (1, LOW)), ())
    assert touched.without_subarc(0).times == (0.0, 2.0, 4.0)
    assert (touched.without_subarc(2).times, touched.without_subarc(2).touches) == (
        (0.0, 1.0, 4.0),
        ((), ((1, UP),), ()),
    )
    assert touched.replace_subarc_by_touch(1) == inner  # nothing was held along it
    for order, left in ((1, ()), (2, ((1, UP),)), (3, ((1, UP),))):
        held = PhaseStructure(
            (0.0, 1.0, 2.0, 4.0), ((FREE, FREE), (FREE, UP), (FREE, FREE)), (), 1, 0, (0, order)
        )
        assert held.replace_subarc_by_touch(1).list_touch_times(1, UP) == ([1.5] if left else [])
    start = PhaseStructure((0.0, 1.0, 4.0), ((FREE, UP), (FREE, FREE)), (), 1, 0, (0, 2))
    assert start.replace_subarc_by_touch(0).list_touch_times(1, UP) == []
    beside = PhaseStructure((0.0, 1.0, 2.0, 4.0), ((FREE, UP), (FREE, LOW), (FREE, FREE)), (), 1, 0, (0, 2))
    assert beside.replace_subarc_by_touch(1).list_touch_times(1, LOW) == []


def test_kinks_are_where_limits_are_entered_or_left_without_a_touch() -> None:
    held = PhaseStructure((0.0, 1.0, 2.0, 4.0), ((FREE, FREE), (FREE, UP), (FREE, FREE)), (), 1, 0, (0, 2))
    assert [held.has_only_control_kinks(k) for k in (1, 2)] == [True, True] and [
        held.has_constraint_contact(k) for k in range(3)
    ] == [0, 1, 0]
    for kinds, effects in ((((FREE, LOW), (FREE, UP)), (0, 2)), (((FREE, FREE), (FREE, UP)), (0, 0))):
        assert not PhaseStructure((0.0, 1.0, 2.0), kinds, (), 1, 0, effects).has_only_control_kinks(1)
    both = PhaseStructure((0.0, 1.0, 2.0), ((LOW, FREE), (UP, UP)), (), 1, 0, (0, 2))
    assert not both.has_only_control_kinks(1)
    touch = PhaseStructure(
        (0.0, 1.0, 2.0), ((FREE, FREE), (FREE, UP)), (), 1, 0, (0, 2), ((), ((1, UP),), ())
    )
    assert not touch.has_only_control_kinks(1)


@pytest.mark.parametrize("price", [1.0, 5.0])
def test_an_arc_from_a_free_start(price: float) -> None:
    """Least int a^2 / 2 + w x over 3 s to (1, 0), x >= 0: it stays on the floor until L = (72 / w)^(1/4) are left.

    Then a = w (L t / 3 - t^2 / 2). The costates are zero on the floor, and nothing pushes at the start.
    """
    model, x, _v, a = dynamics("double integrator", "x v", "a", lambda x, v, a: {x: v, v: a})
    problem, leg = one_phase("lift off", model, initial=0.0, final=3.0)
    leg.final(x=1.0, v=0.0)
    leg.bounds(x=(0.0, None))
    problem.minimize(leg.integral(a**2 / 2 + price * x))
    solution = go.solve(problem, tol=1e-8)
    assert solution.converged and go.verify(solution).ok
    left = (72 / price) ** 0.25
    (arc,) = [a for a in solution.structure if a.channel == "x"]
    assert (arc.start, arc.end) == pytest.approx((0.0, 3.0 - left), abs=1e-7)
    t = np.maximum(np.linspace(0.0, 3.0, 31) - (3.0 - left), 0.0)
    found = solution.phase()
    np.testing.assert_allclose(
        found.u(np.linspace(0.0, 3.0, 31))[0], price * (left * t / 3 - t**2 / 2), atol=1e-6
    )
    np.testing.assert_allclose(found.lam(0.3 * arc.end), 0.0, atol=1e-6)


# Contacts with state constraints, part by part: runs of pushes, junctions, touches that pull, excesses.


MESH = SimpleNamespace(phase=SimpleNamespace(breaks=np.array([0.0, 1.0, 10.0])))


def free(order: int, pieces: int = 1, touches: Any = ()) -> PhaseStructure:
    """One control and one state from 0 to 10 s."""
    times = tuple(float(t) for t in np.linspace(0.0, 10.0, pieces + 1))
    return PhaseStructure(times, ((FREE, FREE),) * pieces, (), 1, 0, (0, order), touches, ((), ((0, 0),)))


def run(times: Any, worth: Any, kind: ArcKind = UP) -> p.ContactNodes:
    return p.ContactNodes(1, kind, np.array(times, float), np.array(worth, float))


def test_a_constraint_of_second_order_touches_or_stays() -> None:
    """Pushes at `FEW` nodes or fewer are a touch at their centre; at more, or beside a touch, an arc over all."""
    nodes = np.linspace(2.0, 8.0, 7)
    few = run(nodes, [0, 1, 0, 3, 0, 0, 0]).add_contact_arcs(free(2), MESH)  # type: ignore[arg-type]
    assert few.times == (0.0, 3.0, 5.0, 10.0) and few.touches == ((), ((1, UP),), ((1, UP),), ())
    one = run(nodes, [0, 1, 3, 0, 0, 0, 0]).add_contact_arcs(free(2), MESH)  # type: ignore[arg-type]
    assert one.list_touch_times(1, UP) == pytest.approx([3.75]) and one.kinds == ((FREE, FREE),) * 2
    five = run(nodes, [0, 1, 0, 0, 0, 1, 0]).add_contact_arcs(free(2), MESH)  # type: ignore[arg-type]
    assert five.list_touch_times(1, UP) == [3.0, 7.0]
    six = run(nodes, [1, 0, 0, 0, 0, 1, 0]).add_contact_arcs(free(2), MESH)  # type: ignore[arg-type]
    assert six.times == (0.0, 2.0, 7.5, 10.0) and [k[1] for k in six.kinds] == [FREE, UP, FREE]
    known = free(2).with_touch_point(1, 2.5, UP)
    beside = run(nodes, [0, 1, 0, 0, 0, 0, 0]).add_contact_arcs(known, MESH)  # type: ignore[arg-type]
    assert beside.times == (0.0, 2.5, 3.5, 10.0) and not beside.list_touch_times(1, UP)
    later = run(nodes, [0, 0, 0, 1, 0, 0, 0]).add_contact_arcs(free(2).with_touch_point(1, 7.5, UP), MESH)  # type: ignore[arg-type]
    assert later.times == (0.0, 4.5, 7.5, 10.0)
    far = run(nodes, [0, 1, 0, 0, 0, 0, 0]).add_contact_arcs(free(2).with_touch_point(1, 9.0, UP), MESH)  # type: ignore[arg-type]
    assert far.list_touch_times(1, UP) == [3.0, 9.0]


def test_a_constraint_of_third_order_touches_only() -> None:
    added = run(np.linspace(2.0, 8.0, 7), [1, 1, 1, 1, 1, 1, 1]).add_contact_arcs(free(3), MESH)  # type: ignore[arg-type]
    assert added.list_touch_times(1, UP) == pytest.approx([5.0]) and added.kinds == ((FREE, FREE),) * 2
    for end in (0.0, 10.0):
        at_end = run([end, 5.0] if end == 0 else [5.0, end], [1, 0] if end == 0 else [0, 1])
        assert at_end.add_contact_arcs(free(3), MESH).touches == free(3).touches  # type: ignore[arg-type]


def climb() -> go.Problem:
    """h' = v, v' = a, and a path on h + v^2 / 2; h and that are of second and first order."""
    model, h, v, a = dynamics("climb", "h v", "a", lambda h, v, a: {h: v, v: a})
    problem, leg = one_phase("climb", model, 0.0, 4.0)
    leg.path("energy", h + v**2 / 2, upper=5.0)
    problem.minimize(0.5 * leg.integral(a**2))
    return problem


CLIMB = climb()


def constraints(x: Any, u: Any, lam: Any, **changes: Any) -> sc.StateConstraints:
    leg = phase(CLIMB, x, u, lam, breaks=(0.0, 1.0, 2.0, 4.0), **changes)
    return sc.StateConstraints(CLIMB, PhaseSamples.from_phase(leg, functions(CLIMB)))


def falling(t: Array, k: int) -> Any:
    """h = 4 t - t^2, v = 4 - 2 t: at its highest, 4 m, at 2 s."""
    return [4 * t - t**2, 4 - 2 * t]


def steady(t: Array, k: int) -> Any:
    return [-2 + 0 * t]


def jumping(t: Array, k: int) -> Any:
    """lam_h is 3 before 2 s, and 1 afterwards."""
    return [1.0 + 2 * (k < 2) + 0 * t, 0 * t]


def test_values_derivatives_and_gradients_of_rows() -> None:
    here = constraints(falling, steady, jumping, state_bounds=interval([-1, -9], [4, 9]))
    assert here.n_rows == 3 and here.constraint_row_bounds.upper.tolist() == [5, 4, 9]
    assert here.constraint_row_bounds.lower.tolist() == [-np.inf, -1, -9]
    t = np.array([0.5, 3.0])
    x, u = falling(t, 0), steady(t, 0)
    x, u = np.array(x), np.array(u)
    assert here.evaluate_constraints(t, x, u) == pytest.approx(np.array([x[0] + x[1] ** 2 / 2, x[0], x[1]]))
    assert here.evaluate_time_derivative(0, 1, t, x, u) == pytest.approx(x[1] + x[1] * u[0])
    assert here.evaluate_time_derivative(1, 1, t, x, u) == pytest.approx(x[1])
    assert (
        here.evaluate_time_derivative(1, 2, t, x, u)
        == pytest.approx(u[0])
        == here.evaluate_time_derivative(2, 1, t, x, u)
    )
    assert here.row_scales == pytest.approx([*here.samples.path_scale, *here.samples.state_scale])
