"""Linear algebra of second-order conditions: sparse symmetric systems, null spaces, extreme eigenvalues."""

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


def factorise_symmetric_matrix(matrix: Any) -> Callable[[Array], Array]:
    """Return the solver of a sparse symmetric system (n, n), a function of the right-hand side (n,).

    The rows of a collocated program are banded (Cuthill & McKee), except for those of quantities common to a whole
    phase, such as a free final time. These come last and are scaled down, so that none of them is a pivot before.
    """
    matrix = scipy.sparse.csr_array(matrix)
    dense = np.diff(matrix.indptr) > DENSE
    if not np.any(dense):
        solve: Callable[[Array], Array] = scipy.sparse.linalg.splu(scipy.sparse.csc_array(matrix)).solve
        return solve
    others = np.flatnonzero(~dense)
    band = scipy.sparse.csr_matrix(matrix[others][:, others])
    order = scipy.sparse.csgraph.reverse_cuthill_mckee(band, symmetric_mode=True)
    order = np.concatenate([others[order], np.flatnonzero(dense)])
    scale = np.where(dense[order], ROUNDING, 1.0)
    ordered = scipy.sparse.diags_array(scale) @ matrix[order][:, order]
    factors = scipy.sparse.linalg.splu(scipy.sparse.csc_array(ordered), permc_spec="NATURAL")

    def solve_in_order(right: Array) -> Array:
        solution = np.empty(right.size)
        solution[order] = factors.solve(scale * right[order])
        return solution

    return solve_in_order


@dataclass(frozen=True, eq=False)
class NullSpace:
    """Variations of a program in which some variables and ``rows`` are fixed.

    Variations are relative to the scales, with weights for which the sum of squares is an integral over time; ``unit``
    (n_variables, n_variations; sparse) has the scaled variables of each. ``jacobian`` (sparse) contains the Jacobian of
    the fixed rows, scaled by the ``norms`` of their gradients, then fixed variables that variations would change, and
    additional rows.
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
