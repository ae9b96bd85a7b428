"""Data of a phase: numbers that may change without a new transcription, its guess, and the map of its controls.

A reformulated phase is solved in other controls than those that were stated; a `Restatement` maps between them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arrays import Array
from gnc_opt.errors import ProblemError
from gnc_opt.model.model import Model
from gnc_opt.planning.problem.angles import Turns
from gnc_opt.planning.problem.arcs import Held
from gnc_opt.planning.problem.guess.values import GuessValue, read_guess_times, resample_guesses, sample_guess
from gnc_opt.planning.problem.interval import Interval, read_interval


@dataclass(frozen=True)
class PhaseGuess:
    """The user's guess of the trajectory: values by name and their times."""

    time: Array | None = None
    values: Mapping[str, GuessValue] = field(default_factory=dict)

    def join_guess_values(
        self, time: ArrayLike | None, values: Mapping[str, GuessValue], sizes: Mapping[str, int], where: str
    ) -> PhaseGuess:
        """Return the guess that others, with their times, have joined; see `Phase.guess`.

        Parameters
        ----------
        time : array (n_times,), optional
        sizes : mapping of str to int
            Numbers of components by name, of all values.
        where : str
            For messages.
        """
        times = self.time if time is None else read_guess_times(time, where)
        older = self.time if time is not None and values else None  # times of what is joined
        merged, ends = {**self.values, **values}, np.array([0.0, 1.0])
        for name, value in (merged if older is None else values).items():
            if not callable(value):  # those must wait until the phase's times are known
                sample_guess(value, sizes[name], ends, ends, times, f"the guess of '{name}' in {where}")
        if older is not None and times is not None:
            kept = {name: value for name, value in self.values.items() if name not in values}
            merged, times = resample_guesses(kept, older, values, times)
        return PhaseGuess(times, merged)


@dataclass(frozen=True)
class PhaseNumbers:
    """The numbers of a phase; they may change without a new transcription.

    Attributes
    ----------
    turns : Turns, optional
        Angles that have lost their bounds, which left out no direction.
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
    arcs: Held | None = None
    turns: Turns | None = None


def read_duration(duration: Any, where: str) -> Interval:
    """Return the range of a phase's duration (s), which is positive; ``None`` is any."""
    given = read_interval(duration, 1, f"the duration of {where}")
    if given.upper[0] <= 0:
        raise ProblemError(f"the duration of {where} is at most {given.upper[0]:g} s: give a positive one.")
    return Interval(np.maximum(given.lower, 0.0), given.upper)


@dataclass(frozen=True, eq=False)
class Restatement:
    """Controls that were reformulated, and the map between stated and solved ones.

    Attributes
    ----------
    model : Model
        As it was stated.
    stated, solved : casadi.SX
        The controls that were stated and are no more, (k, 1), and what they are in the controls that are solved for.
    values : casadi.SX
        The controls that are solved for, in order, in those that were stated, (m, 1); NaN where any would do.
    texts : tuple of str
        What was reformulated.
    """

    model: Model
    stated: Any
    solved: Any
    values: Any
    texts: tuple[str, ...]

    @classmethod
    def from_limits(cls, model: Model, texts: tuple[str, ...]) -> Restatement:
        """Return one that leaves the controls as they are."""
        none = ca.SX(0, 1)
        return cls(model, none, none, model.symbols("control"), texts)

    def restate_expression(self, expression: Any) -> Any:
        """Return an expression of the stated controls in the solved ones."""
        return ca.substitute(expression, self.stated, self.solved)

    def compose_after(self, earlier: Restatement | None) -> Restatement:
        """Return this one and an earlier one, of whose controls it restates some, as one."""
        if earlier is None:
            return self
        return Restatement(
            earlier.model,
            ca.vertcat(earlier.stated, self.stated),
            ca.vertcat(self.restate_expression(earlier.solved), self.solved),
            ca.substitute(self.values, self.model.symbols("control"), earlier.values),
            (*earlier.texts, *self.texts),
        )
