"""Experiment: runs of a loop with chosen random numbers, and what is measured of them.

All that a run draws is made of standard normal numbers: first those of the dispersions, one name after the other, then
those of the control steps. Whoever knows them can fly the run again, change some of them, or look for bad ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gnc_opt.arguments import expect
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.simulation.campaign import Campaign
from gnc_opt.simulation.criteria import Criteria, Judge
from gnc_opt.simulation.dispersion import Dispersion, Dispersions, check_dispersions
from gnc_opt.simulation.flight import Flight
from gnc_opt.simulation.gathering import gathered
from gnc_opt.simulation.loop import ClosedLoop
from gnc_opt.simulation.mission import Flown
from gnc_opt.simulation.outcome import RunStatus

_FLOWN = (RunStatus.OK, RunStatus.INACCURATE)
"""How runs end that have not failed."""

_LEAST = 1e-300
"""Of uniform numbers whose normal quantile is taken."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """A flight, how its runs differ, and what is measured of them.

    Attributes
    ----------
    flight : Flight
    dispersions : mapping
        By dotted name.
    criteria : Criteria
    """

    flight: Flight
    dispersions: Dispersions
    criteria: Criteria

    @classmethod
    def of(
        cls,
        caller: str,
        loop: ClosedLoop,
        mission: Mapping[str, Any],
        dispersions: Dispersions | None,
        target: Mapping[str, ArrayLike] | None,
        judge: Mapping[str, Judge] | None,
        measures: Sequence[str],
    ) -> Experiment:
        """Read what analyses are given; ``mission`` are the arguments of `ClosedLoop.flight`."""
        expect(loop, ClosedLoop, f"what {caller} flies", "give a ClosedLoop")
        flight = loop.flight(**mission)
        check_dispersions({} if dispersions is None else dispersions, flight.layout, flight.nominal)
        experiment = cls(flight, dict(dispersions or {}), Criteria(target or {}, {}, judge or {}))
        empty = experiment.campaign(np.empty((flight.layout.size, 0)), [])
        for name in measures:
            if name not in experiment.criteria.judge:
                empty.measure(name)  # refuses what is none
        return experiment

    # --- numbers ------------------------------------------------------------------------------------------

    @cached_property
    def counts(self) -> dict[str, int]:
        """How many numbers each dispersion takes."""
        return {name: self._count(name, dispersion) for name, dispersion in self.dispersions.items()}

    @property
    def size(self) -> int:
        """Number of numbers that the dispersions take."""
        return sum(self.counts.values())

    @property
    def noise_size(self) -> int:
        """Number of numbers of a control step."""
        return int(self.flight.kernel.known.size - 1 - self.flight.schedule.shape[0])

    def parameters(self, z: Array) -> Array:
        """Return the columns P (n_parameters, n) of standard normal numbers (size, n)."""
        columns = []
        for numbers in z.T:
            P, at = self.flight.nominal.copy(), 0
            for name, dispersion in self.dispersions.items():
                place, count = self.flight.layout.slice(name), self.counts[name]
                generator = GivenNumbers(numbers[at : at + count])
                P[place] = dispersion.draw(generator, self.flight.nominal[place])  # type: ignore[arg-type]
                at += count
            columns.append(P)
        return np.reshape(columns, (z.shape[1], self.flight.layout.size)).T

    def _count(self, name: str, dispersion: Dispersion) -> int:
        counter = GivenNumbers(None)
        try:
            dispersion.draw(counter, self.flight.nominal[self.flight.layout.slice(name)])  # type: ignore[arg-type]
        except AttributeError as error:
            raise ArgumentError(
                f"the dispersion of '{name}' draws otherwise than by standard_normal(), random() and integers(): use "
                "these."
            ) from error
        return counter.taken

    # --- runs ---------------------------------------------------------------------------------------------

    def campaign(self, P: Array, seeds: Sequence[Any]) -> Campaign:
        """Fly runs with these columns P (n_parameters, n) and seeds, or numbers, and return them as a campaign."""
        runs = range(P.shape[1])
        flown = [Flown(runs, P, self.flight.final(P, seeds))] if runs else []
        goal = self.criteria.goal(self.flight)
        campaign = gathered(self.flight, flown, seed=0, asked=len(runs), goal=goal)
        return self.criteria.applied(campaign) if runs else campaign

    def values(self, measure: str, P: Array, seeds: Sequence[Any]) -> Array:
        """Return a measure of runs, (n,), as `campaign`; infinite for those that fail or have none.

        Runs that are merely inaccurate count with what they measure.
        """
        campaign = self.campaign(P, seeds)
        flown = np.array([outcome.status in _FLOWN for outcome in campaign.outcomes], dtype=bool)
        values = campaign.measure(measure)
        return np.where(flown & ~np.isnan(values), values, np.inf)


class GivenNumbers:
    """Stands for a random generator, but draws from given standard normal numbers; without any, it counts.

    Parameters
    ----------
    numbers : array (n,) or None
    """

    def __init__(self, numbers: Array | None) -> None:
        self._numbers, self.taken = numbers, 0

    def standard_normal(self, size: int | None = None) -> Any:
        """Return the next numbers."""
        count = 1 if size is None else int(np.prod(size))
        first, self.taken = self.taken, self.taken + count
        # counting, any numbers will do that are no limit of anything
        found = np.full(count, 0.5) if self._numbers is None else self._numbers[first : self.taken]
        return float(found[0]) if size is None else found.reshape(size)

    def random(self, size: int | None = None) -> Any:
        """Return uniform numbers in [0, 1)."""
        return np.minimum(scipy.special.ndtr(self.standard_normal(size)), 1 - np.finfo(float).epsneg)

    def integers(self, high: int) -> int:
        """Return one of the integers from 0 to below ``high``."""
        return int(self.random() * high)


def normal_numbers(uniform: Array) -> Array:
    """Return the standard normal numbers at which uniform ones are the quantiles."""
    return np.asarray(scipy.special.ndtri(np.clip(uniform, _LEAST, 1 - np.finfo(float).epsneg)))
