"""Smoothness of segments: decay rates of Legendre coefficients."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre

from gnc_opt.array_types import Array
from gnc_opt.planning.refinement.error_estimation import PhaseError
from gnc_opt.tolerances import TINY

COEFFICIENT_ROUNDING = 1e-14
"""Smallest significant Legendre coefficient, relative to the largest; smaller ones are rounding."""

DECAY_RATE_MIN, DECAY_RATE_MAX = 0.02, 2.0
"""Range to which decay rates are clipped, decades per degree."""


def fit_decay_rates(error: PhaseError) -> Array:
    """Return the decay rates of the Legendre coefficients of rates, integrands and controls (K,), decades per degree.

    They are the rates of the envelopes (Liu, Hager & Rao, IEEE Transactions on Control Systems Technology 26, 2018).
    """
    s, leg, functions = error.samples, error.samples.leg, error.samples.functions
    signals = np.concatenate(
        [
            functions.rates(*leg.point_trajectory) / s.state_scale[:, None],
            functions.integrands(*leg.point_trajectory) / error.integral_scale[:, None],
            np.hstack(leg.u.values) / s.control_scale[:, None] / leg.duration,
        ]
    )
    offsets = leg.mesh.point_offsets
    rates = [
        _fit_decay_rate(signals[:, offsets[k] : offsets[k + 1]], rule.points)
        for k, rule in enumerate(leg.collocation_rules)
    ]
    return np.array(rates)


def _fit_decay_rate(values: Array, tau: Array) -> float:
    n = tau.size
    if n < 3 or not np.all(np.isfinite(values)):
        return DECAY_RATE_MIN
    coefficients = np.abs(np.linalg.solve(legendre.legvander(tau, n - 1), values.T))
    sizes = np.max(coefficients, axis=1)
    envelope = np.maximum.accumulate(sizes[::-1])[::-1][1 if n > 5 else 0 :]
    floor = COEFFICIENT_ROUNDING * max(float(np.max(sizes)), TINY)
    kept = envelope[: max(2, int(np.searchsorted(-envelope, -floor)))]
    slope = np.polyfit(np.arange(kept.size), np.log10(np.maximum(kept, floor)), 1)[0]
    return float(np.clip(-slope, DECAY_RATE_MIN, DECAY_RATE_MAX))
