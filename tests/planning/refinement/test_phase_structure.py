"""Structures of a phase by hand: kinks, limits that take over, contacts, what is left after a time or of a piece."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from testing.internals import ARC_MAX_DEGREE, COARSE, Junction, PhaseStructure, Plan, Resolution

from gnc_opt.planning import Arc, ArcKind

LOW, FREE, UP, SING = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.SINGULAR
NAMES = {"l": LOW, "i": FREE, "u": UP, "s": SING}


def made(*pieces: str, **more: Any) -> PhaseStructure:
    """Pieces of a second each from 0 s on, one letter per row."""
    times = tuple(float(t) for t in range(len(pieces) + 1))
    return PhaseStructure(times, tuple(tuple(NAMES[row] for row in piece) for piece in pieces), **more)


# --- rows -------------------------------------------------------------------------------------------------


def test_rows_are_controls_then_paths_then_states() -> None:
    structure = made("lius", "uils", n_controls=2, n_paths=1)
    assert structure.controls.tolist() == [[LOW, UP], [FREE, FREE]]
    assert structure.paths.tolist() == [[UP, LOW]] and structure.states.tolist() == [[SING, SING]]
    assert (
        structure.changes(1) == [0, 2] and structure.pieces == 2 and structure.lengths.tolist() == [1.0, 1.0]
    )
    alone = made("li", "ui")
    assert alone.controls.shape == (2, 2) and alone.paths.shape == alone.states.shape == (0, 2)
    assert alone.orders == alone.slopes == (0, 0) and alone.holders == ((), ())
    assert alone.touches == ((), (), ()) and alone.regular == (False, False)


@pytest.mark.parametrize(
    ("pieces", "regular", "bends"),
    [
        (("ii", "li"), (False, False), True),
        (("ii", "li"), (True, False), False),
        (("li", "ui"), (False, True), False),
        (("si", "ui"), (False, False), False),
    ],
)
def test_only_controls_bend(pieces: Any, regular: Any, bends: bool) -> None:
    assert made(*pieces, regular=regular, n_controls=1).bends is bends


@pytest.mark.parametrize(
    ("time", "first", "times"),
    [
        (-1.0, "l", (0.0, 1.0, 2.0, 3.0)), (0.0, "l", (0.0, 1.0, 2.0, 3.0)), (0.5, "l", (0.5, 1.0, 2.0, 3.0)),
        (1.0, "s", (1.0, 2.0, 3.0)), (2.5, "u", (2.5, 3.0)),
    ],
)  # fmt: skip
def test_what_is_left_after_a_time(time: float, first: str, times: Any) -> None:
    structure = (
        made("li", "si", "ui", n_controls=1, orders=(0, 2)).with_touch(1, 1.0, UP).with_touch(1, 2.0, LOW)
    )
    left = structure.after(time)
    assert left.times == times and left.kinds[0][0] is NAMES[first]
    assert left.touches[1:] == structure.touches[-len(times) + 1 :]
    assert left.touches[0] == ()


# --- what determines a control ----------------------------------------------------------------------------


def test_limits_that_are_held_determine_their_holders_or_all_that_may_hold_them() -> None:
    paths = {"n_controls": 2, "n_paths": 1}
    assert made("iiui", **paths, holders=((), (), (1,), ())).determined(0) == {1}
    assert made("iiui", **paths).determined(0) == {0, 1}
    assert made("iiui", **paths, regular=(True, False, True, False)).determined(0) == {0}
    assert made("iiiu", **paths, regular=(True, False, True, False)).determined(0) == {0, 1}
    assert made("uuii", **paths).determined(0) == set()


def test_boundaries_are_kinks_where_all_that_changes_is_continuous() -> None:
    assert made("i", "u", regular=(True,)).kinked(1)
    assert not made("i", "u").kinked(1) and not made("l", "u", regular=(True,)).kinked(1)
    assert not made("ii", "ul", regular=(True, False)).kinked(1)
    assert made("ii", "ul", regular=(True, True)).kinked(1)
    state = {"n_controls": 1, "orders": (0, 2)}
    assert made("ii", "iu", **state, holders=((), (0,))).kinked(1)
    assert not made("ii", "iu", n_controls=1).kinked(1)
    assert not made("ii", "su", **state, holders=((), (0,)), regular=(True, False)).kinked(1)
    touched = replace(made("ii", "iu", **state), touches=((), ((1, UP),), ()))
    assert not touched.kinked(1)


@pytest.mark.parametrize(
    ("pieces", "slope", "over"),
    [
        (("ui", "iu"), 1, True), (("iu", "ui"), 1, True), (("li", "iu"), -1, True), (("ui", "il"), -1, True),
        (("ui", "iu"), -1, False), (("li", "iu"), 1, False), (("ui", "iu"), 0, False), (("ui", "ii"), 1, False),
        (("ui", "li"), 1, False),
    ],
)  # fmt: skip
def test_a_path_constraint_takes_over_from_a_bound_on_the_same_side(
    pieces: Any, slope: int, over: bool
) -> None:
    """A bound above, or a path constraint that limits the control from there."""
    structure = made(*pieces, n_controls=1, n_paths=1, holders=((), (0,)), slopes=(0, slope))
    assert structure.handed_over(1) == ([0, 1] if over else [])
    assert not structure.kinked(1)
    free = [[kind is FREE for kind in row] for row in structure.matrix()]
    assert structure.beside_takeovers().tolist() == (free if over else [[False, False]] * 2)
    held = [kinds[1] in (LOW, UP) and slope != 0 for kinds in structure.kinds]
    assert structure.limited_by_paths().tolist() == [held]


def test_a_limit_of_a_convex_control_takes_over_from_its_bound_and_a_state_constraint_does_not() -> None:
    """A mixed path constraint leans on the control as one that is linear in it; a state constraint has to be met."""
    given: dict[str, Any] = {"n_controls": 1, "holders": ((), (0,)), "leans": ((), (1,))}
    mixed = made("ui", "iu", n_paths=1, regular=(True, True), **given)
    assert mixed.handed_over(1) == [0, 1] and not mixed.kinked(1)
    assert made("ui", "iu", n_paths=1, orders=(0, 1), **given).handed_over(1) == []
    assert made("ui", "iu", **given).handed_over(1) == []


def test_of_two_controls_none_takes_over_from_the_other() -> None:
    structure = made("uii", "iiu", n_controls=2, n_paths=1, holders=((), (), (1,)), slopes=(0, 0, 1))
    assert structure.handed_over(1) == []


def test_rows_beside_contacts() -> None:
    """Of state constraints only, and where they are touched wherever they are not held."""
    structure = made("ii", "iu", "ii", "ii", n_controls=1, orders=(0, 2))
    assert structure.beside_contacts(False).tolist() == [[False] * 4, [True, False, True, False]]
    assert structure.beside_contacts(True).tolist() == structure.beside_contacts(False).tolist()
    touched = replace(structure, touches=((), (), (), ((1, UP),), ()))
    assert touched.beside_contacts(True)[1].tolist() == [True, False, True, True]
    assert not made("ii", "iu", n_controls=1).beside_contacts(True).any()
    assert [structure.on_contact(k) for k in range(4)] == [False, True, False, False]
    assert not made("ui", "iu", n_controls=1, orders=(0, 0)).on_contact(1)


def test_contacts_hold_up_to_both_ends_and_at_touches() -> None:
    structure = made("ii", "iu", "ii", n_controls=1, orders=(0, 2)).with_touch(1, 2.5, LOW)
    times = np.array([-1.0, 0.9, 1.0, 1.5, 2.0, 2.1, 2.5, 2.6, 9.0])
    assert structure.contact(1, times).tolist() == [False, False, True, True, True, False, True, False, False]
    assert (
        structure.touching(1, LOW) == [2.5] and structure.touching(1, UP) == structure.touching(0, LOW) == []
    )


# --- pieces that vanish -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("order", "paths", "piece", "touches"),
    [
        (2, 0, 1, [1.5]), (1, 0, 1, []), (2, 0, 0, []), (1, 1, 0, [0.0]), (0, 1, 0, []), (1, 1, 2, [3.0]),
        (1, 1, 1, []),
    ],
)  # fmt: skip
def test_a_touch_is_left_of_an_arc_on_a_limit(order: int, paths: int, piece: int, touches: Any) -> None:
    """Within the phase of limits of second order, at its ends of path constraints."""
    pieces = ["ii", "ii", "ii"]
    pieces[piece] = "iu"
    structure = made(*pieces, n_controls=1, n_paths=paths, orders=(0, order))
    left = structure.emptied(piece)
    assert left.touching(1, UP) == touches and all(kinds == (FREE, FREE) for kinds in left.kinds)
    beside = made("iu", "iu", "ii", n_controls=1, orders=(0, 2))
    assert replace(beside, times=(0.0, 1.0, 1.0, 3.0)).emptied(1).touching(1, UP) == []


def test_arcs_are_told_by_name_and_touches_without_length() -> None:
    structure = made("ii", "iu", "li", n_controls=1, orders=(0, 2)).with_touch(1, 2.5, LOW)
    found = structure.arcs("leg", ("a", "q"))
    assert found == (
        Arc("leg", "a", FREE, 0.0, 1.0), Arc("leg", "a", ArcKind.CONSTRAINED, 1.0, 2.0), Arc("leg", "a", LOW, 2.0, 3.0),
        Arc("leg", "q", UP, 1.0, 2.0), Arc("leg", "q", LOW, 2.5, 2.5),
    )  # fmt: skip


# --- plans ------------------------------------------------------------------------------------------------


def test_touches_of_a_plan_are_junctions_of_second_order_within_and_first_at_the_ends() -> None:
    structure = made("iii", "iiu", "iii", n_controls=1, n_paths=1, orders=(0, 0, 3))
    structure = replace(structure, touches=(((2, LOW),), (), ((1, UP),), ((2, UP),)))
    plan = Plan(structure, (Resolution(2), Resolution(3), Resolution(1)))
    found = plan._junctions()
    assert found == (
        Junction(1, 2, UP, 3),
        Junction(0, 5, UP, 2),
        Junction(1, 0, LOW, 1),
        Junction(1, 6, UP, 1),
    )


def test_beside_a_bang_that_bends_more_pieces_are_as_fine_as_what_was_in_their_place() -> None:
    """Half of five segments are three; eight interior ones along the phase are the least."""
    coarse, bent = made("u"), made("u", "i").at((0.0, 0.5, 1.0))
    plan = Plan(coarse, (Resolution(5, 9),), 7.0, True)
    assert plan.restructured(bent).resolutions == (Resolution(3, 9), Resolution(4, 9))
    assert plan.restructured(bent).loose and plan.restructured(bent).points == 7.0
    straight = made("u", "l")
    assert plan.restructured(straight).resolutions == Plan.of(straight, 7.0).resolutions
    same = Plan(bent, (Resolution(5, 10), Resolution(2, 12)), 7.0)
    assert same.restructured(made("i", "u")).resolutions == Plan.of(made("i", "u"), 7.0).resolutions
    finer = same.restructured(made("i", "u", "i").at((0.0, 0.25, 0.5, 1.0)))
    assert finer.resolutions == (Resolution(3, 10), Resolution(3, 10), Resolution(4, 12))
    across = same.restructured(made("u", "i", "u").at((0.0, 0.25, 0.875, 1.0)))
    assert across.resolutions == (Resolution(3, 10), Resolution(5, 12), Resolution(1, 12))


def test_plans_begin_as_defaults_say() -> None:
    plan = Plan(made("u"), (Resolution(),))
    assert (plan.points, plan.loose) == (0.0, False)
    assert Plan.of(made("u"), COARSE).resolutions == (Resolution(),)
    assert Plan.of(made("u"), 1e9).resolutions[0].degree == ARC_MAX_DEGREE
