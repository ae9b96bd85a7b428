"""Variation scales of integrals, parameters and states, and time averages of violations."""

from __future__ import annotations

import numpy as np

from gnc_opt.array_types import Array, Mask, find_runs_of_true_values
from gnc_opt.numerical_tolerances import MINOR, NOTABLE, floor_magnitudes, zero_nonfinite
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.state_and_control_scales import SPAN_MIN_SHARE

AVERAGING_SHARE_OF_PHASE = 1e-2
"""Share of a phase over which violations are averaged: the loss of cost is size times duration."""


def average_violation_over_time(times: Array, violation: Array) -> Array:
    """Return violations (m, n_times) averaged over `AVERAGING_SHARE_OF_PHASE`, since short ones cost little."""
    half = 0.5 * AVERAGING_SHARE_OF_PHASE * (times[-1] - times[0])
    areas = 0.5 * (violation[:, 1:] + violation[:, :-1]) * np.diff(times)
    total = np.concatenate([np.zeros((violation.shape[0], 1)), np.cumsum(areas, axis=1)], axis=1)
    middle = np.clip(times, times[0] + half, times[-1] - half)
    means = [
        (np.interp(middle + half, times, row) - np.interp(middle - half, times, row)) / (2 * half)
        for row in total
    ]
    return np.asarray(np.reshape(means, violation.shape))


def mask_sustained_conditions(times: Array, here: Mask, share: float = MINOR) -> Mask:
    """Return where a condition is true (m, n_times) for longer than a share of the phase, by default a switch."""
    arcs = here.copy()
    for row in arcs:
        for first, end in find_runs_of_true_values(row):
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
                change = np.abs(s.functions.integrands(s.times, *at) - values) @ s.weights
                spans = np.fmax(spans, NOTABLE * zero_nonfinite(change))
    return zero_nonfinite(spans)


def compute_parameter_scales(solution: Solution) -> Array:
    """Return a tenth of the range of each free parameter, or its magnitude without a range (n_parameters,)."""
    box = solution.need_problem("verify").get_parameter_bounds()
    extent = box.upper - box.lower
    size = floor_magnitudes(np.abs(solution.parameter_values))
    return np.asarray(np.where(np.isfinite(extent) & (extent > 0), 0.1 * extent, size))


def compute_state_ranges(s: PhaseSamples) -> Array:
    """Return the variations of the states (n,): their motion along a phase, or their magnitude without motion.

    The motion of a free constant that is stated as a state is at rounding level.
    """
    sizes = np.max(np.abs(s.x), axis=1)
    still = (s.state_scale <= 2 * SPAN_MIN_SHARE * sizes) & (sizes > 0)
    return np.where(still, sizes, s.state_scale)
