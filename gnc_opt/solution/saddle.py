"""Sparse symmetric indefinite systems of first-order conditions, and what a singular one leaves undetermined."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from gnc_opt.arrays import Array
from gnc_opt.errors import GncOptError
from gnc_opt.tolerances import TINY

SINGULAR = 1e13
"""Condition number of the scaled system from which its solution has no digits to rely on."""

REFINEMENTS = 6
"""Steps of inverse iteration and of iterative refinement; each gains the digits that the factors have."""

FREE = 1e-3
"""A variable that moves by this share of the largest in a null vector is not determined."""

LAST_DIGIT = 1e-15
"""Relative residual at which refining a solution of the system ends."""

CONSISTENT, NOISE = 1e-7, 1e-13
"""Relative and absolute residual that the solution of a consistent system keeps below."""

_SHIFT = 1e-9
"""Relative shift under which a singular system is examined."""


class SaddlePoint:
    """A symmetric indefinite sparse system; redundant but consistent rows are borne, a free direction is not.

    Attributes
    ----------
    redundant : bool
        Whether the rows leave multipliers undetermined.
    """

    def __init__(self, matrix: Any, n_primal: int, labels: list[str], name: str) -> None:
        self.labels, self._n, self._name = labels, n_primal, name
        self._scale = _equilibrate(matrix)
        diagonal = scipy.sparse.diags_array(self._scale)
        self._matrix = scipy.sparse.csc_array(diagonal @ matrix @ diagonal)
        # SuperLU may write about a structurally singular matrix instead of raising.
        self.redundant = scipy.sparse.csgraph.structural_rank(self._matrix) < matrix.shape[0]
        if not self.redundant:
            try:
                self._factors = scipy.sparse.linalg.splu(self._matrix)
                self.redundant = not self._condition() < SINGULAR
            except RuntimeError:  # a pivot is exactly zero
                self.redundant = True
        if self.redundant:
            self._examine()

    def _condition(self) -> float:
        n = self._matrix.shape[0]
        inverse = scipy.sparse.linalg.LinearOperator(
            (n, n),
            matvec=self._factors.solve,
            rmatvec=lambda b: self._factors.solve(b, trans="T"),
            dtype=float,
        )
        return (
            float(scipy.sparse.linalg.onenormest(inverse) * np.max(np.abs(self._matrix).sum(axis=0)))
            if n > 1
            else 1.0
        )

    def _examine(self) -> None:
        """Find what the singular system leaves undetermined: variables (refuse) or only multipliers (accept)."""
        n = self._matrix.shape[0]
        signs = np.where(np.arange(n) < self._n, 1.0, -1.0)
        self._factors = scipy.sparse.linalg.splu(
            scipy.sparse.csc_array(self._matrix + _SHIFT * scipy.sparse.diags_array(signs))
        )
        null = np.random.default_rng(0).standard_normal(n)
        for _ in range(REFINEMENTS):
            null = self._factors.solve(null / np.max(np.abs(null)))
        null /= np.max(np.abs(null))
        if np.max(np.abs(null[: self._n]), initial=0.0) > FREE:
            culprit = self.labels[int(np.argmax(np.abs(null[: self._n])))]
            raise GncOptError(
                f"the first-order conditions of '{self._name}' do not determine '{culprit}' (the KKT system is "
                "singular): the cost must depend on it; a singular arc needs refine(solution, structure='auto') "
                "first, and a quantity that nothing depends on must be fixed."
            )

    def solve(self, right: Array) -> Array:
        """Solve with iterative refinement, which also undoes the shift of a redundant system."""
        scaled = self._scale * right
        solved = self._factors.solve(scaled)
        for _ in range(REFINEMENTS):
            rest = scaled - self._matrix @ solved
            if np.max(np.abs(rest), initial=0.0) <= LAST_DIGIT * np.max(np.abs(scaled), initial=TINY):
                break
            solved = solved + self._factors.solve(rest)
        rest = scaled - self._matrix @ solved
        if not np.max(np.abs(rest), initial=0.0) <= CONSISTENT * np.max(np.abs(scaled), initial=TINY) + NOISE:
            culprit = self.labels[int(np.argmax(np.abs(rest)))]
            raise GncOptError(
                f"the limits of '{self._name}' that are active leave no room for its constraints, at '{culprit}': "
                "settle bang-bang arcs with refine(solution, structure='auto') first, or free a boundary value that is "
                "given twice."
            )
        return np.asarray(solved * self._scale)


def _equilibrate(matrix: Any) -> Array:
    """Return symmetric scale factors that bring the largest entry of every row near 1."""
    scale = np.ones(matrix.shape[0])
    absolute = scipy.sparse.coo_array(np.abs(matrix))
    for _ in range(4):
        norms = np.zeros(scale.size)
        np.maximum.at(norms, absolute.row, absolute.data * scale[absolute.row] * scale[absolute.col])
        scale = scale / np.sqrt(np.where(norms > 0, norms, 1.0))
    return scale
