"""The pieces of a control structure: vanishing, swapped and added arcs, and how finely each piece is solved."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.special import spherical_in
from testing.internals import ARC_MAX_DEGREE, MAX_SEGMENTS, PhaseStructure, Resolution, detect

import gnc_opt as go
from gnc_opt.planning import Arc, ArcKind
from gnc_opt.planning.refinement.arcs.detection import switching
from gnc_opt.planning.refinement.arcs.resolution import PIECE_MIN_POINTS
from problems.classics import van_der_pol

LOW, FREE, UP = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER

TWO = PhaseStructure((0.0, 1.0, 2.0, 4.0, 5.0), ((LOW, LOW), (UP, LOW), (UP, UP), (LOW, UP)))
"""Two controls: the first one is up from 1 s to 4 s, the second one from 2 s on."""


# --- arcs that vanish, swap, appear -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("piece", "times", "kinds"),
    [
        (0, (0.0, 2.0, 4.0, 5.0), ((UP, LOW), (UP, UP), (LOW, UP))),
        (1, (0.0, 1.5, 4.0, 5.0), ((LOW, LOW), (UP, UP), (LOW, UP))),
        (2, (0.0, 1.0, 3.0, 5.0), ((LOW, LOW), (UP, LOW), (LOW, UP))),
        (3, (0.0, 1.0, 2.0, 5.0), ((LOW, LOW), (UP, LOW), (UP, UP))),
    ],
)
def test_a_piece_that_vanishes_leaves_its_middle(piece: int, times: tuple[float, ...], kinds: object) -> None:
    left = TWO.without(piece)
    assert (left.times, left.kinds) == (times, kinds)


def test_switches_that_cancel_vanish_with_the_piece_between_them() -> None:
    bump = PhaseStructure((0.0, 1.0, 1.1, 5.0), ((LOW,), (UP,), (LOW,)))
    assert (bump.without(1).times, bump.without(1).kinds) == ((0.0, 5.0), ((LOW,),))


def test_switches_of_two_controls_change_places_but_not_at_the_ends_nor_of_one_control() -> None:
    swapped = TWO.swapped(1)
    assert swapped is not None
    assert swapped.kinds == ((LOW, LOW), (LOW, UP), (UP, UP), (LOW, UP))
    assert swapped.times == TWO.times and swapped.swapped(1) == TWO
    other = TWO.swapped(2)
    assert other is not None and other.kinds == ((LOW, LOW), (UP, LOW), (LOW, LOW), (LOW, UP))
    assert TWO.swapped(0) is None and TWO.swapped(3) is None
    assert PhaseStructure((0.0, 1.0, 2.0, 3.0), ((LOW,), (UP,), (LOW,))).swapped(1) is None


@pytest.mark.parametrize(
    ("row", "start", "end", "kind", "times", "kinds"),
    [
        (1, 0.5, 0.8, UP, (0, 0.5, 0.8, 1, 2, 4, 5),
         ((LOW, LOW), (LOW, UP), (LOW, LOW), (UP, LOW), (UP, UP), (LOW, UP))),
        (0, 0.5, 1.0, UP, (0, 0.5, 2, 4, 5), ((LOW, LOW), (UP, LOW), (UP, UP), (LOW, UP))),
        (0, 4.0, 5.0, UP, (0, 1, 2, 5), ((LOW, LOW), (UP, LOW), (UP, UP))),
        (1, 1.5, 3.0, FREE, (0, 1, 1.5, 3, 4, 5), ((LOW, LOW), (UP, LOW), (UP, FREE), (UP, UP), (LOW, UP))),
    ],
)  # fmt: skip
def test_an_arc_is_added_and_equal_neighbours_are_joined(
    row: int, start: float, end: float, kind: ArcKind, times: tuple[float, ...], kinds: object
) -> None:
    added = TWO.with_arc(row, start, end, kind)
    assert (added.times, added.kinds) == (times, kinds)


def test_arcs_of_controls_paths_and_states() -> None:
    """Rows: one control, one path constraint, one state; the control is constrained where the state is held."""
    held = PhaseStructure(
        (0.0, 1.0, 2.0, 3.0),
        ((UP, FREE, FREE), (FREE, FREE, LOW), (FREE, FREE, FREE)),
        n_controls=1,
        n_paths=1,
    )
    assert [held.determined(k) for k in range(3)] == [set(), {0}, set()]
    assert held.controls.tolist() == [[UP, FREE, FREE]]
    assert held.paths.tolist() == [[FREE] * 3] and held.states.tolist() == [[FREE, LOW, FREE]]
    assert held.arcs("leg", ("u", "c", "x")) == (
        Arc("leg", "u", UP, 0.0, 1.0),
        Arc("leg", "u", ArcKind.CONSTRAINED, 1.0, 2.0),
        Arc("leg", "u", FREE, 2.0, 3.0),
        Arc("leg", "x", LOW, 1.0, 2.0),
    )


def test_a_state_constraint_determines_the_controls_that_can_hold_it() -> None:
    """Rows: two controls, a state that the second one holds, a state of which nothing is known."""
    kinds = (
        (ArcKind.SINGULAR, ArcKind.SINGULAR, LOW, FREE),
        (ArcKind.SINGULAR, ArcKind.SINGULAR, FREE, LOW),
        (UP, ArcKind.SINGULAR, UP, FREE),
    )
    holders = ((), (), (1,), ())
    two = PhaseStructure((0.0, 1.0, 2.0, 3.0), kinds, n_controls=2, holders=holders)
    assert [two.determined(k) for k in range(3)] == [{1}, {0, 1}, {1}]
    told = [(arc.channel, arc.kind, arc.start) for arc in two.arcs("leg", ("a", "b", "x", "y"))]
    assert told[:4] == [
        ("a", ArcKind.SINGULAR, 0.0), ("a", ArcKind.CONSTRAINED, 1.0), ("a", UP, 2.0), ("b", ArcKind.CONSTRAINED, 0.0),
    ]  # fmt: skip


# --- resolution -----------------------------------------------------------------------------------------------


def test_a_piece_gets_higher_degrees_then_twice_the_segments() -> None:
    r, seen = Resolution(), []
    while (finer := r.finer(np.full(r.segments, 0.5))) != r:
        r = finer
        seen.append((r.segments, r.degree))
    halved = [(n, ARC_MAX_DEGREE) for n in (2, 4, 8, 16, 32, MAX_SEGMENTS)]
    assert seen == [(1, 9), (1, ARC_MAX_DEGREE), *halved] and r.edges == ()


def test_only_the_piece_that_is_inaccurate_is_solved_more_finely() -> None:
    """z' = exp(30 (t - 2)) beside a bang-bang move over 2 s: it hardly changes before the switch at 1 s."""
    model = go.Model("double integrator")
    q, v, z = model.state("q"), model.state("v"), model.state("z")
    a = model.control("a")
    model.ode({q: v, v: a, z: ca.exp(30 * (model.time - 2))})
    problem = go.Problem("move and something steep")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.1, 10.0))
    leg.initial(q=1.0, v=0.0, z=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    first = go.solve(problem, mesh="10x4", tol=None)
    solution = go.refine(first, structure="bang-bang")
    assert solution.objective == pytest.approx(2.0, abs=1e-9)
    assert solution.state("z")(2.0 - 1e-9) == pytest.approx(1 / 30, rel=1e-6)
    assert solution.history is not None and len(solution.history.passes) == 1
    leg, scale = solution.phase(), first.samples()["leg"].state_scale[2]
    assert leg.mesh.degrees[0] == PIECE_MIN_POINTS
    n = leg.mesh.degrees[-1]
    assert set(leg.mesh.degrees[1:]) == {n}

    def left(start: float, end: float, points: int) -> float:
        """What points leave of the Legendre series of the exponential function (DLMF 10.60.8) along a segment."""
        terms = np.arange(points, points + 30)
        series = (2 * terms + 1) * spherical_in(terms, 15 * (end - start)) * np.exp(15 * (end + start - 4))
        return float(np.sum((end - start) * series) / scale)

    edges = leg.breaks[1:]
    segments = list(itertools.pairwise(edges))
    assert max(left(*ends, n) for ends in segments) <= 1e-10 < max(left(*ends, n - 1) for ends in segments)
    # Short at the steep end only: of two neighbours, whatever is one half of could not have been one.
    widths = np.diff(edges)
    assert widths[0] > 1.9 * widths[-1] and np.all(widths[:-1] > 0.99 * widths[1:])
    assert left(edges[-3], edges[-1], ARC_MAX_DEGREE) > 1e-10


# --- detection ------------------------------------------------------------------------------------------------


def test_switches_are_found_at_the_zeros_of_the_switching_function() -> None:
    """Not halfway between samples: the costates of a coarse mesh know the switch better than its controls."""
    model = go.Model("double integrator")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    problem = go.Problem("minimum time")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.1, 10.0))
    leg.initial(q=1.0, v=0.3)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    samples = go.solve(problem, mesh="5x4", tol=None).samples()["leg"]
    structure = detect(samples)
    assert [piece[0] for piece in structure.kinds] == [LOW, UP]
    assert abs(switching(samples, np.array([structure.times[1]]))[0, 0]) < 1e-12
    assert structure.times[0] == 0.0 and structure.times[2] == pytest.approx(samples.leg.final_time)


