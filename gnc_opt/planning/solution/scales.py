r"""Spans of states and controls: reference magnitudes for their variations, independent of the origin.

The span of a state is its largest distance from its initial value, shared by the components of a vector. A nearly
constant state has the change that the controls could cause, :math:`T\,\sum_k |\partial f_i/\partial u_k|\,\Delta u_k`
with the mean deviation :math:`\Delta u_k` of each control (a constant one: its span), or the same through another
state. A state that no control affects has the width of its limits, or its size. Spans are at least `SPAN_MIN_SHARE`
of the size.

H keeps the curvature of a smoothed kink, such as :math:`\sqrt{u^2 + e^2}`, over a share of a control's span only
(`Bending`). Controls may be without effect, as the steering angle of an engine that is off (`without_effect`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from gnc_opt.arrays import Array, Indices, Mask
from gnc_opt.model.composed_controls import VectorControl
from gnc_opt.model.variables import Layout
from gnc_opt.planning.problem.functions import PhaseFunctions
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.tolerances import AT_LIMIT, EQUAL, NEGLIGIBLE, NOTABLE, ROUNDING, magnitude

_CURVATURE_MAX_RATIO = 10.0
"""Times what H bends by over half of a control's span its curvature there may amount to."""


@dataclass(frozen=True, eq=False)
class Bending:
    """H along a phase, with other controls; arrays (n, n_samples), ``curvature`` d2H/du2 of each control."""

    functions: PhaseFunctions
    times: Array
    x: Array
    u: Array
    lam: Array
    curvature: Array

    def lasting(self, i: int, at: Indices, span: float) -> Array:
        """Share of its curvature in a control that H may keep over half of a span to either side, at some samples."""
        kept = self._curvature_share(i, at, span)
        return np.asarray(np.where(np.isfinite(kept), np.minimum(_CURVATURE_MAX_RATIO * kept, 1.0), 1.0))

    def rounding(self, spans: Array) -> Indices:
        """Controls that move by nothing beside spans (n_controls,) that H's curvature asks for but does not keep."""
        beyond = np.flatnonzero(spans * NEGLIGIBLE >= np.ptp(self.u, axis=1))
        return beyond[[not self._is_curved(int(i), spans[i]) for i in beyond]]

    def _is_curved(self, i: int, span: float) -> bool:
        """Whether H changes over a control's span by a fair share of what its largest curvature foretells."""
        at = np.array([np.argmax(np.abs(np.nan_to_num(self.curvature[i])))])
        kept = self._curvature_share(i, at, span)[0]
        return bool(not np.isfinite(kept) or kept >= NEGLIGIBLE)

    def _curvature_share(self, i: int, at: Indices, span: float) -> Array:
        """Share of its curvature in a control that H has over half of a span to either side, at some samples."""
        step = np.zeros((self.u.shape[0], 1))
        step[i] = 0.5 * span
        t, x, lam, u = self.times[at], self.x[:, at], self.lam[:, at], self.u[:, at]
        before, here, after = (self.functions.hamiltonian(t, x, v, lam) for v in (u - step, u, u + step))
        foretold = np.abs(self.curvature[i, at]) * step[i, 0] ** 2
        bend = np.abs(after - 2.0 * here + before)
        return np.asarray(np.divide(bend, foretold, out=np.ones_like(foretold), where=foretold > 0))


CONTROL_STEP_SHARES = 0.37, -0.61
"""Steps of a control, in shares of its scale: one that changes nothing at either is idle, and no angle has both as
turns."""


def without_effect(
    functions: PhaseFunctions,
    bounds: Interval,
    t: Array,
    x: Array,
    u: Array,
    scale: Array,
    norms: Mapping[int, int] | None = None,
) -> Mask:
    """Return where controls (m, N) change no rates, paths or integrands while others are on their bounds.

    The effect is relative to that elsewhere along the phase; ``scale`` (m,) are the scales of the controls, ``norms``
    the path constraint that gives a component of a direction its length: no effect.
    """
    idle = np.zeros(u.shape, dtype=bool)
    coupled = np.flatnonzero(~functions.separable_controls)
    lower, upper = bounds.near(u, AT_LIMIT * scale)
    bound = lower | upper
    if coupled.size < 2 or not np.any(bound[coupled]):
        return idle
    bases = u, np.where(bound, u, u + CONTROL_STEP_SHARES[0] * scale[:, None])
    effects = [functions.effects(t, x, base) for base in bases]
    for i in coupled:
        changes = [
            np.abs(functions.effects(t, x, _state_motion(base, int(i), share * scale[i])) - before)
            for base, before in zip(bases, effects, strict=True)
            for share in CONTROL_STEP_SHARES
        ]
        if norms and int(i) in norms:
            for change in changes:
                change[x.shape[0] + norms[int(i)]] = 0.0
        largest = np.nanmax(changes, axis=(0, 2), initial=0.0)
        idle[i] = np.all(np.asarray(changes) <= AT_LIMIT * largest[:, None], axis=(0, 1)) & ~bound[i]
    return idle


