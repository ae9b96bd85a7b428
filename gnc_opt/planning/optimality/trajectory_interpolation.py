r"""Piecewise polynomial fit of sampled trajectories: Hermite interpolation of states, splines of controls.

Between two samples the states are the cubic through both values with the slopes :math:`f(t, x, u)`, of fourth order in
the sampling interval. Controls are interpolated between their jumps by a quintic spline or, near kinks, by a modified
Akima spline, which does not overshoot, but is of second order only. An interval uses the latter if it brings the
integrated dynamics closer to the next sample by a factor of `KINK_ERROR_RATIO`. A jump is a repeated time with
different values, or a change between samples ten times the adjacent ones; its time is determined from the states. A
kink is a jump of the slope, at the intersection of the interpolants from both sides.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gnc_opt.array_types import Array, compute_interval_midpoints
from gnc_opt.model.casadi_function_evaluation import take_runge_kutta_step
from gnc_opt.numerical_tolerances import NEGLIGIBLE, ROUNDING, SMALL, TINY
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial, subdivide_intervals
from gnc_opt.planning.transcription.collocation_families import GAUSS
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.quadrature import (
    build_lagrange_interpolation_matrix,
    get_collocation_rule,
)

FIT_DEGREE = 4
"""Collocation points per sampling interval: cubic controls, of the same order as the states."""

KINK_ERROR_RATIO = 0.1
"""Largest ratio of the propagation errors with Akima and quintic splines at a kink; without one, noise decides."""

JUMP_MIN_RATIO = 10.0
"""Smallest ratio of a control's change to the adjacent changes at which it is a jump."""

_KINK_MIN_SAMPLES = 8
"""Smallest number of samples between jumps for the detection of kinks."""

_NO_FIT = 1e3
"""Error, relative to the state, that replaces a non-finite one."""

_RUNGE_KUTTA_STEPS = 4
"""Number of Runge-Kutta steps from a sample to a jump, and from one jump to the next."""

Rates = Callable[[Array, Array, Array], Array]


@dataclass(frozen=True)
class SampledPhase:
    """Sampled trajectory of a phase: times ``t`` (n,), s, ascending, states and controls; a repeated time is a jump."""

    t: Array
    x: Array
    u: Array


@dataclass(frozen=True, eq=False)
class FittedPhase:
    """Trajectory of a phase as one polynomial per sampling interval, on a mesh whose movable breaks are the jumps."""

    mesh: Mesh
    x: PiecewisePolynomial
    u: PiecewisePolynomial

    def split_mesh_segments(self, parts: int) -> FittedPhase:
        """Return the same trajectory on a mesh with segments divided into equal parts."""
        if parts == 1:
            return self
        breaks, fractions = (
            subdivide_intervals(edges, parts) for edges in (self.x.breaks, np.asarray(self.mesh.breaks))
        )
        mesh = Mesh(
            tuple(map(float, fractions)),
            tuple(n for n in self.mesh.degrees for _ in range(parts)),
            tuple(parts * k for k in self.mesh.movable),
        )
        return FittedPhase(mesh, *(_subdivide_polynomials(p, breaks, parts) for p in (self.x, self.u)))


def _subdivide_polynomials(polynomial: PiecewisePolynomial, breaks: Array, parts: int) -> PiecewisePolynomial:
    """Return the same polynomials with values at the nodes of every part of their segments."""
    nodes = polynomial.nodes[0]  # of all segments
    nodes_of_parts = [(2 * k + 1 + nodes) / parts - 1 for k in range(parts)]
    matrices = [build_lagrange_interpolation_matrix(nodes, points).T for points in nodes_of_parts]
    values = tuple(piece @ matrix for piece in polynomial.values for matrix in matrices)
    return PiecewisePolynomial(breaks, (nodes,) * len(values), values)


