r"""Factors of sparse symmetric matrices that are banded but for a few dense rows.

The rows of a collocated program, in the order of time, have entries near the diagonal only, but for those of what the
whole of a phase shares: a free final time, a parameter, an integral. Eliminating in an order that knows only counts of
entries, such a row couples all that it meets. Stretched (J. Grcar, Matrix stretching for linear equations, 1990), the
unknown :math:`y` of a dense row becomes one copy for every stretch of time and the multipliers of

.. math:: y_1 = y_2 = \dots = y_K,

whose rows have two entries each: the row of a copy holds the entries of its stretch, and added up, in which the
multipliers cancel, they are the dense row. The matrix stays symmetric, its solution is the same, and it is banded.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from gnc_opt.arrays import Array, Indices

DENSE = 200
"""Rows with more entries than this are dense: a row of collocation has those of the points of its segment."""

STRETCH = 60
"""Rows per copy: about as many as the band is wide."""


def factorised(matrix: Any) -> Callable[[Array], Array]:
    """Return what solves a linear system with a symmetric matrix (n, n): right-hand sides (n,) to solutions.

    Parameters
    ----------
    matrix : sparse (n, n)
    """
    matrix = scipy.sparse.csr_array(matrix)
    many = np.diff(matrix.indptr) > DENSE
    dense, others = np.flatnonzero(many), np.flatnonzero(~many)
    copies = others.size // STRETCH
    if not dense.size or copies < 2:
        solve: Callable[[Array], Array] = scipy.sparse.linalg.splu(scipy.sparse.csc_array(matrix)).solve
        return solve
    stretches = _stretches(matrix[others][:, others], copies)
    factors = scipy.sparse.linalg.splu(_stretched(matrix, dense, others, stretches))
    first = others.size + copies * np.arange(dense.size)  # copies

    def solve_stretched(right: Array) -> Array:
        whole = np.zeros(factors.shape[0])
        whole[: others.size], whole[first] = right[others], right[dense]
        found = factors.solve(whole)
        solution = np.empty(right.size)
        solution[others], solution[dense] = found[: others.size], found[first]
        return solution

    return solve_stretched


def _stretches(matrix: Any, copies: int) -> Indices:
    """The stretch of every row, by its place in an order in which the matrix is banded (Cuthill & McKee's)."""
    order = scipy.sparse.csgraph.reverse_cuthill_mckee(scipy.sparse.csr_matrix(matrix), symmetric_mode=True)
    stretches = np.empty(order.size, dtype=int)
    stretches[order] = np.arange(order.size) * copies // order.size
    return stretches


def _stretched(matrix: Any, dense: Indices, others: Indices, stretches: Indices) -> Any:
    """The matrix of the other rows, the copies of each dense one, and the multipliers of their equality."""
    copies = int(np.max(stretches)) + 1
    entries = scipy.sparse.coo_array(matrix)
    stretch, place = np.zeros(matrix.shape[0], dtype=int), np.empty(matrix.shape[0], dtype=int)
    stretch[others] = stretches
    place[others], place[dense] = np.arange(others.size), others.size + copies * np.arange(dense.size)
    is_dense = np.zeros(matrix.shape[0], dtype=bool)
    is_dense[dense] = True
    i, j = entries.row, entries.col
    # An entry of a dense row belongs to the stretch of its column; one of two dense rows, to the first.
    rows = place[i] + np.where(is_dense[i], stretch[j], 0)
    columns = place[j] + np.where(is_dense[j], stretch[i], 0)
    n = others.size + copies * dense.size
    left = (place[dense][:, None] + np.arange(copies - 1)).ravel()
    equal = n + np.arange(left.size)
    one = np.ones(left.size)
    size = n + left.size
    values = np.concatenate([entries.data, one, one, -one, -one])
    at = (
        np.concatenate([rows, equal, left, equal, left + 1]),
        np.concatenate([columns, left, equal, left + 1, equal]),
    )
    return scipy.sparse.csc_array((values, at), shape=(size, size))
