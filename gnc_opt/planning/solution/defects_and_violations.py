r"""Defects, violations of limits and propagation errors of a trajectory, also between its nodes.

A violation is a distance, to first order along the gradient of the constraint, with states and controls scaled by their
magnitudes. Controls beyond their bounds between nodes are clipped to the bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gnc_opt.array_types import Array, Indices
from gnc_opt.numerical_tolerances import ROUNDING
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.propagation import integrate_dynamics

PEAK_RISE_RATIO = 10.0
"""A peak next to a sample is located unless it would exceed the sample by more than this multiple of the difference to
the adjacent samples."""

_TRIED = np.linspace(-7 / 8, 7 / 8, 15)
"""Points in a bracket [-1, 1], which is then reduced to the neighbours of the highest one, by a factor of 8."""

_LIMITS_ROUNDS = 6

PEAKS_PER_LIMIT = 5
"""Largest number of peaks located per limit, and of violations returned per limit."""


@dataclass(frozen=True, eq=False)
class Limits:
    """One-sided finite limits: ``values`` (n,), their ``rows`` of the quantities, ``sides`` 1 (upper) or -1 (lower).

    ``quantities`` (n_rows, m) are a function of t (m,), x (n_states, m), u (n_controls, m).
    """

    quantities: Callable[[Array, Array, Array], Array]
    rows: Indices
    sides: Array
    values: Array

    @classmethod
    def from_interval(cls, quantities: Callable[[Array, Array, Array], Array], bounds: Interval) -> Limits:
        both = np.concatenate([bounds.lower, bounds.upper])
        finite, n = np.flatnonzero(np.isfinite(both)), bounds.lower.size
        return cls(quantities, finite % max(n, 1), np.where(finite < n, -1.0, 1.0), both[finite])

    def select_limits(self, chosen: Indices) -> Limits:
        """Return selected limits in the given order, possibly with repetitions."""
        return Limits(self.quantities, self.rows[chosen], self.sides[chosen], self.values[chosen])

    def compute_limit_excess(self, t: Array, x: Array, u: Array) -> Array:
        """Return the excess of each quantity over its limit (n, m); infinite for NaN."""
        excess = self.quantities(t, x, u)[self.rows] - self.values[:, None]
        return np.where(np.isnan(excess), np.inf, self.sides[:, None] * excess)


@dataclass(frozen=True, eq=False)
class Violations:
    """Local maxima of limit violations in a phase, with states and control polynomials there (n, m)."""

    limits: Limits
    times: Array
    excess: Array
    x: Array
    u: Array

    def describe_violation(self, i: int) -> str:
        """Return a quantity and its limit: "81 (at least 100)", "1 + 2e-08 (at most 1)"."""
        limit, side = self.limits.values[i], self.limits.sides[i]
        text, allowed = f"{limit + side * self.excess[i]:.6g}", f"{limit:.6g}"
        if text == allowed:
            text = f"{allowed} {'+' if side > 0 else '-'} {self.excess[i]:.0e}"
        return f"{text} (at {'most' if side > 0 else 'least'} {allowed})"


def find_limit_violations(samples: PhaseSamples, limits: Limits, *, applied: bool = False) -> Violations:
    """Return times and amounts by which the polynomials of a phase, or its applied controls, exceed limits."""
    controls = samples.u if applied else samples.u_polynomial
    signal = samples.leg.applied if applied else samples.leg.u
    every = limits.compute_limit_excess(samples.times, samples.x, controls)
    k, j, rise = _find_sample_peaks(samples, every)
    times, excess, x, u = samples.times[j], every[k, j], samples.x[:, j], controls[:, j]
    promise = excess + PEAK_RISE_RATIO * rise
    hidden = np.flatnonzero(np.isfinite(excess) & (promise > 0) & (rise > 0))
    hidden = hidden[_find_highest_excess_peaks(k[hidden], promise[hidden])]
    if hidden.size:
        left, right = (
            samples.times[_find_neighbouring_samples(samples, j[hidden], step)] for step in (-1, 1)
        )
        peaks, heights = _locate_excess_peaks(samples, limits.select_limits(k[hidden]), signal, left, right)
        higher = heights > excess[hidden]
        places = hidden[higher]
        times[places], excess[places] = peaks[higher], heights[higher]
        x[:, places], u[:, places] = samples.leg.x(times[places]), signal(times[places])
    beyond = np.flatnonzero(excess > ROUNDING * np.abs(limits.values[k]))
    beyond = beyond[_find_highest_excess_peaks(k[beyond], excess[beyond])]
    return Violations(
        limits.select_limits(k[beyond]), times[beyond], excess[beyond], x[:, beyond], u[:, beyond]
    )


def _find_highest_excess_peaks(groups: Indices, values: Array) -> Indices:
    order = np.lexsort((-values, groups))
    starts = np.searchsorted(groups[order], groups[order])
    return np.asarray(order[np.arange(order.size) - starts < PEAKS_PER_LIMIT])


def _find_neighbouring_samples(samples: PhaseSamples, j: Indices, step: int) -> Indices:
    """Return the samples before or after samples j; at an end of a segment the sample itself."""
    other = np.clip(j + step, 0, samples.times.size - 1)
    return np.where(samples.segments[other] == samples.segments[j], other, j)


def _find_sample_peaks(samples: PhaseSamples, excess: Array) -> tuple[Indices, Indices, Array]:
    """Return limit and sample of local maxima within segments, and their rise above the lower neighbour (m,)."""
    j = np.arange(samples.times.size)
    before, after = (_find_neighbouring_samples(samples, j, step) for step in (-1, 1))
    above_before = (excess > excess[:, before]) | (before == j)
    k, j = np.nonzero(above_before & (excess >= excess[:, after]))
    top, lower = excess[k, j], np.minimum(excess[k, before[j]], excess[k, after[j]])
    return k, j, np.subtract(top, lower, out=np.zeros(top.size), where=np.isfinite(top))


def _locate_excess_peaks(
    samples: PhaseSamples, limits: Limits, signal: Callable[..., Array], left: Array, right: Array
) -> tuple[Array, Array]:
    """Return times and heights of the peaks between left and right, one per limit, located simultaneously."""
    phase, columns = samples.leg, np.arange(left.size)
    times, best = left, np.full(left.size, -np.inf)
    for _ in range(_LIMITS_ROUNDS):
        middle, half = 0.5 * (left + right), 0.5 * (right - left)
        tried = middle + half * _TRIED[:, None]
        every = limits.compute_limit_excess(tried.ravel(), phase.x(tried.ravel()), signal(tried.ravel()))
        excess = every.reshape(left.size, *tried.shape)[columns, :, columns]
        top = np.argmax(excess, axis=1)
        heights, places = excess[columns, top], tried[top, columns]
        times, best = np.where(heights > best, places, times), np.maximum(heights, best)
        step = half * (_TRIED[1] - _TRIED[0])
        left, right = np.maximum(left, places - step), np.minimum(right, places + step)
    return times, best


def evaluate_with_clipped_controls(
    function: Callable[[Array, Array, Array], Array], times: Array, x: Array, u: Array, bounds: Interval
) -> Array:
    """Return the values of a function (n, n_times), with controls clipped to their bounds if it is not finite."""
    values = function(times, x, u)
    lost = np.any(np.isnan(values), axis=0)
    if np.any(lost):
        inside = np.clip(u[:, lost], bounds.lower[:, None], bounds.upper[:, None])
        values = values.copy()
        values[:, lost] = function(times[lost], x[:, lost], inside)
    return values


@dataclass(frozen=True)
class Worst:
    """Value and its location."""

    value: float
    where: str

    def select_larger(self, other: Worst) -> Worst:
        """Return the larger one; NaN counts as larger."""
        return self if np.isnan(self.value) or other.value <= self.value else other

    @classmethod
    def locate_largest(cls, values: Array, describe: Callable[..., str]) -> Worst:
        """Return the largest entry (NaN counts as larger), with its location ``describe(*index)``."""
        if not values.size:
            return NOTHING
        at = np.unravel_index(np.argmax(values), values.shape)
        return cls(float(values[at]), describe(*map(int, at)))


NOTHING = Worst(0.0, "no violation")


def compute_dynamics_residual(s: PhaseSamples, u: Array) -> Array:
    """Return dx/dt - f(t, x, u) for given controls at the samples (n, n_samples)."""
    rates = evaluate_with_clipped_controls(
        s.functions.state_rates, s.times_inside_segments, s.x, u, s.leg.control_bounds
    )
    return np.asarray(s.x_rate - rates)


def compute_segment_defects(samples: PhaseSamples) -> Array:
    """Return the defects of the dynamics in each segment and the jump after it, relative to `state_scale` (n, K)."""
    phase, inner = samples.leg, samples.leg.breaks[1:-1]
    errors = samples.segment_integrals(np.abs(compute_dynamics_residual(samples, samples.u_polynomial)))
    errors[:, :-1] += np.abs(phase.x(inner, "right") - phase.x(inner, "left"))
    return errors / samples.state_scale[:, None]


def find_worst_defect(samples: PhaseSamples) -> Worst:
    labels = samples.leg.states.labels
    return Worst.locate_largest(
        compute_segment_defects(samples), lambda i, k: samples.describe_segment(k, labels[i])
    )


def compute_terminal_error(samples: PhaseSamples) -> float:
    """Return the largest propagation error of the applied control, relative to `state_scale`."""
    run = integrate_dynamics(samples.leg, samples.functions)
    return float(np.max(np.abs(run.error) / samples.state_scale))
