"""Short arcs beside limits that no trajectory has, on structures put together by hand: v' = a, |a| <= 1, |v| <= 1."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.planning import ArcKind
from gnc_opt.planning.optimality.state_constraints import StateConstraints
from gnc_opt.planning.refinement.arcs.control_oscillation import without_ringing
from gnc_opt.planning.refinement.arcs.structure import Kinds, PhaseStructure

LOW, FREE, UP, SING = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.SINGULAR


def speeding(rate: Callable[[Any, Any], Any] = lambda a, t: a, mesh: Any = "10x3") -> StateConstraints:
    """Of a speed with this rate, over 4 s."""
    model = go.Model("cart")
    v, a = model.state("v"), model.control("a")
    model.ode({v: rate(a, model.time)})
    problem = go.Problem("fast")
    leg = problem.phase("leg", model)
    leg.time(0.0, 4.0)
    leg.initial(v=0.0)
    leg.bounds(a=(-1.0, 1.0), v=(-1.0, 1.0))
    problem.minimize(leg.integral(a**2 - v, "cost"))
    solution = go.solve(problem, mesh=mesh, tol=None, throw=False)
    return StateConstraints(problem, solution.samples()["leg"])


@pytest.fixture(scope="module")
def cart() -> StateConstraints:
    """With segments of 0.4 s."""
    return speeding()


def of(times: tuple[float, ...], *kinds: tuple[ArcKind, ArcKind]) -> PhaseStructure:
    """The control, and the speed that it holds."""
    return PhaseStructure(times, kinds, n_controls=1, orders=(0, 1), holders=((), (0,)), leans=((), (1,)))


@pytest.mark.parametrize(("limit", "to", "away"), [(UP, UP, LOW), (LOW, LOW, UP)])
def test_a_short_bang_that_leads_beyond_the_limit_is_of_the_arc(
    cart: StateConstraints, limit: ArcKind, to: ArcKind, away: ArcKind
) -> None:
    fine: Kinds = ((to, FREE), (SING, limit), (away, FREE))
    times = (0.0, 1.0, 3.0, 4.0)
    kept = of(times, *fine)
    assert without_ringing(kept, cart, 1.0) == kept
    rings = of((0.0, 1.0, 1.2, 2.8, 3.0, 4.0), fine[0], (away, FREE), fine[1], (to, FREE), fine[2])
    assert without_ringing(rings, cart, 1.0) == kept
    assert without_ringing(rings, cart, 0.4) == rings, "long enough for this mesh to tell"


def test_an_arc_goes_on_where_it_is_left_with_the_control_on_no_bound(cart: StateConstraints) -> None:
    arc, free, bang = (SING, UP), (SING, FREE), (LOW, FREE)
    left = of((0.0, 1.0, 1.2, 3.0), arc, free, arc)
    assert without_ringing(left, cart, 1.0) == of((0.0, 3.0), arc)
    switched = of((0.0, 1.0, 1.2, 3.0), arc, free, bang)
    assert without_ringing(switched, cart, 1.0) == of((0.0, 1.2, 3.0), arc, bang)
    for real in (
        of((0.0, 1.0, 1.5, 3.0), arc, free, arc),
        of((0.0, 1.0, 1.5, 3.0), arc, free, bang),
        of((0.0, 0.2, 3.0), free, arc),
        of((0.0, 1.0, 1.2, 3.0), free, arc, free),
        of((0.0, 1.0, 1.2, 3.0), bang, (FREE, FREE), arc),
    ):
        assert without_ringing(real, cart, 1.0) == real


def test_two_limits_of_a_control_that_change_places_within_segments_do_it_once(
    cart: StateConstraints,
) -> None:
    own, path = (UP, FREE), (SING, UP)

    def structure(times: tuple[float, ...], *kinds: tuple[ArcKind, ArcKind]) -> PhaseStructure:
        return PhaseStructure(times, kinds, n_controls=1, n_paths=1, holders=((), (0,)), slopes=(0, 1))

    rings = structure((0.0, 1.0, 1.1, 1.3, 3.0), own, path, own, path)
    once = without_ringing(rings, cart, 1.0)
    assert once.kinds == (own, path)
    assert 1.0 <= once.times[1] <= 1.3
    real = structure((0.0, 1.0, 2.0, 3.0), own, path, own)
    assert without_ringing(real, cart, 1.0) == real


ARC, PUSH, BRAKE = (SING, UP), (UP, FREE), (LOW, FREE)
PUSHED_TWICE = of((0.0, 1.0, 1.2, 3.0, 4.0), ARC, PUSH, ARC, BRAKE)


@pytest.mark.parametrize(
    ("gain", "drift", "of_the_arc"), [(1.0, -0.98, False), (1.0, -0.5, True), (0.01, -0.5, True)]
)  # fmt: skip
def test_a_bang_leads_beyond_by_what_the_control_can_do(gain: float, drift: float, of_the_arc: bool) -> None:
    """After the arc that a flight begins with: full push against a drift, in shares of what the control does."""
    structure = of((0.0, 1.0, 1.2, 4.0), ARC, PUSH, BRAKE)
    found = without_ringing(structure, speeding(lambda a, t: gain * (a + drift)), 1.0)
    assert found == (of((0.0, 1.2, 4.0), ARC, BRAKE) if of_the_arc else structure)


def test_a_bang_that_leads_nowhere_between_two_arcs_is_no_gap() -> None:
    structure = of((0.0, 1.0, 1.2, 3.0), ARC, BRAKE, ARC)
    assert without_ringing(structure, speeding(lambda a, t: a + 1.0), 1.0) == structure


@pytest.mark.parametrize("turn", [1.05, 1.15])
def test_where_a_bang_leads_is_told_where_it_meets_the_arc(turn: float) -> None:
    """Beside 1.1 s the rate changes its sign: a bang that ends at 1.1 s, with an arc before and none after it."""
    structure = of((0.0, 1.1, 1.2, 4.0), ARC, PUSH, BRAKE)
    found = without_ringing(structure, speeding(lambda a, t: a * 10 * (t - turn)), 1.0)
    assert (found == structure) is (turn > 1.1)


@pytest.mark.parametrize("begin", [1.0, 2.1])
def test_short_is_what_segments_where_it_is_are_longer_than(begin: float) -> None:
    """Of 1 s until 2 s, of 0.1 s beyond: a gap of 0.2 s is real on the latter."""
    breaks = np.concatenate([[0.0, 1.0], np.linspace(2.0, 4.0, 21)]) / 4.0
    there = speeding(mesh=go.Mesh(tuple(breaks), (3,) * (breaks.size - 1)))
    gap = of((0.0, begin, begin + 0.2, 4.0), ARC, (SING, FREE), ARC)
    assert (without_ringing(gap, there, 1.0) == gap) is (begin > 2.0)


@pytest.mark.parametrize("other", [SING, LOW])
def test_of_two_controls_that_can_hold_a_limit_nothing_is_taken_away(
    cart: StateConstraints, other: ArcKind
) -> None:
    """An arc is left by both together, or by one beside another on its bound: which one holds it again is not known."""
    arc, free = (SING, other, UP), (SING, other, FREE)
    left = PhaseStructure(
        (0.0, 1.0, 1.2, 3.0), (arc, free, arc), n_controls=2, orders=(0, 0, 1), holders=((), (), (0, 1))
    )
    assert without_ringing(left, cart, 1.0) == left
