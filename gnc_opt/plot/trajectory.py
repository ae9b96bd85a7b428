"""Figures of a solution over time: states, controls with their switching functions, costates, Hamiltonian.

Every function returns a matplotlib `Figure` that belongs to no window; write it with `save_figure`. Without a
phase, all phases are drawn one after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gnc_opt.arrays import Array
from gnc_opt.errors import GncOptError
from gnc_opt.model.composed import AssembledControl, ComposedControl, VectorControl
from gnc_opt.plot.sampling import chosen_names, chosen_phases, data_range, sample, zero_crossings
from gnc_opt.plot.style import (
    COLORS,
    QUIET,
    axis_label,
    legend_above,
    legend_on_top,
    line_look,
    name_text,
    new_figure,
    number_text,
    per_unit,
    style,
)
from gnc_opt.solution.phase_solution import PhaseSolution, Signal
from gnc_opt.solution.solution import Solution
from gnc_opt.tolerances import ROUNDING, magnitude

Labels = Mapping[str, Sequence[str]]
"""Component labels by variable name, e.g. ``{"omega": (r"$\\omega_x$", r"$\\omega_y$", r"$\\omega_z$")}``."""

_BOUND: dict[str, Any] = {"color": QUIET, "linestyle": (0, (4, 3)), "linewidth": 1.0}
_FLOWN: dict[str, Any] = {"color": COLORS[0], "linewidth": 2.0}
_POLYNOMIAL: dict[str, Any] = {"color": COLORS[1], "linewidth": 0.7}
_SWITCHING: dict[str, Any] = {"color": COLORS[2], "linewidth": 1.2}
_SIGN_CHANGE: dict[str, Any] = {"color": "black", "linewidth": 0.7, "linestyle": ":"}
_AT_POINTS: dict[str, Any] = {"color": COLORS[0], "marker": "o", "markersize": 3.2, "linestyle": "none"}
_ALONG_FLOWN: dict[str, Any] = {"color": COLORS[5], "linewidth": 0.9}
_EXPECTED: dict[str, Any] = {"color": COLORS[1], "linestyle": "--", "linewidth": 1.0}

_NEGLIGIBLE = 1e-7
"""Shares of the Hamiltonian up to this are the solver's rounding."""

_ON_BOUND = 1e-3
"""Shares of a control's range: nearer to a bound it counts as on it."""

_ROOM = 1.25
"""Half height of a control's axis in units of its half range: bounds in sight, overshoot cut off."""


