r"""The flow of a bang-bang control, and its first two derivatives in switch times and start.

The flow is a chain of integration steps, :math:`y_{j+1} = M_j(y_j, h_j)`, with the state y of the phase, its
integrals and the time, and the width h of a step. With the sensitivities :math:`S_j = dy_j/d\theta` and
:math:`D_j = (S_j, dh_j/d\theta)`,

.. math:: S_{j+1} = M_j' D_j, \qquad
          \frac{d^2 (p^T y_N)}{d\theta^2} = \sum_j D_j^T (p_{j+1}^T M_j'') D_j, \qquad
          p_j = \Big(\frac{\partial M_j}{\partial y_j}\Big)^T p_{j+1}, \quad p_N = p

(Bryson & Ho, Applied Optimal Control, 1975, ch. 2). So only one step is differentiated symbolically, once per
problem; the rest is arithmetic, and exact for the discretised flow.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array, Indices
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.samples import PhaseSamples

STEPS = 300
"""Runge-Kutta steps over the phase, and at least `LEAST_STEPS` from switch to switch."""

LEAST_STEPS = 4


@dataclass(frozen=True, eq=False)
class BangBangFlow:
    """The end of a bang-bang flow as a function of the times of its pieces and of free start values.

    Unknowns are the ends of the pieces (s), then the free start values.

    Attributes
    ----------
    initial, final : array (n_states + n_integrals + 1,)
        States, integrals and time at the start and at the end.
    initial_sensitivity, final_sensitivity : array (n_states + n_integrals + 1, n_unknowns)
        Derivatives of these by the unknowns.
    """

    initial: Array
    final: Array
    initial_sensitivity: Array
    final_sensitivity: Array
    _states: Array
    _inputs: Array
    _jacobians: Array
    _directions: Array
    _hessian: Any

    def curvature(self, adjoint: Array) -> Array:
        """Second derivative of ``adjoint @ final``, (n_unknowns, n_unknowns)."""
        adjoints = np.empty_like(self._states)
        for j in reversed(range(adjoints.shape[1])):
            adjoints[:, j] = adjoint
            adjoint = adjoint @ self._jacobians[j, :, :-1]
        hessians = _stacked(self._hessian(self._states, self._inputs, adjoints), adjoints.shape[1])
        return np.tensordot(self._directions, hessians @ self._directions, axes=((0, 1), (0, 1)))


def bang_bang_flow(problem: Problem, s: PhaseSamples, times: Array, free_start: Indices) -> BangBangFlow:
    """Fly a phase piece by piece with the control of each piece's middle.

    Parameters
    ----------
    problem : Problem
        Of the samples.
    s : PhaseSamples
    times : array (n_pieces + 1,)
        Ends of the pieces, on each of which the control is constant (s).
    free_start : int array
        Rows of the start values that are unknowns.
    """
    leg = s.leg
    step, jacobian, hessian = problem.once(("step", leg.name), lambda: _step_functions(s))
    start = np.concatenate([leg.x(times[0]), np.zeros(leg.integrals.size), times[:1]])
    inputs, changes = _steps(s, times, free_start.size)
    n = inputs.shape[1]
    flown = step.mapaccum(n)(start, inputs).full()
    states = np.column_stack([start, flown[:, :-1]])
    jacobians = _stacked(jacobian(states, inputs), n)
    initial = np.zeros((start.size, times.size + free_start.size))
    initial[-1, 0] = 1.0
    initial[free_start, times.size + np.arange(free_start.size)] = 1.0
    directions, sensitivity = np.empty((n, start.size + 1, initial.shape[1])), initial
    for j in range(n):
        directions[j, :-1], directions[j, -1] = sensitivity, changes[j]
        sensitivity = jacobians[j] @ directions[j]
    return BangBangFlow(
        start, flown[:, -1], initial, sensitivity, states, inputs, jacobians, directions, hessian
    )


def _steps(s: PhaseSamples, times: Array, n_start: int) -> tuple[Array, Array]:
    """Inputs of all steps (n_inputs, n_steps), and derivatives of their widths (n_steps, n_unknowns)."""
    inputs, changes = [], []
    controls = s.leg.flown(0.5 * (times[:-1] + times[1:]))
    for k, (left, right) in enumerate(pairwise(times)):
        count = LEAST_STEPS + int(np.ceil(STEPS * (right - left) / (times[-1] - times[0])))
        numbers = np.concatenate([[(right - left) / count], controls[:, k], s.functions.p, s.functions.q])
        change = np.zeros(times.size + n_start)
        change[k : k + 2] = -1 / count, 1 / count
        inputs.append(np.tile(numbers[:, None], count))
        changes.append(np.tile(change, (count, 1)))
    return np.hstack(inputs), np.vstack(changes)


def _step_functions(s: PhaseSamples) -> tuple[Any, Any, Any]:
    """One classical fourth-order step of (x, integrals, t), its Jacobian, and the Hessian of adjoint @ step.

    CasADi Functions of the state, of the inputs (width, control, p, q) and, the last one, of the adjoint. They are
    differentiated with respect to the state and the width.
    """
    rates, integrands = s.functions.functions["rates"], s.functions.functions["integrands"]
    n, m, parameters = s.leg.states.size, s.leg.controls.size, s.functions.p.size
    state = ca.SX.sym("state", n + s.leg.integrals.size + 1)
    inputs = ca.SX.sym("inputs", 1 + m + parameters + s.functions.q.size)
    adjoint = ca.SX.sym("adjoint", state.shape[0])
    width, control, p, q = ca.vertsplit(inputs, [0, 1, 1 + m, 1 + m + parameters, inputs.shape[0]])

    def derivative(z: Any) -> Any:
        unused = (np.zeros(n), np.zeros(len(s.leg.path_labels)), np.zeros(s.leg.integrals.size))
        here = (z[-1], z[:n], control, *unused, p, q)
        return ca.vertcat(rates(*here), integrands(*here), 1)

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
