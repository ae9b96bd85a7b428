r"""Algebraic Riccati equations: the gain of the linear-quadratic regulator, and its existence.

Continuous, cost :math:`\int e^T Q e + v^T R v + 2 e^T N v \, dt`:

.. math:: A^T P + P A - K^T R K + Q = 0, \qquad K = R^{-1} (B^T P + N^T), \qquad v = -K e .

Sampled: :math:`P = A^T P A - K^T (R + B^T P B) K + Q`, :math:`K = (R + B^T P B)^{-1} (B^T P A + N^T)`.

A stabilising P exists if no mode on or outside the stability boundary is uncontrollable (then: not stabilisable) or
without cost (then: not detectable). Both are tested in balanced coordinates.

Source: B. D. O. Anderson, J. B. Moore, Optimal Control: Linear Quadratic Methods (1990), chapters 2 and 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from gnc_opt.array_types import Array
from gnc_opt.control.design_report import format_number
from gnc_opt.control.sampled_data_discretization import SampledStep
from gnc_opt.errors import DesignError
from gnc_opt.numerical_tolerances import EQUAL, TINY

_REACHABILITY_MIN = 1e-10
"""Smallest entry of the reachability matrix in balanced coordinates that counts as nonzero."""
_PART = 0.3
"""Smallest share of a state in a mode, relative to the largest, at which an error message names it."""


@dataclass(frozen=True, eq=False)
class LqrSolution:
    """Steady Riccati solution: gain K, cost to go P (``e'P e``), poles of A - B K, residual."""

    gain: Array
    cost: Array
    poles: Any
    residual: float


@dataclass(frozen=True, eq=False)
class UncontrollableMode:
    """Uncontrollable mode: its eigenvalue, its states, and the smallest singular value of [lambda 1 - A, B]."""

    eigenvalue: complex
    states: tuple[str, ...]
    rank_gap: float


def solve_algebraic_riccati(
    a: Array, b: Array, q: Array, r: Array, n: Array, labels: tuple[str, ...], *, sampled: bool = False
) -> LqrSolution:
    """Return the stabilising solution; raise `DesignError` with the mode that prevents it."""
    require_stabilizable(a, b, labels, sampled=sampled)
    cross = np.linalg.solve(r, n.T)
    require_detectable(a - b @ cross, q - n @ cross, labels, sampled=sampled)
    solve = scipy.linalg.solve_discrete_are if sampled else scipy.linalg.solve_continuous_are
    try:
        p = solve(a, b, q, r, s=n)
    except (scipy.linalg.LinAlgError, ValueError) as error:
        raise DesignError(
            f"the Riccati equation has no stabilising solution ({error}): choose weights of errors and controls that "
            "differ less, or scale the model's units."
        ) from error
    gain = compute_lqr_gain(a, b, r, n, p, sampled=sampled)
    poles = np.linalg.eigvals(a - b @ gain)
    size = np.abs(poles) if sampled else poles.real
    if not np.all(size < (1.0 if sampled else 0.0)):
        raise DesignError(
            f"the solution of the Riccati equation has an unstable closed-loop pole at {poles[np.argmax(size)]:.3g}: "
            "choose weights of errors and controls that differ less, or scale the model's units."
        )
    order = np.argsort(-size)
    return LqrSolution(gain, p, poles[order], compute_riccati_residual(a, b, q, r, n, p, sampled=sampled))


def compute_lqr_gain(a: Array, b: Array, r: Array, n: Array, p: Array, *, sampled: bool) -> Array:
    """Return the gain K (n_controls, n_errors) for the cost to go P (of the next step, if sampled)."""
    if sampled:
        return np.asarray(np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a + n.T))
    return np.asarray(np.linalg.solve(r, b.T @ p + n.T))


def step_riccati_backward(step: SampledStep, p: Array) -> tuple[Array, Array]:
    """Return K of a control step and the cost to go at its start, from the cost to go P at its end."""
    gain = compute_lqr_gain(step.a, step.b, step.r, step.n, p, sampled=True)
    before = step.q + step.a.T @ p @ step.a - (step.b.T @ p @ step.a + step.n.T).T @ gain
    return gain, 0.5 * (before + before.T)


def compute_riccati_residual(
    a: Array, b: Array, q: Array, r: Array, n: Array, p: Array, *, sampled: bool
) -> float:
    """Return the largest entry of the Riccati equation's left side relative to its largest term."""
    gain = compute_lqr_gain(a, b, r, n, p, sampled=sampled)
    quadratic = gain.T @ (r + b.T @ p @ b if sampled else r) @ gain
    terms = [a.T @ p @ a, -p, -quadratic, q] if sampled else [a.T @ p, p @ a, -quadratic, q]
    diagonal = np.sqrt(np.maximum(np.diag(p), TINY))
    scale = np.outer(diagonal, diagonal)
    largest = max(np.max(np.abs(term) / scale) for term in terms)
    return float(np.max(np.abs(sum(terms)) / scale) / largest) if largest > 0 else 0.0


