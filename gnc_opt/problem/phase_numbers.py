"""The numbers of a phase, apart from what it is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arrays import Array
from gnc_opt.problem.guess.values import GuessValue, on_shared_times, read_guess_times, sample_guess
from gnc_opt.problem.held import Held
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.turns import Turns


@dataclass(frozen=True)
class PhaseGuess:
    """What the user knows about the trajectory beforehand: values by name and their times."""

    time: Array | None = None
    values: Mapping[str, GuessValue] = field(default_factory=dict)

    def joined(
        self, time: ArrayLike | None, values: Mapping[str, GuessValue], sizes: Mapping[str, int], where: str
    ) -> PhaseGuess:
        """Return the guess that others, with their times, have joined; see `Phase.guess`.

        Parameters
        ----------
        time : array (n_times,), optional
        values : mapping of str to GuessValue
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
            merged, times = on_shared_times(kept, older, values, times)
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
