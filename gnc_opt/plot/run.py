"""Figures of closed-loop runs: states with their reference, controls, errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gnc_opt.plot.style import QUIET, axis_label, legend_above, line_look, name_text, new_figure, style
from gnc_opt.simulation.run import Logged, Run


def plot_run_states(run: Run, names: Sequence[str] | None = None) -> Figure:
    """Return a figure that shows states of the plant, one axis per (vector) state; their reference dashed grey.

    Parameters
    ----------
    run : Run
    names : sequence of str, optional
        Default all.

    Raises
    ------
    UnknownNameError
        There is no such state.

    Examples
    --------
    >>> figure = plot_run_states(run, ["q"])
    """

    def draw(ax: Axes, name: str) -> None:
        signal = run.state(name)
        if run.reference is not None and name in run.followed:
            followed = run.reference[run.followed.slice(name)]
            for i, row in enumerate(followed):
                label = "reference" if i == 0 else "_"
                ax.plot(run.times, row, color=QUIET, linestyle="--", linewidth=1.0, label=label)
        _lines(ax, signal)

    return _axes(run, names or run.layouts["state"].names, draw)


def plot_run_errors(run: Run, names: Sequence[str] | None = None) -> Figure:
    """Return a figure that shows the errors of states relative to the reference, one axis each.

    Parameters
    ----------
    run : Run
    names : sequence of str, optional
        States; default all.

    Raises
    ------
    ArgumentError
        The controller of the run follows no reference.

    Examples
    --------
    >>> figure = plot_run_errors(run)
    """
    return _axes(
        run,
        names or [n for n in run.followed.names if n in run.layouts["error"]],
        lambda ax, name: _lines(ax, run.error(name)),
    )


def plot_run_controls(run: Run, names: Sequence[str] | None = None) -> Figure:
    """Return a figure that shows the applied controls (means over control steps), and commands of the same name.

    Parameters
    ----------
    run : Run
    names : sequence of str, optional
        Controls of the plant; default all.

    Examples
    --------
    >>> figure = plot_run_controls(run)
    """

    def draw(ax: Axes, name: str) -> None:
        if name in run.layouts["command"]:
            command = run.command(name)
            for i, row in enumerate(command.values):
                label = "command" if i == 0 else "_"
                ax.step(
                    command.times, row, where="post", color=QUIET, linestyle="--", linewidth=1.0, label=label
                )
        _lines(ax, run.control(name))

    return _axes(run, names or run.layouts["applied"].names, draw)


def _axes(run: Run, names: Sequence[str], draw: Callable[[Axes, str], None]) -> Figure:
    with style():
        figure = new_figure(1.2 + 1.6 * len(names))
        axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        for ax, name in zip(axes, names, strict=True):
            draw(ax, name)
            legend_above(ax)
            ax.set_xlim(run.times[0], run.times[-1])
        axes[-1].set_xlabel("time (s)")
    return figure


def _lines(ax: Axes, signal: Logged) -> None:
    """Draw the components of a signal and label their axis."""
    for i, row in enumerate(signal.values):
        look = line_look(i)
        label = name_text(signal.labels[i])
        if signal.held:
            ax.step(signal.times, row, where="post", label=label, **look)
        else:
            ax.plot(signal.times, row, label=label, **look)
    ax.set_ylabel(axis_label(name_text(signal.name), signal.unit))
