r"""Trajectory for given switching times: Newton step, missing arcs, and conversion to a collocation solution.

A step minimises the quadratic model of the Lagrangian subject to the linearised end conditions; negative curvatures are
reversed (Nocedal & Wright, Numerical Optimization, 2006, ch. 3.4, 18.3). A step with the matrices of an earlier one
(simplified Newton method: Deuflhard, Newton Methods for Nonlinear Problems, 2004, ch. 2.1.2) takes a fifth of the work.

States and costates are integrated between collocation points; the derivatives of their polynomials equal the rates at
the points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch
from gnc_opt.numerical_tolerances import AT_LIMIT, NEGLIGIBLE, RANK, TINY
from gnc_opt.planning.optimality.bang_bang_sensitivity import (
    FLOW_INITIAL_STEPS,
    BangBangFlow,
    PiecewiseControl,
    integrate_bang_bang_flow,
)
from gnc_opt.planning.optimality.switching_time_problem import Switches, build_endpoint_derivative_function
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind
from gnc_opt.planning.problem.hamiltonian_functions import get_endpoint_value_function
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.arcs.arc_mesh import ArcMesh
from gnc_opt.planning.refinement.arcs.structure_update import (
    clear_violations_near_switches,
    find_largest_violation_interval,
)
from gnc_opt.planning.solution.phase_solution import PhaseSolution, interpolate_point_values
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial
from gnc_opt.planning.solution.refinement_history import Statistics
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.quadrature import get_collocation_rule
from gnc_opt.planning.verification.solution_data_check import get_endpoint_gradients


@dataclass(frozen=True, eq=False)
class NewtonStep:
    """Newton step in (start, switches, end), with the flow and multipliers from which it was computed.

    ``change`` (n_switches + 2,) is that of the times, s; ``flow`` is that before the step, on a grid of ``steps``
    steps; ``gain`` is the relative first-order change of the cost. ``adjoint`` is the derivative of the cost in the
    final values of the flow; ``multipliers`` are those of the fixed final states, then of the boundary constraints.
    In the free unknowns, ``hessian`` (n_free, n_free) is that of the Lagrangian, and ``rows`` (n_conditions, n_free)
    are the gradients of the conditions.
    """

    change: Array
    flow: BangBangFlow
    adjoint: Array
    multipliers: Array
    gain: float
    hessian: Array
    rows: Array
    steps: int = FLOW_INITIAL_STEPS

    def get_relative_step_size(self, switches: Switches) -> float:
        """Return the largest change of a time, relative to the phase."""
        return float(np.max(np.abs(self.change)) / (switches.ends[1] - switches.ends[0]))


def compute_newton_step(
    problem: Problem, s: PhaseSamples, switches: Switches, steps: int = FLOW_INITIAL_STEPS
) -> NewtonStep | None:
    """Return the Newton step; None if the flow is not finite or the conditions are linearly dependent."""
    ends = _EndConditions.integrate_to_end_conditions(problem, s, switches, steps)
    flow, size, free = ends.flow, ends.size, ends.free
    if not np.isfinite(flow.final_state_sensitivity).all():
        return None
    changes = np.vstack([flow.initial_sensitivity[:size], flow.final_state_sensitivity[:size]])
    zero_multipliers = np.zeros(ends.residuals.size - ends.fixed.size)
    cost_gradient, jacobian, _ = ends.differentiate_cost_and_end_conditions(zero_multipliers)
    rows = np.vstack([flow.final_state_sensitivity[ends.fixed], jacobian @ changes])[:, free]
    if not are_gradients_independent(rows):
        return None  # undetermined multipliers diverge in the collocated problem
    gradient = (cost_gradient @ changes)[free]
    multipliers = np.asarray(np.linalg.lstsq(rows.T, -gradient, rcond=RANK)[0])
    adjoint, cost_gradient, curvature = ends.compute_lagrangian_derivatives(multipliers)
    hessian = (flow.compute_adjoint_hessian(adjoint) + changes.T @ curvature @ changes)[np.ix_(free, free)]
    change = minimise_quadratic_model(hessian, gradient, rows, ends.residuals)
    gain = ends.compute_relative_cost_change(float(gradient @ change))
    return NewtonStep(ends.expand_change(change), flow, adjoint, multipliers, gain, hessian, rows, steps)


def compute_simplified_newton_step(
    problem: Problem,
    s: PhaseSamples,
    switches: Switches,
    known_step: NewtonStep,
    steps: int = FLOW_INITIAL_STEPS,
    refinement: int = 1,
) -> NewtonStep | None:
    """Return the step with the matrices of one for nearby switches in the same order; None if the flow is not finite.

    ``steps`` is the number of grid steps, ``refinement`` the number of parts into which each is divided.
    """
    ends = _EndConditions.integrate_to_end_conditions(problem, s, switches, steps, refinement)
    if not np.isfinite(ends.flow.final_state).all():
        return None
    adjoint, slope, _ = ends.compute_lagrangian_derivatives(known_step.multipliers)
    initial_gradient = slope[: ends.size] @ ends.flow.initial_sensitivity[: ends.size]
    gradient = (ends.flow.compute_adjoint_gradient(adjoint) + initial_gradient)[ends.free]
    change = minimise_quadratic_model(known_step.hessian, gradient, known_step.rows, ends.residuals)
    residual = gradient + known_step.hessian @ change
    multipliers = known_step.multipliers - np.linalg.lstsq(known_step.rows.T, residual, rcond=RANK)[0]
    cost_change = float((gradient - known_step.rows.T @ known_step.multipliers) @ change)
    gain, matrices = ends.compute_relative_cost_change(cost_change), (known_step.hessian, known_step.rows)
    return NewtonStep(ends.expand_change(change), ends.flow, adjoint, multipliers, gain, *matrices, steps)


class _EndConditions:
    """Flow, its end conditions and their ``residuals``: those of fixed final states, then of boundary constraints.

    ``size`` is the number of states, integrals and time; ``fixed`` and ``free`` select final states and unknowns.
    """

    def __init__(self, problem: Problem, s: PhaseSamples, flow: BangBangFlow) -> None:
        phase, n, limits = s.phase, s.phase.states.size, problem.get_boundary_constraint_bounds()
        self.problem, self.s, self.flow, self.size = problem, s, flow, n + phase.integrals.size + 1
        self.fixed = np.flatnonzero(phase.final_bounds.is_fixed)
        self.free = np.ones(flow.initial_sensitivity.shape[1], dtype=bool)
        self.free[[0, -1]] = ~np.append(phase.initial_time_bounds.is_fixed, phase.final_time_bounds.is_fixed)
        ends = flow.initial[: self.size], flow.final_state[: self.size]
        (start, _, begin), (final, integrals, end) = (np.split(v, [n, self.size - 1]) for v in ends)
        numbers = s.functions.p, s.functions.q, np.zeros(limits.lower.size)
        arguments = (start, final, begin, end, integrals, *numbers)
        end_values = evaluate_casadi_batch(get_endpoint_value_function(problem), 1, *arguments)[:, 0]
        self.cost = float(end_values[-1])
        final_state_residuals = flow.final_state[self.fixed] - phase.final_bounds.lower[self.fixed]
        self.residuals = np.append(final_state_residuals, end_values[:-1] - limits.lower)

    @classmethod
    def integrate_to_end_conditions(
        cls, problem: Problem, s: PhaseSamples, switches: Switches, steps: int, refinement: int = 1
    ) -> _EndConditions:
        piecewise = switches.build_piecewise_control(switches.chronological_switch_order)
        no_rows = np.zeros(0, dtype=int)
        return cls(problem, s, integrate_bang_bang_flow(problem, s, piecewise, no_rows, refinement, steps))

    def differentiate_cost_and_end_conditions(self, nu: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives of cost and constraints in both ends: gradient of their sum, Jacobian, Hessian."""
        problem = self.problem
        functions = problem.memoize("end derivatives", lambda: build_endpoint_derivative_function(problem))
        end_points = self.flow.initial[: self.size], self.flow.final_state[: self.size]
        slope, jacobian, hessian = functions(*end_points, self.s.functions.p, self.s.functions.q, nu)
        return slope.full()[:, 0], jacobian.full(), hessian.full()

    def compute_lagrangian_derivatives(self, multipliers: Array) -> tuple[Array, Array, Array]:
        """Return the cost gradient (final values), and gradient and Hessian of the Lagrangian in both ends."""
        on_states, nu = np.split(multipliers, [self.fixed.size])
        slope, _, curvature = self.differentiate_cost_and_end_conditions(nu)
        adjoint = np.zeros(self.flow.final_state.size)
        adjoint[: self.size] = slope[self.size :]
        adjoint[self.fixed] += on_states
        return adjoint, slope, curvature

    def compute_relative_cost_change(self, change: float) -> float:
        return abs(change) / max(abs(self.cost), TINY)

    def expand_change(self, change: Array) -> Array:
        """Return the changes of all unknowns (n_switches + 2,) from those of the free ones."""
        changes = np.zeros(self.free.size)
        changes[self.free] = change
        return changes


