"""Figure of a refinement: errors and meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, NullLocator

from gnc_opt.planning.solution.history import History
from gnc_opt.plot.style import COLORS, QUIET, apply_style, legend_on_top, new_figure

_COLORMAP = "viridis_r"

_PATH: dict[str, Any] = {"color": COLORS[0], "marker": "o", "markersize": 4, "linewidth": 1.0}
_CHOSEN: dict[str, Any] = {
    "color": COLORS[1],
    "marker": "o",
    "markersize": 9,
    "fillstyle": "none",
    "linestyle": "none",
}
_UNSOLVED: dict[str, Any] = {"color": "black", "marker": "x", "markersize": 7, "linestyle": "none"}
_TOLERANCE: dict[str, Any] = {"color": "black", "linestyle": "--", "linewidth": 1.0}


_NUMBER: dict[str, Any] = {
    "fontsize": 9,
    "color": QUIET,
    "bbox": {"facecolor": "white", "edgecolor": "none", "pad": 0.6},
}


def plot_refinement(history: History) -> Figure:
    """Return a figure of the errors and meshes of a refinement.

    Top: the estimated error of each iteration over its number of collocation points; failed solves are crossed out.
    Bottom: one row of segments per iteration and phase, coloured by degree.

    Parameters
    ----------
    history : History

    Examples
    --------
    >>> figure = plot_refinement(solution.history)
    """
    phases = list(history.passes[0].meshes)
    with apply_style():
        heights = [2.4, *([0.5 + 0.17 * len(history.passes)] * len(phases))]
        figure = new_figure(sum(heights) + 0.7 * len(heights))
        axes = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        _draw_errors(axes[0], history)
        degrees = [n for p in history.passes for mesh in p.meshes.values() for n in mesh.degrees]
        norm = Normalize(min(degrees), max(max(degrees), min(degrees) + 1))
        for ax, phase in zip(axes[1:], phases, strict=True):
            _draw_meshes(ax, history, phase, norm)
            ax.set_ylabel("iteration" if len(phases) == 1 else phase)
        tall = sum(heights[1:])
        ticks = MaxNLocator(max(1, int(tall / 0.3)), integer=True)
        figure.colorbar(
            ScalarMappable(norm, _COLORMAP),
            ax=list(axes[1:]),
            label="degree",
            aspect=tall / 0.12,
            pad=0.01,
            ticks=ticks,
        )
        legend_on_top(figure, _refinement_legend_handles(history))
    return figure


def _draw_errors(ax: Axes, history: History) -> None:
    points = [p.points for p in history.passes]
    errors = [min(max(p.error, 1e-16), 1e6) for p in history.passes]
    ax.plot(points, errors, zorder=2, **_PATH)
    ax.plot(points[history.chosen], errors[history.chosen], zorder=3, **_CHOSEN)
    unsolved = [i for i, p in enumerate(history.passes) if not p.solved]
    ax.plot([points[i] for i in unsolved], [errors[i] for i in unsolved], zorder=4, **_UNSOLVED)
    ax.axhline(history.tolerance, zorder=1, **_TOLERANCE)
    for i, at in enumerate(zip(points, errors, strict=True)):
        ax.annotate(str(i), at, xytext=(5, 5), textcoords="offset points", zorder=5, **_NUMBER)
    ax.set_yscale("log")
    ax.margins(0.06, 0.12)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    ax.set_xlabel("collocation points")
    ax.set_ylabel("estimated error")


def _draw_meshes(ax: Axes, history: History, phase: str, norm: Normalize) -> None:
    narrowest = min(float(np.min(p.meshes[phase].widths[[0, -1]])) for p in history.passes)
    stretched = narrowest < 3e-3
    for i, record in enumerate(history.passes):
        mesh = record.meshes[phase]
        edges = np.array(mesh.breaks) if stretched else np.array(record.times[phase])
        if stretched:
            edges = np.clip(edges, 0.5 * narrowest, 1.0 - 0.5 * narrowest)
        ax.barh(
            np.full(mesh.segments, i),
            np.diff(edges),
            left=edges[:-1],
            height=0.8,
            color=colormaps[_COLORMAP](norm(mesh.degrees)),
            edgecolor="white",
            linewidth=0.4,
        )
    if stretched:
        ax.set_xscale("logit")
        ax.xaxis.set_minor_locator(NullLocator())
        ax.set_xlim(0.5 * narrowest, 1.0 - 0.5 * narrowest)
    else:
        ax.margins(x=0.0)
    ax.set_xlabel("share of the phase" if stretched else "time")
    ax.set_ylim(len(history.passes) - 0.5, -0.5)
    ax.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    ax.grid(False)


def _refinement_legend_handles(history: History) -> list[Any]:
    handles = [
        Line2D([], [], label="iterations in order", **_PATH),
        Line2D([], [], label=f"returned: {history.status.value.replace('_', ' ')}", **_CHOSEN),
        Line2D([], [], label="tolerance", **_TOLERANCE),
    ]
    if not all(p.solved for p in history.passes):
        handles.insert(2, Line2D([], [], label="not solved", **_UNSOLVED))
    return handles
