"""Figures of a solution over time: states, controls with their switching functions, costates, Hamiltonian.

Every function returns a matplotlib `Figure` that belongs to no window; write it with `save_figure`. Without a
phase, all phases are drawn one after the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gnc_opt.model.layout import Array
from gnc_opt.plot.sampling import chosen_names, chosen_phases, data_range, sample
from gnc_opt.plot.style import QUIET, axis_label, legend_above, line_look, new_figure, style, unit_text
from gnc_opt.solution.phase_solution import PhaseSolution
from gnc_opt.solution.solution import Solution

Labels = Mapping[str, Sequence[str]]
"""Component labels by variable name, e.g. ``{"omega": (r"$\\omega_x$", r"$\\omega_y$", r"$\\omega_z$")}``."""

TIME = "time (s)"

_ROOM = 1.25
"""Half height of a control's axis in units of its half range: bounds in sight, overshoot cut off."""


def plot_states(
    solution: Solution, names: Sequence[str] | None = None, *, phase: str | None = None, labels: Labels | None = None
) -> Figure:
    """Draw states over time, one axis per (vector) state; bounds dashed where they come into view.

    Parameters
    ----------
    solution : Solution
    names : sequence of str, optional
        States; default all.
    phase : str, optional
    labels : mapping, optional
        Component labels for the legend.
    """
    legs = chosen_phases(solution, phase)
    names = chosen_names(legs, "states", names)
    with style():
        figure, axes = _stacked_axes(len(names))
        for ax, name in zip(axes, names, strict=True):
            first = next(leg for leg in legs if name in leg.states)
            for leg in legs:
                if name in leg.states:
                    _draw_components(ax, *sample(leg.state(name), leg.breaks), _labels(name, first.state(name), labels))
            for leg in legs:
                if name in leg.states:
                    _draw_bounds_in_view(ax, leg, name)
            _finish(ax, axis_label(_quantity(name, labels), first.state(name).unit), legs)
        axes[-1].set_xlabel(TIME)
    return figure


def plot_costates(
    solution: Solution,
    names: Sequence[str] | None = None,
    *,
    phase: str | None = None,
    labels: Labels | None = None,
    cost_unit: str = "",
) -> Figure:
    """Draw the costates of states over time, one axis per (vector) state.

    Parameters
    ----------
    names : sequence of str, optional
        States whose costates to draw; default all.
    labels : mapping, optional
        Component labels by state name.
    cost_unit : str
        Unit of the cost; a costate has the unit of the cost per unit of the state.
    """
    legs = chosen_phases(solution, phase)
    names = chosen_names(legs, "states", names)
    with style():
        figure, axes = _stacked_axes(len(names))
        for ax, name in zip(axes, names, strict=True):
            first = next(leg for leg in legs if name in leg.states)
            shown = (labels or {}).get(name) or [f"lam_{label}" for label in first.state(name).labels]
            for leg in legs:
                if name in leg.states:
                    _draw_components(ax, *sample(leg.costate(name), leg.breaks), shown)
            _finish(ax, axis_label(f"costate of {name}", per_unit(cost_unit, first.state(name).unit)), legs)
        axes[-1].set_xlabel(TIME)
    return figure


def plot_controls(
    solution: Solution, names: Sequence[str] | None = None, *, phase: str | None = None, labels: Labels | None = None
) -> Figure:
    """Draw every control component with its switching function underneath.

    Above: the flown signal (bold), the collocation polynomial with its nodes (thin; it may overshoot between
    nodes, and is cut off beyond a quarter of the range), bounds dashed. Below: the switching function dH/du; a
    bounded control sits at its upper bound where this is negative. A solution that was loaded without its problem
    has no switching functions.
    """
    legs = chosen_phases(solution, phase)
    names = chosen_names(legs, "controls", names)
    parts = [
        (name, i) for name in names for i in range(next(g for g in legs if name in g.controls).controls[name].size)
    ]
    with style():
        figure = new_figure(0.5 + 2.15 * len(parts))
        rows = 1 if solution.problem is None else 2
        ratios = [2.2, 1.0][:rows] * len(parts)
        grid = figure.subplots(rows * len(parts), 1, sharex=True, squeeze=False, height_ratios=ratios)[:, 0]
        for k, (name, i) in enumerate(parts):
            pair = grid[rows * k : rows * (k + 1)]
            _draw_control(pair[0], legs, name, i, labels)
            if rows == 2:
                _draw_switching(pair[1], solution, legs, name, i, labels)
        legend_above(grid[0], _control_legend(rows == 2))
        grid[-1].set_xlabel(TIME)
        figure.align_ylabels(list(grid))
    return figure


