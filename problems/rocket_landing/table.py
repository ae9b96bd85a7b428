"""The campaigns side by side."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from gnc_opt.report.campaign import campaign_dict
from gnc_opt.simulation import Campaign
from problems.rocket_landing.flown import CONTROLLERS, LIMITS, Landing
from problems.rocket_landing.model import PLANNED, START

DEMANDED = 0.99
"""Share of the runs that the plan made again has to land within all limits."""

_UNITS = {"miss": "m", "speed across": "m/s", "speed downward": "m/s", "propellant": "kg"}
_WIDTH = 110


def table(campaigns: Mapping[str, Campaign]) -> Table:
    """Return what became of the runs, law by law: median and largest value of every measure."""
    found = Table(
        title="Landings (median, largest)", title_justify="left", title_style="bold", box=box.SIMPLE_HEAD
    )
    found.add_column("law", no_wrap=True)
    for name, unit in _UNITS.items():
        found.add_column(f"{name} ({unit})", justify="right")
    for heading in ("replans", "in vain", "crashes", "passed"):
        found.add_column(heading, justify="right")
    for name, campaign in campaigns.items():
        cells = [f"{campaign.percentile(m, 0.5).value:.3g}, {campaign.maximum(m):.3g}" for m in _UNITS]
        cells += [f"{np.nansum(campaign.measure(m)):.0f}" for m in ("replans", "failed replans")]
        rate = campaign.pass_rate()
        passed = f"{rate.rate:.1%} ({rate.low:.2%} to {rate.high:.2%})"
        found.add_row(name, *cells, str(campaign.event_totals["crash"]), passed)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Plan, fly and judge; see ``python -m problems.rocket_landing --help``.

    Returns
    -------
    int
        0; 1 if the plan made again in flight lands fewer than `DEMANDED` within all limits.
    """
    options = _parser().parse_args(arguments)
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, _WIDTH)
    landing = Landing()
    leg = landing.plan.phase()
    burnt = START["mass"] - float(leg.x(leg.final_time)[6])
    console.print(
        f"planned with {PLANNED[0]:.0%} to {PLANNED[1]:.0%} of the engines: {leg.final_time:.3f} s, {burnt:.2f} kg of "
        f"propellant; seed {options.seed}"
    )
    campaigns: dict[str, Campaign] = {}
    for name in CONTROLLERS:
        campaigns[name] = landing.campaign(name, options.runs, options.seed, progress=console.is_terminal)
    console.print(table(campaigns))
    told = ", ".join(f"{name} {limit:g} {_UNITS[name]}" for name, limit in LIMITS.items())
    console.print(f"limits: {told}")
    if options.json is not None:
        summary = {name: campaign_dict(campaign) for name, campaign in campaigns.items()}
        options.json.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    rate = campaigns["planned again"].pass_rate().rate
    if rate < DEMANDED:
        console.print(f"the plan made again lands {rate:.1%} within all limits; {DEMANDED:.0%} are demanded.")
    return int(rate < DEMANDED)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m problems.rocket_landing",
        description="A rocket lands in wind: as planned, with the plan made again in flight, and by ZEM/ZEV.",
    )
    parser.add_argument("--runs", type=int, default=1000, help="per law, default 1000")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the statistics to a file")
    return parser
