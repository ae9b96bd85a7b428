"""Figures of the tethered pair: the publication's plots, the comparison of laws, the optima and their tracking."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gnc_opt.plot.style import QUIET, legend_on_top, line_look, new_figure, save_figure, style
from problems.tethered_formation.model import MAX_ANGLE, MAX_RATE, Orbit
from problems.tethered_formation.optimal import Optimum
from problems.tethered_formation.runs import Manoeuvre

_LAWS = ("MPC", "linear", "switching 0.01", "no control")


def write_figures(
    folder: Path,
    runs: Mapping[str, Manoeuvre],
    optima: Mapping[str, Optimum],
    tracked: Mapping[str, Manoeuvre],
) -> list[Path]:
    """Write all figures as PNG and return their paths."""
    with style():
        figures = {
            "published": _published(runs["MPC"]),
            "histories": _histories(runs["MPC"]),
            "laws": _laws(runs),
            "chattering": _chattering(runs),
            "optima": _optima(runs["MPC"], optima),
            "tracking": _tracking(tracked),
        }
        return [save_figure(figure, folder / f"{name}.png") for name, figure in figures.items()]


def _axes(figure: Figure, rows: int, labels: tuple[str, ...]) -> list[Axes]:
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    for ax, label in zip(axes, labels, strict=True):
        ax.set_ylabel(label)
        ax.margins(x=0)
    axes[-1].set_xlabel("time (s)")
    figure.align_ylabels(list(axes))
    return list(axes)


def _limits(ax: Axes, limit: float) -> None:
    for value in (-limit, limit):
        ax.axhline(value, color=QUIET, linewidth=0.8, linestyle=":")


def _published(m: Manoeuvre) -> Figure:
    """The publication's plots: swing, errors of the orbit, thrust angle and rate, tension."""
    figure = new_figure(8.6)
    labels = (
        "swing error\n(deg)",
        "radial error\n(m)",
        "error along\nthe orbit (m)",
        "thrust angle\n(deg)",
        "its rate\n(rad/s)",
        "tension\n(N)",
    )
    axes = _axes(figure, 6, labels)
    values = (m.swing, m.height, m.lead, m.angle, m.rate, m.tension)
    for ax, value in zip(axes, values, strict=True):
        held = value.size < m.times.size
        ax.plot(m.times[: value.size], value, drawstyle="steps-post" if held else "default", **line_look(0))
    _limits(axes[3], np.degrees(MAX_ANGLE))
    _limits(axes[4], MAX_RATE)
    return figure


def _histories(m: Manoeuvre) -> Figure:
    """The publication's other plots: swing rate, climb beside that of the reference, and sigma."""
    figure = new_figure(5.4)
    axes = _axes(figure, 3, ("swing rate\n(deg/s)", "radial rate\n(m/s)", r"$\sigma$ (rad/s$^2$)"))
    axes[0].plot(m.times, np.degrees(m.run.state("theta_rate").values[0]), **line_look(0))
    climb = m.run.state("climb").values[0]
    axes[1].plot(m.times, climb, label="flown", **line_look(0))
    axes[1].plot(m.times, climb - m.climb, label="reference", **line_look(1))
    axes[1].legend(loc="upper left")
    sigma = m.run.remembered("sigma")
    axes[2].plot(sigma.times, sigma.values[0], **line_look(0))
    return figure


def _laws(runs: Mapping[str, Manoeuvre]) -> Figure:
    figure = new_figure(6.4)
    axes = _axes(figure, 3, ("swing error (deg)", "radial error (m)", "thrust angle (deg)"))
    for i, name in enumerate(_LAWS):
        m = runs[name]
        for ax, value in zip(axes, (m.swing, m.height, m.angle), strict=True):
            ax.plot(m.times, value, label=name, **line_look(i))
    _limits(axes[2], np.degrees(MAX_ANGLE))
    legend_on_top(figure, axes[0].get_lines())
    return figure


def _chattering(runs: Mapping[str, Manoeuvre]) -> Figure:
    """The commanded rates over ten seconds after the limits have let go."""
    names = ("switching 0.01", "MPC", "MPC, no observer")
    figure = new_figure(5.0)
    axes = _axes(figure, 3, ("rate (mrad/s)",) * 3)
    for ax, name in zip(axes, names, strict=True):
        m = runs[name]
        shown = (m.times[:-1] >= 150.0) & (m.times[:-1] <= 160.0)
        ax.plot(
            m.times[:-1][shown], 1e3 * m.rate[shown], drawstyle="steps-post", linewidth=1.0, **line_look(0)
        )
        ax.set_title(name, loc="left")
        ax.set_xlim(150.0, 160.0)
    return figure


def _optima(published: Manoeuvre, optima: Mapping[str, Optimum]) -> Figure:
    figure, orbit = new_figure(7.6), Orbit.of()
    axes = _axes(figure, 4, ("swing (deg)", "radial error (m)", "thrust angle (deg)", "its rate (rad/s)"))
    values = (published.swing, published.height, published.angle)
    for ax, value in zip(axes, values, strict=False):
        ax.plot(published.times, value, label="published structure", **line_look(0))
    axes[3].plot(
        published.times[:-1],
        published.rate,
        drawstyle="steps-post",
        linewidth=0.8,
        color=line_look(0)["color"],
    )
    for i, (name, label) in enumerate((("time", "least time"), ("effort", "least effort")), start=1):
        leg = optima[name].leg
        t = np.linspace(0.0, leg.final_time, 2001)
        height = np.ravel(leg.state("height")(t)) - np.array([orbit(float(s))[0] for s in t])
        swing, angle = (np.degrees(np.ravel(leg.state(n)(t))) for n in ("theta", "gamma"))
        rate = np.ravel(leg.flown_control("gamma_rate")(t))
        for ax, value in zip(axes, (swing, height, angle, rate), strict=True):
            ax.plot(t, value, label=label, **line_look(i))
    _limits(axes[2], np.degrees(MAX_ANGLE))
    _limits(axes[3], MAX_RATE)
    legend_on_top(figure, axes[0].get_lines())
    return figure


def _tracking(tracked: Mapping[str, Manoeuvre]) -> Figure:
    """Errors against the planned least-time manoeuvre, flown by the published structure."""
    figure = new_figure(6.4)
    axes = _axes(figure, 3, ("swing error (deg)", "radial error (m)", "thrust angle (deg)"))
    for i, (case, m) in enumerate(tracked.items()):
        for ax, value in zip(axes, (m.swing, m.height, m.angle), strict=True):
            ax.plot(m.times, value, label=case, **line_look(i))
    _limits(axes[2], np.degrees(MAX_ANGLE))
    legend_on_top(figure, axes[0].get_lines())
    return figure