def fit_trajectory_polynomials(samples: SampledPhase, rates: Rates, noise: ArrayLike = 0.0) -> FittedPhase:
    """Return polynomials through samples with at least two different times; ``rates`` maps (times, x, u) to dx/dt.

    Smaller changes of the controls than ``noise`` (n_controls,) are neither jumps nor kinks, but rounding errors.
    """
    repeated, n_controls = np.flatnonzero(np.diff(samples.t) == 0), samples.u.shape[0]
    floors = np.broadcast_to(noise, n_controls)
    thresholds = np.fmax(SMALL * np.ptp(samples.u, axis=1), floors)
    jump_sizes = np.abs(samples.u[:, repeated + 1] - samples.u[:, repeated])
    jumps = [
        _Jump(int(i), float(samples.t[i]), tuple(range(n_controls)), of_slope=not is_jump)
        for i, is_jump in zip(repeated, np.any(jump_sizes > thresholds[:, None], axis=0), strict=True)
    ]
    unmarked = _find_control_jumps_between_samples(samples, thresholds)
    jumps += unmarked
    for c, values in enumerate(samples.u):
        edges = sorted({0, samples.t.size, *(j.after + 1 for j in jumps if c in j.channels)})
        for first, last in itertools.pairwise(edges):
            jumps += _find_control_kinks(samples.t[first:last], values[first:last], first, c, floors[c])
    jumps.sort(key=lambda jump: jump.after)
    controls = _ControlFit(samples, jumps)
    controls.choose_control_interpolation(samples, rates)
    for interval in sorted({jump.after for jump in unmarked}):
        _refine_control_jump_times(samples, controls, [j for j in unmarked if j.after == interval], rates)
    return _fit_polynomials(samples, controls, sorted(jumps, key=lambda jump: jump.time), rates)


@dataclass
class _Jump:
    """Jump of channels, or of their slopes, between a sample and the next one, which may have the same time."""

    after: int
    time: float
    channels: tuple[int, ...]
    of_slope: bool = False


def _find_control_jumps_between_samples(samples: SampledPhase, thresholds: Array) -> list[_Jump]:
    t, steps = samples.t, np.flatnonzero(np.diff(samples.t) > 0)
    if t.size <= 3:  # too few samples
        return []
    change = np.abs(np.diff(samples.u, axis=1))[:, steps]
    padded = np.pad(change, ((0, 0), (1, 1)))
    neighbours = np.maximum(padded[:, :-2], padded[:, 2:])
    channels, k = np.nonzero((change > thresholds[:, None]) & (change > JUMP_MIN_RATIO * neighbours))
    middles = compute_interval_midpoints(t)
    return [_Jump(int(i), float(middles[i]), (int(c),)) for c, i in zip(channels, steps[k], strict=True)]


def _find_control_kinks(t: Array, u: Array, first: int, channel: int, min_jump: float) -> list[_Jump]:
    """Return the kinks of a control between two jumps: isolated intervals across which its slope changes."""
    if t.size < _KINK_MIN_SAMPLES:
        return []
    slopes = np.diff(u) / np.diff(t)
    jump, changes = np.abs(slopes[4:-1] - slopes[2:-3]), np.abs(np.diff(slopes))
    is_visible = jump * np.diff(t)[3:-2] > max(SMALL * np.ptp(u), min_jump)
    after = 3 + np.flatnonzero(is_visible & (jump > JUMP_MIN_RATIO * np.maximum(changes[1:-3], changes[4:])))
    # The second of two with a kink at the common sample.
    after = after[np.append(np.diff(after) > 1, True)[: after.size]]
    kinks, start = [], 0
    for k, end in zip(after, np.append(after[1:] + 1, t.size), strict=False):
        left = _build_control_interpolants(t[start : k + 1], u[start : k + 1])[0]
        right = _build_control_interpolants(t[k + 1 : end], u[k + 1 : end])[0]
        slack = NEGLIGIBLE * float(np.ptp(u))
        time = _find_curve_intersection(left, right, float(t[k]), float(t[k + 1]), slack)
        if time is not None:
            kinks.append(_Jump(first + int(k), time, (channel,), of_slope=True))
            start = k + 1
    return kinks


