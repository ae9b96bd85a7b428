"""Mission: what every worker of a campaign needs to fly any of its runs.

A batch is a range of run numbers. Whoever flies it gets the same flight and draws everything from the seed and the
number of each run, so that it makes no difference who flies what.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.errors import in_words
from gnc_opt.simulation.dispersion import Dispersions, dispersed
from gnc_opt.simulation.ending import Ending
from gnc_opt.simulation.flight import Flight
from gnc_opt.workers import Done, WorkerDied

MOST_PER_BATCH = 100
"""Runs in a batch at most: what Ctrl-C can lose per process, and a step of the progress bar."""

BATCHES = 32
"""Number of batches aimed at, enough to occupy all processes evenly."""

Batch: TypeAlias = range


@dataclass(frozen=True, eq=False)
class Mission:
    """The flight, and how runs differ."""

    flight: Flight
    dispersions: Dispersions
    seed: int

    def parameters(self, batch: Batch) -> Array:
        """Return the columns P (n_parameters, n) of runs."""
        flight = self.flight
        columns = [
            dispersed(self.dispersions, flight.layout, flight.nominal, self.seed, index) for index in batch
        ]
        return np.stack(columns, axis=1)

    def fly(self, batch: Batch) -> list[Flown]:
        """Fly a batch of runs; those that raise an exception are set apart from the others."""
        try:
            P = self.parameters(batch)
            return [Flown(batch, P, self.flight.final(P, [[self.seed, index] for index in batch]))]
        except Exception as error:  # whatever a dispersion or a solver in the loop does, no run is lost
            if len(batch) == 1:
                return [Flown(batch, None, None, in_words(error))]
            return [flown for half in halves(batch) for flown in self.fly(half)]


@dataclass(frozen=True, eq=False)
class Flown:
    """A batch of runs with their parameters and endings, or with what prevented them.

    Attributes
    ----------
    parameters : array (n_parameters, n) or None
    ending : Ending or None
    mishap : str
        Why there is no ending.
    died : bool
        Whether the process that was to fly it died.
    """

    batch: Batch
    parameters: Array | None
    ending: Ending | None
    mishap: str = ""
    died: bool = False


def batches(runs: int, flown: Iterable[Batch] = (), most: int = MOST_PER_BATCH) -> list[Batch]:
    """Return runs 0 to ``runs`` - 1 without those already flown, cut into batches."""
    size = min(most, max(1, runs // BATCHES))
    ends = sorted((batch.start, batch.stop) for batch in flown)
    gaps = zip([0, *(stop for _, stop in ends)], [*(start for start, _ in ends), runs], strict=True)
    return [
        range(first, min(first + size, stop)) for start, stop in gaps for first in range(start, stop, size)
    ]


def halves(batch: Batch) -> tuple[Batch, ...]:
    """Return the two halves of a batch; none of a single run."""
    if len(batch) == 1:
        return ()
    middle = batch.start + len(batch) // 2
    return range(batch.start, middle), range(middle, batch.stop)


def flown_parts(done: Done[Batch, list[Flown]]) -> list[Flown]:
    """Return what became of a batch, also of one that nobody could fly."""
    if done.answer is not None:
        return done.answer
    assert done.error is not None
    died = isinstance(done.error, WorkerDied)
    why = str(done.error) if died else in_words(done.error)
    return [Flown(done.item, None, None, why, died)]
