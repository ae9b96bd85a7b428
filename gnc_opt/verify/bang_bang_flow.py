r"""The flow of a bang-bang control, and its first two derivatives in switch times and start.

The flow is a chain of integration steps, :math:`y_{j+1} = M_j(y_j, h_j)`, with the state y of the phase, its
integrals, the time and the free parameters, and the width h of a step. With the sensitivities
:math:`S_j = dy_j/d\theta` and :math:`D_j = (S_j, dh_j/d\theta)`,

.. math:: S_{j+1} = M_j' D_j, \qquad
          \frac{d^2 (p^T y_N)}{d\theta^2} = \sum_j D_j^T (p_{j+1}^T M_j'') D_j, \qquad
          p_j = \Big(\frac{\partial M_j}{\partial y_j}\Big)^T p_{j+1}, \quad p_N = p

(Bryson & Ho, Applied Optimal Control, 1975, ch. 2). So only one step is differentiated symbolically, once per
problem; the rest is arithmetic, and exact for the discretised flow.

A piece may have no length: it then tells what a control between two switches at one time would do if they came apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array, Indices
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
    _inputs: Array
    _jacobians: Array
    _directions: Array
    _hessian: Any

    def adjoints(self, adjoint: Array) -> Array:
        """Derivatives of ``adjoint @ final`` by the states before every step and at the end, (n, n_steps + 1)."""
        adjoints = np.empty_like(self.states)
        adjoints[:, -1] = adjoint
        for j in reversed(range(self._jacobians.shape[0])):
            adjoints[:, j] = adjoints[:, j + 1] @ self._jacobians[j, :, :-1]
        return adjoints

    def curvature(self, adjoint: Array) -> Array:
        """Second derivative of ``adjoint @ final``, (n_unknowns, n_unknowns)."""
        adjoints = self.adjoints(adjoint)[:, 1:]
        hessians = _stacked(self._hessian(self.states[:, :-1], self._inputs, adjoints), adjoints.shape[1])
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
    step, jacobian, hessian = problem.once(("step", leg.name), lambda: _step_functions(s))
    start = np.concatenate([leg.x(leg.breaks[0]), np.zeros(leg.integrals.size), pieces.times[:1], q])
    n_times = int(np.max(pieces.unknowns)) + 1
    inputs, changes = _steps(s, pieces, n_times, refinement)
    n, n_clock = inputs.shape[1], start.size - q.size - 1
    flown = step.mapaccum(n)(start, inputs).full()
    states = np.column_stack([start, flown])
    jacobians = _stacked(jacobian(states[:, :-1], inputs), n)
    initial = np.zeros((start.size, n_times + free_start.size + q.size))
    initial[n_clock, pieces.unknowns[0]] = 1.0
    initial[free_start, n_times + np.arange(free_start.size)] = 1.0
    initial[n_clock + 1 :, n_times + free_start.size :] = np.eye(q.size)
    directions, sensitivity = np.zeros((n, start.size + 1, initial.shape[1])), initial
    for j in range(n):
        directions[j, :-1], directions[j, -1, :n_times] = sensitivity, changes[j]
        sensitivity = jacobians[j] @ directions[j]
    return BangBangFlow(
        start, flown[:, -1], initial, sensitivity, states, inputs, jacobians, directions, hessian
    )


def _steps(s: PhaseSamples, pieces: Pieces, n_times: int, refinement: int) -> tuple[Array, Array]:
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


def _step_functions(s: PhaseSamples) -> tuple[Any, Any, Any]:
    """One classical fourth-order step of (x, integrals, t, q), its Jacobian, and the Hessian of adjoint @ step.

    CasADi Functions of the state, of the inputs (width, control, p) and, the last one, of the adjoint. They are
    differentiated with respect to the state and the width.
    """
    rates, integrands = s.functions.functions["rates"], s.functions.functions["integrands"]
    n, m, n_integrals, n_q = s.leg.states.size, s.leg.controls.size, s.leg.integrals.size, s.functions.q.size
    state = ca.SX.sym("state", n + n_integrals + 1 + n_q)
    inputs = ca.SX.sym("inputs", 1 + m + s.functions.p.size)
    adjoint = ca.SX.sym("adjoint", state.shape[0])
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
    varied = ca.vertcat(state, width)
    hessian = ca.hessian(ca.dot(adjoint, after), varied)[0]
    return (
        ca.Function("step", [state, inputs], [after]),
        ca.Function("step_jacobian", [state, inputs], [ca.densify(ca.jacobian(after, varied))]),
        ca.Function("step_hessian", [state, inputs, adjoint], [ca.densify(hessian)]),
    )


def _stacked(matrices: Any, n: int) -> Array:
    """Matrices (n, rows, columns) that CasADi has put side by side."""
    wide = matrices.full()
    return np.ascontiguousarray(wide.reshape(wide.shape[0], n, -1).transpose(1, 0, 2))
