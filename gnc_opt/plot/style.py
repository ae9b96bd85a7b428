"""Style of figures: sized for a journal column, readable in print and by the colour-blind."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gnc_opt.text_formatting import GREEK_NAMES

DPI = 150

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Okabe and Ito's palette, which stays distinct for the colour-blind."""

DASHES = ("-", (0, (6, 1.5)), (0, (5, 1.2, 1.2, 1.2)), (0, (1.2, 1.2)), (0, (9, 2, 1, 2, 1, 2)), "-", "-")
"""Line styles that go with the colours, for prints without colour."""

QUIET = "#777777"
"""Colour of what serves only for orientation: bounds, zero lines, marks."""

_STYLE: dict[str, Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 11,
    "axes.titlesize": 11,
    "xtick.labelsize": 10,
    "ytick.labelsize": 10,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-5, 5),
    "xtick.direction": "in",
    "ytick.direction": "in",
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "figure.dpi": DPI,
    "savefig.dpi": DPI,
}


_LONG_LABEL, _LONG_NAME = 25, 8
"""Characters above which labels have one column in a narrow figure, and names of components two instead of three."""

_NARROW: ContextVar[bool] = ContextVar("narrow figures", default=False)


@contextmanager
def apply_style() -> Iterator[None]:
    """Apply the style inside a ``with`` block; settings outside are left alone."""
    with matplotlib.rc_context(_STYLE):
        yield


@contextmanager
def draw_narrow_figures() -> Iterator[None]:
    """Inside a ``with`` block, draw figures for narrow screens: half as wide, with all axes in one column."""
    earlier = _NARROW.set(True)
    try:
        yield
    finally:
        _NARROW.reset(earlier)


def figure_width() -> float:
    """Return the width of figures in inches."""
    return 4.6 if _NARROW.get() else 9.0


def new_figure(height: float, width: float | None = None) -> Figure:
    """Return an empty figure of the given size in inches; it belongs to no window."""
    return Figure(figsize=(width or figure_width(), height), layout="constrained")


def new_axes_rows(
    counts: Sequence[int], row_height: float, *, share_x: bool = True
) -> tuple[Figure, list[Axes]]:
    """Return a figure and its axes in reading order, with one or two axes per row; one in narrow figures."""
    counts = [1] * sum(counts) if _NARROW.get() else counts
    axes: list[Axes] = []
    figure = new_figure(0.6 + row_height * len(counts))
    grid = figure.add_gridspec(len(counts), 2)
    for row, count in enumerate(counts):
        for place in (grid[row, :],) if count == 1 else (grid[row, 0], grid[row, 1]):
            axes.append(figure.add_subplot(place, sharex=axes[0] if axes and share_x else None))
            axes[-1].tick_params(labelbottom=not share_x or row == len(counts) - 1)
    return figure, axes


def save_figure(figure: Figure, path: str | Path, dpi: int = DPI) -> Path:
    """Return the path of a file to which a figure is written; its suffix is the format.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    path : str or Path
    dpi : int
        Dots per inch, for pixel formats.

    Examples
    --------
    >>> from gnc_opt.plot import plot_states, save_figure
    >>> path = save_figure(plot_states(solution), "states.svg")
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    with apply_style():
        figure.savefig(target, dpi=dpi)
    return target


def line_style(i: int) -> dict[str, Any]:
    """Return colour and dashes of the i-th line of an axis."""
    return {"color": COLORS[i % len(COLORS)], "linestyle": DASHES[i % len(DASHES)]}


def axis_label(quantity: str, unit: str) -> str:
    """Return ``"quantity (unit)"`` with exponents of the unit typeset; no unit, no parentheses."""
    return f"{quantity} ({unit_text(unit)})" if unit else quantity


def variable_name_text(name: str) -> str:
    """Return a variable's name or component, such as "omega_BL" or "v_L[2]", typeset; words stay words."""
    base, _, subscript = name.partition("[")[0].partition("_")
    index = name[name.index("[") :] if "[" in name else ""
    symbol = f"\\{base}" if base in GREEK_NAMES else base
    if base not in GREEK_NAMES and len(base) > 1:
        return name
    lowered = f"_{{\\mathrm{{{subscript.replace('_', ',')}}}}}" if subscript else ""
    return f"${symbol}{lowered}${index}"


def unit_text(unit: str) -> str:
    """Return a unit such as "m/s^2" or "kg m^2" with exponents as mathtext."""
    return re.sub(r"\^(-?\d+)", r"$^{\1}$", unit)


def place_legend_above(ax: Axes) -> None:
    """Put the axis' legend above it, where it cannot hide data."""
    labels = (re.sub(r"\\[a-z]+|\W|_", "", text) for text in ax.get_legend_handles_labels()[1])
    narrow = 2 if max(map(len, labels), default=0) > _LONG_NAME else 3
    columns = narrow if _NARROW.get() else 6
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, borderaxespad=0.2)


def draw_legend_on_top(figure: Figure, axes: Sequence[Any], columns: int = 5) -> None:
    """Put one legend of the labels in some axes at the top of a figure; two columns in narrow figures."""
    handles = {h.get_label(): h for ax in axes for h in ax.get_legend_handles_labels()[0]}
    if _NARROW.get():
        columns = 1 if max(map(len, handles), default=0) > _LONG_LABEL else 2
    columns = min(len(handles), columns)
    where = "upper center" if figure.get_layout_engine() is None else "outside upper center"
    figure.legend(handles=list(handles.values()), loc=where, ncols=columns, columnspacing=1.6)
