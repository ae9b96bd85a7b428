"""Corrections of a control structure by its solution: arcs removed, added or moved, subarcs refined.

The time of a kink, where a control with strictly convex H enters or leaves a bound or a mixed path constraint, is fixed
during a solve ("Kinks" in ``docs/refinement.md``). The control is fixed on one side and *unbounded* on the
other. The kink then moves to the time at which the control of the interior arc meets the bound (bound arc too short) or
the switching function along the bound arc changes sign (bound arc too long). This iteration converges quadratically.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.array_types import Array, find_true_value_intervals
from gnc_opt.numerical_tolerances import (
    EQUAL,
    GONE,
    JUNCTION_OFFSET_SHARE,
    MINOR,
    NEGLIGIBLE,
    SMALL,
    TINY,
)
from gnc_opt.planning.optimality.active_state_constraints import StateConstraints
from gnc_opt.planning.optimality.sampling_at_narrow_peaks import find_zero_times
from gnc_opt.planning.problem.active_constraint_arcs import ArcKind
from gnc_opt.planning.refinement.arcs.arc_mesh import ArcMesh, SubarcMesh
from gnc_opt.planning.refinement.arcs.control_structure import (
    Correction,
    KindArray,
    PhaseStructure,
    select_kind,
)
from gnc_opt.planning.refinement.arcs.hamiltonian_convexity import mask_affine_controls
from gnc_opt.planning.refinement.arcs.state_constraint_contact_detection import (
    add_missing_contact,
    replace_saturated_arc_controls,
)
from gnc_opt.planning.solution.defects_and_violations import compute_segment_defects
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.piecewise_polynomial import Side
from gnc_opt.planning.solution.solution import Solution

KINK_MAX_MOVE_SHARE = 0.5
"""Largest move of a junction in one pass, relative to the shorter adjacent subarc."""

KINKS_MOVED, REFINED, DEGREE_RAISED = "junctions moved", "mesh refined", "degree of singular controls raised"
LIMITS_RELEASED, ARC_REMOVED = "limits next to touch points released", "arc of zero length removed"


def correct_arc_structure(
    solution: Solution, arc_meshes: dict[str, ArcMesh], tol: float
) -> tuple[dict[str, ArcMesh], str]:
    """Correct the structure of one phase, or kinks and subarc meshes of all; return the arc meshes and the action."""
    problem = solution.need_problem("refine")
    constraints = {name: StateConstraints(problem, s) for name, s in solution.samples().items()}
    for correct in (
        _remove_zero_length_subarc,
        add_missing_contact,
        _insert_saturated_arc,
        replace_saturated_arc_controls,
    ):
        for name, c in constraints.items():
            structure, action = correct(c, arc_meshes[name])
            if structure is not None:
                return {**arc_meshes, name: arc_meshes[name].replace_control_structure(structure)}, action
    adjusted = {name: _adjust_arc_mesh(c, arc_meshes[name], tol) for name, c in constraints.items()}
    actions = dict.fromkeys(action for _, action in adjusted.values() if action)
    if actions:
        return {name: plan for name, (plan, _) in adjusted.items()}, ", ".join(actions)
    for name, c in constraints.items():
        structure, action = _insert_arc_at_sign_violation(c.samples, arc_meshes[name])
        if structure is not None:
            return {**arc_meshes, name: arc_meshes[name].replace_control_structure(structure)}, action
    return arc_meshes, ""


def _adjust_arc_mesh(constraints: StateConstraints, arc_mesh: ArcMesh, tol: float) -> tuple[ArcMesh, str]:
    """Move kinks to where the solution has them and refine subarcs with large errors."""
    shifted = move_control_kinks(constraints, arc_mesh)
    finer = refine_arc_mesh_by_residuals(constraints.samples, arc_mesh, tol)
    if shifted is not None:
        vanished = np.flatnonzero(shifted.subarc_lengths < GONE * (shifted.times[-1] - shifted.times[0]))
        if vanished.size:
            remaining = arc_mesh.structure.replace_subarc_by_touch(int(vanished[0]))
            return arc_mesh.replace_control_structure(remaining), ARC_REMOVED
    if finer and not shifted and not arc_mesh.loose and any(arc_mesh.structure.touches):
        return replace(arc_mesh, loose=True), LIMITS_RELEASED
    subarc_meshes = finer.subarc_meshes if finer else arc_mesh.subarc_meshes
    is_smoother = any(a.smooth > b.smooth for a, b in zip(subarc_meshes, arc_mesh.subarc_meshes, strict=True))
    actions = (KINKS_MOVED if shifted else "", DEGREE_RAISED if is_smoother else REFINED if finer else "")
    arc_mesh = replace(arc_mesh, structure=shifted or arc_mesh.structure, subarc_meshes=subarc_meshes)
    return arc_mesh, ", ".join(filter(None, actions))


def _remove_zero_length_subarc(_: StateConstraints, arc_mesh: ArcMesh) -> Correction:
    """Return the structure without a subarc of zero length and the action, or None if there is no such subarc."""
    structure, lengths = arc_mesh.structure, arc_mesh.structure.subarc_lengths
    shortest = int(np.argmin(lengths))
    if structure.n_subarcs == 1 or lengths[shortest] >= GONE * lengths.sum():
        return None, ""
    return structure.replace_subarc_by_touch(shortest), ARC_REMOVED


# --- arcs that are missing --------------------------------------------------------------------------------


def _insert_arc_at_largest_violation(
    samples: PhaseSamples, structure: PhaseStructure, violation: Array, required_kinds: KindArray
) -> Correction:
    """Return the structure with an arc at the largest violation and the action, or None without a violation."""
    if not violation.size or violation.max() < GONE:
        return None, ""
    i, j = (int(v) for v in np.unravel_index(int(np.argmax(violation)), violation.shape))
    start, end = find_largest_violation_interval(samples.times, violation[i])
    label = samples.phase.controls.labels[i]
    extended = structure.with_inserted_arc(i, start, end, required_kinds[i, j])
    if extended == structure:  # between boundaries that differ by rounding
        return None, ""
    return extended, f"arc of {label} added at {samples.describe_times(start)}"


def _insert_arc_at_sign_violation(samples: PhaseSamples, arc_mesh: ArcMesh) -> Correction:
    """Return the structure with an arc where a control is at the wrong bound and the action, or None if none is.

    The violation is the gain in H. The arc is on the opposite bound, or interior where H is convex in the control.
    """
    kinds = arc_mesh.structure.control_arc_kinds[:, arc_mesh.segment_subarc_indices[samples.segments]]
    signs = np.where(kinds == ArcKind.LOWER, -1, np.where(kinds == ArcKind.UPPER, 1, 0))
    regular = np.array(arc_mesh.structure.regular[: len(kinds)], dtype=bool)[:, None]
    checked = (mask_affine_controls(samples)[:, None] | regular) & (signs != 0)
    violation = np.where(checked, signs * samples.relative_control_gradient, 0.0)
    for row_violation, row_kinds in zip(violation, kinds, strict=True):
        clear_violations_near_switches(row_violation, row_kinds)
    opposite = select_kind(signs > 0, ArcKind.LOWER, ArcKind.UPPER)
    required_kinds = select_kind(regular, ArcKind.INTERIOR, opposite)
    return _insert_arc_at_largest_violation(samples, arc_mesh.structure, violation, required_kinds)


def _insert_saturated_arc(constraints: StateConstraints, arc_mesh: ArcMesh) -> Correction:
    """Return the structure with an arc on a bound that a control reaches along a singular arc and the action, or None.

    While a polynomial is between the bounds, the switching function has the sign of that bound at every degree.
    """
    samples = constraints.samples
    bounds, subarcs = samples.phase.control_bounds, arc_mesh.segment_subarc_indices[samples.segments]
    singular = arc_mesh.structure.control_arc_kinds == ArcKind.SINGULAR
    released = arc_mesh.structure.mask_rows_near_limit_changes()[: len(singular)]
    singular = (singular & ~released)[:, subarcs]
    gradient = samples.relative_control_gradient
    at_lower, at_upper = bounds.is_near_limits(samples.u_polynomial, SMALL * samples.control_scale)
    pairs = zip(arc_mesh.subarc_meshes, find_largest_singular_gradients(samples, arc_mesh), strict=True)
    is_final = np.array([m.raise_control_degree(g).smooth == m.smooth for m, g in pairs])[subarcs]
    at_preferred_bound = np.where(gradient > 0, at_lower, at_upper)
    is_saturated = singular & is_final & mask_affine_controls(samples)[:, None] & at_preferred_bound
    violation = np.zeros_like(gradient)
    for i in np.flatnonzero(np.any(is_saturated, axis=1)):
        j = int(np.argmax(np.where(is_saturated[i], np.abs(gradient[i]), 0.0)))
        same_sign = np.sign(gradient[i]) == np.sign(gradient[i, j])
        for first, end in find_true_value_intervals(singular[i] & same_sign):
            if first <= j < end:
                violation[i, first:end] = np.abs(gradient[i, first:end])
    required_kinds = select_kind(gradient > 0, ArcKind.LOWER, ArcKind.UPPER)
    return _insert_arc_at_largest_violation(samples, arc_mesh.structure, violation, required_kinds)


def clear_violations_near_switches(violation: Array, kinds: KindArray | Array) -> None:
    """Set violations next to a switch of the same channel to zero, unless they are on both sides of it.

    One side is rounding and mesh error. On both sides, the slope is wrong: the switching time maximises the cost.
    """
    for j in np.flatnonzero(kinds[1:] != kinds[:-1]) + 1:
        admissible = np.concatenate([[-1], np.flatnonzero(~(violation > 0)), [violation.size]])
        first, last = admissible[admissible < j].max() + 1, admissible[admissible >= j].min()
        if min(np.max(side, initial=0.0) for side in (violation[first:j], violation[j:last])) < NEGLIGIBLE:
            violation[first:last] = 0.0


def find_largest_violation_interval(times: Array, violation: Array) -> tuple[float, float]:
    """Return the interval of the largest violation, between zeros found by linear interpolation of the samples."""
    j, admissible = int(np.argmax(violation)), np.flatnonzero(violation <= 0)
    before, after = admissible[admissible < j][-1:], admissible[admissible > j][:1]
    start, end = times[0], times[-1]
    if before.size:
        start = np.interp(0.0, violation[[*before, *before + 1]], times[[*before, *before + 1]])
    if after.size:
        end = np.interp(0.0, violation[[*after, *after - 1]], times[[*after, *after - 1]])
    return float(start), float(end)


# --- kinks of regular controls at the ends of bound arcs --------------------------------------------------


def move_control_kinks(constraints: StateConstraints, arc_mesh: ArcMesh) -> PhaseStructure | None:
    """Return the structure with kinks moved to the times that the solution indicates, or None if they are converged.

    Lengths of subarcs may become zero or negative.
    """
    structure, samples = arc_mesh.structure, constraints.samples
    times = list(structure.times)
    for boundary in range(1, structure.n_subarcs):
        if structure.has_only_control_kinks(boundary):
            candidate_times = [
                find_junction_time(constraints, structure, boundary, i)
                if structure.orders[i]
                else _find_constraint_kink_time(samples, arc_mesh, boundary, i)
                for i in structure.find_changed_arcs(boundary)
            ]
            times[boundary] = max(candidate_times, key=lambda t: abs(t - structure.times[boundary]))
    moves = np.abs(np.asarray(times) - np.asarray(structure.times))[1:-1]
    changed = [structure.find_changed_arcs(k) for k in range(1, structure.n_subarcs)]
    is_contact = [any(structure.orders[i] for i in rows) for rows in changed]
    duration, lengths = times[-1] - times[0], structure.subarc_lengths
    smallest_move = np.minimum(GONE * duration, NEGLIGIBLE * np.minimum(lengths[1:], lengths[:-1]))
    if np.all(moves <= np.where(is_contact, EQUAL * duration, smallest_move)):
        return None
    return structure.with_switch_times(tuple(times))


def find_junction_time(
    constraints: StateConstraints, structure: PhaseStructure, boundary: int, row: int
) -> float:
    """Return the time of an arc's end, at which the q-th derivative of the row along the interior arc vanishes."""
    phase, first = constraints.samples.phase, structure.n_controls
    entered = structure.kinds[boundary][row].is_at_limit
    side: Side = "left" if entered else "right"
    time = structure.times[boundary]
    k = int(np.argmin(np.abs(phase.breaks - time)))
    step = JUNCTION_OFFSET_SHARE * (phase.breaks[k] - phase.breaks[k - 1 if entered else k + 1])
    times = np.array([phase.breaks[k], phase.breaks[k] - step])
    arguments = times, phase.x(times, side), phase.u(times, side)
    values = constraints.evaluate_time_derivative(row - first, structure.orders[row], *arguments)
    slope = (values[0] - values[1]) / step
    largest_move = KINK_MAX_MOVE_SHARE * np.min(structure.subarc_lengths[boundary - 1 : boundary + 1])
    move = -values[0] / slope if slope != 0 else 0.0
    return time + float(np.clip(move, -largest_move, largest_move))


