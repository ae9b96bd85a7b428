"""What is told of figures: which of several counts, and when it passes, fails or cannot be told."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.planning import ConditionResult
from gnc_opt.planning.verification import optimality_check, reduced_hessian
from gnc_opt.planning.verification import singular_arcs as singular
from gnc_opt.planning.verification.reduced_hessian import Curvature
from gnc_opt.planning.verification.singular_arcs import SingularArc

PASS, FAIL, UNTOLD = ConditionResult.PASS, ConditionResult.FAIL, ConditionResult.INCONCLUSIVE


# --- singular arcs ----------------------------------------------------------------------------------------

GOOD, WEAK, BAD = SingularArc("good", 1, 0.5), SingularArc("weak", 2, 0.25), SingularArc("bad", 1, -0.5)
GOH, UNKNOWN, FLAT = (
    SingularArc("goh", 0, -0.75), SingularArc("unknown", 0, 0.0, "why"), SingularArc("flat", 1, 1e-7),
)  # fmt: skip


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
        condition = singular.check_generalised_legendre_clebsch(given, 1e-5)
        assert (condition.result, condition.where, condition.tolerance) == (result, where, -1e-5)
        assert condition.value == pytest.approx(value) and condition.sufficient


# --- on the mesh ------------------------------------------------------------------------------------------


def curved(value: float, share: float = 0.5, gain: float = 3.0) -> Curvature:
    return Curvature(value, np.sign(value) * share, np.ones(1), gain)


NOTHING = Curvature(np.nan, np.nan, np.zeros(1), 0.0)


@pytest.mark.parametrize(
    ("free", "bound", "admitted", "jumps", "result", "value", "words"),
    [
        (curved(2e-6), None, (), "", PASS, -2e-6, "place"),
        (curved(2e-6), None, (), "jumps", UNTOLD, -2e-6, "jumps"),
        (NOTHING, None, (), "", PASS, 0.0, "no degree of freedom"),
        (NOTHING, None, (), "jumps", UNTOLD, 0.0, "jumps"),
        (curved(-2e-4), None, (1.0,), "", FAIL, 2e-4, "10 % of the magnitudes lowers the cost by 3"),
        (curved(-2e-4), None, (-1.0,), "jumps", FAIL, 2e-4, "10 % of the magnitudes lowers the cost by 3"),
        (curved(-2e-4), None, (), "", UNTOLD, 2e-4, "limits may exclude this variation"),
        (curved(-5e-5), None, (1.0,), "", UNTOLD, 5e-5, "cannot be distinguished from zero"),
        (curved(-2e-4, 1e-7), None, (1.0,), "", UNTOLD, 2e-4, "cannot be distinguished from zero"),
        (curved(5e-7), None, (1.0,), "", UNTOLD, -5e-7, "cannot be distinguished from zero"),
        (replace(curved(-2e-4), least_gain=3.1), None, (1.0,), "", UNTOLD, 2e-4, "which is within rounding"),
        (replace(curved(-2e-4), least_gain=2.9), None, (1.0,), "", FAIL, 2e-4, "lowers the cost by 3"),
        (curved(-2e-4), curved(-3e-4), (2.0,), "", FAIL, 3e-4, "lowers the cost"),
        (curved(-2e-4), curved(2e-4), (2.0,), "", UNTOLD, 2e-4, "limits may exclude"),
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
        point=None, unit=None, further=None, strong=strong, weak=weak,
        admits_direction=lambda direction, samples: direction[0] in admitted,
    )  # fmt: skip

    def least(point: Any, held: Any, unit: Any, further: Any) -> Curvature:
        assert held[0] and (bound is not None or not held[1])
        return free if not held[1] or bound is None else bound

    monkeypatch.setattr(reduced_hessian, "minimise_curvature", least)
    monkeypatch.setattr(reduced_hessian, "_locate_direction", lambda *given: "place")
    monkeypatch.setattr(reduced_hessian, "_find_bang_bang_control", lambda samples: jumps)
    solution: Any = SimpleNamespace(structure=())
    condition = reduced_hessian.check_reduced_hessian(solution, [], cone)
    assert condition.result is result and condition.sufficient and condition.name == "second order"
    assert condition.value == pytest.approx(value) and words in condition.where
    assert condition.tolerance == (0.0 if free is NOTHING else -1e-6)
    if jumps:  # switch times that are variables of the mesh do vary
        solution.structure = ("arcs",)
        told = reduced_hessian.check_reduced_hessian(solution, [], cone)
        assert told.result is (FAIL if result is FAIL else PASS) and "jumps" not in told.where


def test_singular_controls_need_more_curvature(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of several phases with such a control is enough."""
    monkeypatch.setattr(reduced_hessian, "minimise_curvature", lambda *given: curved(-5e-3))
    monkeypatch.setattr(reduced_hessian, "_locate_direction", lambda *given: "place")
    monkeypatch.setattr(reduced_hessian, "_find_bang_bang_control", lambda samples: "")
    cone: Any = SimpleNamespace(
        point=None, unit=None, further=None, strong=None, weak=np.zeros(1),
        admits_direction=lambda *given: True,
    )  # fmt: skip
    solution: Any = SimpleNamespace(structure=())
    samples: Any = [False, True]
    monkeypatch.setattr(reduced_hessian, "_has_partly_singular_segment", lambda s: s)
    monkeypatch.setattr(reduced_hessian, "find_improving_final_control", lambda cone, s: ("", np.inf))
    assert reduced_hessian.check_reduced_hessian(solution, samples, cone).result is UNTOLD
    assert reduced_hessian.check_reduced_hessian(solution, samples[:1], cone).result is FAIL


