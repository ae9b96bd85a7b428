"""Piecewise polynomial interpolation along one axis of a table, as weights of a window of coefficients.

On the interval from break j to break j + 1, with u from 0 to 1, the value is the sum over a of
``(M_j [1, u, u^2, ...])_a C[stride j + a]``. The methods differ in window, matrices M_j and coefficients C.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import scipy

from gnc_opt.array_types import Array, Indices

Method: TypeAlias = Literal["bspline", "linear", "pchip"]


@dataclass(frozen=True, eq=False)
class AxisPolynomials:
    """Piecewise polynomials of one axis.

    Attributes
    ----------
    breaks : array (n + 1,)
        In ascending order.
    matrices : array (n, window, degree + 1)
        Maps powers of u to weights of the window.
    stride : int
        Shift of the window from one interval to the next.
    """

    breaks: Array
    matrices: Array
    stride: int

    @property
    def interval_coefficient_indices(self) -> Indices:
        """Indices of the coefficients of each interval, (n, window)."""
        n, window, _ = self.matrices.shape
        return np.asarray(self.stride * np.arange(n)[:, None] + np.arange(window))

    def convert_polynomials_to_power_basis(self, coefficients: Array) -> tuple[AxisPolynomials, Array]:
        """Return the same polynomials with coefficients (n_coefficients,) of the powers of u per interval."""
        n, _, powers = self.matrices.shape
        own = np.einsum("jap,ja->jp", self.matrices, coefficients[self.interval_coefficient_indices])
        return AxisPolynomials(self.breaks, np.tile(np.eye(powers), (n, 1, 1)), powers), own.ravel()


def fit_linear_interpolation(x: Array, values: Array) -> tuple[AxisPolynomials, Array]:
    """Return pieces and coefficients of the linear interpolation at points x (n,) with values (n, ...)."""
    return AxisPolynomials(x, np.tile([[1.0, -1.0], [0.0, 1.0]], (x.size - 1, 1, 1)), 1), values


def fit_cubic_spline(x: Array, values: Array) -> tuple[AxisPolynomials, Array]:
    """Return pieces and coefficients of the cubic spline with not-a-knot ends; arguments as in `linear`.

    Three points give a parabola, two a straight line. C. de Boor, A Practical Guide to Splines, Springer 2001, ch. IV.
    """
    degree = min(3, x.size - 1)
    spline = scipy.interpolate.make_interp_spline(x, values, k=degree)
    knots = spline.t[degree : spline.t.size - degree]
    unit = scipy.interpolate.BSpline(spline.t, np.eye(x.size), degree)
    widths = np.diff(knots)
    matrices = np.empty((widths.size, degree + 1, degree + 1))
    for power in range(degree + 1):  # Taylor series of each basis function at the start of each interval
        series = unit(knots[:-1], nu=power) * widths[:, None] ** power / math.factorial(power)
        for j in range(widths.size):
            matrices[j, :, power] = series[j, j : j + degree + 1]
    return AxisPolynomials(knots, matrices, 1), spline.c


def fit_monotone_cubic(x: Array, values: Array) -> tuple[AxisPolynomials, Array]:
    """Return pieces and coefficients of the monotone cubic interpolation; arguments as in `linear`.

    F. N. Fritsch and J. Butland, A method for constructing local monotone piecewise cubic interpolants, SIAM J. Sci.
    Stat. Comput. 5, 1984, 300-304.
    """
    slopes = scipy.interpolate.PchipInterpolator(x, values).derivative()(x)
    both = np.stack([values, slopes], axis=1).reshape(2 * x.size, *values.shape[1:])
    first = np.array([[1, 0, -3, 2], [0, 1, -2, 1], [0, 0, 3, -2], [0, 0, -1, 1]], dtype=float)
    matrices = np.tile(first, (x.size - 1, 1, 1))
    matrices[:, 1::2] *= np.diff(x)[:, None, None]
    return AxisPolynomials(x, matrices, 2), both


METHODS: dict[Method, Callable[[Array, Array], tuple[AxisPolynomials, Array]]] = {
    "bspline": fit_cubic_spline,
    "linear": fit_linear_interpolation,
    "pchip": fit_monotone_cubic,
}
