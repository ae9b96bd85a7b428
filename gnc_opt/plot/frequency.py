"""Figures of loops in the frequency domain: Bode, Nyquist, sensitivity, and disk margins along a trajectory."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from gnc_opt.analysis.loop_response import LoopResponse
from gnc_opt.errors import ArgumentError
from gnc_opt.plot.style import (
    COLORS,
    QUIET,
    axis_label,
    legend_on_top,
    line_look,
    name_text,
    new_figure,
    style,
)

_NYQUIST_RADIUS = 2.5
"""How far from the origin a Nyquist plot shows at most: what matters happens about -1."""


def plot_bode(response: LoopResponse, command: str | None = None) -> Figure:
    """Return a figure that shows gain and phase of the open loop of a command, the others closed, by instant.

    Parameters
    ----------
    response : LoopResponse
    command : str, optional
        Default the first.

    Examples
    --------
    >>> from gnc_opt.analysis import loop_response
    >>> figure = plot_bode(loop_response(loop, x0=[1.0, 0.0], tf=8.0))
    """
    label, omega = _command(response, command), response.frequencies
    with style():
        figure = new_figure(4.6)
        gain, phase = figure.subplots(2, 1, sharex=True)
        for i, k in enumerate(_instants(response)):
            loop = response.channel(omega, label, k)
            gain.loglog(omega, np.abs(loop), **line_look(i))
            phase.semilogx(omega, np.degrees(_unwrapped(loop)), **line_look(i))
        gain.axhline(1.0, color=QUIET, linewidth=0.8)
        phase.axhline(-180.0, color=QUIET, linewidth=0.8)
        gain.set_ylabel(f"gain of the loop at {name_text(label)}")
        phase.set_ylabel(axis_label("phase", "deg"))
        phase.set_xlabel(axis_label("frequency", "rad/s"))
        phase.set_xlim(omega[0], omega[-1])
        _legend(figure, response)
    return figure


def plot_nyquist(response: LoopResponse, command: str | None = None) -> Figure:
    """Return a figure that shows the open loop of a command in the complex plane about -1, a line for each instant.

    The lines stay outside of the disk of the smallest disk margin (Seiler, Packard and Gahinet, An
    introduction to disk margins (2020), figure 6).

    Parameters
    ----------
    response : LoopResponse
    command : str, optional
        Default the first.

    Examples
    --------
    >>> from gnc_opt.analysis import loop_response
    >>> figure = plot_nyquist(loop_response(loop, x0=[1.0, 0.0], tf=8.0))
    """
    label, omega = _command(response, command), response.frequencies
    with style():
        figure = new_figure(5.0, 5.0)
        ax = figure.subplots()
        for i, k in enumerate(_instants(response)):
            loop = response.channel(omega, label, k)
            ax.plot(loop.real, loop.imag, **line_look(i))
        ax.plot(-1.0, 0.0, "+", color="black", markersize=9)
        alpha = float(np.fmin.reduce(response.disk_margins))  # open instants have none
        if 0 < alpha < 2:
            low, high = (alpha - 2) / (alpha + 2), (alpha + 2) / (alpha - 2)
            middle, radius = 0.5 * (low + high), 0.5 * (low - high)
            ax.add_patch(Circle((middle, 0.0), radius, facecolor="#eeeeee", edgecolor=QUIET, zorder=0))
        ax.set(
            xlim=(-_NYQUIST_RADIUS, _NYQUIST_RADIUS / 2),
            ylim=(-0.75 * _NYQUIST_RADIUS, 0.75 * _NYQUIST_RADIUS),
            aspect="equal",
        )
        ax.set_xlabel("real part")
        ax.set_ylabel("imaginary part")
        _legend(figure, response)
    return figure


def plot_sensitivity(response: LoopResponse) -> Figure:
    """Return a figure that shows the largest singular values of the sensitivity S and of T = 1 - S, by instant.

    Parameters
    ----------
    response : LoopResponse

    Examples
    --------
    >>> from gnc_opt.analysis import loop_response
    >>> figure = plot_sensitivity(loop_response(loop, x0=[1.0, 0.0], tf=8.0))
    """
    omega = response.frequencies
    with style():
        figure = new_figure(3.2)
        left, right = figure.subplots(1, 2, sharey=True)
        for i, k in enumerate(_instants(response)):
            s = response.sensitivity(omega, k)
            for ax, matrix in ((left, s), (right, np.eye(s.shape[1]) - s)):
                ax.loglog(omega, np.linalg.norm(matrix, 2, axis=(1, 2)), **line_look(i))
        for ax, text in ((left, "sensitivity S"), (right, "complementary sensitivity T")):
            ax.axhline(1.0, color=QUIET, linewidth=0.8)
            ax.set_xlabel(axis_label("frequency", "rad/s"))
            ax.set_title(text)
            ax.set_xlim(omega[0], omega[-1])
        left.set_ylim(1e-3, 1e1)
        _legend(figure, response)
    return figure


def plot_margins(response: LoopResponse) -> Figure:
    """Return a figure that shows the disk margin, and its changes of gain and phase, over the instants.

    Parameters
    ----------
    response : LoopResponse
        At many instants.

    Examples
    --------
    >>> from gnc_opt.analysis import loop_response
    >>> figure = plot_margins(loop_response(loop, x0=[1.0, 0.0], tf=8.0, at=[0.0, 2.0, 4.0]))
    """
    alpha = np.minimum(response.disk_margins, 2.0 - 1e-9)
    with style():
        figure = new_figure(4.6)
        axes = figure.subplots(3, 1, sharex=True)
        rows: tuple[tuple[Any, str], ...] = (
            (alpha, "disk margin"),
            (20 * np.log10((2 + alpha) / (2 - alpha)), axis_label("gain", "dB")),
            (np.degrees(2 * np.arctan(alpha / 2)), axis_label("phase", "deg")),
        )
        for ax, (values, label) in zip(axes, rows, strict=True):
            _over_time(ax, response, values)
            ax.set_ylabel(label)
        axes[-1].set_xlabel(axis_label("time", "s"))
    return figure


def _over_time(ax: Axes, response: LoopResponse, values: Any) -> None:
    look = line_look(0) | ({"marker": "o", "markersize": 4} if response.times.size < 30 else {})
    ax.plot(response.times, values, **look)
    ax.set_ylim(0.0, 1.1 * float(np.fmax.reduce(values, initial=1e-9)))


def _command(response: LoopResponse, command: str | None) -> str:
    return response.commands.labels[0] if command is None else command


def _instants(response: LoopResponse) -> range:
    if response.times.size > len(COLORS):
        raise ArgumentError(
            f"{response.times.size} instants make too many lines: give loop_response() at= up to {len(COLORS)} "
            "times, or use plot_margins()."
        )
    return range(response.times.size)


def _legend(figure: Figure, response: LoopResponse) -> None:
    if response.times.size > 1:
        handles = [Line2D([], [], label=f"{t:g} s", **line_look(i)) for i, t in enumerate(response.times)]
        legend_on_top(figure, handles)


def _unwrapped(loop: Any) -> Any:
    """Return the phase (rad), continuous, that is nearest to a lag of half a turn where the gain is one."""
    phase = np.unwrap(np.angle(loop))
    at = int(np.argmin(np.abs(np.log(np.abs(loop) + 1e-300))))
    return phase - 2 * np.pi * np.round((phase[at] + np.pi) / (2 * np.pi))
