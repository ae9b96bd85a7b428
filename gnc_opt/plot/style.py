"""How figures look: sized for a journal column, readable in print and by the colour-blind."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

WIDTH = 6.5
"""Width of a figure, inches: the text width of a page."""

DPI = 150

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Okabe and Ito's palette, which stays distinct for the colour-blind."""

DASHES = ("-", (0, (6, 1.5)), (0, (5, 1.2, 1.2, 1.2)), (0, (1.2, 1.2)), (0, (8, 1.5, 1.2, 1.5, 1.2, 1.5)), "-", "-")
"""Line styles that go with the colours, for prints without colour."""

QUIET = "#777777"
"""Colour of what serves only for orientation: bounds, zero lines, marks."""

_STYLE: dict[str, Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 11,
    "axes.labelsize": 11,
    "axes.titlesize": 11,
    "legend.fontsize": 10,
    "xtick.labelsize": 10,
    "ytick.labelsize": 10,
    "axes.linewidth": 0.8,
    "lines.linewidth": 1.5,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": True,
    "axes.unicode_minus": True,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "figure.dpi": DPI,
    "savefig.dpi": DPI,
}


@contextmanager
def style() -> Iterator[None]:
    """Apply the style inside a ``with`` block; settings outside are left alone."""
    with matplotlib.rc_context(_STYLE):
        yield


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """Return an empty figure of the given size in inches; it belongs to no window."""
    return Figure(figsize=(width, height), layout="constrained")


def save_figure(figure: Figure, path: str | Path, dpi: int = DPI) -> Path:
    """Write a figure to a file (its suffix is the format), making folders as needed; return its path."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    with style():
        figure.savefig(target, dpi=dpi)
    return target


def line_look(i: int) -> dict[str, Any]:
    """Return colour and dashes of the i-th line of an axis."""
    return {"color": COLORS[i % len(COLORS)], "linestyle": DASHES[i % len(DASHES)]}


def axis_label(quantity: str, unit: str) -> str:
    """Return ``"quantity (unit)"`` with exponents of the unit typeset; no unit, no parentheses."""
    return f"{quantity} ({unit_text(unit)})" if unit else quantity


def unit_text(unit: str) -> str:
    """Return a unit such as "m/s^2" or "kg m^2" with exponents as mathtext."""
    return re.sub(r"\^(-?\d+)", r"$^{\1}$", unit)


def legend_above(ax: Axes, handles: Sequence[Any] | None = None, columns: int | None = None) -> None:
    """Put the legend in one row above the axis, where it cannot hide data."""
    shown = list(ax.get_legend_handles_labels()[0]) if handles is None else list(handles)
    ax.legend(
        handles=shown,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns or len(shown),
        borderaxespad=0.2,
        columnspacing=1.4,
    )
