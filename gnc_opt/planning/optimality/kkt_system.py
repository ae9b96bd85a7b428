r"""Linear algebra of second-order conditions: sparse symmetric systems, null spaces, extreme eigenvalues.

The rows of a collocated program, in order of time, are banded, except for quantities common to a whole phase: a free
final time, a parameter, an integral. In a stretched matrix (J. Grcar, Matrix stretching for linear equations, 1990) the
unknown :math:`y` of such a dense row is replaced by one copy per stretch of time, with the multipliers of
:math:`y_1 = y_2 = \dots = y_K`. The matrix stays symmetric, has the same solution, and is banded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from gnc_opt.array_types import Array, Indices, Mask, compute_midpoints
from gnc_opt.numerical_tolerances import MINOR, NEGLIGIBLE, ROUNDING, TINY, replace_zeros_by_one
from gnc_opt.planning.optimality.kkt_point import ProgramPoint, build_kkt_matrix, compute_quadrature_weights
from gnc_opt.planning.transcription.transcription import Transcription

DENSE = 200
"""Number of entries above which a row is dense; a collocation row has those of the points of its segment."""

STRETCH = 60
"""Number of rows per copy, about the bandwidth."""


def factorise_symmetric_matrix(matrix: Any) -> Callable[[Array], Array]:
    """Return the solver of a sparse symmetric system (n, n), a function of the right-hand side (n,)."""
    matrix = scipy.sparse.csr_array(matrix)
    many = np.diff(matrix.indptr) > DENSE
    dense, others = np.flatnonzero(many), np.flatnonzero(~many)
    copies = others.size // STRETCH
    if not dense.size or copies < 2:
        solve: Callable[[Array], Array] = scipy.sparse.linalg.splu(scipy.sparse.csc_array(matrix)).solve
        return solve
    stretches = _assign_row_blocks(matrix[others][:, others], copies)
    factors = scipy.sparse.linalg.splu(_split_dense_jacobian_rows(matrix, dense, others, stretches))
    first = others.size + copies * np.arange(dense.size)  # copies

    def solve_split_system(right: Array) -> Array:
        whole = np.zeros(factors.shape[0])
        whole[: others.size], whole[first] = right[others], right[dense]
        found = factors.solve(whole)
        solution = np.empty(right.size)
        solution[others], solution[dense] = found[: others.size], found[first]
        return solution

    return solve_split_system


def _assign_row_blocks(matrix: Any, copies: int) -> Indices:
    """Return the stretch of every row, from its position in a banded ordering (Cuthill & McKee)."""
    order = scipy.sparse.csgraph.reverse_cuthill_mckee(scipy.sparse.csr_matrix(matrix), symmetric_mode=True)
    stretches = np.empty(order.size, dtype=int)
    stretches[order] = np.arange(order.size) * copies // order.size
    return stretches


def _split_dense_jacobian_rows(matrix: Any, dense: Indices, others: Indices, stretches: Indices) -> Any:
    """Return the matrix of the other rows, the copies of each dense row, and the multipliers of their equality."""
    copies = int(np.max(stretches)) + 1
    entries = scipy.sparse.coo_array(matrix)
    stretch, place = np.zeros(matrix.shape[0], dtype=int), np.empty(matrix.shape[0], dtype=int)
    stretch[others] = stretches
    place[others], place[dense] = np.arange(others.size), others.size + copies * np.arange(dense.size)
    is_dense = np.zeros(matrix.shape[0], dtype=bool)
    is_dense[dense] = True
    i, j = entries.row, entries.col
    # An entry of a dense row belongs to the stretch of its column; one of two dense rows to the first stretch.
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


@dataclass(frozen=True, eq=False)
class NullSpace:
    """Variations of a program in which some variables and rows are fixed.

    Variations are relative to the scales, with weights for which the sum of squares is an integral over time.

    Attributes
    ----------
    unit : sparse (n_variables, n_variations)
        Scaled variables for each variation.
    rows : int array
        Rows of the program that are fixed.
    norms : array (n_rows,)
        Norms of the gradients of these rows.
    jacobian : sparse (n_rows + n_held, n_variations)
        Jacobian of these rows, scaled to unit gradients; followed by fixed variables that variations would change, and
        by additional rows.
    """

    unit: Any
    rows: Indices
    norms: Array
    jacobian: Any

    @classmethod
    def with_fixed_variables(
        cls, point: ProgramPoint, held: Mask, unit: Any = None, further: Any = None
    ) -> NullSpace:
        """Return the space in which ``held`` (n_variables + n_constraints,) are fixed.

        ``unit`` (n_variables, n_variations) replaces one variation per variable; ``further`` are additional fixed rows.
        """
        held, rows = held[: point.x.size], np.flatnonzero(held[point.x.size :])
        if unit is None:
            weights = compute_variation_norm_weights(point.transcription)
            unit = scipy.sparse.diags_array(1 / np.sqrt(weights), format="csc")
        unit = unit[:, np.flatnonzero(abs(unit[~held]).sum(axis=0) > 0)]
        moved = unit[held]
        moved = moved[np.flatnonzero(abs(moved).sum(axis=1) > 0)]
        jacobian, norms = _normalise_rows(point.row_jacobian[rows] @ unit)
        parts = [jacobian, _normalise_rows(moved)[0]]
        if further is not None:
            parts.append(_normalise_rows(further @ unit)[0])
        return cls(unit, rows, norms, scipy.sparse.vstack(parts, format="csc"))

    @property
    def dimension(self) -> int:
        return int(self.unit.shape[1])

    def project_hessian(self, hessian: Any) -> Any:
        """Return a Hessian in all scaled variables as a Hessian in the variations."""
        return scipy.sparse.csc_array(self.unit.T @ hessian @ self.unit)

    def expand_variation(self, variation: Array) -> Array:
        return np.asarray(self.unit @ variation)

    def factorise_hessian(self, hessian: Any) -> tuple[Any, Callable[[Array], Array]]:
        """Return the saddle-point matrix of a Hessian and the rows, and its solver."""
        n, m = self.dimension, self.jacobian.shape[0]
        matrix = build_kkt_matrix(hessian, self.jacobian)
        # With unit gradients, dependent rows are harmless; in moving frames they are nearly dependent.
        slack = scipy.sparse.diags_array(np.where(np.arange(n + m) < n, 0.0, NEGLIGIBLE * ROUNDING))
        return matrix, factorise_symmetric_matrix(matrix - slack)

    @cached_property
    def factorise_identity(self) -> tuple[Any, Callable[[Array], Array]]:
        """Return the saddle-point matrix of the identity and its solver, a projection onto the null space."""
        return self.factorise_hessian(scipy.sparse.eye_array(self.dimension))

    def invert_projected_hessian(self, hessian: Any) -> Callable[[Array], Array]:
        """Return the inverse of a Hessian restricted to the null space."""
        return self._project_inverse(*self.factorise_hessian(hessian))

    @property
    def projection_operator(self) -> Callable[[Array], Array]:
        """Projection of variations onto the null space."""
        return self._project_inverse(*self.factorise_identity)

    def _project_inverse(self, matrix: Any, solve: Callable[[Array], Array]) -> Callable[[Array], Array]:
        rows = np.zeros(self.jacobian.shape[0])

        def apply_projected_inverse(vector: Array) -> Array:
            right = np.concatenate([vector, rows])
            solved = solve(right)
            solved = solved + solve(right - matrix @ solved)  # removes the slack of `factorise_hessian`
            return np.asarray(solved[: vector.size])

        return apply_projected_inverse


def compute_curvature(hessian: Any, direction: Array) -> tuple[float, float]:
    """Return the curvature along a direction, absolute and relative to the sum of its terms."""
    value = float(direction @ (hessian @ direction))
    terms = float(np.abs(direction) @ (abs(hessian) @ np.abs(direction)))
    return value, value / max(terms, TINY)


def run_lanczos(operate: Callable[[Array], Array], start: Array, steps: int) -> tuple[Array, Array]:
    """Return approximate eigenvalues (k,) and eigenvectors (n, k) of a symmetric operator, from ``start`` (n,)."""
    size = float(np.linalg.norm(start))
    if not size > 0:
        return np.zeros(0), np.zeros((start.size, 0))
    space = np.empty((min(steps, start.size) + 1, start.size))
    space[0] = start / size
    diagonal: list[float] = []
    beside: list[float] = []
    for k in range(space.shape[0] - 1):
        image = operate(space[k])
        diagonal.append(float(space[k] @ image))
        for _ in range(2):
            image = image - space[: k + 1].T @ (space[: k + 1] @ image)
        length = float(np.linalg.norm(image))
        if length <= NEGLIGIBLE * max(map(abs, diagonal)) or (
            k % 10 == 9 and are_extreme_eigenvalues_converged(diagonal, beside, length)
        ):
            break
        beside.append(length)
        space[k + 1] = image / length
    n = len(diagonal)
    values, vectors = scipy.linalg.eigh_tridiagonal(diagonal, beside[: n - 1])
    return values, space[:n].T @ vectors


def are_extreme_eigenvalues_converged(diagonal: list[float], beside: list[float], length: float) -> bool:
    """Return whether both ends of the spectrum have converged, from the last components of their eigenvectors."""
    values, vectors = scipy.linalg.eigh_tridiagonal(diagonal, beside)
    return bool(np.max(length * np.abs(vectors[-1, [0, -1]])) <= MINOR * np.max(np.abs(values)))


def _normalise_rows(rows: Any) -> tuple[Any, Array]:
    norms = np.sqrt(np.asarray((rows**2).sum(axis=1)))
    norms = replace_zeros_by_one(norms)
    return scipy.sparse.diags_array(1 / norms) @ rows, norms


def compute_variation_norm_weights(transcription: Transcription) -> Array:
    """Return the weights of the squares of scaled variables in the norm of a variation (n_variables,)."""
    weights, _ = compute_quadrature_weights(transcription)
    for part in transcription.parts.values():
        collocation = part.collocation
        # States at inner boundaries follow from the points; they are weighted by the adjacent segments.
        widths = collocation.mesh.segment_widths
        weights[collocation.boundary_states[:, 1:-1]] = compute_midpoints(widths)
    return weights
