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
from gnc_opt.planning.refinement.arcs.hamiltonian_convexity import (
    mask_affine_controls,
)
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

KINKS_MOVED, RAISED, SMOOTHED = "junctions moved", "mesh refined", "degree of singular controls raised"
LOOSENED, VANISHED = "limits next to touch points released", "arc of zero length removed"


def correct_arc_structure(
    solution: Solution, plans: dict[str, ArcMesh], tol: float
) -> tuple[dict[str, ArcMesh], str]:
    """Correct the structure of one phase, or kinks and resolutions of all; return the plans and the action."""
    problem = solution.need_problem("refine")
    constraints = {name: StateConstraints(problem, s) for name, s in solution.samples().items()}
    for correct in (
        _remove_zero_length_subarc,
        add_missing_contact,
        _insert_saturated_arc,
        replace_saturated_arc_controls,
    ):
        for name, c in constraints.items():
            structure, action = correct(c, plans[name])
            if structure is not None:
                return {**plans, name: plans[name].replace_control_structure(structure)}, action
    adjusted = {name: _adjust_kinks_and_mesh(c, plans[name], tol) for name, c in constraints.items()}
    actions = dict.fromkeys(action for _, action in adjusted.values() if action)
    if actions:
        return {name: plan for name, (plan, _) in adjusted.items()}, ", ".join(actions)
    for name, c in constraints.items():
        structure, action = _insert_arc_at_sign_violation(c.samples, plans[name])
        if structure is not None:
            return {**plans, name: plans[name].replace_control_structure(structure)}, action
    return plans, ""


def _adjust_kinks_and_mesh(constraints: StateConstraints, plan: ArcMesh, tol: float) -> tuple[ArcMesh, str]:
    """Move kinks to where the solution has them and refine subarcs with large errors."""
    moved = move_control_kinks(constraints, plan)
    raised = refine_arc_mesh_by_residuals(constraints.samples, plan, tol)
    if moved is not None:
        emptied = np.flatnonzero(moved.subarc_lengths < GONE * (moved.times[-1] - moved.times[0]))
        if emptied.size:
            left = plan.structure.replace_subarc_by_touch(int(emptied[0]))
            return plan.replace_control_structure(left), VANISHED
    if raised and not moved and not plan.loose and any(plan.structure.touches):
        return replace(plan, loose=True), LOOSENED
    resolutions = raised.resolutions if raised else plan.resolutions
    smoother = any(a.smooth > b.smooth for a, b in zip(resolutions, plan.resolutions, strict=True))
    actions = (KINKS_MOVED if moved else "", SMOOTHED if smoother else RAISED if raised else "")
    plan = replace(plan, structure=moved or plan.structure, resolutions=resolutions)
    return plan, ", ".join(filter(None, actions))


# --- arcs that vanish -----------------------------------------------------------------------------------


def _remove_zero_length_subarc(_: StateConstraints, plan: ArcMesh) -> Correction:
    """Return the structure without a subarc of zero length and the action, or None if there is no such subarc."""
    structure, lengths = plan.structure, plan.structure.subarc_lengths
    shortest = int(np.argmin(lengths))
    if structure.n_subarcs == 1 or lengths[shortest] >= GONE * lengths.sum():
        return None, ""
    return structure.replace_subarc_by_touch(shortest), VANISHED


# --- arcs that are missing --------------------------------------------------------------------------------


def _insert_arc_at_largest_violation(
    samples: PhaseSamples, structure: PhaseStructure, violation: Array, asked: KindArray
) -> Correction:
    """Return the structure with an arc at the largest violation and the action, or None without a violation."""
    if not violation.size or violation.max() < GONE:
        return None, ""
    i, j = (int(v) for v in np.unravel_index(int(np.argmax(violation)), violation.shape))
    start, end = find_largest_violation_interval(samples.times, violation[i])
    label = samples.phase.controls.labels[i]
    extended = structure.with_inserted_arc(i, start, end, asked[i, j])
    if extended == structure:  # between boundaries that differ by rounding
        return None, ""
    return extended, f"arc of {label} added at {samples.describe_times(start)}"


def _insert_arc_at_sign_violation(samples: PhaseSamples, plan: ArcMesh) -> Correction:
    """Return the structure with an arc where a control is at the wrong bound and the action, or None if none is.

    The violation is the gain in H. The arc is on the opposite bound, or interior where H is convex in the control.
    """
    kinds = plan.structure.control_arc_kinds[:, plan.segment_subarc_indices[samples.segments]]
    signs = np.where(kinds == ArcKind.LOWER, -1, np.where(kinds == ArcKind.UPPER, 1, 0))
    regular = np.array(plan.structure.regular[: len(kinds)], dtype=bool)[:, None]
    checked = (mask_affine_controls(samples)[:, None] | regular) & (signs != 0)
    gain = samples.control_gradient * samples.control_scale[:, None] / samples.hamiltonian_scale
    violation = np.where(checked, signs * gain, 0.0)
    for own, own_kinds in zip(violation, kinds, strict=True):
        clear_violations_near_switches(own, own_kinds)
    opposite = select_kind(signs > 0, ArcKind.LOWER, ArcKind.UPPER)
    asked = select_kind(regular, ArcKind.INTERIOR, opposite)
    return _insert_arc_at_largest_violation(samples, plan.structure, violation, asked)


