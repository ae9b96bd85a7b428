"""Numeric calls of CasADi functions of (t, x, ...)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_numbers
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError


def evaluate(function: Any, t: ArrayLike, x: ArrayLike, *others: ArrayLike) -> Array:
    """Evaluate a CasADi function of (t, x, ...) at one time or many.

    One-dimensional arguments are constant in time; two-dimensional ones have time as the last axis.
    """
    times, *columns = checked(function, t, x, *others)
    if times.ndim == 0:
        return np.asarray(function(times, *columns).full()[:, 0])
    n = times.size
    wide = [c if c.ndim == 2 else np.tile(c.reshape(-1, 1), (1, n)) for c in columns]
    return np.asarray(function(times.reshape(1, n), *wide).full())


def checked(function: Any, *arguments: ArrayLike) -> list[Array]:
    """Return the arguments as arrays; raise `ArgumentError` for those that the function cannot take."""
    arrays = [
        read_numbers(a, f"{function.name_in(i)} of {function.name()}()") for i, a in enumerate(arguments)
    ]
    n_times = arrays[0].size
    for i, array in enumerate(arrays[1:], 1):
        rows = function.size1_in(i)
        if array.ndim == 0:
            arrays[i] = array = array.reshape(1)
        if array.shape[0] != rows or array.shape[1:] not in ((), (n_times,)):
            raise ArgumentError(
                f"{function.name_in(i)} of {function.name()}() has the shape {array.shape}: "
                f"give ({rows},) or ({rows}, {n_times}) for {n_times} time{'s' * (n_times != 1)}."
            )
    return arrays
