"""The structure loop by hand: plans, kinks, arcs that vanish or are missing, and how it ends."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import cart, interval, phase, samples, solution
from testing.internals import (
    ARC_MAX_DEGREE,
    COARSE,
    FIRST_DEGREE,
    MAX_SEGMENTS,
    PassLimits,
    PhaseSamples,
    PhaseStructure,
    Plan,
    RefinementIteration,
    Resolution,
    Smooth,
    StateConstraints,
)

import gnc_opt as go
from gnc_opt.planning import Arc, ArcKind, RefinementStatus, SolverOptions, Status
from gnc_opt.planning.refinement.arcs import arc_refinement as f
from gnc_opt.planning.refinement.arcs import junctions as j
from gnc_opt.planning.refinement.arcs import loop as s
from gnc_opt.planning.refinement.arcs import update as m
from gnc_opt.planning.refinement.arcs.arc_mesh import (
    DEGREE_GAIN_RATIO,
    INTERIOR_DEGREE,
    MAX_SINGULAR_DEGREE,
    SINGULAR_DEGREE,
    THINNED,
)

LOW, FREE, UP, SING = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.SINGULAR
RELEASED = ArcKind.RELEASED
CART = cart()


# --- resolutions ------------------------------------------------------------------------------------------


def test_a_singular_control_gets_four_degrees_more_and_points_for_them() -> None:
    first = Resolution(2, 6, SINGULAR_DEGREE)
    second = first.smoother(1.0)
    assert second == Resolution(2, 9, SINGULAR_DEGREE + 4, 1.0)
    third = second.smoother(DEGREE_GAIN_RATIO)
    assert third == Resolution(2, ARC_MAX_DEGREE, SINGULAR_DEGREE + 8, DEGREE_GAIN_RATIO)
    assert third.smoother(0.0) == Resolution(3, ARC_MAX_DEGREE, SINGULAR_DEGREE + 12, 0.0)
    assert second.smoother(DEGREE_GAIN_RATIO * 1.001) == second
    assert Resolution(9, 6, SINGULAR_DEGREE).smoother(1.0).segments == 9
    assert Resolution(2, 6, 0).smoother(1.0) == Resolution(2, 6, 0)
    assert Resolution(9, 6, MAX_SINGULAR_DEGREE - 1).smoother(0.1).smooth == MAX_SINGULAR_DEGREE


def test_finer_pieces_get_points_first_as_many_as_there_are_decades_to_gain() -> None:
    assert Resolution() == Resolution(1, FIRST_DEGREE, 0, np.inf, ())
    assert Resolution(1, 6).finer(np.array([0.1])) == Resolution(1, 9)
    assert Resolution(2, 6).finer(np.array([-1.0, 3.5])) == Resolution(2, 10)
    assert Resolution(1, 11).finer(np.array([8.0])) == Resolution(1, ARC_MAX_DEGREE)
    assert Resolution(3, 7).finer(np.array([0.0, -1.0, -9.0])) == Resolution(3, 7)


def test_finer_pieces_are_halved_where_they_are_inaccurate() -> None:
    full = Resolution(2, ARC_MAX_DEGREE)
    assert full.finer(np.array([0.1, 3.0])) == Resolution(4, ARC_MAX_DEGREE)
    uneven = full.finer(np.array([0.0, 0.1]))
    assert uneven == Resolution(3, ARC_MAX_DEGREE, edges=(0.5, 0.75))
    assert uneven.shares.tolist() == [0.0, 0.5, 0.75, 1.0] and full.shares.tolist() == [0.0, 0.5, 1.0]
    again = uneven.finer(np.array([-1.0, -1.0, 3.1]))  # more than one halving gains: four parts
    assert again.edges == (0.5, 0.75, 0.8125, 0.875, 0.9375) and again.segments == 6
    assert uneven.finer(np.full(3, 1.0)).edges == (0.25, 0.5, 0.625, 0.75, 0.875)
    assert full.finer(np.full(2, 99.0)).segments == 8
    # The worst first, where not all that is asked for is allowed.
    nearly = Resolution(MAX_SEGMENTS - 1, ARC_MAX_DEGREE)
    worst = nearly.finer(np.linspace(0.1, 0.2, MAX_SEGMENTS - 1))
    assert worst.segments == MAX_SEGMENTS
    assert np.diff(worst.shares)[-2:] == pytest.approx(0.5 / (MAX_SEGMENTS - 1), rel=1e-12)
    assert worst.finer(np.full(MAX_SEGMENTS, 1.0)) == worst


def test_pieces_with_polynomials_of_a_singular_control_get_finer_step_by_step() -> None:
    first = Resolution(2, 6, SINGULAR_DEGREE)
    assert first.finer(np.array([9.0, -1.0])) == Resolution(2, 9, SINGULAR_DEGREE)
    assert replace(first, degree=12).finer(np.array([9.0, -1.0])) == Resolution(4, 12, SINGULAR_DEGREE)
    finest = Resolution(MAX_SEGMENTS, 12, 4)
    assert finest.finer(np.full(MAX_SEGMENTS, 1.0)) == finest


# --- plans ------------------------------------------------------------------------------------------------

THREE = PhaseStructure((1.0, 2.0, 4.0, 5.0), ((LOW,), (SING,), (UP,)))


def test_each_kind_of_piece_begins_with_its_resolution() -> None:
    assert Plan.of(THREE).resolutions == (
        Resolution(),
        Resolution(2, FIRST_DEGREE, SINGULAR_DEGREE),
        Resolution(),
    )
    assert Plan.of(THREE).points == 0.0
    interior = PhaseStructure((0.0, 1.0, 4.0), ((LOW,), (FREE,)))
    assert Plan.of(interior).resolutions == (Resolution(), Resolution(6, INTERIOR_DEGREE))
    held = PhaseStructure((0.0, 1.0, 2.0), ((SING, FREE), (SING, UP)), n_controls=1)
    assert Plan.of(held).resolutions == (Resolution(2, FIRST_DEGREE, SINGULAR_DEGREE), Resolution())


def test_uneven_segments_lie_where_their_piece_says() -> None:
    plan = Plan(THREE, (Resolution(), Resolution(3, edges=(0.5, 0.75)), Resolution()))
    assert np.asarray(plan.mesh().breaks) * 4 + 1 == pytest.approx([1, 2, 3, 3.5, 4, 5])
    assert plan.mesh().movable == (1, 4)


@pytest.mark.parametrize(
    ("points", "segments"),
    [
        (COARSE, 1),
        (COARSE + 1.0, 6),
        (2 * THINNED * ARC_MAX_DEGREE, 1),
        (20 * THINNED * ARC_MAX_DEGREE, 20),
        (1e6, MAX_SEGMENTS),
    ],
)
def test_bangs_of_a_fine_mesh_begin_finely(points: float, segments: int) -> None:
    (r,) = Plan.of(PhaseStructure((0.0, 1.0), ((UP,),)), points).resolutions
    assert r == (Resolution() if segments == 1 else Resolution(segments, ARC_MAX_DEGREE))


def test_places_of_pieces_on_their_mesh() -> None:
    plan = Plan(THREE, (Resolution(1, 6), Resolution(3, 9), Resolution(2, 7)))
    assert plan.segment_pieces.tolist() == [0, 1, 1, 1, 2, 2] and plan.piece_ends == (0, 1, 4, 6)
    mesh = plan.mesh()
    assert np.asarray(mesh.breaks) * 4 + 1 == pytest.approx([1, 2, 2 + 2 / 3, 2 + 4 / 3, 4, 4.5, 5])
    assert mesh.degrees == (6, 9, 9, 9, 7, 7) and mesh.movable == (1, 4)
    kinked = PhaseStructure((0.0, 1.0, 2.0, 3.0), ((LOW,), (FREE,), (UP,)), regular=(True,))
    assert Plan.of(kinked).mesh().movable == ()
    assert plan.points == 0.0


def held_by(plan: Plan) -> Any:
    asked: dict[str, Any] = {}
    leg = SimpleNamespace(numbers=SimpleNamespace(initial=SimpleNamespace(fixed=np.ones(1, dtype=bool))))
    problem = SimpleNamespace(
        phases={"leg": leg}, with_fixed_arcs=lambda name, **more: asked.update(more, name=name) or problem
    )
    assert plan.hold(problem, "leg") is problem  # type: ignore[arg-type]
    return asked


def test_controls_paths_and_states_are_held_segment_by_segment() -> None:
    structure = PhaseStructure(
        (0.0, 1.0, 2.0, 3.0),
        ((LOW, FREE, FREE, FREE), (FREE, SING, UP, FREE), (FREE, UP, FREE, LOW)),
        regular=(True, False, True, False), n_controls=2, n_paths=1,
    )  # fmt: skip
    asked = held_by(Plan(structure, (Resolution(1), Resolution(2, 6, 4), Resolution(1))))
    assert asked["name"] == "leg"
    assert asked["arcs"].tolist() == [[LOW, RELEASED, RELEASED, RELEASED], [FREE, FREE, FREE, UP]]
    assert asked["paths"].tolist() == [[RELEASED, UP, UP, RELEASED]]
    assert asked["states"].tolist() == [[FREE, FREE, FREE, LOW]]
    assert asked["smooth"] == (Smooth(1, 1, 3, 4),)
    bang = held_by(Plan.of(PhaseStructure((0.0, 1.0, 2.0), ((LOW, FREE), (UP, FREE)), n_controls=1)))
    assert bang["paths"] is None and bang["states"] is None and bang["smooth"] == ()
    assert bang["arcs"].tolist() == [[LOW, UP]]


@pytest.mark.parametrize(("smooth", "found"), [(10, True), (11, False), (0, False)])
def test_a_polynomial_that_has_as_many_degrees_as_points_is_none(smooth: int, found: bool) -> None:
    plan = Plan(PhaseStructure((0.0, 1.0), ((SING,),)), (Resolution(2, 6, smooth),))
    assert held_by(plan)["smooth"] == ((Smooth(0, 0, 2, smooth),) if found else ())


# --- kinks ------------------------------------------------------------------------------------------------


def test_an_violation_reaches_to_its_first_zero() -> None:
    times = np.array([0.0, 1.0, 2.0, 3.0])
    assert j._reach(times, lambda t: 1.25 - t) == pytest.approx(1.25)
    assert j._reach(times, lambda t: (t - 0.5) * (t - 1.5)) == pytest.approx(0.5)
    assert j._reach(times, lambda t: 9.0 - t) == 3.0
    assert j._reach(times, lambda t: t) is None and j._reach(times, lambda t: 0 * t - 1.0) is None
    assert j._reach(times[::-1], lambda t: t - 1.75) == pytest.approx(1.75)


def test_what_a_control_and_a_path_constraint_say_at_a_time() -> None:
    found = samples(
        CART, u=lambda t, k: [6 - 12 * t + k], lam=lambda t, k: [0 * t, 3 * t], paths=lambda t, k: [2 + t, 5 * t],
        control_bounds=interval(-4.0, 5.0), path_bounds=interval([-3.0, -50.0], [7.0, 0.25]),
    )  # fmt: skip
    u = 6 - 12 * 0.25
    slope = u + 3 * 0.25 + 2.25
    assert j._control_signals(found, 0, 1, "right", 0.25) == pytest.approx((u - 5, slope))
    assert j._control_signals(found, 0, -1, "right", 0.25) == pytest.approx((u + 4, slope))
    assert j._control_signals(found, 0, 1, "left", 0.5)[0] == pytest.approx(-5.0)
    assert j._control_signals(found, 0, 1, "right", 0.5)[0] == pytest.approx(-4.0)
    v, q = 6 * 0.25 - 6 * 0.0625, 3 * 0.0625 - 2 / 64
    assert j._path_signals(found, 0, 1, "right", 0.25) == pytest.approx((v + u - 7, -2.25))
    assert j._path_signals(found, 0, -1, "right", 0.25) == pytest.approx((v + u + 3, -2.25))
    assert j._path_signals(found, 1, 1, "right", 0.25) == pytest.approx((q - 0.25, -1.25))


def kinked(where: float, pieces: tuple[ArcKind, ArcKind], bounds: Any, costate: float = 0.0) -> float | None:
    """Where the kink of a = 6 - 12 t (within its own bounds it stays free) wants to go from the boundary at 1/2 s."""
    structure = PhaseStructure((0.0, where, 1.0), tuple((kind, FREE, FREE, FREE, FREE) for kind in pieces),
                               regular=(True, False, False, False, False), n_controls=1, n_paths=2)  # fmt: skip
    found = samples(
        CART,
        breaks=(0.0, where, 1.0),
        control_bounds=interval(*bounds),
        lam=lambda t, k: [0 * t, costate - 6 + 12 * t],
    )
    moved = j.move_kinks(StateConstraints(CART, found), Plan(structure, (Resolution(), Resolution())))
    return None if moved is None else moved.times[1]


@pytest.mark.parametrize(
    ("pieces", "bounds", "costate", "time"),
    [
        ((FREE, LOW), (-2.4, 9.0), 0.3, None),  # within its bounds until 1/2 s, then pulled to the lower one
        ((FREE, LOW), (1.2, 9.0), 0.0, 0.4),  # left its bound at 0.4 s already
        ((UP, FREE), (-9.0, -1.2), 0.0, 0.6),  # above its bound until 0.6 s
        ((UP, FREE), (-9.0, 5.0), 3.0, 0.0),  # dH/du = 3 all along the held arc: it should not be there
        ((FREE, UP), (-9.0, 5.0), -3.0, None),  # dH/du < 0 is what holds it at the upper bound
        ((FREE, LOW), (-9.0, 9.0), -3.0, 1.0),
    ],
)
def test_a_kink_moves_to_where_its_arc_may_begin(
    pieces: Any, bounds: Any, costate: float, time: float | None
) -> None:
    """An interior arc beyond its bound is cut there; a held one with the wrong pull is given up as far as it lasts."""
    found = kinked(0.5, pieces, bounds, costate)
    assert (found is None) if time is None else found == pytest.approx(time, abs=1e-9)


def test_switches_are_no_kinks_and_the_farthest_wish_of_all_rows_counts() -> None:
    structure = PhaseStructure((0.0, 0.5, 1.0), ((UP, FREE), (FREE, LOW)), regular=(True, False))
    plan = Plan(structure, (Resolution(), Resolution()))
    constraints = StateConstraints(CART, samples(CART, control_bounds=interval(-9.0, -1.2)))
    assert j.move_kinks(constraints, plan) is None
    both = PhaseStructure(
        (0.0, 0.5, 1.0),
        ((UP, FREE, FREE), (FREE, UP, FREE)),
        regular=(True, True, False),
        n_controls=1,
        n_paths=2,
    )
    found = samples(
        CART, control_bounds=interval(-9.0, -1.2), path_bounds=interval([-50.0, -50.0], [-0.5, 50.0]),
        paths=lambda t, k: [1 + 0 * t, 0 * t],
    )  # fmt: skip
    moved = j.move_kinks(StateConstraints(CART, found), Plan(both, (Resolution(), Resolution())))
    assert moved is not None and moved.kinds == both.kinds
    # the control wants 0.6 s; the constraint -0.5 >= 6 - 6 t - 6 t^2 is beyond its limit on all of the free arc: 0 s
    assert moved.times == pytest.approx((0.0, 0.0, 1.0))


# --- arcs that vanish -------------------------------------------------------------------------------------

LEG: Any = SimpleNamespace(leg=SimpleNamespace(name="leg"))


def test_a_piece_without_length_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(m, "_propped", lambda *_: False)
    vanished = PhaseStructure((0.0, 1.0, 1.0 + 1e-7, 2.0), ((LOW,), (UP,), (LOW,)))
    found, action = m.collapsed(LEG, Plan.of(vanished), set())
    assert found is not None and found.kinds == ((LOW,),) and action == "piece 2 dropped"
    for structure in (
        replace(vanished, times=(0.0, 1.0, 1.0 + 1e-5, 2.0)),
        PhaseStructure((0.0, 1e-9), ((LOW,),)),
    ):
        assert m.collapsed(LEG, Plan.of(structure), set()) == (None, "")
    for share, dropped in ((0.99, True), (1.01, False)):
        late = replace(vanished, times=(50.0, 51.0, 51.0 + share * 2 * m.GONE, 52.0))
        assert (m.collapsed(LEG, Plan.of(late), set())[0] is not None) is dropped


@pytest.mark.parametrize(
    ("share", "wrong", "dropped"), [(0.9, 2.0, True), (0.9, 0.5, False), (1.1, 2.0, False)]
)
def test_a_short_piece_is_swapped_if_its_own_signs_are_wrong(
    monkeypatch: pytest.MonkeyPatch, share: float, wrong: float, dropped: bool
) -> None:
    """Signs that are wrong in other pieces say nothing about it, nor do they beside a singular arc."""
    times = (0.0, 1.0, 1.0 + share * 2 * m.PROPPED, 2.0)
    short = PhaseStructure(times, ((LOW, LOW), (UP, LOW), (UP, UP)))
    there: Any = SimpleNamespace(leg=LEG.leg, segments=np.array([0, 0, 1, 1, 2, 2]))
    violation = np.array([[1.0, 0.0, 0.0, wrong * m.SIGN_ERROR_MIN_SHARE_OF_HAMILTONIAN, 0.0, 1.0]])
    monkeypatch.setattr(m, "_structure_violations", lambda *_: (violation, None))
    assert (m.collapsed(there, Plan.of(short), set())[0] is not None) is dropped
    for kinds in (((LOW, LOW), (UP, LOW), (UP, SING)), ((LOW, LOW), (UP, LOW), (LOW, LOW))):
        assert m.collapsed(there, Plan.of(PhaseStructure(times, kinds)), set()) == (None, "")


@pytest.mark.parametrize(("share", "dropped"), [(0.9, True), (1.1, False)])
def test_a_kink_that_leaves_hardly_any_piece_drops_it(
    monkeypatch: pytest.MonkeyPatch, share: float, dropped: bool
) -> None:
    """By the length of the phase, wherever it begins."""
    structure = PhaseStructure((80.0, 81.0, 82.0, 84.0), ((LOW,), (FREE,), (UP,)), (True,))
    moved = structure.at((80.0, 82.0 - share * 4 * m.GONE, 82.0, 84.0))
    monkeypatch.setattr(m, "move_kinks", lambda *_: moved)
    monkeypatch.setattr(m, "finer", lambda *_: None)
    found, what = m._adjust(SimpleNamespace(samples=LEG), Plan.of(structure, 7.0), 1e-9)  # type: ignore[arg-type]
    assert what == ("piece 2 dropped" if dropped else "kinks moved")
    assert found.structure.pieces == (2 if dropped else 3) and found.points == 7.0


def test_switches_of_two_controls_are_swapped_once() -> None:
    crossed = PhaseStructure((0.0, 1.0, 1.0, 3.0), ((LOW, LOW), (UP, LOW), (UP, UP)))
    seen: set[Any] = set()
    found, action = m.collapsed(LEG, Plan.of(crossed), seen)
    assert found is not None and found.kinds[1] == (LOW, UP) and action == "switches 1 and 2 swapped"
    assert found.times == pytest.approx((0.0, 1 - 0.0015, 1 + 0.0015, 3.0))
    again, action = m.collapsed(LEG, Plan.of(replace(found, times=(0.0, 1.0, 1.0, 3.0))), seen)
    assert again is not None and again.kinds == ((LOW, LOW), (UP, UP)) and action == "piece 2 dropped"
    other = SimpleNamespace(leg=SimpleNamespace(name="other"))
    assert m.collapsed(other, Plan.of(crossed), seen)[1].endswith("swapped")  # type: ignore[arg-type]


@pytest.mark.parametrize("start", [0.0, -7.0, 30.0])
def test_a_swapped_piece_gets_room_but_never_more_than_half_of_its_neighbours(start: float) -> None:
    def spread(times: tuple[float, ...], piece: int) -> Any:
        kinds = ((LOW, LOW), (LOW, UP), (UP, UP), (LOW, UP))
        found = m._spread(PhaseStructure(tuple(start + t for t in times), kinds), piece)
        return np.asarray(found.times) - start

    assert spread((0.0, 1.0, 1.0, 1.0004, 4.0), 1) == pytest.approx((0.0, 1 - 0.002, 1.0002, 1.0004, 4.0))
    assert spread((0.0, 0.9996, 1.0, 1.0, 4.0), 2) == pytest.approx((0.0, 0.9996, 0.9998, 1.002, 4.0))
    assert spread((0.0, 1.0, 1.001, 3.0, 4.0), 1) == pytest.approx((0.0, 0.9985, 1.0025, 3.0, 4.0))


# --- arcs that are missing --------------------------------------------------------------------------------


def test_violations_beside_own_switches_are_forgiven() -> None:
    kinds = np.array([LOW, LOW, LOW, UP, UP, UP, UP], dtype=object)
    for before, after in (
        ([1, 2, 3, 4, 5, 0, 7], [0, 0, 0, 0, 0, 0, 7]), ([1, 0, 3, 4, -1, 6, 7], [1, 0, 0, 0, -1, 6, 7]),
        ([1, 2, -3, -4, 5, 6, 7], [1, 2, -3, -4, 5, 6, 7]), ([1, 2, 3, -4, 5, 6, 7], [0, 0, 0, -4, 5, 6, 7]),
    ):  # fmt: skip
        violation = np.array(before, dtype=float) * 1e-6
        m._forgive_own_switches(violation, kinds)
        np.testing.assert_allclose(violation, np.array(after) * 1e-6, rtol=1e-14)
    for before, after in (
        ([0, 1e-6, 2e-5, 2e-5, 1e-7, 0, 1], [0, 1e-6, 2e-5, 2e-5, 1e-7, 0, 1]),  # the wrong slope
        ([0, 1, 2, 9e-6, 1e-7, 0, 0], [0] * 7), ([0, 1e-7, 9e-6, 1, 2, 0, 0], [0] * 7),  # moved
    ):  # fmt: skip
        wrong = np.array(before)
        m._forgive_own_switches(wrong, kinds)
        assert wrong.tolist() == after
    alone = np.ones(3)
    m._forgive_own_switches(alone, np.array([LOW] * 3, dtype=object))
    assert alone.tolist() == [1, 1, 1]


def test_a_wrong_interval_lies_between_zeros_around_the_worst_place() -> None:
    there: Any = SimpleNamespace(times=np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0]))
    for violation, interval_ in (
        ([-1, 1, 3, 1, -1, 9e-1], (0.5, 3.5)), ([1, 2, 1, -1, -1, -1], (0.0, 2.5)),
        ([-3, -1, -1, 3, 4, 5], (2.25, 5.0)),
        ([1, 2, 3, 4, 5, 6], (0.0, 5.0)), ([5, -1, 1, 0, 7, -7], (3.0, 4.5)),
    ):  # fmt: skip
        assert m._wrong_interval(there, np.array(violation, dtype=float)) == pytest.approx(interval_)
    assert m._zero(np.array([1.0, 3.0]), np.array([-1.0, 3.0]), 0, 1) == 1.5


def line(lam: Any, u: Any, **changes: Any) -> PhaseSamples:
    """x' = u with |u| <= 1 and H = lam u over 4 s; dH/du over its range of 2 in shares of |lam| at most."""
    model = go.Model("integrator")
    x, control = model.state("x"), model.control("u")
    model.ode({x: control})
    problem = go.Problem("integrator")
    leg = problem.phase("leg", model)
    leg.time(0.0, 4.0)
    problem.minimize(leg.integral(x))
    return samples(
        problem, lambda t, k: [0 * t], u, lam, weights=(0.0,), breaks=np.arange(5.0), degree=3,
        control_bounds=interval(-1.0, 1.0), **changes,
    )  # fmt: skip


