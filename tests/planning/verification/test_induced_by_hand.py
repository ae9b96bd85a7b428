"""How an induced problem of known numbers is judged: gradients, multipliers, directions, curvature and their errors."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from testing import constructed_solutions as by_hand

import gnc_opt as go
from gnc_opt.planning import ConditionResult
from gnc_opt.planning.optimality.switching_problem import Conditions
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.verification import bang_bang_second_order as second_order
from gnc_opt.planning.verification.bang_bang_second_order import EXACT, SecondOrder, obstacle

Array = NDArray[np.float64]
NONE = np.zeros((0, 3))


def conditions(rows: Any, *, lower: Any = None, upper: Any = None, multipliers: Any = None) -> Conditions:
    """Rows whose values are zero; limits are far away unless given."""
    jacobian = np.asarray(rows, dtype=float).reshape(-1, 3)
    k = len(jacobian)
    low = np.full(k, -9.0) if lower is None else np.asarray(lower, float)
    up = np.full(k, 9.0) if upper is None else np.asarray(upper, float)
    nu = np.zeros(k) if multipliers is None else np.asarray(multipliers, float)
    return Conditions(
        tuple(f"row {i}" for i in range(k)), np.zeros(k), Interval(low, up), jacobian, nu, np.ones(k)
    )


def judged(
    monkeypatch: pytest.MonkeyPatch,
    gradient: Any,
    hessian: Any,
    rows: Conditions | None = None,
    *,
    coarse: Any = None,
    coarse_rows: Conditions | None = None,
    coarse_hessian: Any = None,
    precedences: Any = NONE,
    free: Any = (True, True, True),
    worth: Any = (1.0, 2.0, 4.0),
    scales: tuple[float, ...] = (1.0, 3.0),
    seen: list[Array] | None = None,
) -> SecondOrder:
    """Three unknowns a, b and c, worth 1, 2 and 4, phases whose costs are worth 1 and 3, Hessian terms of size 2."""
    rows = conditions([]) if rows is None else rows
    unknowns: Any = SimpleNamespace(
        free=np.array(free), worth=np.array(worth), labels=("a", "b", "c"), scale=np.ones(3)
    )
    curved = {1: hessian if coarse_hessian is None else coarse_hessian, 2: hessian}
    slopes = {1: gradient if coarse is None else coarse, 2: gradient}
    about = {1: rows if coarse_rows is None else coarse_rows, 2: rows}

    def of(solution: Any, samples: Any, ends: Any, unknowns: Any, pieces: Any, n: int) -> Any:
        def curvature(multipliers: Array) -> tuple[Array, float]:
            if seen is not None:
                seen.append(multipliers)
            return np.asarray(curved[n], float), 2.0 if n == 2 else 999.0

        return SimpleNamespace(
            unknowns=unknowns,
            gradient=np.asarray(slopes[n], float),
            conditions=about[n],
            hessian=curvature,
            finite=True,
        )

    monkeypatch.setattr(second_order, "InducedProblem", SimpleNamespace(of=of))
    monkeypatch.setattr(second_order, "_precedences", lambda *given: np.asarray(precedences, float))
    samples: Any = [SimpleNamespace(cost_scale=s) for s in scales]
    none: Any = None
    return second_order._judge(none, samples, none, unknowns, {}, {})


SIZE = 2.0 + 4.0 + 3.0
"""Of the Hessian's terms, of the largest worth and of the dearest phase."""


def test_least_curvature_in_shares_of_its_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    hessian = np.diag([5.0, -0.9, 7.0])
    found = judged(monkeypatch, np.zeros(3), hessian)
    assert found.least == pytest.approx(-0.9 / SIZE) and found.error == pytest.approx(EXACT)
    assert (found.violation, found.freedom, found.attained) == (0.0, 3, True)
    given = judged(monkeypatch, np.zeros(3), hessian, free=(True, False, True))
    assert given.least == pytest.approx(5.0 / SIZE) and given.freedom == 2
    other = judged(monkeypatch, np.zeros(3), hessian, scales=(3.0, 1.0))
    assert other.least == found.least


def test_the_largest_worth_is_that_of_what_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    found = judged(monkeypatch, np.zeros(3), np.eye(3), free=(True, True, False))
    assert found.least == pytest.approx(1.0 / (2.0 + 2.0 + 3.0))


