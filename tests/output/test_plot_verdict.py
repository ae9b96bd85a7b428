"""The verdict's figure shows every condition with its outcome."""

from __future__ import annotations

import pytest
from testing.internals import _violation

from gnc_opt.planning import Condition, ConditionResult, Verdict
from gnc_opt.plot import plot_verdict


def test_every_condition_has_a_row_and_the_tolerance_a_line() -> None:
    conditions = tuple(
        Condition(name, result, value, 1e-5, "somewhere", "a meaning")
        for name, result, value in (
            ("dynamics", ConditionResult.PASS, 0.0),
            ("limits", ConditionResult.FAIL, 0.3),
            ("second order", ConditionResult.INCONCLUSIVE, float("nan")),
        )
    )
    figure = plot_verdict(Verdict("toy", conditions))
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["dynamics", "limits", "second order"]
    handles, labels = axes.get_legend_handles_labels()
    assert labels == ["PASS (1)", "FAIL (1)", "INCONCLUSIVE (1)", "tolerance"] and len(handles) == 4
    assert axes.get_xlabel() == "largest residual as a share of its tolerance"
    assert "NOT ok" in axes.get_title()


@pytest.mark.parametrize(
    ("value", "tolerance", "result", "drawn"),
    [
        (3e-5, 1e-5, ConditionResult.FAIL, 3.0),
        (2e-9, 1e-5, ConditionResult.PASS, 2e-4),
        (1e3, 1e4, ConditionResult.PASS, 0.1),  # a condition with a tolerance of its own
        (-0.4, -1e-6, ConditionResult.PASS, 1e-12),  # a margin that is there is no violation, however large
        (-0.4, 1e-5, ConditionResult.PASS, 1e-12),
        (2e-6, -1e-6, ConditionResult.FAIL, 3.0),  # one that is missing is
        (2e-5, 0.0, ConditionResult.FAIL, 2.0),
        (float("inf"), 1e-5, ConditionResult.FAIL, 1e12),
        (float("nan"), 1e-5, ConditionResult.INCONCLUSIVE, 1.0),
    ],
)
def test_violations_are_drawn_in_tolerances(
    value: float, tolerance: float, result: ConditionResult, drawn: float
) -> None:
    violation = _violation(Condition("one", result, value, tolerance, "somewhere", "a meaning"))
    assert violation == pytest.approx(drawn, rel=1e-12)
    assert (violation > 1.0) == (result is ConditionResult.FAIL)