def _find_constraint_kink_time(samples: PhaseSamples, arc_mesh: ArcMesh, boundary: int, row: int) -> float:
    """Return the time at which a control or mixed path constraint enters or leaves its limit, s; see the module."""
    before, after = (arc_mesh.structure.kinds[k][row] for k in (boundary - 1, boundary))
    bound, interior = (boundary - 1, boundary) if before.is_at_limit else (boundary, boundary - 1)
    direction, phase, functions = before.sign or after.sign, samples.phase, samples.functions
    boxes = (phase.control_bounds, phase.path_bounds)
    limits = np.concatenate([box.get_limit_by_sign(direction) for box in boxes])
    subarcs = arc_mesh.segment_subarc_indices[samples.segments]
    for subarc in (interior, bound):
        subarc_times = samples.times[subarcs == subarc]
        side: Side = "left" if subarc < boundary else "right"
        times = subarc_times[::-1] if subarc < boundary else subarc_times

        def evaluate_limit_violation(t: Array, side: Side = side, subarc: int = subarc) -> Array:
            """Return excess of limits, or switching functions and -multipliers, of controls and path constraints."""
            x, u, mu = phase.x(t, side), phase.u(t, side), phase.path_multiplier(t, side)
            if subarc == interior:
                values = np.vstack([u, functions.path_constraints(t, x, u)])
                return np.asarray(direction * (values - limits[:, None]))
            slopes = functions.control_gradient(t, x, u, phase.lam(t, side), mu)
            return np.asarray(direction * np.vstack([slopes, -mu]))

        is_violated = evaluate_limit_violation(times)[row] > 0
        if np.all(is_violated):
            return float(times[-1])
        if is_violated[0]:
            k, rows = int(np.argmin(is_violated)), np.array([row])
            crossing = find_zero_times(evaluate_limit_violation, rows, times[k - 1 : k], times[k : k + 1])
            return float(crossing[0])
    return arc_mesh.structure.times[boundary]