def require_stabilizable(a: Array, b: Array, labels: tuple[str, ...], *, sampled: bool = False) -> None:
    """Raise `DesignError` if an uncontrollable mode does not decay."""
    for mode in find_uncontrollable_modes(a, b, labels):
        if not _is_decaying_eigenvalue(mode.eigenvalue, a, sampled):
            raise DesignError(
                f"the plant is not stabilisable: no control reaches the mode with eigenvalue "
                f"{format_number(mode.eigenvalue)}{'' if sampled else ' 1/s'} in {_quote_mode_names(mode.states)} "
                f"(smallest singular value of [lambda - A, B]: "
                f"{mode.rank_gap:.2g}); give those states a control, or leave them out of the design."
            )


def require_detectable(a: Array, q: Array, labels: tuple[str, ...], *, sampled: bool) -> None:
    """Raise `DesignError` if a mode that does not decay has no cost."""
    for mode in find_uncontrollable_modes(a.T, q.T, labels):
        if not _is_decaying_eigenvalue(mode.eigenvalue, a, sampled):
            raise DesignError(
                f"the weights are not detectable: the mode with eigenvalue "
                f"{format_number(mode.eigenvalue)}{'' if sampled else ' 1/s'} in {_quote_mode_names(mode.states)} "
                "costs nothing and does not decay "
                f"(smallest singular value of [lambda - A; Q]: {mode.rank_gap:.2g}); give one of those states a weight."
            )


def find_uncontrollable_modes(a: Array, b: Array, labels: tuple[str, ...]) -> list[UncontrollableMode]:
    """Return the modes of ``de/dt = A e + B v`` that v does not control, from the staircase form."""
    size = a.shape[0]
    balanced, scale = _balance_matrix_by_diagonal_similarity(a)
    balanced = balanced / max(float(np.linalg.norm(balanced, 2)), TINY)
    rate = np.linalg.norm(_balance_matrix_by_diagonal_similarity(a)[0], 2)
    inputs = b / scale[:, None]
    length = np.linalg.norm(inputs, axis=0)
    inputs = inputs[:, length > 0] / length[length > 0]
    controllable = scipy.linalg.orth(inputs, rcond=_REACHABILITY_MIN) if inputs.size else np.zeros((size, 0))
    added = controllable
    while added.shape[1] and controllable.shape[1] < size:
        image = balanced @ added
        image -= controllable @ (controllable.T @ image)
        image -= controllable @ (controllable.T @ image)  # twice: orthogonal to rounding
        u, s, _ = np.linalg.svd(image, full_matrices=False)
        added = u[:, s > _REACHABILITY_MIN]
        controllable = np.hstack([controllable, added])
    if controllable.shape[1] >= size:
        return []
    unreachable = np.linalg.svd(controllable, full_matrices=True)[0][:, controllable.shape[1] :]
    block = unreachable.T @ balanced @ unreachable
    eigenvalues, left_vectors = np.linalg.eig(block.T)
    modes = []
    for eigenvalue, vector in zip(eigenvalues, left_vectors.T, strict=True):
        share = np.abs(unreachable @ vector)
        pencil = np.hstack([eigenvalue * np.eye(size) - balanced, inputs])
        gap = float(np.linalg.svd(pencil, compute_uv=False)[-1])
        states = tuple(label for label, s in zip(labels, share, strict=True) if s > _PART * share.max())
        modes.append(UncontrollableMode(complex(eigenvalue * rate), states, gap))
    return modes


def _balance_matrix_by_diagonal_similarity(a: Array) -> tuple[Array, Array]:
    """Return ``a`` balanced by a diagonal similarity transformation, and its scales (n,), powers of two."""
    with np.errstate(invalid="ignore"):
        balanced, (scale, _) = scipy.linalg.matrix_balance(a, permute=False, separate=True)
    return balanced, scale


def _is_decaying_eigenvalue(eigenvalue: complex, a: Array, sampled: bool) -> bool:
    if sampled:
        return abs(eigenvalue) < 1 - EQUAL
    rate = float(np.linalg.norm(_balance_matrix_by_diagonal_similarity(a)[0], 2))
    return eigenvalue.real < -EQUAL * rate


def _quote_mode_names(names: tuple[str, ...]) -> str:
    return ", ".join(f"'{name}'" for name in names)
