"""Path constraints that limit one control linearly, by hand: which those are, how far they let it go, what is held."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import interval
from testing.internals import PhaseStructure

from gnc_opt.planning import ArcKind
from gnc_opt.planning.refinement.arcs.mixed_constraints import LinearLimits

LOW, FREE, UP, SING = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.SINGULAR
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
        path_labels=tuple(ROWS), path_bounds=interval(LOWER, UPPER), control_bounds=interval(*bounds),
        controls=SimpleNamespace(size=2),
    )  # fmt: skip
    return SimpleNamespace(
        leg=leg, times=np.arange(5.0), x=X[None, :], u=np.full((2, 5), values), control_scale=np.array([2.5, 2.5]),
        functions=SimpleNamespace(paths=paths, path_control_jacobian=slopes),
    )  # fmt: skip


LIMITS = LinearLimits.of(flight(), np.array([True, True]))


def test_only_inequalities_that_are_linear_in_one_control_count() -> None:
    assert LIMITS.rows == {0: (0, 5), 1: (3,)}
    assert LIMITS.paths.tolist() == [True, False, False, True, False, True]
    assert LIMITS.slopes.tolist() == [[2.0] * 5, [0.0] * 5, [0.0] * 5, [-3.0] * 5, [0.0] * 5, X.tolist()]
    assert LIMITS.signs == (1, 0, 0, -1, 0, 0)
    assert LinearLimits.of(flight(), np.array([False, True])).rows == {1: (3,)}
    none = LinearLimits.of(flight(), np.array([False, False]))
    assert none.rows == {} and none.slopes.shape == (6, 5) and not none.paths.any()


@pytest.mark.parametrize("u", [0.25, -0.7, 3.0])
def test_reaches_are_those_of_the_limits_wherever_the_control_is(u: float) -> None:
    """2 u + x <= 4; x u between -1 and 1.8, whatever the sign of x; -3 w between -3 and 6."""
    limits = LinearLimits.of(flight(values=u), np.array([True, True]))
    above, below = limits._reaches(0)
    assert above[0] == pytest.approx((4 - X) / 2) and np.all(below[0] == -INF)
    assert above[5] == pytest.approx([0.5, 1.0, INF, 1.8, 0.9])
    assert below[5] == pytest.approx([-0.9, -1.8, -INF, -1.0, -0.5])
    above, below = limits._reaches(1)
    assert above[3] == pytest.approx([1.0] * 5) and below[3] == pytest.approx([-2.0] * 5)


@pytest.mark.parametrize(
    ("control", "bounds", "ended"),
    [
        (0, (-1.0, 1.5), (True, True)), (0, (-INF, INF), (False, True)), (1, (-INF, INF), (True, True)),
        (0, (-1.0, INF), (True, True)), (0, (-INF, 1.5), (False, True)),
    ],
)  # fmt: skip
def test_a_control_ends_at_its_bounds_or_at_what_limits_it_all_along(
    control: int, bounds: Any, ended: Any
) -> None:
    both = ((bounds[0],) * 2, (bounds[1],) * 2)
    assert LinearLimits.of(flight(both), np.array([True, True])).ended(control) == ended


def test_the_tightest_limit_holds_a_control_that_is_sent_up_or_down() -> None:
    """Up to 1.5 at most, down to -1: -1 <= x u <= 1.8 is tighter where |x| is large, than 2 u + x <= 4 too."""
    everywhere = np.ones(5, dtype=bool)
    own, held = LIMITS.labels(0, everywhere)
    assert own.tolist() == [SING, SING, UP, UP, SING]
    assert held[0].tolist() == [FREE] * 5 and held[5].tolist() == [LOW, LOW, FREE, FREE, UP]
    own, held = LIMITS.labels(0, ~everywhere)
    assert own.tolist() == [SING, LOW, LOW, LOW, SING]
    assert held[5].tolist() == [UP, FREE, FREE, FREE, LOW] and held[0].tolist() == [FREE] * 5
    own, held = LIMITS.labels(1, np.array([True, False, True, False, True]))
    assert own.tolist() == [SING, LOW, SING, LOW, SING]
    assert set(held) == {3} and held[3].tolist() == [LOW, FREE, LOW, FREE, LOW]


def test_a_later_limit_that_is_tighter_frees_the_one_before() -> None:
    wide = LinearLimits.of(flight(((-9.0, -9.0), (9.0, 9.0))), np.array([True, True]))
    own, held = wide.labels(0, np.ones(5, dtype=bool))
    assert own.tolist() == [SING] * 5
    assert held[0].tolist() == [FREE, FREE, UP, UP, FREE] and held[5].tolist() == [LOW, LOW, FREE, FREE, UP]


STRUCTURE = PhaseStructure(
    (0.0, 2.0, 4.0), ((UP, LOW) + (FREE,) * 7, (LOW, LOW) + (FREE,) * 7), (), 2, 6, holders=((),) * 9,
)  # fmt: skip


def test_an_arc_that_is_asked_for_goes_where_limits_let_it() -> None:
    """At the bound itself where that is the tightest; with the constraint at its limit where that is tighter."""
    up = LIMITS.with_arc(STRUCTURE, 0, 3, (2.5, 3.5), UP)
    assert up.times == (0.0, 2.0, 2.5, 3.5, 4.0) and up.kinds[2] == (UP, *STRUCTURE.kinds[1][1:])
    held = LIMITS.with_arc(STRUCTURE, 0, 4, (3.5, 4.0), UP)
    assert held.kinds[-1][0] is SING and held.kinds[-1][2 + 5] is UP and held.kinds[-1][2] is FREE
    free = LIMITS.with_arc(STRUCTURE, 1, 4, (3.5, 4.0), FREE)
    assert free.kinds[-1] == (LOW, FREE, *(FREE,) * 7)


@pytest.mark.parametrize(("kind", "upward"), [(LOW, True), (UP, False)])
def test_a_constraint_that_is_left_sends_its_control_to_the_other_side(kind: ArcKind, upward: bool) -> None:
    """-3 w at its lower limit holds w up; left, w goes down, to its bound of -1; and the other way, to -3 w = -3."""
    pieces = [list(piece) for piece in STRUCTURE.kinds]
    for piece in pieces:
        piece[1], piece[2 + 3] = SING, kind
    structure = PhaseStructure(STRUCTURE.times, tuple(tuple(p) for p in pieces), (), 2, 6)
    found = LIMITS.with_arc(structure, 2 + 3, 1, (0.5, 1.5), FREE)
    here = found.kinds[1]
    assert found.times == (0.0, 0.5, 1.5, 2.0, 4.0)
    assert (here[1], here[2 + 3]) == ((LOW, FREE) if upward else (SING, LOW))
