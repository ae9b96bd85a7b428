"""Reading what users write for values and ranges: a number, an array, ``None`` or ``(lower, upper)``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gnc_opt.errors import ProblemError
from gnc_opt.model.layout import Array, as_vector


@dataclass(frozen=True)
class Interval:
    """Element-wise bounds ``lower <= value <= upper``, each of shape (n,)."""

    lower: Array
    upper: Array

    @property
    def fixed(self) -> Any:
        """Boolean array (n,): where lower equals upper."""
        return self.lower == self.upper

    @property
    def middle(self) -> Array:
        """A representative value (n,): the midpoint, the finite end, or zero when unbounded."""
        lower, upper = np.isfinite(self.lower), np.isfinite(self.upper)
        low = np.where(lower, self.lower, np.where(upper, self.upper, 0.0))
        high = np.where(upper, self.upper, low)
        return np.asarray(0.5 * (low + high))


def free(size: int) -> Interval:
    """Return the interval without limits."""
    return Interval(np.full(size, -np.inf), np.full(size, np.inf))


def read_interval(value: Any, size: int, what: str) -> Interval:
    """Read a value or range for a quantity of ``size`` components.

    Parameters
    ----------
    value : None, number, array-like or tuple (lower, upper)
        ``None`` is free; a number, list or array is a fixed value; a tuple of two is a range, each end a
        number, an array or ``None`` (no limit).
    size : int
        Number of components; scalars are repeated.
    what : str
        Names the quantity in error messages.

    Raises
    ------
    ProblemError
        Wrong number of components, NaN, crossed bounds, or an ambiguous tuple.
    """
    if value is None:
        return free(size)
    if not isinstance(value, tuple):
        fixed = as_vector(value, size, what)
        return checked(Interval(fixed, fixed), what)
    if len(value) != 2:
        raise ProblemError(
            f"{what}: a tuple means (lower, upper), but it has {len(value)} entries; write a value as a list."
        )
    if size == 2 and all(np.ndim(end) == 0 and end is not None for end in value) and value[0] != value[1]:
        raise ProblemError(
            f"{what} has 2 components, so {value!r} could be a value or a range: write [a, b] for a value "
            "or ([a, a], [b, b]) for a range."
        )
    low = -np.inf if value[0] is None else value[0]
    high = np.inf if value[1] is None else value[1]
    return checked(Interval(as_vector(low, size, what), as_vector(high, size, what)), what)


def checked(interval: Interval, what: str) -> Interval:
    """Return the interval, or raise `ProblemError` when it holds NaN, crossed bounds or a value at infinity."""
    for end, name in ((interval.lower, "lower"), (interval.upper, "upper")):
        if np.any(np.isnan(end)):
            raise ProblemError(f"{what}: the {name} limit is NaN ({end}); use None where there is no limit.")
    crossed = np.flatnonzero(interval.lower > interval.upper)
    if crossed.size:
        i = int(crossed[0])
        raise ProblemError(
            f"{what}: lower {interval.lower[i]:g} exceeds upper {interval.upper[i]:g}"
            f"{f' in component {i}' if interval.lower.size > 1 else ''}; swap or correct them."
        )
    if np.any(np.isposinf(interval.lower)) or np.any(np.isneginf(interval.upper)):
        raise ProblemError(f"{what}: a value or limit lies at infinity; use None where there is no limit.")
    return interval


def intersect(a: Interval, b: Interval) -> Interval:
    """Return the component-wise intersection (may be empty: lower > upper)."""
    return Interval(np.maximum(a.lower, b.lower), np.minimum(a.upper, b.upper))