def are_gradients_independent(rows: Array) -> bool:
    """Return whether gradients of conditions are linearly independent, independent of the units."""
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    return bool(np.all(sizes > 0) and np.linalg.matrix_rank(rows / sizes, RANK) == rows.shape[0])


def minimise_quadratic_model(hessian: Array, gradient: Array, rows: Array, residuals: Array) -> Array:
    """Return the minimiser of a quadratic model under linear conditions, with negative curvatures reversed."""
    feasible = np.linalg.lstsq(rows, -residuals, rcond=RANK)[0]
    basis = np.linalg.qr(rows.T, mode="complete")[0][:, rows.shape[0] :]
    if not basis.shape[1]:
        return np.asarray(feasible)
    curvatures, directions = np.linalg.eigh(basis.T @ hessian @ basis)
    floor = RANK * np.max(np.abs(curvatures))
    slopes = directions.T @ (basis.T @ (gradient + hessian @ feasible))
    return np.asarray(feasible - basis @ (directions @ (slopes / np.maximum(np.abs(curvatures), floor))))


STEP_PARTS = 3
"""Parts of every grid step for the estimate of the integration error."""

NEW_ARC_INSET_SHARE = 0.25
"""Distance of a new arc from the ends of the interval with the wrong sign, relative to the interval."""


