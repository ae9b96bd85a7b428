"""What a mesh shows and no control can do, on structures put together by hand."""

from __future__ import annotations

import pytest

from gnc_opt.planning import ArcKind
from gnc_opt.planning.refinement.arcs.contact_cleanup import with_possible_ends, without_overlaps
from gnc_opt.planning.refinement.arcs.structure import PhaseStructure

LOW, FREE, UP, SING = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.SINGULAR


def structure(times: tuple[float, ...], *kinds: tuple[ArcKind, ...], lean: int = 1) -> PhaseStructure:
    """One control, and two states of order 1 and 2 that it holds."""
    return PhaseStructure(
        times, kinds, n_controls=1, orders=(0, 1, 2), holders=((), (0,), (0,)), leans=((), (lean,), (lean,))
    )


def test_one_limit_takes_over_from_another_in_the_middle_of_what_they_share() -> None:
    both = structure((0.0, 3.0, 5.0, 9.0), (SING, UP, FREE), (SING, UP, UP), (SING, FREE, UP))
    left = without_overlaps(both)
    assert left.times == (0.0, 4.0, 9.0)
    assert left.kinds == ((SING, UP, FREE), (SING, FREE, UP))


def test_a_limit_held_on_both_sides_of_another_is_left_where_it_is_shorter() -> None:
    both = structure(
        (0.0, 3.0, 5.0, 6.0, 9.0), (SING, FREE, LOW), (SING, UP, LOW), (SING, FREE, LOW), (LOW, FREE, FREE)
    )
    left = without_overlaps(both)
    assert left.times == (0.0, 3.0, 5.0, 6.0, 9.0)
    assert left.kinds[1:] == ((SING, UP, FREE), (SING, FREE, FREE), (LOW, FREE, FREE))


def test_a_control_comes_to_its_own_bound_in_the_middle_of_what_that_shares_with_the_limit_it_holds() -> None:
    both = structure((0.0, 3.0, 5.0, 9.0), (FREE, UP, FREE), (UP, UP, FREE), (UP, FREE, FREE))
    left = without_overlaps(both)
    assert left.times == (0.0, 4.0, 9.0)
    assert left.kinds == ((FREE, UP, FREE), (UP, FREE, FREE))


def test_limits_of_two_controls_may_be_held_together() -> None:
    both = PhaseStructure(
        (0.0, 3.0, 5.0, 9.0), ((SING, SING, UP, FREE), (SING, SING, UP, UP), (SING, SING, FREE, UP)),
        n_controls=2, orders=(0, 0, 1, 2), holders=((), (), (0,), (0, 1)),
    )  # fmt: skip
    assert without_overlaps(both) == both


@pytest.mark.parametrize(("lean", "inward", "outward"), [(1, LOW, UP), (-1, UP, LOW)])
def test_an_arc_is_met_with_a_bang_that_leads_away_from_its_limit(
    lean: int, inward: ArcKind, outward: ArcKind
) -> None:
    """S'' < 0 before S = S' = 0 at an upper limit: S comes from below."""
    arc, right, wrong = (SING, FREE, UP), (inward, FREE, FREE), (outward, FREE, FREE)
    fine = structure((0.0, 3.0, 6.0, 9.0), right, arc, right, lean=lean)
    assert with_possible_ends(fine, 2.0) == fine
    swings = structure((0.0, 3.0, 4.0, 6.0, 9.0), right, wrong, arc, right, lean=lean)
    assert with_possible_ends(swings, 2.0) == fine
    unseen = with_possible_ends(structure((0.0, 3.0, 6.0, 9.0), wrong, arc, right, lean=lean), 2.0)
    assert unseen.times == (0.0, 2.75, 3.25, 6.0, 9.0)
    assert unseen.kinds == (wrong, right, arc, right)
