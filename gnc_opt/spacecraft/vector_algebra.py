"""Vector algebra in three dimensions for CasADi symbols and NumPy arrays alike.

A CasADi vector among the arguments makes the result a CasADi vector; lists and tuples count as arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

Vector: TypeAlias = Any
"""CasADi (3, 1), or an array (3,) or (3, n_times)."""

Matrix: TypeAlias = Any
"""CasADi (3, 3), or an array (3, 3) or (3, 3, n_times)."""


def is_symbolic(*values: Any) -> bool:
    """Whether any of the values is a CasADi matrix."""
    return any(isinstance(v, (ca.SX, ca.MX, ca.DM)) for v in values)


def stack_vector(components: Sequence[Any]) -> Vector:
    """Return the vector of scalar components: CasADi scalars, floats or arrays over time."""
    if is_symbolic(*components):
        return ca.vertcat(*components)
    return np.stack(np.broadcast_arrays(*components))


def stack_matrix_rows(rows: Sequence[Sequence[Any]]) -> Matrix:
    """Return the matrix with the given rows of scalar components."""
    if is_symbolic(*(c for row in rows for c in row)):
        return ca.vertcat(*[ca.horzcat(*row) for row in rows])
    flat = np.stack(np.broadcast_arrays(*[c for row in rows for c in row]))
    return flat.reshape(len(rows), len(rows[0]), *flat.shape[1:])


def dot(a: Vector, b: Vector) -> Any:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product a x b.

    Parameters
    ----------
    a, b : casadi (3, 1), array (3,) or (3, n_times)

    Examples
    --------
    >>> print(cross([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    [0. 0. 1.]
    """
    return stack_vector([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def scale_vector(factor: Any, a: Vector) -> Vector:
    """Return a scalar (CasADi, number or array over time) times a vector."""
    return stack_vector([factor * a[0], factor * a[1], factor * a[2]])


def apply(matrix: Matrix, a: Vector) -> Vector:
    """Return the product of a matrix and a vector, at every time.

    Parameters
    ----------
    matrix : casadi (3, 3), array (3, 3) or (3, 3, n_times)
    a : casadi (3, 1), array (3,) or (3, n_times)

    Examples
    --------
    >>> print(apply(np.diag([1.0, 2.0, 3.0]), [1.0, 1.0, 1.0]))
    [1. 2. 3.]
    """
    if is_symbolic(matrix, a):
        return ca.mtimes(matrix, ca.vertcat(a[0], a[1], a[2]))
    m = np.asarray(matrix, dtype=float)
    return stack_vector([m[i, 0] * a[0] + m[i, 1] * a[1] + m[i, 2] * a[2] for i in range(3)])


def transpose(matrix: Matrix) -> Matrix:
    """Return the transposed matrix, at every time.

    Parameters
    ----------
    matrix : casadi (m, n), array (m, n) or (m, n, n_times)

    Examples
    --------
    >>> print(transpose([[1.0, 2.0], [3.0, 4.0]]))
    [[1. 3.]
     [2. 4.]]
    """
    return matrix.T if is_symbolic(matrix) else np.swapaxes(np.asarray(matrix, dtype=float), 0, 1)
