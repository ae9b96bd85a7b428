"""Films: a vehicle on its path, with its axes, the plumes of its thrust and what it keeps out of."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from gnc_opt.arguments import read_positive
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError, GncOptError
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.plot.path import frame_space
from gnc_opt.plot.style import COLORS, DPI, QUIET, legend_on_top, new_figure, style
from gnc_opt.plot.view import AXIS, PLUME, Motion, Moved, View, motion, span, sphere, track
from gnc_opt.simulation.run import Run


def save_film(
    moved: Moved,
    path: str | Path,
    view: View,
    *,
    others: Sequence[Moved] = (),
    seconds: float = 8.0,
    rate: float = 20.0,
) -> Path:
    """Return the path of a film of a planned or flown motion that is written.

    Parameters
    ----------
    moved : Solution or Run
        All phases that have the states of the view, one after the other.
    path : str or Path
        ``.gif``, or ``.mp4`` with ffmpeg.
    view : View
    others : sequence of Solution or Run
        Their paths are drawn in grey.
    seconds : float
        Length of the film, s; the motion is shown at constant speed.
    rate : float
        Pictures per second.

    Raises
    ------
    UnknownNameError, ArgumentError
        An unknown state, control or suffix, or wrong components.
    GncOptError
        A film in mp4 and no ffmpeg.

    Examples
    --------
    >>> film = save_film(solution, "cart.gif", View(position=("q", "v")), seconds=0.2, rate=10.0)
    >>> print(film.name)
    cart.gif
    """
    if not isinstance(moved, Solution | Run):
        raise ArgumentError(f"what save_film() got is a {type(moved).__name__}: give a solution or a run.")
    target = Path(path)
    seconds = read_positive(seconds, "the length of a film")
    rate = read_positive(rate, "the number of pictures per second")
    writer = _writer(target, rate)
    shown = motion(moved, view, np.linspace(*span(moved, view), max(2, round(seconds * rate))))
    paths = [track(each, view, 600) for each in (moved, *others)]
    with style():
        figure, draw = _pictures(shown, paths, view)
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=".film") as folder:
            unfinished = Path(folder) / target.name
            writer.setup(figure, str(unfinished), DPI)
            for k in range(shown.times.size):
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


def _pictures(shown: Motion, paths: Sequence[Array], view: View) -> tuple[Figure, Callable[[int], None]]:
    """A figure, and what draws the k-th picture into it; of the paths the first is the motion's own."""
    r = paths[0]
    dense = np.linspace(shown.times[0], shown.times[-1], r.shape[1])
    size = float(np.max(np.ptp(r, axis=1))) or 1.0
    figure = new_figure(5.0, 6.5)
    ax: Any = figure.add_subplot(projection="3d", computed_zorder=False, elev=20, azim=-58)
    for other in paths[1:]:
        ax.plot(*other, color=QUIET, linewidth=0.4, alpha=0.5)
    ax.plot(*r, color=QUIET, linewidth=0.8, linestyle="--")
    shells = [sphere(*view.volume(name)) for name in view.keep_out]
    for shell in shells:
        ax.plot_wireframe(*shell, color=COLORS[3], linewidth=0.4, alpha=0.6)
    trail = ax.plot([], [], [], color="black", linewidth=1.6)[0]
    body = ax.plot([], [], [], "o", color="black", markersize=5)[0]
    dcm = shown.dcm_BL
    axes = [
        ax.plot([], [], [], color=COLORS[i], linewidth=1.6)[0] for i in range(0 if dcm is None else len(dcm))
    ]
    plumes = [
        (
            ax.plot([], [], [], color=COLORS[4], linewidth=3.0)[0],
            AXIS * plume.root(dcm),
            PLUME * plume.force(dcm),
        )
        for plume in shown.plumes.values()
    ]
    room = r[:, [0, 0]] + [[-0.05 * size, 0.05 * size]] * 3  # motion along a line has a width, too
    if view.position is None:
        room = np.array([[-AXIS * size, AXIS * size]] * 3)
    frame_space(
        ax,
        np.hstack([*paths, *(s.reshape(3, -1) for s in shells), room]),
        shown.unit,
        ("", "", ""),
        view.down,
    )
    if view.position is None:  # directions have no place that numbers could tell
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            axis.set_major_formatter(NullFormatter())
    decimals = max(0, 2 - int(np.floor(np.log10(shown.times[-1] - shown.times[0]))))
    clock = ax.text2D(0.02, 0.96, "", transform=ax.transAxes)
    legend_on_top(figure, _handles(view))

    def draw(k: int) -> None:
        here = shown.position[:, k]
        flown = np.searchsorted(dense, shown.times[k], side="right")
        trail.set_data_3d(*np.column_stack([r[:, :flown], here]))
        body.set_data_3d(*here[:, None])
        for i, axis in enumerate(axes):
            assert dcm is not None
            axis.set_data_3d(*np.column_stack([here, here + AXIS * size * dcm[i, :, k]]))
        for line, root, force in plumes:
            nozzle = here + size * root[:, k]
            line.set_data_3d(*np.column_stack([nozzle, nozzle - size * force[:, k]]))
        clock.set_text(f"t = {shown.times[k]:.{decimals}f} s")

    return figure, draw


def _handles(view: View) -> list[Line2D]:
    """Legend of the lines."""
    handles = [Line2D([], [], color="black", label="path")] if view.position is not None else []
    if view.attitude is not None:
        handles += [Line2D([], [], color=COLORS[i], label=f"$b_{name}$") for i, name in enumerate("xyz")]
    if view.force is not None:
        handles.append(
            Line2D([], [], color=COLORS[4], linewidth=3.0, label="plumes" if view.thrusters else "plume")
        )
    handles += [Line2D([], [], color=COLORS[3], linewidth=0.6, label=name) for name in view.keep_out]
    return handles