# --- units ----------------------------------------------------------------------------------------------------


def pursuit(x_unit: float, u_unit: float, t_unit: float, cost: float) -> go.Problem:
    """x' = u, |u| <= 2, min of half the integral of (x - sin t)^2, x(0) = 1, x(3) = 3/2, in other units."""
    model = go.Model("pursuit")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u / u_unit * x_unit / t_unit})
    problem = go.Problem("pursuit")
    leg = problem.phase("leg", model)
    leg.time(0.0, 3.0 * t_unit)
    leg.initial(x=1.0 * x_unit)
    leg.final(x=1.5 * x_unit)
    leg.bounds(u=tuple(sorted((-2.0 * u_unit, 2.0 * u_unit))))
    off = x / x_unit - ca.sin(model.time / t_unit)
    problem.minimize(0.5 * cost / t_unit * leg.integral(off**2))
    return problem


def regulator(x_unit: float, u_unit: float, t_unit: float, cost: float) -> go.Problem:
    """x' = u, |u| <= 1, half the integral of x^2 + u^2 over 4 s, x(0) = 3: a kink, in other units."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u / u_unit * x_unit / t_unit})
    problem = go.Problem("saturated regulator")
    leg = problem.phase("leg", model)
    leg.time(0.0, 4.0 * t_unit)
    leg.initial(x=3.0 * x_unit)
    leg.bounds(u=tuple(sorted((-1.0 * u_unit, 1.0 * u_unit))))
    problem.minimize(0.5 * cost / t_unit * leg.integral((x / x_unit) ** 2 + (u / u_unit) ** 2))
    return problem


@cache
def in_units(problem: Callable[..., go.Problem], units: tuple[float, ...]) -> go.Solution:
    return go.refine(go.solve(problem(*units), tol=None))


@pytest.mark.parametrize("problem", [pursuit, regulator])
@pytest.mark.parametrize("units", [(300.0, 1.0, 1.0, 1.0), (1.0, 0.01, 1.0, 1.0), (1.0, 1.0, 60.0, 1.0),
                                   (1.0, 1.0, 1.0, 1e3), (0.1, -20.0, 0.05, 0.02)])  # fmt: skip
def test_the_structure_does_not_depend_on_units(
    problem: Callable[..., go.Problem], units: tuple[float, ...]
) -> None:
    """Same arcs, same passes, same mesh; the arcs of a control in a negative unit are upside down."""
    usual, other = in_units(problem, (1.0,) * 4), in_units(problem, units)
    upside_down = {LOW: UP, UP: LOW} if units[1] < 0 else {}
    for a, b in zip(usual.structure, other.structure, strict=True):
        assert b.kind is upside_down.get(a.kind, a.kind)
        assert (b.start, b.end) == pytest.approx((a.start * units[2], a.end * units[2]), rel=1e-7, abs=1e-7)
    assert usual.history is not None and other.history is not None
    assert len(usual.history.passes) == len(other.history.passes)
    assert usual.phase().mesh.degrees == other.phase().mesh.degrees


# --- a mixed constraint whose slope vanishes at rest ------------------------------------------------------------


def power_limited(unit: float) -> go.Problem:
    """Rest to rest over 1 m in 1 s with the least energy and a power a v of at most 3 W/kg, in another unit."""
    model = go.Model("double integrator")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    problem = go.Problem("power limit")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.guess(q=(0.0, 1.0), v=lambda t: 6 * t * (1 - t), a=lambda t: 6 - 12 * t)
    leg.path("power", unit * a * v, upper=3.0 * unit)
    problem.minimize(0.5 * leg.integral(a**2))
    return problem


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e3])
def test_power_limit_is_found_though_at_rest_it_does_not_depend_on_the_control(unit: float) -> None:
    """Free, at the limit (v^2 / 2 grows by 3 t), free again with a linear control: lam_q is constant."""
    first = go.solve(power_limited(unit), mesh="12x4", tol=None)
    rows = [piece[0] for piece in zip(*detect(first.samples()["leg"]).paths.tolist(), strict=True)]
    assert rows == [FREE, UP, FREE]
    solution = go.refine(first)
    assert solution.history is not None and solution.history.converged
    (active,) = [arc for arc in solution.structure if arc.channel == "power"]
    assert active.kind is UP and 0.05 < active.start < active.end < 0.6
    v = solution.state("v")
    for t in np.linspace(active.start, active.end, 7):
        assert v(t) ** 2 - v(active.start) ** 2 == pytest.approx(6.0 * (t - active.start), abs=1e-8)
    a, lam = solution.control("a"), solution.costate("q")
    for left, right in ((0.0, active.start), (active.end, 1.0)):
        middle = 0.5 * (left + right)
        assert a(middle) - 0.5 * (a(left) + a(right, "left")) == pytest.approx(0.0, abs=1e-6)
        assert (a(right, "left") - a(left)) / (right - left) == pytest.approx(lam(middle), rel=1e-6)
    verdict = go.verify(solution, tol=1e-7)
    assert verdict.ok, verdict.explain()


# --- detection of singular arcs on coarse meshes ------------------------------------------------------------------

MESHES = ["8x4", "10x3", "15x4", "20x3", "30x4", "40x3"]


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize("units", [(1.0, 1.0, 1.0, 1.0), (1.0, 0.01, 1.0, 1.0), (40.0, -30.0, 10.0, 1e3)])
def test_a_singular_arc_is_found_to_a_segment_on_any_mesh(mesh: str, units: tuple[float, ...]) -> None:
    """Controls chatter beside its ends; the short bangs are not taken for arcs. The ends are 0.338 s and 2.531 s."""
    solution = go.solve(pursuit(*units), mesh=mesh, tol=None)
    structure = detect(solution.samples()["leg"])
    bangs = [LOW, UP] if units[1] > 0 else [UP, LOW]
    assert [piece[0] for piece in structure.kinds] == [bangs[0], ArcKind.SINGULAR, bangs[1]]
    segment = 3.0 * units[2] / solution.phase().mesh.segments
    assert np.abs(np.array(structure.times[1:3]) - np.array([0.338, 2.531]) * units[2]).max() < segment


@pytest.mark.parametrize("mesh", MESHES)
def test_two_bangs_before_a_singular_arc_are_found_on_any_mesh(mesh: str) -> None:
    solution = go.solve(van_der_pol.build(), mesh=mesh, tol=None)
    (samples,) = solution.samples().values()
    structure = detect(samples)
    assert [piece[0] for piece in structure.kinds] == [LOW, UP, ArcKind.SINGULAR]
    segment = 4.0 / samples.leg.mesh.segments
    assert np.abs(np.array(structure.times[1:3]) - van_der_pol.SWITCH_TIMES).max() < segment
