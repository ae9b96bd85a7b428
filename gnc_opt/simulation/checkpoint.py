"""Checkpoint: the runs of a campaign that have ended, in a folder, one file per batch.

Every file is a small `Campaign` that is there as a whole or not at all, whenever the process is killed. Whoever resumes
flies the runs that are in no file; that a folder is of the same campaign is seen from the flight, the seed, and a run
of each file, whose parameters are drawn again.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gnc_opt.errors import GncOptError
from gnc_opt.simulation.campaign import Campaign
from gnc_opt.simulation.ending import Ending
from gnc_opt.simulation.mission import Flown, Mission

MOST_PER_FILE = 25
"""Runs in a batch at most: what a process has in flight when the campaign is killed."""

_PATTERN = "runs * to *.npz"


def stored(folder: Path, mission: Mission, runs: int) -> list[Flown]:
    """Return the runs below number ``runs`` that are in the folder; it is made if it is not there.

    Raises
    ------
    GncOptError
        The folder is of another campaign, or a file in it is damaged.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for path in sorted(folder.glob(_PATTERN)):
        part = _load(path)
        _require_same(part, mission, path)
        count = int(np.sum(part.indices < runs))
        if count:
            found.append(_flown(part, count))
    return found


def store(folder: Path, part: Campaign) -> None:
    """Write runs with consecutive numbers."""
    part.save(folder / f"runs {part.indices[0]:08d} to {part.indices[-1]:08d}.npz")


def _load(path: Path) -> Campaign:
    try:
        return Campaign.load(path)
    except GncOptError as error:
        raise GncOptError(
            f"the checkpoint cannot be read: {str(error).partition(';')[0].rstrip('.')}. Delete this file: the same "
            "call then flies its runs again."
        ) from error


def _require_same(part: Campaign, mission: Mission, path: Path) -> None:
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


def _flown(part: Campaign, count: int) -> Flown:
    first = int(part.indices[0])
    ending = Ending(
        states=part.states[:, :count],
        errors=None,
        memory=part.memory[:, :count],
        effort=part.effort[:, :count],
        energy=part.energy[:, :count],
        saturation_time=part.saturation_time[:, :count],
        variation=part.variation[:, :count],
        integration_error=part.integration_error[:count],
        averaging_error=np.full(count, np.nan),
        instant_error=np.full(count, np.nan),
        outcomes=part.outcomes[:count],
        event_counts=part.event_counts[:, :count],
        event_times=part.event_times[:, :count],
        replans=part.replans[:, :count],
        sums=part.sums[:, :count],
        samples=part.samples[:, :, :count],
    )
    return Flown(range(first, first + count), part.parameters[:, :count], ending)
