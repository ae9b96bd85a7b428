"""What is told of figures: which of several counts, and when it passes, fails or cannot be told."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from testing import constructed_solutions as by_hand

import gnc_opt as go
from gnc_opt.planning import ConditionResult
from gnc_opt.planning.optimality.accessory import fine_times
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.verification import (
    bang_bang_second_order as second_order,
)
from gnc_opt.planning.verification import (
    reduced_hessian,
)
from gnc_opt.planning.verification import (
    singular_arcs as singular,
)
from gnc_opt.planning.verification.bang_bang_second_order import SecondOrder
from gnc_opt.planning.verification.reduced_hessian import Curvature
from gnc_opt.planning.verification.singular_arcs import SingularArc

PASS, FAIL, UNTOLD = ConditionResult.PASS, ConditionResult.FAIL, ConditionResult.INCONCLUSIVE


# --- singular arcs ----------------------------------------------------------------------------------------

GOOD, WEAK, BAD = SingularArc("good", 1, 0.5), SingularArc("weak", 2, 0.25), SingularArc("bad", 1, -0.5)
GOH, UNKNOWN, FLAT = (
    SingularArc("goh", 0, -0.75),
    SingularArc("unknown", 0, 0.0, "why"),
    SingularArc("flat", 1, 1e-7),
)


@pytest.mark.parametrize(
    ("arcs", "result", "value", "where"),
    [
        ([GOOD], PASS, -0.5, "good: order 1"),
        ([GOOD, WEAK], PASS, -0.25, "weak: order 2"),
        ([BAD, GOOD, UNKNOWN], FAIL, 0.5, "bad: order 1"),
        ([UNKNOWN, GOH, BAD], FAIL, 0.75, "goh: Goh's condition"),
        ([GOOD, UNKNOWN], UNTOLD, 0.0, "unknown: why"),
        ([UNKNOWN, FLAT], UNTOLD, 0.0, "unknown: why"),
        ([GOOD, FLAT], UNTOLD, -1e-7, "flat: order 1"),
    ],
)
def test_which_singular_arc_counts(
    arcs: list[SingularArc], result: ConditionResult, value: float, where: str
) -> None:
    """One that fails before one of which nothing is told, before the least; whatever their order."""
    for given in (arcs, arcs[::-1]):
        condition = singular.generalised_legendre_clebsch(given, 1e-5)
        assert (condition.result, condition.where, condition.tolerance) == (result, where, -1e-5)
        assert condition.value == pytest.approx(value) and condition.sufficient


# --- the induced problem ----------------------------------------------------------------------------------


def found(least: float, error: float = 1e-8, attained: bool = True, **changes: Any) -> SecondOrder:
    return replace(SecondOrder(1e-7, 1e-9, "here", least, error, 2, attained), **changes)


@pytest.mark.parametrize(
    ("least", "attained", "result"),
    [
        (2e-8, True, PASS),
        (5e-9, True, UNTOLD),
        (-5e-9, True, UNTOLD),
        (-2e-8, True, FAIL),
        (-2e-8, False, UNTOLD),
    ],
)
def test_result_of_one_order(least: float, attained: bool, result: ConditionResult) -> None:
    assert found(least, attained=attained).result is result


def of_orders(monkeypatch: pytest.MonkeyPatch, *orders: SecondOrder) -> list[go.Condition]:
    """The conditions for what is found for each order of the switches of phase "leg"."""
    left = iter(orders)
    switches = SimpleNamespace(n_orders=len(orders), orders=lambda: iter([()] * len(orders)))
    monkeypatch.setattr(second_order, "obstacle", lambda samples: "")
    monkeypatch.setattr(second_order, "Switches", SimpleNamespace(of=lambda s: switches))
    monkeypatch.setattr(second_order, "Unknowns", SimpleNamespace(of=lambda *given: None))
    monkeypatch.setattr(second_order, "_judge", lambda *given: next(left))
    samples: Any = [SimpleNamespace(leg=SimpleNamespace(name="leg"))]
    nothing: Any = None
    return second_order.second_order(nothing, samples, nothing, 1e-6)


@pytest.mark.parametrize(
    ("violation", "error", "result"),
    [
        (9e-7, 1e-9, PASS),
        (1e-6, 0.0, PASS),
        (1.05e-6, 1e-7, UNTOLD),
        (1.2e-6, 1e-7, FAIL),
        (np.nan, 1e-7, FAIL),
    ],
)
def test_gradient_within_its_tolerance_and_error(
    monkeypatch: pytest.MonkeyPatch, violation: float, error: float, result: ConditionResult
) -> None:
    """The worst of all orders counts."""
    other, off = found(1.0), found(1.0, violation=violation, violation_error=error, where="there")
    for orders in ((other, off), (off, other)):
        gradient, second = of_orders(monkeypatch, *orders)
        assert (gradient.name, gradient.result, gradient.where) == ("induced gradient", result, "there")
        np.testing.assert_equal(gradient.value, violation)
        assert gradient.tolerance == 1e-6 and gradient.sufficient and second.result is PASS


@pytest.mark.parametrize(
    ("orders", "result", "value", "tolerance", "where"),
    [
        ([found(0.5)], PASS, -0.5, -1e-8, "2 degrees of freedom"),
        (
            [found(0.5), found(0.3)],
            PASS,
            -0.3,
            -1e-8,
            "2 degrees of freedom, 2 orders of simultaneous switches",
        ),
        ([found(-9.0, attained=False), found(-0.3)], FAIL, 0.3, -1e-8, "2 orders of simultaneous switches"),
        ([found(0.5, 0.49), found(0.3)], PASS, -0.5, -0.49, "2 orders of simultaneous switches"),
        (
            [found(-9.0, attained=False)],
            UNTOLD,
            9.0,
            -1e-8,
            "freedom: negative, but beyond one-sided conditions",
        ),
        ([found(5e-9)], UNTOLD, -5e-9, -1e-8, "freedom: no curvature beyond its error"),
        ([found(np.inf, 0.0, freedom=0)], PASS, 0.0, 0.0, "nothing is left to vary"),
    ],
)
def test_curvature_of_the_worst_order(
    monkeypatch: pytest.MonkeyPatch,
    orders: list[SecondOrder],
    result: ConditionResult,
    value: float,
    tolerance: float,
    where: str,
) -> None:
    for given in (orders, orders[::-1]):
        second = of_orders(monkeypatch, *given)[1]
        assert (second.name, second.result, second.sufficient) == ("second order", result, True)
        assert (second.value, second.tolerance) == pytest.approx((value, tolerance))
        assert second.where.startswith("phase leg: ") and second.where.endswith(where)


def test_too_many_orders_are_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(of_orders(monkeypatch, *[found(1.0)] * 120)) == 2
    (condition,) = of_orders(monkeypatch, *[found(1.0)] * 121)
    assert condition.name == "second order" and condition.result is UNTOLD and condition.sufficient
    assert condition.where.startswith("more than 120 orders") and condition.tolerance == 0.0
    assert np.isnan(condition.value) and condition.meaning.startswith("The Hessian")


# --- on the mesh ------------------------------------------------------------------------------------------


def curved(value: float, share: float = 0.5, gain: float = 3.0) -> Curvature:
    return Curvature(value, np.sign(value) * share, np.ones(1), gain)


NOTHING = Curvature(np.nan, np.nan, np.zeros(1), 0.0)


@pytest.mark.parametrize(
    ("free", "bound", "admitted", "jumps", "result", "value", "words"),
    [
        (curved(2e-6), None, (), "", PASS, -2e-6, "place"),
        (curved(2e-6), None, (), "jumps", UNTOLD, -2e-6, "jumps"),
        (NOTHING, None, (), "", PASS, 0.0, "nothing is left to vary"),
        (NOTHING, None, (), "jumps", UNTOLD, 0.0, "jumps"),
        (curved(-2e-4), None, (1.0,), "", FAIL, 2e-4, "a step of 10 % of its magnitude gains 3 in"),
        (curved(-2e-4), None, (-1.0,), "jumps", FAIL, 2e-4, "a step of 10 % of its magnitude gains 3 in"),
        (curved(-2e-4), None, (), "", UNTOLD, 2e-4, "limits that are only just active"),
        (curved(-5e-5), None, (1.0,), "", UNTOLD, 5e-5, "flat"),
        (curved(-2e-4, 1e-7), None, (1.0,), "", UNTOLD, 2e-4, "flat"),
        (curved(5e-7), None, (1.0,), "", UNTOLD, -5e-7, "flat"),
        (
            replace(curved(-2e-4), least_gain=3.1),
            None,
            (1.0,),
            "",
            UNTOLD,
            2e-4,
            "which is rounding",
        ),
        (replace(curved(-2e-4), least_gain=2.9), None, (1.0,), "", FAIL, 2e-4, "gains 3 in the cost"),
        (curved(-2e-4), curved(-3e-4), (2.0,), "", FAIL, 3e-4, "gains"),
        (curved(-2e-4), curved(2e-4), (2.0,), "", UNTOLD, 2e-4, "only just active"),
    ],
)
def test_curvature_on_the_mesh(
    monkeypatch: pytest.MonkeyPatch,
    free: Curvature,
    bound: Curvature | None,
    admitted: tuple[float, ...],
    jumps: str,
    result: ConditionResult,
    value: float,
    words: str,
) -> None:
    """Directions to one side or the other may be admitted, those with weak limits held (``2``) as well."""
    if bound is not None:
        bound = replace(bound, direction=np.full(1, 2.0))
    strong, weak = np.array([True, False]), np.array([False, bound is not None])
    cone: Any = SimpleNamespace(
        point=None,
        unit=None,
        further=None,
        strong=strong,
        weak=weak,
        admits=lambda direction, samples: direction[0] in admitted,
    )

    def least(point: Any, held: Any, unit: Any, further: Any) -> Curvature:
        assert held[0] and (bound is not None or not held[1])
        return free if not held[1] or bound is None else bound

    monkeypatch.setattr(reduced_hessian, "least_curvature", least)
    monkeypatch.setattr(reduced_hessian, "_place", lambda *given: "place")
    monkeypatch.setattr(reduced_hessian, "_jumping_control", lambda samples: jumps)
    solution: Any = SimpleNamespace(structure=())
    condition = reduced_hessian.reduced_hessian(solution, [], cone)
    assert condition.result is result and condition.sufficient and condition.name == "second order"
    assert condition.value == pytest.approx(value) and words in condition.where
    assert condition.tolerance == (0.0 if free is NOTHING else -1e-6)
    if jumps:  # switch times that are variables of the mesh do vary
        solution.structure = ("arcs",)
        told = reduced_hessian.reduced_hessian(solution, [], cone)
        assert told.result is (FAIL if result is FAIL else PASS) and "jumps" not in told.where


def test_singular_controls_need_more_curvature(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of several phases with such a control is enough."""
    monkeypatch.setattr(reduced_hessian, "least_curvature", lambda *given: curved(-5e-3))
    monkeypatch.setattr(reduced_hessian, "_place", lambda *given: "place")
    monkeypatch.setattr(reduced_hessian, "_jumping_control", lambda samples: "")
    cone: Any = SimpleNamespace(
        point=None,
        unit=None,
        further=None,
        strong=None,
        weak=np.zeros(1),
        admits=lambda *given: True,
    )
    solution: Any = SimpleNamespace(structure=())
    samples: Any = [False, True]
    monkeypatch.setattr(reduced_hessian, "_partly_singular", lambda s: s)
    monkeypatch.setattr(reduced_hessian, "open_end", lambda cone, s: ("", np.inf))
    assert reduced_hessian.reduced_hessian(solution, samples, cone).result is UNTOLD
    assert reduced_hessian.reduced_hessian(solution, samples[:1], cone).result is FAIL


