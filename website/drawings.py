"""Figures of the guides that their examples do not draw: each function draws from the names that the examples define.

`website.figures` calls the function with the name of the picture after the examples above the picture have run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

import gnc_opt as go
from gnc_opt.plot.figure_style import COLORS, QUIET, apply_plot_style, create_figure, get_line_style
from gnc_opt.plot.time_plot_axes import BOUND

Names = Mapping[str, Any]

WIDTH_IN = 5.4
"""Width of one column: 518 pixels, readable at the width of a phone too."""


def draw(name: str, names: Names) -> Figure:
    """Return the figure with a name; ``names`` are those of the examples."""
    with apply_plot_style():
        return _FUNCTIONS[name](names)


def is_drawn_here(name: str) -> bool:
    """Return whether this module draws a picture."""
    return name in _FUNCTIONS


def _rows(heights: tuple[float, ...], **more: Any) -> tuple[Figure, list[Axes]]:
    """Return a figure of one column with axes of the given heights (inches) below each other."""
    figure = create_figure(sum(heights) + 0.6, WIDTH_IN)
    axes = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False, **more)[:, 0]
    return figure, list(axes)


def _legend(figure: Figure, ax: Axes, columns: int) -> None:
    figure.legend(
        *ax.get_legend_handles_labels(), loc="outside upper center", ncols=columns, columnspacing=1.4
    )


def _times(solution: go.Solution, n: int = 600) -> Any:
    legs = list(solution.phases.values())
    return np.linspace(legs[0].initial_time, legs[-1].final_time, n)


def draw_guesses(names: Names) -> Figure:
    """Draw two guesses around an obstacle and the solutions that they lead to."""
    figure, (ax,) = _rows((2.6,))
    ax.add_patch(Circle((0.0, 0.3), 1.0, facecolor="#dddddd", edgecolor=QUIET))
    ax.text(0.0, 0.3, "pillar", ha="center", va="center", color=QUIET)
    for i, side in enumerate((-1.0, 1.0)):
        points = [-2.0, 0.0, 2.0], [0.0, 1.5 * side, 0.0]
        names["walk"].guess([0.0, 2.5, 5.0], x=points[0], y=points[1], course=0.0)
        solution = go.solve(names["problem"])
        t = _times(solution)
        ax.plot(
            *points, "--", color=COLORS[i], linewidth=1.1, label=f"guess {'below' if i == 0 else 'above'}"
        )
        path = solution.state("x")(t), solution.state("y")(t)
        ax.plot(*path, color=COLORS[i], linewidth=1.8, label=f"solution, {solution.objective:.2f} s")
    ax.plot([-2.0, 2.0], [0.0, 0.0], "o", color="black", markersize=5)
    ax.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", xlim=(-2.3, 2.3), ylim=(-1.75, 1.75))
    _legend(figure, ax, 2)
    return figure


def draw_power_limit(names: Names) -> Figure:
    """Draw power and multiplier of a path constraint, and the power without the limit."""
    limited, leg = go.solve(names["problem"]), names["move"].name
    power, t = names["u"] * names["v"], np.linspace(0.0, 3.0, 600)
    free = 6.0 / 9.0 * (1 - 2 * t / 3.0) * 6.0 / 3.0 * (t / 3.0 - (t / 3.0) ** 2)  # u v of the closed form
    figure, (top, bottom) = _rows((1.5, 1.2), sharex=True)
    top.plot(t, limited.evaluate(power, t), label="with the limit", **get_line_style(0))
    top.plot(t, free, label="without", **get_line_style(1))
    top.axhline(0.1, label="limit", **BOUND)
    top.set(ylabel="power u v (W/kg)", xlim=(0.0, 3.0))
    bottom.plot(t, limited.phase(leg).path_multiplier(t)[0], color=COLORS[2])
    bottom.set(xlabel="time (s)", ylabel="multiplier (1/s)")
    _legend(figure, top, 3)
    return figure


def draw_phases(names: Names) -> Figure:
    """Draw acceleration and speed of three phases with the values that link them."""
    three = names["three"]
    figure, (top, bottom) = _rows((1.4, 1.5), sharex=True)
    for i, (name, leg) in enumerate(three.phases.items()):
        t = np.linspace(leg.initial_time, leg.final_time, 100)
        top.plot(t, leg.control("u")(t), color=COLORS[i], linewidth=1.8)
        bottom.plot(t, leg.state("v")(t), color=COLORS[i], linewidth=1.8)
        top.text(0.5 * (t[0] + t[-1]), 1.3, name, color=COLORS[i], ha="center")
        for ax in (top, bottom) if i else ():
            ax.axvline(t[0], color=QUIET, linewidth=0.8, linestyle=":")
        if i:
            bottom.plot(t[0], leg.state("v")(t[0]), "o", color="black", markersize=5)
    bottom.annotate(
        *("equal states and times on both sides", (three.phase("coast").initial_time, 0.382), (0.75, 0.16)),
        arrowprops={"arrowstyle": "->", "color": QUIET},
    )
    top.set(ylabel="acceleration (m/s²)", ylim=(-1.2, 1.8))
    bottom.set(xlabel="time (s)", ylabel="speed (m/s)", xlim=(0.0, 3.0), ylim=(0.0, 0.45))
    return figure


def draw_rate_limit(names: Names) -> Figure:
    """Draw a control with a limited rate, and the bang-bang control without that limit."""
    smooth = names["smooth"]
    problem = go.Problem("without rate limit")
    move = names["cart"](problem)
    move.time(initial=0.0, final=(1.0, 20.0))
    move.bounds(u=(-1.0, 1.0))
    move.initial(x=0.0, v=0.0)
    move.final(x=8.0, v=0.0)
    problem.minimize(move.final_time)
    figure, (top, bottom) = _rows((1.5, 1.4), sharex=True)
    sharp = go.solve(problem)
    for i, (solution, label) in enumerate(((smooth, "rate limited to 1 m/s³"), (sharp, "no rate limit"))):
        t = _times(solution, 2000)
        top.plot(t, np.ravel(solution.control("u")(t)), label=label, **get_line_style(i))
        bottom.plot(t, solution.state("v")(t), **get_line_style(i))
    top.set(ylabel="acceleration (m/s²)")
    bottom.set(xlabel="time (s)", ylabel="speed (m/s)", xlim=(0.0, smooth.objective))
    _legend(figure, top, 2)
    return figure


def draw_thrust_vector(names: Names) -> Figure:
    """Draw magnitude and components of the optimal thrust vector of a landing."""
    landing = names["landing"]
    t = _times(landing, 1500)
    thrust = np.asarray(landing.saturated_control("T")(t)) / 1000.0
    figure, (ax,) = _rows((2.3,))
    for i, (values, label) in enumerate(
        zip((np.hypot(*thrust), *thrust), ("magnitude", "sideways", "upwards"), strict=True)
    ):
        ax.plot(t, values, label=label, **get_line_style(i))
    ax.axhline(6.0, label="limit", **BOUND)
    ax.set(xlabel="time (s)", ylabel="thrust (kN)", xlim=(t[0], t[-1]))
    _legend(figure, ax, 4)
    return figure


def draw_refinement(names: Names) -> Figure:
    """Draw a bang-bang control on three meshes, with their nodes."""
    cases = {
        "one solve": names["coarse"],
        "hp refinement": names["by_mesh"],
        "switching times": names["by_times"],
    }
    figure, axes = _rows((0.95, 0.95, 0.95), sharex=True)
    exact = (3 - 5**0.5) / 2
    for i, (ax, (label, solution)) in enumerate(zip(axes, cases.items(), strict=True)):
        leg = solution.phase()
        ax.axvline(exact, label="exact switch", **BOUND)
        for k, (a, b) in enumerate(pairwise(leg.breaks)):
            t = np.linspace(a + 1e-6, b - 1e-6, 60)
            curve = np.ravel(leg.control("forward")(t))
            ax.plot(t, curve, color=COLORS[i], label="control polynomial" if k == 0 else "_")
        points = leg.point_times
        ax.plot(
            points,
            np.ravel(leg.control("forward")(points)),
            "o",
            color=COLORS[i],
            markersize=3,
            label="nodes",
        )
        ax.set(ylabel="control", ylim=(-0.35, 1.6), xlim=(0.0, 0.9))
        count = leg.mesh.segments
        ax.text(0.99, 0.93, f"{label}: {count} segments", transform=ax.transAxes, ha="right", va="top")
    axes[-1].set_xlabel("time (s)")
    _legend(figure, axes[0], 3)
    return figure


def draw_failed_check(names: Names) -> Figure:
    """Draw a control whose switch lies inside a segment, with the exact one and the segment that fails the check."""
    leg = names["rough"].phase()
    figure, (ax,) = _rows((2.1,))
    a, b = leg.breaks[3:5]
    ax.axvspan(a, b, color="#dddddd", label="segment 4, FAIL")
    exact = go.solve(names["problem"])
    t = _times(exact, 2000)
    ax.plot(t, np.ravel(exact.saturated_control("a")(t)), label="exact", **get_line_style(1))
    for k, (a, b) in enumerate(pairwise(leg.breaks)):
        t = np.linspace(a + 1e-6, b - 1e-6, 60)
        curve = np.ravel(leg.control("a")(t))
        ax.plot(t, curve, color=COLORS[0], label="one solve" if k == 0 else "_")
    points = leg.point_times
    ax.plot(points, np.ravel(leg.control("a")(points)), "o", color=COLORS[0], markersize=3, label="nodes")
    ax.set(xlabel="time (s)", ylabel="acceleration (m/s²)", xlim=(0.0, leg.breaks[-1]))
    _legend(figure, ax, 4)
    return figure


_LINEAR_M = 0.1
"""Errors up to which the axes of `draw_estimation` are linear, m."""


def draw_estimation(names: Names) -> Figure:
    """Draw the estimation errors of one run within three standard deviations of the filter."""
    run, ekf = names["run"], names["ekf"]
    error = ekf.estimate(run.memory)[:2] - run.state("r").values[:2]
    sigma = np.sqrt(np.diagonal(ekf.covariance(run.memory), axis1=1, axis2=2)).T[:2]
    figure, axes = _rows((1.35, 1.35), sharex=True)
    for i, (ax, label) in enumerate(zip(axes, ("along", "across"), strict=True)):
        ax.fill_between(run.times, -3 * sigma[i], 3 * sigma[i], color=COLORS[0], alpha=0.18, linewidth=0)
        ax.plot(run.times, error[i], color=COLORS[0], linewidth=1.2)
        ax.set_yscale("symlog", linthresh=_LINEAR_M)  # the error decreases by a factor of 30
        reach = 1.5 * np.max(np.abs([error[i], 3 * sigma[i]]))
        ticks = [-1.0, -_LINEAR_M, 0.0, _LINEAR_M, 1.0]
        ax.set(ylabel=f"error {label} (m)", xlim=(0.0, run.times[-1]), ylim=(-reach, reach), yticks=ticks)
        ax.set_yticklabels([f"{tick:g}" for tick in ticks])
        note = f"band: ±3σ of the filter; logarithmic beyond ±{_LINEAR_M:g} m"
        ax.text(0.98, 0.93, note, transform=ax.transAxes, ha="right", va="top")
    axes[-1].set_xlabel("time (s)")
    return figure


def draw_events(names: Names) -> Figure:
    """Draw height and speed of the probe with its events."""
    run = names["loop"].simulate(**names["mission"])
    figure, (top, bottom) = _rows((1.4, 1.3), sharex=True)
    top.plot(run.times, np.ravel(run.state("h").values), color=COLORS[0])
    bottom.plot(run.times, np.ravel(run.state("w").values), color=COLORS[1])
    for event in run.events:
        for ax in (top, bottom):
            ax.axvline(event.time, color=QUIET, linewidth=0.9, linestyle=":")
        side = "right" if event.name == "touchdown" else "left"
        top.text(event.time, 1450.0, f" {event.name} ", ha=side, va="top")
    top.set(ylabel="height (m)", ylim=(0.0, 1550.0))
    bottom.set(xlabel="time (s)", ylabel="vertical speed (m/s)", xlim=(0.0, run.times[-1]))
    return figure


def draw_guidance(names: Names) -> Figure:
    """Draw commands and errors of a bang-bang plan, open loop and with its switching times corrected."""
    figure, (top, bottom) = _rows((1.2, 1.6), sharex=True)
    for i, (label, controller) in enumerate(reversed(names["controllers"].items())):
        loop = go.ClosedLoop(names["sled"], controller, names["thruster"], dt=0.05)
        run = loop.simulate([4.1, 0.0], tf=6.0, parameters={"plant.grip": 0.95})
        command = np.ravel(run.control("a").values)
        top.step(run.times[: command.size], command, where="post", label=label, **get_line_style(i))
        bottom.plot(run.times, np.ravel(run.state("q").values), **get_line_style(i))
    top.set(ylabel="acceleration (m/s²)")
    bottom.set(xlabel="time (s)", ylabel="position (m)", xlim=(0.0, 6.0))
    bottom.axhline(0.0, color=QUIET, linewidth=0.8)
    _legend(figure, top, 2)
    return figure


def draw_sweep(names: Names) -> Figure:
    """Draw the cost over the final time, found by a sweep, with the limit of feasibility."""
    times = np.concatenate([[2.0], np.geomspace(2.02, 6.0, 24)])
    swept = go.sweep(names["of_duration"], {"t": times[1:].tolist()}, mesh="20x4", executor="serial")
    figure, (ax,) = _rows((2.2,))
    ax.plot(swept.array("final_time"), swept.objective, "o-", color=COLORS[0], markersize=3.5, label="sweep")
    free = np.linspace(2.0, 6.0, 200)
    ax.plot(free, 12 / free**3, label="without bounds of u: 12 / t³", **get_line_style(1))
    ax.axvspan(1.6, 2.0, color="#dddddd")
    ax.text(1.8, 0.75, "infeasible", rotation=90, ha="center", va="center", color=QUIET)
    ax.set(xlabel="final time t (s)", ylabel="cost (m²/s³)", xlim=(1.6, 6.0), ylim=(0.0, 2.1))
    _legend(figure, ax, 2)
    return figure


_FUNCTIONS: dict[str, Callable[[Names], Figure]] = {
    "guesses.svg": draw_guesses,
    "power_limit.svg": draw_power_limit,
    "phases.svg": draw_phases,
    "rate_limit.svg": draw_rate_limit,
    "thrust_vector.svg": draw_thrust_vector,
    "refinement.svg": draw_refinement,
    "failed_check.svg": draw_failed_check,
    "estimation.svg": draw_estimation,
    "events.svg": draw_events,
    "guidance.svg": draw_guidance,
    "sweep.svg": draw_sweep,
}