def rows(found: PhaseSamples, kinds: list[ArcKind]) -> Any:
    return np.array(kinds, dtype=object)[found.segments][None, :]


def test_a_bang_of_the_wrong_sign_offends_by_its_gain_and_asks_for_the_other_bound() -> None:
    found = line(lambda t, k: [t - 1.5], lambda t, k: [1.0 + 0 * t])
    structure = PhaseStructure((0.0, 4.0), ((UP, FREE),), n_controls=1)
    violation, asked = m._structure_violations(found, structure, rows(found, [UP] * 4))
    gain = 2 * (found.times - 1.5) / found.hamiltonian_scale
    assert violation == pytest.approx(gain[None, :]) and set(asked.ravel()) == {LOW}
    violation, asked = m._structure_violations(found, structure, rows(found, [LOW] * 4))
    assert violation == pytest.approx(-gain[None, :]) and set(asked.ravel()) == {UP}
    violation, _ = m._structure_violations(found, structure, rows(found, [SING] * 4))
    assert not violation.any()
    violation, _ = m._structure_violations(found, structure, rows(found, [FREE] * 4))
    assert not violation.any()


def test_a_convex_control_offends_at_its_bound_or_beyond_it() -> None:
    """At its bound by its pull, asking to be free; free by how far it is out, in shares of its range, asking for it."""
    found = samples(
        CART, u=lambda t, k: [6 - 12 * t], lam=lambda t, k: [0 * t, 1 + 0 * t], control_bounds=interval(-4.0, 5.0),
        path_bounds=interval([-np.inf] * 2, [np.inf] * 2),
    )  # fmt: skip
    kinds = (FREE, FREE, FREE, FREE, FREE)
    structure = PhaseStructure((0.0, 1.0), (kinds,), (True, False, False, False, False), 1, 2)
    every = np.array([[FREE] * found.times.size] * 5, dtype=object)
    violation, asked = m._structure_violations(found, structure, every)
    u = found.u_polynomial[0]
    assert violation[0] == pytest.approx(np.maximum(u - 5, -4 - u) / 9) and not violation[1:].any()
    assert violation.shape[0] == 3
    out = violation[0] > 0
    assert np.all(asked[0][out & (u > 0)] == UP) and np.all(asked[0][out & (u < 0)] == LOW)
    every[0] = UP
    violation, asked = m._structure_violations(found, structure, every)
    pull = found.control_gradient[0] * 9 / found.hamiltonian_scale
    assert violation[0] == pytest.approx(pull) and set(asked[0]) == {FREE}
    other = replace(structure, regular=(False,) * 5)
    assert not m._structure_violations(found, other, every)[0].any()


