r"""Sampled-data plant and cost: exact discretisation for a zero-order hold; step counters, poles of sampled loops.

With :math:`\dot\xi = M \xi`, :math:`\xi = (e, v)`, M = [[A, B], [0, 0]] and cost rate :math:`\xi^T W \xi`, the flow of

.. math:: \dot Z = \begin{pmatrix} -M^T & W \\ 0 & M \end{pmatrix} Z, \qquad Z(0) = 1,

has the blocks :math:`Z_{22} = \Psi` (the step) and :math:`\Psi^T Z_{12} = \int \Psi^T W \Psi` (its cost).

Sources: C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE Trans. Autom. Control 23
(1978). S. Blanes et al., The Magnus expansion and some of its applications, Physics Reports 470 (2009), eq. 253.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, DesignError
from gnc_opt.numerical_tolerances import EQUAL, SAME_TIME


def count_steps_in_duration(duration: float, step: float, what: str) -> int:
    """Return the number of steps in a duration (s); raise an error if it is not a whole number."""
    count = round(duration / step)
    if count < 0 or abs(count * step - duration) > SAME_TIME * max(step, duration):
        raise ArgumentError(
            f"{what} is {duration:g} s, not a multiple of the step of {step:g} s: choose one."
        )
    return count


def count_steps_started_within_duration(duration: float, step: float) -> int:
    """Return the number of steps that begin within a duration (s)."""
    return math.ceil(duration / step - SAME_TIME)


def is_step_counter_zero(phase: Any) -> Any:
    """Return whether a step counter (SX) is 0."""
    return phase < 0.5


def advance_step_counter(phase: Any, count: int) -> Any:
    """Return the step counter (SX) after a step, modulo ``count``."""
    return ca.if_else(phase > count - 1.5, 0.0, phase + 1)


def sort_symbolic_times(times: Sequence[Any]) -> list[Any]:
    """Return SX scalars in ascending order."""
    times = list(times)
    for last in range(len(times) - 1, 0, -1):
        for i in range(last):
            times[i], times[i + 1] = ca.fmin(times[i], times[i + 1]), ca.fmax(times[i], times[i + 1])
    return times


def compute_characteristic_polynomial(poles: Any) -> Array | None:
    """Return the coefficients (n + 1,), highest order first, of the polynomial with these roots."""
    polynomial = np.atleast_1d(np.poly(poles))
    if np.any(np.abs(polynomial.imag) > EQUAL * np.abs(polynomial)):
        return None
    return np.asarray(polynomial.real, dtype=float)


_ROUNDING = float(np.finfo(float).eps)


def convert_to_continuous_poles(poles: Any, dt: float | None) -> Any:
    """Return poles as rates (1/s): ``ln(z)/dt`` for a loop sampled with dt (s)."""
    if dt is None:
        return poles
    sampled = np.asarray(poles, dtype=complex)
    rates, is_nonzero = np.full(sampled.shape, complex(-np.inf)), np.abs(sampled) > _ROUNDING
    rates[is_nonzero] = np.log(sampled[is_nonzero]) / dt
    return rates


Linearization = Callable[[Array], tuple[Array, Array]]
"""A (k, n, n) and B (k, n, m) at times (k,)."""

_SUBSTEPS = 2


@dataclass(frozen=True, eq=False)
class SampledStep:
    """``e_next = a e + b v`` with the cost ``e'q e + v'r v + 2 e'n v`` over one control step."""

    a: Array
    b: Array
    q: Array
    r: Array
    n: Array


