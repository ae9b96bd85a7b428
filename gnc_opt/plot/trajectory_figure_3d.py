"""Figure of a motion in space: path, vehicle at several times, other bodies and keep-out volumes."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform

from gnc_opt.array_types import Array
from gnc_opt.plot.figure_style import (
    COLORS,
    QUIET,
    THIN,
    apply_plot_style,
    format_axis_label,
    format_variable_name,
)
from gnc_opt.plot.vehicle_motion_sampling import (
    AXIS,
    VEHICLE_HALF_EDGES,
    MotionSamples,
    Moved,
    View,
    get_motion_time_span,
    sample_ellipsoid_surface,
    sample_vehicle_motion,
)

PATH_SAMPLES = 400
"""Number of points of a path."""

MOTION_WIDTH, MOTION_MAX_HEIGHT = 5.5, 2.9
"""Width of the figure, and largest height of the frame in it, inches."""

KILOMETRES_FROM = 1e5
"""Extent (m) from which axes count kilometres."""


def plot_motion(moved: Moved, view: View, *, vehicles: int = 6) -> Figure:
    """Return a figure of the path of a vehicle, the vehicle at equal time intervals, and other bodies.

    Parameters
    ----------
    moved : Solution or Run
    view : View
        View with a position; the vehicle is a box with axes if the view has an attitude, else a dot.
    vehicles : int
        Number of drawn vehicles, including start and end.

    Raises
    ------
    UnknownNameError, ArgumentError
        See `View`.

    Examples
    --------
    >>> from gnc_opt.plot import View, plot_motion
    >>> figure = plot_motion(solution, View("q"))
    """
    begin, end = get_motion_time_span(moved, view)
    path = sample_vehicle_motion(moved, view, np.linspace(begin, end, PATH_SAMPLES))
    few = sample_vehicle_motion(moved, view, np.linspace(begin, end, max(2, vehicles)))
    bodies = {name: np.ravel(np.asarray(place, dtype=float)) for name, place in view.bodies.items()}
    extent = np.hstack([path.position, *(place[:, None] for place in bodies.values())])
    size = AXIS * float(np.max(np.ptp(extent, axis=1))) or 1.0
    with apply_plot_style():
        figure = Figure(figsize=2 * [MOTION_WIDTH])
        width, depth = np.ptp(extent[:2], axis=1)
        azimuth = -62 if width >= depth else -28  # the longer axis runs across the figure
        ax = figure.add_axes((0, 0, 1, 1), projection="3d", computed_zorder=False, elev=18, azim=azimuth)
        ax.plot(*path.position, color=COLORS[0], zorder=4, label="path")
        for point, marker, label in ((path.position[:, 0], "o", "start"), (path.position[:, -1], "s", "end")):
            ax.plot(*point[:, None], marker, color=COLORS[0], zorder=6, label=label)
        drawn = [extent]
        for k in range(few.times.size):
            if few.dcm_BL is None:
                ax.plot(*few.position[:, k : k + 1], "o", color=COLORS[0], zorder=5)
            else:
                drawn.append(_draw_vehicle(ax, few.position[:, k], few.dcm_BL[:, :, k], size, COLORS[0]))
        for i, (name, place) in enumerate(bodies.items(), 1):
            drawn.append(_draw_vehicle(ax, place, np.eye(3), size, COLORS[i % len(COLORS)], label=name))
        for name in view.keep_out:
            surface = sample_ellipsoid_surface(*view.keep_out_volume(name))
            ax.plot_wireframe(
                *surface, color=QUIET, linewidth=0.4, rstride=2, cstride=2, zorder=2, label=name
            )
            drawn.append(surface.reshape(3, -1))
        _set_equal_axis_scales(ax, np.hstack(drawn), path, view.down)
        _enlarge_axes_to_figure(figure, ax)
        figure.legend(loc="upper center", ncols=4, columnspacing=1.6)
    return figure


def _enlarge_axes_to_figure(figure: Figure, ax: Any) -> None:
    """Magnify the axes until the frame fills the width or `MOTION_MAX_HEIGHT`; cut the figure to its height."""
    corners = np.array(list(itertools.product(ax.get_xlim(), ax.get_ylim(), ax.get_zlim()))).T
    shown = ax.transData.transform(np.transpose(proj_transform(*corners, ax.get_proj())[:2])) / figure.dpi
    low, high = shown.min(axis=0), shown.max(axis=0)
    side = figure.get_figwidth()
    factor = float(np.min(np.array([side - 1.9, MOTION_MAX_HEIGHT]) / (high - low)))
    size = np.array([side, factor * (high - low)[1] + 1.5])
    corner = 0.5 * size - factor * 0.5 * (low + high)
    figure.set_size_inches(*size)
    ax.set_position((*(corner / size), *(factor * side / size)))


def _draw_vehicle(ax: Any, centre: Array, dcm_BL: Array, size: float, color: str, label: str = "") -> Array:
    """Draw a vehicle as a box along its axes, the rows of ``dcm_BL``; return the corners (3, 8)."""
    edges = size * np.array(VEHICLE_HALF_EDGES)
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * edges
    points = corners @ dcm_BL + centre
    faces = [points[list(face)] for face in _BOX_FACES]
    look: dict[str, Any] = {"facecolor": color, "edgecolor": color, "linewidth": THIN, "alpha": 0.2}
    shown = Poly3DCollection(faces, zorder=3, label=label, **look)
    ax.add_collection3d(shown)
    return np.asarray(points.T)


_BOX_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
"""Corner indices of each face, in the order of `itertools.product`."""


def _set_equal_axis_scales(ax: Any, points: Array, path: MotionSamples, down: bool) -> None:
    """Set equal scales on all axes, limits around all points, labels with units; a plane is viewed from its front."""
    low, high = points.min(axis=1), points.max(axis=1)
    room = 0.04 * float(np.max(high - low))
    low, high = low - room, high + room
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(*((high[1], low[1]) if down else (low[1], high[1])))
    ax.set_zlim(*((high[2], low[2]) if down else (low[2], high[2])))
    largest = float(np.max(high - low))
    ax.set_box_aspect(high - low)
    if not path.labels[1] and not np.any(points[1]):
        ax.set_proj_type("ortho")
        ax.view_init(0, -90)
    large = path.unit == "m" and largest > KILOMETRES_FROM
    units = FuncFormatter(lambda value, _: f"{value / (1000 if large else 1):g}")
    for axis, extent, name in zip((ax.xaxis, ax.yaxis, ax.zaxis), high - low, path.labels, strict=True):
        count = round(6 * extent / largest)
        axis.set_major_locator(MaxNLocator(count) if count else NullLocator())
        axis.set_major_formatter(units)
        text = format_axis_label(format_variable_name(name), "km" if large else path.unit) if name else ""
        axis.set_label_text(text)
        axis.labelpad = 8
