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


def remove_short_intervals_from_mask(times: Array, here: Mask, share: float = MINOR) -> Mask:
    """Return where a condition is true (m, n_times) for longer than a share of the phase, by default a switch."""
    arcs = here.copy()
    for row in arcs:
        for first, end in find_true_value_intervals(row):
            row[first:end] &= times[end - 1] - times[first] > share * (times[-1] - times[0])
    return arcs


def find_lasting_minimum_sample(times: Array, values: Array) -> int:
    """Return the sample of the smallest values (n_times,) that last for more than the share `MINOR`.

    A shorter minimum is an artefact of a polynomial at a switch. ``times`` do not decrease.
    """
    length = MINOR * (times[-1] - times[0])
    firsts = np.flatnonzero(times <= times[-1] - length)
    ends = np.searchsorted(times, times[firsts] + length, "right")
    peaks = [first + int(np.argmax(values[first:end])) for first, end in zip(firsts, ends, strict=True)]
    return int(peaks[np.argmin(values[peaks])])


def compute_integral_scales(s: PhaseSamples) -> Array:
    """Return the variation scale of each integral of a phase (n_integrals,).

    An integrand contributes its variation along the phase; its magnitude if the duration is free; and the share
    `NOTABLE` of its change when a state or control changes by its variation scale.
    """
    values = s.functions.integrands(s.times, s.x, s.u)
    if not values.shape[0]:
        return np.zeros(0)
    above = values - np.min(values, axis=1, keepdims=True)
    below = np.max(values, axis=1, keepdims=True) - values
    spans = np.minimum(above @ s.weights, below @ s.weights)
    if not s.has_fixed_duration:
        spans = np.fmax(spans, np.abs(values) @ s.weights)
    for k, steps in enumerate((s.state_scale, s.control_span)):
        for i, step in enumerate(steps):
            for moved in (step, -step):
                at = [s.x.copy(), s.u.copy()]
                at[k][i] += moved
                with np.errstate(invalid="ignore"):  # beyond the domain of an integrand
                    change = np.abs(s.functions.integrands(s.times, *at) - values) @ s.weights
                spans = np.fmax(spans, NOTABLE * set_nonfinite_to_zero(change))
    return set_nonfinite_to_zero(spans)


def compute_parameter_scales(solution: Solution) -> Array:
    """Return a tenth of the range of each free parameter, or its magnitude without a range (n_parameters,)."""
    box = solution.need_problem("verify").get_parameter_bounds()
    extent = box.upper - box.lower
    size = replace_tiny_by_one(np.abs(solution.parameter_values))
    return np.asarray(np.where(np.isfinite(extent) & (extent > 0), 0.1 * extent, size))


def compute_state_ranges(s: PhaseSamples) -> Array:
    """Return the variations of the states (n,): their motion along a phase, or their magnitude without motion.

    The motion of a free constant that is stated as a state is at rounding level.
    """
    sizes = np.max(np.abs(s.x), axis=1)
    still = (s.state_scale <= 2 * SPAN_MIN_SHARE * sizes) & (sizes > 0)
    return np.where(still, sizes, s.state_scale)


MEAN_SHARE = 0.1
"""Smallest deviation of a control at any time, relative to its mean over the phase; the inverse limits the ratio of the
distance to the minimum of H to the deviation."""

BESIDE = 1.3
"""Factor of a control for the test whether the control has an effect."""