def _insert_saturated_arc(constraints: StateConstraints, plan: ArcMesh) -> Correction:
    """Return the structure with an arc on a bound that a control reaches along a singular arc and the action, or None.

    While a polynomial is between the bounds, the switching function has the sign of that bound at every degree.
    """
    samples = constraints.samples
    bounds, subarcs = samples.phase.control_bounds, plan.segment_subarc_indices[samples.segments]
    singular = plan.structure.control_arc_kinds == ArcKind.SINGULAR
    released = plan.structure.mask_rows_near_limit_changes()[: len(singular)]
    singular = (singular & ~released)[:, subarcs]
    gain = samples.control_gradient * samples.control_scale[:, None] / samples.hamiltonian_scale
    at_lower, at_upper = bounds.is_near_limits(samples.u_polynomial, SMALL * samples.control_scale)
    left_open = zip(plan.resolutions, compute_singular_hamiltonian_gradients(samples, plan), strict=True)
    stuck = np.array([r.raise_control_degree(g).smooth == r.smooth for r, g in left_open])[subarcs]
    jumps = np.where(gain > 0, at_lower, at_upper)
    reached = singular & stuck & mask_affine_controls(samples)[:, None] & jumps
    violation = np.zeros_like(gain)
    for i in np.flatnonzero(np.any(reached, axis=1)):
        j = int(np.argmax(np.where(reached[i], np.abs(gain[i]), 0.0)))
        for first, end in find_true_value_intervals(singular[i] & (np.sign(gain[i]) == np.sign(gain[i, j]))):
            if first <= j < end:
                violation[i, first:end] = np.abs(gain[i, first:end])
    asked = select_kind(gain > 0, ArcKind.LOWER, ArcKind.UPPER)
    return _insert_arc_at_largest_violation(samples, plan.structure, violation, asked)


def clear_violations_near_switches(violation: Array, kinds: KindArray | Array) -> None:
    """Set violations next to a switch of the same channel to zero, unless they are on both sides of it.

    One side is rounding and mesh error. On both sides, the slope is wrong: the switching time maximises the cost.
    """
    for j in np.flatnonzero(kinds[1:] != kinds[:-1]) + 1:
        fine = np.concatenate([[-1], np.flatnonzero(~(violation > 0)), [violation.size]])
        first, last = fine[fine < j].max() + 1, fine[fine >= j].min()
        if min(np.max(side, initial=0.0) for side in (violation[first:j], violation[j:last])) < NEGLIGIBLE:
            violation[first:last] = 0.0


def find_largest_violation_interval(times: Array, violation: Array) -> tuple[float, float]:
    """Return the interval of the largest violation, between zeros found by linear interpolation of the samples."""
    j, fine = int(np.argmax(violation)), np.flatnonzero(violation <= 0)
    before, after = fine[fine < j][-1:], fine[fine > j][:1]
    start, end = times[0], times[-1]
    if before.size:
        start = np.interp(0.0, violation[[*before, *before + 1]], times[[*before, *before + 1]])
    if after.size:
        end = np.interp(0.0, violation[[*after, *after - 1]], times[[*after, *after - 1]])
    return float(start), float(end)


# --- kinks of regular controls at the ends of bound arcs --------------------------------------------------


def move_control_kinks(constraints: StateConstraints, plan: ArcMesh) -> PhaseStructure | None:
    """Return the structure with kinks moved to the times that the solution indicates, or None if they are converged.

    Lengths of subarcs may become zero or negative.
    """
    structure, samples = plan.structure, constraints.samples
    times = list(structure.times)
    for boundary in range(1, structure.n_subarcs):
        if structure.has_only_control_kinks(boundary):
            wanted = [
                find_junction_time(constraints, structure, boundary, i)
                if structure.orders[i]
                else _find_constraint_kink_time(samples, plan, boundary, i)
                for i in structure.find_changed_arcs(boundary)
            ]
            times[boundary] = max(wanted, key=lambda t: abs(t - structure.times[boundary]))
    moves = np.abs(np.asarray(times) - np.asarray(structure.times))[1:-1]
    changed = [structure.find_changed_arcs(k) for k in range(1, structure.n_subarcs)]
    contact = [any(structure.orders[i] for i in rows) for rows in changed]
    span, lengths = times[-1] - times[0], structure.subarc_lengths
    beside = np.minimum(GONE * span, NEGLIGIBLE * np.minimum(lengths[1:], lengths[:-1]))
    if np.all(moves <= np.where(contact, EQUAL * span, beside)):
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
    along = times, phase.x(times, side), phase.u(times, side)
    values = constraints.evaluate_time_derivative(row - first, structure.orders[row], *along)
    slope = (values[0] - values[1]) / step
    most = KINK_MAX_MOVE_SHARE * np.min(structure.subarc_lengths[boundary - 1 : boundary + 1])
    move = -values[0] / slope if slope != 0 else 0.0
    return time + float(np.clip(move, -most, most))


