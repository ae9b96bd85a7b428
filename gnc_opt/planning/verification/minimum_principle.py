"""Pontryagin's minimum principle: the applied control minimises the Hamiltonian.

Violations are decreases of H by other controls, to first order or exact, relative to the cost scale (module
`optimality_check_scales`). The module `costate_conditions` states the principle and its sources.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from gnc_opt.array_types import Array, Mask
from gnc_opt.numerical_tolerances import AT_LIMIT, NOTABLE, set_nonfinite_to_zero
from gnc_opt.planning.optimality.active_state_constraints import (
    compute_free_control_directions,
    mask_singular_controls,
)
from gnc_opt.planning.optimality.cost_and_endpoint_scales import (
    average_violation_over_time,
    find_lasting_minimum_sample,
    remove_short_intervals_from_mask,
)
from gnc_opt.planning.optimality.optimality_check_scales import (
    AFFINE_MIN_COST,
    CURVED_MIN_COST,
    Scales,
    mask_controls_with_cost_curvature,
)
from gnc_opt.planning.solution.defects_and_violations import NO_VIOLATION, Worst
from gnc_opt.planning.solution.optimality_verdict import Condition, ConditionResult
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.verification.feasibility import check_value_within_tolerance, combine_condition_results
from gnc_opt.planning.verification.hamiltonian_minimum import (
    RESOLVED_GAIN_SHARE,
    TRIALS,
    compute_joint_hamiltonian_decreases,
    draw_low_discrepancy_points,
    get_control_search_bounds,
)


def compute_hamiltonian_decrease_scales(s: PhaseSamples, scales: Scales) -> Array:
    """Return the scales of decreases of H by each single control (m,), cost per second."""
    curvature = np.max(np.abs(np.einsum("iij->ij", s.control_hessian)), axis=1)
    smallest = np.where(curvature > 0, CURVED_MIN_COST, AFFINE_MIN_COST) * scales.cost
    by_control = np.maximum(scales.phases[s.phase.name].control_cost, smallest)
    return np.asarray(np.minimum(by_control, scales.cost) / s.span)


def check_control_stationarity(samples: list[PhaseSamples], scales: Scales, tolerance: float) -> Worst:
    """Return the first-order decrease of H by interior controls, or their distance to the minimum of H.

    It is the largest integral between two ends of segments, with its sign: this displaces the states, in shares of
    their reach. Faster deviations change the cost only to second order, so that the root of the tolerance applies.
    """
    worst = NO_VIOLATION
    for s in samples:
        loss, on_bound = _estimate_hamiltonian_decreases(s, scales.phases[s.phase.name].deviation)
        distance = _compute_control_distance_to_minimum(s, scales)
        # Applies to low-cost controls too: multipliers may be rounding, the curvature of the cost itself is not.
        clear = np.isfinite(distance) & (distance > NOTABLE) & mask_controls_with_cost_curvature(s)[:, None]
        clear |= loss * s.span > RESOLVED_GAIN_SHARE * scales.cost
        relative = np.where(clear, loss, 0.0) / compute_hamiltonian_decrease_scales(s, scales)[:, None]
        excess = np.where(on_bound, 0.0, np.minimum(relative, distance))
        totals = np.pad(s.integrate_over_segments(np.copysign(excess, s.control_gradient)), ((0, 0), (1, 0)))
        running = np.cumsum(totals, axis=1) / s.span
        # The location is that of the largest mean.
        averaged = average_violation_over_time(s.times, excess)
        is_largest = averaged == np.max(averaged, axis=1, keepdims=True)
        violation = np.maximum(
            np.where(is_largest, np.ptp(running, axis=1, keepdims=True), 0.0), averaged * np.sqrt(tolerance)
        )
        worst = worst.select_larger(_locate_largest_hamiltonian_decrease(s, violation, "dH/du of "))
    return worst


def _compute_control_distance_to_minimum(s: PhaseSamples, scales: Scales) -> Array:
    """Return the distance of each control to the minimum of H, in deviations; infinite for negative curvature."""
    deviation = scales.phases[s.phase.name].deviation
    curvature = np.einsum("iij->ij", s.control_hessian) * deviation
    slope = np.abs(s.control_gradient)
    infinite = np.full_like(slope, np.inf)
    return np.asarray(np.divide(slope, curvature, out=infinite, where=curvature > 0))


def check_switching_signs(samples: list[PhaseSamples], scales: Scales) -> Worst:
    """Return the first-order decrease of H if controls at a bound move into the interior."""
    worst = NO_VIOLATION
    for s in samples:
        loss, on_bound = _estimate_hamiltonian_decreases(s, scales.phases[s.phase.name].deviation)
        gain = average_violation_over_time(s.times, np.where(on_bound, loss * s.span / scales.cost, 0.0))
        worst = worst.select_larger(_locate_largest_hamiltonian_decrease(s, gain, "switching function of "))
    return worst


def _estimate_hamiltonian_decreases(
    s: PhaseSamples, scale: Array, size: Array | None = None
) -> tuple[Array, Mask]:
    """Return the first-order decrease of H by each control over a scale (m, n_samples), and whether it is at a bound.

    The decrease is in cost per second. ``size`` (m,) is the reference of the distance to a bound.
    """
    bounds, gradient = s.phase.control_bounds, s.control_gradient
    size = np.max(scale, axis=1) if size is None else size
    at_lower, at_upper = bounds.is_near_limits(s.u, AT_LIMIT * size)
    room_down = np.where(at_lower, 0.0, np.minimum(s.u - bounds.lower[:, None], scale))
    room_up = np.where(at_upper, 0.0, np.minimum(bounds.upper[:, None] - s.u, scale))
    loss = np.abs(gradient) * np.where(gradient > 0, room_down, room_up)
    return loss, at_lower | at_upper


def _locate_largest_hamiltonian_decrease(s: PhaseSamples, loss: Array, what: str) -> Worst:
    return Worst.find_largest_value(
        loss, lambda i, j: s.describe_sample(j, what + s.phase.controls.labels[i])
    )


def check_minimum_principle(
    samples: list[PhaseSamples], scales: Scales, tolerance: float, unit: str = ""
) -> Condition:
    """Return the condition that no other control has a smaller H; the loss in ``unit`` is the integral over time."""
    meaning = (
        "At every time the control must minimise H among all admissible controls; a stationary value is not enough. "
        "The value is the possible reduction of H, relative to its scale."
    )
    worst, searched, loss = NO_VIOLATION, False, 0.0
    for s in samples:
        if s.phase.controls.size:
            gain, phase_loss, was_searched = _find_largest_hamiltonian_decrease(s, scales, tolerance)
            worst, searched, loss = worst.select_larger(gain), searched or was_searched, loss + phase_loss
    if searched:
        meaning += (
            f" H is neither affine nor convex and quadratic in all controls. Its minimum was searched with {TRIALS} "
            "controls per phase; the search may miss a narrow minimum."
        )
    condition = check_value_within_tolerance("minimum principle", worst, tolerance, meaning)
    return replace(condition, loss=loss, unit=unit) if np.isfinite(loss) else condition


def _find_largest_hamiltonian_decrease(
    s: PhaseSamples, scales: Scales, tolerance: float
) -> tuple[Worst, float, bool]:
    """Return the largest decrease of H by other controls, its loss along the phase, and whether a search was needed."""
    deviation = np.max(scales.phases[s.phase.name].deviation, axis=1)
    gain, smallest_share, searched = _search_hamiltonian_decreases(s, deviation, scales.cost, tolerance)
    averaged = average_violation_over_time(s.times, gain[None])[0]
    share = np.maximum(averaged / (scales.cost / s.span + averaged), smallest_share)
    share = np.where(np.isnan(s.hamiltonian), np.inf, share)
    j = int(np.argmax(share))
    return Worst(float(share[j]), s.describe_sample(j)), float(s.weights @ gain), searched


def _search_hamiltonian_decreases(
    s: PhaseSamples, deviation: Array, cost: float, tolerance: float
) -> tuple[Array, Array, bool]:
    """Return the decrease of H by other controls and its share along the phase, and whether a search was needed."""
    separable = _compute_separable_hamiltonian_decrease(s)
    jumping = s.hamiltonian - s.functions.hamiltonian(s.times, s.x, _draw_separable_controls(s), s.lam)
    gain = np.fmax(separable, set_nonfinite_to_zero(jumping))
    joint, searched = compute_joint_hamiltonian_decreases(s, deviation, cost, tolerance)
    share = np.zeros_like(gain)
    for group in joint:
        gain = gain + np.interp(s.times, group.times, group.gain)
        share = np.maximum(share, np.interp(s.times, group.times, group.share))
    return gain, share, searched


def integrate_hamiltonian_excess(solution: Solution) -> float:
    """Return the integral of H minus its minimum, in the unit of the objective; NaN or inf if H is not finite."""
    samples = [s for s in solution.samples().values() if s.has_duration and s.phase.controls.size]
    decreases = [_search_hamiltonian_decreases(s, s.control_span, s.cost_scale, np.inf)[0] for s in samples]
    return float(sum(s.weights @ decrease for s, decrease in zip(samples, decreases, strict=True)))


def _compute_separable_hamiltonian_decrease(s: PhaseSamples) -> Array:
    """Return the largest decrease of H by other values of its separable controls, according to their slopes."""
    separable = s.functions.separable_controls
    lower, upper = (limit[separable, None] for limit in get_control_search_bounds(s))
    slope, u = s.control_gradient[separable], s.u[separable]
    return np.asarray(np.sum(np.maximum(slope * (u - lower), slope * (u - upper)), axis=0))


def _draw_separable_controls(s: PhaseSamples) -> Array:
    """Return separable controls at random points between their limits, which reveal steps of H with zero slope."""
    lower, upper = get_control_search_bounds(s)
    shares = draw_low_discrepancy_points(s.u.shape[1], s.u.shape[0])
    trial = lower[:, None] + (upper - lower)[:, None] * shares
    return np.where(s.functions.separable_controls[:, None], trial, s.u)


def check_legendre_clebsch(
    samples: list[PhaseSamples], tolerance: float, singular: Sequence[Mask]
) -> Condition:
    """Return the Legendre-Clebsch condition: the Hessian of H in interior controls is positive definite."""
    name = "Legendre-Clebsch"
    meaning = (
        "The Hessian of H with respect to the controls between their bounds must be positive definite. The margin is "
        "the smallest eigenvalue, relative to the scale of H. If it is negative, the control does not minimise H. If "
        "it is zero, the result is inconclusive."
    )
    # If H is affine in controls, the generalised condition applies; this one applies to the other controls.
    margins = [_find_least_hessian_eigenvalue(s, ~m) for s, m in zip(samples, singular, strict=True)]
    found = [(value, where) for value, where in margins if where is not None]
    if not found:
        has_singular_arcs = any(np.any(m) for m in singular)
        location = "no control between its limits" + (" but along singular arcs" if has_singular_arcs else "")
        return Condition(name, ConditionResult.PASS, 0.0, 0.0, location, meaning, sufficient=True)
    smallest, where = min(found, key=lambda item: item[0])
    result = combine_condition_results(smallest >= tolerance, not smallest > -tolerance)
    return Condition(name, result, -smallest, -tolerance, where, meaning, sufficient=True)


def _find_least_hessian_eigenvalue(s: PhaseSamples, candidates: Mask) -> tuple[float, str | None]:
    """Return the smallest lasting eigenvalue, relative to H, and its location; None if no direction is free."""
    unit = s.control_span / np.sqrt(s.hamiltonian_change_by_control)
    scaled = np.moveaxis(s.control_hessian * unit[:, None, None] * unit[None, :, None], 2, 0)
    smallest = np.full(s.times.size, np.inf)
    bases = compute_free_control_directions(s, _mask_interior_controls(s) & candidates, unit)
    sizes = np.array([basis.shape[1] for basis in bases])
    for size in np.unique(sizes[sizes > 0]):
        samples = np.flatnonzero(sizes == size)
        basis = np.stack([bases[j] for j in samples])
        reduced = np.swapaxes(basis, 1, 2) @ scaled[samples] @ basis
        finite = np.all(np.isfinite(reduced), axis=(1, 2))  # LAPACK fails for non-finite numbers
        symmetric = 0.5 * (reduced + np.swapaxes(reduced, 1, 2))[finite]
        smallest[samples[finite]], smallest[samples[~finite]] = np.linalg.eigvalsh(symmetric)[:, 0], -np.inf
    j = find_lasting_minimum_sample(s.times, smallest)
    return float(smallest[j]), s.describe_sample(j) if smallest[j] < np.inf else None


def check_singular_arcs(
    samples: list[PhaseSamples], tolerance: float, singular: Sequence[Mask], determined: Sequence[Mask]
) -> Condition:
    """Return the condition that H or the second derivative of the switching function determines interior controls."""
    meaning = (
        "Along a singular arc the control is between its limits, and dH/du and the curvature of H are zero. The second "
        "time derivative of the switching function must then determine the control. The value is the share of the "
        "phase along which it does not. No sufficient conditions are known for such arcs. Where they meet bang arcs, "
        "an optimal control switches infinitely often (chattering)."
    )
    largest_share, location = 0.0, "no singular arc of higher order"
    for s, is_singular, is_determined in zip(samples, singular, determined, strict=True):
        undetermined = is_singular & ~is_determined
        lengths = np.sum(undetermined * s.weights, axis=1) / s.span
        if lengths.size and lengths.max() > largest_share:
            i = int(np.argmax(lengths))
            largest_share = float(lengths[i])
            j = int(np.flatnonzero(undetermined[i])[0])
            start = s.describe_sample(j, s.phase.controls.labels[i])
            location = f"from {start}, {100 * largest_share:.1f} % of the phase"
    result = ConditionResult.PASS if largest_share <= tolerance else ConditionResult.INCONCLUSIVE
    return Condition("singular arcs", result, largest_share, tolerance, location, meaning, sufficient=True)


@lru_cache(maxsize=8)
def mask_undetermined_controls(s: PhaseSamples, tolerance: float) -> tuple[Mask, Mask]:
    """Return where interior controls are undetermined: singular (m, n_samples), and inside (m, n_samples).

    Singular: H has neither slope nor curvature, and active constraints leave a direction free. Inside: they leave all
    directions free.
    """
    loss = (
        _estimate_hamiltonian_decreases(s, s.control_span[:, None], s.control_scale)[0]
        / s.hamiltonian_change_by_control[:, None]
    )
    unit = s.control_span / np.sqrt(s.hamiltonian_change_by_control)
    interior = _mask_interior_controls(s)
    has_free_direction, all_free = mask_singular_controls(s, interior, unit, tolerance)
    curvature = np.einsum("iij->ij", s.control_hessian) * unit[:, None] ** 2
    singular = has_free_direction & (loss <= tolerance) & (np.abs(curvature) <= tolerance)
    return remove_short_intervals_from_mask(s.times, singular), interior & all_free


def _mask_interior_controls(s: PhaseSamples) -> Mask:
    """Return where each active control is interior, and not only during a switch, (m, n_samples)."""
    at_lower, at_upper = s.phase.control_bounds.is_near_limits(s.u, NOTABLE * s.control_scale)
    return remove_short_intervals_from_mask(s.times, np.asarray(~(at_lower | at_upper | s.inactive_controls)))
