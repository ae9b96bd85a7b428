"""The numbers of a phase, apart from what it is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from gnc_opt.arrays import Array
from gnc_opt.problem.guess.values import GuessValue
from gnc_opt.problem.held import Held
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.turns import Turns


@dataclass(frozen=True)
class PhaseGuess:
    """What the user knows about the trajectory beforehand: values by name and their times."""

    time: Array | None = None
    values: Mapping[str, GuessValue] = field(default_factory=dict)


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
