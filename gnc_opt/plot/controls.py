"""Figure of the controls and their switching functions over time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gnc_opt.arrays import Array
from gnc_opt.errors import GncOptError
from gnc_opt.model.composed_controls import AssembledControl, ComposedControl, VectorControl
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.summary import time_unit
from gnc_opt.plot.axes import (
    BOUND,
    HAMILTONIAN_ROUNDING_SHARE,
    MOST_ROWS,
    component_legend_labels,
    draw_components,
    draw_phase_boundaries,
    find_zero_crossings,
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
    variable_name_text,
)
from gnc_opt.text_formatting import derivative_unit
from gnc_opt.tolerances import AT_LIMIT

_FLOWN: dict[str, Any] = {"color": COLORS[0], "linewidth": 2.0}
_POLYNOMIAL: dict[str, Any] = {"color": COLORS[1], "linewidth": 0.7}
_SWITCHING: dict[str, Any] = {"color": COLORS[2], "linewidth": 1.2}
_SIGN_CHANGE: dict[str, Any] = {"color": "black", "linewidth": 0.7, "linestyle": ":"}


def plot_controls(
    solution: Solution,
    names: Sequence[str] | None = None,
    *,
    phase: str | None = None,
) -> Figure:
    """Return a figure of every control component and, next to it, its switching function.

    Left: the applied signal (bold), the collocation polynomial with its nodes (thin), bounds dashed. Right: the
    switching function dH/du; an optimal bounded control is at its upper bound where it is negative; dotted lines mark
    zeros.

    Parameters
    ----------
    solution, names, phase
        As in `plot_states`, for controls.

    Raises
    ------
    UnknownNameError
        The phase or control does not exist.
    GncOptError
        The phase has no controls.

    Examples
    --------
    >>> print(len(plot_controls(solution).axes))  # the control, and its switching function
    2
    """
    legs = select_phases(solution, phase)
    known = {c.name: c for leg in legs for c in leg.composed_controls}
    composed = [
        c
        for name, c in known.items()
        if (name in names if names is not None else _is_declared_control(c, known.values()))
    ]
    names = select_variable_names(
        legs, "controls", names if names is None else [n for n in names if n not in known]
    )
    sizes = {name: leg.controls[name].size for leg in legs for name in names if name in leg.controls}
    parts = [(name, i) for name in names for i in range(sizes[name])]
    if not parts and not composed:
        raise GncOptError(f"'{solution.problem_name}' has no controls to draw: use plot_states().")
    columns = 1 if solution.problem is None else 2
    with apply_style():
        figure, grid = _control_axes_grid(len(parts) + len(composed), columns)
        for axes, (name, i) in zip(grid, parts, strict=False):
            for leg in legs:
                if name in leg.controls:
                    shown = component_legend_labels(leg.control(name))[i]
                    _draw_control(axes[0], leg, name, i, shown)
                    if columns == 2:
                        _draw_switching_function(axes, solution, leg, name, i, shown)
        for axes, control in zip(grid[len(parts) :], composed, strict=True):
            _draw_composed_control(axes[0], legs, control)
            for ax in axes[1:]:
                place = axes[0].get_subplotspec()
                both = slice(place.colspan.start, place.colspan.start + 2)
                axes[0].set_subplotspec(place.get_gridspec()[place.rowspan.start, both])
                ax.remove()
        for ax in figure.axes:
            draw_phase_boundaries(ax, legs)
        label_time_axes(figure, time_unit(solution))
        legend_on_top(figure, _control_legend_handles(columns == 2))
    return figure


def _control_axes_grid(rows: int, columns: int) -> tuple[Figure, Any]:
    """Return a figure with one row of axes per control, shape (rows, columns); more than three use two columns."""
    stacks = 1 if rows <= MOST_ROWS else 2
    height = -(-rows // stacks)
    figure = new_figure(0.9 + (1.75 if stacks == 1 else 1.35) * height)
    drawn = figure.subplots(height, stacks * columns, sharex=True, squeeze=False)
    grid = np.vstack(np.hsplit(drawn, stacks))
    for ax in np.ravel(grid[rows:]):
        ax.remove()
    return figure, grid[:rows]


def _draw_control(ax: Axes, leg: PhaseSolution, name: str, i: int, shown: str) -> None:
    signal = leg.control(name)
    t, polynomial = sample_densely(signal, leg.breaks, gaps=True)
    ax.plot(t, polynomial[i], zorder=2, **_POLYNOMIAL)
    nodes = np.atleast_2d(signal(leg.point_times))[i]
    ax.plot(leg.point_times, nodes, ".", color=_POLYNOMIAL["color"], markersize=1.8, zorder=4)
    t, flown = sample_densely(leg.saturated_control(name), leg.applied.jump_times)
    ax.plot(t, flown[i], zorder=3, **_FLOWN)
    row = leg.controls.slice(name).start + i
    lower, upper = leg.control_bounds.lower[row], leg.control_bounds.upper[row]
    for level in (lower, upper):
        if np.isfinite(level):
            ax.plot(leg.breaks[[0, -1]], [level, level], zorder=1.5, **BOUND)
    if np.isfinite(lower) and np.isfinite(upper) and lower < upper:
        margin = 0.125 * (upper - lower)  # shows the bounds, clips overshoot
        ax.set_ylim(lower - margin, upper + margin)
    ax.set_ylabel(axis_label(shown, signal.unit))


def _is_declared_control(control: ComposedControl, others: Iterable[ComposedControl]) -> bool:
    """Return whether a control was declared itself, and not as a part of a control that is drawn."""
    whole = isinstance(control, VectorControl)
    return not any(whole and isinstance(c, AssembledControl) and c.parts[:2] == control.parts for c in others)


def _draw_composed_control(ax: Axes, legs: Sequence[PhaseSolution], control: ComposedControl) -> None:
    for leg in legs:
        if control in leg.composed_controls:
            signal = leg.saturated_control(control.name)
            draw_components(
                ax, *sample_densely(signal, leg.applied.jump_times), component_legend_labels(signal)
            )
    ax.set_ylabel(axis_label(variable_name_text(control.name), control.variable.unit))
    if control.variable.size > 1:
        legend_above(ax)


def _draw_switching_function(
    axes: Sequence[Axes], solution: Solution, leg: PhaseSolution, name: str, i: int, shown: str
) -> None:
    """Draw the switching function on the second axes, and mark its sign changes on both."""

    def evaluate_switching_function(t: Array, side: Any) -> Any:
        return solution.switching_function(name, t, leg.name, side)

    t, values = sample_densely(evaluate_switching_function, leg.breaks)
    axes[1].plot(t, values[i], **_SWITCHING)
    axes[1].axhline(0.0, color="black", linewidth=0.6)
    axes[1].locator_params(axis="y", nbins=3)
    per = derivative_unit(hamiltonian_unit(solution), leg.control(name).unit)
    axes[1].set_ylabel(axis_label(f"$\\partial H/\\partial${shown}" + "\n" * bool(per), per))
    negligible = _compute_negligible_switching(solution, leg, name, i)
    set_minimum_y_range(axes[1], 100 * negligible)  # 1e-5 of H, as in the optimality check
    on_bound = _is_control_at_bound(
        leg, leg.controls.slice(name).start + i, t
    )  # between them it is zero up to rounding
    for crossing in find_zero_crossings(t[on_bound], values[i][on_bound], negligible):
        for ax in axes:
            ax.axvline(crossing, zorder=1, **_SIGN_CHANGE)


def _is_control_at_bound(leg: PhaseSolution, row: int, t: Array) -> Any:
    lower, upper = leg.control_bounds.lower[row], leg.control_bounds.upper[row]
    flown = leg.applied(t)[row]
    room = np.minimum(flown - lower, upper - flown)
    return room <= AT_LIMIT * (upper - lower if np.isfinite(upper - lower) else 1.0 + np.max(np.abs(flown)))


def _compute_negligible_switching(solution: Solution, leg: PhaseSolution, name: str, i: int) -> float:
    """Return the switching function that changes H by 1e-7 of its terms over the range of the control."""
    t, rows = leg.point_times, leg.controls.slice(name)
    row = rows.start + i
    terms = leg.lam(t) * solution.functions(leg.name).rates(t, leg.x(t), leg.u(t))
    reach = leg.control_bounds.upper[row] - leg.control_bounds.lower[row]
    if not (np.isfinite(reach) and reach > 0):
        reach = float(np.max(np.abs(leg.u(t)[rows]))) or 1.0
    return float(HAMILTONIAN_ROUNDING_SHARE * np.max(np.sum(np.abs(terms), axis=0)) / reach)


def _control_legend_handles(with_switching: bool) -> list[Any]:
    handles = [
        Line2D([], [], label="applied", **_FLOWN),
        Line2D([], [], label="polynomial and nodes", marker=".", markersize=4, **_POLYNOMIAL),
        Line2D([], [], label="bounds", **BOUND),
    ]
    if with_switching:
        handles.append(Line2D([], [], label="switching function", **_SWITCHING))
    return handles