def _state_motion(u: Array, i: int, by: float) -> Array:
    other = u.copy()
    other[i] += by
    return other


STILL_STATE_SHARE = 1e-4
"""A state that moves by less than this share of what the controls could move it is still: that is its span."""


SPAN_MIN_SHARE = 1e-7
"""Least span, in shares of the size: with the tolerance of 1e-5 then 1e-12 of it, which is rounding."""


def state_spans(leg: PhaseSolution, functions: PhaseFunctions, used: Array, *, lasting: bool) -> Array:
    """Return how far each state moves along a phase (n_states,); ``used`` (n_controls,) are the controls' spans."""
    values = leg.x(leg.sample_times())
    size = np.max(np.abs(values), axis=1, initial=0.0)
    moved = shared(np.max(np.abs(values - values[:, :1]), axis=1), leg.states)
    if not lasting or np.max(moved) <= EQUAL:
        return magnitude(shared(size, leg.states))
    movable = shared(_reachable_motion(leg, functions, used), leg.states)
    spans = np.where(moved > STILL_STATE_SHARE * movable, moved, movable)
    spans = np.maximum(spans, SPAN_MIN_SHARE * size)
    boxes = (leg.state_bounds, leg.initial_bounds, leg.final_bounds)
    return _fallback_span(
        _fallback_span(spans, *(_finite_width(box) for box in boxes)), size, np.ones(size.size)
    )


def end_spans(leg: PhaseSolution, functions: PhaseFunctions, moved: Array, used: Array) -> Array:
    r"""Return the reference magnitudes of misses of the final state (n_states,): what controls move.

    That is :math:`\int |\Phi(t_f, t)\,\partial f/\partial u|\,\Delta u\,dt`, between the share `NOTABLE` of
    the span and the span; where controls do not reach, the span.
    """
    middles, widths = 0.5 * (leg.breaks[:-1] + leg.breaks[1:]), np.diff(leg.breaks)
    x, u = leg.x(middles), leg.flown(middles)
    by_state, by_control = (f(middles, x, u) for f in (functions.state_jacobian, functions.input_jacobian))
    if not (np.all(np.isfinite(by_state)) and np.all(np.isfinite(by_control))):
        return moved
    by_state = by_state * moved[None, :, None] / moved[:, None, None] * widths
    by_control = by_control * used[None, :, None] / moved[:, None, None] * widths
    onwards, reach = np.eye(moved.size), np.zeros(moved.size)
    for k in reversed(range(widths.size)):
        half = scipy.linalg.expm(np.clip(0.5 * by_state[:, :, k], -25.0, 25.0))
        reach += np.sum(np.abs(onwards @ half @ by_control[:, :, k]), axis=1)
        onwards = onwards @ half @ half
        if not np.all(reach < 1.0 / NOTABLE) or np.all(reach >= 1.0):
            break
    reach = shared(reach, leg.states)
    return np.asarray(moved * np.where(reach > STILL_STATE_SHARE, np.clip(reach, NOTABLE, 1.0), 1.0))


def control_spans(
    leg: PhaseSolution, flown: Array, pull: Array, curvature: Array, terms: float, asked: Array | float = 0.0
) -> Array:
    """Return the span of each control along a phase (n_controls,), positive and at most its range.

    Parameters
    ----------
    flown, pull, curvature : array (n_controls, n_samples)
        The control; the costates' part of dH/du; d2H/du2. A constant control has the span pull / curvature; an inactive
        one without a range the span that changes H as much as the others do.
    terms : float
        Size of the products of costates and rates in H, used if all controls are inactive.
    asked : array (n_controls,)
        Controls needed for the trajectory's motion (`steering`): the span of a constant control without a range, or its
        own size if less.
    """
    extent, size = _finite_width(leg.control_bounds), np.max(np.abs(flown), axis=1, initial=0.0)
    moved = np.ptp(flown, axis=1) if flown.size else size
    steepest, most = (np.max(np.abs(v), axis=1, initial=0.0) for v in (pull, curvature))
    pulled = np.divide(steepest, most, out=np.zeros_like(most), where=most > 0)
    spans = np.maximum(_within_range(np.fmax(moved, pulled), extent), SPAN_MIN_SHARE * size)
    spans = shared(spans, leg.controls)
    worth = np.fmax(steepest * spans, most * spans**2)
    largest = np.max(worth, initial=0.0, where=np.isfinite(worth))
    largest = largest if largest > NEGLIGIBLE**2 * terms else terms
    alike = np.sqrt(np.divide(largest, most, out=np.zeros_like(most), where=most > 0))
    spans = shared(np.where(spans > NEGLIGIBLE * alike, spans, alike), leg.controls)
    itself = np.where(size > EQUAL * asked, np.minimum(size, asked), asked)
    unmoved = (extent == 0) & (np.fmax(moved, pulled) <= NEGLIGIBLE * itself)
    unmoved &= spans <= np.fmax(NEGLIGIBLE * itself, SPAN_MIN_SHARE * size)
    spans = shared(np.where(unmoved, np.fmax(itself, spans), spans), leg.controls)
    return _fallback_span(np.where(spans > ROUNDING, spans, extent), magnitude(size))


