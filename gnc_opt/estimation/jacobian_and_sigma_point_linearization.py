r"""Linearisation of a function of a random variable: Jacobian, or statistical linear regression.

Both approximate :math:`f(x)`, x with mean :math:`\hat x` and error covariance P, by

.. math:: f(x) \approx \hat f + F e + \omega, \qquad \omega \sim (0, \Omega) .

*Tangent* (extended Kalman filter): :math:`\hat f = f(\hat x)`, F the Jacobian, :math:`\Omega = 0`.

*Regression* (unscented Kalman filter), with :math:`P = L L^T`, sigma points :math:`\pm c L_i`, errors :math:`f_i^\pm`
of their images relative to :math:`f(\hat x)`, :math:`s_i = (f_i^+ + f_i^-) / 2` and :math:`c^2 = 3` (Gauss-Hermite):

.. math:: \bar f = \frac{1}{c^2} \sum_i s_i, \quad F = A L^{-1}, \quad A_i = \frac{f_i^+ - f_i^-}{2c}, \quad
   \Omega = \frac{c^2 - 1}{c^4} \sum_i s_i s_i^T .

Sources: S. Julier, J. Uhlmann, Unscented filtering and nonlinear estimation, Proc. IEEE 92 (2004).
M. Norgaard, N. Poulsen, O. Ravn, New developments in state estimation for nonlinear systems, Automatica 36 (2000):
second-order divided differences with the interval sqrt(3).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca

from gnc_opt.estimation.error_state_coordinates import Space
from gnc_opt.numerical_tolerances import ROUNDING

Map: TypeAlias = Callable[[Any], Any]


@dataclass(frozen=True)
class TangentModel:
    """Linearisation by the Jacobian at the mean; f maps SX columns, x and P are SX symbols."""

    @property
    def preserves_covariance_sparsity(self) -> bool:
        """Whether errors that f does not couple stay exactly uncorrelated."""
        return True

    def propagate_covariance(
        self, f: Map, space: Space, x: Any, P: Any, value: Any, slope: Any
    ) -> tuple[Any, Any]:
        """Return f at the mean, and P propagated with the Jacobian."""
        return value, slope @ P @ slope.T

    def fit_linear_model(self, f: Map, source: Space, target: Space, x: Any, P: Any) -> tuple[Any, Any, Any]:
        """Return f at the mean, the Jacobian in the errors and a zero remainder."""
        value = f(x)
        slope = (
            target.build_state_difference_jacobian(value)
            @ ca.jacobian(value, x)
            @ source.build_state_retraction_jacobian(x)
        )
        return value, slope, ca.SX(target.errors, target.errors)


@dataclass(frozen=True)
class SigmaRegression:
    """Statistical linear regression with 2 n + 1 sigma points."""

    @property
    def preserves_covariance_sparsity(self) -> bool:
        """Whether errors that f does not couple stay exactly uncorrelated; sigma points mix all errors."""
        return False

    def propagate_covariance(
        self, f: Map, space: Space, x: Any, P: Any, value: Any, slope: Any
    ) -> tuple[Any, Any]:
        """Return the mean of f(x) and the covariance of its error, from the sigma points."""
        mean, slope_root, remainder, _ = self._propagate_sigma_points(f, space, space, x, P)
        return mean, slope_root @ slope_root.T + remainder

    def fit_linear_model(self, f: Map, source: Space, target: Space, x: Any, P: Any) -> tuple[Any, Any, Any]:
        """Return the mean of f(x), the regression slope of its error and the covariance of the residual."""
        value, spread, remainder, root = self._propagate_sigma_points(f, source, target, x, P)
        return value, solve_triangular_right(spread, root), remainder

    def _propagate_sigma_points(
        self, f: Map, source: Space, target: Space, x: Any, P: Any
    ) -> tuple[Any, Any, Any, Any]:
        """Return mean, regressed spread, remaining covariance, and the root of ``P``."""
        root = factorise_semidefinite(P)
        square, c = 3.0, math.sqrt(3.0)
        centre = f(x)
        sums, differences = [], []
        for i in range(source.errors):
            step = c * root[:, i]
            plus, minus = (target.difference(f(source.retraction(x, move)), centre) for move in (step, -step))
            sums.append((plus + minus) / 2)
            differences.append((plus - minus) / (2 * c))
        curvatures, spread = ca.horzcat(*sums), ca.horzcat(*differences)
        mean = ca.sum2(curvatures) / square
        remainder = (square - 1) / square**2 * (curvatures @ curvatures.T)
        return target.retraction(centre, mean), spread, remainder, root


Approximation: TypeAlias = TangentModel | SigmaRegression


def factorise_semidefinite(P: Any) -> Any:
    """Return the lower L (n, n) with P = L L' for a symmetric, possibly singular SX; uses the lower part of P."""
    n = P.shape[0]
    root = ca.SX.zeros(n, n)
    for j in range(n):
        pivot_square = P[j, j] - ca.sumsqr(root[j, :j])
        valid = pivot_square > ROUNDING * P[j, j]
        pivot = ca.sqrt(ca.if_else(valid, pivot_square, 0))
        root[j, j] = pivot
        for i in range(j + 1, n):
            root[i, j] = ca.if_else(
                valid, (P[i, j] - ca.dot(root[i, :j], root[j, :j])) / ca.if_else(valid, pivot, 1), 0
            )
    return root


def solve_triangular_left(root: Any, b: Any) -> Any:
    """Return L^-1 b for a lower SX L; components with a zero on the diagonal are zero."""
    rows: list[Any] = []
    for i in range(root.shape[0]):
        value = b[i, :]
        for k, row in enumerate(rows):
            value = value - root[i, k] * row
        is_regular = root[i, i] > 0
        rows.append(ca.if_else(is_regular, value / ca.if_else(is_regular, root[i, i], 1), 0))
    return ca.vertcat(*rows)


def solve_triangular_right(a: Any, root: Any) -> Any:
    """Return F with F L = a for a lower SX L; columns with a zero on the diagonal are zero."""
    columns: dict[int, Any] = {}
    for j in reversed(range(root.shape[0])):
        value = a[:, j]
        for k in range(j + 1, root.shape[0]):
            value = value - columns[k] * root[k, j]
        is_regular = root[j, j] > 0
        columns[j] = ca.if_else(is_regular, value / ca.if_else(is_regular, root[j, j], 1), 0)
    return ca.horzcat(*[columns[j] for j in range(root.shape[0])])
