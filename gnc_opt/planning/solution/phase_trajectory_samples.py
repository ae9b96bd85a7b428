"""Dense samples of a phase, at and between the nodes, from model and trajectory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np

from gnc_opt.array_types import Array, Indices, Mask
from gnc_opt.numerical_tolerances import (
    AT_LIMIT,
    GONE,
    MAGNITUDE_FLOOR,
    NEGLIGIBLE,
    NOTABLE,
    SHORTEST,
    TINY,
    replace_tiny_by_one,
    set_nonfinite_to_zero,
)
from gnc_opt.planning.problem.angle_valued_controls import AngleProbe
from gnc_opt.planning.problem.hamiltonian_functions import PhaseFunctions
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.state_and_control_scales import (
    FAR_LIMIT_RATIO,
    SPAN_MIN_SHARE,
    STILL_STATE_SHARE,
    compute_control_scales,
    compute_state_scales,
    estimate_required_controls,
    mask_inactive_controls,
    take_largest_variable_component,
)
from gnc_opt.planning.transcription.collocation_families import GAUSS
from gnc_opt.planning.transcription.quadrature import (
    MAX_POINTS,
    get_collocation_points,
    get_quadrature_weights,
)

SAMPLES_BEYOND_POINTS = 9
"""Samples per segment in addition to the number of collocation points; segment ends are added."""

EVEN_STEPS_PER_SEGMENT = 32
"""Smallest number of steps per segment for even sampling; short segments contain fast motion."""

COSTATE_MIN_SHARE_OF_COST = 1e-4
"""Share of the cost scale below which costates are rounding and do not affect the scale."""

_BY_COST_MAGNITUDE = ("cost_scale", "hamiltonian_scale")
"""Cached properties of samples that depend on the cost magnitude."""


NO_EDGES = np.zeros(0)


@dataclass(frozen=True, eq=False)
class PhaseSamples:
    """Data of the optimality conditions at the times of a fine quadrature in every segment, including segment ends.

    ``times`` (n_samples,) ascend; segment boundaries appear twice, as end and start of adjacent ``segments``. The
    quadrature ``weights`` are in s, zero at segment ends. ``cost_magnitude`` is 0 if unknown (see
    `EndPoints.compute_endpoint_changes`); ``feature_edges`` are edges of additional cells (s).
    """

    phase: PhaseSolution
    functions: PhaseFunctions
    times: Array
    segments: Indices
    weights: Array
    cost_magnitude: float = 0.0
    feature_edges: Array = field(default_factory=lambda: NO_EDGES)

    @classmethod
    def from_phase(
        cls, phase: PhaseSolution, functions: PhaseFunctions, feature_edges: Array = NO_EDGES
    ) -> PhaseSamples:
        edges, segments = phase.breaks, np.arange(phase.mesh.segments)
        if feature_edges.size:
            edges = np.union1d(edges, feature_edges)
            segments = np.searchsorted(phase.breaks, edges[:-1], "right") - 1
        cell_points = [choose_segment_sample_points(phase.mesh.degrees[k]) for k in segments]
        cells = np.repeat(np.arange(len(cell_points)), [tau.size for tau, _ in cell_points])
        tau, weights = (np.concatenate(part) for part in zip(*cell_points, strict=True))
        halves = 0.5 * np.diff(edges)[cells]
        times = edges[cells] + halves * (1 + tau)
        ends = np.append(np.flatnonzero(np.diff(cells)), cells.size - 1)
        times[ends] = edges[1:]  # exact
        return cls(phase, functions, times, segments[cells], halves * weights, feature_edges=feature_edges)

    def with_cost_scale(self, amount: float, feature_edges: Array) -> PhaseSamples:
        """Return samples with another cost magnitude and further cells; without these, cached values are kept."""
        if feature_edges.size:
            return replace(self.from_phase(self.phase, self.functions, feature_edges), cost_magnitude=amount)
        clone = replace(self, cost_magnitude=amount)
        cached = {k: v for k, v in vars(self).items() if k not in _BY_COST_MAGNITUDE and k not in vars(clone)}
        vars(clone).update(cached)
        return clone

    def resample_at_even_times(self, count: int, min_steps: int = EVEN_STEPS_PER_SEGMENT) -> PhaseSamples:
        """Return samples at ``count`` or more evenly spaced times, two Gauss points per step, and at segment ends.

        Every segment has at least ``min_steps`` steps.
        """
        breaks = self.phase.breaks
        widths = np.diff(breaks)
        steps = np.maximum(np.ceil(0.5 * count * widths / max(np.sum(widths), TINY)), min_steps).astype(int)
        pieces = zip(breaks[:-1], breaks[1:], steps, strict=True)
        edges_by_segment = [np.linspace(left, right, n + 1) for left, right, n in pieces]
        edges = np.unique(np.concatenate([*edges_by_segment, self.feature_edges]))
        cells, segment_of_cell = np.diff(edges), np.searchsorted(breaks, edges[:-1], "right") - 1
        pair = 0.5 + 0.5 / np.sqrt(3) * np.array([-1.0, 1.0])
        points, all_segments = (edges[:-1, None] + cells[:, None] * pair).ravel(), np.arange(steps.size)
        times = np.concatenate([points, breaks[:-1], breaks[1:]])
        segments = np.concatenate([np.repeat(segment_of_cell, 2), all_segments, all_segments])
        weights = np.concatenate([np.repeat(0.5 * cells, 2), np.zeros(2 * steps.size)])
        order = np.lexsort((times, segments))
        return replace(self, times=times[order], segments=segments[order], weights=weights[order])

    @cached_property
    def times_inside_segments(self) -> Array:
        """Times (n_samples,); with discontinuous dynamics, segment ends are moved inwards by `GONE`.

        The value at a jump due to a final state, such as friction at rest, must not depend on rounding.
        """
        if not self.functions.has_discontinuous_rates:
            return self.times
        starts, ends = self.phase.breaks[self.segments], self.phase.breaks[self.segments + 1]
        return np.clip(self.times, starts + GONE * (ends - starts), ends - GONE * (ends - starts))

    def sample_signal(self, signal: Callable[..., Array]) -> Array:
        """Return a signal (of times and a side) at the samples, with the limit from inside each segment."""
        values = signal(self.times_inside_segments, "right")
        ends = np.append(self.segment_starts[1:], self.segments.size) - 1
        values[:, ends] = signal(self.times_inside_segments[ends], "left")
        return values

    @cached_property
    def x(self) -> Array:
        """States (n, n_samples)."""
        return self.sample_signal(self.phase.x)

    @cached_property
    def u_polynomial(self) -> Array:
        """Controls as collocation polynomials (m, n_samples)."""
        return self.sample_signal(self.phase.u)

    @cached_property
    def u(self) -> Array:
        """Applied controls, within bounds."""
        return self.sample_signal(self.phase.applied)

    def evaluate_with_clipped_controls(
        self, function: Callable[[Array, Array, Array], Array], u: Array | None = None
    ) -> Array:
        """Return a function (n, n_samples) of times, states and controls, by default the collocation polynomials.

        Where it is not finite, controls are clipped to their bounds.
        """
        u, bounds = self.u_polynomial if u is None else u, self.phase.control_bounds
        values = function(self.times_inside_segments, self.x, u)
        is_nan = np.any(np.isnan(values), axis=0)
        if np.any(is_nan):
            clipped = np.clip(u[:, is_nan], bounds.lower[:, None], bounds.upper[:, None])
            values = values.copy()
            values[:, is_nan] = function(self.times_inside_segments[is_nan], self.x[:, is_nan], clipped)
        return values

    @cached_property
    def inactive_controls(self) -> Mask:
        """Whether a control has no effect (m, n_samples), such as the direction of a vector of magnitude zero."""
        layout, bounds = self.phase.controls, self.phase.control_bounds
        vectors = self.phase.vector_controls
        rows = {label: row for row, label in enumerate(self.phase.path_labels)}
        norms = {
            i: rows[vector.direction_norm_constraint_name]
            for vector in vectors
            if vector.direction_norm_constraint_name in rows
            for i in layout.indices(vector.direction)
        }
        arguments = self.times, self.x, self.u, self.control_scale
        inactive = mask_inactive_controls(self.functions, bounds, *arguments, norms)
        for vector in vectors:
            magnitude = self.u[layout.slice(vector.magnitude)]
            scale = self.control_scale[layout.slice(vector.magnitude), None]
            inactive[layout.slice(vector.direction)] |= magnitude <= AT_LIMIT * scale
        return inactive

    @cached_property
    def is_at_control_bounds(self) -> Mask:
        """Whether controls are at their lower and at their upper bound (2, m, n_samples)."""
        return np.stack(self.phase.control_bounds.is_near_limits(self.u, AT_LIMIT * self.control_scale))

    @cached_property
    def lam(self) -> Array:
        """Costates (n, n_samples)."""
        return self.sample_signal(self.phase.lam)

    @cached_property
    def lam_rate(self) -> Array:
        """Time derivatives of the costate polynomials."""
        return self.sample_signal(self.phase.lam.derivative())

    @cached_property
    def mu(self) -> Array:
        """Path multiplier densities (n_paths, n_samples)."""
        return self.sample_signal(self.phase.path_multiplier)

    @cached_property
    def state_multiplier(self) -> Array:
        """State bound multiplier densities (n, n_samples)."""
        return self.sample_signal(self.phase.state_multiplier)

    def adjoint_residual(self, u: Array, mu: Array) -> Array:
        """Return the residual of the adjoint equation for given controls and path multipliers (n, n_samples)."""
        gradient = self.functions.state_gradient(self.times, self.x, u, self.lam, mu)
        return np.asarray(self.lam_rate + gradient + self.state_multiplier)

    @cached_property
    def hamiltonian(self) -> Array:
        """H along the applied control (n_samples,)."""
        return self.functions.hamiltonian(self.times, self.x, self.u, self.lam)

    @cached_property
    def control_gradient(self) -> Array:
        """d(H + mu.c)/du along the applied control (m, n_samples)."""
        return self.functions.control_gradient(self.times, self.x, self.u, self.lam, self.mu)

    @property
    def relative_control_gradient(self) -> Array:
        """Control gradient times the range of each control, relative to H (m, n_samples)."""
        return self.control_gradient * self.control_scale[:, None] / self.hamiltonian_scale

    @cached_property
    def control_hessian(self) -> Array:
        """d2(H + mu.c)/du2 along the applied control (m, m, n_samples)."""
        return self.functions.control_hessian(self.times, self.x, self.u, self.lam, self.mu)

    @cached_property
    def state_scale(self) -> Array:
        """Variation scale of each state along the phase (n,); see module `state_and_control_scales`."""
        return compute_state_scales(self.phase, self.functions, self.control_span, lasting=self.has_duration)

    @cached_property
    def control_span(self) -> Array:
        """Scale of each control, from its own variation or the costates (m,); module `state_and_control_scales`."""
        derivatives = np.abs(self.switching_functions - self.cost_gradient)
        rate_magnitude = float(np.nanmax(self._costate_rate_product_magnitudes, initial=0.0))
        required = estimate_required_controls(self.phase, self.functions)
        curvature = np.einsum("iij->ij", self.control_hessian)
        spans = compute_control_scales(self.phase, self.u, derivatives, curvature, rate_magnitude, required)
        quadratic = [self._is_hamiltonian_quadratic(i, spans[i], curvature[i]) for i in range(spans.size)]
        if all(quadratic):
            return spans
        curvature = np.where(np.array(quadratic)[:, None], curvature, 0.0)
        return compute_control_scales(self.phase, self.u, derivatives, curvature, rate_magnitude, required)

    def _is_hamiltonian_quadratic(self, i: int, span: float, curvature: Array) -> bool:
        """Return whether H changes over the control's scale about as its largest curvature predicts."""
        j = np.array([np.argmax(np.abs(np.nan_to_num(curvature)))])
        step = np.zeros((self.u.shape[0], 1))
        step[i] = 0.5 * span
        t, x, lam, u = self.times[j], self.x[:, j], self.lam[:, j], self.u[:, j]
        before, middle, after = (self.functions.hamiltonian(t, x, v, lam)[0] for v in (u - step, u, u + step))
        return not abs(after - 2.0 * middle + before) < NEGLIGIBLE * abs(curvature[j[0]]) * step[i, 0] ** 2

    @cached_property
    def angular_control_periods(self) -> Array:
        """Periods of controls (m,); 0 for controls that are not angles or have bounds."""
        bounds = self.phase.control_bounds
        unbounded = np.isinf(bounds.lower) & np.isinf(bounds.upper) & ~self.functions.separable_controls
        probe = AngleProbe(
            lambda u: self.functions.evaluate_rates_paths_and_integrands(self.times, self.x, u), self.u
        )
        return np.array([probe.find_angle_period(i) if free else 0.0 for i, free in enumerate(unbounded)])

    @cached_property
    def switching_functions(self) -> Array:
        """dH/du without path multipliers along the applied control (m, n_samples)."""
        return self.functions.switching_functions(self.times, self.x, self.u, self.lam)

    @cached_property
    def cost_gradient(self) -> Array:
        """Contribution of the integrands to dH/du, (m, n_samples)."""
        return self.functions.switching_functions(self.times, self.x, self.u, np.zeros_like(self.lam))

    @cached_property
    def _hamiltonian_changes_per_control(self) -> Array:
        amplitude = 0.5 * self.control_span[:, None]
        slopes = np.maximum(np.abs(self.cost_gradient), np.abs(self.switching_functions - self.cost_gradient))
        by_slope = _compute_largest_finite_value(slopes * amplitude)
        by_curvature = 0.5 * np.sum(np.abs(self.control_hessian) * amplitude, axis=1) * amplitude
        return np.fmax(by_slope, _compute_largest_finite_value(by_curvature))

    @property
    def max_hamiltonian_change(self) -> float:
        """Largest change of H along the phase for half the scales of all controls, cost per second.

        It is determined from the slope of the integrands or of the costate terms, which cancel at a minimum, or from
        the curvature of H. Constant states, and drift without controls, are excluded.
        """
        return max(float(np.sum(self._hamiltonian_changes_per_control)), self.hamiltonian_rounding_level)

    @property
    def hamiltonian_change_by_control(self) -> Array:
        """Change of H for each control, common to components of a vector; at least `NOTABLE` of the sum (m,)."""
        changes = take_largest_variable_component(self._hamiltonian_changes_per_control, self.phase.controls)
        return np.maximum(changes, NOTABLE * self.max_hamiltonian_change)

    @property
    def hamiltonian_rounding_level(self) -> float:
        """Cost per second below which differences of H are rounding."""
        rounding = COSTATE_MIN_SHARE_OF_COST * self.cost_magnitude
        return rounding / self.span if rounding > 0 else 1e-9

    @cached_property
    def control_scale(self) -> Array:
        """Range of each control, or its variation if a limit is far away; its magnitude without limits (m,)."""
        scale, magnitude = self.phase.control_bounds.interval_width_or_zero, np.max(np.abs(self.u), axis=1)
        scale = np.where(scale > FAR_LIMIT_RATIO * self.control_span, self.control_span, scale)
        return np.where(scale > 0, scale, replace_tiny_by_one(magnitude))

    @cached_property
    def cost_scale(self) -> float:
        """Largest |lambda_i| x_i along the phase: magnitudes of the states in units of the cost."""
        scale = float(np.max(np.abs(self.lam) * self.state_scale[:, None], initial=0.0))
        scale = max(scale, COSTATE_MIN_SHARE_OF_COST * self.cost_magnitude)
        return scale if scale > 0 else 1.0

    @cached_property
    def _costate_rate_product_magnitudes(self) -> Array:
        rates = self.functions.state_rates(self.times, self.x, self.u)
        return np.asarray(np.sum(np.abs(self.lam * rates), axis=0))

    @cached_property
    def hamiltonian_term_magnitudes(self) -> Array:
        """Sum of the magnitudes of the terms of H (n_samples,)."""
        integrands = self.functions.integrands(self.times, self.x, self.u)
        magnitudes = np.sum(np.abs(self.functions.weights[:, None] * integrands), axis=0)
        return np.asarray(self._costate_rate_product_magnitudes + magnitudes)

    @cached_property
    def hamiltonian_scale(self) -> float:
        """Largest sum of the magnitudes of the terms of H along the phase (cost per second).

        For a fixed duration, integrands are taken relative to their minimum, since constants have no effect.
        """
        integrands = self.functions.integrands(self.times, self.x, self.u)
        if self.has_fixed_duration and integrands.size:
            integrands = integrands - np.min(integrands, axis=1, keepdims=True)
        magnitudes = np.sum(np.abs(self.functions.weights[:, None] * integrands), axis=0)
        largest = float(np.max(self._costate_rate_product_magnitudes + magnitudes, initial=0.0))
        return max(largest, self.max_hamiltonian_change)  # which is at least the rounding level

    @property
    def has_fixed_duration(self) -> bool:
        """Whether initial and final time of the phase, or its duration, are fixed."""
        phase = self.phase
        ends = phase.initial_time_bounds.is_fixed[0] and phase.final_time_bounds.is_fixed[0]
        return bool(ends or phase.duration_bounds.is_fixed[0])

    @property
    def span(self) -> float:
        """Duration between the first and last sample, s; positive even for an empty phase."""
        return float(self.times[-1] - self.times[0])

    @property
    def has_duration(self) -> bool:
        """Whether the phase is not empty: its duration is not at a lower bound of zero."""
        phase, first, last = self.phase, self.phase.initial_time_bounds, self.phase.final_time_bounds
        shortest = max(phase.duration_bounds.lower[0], last.lower[0] - first.upper[0])
        longest = min(phase.duration_bounds.upper[0], last.upper[0] - first.lower[0])
        negligible = min(AT_LIMIT * longest, MAGNITUDE_FLOOR) if np.isfinite(longest) else SHORTEST
        return bool(shortest > 0 or phase.duration > negligible)

    @cached_property
    def pure_state_constraints(self) -> Indices:
        """Path constraints that do not depend on controls."""
        return np.flatnonzero(~self.functions.mixed_path_constraints)

    @cached_property
    def path_constraint_variations(self) -> Array:
        """Possible change of each path constraint over the scales of states and controls (n_paths,)."""
        arguments = self.times, self.x, self.u
        by_state = np.abs(self.functions.path_state_jacobian(*arguments))
        by_control = np.abs(self.functions.path_control_jacobian(*arguments))
        pairs = (by_state, self.state_scale), (by_control, self.control_scale)
        return np.asarray(np.max(sum(np.einsum("ijt,j->it", *pair) for pair in pairs), axis=1))

    @cached_property
    def path_scale(self) -> Array:
        """Variation of each path constraint along the phase, or over the scales of states and controls (n_paths,)."""
        values = self.functions.path_constraints(self.times, self.x, self.u)
        scale = np.fmax(np.ptp(values, axis=1), STILL_STATE_SHARE * self.path_constraint_variations)
        size = np.max(np.abs(values), axis=1)
        scale = np.fmax(scale, SPAN_MIN_SHARE * size)
        return np.where(np.isfinite(scale) & (scale > 0), scale, 1.0)

    def describe_sample(self, column: int, what: str = "") -> str:
        """Return "phase leg, t = 1.23 s, v[2]" for a sample."""
        return self.describe_time(float(self.times[column]), what)

    def describe_time(self, time: float, what: str = "") -> str:
        """Return "phase leg, t = 1.23 s, v[2]" for any time."""
        return f"phase {self.phase.name}, t = {self.describe_times(time)}{f', {what}' if what else ''}"

    def describe_times(self, *times: float) -> str:
        """Return one time, or several joined by "to", in the unit of time."""
        return f"{' to '.join(f'{t:.6g}' for t in times)} {self.functions.time_unit}"

    def describe_segment(self, segment: int, what: str) -> str:
        times = self.describe_times(*self.phase.breaks[segment : segment + 2])
        return f"phase {self.phase.name}, segment {segment + 1} ({times}), {what}"

    @cached_property
    def segment_starts(self) -> Indices:
        """First sample of each segment (K,)."""
        return np.searchsorted(self.segments, np.arange(self.phase.mesh.segments))

    def integrate_over_segments(self, values: Array) -> Array:
        """Return the integrals of values (..., n_samples) over each segment (..., K); values at its ends may be NaN."""
        parts = np.where(self.weights > 0, values, 0.0) * self.weights
        return np.asarray(np.add.reduceat(parts, self.segment_starts, axis=-1))

    def quadrature_integrals(self) -> Array:
        """Return the integrals over each segment by the quadrature of the collocation points: (n_integrals, K)."""
        phase = self.phase
        values = self.functions.integrands(*phase.point_trajectory) * phase.point_weights
        return np.asarray(np.add.reduceat(values, phase.mesh.point_offsets[:-1], axis=1))

    def cumulative_integrals(self, values: Array) -> Array:
        """Return the integrals of values (n, n_samples) from the start of the segment to each sample (n, n_samples)."""
        parts = values * self.weights
        running = np.cumsum(parts, axis=1)
        return np.asarray(running - (running - parts)[:, self.segment_starts][:, self.segments])

    def segment_maxima(self, values: Array) -> Array:
        """Return the largest values (..., n_samples) of each segment (..., K)."""
        return np.asarray(np.maximum.reduceat(values, self.segment_starts, axis=-1))


@cache
def choose_segment_sample_points(degree: int) -> tuple[Array, Array]:
    """Return the positions of a segment's samples on [-1, 1], including its ends, and their weights."""
    n = min(degree + SAMPLES_BEYOND_POINTS, MAX_POINTS)
    points, weights = get_collocation_points(GAUSS, n), get_quadrature_weights(GAUSS, n)
    return np.pad(points, 1, constant_values=(-1.0, 1.0)), np.pad(weights, 1)


def _compute_largest_finite_value(values: Array) -> Array:
    return np.asarray(np.max(set_nonfinite_to_zero(values), axis=1, initial=0.0))
