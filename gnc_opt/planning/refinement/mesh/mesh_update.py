"""Next mesh of a phase: increase of degrees and subdivision of segments.

Smooth segments get the degree predicted by the decay of their Legendre coefficients. Other segments are split at their
kinks, or halved. See Liu, Hager & Rao, Journal of the Franklin Institute 352 (2015), for the
detection of discontinuities, and Patterson, Hager & Rao, Optimal Control Applications and Methods 36 (2015), for the
preference of degrees to segments.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from gnc_opt.array_types import Array
from gnc_opt.planning.refinement.collocation_error_estimate import PhaseError
from gnc_opt.planning.refinement.mesh.mesh_breaks_at_kinks import (
    Kink,
    choose_breaks_around_kinks,
    find_active_constraint_multipliers,
    find_kinks,
)
from gnc_opt.planning.solution.refinement_history import Actions
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.tolerances import INNER_TOLERANCE_SHARE, NOTABLE, ROUNDING, SAME_TIME, TINY

DECAY_RATE_MIN, DECAY_RATE_MAX = 0.02, 2.0
"""Range to which decay rates are clipped, decades per degree."""

SEGMENT_MAX_DEGREE, HALF_MAX_DEGREE = 20, 10
"""Largest degree of a segment, and of the halves of one."""

UNKNOWN_TRAJECTORY_ERROR = 1.0
"""Error above which kinks are not detected, since the trajectory is unknown."""

SMOOTHNESS_MIN_DEGREE = 5
"""Least number of coefficients for a test of smoothness; with fewer, the degree is increased first."""


@dataclass(frozen=True)
class MeshPiece:
    """Segment of the next mesh: ends (s) and degree."""

    start: float
    end: float
    degree: int


@dataclass
class MeshUpdate:
    """Computation of the next mesh of one phase; ``tol`` is the largest error of a segment that is not refined."""

    error: PhaseError
    tol: float

    def __post_init__(self) -> None:
        self._leg = self.error.samples.leg
        self._worst = self.error.largest_errors
        self._decades = self.error.compute_required_error_decades(INNER_TOLERANCE_SHARE * self.tol)
        self._active: Array | None = None
        self.raised = self.split = 0

    def build_mesh(self) -> tuple[Mesh, Actions]:
        """Return the mesh and the numbers of changes."""
        pieces: list[MeshPiece] = []
        rates = _fit_legendre_decay_rates(self.error)
        for k, degree in enumerate(self._leg.mesh.degrees):
            own = MeshPiece(float(self._leg.breaks[k]), float(self._leg.breaks[k + 1]), degree)
            pieces += [own] if self._worst[k] <= self.tol else self._refine_segment(k, own, float(rates[k]))
        return _build_mesh(pieces), Actions(self.raised, self.split)

    def _refine_segment(self, k: int, own: MeshPiece, rate: float) -> list[MeshPiece]:
        narrow = (own.end - own.start) < SAME_TIME * self._leg.duration
        if narrow:
            return [own]
        if self._active is None:
            self._active = find_active_constraint_multipliers(self.error)
        kinks = find_kinks(self.error, k, self._active) if self._worst[k] < UNKNOWN_TRAJECTORY_ERROR else []
        if kinks:
            cuts = choose_breaks_around_kinks(self.error, k, kinks)
            if len(cuts) > 2:
                self.split += 1
                return self._split_around_kinks(cuts, kinks, own.degree)
        excess = float(self._decades[k])
        wanted = own.degree + max(1, math.ceil(excess / rate))
        if own.degree < SMOOTHNESS_MIN_DEGREE and self._worst[k] < NOTABLE:
            wanted = min(wanted, 2 * own.degree)
        if wanted <= SEGMENT_MAX_DEGREE:
            self.raised += 1
            return [MeshPiece(own.start, own.end, min(wanted, 2 * own.degree + 2))]
        self.split += 1
        return self._halve_segment(own)

    def _split_around_kinks(self, cuts: list[float], kinks: Sequence[Kink], degree: int) -> list[MeshPiece]:
        """Return the pieces around kinks: smooth ones with unchanged degree, those with a kink of low degree."""
        pieces = []
        for a, b in itertools.pairwise(cuts):
            middle = 0.5 * (a + b)
            inside = any(kink.start <= middle <= kink.end for kink in kinks)
            pieces.append(MeshPiece(a, b, min(degree, 3) if inside else max(min(degree, 6), 3)))
        return pieces

    def _halve_segment(self, own: MeshPiece) -> list[MeshPiece]:
        """Return the halves of a segment with its degree, at most `HALF_MAX_DEGREE`."""
        degree, middle = min(own.degree, HALF_MAX_DEGREE), 0.5 * (own.start + own.end)
        return [MeshPiece(own.start, middle, degree), MeshPiece(middle, own.end, degree)]


def _build_mesh(pieces: list[MeshPiece]) -> Mesh:
    times = [pieces[0].start, *(p.end for p in pieces)]
    return Mesh.at_times(times, [p.degree for p in pieces])


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
        _fit_legendre_decay_rate(signals[:, offsets[k] : offsets[k + 1]], rule.points)
        for k, rule in enumerate(leg.collocation_rules)
    ]
    return np.array(rates)


def _fit_legendre_decay_rate(values: Array, tau: Array) -> float:
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
