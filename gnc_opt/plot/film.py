"""Films: a vehicle on its path, with its axes, the plume of its thrust and what it keeps out of."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_positive
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError, GncOptError
from gnc_opt.model.layout import Layout
from gnc_opt.plot.path import frame_space
from gnc_opt.plot.style import COLORS, DPI, QUIET, legend_on_top, new_figure, style
from gnc_opt.simulation.run import Run
from gnc_opt.solution.solution import Solution
from gnc_opt.spacecraft import mrp_to_dcm, quaternion_to_dcm

Moved: TypeAlias = Solution | Run

_AXIS, _PLUME = 0.12, 0.2
"""Lengths of the body's axes and of the plume at full thrust, shares of the path's largest extent."""
_PATH_POINTS = 600
"""Of a path that is drawn whole."""


@dataclass(frozen=True)
class View:
    """What of a motion is seen in space, by the names of states and controls.

    Attributes
    ----------
    position : str or sequence of str
        A state of two or three components, or as many scalar states: x, y (and z) in the frame that is drawn, L.
        Of two, the second is drawn upwards.
    attitude : str, optional
        Of the body B relative to L: modified Rodrigues parameters (3) or a quaternion (4, scalar part first).
    force : str, optional
        A control or a state (thrust) of as many components as the position, in B if there is an attitude, else in
        L; the plume points the other way.
    keep_out : mapping of str to (centre, radius)
        Spheres, in the unit of the position.
    down : bool
        Draw z downwards (and y towards the viewer), as befits a z axis that points to the planet.
    """

    position: str | Sequence[str]
    attitude: str | None = None
    force: str | None = None
    keep_out: Mapping[str, tuple[ArrayLike, float]] = field(default_factory=dict)
    down: bool = False


@dataclass(frozen=True)
class _Motion:
    """times (n,), position (3, n), body's axes as rows (3, 3, n), force in L (3, n) in shares of its largest."""

    times: Array
    position: Array
    dcm_BL: Array | None
    force: Array | None
    unit: str


def save_film(
    moved: Moved,
    path: str | Path,
    view: View,
    *,
    others: Sequence[Moved] = (),
    seconds: float = 8.0,
    rate: float = 20.0,
) -> Path:
    """Write a film of a planned or flown motion.

    Parameters
    ----------
    moved : Solution or Run
        All phases that have the states of the view, one after the other.
    path : str or Path
        ``.gif``, or ``.mp4`` where ffmpeg is installed; an existing file is replaced when the film is whole.
    view : View
    others : sequence of Solution or Run
        Their paths are drawn in grey, e.g. the runs of a campaign or the plan.
    seconds : float
        Length of the film, s; the motion is shown at constant speed.
    rate : float
        Pictures per second.

    Returns
    -------
    Path

    Raises
    ------
    UnknownNameError
        There is no such state or control.
    ArgumentError
        A position, attitude or force does not have the components it must have, or the suffix is another one.
    GncOptError
        A film in mp4 and no ffmpeg.
    """
    if not isinstance(moved, Solution | Run):
        raise ArgumentError(f"what save_film() got is a {type(moved).__name__}: give a solution or a run.")
    target = Path(path)
    seconds = read_positive(seconds, "the length of a film")
    rate = read_positive(rate, "the number of pictures per second")
    writer = _writer(target, rate)
    motion = _motion(moved, view, max(2, round(seconds * rate)))
    path_of = [_motion(each, View(view.position), _PATH_POINTS).position for each in (moved, *others)]
    with style():
        figure, draw = _pictures(motion, path_of, view)
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=".film") as folder:
            unfinished = Path(folder) / target.name
            writer.setup(figure, str(unfinished), DPI)
            for k in range(motion.times.size):
                draw(k)
                writer.grab_frame()
            writer.finish()
            os.replace(unfinished, target)
    return target


def _writer(target: Path, rate: float) -> Any:
    if target.suffix.lower() == ".gif":
        return PillowWriter(fps=rate)
    if target.suffix.lower() == ".mp4":
        if not FFMpegWriter.isAvailable():
            raise GncOptError("no ffmpeg is found, which writes films in mp4: install it, or write a '.gif'.")
        return FFMpegWriter(fps=rate)
    raise ArgumentError(f"a film is written as '.gif' or '.mp4', not as '{target.suffix or target.name}'.")


# --- what moves -----------------------------------------------------------------------------------------


def _motion(moved: Moved, view: View, n: int) -> _Motion:
    names = [view.position] if isinstance(view.position, str) else list(view.position)
    parts = _parts(moved, names)
    begin, end = parts[0].begin, parts[-1].end
    times = np.linspace(begin, end, n)
    owner = np.clip(
        np.searchsorted([part.begin for part in parts], times, side="right") - 1, 0, len(parts) - 1
    )
    groups = [(part, times[owner == k]) for k, part in enumerate(parts) if np.any(owner == k)]

    def of(name: str) -> Array:
        return np.concatenate([part.values(name, t) for part, t in groups], axis=1)

    position = _in_space(np.vstack([of(name) for name in names]), f"the position {', '.join(names)}")
    dcm = None if view.attitude is None else _dcm(of(view.attitude), view.attitude)
    force = None if view.force is None else _in_space(of(view.force), f"the force {view.force}")
    if force is not None:
        force = force / max(float(np.max(np.linalg.norm(force, axis=0))), np.finfo(float).tiny)
        force = force if dcm is None else np.einsum("ijk,ik->jk", dcm, force)
    return _Motion(times, position, dcm, force, parts[0].unit(names[0]))


