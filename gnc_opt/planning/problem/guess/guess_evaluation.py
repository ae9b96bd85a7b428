"""User input of guesses: a constant, a straight line, an array over time or a function of time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array
from gnc_opt.array_types import Array
from gnc_opt.errors import ProblemError
from gnc_opt.model.model_variables import read_vector
from gnc_opt.planning.problem.bounds import reject_ambiguous_value_or_range

GuessValue: TypeAlias = Callable[[Array], ArrayLike] | tuple[ArrayLike, ArrayLike] | ArrayLike


@dataclass(frozen=True)
class VectorizedGuess:
    """Guess by a function of times (N,) with values (size, N), which is much faster than one call for each time."""

    function: Callable[[Array], Array]

    def __call__(self, t: ArrayLike) -> Array:
        return self.function(np.atleast_1d(np.asarray(t, dtype=float)))[:, 0]


def read_guess_times(time: ArrayLike, where: str) -> Array:
    """Return the times (n_times,) of array-valued guesses, in ascending order."""
    times = read_float_array(time, f"the time of the guess in {where}", ProblemError).ravel()
    if times.size < 2 or not np.all(np.isfinite(times)) or not np.all(np.diff(times) > 0):
        raise ProblemError(
            f"the times of the guess in {where} must be finite and increase: give two or more."
        )
    return times


def resample_guesses(
    old: Mapping[str, GuessValue], old_times: Array, new: Mapping[str, GuessValue], times: Array
) -> tuple[dict[str, GuessValue], Array]:
    """Return two guesses with different times on the union of their times, within the span of the second."""
    if not any(_is_guess_table_over_times(value, old_times) for value in old.values()):
        return {**old, **new}, times
    shared = np.union1d(old_times, times)
    shared = shared[(shared >= times[0]) & (shared <= times[-1])]
    resampled = {
        name: _interpolate_guess(value, t, shared) if _is_guess_table_over_times(value, t) else value
        for values, t in ((old, old_times), (new, times))
        for name, value in values.items()
    }
    return resampled, shared


def _is_guess_table_over_times(value: GuessValue, times: Array) -> bool:
    return not callable(value) and not isinstance(value, tuple) and np.shape(value)[-1:] == times.shape


def _interpolate_guess(value: GuessValue, times: Array, new_times: Array) -> Array:
    rows = np.asarray(value, dtype=float).reshape(-1, times.size)
    return np.stack([np.interp(new_times, times, row) for row in rows])


def sample_guess(
    value: GuessValue, size: int, t: Array, fractions: Array, times: Array | None, what: str
) -> Array:
    """Return a guess with ``size`` components at times ``t`` (N,), or fractions of a phase, shape (size, N)."""
    if isinstance(value, VectorizedGuess):
        sampled = value.function(t)
    elif callable(value):
        sampled = np.stack([read_vector(value(t), size, f"{what} at t = {t:.4g} s") for t in t], axis=1)
    elif isinstance(value, tuple):
        sampled = _sample_linear_guess(value, size, fractions, what)
    else:
        sampled = _interpolate_guess_table(read_float_array(value, what, ProblemError), size, t, times, what)
    nonfinite = np.flatnonzero(~np.isfinite(sampled).all(axis=0))
    if nonfinite.size:
        value, time = sampled[:, nonfinite[0]], t[nonfinite[0]]
        raise ProblemError(f"{what} is {value} at t = {time:.4g} s: give finite values.")
    return sampled


def _sample_linear_guess(value: tuple[ArrayLike, ...], size: int, fractions: Array, what: str) -> Array:
    """Return values (size, N) between a start and an end value."""
    if len(value) != 2:
        raise ProblemError(
            f"{what} is a tuple of {len(value)} entries, but a tuple means (start, end): use a list."
        )
    reject_ambiguous_value_or_range((value[0], value[1]), size, what, "([a, a], [b, b]) for start and end")
    first, last = (
        read_vector(v, size, f"the {end} of {what}") for v, end in zip(value, ("start", "end"), strict=True)
    )
    return np.asarray(first[:, None] + (last - first)[:, None] * fractions)


def _interpolate_guess_table(array: Array, size: int, t: Array, times: Array | None, what: str) -> Array:
    constant = array.size in (1, size)
    if times is None and not constant:
        raise ProblemError(
            f"{what} has the shape {array.shape} and no times: give guess(time=[...], ...) with it."
        )
    if times is None or (constant and array.shape[-1:] != times.shape):
        return np.tile(read_vector(array, size, what)[:, None], t.size)
    if array.size != size * times.size:
        raise ProblemError(
            f"{what} has the shape {array.shape}: give ({size}, {times.size}) for {times.size} guess times."
        )
    return _interpolate_guess(array, times, t)