@dataclass(frozen=True, eq=False)
class BangBangExtremal:
    """A phase integrated on a grid `STEP_PARTS` times as fine as that of a step; ``step`` is the Newton step there."""

    s: PhaseSamples
    switches: Switches
    step: NewtonStep

    @classmethod
    def integrate_phase(
        cls, problem: Problem, s: PhaseSamples, switches: Switches, known_step: NewtonStep
    ) -> BangBangExtremal | None:
        """Return a phase integrated with the matrices and the grid of a known step; None if it is not finite."""
        step = compute_simplified_newton_step(problem, s, switches, known_step, known_step.steps, STEP_PARTS)
        return None if step is None else cls(s, switches, step)

    def is_cost_accurate(self, accuracy: float) -> bool:
        """Return whether the cost changes less than the accuracy by the coarser grid, and no arc is missing."""
        return self.step.gain < accuracy and self.missing_bang_arc is None

    @property
    def integration_grid_times(self) -> Array:
        """Times of the grid (n_steps + 1,)."""
        phase = self.s.phase
        return np.asarray(self.step.flow.states[phase.states.size + phase.integrals.size])

    @property
    def step_times(self) -> Array:
        """Ends of the integration steps (s) with which the trajectory is accurate."""
        return self.integration_grid_times[::STEP_PARTS]

    @property
    def states(self) -> Array:
        """States (n_states, n_steps + 1)."""
        return self.step.flow.states[: self.s.phase.states.size]

    @cached_property
    def costates(self) -> Array:
        """Costates (n_states, n_steps + 1)."""
        return self.step.flow.integrate_adjoint_equation(self.step.adjoint)[: self.s.phase.states.size]

    def build_solution(self, known_solution: Solution) -> Solution:
        """Return the trajectory, which may exceed limits, as a solution with one point per integration step."""
        s, grid = self.s, self.integration_grid_times
        first_samples = STEP_PARTS * np.flatnonzero(np.diff(self.step_times) > 0)
        segment_samples = first_samples[:, None] + np.arange(STEP_PARTS + 1)
        breaks, controls = np.append(grid[first_samples], grid[-1]), self.step.flow.controls[:, first_samples]
        sample_indices, u = segment_samples.ravel(), np.repeat(controls, STEP_PARTS + 1, axis=1)
        x, lam = self.states[:, sample_indices], self.costates[:, sample_indices]
        mu = np.zeros((len(s.phase.path_labels), sample_indices.size))
        costate_rates = -s.functions.state_gradient(grid[sample_indices], x, u, lam, mu)
        x_polynomial = _interpolate_hermite(breaks, x, s.functions.state_rates(grid[sample_indices], x, u))
        lam_polynomial = _interpolate_hermite(breaks, lam, costate_rates)
        phase = replace(
            s.phase,
            mesh=Mesh(tuple((breaks - breaks[0]) / (breaks[-1] - breaks[0])), (1,) * first_samples.size),
            x=x_polynomial,
            u=PiecewisePolynomial(breaks, (np.zeros(1),) * first_samples.size, tuple(controls.T[:, :, None])),
            lam=lam_polynomial,
            lam_start=self.costates[:, segment_samples[:, 0]],
            lam_end=self.costates[:, segment_samples[:, -1]],
        )
        return _build_solution_from_bang_bang_flow(known_solution, phase, self.step, self.step.flow)

    @cached_property
    def missing_bang_arc(self) -> tuple[int, float, float] | None:
        """Return control, start and end of an arc at the largest violation of a sign; None if all signs are right."""
        s, times = self.s, self.integration_grid_times
        controls = np.column_stack([self.step.flow.controls, self.step.flow.controls[:, -1]])
        values = s.functions.switching_functions(times, self.states, controls, self.costates)
        violations = np.where(controls == s.phase.control_bounds.upper[:, None], values, -values)
        violations /= np.max(np.abs(values), axis=1, keepdims=True)
        for violation, levels in zip(violations, controls, strict=True):
            clear_violations_near_switches(violation, levels)
        i, j = (int(k) for k in np.unravel_index(int(np.argmax(violations)), violations.shape))
        if violations[i, j] < NEGLIGIBLE:
            return None
        start, end = find_largest_violation_interval(times, violations[i])
        inset = NEW_ARC_INSET_SHARE * (end - start)
        return i, start + inset * (start > times[0]), end - inset * (end < times[-1])


