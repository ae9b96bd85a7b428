"""Schedules: what a tracking law knows beforehand, with names and units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.control.reference import Reference
from gnc_opt.model.layout import Array, Layout, Variable


def reference_signals(reference: Reference, *more: Variable) -> Layout:
    """Return the layout of a schedule: ``<state>_ref``, ``<control>_ff`` (the feedforward), then ``more``."""
    states = [replace(v, name=f"{v.name}_ref", nominal=None) for v in reference.states.variables]
    controls = [replace(v, name=f"{v.name}_ff", nominal=None) for v in reference.controls.variables]
    return Layout("signal", (*states, *controls, *more), "the schedule")


@dataclass(frozen=True, eq=False)
class ReferenceSchedule:
    """Rows of `reference_signals`: states at the beginning of a step, mean controls over it.

    Called with times (n,) and a step (s) it returns (n_states + n_controls, n).
    """

    reference: Reference

    def __call__(self, times: Array, dt: float) -> Array:
        return np.vstack([self.reference.x(times), self.reference.mean_control(times, dt)])


def feedforward_reserve(reference: Reference, lower: Array, upper: Array, samples: int = 400) -> Array:
    """Return the least distance of the reference's controls to their limits, (n_controls,); < 0 is beyond them."""
    times = reference_times(reference, samples)
    u = reference.u(times)
    if reference.tail_control is not None:
        u = np.hstack([u, reference.tail_control[:, None]])
    return np.asarray(np.minimum(upper[:, None] - u, u - lower[:, None]).min(axis=1))


def reference_times(reference: Reference, samples: int, also: Sequence[float] = ()) -> Array:
    """Return times over the reference, with both sides of its jumps."""
    start, end = reference.initial_time, reference.final_time
    if end <= start:
        return np.array([start])
    edge = 1e-9 * (end - start)
    jumps = np.concatenate([reference.jumps, np.asarray(also, dtype=float)])
    times = np.concatenate([np.linspace(start, end, samples), jumps, jumps - edge, jumps + edge])
    return np.unique(np.clip(times, start, end))