def plot_states(
    solution: Solution,
    names: Sequence[str] | None = None,
    *,
    phase: str | None = None,
    labels: Labels | None = None,
) -> Figure:
    """Draw states over time, one axis per (vector) state; bounds dashed where they come into view.

    Parameters
    ----------
    solution : Solution
    names : sequence of str, optional
        States; default all.
    phase : str, optional
        Default all, one after the other.
    labels : mapping, optional
        Component labels for the legend, by name.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    UnknownNameError
        There is no such phase or state.

    Examples
    --------
    >>> from gnc_opt.plot import plot_states
    >>> print(len(plot_states(solution).axes))  # one for each state
    2
    """
    return _draw_each(
        solution,
        phase,
        names,
        labels,
        lambda leg, name: leg.state(name),
        lambda name, unit: axis_label(name_text(name), unit),
        _draw_bounds_in_view,
    )


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
    solution : Solution
    names : sequence of str, optional
        States whose costates to draw; default all.
    phase : str, optional
        Default all, one after the other.
    labels : mapping, optional
        Component labels by state name.
    cost_unit : str
        Unit of the cost; a costate has the unit of the cost per unit of the state.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    UnknownNameError
        There is no such phase or state.

    Examples
    --------
    >>> from gnc_opt.plot import plot_costates
    >>> print(len(plot_costates(solution, ["v"]).axes))
    1
    """
    return _draw_each(
        solution,
        phase,
        names,
        labels,
        lambda leg, name: leg.costate(name),
        lambda name, unit: axis_label(f"costate of {name_text(name)}", per_unit(cost_unit, unit)),
    )


def plot_controls(
    solution: Solution,
    names: Sequence[str] | None = None,
    *,
    phase: str | None = None,
    labels: Labels | None = None,
    hamiltonian_unit: str = "",
) -> Figure:
    """Draw every control component with its switching function underneath.

    Above: the flown signal (bold), the collocation polynomial with its nodes (thin; it may overshoot between
    nodes and is cut off beyond an eighth of the range), bounds dashed. Below: the switching function dH/du;
    a bounded control belongs on its upper bound where this is negative. Dotted lines mark its changes of
    sign. A solution that was loaded without its problem has no switching functions. Controls that are made of two
    (``Model.vector_control``, ``Model.split_control``) follow, as flown.

    Parameters
    ----------
    solution : Solution
    names : sequence of str, optional
        Controls; default all.
    phase : str, optional
        Default all, one after the other.
    labels : mapping, optional
        Component labels by control name.
    hamiltonian_unit : str
        Cost per second; none for minimum time. The switching function has this unit per unit of the control.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    UnknownNameError
        There is no such phase or control.
    GncOptError
        There are no controls at all.

    Examples
    --------
    >>> from gnc_opt.plot import plot_controls
    >>> print(len(plot_controls(solution).axes))  # the control, and its switching function
    2
    """
    legs = chosen_phases(solution, phase)
    known = {c.name: c for leg in legs for c in leg.composed_controls}
    composed = [
        c
        for name, c in known.items()
        if (name in names if names is not None else _as_stated(c, known.values()))
    ]
    names = chosen_names(legs, "controls", names if names is None else [n for n in names if n not in known])
    sizes = {name: leg.controls[name].size for leg in legs for name in names if name in leg.controls}
    parts = [(name, i) for name in names for i in range(sizes[name])]
    if not parts and not composed:
        raise GncOptError(
            f"'{solution.problem_name}' has no controls to draw: draw its states by plot_states()."
        )
    rows = 1 if solution.problem is None else 2
    with style():
        figure = new_figure(0.5 + 2.15 * (len(parts) + len(composed)))
        ratios = [2.2, 1.0][:rows] * len(parts) + [2.2] * len(composed)
        grid = figure.subplots(len(ratios), 1, sharex=True, squeeze=False, height_ratios=ratios)[:, 0]
        for ax, control in zip(grid[rows * len(parts) :], composed, strict=True):
            _draw_composed(ax, legs, control, labels)
        for k, (name, i) in enumerate(parts):
            axes = grid[rows * k : rows * (k + 1)]
            for leg in legs:
                if name in leg.controls:
                    shown = _labels(name, leg.control(name), labels)[i]
                    _draw_control(axes[0], leg, name, i, shown)
                    if rows == 2:
                        _draw_switching(axes, solution, leg, name, i, shown, hamiltonian_unit)
        for ax in grid:
            _span(ax, legs)
        grid[-1].set_xlabel("time (s)")
        figure.align_ylabels(list(grid))
        legend_on_top(figure, _control_legend(rows == 2))
    return figure


def plot_hamiltonian(
    solution: Solution, *, phase: str | None = None, expected: float | None = None, unit: str = ""
) -> Figure:
    """Draw the Hamiltonian over time with the band it stays in.

    Marks show it at the collocation points, where the program sees it; the line is drawn along the flown
    controls.

    Parameters
    ----------
    solution : Solution
        Joined to its problem.
    phase : str, optional
        Default all, one after the other.
    expected : float, optional
        The value it ought to have, e.g. -1 for minimum time; drawn as a dashed line.
    unit : str
        Cost per second; none for minimum time.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    GncOptError
        The solution was loaded without its problem.

    Examples
    --------
    >>> from gnc_opt.plot import plot_hamiltonian
    >>> print(plot_hamiltonian(solution).axes[0].get_xlabel())
    time (s)
    """
    legs = chosen_phases(solution, phase)
    at_points = [np.asarray(solution.hamiltonian(leg.point_times, leg.name)) for leg in legs]
    along = [sample(_flown_hamiltonian(solution, leg), leg.flown.jumps) for leg in legs]
    low, high = data_range(np.concatenate(at_points))
    with style():
        figure = new_figure(3.8)
        ax = figure.subplots()
        ax.axhspan(low, high, color=COLORS[0], alpha=0.12, linewidth=0, zorder=1)
        for leg, points, (t, values) in zip(legs, at_points, along, strict=True):
            ax.plot(t, values[0], zorder=2, **_ALONG_FLOWN)
            ax.plot(leg.point_times, points, zorder=3, **_AT_POINTS)
        if expected is not None:
            ax.axhline(expected, zorder=2.5, **_EXPECTED)
        _leave_room(ax, _NEGLIGIBLE * max(abs(low), abs(high)))
        _span(ax, legs)
        ax.set_xlabel("time (s)")
        ax.set_ylabel(axis_label("Hamiltonian", unit))
        legend_on_top(figure, _hamiltonian_legend(low, high, expected), columns=2)
    return figure


# --- pieces of figures --------------------------------------------------------------------------------


def _draw_each(
    solution: Solution,
    phase: str | None,
    names: Sequence[str] | None,
    labels: Labels | None,
    signal_of: Callable[[PhaseSolution, str], Signal],
    label_of: Callable[[str, str], str],
    decorate: Callable[[Axes, PhaseSolution, str], None] | None = None,
) -> Figure:
    """One axis per state, the phases that have it one after the other.

    ``signal_of(leg, name)`` is what to draw, ``label_of(name, unit of the state)`` names its axis, and ``decorate`` may
    add to it.
    """
    legs = chosen_phases(solution, phase)
    names = chosen_names(legs, "states", names)
    with style():
        figure = new_figure(0.4 + 2.6 * len(names))
        axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        for ax, name in zip(axes, names, strict=True):
            for leg in legs:
                if name in leg.states:
                    signal = signal_of(leg, name)
                    _draw_components(ax, *sample(signal, leg.breaks), _labels(name, signal, labels))
                    ax.set_ylabel(label_of(name, leg.state(name).unit))
                    if decorate is not None:
                        decorate(ax, leg, name)
            _span(ax, legs)
            legend_above(ax)
        axes[-1].set_xlabel("time (s)")
        figure.align_ylabels(list(axes))
    return figure


def _labels(name: str, signal: Any, labels: Labels | None) -> Sequence[str]:
    return (labels or {}).get(name) or [name_text(label) for label in signal.labels]


def _draw_components(ax: Axes, t: Array, values: Array, labels: Sequence[str]) -> None:
    known = set(ax.get_legend_handles_labels()[1])
    for i, row in enumerate(values):
        ax.plot(t, row, label=None if labels[i] in known else labels[i], **line_look(i))


def _draw_bounds_in_view(ax: Axes, leg: PhaseSolution, name: str) -> None:
    rows, limits = leg.states.slice(name), ax.get_ylim()
    for level in np.unique([leg.state_bounds.lower[rows], leg.state_bounds.upper[rows]]):
        if limits[0] <= level <= limits[1]:
            ax.plot(leg.breaks[[0, -1]], [level, level], **_BOUND)


def _draw_control(ax: Axes, leg: PhaseSolution, name: str, i: int, shown: str) -> None:
    signal = leg.control(name)
    t, polynomial = sample(signal, leg.breaks, gaps=True)
    ax.plot(t, polynomial[i], zorder=2, **_POLYNOMIAL)
    nodes = np.atleast_2d(signal(leg.point_times))[i]
    ax.plot(leg.point_times, nodes, ".", color=_POLYNOMIAL["color"], markersize=3.0, zorder=4)
    t, flown = sample(leg.flown_control(name), leg.flown.jumps)
    ax.plot(t, flown[i], zorder=3, **_FLOWN)
    row = leg.controls.slice(name).start + i
    lower, upper = leg.control_bounds.lower[row], leg.control_bounds.upper[row]
    for level in (lower, upper):
        if np.isfinite(level):
            ax.plot(leg.breaks[[0, -1]], [level, level], zorder=1.5, **_BOUND)
    if np.isfinite(lower) and np.isfinite(upper) and lower < upper:
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        ax.set_ylim(middle - _ROOM * half, middle + _ROOM * half)
    ax.set_ylabel(axis_label(shown, signal.unit))


def _as_stated(control: ComposedControl, others: Iterable[ComposedControl]) -> bool:
    """Whether a control was stated as it is, and not as components that are drawn themselves."""
    whole = isinstance(control, VectorControl)
    return not any(whole and isinstance(c, AssembledControl) and c.parts[:2] == control.parts for c in others)


def _draw_composed(
    ax: Axes, legs: Sequence[PhaseSolution], control: ComposedControl, labels: Labels | None
) -> None:
    """Draw all components of a control that is made of two, as flown."""
    for leg in legs:
        if control in leg.composed_controls:
            signal = leg.flown_control(control.name)
            shown = _labels(control.name, signal, labels)
            _draw_components(ax, *sample(signal, leg.flown.jumps), shown)
    ax.set_ylabel(axis_label(name_text(control.name), control.variable.unit))
    if control.variable.size > 1:
        legend_above(ax)


def _draw_switching(
    axes: Sequence[Axes], solution: Solution, leg: PhaseSolution, name: str, i: int, shown: str, unit: str
) -> None:
    """Draw into the second axis; mark changes of sign in both."""

    def switching(t: Array, side: Any) -> Any:
        return solution.switching_function(name, t, leg.name, side)

    t, values = sample(switching, leg.breaks)
    axes[1].plot(t, values[i], **_SWITCHING)
    axes[1].axhline(0.0, color="black", linewidth=0.6)
    axes[1].locator_params(axis="y", nbins=3)
    per = per_unit(unit, leg.control(name).unit)
    axes[1].set_ylabel(axis_label(f"$\\partial H/\\partial${shown}" + "\n" * bool(per), per))
    negligible = _negligible_switching(solution, leg, name, i)
    _leave_room(axes[1], negligible)
    on_bound = _on_a_bound(
        leg, leg.controls.slice(name).start + i, t
    )  # between them it is zero up to rounding
    for crossing in zero_crossings(t[on_bound], values[i][on_bound], negligible):
        for ax in axes:
            ax.axvline(crossing, zorder=1, **_SIGN_CHANGE)


def _on_a_bound(leg: PhaseSolution, row: int, t: Array) -> Any:
    """Return at which times (n_times,) the flown control sits on one of its bounds."""
    lower, upper = leg.control_bounds.lower[row], leg.control_bounds.upper[row]
    flown = leg.flown(t)[row]
    room = np.minimum(flown - lower, upper - flown)
    return room <= _ON_BOUND * (upper - lower if np.isfinite(upper - lower) else 1.0 + np.max(np.abs(flown)))


def _negligible_switching(solution: Solution, leg: PhaseSolution, name: str, i: int) -> float:
    """Return the switching function that is worth 1e-7 of the Hamiltonian's terms over the control's range.

    An interior control holds it at zero; without this the figure would magnify the rounding errors.
    """
    t, rows = leg.point_times, leg.controls.slice(name)
    row = rows.start + i
    terms = leg.lam(t) * solution.functions(leg.name).rates(t, leg.x(t), leg.u(t))
    reach = leg.control_bounds.upper[row] - leg.control_bounds.lower[row]
    if not (np.isfinite(reach) and reach > 0):
        reach = float(np.max(np.abs(leg.u(t)[rows]))) or 1.0
    return float(_NEGLIGIBLE * np.max(np.sum(np.abs(terms), axis=0)) / reach)


def _control_legend(with_switching: bool) -> list[Any]:
    handles = [
        Line2D([], [], label="flown", **_FLOWN),
        Line2D([], [], label="polynomial and nodes", marker=".", markersize=4, **_POLYNOMIAL),
        Line2D([], [], label="bounds", **_BOUND),
    ]
    if with_switching:
        handles.append(Line2D([], [], label="switching function", **_SWITCHING))
    return handles


def _flown_hamiltonian(solution: Solution, leg: PhaseSolution) -> Callable[..., Array]:
    functions = solution.functions(leg.name)

    def hamiltonian(t: Array, side: Any) -> Array:
        return functions.hamiltonian(t, leg.x(t, side), leg.flown(t, side), leg.lam(t, side))

    return hamiltonian


def _hamiltonian_legend(low: float, high: float, expected: float | None) -> list[Any]:
    ends = number_text(low), number_text(high)
    told = (
        f"{ends[0]} to {ends[1]}"
        if ends[0] != ends[1]
        else f"{ends[0]} \N{PLUS-MINUS SIGN} {number_text(0.5 * (high - low), 2)}"
    )
    handles: list[Any] = [
        Line2D([], [], label="at the collocation points", **_AT_POINTS),
        Line2D([], [], label=f"band of these, {told}", color=COLORS[0], alpha=0.25, linewidth=6),
        Line2D([], [], label="along the flown controls", **_ALONG_FLOWN),
    ]
    if expected is not None:
        handles.append(Line2D([], [], label=f"expected, {number_text(expected)}", **_EXPECTED))
    return handles


def _leave_room(ax: Axes, least: float) -> None:
    """Show at least ``least`` to both sides of the data, lest rounding errors fill the axis."""
    low, high = ax.get_ylim()
    if high - low < least:
        ax.set_ylim(low - least, high + least)


def _heights(line: Line2D) -> Array:
    return np.asarray(line.get_ydata(), dtype=float)


def _span(ax: Axes, legs: Sequence[PhaseSolution]) -> None:
    """Show all phases, with a dotted line between one and the next, and noise as zero."""
    reach = max((float(np.nanmax(np.abs(y), initial=0.0)) for y in map(_heights, ax.lines)), default=0.0)
    _leave_room(ax, ROUNDING * float(magnitude(reach)))
    ax.set_xlim(legs[0].breaks[0], legs[-1].breaks[-1])
    for leg in legs[1:]:
        ax.axvline(leg.breaks[0], color=QUIET, linewidth=0.8, linestyle=":")