def test_curvature_is_extrapolated_and_its_error_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half the step leaves a sixteenth of the error."""
    fine, coarse = np.diag([1.0, 2.0, 3.0]), np.diag([0.7, 2.4, 3.0])
    found = judged(monkeypatch, np.zeros(3), fine, coarse_hessian=coarse)
    assert found.least == pytest.approx((1.0 + 0.3 / 255) / SIZE)
    assert found.error == pytest.approx(0.5 / 255 / SIZE + EXACT)
    lopsided = np.array([[1.0, 0.8, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 9.0]])
    assert judged(monkeypatch, np.zeros(3), lopsided).least == pytest.approx(0.6 / SIZE)


def test_gradient_in_shares_of_what_each_unknown_is_worth(monkeypatch: pytest.MonkeyPatch) -> None:
    found = judged(monkeypatch, [0.1, -0.3, 0.2], np.eye(3))
    assert found.violation == pytest.approx(0.15) and found.where == "b"
    assert found.error == pytest.approx(EXACT + 0.15) and found.violation_error == 0.0
    given = judged(monkeypatch, [0.1, -0.3, 0.4], np.eye(3), free=(True, False, True))
    assert given.violation == pytest.approx(0.1) and given.where in ("a", "c")


def test_gradient_is_extrapolated_and_its_error_told(monkeypatch: pytest.MonkeyPatch) -> None:
    found = judged(monkeypatch, [0.0, 0.0, 0.8], np.eye(3), coarse=[0.0, 0.0, 0.2])
    assert found.violation == pytest.approx((0.8 + 0.6 / 255) / 4.0) and found.where == "c"
    assert found.violation_error == pytest.approx(0.6 / 255 / 4.0)


@pytest.mark.parametrize(
    ("sides", "slope", "violation", "freedom"),
    [
        ((0.0, 9.0), 2.0, 0.0, 2),  # at the lower limit a multiplier of -2 is right,
        ((0.0, 9.0), -2.0, 2.0 / 7.0, 2),  # +2 is not,
        ((-9.0, 0.0), -2.0, 0.0, 2),  # at the upper one conversely,
        ((-9.0, 0.0), 2.0, 2.0 / 7.0, 2),
        ((0.0, 0.0), 2.0, 0.0, 2),  # and a given value takes both.
        ((0.0, 0.0), -2.0, 0.0, 2),
        ((-9.0, 9.0), 2.0, 2.0, 3),  # Far from limits it explains nothing.
    ],
)
def test_multipliers_have_the_sign_of_their_limit(
    monkeypatch: pytest.MonkeyPatch, sides: tuple[float, float], slope: float, violation: float, freedom: int
) -> None:
    """L = cost + multiplier * row: the row is a itself, so that the multiplier is the slope reversed."""
    rows = conditions([[1.0, 0.0, 0.0]], lower=sides[:1], upper=sides[1:])
    found = judged(monkeypatch, [slope, 0.0, 0.0], np.diag([-9.0, 1.0, 2.0]), rows)
    assert found.violation == pytest.approx(violation) and found.freedom == freedom
    assert found.least == pytest.approx((1.0 if freedom == 2 else -9.0) / SIZE)
    if violation:
        assert found.where == ("row 0" if freedom == 2 else "a")


def test_the_hessian_is_that_with_these_multipliers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of rows as they are, not of those of unit length; zero where a row is not active."""
    seen: list[Array] = []
    rows = conditions(
        [[0.0, 7.0, 0.0], [3.0, 0.0, 4.0]], lower=[-9.0, 0.0], upper=[9.0, 0.0], multipliers=[5.0, 0.1]
    )
    judged(monkeypatch, [6.0, 0.0, 8.0], np.eye(3), rows, seen=seen)
    for given in seen:
        np.testing.assert_allclose(given, [0.0, -2.0], atol=1e-12)
    assert len(seen) == 2


