"""Figures of the flexible spacecraft: the publication's plots, chattering, the optimal slews and their tracking."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gnc_opt.arrays import Array
from gnc_opt.plot.style import (
    QUIET,
    axis_label,
    legend_on_top,
    line_look,
    new_figure,
    save_figure,
    style,
)
from gnc_opt.simulation import Run
from problems.flexible_spacecraft.laws import INERTIAL_ROBUST, UNIT_ROBUST
from problems.flexible_spacecraft.model import MAX_TORQUE
from problems.flexible_spacecraft.optimal import modal_energy, solved, tracked
from problems.flexible_spacecraft.runs import attitude_error, disturbed, standard, surface

_AXES: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
    ("q", r"$q_{v}$", "", ("x", "y", "z")),
    ("omega", r"$\omega$", "rad/s", ("x", "y", "z")),
    ("eta", r"$\eta$", "kg$^{0.5}$ m", ("1", "2", "3", "4")),
)
"""Signal, symbol, unit and components of each axis."""
_TORQUE = (("torque", "torque", "N m", ("x", "y", "z")),)
_TORQUES = tuple((f"torque {axis}", f"torque {axis}", "N m", ("",)) for axis in "xyz")

Signals = dict[str, Array]


def write_figures(folder: Path) -> list[Path]:
    """Write all figures; return their paths."""
    figures = {
        "flexible_published": published_figure(),
        "flexible_robust": robust_figure(),
        "flexible_chattering": chattering_figure(),
        "flexible_optimal": optimal_figure(),
        "flexible_tracking": tracking_figure(),
    }
    return [save_figure(figure, folder / f"{name}.png") for name, figure in figures.items()]


def published_figure() -> Figure:
    """Draw attitude, rate, modes and torque of QSMC by configuration U and J over the publication's 200 s."""
    columns = [("U: $G = 1$, printed gains", standard("U")), ("J: $G = J$, gains retuned", standard("J"))]
    return _grid([(title, *_of_run(run)) for title, run in columns], _AXES + _TORQUE, 7.6)


def robust_figure() -> Figure:
    """Draw the same of RQSMC with the scalar part of the attitude and the surface over its first size, by U and J."""
    columns = []
    for title, name, c in (
        ("U: $k = 0.07$", "U robust", UNIT_ROBUST.c),
        ("J: $k = 0.05$", "J robust", INERTIAL_ROBUST.c),
    ):
        run = standard(name)
        times, values = _of_run(run)
        s = surface(run, c)
        more = {"q0": run.state("q_BO").values[:1], "S": s / np.max(np.abs(s[:, 0]))}
        columns.append((title, times, {**values, **more}))
    scalar = (("q0", "$q_0$", "", ("",)),)
    return _grid(columns, scalar + _AXES + _TORQUE + (("S", "$S$ / $|S(0)|$", "", ("x", "y", "z")),), 10.0)


def optimal_figure() -> Figure:
    """Draw the same of the optimal slews."""
    columns = []
    for title, name in (("least time", "fast"), ("least vibration in 60 s", "gentle")):
        leg = solved(name).phase()
        t = np.linspace(leg.initial_time, leg.final_time, 4001)
        values = _named(
            *(np.asarray(leg.state(signal)(t)) for signal in ("q_BO", "omega", "eta")),
            np.asarray(leg.flown_control("torque")(t)),
        )
        columns.append((title, t, values))
    return _grid(columns, _AXES + _TORQUES, 9.0)


