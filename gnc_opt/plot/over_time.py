"""What figures over time share: labels of components, their lines, axes that span all phases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from gnc_opt.arrays import Array
from gnc_opt.plot.style import QUIET, line_look, name_text
from gnc_opt.solution.phase_solution import PhaseSolution
from gnc_opt.tolerances import ROUNDING, magnitude

Labels = Mapping[str, Sequence[str]]
"""Component labels by variable name, e.g. ``{"omega": (r"$\\omega_x$", r"$\\omega_y$", r"$\\omega_z$")}``."""

BOUND: dict[str, Any] = {"color": QUIET, "linestyle": (0, (4, 3)), "linewidth": 1.0}
"""Look of a bound's line."""

NEGLIGIBLE = 1e-7
"""Shares of the Hamiltonian up to this are the solver's rounding."""


def component_labels(name: str, signal: Any, labels: Labels | None) -> Sequence[str]:
    """Return what the legend calls each component of a signal: as given, or by its own names."""
    return (labels or {}).get(name) or [name_text(label) for label in signal.labels]


def draw_components(ax: Axes, t: Array, values: Array, labels: Sequence[str]) -> None:
    """Draw rows of ``values`` (n_components, n_times), each in its look; a label that the axis has is not repeated."""
    known = set(ax.get_legend_handles_labels()[1])
    for i, row in enumerate(values):
        ax.plot(t, row, label=None if labels[i] in known else labels[i], **line_look(i))


def leave_room(ax: Axes, least: float) -> None:
    """Show at least ``least`` to both sides of the data, lest rounding errors fill the axis."""
    low, high = ax.get_ylim()
    if high - low < least:
        ax.set_ylim(low - least, high + least)


def _heights(line: Line2D) -> Array:
    return np.asarray(line.get_ydata(), dtype=float)


def span_phases(ax: Axes, legs: Sequence[PhaseSolution]) -> None:
    """Show all phases, with a dotted line between one and the next, and noise as zero."""
    reach = max((float(np.nanmax(np.abs(y), initial=0.0)) for y in map(_heights, ax.lines)), default=0.0)
    leave_room(ax, ROUNDING * float(magnitude(reach)))
    ax.set_xlim(legs[0].breaks[0], legs[-1].breaks[-1])
    for leg in legs[1:]:
        ax.axvline(leg.breaks[0], color=QUIET, linewidth=0.8, linestyle=":")
