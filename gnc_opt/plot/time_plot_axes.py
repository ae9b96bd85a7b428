"""Elements of time plots: dense sampling with one-sided limits at jumps, labels, lines and axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import NEGLIGIBLE, ROUNDING
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_summary import time_unit
from gnc_opt.plot.figure_style import (
    QUIET,
    THIN,
    format_variable_name,
    get_line_style,
)
from gnc_opt.text_html_and_json_formatting import format_unit_quotient

BOUND: dict[str, Any] = {
    "color": QUIET,
    "linestyle": (0, (4, 3)),
    "linewidth": THIN,
    "zorder": 1.5,
    "gid": "limit",
}
"""Line style of bounds."""

NEGLIGIBLE_SHARE_OF_HAMILTONIAN = 1e-5
"""Effect on the Hamiltonian, relative to its terms, that is not magnified in figures, as in the optimality check."""


def list_legend_labels(signal: Any) -> list[str]:
    return [format_variable_name(label) for label in signal.labels]


def get_cost_unit(solution: Solution) -> str:
    """Return the unit of the cost, or "" if the solution has no problem."""
    return "" if solution.problem is None else solution.problem.cost_unit


def get_hamiltonian_unit(solution: Solution) -> str:
    """Return the unit of cost per second; "" for a minimum time or without a unit."""
    unit = get_cost_unit(solution)
    time = time_unit(solution).removeprefix("× ")
    return "" if unit in ("", time) else format_unit_quotient(unit, time)


def find_largest_hamiltonian_term(solution: Solution, phase: PhaseSolution) -> float:
    """Return the largest sum of the magnitudes of the terms lambda_i dx_i/dt along a phase."""
    t = phase.point_times
    terms = phase.lam(t) * solution.phase_functions(phase.name).state_rates(t, phase.x(t), phase.u(t))
    return float(np.max(np.sum(np.abs(terms), axis=0)))


def draw_signal_components(ax: Axes, t: Array, values: Array, labels: Sequence[str]) -> None:
    """Draw the rows of ``values`` (n_components, n_times), each in its style; existing labels are not repeated."""
    known = set(ax.get_legend_handles_labels()[1])
    for i, row in enumerate(values):
        ax.plot(t, row, label=None if labels[i] in known else labels[i], **get_line_style(i))


def set_minimum_y_range(ax: Axes, least: float) -> None:
    """Extend the y axis by at least ``least`` on both sides of the data, so that rounding errors do not fill it."""
    low, high = ax.get_ylim()
    if high - low < least:
        ax.set_ylim(low - least, high + least)


def draw_phase_boundaries(ax: Axes, phases: Sequence[PhaseSolution], negligible: float = ROUNDING) -> None:
    """Set the time range to all phases, with dotted lines between them; ``negligible`` values look like zero."""
    heights = (np.abs(np.asarray(line.get_ydata(), dtype=float)) for line in ax.lines)
    reach = max((float(np.nanmax(y, initial=0.0)) for y in heights), default=0.0)
    set_minimum_y_range(ax, NEGLIGIBLE * reach if reach > negligible else 1.0)
    ax.set_xlim(phases[0].breaks[0], phases[-1].breaks[-1])
    for phase in phases[1:]:
        ax.axvline(phase.breaks[0], color=QUIET, linewidth=THIN, linestyle=":")


_NO_TIMES = ("rad", "deg", "m", "km", "m/s", "km/s")
"""Units of independent variables in place of the time."""


def label_bottom_time_axes(figure: Figure, unit: str) -> None:
    """Add a time label to the axes that have tick labels for it."""
    quantity = "independent variable" if unit in _NO_TIMES else "time"
    for ax in figure.axes:
        if ax.get_subplotspec().is_last_row():
            ax.set_xlabel(f"{quantity} ({unit})")


def sample_piecewise_function(
    function: Callable[..., Any], breaks: Array, per_piece: int = 24
) -> tuple[Array, Array]:
    """Return dense samples of ``function(t, side=...)`` between breaks, with both one-sided limits at the breaks.

    Parameters
    ----------
    function : callable
        Returns (n, n_times), or (n_times,) for a scalar quantity.
    breaks : array (K + 1,)
        Times of possible jumps, s.

    Returns
    -------
    t : array (n_times,)
    values : array (n, n_times)
    """
    times = np.linspace(breaks[:-1], breaks[1:], per_piece, axis=1)
    right = np.atleast_2d(function(times[:, :-1].ravel(), side="right"))
    left = np.atleast_2d(function(times[:, -1], side="left"))
    n, pieces = right.shape[0], times.shape[0]
    values = np.concatenate([right.reshape(n, pieces, per_piece - 1), left.reshape(n, pieces, 1)], axis=2)
    return times.ravel(), values.reshape(n, times.size)


def select_plotted_phases(solution: Solution, phase: str | None) -> list[PhaseSolution]:
    """Return the named phase, or all of them in order."""
    return list(solution.phases.values()) if phase is None else [solution.phase(phase)]


def select_plotted_variable_names(
    phases: Sequence[PhaseSolution], kind: str, names: Sequence[str] | None
) -> list[str]:
    """Return the names of "states" or "controls" to draw; raise an error for unknown ones."""
    layouts = [getattr(phase, kind) for phase in phases]
    known = list(dict.fromkeys(name for layout in layouts for name in layout.names))
    for name in names or ():
        if name not in known:
            layouts[0].slice(name)
    return known if names is None else list(names)
