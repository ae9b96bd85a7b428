"""Legendre quadrature and collocation on [-1, 1]: nodes, weights, differentiation and integration.

There are three families of points: ``LG`` (Gauss, no end), ``LGR`` (Radau, with -1) and ``LGL`` (Lobatto, both ends).
The tables are computed in 50-digit decimal arithmetic and rounded once.

P_0 ... P_{n-1} are orthogonal with respect to the quadrature, ``sum_i w_i P_j(x_i) P_k(x_i) = g_k δ_jk``, with ``g_k``
the integral of P_k², except ``2/(n-1)`` for the last one of Lobatto. Sources: Gautschi, *Orthogonal Polynomials*
(2004); Berrut & Trefethen, *Barycentric Lagrange interpolation*, SIAM Review 46 (2004).
"""

from collections.abc import Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from functools import cache, lru_cache
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, quote_value
from gnc_opt.planning.transcription.collocation_families import Numbers, Scheme, get_point_family

MAX_POINTS = 64


@dataclass(frozen=True, eq=False)
class CollocationRule:
    """Tables of a collocation method with n points on [-1, 1]; all arrays are read-only.

    Attributes
    ----------
    points, weights : Array, shape (n,)
        Collocation points in ascending order, and their quadrature weights (sum 2).
    state_nodes : Array, shape (n + 1,)
        Nodes of the state polynomial in ascending order: the points and -1 (LG), +1 (LGR), or the midpoint of the
        widest gap (LGL; of two equal gaps the positive one), which is used for dense output only.
    differentiation : Array, shape (n, n + 1)
        Maps values on ``state_nodes`` to the derivative at ``points``.
    end_values : Array, shape (n + 1,)
        Maps values on ``state_nodes`` to the value at +1 (a unit vector for LGR and LGL).
    integration : Array, shape (n, n)
        Maps values at ``points`` to the integral of their interpolant from -1 to each point (Butcher matrix).
    """

    scheme: Scheme
    n: int
    points: Array
    weights: Array
    state_nodes: Array
    differentiation: Array
    end_values: Array
    integration: Array

    def build_integration_matrix(self, tau: ArrayLike) -> Array:
        """Return the map from values at ``points`` to their interpolant's integral to ``tau``, (len(tau), n)."""
        at = np.atleast_1d(np.asarray(tau, dtype=float))
        return np.asarray(_integrate_legendre(at, self.n) @ _build_legendre_transform(self.scheme, self.n))


def get_collocation_rule(scheme: Scheme, n: int) -> CollocationRule:
    """Return the tables of the ``n``-point method of a family, n from 1 (LGL: 2) to 64; cached.

    Raises
    ------
    ArgumentError
        Unknown scheme, or a number of points that is not an integer in range.
    """
    return _build_collocation_rule(*_check_quadrature_arguments(scheme, n))


def get_collocation_points(scheme: Scheme, n: int) -> Array:
    """Return the ``n`` points of a family in ascending order, shape (n,); raises as `get_collocation_rule`."""
    return _compute_quadrature_points_and_weights(*_check_quadrature_arguments(scheme, n))[0]


def get_quadrature_weights(scheme: Scheme, n: int) -> Array:
    """Return the ``n`` quadrature weights of a family, shape (n,); raises as `get_collocation_rule`."""
    return _compute_quadrature_points_and_weights(*_check_quadrature_arguments(scheme, n))[1]


def compute_barycentric_weights(nodes: ArrayLike) -> Array:
    """Return the barycentric weights ``1 / prod_k (x_j - x_k)``, scaled to a largest one of ±1, shape (len(nodes),)."""
    return _compute_barycentric_weights(_read_float_vector(nodes).tobytes())


def build_differentiation_matrix(nodes: ArrayLike, at: ArrayLike) -> Array:
    """Return the map from values on ``nodes`` to the interpolant's derivative at ``at``, (len(at), len(nodes))."""
    x, w = _read_float_vector(nodes), compute_barycentric_weights(nodes)
    return np.asarray(build_lagrange_interpolation_matrix(x, at) @ _build_square_differentiation_matrix(x, w))


def build_lagrange_interpolation_matrix(nodes: ArrayLike, at: ArrayLike) -> Array:
    """Return the map from values on ``nodes`` to their interpolant at ``at``, shape (len(at), len(nodes))."""
    return interpolate_barycentric(
        _read_float_vector(nodes), compute_barycentric_weights(nodes), _read_float_vector(at)
    )


def interpolate_barycentric(x: Array, w: Array, at: Array) -> Array:
    """Return `build_lagrange_interpolation_matrix` for validated nodes and abscissae, and barycentric weights."""
    gap = at[:, None] - x
    nearest = np.min(np.abs(gap), axis=1, keepdims=True)
    hit = gap == 0
    gap[hit] = 1.0
    basis = w * (nearest / gap)  # the row is 0 if an abscissa equals a node
    basis[hit] = 1.0
    return np.asarray(basis / basis.sum(axis=1, keepdims=True))


def _check_quadrature_arguments(scheme: Scheme, n: int) -> tuple[Scheme, int]:
    fewest = get_point_family(scheme).fewest
    if not isinstance(n, Integral) or isinstance(n, bool) or not fewest <= n <= MAX_POINTS:
        remedy = f"use an integer from {fewest} to {MAX_POINTS}, or more segments"
        raise ArgumentError(f"{scheme} has no rule with {quote_value(n)} points: {remedy}.")
    return scheme, int(n)


