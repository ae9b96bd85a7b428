"""Error estimate per segment: violation of the optimality system between the collocation points.

Four dimensionless errors, which the NLP solver does not constrain:

* dynamics: the integral over the segment of |dx/dt - f(t, x, u)|, relative to the state's magnitude;
* integrals: a finer quadrature of each integrand minus the collocation rule's, relative to the integral
  of its magnitude;
* overshoot: violation of bounds and path constraints between the nodes: the largest value for functions of
  the states alone, the mean over the phase for those of the controls;
* costates: the square of the residual of their differential equation, the integral of |d(lambda)/dt + dH_a/dx + z|,
  times the state's magnitude over that of the cost. Segments with active pure state constraints are not used.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

import numpy as np

from gnc_opt.array_types import Array, Mask
from gnc_opt.numerical_tolerances import NEGLIGIBLE, SMALL, replace_tiny_by_one
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.solution.defects_and_violations import compute_segment_defects
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.refinement_history import Actions, RefinementIteration
from gnc_opt.planning.solution.solution import Solution

COSTATE_ERROR_WEIGHT = 20.0
"""A residual r counts as an error of (20 r)^2, since costates affect the cost only to second order."""


@dataclass(frozen=True, eq=False)
class PhaseError:
    """Error estimate of one phase by segment (column); ``overshoot`` has rows of states, controls and path constraints.

    ``integral_scale`` and ``path_scale`` are the magnitudes of integrals and path constraints.
    """

    samples: PhaseSamples
    dynamics: Array
    integrals: Array
    overshoot: Array
    costates: Array
    integral_scale: Array
    path_scale: Array

    @classmethod
    def from_samples(cls, samples: PhaseSamples) -> PhaseError:
        phase, s = samples.phase, samples
        integrands = s.evaluate_with_clipped_controls(s.functions.integrands)
        integral_scale = replace_tiny_by_one(np.sum(np.abs(integrands) * s.weights, axis=1))
        quadrature_errors = np.abs(s.integrate_over_segments(integrands) - s.quadrature_integrals())
        bounds = phase.path_bounds
        limits = [np.where(np.isfinite(b), np.abs(b), 0.0) for b in (bounds.lower, bounds.upper)]
        paths = s.evaluate_with_clipped_controls(s.functions.path_constraints)
        path_magnitudes = np.maximum(np.max(np.abs(paths), axis=1), np.maximum(*limits))
        path_scale = replace_tiny_by_one(path_magnitudes)
        span = phase.duration
        overshoot = _compute_bound_overshoot(s.x, phase.state_bounds, s.state_scale, s.times)
        states = s.segment_maxima(overshoot)
        excess = phase.control_bounds.compute_bound_violation(s.u_polynomial) / s.control_scale[:, None]
        mean, peak = s.integrate_over_segments(excess) / span, s.segment_maxima(excess)
        controls = np.maximum(mean, SMALL * peak)
        mean = s.integrate_over_segments(bounds.compute_bound_violation(paths) / path_scale[:, None]) / span
        peak = s.segment_maxima(_compute_bound_overshoot(paths, bounds, path_scale, s.times))
        mean[s.pure_state_constraints] = peak[s.pure_state_constraints]
        residual = s.integrate_over_segments(compute_costate_residual(s, path_scale))
        costates = (COSTATE_ERROR_WEIGHT * residual) ** 2
        overshoot = np.concatenate([states, controls, mean])
        errors = compute_segment_defects(s), quadrature_errors / integral_scale[:, None], overshoot, costates
        return cls(s, *errors, integral_scale, path_scale)

    @property
    def stacked_segment_errors(self) -> Array:
        """Errors of all kinds, stacked by rows; NaN is replaced by infinity."""
        rows = np.concatenate([self.dynamics, self.integrals, self.overshoot, self.costates])
        return np.where(np.isnan(rows), np.inf, rows)

    def compute_required_error_reduction(self, target: float) -> Array:
        """Return the decades (K,) by which residuals and violations must decrease for errors of ``target``."""
        decades = np.log10(np.clip(self.stacked_segment_errors, 1e-99, 1e6) / target)
        decades[-self.costates.shape[0] :] /= 2.0  # squared residuals
        return np.asarray(np.max(decades, axis=0))

    @property
    def largest_segment_errors(self) -> Array:
        """Largest error of each segment, (K,)."""
        return np.asarray(np.max(self.stacked_segment_errors, axis=0))

    @property
    def largest_error_location(self) -> str:
        """Location and kind of the largest error."""
        errors, phase = self.stacked_segment_errors, self.samples.phase
        row, k = np.unravel_index(int(np.argmax(errors)), errors.shape)
        states, controls = phase.states.labels, phase.controls.labels
        names = [f"dynamics of {label}" for label in states]
        names += [f"integral {label}" for label in phase.integral_labels]
        names += [f"bounds of {label}" for label in (*states, *controls)]
        names += [f"path constraint {label}" for label in phase.path_labels]
        names += [f"costate of {label}" for label in states]
        return self.samples.describe_segment(int(k), names[int(row)])


def estimate_segment_errors(solution: Solution) -> dict[str, PhaseError]:
    """Return the error estimate of every phase of a solution, which must have its problem."""
    return {name: PhaseError.from_samples(samples) for name, samples in solution.samples().items()}


def compute_costate_residual(samples: PhaseSamples, path_scale: Array) -> Array:
    """Return the costate residual (n_states, n_samples), relative to the cost per second; zero where excluded."""
    s, cost_shares = samples, samples.state_scale / samples.cost_scale
    included = _find_unconstrained_segments(s, path_scale, cost_shares)[s.segments]
    return np.where(included, np.abs(s.adjoint_residual(s.u, s.mu)) * cost_shares[:, None], 0.0)


def _find_unconstrained_segments(samples: PhaseSamples, path_scale: Array, cost_shares: Array) -> Mask:
    """Return the segments (K,) without an active pure state constraint, inside or at the ends."""
    phase, state_rows = samples.phase, samples.pure_state_constraints
    on_states = np.abs(phase.state_multipliers) * samples.state_scale[:, None]
    on_paths = np.abs(phase.path_multipliers[state_rows]) * path_scale[state_rows, None]
    has_multiplier = np.any(np.vstack([on_states, on_paths]) > NEGLIGIBLE * samples.hamiltonian_scale, axis=0)
    jumps = np.any(np.abs(phase.state_impulses) * cost_shares[:, None] > NEGLIGIBLE, axis=0)
    jumps[[0, -1]] = False  # the ends of a phase have boundary conditions
    constrained = np.logical_or.reduceat(has_multiplier, phase.mesh.point_offsets[:-1])
    return np.asarray(~(constrained | jumps[:-1] | jumps[1:]))


def _compute_bound_overshoot(values: Array, bounds: Interval, scale: Array, times: Array) -> Array:
    """Return the violation of bounds at the samples, including peaks between samples."""
    below = _interpolate_local_maxima(bounds.lower[:, None] - values, times)
    above = _interpolate_local_maxima(values - bounds.upper[:, None], times)
    return np.asarray(np.maximum(np.maximum(below, above), 0.0) / scale[:, None])


def _interpolate_local_maxima(values: Array, times: Array) -> Array:
    """Replace each local maximum of the samples (n, n_samples) by the peak of the parabola through its neighbours."""
    left, right = times[1:-1] - times[:-2], times[2:] - times[1:-1]
    inside_segment = (left > 0) & (right > 0)  # segment ends are duplicated in the samples
    left, right = np.where(inside_segment, left, 1.0), np.where(inside_segment, right, 1.0)
    middle = values[:, 1:-1]
    with np.errstate(invalid="ignore"):  # without a bound
        a, b = (middle - values[:, :-2]) / left, (values[:, 2:] - middle) / right
        curvature = (b - a) / (left + right)
        slope = (a * right + b * left) / (left + right)
        is_peak = inside_segment & (a >= 0) & (b <= 0) & (curvature < 0)
    rise = np.where(is_peak, slope**2 / np.where(is_peak, -4.0 * curvature, 1.0), 0.0)
    raised = values.copy()
    raised[:, 1:-1] += rise
    return raised


# --- records of refinement iterations ---------------------------------------------------------------------


def record_iteration(
    solution: Solution, begin: float, actions: Actions | str, errors: Mapping[str, PhaseError] | None = None
) -> RefinementIteration:
    """Return the record of a pass from ``begin`` (s, `time.perf_counter`) to its solution; ``errors`` if known."""
    phase_errors = (errors or estimate_segment_errors(solution)).values()
    worst = max(phase_errors, key=lambda e: float(np.max(e.largest_segment_errors)))
    return RefinementIteration(
        meshes={name: phase.mesh for name, phase in solution.phases.items()},
        times={name: tuple(float(t) for t in phase.breaks) for name, phase in solution.phases.items()},
        error=float(np.max(worst.largest_segment_errors)),
        where=worst.largest_error_location,
        objective=solution.objective,
        solved=solution.status.solved,
        iterations=solution.statistics.iterations,
        seconds=time.perf_counter() - begin,
        actions=actions,
    )


def print_iterations(
    name: str, tol: float, shown: bool
) -> AbstractContextManager[Callable[[RefinementIteration], None]]:
    """Return a context manager whose value prints an iteration, or does nothing; see `gnc_opt.progress_display`."""
    if not shown:
        return nullcontext(lambda _: None)
    from gnc_opt.progress_display import show_refinement_progress

    return show_refinement_progress(name, tol)
