r"""Partially separable nonlinear programs: sums of many small functions.

The rows r = (f, g) of the program, its objective and its constraints, have the form

.. math:: r(x) = C x + \sum_b W_b \, \mathrm{vec}\, [F_b(Z_{b1} x, d_{b1}), F_b(Z_{b2} x, d_{b2}), \dots]

with constant sparse matrices C and W and index maps Z. Collocation has this form: F is the dynamics at a point, W
contains step sizes and quadrature weights. Only F is differentiated, once and symbolically; Jacobian and Hessian of the
program are linear in its derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.array_types import Array, Indices


@dataclass(frozen=True)
class PointFunction:
    """Small vector function F(z, d) with its derivatives as CasADi Functions.

    Attributes
    ----------
    value, jacobian : casadi.Function
        Maps (z, d) to F, shape (n_rows, 1), or to the dense vector of the nonzeros of dF/dz.
    hessian : casadi.Function
        Maps (z, d, m) to the dense vector of the nonzeros of the upper triangle of d2(m.F)/dz2.
    jacobian_pattern, hessian_pattern : (rows, columns)
        Indices of these nonzeros.
    """

    value: Any
    jacobian: Any
    hessian: Any
    jacobian_pattern: tuple[Indices, Indices]
    hessian_pattern: tuple[Indices, Indices]

    @classmethod
    def from_expression(cls, name: str, z: Any, d: Any, expression: Any) -> PointFunction:
        """Return the function and its derivatives from an SX expression in z; d is not differentiated."""
        expression = ca.cse(expression)  # models often repeat subexpressions, such as rotations
        multiplier = ca.SX.sym("multiplier", expression.shape[0])
        jacobian = ca.jacobian(expression, z)
        hessian = ca.triu(ca.hessian(ca.dot(multiplier, expression), z)[0])
        value = ca.densify(expression)
        return cls(
            ca.Function(name, [z, d], [value]),
            ca.Function(f"{name}_jacobian", [z, d], [value, _stack_nonzero_expressions(jacobian)]),
            ca.Function(f"{name}_hessian", [z, d, multiplier], [_stack_nonzero_expressions(hessian)]),
            _list_nonzero_positions(jacobian),
            _list_nonzero_positions(hessian),
        )

    @property
    def n_rows(self) -> int:
        return int(self.value.size1_out(0))


@dataclass(frozen=True)
class PointTerm:
    """Small function evaluated at many points of the program.

    Attributes
    ----------
    variables : int array (n_z, n_points)
        Z: index of the program variable of each argument; indices >= the number of variables are constants.
    data : casadi.MX (n_d, n_points)
        d: constants and program parameters.
    weights : scipy.sparse.csc_array (rows of the program, n_rows * n_points)
        W: column r + n_rows * j belongs to row r of F at point j.
    """

    function: PointFunction
    variables: Indices
    data: Any
    weights: Any

    @property
    def n_points(self) -> int:
        return int(self.variables.shape[1])


@dataclass(frozen=True)
class SeparableProgram:
    """Rows of a partially separable program in physical units; ``linear`` is C, (n_rows, n_variables)."""

    linear: Any
    blocks: tuple[PointTerm, ...]

    @property
    def n_rows(self) -> int:
        return int(self.linear.shape[0])

    @property
    def n_variables(self) -> int:
        return int(self.linear.shape[1])

    def select_constraint_rows(self, first: int, end: int) -> SeparableProgram:
        """Return the rows from ``first`` to ``end``, with the blocks that they contain."""
        parts = [
            replace(b, weights=scipy.sparse.csc_array(b.weights.tocsr()[first:end])) for b in self.blocks
        ]
        linear = scipy.sparse.coo_array(self.linear.tocsr()[first:end])
        return SeparableProgram(linear, tuple(part for part in parts if part.weights.nnz))

    def evaluate_constraint_rows(self, x: Any, constants: Any) -> Any:
        """Return the MX column vector of the rows at x; ``constants`` extends x for indices beyond it."""
        extended = ca.vertcat(x, constants)
        linear, weights = self._linear_coefficient_matrices
        total = linear @ x
        for block, weight in zip(self.blocks, weights, strict=True):
            outputs = block.function.value.map(block.n_points)(
                _select_collocation_point_variables(extended, block), block.data
            )
            total += weight @ ca.vec(outputs)
        return ca.densify(total)

    def evaluate_constraints_and_jacobian(self, x: Any, constants: Any) -> tuple[Any, Any]:
        """Return the rows and the MX vector of the nonzeros of dr/dx, in the order of `jacobian_pattern`."""
        extended = ca.vertcat(x, constants)
        _, constant, scatters = self._jacobian_sparsity_and_scatter
        linear, weights = self._linear_coefficient_matrices
        values, entries = linear @ x, ca.MX(ca.DM(constant))
        for block, weight, scatter in zip(self.blocks, weights, scatters, strict=True):
            outputs, nonzeros = block.function.jacobian.map(block.n_points)(
                _select_collocation_point_variables(extended, block), block.data
            )
            values += weight @ ca.vec(outputs)
            entries += convert_scipy_to_casadi(scatter) @ ca.vec(nonzeros)
        return ca.densify(values), entries

    def evaluate_hessian(self, x: Any, constants: Any, multipliers: Any) -> Any:
        """Return the MX nonzeros of the upper triangle of the Hessian of ``multipliers . r``."""
        extended = ca.vertcat(x, constants)
        pattern, scatters = self._hessian_sparsity_and_scatter
        total = ca.MX(pattern[0].size, 1)
        for block, scatter in zip(self.blocks, scatters, strict=True):
            local = ca.reshape(
                convert_scipy_to_casadi(block.weights.T) @ multipliers, block.function.n_rows, block.n_points
            )
            nonzeros = block.function.hessian.map(block.n_points)(
                _select_collocation_point_variables(extended, block), block.data, local
            )
            total += convert_scipy_to_casadi(scatter) @ ca.vec(nonzeros)
        return ca.densify(total)

    @property
    def jacobian_pattern(self) -> tuple[Indices, Indices]:
        """Rows and columns of the Jacobian's nonzeros, column-major."""
        return self._jacobian_sparsity_and_scatter[0]

    @property
    def hessian_pattern(self) -> tuple[Indices, Indices]:
        """Rows and columns of the Hessian's upper-triangle nonzeros, column-major."""
        return self._hessian_sparsity_and_scatter[0]

    @cached_property
    def _linear_coefficient_matrices(self) -> tuple[Any, list[Any]]:
        return convert_scipy_to_casadi(self.linear), [
            convert_scipy_to_casadi(block.weights) for block in self.blocks
        ]

    @cached_property
    def _jacobian_sparsity_and_scatter(self) -> tuple[tuple[Indices, Indices], Array, list[Any]]:
        entries = [_list_jacobian_nonzeros(block, self.n_variables) for block in self.blocks]
        linear = self.linear
        keys = [e.rows + self.n_rows * e.columns for e in entries]
        linear_keys = linear.row.astype(np.int64) + self.n_rows * linear.col.astype(np.int64)
        unique = _sort_unique_nonzero_positions([linear_keys, *keys])
        constant = np.zeros(unique.size)
        np.add.at(constant, np.searchsorted(unique, linear_keys), linear.data)
        scatters = [
            e.build_scatter_matrix(np.searchsorted(unique, k), unique.size)
            for e, k in zip(entries, keys, strict=True)
        ]
        pattern = (unique % self.n_rows, unique // self.n_rows)
        return pattern, constant, scatters

    @cached_property
    def _hessian_sparsity_and_scatter(self) -> tuple[tuple[Indices, Indices], list[Any]]:
        entries = [_list_hessian_nonzeros(block, self.n_variables) for block in self.blocks]
        keys = [e.rows + self.n_variables * e.columns for e in entries]
        unique = _sort_unique_nonzero_positions(keys)
        scatters = [
            e.build_scatter_matrix(np.searchsorted(unique, k), unique.size)
            for e, k in zip(entries, keys, strict=True)
        ]
        return (unique % self.n_variables, unique // self.n_variables), scatters


@dataclass(frozen=True)
class _Nonzeros:
    """Contributions of a block's nonzeros to the global ones: global index, local source, factor."""

    rows: Indices
    columns: Indices
    sources: Indices
    factors: Array
    n_sources: int

    def build_scatter_matrix(self, places: Indices, size: int) -> Any:
        """Return the sparse matrix (size, n_sources) that maps local nonzeros to global ones."""
        return scipy.sparse.csc_array((self.factors, (places, self.sources)), shape=(size, self.n_sources))


def _list_jacobian_nonzeros(block: PointTerm, n_variables: int) -> _Nonzeros:
    rows, columns = block.function.jacobian_pattern
    n_points, n_local = block.n_points, rows.size
    outputs = (rows[:, None] + block.function.n_rows * np.arange(n_points)[None, :]).ravel(order="F")
    variables = block.variables[columns, :].ravel(order="F")
    keep = np.flatnonzero(variables < n_variables)
    starts, ends = block.weights.indptr[outputs[keep]], block.weights.indptr[outputs[keep] + 1]
    counts = ends - starts
    sources = np.repeat(keep, counts)
    positions = np.repeat(starts - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts) + np.arange(
        counts.sum()
    )
    return _Nonzeros(
        block.weights.indices[positions].astype(np.int64),
        variables[sources].astype(np.int64),
        sources.astype(np.int64),
        block.weights.data[positions],
        n_local * n_points,
    )


def _list_hessian_nonzeros(block: PointTerm, n_variables: int) -> _Nonzeros:
    rows, columns = block.function.hessian_pattern
    first = block.variables[rows, :].ravel(order="F")
    second = block.variables[columns, :].ravel(order="F")
    keep = np.flatnonzero((first < n_variables) & (second < n_variables))
    low, high = np.minimum(first, second)[keep], np.maximum(first, second)[keep]
    # Two arguments from one variable: both off-diagonal entries contribute to the diagonal.
    off_diagonal = np.tile(rows != columns, block.n_points)[keep]
    factors = np.where((low == high) & off_diagonal, 2.0, 1.0)
    return _Nonzeros(low.astype(np.int64), high.astype(np.int64), keep.astype(np.int64), factors, first.size)


def _sort_unique_nonzero_positions(keys: list[Indices]) -> Indices:
    """Return the distinct keys in order; several times faster than numpy.unique."""
    ordered = np.sort(np.concatenate([np.zeros(0, dtype=np.int64), *keys]))
    return ordered[np.append(True, ordered[1:] != ordered[:-1])] if ordered.size else ordered


def _select_collocation_point_variables(extended: Any, block: PointTerm) -> Any:
    n_z, n_points = block.variables.shape
    return ca.reshape(extended[block.variables.ravel(order="F").tolist()], n_z, n_points)


def convert_scipy_to_casadi(matrix: Any) -> Any:
    """Convert a sparse scipy matrix to CasADi DM."""
    csc = scipy.sparse.csc_array(matrix)
    csc.sum_duplicates()
    csc.sort_indices()
    pattern = ca.Sparsity(*csc.shape, csc.indptr.tolist(), csc.indices.tolist())
    return ca.DM(pattern, csc.data.tolist())  # arrays are converted entry by entry


def convert_casadi_to_scipy(matrix: Any) -> Any:
    """Convert a sparse CasADi DM to scipy."""
    pattern = matrix.sparsity()
    return scipy.sparse.csc_array((matrix.nonzeros(), pattern.row(), pattern.colind()), shape=matrix.shape)


def _stack_nonzero_expressions(expression: Any) -> Any:
    return ca.SX(ca.vertcat(*expression.nonzeros())) if expression.nnz() else ca.SX(0, 1)


def _list_nonzero_positions(expression: Any) -> tuple[Indices, Indices]:
    rows, columns = expression.sparsity().get_triplet()
    return np.asarray(rows, dtype=np.int64), np.asarray(columns, dtype=np.int64)
