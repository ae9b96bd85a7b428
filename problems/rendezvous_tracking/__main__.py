"""``python -m problems.rendezvous_tracking``: the planned rendezvous tracked, a campaign per controller."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from gnc_opt.simulation import Campaign
from gnc_opt.simulation.campaign_text import campaign_dict
from problems._campaign_table import kept_in
from problems._example import wide_console
from problems.rendezvous import CASES
from problems.rendezvous_tracking.control import MPC_RUNS, SETTLING, SHOWN, Conditions, Tracking, plan
from problems.rendezvous_tracking.guidance import Filtered, Guided, Measured
from problems.rendezvous_tracking.replanning import PLANNED, REPLANNED_RUNS, Replanned

GUIDED = ("guided", "guided, filtered", "planned again, filtered")
"""Flights with more of the authority than the reserve leaves, evaluated as long after their own planned end."""
DEMANDED = 0.99
"""Pass rate of the controllers with feedback."""
_LEVELS = (0.5, 0.99)
_WIDTH = 190
_COSTS = {"effort(F_B)": "effort F (N s)", "effort(T_B)": "effort T (N m s)"}
_SATURATION = {"saturation(F_B)": "F saturated (s)", "saturation(T_B)": "T saturated (s)"}


def results_table(campaigns: Mapping[str, Campaign]) -> Table:
    """Return the table of all controllers: medians / 99 % points / largest values at the end."""
    table = _table("At the end: 50 % / 99 % / largest")
    table.add_column("controller", no_wrap=True)
    for heading in ("runs", "passed (95 % interval)"):
        table.add_column(heading, justify="right", no_wrap=True)
    for label, _, unit in SHOWN.values():
        table.add_column(f"{label} ({unit})", justify="right", no_wrap=True)
    for name, campaign in campaigns.items():
        cells = [_spread(campaign, measure, factor) for measure, (_, factor, _) in SHOWN.items()]
        table.add_row(name, str(len(campaign)), str(campaign.pass_rate()), *cells)
    return table


def cost_table(campaigns: Mapping[str, Campaign]) -> Table:
    """Return what following the plan cost: effort and time in saturation, 50 % / 99 % / largest."""
    table = _table("Cost: 50 % / 99 % / largest")
    table.add_column("controller", no_wrap=True)
    for heading in (*_COSTS.values(), *_SATURATION.values()):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, campaign in campaigns.items():
        cells = [_spread(campaign, measure, 1.0, ".0f") for measure in _COSTS]
        cells += [_spread(campaign, measure, 1.0, ".2f") for measure in _SATURATION]
        table.add_row(name, *cells)
    return table


def _spread(campaign: Campaign, measure: str, factor: float, form: str = ".3g") -> str:
    values = [campaign.percentile(measure, level).value for level in _LEVELS] + [campaign.maximum(measure)]
    return " / ".join(format(factor * value, form) for value in values)


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)


# --- main -------------------------------------------------------------------------------------------------


def main(arguments: Sequence[str] | None = None) -> int:
    """Plan, follow, evaluate and draw; see ``python -m problems.rendezvous_tracking --help``.

    Returns
    -------
    int
        0; 1 if a controller with feedback misses its pass rate.
    """
    options = _parser().parse_args(arguments)
    console = wide_console(_WIDTH)
    conditions = Conditions()
    tracking = Tracking(plan(options.case, conditions.share), conditions)
    console.print(
        f"case {options.case}: planned with {conditions.share:.0%} of the authority, "
        f"t_f = {tracking.reference.final_time:.6f} s, evaluated at {tracking.end:.4f} s; seed {options.seed}"
    )
    campaigns: dict[str, Campaign] = {}
    seconds: dict[str, float] = {}

    def how(name: str) -> dict[str, Any]:
        return {"progress": console.is_terminal, "checkpoint": kept_in(options.checkpoint, name)}

    for name in conditions.laws:
        runs = min(options.runs, options.mpc_runs) if name == "MPC" else options.runs
        if runs < 1:
            continue
        begin = time.perf_counter()
        campaigns[name] = tracking.campaign(name, runs, options.seed, **how(name))
        seconds[name] = time.perf_counter() - begin
        console.print(f"{name}: {runs} runs in {seconds[name]:.1f} s, design included")
    everything = options.runs > 0
    filtered = Filtered(tracking.solution, conditions)
    if everything:
        title, begin = "TVLQR, EKF", time.perf_counter()
        campaigns[title] = filtered.campaign("TVLQR", options.runs, options.seed, **how(title))
        seconds[title] = time.perf_counter() - begin
    for name in GUIDED if everything else ():
        runs = min(options.runs, options.replanned_runs) if name.startswith("planned") else options.runs
        if runs < 1:
            continue
        begin, guided = time.perf_counter(), _guided(name, options.case, conditions)
        campaigns[name] = guided.campaign(name, runs, options.seed, **how(name))
        seconds[name] = time.perf_counter() - begin
        arrivals = guided.arrivals(campaigns[name])
        console.print(
            f"{name}: {runs} runs, arrival by the last plan after {np.mean(arrivals):.3f} s on average, "
            f"{np.max(arrivals):.3f} s at the latest"
        )
    console.print()
    for table in (results_table(campaigns), cost_table(campaigns)):
        console.print(table)
    if options.json is not None:
        results = _summary(tracking, options.case, campaigns, seconds)
        options.json.write_text(json.dumps(results, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    if options.report is not None:
        from gnc_opt.plot.campaign import plot_dispersion
        from gnc_opt.plot.style import save_figure

        for name, campaign in campaigns.items():
            stem = name.replace(", ", "_").replace(" ", "_").lower()
            save_figure(plot_dispersion(campaign, "r_L"), options.report / f"dispersion_{stem}.png")
        console.print(f"report: {len(campaigns)} figures in {options.report}")
    rates = {name: campaign.pass_rate().rate for name, campaign in campaigns.items()}
    missed = [name for name, rate in rates.items() if name != "open loop" and rate < DEMANDED]
    for name in missed:
        console.print(f"{name} passes {rates[name]:.1%} of its runs; {DEMANDED:.0%} are demanded.")
    return 1 if missed else 0


def _guided(name: str, case: int, conditions: Conditions) -> Guided:
    """Return one of `GUIDED`."""
    if name.startswith("planned"):
        return Replanned(plan(case, PLANNED, refined=False), conditions, case)
    return (Measured if "filtered" in name else Guided)(plan(case, 1.0), conditions)


def _summary(
    tracking: Tracking, case: int, campaigns: Mapping[str, Campaign], seconds: Mapping[str, float]
) -> dict[str, Any]:
    return {
        "case": case,
        "share": tracking.conditions.share,
        "conditions": asdict(tracking.conditions),
        "planned_time_s": tracking.reference.final_time,
        "settling_s": SETTLING,
        "controllers": {
            name: {
                **campaign_dict(campaign),
                "seconds": seconds[name],
                "saturation_time_s": {m: float(np.mean(campaign.measure(m))) for m in _SATURATION},
            }
            for name, campaign in campaigns.items()
        },
    }


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m problems.rendezvous_tracking",
        description="The time-optimal rendezvous followed: open loop, TVLQR, integral sliding mode and MPC.",
    )
    parser.add_argument("--case", type=int, choices=list(CASES), default=1, help="initial position")
    parser.add_argument("--runs", type=int, default=1000, help="per controller, default 1000")
    parser.add_argument("--mpc-runs", type=int, default=MPC_RUNS, help=f"of the MPC at most, {MPC_RUNS}")
    parser.add_argument(
        "--replanned-runs", type=int, default=REPLANNED_RUNS,
        help=f"of the flight that is planned again at most, {REPLANNED_RUNS}",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--checkpoint", type=Path, metavar="DIR",
        help="keep finished runs in a folder per controller; those that are there are not flown again",
    )  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the statistics to a file")
    parser.add_argument("--report", type=Path, metavar="DIR", help="write the figures to a folder")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
