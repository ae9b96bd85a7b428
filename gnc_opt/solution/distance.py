r"""How far a trajectory is beyond what a constraint allows: a distance, not a value.

The value of a constraint says nothing by itself: :math:`r^2 \ge b^2`, :math:`r \ge b` and :math:`b/r \le 1` are one
limit. What counts is the set of states and controls that it allows. So the depth of a point beyond it is the
distance to that set along the constraint's own gradient, states and controls scaled by their sizes. It is judged in
shares of the flight's size, or of the width of what is allowed or forbidden there where that is far less: a sphere of
10 m on a flight of 10 km.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gnc_opt.arrays import Array, Indices, Mask
from gnc_opt.problem.interval import Interval
from gnc_opt.solution.limits import Limits, Violations
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.tolerances import ROUNDING, TINY

WIDTHS = 100.0
"""Yardstick of a small feature, in widths of it: solvers keep a limit to shares of the flight's size, and cannot keep
it to the same share of what is far smaller."""

FINEST = 1e-3
"""Least yardstick, in shares of the flight's size: below, rounding of the solver's own scale would fail."""

PINNED = 1e-5
"""A range narrower than this share of the flight's size fixes a value; it is no feature with a width of its own."""

REACH = 64.0
"""How far off the allowed set is looked for, in sizes of the flight."""

_STEPS = REACH * 4.0 ** np.arange(-22.0, 1.0)
"""Places on a line where it is looked at first; what lies between two is then cut in `_PARTS`, `_ROUNDS` times."""

_PARTS, _ROUNDS = 16, 6


def bound_offences(found: Violations, bounds: Interval, scale: Array) -> Array:
    """Return how far states or controls of given sizes (n,) are beyond their bounds, as shares (m,)."""
    rows = found.limits.rows
    here = Interval(bounds.lower[rows], bounds.upper[rows])
    return shares(found.excess / scale[rows], here, scale[rows])


def shares(depth: Array, bounds: Interval, scale: Array) -> Array:
    """Return depths (n,) beyond limits on quantities of given sizes in shares of these, or of the limits' width."""
    width = (bounds.upper - bounds.lower) / scale
    return _shares(depth, np.where(width > PINNED, width, np.inf))


def path_offences(found: Violations, samples: PhaseSamples) -> Array:
    """Return how far points are beyond what their path constraints allow, as shares (m,).

    Where there is no gradient (the centre of a sphere), or no allowed point along it, the line leads to the nearest
    sample that the constraint allows. Where there is none either, as states and controls cannot restore the
    constraint, its excess counts in shares of its values. What is not finite is infinitely far off.
    """
    start = np.zeros(found.times.size)
    line = _Line(found, samples, _gradient(found, samples))
    depth = line.first(found.limits, start, 1.0, allowed=True)
    lost = ~np.isfinite(depth)
    if np.any(lost):
        line = _Line(found, samples, np.where(lost, _to_nearest_allowed(found, samples), line.direction))
        depth = line.first(found.limits, start, 1.0, allowed=True)
    met = np.isfinite(depth)
    depth = np.where(met, depth, 0.0)
    shares = np.where(
        met, _shares(depth, _width(line, depth)), found.excess / samples.path_scale[found.limits.rows]
    )
    return np.where(np.isfinite(found.excess), shares, np.inf)


def _width(line: _Line, depth: Array) -> Array:
    """Return the lesser width of what is forbidden and allowed along lines that become allowed at a depth, (m,)."""
    limits = line.found.limits
    forbidden = depth - line.first(limits, np.zeros(depth.size), -1.0, allowed=True)
    allowed = line.first(limits, depth, 1.0, allowed=False) - depth
    bounds, upper = line.samples.leg.path_bounds, limits.sides > 0
    others = np.where(upper, bounds.lower[limits.rows], bounds.upper[limits.rows])
    other = Limits(limits.quantities, limits.rows, -limits.sides, others)
    span = line.first(other, depth, 1.0, allowed=False) - depth
    return np.minimum(np.minimum(forbidden, allowed), np.where(span > PINNED, span, np.inf))


