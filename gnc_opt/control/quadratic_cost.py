"""Weights of quadratic costs, as matrices or by name in engineering units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array, require_type
from gnc_opt.array_types import Array
from gnc_opt.control.design_report import ReportEntry
from gnc_opt.control.reference_trajectory import Reference
from gnc_opt.errors import ArgumentError, DesignError
from gnc_opt.model.model_variables import Layout, format_names_with_units, read_vector
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.numerical_tolerances import ROUNDING, max_norm, replace_zeros_by_one

Weight: TypeAlias = ArrayLike | Mapping[str, ArrayLike]
"""Matrix (n, n), diagonal (n,), one number for all, or diagonal entries by name (missing names weigh 0)."""


def bryson(layout: Layout, /, **largest: ArrayLike) -> dict[str, float | Array]:
    """Return the weights :math:`1/x_{max}^2` of Bryson's rule, by name, for ``Q=`` and ``R=``.

    Parameters
    ----------
    layout : Layout
        ``model.states``, ``model.errors`` or ``model.controls``; defines the valid names.
    **largest : float or array
        Largest acceptable deviation of a variable in its own unit, > 0; one number or one per component.

    Raises
    ------
    UnknownNameError, ArgumentError
        A name that the layout does not contain; a value that is not positive and finite.

    Examples
    --------
    >>> Q = bryson(cart.states, q=0.1, v=0.01)
    >>> R = bryson(cart.controls, a=5.0)
    """
    require_type(layout, Layout, "the layout of bryson()", "write bryson(model.states, ...)")
    weights: dict[str, float | Array] = {}
    for name, value in largest.items():
        layout.slice(name)
        array = read_float_array(value, f"the largest acceptable '{name}'")
        if array.ndim > 1 or array.size == 0 or not np.all(np.isfinite(array) & (array > 0)):
            raise ArgumentError(
                f"the largest acceptable '{name}' is {value!r}: give positive finite numbers, in its unit."
            )
        weights[name] = float(array**-2) if array.ndim == 0 else array**-2
    return weights


class QuadraticCost(NamedTuple):
    """Matrices of the cost rate ``e'q e + v'r v + 2 e'n v``."""

    q: Array
    r: Array
    n: Array


def read_quadratic_cost(model: Model, q: Weight, r: Weight, n: ArrayLike | None) -> QuadraticCost:
    """Return Q, R, N as matrices; raise `DesignError` unless the cost is positive semidefinite and R definite."""
    errors, controls = model.errors, model.controls
    weight, effort = (
        read_weight_matrix(q, errors, "the weight Q"),
        read_weight_matrix(r, controls, "the weight R"),
    )
    require_semidefinite(weight, errors.labels, "the weight Q")
    require_definite(effort, controls.labels, "the weight R")
    shape = (errors.size, controls.size)
    cross = np.zeros(shape) if n is None else np.asarray(n, dtype=float)
    if cross.shape != shape or not np.all(np.isfinite(cross)):
        raise ArgumentError(
            f"the weight N has the shape {cross.shape}: give finite numbers of the shape {shape}."
        )
    if n is not None:
        weights = np.block([[weight, cross], [cross.T, effort]])
        require_semidefinite(weights, errors.labels + controls.labels, "the weight [[Q, N], [N', R]]")
    return QuadraticCost(weight, effort, cross)


def report_quadratic_cost(cost: QuadraticCost, reference: Reference) -> list[ReportEntry]:
    """Return the report entries of a reference and of the weights, diagonal ones by their diagonals."""
    model, facts = reference.model, [ReportEntry("reference", reference.description)]
    errors, controls = (
        format_names_with_units(layout.variables) for layout in (model.errors, model.controls)
    )
    remarks = {"Q": f"errors of {errors}", "R": controls, "N": "rows: errors; columns: controls"}
    for (name, remark), weight in zip(remarks.items(), cost, strict=True):
        if name != "N" and np.array_equal(weight, np.diag(np.diag(weight))):
            facts.append(ReportEntry(f"weight {name}", np.diag(weight), "", f"diagonal; {remark}"))
        elif np.any(weight):
            facts.append(ReportEntry(f"weight {name}", weight, "", remark))
    return facts


def read_weight_matrix(value: Weight, layout: Layout, what: str) -> Array:
    """Return a symmetric matrix (n, n) of finite numbers, n the size of the layout."""
    n = layout.size
    if isinstance(value, Mapping):
        diagonal = np.zeros(n)
        for name, entry in value.items():
            rows = layout.slice(name)
            diagonal[rows] = read_vector(entry, layout[name].size, f"{what} of '{name}'", ArgumentError)
        matrix = np.diag(diagonal)
    else:
        matrix = read_float_array(value, what)
        if matrix.ndim < 2:
            matrix = np.diag(read_vector(matrix, n, what, ArgumentError))
    if matrix.shape != (n, n):
        raise ArgumentError(
            f"{what} has the shape {matrix.shape}: give ({n}, {n}), in the order {layout.labels}."
        )
    if not np.all(np.isfinite(matrix)):
        raise ArgumentError(f"{what} has entries that are not finite: give numbers.")
    if max_norm(matrix - matrix.T) > ROUNDING * max_norm(matrix):
        raise DesignError(f"{what} is not symmetric: give (W + W.T) / 2, which has the same quadratic form.")
    return np.asarray(0.5 * (matrix + matrix.T))


def require_semidefinite(weight: Array, labels: tuple[str, ...], what: str) -> None:
    """Raise `DesignError` with the smallest eigenvalue unless the weight is positive semidefinite."""
    smallest = _find_smallest_relative_eigenvalue(weight, labels, what, strict=False)
    if smallest < -ROUNDING * len(labels):
        raise DesignError(
            f"{what} is not positive semidefinite: with its diagonal scaled to one its smallest eigenvalue is "
            f"{smallest:.3g}; choose weights that penalise every error."
        )


def require_definite(weight: Array, labels: tuple[str, ...], what: str) -> None:
    """Raise `DesignError` with the smallest eigenvalue unless the weight is positive definite."""
    smallest = _find_smallest_relative_eigenvalue(weight, labels, what, strict=True)
    if smallest <= ROUNDING * len(labels):
        raise DesignError(
            f"{what} is not positive definite: with its diagonal scaled to one its smallest eigenvalue is "
            f"{smallest:.3g}; every combination of controls must cost something."
        )


def _find_smallest_relative_eigenvalue(
    weight: Array, labels: tuple[str, ...], what: str, *, strict: bool
) -> float:
    diagonal = np.diag(weight)
    invalid = np.flatnonzero(diagonal <= 0 if strict else diagonal < 0)
    if invalid.size:
        raise DesignError(
            f"{what} of '{labels[invalid[0]]}' is {diagonal[invalid[0]]:g}: give a number {'>' if strict else '>='} 0."
        )
    scale = np.sqrt(replace_zeros_by_one(diagonal))
    # a zero on the diagonal requires a zero row; such a row is scaled by its largest entry
    empty = diagonal == 0
    if np.any(empty):
        largest = np.max(
            np.abs(weight) / np.outer(np.where(empty, 1.0, scale), np.where(empty, 1.0, scale)), axis=1
        )
        scale = np.where(empty & (largest > 0), largest, scale)
    return float(np.min(np.linalg.eigvalsh(weight / np.outer(scale, scale)), initial=1.0))