def _find_curve_intersection(left: Any, right: Any, first: float, last: float, slack: float) -> float | None:
    differences = {end: float(left(end) - right(end)) for end in (first, last)}
    for end, difference in differences.items():
        if abs(difference) <= slack:
            return end
    if differences[first] * differences[last] > 0:
        return None
    return float(scipy.optimize.brentq(lambda time: float(left(time) - right(time)), first, last))


class _ControlFit:
    """Controls at any time, between their jumps; ``kinked``: sampling intervals with Akima splines."""

    def __init__(self, samples: SampledPhase, jumps: list[_Jump]) -> None:
        self._jumps = [[j for j in jumps if c in j.channels] for c in range(samples.u.shape[0])]
        self._times, self._kinked = samples.t, np.zeros(samples.t.size - 1, dtype=bool)
        self._pieces = []
        for c, channel_jumps in enumerate(self._jumps):
            edges = [0, *(j.after + 1 for j in channel_jumps), samples.t.size]
            pairs = itertools.pairwise(edges)
            self._pieces.append(
                [_build_control_interpolants(samples.t[a:b], samples.u[c, a:b]) for a, b in pairs]
            )

    def __call__(self, t: float | Array, middle: float | Array) -> Array:
        """Return the controls (m, n_times) at times t in the segment with the given middle."""
        times, middles = np.atleast_1d(t), np.broadcast_to(middle, np.shape(np.atleast_1d(t)))
        kinked = self._kinked[np.clip(np.searchsorted(self._times, middles) - 1, 0, self._kinked.size - 1)]
        values = np.empty((len(self._pieces), times.size))
        for c, pieces in enumerate(self._pieces):
            chosen = np.searchsorted([j.time for j in self._jumps[c]], middles)
            for k in np.unique(chosen):
                for spline, interpolant in enumerate(pieces[k]):
                    columns = (chosen == k) & (kinked == bool(spline))
                    values[c, columns] = interpolant(times[columns])
        return values

    def choose_control_interpolation(self, samples: SampledPhase, rates: Rates) -> None:
        """Select Akima splines where the states agree much better with them, relative to their median errors."""
        steps = np.flatnonzero(np.diff(samples.t) > 0)
        errors = []
        for kinked in (False, True):
            self._kinked[:] = kinked
            ends = _propagate_states(samples.x[:, steps], samples.t[steps], samples.t[steps + 1], self, rates)
            errors.append(np.abs(ends - samples.x[:, steps + 1]))
        typical = np.fmax(np.median(errors[0], axis=1), ROUNDING * np.max(np.abs(samples.x), axis=1)) + TINY
        relative_errors = [np.max(error / typical[:, None], axis=0) for error in errors]
        self._kinked[steps] = relative_errors[1] < KINK_ERROR_RATIO * relative_errors[0]


def _build_control_interpolants(t: Array, u: Array) -> tuple[Any, Any]:
    """Return the quintic spline and the Akima spline of samples u (n,) at times t; of fewer than four, a polynomial."""
    if t.size < 4:
        polynomial = np.polynomial.Polynomial.fit(t, u, t.size - 1, domain=[t[0] - 0.5, t[0] + 0.5])
        return polynomial, polynomial
    akima = scipy.interpolate.Akima1DInterpolator(t, u, method="makima", extrapolate=True)
    return scipy.interpolate.make_interp_spline(t, u, k=5 if t.size > 5 else 3), akima


