"""The verdict as a picture: how far each condition is from its tolerance."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from gnc_opt.plot.style import COLORS, QUIET, legend_on_top, new_figure, style
from gnc_opt.verify.verdict import Condition, Result, Verdict
from gnc_opt.verify.verify import TOLERANCE

_LOOKS = {
    Result.PASS: (COLORS[2], "o", "PASS"),
    Result.FAIL: (COLORS[1], "X", "FAIL"),
    Result.CANNOT_TELL: (COLORS[4], "D", "CANNOT TELL"),
}
_LEAST, _MOST = 1e-12, 1e12
"""Ends of the axis, in tolerances."""


def plot_verdict(verdict: Verdict) -> Figure:
    """Return a figure with one row per condition: its offence in shares of its tolerance on a logarithmic axis.

    Conditions that ask for a margin (their tolerance is negative) offend by what is missing of it.

    Parameters
    ----------
    verdict : Verdict

    Examples
    --------
    >>> from gnc_opt.plot import plot_verdict
    >>> figure = plot_verdict(go.verify(solution))
    """
    with style():
        figure = new_figure(1.2 + 0.27 * len(verdict.conditions))
        axes = figure.subplots()
        rows = np.arange(len(verdict.conditions))[::-1]
        for result, (color, marker, label) in _LOOKS.items():
            chosen = [k for k, c in enumerate(verdict.conditions) if c.result is result]
            if chosen:
                values = [_offence(verdict.conditions[k]) for k in chosen]
                axes.hlines(rows[chosen], _LEAST, values, color=color, linewidth=2.5)
                axes.plot(
                    values, rows[chosen], marker, color=color, markersize=7, label=f"{label} ({len(chosen)})"
                )
        axes.axvline(1.0, color=QUIET, linestyle="--", linewidth=1.0, label="tolerance")
        axes.set_xscale("log")
        axes.set_xlim(_LEAST, 10.0 ** np.ceil(np.log10(max(1.0, *map(_offence, verdict.conditions)) * 3)))
        axes.set_yticks(rows, [c.name for c in verdict.conditions])
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel("worst offence, in tolerances")
        axes.set_title(f"{verdict.problem_name}: {verdict.headline}")
        legend_on_top(figure, axes.get_legend_handles_labels()[0])
        return figure


def _offence(condition: Condition) -> float:
    """Offence to draw, in tolerances; 1 and more is beyond."""
    value, tolerance = condition.value, condition.tolerance
    if not np.isfinite(value):
        return _MOST if condition.result is Result.FAIL else 1.0
    missing = value if tolerance > 0 else value - tolerance
    share = missing / (abs(tolerance) or TOLERANCE)
    return float(np.clip(share, _LEAST, _MOST))
