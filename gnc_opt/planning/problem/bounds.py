"""Intervals: user input of values and ranges, and ranges of states and controls by name."""

from __future__ import annotations

import numbers
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.array_types import Array, Indices, Mask
from gnc_opt.errors import ProblemError, unknown_name_error
from gnc_opt.model.model_variables import Layout, read_vector
from gnc_opt.model.split_and_magnitude_direction_controls import SplitControl, VectorControl
from gnc_opt.model.symbolic_dynamics_model import Model


def replace_bounds_by_name(
    old: Interval, layout: Layout, values: Mapping[str, Any], what: str, where: str
) -> Interval:
    """Return an interval with changed ranges of some names; ``what`` and ``where`` are for messages."""
    lower, upper = old.lower.copy(), old.upper.copy()
    for name, value in values.items():
        if name not in layout:
            raise unknown_name_error(layout.kind, name, where, layout.names)
        place = layout.slice(name)
        interval = read_value_or_range(value, layout[name].size, f"the {what} of '{name}' in {where}")
        lower[place], upper[place] = interval.lower, interval.upper
    return Interval(lower, upper)


def split_bounds_by_name(box: Interval, layout: Layout) -> dict[str, Interval]:
    slices = ((name, layout.slice(name)) for name in layout.names)
    return {name: box.select_components(rows) for name, rows in slices}


def stack_named_bounds(boxes: Mapping[str, Interval], layout: Layout) -> Interval:
    """Return named ranges stacked in the order of a layout; missing ones are free."""
    box = unbounded_interval(layout.size)
    for name in layout.names:
        if name in boxes:
            box.lower[layout.slice(name)], box.upper[layout.slice(name)] = (
                boxes[name].lower,
                boxes[name].upper,
            )
    return box


def get_control_bounds(model: Model) -> Interval:
    """Return the default bounds of controls: parts of split controls and magnitudes are >= 0, others free."""
    box = unbounded_interval(model.controls.size)
    for control in model.composed_controls.values():
        for part in control.parts if isinstance(control, SplitControl) else control.parts[:1]:
            box.lower[model.controls.slice(part)] = 0.0
    return box


