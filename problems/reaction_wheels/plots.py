"""Figures of the wheel pyramid: published slews, use of the null space, optimal slews and their tracking."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gnc_opt.plot.style import QUIET, legend_above, line_look, new_figure, save_figure, style
from problems._example import Array
from problems.reaction_wheels.flown import FLOWN, flight, plan
from problems.reaction_wheels.laws import Law
from problems.reaction_wheels.model import (
    DESIGN_SPEED,
    NOMINAL_SPEED,
    NULL,
    RPM,
    WHEEL_INERTIA,
    paper_quaternion,
)
from problems.reaction_wheels.optimal import MANOEUVRE, SLEWS, Name, optimal_slew
from problems.reaction_wheels.runs import Slew, published_slew

WHEELS = tuple(f"wheel {i}" for i in range(1, 5))
QUATERNION = ("$q_1$", "$q_2$", "$q_3$", "$q_4$")
EULER, AXES = (r"$\phi$", r"$\theta$", r"$\psi$"), ("x", "y", "z")
RATES = (r"$\omega_x$", r"$\omega_y$", r"$\omega_z$")
LAWS: tuple[Law, ...] = ("FLC", "LQR")
Panel = tuple[str, Array, Sequence[str]]


def write_figures(directory: Path) -> list[Path]:
    """Write all figures as PNG into a folder; return their paths."""
    return [save_figure(draw(), directory / f"{stem}.png") for stem, draw in figures().items()]


def figures() -> dict[str, Callable[[], Figure]]:
    """Return by file stem what draws each figure."""
    drawers: dict[str, Callable[[], Figure]] = {
        "angle_1": lambda: plot_angles(1),
        "slew_1_flc": lambda: plot_slew(published_slew(1, "FLC")),
        "slew_1_lqr": lambda: plot_slew(published_slew(1, "LQR")),
        "power_1": lambda: plot_power(1),
        "null_space_3_flc": lambda: plot_null_space(3, "FLC"),
        "tracking": plot_tracking,
    }
    for name in SLEWS:
        stem = "optimal_" + name.replace(",", "").replace(" ", "_")
        drawers[stem] = lambda name=name: plot_optimal(name)  # type: ignore[misc]
    return drawers


def plot_slew(slew: Slew) -> Figure:
    """Draw quaternion (as in the paper, scalar part last), Euler angles, rates, torques, and wheel speeds."""
    panels: list[Panel] = [
        ("quaternion", paper_quaternion(slew.states[:4]), QUATERNION),
        ("Euler angles (deg)", slew.euler_angles, EULER),
        ("body rate (deg/s)", np.degrees(slew.rates), RATES),
        ("body torque (N m)", slew.body_torque, AXES),
        ("wheel torque (N m)", slew.torques, WHEELS),
        ("wheel speed (rpm)", slew.speeds, WHEELS),
    ]
    return _stack(slew.times, panels)


def plot_angles(manoeuvre: int) -> Figure:
    """Draw the angle to the target under both laws: what EULERINT is the area of."""
    slews = [published_slew(manoeuvre, law) for law in LAWS]
    areas = [f"{law}: {slew.eulerint:.1f} deg s" for law, slew in zip(LAWS, slews, strict=True)]
    return _stack(slews[0].times, [("angle to target (deg)", np.stack([s.angle for s in slews]), areas)], 2.8)


def plot_power(manoeuvre: int) -> Figure:
    """Draw the power of all motors under both laws."""
    slews = [published_slew(manoeuvre, law) for law in LAWS]
    power = np.stack([np.sum(slew.power, axis=0) for slew in slews])
    labels = [f"{law}: {slew.work:.1f} J" for law, slew in zip(LAWS, slews, strict=True)]
    return _stack(slews[0].times, [("sum of motor powers (W)", power, labels)], 2.8)


def plot_null_space(manoeuvre: int, law: Law) -> Figure:
    """Draw wheel speeds with least torques, and with null torques that keep the largest as small as possible."""
    slew = published_slew(manoeuvre, law)
    signed = NULL[:, None] * slew.momenta
    shift = -(np.max(signed, axis=0) + np.min(signed, axis=0)) / 2
    balanced = (slew.momenta + NULL[:, None] * shift) / WHEEL_INERTIA / RPM
    panels: list[Panel] = [
        ("speed, least torque (rpm)", slew.speeds, WHEELS),
        ("speed, min-max (rpm)", balanced, WHEELS),
    ]
    figure = _stack(slew.times, panels)
    for ax in figure.axes:
        _limits(ax, DESIGN_SPEED, NOMINAL_SPEED)
    return figure


def plot_optimal(name: Name) -> Figure:
    """Draw an optimal slew: quaternion, rates, torques and speeds with their limits."""
    solution = optimal_slew(name)
    leg = solution.phase()
    jumps = np.asarray(leg.flown.jumps)
    sides = np.concatenate([jumps * (1 - 1e-9), jumps * (1 + 1e-9)])
    fine = np.linspace(0.0, leg.final_time, 2001)  # segments are long and curves of high degree
    times = np.unique(np.clip(np.concatenate([fine, sides]), 0.0, leg.final_time))
    speeds = np.asarray(leg.state("h")(times)) / WHEEL_INERTIA / RPM
    panels: list[Panel] = [
        ("quaternion", paper_quaternion(leg.state("q")(times)), QUATERNION),
        ("body rate (deg/s)", np.degrees(leg.state("omega")(times)), RATES),
        ("wheel torque (N m)", np.asarray(leg.flown_control("T")(times)), WHEELS),
        ("wheel speed (rpm)", speeds, WHEELS),
    ]
    figure = _stack(times, panels)
    bounds = leg.control_bounds
    if np.max(np.abs(panels[2][1])) > 0.9 * float(np.max(bounds.upper)):
        _limits(figure.axes[2], float(np.max(bounds.upper)))
    if np.max(np.abs(speeds)) > 0.9 * DESIGN_SPEED:
        _limits(figure.axes[3], DESIGN_SPEED)
    return figure


def plot_tracking() -> Figure:
    """Draw attitude errors and fastest wheels of the flown optimal slews."""
    with style():
        figure = new_figure(4.6)
        upper, lower = figure.subplots(2, 1, sharex=True)
        for i, name in enumerate(FLOWN):
            run, end = flight(name), plan(name).phase().final_time
            error = np.degrees(np.linalg.norm(run.error("q").values, axis=0))
            speed = np.max(np.abs(run.state("h").values), axis=0) / WHEEL_INERTIA / RPM
            upper.semilogy(run.times, error, label=f"{name} ({MANOEUVRE[name]})", **line_look(i))
            lower.plot(run.times, speed, **line_look(i))
            upper.axvline(end, color=line_look(i)["color"], linewidth=0.6)
            lower.axvline(end, color=line_look(i)["color"], linewidth=0.6)
        upper.set_ylabel("attitude error (deg)")
        lower.set_ylabel("fastest wheel (rpm)")
        lower.set_xlabel("time (s); thin lines: end of the slew")
        _limits(lower, DESIGN_SPEED, NOMINAL_SPEED, both=False)
        lower.set_xlim(left=0.0)
        lower.set_ylim(0.0, 1.05 * NOMINAL_SPEED)
        legend_above(upper)
        for line in list(upper.get_legend().get_lines()):
            line.set_linewidth(1.5)
    return figure


def _stack(times: Array, panels: Sequence[Panel], height: float | None = None) -> Figure:
    """Draw panels below each other: rows of values over time with their labels."""
    with style():
        figure = new_figure(height if height is not None else 0.6 + 1.75 * len(panels))
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for ax, (label, values, names) in zip(axes, panels, strict=True):
            for i, row in enumerate(values):
                ax.plot(times, row, label=names[i], **line_look(i))
            ax.set_ylabel(label)
            legend_above(ax)
        axes[-1].set_xlabel("time (s)")
        axes[-1].set_xlim(times[0], times[-1])
    return figure


def _limits(ax: Axes, *sizes: float, both: bool = True) -> None:
    for size in sizes:
        for value in (size, -size) if both else (size,):
            ax.axhline(value, color=QUIET, linewidth=0.8, linestyle=":")