def steering(leg: PhaseSolution, functions: PhaseFunctions) -> Array:
    """Return the controls (n_controls,) that the motion needs, by the least moved state; zero without effect."""
    middles, values = 0.5 * (leg.breaks[:-1] + leg.breaks[1:]), leg.x(leg.sample_times())
    moved = shared(np.max(np.abs(values - values[:, :1]), axis=1), leg.states)[:, None]
    x, u = leg.x(middles), leg.flown(middles)
    by_control = np.median(np.abs(functions.input_jacobian(middles, x, u)), axis=2)
    lasts = leg.breaks[-1] - leg.breaks[0]
    asked = np.divide(moved, lasts * by_control, out=np.full(by_control.shape, np.inf), where=by_control > 0)
    least = np.min(asked, axis=0, initial=np.inf)
    least = np.where(np.isfinite(least), least, 0.0)
    for i in np.flatnonzero(np.max(np.abs(u), axis=1, initial=0.0) <= EQUAL * least):
        by = least[i] * (np.arange(least.size) == i)[:, None]
        changed = np.max(np.abs(functions.rates(middles, x, u + by) - functions.rates(middles, x, u)), axis=1)
        if np.all(changed <= NEGLIGIBLE * by_control[:, i] * least[i]):
            least[i] = 0.0
    for vector in (c for c in leg.composed_controls if isinstance(c, VectorControl)):
        place = leg.controls.slice(
            vector.direction
        )  # of length 1: where it coasts, nothing could ask for more
        least[place] = np.minimum(least[place], 1.0)
    return np.asarray(least)


def _reachable_motion(leg: PhaseSolution, functions: PhaseFunctions, used: Array) -> Array:
    """Return how far the controls could move each state within the phase, directly or through another (n_states,)."""
    middles = 0.5 * (leg.breaks[:-1] + leg.breaks[1:])
    x, u = leg.x(middles), leg.flown(middles)
    # A median, as one violent instant says nothing about the phase.
    by_control = np.median(np.abs(functions.input_jacobian(middles, x, u)), axis=2)
    by_state = np.median(np.abs(functions.state_jacobian(middles, x, u)), axis=2)
    np.fill_diagonal(by_state, 0.0)
    lasts = leg.breaks[-1] - leg.breaks[0]
    at_once = lasts * by_control @ _mean_control_effects(leg, used)
    movable = np.maximum(at_once, lasts * by_state @ at_once)
    for _ in range(movable.size):  # what is further down a chain
        movable = np.where(movable > 0, movable, lasts * by_state @ movable)
    return np.asarray(movable)


def _mean_control_effects(leg: PhaseSolution, used: Array) -> Array:
    """Return by how much each control differs from its mean, on average (n_controls,); a constant one by its span."""
    times = leg.sample_times()
    lasts, u = times[-1] - times[0], leg.flown(times)
    mean = scipy.integrate.trapezoid(u, times, axis=1) / lasts
    pushes = scipy.integrate.trapezoid(np.abs(u - mean[:, None]), times, axis=1) / lasts
    return np.asarray(np.where(pushes > NEGLIGIBLE * used, pushes, used))


def _within_range(spans: Array, extent: Array) -> Array:
    return np.where(
        extent > 0, np.where(spans > NEGLIGIBLE * extent, np.minimum(spans, extent), extent), spans
    )


def shared(values: Array, layout: Layout) -> Array:
    """Return the largest value among the components of each variable."""
    values = np.where(np.isfinite(values), values, 0.0)  # a copy
    for variable in layout.variables:
        rows = layout.slice(variable.name)
        values[rows] = np.max(values[rows], initial=0.0)
    return values


def _finite_width(box: Interval) -> Array:
    """Return the finite widths of an interval; 0 where there is none."""
    width = box.upper - box.lower
    return np.where(np.isfinite(width), width, 0.0)


def _fallback_span(values: Array, *others: Array) -> Array:
    for other in others:
        values = np.where(values > 0, values, other)
    return values