def test_a_mixed_constraint_offends_by_its_multiplier_or_its_value() -> None:
    """At its upper limit by a negative multiplier, times its size; free by how far it is beyond, in shares of that."""
    found = samples(
        CART, paths=lambda t, k: [t - 0.4, 0 * t], path_bounds=interval([-3.0, -50.0], [5.0, 50.0])
    )
    structure = PhaseStructure(
        (0.0, 1.0), ((FREE, UP, FREE, FREE, FREE),), (False, True, False, False, False), 1, 2
    )
    every = np.array([[FREE] * found.times.size] * 5, dtype=object)
    values = found.functions.paths(found.times, found.x, found.u_polynomial)[0]
    size = np.max(np.abs(values))
    violation, asked = m._structure_violations(found, structure, every)
    assert violation[1] == pytest.approx(np.maximum(values - 5, -3 - values) / size)
    assert np.all(asked[1][values > 5] == UP) and np.all(asked[1][values < -3] == LOW)
    every[1] = UP
    violation, asked = m._structure_violations(found, structure, every)
    assert violation[1] == pytest.approx(-(found.times - 0.4) * size / found.hamiltonian_scale)
    assert set(asked[1]) == {FREE}
    every[1] = LOW
    assert m._structure_violations(found, structure, every)[0][1] == pytest.approx(
        (found.times - 0.4) * size / found.hamiltonian_scale
    )


