"""A few of the runs that a system's page tells of, held against what it says of all of them."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.simulation import Campaign, Run
from problems.all import PAGES
from problems.dispersed import Rivals, dispersed_rows


def few_runs(system: str, rivals: Rivals, runs: int = 8) -> dict[str, Campaign]:
    """Fly the first runs of a page; its medians have to lie among them, and none is beyond its largest."""
    printed = json.loads((PAGES / f"{system}.json").read_text(encoding="utf-8"))
    known = {row["quantity"].partition(" runs, ")[2]: row["ours"] for row in printed["rows"]}
    campaigns = rivals.fly(runs, executor="serial")
    *rows, failed = dispersed_rows(rivals, campaigns)
    assert failed.passes
    *plans, law = campaigns
    measures = [(plan, *measure) for plan in plans for measure in rivals.measures.items()]
    for row, (plan, measure, (_, factor)) in zip(rows, measures, strict=True):
        page = np.array(known[row.quantity.partition(" runs, ")[2]]).reshape(2, 3)
        for who, (median, _, largest) in zip((plan, law), page, strict=True):
            values = factor * campaigns[who].measure(measure)
            assert np.min(values) <= median <= np.max(values) <= largest * (1 + 1e-6)
    return campaigns


def flown_again(campaigns: dict[str, Campaign], runs: int = 3) -> list[Run]:
    """The first runs of each with all their steps, one campaign after the other: another program flies all at once."""
    return [campaign.rerun(i) for campaign in campaigns.values() for i in range(runs)]


def told(campaigns: dict[str, Campaign], value: Callable[[Campaign], Array], runs: int = 3) -> Array:
    """What the campaigns say of the same runs, in the same order."""
    return np.concatenate([value(campaign)[..., :runs] for campaign in campaigns.values()], axis=-1)