# --- subarc meshes ----------------------------------------------------------------------------------------


def refine_arc_mesh_by_residuals(samples: PhaseSamples, arc_mesh: ArcMesh, tol: float) -> ArcMesh | None:
    """Return the arc mesh with finer subarcs where dynamics or adjoint equations are violated, or None."""
    errors = compute_segment_defects(samples)
    residual = np.abs(samples.adjoint_residual(samples.u_polynomial, samples.mu))
    weights = samples.state_scale[:, None] / samples.cost_scale
    # Multipliers along a state constraint contain differences of rounding errors that grow on finer subarcs.
    has_contact = [arc_mesh.structure.has_constraint_contact(k) for k in arc_mesh.segment_subarc_indices]
    residual = np.where(has_contact, 0.0, samples.integrate_over_segments(residual))
    segment_errors = np.maximum(np.max(errors, axis=0), np.max(residual * weights, axis=0))
    errors_by_subarc = np.split(segment_errors, arc_mesh.subarc_boundary_breaks[1:-1])
    gradients = find_largest_singular_gradients(samples, arc_mesh)
    subarcs = zip(arc_mesh.subarc_meshes, errors_by_subarc, gradients, strict=True)
    finer = tuple(choose_finer_subarc_mesh(*subarc, tol) for subarc in subarcs)
    return replace(arc_mesh, subarc_meshes=finer) if finer != arc_mesh.subarc_meshes else None


