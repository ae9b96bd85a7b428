"""Figure of the controls and their switching functions over time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gnc_opt.array_types import Array
from gnc_opt.errors import GncOptError
from gnc_opt.model.split_and_magnitude_direction_controls import (
    AssembledControl,
    ComposedControl,
    UnitVectorControl,
    VectorControl,
)
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_summary import time_unit
from gnc_opt.plot.figure_style import (
    COLORS,
    THIN,
    apply_plot_style,
    count_axes_per_figure_row,
    create_figure_with_axes_rows,
    format_axis_label,
    format_variable_name,
    place_legend_above,
)
from gnc_opt.plot.time_plot_axes import (
    BOUND,
    NEGLIGIBLE_SHARE_OF_HAMILTONIAN,
    draw_phase_boundaries,
    draw_signal_components,
    find_largest_hamiltonian_term,
    get_hamiltonian_unit,
    label_bottom_time_axes,
    list_legend_labels,
    sample_piecewise_function,
    select_plotted_phases,
    select_plotted_variable_names,
    set_minimum_y_range,
)
from gnc_opt.text_html_and_json_formatting import format_unit_quotient

_APPLIED: dict[str, Any] = {"label": "applied", "color": COLORS[0]}
_POINTS: dict[str, Any] = {"label": "at nodes", "color": COLORS[1]}
_SPACED_NODES = 200.0
"""Sum of the diameters of the marks of nodes that leave the curve visible, points."""
_SWITCHING: dict[str, Any] = {"color": COLORS[2]}
_NEGATIVE: dict[str, Any] = {"color": COLORS[0], "alpha": 0.12, "linewidth": 0.0}
_ARC_END: dict[str, Any] = {"color": "black", "linewidth": THIN, "linestyle": ":", "zorder": 1}


def plot_controls(
    solution: Solution, names: Sequence[str] | None = None, *, phase: str | None = None
) -> Figure:
    """Return a figure of the controls, with the switching function beside each bounded component.

    Left: the applied signal with its bounds (dashed) and the values at the collocation points. Right: the switching
    function dH/du; where it is negative (shaded), an optimal bounded control is at its upper bound; dotted: arc ends.
    Controls without bounds, and vectors composed of other controls, have one row for all components.

    Parameters
    ----------
    solution, names, phase
        As in `plot_states`, for controls.

    Examples
    --------
    >>> print(len(plot_controls(solution).axes))  # the control, and its switching function
    2
    """
    phases = select_plotted_phases(solution, phase)
    rows = _list_plotted_control_components(phases, find_declared_controls(phases, names))
    if not rows:
        raise GncOptError(f"'{solution.problem_name}' has no controls to draw: use plot_states().")
    paired = [i is not None and solution.problem is not None for _, i in rows]
    with apply_plot_style():
        counts = [1 + pair for pair in paired] if any(paired) else count_axes_per_figure_row(len(rows))
        figure, drawn = create_figure_with_axes_rows(counts, 1.15, gap=0.2 if all(paired) else 0.3)
        axes = iter(drawn)
        for (name, i), pair in zip(rows, paired, strict=True):
            pictures = [next(axes) for _ in range(1 + pair)]
            for each in phases:
                if not has_phase_control(each, name):
                    continue
                if i is None:
                    _draw_all_control_components(pictures[0], each, name)
                else:
                    _draw_bounded_control_component(pictures[0], each, name, i)
                if pair:
                    _draw_switching_function(pictures, solution, each, name, i or 0)
        for ax in drawn:
            draw_phase_boundaries(ax, phases)
        label_bottom_time_axes(figure, time_unit(solution))
        if any(paired) and drawn[0].get_legend() is None:
            place_legend_above(drawn[0], [ax for ax in drawn if ax.get_legend() is None])
    return figure


def has_phase_control(phase: PhaseSolution, name: str) -> bool:
    """Return whether a phase has a control, as solved or as declared."""
    return name in phase.controls or any(c.name == name for c in phase.composed_controls)


def find_declared_controls(phases: Sequence[PhaseSolution], names: Sequence[str] | None = None) -> list[str]:
    """Return the given controls, or all as declared: of a vector control not its direction."""
    composed = {c.name: c for phase in phases for c in phase.composed_controls}
    if names is not None:
        select_plotted_variable_names(phases, "controls", [name for name in names if name not in composed])
        return list(names)
    whole = [c for c in composed.values() if isinstance(c, (VectorControl, UnitVectorControl))]
    omitted = {c.parts[-1] for c in whole}
    plain = [n for n in select_plotted_variable_names(phases, "controls", None) if n not in omitted]
    return plain + [name for name, c in composed.items() if _is_declared_control(c, composed.values())]


def _list_plotted_control_components(
    phases: Sequence[PhaseSolution], names: Sequence[str]
) -> list[tuple[str, int | None]]:
    """Return name and component of each row; None for all components of a control without bounds or fixed."""
    rows: list[tuple[str, int | None]] = []
    for name in names:
        owners = [phase for phase in phases if name in phase.controls]
        limits = [
            (phase.control_bounds.lower[at], phase.control_bounds.upper[at])
            for phase, at in ((phase, phase.controls.slice(name)) for phase in owners)
        ]
        bounded = any(
            np.any((low < high) & np.isfinite(np.fmin(abs(low), abs(high)))) for low, high in limits
        )
        rows += [(name, i) for i in range(owners[0].controls[name].size)] if bounded else [(name, None)]
    return rows


def _draw_bounded_control_component(ax: Axes, phase: PhaseSolution, name: str, i: int) -> None:
    signal = phase.control(name)
    t, applied = sample_piecewise_function(phase.saturated_control(name), phase.applied.jump_times)
    ax.plot(t, applied[i], **_APPLIED, zorder=3)
    size = min(3.5, max(2.2, _SPACED_NODES / phase.point_times.size))
    ax.plot(phase.point_times, np.atleast_2d(signal(phase.point_times))[i], "o", markersize=size, **_POINTS)
    row = phase.controls.slice(name).start + i
    lower, upper = phase.control_bounds.lower[row], phase.control_bounds.upper[row]
    for level in (lower, upper):
        if np.isfinite(level):
            ax.plot(phase.breaks[[0, -1]], [level, level], label="limits", **BOUND)
    if np.isfinite(lower) and np.isfinite(upper) and lower < upper:
        margin = 0.125 * (upper - lower)
        ax.set_ylim(lower - margin, upper + margin)
    ax.set_ylabel(format_axis_label(list_legend_labels(signal)[i], signal.unit))


def _draw_all_control_components(ax: Axes, phase: PhaseSolution, name: str) -> None:
    signal = phase.saturated_control(name)
    labels = list_legend_labels(signal)
    t, values = sample_piecewise_function(signal, phase.applied.jump_times)
    draw_signal_components(ax, t, values, labels if len(labels) > 1 else ["_"])
    ax.set_ylabel(format_axis_label(format_variable_name(name), signal.unit))
    if len(labels) > 1:
        place_legend_above(ax)


def _is_declared_control(control: ComposedControl, others: Iterable[ComposedControl]) -> bool:
    """Return whether a control was declared itself, and not as a part of a control that is drawn."""
    whole = isinstance(control, VectorControl)
    return not any(whole and isinstance(c, AssembledControl) and c.parts[:2] == control.parts for c in others)


def _draw_switching_function(
    axes: Sequence[Axes], solution: Solution, phase: PhaseSolution, name: str, i: int
) -> None:
    """Draw the switching function on the second axes, and mark the ends of the control's arcs on both."""

    def evaluate_switching_function(t: Array, side: Any) -> Any:
        return solution.switching_function(name, t, phase.name, side)

    t, values = sample_piecewise_function(evaluate_switching_function, phase.breaks)
    axes[1].plot(t, values[i], **_SWITCHING)
    axes[1].axhline(0.0, color="black", linewidth=THIN)
    axes[1].locator_params(axis="y", nbins=3)
    signal = phase.control(name)
    shown, per = (
        list_legend_labels(signal)[i],
        format_unit_quotient(get_hamiltonian_unit(solution), signal.unit),
    )
    axes[1].set_ylabel(format_axis_label(f"$\\partial H/\\partial${shown}" + "\n" * bool(per), per))
    row = phase.controls.slice(name).start + i
    reach = phase.control_bounds.upper[row] - phase.control_bounds.lower[row]
    if not (np.isfinite(reach) and reach > 0):
        reach = float(np.max(np.abs(phase.u(phase.point_times)[row]))) or 1.0
    negligible = NEGLIGIBLE_SHARE_OF_HAMILTONIAN * find_largest_hamiltonian_term(solution, phase) / reach
    set_minimum_y_range(axes[1], negligible)
    axes[1].fill_between(
        t, 0, 1, where=values[i] < -negligible, transform=axes[1].get_xaxis_transform(), **_NEGATIVE
    )
    switches = _find_control_arc_ends(solution, phase, row)
    for time in switches:
        for ax in axes:
            ax.axvline(time, **_ARC_END)


def _find_control_arc_ends(solution: Solution, phase: PhaseSolution, row: int) -> list[float]:
    """Return the times between the arcs of a control, s; empty if its arcs are unknown."""
    channel, begin, end = phase.controls.labels[row], phase.initial_time, phase.final_time
    arcs = [arc for arc in solution.structure if arc.phase == phase.name and arc.channel == channel]
    return sorted({arc.start for arc in arcs if begin < arc.start < end})
