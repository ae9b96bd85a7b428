r"""The flow of a bang-bang control, and its first two derivatives in switch times and start.

The flow is a chain of integration steps, :math:`y_{j+1} = M_j(y_j, h_j)`, with the state y of the phase, its
integrals, the time and the free parameters, and the width h of a step. With the sensitivities
:math:`S_j = dy_j/d\theta` and :math:`D_j = (S_j, dh_j/d\theta)`,

.. math:: S_{j+1} = M_j' D_j, \qquad
          \frac{d^2 (p^T y_N)}{d\theta^2} = \sum_j D_j^T (p_{j+1}^T M_j'') D_j, \qquad
          p_j = \Big(\frac{\partial M_j}{\partial y_j}\Big)^T p_{j+1}, \quad p_N = p

(Bryson & Ho, Applied Optimal Control, 1975, ch. 2). A step in turn is a chain of four stages, differentiated alike:
only the rates are differentiated symbolically, once per problem; the rest is arithmetic on all steps at once, and
exact for the discretised flow.

A piece may have no length: it then tells what a control between two switches at one time would do if they came apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array, Indices
from gnc_opt.model.evaluation import evaluate_chain, evaluate_columns
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.samples import PhaseSamples

STEPS = 100
"""Runge-Kutta steps over the phase on the coarsest grid, and at least `LEAST_STEPS` from switch to switch."""

LEAST_STEPS = 2


@dataclass(frozen=True)
class Pieces:
    """A control that is constant on pieces of a phase.

    Attributes
    ----------
    times : array (n_pieces + 1,)
        Ends of the pieces (s), not decreasing.
    controls : array (n_controls, n_pieces)
    unknowns : int array (n_pieces + 1,)
        Which unknown each end is.
    """

    times: Array
    controls: Array
    unknowns: Indices


@dataclass(frozen=True, eq=False)
class BangBangFlow:
    """The end of a bang-bang flow as a function of the times of its pieces, of free start values and parameters.

    Unknowns are the ends of the pieces (s), then the free start values, then the free parameters of the problem.

    Attributes
    ----------
    initial, final : array (n_states + n_integrals + 1 + n_parameters,)
        States, integrals, time and free parameters at the start and at the end.
    initial_sensitivity, final_sensitivity : array (n_states + n_integrals + 1 + n_parameters, n_unknowns)
        Derivatives of these by the unknowns.
    states : array (n_states + n_integrals + 1 + n_parameters, n_steps + 1)
        Before every step and at the end.
    """

    initial: Array
    final: Array
    initial_sensitivity: Array
    final_sensitivity: Array
    states: Array
    _steps: _Steps
    _directions: Array

    def adjoints(self, adjoint: Array) -> Array:
        """Derivatives of ``adjoint @ final`` by the states before every step and at the end, (n, n_steps + 1)."""
        adjoints = np.empty_like(self.states)
        adjoints[:, -1] = adjoint
        for j in reversed(range(self._steps.jacobians.shape[0])):
            adjoints[:, j] = adjoints[:, j + 1] @ self._steps.jacobians[j, :, :-1]
        return adjoints

    def curvature(self, adjoint: Array) -> Array:
        """Second derivative of ``adjoint @ final``, (n_unknowns, n_unknowns)."""
        hessians = self._steps.hessians(self.adjoints(adjoint)[:, 1:])
        return np.tensordot(self._directions, hessians @ self._directions, axes=((0, 1), (0, 1)))


def bang_bang_flow(
    problem: Problem, s: PhaseSamples, pieces: Pieces, free_start: Indices, refinement: int = 1
) -> BangBangFlow:
    """Fly a phase piece by piece.

    Parameters
    ----------
    problem : Problem
        Of the samples.
    s : PhaseSamples
    pieces : Pieces
    free_start : int array
        Rows of the start values that are unknowns.
    refinement : int
        Steps per step of the coarsest grid.
    """
    leg, q = s.leg, s.functions.q
    rates = problem.once(("flow", leg.name), lambda: _Rates.of(s))
    start = np.concatenate([leg.x(leg.breaks[0]), np.zeros(leg.integrals.size), pieces.times[:1], q])
    n_times = int(np.max(pieces.unknowns)) + 1
    inputs, changes = _inputs(s, pieces, n_times, refinement)
    n, n_clock = inputs.shape[1], start.size - q.size - 1
    states = evaluate_chain(rates.step, start, inputs)
    steps = _Steps.of(rates, states[:, :-1], inputs)
    initial = np.zeros((start.size, n_times + free_start.size + q.size))
    initial[n_clock, pieces.unknowns[0]] = 1.0
    initial[free_start, n_times + np.arange(free_start.size)] = 1.0
    initial[n_clock + 1 :, n_times + free_start.size :] = np.eye(q.size)
    directions, sensitivity = np.zeros((n, start.size + 1, initial.shape[1])), initial
    for j in range(n):
        directions[j, :-1], directions[j, -1, :n_times] = sensitivity, changes[j]
        sensitivity = steps.jacobians[j] @ directions[j]
    return BangBangFlow(start, states[:, -1], initial, sensitivity, states, steps, directions)


def _inputs(s: PhaseSamples, pieces: Pieces, n_times: int, refinement: int) -> tuple[Array, Array]:
    """Inputs of all steps (n_inputs, n_steps), and derivatives of their widths (n_steps, n_times)."""
    inputs, changes = [], []
    widths = np.diff(pieces.times)
    for k, width in enumerate(widths):
        count = refinement * (LEAST_STEPS + int(np.ceil(STEPS * width / np.sum(widths))))
        numbers = np.concatenate([[width / count], pieces.controls[:, k], s.functions.p])
        change = np.zeros(n_times)
        change[pieces.unknowns[k : k + 2]] = -1 / count, 1 / count
        inputs.append(np.tile(numbers[:, None], count))
        changes.append(np.tile(change, (count, 1)))
    return np.hstack(inputs), np.vstack(changes)


@dataclass(frozen=True, eq=False)
class _Rates:
    """CasADi Functions of z = (x, integrals, t, q) and of the inputs (width, control, p).

    Attributes
    ----------
    step : Function
        One classical fourth-order step.
    rate : Function
        dz/dt.
    jacobian, hessian : _Matrices
        The Jacobian of dz/dt in z; of z, of the inputs and of weights: the Hessian of weights @ dz/dt in z.
    """

    step: Any
    rate: Any
    jacobian: _Matrices
    hessian: _Matrices

    @classmethod
    def of(cls, s: PhaseSamples) -> _Rates:
        rates, integrands = s.functions.functions["rates"], s.functions.functions["integrands"]
        n, m, n_integrals, n_q = (
            s.leg.states.size, s.leg.controls.size, s.leg.integrals.size, s.functions.q.size
        )  # fmt: skip
        state = ca.SX.sym("state", n + n_integrals + 1 + n_q)
        inputs = ca.SX.sym("inputs", 1 + m + s.functions.p.size)
        weights = ca.SX.sym("weights", state.shape[0])
        width, control, p = ca.vertsplit(inputs, [0, 1, 1 + m, inputs.shape[0]])

        def derivative(z: Any) -> Any:
            x, _, t, q = ca.vertsplit(z, [0, n, n + n_integrals, n + n_integrals + 1, z.shape[0]])
            unused = (np.zeros(n), np.zeros(len(s.leg.path_labels)), np.zeros(n_integrals))
            here = (t, x, control, *unused, p, q)
            return ca.vertcat(rates(*here), integrands(*here), 1, np.zeros(n_q))

        k1 = derivative(state)
        k2 = derivative(state + 0.5 * width * k1)
        k3 = derivative(state + 0.5 * width * k2)
        k4 = derivative(state + width * k3)
        after = state + width / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        hessian = ca.hessian(ca.dot(weights, k1), state)[0]
        return cls(
            ca.Function("step", [state, inputs], [ca.densify(after)]),
            ca.Function("rate", [state, inputs], [ca.densify(k1)]),
            _Matrices.of("rate_jacobian", [state, inputs], ca.jacobian(k1, state)),
            _Matrices.of("rate_hessian", [state, inputs, weights], hessian),
        )


@dataclass(frozen=True, eq=False)
class _Matrices:
    """A sparse matrix as a function of columns, evaluated for many of them."""

    entries: Any
    shape: tuple[int, int]
    rows: Indices
    columns: Indices

    @classmethod
    def of(cls, name: str, arguments: list[Any], matrix: Any) -> _Matrices:
        rows, columns = (np.array(part, dtype=int) for part in matrix.sparsity().get_triplet())
        entries = ca.vertcat(*matrix.nonzeros()) if rows.size else ca.SX(0, 1)
        return cls(ca.Function(name, arguments, [entries]), matrix.shape, rows, columns)

    def __call__(self, *arguments: Array) -> Array:
        """Return the dense matrices (n, *shape) of n columns of every argument."""
        n = arguments[0].shape[1]
        found = np.zeros((n, *self.shape))
        found[:, self.rows, self.columns] = evaluate_columns(self.entries, n, *arguments).T
        return found


_REACH = (0.0, 0.5, 0.5, 1.0)
"""Stage i begins at y + reach * h * k_(i-1)."""

_SHARE = (1 / 6, 1 / 3, 1 / 3, 1 / 6)
"""The step is y + h * sum of share * k_i."""


@dataclass(frozen=True, eq=False)
class _Steps:
    """The derivatives of steps by w = (z, h), from those of their four stages; n_steps first.

    Attributes
    ----------
    jacobians : array (n_steps, n, n + 1)
        Of the steps.
    """

    jacobians: Array
    _rates: _Rates
    _inputs: Array
    _stages: list[_Stage]

    @classmethod
    def of(cls, rates: _Rates, states: Array, inputs: Array) -> _Steps:
        """Differentiate the steps from some states (n, n_steps) with some inputs."""
        n, n_steps = states.shape
        h = inputs[0]
        unmoved = np.zeros((n_steps, n, n + 1))
        unmoved[:, :, :n] = np.eye(n)
        jacobians, slope, change = unmoved.copy(), np.zeros((n, n_steps)), np.zeros_like(unmoved)
        stages: list[_Stage] = []
        for reach, share in zip(_REACH, _SHARE, strict=True):
            place, moved = states + reach * h * slope, unmoved + (reach * h)[:, None, None] * change
            moved[:, :, -1] += reach * slope.T
            slope = evaluate_columns(rates.rate, n_steps, place, inputs)
            jacobian = rates.jacobian(place, inputs)
            change = jacobian @ moved
            stages.append(_Stage(place, moved, jacobian, change))
            jacobians += (share * h)[:, None, None] * change
            jacobians[:, :, -1] += share * slope.T
        return cls(jacobians, rates, inputs, stages)

    def hessians(self, adjoints: Array) -> Array:
        """Hessians of ``adjoints @ step`` of every step, (n_steps, n + 1, n + 1), for adjoints (n, n_steps)."""
        h, n_steps = self._inputs[0], adjoints.shape[1]
        total = np.zeros((n_steps, adjoints.shape[0] + 1, adjoints.shape[0] + 1))
        later, reach_later = np.zeros_like(adjoints), 0.0
        for stage, reach, share in reversed(list(zip(self._stages, _REACH, _SHARE, strict=True))):
            # What a slope is worth: by the step itself, and by the place of the next stage.
            by_width = share * adjoints + reach_later * later
            weights = h * by_width
            bent = self._rates.hessian(stage.place, self._inputs, weights)
            total += stage.moved.transpose(0, 2, 1) @ (bent @ stage.moved)
            mixed = (by_width.T[:, None, :] @ stage.change)[:, 0]
            total[:, -1] += mixed
            total[:, :, -1] += mixed
            later, reach_later = (weights.T[:, None, :] @ stage.jacobian)[:, 0].T, reach
        return total


@dataclass(frozen=True, eq=False)
class _Stage:
    """Where a stage evaluates the rates, and derivatives of that place and of its slope by w.

    Attributes
    ----------
    place : array (n, n_steps)
    moved, change : array (n_steps, n, n + 1)
        Of the place, of the slope.
    jacobian : array (n_steps, n, n)
        Of the rates there.
    """

    place: Array
    moved: Array
    jacobian: Array
    change: Array