def resting(duration: float = 2.0, start: float = 1.0) -> PhaseSamples:
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("integrator")
    leg = problem.phase("leg", model)
    leg.time(start, start + duration)
    problem.minimize(leg.integral(u**2))
    flat = lambda t, k: np.array([1 + 0 * t])  # noqa: E731
    breaks = start + duration * np.array([0.0, 0.25, 1.0])
    return by_hand.samples(problem, flat, flat, flat, weights=(1.0,), breaks=breaks)


def test_steps_of_the_system() -> None:
    """300 over the phase and 4 more in every segment, at the breaks too."""
    times = fine_times(resting().leg, 300, 4)
    assert times.size == 75 + 4 + 225 + 4 + 1
    np.testing.assert_allclose(times[[0, 79, -1]], [1.0, 1.5, 3.0])
    np.testing.assert_allclose(np.diff(times)[[0, 78, 79]], [0.5 / 79, 0.5 / 79, 1.5 / 229])


# --- the verdict ------------------------------------------------------------------------------------------


def test_what_keeps_a_verdict_open() -> None:
    """Those that fail, then necessary ones that are not told; what only suffices may stay untold."""
    conditions = [
        go.Condition(f"{result.name} {sufficient}", result, 0.0, 0.0, "", "", sufficient)
        for sufficient in (True, False)
        for result in (UNTOLD, FAIL, PASS)
    ]
    verdict = go.Verdict("name", tuple(conditions))
    assert [c.name for c in verdict.open] == ["FAIL True", "FAIL False", "INCONCLUSIVE False"]
    assert [c.name for c in verdict.failed] == ["FAIL True", "FAIL False"]
    assert [c.name for c in verdict.inconclusive] == ["INCONCLUSIVE True", "INCONCLUSIVE False"]
    assert go.Verdict("name", tuple(conditions[::3])).open == (conditions[3],)
