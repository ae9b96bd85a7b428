"""Structures of a phase by hand: kinks, limits that take over, contacts, what is left after a time or of a piece."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from testing.internals import ArcMesh, Junction, PhaseStructure, SubarcMesh

from gnc_opt.planning import Arc, ArcKind

LOW, FREE, UP, SING = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.SINGULAR
NAMES = {"l": LOW, "i": FREE, "u": UP, "s": SING}


def made(*pieces: str, **more: Any) -> PhaseStructure:
    """Pieces of a second each from 0 s on, one letter per row."""
    times = tuple(float(t) for t in range(len(pieces) + 1))
    more = {"regular": (), "n_controls": len(pieces[0])} | more
    return PhaseStructure(times, tuple(tuple(NAMES[row] for row in piece) for piece in pieces), **more)


def test_limits_that_are_held_determine_their_holders_or_all_that_may_hold_them() -> None:
    paths = {"n_controls": 2, "n_paths": 1}
    assert made("iiui", **paths, effects=((), (), ((1, 0),), ())).find_controls_fixed_by_limits(0) == {1}
    assert made("iiui", **paths).find_controls_fixed_by_limits(0) == {0, 1}
    for pieces, found in (("iiui", {0}), ("iiiu", {0, 1})):
        odd = made(pieces, **paths, regular=(True, False, True, False))
        assert odd.find_controls_fixed_by_limits(0) == found
    assert made("uuii", **paths).find_controls_fixed_by_limits(0) == set()


def test_a_saturated_control_leaves_the_state_constraint_to_another_one() -> None:
    holders = {"n_controls": 2, "orders": (0, 0, 1), "regular": (False, True, False)}
    for pieces, found in (("siu", "uiu"), True), (("siu", "uuu"), False), (("siu", "uii"), False):
        for ordered in (pieces, pieces[::-1]):
            odd = made(*ordered, effects=((), (), ((0, 1), (1, 1))), **holders)
            assert odd.has_saturated_control(0, 1) is found


def test_arcs_are_reported_by_name_and_touches_without_length() -> None:
    structure = made("ii", "iu", "li", n_controls=1, orders=(0, 2)).with_touch_point(1, 2.5, LOW)
    found = structure.list_arcs("leg", ("a", "q"))
    assert found == (
        Arc("leg", "a", FREE, 0.0, 1.0),
        Arc("leg", "a", ArcKind.CONSTRAINED, 1.0, 2.0),
        Arc("leg", "a", LOW, 2.0, 3.0),
        Arc("leg", "q", UP, 1.0, 2.0),
        Arc("leg", "q", LOW, 2.5, 2.5),
    )


def test_touches_of_a_plan_are_junctions_of_second_order_within_and_first_at_the_ends() -> None:
    structure = made("iii", "iiu", "iii", n_controls=1, n_paths=1, orders=(0, 0, 3))
    structure = replace(structure, touches=(((2, LOW),), (), ((1, UP),), ((2, UP),)))
    plan = ArcMesh(structure, (SubarcMesh(2), SubarcMesh(3), SubarcMesh(1)))
    found = plan._list_state_constraint_junctions()
    assert found == (
        Junction(1, 2, UP, 3),
        Junction(0, 5, UP, 2),
        Junction(1, 0, LOW, 1),
        Junction(1, 6, UP, 1),
    )


def test_boundaries_a_rounding_apart_are_one() -> None:
    """An arc, or a touch, at a known time up to rounding has no piece of its own next to it."""
    near = np.nextafter(13.5, 0.0)
    structure = replace(made("i", "l"), times=(-200.0, 13.5, 200.0))
    assert structure.with_inserted_arc(0, near, 50.0, UP).times == (-200.0, 13.5, 50.0, 200.0)
    assert structure.with_inserted_arc(0, near, 50.0, UP).kinds == ((FREE,), (UP,), (LOW,))
    touched = replace(made("ii", "li"), times=(-200.0, 13.5, 200.0)).with_touch_point(1, near, UP)
    assert touched.times == (-200.0, 13.5, 200.0) and touched.touches == ((), ((1, UP),), ())
