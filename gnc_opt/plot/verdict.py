"""The verdict as a picture: how far each condition is from its tolerance."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from gnc_opt.plot.style import COLORS, QUIET, legend_on_top, new_figure, style
from gnc_opt.verify.verdict import Condition, Result, Verdict

_LOOKS = {
    Result.PASS: (COLORS[2], "o", "PASS"),
    Result.FAIL: (COLORS[1], "X", "FAIL"),
    Result.CANNOT_TELL: (COLORS[4], "D", "CANNOT TELL"),
}
_LEAST = 1e-17


def plot_verdict(verdict: Verdict) -> Figure:
    """Return a figure with one row per condition: its value on a logarithmic axis against its tolerance.

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
                values = [_size(verdict.conditions[k]) for k in chosen]
                axes.hlines(rows[chosen], _LEAST, values, color=color, linewidth=2.5)
                axes.plot(
                    values, rows[chosen], marker, color=color, markersize=7, label=f"{label} ({len(chosen)})"
                )
        tolerance = max(abs(c.tolerance) for c in verdict.conditions)
        axes.axvline(
            tolerance, color=QUIET, linestyle="--", linewidth=1.0, label=f"tolerance {tolerance:.0e}"
        )
        axes.set_xscale("log")
        axes.set_xlim(_LEAST, 10.0 ** np.ceil(np.log10(max(1.0, *map(_size, verdict.conditions)) * 3)))
        axes.set_yticks(rows, [c.name for c in verdict.conditions])
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel("worst offence (dimensionless)")
        axes.set_title(f"{verdict.problem_name}: {verdict.headline}")
        legend_on_top(figure, axes.get_legend_handles_labels()[0])
        return figure


def _size(condition: Condition) -> float:
    """Value to draw: Legendre-Clebsch passes below a negative tolerance and is drawn at the left edge then."""
    value = condition.value
    if not np.isfinite(value):
        return 1.0
    if condition.name == "Legendre-Clebsch" and condition.result is Result.PASS:
        return _LEAST
    return max(abs(value), _LEAST)
