r"""Feasibility conditions: dynamics, limits, boundary conditions and cost of the trajectory.

Displacements are relative to the reach of the states, cost changes to the cost scale (`optimality_check_scales`).
A defect of the differential equation has three measures: its signed integral over a segment; its running integral
inside a segment, times the square root of the tolerance, because it changes the cost only to second order there; its
effect on the cost, :math:`\int\lambda^T(\dot x - f)\,dt`. The control is the applied one, within its bounds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import ROUNDING, SHORTEST, SMALL, TINY, max_norm, replace_zeros_by_one
from gnc_opt.planning.optimality.controllability_gramian import Ellipsoid
from gnc_opt.planning.optimality.optimality_check_scales import (
    Scales,
    sample_control_deviations,
    solve_quadratic_step_to_limit,
)
from gnc_opt.planning.problem.bounds import Interval, stack_intervals
from gnc_opt.planning.problem.hamiltonian_functions import EndGradients
from gnc_opt.planning.solution.defects_and_violations import (
    NO_VIOLATION,
    Limits,
    Worst,
    compute_dynamics_residual,
    compute_propagation_errors,
    find_limit_violations,
)
from gnc_opt.planning.solution.optimality_verdict import Condition, ConditionResult
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_summary import time_unit
from gnc_opt.planning.solution.state_and_control_scales import SPAN_MIN_SHARE

SCAN_TIMES, PATH_SCAN_TIMES = 4096, 32768
"""Number of additional times at which dynamics, integrands and path constraints are evaluated; the samples may miss
narrow features in time or space, such as a gust or a small keep-out zone."""

SCALE_MAX_WIDTHS = 100.0
"""Largest reference magnitude of a limit, in interval widths; at the tolerance 1e-5, an excess of 1e-3 widths fails."""

LAYER_MIN_STEPS = 512
"""Smallest number of steps per segment with which an integral is computed again if the scan gives another value."""


def check_value_within_tolerance(name: str, worst: Worst, tolerance: float, meaning: str) -> Condition:
    """Return a condition: PASS if the value is within the tolerance, else FAIL (also for NaN)."""
    result = ConditionResult.PASS if worst.value <= tolerance else ConditionResult.FAIL
    return Condition(name, result, worst.value, tolerance, worst.where, meaning)


def combine_condition_results(passes: bool, fails: bool) -> ConditionResult:
    """Return FAIL, PASS, or INCONCLUSIVE if neither is certain."""
    if fails:
        return ConditionResult.FAIL
    return ConditionResult.PASS if passes else ConditionResult.INCONCLUSIVE


def locate_maximum_over_time(s: PhaseSamples, values: Array, times: Array, labels: Sequence[str]) -> Worst:
    """Return the largest of values (n_labels, n_times) of a phase."""
    return Worst.find_largest_value(values, lambda i, j: s.describe_time(float(times[j]), labels[i]))


def check_dynamics(samples: list[PhaseSamples], scales: Scales, tolerance: float) -> Condition:
    """Return the condition that the applied control moves the states along the trajectory, over and inside segments."""
    worst = NO_VIOLATION
    for s in samples:
        worst = worst.select_larger(_find_worst_defect(s, scales, tolerance))
    return check_value_within_tolerance(
        "dynamics",
        worst,
        tolerance,
        "The dynamics, integrated with the applied control from the start of a segment, must reach the state at its "
        "end. If they do not, refine the mesh. The violation is relative to the distance that the controls can move "
        "the states, or to the cost.",
    )


def _find_worst_defect(s: PhaseSamples, scales: Scales, tolerance: float) -> Worst:
    """Return the largest measure of a defect: over a segment, inside it, or by its effect on the cost."""
    phase, ellipsoid, dense = s.phase, scales.phases[s.phase.name].along, s.resample_at_even_times(SCAN_TIMES)
    residual, scanned = compute_dynamics_residual(s, s.u), compute_dynamics_residual(dense, dense.u)
    segment_total, scanned_total = s.integrate_over_segments(residual), dense.integrate_over_segments(scanned)
    has_jump = np.any(phase.applied.is_piecewise_constant, axis=0)  # segments with a control jump inside
    displacement = ellipsoid.normalise_displacement(segment_total)
    # Residuals contain the error of the states inside a segment, which an integration does not.
    integrated = has_jump | ((displacement > tolerance) & (np.max(displacement) <= SMALL))
    errors = compute_propagation_errors(phase, s.functions, np.flatnonzero(integrated))
    is_finite = has_jump[integrated] | np.all(np.isfinite(errors), axis=0)
    integrated[integrated], errors = is_finite, errors[:, is_finite]
    scanned_total[:, integrated] += errors - segment_total[:, integrated]
    segment_total[:, integrated] = errors
    scanned_total[:, has_jump] = 0.0
    inner = phase.breaks[1:-1]
    jumps = phase.x(inner, "right") - phase.x(inner, "left")
    measures = np.zeros(phase.mesh.segments)
    for grid, totals, defects in ((s, segment_total, residual), (dense, scanned_total, scanned)):
        totals[:, :-1] += jumps
        sums = np.where(has_jump[grid.segments], 0.0, grid.cumulative_integrals(defects))
        within = grid.segment_maxima(ellipsoid.normalise_displacement(sums)) * np.sqrt(tolerance)
        displacement = ellipsoid.normalise_displacement(totals)
        measures = np.fmax(measures, np.where(np.isnan(displacement), np.inf, np.fmax(displacement, within)))
    k = int(np.argmax(measures))
    i = int(np.argmax(np.abs(segment_total[:, k]) / np.where(ellipsoid.radius > 0, ellipsoid.radius, TINY)))
    description = phase.states.labels[i]
    if has_jump[k]:
        jumping = np.array(phase.controls.labels)[phase.applied.is_piecewise_constant[:, k]]
        description += f"; {', '.join(jumping)}: a switch within the segment is not resolved"
    worst = Worst(float(measures[k]), s.describe_segment(k, description))
    cost_effects = s.integrate_over_segments(np.sum(s.lam * residual, axis=0))
    if s.has_duration and np.all(np.isfinite(cost_effects)):
        ends = phase.lam(phase.breaks[1:], "left")
        cost_effects[has_jump] = np.sum(ends * segment_total, axis=0)[has_jump]
        effects = np.abs(np.cumsum(cost_effects)) / scales.cost
        k = int(np.argmax(effects))
        worst = worst.select_larger(Worst(float(effects[k]), s.describe_segment(k, "effect on the cost")))
    return worst


def check_trajectory_limits(
    solution: Solution, samples: list[PhaseSamples], scales: Scales, tolerance: float
) -> Condition:
    """Return the condition that applied control, states, path constraints and free parameters satisfy their limits."""
    labels = [f"parameter {label}" for label in solution.free_parameters.labels]
    bounds = solution.need_problem("verify").get_parameter_bounds()
    values = solution.parameter_values
    worst = _find_bound_violation(values, bounds, scales.parameters, labels, solution.free_parameters.units)
    for s in samples:
        worst = worst.select_larger(_find_control_violation(s, scales)).select_larger(
            _find_state_violation(s, scales)
        )
        if s.phase.path_labels:
            for grid in (s, s.resample_at_even_times(PATH_SCAN_TIMES)):
                worst = worst.select_larger(_find_path_violation(s, grid, scales))
            worst = worst.select_larger(_find_costliest_path_constraint_violation(s, scales))
    return check_value_within_tolerance(
        "limits",
        worst,
        tolerance,
        "Controls, states, path constraints and parameters must stay within their limits, also between the nodes. The "
        "violation is relative to the distance that the controls can move the states, or to the cost.",
    )


def _find_control_violation(s: PhaseSamples, scales: Scales) -> Worst:
    """Return the violation of control bounds at the nodes; between them the applied control satisfies its bounds."""
    phase = s.phase
    u = np.hstack(phase.u.values)
    scale = np.fmax(
        sample_control_deviations(s, scales, phase.point_times),
        SPAN_MIN_SHARE * np.max(np.abs(u), axis=1)[:, None],
    )
    scale = _cap_scale_by_interval_width(scale, phase.control_bounds)
    violation = phase.control_bounds.compute_bound_violation(u) / np.where(scale > 0, scale, TINY)
    return locate_maximum_over_time(s, violation, phase.point_times, phase.controls.labels)


def _find_state_violation(s: PhaseSamples, scales: Scales) -> Worst:
    peaks = find_limit_violations(s, Limits.from_interval(lambda _, x, __: x, s.phase.state_bounds))
    if not peaks.times.size:
        return NO_VIOLATION
    radius = _cap_scale_by_interval_width(scales.phases[s.phase.name].along.radius, s.phase.state_bounds)
    sizes = peaks.excess / radius[peaks.limits.rows]
    i = int(np.argmax(sizes))
    row = peaks.limits.rows[i]
    unit = s.phase.states.units[row]
    what = f"{s.phase.states.labels[row]} = {peaks.describe_violation(i)}{f' {unit}' if unit else ''}"
    return Worst(float(sizes[i]), s.describe_time(peaks.times[i], what))


def _find_path_violation(s: PhaseSamples, grid: PhaseSamples, scales: Scales) -> Worst:
    """Return the distance to the limit along the constraint gradient, at peaks and at samples that violate it."""
    limits = Limits.from_interval(s.functions.path_constraints, s.phase.path_bounds)
    peaks = find_limit_violations(grid, limits)
    if not peaks.times.size:
        return NO_VIOLATION
    sizes = _compute_limit_distances(s, scales, peaks.limits, peaks.excess, (peaks.times, peaks.x, peaks.u))
    i = int(np.argmax(sizes))
    excess = limits.compute_limit_excess(grid.times, grid.x, grid.u)
    rows, k = np.nonzero(excess > 0)
    point = grid.times[k], grid.x[:, k], grid.u[:, k]
    at_samples = _compute_limit_distances(s, scales, limits.select_limits(rows), excess[rows, k], point)
    largest = max(float(sizes[i]), float(np.max(at_samples, initial=0.0)))
    text = f"{s.phase.path_labels[peaks.limits.rows[i]]} = {peaks.describe_violation(i)}"
    return Worst(largest, s.describe_time(peaks.times[i], text))


def _compute_limit_distances(
    s: PhaseSamples, scales: Scales, limits: Limits, excess: Array, trajectory: tuple[Array, Array, Array]
) -> Array:
    """Return distances to limits (n,) relative to the reach, each at its own time."""
    rows = limits.rows
    changes = compute_path_value_changes(s, scales, *trajectory, SMALL)[rows, np.arange(rows.size)]
    changes = _cap_scale_by_interval_width(changes, s.phase.path_bounds.select_components(rows))
    excess_above_rounding = np.maximum(excess - ROUNDING * np.abs(limits.values), 0.0)
    relative = np.divide(excess_above_rounding, changes, out=np.full(changes.size, np.inf), where=changes > 0)
    return np.asarray(np.where(excess_above_rounding > 0, relative, 0.0))


def compute_path_value_changes(
    s: PhaseSamples, scales: Scales, times: Array, x: Array, u: Array, smallest: float = 1.0
) -> Array:
    """Return the changes of path constraints by deviations of states and controls (n_paths, n_times).

    Deviations of controls are at least the share ``smallest`` of the largest one along the phase.
    """
    phase_scales = scales.phases[s.phase.name]
    by_state = np.nan_to_num(s.functions.path_state_jacobian(times, x, u))
    by_control = np.nan_to_num(s.functions.path_control_jacobian(times, x, u))
    by_state = np.moveaxis(by_state, 1, 0)
    by_states = phase_scales.along.support_function((by_state.T * phase_scales.along.reached).T)
    by_states = np.where(by_states > 0, by_states, phase_scales.along.support_function(by_state))
    peak = np.max(phase_scales.deviation, axis=1)[:, None]
    deviation = np.maximum(sample_control_deviations(s, scales, times), smallest * peak)
    for vector in s.phase.vector_controls:  # directions always have length 1
        deviation[s.phase.controls.slice(vector.direction)] = peak[s.phase.controls.slice(vector.direction)]
    return np.asarray(np.hypot(by_states, np.linalg.norm(by_control * deviation, axis=1)))


def _find_costliest_path_constraint_violation(s: PhaseSamples, scales: Scales) -> Worst:
    values, bounds = s.functions.path_constraints(s.times, s.x, s.u), s.phase.path_bounds
    upper_cost = np.maximum(values - bounds.upper[:, None], 0.0) * np.maximum(s.mu, 0.0)
    lower_cost = np.maximum(bounds.lower[:, None] - values, 0.0) * np.maximum(-s.mu, 0.0)
    cost_effect = np.nan_to_num(upper_cost + lower_cost) @ s.weights / scales.cost
    locations = [f"phase {s.phase.name}, {label}, effect on the cost" for label in s.phase.path_labels]
    return Worst.find_largest_value(cost_effect, locations.__getitem__)


def check_table_ranges(solution: Solution) -> Condition:
    """Return the condition that the trajectory stays within the tables of its models."""
    worst, is_error = NO_VIOLATION, False
    for point in solution.outside_tables():
        grid = point.table.grids[point.axis]
        distance = max(grid[0] - point.value, point.value - grid[-1]) / (grid[-1] - grid[0])
        worst = worst.select_larger(Worst(distance, str(point)))
        is_error = is_error or point.table.outside == "error"
    result = combine_condition_results(not worst.value, is_error)
    meaning = (
        "The trajectory must stay within the data of each table. The violation is the distance relative to the length "
        "of the axis. The condition fails only for tables with outside='error'."
    )
    return Condition("tables", result, worst.value, 0.0, worst.where, meaning, sufficient=True)


def check_boundary_conditions(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, scales: Scales, tolerance: float
) -> Condition:
    """Return the condition that initial and final values, times and boundary constraints hold."""
    worst = NO_VIOLATION
    for s in samples:
        phase, durations = s.phase, np.full(5, s.span if s.has_duration else 1.0)
        times = np.array([phase.initial_time, phase.final_time])
        # Times in the cost and the constraints must equal the start and end of the trajectory.
        slack = 10 * SHORTEST + ROUNDING * np.max(np.abs(times))
        gaps = np.maximum(np.abs(phase.breaks[[0, -1]] - times) - slack, 0.0)
        bounds = phase.initial_time_bounds, phase.final_time_bounds, phase.duration_bounds
        box = stack_intervals([*bounds, Interval(np.zeros(2), np.zeros(2))])
        names = "initial time", "final time", "duration", "start of the trajectory", "end of the trajectory"
        labels = [f"phase {phase.name}, {what}" for what in names]
        values = np.concatenate([times, [phase.duration], gaps])
        worst = worst.select_larger(
            _find_bound_violation(values, box, durations, labels, (time_unit(solution),) * 5)
        )
    worst = worst.select_larger(
        _find_boundary_violation(*_list_boundary_values(solution, samples, ends), scales)
    )
    return check_value_within_tolerance(
        "boundary conditions",
        worst,
        tolerance,
        "Initial and final values, times, linkages and boundary constraints, computed again from the model, must hold. "
        "The violation is relative to the distance that the controls can move the end states, or to the cost.",
    )


def _cap_scale_by_interval_width(scale: Array, bounds: Interval) -> Array:
    """Return reference magnitudes (n, ...) of at most `SCALE_MAX_WIDTHS` widths of intervals, except for equalities."""
    largest = np.where(bounds.is_fixed, np.inf, SCALE_MAX_WIDTHS * (bounds.upper - bounds.lower))
    return np.fmin(scale.T, largest).T


def _list_boundary_values(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients
) -> tuple[list[tuple[str, str]], Array, Array, Interval]:
    """Return labels, units, values, multipliers and limits of boundary constraints, then of start and end states."""
    labels = [(f"constraint {label}", "") for label in solution.constraint_labels]
    values, multipliers = [ends.constraints], [solution.constraint_multipliers]
    limits = [solution.need_problem("verify").get_boundary_constraint_bounds()]
    for s in samples:
        phase, name = s.phase, s.phase.name
        values += [phase.x(phase.breaks[0]), phase.x(phase.breaks[-1])]
        gaps = s.lam[:, 0] + ends.initial_state[name], s.lam[:, -1] - ends.final_state[name]
        multipliers += [s.has_duration * gap for gap in gaps]
        limits += [phase.initial_bounds, phase.final_bounds]
        for end in ("start", "end"):
            states = zip(phase.states.labels, phase.states.units, strict=True)
            labels += [(f"phase {name}, {end}, {state}", unit) for state, unit in states]
    return labels, np.concatenate(values), np.concatenate(multipliers), stack_intervals(limits)


def _find_boundary_violation(
    labels: list[tuple[str, str]], values: Array, multipliers: Array, bounds: Interval, scales: Scales
) -> Worst:
    """Return the distance of end states and boundary constraints to their limits, or its effect on the cost."""
    whole = scales.boundary[1.0]
    signed_excess = np.maximum(values - bounds.upper, 0.0) - np.maximum(bounds.lower - values, 0.0)
    excess = np.maximum(np.abs(signed_excess) - ROUNDING * whole.terms, 0.0)
    excess[np.isnan(values)] = np.inf
    if not np.any(excess):
        return NO_VIOLATION
    distance = np.where(np.isfinite(excess), 0.0, np.inf)
    for share, changes in scales.boundary.items():
        row_scales = _cap_scale_by_interval_width(np.sqrt(np.diag(changes.gramian)), bounds)
        step = solve_quadratic_step_to_limit(excess, row_scales, changes.curvature)
        distance = np.fmax(distance, step if share == 1.0 else share * np.fmin(1.0, step))
    cost_effect = np.abs(np.nan_to_num(multipliers)) * np.nan_to_num(excess) / scales.cost
    chosen, joint = bounds.is_fixed | (excess > 0), np.inf
    if np.all(np.isfinite(distance)):
        gramian = whole.gramian[np.ix_(chosen, chosen)]
        ellipsoid = Ellipsoid.from_gramian(gramian, np.ones(int(np.sum(chosen))))
        joint = float(ellipsoid.normalise_displacement(np.copysign(distance, signed_excess)[chosen]))
    i = int(np.argmax(np.fmax(distance, cost_effect)))
    return Worst(max(joint, float(cost_effect[i])), _describe_violation(*labels[i], excess[i]))


def _describe_violation(label: str, unit: str, excess: float) -> str:
    return f"{label} off by {excess:.3g} {unit}".rstrip() if np.isfinite(excess) else f"{label} is not finite"


def check_reported_cost(
    stored: Solution,
    checked: list[PhaseSamples],
    ends: EndGradients,
    with_weights: bool,
    scales: Scales,
    tolerance: float,
) -> Condition:
    """Return the condition that cost, integrals and weights are those of the trajectory between its nodes."""
    reference = max(scales.cost, SPAN_MIN_SHARE * abs(stored.objective))
    location = f"objective = {stored.objective:.10g}, recomputed {ends.cost:.10g}"
    worst = Worst(abs(ends.cost - stored.objective) / reference, location)
    for s in checked:
        phase, saved = s.phase, stored.phases[s.phase.name]
        size = np.abs(s.functions.integrands(s.times, s.x, s.u)) @ s.weights
        scanned = integrate_cost_terms(s.resample_at_even_times(SCAN_TIMES))
        if max_norm(phase.integral_weights * (scanned - phase.integrals)) > tolerance * reference:
            # In thin layers the scan itself may be inaccurate.
            scanned = integrate_cost_terms(s.resample_at_even_times(SCAN_TIMES, LAYER_MIN_STEPS))
        rows = [
            ("integral", phase.integral_weights * (saved.integrals - phase.integrals)),
            ("peaks between the nodes of integral", phase.integral_weights * (scanned - phase.integrals)),
        ]
        if with_weights:
            rows.append(("weight of integral", size * (saved.integral_weights - phase.integral_weights)))
        for what, gap in rows:
            labels = [f"phase {phase.name}, {what} {label}" for label in phase.integral_labels]
            worst = worst.select_larger(Worst.find_largest_value(np.abs(gap) / reference, labels.__getitem__))
    return check_value_within_tolerance(
        "cost",
        worst,
        tolerance,
        "The objective and its integrals, computed again by a finer quadrature along the applied control, must agree "
        "with those of the solution. The violation is relative to the cost scale.",
    )


def integrate_cost_terms(s: PhaseSamples) -> Array:
    """Return the integrals (n_integrals,) from the quadrature of the samples."""
    return np.asarray(s.functions.integrands(s.times, s.x, s.u) @ s.weights)


def _find_bound_violation(
    values: Array, bounds: Interval, scale: Array, labels: Sequence[str], units: Sequence[str]
) -> Worst:
    excess = bounds.compute_bound_violation(values)
    scale = _cap_scale_by_interval_width(np.maximum(scale, SPAN_MIN_SHARE * np.abs(values)), bounds)
    violation = excess / replace_zeros_by_one(scale)
    excess, violation = (np.where(np.isnan(values), np.inf, v) for v in (excess, violation))
    if not np.any(violation > 0):
        return NO_VIOLATION
    i = int(np.argmax(violation))
    return Worst(float(violation[i]), _describe_violation(labels[i], units[i], excess[i]))