def _interpolate_hermite(breaks: Array, values: Array, rates: Array) -> PiecewisePolynomial:
    """Return polynomials through values and rates, (n, K * 4), at the ends and at thirds of every segment."""
    halves, rows, tau = 0.5 * np.diff(breaks), values.shape[0], np.linspace(-1.0, 1.0, STEP_PARTS + 1)
    powers = np.arange(2 * tau.size)
    nodes = -np.cos(np.pi * powers / powers[-1])
    rate_conditions = powers * tau[:, None] ** np.maximum(powers - 1, 0)
    conditions = np.vstack([tau[:, None] ** powers, rate_conditions])
    basis = nodes[:, None] ** powers @ np.linalg.inv(conditions)
    data = values.reshape(rows, halves.size, -1), rates.reshape(rows, halves.size, -1) * halves[:, None]
    node_values = np.concatenate(data, axis=2) @ basis.T
    return PiecewisePolynomial(breaks, (nodes,) * halves.size, tuple(node_values.transpose(1, 0, 2)))


def collocate_trajectory(known_solution: Solution, extremal: BangBangExtremal, arc_mesh: ArcMesh) -> Solution:
    """Return the converged trajectory of a one-phase solution at the collocation points of a mesh with one degree.

    It may exceed limits. The mesh is that of the structure after the last Newton step.
    """
    problem, s, n = known_solution.need_problem("refine"), extremal.s, extremal.s.phase.states.size
    phase, mesh, boundary_times = s.phase, arc_mesh.build_mesh(), arc_mesh.structure.times
    breaks = boundary_times[0] + np.asarray(mesh.breaks) * (boundary_times[-1] - boundary_times[0])
    breaks[-1] = boundary_times[-1]
    rule = get_collocation_rule(phase.scheme, mesh.degrees[0])
    tau = np.unique([-1.0, *rule.state_nodes, *rule.points, 1.0])
    steps, half_lengths = tau.size - 1, 0.5 * np.diff(breaks)[:, None]
    times = np.append(breaks[:-1, None] + half_lengths * (1 + tau[:-1]), breaks[-1])
    kinds = arc_mesh.structure.control_arc_kinds[:, arc_mesh.segment_subarc_indices]
    lower, upper = phase.control_bounds.lower[:, None], phase.control_bounds.upper[:, None]
    controls = np.where(kinds == ArcKind.UPPER, upper, lower)
    piecewise = PiecewiseControl(times, np.repeat(controls, steps, axis=1), np.arange(times.size))
    longest, known_step = (np.max(np.diff(grid)) for grid in (times, extremal.integration_grid_times))
    substeps = max(1, round(longest / known_step))
    flow = integrate_bang_bang_flow(problem, s, piecewise, np.zeros(0, dtype=int), substeps, 1)
    end_conditions = _EndConditions(problem, s, flow)
    final_costates = end_conditions.compute_lagrangian_derivatives(extremal.step.multipliers)[0]
    x, lam = flow.states[:n, ::substeps], flow.integrate_adjoint_equation(final_costates)[:n, ::substeps]
    points = np.add.outer(steps * np.arange(mesh.segments), np.searchsorted(tau, rule.points)).ravel()
    u, mu = np.repeat(controls, rule.n, axis=1), np.zeros((len(phase.path_labels), mesh.size))
    rates = s.functions.state_rates(times[points], x[:, points], u)
    costate_rates = -s.functions.state_gradient(times[points], x[:, points], u, lam[:, points], mu)

    def integrate_rates(nodes: Array, values: Array, slopes: Array) -> PiecewisePolynomial:
        """Return polynomials with given values at the starts of segments and rates at the points (n, N)."""
        changes = slopes.reshape(n, -1, rule.n) @ rule.build_integration_matrix(nodes).T
        values = values[:, :-1:steps, None] + half_lengths * changes
        return PiecewisePolynomial(breaks, (nodes,) * mesh.segments, tuple(values.swapaxes(0, 1)))

    nodes = np.append(rule.points, 1.0) if phase.scheme == "LG" else rule.state_nodes
    lam_polynomial = integrate_rates(nodes, lam, costate_rates)
    collocated = replace(
        phase,
        mesh=mesh,
        x=integrate_rates(rule.state_nodes, x, rates),
        u=interpolate_point_values(breaks, (rule,) * mesh.segments, u),
        lam=lam_polynomial,
        lam_start=lam[:, :-1:steps],
        lam_end=lam[:, steps::steps],
    )
    return replace(
        _build_solution_from_bang_bang_flow(known_solution, collocated, extremal.step, flow),
        structure=(),
        statistics=Statistics(0, 0.0, 0.0, 0.0, 0.0),
        provenance={**known_solution.provenance, "mesh": f"{phase.name} {mesh}"},
    )


