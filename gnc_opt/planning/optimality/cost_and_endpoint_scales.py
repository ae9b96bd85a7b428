"""Scales of controls, integrals, parameters and states for the optimality check, and time averages of violations.

Control deviation: distance of the applied control from its mean, or from the minimum of H, see the module
`optimality_check_scales`. Other scales are variations along the trajectory, which contain no constants.
"""

from __future__ import annotations

import numpy as np

from gnc_opt.array_types import Array, Mask, find_true_value_intervals
from gnc_opt.numerical_tolerances import (
    EQUAL,
    MINOR,
    NOTABLE,
    max_norm,
    replace_tiny_by_one,
    set_nonfinite_to_zero,
)
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.state_and_control_scales import (
    SPAN_MIN_SHARE,
    STILL_STATE_SHARE,
    estimate_required_controls,
)

AVERAGING_SHARE_OF_PHASE = 1e-2
"""Share of a phase over which violations are averaged: the loss of cost is size times duration."""


def average_violation_over_time(times: Array, violation: Array) -> Array:
    """Return violations (m, n_times) averaged over `AVERAGING_SHARE_OF_PHASE`, since short ones cost little."""
    half = 0.5 * AVERAGING_SHARE_OF_PHASE * (times[-1] - times[0])
    areas = 0.5 * (violation[:, 1:] + violation[:, :-1]) * np.diff(times)
    total = np.concatenate([np.zeros((violation.shape[0], 1)), np.cumsum(areas, axis=1)], axis=1)
    middle = np.clip(times, times[0] + half, times[-1] - half)
    rises = [np.interp(middle + half, times, row) - np.interp(middle - half, times, row) for row in total]
    return np.asarray(np.reshape(rises, violation.shape) / (2 * half))


def remove_short_intervals_from_mask(times: Array, mask: Mask, share: float = MINOR) -> Mask:
    """Return where a condition is true (m, n_times) for longer than a share of the phase, by default a switch."""
    lasting = mask.copy()
    for row in lasting:
        for first, end in find_true_value_intervals(row):
            row[first:end] &= times[end - 1] - times[first] > share * (times[-1] - times[0])
    return lasting


def find_lasting_minimum_sample(times: Array, values: Array) -> int:
    """Return the sample of the smallest values (n_times,) that last for more than the share `MINOR`.

    A shorter minimum is an artefact of a polynomial at a switch. ``times`` do not decrease.
    """
    length = MINOR * (times[-1] - times[0])
    starts = np.flatnonzero(times <= times[-1] - length)
    ends = np.searchsorted(times, times[starts] + length, "right")
    peaks = [first + int(np.argmax(values[first:end])) for first, end in zip(starts, ends, strict=True)]
    return int(peaks[np.argmin(values[peaks])])


def compute_integral_scales(s: PhaseSamples) -> Array:
    """Return the variation scale of each integral of a phase (n_integrals,).

    An integrand contributes its variation along the phase; its magnitude if the duration is free; and the share
    `NOTABLE` of its change when a state or control changes by its variation scale.
    """
    values = s.functions.integrands(s.times, s.x, s.u)
    if not values.shape[0]:
        return np.zeros(0)
    above_minimum = values - np.min(values, axis=1, keepdims=True)
    below_maximum = np.max(values, axis=1, keepdims=True) - values
    spans = np.minimum(above_minimum @ s.weights, below_maximum @ s.weights)
    if not s.has_fixed_duration:
        spans = np.fmax(spans, np.abs(values) @ s.weights)
    for k, steps in enumerate((s.state_scale, s.control_span)):
        for i, scale in enumerate(steps):
            for step in (scale, -scale):
                arguments = [s.x.copy(), s.u.copy()]
                arguments[k][i] += step
                with np.errstate(invalid="ignore"):  # beyond the domain of an integrand
                    change = np.abs(s.functions.integrands(s.times, *arguments) - values) @ s.weights
                spans = np.fmax(spans, NOTABLE * set_nonfinite_to_zero(change))
    return set_nonfinite_to_zero(spans)


def compute_parameter_scales(solution: Solution) -> Array:
    """Return a tenth of the range of each free parameter, or its magnitude without a range (n_parameters,)."""
    bounds = solution.need_problem("verify").get_parameter_bounds()
    width = bounds.upper - bounds.lower
    magnitude = replace_tiny_by_one(np.abs(solution.parameter_values))
    return np.asarray(np.where(np.isfinite(width) & (width > 0), 0.1 * width, magnitude))


def compute_state_ranges(s: PhaseSamples) -> Array:
    """Return the variations of the states (n,): their motion along a phase, or their magnitude without motion.

    The motion of a free constant that is stated as a state is at rounding level.
    """
    magnitudes = np.max(np.abs(s.x), axis=1)
    is_constant = (s.state_scale <= 2 * SPAN_MIN_SHARE * magnitudes) & (magnitudes > 0)
    return np.where(is_constant, magnitudes, s.state_scale)


