"""Next mesh of a phase: increase of degrees and subdivision of segments.

Smooth segments get the degree predicted by the decay of their Legendre coefficients. Other segments are split at their
kinks, or halved. See Liu, Hager & Rao, Journal of the Franklin Institute 352 (2015), for the
detection of discontinuities, and Patterson, Hager & Rao, Optimal Control Applications and Methods 36 (2015), for the
preference of degrees to segments.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.polynomial import legendre

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import INNER_TOLERANCE_SHARE, NOTABLE, ROUNDING, SAME_TIME, TINY
from gnc_opt.planning.refinement.collocation_error_estimate import PhaseError
from gnc_opt.planning.refinement.mesh.mesh_breaks_at_kinks import (
    choose_breaks_around_kinks,
    find_active_constraint_multipliers,
    find_kinks_in_segment,
)
from gnc_opt.planning.solution.refinement_history import Actions
from gnc_opt.planning.transcription.mesh import Mesh

DECAY_RATE_MIN, DECAY_RATE_MAX = 0.02, 2.0
"""Range to which decay rates are clipped, decades per degree."""

SEGMENT_MAX_DEGREE, HALF_MAX_DEGREE = 20, 10
"""Largest degree of a segment, and of the halves of one."""

UNKNOWN_TRAJECTORY_ERROR = 1.0
"""Error above which kinks are not detected, since the trajectory is unknown."""

SMOOTHNESS_MIN_DEGREE = 5
"""Least number of coefficients for a test of smoothness; with fewer, the degree is increased first."""


def build_next_mesh(error: PhaseError, tol: float) -> tuple[Mesh, Actions]:
    """Return the next mesh of a phase, with unchanged segments up to errors of ``tol``, and the numbers of changes."""
    leg, worst, raised, split = error.samples.leg, error.largest_errors, 0, 0
    excess = error.compute_required_error_decades(INNER_TOLERANCE_SHARE * tol)
    added, active = (
        np.ceil(excess / _fit_legendre_decay_rates(error)),
        find_active_constraint_multipliers(error),
    )
    times, degrees = [float(leg.breaks[0])], list[int]()
    for k, degree in enumerate(leg.mesh.degrees):
        pieces = [(float(leg.breaks[k + 1]), degree)]
        if worst[k] > tol and leg.breaks[k + 1] - leg.breaks[k] >= SAME_TIME * leg.duration:
            pieces = _refine_segment(error, k, active, max(1, int(added[k])))
            raised, split = raised + (len(pieces) == 1), split + (len(pieces) > 1)
        times += [end for end, _ in pieces]
        degrees += [degree for _, degree in pieces]
    return Mesh.at_times(times, degrees), Actions(raised, split)


def _refine_segment(error: PhaseError, k: int, active: Array, added: int) -> list[tuple[float, int]]:
    """Return ends (s) and degrees of the pieces of segment k, which otherwise needs ``added`` points.

    Pieces with a kink have at most degree 3, the others of such a segment 3 to 6, and halves at most `HALF_MAX_DEGREE`.
    """
    leg, worst = error.samples.leg, float(error.largest_errors[k])
    degree, (left, right) = leg.mesh.degrees[k], map(float, leg.breaks[k : k + 2])
    kinks = find_kinks_in_segment(error, k, active) if worst < UNKNOWN_TRAJECTORY_ERROR else []
    cuts = choose_breaks_around_kinks(error, k, kinks) if kinks else []
    if len(cuts) > 2:
        middles = [0.5 * (a + b) for a, b in itertools.pairwise(cuts)]
        kinked = [any(kink.start <= t <= kink.end for kink in kinks) for t in middles]
        own = [min(degree, 3) if inside else max(min(degree, 6), 3) for inside in kinked]
        return list(zip(cuts[1:], own, strict=True))
    wanted = degree + added
    if degree < SMOOTHNESS_MIN_DEGREE and worst < NOTABLE:
        wanted = min(wanted, 2 * degree)
    if wanted <= SEGMENT_MAX_DEGREE:
        return [(right, min(wanted, 2 * degree + 2))]
    half = min(degree, HALF_MAX_DEGREE)
    return [(0.5 * (left + right), half), (right, half)]


def _fit_legendre_decay_rates(error: PhaseError) -> Array:
    """Return the decay rates of the Legendre coefficients of rates, integrands and controls (K,), decades per degree.

    They are the rates of the envelopes (Liu, Hager & Rao, IEEE Transactions on Control Systems Technology 26, 2018).
    """
    s, leg, functions = error.samples, error.samples.leg, error.samples.functions
    signals = np.concatenate(
        [
            functions.state_rates(*leg.point_trajectory) / s.state_scale[:, None],
            functions.integrands(*leg.point_trajectory) / error.integral_scale[:, None],
            np.hstack(leg.u.values) / s.control_scale[:, None] / leg.duration,
        ]
    )
    offsets = leg.mesh.point_offsets
    rates = [
        _fit_decay_rate_of_segment(signals[:, offsets[k] : offsets[k + 1]], rule.points)
        for k, rule in enumerate(leg.collocation_rules)
    ]
    return np.array(rates)


def _fit_decay_rate_of_segment(values: Array, tau: Array) -> float:
    n = tau.size
    if n < 3 or not np.all(np.isfinite(values)):
        return DECAY_RATE_MIN
    coefficients = np.abs(np.linalg.solve(legendre.legvander(tau, n - 1), values.T))
    sizes = np.max(coefficients, axis=1)
    envelope = np.maximum.accumulate(sizes[::-1])[::-1][1 if n > 5 else 0 :]
    floor = ROUNDING * max(float(np.max(sizes)), TINY)
    kept = envelope[: max(2, int(np.searchsorted(-envelope, -floor)))]
    slope = np.polyfit(np.arange(kept.size), np.log10(np.maximum(kept, floor)), 1)[0]
    return float(np.clip(-slope, DECAY_RATE_MIN, DECAY_RATE_MAX))
