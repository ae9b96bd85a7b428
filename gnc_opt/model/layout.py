"""Named variables and their places in a stacked vector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import ErrorType, read_numbers
from gnc_opt.arrays import Array
from gnc_opt.errors import ProblemError, unknown_name


@dataclass(frozen=True)
class Variable:
    """A named, possibly vector-valued quantity.

    Attributes
    ----------
    name : str
    size : int
        Number of components.
    unit : str
        For printing and plotting; gnc_opt computes in the units it is given (SI by convention).
    nominal : tuple of float or None
        Typical magnitude of each component, used for scaling; ``None`` lets gnc_opt choose.

    Examples
    --------
    >>> print(cart.states["q"], cart.states["q"].labels)
    q (m) ('q',)
    """

    name: str
    size: int = 1
    unit: str = ""
    nominal: tuple[float, ...] | None = None

    @property
    def labels(self) -> tuple[str, ...]:
        """Component names: ``("q",)`` for a scalar, ``("r[0]", "r[1]", ...)`` for a vector."""
        return (self.name,) if self.size == 1 else tuple(f"{self.name}[{i}]" for i in range(self.size))

    def __str__(self) -> str:
        size = f"[{self.size}]" if self.size > 1 else ""
        unit = f" ({self.unit})" if self.unit else ""
        return f"{self.name}{size}{unit}"


@dataclass(frozen=True)
class Layout:
    """Ordered variables of one kind ("state", "control", ...) stacked into one vector.

    Examples
    --------
    >>> print(cart.states.names, cart.states.units, cart.states.slice("v"))
    ('q', 'v') ('m', 'm/s') slice(1, 2, None)
    """

    kind: str
    variables: tuple[Variable, ...] = ()
    owner: str = ""

    @cached_property
    def size(self) -> int:
        """Length of the stacked vector."""
        return sum(v.size for v in self.variables)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Variable names in order."""
        return tuple(v.name for v in self.variables)

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Component names in order, one per entry of the stacked vector."""
        return tuple(label for v in self.variables for label in v.labels)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units, one per entry of the stacked vector."""
        return tuple(v.unit for v in self.variables for _ in range(v.size))

    @cached_property
    def _slices(self) -> dict[str, slice]:
        ends = np.cumsum([v.size for v in self.variables])
        return {
            v.name: slice(int(end) - v.size, int(end)) for v, end in zip(self.variables, ends, strict=True)
        }

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name in self._slices

    def __getitem__(self, name: str) -> Variable:
        self.slice(name)
        return next(v for v in self.variables if v.name == name)

    def slice(self, name: str) -> slice:
        """Return the place of a variable in the stacked vector; raise `UnknownNameError` for others."""
        if name not in self:
            raise unknown_name(self.kind, name, self.owner or "it", self.names)
        return self._slices[name]

    def stack(self, values: Mapping[str, ArrayLike], default: float = np.nan) -> Array:
        """Stack values by name into one vector of shape (size,); absent names get ``default``."""
        out = np.full(self.size, default)
        for name, value in values.items():
            out[self.slice(name)] = as_vector(value, self[name].size, f"{self.kind} '{name}'")
        return out


def as_vector(value: ArrayLike, size: int, what: str, error: ErrorType = ProblemError) -> Array:
    """Return ``value`` as a float vector of ``size`` entries; scalars are repeated.

    Raises
    ------
    ProblemError
        Or the given class of error, if the value is not numeric or has another number of entries.
    """
    array = read_numbers(value, what, error).reshape(-1)
    if array.size == 1:
        return np.full(size, array[0])
    if array.size != size:
        needed = "one value" if size == 1 else f"{size} values, or one for all"
        raise error(f"{what} is given {array.size} values: give {needed}.")
    return array


def as_point(value: ArrayLike, size: int, what: str, error: ErrorType = ProblemError) -> Array:
    """Return what `as_vector` does of a state or a whole measurement: a list of one number is no list of several."""
    if size != 1 and np.shape(read_numbers(value, what, error)) == (1,):
        raise error(f"{what} is given 1 value in a list: give {size} values.")
    return as_vector(value, size, what, error)


def as_magnitudes(value: ArrayLike, size: int, what: str, error: ErrorType = ProblemError) -> Array:
    """Return typical magnitudes as `as_vector` does; they are positive and finite, or an error is raised."""
    vector = as_vector(value, size, what, error)
    if not np.all(np.isfinite(vector) & (vector > 0)):
        raise error(f"{what} is {vector}: give positive finite numbers.")
    return vector
