"""Another way to a first solution: meet the constraints first, lower the cost afterwards.

A cost pulls the iterates, a free final time above all, into a corner where the constraints cannot be met and their
violation is stationary: there a solver stops and reports that the problem is infeasible, though it is not. Without the
cost nothing pulls; with the durations held, what remains of many problems is close to linear. Durations that are too
short are the usual trap, so longer ones are tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gnc_opt.model.layout import Array
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.random_guess import with_random_guess
from gnc_opt.transcription.guess import start_variables
from gnc_opt.transcription.transcription import Transcription

STRETCHES = (1.0, 4.0, 16.0, 64.0)
"""Multiples of the guessed times at which durations are held."""

RANDOM = 2
"""Random starts, free durations, where the guess itself does not help."""

SEED = 1


@dataclass(frozen=True, eq=False)
class FeasibilityStart:
    """Where to look for a point that meets the constraints.

    Attributes
    ----------
    variables : array (n_variables,)
        Physical.
    held : int array
        Places of variables to hold while the constraints are being met.
    """

    variables: Array
    held: NDArray[np.int64]


def feasibility_starts(
    transcription: Transcription, problem: Problem, start: Array
) -> Iterator[FeasibilityStart]:
    """Yield starts: the guess with free times, with times held at multiples of the guess, and random ones."""
    places = np.concatenate([part.times for part in transcription.parts.values()])
    times = np.unique(places[places < transcription.n_variables])
    box = transcription.variable_interval(problem)
    yield FeasibilityStart(start, times[:0])
    tried: list[Array] = []
    for stretch in STRETCHES if times.size else ():
        values = np.clip(stretch * start[times], box.lower[times], box.upper[times])
        if any(np.array_equal(values, earlier) for earlier in tried):
            continue
        tried.append(values)
        stretched = start.copy()
        stretched[times] = values
        yield FeasibilityStart(stretched, times)
    for index in range(1, RANDOM + 1):
        twin = with_random_guess(problem, SEED, index)
        yield FeasibilityStart(start_variables(transcription, twin), times[:0])


def knows_trajectory(problem: Problem) -> bool:
    """Whether the problem's guess is a trajectory over time, not merely end values: then its failure is the user's."""
    guesses = [leg.numbers.guess for leg in problem.phases.values()]
    return any(
        callable(value) or (guess.time is not None and guess.time.size > 2)
        for guess in guesses
        for value in guess.values.values()
    )
