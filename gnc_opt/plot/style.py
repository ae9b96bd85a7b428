"""Style of figures: sized for a journal column, readable in print and by the colour-blind."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
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
    "axes.labelsize": 11,
    "axes.titlesize": 11,
    "legend.fontsize": 11,
    "xtick.labelsize": 10,
    "ytick.labelsize": 10,
    "axes.linewidth": 0.8,
    "lines.linewidth": 1.5,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-5, 5),
    "axes.unicode_minus": True,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "figure.dpi": DPI,
    "savefig.dpi": DPI,
}


@contextmanager
def apply_style() -> Iterator[None]:
    """Apply the style inside a ``with`` block; settings outside are left alone."""
    with matplotlib.rc_context(_STYLE):
        yield


def new_figure(height: float, width: float = 9.0) -> Figure:
    """Return an empty figure of the given size in inches; it belongs to no window."""
    return Figure(figsize=(width, height), layout="constrained")


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
    cut: dict[str, Any] = {}
    spatial = [ax for ax in figure.axes if ax.name == "3d"]
    if spatial or figure.get_layout_engine() is None:  # nothing else keeps the labels inside
        labels = [axis.label for ax in spatial for axis in (ax.xaxis, ax.yaxis, ax.zaxis)]
        drawn = [*figure.get_default_bbox_extra_artists(), *labels]
        cut = {"bbox_inches": "tight", "pad_inches": 0.1, "bbox_extra_artists": drawn}
    with apply_style():
        figure.savefig(target, dpi=dpi, **cut)
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


def number_text(value: float, digits: int = 6) -> str:
    """Return a number with the minus sign of the axes' labels."""
    return f"{value:.{digits}g}".replace("-", "\N{MINUS SIGN}")


def unit_text(unit: str) -> str:
    """Return a unit such as "m/s^2" or "kg m^2" with exponents as mathtext."""
    return re.sub(r"\^(-?\d+)", r"$^{\1}$", unit)


def legend_above(ax: Axes) -> None:
    """Put the axis' legend in one row above it, where it cannot hide data."""
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(ax.get_lines()), borderaxespad=0.2)


def legend_on_top(figure: Figure, handles: Sequence[Any], columns: int | None = None) -> None:
    """Put one legend at the top of a figure, above all axes."""
    figure.legend(
        handles=list(handles), loc="outside upper center", ncols=columns or len(handles), columnspacing=1.6
    )
