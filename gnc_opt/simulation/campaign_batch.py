"""Batches of a campaign: the task of a worker, files in which a campaign resumes, and their assembly.

A batch is a range of run numbers; results depend on the seed and the number of a run alone. A checkpoint is a
folder with one `Campaign` file per batch, identified by the compiled loop, the seed and one run drawn again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.errors import GncOptError, format_error
from gnc_opt.simulation.campaign import Campaign
from gnc_opt.simulation.compiled_loop import CompiledLoop
from gnc_opt.simulation.dispersions import Dispersions, draw_parameters
from gnc_opt.simulation.final_values import FinalValues
from gnc_opt.simulation.quantities import select_sample_steps
from gnc_opt.simulation.run_outcome import Outcome, RunStatus
from gnc_opt.workers import Done, WorkerDied

MOST_PER_BATCH = 25
"""Runs in a batch at most: what a process can lose when the campaign is killed."""

BATCHES = 32
"""Number of batches aimed at, enough to occupy all processes evenly."""

_PATTERN = "runs * to *.npz"

_STORED = (
    *("states", "memory", "effort", "energy", "saturation_time", "variation", "integration_error"),
    *("event_counts", "event_times", "replans", "sums", "samples"),
)
"""Arrays of a campaign with one column for each run, as of its final values."""


def load_stored_runs(folder: Path, mission: CampaignTask, runs: int) -> list[Flown]:
    """Return the runs below number ``runs`` that are in the folder, which is made if missing.

    Raises
    ------
    GncOptError
        The folder is of another campaign, or a file in it is damaged.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for path in sorted(folder.glob(_PATTERN)):
        part = _load_batch(path)
        _require_same_plan(part, mission, path)
        count = int(np.sum(part.indices < runs))
        if count:
            found.append(_find_first_runs(part, count))
    return found


def store_runs(folder: Path, part: Campaign) -> None:
    """Write runs with consecutive numbers."""
    part.save(folder / f"runs {part.indices[0]:08d} to {part.indices[-1]:08d}.npz")


def _load_batch(path: Path) -> Campaign:
    try:
        return Campaign.load(path)
    except GncOptError as error:
        raise GncOptError(
            f"the checkpoint cannot be read: {str(error).partition(';')[0].rstrip('.')}. Delete this file: the same "
            "call then flies its runs again."
        ) from error


def _require_same_plan(part: Campaign, mission: CampaignTask, path: Path) -> None:
    first = int(part.indices[0])
    why = ""
    if part.fingerprint != mission.flight.fingerprint:
        why = "another loop or span"
    elif part.seed != mission.seed:
        why = f"the seed {part.seed}, not {mission.seed}"
    elif not np.array_equal(
        part.parameters[:, 0], mission.parameters(range(first, first + 1))[:, 0], equal_nan=True
    ):
        why = "other dispersions, initial states or parameters"
    if why:
        raise GncOptError(f"the checkpoint '{path}' is of a campaign with {why}: give another folder.")


def _find_first_runs(part: Campaign, count: int) -> Flown:
    first = int(part.indices[0])
    ending = FinalValues(
        errors=None,
        state_error=np.full(count, np.nan),
        outcomes=part.outcomes[:count],
        **{name: getattr(part, name)[..., :count] for name in _STORED},
    )
    return Flown(range(first, first + count), part.parameters[:, :count], ending)