def test_error_of_the_gradient_with_that_of_the_conditions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Multiplier -2 of a row that differs by (0, 0.3, 0) between the grids, and a gradient that does by 0.1."""
    fine = conditions([[1.0, 0.0, 0.0]], lower=[0.0], upper=[0.0])
    coarse = conditions([[1.0, -0.3, 0.0]], lower=[0.0], upper=[0.0])
    found = judged(monkeypatch, [2.0, 0.1, 0.0], np.eye(3), fine, coarse=[2.0, 0.0, 0.0], coarse_rows=coarse)
    jacobian = np.array([1.0, 0.3 / 255, 0.0])
    gradient = np.array([2.0, 0.1 + 0.1 / 255, 0.0])
    multiplier = -gradient @ jacobian / (jacobian @ jacobian)
    left = gradient + multiplier * jacobian
    assert found.violation == pytest.approx(np.max(np.abs(left) / [1.0, 2.0, 4.0]), rel=1e-9)
    assert found.violation_error == pytest.approx(abs(0.1 + multiplier * 0.3) / 255 / 2.0, rel=1e-9)


@pytest.mark.parametrize(("tilt", "attained"), [(0.0, True), (1.0, True), (-1.0, True)])
def test_a_limit_without_a_multiplier_holds_one_side(
    monkeypatch: pytest.MonkeyPatch, tilt: float, attained: bool
) -> None:
    """One such limit forbids no line: the direction of least curvature or its opposite keeps it."""
    rows = conditions([[tilt, 1.0, 0.0]], lower=[0.0], upper=[9.0])
    found = judged(monkeypatch, np.zeros(3), np.diag([-1.0, 2.0, 3.0]), rows)
    assert found.freedom == 3 and found.least == pytest.approx(-1.0 / SIZE)
    assert found.attained is attained


@pytest.mark.parametrize(
    ("rows", "lower", "attained"),
    [
        ([[1.0, 0.5, 0.0], [1.0, 0.0, 0.5]], [0.0, 0.0], True),
        ([[1.0, 0.5, 0.0], [-1.0, 0.0, 0.5]], [0.0, 0.0], False),
        ([[1.0, 0.5, 0.0], [-1.0, 0.0, 0.5]], [0.0, -9.0], True),
        ([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0, 0.0], True),
    ],
)
def test_two_limits_without_multipliers_may_forbid_both_ways(
    monkeypatch: pytest.MonkeyPatch, rows: Any, lower: list[float], attained: bool
) -> None:
    """The direction is a: both rows grow along it, or one does and the other one falls; one of them at its upper."""
    upper = [9.0 if value == 0.0 else 0.0 for value in lower]
    found = judged(
        monkeypatch, np.zeros(3), np.diag([-1.0, 2.0, 3.0]), conditions(rows, lower=lower, upper=upper)
    )
    assert found.attained is attained
    assert found.result is (ConditionResult.FAIL if attained else ConditionResult.INCONCLUSIVE)


@pytest.mark.parametrize(("push", "freedom"), [(2e-5, 2), (1e-6, 3)])
def test_a_multiplier_counts_in_shares_of_the_cost(
    monkeypatch: pytest.MonkeyPatch, push: float, freedom: int
) -> None:
    """From a millionth of 7 on its limit holds directions; an equality does in any case."""
    rows = conditions([[1.0, 0.0, 0.0]], lower=[0.0], upper=[9.0])
    assert judged(monkeypatch, [push, 0.0, 0.0], np.eye(3), rows).freedom == freedom
    equal = conditions([[1.0, 0.0, 0.0]], lower=[0.0], upper=[0.0])
    assert judged(monkeypatch, np.zeros(3), np.eye(3), equal).freedom == 2


@pytest.mark.parametrize(("push", "freedom"), [(2e-5, 2), (1e-6, 3)])
def test_orders_of_simultaneous_switches_push_too(
    monkeypatch: pytest.MonkeyPatch, push: float, freedom: int
) -> None:
    """b must not come before a: what the cost gains from that the order explains, and then holds."""
    order = np.array([[-1.0, 1.0, 0.0]])
    found = judged(monkeypatch, [-push, push, 0.0], np.diag([1.0, 1.0, 9.0]), precedences=order)
    assert found.violation == pytest.approx(0.0, abs=1e-12) and found.freedom == freedom
    wrong = judged(monkeypatch, [push, -push, 0.0], np.eye(3), precedences=order)
    assert wrong.violation == pytest.approx(push) and wrong.where == "a"
    two = np.array([[-1.0, 1.0, 0.0], [1.0, 0.0, 1.0]])
    least = np.diag([-1.0, 1.0, 1.0])
    assert not judged(monkeypatch, np.zeros(3), least, precedences=two).attained
    assert judged(monkeypatch, np.zeros(3), least, precedences=order).attained


def test_nothing_is_left_to_vary(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = conditions(np.eye(3), lower=np.zeros(3), upper=np.zeros(3))
    found = judged(monkeypatch, [2.0, -4.0, 1.0], -np.eye(3), rows)
    assert (found.freedom, found.least, found.error, found.attained) == (0, np.inf, 0.0, True)
    assert found.violation == pytest.approx(0.0, abs=1e-12)


# --- what forbids it --------------------------------------------------------------------------------------


def cart() -> go.Problem:
    problem = by_hand.cart()
    problem.get_phase().bounds(a=(-1.0, 1.0))
    return problem


def bang(**changes: Any) -> PhaseSamples:
    """One arc of a = 1 from rest; lam = (-1, t - 1), path "pure" of q."""
    box = by_hand.interval(-1.0, 1.0)
    return by_hand.samples(
        cart(),
        lambda t, k: np.array([t**2 / 2, t]),
        lambda t, k: np.array([1 + 0 * t]),
        lambda t, k: np.array([-1 + 0 * t, t - 1]),
        **({"control_bounds": box} | changes),
    )


def test_an_obstacle_needs_a_multiplier_that_counts() -> None:
    """A millionth of H for paths; a ten-thousandth of the cost for states over the phase's length."""
    base = bang()
    assert obstacle([base]) == ""
    least = 1e-6 * base.hamiltonian_scale
    for factor, told in ((0.9, False), (1.1, True)):
        for sign in (1.0, -1.0):
            pushed = bang(paths=lambda t, k, m=sign * factor * least: np.array([0 * t, m + 0 * t]))
            assert obstacle([base, pushed]) == ("phase leg: an active path constraint" if told else "")
    span = 1e-4 * base.cost_scale / base.leg.duration
    for factor, told in ((0.9, False), (1.1, True)):
        for i in (0, 1):
            rows = np.zeros((2, 1))
            rows[i] = factor * span / base.state_scale[i]
            pushed = bang(states=lambda t, k, m=rows: m + 0 * t)
            assert obstacle([pushed]) == ("phase leg: an active state bound" if told else "")


