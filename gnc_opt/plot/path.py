"""Figures of motion in space: the path with the body's axes along it; plain curves over time."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import ArrayLike

from gnc_opt.arrays import Array
from gnc_opt.plot.style import (
    COLORS,
    QUIET,
    axis_label,
    legend_above,
    legend_on_top,
    line_look,
    new_figure,
    style,
)
from gnc_opt.plot.view import AXIS, VEHICLE_HALF_EDGES, Moved, View, motion, span, sphere

PATH_SAMPLES = 400
"""Points of a drawn path."""


def plot_curves(t: ArrayLike, values: ArrayLike, labels: Sequence[str], ylabel: str) -> Figure:
    """Return a figure that shows rows of values over time in one axis, e.g. Euler angles computed from a solution.

    Parameters
    ----------
    t : array (n_times,)
        s.
    values : array (n, n_times)
    labels : sequence of n str
    ylabel : str
        With its unit.

    Examples
    --------
    >>> t = np.linspace(0.0, 2.0, 50)
    >>> figure = plot_curves(t, 0.5 * solution.state("v")(t) ** 2, ["kinetic"], "energy, J/kg")
    """
    times = np.asarray(t, dtype=float)
    with style():
        figure = new_figure(3.0)
        ax = figure.subplots()
        for i, row in enumerate(np.atleast_2d(np.asarray(values, dtype=float))):
            ax.plot(times, row, label=labels[i], **line_look(i))
        ax.set_xlim(times[0], times[-1])
        ax.set_xlabel("time (s)")
        ax.set_ylabel(ylabel)
        legend_above(ax)
    return figure


def plot_path(
    r_L: ArrayLike,
    *,
    dcm_BL: ArrayLike | None = None,
    at: Sequence[int] = (),
    unit: str = "m",
    axis_length: float | None = None,
    axis_notes: Sequence[str] = ("", "", ""),
    down: bool = True,
) -> Figure:
    """Return a figure that shows a path in three dimensions with the body's axes along it.

    Parameters
    ----------
    r_L : array (3, n_times)
        Positions in frame L.
    dcm_BL : array (3, 3, n_times), optional
        Attitude of the body: its rows are the body's axes in L.
    at : sequence of int
        Indices of the times at which to draw the body's axes.
    unit : str
        Of the positions.
    axis_length : float, optional
        Of the drawn axes; default 12 % of the path's largest extent.
    axis_notes : sequence of str
        Added to the names of the three axes, e.g. ("along velocity", "", "to Earth").
    down : bool
        Draw z downwards (and y towards the viewer), as befits a z axis that points to the planet.

    Examples
    --------
    >>> angle = np.linspace(0.0, 6.0, 60)
    >>> figure = plot_path(np.array([np.cos(angle), np.sin(angle), 0.1 * angle]))
    """
    r = np.asarray(r_L, dtype=float)
    length = axis_length or 0.12 * float(np.max(np.ptp(r, axis=1)))
    with style():
        figure = new_figure(4.6)
        ax = figure.add_subplot(projection="3d", computed_zorder=False, elev=20, azim=-58)
        ax.plot(*r, color="black", linewidth=1.6, zorder=4)
        ax.plot(*r[:, :1], "o", color="black", markersize=6, zorder=6)
        ax.plot(*r[:, -1:], "s", color="black", markersize=6, zorder=6)
        handles = [
            Line2D([], [], color="black", linewidth=1.6, label="path"),
            Line2D([], [], color="black", marker="o", linestyle="none", label="start"),
            Line2D([], [], color="black", marker="s", linestyle="none", label="end"),
        ]
        tips = [r]
        if dcm_BL is not None:
            tips += _draw_body_axes(ax, r, np.asarray(dcm_BL, dtype=float), at, length)
            handles += [
                Line2D([], [], color=COLORS[i], linewidth=1.6, label=f"$b_{name}$")
                for i, name in enumerate("xyz")
            ]
        frame_space(ax, np.hstack(tips), unit, axis_notes, down)
        legend_on_top(figure, handles)
    return figure


def plot_motion(moved: Moved, view: View, *, vehicles: int = 6) -> Figure:
    """Return a figure that shows the path of a vehicle, the vehicle at equal intervals of time, and other bodies.

    Parameters
    ----------
    moved : Solution or Run
    view : View
        With a position; the vehicle is drawn as a box with its axes if there is an attitude, else as a dot.
    vehicles : int
        How often the vehicle is drawn, start and end included.

    Raises
    ------
    UnknownNameError, ArgumentError
        As for `View`.

    Examples
    --------
    >>> from gnc_opt.plot import View, plot_motion
    >>> figure = plot_motion(solution, View("q"))
    """
    begin, end = span(moved, view)
    path = motion(moved, view, np.linspace(begin, end, PATH_SAMPLES))
    few = motion(moved, view, np.linspace(begin, end, max(2, vehicles)))
    bodies = {name: np.ravel(np.asarray(place, dtype=float)) for name, place in view.bodies.items()}
    extent = np.hstack([path.position, *(place[:, None] for place in bodies.values())])
    size = AXIS * float(np.max(np.ptp(extent, axis=1))) or 1.0
    with style():
        figure = new_figure(5.2)
        width, depth = np.ptp(extent[:2], axis=1)
        azimuth = -62 if width >= depth else -28  # the longer axis runs across the figure
        ax = figure.add_subplot(projection="3d", computed_zorder=False, elev=18, azim=azimuth)
        ax.plot(*path.position, color=COLORS[0], zorder=4)
        handles = [Line2D([], [], color=COLORS[0], label="path")]
        for point, marker, label in ((path.position[:, 0], "o", "start"), (path.position[:, -1], "s", "end")):
            ax.plot(*point[:, None], marker, color=COLORS[0], markersize=5, zorder=6)
            handles.append(Line2D([], [], color=COLORS[0], marker=marker, linestyle="none", label=label))
        drawn = [extent]
        for k in range(few.times.size):
            if few.dcm_BL is None:
                ax.plot(*few.position[:, k : k + 1], ".", color=COLORS[0], markersize=9, zorder=5)
            else:
                drawn.append(_draw_box(ax, few.position[:, k], few.dcm_BL[:, :, k], size, COLORS[0]))
        for i, (name, place) in enumerate(bodies.items(), 1):
            drawn.append(_draw_box(ax, place, np.eye(3), size, COLORS[i % len(COLORS)]))
            handles.append(Line2D([], [], color=COLORS[i % len(COLORS)], linewidth=6, alpha=0.4, label=name))
        for name in view.keep_out:
            surface = sphere(*view.volume(name))
            ax.plot_wireframe(*surface, color=QUIET, linewidth=0.4, rstride=2, cstride=2, zorder=2)
            drawn.append(surface.reshape(3, -1))
            handles.append(Line2D([], [], color=QUIET, linewidth=0.8, label=name))
        frame_space(ax, np.hstack(drawn), path.unit, ("", "", ""), view.down, zoom=1.15)
        legend_on_top(figure, handles)
    return figure


def _draw_box(ax: Any, centre: Array, dcm_BL: Array, size: float, color: str) -> Array:
    """Draw a vehicle as a box along its axes, the rows of ``dcm_BL``; return its corners (3, 8)."""
    edges = size * np.array(VEHICLE_HALF_EDGES)
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * edges
    points = corners @ dcm_BL + centre
    faces = [points[list(face)] for face in _BOX_FACES]
    shown = Poly3DCollection(faces, facecolor=color, edgecolor=color, linewidth=0.6, alpha=0.2, zorder=3)
    ax.add_collection3d(shown)
    return np.asarray(points.T)


_BOX_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
"""Corners of each face, in the order of `itertools.product`."""


def _draw_body_axes(ax: Any, r: Array, dcm: Array, at: Sequence[int], length: float) -> list[Array]:
    tips = []
    for k in at:
        for i in range(3):
            tip = r[:, k] + length * dcm[i, :, k]
            ax.plot(*np.column_stack([r[:, k], tip]), color=COLORS[i], linewidth=1.3, zorder=5)
            tips.append(tip[:, None])
    return tips


def frame_space(
    ax: Any, points: Array, unit: str, notes: Sequence[str], down: bool, zoom: float = 1.05
) -> None:
    """Equal scales on all axes, limits around all points, labels with units."""
    low, high = points.min(axis=1), points.max(axis=1)
    room = 0.04 * float(np.max(high - low))
    low, high = low - room, high + room
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(*((high[1], low[1]) if down else (low[1], high[1])))
    ax.set_zlim(*((high[2], low[2]) if down else (low[2], high[2])))
    ax.set_box_aspect(high - low, zoom=zoom)
    for axis, extent in zip((ax.xaxis, ax.yaxis, ax.zaxis), high - low, strict=True):
        axis.set_major_locator(MaxNLocator(max(1, round(6 * extent / float(np.max(high - low))))))
    names = [axis_label(f"${name}$ {note}".strip(), unit) for name, note in zip("xyz", notes, strict=True)]
    ax.set_xlabel(names[0], labelpad=12)
    ax.set_ylabel(names[1], labelpad=4)
    ax.set_zlabel(names[2])
