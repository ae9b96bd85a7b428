"""Plan and published law side by side over many dispersed runs: what they cost and how far they are off."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.simulation import Campaign, ClosedLoop, monte_carlo
from gnc_opt.simulation.dispersions import Dispersion
from problems.comparison import Row, remark, require

RUNS, SEED = 1000, 1
LEVELS = (0.5, 0.99)


@dataclass(frozen=True, eq=False)
class Rivals:
    """Loops that are flown with the same dispersions, the published law's last.

    Attributes
    ----------
    loops : mapping of str to (ClosedLoop, array (n_states,))
        With their first states, by name.
    duration : float
        s.
    dispersions : mapping
        As of `gnc_opt.monte_carlo`.
    target : mapping of str to array
        States at the end, by name.
    measures : mapping of str to tuple of str and float
        Measures of the campaign with what they are, unit included, and the factor to that unit.
    """

    loops: Mapping[str, tuple[ClosedLoop, Array]]
    duration: float
    dispersions: Mapping[str, Dispersion]
    target: Mapping[str, Array]
    measures: Mapping[str, tuple[str, float]]

    def fly(
        self, runs: int = RUNS, seed: int = SEED, executor: Executor | Literal["serial"] | None = None
    ) -> dict[str, Campaign]:
        """Fly all; the same seed gives all of them the same starts and plants."""
        return {
            name: monte_carlo(
                loop,
                runs,
                x0=start,
                tf=self.duration,
                seed=seed,
                dispersions=dict(self.dispersions),
                target=dict(self.target),
                executor=executor,
            )
            for name, (loop, start) in self.loops.items()
        }


def dispersed_rows(rivals: Rivals, campaigns: Mapping[str, Campaign]) -> list[Row]:
    """Return a row per measure and plan: median, 99 % point and largest of the plan, and of the published law."""
    *plans, law = campaigns
    rows = []
    for name in plans:
        for measure, (what, factor) in rivals.measures.items():
            spread = [_spread(campaigns[who], measure, factor) for who in (name, law)]
            quantity = f"{len(campaigns[name])} runs, {name}: {what}, 50 %, 99 %, largest; {law}"
            rows.append(remark(quantity, np.concatenate(spread)))
    failed = sum(len(campaign.failures) for campaign in campaigns.values())
    return [*rows, require("dispersed runs that failed", "none", failed, failed == 0)]


def _spread(campaign: Campaign, measure: str, factor: float) -> Array:
    levels = [campaign.percentile(measure, level).value for level in LEVELS]
    return factor * np.array([*levels, campaign.maximum(measure)])
