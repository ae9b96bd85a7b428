r"""Step of Newton's method for switching times, with its own derivatives or those of an earlier step.

A step minimises the quadratic model of the Lagrangian subject to the linearised end conditions; negative curvatures are
reversed (Nocedal & Wright, Numerical Optimization, 2006, ch. 3.4, 18.3). A step with the matrices of an earlier one
(simplified Newton method: Deuflhard, Newton Methods for Nonlinear Problems, 2004, ch. 2.1.2) takes a fifth of the work.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch
from gnc_opt.numerical_tolerances import RANK, TINY
from gnc_opt.planning.optimality.bang_bang_sensitivity import (
    FLOW_INITIAL_STEPS,
    BangBangFlow,
    integrate_bang_bang_flow,
)
from gnc_opt.planning.optimality.switching_time_problem import Switches, build_endpoint_derivative_function
from gnc_opt.planning.problem.hamiltonian_functions import get_endpoint_value_function
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples


@dataclass(frozen=True, eq=False)
class SwitchStep:
    """Newton step in (start, switches, end), with the flow and multipliers from which it was computed.

    ``change`` (n_switches + 2,) is that of the times, s; ``flow`` and ``cost`` are those before the step, ``gain`` is
    the relative first-order change of the cost. ``adjoint`` is the derivative of the cost with respect to the final
    values of the flow; ``multipliers`` are those of the given end values, then of the boundary constraints. ``hessian``
    (n_free, n_free) of the Lagrangian and ``rows`` (n_conditions, n_free), the gradients of the conditions, refer to
    the free unknowns. The flow's grid has ``steps`` steps.
    """

    change: Array
    flow: BangBangFlow
    adjoint: Array
    multipliers: Array
    cost: float
    gain: float
    hessian: Array
    rows: Array
    steps: int = FLOW_INITIAL_STEPS

    def get_relative_step_size(self, switches: Switches) -> float:
        """Largest entry relative to the phase."""
        return float(np.max(np.abs(self.change)) / (switches.ends[1] - switches.ends[0]))


def compute_newton_step(
    problem: Problem, s: PhaseSamples, switches: Switches, steps: int = FLOW_INITIAL_STEPS
) -> SwitchStep | None:
    """Return the Newton step; None if the flow is not finite or the conditions are linearly dependent."""
    ends = _EndConditions.from_integrated_switches(problem, s, switches, steps)
    flow, size, free = ends.flow, ends.size, ends.free
    if not np.isfinite(flow.final_state_sensitivity).all():
        return None
    changes = np.vstack([flow.initial_sensitivity[:size], flow.final_state_sensitivity[:size]])
    slope, jacobian, _ = ends.compute_end_derivatives(np.zeros(ends.misses.size - ends.given.size))
    rows = np.vstack([flow.final_state_sensitivity[ends.given], jacobian @ changes])[:, free]
    if not are_gradients_independent(rows):
        return None  # undetermined multipliers diverge in the collocated problem
    gradient = (slope @ changes)[free]
    multipliers = np.asarray(np.linalg.lstsq(rows.T, -gradient, rcond=RANK)[0])
    adjoint, slope, curvature = ends.compute_lagrangian_derivatives(multipliers)
    hessian = (flow.compute_adjoint_hessian(adjoint) + changes.T @ curvature @ changes)[np.ix_(free, free)]
    change = minimise_quadratic_model(hessian, gradient, rows, ends.misses)
    return ends.build_step(change, float(gradient @ change), adjoint, multipliers, (hessian, rows), steps)


def compute_simplified_step(
    problem: Problem,
    s: PhaseSamples,
    switches: Switches,
    known: SwitchStep,
    steps: int = FLOW_INITIAL_STEPS,
    refinement: int = 1,
) -> SwitchStep | None:
    """Return the step with the matrices of one for nearby switches in the same order; None if the flow is not finite.

    ``steps`` is the number of grid steps, ``refinement`` the number of parts into which each is divided.
    """
    ends = _EndConditions.from_integrated_switches(problem, s, switches, steps, refinement)
    if not np.isfinite(ends.flow.final_state).all():
        return None
    adjoint, slope, _ = ends.compute_lagrangian_derivatives(known.multipliers)
    initial = slope[: ends.size] @ ends.flow.initial_sensitivity[: ends.size]
    gradient = (ends.flow.compute_adjoint_gradient(adjoint) + initial)[ends.free]
    change = minimise_quadratic_model(known.hessian, gradient, known.rows, ends.misses)
    left = gradient + known.hessian @ change
    multipliers = known.multipliers - np.linalg.lstsq(known.rows.T, left, rcond=RANK)[0]
    gain = float((gradient - known.rows.T @ known.multipliers) @ change)
    matrices = known.hessian, known.rows
    return ends.build_step(change, gain, adjoint, multipliers, matrices, steps)


def differentiate_cost_by_final_state(
    problem: Problem, s: PhaseSamples, flow: BangBangFlow, multipliers: Array
) -> Array:
    """Return the derivative of the cost with respect to the final values of a flow, with the multipliers of a step."""
    return _EndConditions(problem, s, flow).compute_lagrangian_derivatives(multipliers)[0]


class _EndConditions:
    """Flow, its end conditions and their residuals ``misses``: given final values, then boundary constraints.

    ``size`` is the number of states, integrals and time.
    """

    def __init__(self, problem: Problem, s: PhaseSamples, flow: BangBangFlow) -> None:
        phase, n, limits = s.leg, s.leg.states.size, problem.get_boundary_constraint_bounds()
        self.problem, self.s, self.flow, self.size = problem, s, flow, n + phase.integrals.size + 1
        self.given = np.flatnonzero(phase.final_bounds.is_fixed)
        self.free = np.ones(flow.initial_sensitivity.shape[1], dtype=bool)
        self.free[[0, -1]] = ~np.append(phase.initial_time_bounds.is_fixed, phase.final_time_bounds.is_fixed)
        ends = flow.initial[: self.size], flow.final_state[: self.size]
        (start, _, begin), (final, integrals, end) = (np.split(v, [n, self.size - 1]) for v in ends)
        numbers = s.functions.p, s.functions.q, np.zeros(limits.lower.size)
        arguments = (start, final, begin, end, integrals, *numbers)
        found = evaluate_casadi_batch(get_endpoint_value_function(problem), 1, *arguments)[:, 0]
        self.cost = float(found[-1])
        missed = flow.final_state[self.given] - phase.final_bounds.lower[self.given]
        self.misses = np.append(missed, found[:-1] - limits.lower)

    @classmethod
    def from_integrated_switches(
        cls, problem: Problem, s: PhaseSamples, switches: Switches, steps: int, refinement: int = 1
    ) -> _EndConditions:
        piecewise = switches.build_piecewise_control(switches.chronological_switch_order)
        nothing = np.zeros(0, dtype=int)
        return cls(problem, s, integrate_bang_bang_flow(problem, s, piecewise, nothing, refinement, steps))

    def compute_end_derivatives(self, nu: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives of cost and constraints in both ends: gradient of their sum, Jacobian, Hessian."""
        problem = self.problem
        functions = problem.memoize("end derivatives", lambda: build_endpoint_derivative_function(problem))
        both = self.flow.initial[: self.size], self.flow.final_state[: self.size]
        slope, jacobian, hessian = functions(*both, self.s.functions.p, self.s.functions.q, nu)
        return slope.full()[:, 0], jacobian.full(), hessian.full()

    def compute_lagrangian_derivatives(self, multipliers: Array) -> tuple[Array, Array, Array]:
        """Return the cost gradient (final values), and gradient and Hessian of the Lagrangian in both ends."""
        on_states, nu = np.split(multipliers, [self.given.size])
        slope, _, curvature = self.compute_end_derivatives(nu)
        adjoint = np.zeros(self.flow.final_state.size)
        adjoint[: self.size] = slope[self.size :]
        adjoint[self.given] += on_states
        return adjoint, slope, curvature

    def build_step(
        self,
        change: Array,
        gain: float,
        adjoint: Array,
        multipliers: Array,
        matrices: tuple[Array, Array],
        steps: int,
    ) -> SwitchStep:
        """Return the step for changes of the free unknowns and of the cost; ``matrices`` are Hessian and gradients."""
        spread, relative = np.zeros(self.free.size), abs(gain) / max(abs(self.cost), TINY)
        spread[self.free] = change
        return SwitchStep(spread, self.flow, adjoint, multipliers, self.cost, relative, *matrices, steps)


def are_gradients_independent(rows: Array) -> bool:
    """Return whether gradients of conditions are linearly independent, independent of the units."""
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    return bool(np.all(sizes > 0) and np.linalg.matrix_rank(rows / sizes, RANK) == rows.shape[0])


def minimise_quadratic_model(hessian: Array, gradient: Array, rows: Array, misses: Array) -> Array:
    """Return the minimiser of a quadratic model under linear conditions, with negative curvatures reversed."""
    back = np.linalg.lstsq(rows, -misses, rcond=RANK)[0]
    null = np.linalg.qr(rows.T, mode="complete")[0][:, rows.shape[0] :]
    if not null.shape[1]:
        return np.asarray(back)
    curvatures, directions = np.linalg.eigh(null.T @ hessian @ null)
    least = RANK * np.max(np.abs(curvatures))
    slopes = directions.T @ (null.T @ (gradient + hessian @ back))
    return np.asarray(back - null @ (directions @ (slopes / np.maximum(np.abs(curvatures), least))))
