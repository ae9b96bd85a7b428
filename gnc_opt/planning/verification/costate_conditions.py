r"""Pontryagin's minimum principle: costates, Hamiltonian and multipliers.

With :math:`H = w^T L + \lambda^T f`, :math:`H_a = H + \mu^T c` and :math:`\tilde\Phi = \Phi + \nu^T\psi`, a minimum
satisfies (Bryson & Ho, Applied Optimal Control, 1975, ch. 2-3; Hartl, Sethi & Vickson, SIAM Review 37(2), 1995)

* :math:`\dot\lambda = -\partial H_a/\partial x - z_x` with jumps only where a state
  constraint is active (module `active_state_constraints`),
* :math:`\lambda(t_0) = -\partial\tilde\Phi/\partial x_0` and :math:`\lambda(t_f) = \partial\tilde\Phi/\partial x_f`
  in components that are free there, :math:`H(t_f) = -\partial\tilde\Phi/\partial t_f` and
  :math:`H(t_0) = \partial\tilde\Phi/\partial t_0` at free times,
* :math:`dH/dt = \partial H_a/\partial t`, with jumps where a moving state constraint is active,
* u minimises H among the admissible controls (module `minimum_principle`).

Gradients are multiplied by the reach of the states and divided by the cost scale (module `optimality_check_scales`).

A constraint :math:`c(t, x) \le 0` that is active only at an end of a phase has an atom :math:`\eta \ge 0` there (Hartl,
Sethi & Vickson, theorem 4.1). The second-order conditions treat it as a boundary constraint with :math:`\nu = \eta`.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array, Indices
from gnc_opt.numerical_tolerances import AT_LIMIT, ROUNDING, set_nonfinite_to_zero
from gnc_opt.planning.optimality.active_state_constraints import (
    explain_costate_jumps,
    explain_transversality_residual,
    integrate_multipliers_near_boundaries,
)
from gnc_opt.planning.optimality.optimality_check_scales import Scales
from gnc_opt.planning.problem.bounds import Interval, stack_intervals
from gnc_opt.planning.problem.constraints import make_constraint
from gnc_opt.planning.problem.hamiltonian_functions import EndGradients
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.solution.defects_and_violations import NO_VIOLATION, Worst
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.verification.feasibility import compute_path_value_changes, locate_maximum_over_time
from gnc_opt.planning.verification.solution_data_check import get_endpoint_gradients

ENDS = (("initial", 0), ("final", -1))
"""Ends of a phase and their samples."""


def impose_constraints_active_at_ends(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients
) -> tuple[Solution, EndGradients]:
    """Return the solution and its end gradients, with these constraints as boundary constraints with multipliers."""
    active = [(s, end, k, _find_constraints_active_at_end(s, k)) for s in samples for end, k in ENDS]
    nonempty = [entry for entry in active if entry[-1].size]
    if not nonempty:
        return solution, ends
    problem, multipliers = solution.need_problem("verify").clone(), [solution.constraint_multipliers]
    for s, end, k, rows in nonempty:
        phase = problem.phases[s.phase.name]
        box = phase.get_path_bounds()
        for row in rows:
            label = f"{s.phase.path_labels[row]}, {end} end of phase {s.phase.name}"
            expression = _express_path_constraint_at_end(phase, row, end)
            problem.constraints[label] = make_constraint(
                label, expression, box.lower[row], box.upper[row], None, f"constraint '{label}'"
            )
        multipliers.append(explain_transversality_residual(s, k, ends).multipliers[rows])
    problem.clear_cache()
    problem_at_ends = replace(
        solution,
        problem=problem,
        constraint_multipliers=np.concatenate(multipliers),
        constraint_labels=problem.constraint_labels(),
    )
    return problem_at_ends, get_endpoint_gradients(problem_at_ends)


def _find_constraints_active_at_end(s: PhaseSamples, k: int) -> Indices:
    """Return pure state path constraints that are active at an end of the phase, but not at the next point."""
    phase, state_rows = s.phase, s.pure_state_constraints
    end, point = s.times[[k]], phase.point_times[[k]]
    values = np.hstack([s.functions.path_constraints(t, phase.x(t), phase.applied(t)) for t in (end, point)])
    at_limit = np.any(phase.path_bounds.is_near_limits(values, AT_LIMIT * s.path_scale), axis=0)
    at_limit &= ~phase.path_bounds.is_fixed[:, None]
    return np.asarray(state_rows[at_limit[state_rows, 0] & ~at_limit[state_rows, 1]])


def _express_path_constraint_at_end(phase: Phase, row: int, end: str) -> ca.SX:
    t, x, _, _ = phase.model.symbolic_arguments()
    time = phase.initial_time if end == "initial" else phase.final_time
    at_end = ca.vertcat(time, phase.end_states(end))
    return ca.substitute(phase.path_expression()[int(row)], ca.vertcat(t, x), at_end)


def check_adjoint_equation(samples: list[PhaseSamples], scales: Scales, tolerance: float) -> Worst:
    """Return the residual of the adjoint equation, and costate jumps without an active state constraint."""
    worst = NO_VIOLATION
    for s in samples:
        ellipsoid, cost = scales.phases[s.phase.name].along, scales.cost
        share, total = _evaluate_costate_residuals(s, s.mu, scales, tolerance)
        if s.pure_state_constraints.size:
            share = np.fmin(
                share, _evaluate_costate_residuals(s, _remove_multiplier_impulses(s), scales, tolerance)[0]
            )
        k = int(np.argmax(share))
        location = s.describe_segment(
            k, f"adjoint equation of {_find_state_of_costliest_gradient(s, total[:, k], ellipsoid.radius)}"
        )
        worst = worst.select_larger(Worst(float(share[k]), location))
        if s.phase.mesh.segments > 1:
            jumps = explain_costate_jumps(s)[0]
            share = ellipsoid.support_function(jumps) / cost
            share = np.where(np.isnan(share), np.inf, share)
            k = int(np.argmax(share))
            label = _find_state_of_costliest_gradient(s, jumps[:, k], ellipsoid.radius)
            location = s.describe_time(s.phase.breaks[k + 1], f"jump of the costate of {label}")
            worst = worst.select_larger(Worst(float(share[k]), location))
    return worst


def _find_state_of_costliest_gradient(s: PhaseSamples, gradient: Array, radius: Array) -> str:
    """Return the label of the state whose gradient costs most along its reach."""
    return s.phase.states.labels[int(np.argmax(np.abs(gradient) * radius))]


def _evaluate_costate_residuals(
    s: PhaseSamples, mu: Array, scales: Scales, tolerance: float
) -> tuple[Array, Array]:
    """Return the violation of the adjoint equation over each segment (K,), and its integral (n_states, K)."""
    scale = scales.phases[s.phase.name].along
    residual = s.adjoint_residual(s.u, mu)
    total = s.integrate_over_segments(residual)
    partial_sums = s.segment_maxima(scale.support_function(s.cumulative_integrals(residual)))
    violation = np.fmax(scale.support_function(total), partial_sums * np.sqrt(tolerance)) / scales.cost
    return np.where(np.all(np.isfinite(total), axis=0), violation, np.inf), total


def _remove_multiplier_impulses(s: PhaseSamples) -> Array:
    """Return path multipliers (n_paths, n_samples) from interior points of segments; boundary points have atoms."""
    phase = s.phase
    is_inner = [
        np.abs(rule.points) < 1 if rule.n > 2 else np.ones(rule.n, dtype=bool)
        for rule in phase.collocation_rules
    ]
    nodes = tuple(rule.points[inner] for rule, inner in zip(phase.collocation_rules, is_inner, strict=True))
    values = tuple(v[:, inner] for v, inner in zip(phase.path_multiplier.values, is_inner, strict=True))
    mu, state_rows = s.mu.copy(), s.pure_state_constraints
    mu[state_rows] = s.sample_signal(PiecewisePolynomial(phase.breaks, nodes, values))[state_rows]
    return mu


def check_transversality(samples: list[PhaseSamples], ends: EndGradients, scales: Scales) -> Worst:
    """Return the residuals of the transversality conditions, of costates at free ends and of H at free times."""
    worst = NO_VIOLATION
    for s in samples:
        sizes = scales.phases[s.phase.name]
        # Only a multiplier admissible for the bounds at this end can explain the gap.
        gaps = {end: explain_transversality_residual(s, k, ends) for end, k in (("start", 0), ("end", -1))}
        for (end, gap), k, ellipsoid in zip(gaps.items(), (0, -1), (sizes.start, sizes.end), strict=True):
            residual = gap.gap - gap.explained
            residual = np.copysign(
                _compute_wrong_sign_multipliers(residual, s.x[:, k], gap.limits, s.state_scale), residual
            )
            violation = float(ellipsoid.support_function(residual)) / scales.cost
            if end == "end":
                violation = max(violation, scales.estimate_control_change_by_costate_gap(s, residual))
            state = _find_state_of_costliest_gradient(s, residual, ellipsoid.radius)
            location = f"phase {s.phase.name}, {end}, costate of {state}"
            worst = worst.select_larger(Worst(violation, location))
        drifts = np.array([gap.drift for gap in gaps.values()])
        worst = worst.select_larger(_check_time_transversality(s, ends, drifts, scales))
    return worst


def _check_time_transversality(s: PhaseSamples, ends: EndGradients, drifts: Array, scales: Scales) -> Worst:
    """Return the residual for free times; ``drifts`` (2,) are contributions of time-dependent path constraints."""
    phase, name = s.phase, s.phase.name
    bounds, length = phase.duration_bounds, np.array([phase.duration])
    # A multiplier of the duration counts only if a bound of the duration is active.
    multiplier = np.array([phase.duration_multiplier])
    wrong = np.copysign(_compute_wrong_sign_multipliers(multiplier, length, bounds, length), multiplier)
    duration = float((multiplier - wrong)[0])
    gaps = np.array(
        [
            s.hamiltonian[0] - ends.initial_time[name] + duration,
            -s.hamiltonian[-1] - ends.final_time[name] - duration,
        ]
    )
    gaps -= drifts
    box = stack_intervals([phase.initial_time_bounds, phase.final_time_bounds])
    times = np.array([phase.initial_time, phase.final_time])
    width = box.upper - box.lower
    span = np.maximum(s.span, set_nonfinite_to_zero(width))
    # Multipliers exist only for times that are variables.
    mismatch = np.where(phase.time_multipliers != 0, np.abs(phase.time_multipliers - gaps), 0.0)
    violation = (
        np.maximum(_compute_wrong_sign_multipliers(gaps, times, box, span), mismatch) * s.span / scales.cost
    )
    i = int(np.argmax(violation))
    worst = Worst(float(violation[i]), f"phase {name}, H at its {('start', 'end')[i]}")
    return worst.select_larger(
        Worst(float(np.abs(wrong[0])) * s.span / scales.cost, f"phase {name}, multiplier of its duration")
    )


def _compute_wrong_sign_multipliers(
    multipliers: Array, values: Array, bounds: Interval, scale: Array
) -> Array:
    """Return the size of inadmissible bound multipliers: > 0 requires the upper, < 0 the lower bound to be active."""
    at_lower, at_upper = bounds.is_near_limits(values, AT_LIMIT * scale)
    # A fixed value allows any multiplier; the boundary conditions check the value.
    allowed = np.where(multipliers > 0, at_upper, at_lower) | bounds.is_fixed
    return np.where(allowed, 0.0, np.abs(multipliers))


def check_complementarity(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, scales: Scales
) -> Worst:
    """Return the largest effect on the cost of a multiplier of an inactive limit, or of one with the wrong sign."""
    worst = _check_boundary_multipliers(solution, ends, scales)
    for s in samples:
        own = scales.phases[s.phase.name]
        worst = worst.select_larger(_check_costate_jumps_at_state_bounds(s, scales))
        phase, times = s.phase, s.phase.point_times
        x, u = phase.x(times), np.hstack(phase.u.values)
        paths = s.functions.path_constraints(times, x, u)
        # A density is weighted by its share of the phase: in a small cell next to a jump it may be large.
        peak = np.max(own.deviation, axis=1)
        for labels, multipliers, values, box, scale in (
            (phase.states.labels, phase.state_multipliers, x, phase.state_bounds, own.along.radius[:, None]),
            (phase.controls.labels, phase.control_multipliers, u, phase.control_bounds, peak[:, None]),
            (
                phase.path_labels,
                phase.path_multipliers,
                paths,
                phase.path_bounds,
                compute_path_value_changes(s, scales, times, x, u),
            ),
        ):
            violation = (
                _compute_complementarity_products(multipliers, values, box, scale)
                * phase.point_weights
                / scales.cost
            )
            locations = [f"multiplier of {label}" for label in labels]
            worst = worst.select_larger(locate_maximum_over_time(s, violation, times, locations))
    return worst


def _check_boundary_multipliers(solution: Solution, ends: EndGradients, scales: Scales) -> Worst:
    """Return multipliers of boundary constraints that are not active at the required limit."""
    nu, values = solution.constraint_multipliers, ends.constraints
    bounds = solution.need_problem("verify").get_boundary_constraint_bounds()
    boundary = scales.boundary[1.0]
    changes = (np.sqrt(np.diag(boundary.gramian)) + 0.5 * boundary.curvature)[: nu.size]
    violation = (
        _compute_complementarity_products(nu[:, None], values[:, None], bounds, changes[:, None])[:, 0]
        / scales.cost
    )
    locations = [f"multiplier of constraint {label}" for label in solution.constraint_labels]
    return Worst.find_largest_value(violation, locations.__getitem__)


def _check_costate_jumps_at_state_bounds(s: PhaseSamples, scales: Scales) -> Worst:
    """Return impulses of state bounds at inner segment boundaries that are not active at the required limit."""
    phase, breaks = s.phase, s.phase.breaks[1:-1]
    impulses, nearby = (
        phase.state_impulses[:, 1:-1],
        integrate_multipliers_near_boundaries(s, phase.state_multipliers),
    )
    compensated = np.clip(impulses, np.minimum(-nearby, 0.0), np.maximum(-nearby, 0.0))
    radius = scales.phases[phase.name].along.radius[:, None]
    remaining, x = impulses - compensated, phase.x(breaks)
    products = _compute_complementarity_products(remaining, x, phase.state_bounds, radius)
    locations = [f"impulse on {label}" for label in phase.states.labels]
    return locate_maximum_over_time(s, products / scales.cost, breaks, locations)


def _compute_complementarity_products(
    multipliers: Array, values: Array, bounds: Interval, scale: Array
) -> Array:
    """Return |multiplier| times the distance to its limit (at most the scale)."""
    to_upper = np.minimum(np.abs(bounds.upper[:, None] - values), scale)
    to_lower = np.minimum(np.abs(values - bounds.lower[:, None]), scale)
    return np.abs(multipliers) * np.where(multipliers > 0, to_upper, to_lower)


def check_parameter_stationarity(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, scales: Scales
) -> Worst:
    """Return the largest change of the cost if a free parameter varies by its deviation within its bounds."""
    values, bounds = solution.parameter_values, solution.need_problem("verify").get_parameter_bounds()
    gradient, magnitudes = ends.parameters.copy(), np.abs(ends.parameters)
    for s in samples:
        density = s.functions.parameter_gradient(s.times, s.x, s.u, s.lam, s.mu)
        atoms = _compute_contact_parameter_gradients(s, ends)
        gradient = gradient + density @ s.weights + np.sum(atoms, axis=1)
        magnitudes = magnitudes + np.abs(density) @ s.weights
    # L + z q stationary: the multiplier of a bound is -gradient.
    slope = np.where(np.abs(gradient) > ROUNDING * magnitudes, gradient, 0.0)
    scale = scales.parameters[:, None]
    violation = (
        _compute_complementarity_products(-slope[:, None], values[:, None], bounds, scale)[:, 0] / scales.cost
    )
    locations = [f"parameter {label}" for label in solution.free_parameters.labels]
    return Worst.find_largest_value(violation, locations.__getitem__)


def _compute_contact_parameter_gradients(s: PhaseSamples, ends: EndGradients) -> Array:
    """Return the parameter gradients of atoms of path constraints that are touched or active at an end (q, n_atoms)."""
    phase = s.phase
    end_atoms = [explain_transversality_residual(s, k, ends).multipliers for k in (0, -1)]
    atoms = np.column_stack([end_atoms[0], explain_costate_jumps(s)[1], end_atoms[1]])
    x, u = phase.x(phase.breaks), phase.applied(phase.breaks)
    no_costates = np.zeros_like(x)
    by_parameter, without_atoms = (
        s.functions.parameter_gradient(phase.breaks, x, u, no_costates, mu) for mu in (atoms, 0.0 * atoms)
    )
    return np.asarray(by_parameter - without_atoms)