@pytest.mark.parametrize(
    ("switches", "at", "answer"),
    [
        ((1.0, 1.7, 1.8, 1.9, 2.0, 2.1, 3.0), 2.05, (0, 1.7, 2.1)), ((1.0, 1.7, 1.8, 1.9, 2.1, 3.0), 2.05, None),
        ((1.0, 1.7, 1.8, 1.9, 2.0, 2.1, 3.0), 0.5, None),
        ((1.0, 1.6, 1.75, 1.85, 1.95, 2.1, 3.0), 2.05, (0, 1.75, 2.1)), ((1.0, 1.6, 1.65, 1.85, 1.95, 2.1), 2.05, None),
    ],
)  # fmt: skip
def test_many_switches_of_a_small_switching_function_are_a_singular_arc(
    monkeypatch: pytest.MonkeyPatch, switches: tuple[float, ...], at: float, answer: Any
) -> None:
    """Of (t - 2)^3 / 4, below `SMALL` from t = 1.57 to 2.43, where a violation adds a bang, and below `ALIKE`
    times this from 1.71 to 2.29.

    Where such arcs are of second order, bangs remain bangs.
    """
    found = line(lambda t, k: [((t - 2) / 2) ** 3], lambda t, k: [0 * t])
    kinds = tuple(((LOW, UP)[k % 2], FREE) for k in range(len(switches) + 1))
    structure = PhaseStructure((0.0, *switches, 4.0), kinds, n_controls=1)
    violation = np.zeros((1, found.times.size))
    violation[0, np.argmin(np.abs(found.times - at))] = 2e-4
    problem: Any = None
    monkeypatch.setattr(m, "chatters", lambda *_: False)
    assert m._chatter(found, structure, violation, problem) == answer
    assert (
        m._chatter(found, structure, m.SIGN_ERROR_MIN_SHARE_OF_HAMILTONIAN / 4e-4 * violation, problem)
        is None
    )
    monkeypatch.setattr(m, "chatters", lambda *_: True)
    assert m._chatter(found, structure, violation, problem) is None


