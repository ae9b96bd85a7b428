"""Batches of a Monte Carlo campaign: worker task, checkpoint files and assembly of the results.

A batch is a range of run indices; the results depend on the seed and the index of a run only. A checkpoint is a folder
with one `Campaign` file per batch. It is identified by the compiled loop, the seed and one run that is drawn again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.errors import GncOptError, format_exception
from gnc_opt.simulation.campaign_results import Campaign
from gnc_opt.simulation.compiled_closed_loop import CompiledLoop
from gnc_opt.simulation.dispersions import Dispersions, draw_dispersed_parameters
from gnc_opt.simulation.final_states_and_integration_error import FinalValues
from gnc_opt.simulation.recorded_extremes_and_integrals import select_quantity_sample_steps
from gnc_opt.simulation.simulation_run_outcome import Outcome, RunStatus
from gnc_opt.workers import TaskResult, WorkerDiedError

BATCH_MAX_RUNS = 25
"""Largest number of runs in a batch, which are lost if the process is killed."""

N_BATCHES = 32
"""Target number of batches; enough for an even load of all processes."""

_PATTERN = "runs * to *.npz"

_STORED = (
    *("states", "memory", "effort", "energy", "saturation_time", "variation", "integration_error"),
    *("event_counts", "event_times", "replans", "sums", "samples"),
)
"""Arrays of a campaign with one column per run, named as in `FinalValues`."""


def load_stored_runs(folder: Path, mission: CampaignTask, runs: int) -> list[RunBatch]:
    """Return the stored runs with index below ``runs``; creates the folder if it is missing.

    Raises
    ------
    GncOptError
        The folder belongs to another campaign, or one of its files is damaged.
    """
    folder.mkdir(parents=True, exist_ok=True)
    stored = []
    for path in sorted(folder.glob(_PATTERN)):
        part = _load_run_batch_file(path)
        _require_checkpoint_of_same_campaign(part, mission, path)
        count = int(np.sum(part.indices < runs))
        if count:
            stored.append(_keep_first_runs_of_batch(part, count))
    return stored


def store_run_batch_file(folder: Path, part: Campaign) -> None:
    """Write runs with consecutive indices."""
    part.save(folder / f"runs {part.indices[0]:08d} to {part.indices[-1]:08d}.npz")


def _load_run_batch_file(path: Path) -> Campaign:
    try:
        return Campaign.load(path)
    except GncOptError as error:
        raise GncOptError(
            f"the checkpoint cannot be read: {str(error).partition(';')[0].rstrip('.')}. Delete this file: the same "
            "call then simulates its runs again."
        ) from error


def _require_checkpoint_of_same_campaign(part: Campaign, mission: CampaignTask, path: Path) -> None:
    first = int(part.indices[0])
    why = ""
    if part.fingerprint != mission.compiled_loop.fingerprint:
        why = "another loop or span"
    elif part.seed != mission.seed:
        why = f"the seed {part.seed}, not {mission.seed}"
    elif not np.array_equal(
        part.parameters[:, 0],
        mission.draw_dispersed_parameters(range(first, first + 1))[:, 0],
        equal_nan=True,
    ):
        why = "other dispersions, initial states or parameters"
    if why:
        raise GncOptError(f"the checkpoint '{path}' is of a campaign with {why}: give another folder.")


def _keep_first_runs_of_batch(part: Campaign, count: int) -> RunBatch:
    first = int(part.indices[0])
    ending = FinalValues(
        errors=None,
        state_error=np.full(count, np.nan),
        outcomes=part.outcomes[:count],
        **{name: getattr(part, name)[..., :count] for name in _STORED},
    )
    return RunBatch(range(first, first + count), part.parameters[:, :count], ending)


def merge_run_batches(
    loop: CompiledLoop, batches: Sequence[RunBatch], *, seed: int, n_runs: int, goal: Array
) -> Campaign:
    """Return the campaign of these batches; ``goal`` (n_states,) are the target states."""

    def concatenate_run_batch_arrays(attribute: str, size: int) -> Array:
        parts = [
            np.full((size, len(p.batch)), np.nan)
            if p.ending is None
            else np.asarray(getattr(p.ending, attribute)).reshape(size, len(p.batch))
            for p in batches
        ]
        return np.hstack([np.empty((size, 0)), *parts])

    states = concatenate_run_batch_arrays("states", loop.states.size)
    outcomes: list[Outcome] = []
    for part in batches:
        lost_outcomes = [Outcome(RunStatus.LOST, part.mishap)] * len(part.batch)
        outcomes += lost_outcomes if part.ending is None else part.ending.outcomes
    errors = np.full((loop.error_layout.size, states.shape[1]), np.nan)
    if states.shape[1]:
        errors = np.asarray(loop.errors(states, np.repeat(goal[:, None], states.shape[1], axis=1)).full())
    sizes = {
        **dict.fromkeys(("effort", "energy"), loop.controls.size),
        **dict.fromkeys(("saturation_time", "variation"), loop.commands.size),
        **dict.fromkeys(("event_counts", "event_times"), loop.events.size),
        "memory": loop.memory.size,
        "replans": 2,
    }
    arrays: dict[str, Any] = {name: concatenate_run_batch_arrays(name, size) for name, size in sizes.items()}
    if loop.quantities.size:
        count, steps = loop.quantities.size, select_quantity_sample_steps(loop.n_steps)
        samples = concatenate_run_batch_arrays("samples", count * steps.size).reshape(count, steps.size, -1)
        arrays |= {
            "sums": concatenate_run_batch_arrays("sums", 3 * count),
            "samples": samples,
            "sample_times": loop.times[steps],
        }
    drawn = [p.parameters for p in batches if p.parameters is not None]
    return Campaign(
        seed=seed,
        asked=n_runs,
        indices=np.array([i for part in batches for i in part.batch], dtype=np.int64),
        parameters=np.hstack([np.empty((loop.layout.size, 0)), *drawn]),
        states=states,
        errors=errors,
        target=goal,
        integration_error=concatenate_run_batch_arrays("integration_error", 1)[0],
        outcomes=tuple(outcomes),
        span=(float(loop.times[0]), float(loop.times[-1])),
        limits={},
        measured={},
        interrupted=False,
        layouts=loop.layouts,
        compiled_loop=loop,
        fingerprint=loop.fingerprint,
        **arrays,
    )


Batch: TypeAlias = range


@dataclass(frozen=True, eq=False)
class CampaignTask:
    """Compiled loop and dispersions of a campaign."""

    compiled_loop: CompiledLoop
    dispersions: Dispersions
    seed: int

    def draw_dispersed_parameters(self, batch: Batch) -> Array:
        """Return the parameter columns P (n_parameters, n) of runs."""
        loop = self.compiled_loop
        columns = [
            draw_dispersed_parameters(self.dispersions, loop.layout, loop.nominal, self.seed, index)
            for index in batch
        ]
        return np.stack(columns, axis=1)

    def simulate_runs(self, batch: Batch) -> list[RunBatch]:
        """Simulate a batch of runs; runs that raise an exception are returned separately."""
        try:
            P = self.draw_dispersed_parameters(batch)
            return [
                RunBatch(
                    batch, P, self.compiled_loop.final_values(P, [[self.seed, index] for index in batch])
                )
            ]
        except Exception as error:  # a failing dispersion or solver must not lose other runs
            if len(batch) == 1:
                return [RunBatch(batch, None, None, format_exception(error))]
            return [run_batch for half in halve_run_batch(batch) for run_batch in self.simulate_runs(half)]


@dataclass(frozen=True, eq=False)
class RunBatch:
    """Batch of runs with parameters (n_parameters, n) and final values, or the error that prevented the simulation."""

    batch: Batch
    parameters: Array | None
    ending: FinalValues | None
    mishap: str = ""
    died: bool = False


def find_unsimulated_batches(runs: int, simulated: Iterable[Batch]) -> list[Batch]:
    """Return batches of the runs 0 to ``runs`` - 1 that have not been simulated."""
    size = min(BATCH_MAX_RUNS, max(1, runs // N_BATCHES))
    ends = sorted((batch.start, batch.stop) for batch in simulated)
    gaps = zip([0, *(stop for _, stop in ends)], [*(start for start, _ in ends), runs], strict=True)
    return [
        range(first, min(first + size, stop)) for start, stop in gaps for first in range(start, stop, size)
    ]


def halve_run_batch(batch: Batch) -> tuple[Batch, ...]:
    """Return the two halves of a batch; empty for a single run."""
    if len(batch) == 1:
        return ()
    middle = batch.start + len(batch) // 2
    return range(batch.start, middle), range(middle, batch.stop)


def get_run_batch_results(done: TaskResult[Batch, list[RunBatch]]) -> list[RunBatch]:
    """Return the results of a finished batch, or of one that could not be simulated."""
    if done.answer is not None:
        return done.answer
    assert done.error is not None
    died = isinstance(done.error, WorkerDiedError)
    why = str(done.error) if died else format_exception(done.error)
    return [RunBatch(done.item, None, None, why, died)]
