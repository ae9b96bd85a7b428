"""Figures of a loop in the frequency domain: Bode, Nyquist, sensitivity, disk margins along a trajectory."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from gnc_opt.analysis.loop_frequency_response import LoopResponse
from gnc_opt.errors import ArgumentError, quote_value, suggest_similar_name
from gnc_opt.plot.figure_style import (
    COLORS,
    QUIET,
    THIN,
    apply_plot_style,
    create_figure,
    format_axis_label,
    format_variable_name,
    get_line_style,
    place_legend_above,
)

Kind: TypeAlias = Literal["bode", "nyquist", "sensitivity", "margins"]

_NYQUIST_RADIUS = 2.5
"""Largest distance from the origin in a Nyquist plot; the region around -1 is relevant."""


def plot_response(response: LoopResponse, kind: Kind = "bode", command: str | None = None) -> Figure:
    """Return a frequency-domain figure of a loop, with one line per instant.

    Parameters
    ----------
    response : LoopResponse
    kind : {"bode", "nyquist", "sensitivity", "margins"}
        Gain and phase of the open loop of one command, the others closed; its Nyquist plot with the disk of the
        smallest disk margin (Seiler, Packard and Gahinet, An introduction to disk margins (2020), figure 6); largest
        singular values of the sensitivity S and of T = 1 - S; disk margin with its changes of gain and phase over time.
    command : str, optional
        Command for "bode" and "nyquist"; default: the first.

    Raises
    ------
    ArgumentError
        Unknown kind, or more instants than available line colours.

    Examples
    --------
    >>> from gnc_opt.analysis import loop_response
    >>> figure = plot_response(loop_response(loop, x0=[1.0, 0.0], tf=8.0), "nyquist")
    """
    if kind not in _KINDS:
        raise ArgumentError(
            f"a response is not drawn as {quote_value(kind)}: {suggest_similar_name(str(kind), _KINDS)}"
        )
    if kind != "margins" and response.times.size > len(COLORS):
        raise ArgumentError(
            f"{response.times.size} instants are too many for one figure: give loop_response() at= up to {len(COLORS)} "
            'times, or draw their "margins".'
        )
    draw, *size = _KINDS[kind]
    with apply_plot_style():
        figure = create_figure(*size)
        draw(figure, response, response.commands.labels[0] if command is None else command)
        if kind != "margins" and response.times.size > 1:
            lines = figure.axes[0].get_lines()
            for line, t in zip(lines, response.times, strict=False):
                line.set_label(f"{t:g} s")
            place_legend_above(figure.axes[0])
    return figure


def _draw_bode_plot(figure: Figure, response: LoopResponse, label: str) -> None:
    omega = response.frequencies
    gain, phase = figure.subplots(2, 1, sharex=True)
    for k in range(response.times.size):
        loop = response.channel_open_loop(omega, label, k)
        gain.loglog(omega, np.abs(loop), **get_line_style(k))
        phase.semilogx(omega, np.degrees(_unwrap_phase_angle(loop)), **get_line_style(k))
    gain.axhline(1.0, color=QUIET, linewidth=THIN)
    phase.axhline(-180.0, color=QUIET, linewidth=THIN)
    gain.set_ylabel(f"gain of the loop at {format_variable_name(label)}")
    phase.set_ylabel(format_axis_label("phase", "deg"))
    phase.set_xlabel(format_axis_label("frequency", "rad/s"))
    phase.set_xlim(omega[0], omega[-1])


def _draw_nyquist_plot(figure: Figure, response: LoopResponse, label: str) -> None:
    ax = figure.subplots()
    for k in range(response.times.size):
        loop = response.channel_open_loop(response.frequencies, label, k)
        ax.plot(loop.real, loop.imag, **get_line_style(k))
    ax.plot(-1.0, 0.0, "+", color="black", markersize=9)
    alpha = float(np.fmin.reduce(response.disk_margins))  # NaN for open loops
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


def _draw_sensitivity_plot(figure: Figure, response: LoopResponse, _: str) -> None:
    omega = response.frequencies
    left, right = figure.subplots(1, 2, sharey=True)
    for k in range(response.times.size):
        s = response.sensitivity(omega, k)
        for ax, matrix in ((left, s), (right, np.eye(s.shape[1]) - s)):
            ax.loglog(omega, np.linalg.norm(matrix, 2, axis=(1, 2)), **get_line_style(k))
    for ax, name in ((left, "sensitivity S"), (right, "complementary sensitivity T")):
        ax.axhline(1.0, color=QUIET, linewidth=THIN)
        ax.set_xlabel(format_axis_label("frequency", "rad/s"))
        ax.set_ylabel(f"{name}\nlargest singular value")
        ax.set_xlim(omega[0], omega[-1])
    left.set_ylim(1e-3, 1e1)


def _draw_disk_margin_plot(figure: Figure, response: LoopResponse, _: str) -> None:
    alpha = np.minimum(response.disk_margins, 2.0 - 1e-9)
    look = get_line_style(0) | ({"marker": "o"} if response.times.size < 30 else {})
    axes = figure.subplots(3, 1, sharex=True)
    rows: tuple[tuple[Any, str], ...] = (
        (alpha, "disk margin"),
        (20 * np.log10((2 + alpha) / (2 - alpha)), format_axis_label("gain", "dB")),
        (np.degrees(2 * np.arctan(alpha / 2)), format_axis_label("phase", "deg")),
    )
    for ax, (values, label) in zip(axes, rows, strict=True):
        ax.plot(response.times, values, **look)
        ax.set_ylim(0.0, 1.1 * float(np.fmax.reduce(values, initial=1e-9)))
        ax.set_ylabel(label)
    axes[-1].set_xlabel(format_axis_label("time", "s"))


_KINDS: dict[str, Any] = {
    "bode": (_draw_bode_plot, 4.6),
    "nyquist": (_draw_nyquist_plot, 5.0, 5.0),
    "sensitivity": (_draw_sensitivity_plot, 3.6),
    "margins": (_draw_disk_margin_plot, 4.6),
}
"""Drawing function of each kind, with height and width (inch)."""


def _unwrap_phase_angle(loop: Any) -> Any:
    """Return the continuous phase (rad) that is closest to -180 degrees at unit gain."""
    phase = np.unwrap(np.angle(loop))
    at = int(np.argmin(np.abs(np.log(np.abs(loop) + 1e-300))))
    return phase - 2 * np.pi * np.round((phase[at] + np.pi) / (2 * np.pi))