def _build_solution_from_bang_bang_flow(
    base: Solution, phase: PhaseSolution, step: NewtonStep, flow: BangBangFlow
) -> Solution:
    """Return a one-phase solution with the trajectory of a phase and the costs of its flow, without active limits."""
    n = phase.states.size
    found = replace(
        phase,
        initial_time=float(phase.x.breaks[0]),
        final_time=float(phase.x.breaks[-1]),
        path_multipliers=np.zeros((len(phase.path_labels), phase.mesh.size)),
        state_multipliers=np.zeros((n, phase.mesh.size)),
        state_impulses=np.zeros((n, phase.mesh.segments + 1)),
        duration_multiplier=0.0,
        integrals=flow.final_state[n : n + phase.integrals.size],
    )
    found = replace(found, point_costates=phase.lam(found.point_times))
    nu = step.multipliers[int(np.sum(phase.final_bounds.is_fixed)) :]
    return compute_cost_and_multipliers(replace(base, phases={phase.name: found}, constraint_multipliers=nu))


def satisfies_inequality_limits(trajectory: Solution, state_scale: Array) -> bool:
    """Return whether states and path constraints at the samples, and end values, are within inequality limits."""
    (s,) = trajectory.samples().values()
    phase = s.phase
    limits = (
        (phase.final_bounds, phase.x(phase.final_time), state_scale),
        (phase.initial_time_bounds, phase.initial_time, s.span),
        (phase.final_time_bounds, phase.final_time, s.span),
        (phase.duration_bounds, phase.duration, s.span),
    )
    excess = [(box.compute_bound_violation(np.atleast_1d(value)), scale) for box, value, scale in limits]
    is_feasible = all(np.all(violation <= AT_LIMIT * scale) for violation, scale in excess)
    violation = phase.path_bounds.compute_bound_violation(s.functions.path_constraints(s.times, s.x, s.u))
    is_feasible &= not np.any(violation) or bool(np.all(violation < AT_LIMIT * s.path_scale[:, None]))
    violation = phase.state_bounds.compute_bound_violation(s.x)
    return is_feasible and bool(np.all(violation < AT_LIMIT * state_scale[:, None]))


