"""Figures of a solution over time: states, costates, Hamiltonian; without a phase, of all phases in order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gnc_opt.arrays import Array
from gnc_opt.planning.solution.phase_solution import PhaseSolution, Signal
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.summary import time_unit
from gnc_opt.plot.axes import (
    BOUND,
    HAMILTONIAN_ROUNDING_SHARE,
    MOST_ROWS,
    component_legend_labels,
    cost_unit,
    data_range,
    draw_components,
    draw_phase_boundaries,
    hamiltonian_unit,
    label_time_axes,
    sample_densely,
    select_phases,
    select_variable_names,
    set_minimum_y_range,
)
from gnc_opt.plot.style import (
    COLORS,
    apply_style,
    axis_label,
    legend_above,
    legend_on_top,
    new_figure,
    number_text,
    variable_name_text,
)
from gnc_opt.text_formatting import derivative_unit

_AT_POINTS: dict[str, Any] = {"color": COLORS[0], "marker": "o", "markersize": 3.2, "linestyle": "none"}
_ALONG_FLOWN: dict[str, Any] = {"color": COLORS[5], "linewidth": 0.9}


def plot_states(
    solution: Solution,
    names: Sequence[str] | None = None,
    *,
    phase: str | None = None,
) -> Figure:
    """Return a figure that shows states over time, one axis per (vector) state; bounds in view are dashed.

    Parameters
    ----------
    solution : Solution
    names : sequence of str, optional
        States; default all.
    phase : str, optional
        Default all, one after the other.

    Raises
    ------
    UnknownNameError
        There is no such phase or state.

    Examples
    --------
    >>> print(len(plot_states(solution).axes))  # one for each state
    2
    """
    return _draw_state_axes(
        solution,
        phase,
        names,
        lambda leg, name: leg.state(name),
        lambda name, unit: axis_label(variable_name_text(name), unit),
        _draw_bounds_in_view,
    )


def plot_costates(
    solution: Solution,
    names: Sequence[str] | None = None,
    *,
    phase: str | None = None,
) -> Figure:
    """Return a figure that shows the costates of states over time, one axis per (vector) state.

    Parameters
    ----------
    solution, names, phase
        As in `plot_states`.

    Raises
    ------
    UnknownNameError
        There is no such phase or state.

    Examples
    --------
    >>> print(len(plot_costates(solution, ["v"]).axes))
    1
    """
    return _draw_state_axes(
        solution,
        phase,
        names,
        lambda leg, name: leg.costate(name),
        lambda name, unit: axis_label(
            f"costate of {variable_name_text(name)}", derivative_unit(cost_unit(solution), unit)
        ),
    )


def plot_hamiltonian(solution: Solution, *, phase: str | None = None) -> Figure:
    """Return a figure that shows the Hamiltonian over time with its range.

    Marks show it at the collocation points of the program; the line uses the applied controls.

    Parameters
    ----------
    solution : Solution
        Joined to its problem.
    phase : str, optional
        Default all, one after the other.

    Raises
    ------
    GncOptError
        The solution was loaded without its problem.

    Examples
    --------
    >>> print(plot_hamiltonian(solution).axes[0].get_xlabel())
    time (s)
    """
    legs = select_phases(solution, phase)
    at_points = [np.asarray(solution.hamiltonian(leg.point_times, leg.name)) for leg in legs]
    along = [
        sample_densely(_applied_hamiltonian_function(solution, leg), leg.applied.jump_times) for leg in legs
    ]
    low, high = data_range(np.concatenate(at_points))
    with apply_style():
        figure = new_figure(3.4)
        ax = figure.subplots()
        ax.axhspan(low, high, color=COLORS[0], alpha=0.12, linewidth=0, zorder=1)
        for leg, points, (t, values) in zip(legs, at_points, along, strict=True):
            ax.plot(t, values[0], zorder=2, **_ALONG_FLOWN)
            ax.plot(leg.point_times, points, zorder=3, **_AT_POINTS)
        set_minimum_y_range(ax, HAMILTONIAN_ROUNDING_SHARE * max(abs(low), abs(high)))
        draw_phase_boundaries(ax, legs)
        ax.set_xlabel(f"time ({time_unit(solution)})")
        ax.set_ylabel(axis_label("Hamiltonian", hamiltonian_unit(solution)))
        legend_on_top(figure, _hamiltonian_legend_handles(low, high), columns=2)
    return figure


def _draw_state_axes(
    solution: Solution,
    phase: str | None,
    names: Sequence[str] | None,
    signal_of: Callable[[PhaseSolution, str], Signal],
    label_of: Callable[[str, str], str],
    decorate: Callable[[Axes, PhaseSolution, str], None] | None = None,
) -> Figure:
    """Figure of the states over time, one axis per state over all its phases; ``decorate`` may add to an axis."""
    legs = select_phases(solution, phase)
    names = select_variable_names(legs, "states", names)
    with apply_style():
        columns = 1 if len(names) <= MOST_ROWS else 2
        rows = -(-len(names) // columns)
        figure = new_figure(0.5 + 2.1 * rows)
        axes = figure.subplots(rows, columns, sharex=True, squeeze=False).T.ravel()
        for ax in axes[len(names) :]:
            ax.remove()
        for ax, name in zip(axes, names, strict=False):
            for leg in legs:
                if name in leg.states:
                    signal = signal_of(leg, name)
                    draw_components(ax, *sample_densely(signal, leg.breaks), component_legend_labels(signal))
                    ax.set_ylabel(label_of(name, leg.state(name).unit))
                    if decorate is not None:
                        decorate(ax, leg, name)
            draw_phase_boundaries(ax, legs)
            if max(leg.states[name].size for leg in legs if name in leg.states) > 1:
                legend_above(ax)
        label_time_axes(figure, time_unit(solution))
    return figure


def _draw_bounds_in_view(ax: Axes, leg: PhaseSolution, name: str) -> None:
    rows, limits = leg.states.slice(name), ax.get_ylim()
    for level in np.unique([leg.state_bounds.lower[rows], leg.state_bounds.upper[rows]]):
        if limits[0] <= level <= limits[1]:
            ax.plot(leg.breaks[[0, -1]], [level, level], **BOUND)


def _applied_hamiltonian_function(solution: Solution, leg: PhaseSolution) -> Callable[..., Array]:
    hamiltonian = solution.functions(leg.name).hamiltonian
    return lambda t, side: hamiltonian(t, leg.x(t, side), leg.applied(t, side), leg.lam(t, side))


def _hamiltonian_legend_handles(low: float, high: float) -> list[Any]:
    ends = number_text(low), number_text(high)
    spread = f"\N{PLUS-MINUS SIGN} {number_text(0.5 * (high - low), 2)}"
    shown = f"{ends[0]} {spread}" if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"
    return [
        Line2D([], [], label="at the collocation points", **_AT_POINTS),
        Line2D([], [], label=f"their range, {shown}", color=COLORS[0], alpha=0.25, linewidth=6),
        Line2D([], [], label="along the applied controls", **_ALONG_FLOWN),
    ]
