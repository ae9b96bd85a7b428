"""Feedforward control, and schedules of the precomputed signals of a tracking law."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from gnc_opt.argument_checks import require_type
from gnc_opt.array_types import Array
from gnc_opt.control.design_report import DesignReport, ReportEntry
from gnc_opt.control.discrete_time_controller import (
    Controller,
    Schedule,
    initial_state_function,
    law_function,
)
from gnc_opt.control.reference_trajectory import Reference
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.numerical_tolerances import SAME_TIME


def build_reference_signal_layout(reference: Reference, *more: Variable) -> Layout:
    """Return the layout of a schedule: ``<state>_ref``, ``<control>_ff`` (feedforward) and the variables ``more``."""
    states = [replace(v, name=f"{v.name}_ref", nominal=None) for v in reference.states.variables]
    controls = [replace(v, name=f"{v.name}_ff", nominal=None) for v in reference.controls.variables]
    return Layout("signal", (*states, *controls, *more), "the schedule")


@dataclass(frozen=True, eq=False)
class ReferenceSchedule:
    """Schedule (n_states + n_controls, n): states at the start of each step, mean controls over the step."""

    reference: Reference

    def __call__(self, times: Array, dt: float) -> Array:
        return np.vstack([self.reference.x(times), self.reference.mean_control(times, dt)])


@dataclass(frozen=True, eq=False)
class StackedSchedule:
    """Two schedules stacked by rows."""

    upper: Schedule
    lower: Schedule

    def __call__(self, times: Array, dt: float) -> Array:
        return np.vstack([self.upper(times, dt), self.lower(times, dt)])


def choose_reference_sample_times(reference: Reference, samples: int = 101) -> Array:
    """Return the times (s) at which a design evaluates its reference: equidistant, and on both sides of jumps."""
    start, end = reference.initial_time, reference.final_time
    if end <= start:
        return np.array([start])
    edge = SAME_TIME * (end - start)
    jumps = reference.jumps
    times = np.concatenate([np.linspace(start, end, samples), jumps, jumps - edge, jumps + edge])
    return np.unique(np.clip(times, start, end))


def feedforward(reference: Reference) -> Controller:
    """Return an open-loop controller: the mean reference control over each step.

    Parameters
    ----------
    reference : Reference

    Raises
    ------
    ArgumentError
        Not a reference.

    Examples
    --------
    >>> law = go.feedforward(go.Reference(solution))
    """
    require_type(
        reference, Reference, "the argument of feedforward()", "write feedforward(Reference(solution))"
    )
    signals = build_reference_signal_layout(reference)
    states, controls = reference.states.size, reference.controls.size
    t, x = ca.SX.sym("t"), ca.SX.sym("x", states)
    r, z = ca.SX.sym("r", signals.size), ca.SX.sym("z", 0)
    return Controller(
        name="feedforward",
        step=law_function(t, x, r, z, r[states : states + controls], z),
        start=initial_state_function(t, x, r, z),
        states=reference.states,
        commands=reference.controls,
        signals=signals,
        memory=Layout("memory", (), "feedforward"),
        schedule=ReferenceSchedule(reference),
        span=(reference.initial_time, reference.final_time),
        explanation=DesignReport(
            "feedforward (open loop)",
            (
                ReportEntry(
                    "feedback", "none", remark="errors of the initial state and of the model stay or grow"
                ),
            ),
        ),
    )