def _shares(depth: Array, width: Array) -> Array:
    """Return depths in shares of the flight's size, or of `WIDTHS` widths where these are less."""
    return np.asarray(depth / np.clip(WIDTHS * width, FINEST, 1.0))


@dataclass(frozen=True, eq=False)
class _Line:
    """A line through each point, in scaled states and controls (n_states + n_controls, m)."""

    found: Violations
    samples: PhaseSamples
    direction: Array

    def first(self, limits: Limits, start: Array, sense: float, *, allowed: bool) -> Array:
        """Return the first place beyond ``start`` where limits hold, or do not; infinite if there is none."""
        inside, outside, found = self._bracket(limits, start, start + sense * _STEPS[:, None], allowed)
        for _ in range(_ROUNDS):
            cuts = inside + (outside - inside) * (np.arange(1, _PARTS + 1) / _PARTS)[:, None]
            inside, outside, _ = self._bracket(limits, inside, cuts, allowed)
        return np.where(found, outside, sense * np.inf)

    def _bracket(
        self, limits: Limits, start: Array, places: Array, allowed: bool
    ) -> tuple[Array, Array, Mask]:
        """Return the first of places (n, m) that is as wanted, the place before it, and whether there is one."""
        columns = np.arange(start.size)
        holds = self._holds(limits, places.ravel(), np.tile(columns, places.shape[0]))
        hits = holds.reshape(places.shape) == allowed
        found, hit = np.any(hits, axis=0), np.argmax(hits, axis=0)
        hit = np.where(found, hit, places.shape[0] - 1)
        before = np.where(hit > 0, places[hit - 1, columns], start)
        return before, places[hit, columns], found

    def _holds(self, limits: Limits, places: Array, which: Indices) -> Mask:
        found, n = self.found, self.found.x.shape[0]
        moved = np.concatenate([found.x, found.u])[:, which]
        moved = moved + places * _scale(self.samples)[:, None] * self.direction[:, which]
        here = limits.some(which)
        excess = here.excess_pairwise(found.times[which], moved[:n], moved[n:])
        return np.asarray(excess <= ROUNDING * np.where(np.isfinite(here.values), np.abs(here.values), 0.0))


def _scale(samples: PhaseSamples) -> Array:
    return np.concatenate([samples.state_scale, samples.control_scale])


def _unit(vectors: Array) -> Array:
    """Return columns of length 1; zero where there is no direction."""
    vectors = np.where(np.all(np.isfinite(vectors), axis=0), vectors, 0.0)
    largest = np.max(np.abs(vectors), axis=0, initial=0.0)
    vectors = vectors / np.maximum(largest, TINY)
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=0), TINY))


def _gradient(found: Violations, samples: PhaseSamples) -> Array:
    """Return the direction in which the excess falls fastest, of length 1 (n_states + n_controls, m)."""
    at = (found.times, found.x, found.u)
    columns = np.arange(found.times.size)
    by_state = samples.functions.path_state_jacobian(*at)[found.limits.rows, :, columns]
    by_control = samples.functions.path_control_jacobian(*at)[found.limits.rows, :, columns]
    gradient = np.concatenate([by_state, by_control], axis=1).T * _scale(samples)[:, None]
    return _unit(-found.limits.sides * gradient)


def _to_nearest_allowed(found: Violations, samples: PhaseSamples) -> Array:
    """Return the direction to the nearest sample that satisfies each point's limit, zero if there is none."""
    scale = _scale(samples)[:, None]
    flight = np.concatenate([samples.x, samples.u_polynomial]) / scale
    allowed = found.limits.excess(samples.times, samples.x, samples.u_polynomial) <= 0
    directions = np.zeros((flight.shape[0], found.times.size))
    for i, point in enumerate((np.concatenate([found.x, found.u]) / scale).T):
        away = flight - point[:, None]
        distance = np.where(allowed[i], np.linalg.norm(away, axis=0), np.inf)
        nearest = int(np.argmin(distance))
        if np.isfinite(distance[nearest]):
            directions[:, i] = away[:, nearest]
    return _unit(directions)
