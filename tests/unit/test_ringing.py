"""Short arcs beside limits that no trajectory has, on structures put together by hand: v' = a, |a| <= 1, |v| <= 1."""

from __future__ import annotations

import pytest

import gnc_opt as go
from gnc_opt.problem.arc import ArcKind
from gnc_opt.refine.structure.phase_structure import Kinds, PhaseStructure
from gnc_opt.refine.structure.ringing import without_ringing
from gnc_opt.refine.structure.state_constraints import StateConstraints

LOW, FREE, UP, SING = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.SINGULAR


@pytest.fixture(scope="module")
def cart() -> StateConstraints:
    """With segments of 0.4 s."""
    model = go.Model("cart")
    v, a = model.state("v"), model.control("a")
    model.ode({v: a})
    problem = go.Problem("fast")
    leg = problem.phase("leg", model)
    leg.time(0.0, 4.0)
    leg.initial(v=0.0)
    leg.final(v=0.0)
    leg.bounds(a=(-1.0, 1.0), v=(-1.0, 1.0))
    problem.minimize(leg.integral(a**2 - v, "cost"))
    solution = go.solve(problem, mesh="10x3", tol=None)
    return StateConstraints(solution.need_problem("test"), solution.samples()["leg"])


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
    for real in (of((0.0, 1.0, 1.5, 3.0), arc, free, arc), of((0.0, 1.0, 1.2, 3.0), arc, free, bang)):
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
