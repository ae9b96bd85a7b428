"""Controls that are stated as one and optimised as others: a difference, or a magnitude times a direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.variables import Variable


@dataclass(frozen=True)
class ComposedControl:
    """A control u, the ``variable``, made of other controls, the ``parts``."""

    variable: Variable
    parts: tuple[str, ...]

    @property
    def name(self) -> str:
        """Of u."""
        return self.variable.name

    def compose(self, *parts: Any) -> Any:
        """Return u (size, ...), symbols or numbers, from its parts."""
        raise NotImplementedError

    def decompose(self, u: Array) -> tuple[Array, ...]:
        """Return parts that u (size, n_times) is made of; NaN where any would do."""
        raise NotImplementedError


@dataclass(frozen=True)
class SplitControl(ComposedControl):
    """The difference of two controls >= 0 that meet at ``corners`` (by component; empty: at zero)."""

    corners: tuple[float, ...] = ()

    def compose(self, *parts: Any) -> Any:
        """Return first - second, from the corners."""
        first, second = parts
        if not self.corners:
            return first - second
        return first - second + np.reshape(self.corners, (-1, *[1] * (np.ndim(first) - 1)))

    def decompose(self, u: Array) -> tuple[Array, Array]:
        """Return what is above the corners, and below."""
        beyond = u - np.reshape(self.corners or [0.0], (-1, 1))
        return np.maximum(beyond, 0.0), np.maximum(-beyond, 0.0)

    def decompose_symbol(self, u: Any) -> tuple[Any, Any]:
        """Return the same of a symbol (size, 1)."""
        beyond = u - ca.DM(self.corners or [0.0] * u.shape[0])
        return ca.fmax(beyond, 0.0), ca.fmax(-beyond, 0.0)


@dataclass(frozen=True)
class VectorControl(ComposedControl):
    """The product of a magnitude >= 0 (one component) and a direction, a vector of length 1 where it matters."""

    @property
    def magnitude(self) -> str:
        """Name of the control that is the norm."""
        return self.parts[0]

    @property
    def direction(self) -> str:
        """Name of the control that is the direction."""
        return self.parts[1]

    @property
    def length(self) -> str:
        """Name of the path constraint that limits the length of the direction."""
        return f"{self.direction} squared"

    def compose(self, *parts: Any) -> Any:
        """Return first * second."""
        first, second = parts
        return first * second

    def decompose(self, u: Array) -> tuple[Array, Array]:
        """Return norm and direction."""
        norm = np.linalg.norm(u, axis=0, keepdims=True)
        return norm, np.divide(u, norm, out=np.full_like(u, np.nan), where=norm > 0)


@dataclass(frozen=True)
class AssembledControl(ComposedControl):
    """Components (``rows``) of a vector that is a magnitude times a direction."""

    rows: tuple[int, ...] = ()

    def compose(self, *parts: Any) -> Any:
        """Return components of first * second."""
        first, second = parts
        return (first * second)[list(self.rows)]

    def decompose(self, u: Array) -> tuple[Array, ...]:
        """Return NaN: other controls are needed, too."""
        return tuple(np.full(u.shape[1:], np.nan) for _ in self.parts)
