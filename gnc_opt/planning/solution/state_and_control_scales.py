r"""Variation scales of states and controls: reference magnitudes that do not depend on the origin.

The scale of a state is its largest distance from its initial value, common to the components of a vector. For a nearly
constant state it is the change that the controls could cause, :math:`T\,\sum_k |\partial f_i/\partial u_k|\,\Delta u_k`
with the mean deviation :math:`\Delta u_k` of each control (a constant one: its scale), or the same through another
state. A state that no control affects has the width of its limits, or its magnitude. Scales are at least
`SPAN_MIN_SHARE` of the magnitude.

Controls may be without effect, such as the steering angle of an engine that is off (`mask_inactive_controls`).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy

from gnc_opt.array_types import Array, Mask, compute_interval_midpoints
from gnc_opt.model.model_variables import Layout
from gnc_opt.numerical_tolerances import (
    AT_LIMIT,
    EQUAL,
    NEGLIGIBLE,
    ROUNDING,
    replace_tiny_by_one,
    set_nonfinite_to_zero,
)
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.hamiltonian_functions import PhaseFunctions
from gnc_opt.planning.solution.phase_solution import PhaseSolution

CONTROL_STEP_SHARES = 0.37, -0.61
"""Test steps of a control, as shares of its scale; a control is inactive if both have no effect."""


def mask_inactive_controls(
    functions: PhaseFunctions,
    bounds: Interval,
    t: Array,
    x: Array,
    u: Array,
    scale: Array,
    norms: Mapping[int, int] | None = None,
) -> Mask:
    """Return where controls (m, N) do not change rates, paths or integrands while others are at their bounds.

    The effect is relative to that elsewhere along the phase; ``scale`` (m,) are the scales of the controls. ``norms``
    maps a component of a direction to the path constraint of its length, which does not count as an effect.
    """
    inactive = np.zeros(u.shape, dtype=bool)
    coupled = np.flatnonzero(~functions.separable_controls)
    lower, upper = bounds.is_near_limits(u, AT_LIMIT * scale)
    at_bound = lower | upper
    if coupled.size < 2 or not np.any(at_bound[coupled]):
        return inactive
    bases = u, np.where(at_bound, u, u + CONTROL_STEP_SHARES[0] * scale[:, None])
    effects = [functions.evaluate_rates_paths_and_integrands(t, x, base) for base in bases]
    for i in coupled:
        step = scale[i] * (np.arange(scale.size) == i)[:, None]
        changes = [
            np.abs(functions.evaluate_rates_paths_and_integrands(t, x, base + share * step) - before)
            for base, before in zip(bases, effects, strict=True)
            for share in CONTROL_STEP_SHARES
        ]
        if norms and int(i) in norms:
            for change in changes:
                change[x.shape[0] + norms[int(i)]] = 0.0
        largest = np.nanmax(changes, axis=(0, 2), initial=0.0)
        inactive[i] = np.all(np.asarray(changes) <= AT_LIMIT * largest[:, None], axis=(0, 1)) & ~at_bound[i]
    return inactive


STILL_STATE_SHARE = 1e-4
"""Share of the motion that controls could cause, below which a state is nearly constant and has that scale."""

SPAN_MIN_SHARE = 1e-7
"""Smallest scale, as a share of the magnitude: with the tolerance 1e-5 it gives 1e-12, the rounding level."""


FAR_LIMIT_RATIO, INACTIVE_RANGE_RATIO = 1e3, 10.0
"""Largest ratios of a control's range to its variation with which the range is a scale: of distances to limits, and of
the variation of an inactive control. A wider range has a limit that the control does not approach."""


def compute_state_scales(
    phase: PhaseSolution, functions: PhaseFunctions, control_scales: Array, *, lasting: bool
) -> Array:
    """Return the variation scale of each state (n_states,) for given scales of the controls (n_controls,)."""
    values = phase.x(phase.sample_times())
    size = np.max(np.abs(values), axis=1)
    motion = take_largest_variable_component(np.max(np.abs(values - values[:, :1]), axis=1), phase.states)
    if not lasting or np.max(motion) <= EQUAL:
        return replace_tiny_by_one(take_largest_variable_component(size, phase.states))
    controllable = _estimate_controllable_changes(phase, functions, control_scales)
    controllable = take_largest_variable_component(controllable, phase.states)
    spans = np.where(motion > STILL_STATE_SHARE * controllable, motion, controllable)
    spans = np.maximum(spans, SPAN_MIN_SHARE * size)
    bounds = (phase.state_bounds, phase.initial_bounds, phase.final_bounds)
    return _replace_zeros(spans, *(box.interval_width_or_zero for box in bounds), size, np.ones(size.size))


def compute_control_scales(
    phase: PhaseSolution, applied: Array, slope: Array, curvature: Array, level: float, needed: Array | float
) -> Array:
    """Return the variation scale of each control in a phase (n_controls,), positive and at most its range.

    ``applied``, ``slope``, ``curvature`` (n_controls, n_samples) are the control, the costate part of dH/du and
    d2H/du2. A constant control has the scale slope / curvature; without it and a range, the one required for the motion
    (``needed``, `estimate_required_controls`) or its own magnitude if that is smaller; an inactive one without a near
    limit the scale with the same effect on H as the others, or as ``level``, products of costates and rates.
    """
    width, size = phase.control_bounds.interval_width_or_zero, np.max(np.abs(applied), axis=1)
    variation = np.ptp(applied, axis=1) if applied.size else size
    max_slope, max_curv = (np.max(np.abs(v), axis=1) for v in (slope, curvature))
    by_slope = np.divide(max_slope, max_curv, out=np.zeros_like(max_curv), where=max_curv > 0)
    spans = np.fmax(variation, by_slope)
    inactive = (width > 0) & (spans <= NEGLIGIBLE * width)
    spans = np.where(inactive & (max_curv == 0), width, np.where(width > 0, np.minimum(spans, width), spans))
    spans = np.maximum(spans, SPAN_MIN_SHARE * size)
    spans = take_largest_variable_component(spans, phase.controls)
    cost = np.fmax(max_slope * spans, max_curv * spans**2)
    largest = np.max(cost, initial=0.0, where=np.isfinite(cost))
    largest = largest if largest > NEGLIGIBLE**2 * level else level
    by_cost = np.sqrt(np.divide(largest, max_curv, out=np.zeros_like(max_curv), where=max_curv > 0))
    inactive_scale = replace_tiny_by_one(np.fmax(by_cost, size))
    inactive_scale = np.where(width > INACTIVE_RANGE_RATIO * inactive_scale, inactive_scale, width)
    by_cost = np.where(inactive, inactive_scale, by_cost)
    spans = np.where(spans > NEGLIGIBLE * by_cost, spans, by_cost)
    spans = take_largest_variable_component(spans, phase.controls)
    fallback = np.where(size > EQUAL * needed, np.minimum(size, needed), needed)
    is_constant = (width == 0) & (np.fmax(variation, by_slope) <= NEGLIGIBLE * fallback)
    is_constant &= spans <= np.fmax(NEGLIGIBLE * fallback, SPAN_MIN_SHARE * size)
    spans = np.where(is_constant, np.fmax(fallback, spans), spans)
    spans = take_largest_variable_component(spans, phase.controls)
    spans = np.where(spans > ROUNDING * np.where(needed > 0, needed, 1.0), spans, width)
    return _replace_zeros(spans, replace_tiny_by_one(size))


def estimate_required_controls(phase: PhaseSolution, functions: PhaseFunctions) -> Array:
    """Return the controls (n_controls,) required for the motion, from the least moved state; zero without effect."""
    middles, values = compute_interval_midpoints(phase.breaks), phase.x(phase.sample_times())
    motion = take_largest_variable_component(np.max(np.abs(values - values[:, :1]), axis=1), phase.states)
    motion = np.where(motion > ROUNDING, motion, 0.0)[:, None]
    x, u = phase.x(middles), phase.applied(middles)
    by_control = np.median(np.abs(functions.dynamics_control_jacobian(middles, x, u)), axis=2)
    span = phase.breaks[-1] - phase.breaks[0]
    needed = np.divide(motion, span * by_control, out=np.full(by_control.shape, np.inf), where=by_control > 0)
    smallest = np.min(needed, axis=0, initial=np.inf)
    smallest = set_nonfinite_to_zero(smallest)
    for i in np.flatnonzero(np.max(np.abs(u), axis=1) <= EQUAL * smallest):
        step = smallest[i] * (np.arange(smallest.size) == i)[:, None]
        before, after = (functions.state_rates(middles, x, v) for v in (u, u + step))
        changed = np.max(np.abs(after - before), axis=1)
        if np.all(changed <= NEGLIGIBLE * by_control[:, i] * smallest[i]):
            smallest[i] = 0.0
    for vector in phase.vector_controls:
        rows = phase.controls.slice(vector.direction)  # directions of length 1 have no larger scale
        smallest[rows] = np.minimum(smallest[rows], 1.0)
    return np.asarray(smallest)


def _estimate_controllable_changes(phase: PhaseSolution, functions: PhaseFunctions, scales: Array) -> Array:
    """Return the change of each state that controls could cause, directly or through another state (n_states,)."""
    middles = compute_interval_midpoints(phase.breaks)
    x, u = phase.x(middles), phase.applied(middles)
    # median, not sensitive to short peaks
    by_control = np.median(np.abs(functions.dynamics_control_jacobian(middles, x, u)), axis=2)
    by_state = np.median(np.abs(functions.state_jacobian(middles, x, u)), axis=2)
    np.fill_diagonal(by_state, 0.0)
    times = phase.sample_times()
    span, control = phase.breaks[-1] - phase.breaks[0], phase.applied(times)
    mean = scipy.integrate.trapezoid(control, times, axis=1) / span
    deviation = scipy.integrate.trapezoid(np.abs(control - mean[:, None]), times, axis=1) / span
    direct = span * by_control @ np.where(deviation > NEGLIGIBLE * scales, deviation, scales)
    changes = np.maximum(direct, span * by_state @ direct)
    for _ in range(changes.size):  # states further down a chain
        changes = np.where(changes > 0, changes, span * by_state @ changes)
    return np.asarray(changes)


def take_largest_variable_component(values: Array, layout: Layout) -> Array:
    """Return the largest value over the components of each variable."""
    values = set_nonfinite_to_zero(values)  # copy
    for variable in layout.variables:
        rows = layout.slice(variable.name)
        values[rows] = np.max(values[rows], initial=0.0)
    return values


def _replace_zeros(values: Array, *fallbacks: Array) -> Array:
    for fallback in fallbacks:
        values = np.where(values > 0, values, fallback)
    return values
