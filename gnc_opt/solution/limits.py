"""Where a trajectory is beyond its limits: at the samples and between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gnc_opt.arrays import Array, Indices
from gnc_opt.problem.interval import Interval
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.tolerances import ROUNDING

SWINGS = 10.0
"""A peak beside a sample is looked for unless it had to rise above it by more than this many times the change
to the neighbouring samples."""

FLAT = 1e-9
"""Changes between samples below this share of the usual distance to the limit are noise, not a peak."""

_TRIED = np.linspace(-7 / 8, 7 / 8, 15)
"""Where a bracket [-1, 1] is looked at before it is narrowed to the neighbours of the highest, eight times less."""

_ROUNDS = 6

MOST = 5
"""So many peaks per limit are looked for, the most promising ones, and so many violations per limit are returned."""


@dataclass(frozen=True, eq=False)
class Limits:
    """The finite limits of an interval on quantities of (t, x, u), one side each.

    Attributes
    ----------
    quantities : function of t (m,), x (n_states, m) and u (n_controls, m)
        The quantities (n_rows, m).
    rows : int array (n,)
        Whose limit it is.
    sides : array (n,)
        1 for an upper limit, -1 for a lower one.
    values : array (n,)
    """

    quantities: Callable[[Array, Array, Array], Array]
    rows: Indices
    sides: Array
    values: Array

    @classmethod
    def of(cls, quantities: Callable[[Array, Array, Array], Array], bounds: Interval) -> Limits:
        """Return the finite limits of an interval."""
        both = np.concatenate([bounds.lower, bounds.upper])
        finite, n = np.flatnonzero(np.isfinite(both)), bounds.lower.size
        return cls(quantities, finite % max(n, 1), np.where(finite < n, -1.0, 1.0), both[finite])

    def some(self, chosen: Indices) -> Limits:
        """Return some of the limits, in the order given; any may come several times."""
        return Limits(self.quantities, self.rows[chosen], self.sides[chosen], self.values[chosen])

    def excess(self, t: Array, x: Array, u: Array) -> Array:
        """Return how far each quantity is beyond its limit (n, m); infinite if it is not a number."""
        values = self.quantities(t, x, u)[self.rows]
        excess = self.sides[:, None] * (values - self.values[:, None])
        return np.where(np.isnan(excess), np.inf, excess)

    def excess_pairwise(self, t: Array, x: Array, u: Array) -> Array:
        """Return how far the i-th quantity is beyond its limit at the i-th time (n,)."""
        values = self.quantities(t, x, u)[self.rows, np.arange(t.size)]
        excess = self.sides * (values - self.values)
        return np.where(np.isnan(excess), np.inf, excess)


@dataclass(frozen=True, eq=False)
class Violations:
    """Points of a phase beyond a limit, farthest among their neighbours.

    Attributes
    ----------
    limits : Limits
        The limit of each point, m in all.
    times, excess : array (m,)
    x, u : array (n_states, m), (n_controls, m)
        Controls by their polynomial.
    """

    limits: Limits
    times: Array
    excess: Array
    x: Array
    u: Array

    def value(self, i: int) -> str:
        """Return what the quantity is and may be: "81 (at least 100)"."""
        limit, side = self.limits.values[i], self.limits.sides[i]
        return f"{limit + side * self.excess[i]:.6g} (at {'most' if side > 0 else 'least'} {limit:.6g})"


def violations(samples: PhaseSamples, limits: Limits) -> Violations:
    """Return where the polynomials of a phase leave limits.

    A sample that no neighbour surpasses has a peak beside it. Unless that would have to rise far more above the sample
    than the samples change, it is found by narrowing the bracket between the neighbours.
    """
    if not limits.rows.size:
        leg, nothing = samples.leg, np.zeros(0)
        x, u = np.zeros((leg.states.size, 0)), np.zeros((leg.controls.size, 0))
        return Violations(limits, nothing, nothing, x, u)
    tops = _Tops.of(samples, limits)
    k, j, excess = tops.limits, tops.samples, tops.excess
    times, x, u = samples.times[j], samples.x[:, j], samples.u_polynomial[:, j]
    promise = excess + SWINGS * tops.swing
    hidden = np.flatnonzero(np.isfinite(excess) & (promise > 0) & (tops.swing > FLAT * tops.room))
    hidden = hidden[_highest(k[hidden], promise[hidden])]
    if hidden.size:
        peaks, heights = _narrowed(samples, limits.some(k[hidden]), tops.left[hidden], tops.right[hidden])
        higher = heights > excess[hidden]
        places = hidden[higher]
        times[places], excess[places] = peaks[higher], heights[higher]
        x[:, places], u[:, places] = samples.leg.x(times[places]), samples.leg.u(times[places])
    beyond = np.flatnonzero(excess > ROUNDING * np.abs(limits.values[k]))
    beyond = beyond[_highest(k[beyond], excess[beyond])]
    return Violations(limits.some(k[beyond]), times[beyond], excess[beyond], x[:, beyond], u[:, beyond])


def _highest(groups: Indices, values: Array) -> Indices:
    """Return where the `MOST` highest values of each group are."""
    order = np.lexsort((-values, groups))
    starts = np.searchsorted(groups[order], groups[order])
    return np.asarray(order[np.arange(order.size) - starts < MOST])


@dataclass(frozen=True, eq=False)
class _Tops:
    """Samples whose excess no neighbour in the segment surpasses.

    Attributes
    ----------
    limits, samples : int array (m,)
        Which.
    excess, swing : array (m,)
        Excess there, and by how much more it is than at the lower neighbour.
    left, right : array (m,)
        Times of the neighbours.
    room : array (m,)
        The limit's usual distance along the phase.
    """

    limits: Indices
    samples: Indices
    excess: Array
    swing: Array
    left: Array
    right: Array
    room: Array

    @classmethod
    def of(cls, samples: PhaseSamples, limits: Limits) -> _Tops:
        times, last = samples.times, samples.at_end
        first = np.append(True, last[:-1])
        excess = limits.excess(times, samples.x, samples.u_polynomial)
        before = np.where(first, -np.inf, np.roll(excess, 1, axis=1))
        after = np.where(last, -np.inf, np.roll(excess, -1, axis=1))
        k, j = np.nonzero((excess > before) & (excess >= after))
        lower = np.minimum(np.where(first, np.inf, before)[k, j], np.where(last, np.inf, after)[k, j])
        top = excess[k, j]
        swing = np.subtract(top, lower, out=np.zeros(top.size), where=np.isfinite(top))
        left = np.where(first, times, np.roll(times, 1))[j]
        right = np.where(last, times, np.roll(times, -1))[j]
        return cls(k, j, top, swing, left, right, np.median(np.abs(excess), axis=1)[k])


def _narrowed(samples: PhaseSamples, limits: Limits, left: Array, right: Array) -> tuple[Array, Array]:
    """Return times and heights of the peaks between left and right, one per limit, all narrowed at once."""
    leg, columns = samples.leg, np.arange(left.size)
    times, best = left, np.full(left.size, -np.inf)
    all_limits = limits.some(np.tile(columns, _TRIED.size))
    for _ in range(_ROUNDS):
        middle, half = 0.5 * (left + right), 0.5 * (right - left)
        tried = (middle + half * _TRIED[:, None]).ravel()
        excess = all_limits.excess_pairwise(tried, leg.x(tried), leg.u(tried)).reshape(_TRIED.size, -1)
        top = np.argmax(excess, axis=0)
        heights, places = excess[top, columns], tried.reshape(_TRIED.size, -1)[top, columns]
        times, best = np.where(heights > best, places, times), np.maximum(heights, best)
        step = half * (_TRIED[1] - _TRIED[0])
        left, right = np.maximum(left, places - step), np.minimum(right, places + step)
    return times, best
