"""Figure of a closed-loop run: states with reference, applied controls, or errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gnc_opt.errors import ArgumentError, quote_value, suggest_similar_name
from gnc_opt.plot.figure_style import (
    QUIET,
    THIN,
    apply_plot_style,
    count_axes_per_figure_row,
    create_figure_with_axes_rows,
    format_axis_label,
    format_variable_name,
    get_line_style,
    place_legend_above,
)
from gnc_opt.plot.time_plot_axes import label_bottom_time_axes
from gnc_opt.simulation.simulation_run_results import LoggedSignal, Run

Kind: TypeAlias = Literal["states", "controls", "errors"]

_FOLLOWED: dict[str, Any] = {"color": QUIET, "linestyle": "--", "linewidth": THIN}


def plot_run(run: Run, kind: Kind = "states", names: Sequence[str] | None = None) -> Figure:
    """Return a figure of signals of a run over time, with one axis per (vector) signal.

    Parameters
    ----------
    run : Run
    kind : {"states", "controls", "errors"}
        States of the plant with reference (dashed grey); applied controls (means over control steps) with commands of
        the same name (dashed grey); errors of the states relative to the reference.
    names : sequence of str, optional
        Names of signals; default: all.

    Raises
    ------
    UnknownNameError
        The signal does not exist.
    ArgumentError
        Unknown kind, or errors of a run without reference.

    Examples
    --------
    >>> figure = plot_run(run, "states", ["q"])
    """
    known = {
        "states": run.layouts["state"].names,
        "controls": run.layouts["applied"].names,
        "errors": [n for n in run.reference_layout.names if n in run.layouts["error"]],
    }
    if kind not in known:
        raise ArgumentError(
            f"a run has no {quote_value(kind)} to draw: {suggest_similar_name(str(kind), known)}"
        )
    signal_of = {"states": run.state, "controls": run.control, "errors": run.error}[kind]
    names = names or known[kind]
    with apply_plot_style():
        figure, axes = create_figure_with_axes_rows(count_axes_per_figure_row(len(names)), 1.7)
        for ax, name in zip(axes, names, strict=True):
            signal = signal_of(name)
            if kind == "states" and run.reference is not None and name in run.reference_layout:
                rows = run.reference[run.reference_layout.slice(name)]
                ax.plot(run.times, rows.T, label=["reference", *["_"] * (len(rows) - 1)], **_FOLLOWED)
            elif kind == "controls" and name in run.layouts["command"]:
                _draw_logged_signal_components(
                    ax, run.command(name), [{**_FOLLOWED, "label": "command"}, _FOLLOWED]
                )
            labels = map(format_variable_name, signal.labels)
            _draw_logged_signal_components(
                ax, signal, [{"label": text, **get_line_style(i)} for i, text in enumerate(labels)]
            )
            quantity = "error of " * (kind == "errors") + format_variable_name(signal.name)
            ax.set_ylabel(format_axis_label(quantity, signal.unit))
            place_legend_above(ax)
            ax.set_xlim(run.times[0], run.times[-1])
        label_bottom_time_axes(figure, "s")
    return figure


def _draw_logged_signal_components(ax: Axes, signal: LoggedSignal, looks: Sequence[dict[str, Any]]) -> None:
    """Draw the components of a signal; the last style is used for all further components."""
    for i, row in enumerate(signal.values):
        look = {"label": "_", **looks[min(i, len(looks) - 1)]}
        ax.plot(signal.times, row, drawstyle="steps-post" if signal.held else "default", **look)