def compute_cost_and_multipliers(trajectory: Solution) -> Solution:
    """Return the trajectory with its cost, and the multipliers of limits computed from its costates."""
    (phase,) = trajectory.phases.values()
    ends, functions = get_endpoint_gradients(trajectory), trajectory.phase_functions(phase.name)
    end_times, lam = phase.breaks[[0, -1]], np.stack([phase.lam_start[:, 0], phase.lam_end[:, -1]], axis=1)
    x = np.stack([phase.x(end_times[0]), phase.x(end_times[1], "left")], axis=1)
    u = np.stack([phase.applied(end_times[0]), phase.applied(end_times[1], "left")], axis=1)
    time_gradient = np.array([ends.initial_time[phase.name], -ends.final_time[phase.name]])
    time_residual = functions.hamiltonian(end_times, x, u, lam) - time_gradient
    is_time_fixed = np.concatenate([phase.initial_time_bounds.is_fixed, phase.final_time_bounds.is_fixed])
    impulses = np.zeros_like(phase.state_impulses)
    impulses[:, 0] = -lam[:, 0] - ends.initial_state[phase.name]
    impulses[:, -1] = lam[:, 1] - ends.final_state[phase.name]
    times, mu = phase.point_times, np.zeros((len(phase.path_labels), phase.point_times.size))
    point_arguments = times, phase.x(times), phase.applied(times), phase.point_costates, mu
    gradient = functions.control_gradient(*point_arguments)
    completed: PhaseSolution = replace(
        phase,
        time_multipliers=np.where(is_time_fixed, time_residual * np.array([1.0, -1.0]), 0.0),
        state_impulses=impulses,
        control_multipliers=-gradient,
    )
    return replace(
        trajectory,
        phases={phase.name: completed},
        objective=ends.cost,
        constraint_values=ends.constraints,
        history=None,
    )
