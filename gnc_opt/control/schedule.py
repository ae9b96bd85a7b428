"""Schedules: what a tracking law knows beforehand, with names and units."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.control.controller import Schedule
from gnc_opt.control.reference import Reference
from gnc_opt.model.layout import Layout, Variable
from gnc_opt.tolerances import SAME_TIME

LOOKS = 101
"""Times over a reference, beside its jumps, at which a design looks at it where nothing else is said."""


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


@dataclass(frozen=True, eq=False)
class StackedSchedule:
    """Two schedules, one above the other."""

    upper: Schedule
    lower: Schedule

    def __call__(self, times: Array, dt: float) -> Array:
        return np.vstack([self.upper(times, dt), self.lower(times, dt)])


def reference_times(reference: Reference, samples: int = LOOKS) -> Array:
    """Return the times (s) at which a design looks at its reference: its ends and both sides of jumps, too."""
    start, end = reference.initial_time, reference.final_time
    if end <= start:
        return np.array([start])
    edge = SAME_TIME * (end - start)
    jumps = reference.jumps
    times = np.concatenate([np.linspace(start, end, samples), jumps, jumps - edge, jumps + edge])
    return np.unique(np.clip(times, start, end))