def discretize_plant_and_cost(a: Array, b: Array, q: Array, r: Array, n: Array, dt: float) -> SampledStep:
    """Return the exact discretisation of constant A, B and cost over dt (s)."""
    flow = _build_van_loan_matrix(a, b, _stack_cost_matrix(q, r, n))
    size = float(np.linalg.norm(flow[flow.shape[0] // 2 :], 1)) * dt  # of M only: the cost enters linearly
    halvings = max(0, int(np.ceil(np.log2(max(size, 1.0)))))
    phi, cost = _compute_transition_matrix_and_cost(scipy.linalg.expm(flow * (dt / 2**halvings)))
    with np.errstate(over="ignore", invalid="ignore"):  # `_build_discretized_plant_and_cost` rejects overflow
        for _ in range(halvings):  # doubling never multiplies growing by decaying exponentials
            cost = cost + phi.T @ cost @ phi
            phi = phi @ phi
    return _build_discretized_plant_and_cost(phi, cost, a.shape[0], dt)


def discretize_time_varying_plant(
    linearize: Linearization, q: Array, r: Array, n: Array, t: float, dt: float, jumps: Array
) -> SampledStep:
    """Return the discretisation of A(t), B(t) from t to t + dt, with jumps at ``jumps`` (order 4 in dt)."""
    inner = jumps[(jumps > t) & (jumps < t + dt)]
    edges = np.concatenate([[t], inner, [t + dt]])
    steps = np.repeat(np.diff(edges) / _SUBSTEPS, _SUBSTEPS)
    middles = np.repeat(edges[:-1], _SUBSTEPS) + steps * np.tile(np.arange(_SUBSTEPS) + 0.5, edges.size - 1)
    a, b = linearize((middles[:, None] + steps[:, None] * np.sqrt(3) / 6 * [-1.0, 1.0]).ravel())
    weight = _stack_cost_matrix(q, r, n)
    phi, cost = np.eye(len(weight)), np.zeros_like(weight)
    for k, h in enumerate(steps):
        first, second = (_build_van_loan_matrix(a[i], b[i], weight) for i in (2 * k, 2 * k + 1))
        commutator = second @ first - first @ second
        exponent = 0.5 * h * (first + second) + np.sqrt(3) / 12 * h**2 * commutator
        step, part = _compute_transition_matrix_and_cost(scipy.linalg.expm(exponent))
        cost = cost + phi.T @ part @ phi
        phi = step @ phi
    return _build_discretized_plant_and_cost(phi, cost, q.shape[0], dt)


def discretize_zero_order_hold(a: Array, b: Array, dt: float) -> tuple[Array, Array]:
    """Return the discrete plant (A, B) of a zero-order hold over dt (s)."""
    n, m = b.shape
    exponential = scipy.linalg.expm(np.block([[a, b], [np.zeros((m, n + m))]]) * dt)
    return exponential[:n, :n], exponential[:n, n:]


def compute_spectral_radius(matrix: Array) -> float:
    """Return the largest magnitude of the eigenvalues; a sampled loop is stable if it is below 1."""
    return float(np.max(np.abs(np.linalg.eigvals(matrix))))


def _stack_cost_matrix(q: Array, r: Array, n: Array) -> Array:
    return np.block([[q, n], [n.T, r]])


def _build_van_loan_matrix(a: Array, b: Array, weight: Array) -> Array:
    size = weight.shape[0]
    m = np.zeros((size, size))
    m[: a.shape[0]] = np.hstack([a, b])
    return np.block([[-m.T, weight], [np.zeros((size, size)), m]])


def _compute_transition_matrix_and_cost(flow: Array) -> tuple[Array, Array]:
    size = flow.shape[0] // 2
    phi = flow[size:, size:]
    cost = phi.T @ flow[:size, size:]
    return phi, 0.5 * (cost + cost.T)


def _build_discretized_plant_and_cost(phi: Array, cost: Array, n: int, dt: float) -> SampledStep:
    if not (np.all(np.isfinite(phi)) and np.all(np.isfinite(cost))):
        raise DesignError(
            f"the plant's transition matrix overflows over a control step of {dt:g} s: design with a shorter step."
        )
    return SampledStep(phi[:n, :n], phi[:n, n:], cost[:n, :n], cost[n:, n:], cost[:n, n:])
