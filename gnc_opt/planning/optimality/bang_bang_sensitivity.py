r"""Flow of a bang-bang control, with first and second derivatives in switching times and initial values.

The flow is a chain of integration steps, :math:`y_{j+1} = M_j(y_j, h_j)`; y contains the states of the phase, its
integrals, the time and the free parameters, and h is the step length. With the sensitivities
:math:`S_j = dy_j/d\theta` and :math:`D_j = (S_j, dh_j/d\theta)`,

.. math:: S_{j+1} = M_j' D_j, \qquad
          \frac{d^2 (p^T y_N)}{d\theta^2} = \sum_j D_j^T (p_{j+1}^T M_j'') D_j, \qquad
          p_j = \Big(\frac{\partial M_j}{\partial y_j}\Big)^T p_{j+1}, \quad p_N = p

(Bryson & Ho, Applied Optimal Control, 1975, ch. 2), exact for the discretised flow. A step is a chain of 12 stages of
order 8 (Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, 1993, section II.5), differentiated in the
same way; only the rates are differentiated symbolically. A piece of zero length yields the effect of the control
between two coinciding switches when they separate.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.array_types import Array, Indices
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch, iterate_discrete_time_map
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples

FLOW_INITIAL_STEPS = 36
"""Default number of Runge-Kutta steps over the phase: accurate to 1e-4 for five revolutions of an oscillator."""

RUNGE_KUTTA_ORDER = 8
"""Order of the method: halving the step reduces the error by 2 to this power."""


@dataclass(frozen=True)
class PiecewiseControl:
    """Piecewise constant ``controls`` (n_controls, n_subarcs) of a phase.

    ``times`` (n_subarcs + 1,) are their ends (s), ascending, ``unknowns`` the index of the unknown of each.
    """

    times: Array
    controls: Array
    unknowns: Indices


@dataclass(frozen=True, eq=False)
class BangBangFlow:
    """Final state of a bang-bang flow as a function of switching times, free initial values and parameters.

    Unknowns are the ends of the pieces (s), the free initial values, and the free parameters of the problem. Rows are
    states, integrals, time and free parameters: ``initial`` (n,), its derivatives in the unknowns (n, n_unknowns), and
    ``states`` before every step and at the end (n, n_steps + 1). ``controls`` (n_controls, n_steps) are the inputs.
    """

    initial: Array
    initial_sensitivity: Array
    states: Array
    controls: Array
    _rates: _StepFunctions
    _inputs: Array
    _widths: Array
    _swept: dict[bytes, Array] = field(default_factory=dict)

    @property
    def final_state(self) -> Array:
        return self.states[:, -1]

    @property
    def final_state_sensitivity(self) -> Array:
        """Derivative of the final state in the unknowns (n, n_unknowns)."""
        return self._step_and_final_state_sensitivities[1]

    def integrate_adjoint_equation(self, adjoint: Array) -> Array:
        """Return the gradient of ``adjoint @ final`` in the states at all step ends (n, n_steps + 1)."""
        return self._compute_cost_gradients_by_step(adjoint)[:-1]

    def compute_adjoint_gradient(self, adjoint: Array) -> Array:
        """Return the first derivative of ``adjoint @ final``, (n_unknowns,), without sensitivities."""
        adjoints, n_times = self._compute_cost_gradients_by_step(adjoint), self._widths.shape[1]
        gradient = adjoints[:-1, 0] @ self.initial_sensitivity
        gradient[:n_times] += adjoints[-1, :-1] @ self._widths
        return np.asarray(gradient)

    def compute_adjoint_hessian(self, adjoint: Array) -> Array:
        """Return the second derivative of ``adjoint @ final``, (n_unknowns, n_unknowns)."""
        jacobians = self._integration_step_derivatives.jacobians[:, :, :-1]
        adjoints = np.empty((len(jacobians), adjoint.size))
        for j in reversed(range(len(jacobians))):
            adjoints[j] = adjoint
            adjoint = adjoint @ jacobians[j]
        hessians = self._integration_step_derivatives.compute_integration_step_hessians(adjoints.T)
        directions = self._step_and_final_state_sensitivities[0]
        return np.tensordot(directions, hessians @ directions, axes=((0, 1), (0, 1)))

    def _compute_cost_gradients_by_step(self, adjoint: Array) -> Array:
        """Return cost gradients in the states before every step and (last row) step lengths; (n + 1, n_steps + 1)."""
        key = adjoint.tobytes()
        if key not in self._swept:
            arguments = np.vstack([self.states[:, :-1], self._inputs])[:, ::-1]
            gradients = iterate_discrete_time_map(self._rates.back, np.append(adjoint, 0.0), arguments)
            self._swept[key] = gradients[:, ::-1]
        return self._swept[key]

    @cached_property
    def _integration_step_derivatives(self) -> _StepDerivatives:
        return _StepDerivatives(self._rates, self.states[:, :-1], self._inputs)

    @cached_property
    def _step_and_final_state_sensitivities(self) -> tuple[Array, Array]:
        """Derivatives of (state, step length) of every step in the unknowns, and of the final state."""
        (n, n_times), sensitivity = self._widths.shape, self.initial_sensitivity
        directions = np.zeros((n, self.initial.size + 1, sensitivity.shape[1]))
        directions[:, -1, :n_times] = self._widths
        with np.errstate(over="ignore", invalid="ignore"):  # the flow may overflow
            for j, jacobian in enumerate(self._integration_step_derivatives.jacobians):
                directions[j, :-1] = sensitivity
                sensitivity = jacobian @ directions[j]
        return directions, sensitivity


def integrate_bang_bang_flow(
    problem: Problem,
    s: PhaseSamples,
    pieces: PiecewiseControl,
    free_start: Indices,
    refinement: int,
    steps: int = FLOW_INITIAL_STEPS,
) -> BangBangFlow:
    """Return the flow of a phase with a piecewise constant control.

    ``free_start`` are the rows of the initial values that are unknowns, ``refinement`` is the number of parts of every
    grid step, and ``steps`` the number of grid steps over the phase; at least one between two switches.
    """
    phase, q = s.phase, s.functions.q
    rates = problem.memoize(("flow", phase.name), lambda: _StepFunctions(s))
    start = np.concatenate([phase.x(phase.breaks[0]), np.zeros(phase.integrals.size), pieces.times[:1], q])
    n_times = int(np.max(pieces.unknowns)) + 1
    inputs, widths = _build_integrator_step_arguments(s, pieces, n_times, refinement, steps)
    n_clock = start.size - q.size - 1
    initial = np.zeros((start.size, n_times + free_start.size + q.size))
    initial[n_clock, pieces.unknowns[0]] = 1.0
    initial[free_start, n_times + np.arange(free_start.size)] = 1.0
    initial[n_clock + 1 :, n_times + free_start.size :] = np.eye(q.size)
    states = iterate_discrete_time_map(rates.step, start, inputs)
    controls = inputs[1 : 1 + phase.controls.size]
    return BangBangFlow(start, initial, states, controls, rates, inputs, widths)


def _build_integrator_step_arguments(
    s: PhaseSamples, pieces: PiecewiseControl, n_times: int, refinement: int, steps: int
) -> tuple[Array, Array]:
    """Return the inputs of all steps (n_inputs, n_steps), and derivatives of their lengths (n_steps, n_times)."""
    widths = np.diff(pieces.times)
    counts = refinement * np.maximum(1, np.rint(steps * widths / np.sum(widths)).astype(int))
    piece = np.arange(widths.size).repeat(counts)
    parameters = np.tile(s.functions.p[:, None], piece.size)
    changes = np.zeros((widths.size, n_times))
    changes[np.arange(widths.size), pieces.unknowns[:-1]] = -1 / counts
    changes[np.arange(widths.size), pieces.unknowns[1:]] += 1 / counts
    return np.vstack([(widths / counts)[piece], pieces.controls[:, piece], parameters]), changes[piece]


class _StepFunctions:
    """CasADi Functions of z = (x, integrals, t, q) and of the inputs (width, control, p).

    ``step`` maps z and inputs to z after one step; ``back`` maps (cost gradient in z after a step, unused) and (z,
    inputs) to the cost gradients in z before it and in its length; ``stages`` maps z and inputs to the arguments and
    the values of dz/dt at every stage. ``jacobian`` is that of dz/dt in z, ``hessian`` that of weights @ dz/dt in z, a
    function of z, inputs and weights.
    """

    def __init__(self, s: PhaseSamples) -> None:
        rates, integrands = s.functions.functions["rates"], s.functions.functions["integrands"]
        n, m, n_integrals = s.phase.states.size, s.phase.controls.size, s.phase.integrals.size
        n_q = s.functions.q.size
        state = ca.SX.sym("state", n + n_integrals + 1 + n_q)
        inputs = ca.SX.sym("inputs", 1 + m + s.functions.p.size)
        weights = ca.SX.sym("weights", state.shape[0])
        width, control, p = ca.vertsplit(inputs, [0, 1, 1 + m, inputs.shape[0]])

        def evaluate_augmented_state_rate(z: Any) -> Any:
            x, _, t, q = ca.vertsplit(z, [0, n, n + n_integrals, n + n_integrals + 1, z.shape[0]])
            unused = (np.zeros(n), np.zeros(len(s.phase.path_labels)), np.zeros(n_integrals))
            arguments = (t, x, control, *unused, p, q)
            return ca.vertcat(rates(*arguments), integrands(*arguments), 1, np.zeros(n_q))

        rate = ca.Function("rate", [state, inputs], [ca.cse(evaluate_augmented_state_rate(state))])
        stage_states: list[Any] = []
        slopes: list[Any] = []

        def advance_state_by_runge_kutta_stages(shares: Array) -> Any:
            moves = (float(a) * slope for a, slope in zip(shares, slopes, strict=False) if a)
            return state + width * sum(moves, start=ca.SX(0))

        stage_weights, step_weights = _get_butcher_tableau()
        for shares in stage_weights:
            stage_states.append(advance_state_by_runge_kutta_stages(shares))
            slopes.append(rate(stage_states[-1], inputs))
        next_state = advance_state_by_runge_kutta_stages(step_weights)
        cost_gradient = ca.SX.sym("cost_gradient", state.shape[0] + 1)
        adjoint = ca.jtimes(next_state, ca.vertcat(state, width), cost_gradient[:-1], True)
        hessian = ca.hessian(ca.dot(weights, slopes[0]), state)[0]
        step_arguments, weighted_arguments = [state, inputs], [state, inputs, weights]
        self.step = ca.Function("step", step_arguments, [ca.densify(next_state)])
        self.back = ca.Function("back", [cost_gradient, ca.vertcat(state, inputs)], [ca.densify(adjoint)])
        self.stages = ca.Function("stages", step_arguments, [ca.densify(ca.vertcat(*stage_states, *slopes))])
        self.jacobian = ca.Function("rate_jacobian", step_arguments, [ca.jacobian(slopes[0], state).T])
        self.hessian = ca.Function("rate_hessian", weighted_arguments, [hessian])


def _get_butcher_tableau() -> tuple[Array, Array]:
    """Return A and b: stage i is evaluated at y + h * sum of A_ij k_j, the step ends at y + h * sum of b_i k_i."""
    return scipy.integrate.DOP853.A, scipy.integrate.DOP853.B


class _StepDerivatives:
    """Derivatives of integration steps in w = (z, h) for states (n, n_steps); ``jacobians`` (n_steps, n, n + 1)."""

    def __init__(self, rates: _StepFunctions, states: Array, inputs: Array) -> None:
        stage_weights, step_weights = _get_butcher_tableau()
        (n, n_steps), n_stages = states.shape, len(step_weights)
        h = inputs[0][:, None, None]
        stages = evaluate_casadi_batch(rates.stages, n_steps, states, inputs).reshape(2, n_stages, n, n_steps)
        stage_states = stages[0].transpose(1, 0, 2).reshape(n, -1)
        slopes = stages[1].transpose(0, 2, 1)
        count, repeated = n_stages * n_steps, np.tile(inputs, n_stages)
        slope_jacobians = evaluate_casadi_batch(rates.jacobian, count, stage_states, repeated).T
        slope_jacobians = slope_jacobians.reshape(n_stages, n_steps, n, n)
        d_states, d_slopes = np.zeros((n_stages, n_steps, n, n + 1)), np.zeros((n_stages, n_steps, n, n + 1))

        def sum_runge_kutta_stage_jacobians(shares: Array, total: Array) -> Array:
            """Return the derivatives of z + h * sum of share * k_i over the first stages."""
            used = np.flatnonzero(shares)
            total[:, :, :n] = np.eye(n)
            total += h * np.tensordot(shares[used], d_slopes[used], 1)
            total[:, :, n] += np.tensordot(shares[used], slopes[used], 1)
            return total

        with np.errstate(over="ignore", invalid="ignore"):  # the flow may overflow
            for i, shares in enumerate(stage_weights):
                by_stage = sum_runge_kutta_stage_jacobians(shares, d_states[i])
                np.matmul(slope_jacobians[i], by_stage, out=d_slopes[i])
            self.jacobians = sum_runge_kutta_stage_jacobians(step_weights, np.zeros((n_steps, n, n + 1)))
        self._rates, self._inputs, self._stage_states = rates, inputs, stage_states
        self._d_states, self._d_slopes, self._slope_jacobians = d_states, d_slopes, slope_jacobians

    def compute_integration_step_hessians(self, adjoints: Array) -> Array:
        """Return the Hessians of ``adjoints @ step``, (n_steps, n + 1, n + 1), for adjoints (n, n_steps)."""
        stage_weights, step_weights = _get_butcher_tableau()
        (n, n_steps), n_stages = adjoints.shape, len(step_weights)
        h = self._inputs[0]
        # Cost gradient of a slope times the step length: through the step itself, and through the states of later
        # stages.
        cost_gradient = np.multiply.outer(step_weights, adjoints.T)
        for i in reversed(range(n_stages)):
            by_state = ((h[:, None] * cost_gradient[i])[:, None] @ self._slope_jacobians[i])[:, 0]
            for j in np.flatnonzero(stage_weights[i]):
                cost_gradient[j] += stage_weights[i, j] * by_state
        weights = (h[:, None] * cost_gradient).transpose(2, 0, 1).reshape(n, -1)
        arguments = self._stage_states, np.tile(self._inputs, n_stages), weights
        rate_hessians = evaluate_casadi_batch(self._rates.hessian, n_stages * n_steps, *arguments).T
        rate_hessians = rate_hessians.reshape(n_stages, n_steps, n, n)
        total = np.sum(self._d_states.transpose(0, 1, 3, 2) @ (rate_hessians @ self._d_states), axis=0)
        mixed = np.sum(cost_gradient[:, :, None] @ self._d_slopes, axis=0)[:, 0]
        total[:, -1] += mixed
        total[:, :, -1] += mixed
        return np.asarray(total)
