"""Plans and a published controller on the same disturbed plant: one run of each, or many dispersed ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import astuple, dataclass
from typing import Literal

import numpy as np

from benchmarks.validation.published.comparison import Claim, Row, Value
from gnc_opt.arrays import Array
from gnc_opt.simulation import Campaign, ClosedLoop, monte_carlo
from gnc_opt.simulation.dispersions import Dispersion

RUNS, SEED = 1000, 1
LEVELS = (0.5, 0.99)


@dataclass(frozen=True)
class CompiledLoop:
    """Measures of a run in closed loop.

    Attributes
    ----------
    time : float
        Until it is settled, s; infinite if it never is.
    effort : float
        What it costs, in the system's unit.
    miss : float
        How far it is off when it is measured, in the system's unit.
    """

    time: float
    effort: float
    miss: float


def flight_values(
    what: str, measures: tuple[str, str, str], plan: CompiledLoop, law: CompiledLoop
) -> Iterator[Value]:
    """Yield, for each measure (its name and unit), that of a plan, of the published controller, and their ratio."""
    for measure, ours, theirs in zip(measures, astuple(plan), astuple(law), strict=True):
        ratio = ours / theirs if np.isfinite(theirs) and theirs else float("nan")
        yield Value(f"{what}, flown: {measure}; published law; ratio", (ours, theirs, ratio))


@dataclass(frozen=True, eq=False)
class Rivals:
    """Loops that are simulated with the same dispersions, the published controller's last.

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
        """Simulate all; the same seed gives all of them the same starts and plants."""
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


def dispersed_rows(rivals: Rivals, campaigns: Mapping[str, Campaign]) -> Iterator[Row]:
    """Yield a row per measure and plan: median, 99 % point and largest of the plan, and of the published controller."""
    *plans, law = campaigns
    for name in plans:
        for measure, (what, factor) in rivals.measures.items():
            spread = [_spread(campaigns[who], measure, factor) for who in (name, law)]
            quantity = f"{len(campaigns[name])} runs, {name}: {what}, 50 %, 99 %, largest; {law}"
            yield Row(quantity, tuple(np.concatenate(spread)))
    failed = sum(len(campaign.failures) for campaign in campaigns.values())
    yield Row("dispersed runs that failed", (float(failed),), None, Claim("none", failed == 0))


def _spread(campaign: Campaign, measure: str, factor: float) -> Array:
    levels = [campaign.percentile(measure, level).value for level in LEVELS]
    return factor * np.array([*levels, campaign.maximum(measure)])