def convert_bounds_to_split_controls(model: Model, ranges: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return ranges in which split controls are replaced by their two parts: u = plus - minus."""
    parts: dict[str, Any] = {}
    for name, value in ranges.items():
        composed = model.composed_controls.get(name)
        if composed is None:
            parts[name] = value
            continue
        what = f"the bounds of '{name}' in {where}"
        if not isinstance(composed, SplitControl):
            raise ProblemError(
                f"{what} are those of a vector: give norm_bounds({name}=...), or path() for its components."
            )
        box = read_value_or_range(value, composed.variable.size, what)
        if np.any(box.lower > 0) or np.any(box.upper < 0):
            raise ProblemError(
                f"{what} exclude zero, which a split control requires: declare it with control()."
            )
        plus, minus = composed.parts
        parts[plus] = (np.zeros(box.upper.size), box.upper)
        parts[minus] = (np.zeros(box.lower.size), -box.lower)
    return parts


def read_norm_ranges(model: Model, ranges: Mapping[str, Any], where: str) -> dict[str, tuple[float, float]]:
    """Return norm ranges of vector controls as ranges of their magnitudes, which are >= 0."""
    parts = {}
    for name, value in ranges.items():
        what = f"the norm of '{name}' in {where}"
        vector = model.composed_controls.get(name)
        if not isinstance(vector, VectorControl):
            if name in model.controls or vector is not None:
                raise ProblemError(f"{what} has no bounds: declare '{name}' with vector_control().")
            known = [v.name for v in model.composed_controls.values() if isinstance(v, VectorControl)]
            raise unknown_name_error("vector control", name, where, known)
        box = read_value_or_range(value, 1, what)
        if box.upper[0] < 0:
            raise ProblemError(f"{what} is at most {box.upper[0]:g}: give a limit >= 0.")
        parts[vector.magnitude] = (max(0.0, float(box.lower[0])), float(box.upper[0]))
    return parts


@dataclass(frozen=True)
class Interval:
    """Element-wise bounds ``lower <= value <= upper``, each of shape (n,).

    Examples
    --------
    >>> print(Interval(np.array([0.0, 2.0]), np.array([1.0, 2.0])).is_fixed)
    [False  True]
    """

    lower: Array
    upper: Array

    @property
    def is_fixed(self) -> Any:
        """Boolean array (n,): whether lower equals upper."""
        return self.lower == self.upper

    @property
    def midpoint(self) -> Array:
        """Representative value (n,): the midpoint, the finite end, or zero without bounds."""
        lower, upper = np.isfinite(self.lower), np.isfinite(self.upper)
        low = np.where(lower, self.lower, np.where(upper, self.upper, 0.0))
        high = np.where(upper, self.upper, low)
        return np.asarray(0.5 * (low + high))

    @property
    def interval_width_or_zero(self) -> Array:
        """Width of each component (n,); 0 where it is unbounded."""
        return np.nan_to_num(self.upper - self.lower, posinf=0.0)

    def select_components(self, rows: slice | list[int] | Indices | Mask) -> Interval:
        """Return the interval of some components."""
        return Interval(self.lower[rows], self.upper[rows])

    def get_limit_by_sign(self, sign: int) -> Array:
        """Return the upper limit for a positive sign, else the lower one, (n,)."""
        return self.upper if sign > 0 else self.lower

    def compute_bound_violation(self, values: Array) -> Array:
        """Return the distances of values (n, ...) from the interval; 0 for values within it."""
        shape = (-1, *(1,) * (values.ndim - 1))
        lower, upper = self.lower.reshape(shape), self.upper.reshape(shape)
        return np.maximum(np.maximum(lower - values, values - upper), 0.0)

    def is_near_limits(self, values: Array, margin: ArrayLike) -> tuple[Mask, Mask]:
        """Return which values (n, ...) are at or beyond the lower and the upper limit, with a margin () or (n,)."""
        shape = (-1, *(1,) * (values.ndim - 1))
        slack = np.broadcast_to(margin, self.lower.shape).reshape(shape)
        lower, upper = self.lower.reshape(shape), self.upper.reshape(shape)
        return values <= lower + slack, values >= upper - slack


def unbounded_interval(size: int) -> Interval:
    """Return the interval without limits."""
    return Interval(np.full(size, -np.inf), np.full(size, np.inf))


def stack_intervals(boxes: Iterable[Interval]) -> Interval:
    intervals = [unbounded_interval(0), *boxes]
    return Interval(
        np.concatenate([box.lower for box in intervals]), np.concatenate([box.upper for box in intervals])
    )


def read_value_or_range(value: Any, size: int, what: str) -> Interval:
    """Read a value or range of a quantity with ``size`` components; ``what`` is its name in messages.

    ``None`` is free. A number, list or array is a fixed value; entries ``None`` are free. A tuple of two (for one
    component also a list of two) is a range; each end is a number, an array or ``None`` (no limit).

    Raises
    ------
    ProblemError
        Wrong number of components, NaN, lower limit above upper limit, or an ambiguous tuple.
    """
    if value is None:
        return unbounded_interval(size)
    if size == 1 and _is_number_pair(value):
        value = tuple(value)
    if not isinstance(value, tuple):
        fixed = Interval(_parse_limit(value, -np.inf, size, what), _parse_limit(value, np.inf, size, what))
        if np.any(np.isnan(fixed.lower)):
            raise ProblemError(f"{what}: NaN; give a number, or None to leave it free.")
        return check_interval_not_empty(fixed, what)
    if len(value) != 2:
        raise ProblemError(
            f"{what}: tuple of {len(value)} entries, but a tuple means (lower, upper); write a value as "
            "a list."
        )
    reject_ambiguous_value_or_range(value, size, what, "([a, a], [b, b]) for a range")
    return read_lower_and_upper_limits(value[0], value[1], size, what)


def read_lower_and_upper_limits(lower: Any, upper: Any, size: int, what: str) -> Interval:
    """Return the range of ``size`` components; each end is a number, an array or ``None`` (no limit)."""
    low = _parse_limit(lower, -np.inf, size, f"the lower limit of {what}")
    high = _parse_limit(upper, np.inf, size, f"the upper limit of {what}")
    return check_interval_not_empty(Interval(low, high), what)


def _parse_limit(value: Any, unlimited: float, size: int, what: str) -> Array:
    if value is None:
        value = unlimited
    elif isinstance(value, (list, tuple)):
        value = [unlimited if entry is None else entry for entry in value]
    return read_vector(value, size, what)


def reject_ambiguous_value_or_range(value: tuple[Any, Any], size: int, what: str, otherwise: str) -> None:
    """Raise `ProblemError` for a tuple of two numbers for a 2-vector: it may be a value or a range."""
    if (
        size == 2
        and all(np.ndim(end) == 0 and isinstance(end, numbers.Real) for end in value)
        and value[0] != value[1]
    ):
        raise ProblemError(
            f"{what}: with 2 components, {value!r} can be read in two ways; write [a, b] for a value or "
            f"{otherwise}."
        )


def check_interval_not_empty(interval: Interval, what: str) -> Interval:
    """Return the interval; raise `ProblemError` for NaN, crossed limits and infinite values."""
    what = what.removeprefix("the ")
    for end, name in ((interval.lower, "lower"), (interval.upper, "upper")):
        if np.any(np.isnan(end)):
            raise ProblemError(f"{what}: {name} limit NaN; give a number, or None for no limit.")
    crossed = np.flatnonzero(interval.lower > interval.upper)
    if crossed.size:
        i = int(crossed[0])
        raise ProblemError(
            f"{what}{f', component {i}' if interval.lower.size > 1 else ''}: lower limit {interval.lower[i]:g} "
            f"exceeds upper limit {interval.upper[i]:g}; swap or correct them."
        )
    if np.any(np.isposinf(interval.lower)) or np.any(np.isneginf(interval.upper)):
        raise ProblemError(f"{what}: infinite limit; give a finite number, or None for no limit.")
    return interval


def intersect_bounds(a: Interval, b: Interval) -> Interval:
    """Return the component-wise intersection (may be empty: lower > upper)."""
    return Interval(np.maximum(a.lower, b.lower), np.minimum(a.upper, b.upper))


def _is_number_pair(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return bool(value.shape == (2,))
    return (
        isinstance(value, list) and len(value) == 2 and not any(isinstance(v, (list, tuple)) for v in value)
    )
