"""The picture of the first page: the rendezvous, its controls with switching functions, and its optimality check.

`python -m website.figures` draws it with the other pictures of the pages.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from PIL import Image

import gnc_opt as go
from gnc_opt.plot import save_figure
from gnc_opt.plot.figure_style import COLORS, QUIET, apply_plot_style
from gnc_opt.spacecraft import mrp_to_dcm
from problems.rendezvous.model import build

CHASER_SIZE_M = (2.4, 1.6, 1.6)
"""Edges along the body axes; the publication gives none."""

TARGET_SIZE_M = (2.0, 3.0, 2.0)

CHASERS = 6
"""Instants at which the chaser is drawn, evenly spaced in time."""

NAMES = {"T_B": ("T_x", "T_y", "T_z"), "F_B": ("F_x", "F_y", "F_z")}

GROUPS = {
    "feasible": ("dynamics", "limits", "boundary conditions", "cost"),
    "first-order conditions": ("stationarity", "active set", "minimum principle"),
}
"""Conditions whose largest violation the picture shows."""


def overview() -> Figure:
    """Return the figure of the time-optimal rendezvous, case 1, refined to 1e-8."""
    solution = go.solve(build(case=1), tol=1e-8)
    with apply_plot_style():
        figure = Figure(figsize=(10.0, 5.6))
        left, right = figure.subfigures(1, 2, width_ratios=(0.44, 0.56))
        _draw_path(left, solution)
        _draw_check(left, solution)
        _draw_controls(right, solution)
    return figure


def _draw_path(figure: Any, solution: go.Solution) -> None:
    leg = solution.phase()
    ax = figure.add_axes((-0.09, 0.29, 1.02, 0.68), projection="3d")
    times = np.linspace(leg.initial_time, leg.final_time, 200)
    r = _up(solution.state("r_L")(times))
    ax.plot(*r, color=COLORS[0])
    _draw_box(ax, np.zeros(3), np.eye(3), TARGET_SIZE_M, COLORS[1])
    for t in np.linspace(leg.initial_time, leg.final_time, CHASERS):
        dcm_BL = np.asarray(mrp_to_dcm(solution.state("sigma")(t)), dtype=float)
        _draw_box(ax, solution.state("r_L")(t), dcm_BL.T, CHASER_SIZE_M, COLORS[0])
    ax.text(0.0, 0.0, -3.2, "target", color=COLORS[1], ha="center")
    ax.text(*(r[:, 0] + [0.0, 0.0, 3.0]), "chaser, t = 0", color=COLORS[0], ha="center")
    ax.set_xlabel("along orbit (m)")
    ax.set_ylabel("across (m)")
    ax.set_zlabel("height above the target (m)")
    ax.set_yticks([-5, 0, 5])
    ax.set_box_aspect((22, 10, 14), zoom=1.08)
    ax.set_xlim(-2, 22)
    ax.set_ylim(-5, 5)
    ax.set_zlim(-2, 12)
    ax.view_init(elev=16, azim=-68)
    figure.suptitle("Time-optimal rendezvous in six degrees of freedom", x=0.04, y=0.97, ha="left")


def _draw_box(ax: Any, centre_L: Any, dcm_LB: Any, size: Sequence[float], color: str) -> None:
    """Draw the faces of a box with the given edges along its body axes."""
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size
    points = _up((dcm_LB @ corners.T).T + np.ravel(centre_L), axis=1)
    faces = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    shown = Poly3DCollection([points[list(f)] for f in faces], facecolor=color, edgecolor=color, alpha=0.18)
    shown.set_linewidth(0.6)
    ax.add_collection3d(shown)


def _up(r_L: Any, axis: int = 0) -> Any:
    """Return local-vertical coordinates with the third axis away from the Earth instead of towards it."""
    signs = np.array([1.0, -1.0, -1.0])
    r_L = np.asarray(r_L, dtype=float)
    return r_L * (signs if r_L.ndim == 1 or axis == 1 else signs[:, None])


def _draw_controls(figure: Any, solution: go.Solution) -> None:
    axes = figure.subplots(3, 2, sharex=True)
    figure.subplots_adjust(0.10, 0.10, 0.92, 0.85, wspace=0.26, hspace=0.18)
    leg = solution.phase()
    t = np.linspace(leg.initial_time, leg.final_time, 1500)
    for column, (name, labels) in enumerate(NAMES.items()):
        rows = leg.controls.slice(name)
        applied = leg.applied(t)[rows] / leg.control_bounds.upper[rows][:, None]
        switching = np.asarray(solution.switching_function(name, t))
        for i, label in enumerate(labels):
            ax = axes[i, column]
            ax.fill_between(t, applied[i], step="mid", color=COLORS[0], alpha=0.25, linewidth=0.0)
            ax.plot(t, applied[i], color=COLORS[0], linewidth=1.0)
            ax.plot(t, switching[i] / np.max(np.abs(switching[i])), color=COLORS[1], linewidth=1.2)
            ax.axhline(0.0, color=QUIET, linewidth=0.6)
            ax.set_ylim(-1.25, 1.25)
            ax.set_yticks([-1, 0, 1])
            ax.set_ylabel(f"${label}$")
    for ax in axes[-1]:
        ax.set_xlabel("time (s)")
    axes[0, 0].set_title("torque / 50 N m")
    axes[0, 1].set_title("force / 320 N")
    handles = [axes[0, 0].lines[0], axes[0, 0].lines[1]]
    texts = ["control, share of its limit", "switching function, share of its maximum"]
    figure.legend(handles, texts, loc="upper center", ncols=2, bbox_to_anchor=(0.51, 0.99), columnspacing=1.4)


def _draw_check(figure: Any, solution: go.Solution) -> None:
    """Write the optimality check: status, groups with their largest violation, second order."""
    verdict = go.verify(solution)
    switches = sum(arc.end < solution.phase().final_time for arc in solution.structure if arc.end is not None)
    lines = [("minimum time", f"{solution.objective:.8f} s, {switches} switches")]
    for group, names in GROUPS.items():
        passes = all(verdict[name].result is go.ConditionResult.PASS for name in names)
        lines.append((group, "pass" if passes else "fail"))
    lines.append(("second-order condition", "pass" if verdict.minimum else "not met"))
    lines.append(("conclusion", "strict local minimum" if verdict.minimum else verdict.headline))
    for i, (what, value) in enumerate(lines):
        y = 0.25 - 0.052 * i
        figure.text(0.06, y, what, weight="bold" if what == "conclusion" else "normal")
        figure.text(0.46, y, value, weight="bold" if what == "conclusion" else "normal")


def save(path: Path) -> None:
    """Write the picture as PNG of 128 colours."""
    save_figure(overview(), path)
    Image.open(path).convert("RGB").quantize(128).save(path, optimize=True)
