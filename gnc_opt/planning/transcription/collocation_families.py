"""Collocation schemes: properties of the families of points, and the rows of a segment."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from decimal import Decimal
from difflib import get_close_matches
from typing import Any, ClassVar, Literal, TypeAlias, get_args

import numpy as np
import scipy
from numpy.typing import NDArray

from gnc_opt.array_types import Array, Indices
from gnc_opt.errors import ArgumentError, quote_value

Scheme: TypeAlias = Literal["LG", "LGR", "LGL"]

SCHEMES: tuple[Scheme, ...] = get_args(Scheme)

GAUSS: Scheme = "LG"
"""Default family, also used for quadratures."""

Numbers: TypeAlias = NDArray[Any]
"""Arrays of float64 or (as objects) of Decimal; formulas apply to both."""


class PointFamily(ABC):
    """Family of collocation points on [-1, 1], with the rows of a segment.

    Attributes
    ----------
    fewest : int
        Smallest number of points.
    starts_at_point, ends_at_point : bool
        Whether -1 and +1 are collocation points, equal to the boundaries of a segment.
    extra_rows : int
        Number of vector-valued dynamics rows of a segment minus its number of points.
    """

    fewest: ClassVar[int] = 1
    starts_at_point: ClassVar[bool] = False
    ends_at_point: ClassVar[bool] = False
    extra_rows: ClassVar[int] = 0

    @property
    def is_symmetric(self) -> bool:
        return self.starts_at_point == self.ends_at_point

    @property
    def has_dynamics_row_at_segment_end(self) -> bool:
        """Whether the state at the end of a segment has its own row and multiplier."""
        return self.extra_rows > 0

    # --- points -----------------------------------------------------------------------------------

    @abstractmethod
    def approximate_nodes(self, n: int) -> Iterable[float]:
        """Return the points to about 14 digits."""

    @abstractmethod
    def build_polynomial_with_node_roots(self, n: int) -> dict[int, int]:
        """Return the polynomial whose (simple) roots are the points: Legendre degree → coefficient."""

    def sum_legendre_squares(self, n: int) -> list[Decimal]:
        """Return the sums ``sum_i w_i P_k(x_i)²``, k = 0 ... n-1."""
        return [Decimal(2) / (2 * k + 1) for k in range(n)]

    @abstractmethod
    def get_state_polynomial_nodes(self, points: Numbers) -> Numbers:
        """Return the nodes of the state polynomial in ascending order (n + 1,)."""

    # --- rows of a segment ------------------------------------------------------------------------

    @abstractmethod
    def build_dynamics_state_matrix(self, differentiation: Array, end_values: Array) -> Array:
        """Return the coefficients (rows, nodes) of the states of `list_dynamics_row_variables` in the dynamics rows.

        ``differentiation`` (n, n + 1) and ``end_values`` (n + 1,) map state values to rates and the end value.
        """

    def build_dynamics_rate_matrix(self, integration: Array) -> Array:
        """Return the coefficients (rows, n) of the point values F_j in the dynamics rows, before -w/2.

        ``integration`` (n, n) maps values at the points to the integral of their interpolant from -1 to each point.
        """
        return np.eye(len(integration))

    @abstractmethod
    def list_dynamics_row_variables(self, start: Indices, points: Indices, end: Indices) -> Indices:
        """Return the variables (n_states, nodes) in the rows: states at start, points and end of a segment."""

    def describe_dynamics_row_location(self, row: int, n: int) -> str:
        """Return a description of the location of a row in a segment of n points."""
        return f"point {row + 1}"


class Gauss(PointFamily):
    """Legendre-Gauss: neither end is a point; the end state is the value of the polynomial, with its own row."""

    extra_rows = 1

    def approximate_nodes(self, n: int) -> Iterable[float]:
        return [float(x) for x in scipy.special.roots_legendre(n)[0]]

    def build_polynomial_with_node_roots(self, n: int) -> dict[int, int]:
        return {n: 1}

    def get_state_polynomial_nodes(self, points: Numbers) -> Numbers:
        return np.array([Decimal(-1), *points])

    def build_dynamics_state_matrix(self, differentiation: Array, end_values: Array) -> Array:
        n = len(differentiation)
        matrix = np.zeros((n + 1, n + 2))
        matrix[:n, : n + 1] = differentiation
        matrix[n, : n + 1] = -end_values
        matrix[n, n + 1] = 1.0
        return matrix

    def build_dynamics_rate_matrix(self, integration: Array) -> Array:
        n = len(integration)
        return np.vstack([np.eye(n), np.zeros((1, n))])

    def list_dynamics_row_variables(self, start: Indices, points: Indices, end: Indices) -> Indices:
        return np.hstack([start, points, end])

    def describe_dynamics_row_location(self, row: int, n: int) -> str:
        return "end" if row == n else super().describe_dynamics_row_location(row, n)


class Radau(PointFamily):
    """Legendre-Gauss-Radau: the start is a point; the end state is a node without collocation."""

    starts_at_point = True

    def approximate_nodes(self, n: int) -> Iterable[float]:
        return [-1.0, *(scipy.special.roots_jacobi(n - 1, 0, 1)[0] if n > 1 else [])]

    def build_polynomial_with_node_roots(self, n: int) -> dict[int, int]:
        return {n: 1, n - 1: 1}

    def get_state_polynomial_nodes(self, points: Numbers) -> Numbers:
        return np.array([*points, Decimal(1)])

    def build_dynamics_state_matrix(self, differentiation: Array, end_values: Array) -> Array:
        return differentiation

    def list_dynamics_row_variables(self, start: Indices, points: Indices, end: Indices) -> Indices:
        return np.hstack([points, end])


class Lobatto(PointFamily):
    """Legendre-Gauss-Lobatto: both ends are points; states follow from the first one by integration (IIIA)."""

    fewest = 2
    starts_at_point = ends_at_point = True
    extra_rows = -1

    def approximate_nodes(self, n: int) -> Iterable[float]:
        return [-1.0, *(scipy.special.roots_jacobi(n - 2, 1, 1)[0] if n > 2 else []), 1.0]

    def build_polynomial_with_node_roots(self, n: int) -> dict[int, int]:
        return {n: 1, n - 2: -1}

    def sum_legendre_squares(self, n: int) -> list[Decimal]:
        return [*super().sum_legendre_squares(n)[:-1], Decimal(2) / (n - 1)]

    def get_state_polynomial_nodes(self, points: Numbers) -> Numbers:
        """Return the points and the midpoint of the widest gap (of two equal gaps the positive one)."""
        gaps = zip(points[1:] - points[:-1], (points[1:] + points[:-1]) / 2, strict=True)
        _, _, widest = max((gap, -abs(middle), middle) for gap, middle in gaps)
        return np.array(sorted([*points, widest]))

    def build_dynamics_state_matrix(self, differentiation: Array, end_values: Array) -> Array:
        n = len(differentiation)
        return np.hstack([-np.ones((n - 1, 1)), np.eye(n - 1)])

    def build_dynamics_rate_matrix(self, integration: Array) -> Array:
        return integration[1:, :]

    def list_dynamics_row_variables(self, start: Indices, points: Indices, end: Indices) -> Indices:
        return points

    def describe_dynamics_row_location(self, row: int, n: int) -> str:
        return f"point {row + 2}"


_FAMILIES: dict[str, PointFamily] = {"LG": Gauss(), "LGR": Radau(), "LGL": Lobatto()}
_SPELLINGS = {"lg": "LG", "gauss": "LG", "lgr": "LGR", "radau": "LGR", "lgl": "LGL", "lobatto": "LGL"}


def get_point_family(scheme: Scheme) -> PointFamily:
    """Return the family with this name; raise `ArgumentError` for other names."""
    if not isinstance(scheme, str) or scheme not in _FAMILIES:
        close = get_close_matches(str(scheme).lower(), _SPELLINGS, n=1)
        hint = f"did you mean '{_SPELLINGS[close[0]]}'? " if close else ""
        raise ArgumentError(
            f"unknown scheme {quote_value(scheme)}: {hint}choose LG (Gauss), LGR (Radau) or LGL (Lobatto)."
        )
    return _FAMILIES[scheme]
