"""Figures of campaigns: final errors, distributions of measures, and quantities over time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import PercentFormatter

from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.numerical_tolerances import EQUAL, SAME_TIME, SMALL
from gnc_opt.plot.figure_style import (
    COLORS,
    QUIET,
    THIN,
    apply_plot_style,
    count_axes_per_figure_row,
    create_figure_with_axes_rows,
    format_axis_label,
    format_unit,
    format_variable_name,
    get_line_style,
    place_legend_above,
)
from gnc_opt.plot.time_plot_axes import label_bottom_time_axes
from gnc_opt.simulation.campaign_performance_measures import rank_dispersions
from gnc_opt.simulation.campaign_results import Campaign
from gnc_opt.simulation.campaign_tables import LEVELS, select_printed_performance_measures
from gnc_opt.simulation.confidence_intervals import CONFIDENCE
from gnc_opt.simulation.recorded_extremes_and_integrals import select_quantity_sample_steps
from gnc_opt.simulation.simulation_run_results import Run
from gnc_opt.spacecraft.attitude import compute_attitude_angle

_PASSED: dict[str, Any] = {"color": COLORS[0], "marker": "o", "linestyle": "none"}
_FAILED: dict[str, Any] = {"color": COLORS[1], "marker": "x", "linestyle": "none"}
_LIMIT: dict[str, Any] = {"label": "limit", "color": "black", "linestyle": "--"}
_CURVE: dict[str, Any] = {"color": COLORS[0]}
_PERCENTILE: dict[str, Any] = {
    "label": "percentiles, 95 % intervals",
    "color": COLORS[1],
    "marker": "o",
}

_NOMINAL: dict[str, Any] = {"label": "nominal", "color": "black", "linestyle": ":"}

_NOISE: dict[str, Any] = {"label": "noise level", "color": "black"}

_COMMAND: dict[str, Any] = {"label": "command", "color": QUIET, "linewidth": THIN}

_BAND: dict[str, Any] = {"label": "5 to 95 %", "color": COLORS[5], "alpha": 0.5, "linewidth": 0}

_RANGE: dict[str, Any] = _BAND | {"label": "_", "alpha": 0.25}

_LAYOUTS = {"errors": "error", "states": "state", "controls": "applied"}

LEVELS_OVER_TIME = (0.05, 0.5, 0.95)
"""Levels of the percentiles of states and controls over time."""

_EFFECTS_MAX, _FINAL_SHARE = 6, 0.2
"""Largest number of dispersions in the figure of a measure; share of the longest run in that of final errors."""

_FAR = 3.0
"""Limits farther out than this multiple of the largest value (or of the range) do not extend the axes."""


def plot_dispersion(campaign: Campaign, name: str) -> Figure:
    """Return a figure of the final errors of all runs: the components of a state's error against each other.

    Dots are runs within all limits, crosses the others; the circle is the limit of the norm of the error.

    Parameters
    ----------
    campaign : Campaign
    name : str
        State with at least two components; for three, the first is drawn against each of the others.

    Examples
    --------
    >>> puck = go.Model("puck")
    >>> r, u = puck.state("r", 2, unit="m"), puck.control("u", 2, unit="m/s")
    >>> puck.ode({r: u})
    >>> to_rest = go.ClosedLoop(puck, go.design_lqr(puck, [0, 0], Q=1, R=1, dt=0.1))
    >>> asked = {"x0": [2, 1], "tf": 3.0, "seed": 1, "executor": "serial"}
    >>> runs = go.monte_carlo(to_rest, 5, **asked, dispersions={"initial.r": Normal([0.2, 0.1])})
    >>> figure = plot_dispersion(runs, "r")
    """
    campaign.measure(name)  # raises an error for an unknown name
    errors = campaign.error(name)
    if errors.shape[0] < 2:
        raise ArgumentError(f"the error of '{name}' has only one component: use plot_distributions().")
    others = range(1, min(errors.shape[0], 3))
    passed, limit = campaign.passed(), campaign.limits.get(name, 0.0)
    unit = campaign.layouts["error"][name].unit
    finite = np.all(np.isfinite(errors), axis=0)
    reach = float(np.max(np.abs(errors[:, finite]), initial=np.finfo(float).tiny))
    reach = 1.1 * (limit if reach < limit < _FAR * reach else reach)
    groups = [(passed, _PASSED | {"label": f"{np.sum(passed)} passed"})]
    if not np.all(passed):
        groups.append((~passed, _FAILED | {"label": f"{np.sum(~passed)} failed"}))
    with apply_plot_style():
        figure, axes = create_figure_with_axes_rows([len(others)], 3.3, share_x=False)
        for ax, other in zip(axes, others, strict=True):
            for chosen, look in groups:
                ax.plot(errors[0, chosen], errors[other, chosen], **look)
            if limit:
                label = f"limit {limit:.3g} {unit}".rstrip() + " (outside)" * (limit > reach)
                ax.add_patch(Circle((0, 0), limit, fill=False, **(_LIMIT | {"label": "_"})))
                ax.plot([], [], **(_LIMIT | {"label": format_unit(label)}))
            ax.set_xlabel(format_axis_label(f"final error of {format_variable_name(f'{name}[0]')}", unit))
            ax.set_ylabel(
                format_axis_label(f"final error of {format_variable_name(f'{name}[{other}]')}", unit)
            )
            ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
            ax.locator_params(nbins=5, symmetric=True)
        place_legend_above(axes[0])
    return figure


def plot_distributions(campaign: Campaign, names: Sequence[str] | None = None) -> Figure:
    """Return a figure of the empirical distribution of measures: the share of runs below each value.

    Percentiles are marked with bars for their confidence intervals; an arrow marks an unbounded interval.

    Parameters
    ----------
    campaign : Campaign
    names : sequence of str, optional
        Measures; default: those with limits, or errors and efforts if there are none.

    Examples
    --------
    >>> figure = plot_distributions(campaign, ["q", "max(overshoot)"])
    """
    chosen = (
        list(names)
        if names is not None
        else list(campaign.limits) or list(select_printed_performance_measures(campaign))
    )
    if not chosen:
        raise ArgumentError("the campaign has no measures: give target= or limits= to monte_carlo().")
    with apply_plot_style():
        figure, axes = create_figure_with_axes_rows(
            count_axes_per_figure_row(len(chosen)), 1.7, share_x=False, gap=0.1
        )
        for ax, name in zip(axes, chosen, strict=True):
            values = campaign.measure(name)
            finite = np.sort(values[np.isfinite(values)])
            _draw_empirical_distribution(ax, campaign, name, finite)
            unit = campaign.unit(name)
            _draw_limit_of_performance_measure(ax, campaign.limits.get(name), unit, finite)
            ax.set_xlabel(format_axis_label(campaign.describe_measure(name, format_variable_name), unit))
        place_legend_above(axes[0], axes[1:])
    return figure


def _draw_empirical_distribution(ax: Axes, campaign: Campaign, name: str, finite: Any) -> None:
    shares = np.arange(1, finite.size + 1) / len(campaign)
    if finite.size:
        ax.step(np.r_[finite[0], finite], np.r_[0.0, shares], where="post", **_CURVE)
    for level in LEVELS:
        found = campaign.percentile(name, level)
        if np.isfinite(found.value):
            bounds = found.low, found.high
            shown = np.clip(bounds, finite[0], finite[-1])
            ax.plot(shown, [level, level], color=COLORS[1])
            for end, bound, arrow in zip(shown, bounds, "<>", strict=True):
                marker = "|" if np.isfinite(bound) else arrow
                ax.plot(end, level, color=COLORS[1], marker=marker)
            ax.plot(found.value, level, **_PERCENTILE)
    ax.set_ylim(-0.03, 1.05)
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))
    ax.locator_params(axis="x", nbins=5)
    ax.set_ylabel("share of runs")


def _draw_limit_of_performance_measure(ax: Axes, limit: float | None, unit: str, finite: Any) -> None:
    if limit is None:
        return
    ends = ax.get_xlim()
    ax.axvline(limit, **_LIMIT)
    if finite.size and abs(limit - np.mean(finite[[0, -1]])) > _FAR * np.ptp(finite):
        ax.set_xlim(ends)
        text = format_unit(f"limit {limit:.4g} {unit}".rstrip())
        right, place = limit > finite[0], {"transform": ax.transAxes, "va": "bottom"}
        ax.text(
            0.98 if right else 0.02,
            0.04,
            f"{text} →" if right else f"← {text}",
            ha="right" if right else "left",
            **place,
        )


def rank_dispersion_effects(campaign: Campaign) -> dict[str, tuple[list[tuple[str, float, Array]], float]]:
    """Return the ranked dispersions and the noise level of rank correlations by (limited) measure."""
    found = {}
    for name in list(campaign.limits) or select_printed_performance_measures(campaign):
        effects = rank_dispersions(campaign, campaign.measure(name))
        tail = (1 - CONFIDENCE) / (4 * len(effects) or 1)  # Bonferroni: two sides of two coefficients each
        found[name] = effects, min(-scipy.special.ndtri(tail) / np.sqrt(len(campaign)), 1.0)
    return found


def plot_dispersion_effects(campaign: Campaign) -> Figure:
    """Return a figure of rank correlations of dispersions with limited measures, and of the runs.

    Measures without significant correlation are omitted; if there are no others, the one with the largest is shown.
    """
    every, passed = rank_dispersion_effects(campaign), campaign.passed()
    sizes = {name: abs(effects[0][1]) if effects else 0.0 for name, (effects, _) in every.items()}
    shown = [name for name in every if sizes[name] > every[name][1]] or [max(sizes, key=lambda n: sizes[n])]
    layout = campaign.layouts["parameter"]
    units = dict(zip(layout.labels, layout.units, strict=True))
    with apply_plot_style():
        figure, axes = create_figure_with_axes_rows([2] * len(shown), 1.8, share_x=False)
        for name, bars, ax in zip(shown, axes[::2], axes[1::2], strict=True):
            effects, noise = every[name]
            values, label = campaign.measure(name), campaign.describe_measure(name, format_variable_name)
            for i, (parameter, size, _) in enumerate(effects[:_EFFECTS_MAX]):
                text = f"{size:+.2f}  {_format_parameter_label(parameter)}".replace("-", "−")
                bars.barh(i + 0.3, abs(size), 0.25, color=COLORS[5] if abs(size) > noise else QUIET)
                bars.plot([noise, noise], [i + 0.16, i + 0.46], **_NOISE)
                bars.text(0.02, i - 0.12, text, va="center")
            bars.set(xlim=(0, 1), ylim=(_EFFECTS_MAX - 0.5, -0.5), yticks=[])
            bars.set_xlabel(f"rank correlation, {label}")
            for parameter, _, drawn in effects[:1]:
                ax.plot(drawn[passed], values[passed], **_PASSED)
                ax.plot(drawn[~passed], values[~passed], **_FAILED)
                first = parameter.strip("|")
                ax.set_xlabel(format_axis_label(_format_parameter_label(first), units[first]))
            ax.set_ylabel(format_axis_label(label, campaign.unit(name)))
            largest = np.max(values, where=np.isfinite(values), initial=0.0)
            if campaign.limits.get(name, np.inf) < _FAR * largest:
                ax.axhline(campaign.limits[name], **_LIMIT)
        place_legend_above(axes[0])
    return figure


def _format_parameter_label(label: str) -> str:
    """Return a parameter typeset: "|initial.q[0]|" is "|Δ initial q₁|"."""
    owner, _, name = label.strip("|").partition(".")
    text = f"{owner} {format_variable_name(name)}"
    return f"|Δ {text}|" if label.startswith("|") else text


def plot_envelope(campaign: Campaign, name: str, levels: Sequence[float] = (0.01, 0.5, 0.99)) -> Figure:
    """Return a figure of the percentiles of a quantity over time, over all runs.

    Areas around the percentiles are pointwise 95 % confidence intervals. The limit of the maximum is dashed.

    Parameters
    ----------
    campaign : Campaign
    name : str
        A quantity of the loop.
    levels : sequence of float
        In (0, 1).

    Examples
    --------
    >>> figure = plot_envelope(campaign, "overshoot", levels=(0.1, 0.5, 0.9))
    """
    found, limit = campaign.envelope(name, levels), campaign.limits.get(f"max({name})")
    with apply_plot_style():
        figure, (ax,) = create_figure_with_axes_rows([1], 2.0)
        for i, level in enumerate(found.levels):
            look = get_line_style(i)
            low, high = (
                np.where(np.isfinite(end[i]), end[i], found.values[i]) for end in (found.low, found.high)
            )
            ax.fill_between(found.times, low, high, color=look["color"], alpha=0.25, linewidth=0)
            ax.plot(found.times, found.values[i], label=f"{100 * level:g} %", **look)
        ax.set_ylabel(format_axis_label(format_variable_name(name), found.unit))
        ax.set_xlim(found.times[0], found.times[-1])
        if limit is not None:
            ax.axhline(limit, **_LIMIT)
        place_legend_above(ax)
        label_bottom_time_axes(figure, "s")
    return figure


def plot_run_envelopes(campaign: Campaign, runs: Sequence[Run], nominal: Run) -> Iterator[tuple[str, Figure]]:
    """Yield "final", "errors", "states", "controls": percentiles in some runs, a nominal run, and the limits.

    "final" shows limited final errors before the end of each run. The errors are those relative to the reference;
    "states" are those without reference, while at least half of the runs are active.
    """
    compiled_loop = campaign.compiled_loop
    assert compiled_loop is not None  # the runs were simulated with it
    times = compiled_loop.times[select_quantity_sample_steps(compiled_loop.n_steps)]
    ends = np.array([run.times[-1] for run in runs])
    times = times[np.mean(ends[:, None] >= times - SAME_TIME, axis=0) >= 0.5]
    states = {*compiled_loop.states.names, *(f"angle({name})" for name in compiled_loop.states.names)}
    if finals := {name: limit for name, limit in campaign.limits.items() if name in states and limit > 0.0}:
        yield "final", _plot_final_errors(campaign, [*runs, nominal], finals)
    for kind, names in group_variables_by_figure(nominal).items():
        if names:
            samples = np.stack([_sample_run_variables(run, kind, times) for run in runs], axis=-1)
            draw = partial(
                _draw_percentiles_over_time, times, samples, _sample_run_variables(nominal, kind, times)
            )
            yield kind, _plot_signal_components(campaign, kind, names, times, draw)


def plot_run_controls(campaign: Campaign, run: Run, nominal: Run, label: str) -> Figure:
    """Return a figure of the applied controls of a run with its commands, of a nominal run, and of the limits."""
    lines = [(run, run.applied, _CURVE | {"label": label}), (nominal, nominal.applied, _NOMINAL)]
    if run.layouts["command"].labels == run.layouts["applied"].labels:
        lines.insert(0, (run, run.commands, _COMMAND))

    def draw_control_component(i: int, ax: Axes) -> None:
        for owner, values, look in lines:
            ax.plot(owner.times[:-1], values[i], drawstyle="steps-post", **look)

    return _plot_signal_components(
        campaign, "controls", run.layouts["applied"].names, run.times, draw_control_component
    )


def _plot_signal_components(
    campaign: Campaign, kind: str, names: Sequence[str], times: Array, draw: Callable[[int, Axes], None]
) -> Figure:
    """Return a figure with one axes for each component of the signals, and the limits of the controls."""
    layout = campaign.layouts[_LAYOUTS[kind]]
    rows = [i for name in names for i in range(layout.size)[layout.slice(name)]]
    limits = _find_saturation_limits(campaign) if kind == "controls" else {}
    with apply_plot_style():
        figure, axes = create_figure_with_axes_rows(count_axes_per_figure_row(len(rows)), 1.5)
        for i, ax in zip(rows, axes, strict=True):
            draw(i, ax)
            for level in limits.get(layout.labels[i], ()):
                ax.axhline(level, **_LIMIT)
            quantity = "error of " * (kind == "errors") + format_variable_name(layout.labels[i])
            ax.set_ylabel(format_axis_label(quantity, layout.units[i]))
        axes[0].set_xlim(times[0], times[-1])
        place_legend_above(axes[0], axes[1:])
        label_bottom_time_axes(figure, "s")
    return figure


def _draw_percentiles_over_time(times: Array, samples: Array, nominal: Array, i: int, ax: Axes) -> None:
    """Draw percentiles and range over the runs of the samples i, (n_times, n_runs), which are NaN after the end."""
    ordered = np.sort(samples[i], axis=1)  # NaN last
    count = np.sum(~np.isnan(ordered), axis=1)
    orders = (np.clip(np.ceil(level * count - EQUAL).astype(int), 1, None) - 1 for level in LEVELS_OVER_TIME)
    low, median, high = (np.take_along_axis(ordered, order[:, None], axis=1)[:, 0] for order in orders)
    ax.fill_between(times, low, high, **_BAND)
    ax.fill_between(times, *(f.reduce(samples[i], axis=1) for f in (np.fmin, np.fmax)), **_RANGE)
    ax.plot(times, median, label="median", **_CURVE)
    ax.plot(times, nominal[i], **_NOMINAL)


def _plot_final_errors(campaign: Campaign, runs: Sequence[Run], limits: Mapping[str, float]) -> Figure:
    """Return a figure of final errors before the end of each run, of which the last is nominal, with the limits."""
    times = np.linspace(-_FINAL_SHARE * max(run.times[-1] - run.times[0] for run in runs), 0.0, 101)
    with apply_plot_style():
        figure, axes = create_figure_with_axes_rows(count_axes_per_figure_row(len(limits)), 1.5)
        for ax, (name, limit) in zip(axes, limits.items(), strict=True):
            samples = np.stack(
                [_sample_final_error_history(campaign, run, name, times) for run in runs], axis=-1
            )
            _draw_percentiles_over_time(times, samples[None, :, :-1], samples[None, :, -1], 0, ax)
            ax.axhline(limit, **_LIMIT)
            last, middle = samples[-1], np.fmax(limit, np.nanmedian(samples[-1]))
            top = 1.2 * min(np.fmax(limit, np.fmax.reduce(last)), _FAR * middle)
            bottom = np.nanquantile(samples, LEVELS_OVER_TIME[0]) / 2
            ax.set(yscale="log", ylim=(max(bottom, SMALL * SMALL * top), top))
            label = campaign.describe_measure(name, format_variable_name).removeprefix("final ")
            ax.set_ylabel(format_axis_label(label, campaign.unit(name)))
        axes[0].set_xlim(times[0], times[-1])
        place_legend_above(axes[0])
        label_bottom_time_axes(figure, "s, relative to the end of the run")
    return figure


def _sample_final_error_history(campaign: Campaign, run: Run, name: str, times: Array) -> Array:
    """Return a final error over time: the norm or the angle relative to the target; times count from the end."""
    assert campaign.compiled_loop is not None
    subject, target = name.removeprefix("angle(").rstrip(")"), campaign.target[:, None]
    if subject == name:
        errors = campaign.compiled_loop.errors(run.states, np.repeat(target, run.times.size, axis=1)).full()
        values = np.linalg.norm(errors[campaign.layouts["error"].slice(name)], axis=0)
    else:
        rows = campaign.layouts["state"].slice(subject)
        values = compute_attitude_angle(run.states[rows], target[rows])
    return np.asarray(np.interp(times, run.times - run.times[-1], values, left=np.nan))


def group_variables_by_figure(run: Run) -> dict[str, list[str]]:
    """Return the names of the states with a reference ("errors"), of the other states and of the controls."""
    followed = run.reference_layout.names if run.errors is not None else ()
    errors = [name for name in run.layouts["error"].names if name in followed]
    others = [name for name in run.layouts["state"].names if name not in errors]
    return {"errors": errors, "states": others, "controls": list(run.layouts["applied"].names)}


def _find_saturation_limits(campaign: Campaign) -> dict[str, list[float]]:
    """Return the finite limits of saturations by component of the control, medians over the runs."""
    found: dict[str, list[float]] = {}
    compiled_loop = campaign.compiled_loop
    assert compiled_loop is not None  # runs are drawn
    for name, on in compiled_loop.saturations.items():
        if set(on) <= set(compiled_loop.controls.names):
            labels = [label for control in on for label in compiled_loop.controls[control].labels]
            ends = [np.median(campaign.parameter(f"{name}.{end}"), axis=1) for end in ("lower", "upper")]
            found |= {
                label: [e for e in pair if np.isfinite(e)] for label, *pair in zip(labels, *ends, strict=True)
            }
    return found


def _sample_run_variables(run: Run, kind: str, times: Array) -> Array:
    """Return errors, states or applied controls at times of control steps, (n, n_times); NaN after the end."""
    if kind == "controls":
        values = np.hstack([run.applied, run.applied[:, -1:]])
    else:
        values = run.errors if kind == "errors" and run.errors is not None else run.states
    at = np.searchsorted(run.times, times)
    values = np.hstack([values, np.full((len(values), 1), np.nan)])
    return values[:, at]