def merge_batches(
    flight: CompiledLoop, flown: Sequence[Flown], *, seed: int, asked: int, goal: Array
) -> Campaign:
    """Return the campaign of these batches of runs; ``goal`` (n_states,) is what ends are compared with."""

    def join_values(attribute: str, size: int) -> Array:
        parts = [
            np.full((size, len(p.batch)), np.nan)
            if p.ending is None
            else np.asarray(getattr(p.ending, attribute)).reshape(size, len(p.batch))
            for p in flown
        ]
        return np.hstack([np.empty((size, 0)), *parts])

    states = join_values("states", flight.states.size)
    outcomes: list[Outcome] = []
    for part in flown:
        lost = [Outcome(RunStatus.LOST, part.mishap)] * len(part.batch)
        outcomes += lost if part.ending is None else part.ending.outcomes
    errors = np.full((flight.error_layout.size, states.shape[1]), np.nan)
    if states.shape[1]:
        errors = np.asarray(flight.errors(states, np.repeat(goal[:, None], states.shape[1], axis=1)).full())
    sizes = {
        **dict.fromkeys(("effort", "energy"), flight.controls.size),
        **dict.fromkeys(("saturation_time", "variation"), flight.commands.size),
        **dict.fromkeys(("event_counts", "event_times"), flight.events.size),
        "memory": flight.memory.size,
        "replans": 2,
    }
    way = {}
    if flight.quantities.size:
        count, at = flight.quantities.size, select_sample_steps(flight.n_steps)
        samples = join_values("samples", count * at.size).reshape(count, at.size, -1)
        way = {"sums": join_values("sums", 3 * count), "samples": samples, "sample_times": flight.times[at]}
    drawn = [p.parameters for p in flown if p.parameters is not None]
    return Campaign(
        seed=seed,
        asked=asked,
        indices=np.array([i for part in flown for i in part.batch], dtype=np.int64),
        parameters=np.hstack([np.empty((flight.layout.size, 0)), *drawn]),
        states=states,
        errors=errors,
        target=goal,
        integration_error=join_values("integration_error", 1)[0],
        outcomes=tuple(outcomes),
        span=(float(flight.times[0]), float(flight.times[-1])),
        limits={},
        measured={},
        interrupted=False,
        layouts=flight.layouts,
        flight=flight,
        fingerprint=flight.fingerprint,
        **{name: join_values(name, size) for name, size in sizes.items()},
        **way,
    )


Batch: TypeAlias = range


@dataclass(frozen=True, eq=False)
class CampaignTask:
    """The flight, and how runs differ."""

    flight: CompiledLoop
    dispersions: Dispersions
    seed: int

    def parameters(self, batch: Batch) -> Array:
        """Return the columns P (n_parameters, n) of runs."""
        flight = self.flight
        columns = [
            draw_parameters(self.dispersions, flight.layout, flight.nominal, self.seed, index)
            for index in batch
        ]
        return np.stack(columns, axis=1)

    def simulate_runs(self, batch: Batch) -> list[Flown]:
        """Fly a batch of runs; those that raise an exception are set apart from the others."""
        try:
            P = self.parameters(batch)
            return [Flown(batch, P, self.flight.final(P, [[self.seed, index] for index in batch]))]
        except Exception as error:  # whatever a dispersion or a solver in the loop does, no run is lost
            if len(batch) == 1:
                return [Flown(batch, None, None, format_error(error))]
            return [flown for half in split_batch(batch) for flown in self.simulate_runs(half)]


@dataclass(frozen=True, eq=False)
class Flown:
    """A batch of runs with their parameters (n_parameters, n) and endings, or with the mishap that prevented them."""

    batch: Batch
    parameters: Array | None
    ending: FinalValues | None
    mishap: str = ""
    died: bool = False


def find_remaining_batches(runs: int, flown: Iterable[Batch] = ()) -> list[Batch]:
    """Return runs 0 to ``runs`` - 1 without those already flown, cut into batches."""
    size = min(MOST_PER_BATCH, max(1, runs // BATCHES))
    ends = sorted((batch.start, batch.stop) for batch in flown)
    gaps = zip([0, *(stop for _, stop in ends)], [*(start for start, _ in ends), runs], strict=True)
    return [
        range(first, min(first + size, stop)) for start, stop in gaps for first in range(start, stop, size)
    ]


def split_batch(batch: Batch) -> tuple[Batch, ...]:
    """Return the two halves of a batch; none of a single run."""
    if len(batch) == 1:
        return ()
    middle = batch.start + len(batch) // 2
    return range(batch.start, middle), range(middle, batch.stop)


def batch_results(done: Done[Batch, list[Flown]]) -> list[Flown]:
    """Return the results of a batch, also of one that could not be simulated."""
    if done.answer is not None:
        return done.answer
    assert done.error is not None
    died = isinstance(done.error, WorkerDied)
    why = str(done.error) if died else format_error(done.error)
    return [Flown(done.item, None, None, why, died)]
