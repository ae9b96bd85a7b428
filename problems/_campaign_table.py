"""Campaigns of several controllers side by side: command line, table, statistics in a file."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rich import box
from rich.table import Table

from gnc_opt.simulation import Campaign
from gnc_opt.simulation.campaign_tables import build_campaign_summary_dict


def parser(prog: str, description: str) -> argparse.ArgumentParser:
    """Return what reads ``--runs``, ``--seed``, ``--json`` and ``--checkpoint``."""
    found = argparse.ArgumentParser(prog=prog, description=description)
    found.add_argument("--runs", type=int, default=1000, help="runs per controller, default 1000")
    found.add_argument("--seed", type=int, default=1, help="of the random numbers, default 1")
    found.add_argument("--json", type=Path, metavar="OUT", help="write the statistics to a file")
    found.add_argument(
        "--checkpoint",
        type=Path,
        metavar="DIR",
        help="keep finished runs there; they are not simulated again",
    )
    return found


def kept_in(folder: Path | None, name: str) -> Path | None:
    """Return where the finished runs of a controller are kept, if anywhere."""
    return None if folder is None else folder / name.replace(", ", "-").replace("/", "-").replace(" ", "_")


def table(
    title: str,
    campaigns: Mapping[str, Campaign],
    measures: Mapping[str, tuple[str, float]],
    counts: Mapping[str, Callable[[Campaign], float]] | None = None,
    levels: Sequence[float] = (0.5,),
) -> Table:
    """Return percentiles and the largest value of every measure, and how many runs passed, by controller.

    Parameters
    ----------
    title : str
    campaigns : mapping of str to Campaign
        By controller.
    measures : mapping of str to tuple of str and float
        What is printed of a measure, and the factor to its unit.
    counts : mapping of str to function, optional
        Numbers of a whole campaign, by their headings.
    levels : sequence of float
        Of the percentiles.
    """
    counts = counts or {}
    shown = ", ".join(f"{100 * level:g} %" for level in levels)
    found = Table(
        title=f"{title} (percentiles {shown}; largest value)",
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
    )
    found.add_column("controller", no_wrap=True)
    for heading in (*(heading for heading, _ in measures.values()), *counts, "passed"):
        found.add_column(heading, justify="right")
    for name, campaign in campaigns.items():
        cells = []
        for measure, (_, factor) in measures.items():
            values = [campaign.percentile(measure, level).value for level in levels]
            cells.append(", ".join(f"{factor * v:.4g}" for v in (*values, campaign.maximum(measure))))
        cells += [f"{count(campaign):.0f}" for count in counts.values()]
        rate = campaign.pass_rate()
        found.add_row(name, *cells, f"{rate.rate:.1%} ({rate.low:.2%} to {rate.high:.2%})")
    return found


def write(file: Path, campaigns: Mapping[str, Campaign]) -> None:
    """Write the statistics of campaigns to a file, as JSON by controller."""
    summary = {name: build_campaign_summary_dict(campaign) for name, campaign in campaigns.items()}
    file.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