def test_a_missing_arc_is_added_where_the_sign_is_wrong() -> None:
    problem: Any = None
    found = line(lambda t, k: [(t - 1.3) * (t - 2.6)], lambda t, k: [-1.0 + 0 * t])
    plan = Plan(PhaseStructure((0.0, 4.0), ((LOW, FREE),), n_controls=1), (Resolution(4, 3),))
    structure, action = m._complete(found, plan, problem)
    assert structure is not None and [kinds[0] for kinds in structure.kinds] == [LOW, UP, LOW]
    assert structure.times == pytest.approx((0.0, 1.3, 2.6, 4.0), abs=0.02)
    assert action == f"arc of u added at {structure.times[1]:.4g} s"
    agreed = Plan(
        PhaseStructure((0.0, 1.0, 4.0), ((LOW, FREE), (UP, FREE)), n_controls=1),
        (Resolution(1, 3), Resolution(3, 3)),
    )
    assert m._complete(line(lambda t, k: [1 - t], lambda t, k: [0 * t]), agreed, problem) == (None, "")
    nearly = Plan(
        PhaseStructure((0.0, 1.0, 4.0), ((LOW, FREE), (UP, FREE)), n_controls=1),
        (Resolution(1, 3), Resolution(3, 3)),
    )
    assert m._complete(line(lambda t, k: [0.9 - t], lambda t, k: [0 * t]), nearly, problem) == (
        None,
        "",
    )  # up to its own switch


def test_a_singular_control_that_reaches_a_bound_asks_for_a_bang_if_no_higher_degree_helps() -> None:
    """lam < 0 between 1.3 and 2.6 s, where the polynomial of u comes up to its bound and H wants it there."""
    found = line(lambda t, k: [(t - 1.3) * (t - 2.6)], lambda t, k: [1 - 0.3 * (t - 1.95) ** 2])
    structure = PhaseStructure((0.0, 4.0), ((SING, FREE),), n_controls=1)
    stuck = Plan(structure, (Resolution(4, 3, MAX_SINGULAR_DEGREE, 1e-12),))
    added, action = m._saturated(found, stuck, set())
    assert added is not None and [kinds[0] for kinds in added.kinds] == [SING, UP, SING]
    assert added.times == pytest.approx((0.0, 1.3, 2.6, 4.0), abs=0.12)  # to the next sample
    assert action == f"arc of u added at {added.times[1]:.4g} s"
    young = Plan(structure, (Resolution(4, 3, SINGULAR_DEGREE),))
    assert m._saturated(found, young, set()) == (None, "")
    assert m._saturated(found, stuck, {(found.leg.name, added.at(()))}) == (None, "")  # it has been left
    inside = line(lambda t, k: [(t - 1.3) * (t - 2.6)], lambda t, k: [0.9 - 0.3 * (t - 1.95) ** 2])
    assert m._saturated(inside, stuck, set()) == (None, "")


@pytest.mark.parametrize(("width", "asked"), [(0.5, [UP, SING]), (1.2, None)])
def test_a_singular_control_asks_for_a_bang_at_an_end_where_its_polynomial_cannot_follow(
    width: float, asked: Any
) -> None:
    """lam < 0 up to a time at which degree 4 may still turn (3 / 16 of 4 s), or not any more; u stays inside."""
    found = line(lambda t, k: [1e-3 * np.minimum(t - width, 0.0)], lambda t, k: [0.1 + 0 * t])
    structure = PhaseStructure((0.0, 4.0), ((SING, FREE),), n_controls=1)
    added, _ = m._saturated(found, Plan(structure, (Resolution(4, 3, SINGULAR_DEGREE, 1e-12),)), set())
    assert (added and [kinds[0] for kinds in added.kinds]) == asked
    if added:
        assert added.times[1] == pytest.approx(width, abs=0.12)  # to the next sample


def test_a_mended_plan_stays_loose_while_the_same_is_touched() -> None:
    touched = PhaseStructure((0.0, 4.0), ((SING, FREE),), n_controls=1, orders=(0, 2)).with_touch(1, 2.0, UP)
    plan = replace(Plan.of(touched, 7.0), loose=True)
    with_bang = touched.with_arc(0, 1.0, 2.0, UP)
    assert plan.restructured(with_bang).loose and plan.restructured(with_bang).points == 7.0
    assert plan.restructured(with_bang).resolutions == Plan.of(with_bang, 7.0).resolutions
    assert not plan.restructured(touched.with_touch(1, 3.0, UP)).loose
    assert not Plan.of(touched).restructured(with_bang).loose


def test_a_mended_plan_keeps_the_degree_of_its_singular_controls() -> None:
    structure = PhaseStructure((0.0, 1.0, 4.0), ((LOW,), (SING,)))
    plan = Plan(structure, (Resolution(), Resolution(4, 9, smooth=12, gradient=0.1)))
    mended = plan.restructured(structure.with_arc(0, 1.0, 2.0, UP))
    assert mended.resolutions == (Resolution(), Resolution(), Resolution(4, 9, smooth=12))


# --- resolution -------------------------------------------------------------------------------------------


def plan_of(*resolutions: Resolution, kinds: Any = None) -> Plan:
    n = len(resolutions)
    structure = PhaseStructure(
        tuple(np.linspace(0, 1, n + 1)), kinds or ((LOW, FREE, FREE, FREE, FREE),) * n, (), 1, 2
    )
    return Plan(structure, resolutions)


def test_only_inaccurate_pieces_are_solved_more_finely() -> None:
    plan = plan_of(Resolution(1, 4), Resolution(1, 4))
    assert f.finer(samples(CART), plan, 1e-9) is None
    bent = samples(CART, lambda t, k: np.array([3 * t**2 - 2 * t**3, 6 * t - 6 * t**2 + 0.4 * k * (t - 0.5)]))
    found = f.finer(bent, plan, 1e-2)
    assert found is not None and [r.degree for r in found.resolutions] == [4, 7]
    assert f.finer(bent, plan, 0.2 / 1.45) is None  # 0.2 m/s beside a size of at least 1.45 m/s


def test_costates_count_in_shares_of_the_cost() -> None:
    """lam_q' = -1/2 along the second half: 1/4 of 12.25 that the states are worth."""

    def lam(t: Any, k: int) -> Any:
        return [-12 - 0.5 * k * (t - 0.5), -6 + 12 * t + 0.25 * k * (t - 0.5) ** 2]

    plan = plan_of(Resolution(1, 4), Resolution(1, 4))
    wrong = samples(CART, lam=lam)
    share = 0.25 / 12.25
    found = f.finer(wrong, plan, 0.99 * share)
    assert found is not None and [r.degree for r in found.resolutions] == [4, 7]
    assert f.finer(wrong, plan, 1.01 * share) is None
    pushed = samples(CART, lam=lam, states=lambda t, k: [0.5 * k + 0 * t, 0 * t])
    assert f.finer(pushed, plan, 1e-9) is None