MEAN_MIN_SHARE = 0.1
"""Smallest deviation of a control at any time, relative to its mean over the phase; the inverse limits the ratio of the
distance to the minimum of H to the deviation."""

EFFECT_FACTOR = 1.3
"""Factor of a control for the test whether the control has an effect."""


def estimate_control_deviations(s: PhaseSamples) -> Array:
    """Return the deviation of the applied control from its mean or the minimum of H (m, n_samples); 0 if inactive."""
    span, u = s.span, s.u
    distance = set_nonfinite_to_zero(np.abs(u - (u @ s.weights / span)[:, None]))
    size = np.max(np.abs(set_nonfinite_to_zero(u)), axis=1)
    mean_distance = distance @ s.weights / span
    rms = np.fmax(np.sqrt(distance**2 @ s.weights / span), NOTABLE * np.max(distance, axis=1))
    curv = np.sqrt(set_nonfinite_to_zero(np.einsum("iij->ij", s.control_hessian)) ** 2 @ s.weights / span)
    bounds = s.phase.control_bounds
    width = np.where(np.isfinite(bounds.upper - bounds.lower), bounds.upper - bounds.lower, np.inf)
    slope = np.abs(set_nonfinite_to_zero(s.switching_functions))
    move = np.where(slope > 0, np.inf, 0.0)
    move = np.minimum(np.divide(slope, curv[:, None], out=move, where=curv[:, None] > 0), width[:, None])
    is_moving = rms > SPAN_MIN_SHARE * size
    move = np.where(is_moving[:, None], np.minimum(move, rms[:, None] / MEAN_MIN_SHARE), move)
    move = np.where(np.isfinite(move), move, size[:, None])
    deviation = np.fmax(np.fmax(distance, MEAN_MIN_SHARE * mean_distance[:, None]), move)
    is_pulled = np.sqrt(move**2 @ s.weights / span) > SPAN_MIN_SHARE * size
    is_constant = ~is_moving & ~is_pulled
    constant = _estimate_constant_control_deviation(s, size, curv)[:, None]
    deviation = np.where(is_constant[:, None], constant, deviation)
    at_zero = _estimate_zero_control_deviation(s, np.fmax(size, np.max(deviation, axis=1)))
    return np.fmax(deviation, at_zero[:, None])


def _estimate_constant_control_deviation(s: PhaseSamples, size: Array, curv: Array) -> Array:
    """Return the deviation of constant controls (m,): their magnitude, unless negligible relative to the cost."""
    cost = np.abs(s.functions.weights @ s.functions.integrands(s.times, s.x, s.u)) @ s.weights / s.span
    balanced = np.sqrt(np.divide(2 * cost, curv, out=np.zeros_like(curv), where=curv > 0))
    is_negligible = size <= EQUAL * balanced
    is_at_rest = max_norm(s.x - s.x[:, :1]) <= EQUAL * np.max(np.abs(s.x), initial=1.0)
    return np.where(is_negligible, balanced if is_at_rest else 0.0, size)


def _estimate_zero_control_deviation(s: PhaseSamples, size: Array) -> Array:
    """Return the deviation of controls at rounding level, constant and at the minimum of H (m,); else zero."""
    required, rounding = estimate_required_controls(s.phase, s.functions), SPAN_MIN_SHARE**2 * s.control_span
    # A control whose effect vanishes only at its value, such as an angle of 180 degrees, is not at rounding level.
    effects = (s.functions.dynamics_control_jacobian(s.times, s.x, k * s.u) for k in (1.0, EFFECT_FACTOR))
    effect, changed = (np.max(np.abs(set_nonfinite_to_zero(v)), axis=(0, 2), initial=0.0) for v in effects)
    share = np.divide(effect, changed, out=np.ones_like(effect), where=changed > effect)
    if not np.all(size <= share * np.fmax(SPAN_MIN_SHARE * required, rounding)):
        return np.zeros_like(size)
    return np.asarray(np.where(required > rounding, STILL_STATE_SHARE * required, s.control_span))


def scale_inactive_control_deviations(s: PhaseSamples, deviation: Array, mask: Mask, cost: float) -> Array:
    """Return deviations in which those of inactive controls (m,) cost as much as those of all others together."""
    if not np.any(mask):
        return deviation
    curv = np.abs(set_nonfinite_to_zero(np.einsum("iij->ij", s.control_hessian))) @ s.weights
    by_cost = np.sqrt(np.divide(2 * cost, curv, out=np.zeros_like(curv), where=curv > 0))
    width = s.phase.control_bounds.upper - s.phase.control_bounds.lower
    scale = np.where(np.isfinite(width) & (curv == 0), width, by_cost)
    return np.where(mask[:, None], np.fmax(scale[:, None], deviation), deviation)