@cache
def _build_collocation_rule(scheme: Scheme, n: int) -> CollocationRule:
    x, _ = _compute_decimal_quadrature_rule(scheme, n)
    with _set_decimal_context_precision():
        nodes = get_point_family(scheme).get_state_polynomial_nodes(x)
        w = _invert_products_of_node_differences(nodes)
        collocated = np.isin(nodes, x)
        differentiation = _build_square_differentiation_matrix(nodes, w)[collocated]
        integration = _integrate_legendre(x, n) @ _build_decimal_legendre_transform(scheme, n)
        end_values = _differentiate_legendre_at_one(nodes, w)
    tables = map(_round_to_float, (nodes, differentiation, end_values, integration))
    return CollocationRule(scheme, n, *_compute_quadrature_points_and_weights(scheme, n), *tables)


@cache
def _compute_quadrature_points_and_weights(scheme: Scheme, n: int) -> tuple[Array, Array]:
    x, w = _compute_decimal_quadrature_rule(scheme, n)
    return _round_to_float(x), _round_to_float(w)


@cache
def _compute_decimal_quadrature_rule(scheme: Scheme, n: int) -> tuple[Numbers, Numbers]:
    with _set_decimal_context_precision():
        family = get_point_family(scheme)
        x = _convert_to_decimals(family.approximate_nodes(n))[(n + 1) // 2 if family.is_symmetric else 0 :]
        for _ in range(3):  # quadratic convergence from about 1e-14: three steps reach the last digit
            x = _refine_quadrature_points_by_newton(scheme, n, x)
        if family.is_symmetric:
            x = np.concatenate([-x[::-1], [Decimal(0)] * (n % 2), x])
        modes = _evaluate_legendre(x, n - 1)
        return x, 1 / sum(modes[k] ** 2 / g for k, g in enumerate(family.sum_legendre_squares(n)))


def _refine_quadrature_points_by_newton(scheme: Scheme, n: int, x: Numbers) -> Numbers:
    """Return Newton's step to the roots of P_n (LG), P_n + P_{n-1} (LGR) or P_n - P_{n-2} (LGL), all simple."""
    modes = _evaluate_legendre(x, n)
    series = get_point_family(scheme).build_polynomial_with_node_roots(n)
    value = sum(c * modes[k] for k, c in series.items())
    slope = sum(c * (2 * j + 1) * modes[j] for k, c in series.items() for j in range(k - 1, -1, -2))
    return np.asarray(x - value / slope)


def _evaluate_legendre(x: Numbers, degree: int) -> list[Numbers]:
    """Return P_0 ... P_degree at ``x`` from the three-term recurrence; floats or Decimals."""
    modes = [x * 0 + 1, x]
    for k in range(1, degree):
        modes.append(((2 * k + 1) * x * modes[k] - k * modes[k - 1]) / (k + 1))
    return modes[: degree + 1]


def _integrate_legendre(x: Numbers, n: int) -> Numbers:
    """Return the integrals of P_0 ... P_{n-1} from -1 to ``x``, shape (len(x), n)."""
    modes = _evaluate_legendre(x, n)
    return np.stack([x + 1] + [(modes[k + 1] - modes[k - 1]) / (2 * k + 1) for k in range(1, n)], axis=1)


@cache
def _build_decimal_legendre_transform(scheme: Scheme, n: int) -> Numbers:
    """Return the map from values at the points to the Legendre coefficients of their interpolant, shape (n, n)."""
    x, w = _compute_decimal_quadrature_rule(scheme, n)
    with _set_decimal_context_precision():
        pairs = zip(
            _evaluate_legendre(x, n - 1), get_point_family(scheme).sum_legendre_squares(n), strict=True
        )
        return np.stack([w * mode / norm for mode, norm in pairs])


@cache
def _build_legendre_transform(scheme: Scheme, n: int) -> Array:
    return _round_to_float(_build_decimal_legendre_transform(scheme, n))


def _invert_products_of_node_differences(x: Numbers) -> Numbers:
    gap = x[:, None] - x
    np.fill_diagonal(gap, 1)
    return np.asarray(1 / gap.prod(axis=1))


def _build_square_differentiation_matrix(x: Numbers, w: Numbers) -> Numbers:
    """Return the differentiation matrix at the nodes ``x`` with barycentric weights ``w``; floats or Decimals."""
    gap = x[:, None] - x
    np.fill_diagonal(gap, 1)
    matrix = w / w[:, None] / gap
    np.fill_diagonal(matrix, 0)
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return np.asarray(matrix)


def _differentiate_legendre_at_one(x: Numbers, w: Numbers) -> Numbers:
    if x[-1] == 1:
        return np.asarray(x == 1)
    terms = w / (1 - x)
    return np.asarray(terms / terms.sum())


@lru_cache(maxsize=1024)
def _compute_barycentric_weights(nodes: bytes) -> Array:
    x = np.frombuffer(nodes)
    if x.size == 0 or not np.all(np.isfinite(x)) or np.unique(x).size < x.size:
        raise ArgumentError(f"interpolation nodes must be finite and distinct, at least one; got {x}")
    with _set_decimal_context_precision():
        w = _invert_products_of_node_differences(_convert_to_decimals(x))
        return _round_to_float(w / max(abs(w)))


def _set_decimal_context_precision() -> AbstractContextManager[Context]:
    return localcontext(Context(prec=50))


def _convert_to_decimals(values: Iterable[float]) -> Numbers:
    return np.array([Decimal(float(value)) for value in values], dtype=object)


def _round_to_float(values: Numbers) -> Array:
    table = values.astype(float)
    table.setflags(write=False)
    return table


def _read_float_vector(values: ArrayLike) -> Array:
    vector = np.atleast_1d(np.asarray(values, dtype=float))
    if vector.ndim != 1:
        raise ArgumentError(f"expected a vector of nodes or abscissae, got an array of shape {vector.shape}")
    return vector