def test_multipliers_along_a_contact_are_rough_and_do_not_count() -> None:
    """lam_q' = 1 where 0 is right, in both pieces; along the second one a state constraint is held. Dynamics count."""
    contact = PhaseStructure(
        (0.0, 0.5, 1.0),
        ((FREE,) * 5, (FREE, FREE, FREE, UP, FREE)),
        n_controls=1,
        n_paths=2,
        orders=(0, 0, 0, 2, 0),
    )
    plan = Plan(contact, (Resolution(1, 4), Resolution(1, 4)))
    wrong = samples(CART, lam=lambda t, k: [-12 + t, -6 + 12 * t - 0.5 * t**2])
    found = f.finer(wrong, plan, 1e-9)
    assert found is not None and [r.degree for r in found.resolutions] == [ARC_MAX_DEGREE, 4]
    bent = samples(CART, lambda t, k: [3 * t**2 - 2 * t**3, 6 * t - 6 * t**2 + 0.4 * k * (t - 0.5)])
    found = f.finer(bent, plan, 1e-9)
    assert found is not None and [r.degree for r in found.resolutions] == [4, ARC_MAX_DEGREE]


def test_an_open_gradient_of_a_singular_control_asks_for_a_higher_degree() -> None:
    plan = plan_of(
        Resolution(1, 4, 4),
        Resolution(1, 4, 4),
        kinds=((SING, FREE, FREE, FREE, FREE), (SING, UP, FREE, FREE, FREE)),
    )
    found = samples(
        CART, lam=lambda t, k: [-12 + 0 * t, -6 + 12 * t + 1e-6 * k], control_bounds=interval(-10.0, 10.0)
    )
    share = 1e-6 * 20 / found.hamiltonian_scale
    assert f.open_gradient(found, plan) == pytest.approx([0.0, share], rel=1e-3, abs=1e-12)
    finer = f.finer(found, plan, 1e-3)
    assert finer is not None and [r.smooth for r in finer.resolutions] == [4, 8]
    assert finer.resolutions[1].gradient == pytest.approx(share, rel=1e-3)
    bang = plan_of(Resolution(1, 4), Resolution(1, 4))
    assert f.open_gradient(found, bang).tolist() == [0.0, 0.0]


TWO_ROWS = PhaseStructure((0.0, 0.5, 1.0), ((LOW,) + (FREE,) * 4, (UP,) + (FREE,) * 4), (), 1, 2)


# --- the loop ---------------------------------------------------------------------------------------------


def record(error: float, actions: str) -> RefinementIteration:
    return RefinementIteration({}, {}, error, "", 0.0, True, 1, 0.0, actions)


def test_the_loop_is_restless_if_adjusting_does_not_help() -> None:
    moved, raised = record(1.0, s.KINKS_MOVED), record(1.0, s.RAISED)
    both = record(1.0, f"{s.KINKS_MOVED}, {s.RAISED}")
    assert s._restless([record(1.0, "x"), moved, raised, both, moved, raised])
    assert not s._restless([moved] * 4) and s._restless([moved] * 5)
    assert not s._restless([moved, moved, record(1.0, "piece 1 dropped"), moved, moved])
    assert not s._restless([moved, moved, moved, moved, record(0.5, s.RAISED)])
    assert s._restless([moved, moved, moved, moved, record(0.51, s.RAISED)])
    other = record(1e-9, "arc of u singular")  # errors of another structure are no measure
    assert not s._restless([other, *[record(0.1, s.RAISED)] * 4])
    assert s._restless([other, *[record(0.1, s.RAISED)] * 5])
    assert not s._restless([moved, moved, moved, record(1.0, f"{s.KINKS_MOVED}, {s.SMOOTHED}"), moved])


def test_a_mesh_is_refined_once_beyond_a_small_error() -> None:
    """Costates that are zero are rounding to any resolution."""
    raised = record(1e-10, s.RAISED)
    assert s._resolved([raised, raised], 1e-9) and not s._resolved([raised, raised], 1e-11)
    assert not s._resolved([raised], 1e-9)
    assert not s._resolved([record(1e-8, s.RAISED), raised], 1e-9)
    assert not s._resolved([raised, record(1e-10, s.KINKS_MOVED)], 1e-9)
    assert s._resolved([record(1.0, s.KINKS_MOVED), record(1.0, s.RAISED), raised, raised], 1e-9)


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The loop with solves and mending as told: `script` is (status, action) of every pass."""
    problem = cart()
    base = solution(problem, phase(problem))

    def run(script: list[tuple[Status, str]], **more: Any) -> Any:
        left, asked, shown = iter(script), [], []
        now: dict[str, Any] = {"passes": 0}

        def solve(problem: Any, plans: Any, guess: Any, options: SolverOptions, *_: Any) -> Any:
            asked.append(options)
            now["status"], now["action"] = next(left)
            now["passes"] += 1
            return replace(base, status=now["status"], objective=float(now["passes"]))

        monkeypatch.setattr(s, "_solve", solve)
        monkeypatch.setattr(s, "pass_meter", lambda *_: nullcontext(shown.append))
        monkeypatch.setattr(s, "_at_solution", lambda plan, found, name: plan)
        monkeypatch.setattr(s, "improve", lambda found, plans, swapped, tol: (plans, now["action"]))
        found, history = s.optimise_switches(base, **more)
        assert shown == list(history.passes)
        return found, history, asked

    return run


@pytest.mark.parametrize(
    ("script", "passes", "status", "actions"),
    [
        ([(Status.OPTIMAL, "")], 40, "converged", ["structure stands"]),
        ([(Status.OPTIMAL, "a"), (Status.ACCEPTABLE, "")], 40, "converged", ["a", "structure stands"]),
        ([(Status.OPTIMAL, "a"), (Status.OPTIMAL, "b")], 2, "pass_limit", ["a", "b"]),
        ([(Status.OPTIMAL, "a"), (Status.INFEASIBLE, "")], 40, "failed", ["a", "not solved (infeasible)"]),
        ([(Status.INTERRUPTED, "")], 40, "interrupted", ["not solved (interrupted)"]),
        ([(Status.OPTIMAL, s.KINKS_MOVED)] * 5, 40, "stalled", [s.KINKS_MOVED] * 5),
        ([(Status.OPTIMAL, s.RAISED)] * 2, 40, "converged", [s.RAISED] * 2),  # the error is rounding already
    ],
)
def test_how_the_loop_ends(scripted: Any, script: Any, passes: int, status: str, actions: list[str]) -> None:
    found, history, _ = scripted(script, limits=PassLimits(passes))
    assert history.status is RefinementStatus(status) and [p.actions for p in history.passes] == actions
    assert [p.solved for p in history.passes] == [st.solved for st, _ in script]
    assert history.message == f"{status}: {actions[-1]}"
    if status == "converged":
        assert found.objective == len(script) and history.chosen == len(script) - 1


def test_where_finer_meshes_end_singular_controls_of_higher_degree_are_tried(
    scripted: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once: the plans that then are asked for are what they are."""
    rows = PhaseStructure(
        (0.0, 0.5, 1.0), ((UP, FREE, FREE, FREE, FREE), (SING, FREE, FREE, FREE, FREE)), (), 1, 2
    )
    smoother = iter([{"leg": Plan.of(rows)}])
    monkeypatch.setattr(s, "smoother", lambda found, plans: next(smoother, plans))
    _, history, _ = scripted([(Status.OPTIMAL, s.RAISED)] * 2 + [(Status.OPTIMAL, "")])
    assert [p.actions for p in history.passes] == [s.RAISED, s.SMOOTHED, "structure stands"]
    assert history.status is RefinementStatus.CONVERGED


