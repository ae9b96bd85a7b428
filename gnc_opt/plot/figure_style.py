"""Style of figures: sized for a journal column, readable in print and by the colour-blind."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gnc_opt.text_html_and_json_formatting import (
    GREEK_NAMES,
    simplify_time_integral_unit,
    split_symbol_and_index,
)

DPI = 150

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Okabe and Ito's palette, which stays distinct for the colour-blind."""

DASHES = ("-", "--", "-.", ":")
"""Line styles that go with the colours, for prints without colour."""

QUIET = "#777777"
"""Colour of what serves only for orientation: bounds, zero lines, marks."""

THIN = 0.8
"""Width of lines for orientation, points."""

_STYLE: dict[str, Any] = {
    **matplotlib.rc_params_from_file(
        Path(__file__).with_name("figures.mplstyle"), use_default_template=False
    ),
    **dict.fromkeys(("figure.dpi", "savefig.dpi"), DPI),
}

PANEL_WIDTH = 4.5
"""Width of one axes with its labels, inches: half a page, or a telephone's screen."""

_LEFT, _RIGHT, _TOP, _BOTTOM = 0.9, 0.22, 0.3, 0.5
"""Margins of an axes for labels and legend, inches."""

_LEGEND_CHARACTERS = 54
"""Characters in one line of a legend of an axes, of which a handle takes seven."""


@contextmanager
def apply_plot_style() -> Iterator[None]:
    """Apply the style inside a ``with`` block; settings outside are left alone."""
    with matplotlib.rc_context(_STYLE):
        yield


def create_figure(height: float, width: float = 2 * PANEL_WIDTH) -> Figure:
    """Return an empty figure of the given size in inches; it belongs to no window."""
    return Figure(figsize=(width, height), layout="constrained")


def count_axes_per_figure_row(count: int) -> list[int]:
    """Return the number of axes in each row, for `create_figure_with_axes_rows`."""
    return [2] * (count // 2) + [1] * (count % 2)


def create_figure_with_axes_rows(
    counts: Sequence[int], row_height: float, *, share_x: bool = True, gap: float = _TOP
) -> tuple[Figure, list[Axes]]:
    """Return a figure and its axes in reading order, with one or two axes per row.

    Rows of one axes in a figure of two columns have the full width. The figure can be cut in the middle of the other
    rows: a report shows the halves below each other on narrow screens. If the x axis is shared, the last row of axes
    of equal width has its tick labels.
    """
    columns, gap = max(counts), gap if share_x else gap + _BOTTOM
    bands = [(count, len(list(rows))) for count, rows in groupby(counts)]
    heights = [rows * row_height + (rows - 1) * gap for _, rows in bands]
    between = gap + _BOTTOM * share_x
    width, height = columns * PANEL_WIDTH, _TOP + _BOTTOM + sum(heights) + between * (len(bands) - 1)
    figure, top = Figure(figsize=(width, height)), height - _TOP
    axes: list[Axes] = []
    for (count, rows), band_height in zip(bands, heights, strict=True):
        inner = width / count - _LEFT - _RIGHT
        grid = figure.add_gridspec(
            *(rows, count),
            left=_LEFT / width,
            right=1 - _RIGHT / width,
            wspace=(_LEFT + _RIGHT) / inner,
            bottom=(top - band_height) / height,
            top=top / height,
            hspace=gap / row_height,
        )
        top -= band_height + between
        for cell in grid:
            axes.append(figure.add_subplot(cell, sharex=axes[0] if axes and share_x else None))
            axes[-1].yaxis.set_label_coords((0.36 - _LEFT) / inner, 0.5)
            axes[-1].yaxis.label.set_linespacing(1.0)  # two lines stay in the margin
            axes[-1].tick_params(labelbottom=not share_x or cell.is_last_row())
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
    with apply_plot_style():
        figure.savefig(target, dpi=dpi)
    return target


def get_line_style(i: int) -> dict[str, Any]:
    """Return colour and dashes of the i-th line of an axis."""
    return {"color": COLORS[i % len(COLORS)], "linestyle": DASHES[i % len(DASHES)]}


def format_axis_label(quantity: str, unit: str) -> str:
    """Return ``"quantity (unit)"`` with exponents of the unit typeset; no unit, no parentheses."""
    return f"{quantity} ({format_unit(unit)})" if unit else quantity


def format_variable_name(name: str) -> str:
    """Return a variable's name or component typeset, counted from 1: "v_L[2]" has the index L,3; words stay words."""
    base, marks = split_symbol_and_index(name)
    if not marks and base not in GREEK_NAMES and len(base) > 1:
        return base
    words = f"\\mathrm{{{base.replace('_', chr(92) + '_')}}}" if len(base) > 1 else base
    symbol = f"\\{base}" if base in GREEK_NAMES else words
    return f"${symbol}_{{\\mathrm{{{marks}}}}}$" if marks else f"${symbol}$"


def format_unit(unit: str) -> str:
    """Return a unit such as "m/s^2" or "kg m^2" with exponents as mathtext."""
    return re.sub(r"\^(-?\d+(?:\.\d+)?)", r"$^{\1}$", simplify_time_integral_unit(unit))


def place_legend_above(ax: Axes, others: Sequence[Axes] = ()) -> None:
    """Put a legend of an axes, and of others with their labels, above it, where it cannot hide data."""
    handles = {h.get_label(): h for each in (ax, *others) for h in each.get_legend_handles_labels()[0]}
    lengths = [7 + len(re.sub(r"\\[a-z]+|\W|_", "", label)) for label in handles]
    columns = len(lengths) if sum(lengths) <= _LEGEND_CHARACTERS else _LEGEND_CHARACTERS // max(lengths)
    place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.1}
    place["handlelength"] = 1.6 if sum(lengths) > 0.8 * _LEGEND_CHARACTERS else 2.6
    ax.legend(handles=list(handles.values()), ncols=max(columns, 1), columnspacing=1.2, **place)
    figure = ax.get_figure()
    axes_width = ax.get_position().width * figure.bbox.width / figure.dpi
    ax.yaxis.get_offset_text().set_x(-0.68 / axes_width)  # the power of ten is left of the legend