def _refine_control_jump_times(
    samples: SampledPhase, controls: _ControlFit, jumps: list[_Jump], rates: Rates
) -> None:
    """Move jumps between two samples to the time at which the dynamics connect the states."""
    i = jumps[0].after
    first, last = float(samples.t[i]), float(samples.t[i + 1])
    magnitude = np.maximum(np.max(np.abs(samples.x), axis=1), TINY)

    def compute_propagation_error(times: Array) -> Array:
        for jump, time in zip(jumps, times, strict=True):
            jump.time = float(time)
        ends = np.unique([first, *np.clip(times, first, last), last])
        x = samples.x[:, i]
        for a, b in itertools.pairwise(ends):
            x = _propagate_states(x[:, None], np.array([a]), np.array([b]), controls, rates)[:, 0]
        error = (x - samples.x[:, i + 1]) / magnitude
        return np.asarray(np.nan_to_num(error, nan=_NO_FIT, posinf=_NO_FIT, neginf=-_NO_FIT))

    start = np.array([first + (last - first) * (k + 1) / (len(jumps) + 1) for k in range(len(jumps))])
    fit = scipy.optimize.least_squares(
        compute_propagation_error,
        start,
        bounds=(first, last),
        x_scale=last - first,
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    slack = NEGLIGIBLE * (last - first)
    for jump, time in zip(jumps, fit.x, strict=True):
        is_at_end = time - first < slack, last - time < slack
        jump.time = first if is_at_end[0] else last if is_at_end[1] else float(time)


def _propagate_states(x: Array, a: Array, b: Array, controls: _ControlFit, rates: Rates) -> Array:
    """Return states (n, k) at times b from those at times a (k,), by Runge-Kutta steps of order 4."""
    h, middle = (b - a) / _RUNGE_KUTTA_STEPS, 0.5 * (a + b)
    for k in range(_RUNGE_KUTTA_STEPS):
        t = a + k * h
        u = [controls(time, middle) for time in (t, t + 0.5 * h, t + h)]
        x = np.asarray(take_runge_kutta_step(rates, t, h, x, u))
    return x


def _fit_polynomials(
    samples: SampledPhase, controls: _ControlFit, jumps: list[_Jump], rates: Rates
) -> FittedPhase:
    t, x = samples.t, samples.x
    between_samples = [j for j in jumps if not np.any(t == j.time)]
    times = np.unique([*t, *(j.time for j in between_samples)])
    before, after = np.empty((x.shape[0], times.size)), np.empty((x.shape[0], times.size))
    before[:, np.searchsorted(times, t[::-1])] = x[:, ::-1]  # the first one of a repeated time
    after[:, np.searchsorted(times, t)] = x
    for time in dict.fromkeys(j.time for j in between_samples):
        k = int(np.searchsorted(times, time))
        state = _propagate_states(after[:, k - 1 : k], times[k - 1 : k], times[k : k + 1], controls, rates)
        before[:, [k]] = after[:, [k]] = state
    widths, middles = np.diff(times), compute_interval_midpoints(times)
    left, right = after[:, :-1], before[:, 1:]
    slopes_left = widths * rates(times[:-1], left, controls(times[:-1], middles))
    slopes_right = widths * rates(times[1:], right, controls(times[1:], middles))
    rule = get_collocation_rule(GAUSS, FIT_DEGREE)
    s = 0.5 * (1 + rule.state_nodes)[:, None, None]
    states = (
        (1 + 2 * s) * (1 - s) ** 2 * left
        + s * (1 - s) ** 2 * slopes_left
        + s**2 * (3 - 2 * s) * right
        - s**2 * (1 - s) * slopes_right
    )
    points = (times[:-1] + 0.5 * widths * (1 + rule.points)[:, None]).ravel()
    values = controls(points, np.tile(middles, rule.points.size)).reshape(-1, rule.points.size, widths.size)
    count = range(widths.size)
    jump_breaks = {int(np.searchsorted(times, j.time)) for j in jumps if not j.of_slope}
    movable = tuple(sorted(jump_breaks & set(range(1, times.size - 1))))
    fractions = (times - times[0]) / (times[-1] - times[0])
    return FittedPhase(
        Mesh(tuple(fractions), (FIT_DEGREE,) * widths.size, movable),
        PiecewisePolynomial(
            times, (rule.state_nodes,) * widths.size, tuple(states[:, :, k].T for k in count)
        ),
        PiecewisePolynomial(times, (rule.points,) * widths.size, tuple(values[:, :, k] for k in count)),
    )