@dataclass(frozen=True)
class _Part:
    """A phase, or a run: from begin to end (s), with its states and controls by name."""

    begin: float
    end: float
    source: Any
    layouts: Mapping[str, Layout]

    def values(self, name: str, t: Array) -> Array:
        """(size, n_times)."""
        kind = "control" if name in self.layouts["control"] and name not in self.layouts["state"] else "state"
        return np.atleast_2d(getattr(self.source, kind)(name)(t))

    def unit(self, name: str) -> str:
        return next(v.unit for v in self.layouts["state"].variables if v.name == name)


def _parts(moved: Moved, names: Sequence[str]) -> list[_Part]:
    if isinstance(moved, Run):
        layouts = {"state": moved.layouts["state"], "control": moved.layouts["applied"]}
        parts = [_Part(float(moved.times[0]), float(moved.times[-1]), moved, layouts)]
    else:
        parts = [
            _Part(leg.initial_time, leg.final_time, leg, {"state": leg.states, "control": leg.controls})
            for leg in moved.phases.values()
        ]
    found = [part for part in parts if all(name in part.layouts["state"] for name in names)]
    if not found:  # say so in the words of what was given
        for name in names:
            parts[0].source.state(name)
    return sorted(found, key=lambda part: part.begin)


def _in_space(values: Array, what: str) -> Array:
    """Three rows; of two components the second is drawn upwards."""
    if values.shape[0] == 2:
        return np.vstack([values[0], np.zeros(values.shape[1]), values[1]])
    if values.shape[0] != 3:
        raise ArgumentError(f"{what} has {values.shape[0]} components: two or three can be drawn.")
    return values


def _dcm(attitude: Array, name: str) -> Array:
    kinds = {3: mrp_to_dcm, 4: quaternion_to_dcm}
    if attitude.shape[0] not in kinds:
        raise ArgumentError(
            f"the attitude {name} has {attitude.shape[0]} components: give modified Rodrigues parameters (3) or a "
            "quaternion (4)."
        )
    return np.asarray(kinds[attitude.shape[0]](attitude), dtype=float)


# --- pictures -------------------------------------------------------------------------------------------


def _pictures(motion: _Motion, paths: Sequence[Array], view: View) -> tuple[Figure, Callable[[int], None]]:
    """A figure, and what draws the k-th picture into it; of the paths the first is the motion's own."""
    r = paths[0]
    dense = np.linspace(motion.times[0], motion.times[-1], r.shape[1])
    size = float(np.max(np.ptp(r, axis=1))) or 1.0
    figure = new_figure(5.0)
    ax: Any = figure.add_subplot(projection="3d", computed_zorder=False, elev=20, azim=-58)
    for other in paths[1:]:
        ax.plot(*other, color=QUIET, linewidth=0.4, alpha=0.5)
    ax.plot(*r, color=QUIET, linewidth=0.8, linestyle="--")
    shells = [
        _draw_shell(ax, np.asarray(c, dtype=float), float(radius)) for c, radius in view.keep_out.values()
    ]
    trail = ax.plot([], [], [], color="black", linewidth=1.6)[0]
    body = ax.plot([], [], [], "o", color="black", markersize=5)[0]
    axes = [
        ax.plot([], [], [], color=COLORS[i], linewidth=1.6)[0]
        for i in range(0 if motion.dcm_BL is None else 3)
    ]
    plume = None if motion.force is None else ax.plot([], [], [], color=COLORS[4], linewidth=3.0)[0]
    room = r[:, [0, 0]] + [[-0.05 * size, 0.05 * size]] * 3  # motion along a line has a width, too
    frame_space(ax, np.hstack([*paths, *shells, room]), motion.unit, ("", "", ""), view.down)
    decimals = max(0, 2 - int(np.floor(np.log10(motion.times[-1] - motion.times[0]))))
    clock = ax.text2D(0.02, 0.96, "", transform=ax.transAxes)
    legend_on_top(figure, _handles(view))

    def draw(k: int) -> None:
        here = motion.position[:, k]
        flown = np.searchsorted(dense, motion.times[k], side="right")
        trail.set_data_3d(*np.column_stack([r[:, :flown], here]))
        body.set_data_3d(*here[:, None])
        for i, axis in enumerate(axes):
            assert motion.dcm_BL is not None
            axis.set_data_3d(*np.column_stack([here, here + _AXIS * size * motion.dcm_BL[i, :, k]]))
        if plume is not None and motion.force is not None:
            plume.set_data_3d(*np.column_stack([here, here - _PLUME * size * motion.force[:, k]]))
        clock.set_text(f"t = {motion.times[k]:.{decimals}f} s")

    return figure, draw


def _handles(view: View) -> list[Line2D]:
    """What the lines mean."""
    handles = [Line2D([], [], color="black", label="path")]
    if view.attitude is not None:
        handles += [Line2D([], [], color=COLORS[i], label=f"$b_{name}$") for i, name in enumerate("xyz")]
    if view.force is not None:
        handles.append(Line2D([], [], color=COLORS[4], linewidth=3.0, label="plume"))
    handles += [Line2D([], [], color=COLORS[3], linewidth=0.6, label=name) for name in view.keep_out]
    return handles


def _draw_shell(ax: Any, centre: Array, radius: float) -> Array:
    """Draw a sphere, return points of it (3, n)."""
    around, up = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(-np.pi / 2, np.pi / 2, 13))
    unit = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    points = centre[:, None, None] + radius * unit
    ax.plot_wireframe(*points, color=COLORS[3], linewidth=0.4, alpha=0.6)
    return np.asarray(points.reshape(3, -1))