def plot_hamiltonian(
    solution: Solution, *, phase: str | None = None, expected: float | None = None, unit: str = ""
) -> Figure:
    """Draw the Hamiltonian over time with the band it stays in.

    It is drawn along the flown controls; marks show it at the collocation points, where the program sees it.

    Parameters
    ----------
    expected : float, optional
        The value it ought to have, e.g. -1 for minimum time; drawn as a dashed line.
    unit : str
        Cost per second; none for minimum time.
    """
    legs = chosen_phases(solution, phase)
    with style():
        figure, (ax,) = _stacked_axes(1, height=3.4)
        point_values, dense_values = [], []
        for leg in legs:
            points = np.asarray(solution.hamiltonian(leg.point_times, leg.name))
            t, dense = sample(_flown_hamiltonian(solution, leg), leg.flown.jumps)
            ax.plot(t, dense[0], color="#56b4e9", linewidth=0.9, zorder=2)
            ax.plot(leg.point_times, points, "o", color="#0072b2", markersize=3.2, zorder=3)
            point_values.append(points)
            dense_values.append(dense[0])
        low, high = data_range(np.concatenate(point_values))
        ax.axhspan(low, high, color="#0072b2", alpha=0.12, linewidth=0, zorder=1)
        if expected is not None:
            ax.axhline(expected, color="#d55e00", linestyle="--", linewidth=1.0, zorder=2.5)
        _show_all(ax, np.concatenate(dense_values), *([] if expected is None else [expected]))
        _finish(ax, axis_label("Hamiltonian", unit), legs, legend=False)
        legend_above(ax, _hamiltonian_legend(low, high, expected), columns=2)
        ax.set_xlabel(TIME)
    return figure


def per_unit(unit: str, other: str) -> str:
    """Return the unit of a derivative: ``per_unit("s", "m/s") == "s/(m/s)"``."""
    if not other:
        return unit
    return f"{unit or '1'}/({other})" if set(other) & set(" /*") else f"{unit or '1'}/{other}"


# --- pieces of figures --------------------------------------------------------------------------------


def _stacked_axes(count: int, height: float = 2.6) -> tuple[Figure, list[Axes]]:
    figure = new_figure(0.4 + height * count)
    axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    figure.align_ylabels(list(axes))
    return figure, list(axes)


def _labels(name: str, signal: Any, labels: Labels | None) -> Sequence[str]:
    return (labels or {}).get(name) or signal.labels


def _quantity(name: str, labels: Labels | None) -> str:
    """What the axis is called: the component labels are in the legend, so the name is enough."""
    shown = (labels or {}).get(name)
    return shown[0] if shown and len(shown) == 1 else name


def _draw_components(ax: Axes, t: Array, values: Array, labels: Sequence[str]) -> None:
    known = set(ax.get_legend_handles_labels()[1])
    for i, row in enumerate(values):
        ax.plot(t, row, label=None if labels[i] in known else labels[i], **line_look(i))


def _draw_bounds_in_view(ax: Axes, leg: PhaseSolution, name: str) -> None:
    limits = ax.get_ylim()
    rows = leg.states.slice(name)
    for level in np.unique([leg.state_bounds.lower[rows], leg.state_bounds.upper[rows]]):
        if limits[0] <= level <= limits[1]:
            ax.plot(leg.breaks[[0, -1]], [level, level], **_BOUND)
    ax.set_ylim(limits)


_BOUND: dict[str, Any] = {"color": QUIET, "linestyle": (0, (4, 3)), "linewidth": 1.0}
_FLOWN: dict[str, Any] = {"color": "#0072b2", "linewidth": 2.0}
_POLYNOMIAL: dict[str, Any] = {"color": "#d55e00", "linewidth": 0.7}
_SWITCHING: dict[str, Any] = {"color": "#009e73", "linewidth": 1.2}


