"""Control deviation: distance of the applied control from its mean, or from the minimum of H.

See the module `optimality_check_scales` for its definition.
"""

from __future__ import annotations

import numpy as np

from gnc_opt.array_types import Array, Mask
from gnc_opt.numerical_tolerances import EQUAL, NOTABLE, TINY, max_norm, zero_nonfinite
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.state_and_control_scales import (
    SPAN_MIN_SHARE,
    STILL_STATE_SHARE,
    estimate_required_controls,
)

MEAN_SHARE = 0.1
"""Smallest deviation of a control at any time, relative to its mean over the phase; the inverse limits the ratio of the
distance to the minimum of H to the deviation."""

BESIDE = 1.3
"""Factor of a control for the test whether the control has an effect."""


def compute_control_deviation(s: PhaseSamples) -> Array:
    """Return the deviation of the applied control from its mean or the minimum of H (m, n_samples); 0 if inactive."""
    lasts, u = max(float(np.sum(s.weights)), TINY), s.u
    about = zero_nonfinite(np.abs(u - (u @ s.weights / lasts)[:, None]))
    size = np.max(np.abs(zero_nonfinite(u)), axis=1)
    mean = about @ s.weights / lasts
    moved = np.fmax(np.sqrt(about**2 @ s.weights / lasts), NOTABLE * np.max(about, axis=1))
    bends = np.sqrt(zero_nonfinite(np.einsum("iij->ij", s.control_hessian)) ** 2 @ s.weights / lasts)
    bounds = s.leg.control_bounds
    extent = np.where(np.isfinite(bounds.upper - bounds.lower), bounds.upper - bounds.lower, np.inf)
    slope = np.abs(zero_nonfinite(s.switching_functions))
    pull = np.where(slope > 0, np.inf, 0.0)
    pull = np.minimum(np.divide(slope, bends[:, None], out=pull, where=bends[:, None] > 0), extent[:, None])
    moves = moved > SPAN_MIN_SHARE * size
    pull = np.where(moves[:, None], np.minimum(pull, moved[:, None] / MEAN_SHARE), pull)
    pull = np.where(np.isfinite(pull), pull, size[:, None])
    deviation = np.fmax(np.fmax(about, MEAN_SHARE * mean[:, None]), pull)
    pulled = np.sqrt(pull**2 @ s.weights / lasts) > SPAN_MIN_SHARE * size
    steady = ~moves & ~pulled
    deviation = np.where(steady[:, None], _estimate_deviation_if_constant(s, size, bends)[:, None], deviation)
    return np.fmax(
        deviation, _estimate_deviation_if_zero(s, np.fmax(size, np.max(deviation, axis=1)))[:, None]
    )


def _estimate_deviation_if_constant(s: PhaseSamples, size: Array, bends: Array) -> Array:
    """Return the deviation of constant controls (m,): their magnitude, unless negligible relative to the cost."""
    lasts = max(float(np.sum(s.weights)), TINY)
    cost = np.abs(s.functions.weights @ s.functions.integrands(s.times, s.x, s.u)) @ s.weights / lasts
    worth = np.sqrt(np.divide(2 * cost, bends, out=np.zeros_like(bends), where=bends > 0))
    idle = size <= EQUAL * worth
    still = max_norm(s.x - s.x[:, :1]) <= EQUAL * np.max(np.abs(s.x), initial=1.0)
    return np.where(idle, worth if still else 0.0, size)


def _estimate_deviation_if_zero(s: PhaseSamples, size: Array) -> Array:
    """Return the deviation of controls at rounding level, constant and at the minimum of H (m,); else zero."""
    asked, rounding = estimate_required_controls(s.leg, s.functions), SPAN_MIN_SHARE**2 * s.control_span
    if not np.all(size <= np.fmax(SPAN_MIN_SHARE * asked, rounding)):
        return np.zeros_like(size)
    # A control whose effect vanishes only at its value, such as an angle of 180 degrees, is not at rounding level.
    own, beside = (
        np.max(
            np.abs(zero_nonfinite(s.functions.input_jacobian(s.times, s.x, factor * s.u))),
            axis=(0, 2),
            initial=0.0,
        )
        for factor in (1.0, BESIDE)
    )
    share = np.divide(own, beside, out=np.ones_like(own), where=beside > own)
    if not np.all(size <= share * np.fmax(SPAN_MIN_SHARE * asked, rounding)):
        return np.zeros_like(size)
    return np.asarray(np.where(asked > rounding, STILL_STATE_SHARE * asked, s.control_span))


def add_inactive_control_deviations(s: PhaseSamples, deviation: Array, idle: Mask, cost: float) -> Array:
    """Return deviations in which those of inactive controls (m,) cost as much as those of all others together."""
    if not np.any(idle):
        return deviation
    lasts = max(float(np.sum(s.weights)), TINY)
    bends = np.abs(zero_nonfinite(np.einsum("iij->ij", s.control_hessian))) @ s.weights
    equal = np.sqrt(np.divide(2 * cost, bends, out=np.zeros_like(bends), where=bends > 0))
    extent = s.leg.control_bounds.upper - s.leg.control_bounds.lower
    other = np.where(np.isfinite(extent) & (bends == 0) & (lasts > TINY), extent, equal)
    return np.where(idle[:, None], np.fmax(other[:, None], deviation), deviation)