@pytest.mark.parametrize(("tol", "asked"), [(1e-3, s.SWITCHING_TIME_TOLERANCE), (1e-12, 1e-12)])
def test_what_was_detected_is_tried_after_a_structure_that_fails(
    monkeypatch: pytest.MonkeyPatch, tol: float, asked: float
) -> None:
    problem = cart()
    base, other = solution(problem, phase(problem)), solution(problem, phase(problem))
    told, calls = {"leg": Plan.of(TWO_ROWS)}, []

    def run(loop: Any, guess: Any, plans: Any, flown: Any = None) -> Any:
        calls.append((guess, plans, loop.aim, loop.limits.passes, loop.options.tolerance))
        return RefinementStatus.FAILED

    monkeypatch.setattr(s, "_settled", lambda *_: (other, told, None))
    monkeypatch.setattr(s._Loop, "run", run)
    limits = PassLimits(7)
    found, history = s.optimise_switches(base, tol=tol, limits=limits, structures={"leg": TWO_ROWS})
    assert found is base and history.status is RefinementStatus.FAILED and history.tolerance == tol
    assert [(c[0] is other, c[0] is base, *c[2:]) for c in calls] == [
        (True, False, asked, 7, s.TIGHT),
        (False, True, asked, 7, s.TIGHT),
    ]
    assert calls[0][1] is told and calls[1][1]["leg"].structure == TWO_ROWS
    monkeypatch.setattr(s, "_settled", lambda *_: (base, told, None))
    calls.clear()
    s.optimise_switches(base, structures={"leg": TWO_ROWS})
    assert len(calls) == 1  # the same guess would fail again


def test_solves_of_the_loop_are_sharp_and_brief(scripted: Any) -> None:
    _, history, (options,) = scripted([(Status.OPTIMAL, "")])
    assert (options.tolerance, options.max_iterations) == (s.TIGHT, s.ARC_SOLVE_MAX_ITERATIONS)
    own = SolverOptions(tolerance=1e-5)
    _, looser, (options,) = scripted([(Status.OPTIMAL, "")], options=own, tol=1e-3)
    assert options is own and (history.tolerance, looser.tolerance) == (1e-9, 1e-3)


def test_plans_follow_the_switch_times_of_their_solution() -> None:
    plan = Plan(THREE, (Resolution(1), Resolution(2), Resolution(1)))
    leg = SimpleNamespace(breaks=np.array([1.0, 1.5, 2.0, 4.5, 5.0]))
    there: Any = SimpleNamespace(phases={"leg": leg})
    assert s._at_solution(plan, there, "leg").structure.times == (1.0, 1.5, 4.5, 5.0)


def improved(monkeypatch: pytest.MonkeyPatch, **answers: Any) -> tuple[dict[str, Plan], str]:
    """Two phases; what each step answers by phase."""
    plans = {n: Plan(THREE, (Resolution(),) * 3, 7.0) for n in ("a", "b")}
    there: Any = SimpleNamespace(
        samples=lambda: {n: SimpleNamespace(name=n) for n in plans}, need_problem=lambda _: None
    )
    nothing: Any = {"a": None, "b": None}

    def step(name: str, otherwise: Any) -> Any:
        return lambda of, *more: (
            answers.get(name, nothing)[getattr(of, "samples", of).name] or otherwise(*more)
        )

    monkeypatch.setattr(m, "collapsed", step("collapse", lambda *_: (None, "")))
    monkeypatch.setattr(m, "_adjust", step("adjust", lambda plan, tol: (plan, "")))
    monkeypatch.setattr(m, "_complete", step("complete", lambda *_: (None, "")))
    monkeypatch.setattr(m, "_saturated", step("saturate", lambda *_: (None, "")))
    monkeypatch.setattr(m, "_overrun", step("overrun", lambda *_: (None, "")))
    monkeypatch.setattr(m, "unpinned", step("pinned", lambda *_: (None, "")))
    monkeypatch.setattr(m, "_mended_contacts", step("mended", lambda *_: (None, "")))
    monkeypatch.setattr(m, "crossed_contact", step("crossed", lambda *_: (None, "")))
    return m.improve(there, plans, set(), 1e-9)


def test_what_vanishes_is_mended_first_then_kinks_and_points_then_what_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    other = PhaseStructure((0.0, 1.0), ((LOW,),))
    finer = Plan(THREE, (Resolution(2),) * 3)
    add, drop, adjust = (
        {"a": (other, "added"), "b": None},
        {"a": None, "b": (other, "dropped")},
        {"a": None, "b": (finer, "r")},
    )
    plans, action = improved(monkeypatch)
    assert action == "" and all(plan.structure is THREE for plan in plans.values())
    plans, action = improved(monkeypatch, collapse=drop, adjust=adjust, complete=add)
    assert (action, plans["b"].structure, plans["a"].structure) == ("dropped", other, THREE)
    assert plans["b"].points == 7.0
    plans, action = improved(monkeypatch, adjust=adjust, complete=add)
    assert (action, plans["b"]) == ("r", finer) and plans["a"].structure is THREE
    plans, action = improved(monkeypatch, saturate={"a": (other, "saturated"), "b": None}, adjust=adjust)
    assert (action, plans["a"].structure, plans["a"].points) == ("saturated", other, 7.0)
    plans, action = improved(monkeypatch, overrun={"a": (other, "overrun"), "b": None}, adjust=adjust)
    assert (action, plans["a"].structure, plans["a"].points) == ("overrun", other, 7.0)
    plans, action = improved(monkeypatch, pinned={"a": (other, "unpinned"), "b": None}, adjust=adjust)
    assert (action, plans["a"].structure, plans["a"].points) == ("unpinned", other, 7.0)
    plans, action = improved(monkeypatch, complete=add)
    assert (action, plans["a"].structure, plans["a"].points) == ("added", other, 7.0)
    plans, action = improved(monkeypatch, collapse=drop, mended=add, adjust=adjust)
    assert action == "dropped"
    plans, action = improved(monkeypatch, mended=add, adjust=adjust, complete=drop)
    assert (action, plans["a"].structure, plans["a"].points, plans["b"].structure) == (
        "added",
        other,
        7.0,
        THREE,
    )
    crossed = {"a": None, "b": (other, "crossed")}
    plans, action = improved(monkeypatch, crossed=crossed)
    assert (action, plans["b"].structure, plans["b"].points) == ("crossed", other, 7.0)
    assert improved(monkeypatch, complete=add, crossed=crossed)[1] == "added"
    assert improved(monkeypatch, adjust=adjust, crossed=crossed)[1] == "r"
    both = {"a": (finer, "r"), "b": (finer, "r")}
    assert improved(monkeypatch, adjust=both)[1] == "r"
    assert improved(monkeypatch, adjust={"a": (finer, "r"), "b": (finer, "k")})[1] == "r, k"


@pytest.mark.parametrize(
    ("error", "gradient", "wanted"),
    [
        (1e-3, 1e-2, Resolution(2, 9, 8, 1e-2)),  # a polynomial that is no guess of the control comes first
        (1e-2, 1e-3, Resolution(2, 9, 4)),
        (1e-6, 1e-5, Resolution(2, 9, 4)),  # then the states,
        (1e-10, 1e-5, Resolution(2, 9, 8, 1e-5)),  # then the last digits of the control
        (1e-10, 1e-10, Resolution(2, 6, 4)),
    ],
)
def test_what_is_worse_is_raised(error: float, gradient: float, wanted: Resolution) -> None:
    assert f.next_resolution(Resolution(2, 6, 4), np.array([1e-12, error]), gradient, 1e-9) == wanted