def choose_finer_subarc_mesh(mesh: SubarcMesh, errors: Array, gradient: float, tol: float) -> SubarcMesh:
    """Return a mesh with more points or a higher control degree, whichever has the larger error (segments,)."""
    smoother = mesh.raise_control_degree(gradient) if gradient > EQUAL else mesh
    if smoother != mesh and gradient > max(float(np.max(errors)), MINOR):
        return smoother
    if np.all(errors <= tol):
        return smoother
    return mesh.refine_to_reduce_errors(np.log10(np.clip(np.nan_to_num(errors, nan=np.inf), TINY, 1.0) / tol))


def find_largest_singular_gradients(samples: PhaseSamples, arc_mesh: ArcMesh) -> Array:
    """Return the largest |dH/du| of singular controls in every subarc (A,), relative to H."""
    kinds = arc_mesh.structure.control_arc_kinds[:, arc_mesh.segment_subarc_indices[samples.segments]]
    singular = np.where(kinds == ArcKind.SINGULAR, np.abs(samples.relative_control_gradient), 0.0)
    per_sample = np.max(singular, axis=0, initial=0.0)
    largest = np.zeros(arc_mesh.structure.n_subarcs)
    np.maximum.at(largest, arc_mesh.segment_subarc_indices[samples.segments], per_sample)
    return largest
