r"""Propagation with the applied control, defects and violations of limits of a trajectory, also between its nodes.

The dynamics are integrated independently of the collocation. A violation is a distance, to first order along the
gradient of the constraint, with states and controls scaled by their magnitudes. Controls beyond their bounds between
nodes are clipped to the bound.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from gnc_opt.array_types import Array, Indices
from gnc_opt.model.ode_integration import CallLimit, Controls, OdeError, Tolerance, integrate_ode
from gnc_opt.numerical_tolerances import ROUNDING, replace_tiny_by_one
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.hamiltonian_functions import PhaseFunctions
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.state_and_control_scales import take_largest_variable_component

RELATIVE_TOLERANCE = 1e-11
"""Relative tolerance of integrations that check a solution."""


@dataclass(frozen=True)
class Propagation:
    """States integrated from the initial state with the applied controls.

    Attributes
    ----------
    times : array (n_times,)
    states : array (n_states, n_times)
        NaN after an early end.
    error : array (n_states,)
        Final state minus the final state of the solution; infinite after an early end.
    ended : str
        Cause and time of an early end, e.g. ``"the rate of state 'h' is nan at t = 2.5 s"``; else empty.
    """

    times: Array
    states: Array
    error: Array
    ended: str = ""


def integrate_dynamics(phase: PhaseSolution, functions: PhaseFunctions) -> Propagation:
    """Return the integrated states of a phase with the applied control; see `Solution.propagate`."""
    edges = phase.applied.jump_times
    states, ended = _integrate_between_control_jumps(phase, functions, edges)
    error = states[:, -1] - phase.x(phase.breaks[-1])
    return Propagation(edges, states, np.where(np.isfinite(error), error, np.inf), ended)


def integrate_states_to_times(phase: PhaseSolution, functions: PhaseFunctions, times: Array) -> Array:
    """Return the states (n_states, n_times) of a phase integrated with the applied control.

    Times must not decrease; states are NaN after an early end.
    """
    edges = np.union1d(phase.applied.jump_times, times)
    states, _ = _integrate_between_control_jumps(phase, functions, edges)
    return np.asarray(states[:, np.searchsorted(edges, times)])


def compute_propagation_errors(phase: PhaseSolution, functions: PhaseFunctions, segments: Indices) -> Array:
    """Return the propagation errors of segments, integrated with the applied control (n_states, n).

    Infinite where the integration fails, and after `MAX_RATES` evaluations for all segments together.
    """
    errors, jumps = np.empty((phase.states.size, segments.size)), phase.applied.jump_times
    budget = CallLimit(phase.states.labels)
    for column, k in enumerate(segments):
        left, right = phase.breaks[k : k + 2]
        edges = np.array([left, *jumps[(jumps > left) & (jumps < right)], right])
        states, _ = _integrate_between_control_jumps(phase, functions, edges, budget)
        errors[:, column] = phase.x(right, "left") - states[:, -1]
    return np.where(np.isfinite(errors), errors, np.inf)


def _integrate_between_control_jumps(
    phase: PhaseSolution, functions: PhaseFunctions, edges: Array, budget: CallLimit | None = None
) -> tuple[Array, str]:
    """Return the states at the edges of pieces with smooth applied control (DOP853), and the cause of an early end.

    The integration starts at the state of the first edge; states (n_states, n_edges) are NaN after an early end. The
    absolute tolerance is `RELATIVE_TOLERANCE` times the magnitude of each state.
    """
    tolerance = Tolerance(RELATIVE_TOLERANCE, compute_state_magnitudes(phase))
    budget = budget or CallLimit(phase.states.labels)
    states = np.full((phase.states.size, edges.size), np.nan)
    states[:, 0] = phase.x(edges[0])
    rates = functions.buffered_state_rates()
    for k, (left, right) in enumerate(itertools.pairwise(edges)):
        controls = _interpolate_controls(phase, left, right)

        def evaluate_state_rates(t: float, x: Array, controls: Controls = controls) -> Array:
            return rates(t, x, controls(np.array([t]))[:, 0])

        try:
            run = integrate_ode(
                evaluate_state_rates, states[:, k], (left, right), tolerance=tolerance, budget=budget
            )
        except OdeError as why:
            return states, str(why)
        states[:, k + 1] = run.states[:, -1]
    return states, ""


def compute_state_magnitudes(phase: PhaseSolution) -> Array:
    """Return the largest magnitude of each state along the phase (n,), common to the components of a vector."""
    largest = np.max(np.abs(phase.x(phase.sample_times())), axis=1)
    return replace_tiny_by_one(take_largest_variable_component(largest, phase.states))


def _interpolate_controls(phase: PhaseSolution, left: float, right: float) -> Controls:
    """Return the applied controls between two successive jump times, where they are polynomials."""
    degree = max(phase.mesh.degrees)
    half, middle = 0.5 * (right - left), 0.5 * (right + left)
    tau = chebyshev.chebpts1(degree + 1)
    values = phase.applied(middle + half * tau)
    if np.all(values == values[:, :1]):  # constant, e.g. at a bound
        return lambda times: np.broadcast_to(values[:, :1], (values.shape[0], times.size))
    coefficients = np.asarray(chebyshev.chebfit(tau, values.T, degree)).T
    orders = np.arange(degree + 1.0)[:, None]

    def evaluate_control_polynomial(times: Array) -> Array:
        # One call of Chebyshev polynomials; Runge-Kutta stages may be beyond the ends by rounding.
        angles = np.arccos(np.minimum(np.maximum((times - middle) / half, -1.0), 1.0))
        return np.asarray(coefficients @ np.cos(orders * angles))

    return evaluate_control_polynomial


PEAK_RISE_RATIO = 10.0
"""A peak next to a sample is located unless it would exceed the sample by more than this multiple of the difference to
the adjacent samples."""

_TRIAL_POINTS = np.linspace(-7 / 8, 7 / 8, 15)
"""Points in a bracket [-1, 1], which is then reduced to the neighbours of the highest one, by a factor of 8."""

_PEAK_ITERATIONS = 6

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
        limits = np.concatenate([bounds.lower, bounds.upper])
        finite, n_rows = np.flatnonzero(np.isfinite(limits)), bounds.lower.size
        return cls(quantities, finite % max(n_rows, 1), np.where(finite < n_rows, -1.0, 1.0), limits[finite])

    def select_limits(self, chosen: Indices) -> Limits:
        """Return selected limits in the given order, possibly with repetitions."""
        return Limits(self.quantities, self.rows[chosen], self.sides[chosen], self.values[chosen])

    def compute_limit_excess(self, t: Array, x: Array, u: Array) -> Array:
        """Return the excess of each quantity over its limit (n, m); infinite for NaN."""
        excess = self.quantities(t, x, u)[self.rows] - self.values[:, None]
        return np.where(np.isnan(excess), np.inf, self.sides[:, None] * excess)


@dataclass(frozen=True, eq=False)
class Violations:
    """Local maxima of limit violations in a phase, with states and controls there (n, m)."""

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


def find_limit_violations(samples: PhaseSamples, limits: Limits) -> Violations:
    """Return times and amounts by which states and applied controls of a phase exceed limits."""
    all_excess = limits.compute_limit_excess(samples.times, samples.x, samples.u)
    rows, j, rise = _find_local_violation_peaks(samples, all_excess)
    times, excess, x, u = samples.times[j], all_excess[rows, j], samples.x[:, j], samples.u[:, j]
    possible_excess = excess + PEAK_RISE_RATIO * rise
    unresolved = np.flatnonzero(np.isfinite(excess) & (possible_excess > 0) & (rise > 0))
    unresolved = unresolved[_select_largest_violation_peaks(rows[unresolved], possible_excess[unresolved])]
    if unresolved.size:
        neighbour_pairs = (_find_neighbouring_samples(samples, j[unresolved], step) for step in (-1, 1))
        left, right = (samples.times[neighbours] for neighbours in neighbour_pairs)
        chosen = limits.select_limits(rows[unresolved])
        peaks, heights = _locate_violation_peaks(samples.phase, chosen, left, right)
        is_higher = heights > excess[unresolved]
        better = unresolved[is_higher]
        times[better], excess[better] = peaks[is_higher], heights[is_higher]
        x[:, better], u[:, better] = samples.phase.x(times[better]), samples.phase.applied(times[better])
    large = np.flatnonzero(excess > ROUNDING * np.abs(limits.values[rows]))
    large = large[_select_largest_violation_peaks(rows[large], excess[large])]
    return Violations(
        limits.select_limits(rows[large]), times[large], excess[large], x[:, large], u[:, large]
    )


def _select_largest_violation_peaks(groups: Indices, values: Array) -> Indices:
    order = np.lexsort((-values, groups))
    starts = np.searchsorted(groups[order], groups[order])
    return np.asarray(order[np.arange(order.size) - starts < PEAKS_PER_LIMIT])


def _find_neighbouring_samples(samples: PhaseSamples, j: Indices, step: int) -> Indices:
    """Return the samples before or after samples j; at an end of a segment the sample itself."""
    neighbours = np.clip(j + step, 0, samples.times.size - 1)
    return np.where(samples.segments[neighbours] == samples.segments[j], neighbours, j)


def _find_local_violation_peaks(samples: PhaseSamples, excess: Array) -> tuple[Indices, Indices, Array]:
    """Return limit and sample of local maxima within segments, and their rise above the lower neighbour (m,)."""
    j = np.arange(samples.times.size)
    before, after = (_find_neighbouring_samples(samples, j, step) for step in (-1, 1))
    above_before = (excess > excess[:, before]) | (before == j)
    k, j = np.nonzero(above_before & (excess >= excess[:, after]))
    peak, lower = excess[k, j], np.minimum(excess[k, before[j]], excess[k, after[j]])
    return k, j, np.subtract(peak, lower, out=np.zeros(peak.size), where=np.isfinite(peak))


def _locate_violation_peaks(
    phase: PhaseSolution, limits: Limits, left: Array, right: Array
) -> tuple[Array, Array]:
    """Return times and heights of the peaks between left and right, one per limit, located simultaneously."""
    times, best, columns = left, np.full(left.size, -np.inf), np.arange(left.size)
    for _ in range(_PEAK_ITERATIONS):
        middle, half = 0.5 * (left + right), 0.5 * (right - left)
        trial_times = middle + half * _TRIAL_POINTS[:, None]
        all_times = trial_times.ravel()
        excess_of_all = limits.compute_limit_excess(all_times, phase.x(all_times), phase.applied(all_times))
        excess = excess_of_all.reshape(left.size, *trial_times.shape)[columns, :, columns]
        best_trials = np.argmax(excess, axis=1)
        heights, peak_times = excess[columns, best_trials], trial_times[best_trials, columns]
        times, best = np.where(heights > best, peak_times, times), np.maximum(heights, best)
        step = half * (_TRIAL_POINTS[1] - _TRIAL_POINTS[0])
        left, right = np.maximum(left, peak_times - step), np.minimum(right, peak_times + step)
    return times, best


@dataclass(frozen=True)
class Worst:
    """Value and its location."""

    value: float
    where: str

    def select_larger(self, other: Worst) -> Worst:
        """Return the larger one; NaN counts as larger."""
        return self if np.isnan(self.value) or other.value <= self.value else other

    @classmethod
    def find_largest_value(cls, values: Array, describe: Callable[..., str]) -> Worst:
        """Return the largest entry (NaN counts as larger), with its location ``describe(*index)``."""
        if not values.size:
            return NO_VIOLATION
        index = np.unravel_index(np.argmax(values), values.shape)
        return cls(float(values[index]), describe(*map(int, index)))


NO_VIOLATION = Worst(0.0, "no violation")


def compute_dynamics_residual(s: PhaseSamples, u: Array) -> Array:
    """Return dx/dt - f(t, x, u) for given controls at the samples (n, n_samples)."""
    rates = s.sample_signal(s.phase.x.derivative())
    return np.asarray(rates - s.evaluate_with_clipped_controls(s.functions.state_rates, u))


def compute_segment_defects(samples: PhaseSamples) -> Array:
    """Return the defects of the dynamics in each segment and the jump after it, relative to `state_scale` (n, K)."""
    phase, inner = samples.phase, samples.phase.breaks[1:-1]
    errors = samples.integrate_over_segments(np.abs(compute_dynamics_residual(samples, samples.u_polynomial)))
    errors[:, :-1] += np.abs(phase.x(inner, "right") - phase.x(inner, "left"))
    return errors / samples.state_scale[:, None]


def find_worst_defect(samples: PhaseSamples) -> Worst:
    """Return the largest defect, relative to the variation of its state, with its location."""
    labels = samples.phase.states.labels
    defects = compute_segment_defects(samples)
    return Worst.find_largest_value(defects, lambda i, k: samples.describe_segment(k, labels[i]))
