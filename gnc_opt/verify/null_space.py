"""Linear algebra on the null space of what is active: sparse projections, and the ends of spectra."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from gnc_opt.arrays import Array, Indices, Mask
from gnc_opt.solution.program_point import ProgramPoint, quadrature_weights, saddle_matrix
from gnc_opt.tolerances import TINY
from gnc_opt.transcription.transcription import Transcription
from gnc_opt.verify.stretching import factorised

SLACK, REFINEMENTS = 1e-12, 1
"""Of the rows, scaled to unit gradients, so that dependent ones do no harm, and the steps of iterative refinement by
which the others are kept all the same."""

SETTLED = 1e-4
"""Residual of the eigenvectors, beside the largest eigenvalue, at which the method ends."""

FOUND = 1e-6
"""Inverse curvatures below this, beside that of the shift, are rounding: nothing is left to vary there."""


@dataclass(frozen=True, eq=False)
class NullSpace:
    """The variations that keep some variables and rows of a program where they are.

    Variations are taken in shares of the scales, weighed such that their squares add up to an integral over time.

    Attributes
    ----------
    unit : sparse (n_variables, n_variations)
        Scaled variables per variation.
    rows : int array
        Rows of the program that do not vary.
    norms : array (n_rows,)
        Of the gradients of the rows.
    jacobian : sparse (n_rows + n_held, n_variations)
        Of the rows by the variations, scaled to unit gradients; then that of variables that do not vary, but that
        variations would move; then of what is held besides.
    """

    unit: Any
    rows: Indices
    norms: Array
    jacobian: Any

    @classmethod
    def of(cls, point: ProgramPoint, held: Mask, unit: Any = None, further: Any = None) -> NullSpace:
        """Return the space where ``held`` (n_variables + n_constraints,) do not vary.

        Parameters
        ----------
        point : ProgramPoint
        held : bool array (n_variables + n_constraints,)
        unit : sparse (n_variables, n_variations), optional
            Instead of a variation for each variable.
        further : sparse (n, n_variables), optional
            What of the scaled variables is held beside rows of the program.
        """
        held, rows = held[: point.x.size], np.flatnonzero(held[point.x.size :])
        if unit is None:
            unit = unit_variations(variation_weights(point.transcription))
        unit = unit[:, np.flatnonzero(abs(unit[~held]).sum(axis=0) > 0)]
        moved = unit[held]
        moved = moved[np.flatnonzero(abs(moved).sum(axis=1) > 0)]
        jacobian, norms = _normed(point.jacobian[rows] @ unit)
        parts = [jacobian, _normed(moved)[0]]
        if further is not None:
            parts.append(_normed(further @ unit)[0])
        return cls(unit, rows, norms, scipy.sparse.vstack(parts, format="csc"))

    @property
    def size(self) -> int:
        """Number of variations."""
        return int(self.unit.shape[1])

    def in_shares(self, hessian: Any) -> Any:
        """Return a Hessian by all scaled variables as one by the variations."""
        return scipy.sparse.csc_array(self.unit.T @ hessian @ self.unit)

    def variables(self, variation: Array) -> Array:
        """Return the change of all scaled variables."""
        return np.asarray(self.unit @ variation)

    def factorised(self, hessian: Any) -> tuple[Any, Callable[[Array], Array]]:
        """Return the saddle matrix of a Hessian and of the rows, and what solves with it, but for rounding."""
        n, m = self.size, self.jacobian.shape[0]
        matrix = saddle_matrix(hessian, self.jacobian)
        slack = scipy.sparse.diags_array(np.where(np.arange(n + m) < n, 0.0, SLACK))
        return matrix, factorised(matrix - slack)

    @cached_property
    def of_identity(self) -> tuple[Any, Callable[[Array], Array]]:
        """The same for the identity, by which variations are projected."""
        return self.factorised(scipy.sparse.eye_array(self.size))

    def projected_inverse(self, hessian: Any) -> Callable[[Array], Array]:
        """Return the inverse of a Hessian restricted to the null space."""
        return self._restricted(*self.factorised(hessian))

    @property
    def projection(self) -> Callable[[Array], Array]:
        """What projects variations to the null space."""
        return self._restricted(*self.of_identity)

    def _restricted(self, matrix: Any, solve: Callable[[Array], Array]) -> Callable[[Array], Array]:
        rows = np.zeros(self.jacobian.shape[0])

        def inverse(vector: Array) -> Array:
            right = np.concatenate([vector, rows])
            solved = solve(right)
            for _ in range(REFINEMENTS):
                solved = solved + solve(right - matrix @ solved)
            return np.asarray(solved[: vector.size])

        return inverse


def quadratic(hessian: Any, direction: Array) -> tuple[float, float]:
    """Return the curvature along a direction, and in shares of the terms that add up to it."""
    value = float(direction @ (hessian @ direction))
    terms = float(np.abs(direction) @ (abs(hessian) @ np.abs(direction)))
    return value, value / max(terms, TINY)


def lanczos(operate: Callable[[Array], Array], start: Array, steps: int) -> tuple[Array, Array]:
    """Return approximate eigenvalues (k,) and eigenvectors (n, k) of a symmetric operator.

    With full reorthogonalisation; ends early where the ends of the spectrum have settled.

    Parameters
    ----------
    operate : function of a vector (n,)
    start : array (n,)
    steps : int
    """
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
        if length <= FOUND * max(map(abs, diagonal)) or (k % 10 == 9 and _settled(diagonal, beside, length)):
            break
        beside.append(length)
        space[k + 1] = image / length
    n = len(diagonal)
    values, vectors = scipy.linalg.eigh_tridiagonal(diagonal, beside[: n - 1])
    return values, space[:n].T @ vectors


def _settled(diagonal: list[float], beside: list[float], length: float) -> bool:
    """Whether both ends of the spectrum are found, by the last components of their eigenvectors."""
    values, vectors = scipy.linalg.eigh_tridiagonal(diagonal, beside)
    return bool(np.max(length * np.abs(vectors[-1, [0, -1]])) <= SETTLED * np.max(np.abs(values)))


def _normed(rows: Any) -> tuple[Any, Array]:
    """Rows scaled to unit length, and what they have been divided by."""
    norms = np.sqrt(np.asarray((rows**2).sum(axis=1)))
    norms = np.where(norms > 0, norms, 1.0)
    return scipy.sparse.diags_array(1 / norms) @ rows, norms


def unit_variations(squares: Array) -> Any:
    """A variation of size 1 for each scaled variable (n_variables, n_variables), sparse."""
    return scipy.sparse.diags_array(1 / np.sqrt(squares), format="csc")


def variation_weights(transcription: Transcription) -> Array:
    """Weights of the squares of scaled variables in the size of a variation (n_variables,)."""
    weights, _ = quadrature_weights(transcription)
    for part in transcription.parts.values():
        collocation = part.collocation
        # States at inner boundaries follow from the points: they count by what lies beside them.
        widths = collocation.mesh.widths
        weights[collocation.boundary_states[:, 1:-1]] = 0.5 * (widths[:-1] + widths[1:])
    return weights
