"""A few of the runs that a system's page tells of, held against what it says of all of them."""

from __future__ import annotations

import json

import numpy as np

from gnc_opt.simulation import Campaign
from problems.all import PAGES
from problems.dispersed import Rivals, dispersed_rows


def few_runs(system: str, rivals: Rivals, runs: int = 12) -> dict[str, Campaign]:
    """Fly the first runs of a page; its medians have to lie among them, and none is beyond its largest."""
    told = json.loads((PAGES / f"{system}.json").read_text(encoding="utf-8"))
    known = {row["quantity"].partition(" runs, ")[2]: row["ours"] for row in told["rows"]}
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