# --- the verdict ------------------------------------------------------------------------------------------


def test_what_keeps_a_verdict_open() -> None:
    """Those that fail, then necessary ones that are not told; what only suffices may stay untold."""
    conditions = [
        go.Condition(f"{result.name} {sufficient}", result, 0.0, 0.0, "", "", sufficient)
        for sufficient in (True, False)
        for result in (UNTOLD, FAIL, PASS)
    ]
    verdict = go.Verdict("name", tuple(conditions))
    assert [c.name for c in verdict.open_conditions] == ["FAIL True", "FAIL False", "INCONCLUSIVE False"]
    assert [c.name for c in verdict.failed] == ["FAIL True", "FAIL False"]
    assert [c.name for c in verdict.inconclusive] == ["INCONCLUSIVE True", "INCONCLUSIVE False"]
    assert go.Verdict("name", tuple(conditions[::3])).open_conditions == (conditions[3],)


@pytest.mark.parametrize(
    ("structure", "bang", "loss", "results"),
    [
        ((), False, 1.0, (FAIL, PASS)),
        (("arc",), False, None, (FAIL, FAIL)),
        ((), True, 4e-7, (FAIL, FAIL)),
        ((), False, 2e-7, (UNTOLD, PASS)),  # no control gains more than the errors of the multipliers
    ],
)
def test_switches_of_arcs_and_curvature_with_a_gain_count(
    monkeypatch: pytest.MonkeyPatch,
    structure: tuple[str, ...],
    bang: bool,
    loss: float | None,
    results: tuple[ConditionResult, ...],
) -> None:
    def condition(name: str, result: ConditionResult) -> go.Condition:
        return go.Condition(name, result, 0.0, 0.0, "there", "meaning", sufficient=True)

    stubs = {
        "second_order_conditions": [condition("Legendre-Clebsch", FAIL)],
        "check_switching_times": condition("switching times", PASS),
    }
    for name, value in stubs.items():
        monkeypatch.setattr(optimality_check, name, lambda *_, value=value: value)
    theory: Any = optimality_check.second_order
    monkeypatch.setattr(theory, "is_bang_bang", lambda _: bang)
    monkeypatch.setattr(
        theory, "check_strict_bang_bang_property", lambda _: condition("strict switches", FAIL)
    )
    solution: Any = SimpleNamespace(structure=structure)
    nothing: Any = None
    scales: Any = SimpleNamespace(cost=1.0)
    found = optimality_check._check_second_order(solution, [], nothing, scales, 1e-5, loss)
    assert tuple(c.result for c in found) == results