def _find_constraint_kink_time(samples: PhaseSamples, plan: ArcMesh, boundary: int, row: int) -> float:
    before, after = (plan.structure.kinds[k][row] for k in (boundary - 1, boundary))
    held, interior = (boundary - 1, boundary) if before.is_at_limit else (boundary, boundary - 1)
    direction, phase, functions = before.sign or after.sign, samples.phase, samples.functions
    boxes = (phase.control_bounds, phase.path_bounds)
    limits = np.concatenate([box.get_limit_by_sign(direction) for box in boxes])
    subarcs = plan.segment_subarc_indices[samples.segments]
    for subarc in (interior, held):
        here = samples.times[subarcs == subarc]
        side: Side = "left" if subarc < boundary else "right"
        times = here[::-1] if subarc < boundary else here

        def evaluate_limit_violation(t: Array, side: Side = side, subarc: int = subarc) -> Array:
            """Return excess of limits, or switching functions and -multipliers, of controls and path constraints."""
            x, u, mu = phase.x(t, side), phase.u(t, side), phase.path_multiplier(t, side)
            if subarc == interior:
                values = np.vstack([u, functions.path_constraints(t, x, u)])
                return np.asarray(direction * (values - limits[:, None]))
            slopes = functions.control_gradient(t, x, u, phase.lam(t, side), mu)
            return np.asarray(direction * np.vstack([slopes, -mu]))

        over = evaluate_limit_violation(times)[row] > 0
        if np.all(over):
            return float(times[-1])
        if over[0]:
            k, rows = int(np.argmin(over)), np.array([row])
            at = find_zero_times(evaluate_limit_violation, rows, times[k - 1 : k], times[k : k + 1])
            return float(at[0])
    return plan.structure.times[boundary]


# --- resolutions ----------------------------------------------------------------------------------------


def refine_arc_mesh_by_residuals(samples: PhaseSamples, plan: ArcMesh, tol: float) -> ArcMesh | None:
    """Return the plan with finer subarcs where dynamics or adjoint equations are violated, or None."""
    errors = compute_segment_defects(samples)
    residual = np.abs(samples.adjoint_residual(samples.u_polynomial, samples.mu))
    weights = samples.state_scale[:, None] / samples.cost_scale
    # Multipliers along a state constraint contain differences of rounding errors that grow on finer subarcs.
    contact = np.array([plan.structure.has_constraint_contact(k) for k in range(plan.structure.n_subarcs)])
    residual = np.where(contact[plan.segment_subarc_indices], 0.0, samples.integrate_over_segments(residual))
    per_segment = np.maximum(np.max(errors, axis=0), np.max(residual * weights, axis=0))
    by_piece = np.split(per_segment, plan.subarc_boundary_breaks[1:-1])
    gradients = compute_singular_hamiltonian_gradients(samples, plan)
    subarcs = zip(plan.resolutions, by_piece, gradients, strict=True)
    wanted = tuple(choose_finer_subarc_mesh(*subarc, tol) for subarc in subarcs)
    return replace(plan, resolutions=wanted) if wanted != plan.resolutions else None


def choose_finer_subarc_mesh(r: SubarcMesh, errors: Array, gradient: float, tol: float) -> SubarcMesh:
    """Return the resolution with more points or a higher control degree, whichever has the larger error (segments,)."""
    smoother = r.raise_control_degree(gradient) if gradient > EQUAL else r
    if smoother != r and gradient > max(float(np.max(errors)), MINOR):
        return smoother
    if np.all(errors <= tol):
        return smoother
    return r.refine_to_reduce_errors(np.log10(np.clip(np.nan_to_num(errors, nan=np.inf), TINY, 1.0) / tol))


def compute_singular_hamiltonian_gradients(samples: PhaseSamples, plan: ArcMesh) -> Array:
    """Return the largest |dH/du| of singular controls in every subarc (A,), relative to H."""
    kinds = plan.structure.control_arc_kinds[:, plan.segment_subarc_indices[samples.segments]]
    gain = np.abs(samples.control_gradient) * samples.control_scale[:, None] / samples.hamiltonian_scale
    per_sample = np.max(np.where(kinds == ArcKind.SINGULAR, gain, 0.0), axis=0, initial=0.0)
    worst = np.zeros(plan.structure.n_subarcs)
    np.maximum.at(worst, plan.segment_subarc_indices[samples.segments], per_sample)
    return worst
