"""The verdict's figure shows every condition with its outcome."""

from __future__ import annotations

from gnc_opt.plot import plot_verdict
from gnc_opt.verify import Condition, Result, Verdict


def test_every_condition_has_a_row_and_the_tolerance_a_line() -> None:
    conditions = tuple(
        Condition(name, result, value, 1e-5, "somewhere", "a meaning")
        for name, result, value in (
            ("dynamics", Result.PASS, 0.0),
            ("bounds", Result.FAIL, 0.3),
            ("singular arcs", Result.CANNOT_TELL, float("nan")),
        )
    )
    figure = plot_verdict(Verdict("toy", conditions))
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["dynamics", "bounds", "singular arcs"]
    handles, labels = axes.get_legend_handles_labels()
    assert labels == ["PASS (1)", "FAIL (1)", "CANNOT TELL (1)", "tolerance 1e-05"] and len(handles) == 4
    assert "dimensionless" in axes.get_xlabel()
    assert "NOT ok" in axes.get_title()
