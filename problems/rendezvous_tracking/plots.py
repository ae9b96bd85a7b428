"""Figures of the followed rendezvous."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from gnc_opt.plot.campaign import plot_dispersion
from gnc_opt.plot.run import plot_run_controls
from gnc_opt.plot.style import QUIET, legend_on_top, line_look, new_figure, style
from gnc_opt.simulation import Campaign
from problems.rendezvous_tracking.tracking import DT, LIMITS, SHOWN, Tracking

_COSTS = {
    "effort(F_B)": "effort of the forces (N s)",
    "effort(T_B)": "effort of the torques (N m s)",
    "saturation(F_B)": "forces in saturation (s)",
    "saturation(T_B)": "torques in saturation (s)",
}
_FLOWN = 20
"""Runs per controller in the figure over time."""
_LIMIT = {"color": "black", "linestyle": ":", "linewidth": 1.2}


def all_figures(
    tracking: Tracking, campaigns: Mapping[str, Campaign], price: Sequence[tuple[float, float]]
) -> dict[str, Figure]:
    """Return the figures by file stem."""
    figures = {
        "terminal_errors": terminal_errors(campaigns),
        "costs": costs(campaigns),
        "errors_over_time": errors_over_time(tracking, campaigns),
        "price_of_robustness": price_figure(price),
    }
    for name, campaign in campaigns.items():
        stem = name.replace(" ", "_").lower()
        figures[f"dispersion_{stem}"] = plot_dispersion(campaign, "r_L")
        figures[f"controls_{stem}"] = plot_run_controls(campaign.rerun(int(campaign.indices[0])))
    return figures


def terminal_errors(campaigns: Mapping[str, Campaign]) -> Figure:
    """Draw which share of the runs ends below an error, one axis per error, limits dotted."""
    labels = {measure: f"{label} error ({unit})" for measure, (label, _, unit) in SHOWN.items()}
    factors = {measure: factor for measure, (_, factor, _) in SHOWN.items()}
    return _shares(campaigns, labels, factors, logarithmic=True)


def costs(campaigns: Mapping[str, Campaign]) -> Figure:
    """Draw which share of the runs costs less than a value."""
    return _shares(campaigns, _COSTS, dict.fromkeys(_COSTS, 1.0), logarithmic=False)


def _shares(
    campaigns: Mapping[str, Campaign],
    labels: Mapping[str, str],
    factors: Mapping[str, float],
    *,
    logarithmic: bool,
) -> Figure:
    with style():
        figure = new_figure(6.0)
        axes = figure.subplots(2, 2, sharey=True).ravel()
        for ax, (measure, label) in zip(axes, labels.items(), strict=True):
            for i, campaign in enumerate(campaigns.values()):
                values = np.sort(factors[measure] * campaign.measure(measure))
                share = np.arange(1, values.size + 1) / values.size
                ax.step(np.r_[values[0], values], np.r_[0, share], where="post", **line_look(i))
            if logarithmic:
                ax.set_xscale("log")
                ax.axvline(factors[measure] * LIMITS[measure], **_LIMIT)
            ax.set_xlabel(label)
            ax.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
        for ax in axes[::2]:
            ax.set_ylabel("runs below")
        legend_on_top(figure, _handles(campaigns, limit=logarithmic))
    return figure


def errors_over_time(tracking: Tracking, campaigns: Mapping[str, Campaign]) -> Figure:
    """Draw position and attitude errors of the first runs over time; the planned arrival is grey."""
    with style():
        figure = new_figure(6.5)
        axes = figure.subplots(2, 1, sharex=True)
        for i, campaign in enumerate(campaigns.values()):
            for index in campaign.indices[:_FLOWN]:
                run = campaign.rerun(int(index))
                for ax, state, factor in zip(axes, ("r_L", "sigma"), (100.0, np.degrees(1)), strict=True):
                    size = factor * np.linalg.norm(run.error(state).values, axis=0)
                    ax.semilogy(run.times, size, linewidth=0.6, alpha=0.7, color=line_look(i)["color"])
        for ax, measure, label in zip(
            axes, ("r_L", "angle(sigma)"), ("position error (cm)", "attitude error (deg)"), strict=True
        ):
            ax.axhline(SHOWN[measure][1] * LIMITS[measure], **_LIMIT)
            ax.axvline(tracking.reference.final_time, color=QUIET, linewidth=1.0)
            ax.set_ylabel(label)
        axes[-1].set_xlabel(f"time (s), control step {DT:g} s")
        legend_on_top(figure, _handles(campaigns, limit=True, dashed=False))
    return figure


def price_figure(price: Sequence[tuple[float, float]]) -> Figure:
    """Draw the minimum time against the reserve, beside the law of a rest-to-rest translation."""
    share, t_f = np.array(price).T
    order = np.argsort(share)
    fastest = t_f[np.argmax(share)]
    fine = np.linspace(share.min(), share.max(), 200)
    with style():
        figure = new_figure(3.6)
        ax = figure.subplots()
        ax.plot(100 * (1 - share[order]), t_f[order], marker="o", **line_look(0), label="planned")
        ax.plot(
            100 * (1 - fine),
            fastest / np.sqrt(fine),
            color=QUIET,
            linewidth=1.0,
            label=r"$t_f(1) / \sqrt{\mathrm{share}}$",
        )
        ax.set_xlabel("authority kept in reserve (%)")
        ax.set_ylabel("minimum time (s)")
        ax.legend(loc="upper left")
    return figure


def _handles(campaigns: Mapping[str, Campaign], *, limit: bool, dashed: bool = True) -> list[Line2D]:
    looks = [line_look(i) if dashed else {"color": line_look(i)["color"]} for i in range(len(campaigns))]
    lines = [Line2D([], [], **look, label=name) for look, name in zip(looks, campaigns, strict=True)]
    return [*lines, Line2D([], [], **_LIMIT, label="limit")] if limit else lines
