"""Trajectory: states and controls of a model over time, made by planning and followed by controllers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from gnc_opt.arrays import Array
from gnc_opt.model.model import Model


@dataclass(frozen=True)
class TrajectoryPhase:
    """States and controls of a model from an initial to a final time.

    Attributes
    ----------
    model : Model
        With the values of its parameters on this trajectory.
    initial_time, final_time : float
        s.
    jumps : array (n_jumps,)
        Times at which a control jumps, s.
    x, u : callable
        Of times (n_times,) in s: states (n_states, n_times) and controls (n_controls, n_times).
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
    """Anything that has a trajectory, phase by phase."""

    def trajectory_phases(self) -> tuple[TrajectoryPhase, ...]:
        """Return the phases in the order of time."""