def test_a_control_between_its_bounds_is_an_obstacle_at_its_first_sample() -> None:
    inside = bang(control_bounds=by_hand.interval(-1.0, 2.0))
    assert obstacle([inside]) == "phase leg, t = 0 s, a: a control between its bounds"
    assert not second_order.is_bang_bang([bang(), inside]) and second_order.is_bang_bang([bang()])
    assert not second_order.is_bang_bang([])
    vanished = replace(bang().leg, final_time=0.0, final_time_bounds=by_hand.interval(0.0, 0.0))
    none = PhaseSamples.of(vanished, bang().functions)
    assert obstacle([none]) == "phase leg has no length"


@pytest.mark.parametrize(("rate", "told"), [(3e2, ConditionResult.PASS), (1e4, ConditionResult.INCONCLUSIVE)])
def test_dynamics_that_are_fast_for_the_steps_are_resolved_or_not_judged(
    rate: float, told: ConditionResult
) -> None:
    """A filter beside a bang-bang move: explicit steps must be shorter than a few of its time constants."""
    cart = go.Model("cart with a filter")
    q, v, w, a = cart.state("q"), cart.state("v"), cart.state("w"), cart.control("a")
    cart.ode({q: v, v: a, w: rate * (q - w)})
    problem = go.Problem("filtered")
    leg = problem.phase("leg", cart)
    leg.time(0.0, (0.1, 10.0))
    leg.initial(q=1.0, v=0.0, w=1.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    verdict = go.verify(go.solve(problem))
    assert verdict["dynamics"].result is ConditionResult.PASS
    assert {verdict[name].result for name in ("second order", "second order")} == {told}
    if told is ConditionResult.INCONCLUSIVE:
        assert "too fast" in verdict["second order"].where
