"""Gathering: batches of runs as one campaign."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.simulation.campaign import Campaign
from gnc_opt.simulation.flight import Flight
from gnc_opt.simulation.mission import Flown
from gnc_opt.simulation.outcome import Outcome, RunStatus
from gnc_opt.simulation.quantity import sample_steps


def gathered(flight: Flight, flown: Sequence[Flown], *, seed: int, asked: int, goal: Array) -> Campaign:
    """Return the campaign of these batches of runs; ``goal`` (n_states,) is what ends are compared with."""

    def joined(attribute: str, size: int) -> Array:
        parts = [
            np.full((size, len(p.batch)), np.nan)
            if p.ending is None
            else np.asarray(getattr(p.ending, attribute)).reshape(size, len(p.batch))
            for p in flown
        ]
        return np.hstack([np.empty((size, 0)), *parts])

    states = joined("states", flight.states.size)
    outcomes: list[Outcome] = []
    for part in flown:
        lost = [Outcome(RunStatus.LOST, part.mishap)] * len(part.batch)
        outcomes += lost if part.ending is None else part.ending.outcomes
    errors = np.full((flight.error_layout.size, states.shape[1]), np.nan)
    if states.shape[1]:
        errors = np.asarray(flight.errors(states, np.repeat(goal[:, None], states.shape[1], axis=1)).full())
    way = {}
    if flight.quantities is not None:
        count, at = len(flight.quantities), sample_steps(flight.n_steps)
        samples = joined("samples", count * at.size).reshape(count, at.size, -1)
        way = {"sums": joined("sums", 3 * count), "samples": samples, "sample_times": flight.times[at]}
    drawn = [p.parameters for p in flown if p.parameters is not None]
    return Campaign(
        seed=seed,
        asked=asked,
        indices=np.array([i for part in flown for i in part.batch], dtype=np.int64),
        parameters=np.hstack([np.empty((flight.layout.size, 0)), *drawn]),
        states=states,
        errors=errors,
        target=goal,
        effort=joined("effort", flight.controls.size),
        energy=joined("energy", flight.controls.size),
        saturation_time=joined("saturation_time", flight.commands.size),
        variation=joined("variation", flight.commands.size),
        integration_error=joined("integration_error", 1)[0],
        outcomes=tuple(outcomes),
        span=(float(flight.times[0]), float(flight.times[-1])),
        limits={},
        measured={},
        interrupted=False,
        layouts={
            "parameter": flight.layout,
            "state": flight.states,
            "error": flight.error_layout,
            "applied": flight.controls,
            "command": flight.commands,
            "memory": flight.memory,
            "event": flight.events,
            **({} if flight.quantities is None else {"quantity": flight.quantities.layout}),
        },
        flight=flight,
        fingerprint=flight.fingerprint,
        memory=joined("memory", flight.memory.size),
        event_counts=joined("event_counts", flight.events.size),
        event_times=joined("event_times", flight.events.size),
        replans=joined("replans", 2),
        **way,
    )
