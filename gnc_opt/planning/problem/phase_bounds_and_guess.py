"""Phase data: numbers that may change without a new transcription, initial guess, and reformulated controls.

A reformulated phase is solved with other controls than stated; a `ControlMap` maps between them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.array_types import Array
from gnc_opt.errors import ProblemError
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.planning.problem.active_constraint_arcs import FixedArcs
from gnc_opt.planning.problem.angle_valued_controls import UnboundedAngles
from gnc_opt.planning.problem.bounds import Interval, read_value_or_range
from gnc_opt.planning.problem.guess.guess_evaluation import (
    GuessValue,
    read_guess_times,
    resample_guesses,
    sample_guess,
)


@dataclass(frozen=True)
class PhaseGuess:
    """User's initial guess: values by name, and their times."""

    time: Array | None = None
    values: Mapping[str, GuessValue] = field(default_factory=dict)

    def add_guess_times_and_values(
        self, time: ArrayLike | None, values: Mapping[str, GuessValue], sizes: Mapping[str, int], where: str
    ) -> PhaseGuess:
        """Return the guess extended by new values and times; see `Phase.guess`.

        Parameters
        ----------
        time : array (n_times,), optional
        sizes : mapping of str to int
            Number of components of each value.
        where : str
            Location, for messages.
        """
        times = self.time if time is None else read_guess_times(time, where)
        older = self.time if time is not None and values else None  # times of the existing values
        merged, ends = {**self.values, **values}, np.array([0.0, 1.0])
        for name, value in (merged if older is None else values).items():
            if not callable(value):  # functions need the phase's times
                sample_guess(value, sizes[name], ends, ends, times, f"the guess of '{name}' in {where}")
        if older is not None and times is not None:
            unchanged = {name: value for name, value in self.values.items() if name not in values}
            merged, times = resample_guesses(unchanged, older, values, times)
        return PhaseGuess(times, merged)


@dataclass(frozen=True)
class PhaseBoundsAndGuess:
    """Numbers of a phase; they may change without a new transcription.

    Attributes
    ----------
    turns : UnboundedAngles, optional
        Angles whose bounds were removed because they excluded no direction.
    """

    initial_time: Interval | None
    final_time: Interval | None
    duration: Interval
    initial: Interval
    final: Interval
    states: Interval
    controls: Interval
    guess: PhaseGuess = PhaseGuess()
    scales: Mapping[str, Array] = field(default_factory=dict)
    arcs: FixedArcs | None = None
    turns: UnboundedAngles | None = None


def read_duration(duration: Any, where: str) -> Interval:
    """Return the range of a phase's duration (s), which is positive; ``None`` is free."""
    given = read_value_or_range(duration, 1, f"the duration of {where}")
    if given.upper[0] <= 0:
        raise ProblemError(f"the duration of {where} is at most {given.upper[0]:g} s: give a positive one.")
    return Interval(np.maximum(given.lower, 0.0), given.upper)


@dataclass(frozen=True, eq=False)
class ControlMap:
    """Reformulated controls, with the maps between stated and solved controls.

    Attributes
    ----------
    model : Model
        Model as stated.
    stated, solved : casadi.SX
        Stated controls that were replaced, (k, 1), and their expressions in the solved controls.
    values : casadi.SX
        Solved controls, in order, as expressions of the stated ones, (m, 1); NaN if they are arbitrary.
    texts : tuple of str
        Descriptions of the reformulations.
    """

    model: Model
    stated: Any
    solved: Any
    values: Any
    texts: tuple[str, ...]

    @classmethod
    def create_identity_map(cls, model: Model, texts: tuple[str, ...]) -> ControlMap:
        """Return a map that does not change the controls."""
        empty = ca.SX(0, 1)
        return cls(model, empty, empty, model.symbols("control"), texts)

    def express_by_reformulated_controls(self, expression: Any) -> Any:
        """Return an expression of the stated controls in terms of the solved ones."""
        return ca.substitute(expression, self.stated, self.solved)

    def compose_control_maps(self, earlier: ControlMap | None) -> ControlMap:
        if earlier is None:
            return self
        return ControlMap(
            earlier.model,
            ca.vertcat(earlier.stated, self.stated),
            ca.vertcat(self.express_by_reformulated_controls(earlier.solved), self.solved),
            ca.substitute(self.values, self.model.symbols("control"), earlier.values),
            (*earlier.texts, *self.texts),
        )