def estimate_control_deviations(s: PhaseSamples) -> Array:
    """Return the deviation of the applied control from its mean or the minimum of H (m, n_samples); 0 if inactive."""
    lasts, u = s.span, s.u
    about = set_nonfinite_to_zero(np.abs(u - (u @ s.weights / lasts)[:, None]))
    size = np.max(np.abs(set_nonfinite_to_zero(u)), axis=1)
    mean = about @ s.weights / lasts
    moved = np.fmax(np.sqrt(about**2 @ s.weights / lasts), NOTABLE * np.max(about, axis=1))
    bends = np.sqrt(set_nonfinite_to_zero(np.einsum("iij->ij", s.control_hessian)) ** 2 @ s.weights / lasts)
    bounds = s.phase.control_bounds
    extent = np.where(np.isfinite(bounds.upper - bounds.lower), bounds.upper - bounds.lower, np.inf)
    slope = np.abs(set_nonfinite_to_zero(s.switching_functions))
    pull = np.where(slope > 0, np.inf, 0.0)
    pull = np.minimum(np.divide(slope, bends[:, None], out=pull, where=bends[:, None] > 0), extent[:, None])
    moves = moved > SPAN_MIN_SHARE * size
    pull = np.where(moves[:, None], np.minimum(pull, moved[:, None] / MEAN_SHARE), pull)
    pull = np.where(np.isfinite(pull), pull, size[:, None])
    deviation = np.fmax(np.fmax(about, MEAN_SHARE * mean[:, None]), pull)
    pulled = np.sqrt(pull**2 @ s.weights / lasts) > SPAN_MIN_SHARE * size
    steady = ~moves & ~pulled
    constant = _estimate_constant_control_deviation(s, size, bends)[:, None]
    deviation = np.where(steady[:, None], constant, deviation)
    zero = _estimate_zero_control_deviation(s, np.fmax(size, np.max(deviation, axis=1)))
    return np.fmax(deviation, zero[:, None])


def _estimate_constant_control_deviation(s: PhaseSamples, size: Array, bends: Array) -> Array:
    """Return the deviation of constant controls (m,): their magnitude, unless negligible relative to the cost."""
    cost = np.abs(s.functions.weights @ s.functions.integrands(s.times, s.x, s.u)) @ s.weights / s.span
    balanced = np.sqrt(np.divide(2 * cost, bends, out=np.zeros_like(bends), where=bends > 0))
    idle = size <= EQUAL * balanced
    still = max_norm(s.x - s.x[:, :1]) <= EQUAL * np.max(np.abs(s.x), initial=1.0)
    return np.where(idle, balanced if still else 0.0, size)


def _estimate_zero_control_deviation(s: PhaseSamples, size: Array) -> Array:
    """Return the deviation of controls at rounding level, constant and at the minimum of H (m,); else zero."""
    asked, rounding = estimate_required_controls(s.phase, s.functions), SPAN_MIN_SHARE**2 * s.control_span
    # A control whose effect vanishes only at its value, such as an angle of 180 degrees, is not at rounding level.
    effects = (s.functions.dynamics_control_jacobian(s.times, s.x, factor * s.u) for factor in (1.0, BESIDE))
    own, beside = (np.max(np.abs(set_nonfinite_to_zero(v)), axis=(0, 2), initial=0.0) for v in effects)
    share = np.divide(own, beside, out=np.ones_like(own), where=beside > own)
    if not np.all(size <= share * np.fmax(SPAN_MIN_SHARE * asked, rounding)):
        return np.zeros_like(size)
    return np.asarray(np.where(asked > rounding, STILL_STATE_SHARE * asked, s.control_span))


def scale_inactive_control_deviations(s: PhaseSamples, deviation: Array, idle: Mask, cost: float) -> Array:
    """Return deviations in which those of inactive controls (m,) cost as much as those of all others together."""
    if not np.any(idle):
        return deviation
    bends = np.abs(set_nonfinite_to_zero(np.einsum("iij->ij", s.control_hessian))) @ s.weights
    equal = np.sqrt(np.divide(2 * cost, bends, out=np.zeros_like(bends), where=bends > 0))
    extent = s.phase.control_bounds.upper - s.phase.control_bounds.lower
    other = np.where(np.isfinite(extent) & (bends == 0), extent, equal)
    return np.where(idle[:, None], np.fmax(other[:, None], deviation), deviation)
