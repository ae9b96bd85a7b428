"""Figures of a solution over time: states, costates, Hamiltonian; without a phase, of all phases in order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import EQUAL, NEGLIGIBLE, ROUNDING, SMALL, TINY
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_summary import time_unit
from gnc_opt.plot.figure_style import (
    COLORS,
    apply_plot_style,
    count_axes_per_figure_row,
    create_figure_with_axes_rows,
    format_axis_label,
    format_variable_name,
    place_legend_above,
)
from gnc_opt.plot.time_plot_axes import (
    BOUND,
    draw_phase_boundaries,
    draw_signal_components,
    find_largest_hamiltonian_term,
    get_cost_unit,
    get_hamiltonian_unit,
    label_bottom_time_axes,
    list_legend_labels,
    sample_piecewise_function,
    select_plotted_phases,
    select_plotted_variable_names,
    set_minimum_y_range,
)
from gnc_opt.text_html_and_json_formatting import format_unit_quotient

_AT_POINTS: dict[str, Any] = {"label": "at nodes", "color": COLORS[1]}
_ACTIVE: dict[str, Any] = {"color": COLORS[4], "alpha": 0.35}
_LIMIT_IN_VIEW, _ACTIVE_SHARE = 2.0, 1e-4
"""Distance to a limit, over the range of the values, up to which it is drawn, and up to which it counts as active."""


def plot_states(
    solution: Solution, names: Sequence[str] | None = None, *, phase: str | None = None
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
    return _draw_states_or_costates(solution, names, phase, costates=False)


def plot_costates(
    solution: Solution, names: Sequence[str] | None = None, *, phase: str | None = None
) -> Figure:
    """Return a figure that shows the costates of states over time, one axis per (vector) state.

    Parameters
    ----------
    solution, names, phase
        As in `plot_states`.

    Examples
    --------
    >>> print(len(plot_costates(solution, ["v"]).axes))
    1
    """
    return _draw_states_or_costates(solution, names, phase, costates=True)


def find_negligible_costates(phases: Sequence[PhaseSolution]) -> dict[str, float]:
    """Return by state the limit of negligible costates: 1e-9 of the largest |state| |costate|, divided by |state|."""
    sizes = {
        (phase.name, v.name): [
            np.max(np.abs(p(phase.point_times)[phase.states.slice(v.name)])) for p in (phase.x, phase.lam)
        ]
        for phase in phases
        for v in phase.states.variables
    }
    largest = max(x * lam for x, lam in sizes.values())
    return {name: EQUAL * largest / max(x, TINY) for (_, name), (x, _) in sizes.items()}


def plot_path_constraints(solution: Solution, *, phase: str | None = None) -> Figure | None:
    """Return a figure of the path constraints over time, one axis each; None if all of them are equalities.

    Limits are dashed; shaded times are those at which the constraint is active.

    Parameters
    ----------
    solution : Solution
        Joined to its problem.
    phase : str, optional
        Default all, one after the other.

    Examples
    --------
    >>> from gnc_opt.plot import plot_path_constraints
    >>> print(plot_path_constraints(solution))  # this problem has none
    None
    """
    phases = select_plotted_phases(solution, phase)
    rows = [row for each in phases for row in _list_path_inequalities(each)]
    labels = list(dict.fromkeys(label for label, *_ in rows))
    units = {} if solution.problem is None else solution.problem.path_units()
    if not labels or solution.problem is None:
        return None
    with apply_plot_style():
        figure, axes = create_figure_with_axes_rows(count_axes_per_figure_row(len(labels)), 1.8)
        for label, i, each in rows:
            _draw_path_constraint(axes[labels.index(label)], solution, each, i)
        for ax, label in zip(axes, labels, strict=True):
            ax.set_ylabel(format_axis_label(label, units[label]))
            draw_phase_boundaries(ax, phases)
        label_bottom_time_axes(figure, time_unit(solution))
    return figure


def _list_path_inequalities(phase: PhaseSolution) -> list[tuple[str, int, PhaseSolution]]:
    """Return label and row of each path constraint, without equations and lengths of directions."""
    box, lengths = phase.path_bounds, [c.direction_norm_constraint_name for c in phase.vector_controls]
    return [
        (label, i, phase)
        for i, label in enumerate(phase.path_labels)
        if box.lower[i] < box.upper[i] and label not in lengths
    ]


def _draw_path_constraint(ax: Axes, solution: Solution, phase: PhaseSolution, i: int) -> None:
    paths = solution.phase_functions(phase.name).path_constraints
    t, values = sample_piecewise_function(
        lambda t, side: paths(t, phase.x(t, side), phase.applied(t, side))[i], phase.applied.jump_times
    )
    ax.plot(t, values[0], color=COLORS[0])
    reach = max(float(np.ptp(values)), NEGLIGIBLE * float(np.max(np.abs(values))))
    limits = phase.path_bounds.lower[i], phase.path_bounds.upper[i]
    for limit in limits:
        if np.min(np.abs(values - limit)) < _LIMIT_IN_VIEW * reach:
            ax.plot(t[[0, -1]], [limit, limit], **BOUND)
    gap = np.minimum(values[0] - limits[0], limits[1] - values[0])
    ax.fill_between(
        t, 0, 1, where=gap <= _ACTIVE_SHARE * reach, transform=ax.get_xaxis_transform(), **_ACTIVE
    )


def plot_hamiltonian(solution: Solution, *, phase: str | None = None) -> Figure:
    """Return a figure of the Hamiltonian over time, along the applied controls and at the collocation points.

    Parameters
    ----------
    solution : Solution
        Joined to its problem.
    phase : str, optional
        Default all, one after the other.

    Examples
    --------
    >>> print(plot_hamiltonian(solution).axes[0].get_xlabel())
    time (s)
    """
    phases = select_plotted_phases(solution, phase)
    with apply_plot_style():
        figure, (ax,) = create_figure_with_axes_rows([1], 2.0)
        for each in phases:
            along = sample_piecewise_function(
                _build_applied_hamiltonian_function(solution, each), each.applied.jump_times
            )
            draw_signal_components(ax, *along, ["applied controls"])
            ax.plot(each.point_times, solution.hamiltonian(each.point_times, each.name), "o", **_AT_POINTS)
        set_minimum_y_range(ax, SMALL * max(find_largest_hamiltonian_term(solution, each) for each in phases))
        draw_phase_boundaries(ax, phases)
        label_bottom_time_axes(figure, time_unit(solution))
        ax.set_ylabel(format_axis_label("Hamiltonian", get_hamiltonian_unit(solution)))
        place_legend_above(ax)
    return figure


def _draw_states_or_costates(
    solution: Solution, names: Sequence[str] | None, phase: str | None, *, costates: bool
) -> Figure:
    phases = select_plotted_phases(solution, phase)
    names = select_plotted_variable_names(phases, "states", names)
    negligible = find_negligible_costates(phases) if costates else dict.fromkeys(names, ROUNDING)
    with apply_plot_style():
        figure, axes = create_figure_with_axes_rows(count_axes_per_figure_row(len(names)), 1.8)
        for ax, name in zip(axes, names, strict=True):
            owners = [each for each in phases if name in each.states]
            for each in owners:
                signal = each.costate(name) if costates else each.state(name)
                draw_signal_components(
                    ax, *sample_piecewise_function(signal, each.breaks), list_legend_labels(signal)
                )
                if not costates:
                    _draw_state_bounds(ax, each, name)
            variable, text = owners[0].states[name], "costate of " * costates + format_variable_name(name)
            unit = format_unit_quotient(get_cost_unit(solution), variable.unit) if costates else variable.unit
            ax.set_ylabel(format_axis_label(text, unit))
            draw_phase_boundaries(ax, phases, negligible[name])
            if variable.size > 1:
                place_legend_above(ax)
        label_bottom_time_axes(figure, time_unit(solution))
    return figure


def _draw_state_bounds(ax: Axes, phase: PhaseSolution, name: str) -> None:
    rows, limits = phase.states.slice(name), ax.get_ylim()
    for level in np.unique([phase.state_bounds.lower[rows], phase.state_bounds.upper[rows]]):
        if limits[0] <= level <= limits[1]:
            ax.plot(phase.breaks[[0, -1]], [level, level], **BOUND)


def _build_applied_hamiltonian_function(solution: Solution, phase: PhaseSolution) -> Callable[..., Array]:
    hamiltonian = solution.phase_functions(phase.name).hamiltonian
    return lambda t, side: hamiltonian(t, phase.x(t, side), phase.applied(t, side), phase.lam(t, side))
