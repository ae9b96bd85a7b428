"""Trajectory: interface between planning and control, states and controls of a model over time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from gnc_opt.array_types import Array
from gnc_opt.model.symbolic_dynamics_model import Model


@dataclass(frozen=True)
class TrajectoryPhase:
    """States and controls of a model over a time interval.

    Attributes
    ----------
    model : Model
        Model with the parameter values of this trajectory.
    initial_time, final_time : float
        Time interval, s.
    jumps : array (n_jumps,)
        Times of control jumps, s.
    x, u : callable
        Functions of times (n_times,), s: states (n_states, n_times) and controls (n_controls, n_times).
    """

    name: str
    model: Model
    initial_time: float
    final_time: float
    jumps: Array
    x: Callable[[Array], Array]
    u: Callable[[Array], Array]


@runtime_checkable
class Trajectory(Protocol):
    """Object with a trajectory of one or more phases."""

    def trajectory_phases(self) -> tuple[TrajectoryPhase, ...]:
        """Return the phases in order of time."""
