"""Figures of the formation: the publication's plots, the optimal acquisitions, and how they are held."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from gnc_opt.arrays import Array
from gnc_opt.plot.style import axis_label, legend_on_top, line_look, new_figure, save_figure, style
from problems.formation_flying.flown import away, flight
from problems.formation_flying.model import PERIOD, START, circle, differential_oblateness
from problems.formation_flying.optimal import LIMIT, plan
from problems.formation_flying.published import LAWS, run

_NAMES = ("x", "y", "z")


def write_figures(folder: Path) -> list[Path]:
    """Write all figures; return their paths."""
    figures = {
        "formation_errors": errors_figure(),
        "formation_thrust": thrust_figure(),
        "formation_disturbance": disturbance_figure(),
        "formation_paths": paths_figure(),
        "formation_paths_3d": space_figure(),
        "formation_optimal": optimal_figure(),
    }
    return [save_figure(figure, folder / f"{name}.png") for name, figure in figures.items()]


def errors_figure() -> Figure:
    """Draw the position error over one period: laws, and plans flown by the optimal sliding mode."""
    with style():
        figure = new_figure(3.6)
        ax = figure.subplots()
        for i, law in enumerate(LAWS):
            _norm(ax, i, law, run(law).times, run(law).error("r").values)
        for i, name in enumerate(("least Delta-V", "least time"), len(LAWS)):
            ax.plot(flight(name).times, away(flight(name)), label=f"{name}, flown", **line_look(i))
        ax.set_yscale("log")
        ax.set_xlabel(axis_label("time", "s"))
        ax.set_ylabel(axis_label("distance from the circle's point", "m"))
        legend_on_top(figure, ax.get_lines(), 3)
    return figure


def thrust_figure() -> Figure:
    """Draw the thrust of both laws: all of it, and the first two minutes, where sliding mode spends most."""
    with style():
        figure = new_figure(4.6)
        axes = figure.subplots(2, 2, squeeze=False)
        for column, law in enumerate(("SMC", "optimal SMC")):
            for row, end in enumerate((PERIOD, 120.0)):
                ax = axes[row, column]
                flown = run(law)
                shown = flown.times[:-1] <= end
                for i, values in enumerate(flown.commands):
                    ax.plot(flown.times[:-1][shown], 1e3 * values[shown], label=_NAMES[i], **line_look(i))
                ax.set_xlabel(axis_label("time", "s"))
                if column == 0:
                    ax.set_ylabel(axis_label("thrust", "mm/s^2"))
            axes[0, column].set_title(law)
        legend_on_top(figure, axes[0, 0].get_lines())
    return figure


def disturbance_figure() -> Figure:
    """Draw the differential oblateness that the laws do not know."""
    with style():
        figure = new_figure(2.6)
        ax = figure.subplots()
        flown = run("optimal SMC")
        for i, values in enumerate(differential_oblateness(flown.states[:3])):
            ax.plot(flown.times, 1e6 * values, label=_NAMES[i], **line_look(i))
        ax.set_xlabel(axis_label("time", "s"))
        ax.set_ylabel("differential oblateness (µm/s$^2$)")
        legend_on_top(figure, ax.get_lines())
    return figure


def paths_figure() -> Figure:
    """Draw the ways to the circle, seen along the orbit normal and along the motion."""
    with style():
        figure = new_figure(3.4)
        axes = figure.subplots(1, 2)
        ways, ring = _ways(), circle(np.linspace(0, PERIOD, 400))[0]
        for ax, (across, up) in zip(axes, ((1, 0), (1, 2)), strict=True):
            ax.plot(ring[across], ring[up], color="0.6", linewidth=0.8, label="circle")
            for i, (name, states) in enumerate(ways.items()):
                ax.plot(states[across], states[up], label=name, **line_look(i))
            ax.plot(
                ways["least time"][across, 0], ways["least time"][up, 0], "ko", markersize=3, label="start"
            )
            ax.set_xlabel(axis_label(_NAMES[across], "m"))
            ax.set_ylabel(axis_label(_NAMES[up], "m"))
            ax.set_aspect("equal")
        legend_on_top(figure, axes[0].get_lines())
    return figure


def space_figure() -> Figure:
    """Draw the same ways in space."""
    with style():
        figure = new_figure(5.4)
        ax = figure.add_subplot(projection="3d", box_aspect=(1, 1, 1))
        ax.view_init(elev=25, azim=-150)  # from the side to which the circle's plane is open
        ring = circle(np.linspace(0, PERIOD, 400))[0]
        ax.plot(*ring, color="0.6", linewidth=0.8, label="circle")
        for i, (name, states) in enumerate(_ways().items()):
            ax.plot(*states[:3], label=name, **line_look(i))
        ax.plot(*START[:3], "ko", markersize=3, label="start")
        ax.set(**{f"{name}label": axis_label(name, "m") for name in _NAMES})
        ax.zaxis.set_rotate_label(False)  # seen from there it would be upside down
        ax.zaxis.label.set_rotation(90)
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            axis.set_major_locator(MaxNLocator(4))
        legend_on_top(figure, ax.get_lines())
    return figure


def _ways() -> dict[str, Array]:
    """States along the ways to the circle, by name."""
    ways = {"optimal SMC": run("optimal SMC").states}
    for name in ("least Delta-V", "least time"):
        ways[name] = plan(name).states(np.linspace(0.0, plan(name).final_time, 600))
    return ways


def optimal_figure() -> Figure:
    """Draw the thrust of both optima."""
    with style():
        figure = new_figure(5.2)
        axes = figure.subplots(3, 2, sharex="col", sharey=True)
        for column, name in enumerate(("least Delta-V", "least time")):
            times = np.linspace(0.0, plan(name).final_time, 6001)
            thrust = plan(name).thrust(times)
            for i in range(3):
                ax = axes[i, column]
                ax.plot(times, 1e3 * thrust[i], **line_look(0))
                if name == "least Delta-V":
                    for bound in (-LIMIT, LIMIT):
                        ax.axhline(1e3 * bound, color="0.5", linestyle=":", linewidth=0.8)
                else:  # limited in any direction, not per axis
                    size = 1e3 * np.linalg.norm(thrust, axis=0)
                    ax.plot(times, size, color="0.5", linestyle="--", linewidth=0.8, label="magnitude")
                    if i == 0:
                        ax.legend(loc="lower left")
                if column == 0:
                    ax.set_ylabel(axis_label(f"thrust {_NAMES[i]}", "mm/s^2"))
            axes[0, column].set_title(name)
            axes[2, column].set_xlabel(axis_label("time", "s"))
    return figure


def _norm(ax: Axes, i: int, label: str, times: Array, errors: Array) -> None:
    ax.plot(times, np.linalg.norm(errors, axis=0), label=label, **line_look(i))