def chattering_figure() -> Figure:
    """Draw the torque about x with tanh and with sign, commands held for 0.1 s: all of it, and two seconds."""
    with style():
        figure = new_figure(3.6)
        axes = figure.subplots(2, 2, sharex="col", sharey=True, width_ratios=(2, 1))
        for row, name, label in zip(axes, ("J tanh", "J sign"), ("tanh", "sign"), strict=True):
            signal = standard(name).control("torque")
            for ax, shown in zip(row, ((0, 120), (80, 82)), strict=True):
                ax.step(signal.times, signal.values[0], where="post", linewidth=0.8, **line_look(0))
                ax.set_xlim(*shown)
                ax.set_ylim(-1.1 * MAX_TORQUE, 1.1 * MAX_TORQUE)
            row[0].set_ylabel(axis_label(f"torque x, {label}", "N m"))
        for ax in axes[-1]:
            ax.set_xlabel("time (s)")
    return figure


def tracking_figure() -> Figure:
    """Draw attitude error and modal energy of the disturbed runs, published law and optimal slews."""
    runs = (
        ("QSMC, J", disturbed("J")),
        ("least time and effort, TVLQR", tracked("prompt", "TVLQR")),
        ("least time and effort, RQSMC", tracked("prompt", "RQSMC")),
        ("least vibration, TVLQR", tracked("gentle", "TVLQR")),
    )
    with style():
        figure = new_figure(4.6)
        axes = figure.subplots(2, 1, sharex=True)
        handles: list[Any] = []
        for i, (label, run) in enumerate(runs):
            shown = run.times <= 120
            handles += axes[0].semilogy(
                run.times[shown], np.degrees(attitude_error(run)[shown]), label=label, **line_look(i)
            )
            axes[1].semilogy(run.times[shown], modal_energy(run)[shown], **line_look(i))
        axes[0].set_ylabel(axis_label("attitude error", "deg"))
        axes[1].set_ylabel(axis_label("modal energy", "J"))
        axes[1].set_ylim(1e-11, 3e-2)
        axes[1].set_xlabel("time (s)")
        axes[1].set_xlim(0, 120)
        legend_on_top(figure, handles, columns=2)
    return figure


# --- parts ----------------------------------------------------------------------------------------------


def _of_run(run: Run) -> tuple[Array, Signals]:
    applied = run.control("torque").values
    q, omega, eta = (run.state(name).values for name in ("q_BO", "omega", "eta"))
    return run.times, _named(q, omega, eta, np.hstack([applied, applied[:, -1:]]))


def _named(*values: Array) -> Signals:
    q, omega, eta, torque = values
    parts = {f"torque {axis}": torque[k : k + 1] for k, axis in enumerate("xyz")}
    return {"q": q[1:], "omega": omega, "eta": eta, "torque": torque, **parts}


def _grid(
    columns: Sequence[tuple[str, Array, Signals]],
    signals: Sequence[tuple[str, str, str, tuple[str, ...]]],
    height: float,
) -> Figure:
    """Draw one column of axes per title, times and signals; legends are in the last column, which is emptier."""
    with style():
        figure = new_figure(height)
        axes = figure.subplots(len(signals), len(columns), sharex="col", sharey="row")
        for j, (title, t, values) in enumerate(columns):
            for ax, (name, symbol, unit, parts) in zip(axes[:, j], signals, strict=True):
                _lines(ax, t, values[name], parts if j == len(columns) - 1 else None)
                if j == 0:
                    ax.set_ylabel(axis_label(symbol, unit))
                if name.startswith("torque"):
                    for bound in (-MAX_TORQUE, MAX_TORQUE):
                        ax.axhline(bound, color=QUIET, linestyle=":", linewidth=1.0)
            axes[0, j].set_title(title)
            axes[-1, j].set_xlabel("time (s)")
            axes[-1, j].set_xlim(t[0], t[-1])
    return figure


def _lines(ax: Axes, t: Array, rows: Array, parts: tuple[str, ...] | None) -> None:
    for k, row in enumerate(rows):
        ax.plot(t, row, label=parts[k] if parts else None, linewidth=1.1, **line_look(k))
    if parts and len(parts) > 1:
        ax.legend(loc="upper right", ncols=len(parts), columnspacing=0.8, handlelength=1.6, fontsize=9)
