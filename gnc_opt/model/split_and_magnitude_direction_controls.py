"""Composed controls: a difference of two controls, or the product of a magnitude and a direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.model.model_variables import Variable
from gnc_opt.numerical_tolerances import replace_zeros_by_one


@dataclass(frozen=True)
class ComposedControl:
    """Control u, the ``variable``, as a function of other controls, the ``parts``."""

    variable: Variable
    parts: tuple[str, ...]

    @property
    def name(self) -> str:
        return self.variable.name

    def compose_control(self, *parts: Any) -> Any:
        """Return u (size, ...), symbols or numbers, from the parts."""
        raise NotImplementedError

    def decompose_control(self, u: Array) -> tuple[Array, ...]:
        """Return parts that compose u (size, n_times); NaN if they are not unique."""
        raise NotImplementedError


@dataclass(frozen=True)
class SplitControl(ComposedControl):
    """Difference of two controls >= 0, plus ``corners`` (one per component; empty: zero)."""

    corners: tuple[float, ...] = ()

    def compose_control(self, *parts: Any) -> Any:
        """Return corners + first - second."""
        first, second = parts
        if not self.corners:
            return first - second
        return first - second + np.reshape(self.corners, (-1, *[1] * (np.ndim(first) - 1)))

    def decompose_control(self, u: Array) -> tuple[Array, Array]:
        """Return the positive and the negative part of u - corners."""
        beyond = u - np.reshape(self.corners or [0.0], (-1, 1))
        return np.maximum(beyond, 0.0), np.maximum(-beyond, 0.0)

    def decompose_symbolic_control(self, u: Any) -> tuple[Any, Any]:
        """Return the positive and the negative part for a symbol (size, 1)."""
        beyond = u - ca.DM(self.corners or [0.0] * u.shape[0])
        return ca.fmax(beyond, 0.0), ca.fmax(-beyond, 0.0)


@dataclass(frozen=True)
class VectorControl(ComposedControl):
    """Product of a magnitude >= 0 (one component) and a direction, which has length 1 unless it has no effect."""

    @property
    def magnitude(self) -> str:
        return self.parts[0]

    @property
    def direction(self) -> str:
        return self.parts[1]

    @property
    def direction_norm_constraint_name(self) -> str:
        """Name of the path constraint on the length of the direction."""
        return f"{self.direction} squared"

    def compose_control(self, *parts: Any) -> Any:
        """Return first * second."""
        first, second = parts
        return first * second

    def decompose_control(self, u: Array) -> tuple[Array, Array]:
        """Return norm and direction of u."""
        norm = np.linalg.norm(u, axis=0, keepdims=True)
        return norm, np.divide(u, norm, out=np.full_like(u, np.nan), where=norm > 0)


@dataclass(frozen=True)
class AssembledControl(ComposedControl):
    """Components (``rows``) of a product of a magnitude and a direction."""

    rows: tuple[int, ...] = ()

    def compose_control(self, *parts: Any) -> Any:
        """Return components of first * second."""
        first, second = parts
        return (first * second)[list(self.rows)]

    def decompose_control(self, u: Array) -> tuple[Array, ...]:
        """Return NaN: the parts depend on other controls too."""
        return tuple(np.full(u.shape[1:], np.nan) for _ in self.parts)


@dataclass(frozen=True)
class UnitVectorControl(ComposedControl):
    """Unit vector in the direction of a control vector of any length."""

    def compose_control(self, *parts: Any) -> Any:
        """Return the vector divided by its length."""
        norm = np.linalg.norm(parts[0], axis=0)
        return parts[0] / replace_zeros_by_one(norm)

    def decompose_control(self, u: Array) -> tuple[Array, ...]:
        """Return the vector unchanged."""
        return (u,)