def _draw_control(ax: Axes, legs: Sequence[PhaseSolution], name: str, i: int, labels: Labels | None) -> None:
    for leg in legs:
        if name not in leg.controls:
            continue
        signal, flown = leg.control(name), leg.flown_control(name)
        row = leg.controls.slice(name).start + i
        t, polynomial = sample(signal, leg.breaks, gaps=True)
        ax.plot(t, polynomial[i], zorder=2, **_POLYNOMIAL)
        nodes = np.atleast_2d(signal(leg.point_times))[i]
        ax.plot(leg.point_times, nodes, ".", color=_POLYNOMIAL["color"], markersize=3.5, zorder=2.2)
        t, bounded = sample(flown, leg.flown.jumps, per_piece=12)
        ax.plot(t, bounded[i], zorder=3, **_FLOWN)
        lower, upper = leg.control_bounds.lower[row], leg.control_bounds.upper[row]
        for level in (lower, upper):
            if np.isfinite(level):
                ax.axhline(level, zorder=1.5, **_BOUND)
        if np.isfinite(lower) and np.isfinite(upper):
            middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
            ax.set_ylim(middle - _ROOM * half, middle + _ROOM * half)
        shown = _labels(name, signal, labels)
        _finish(ax, axis_label(shown[i], signal.unit), legs, legend=False)


def _draw_switching(
    ax: Axes, solution: Solution, legs: Sequence[PhaseSolution], name: str, i: int, labels: Labels | None
) -> None:
    for leg in legs:
        if name not in leg.controls:
            continue

        def switching(t: Array, side: Any, leg: PhaseSolution = leg) -> Any:
            return solution.switching_function(name, t, leg.name, side)

        t, values = sample(switching, leg.breaks)
        ax.plot(t, values[i], **_SWITCHING)
        shown = _labels(name, leg.control(name), labels)
        ax.axhline(0.0, color="black", linewidth=0.6)
        _finish(ax, f"$\\partial H/\\partial${shown[i]}", legs, legend=False)
        ax.locator_params(axis="y", nbins=3)


def _control_legend(with_switching: bool) -> list[Any]:
    handles = [
        Line2D([], [], label="flown", **_FLOWN),
        Line2D([], [], label="polynomial and nodes", marker=".", markersize=3.5, **_POLYNOMIAL),
        Line2D([], [], label="bounds", **_BOUND),
    ]
    if with_switching:
        handles.append(Line2D([], [], label="switching function", **_SWITCHING))
    return handles


def _flown_hamiltonian(solution: Solution, leg: PhaseSolution) -> Any:
    functions = solution.functions(leg.name)

    def hamiltonian(t: Array, side: Any) -> Array:
        return functions.hamiltonian(t, leg.x(t, side), leg.flown(t, side), leg.lam(t, side))

    return hamiltonian


def _hamiltonian_legend(low: float, high: float, expected: float | None) -> list[Any]:
    handles: list[Any] = [
        Line2D([], [], marker="o", markersize=3.2, linestyle="none", color="#0072b2", label="at the collocation points"),
        Line2D([], [], color="#0072b2", alpha=0.25, linewidth=6, label=f"their band, {low:.6g} to {high:.6g}"),
        Line2D([], [], color="#56b4e9", linewidth=0.9, label="along the flown controls"),
    ]
    if expected is not None:
        handles.append(Line2D([], [], color="#d55e00", linestyle="--", linewidth=1.0, label=f"$H={expected:g}$"))
    return handles


def _show_all(ax: Axes, values: Array, *levels: float) -> None:
    low, high = data_range([*data_range(values), *levels])
    room = 0.08 * (high - low) or 1e-3 * max(abs(low), 1.0)
    ax.set_ylim(low - room, high + room)


def _finish(ax: Axes, label: str, legs: Sequence[PhaseSolution], legend: bool = True) -> None:
    ax.set_ylabel(label)
    ax.set_xlim(legs[0].breaks[0], legs[-1].breaks[-1])
    for leg in legs[1:]:
        ax.axvline(leg.breaks[0], color=QUIET, linewidth=0.6, linestyle=":")
    if legend:
        legend_above(ax)


__all__ = [
    "Labels",
    "per_unit",
    "plot_controls",
    "plot_costates",
    "plot_hamiltonian",
    "plot_states",
    "unit_text",
]
