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
from gnc_opt.simulation import Campaign, consistency
from problems.attitude_control.board import LAWS, estimator
from problems.attitude_control.flown import LIMITS, campaign
from problems.attitude_control.model import slew

DEMANDED = 0.99
"""Share of the runs in which the regulator along the slew has to meet all limits."""
WITHOUT = "least energy, no bias estimated"

MEASURES = {
    "max(pointing)": ("off target (deg)", float(np.degrees(1.0))),
    "max(rate)": ("fastest (deg/s)", float(np.degrees(1.0))),
    "max(torque)": ("torque (N m)", 1.0),
    "max(speed)": ("speed (rpm)", 1.0),
    "energy(T)": ("sum T^2 (N^2 m^2 s)", 1.0),
}
"""Of a campaign: what is printed, and the factor to its unit."""

_WIDTH = 130


def table(campaigns: Mapping[str, Campaign]) -> Table:
    """Return what became of the runs, law by law: median and largest value of every measure."""
    found = Table(
        title="Slews from sensors to motors (median, largest)",
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
    )
    found.add_column("law", no_wrap=True)
    for heading, _ in MEASURES.values():
        found.add_column(heading, justify="right")
    found.add_column("passed", justify="right")
    for name, flown in campaigns.items():
        cells = [
            f"{factor * flown.percentile(measure, 0.5).value:.4g}, {factor * flown.maximum(measure):.4g}"
            for measure, (_, factor) in MEASURES.items()
        ]
        rate = flown.pass_rate()
        found.add_row(name, *cells, f"{rate.rate:.1%} ({rate.low:.2%} to {rate.high:.2%})")
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Plan, fly and judge; see ``python -m problems.attitude_control --help``.

    Returns
    -------
    int
        0; 1 if the regulator along the slew meets all limits in fewer than `DEMANDED` of its runs, or if any law ever
        asks too much of a wheel.
    """
    options = _parser().parse_args(arguments)
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, _WIDTH)
    console.print(f"slew of least energy: {slew().objective:.6f} N^2 m^2 s; seed {options.seed}")
    campaigns = {
        name: campaign(name, options.runs, options.seed, progress=console.is_terminal) for name in LAWS
    }
    campaigns[WITHOUT] = campaign(
        LAWS[0], options.runs, options.seed, bias=False, progress=console.is_terminal
    )
    console.print(table(campaigns))
    told = ", ".join(f"{MEASURES[name][0]} {MEASURES[name][1] * limit:g}" for name, limit in LIMITS.items())
    console.print(f"limits: {told}")
    console.print(str(consistency(campaigns[LAWS[0]], estimator())))
    if options.json is not None:
        summary = {name: campaign_dict(flown) for name, flown in campaigns.items()}
        options.json.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return int(bool(_failures(campaigns, console)))


def _failures(campaigns: Mapping[str, Campaign], console: Console) -> list[str]:
    """Return what is not as demanded, printed, too."""
    rate = campaigns[LAWS[0]].pass_rate().rate
    found = []
    if rate < DEMANDED:
        found.append(
            f"the regulator meets all limits in {rate:.1%} of its runs; {DEMANDED:.0%} are demanded."
        )
    for name, flown in campaigns.items():
        for measure in ("max(torque)", "max(speed)"):
            if not np.all(flown.measure(measure) <= LIMITS[measure]):
                found.append(
                    f"{name}: {measure} is {flown.maximum(measure):g}, {LIMITS[measure]:g} is the limit."
                )
    for line in found:
        console.print(line)
    return found


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m problems.attitude_control",
        description="Slews with four wheels by star tracker, gyro and tachometers: a plan and two published laws.",
    )
    parser.add_argument("--runs", type=int, default=1000, help="per law, default 1000")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the statistics to a file")
    return parser