def test_errors_that_are_no_numbers_ask_for_the_finest() -> None:
    found = f.next_resolution(Resolution(2, ARC_MAX_DEGREE), np.array([np.nan, 1e-12]), 0.0, 1e-9)
    assert found == Resolution(5, ARC_MAX_DEGREE, edges=(0.125, 0.25, 0.375, 0.5))


@pytest.mark.parametrize(
    ("action", "error", "rests"),
    [("resolution raised", 1e-9, True), ("resolution raised", 1e-7, False), ("kinks moved", 1e-9, False)],
)
def test_at_a_limit_a_structure_that_is_accurate_enough_rests(action: str, error: float, rests: bool) -> None:
    record = RefinementIteration({}, {}, error, "", 1.0, True, 3, 0.1, action)
    nothing: Any = None
    tried = s._Try(nothing, {}, record)

    def loop(*tries: Any) -> s._Loop:
        return s._Loop(nothing, 1e-8, PassLimits(), nothing, nothing, list(tries))

    status = loop(tried)._limited(RefinementStatus.BUDGET_LIMIT)
    assert status is (RefinementStatus.CONVERGED if rests else RefinementStatus.BUDGET_LIMIT)
    assert loop()._limited(RefinementStatus.ITERATION_LIMIT) is RefinementStatus.ITERATION_LIMIT


@pytest.mark.parametrize(
    ("moved", "finer", "action", "pieces"),
    [
        (None, False, "", 3), ((1.0, 2.5, 4.0, 5.0), False, "kinks moved", 3), (None, True, "resolution raised", 3),
        ((1.0, 2.5, 4.0, 5.0), True, "kinks moved, resolution raised", 3),
        ((1.0, 4.0, 4.0, 5.0), True, "piece 2 dropped", 2), ((1.0, 0.9, 4.0, 5.0), False, "piece 1 dropped", 2),
    ],
)  # fmt: skip
def test_kinks_and_resolutions_are_adjusted_together(
    monkeypatch: pytest.MonkeyPatch, moved: Any, finer: bool, action: str, pieces: int
) -> None:
    plan = Plan(THREE, (Resolution(),) * 3, 7.0)
    raised = replace(plan, resolutions=(Resolution(2),) * 3)
    monkeypatch.setattr(m, "move_kinks", lambda *_: None if moved is None else THREE.at(moved))
    monkeypatch.setattr(m, "finer", lambda *_: raised if finer else None)
    constraints: Any = SimpleNamespace(samples=LEG)
    found, what = m._adjust(constraints, plan, 1e-9)
    assert what == action and found.structure.pieces == pieces and found.points == 7.0
    if pieces == 3:
        assert found.structure.times == (moved or THREE.times)
        assert found.resolutions == (raised if finer else plan).resolutions


def test_arcs_of_all_phases_have_the_names_of_their_rows() -> None:
    problem = cart()
    structure = PhaseStructure((0.0, 1.0), ((UP, FREE, LOW, FREE, FREE),), (), 1, 2)
    found = s._arcs(solution(problem, phase(problem)), {"leg": Plan.of(structure)})
    assert found == (Arc("leg", "a", UP, 0.0, 1.0), Arc("leg", "pure", LOW, 0.0, 1.0))


TOUCHED = PhaseStructure(
    (0.0, 1.0, 2.0, 4.0), ((LOW, FREE), (LOW, UP), (LOW, FREE)), (), 1, 0, (0, 2), ((), (), ((1, UP),), ())
)


@pytest.mark.parametrize(
    ("loose", "moved", "touches", "action"),
    [
        (False, None, True, "limits beside touches released"), (True, None, True, "resolution raised"),
        (False, (0.0, 1.5, 2.0, 4.0), True, "kinks moved, resolution raised"),
        (False, None, False, "resolution raised"),
    ],
)  # fmt: skip
def test_limits_beside_touches_are_released_before_a_mesh_is_refined(
    monkeypatch: pytest.MonkeyPatch, loose: bool, moved: Any, touches: bool, action: str
) -> None:
    structure = TOUCHED if touches else replace(TOUCHED, touches=((),) * 4)
    plan = Plan(structure, (Resolution(),) * 3, 7.0, loose)
    raised = replace(plan, resolutions=(Resolution(2),) * 3)
    monkeypatch.setattr(m, "move_kinks", lambda *_: None if moved is None else structure.at(moved))
    monkeypatch.setattr(m, "finer", lambda *_: raised)
    found, what = m._adjust(SimpleNamespace(samples=LEG), plan, 1e-9)  # type: ignore[arg-type]
    assert what == action and found.loose is (loose or action.startswith("limits"))
    assert found.resolutions == (plan if action.startswith("limits") else raised).resolutions


def test_an_arc_on_a_limit_that_shrinks_to_nothing_leaves_a_touch(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = Plan(replace(TOUCHED, touches=((),) * 4), (Resolution(),) * 3, 7.0)
    monkeypatch.setattr(m, "move_kinks", lambda *_: plan.structure.at((0.0, 1.5, 1.5, 4.0)))
    monkeypatch.setattr(m, "finer", lambda *_: None)
    found, what = m._adjust(SimpleNamespace(samples=LEG), plan, 1e-9)  # type: ignore[arg-type]
    assert what == "piece 2 dropped" and found.points == 7.0
    assert found.structure.touching(1, UP) == [1.5] and found.structure.kinds == ((LOW, FREE),) * 2


@pytest.mark.parametrize(
    ("added", "wrong", "action"),
    [
        (True, (2, 1), "added"),
        (True, None, "added"),
        (False, (2, 1), "touch at 2 s dropped"),
        (False, None, ""),
    ],
)
def test_a_contact_that_is_missing_comes_before_a_touch_that_pulls(
    monkeypatch: pytest.MonkeyPatch, added: bool, wrong: Any, action: str
) -> None:
    monkeypatch.setattr(m, "pushed_contact", lambda *_: (THREE, "added") if added else (None, ""))
    monkeypatch.setattr(m, "wrong_touch", lambda *_: wrong)
    found, what = m._mended_contacts(None, TOUCHED)  # type: ignore[arg-type]
    assert what == action
    assert found == (THREE if added else TOUCHED.without_touch(2, 1) if wrong else None)


@pytest.mark.parametrize(("away", "settled"), [(5e-11, True), (5e-9, False)])
def test_ends_of_contacts_are_told_more_sharply_than_kinks(
    monkeypatch: pytest.MonkeyPatch, away: float, settled: bool
) -> None:
    """Both would rest within 1e-8 of the phase, a contact within 1e-10."""
    contact = PhaseStructure((10.0, 10.5, 11.0), ((FREE,) * 5, (FREE, FREE, FREE, UP, FREE)), (True,) + (False,) * 4, 1,
                             2, (0, 0, 0, 2, 0))  # fmt: skip
    plan = Plan(contact, (Resolution(), Resolution()))
    monkeypatch.setattr(j, "junction_time", lambda *_: 10.5 - away)
    found = j.move_kinks(SimpleNamespace(samples=None), plan)  # type: ignore[arg-type]
    assert (found is None) is settled and (settled or found.times == (10.0, 10.5 - away, 11.0))  # type: ignore[union-attr]
    kink = PhaseStructure(
        (10.0, 10.5, 11.0), ((FREE,) * 5, (UP, FREE, FREE, FREE, FREE)), (True,) + (False,) * 4, 1, 2
    )
    monkeypatch.setattr(j, "_wanted", lambda *_: 10.5 - away)
    assert j.move_kinks(SimpleNamespace(samples=None), Plan(kink, plan.resolutions)) is None  # type: ignore[arg-type]
