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

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gnc_opt.array_types import Array, Mask
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.hamiltonian_functions import PhaseFunctions
from gnc_opt.planning.solution.defects_and_violations import evaluate_clipped
from gnc_opt.planning.solution.phase_samples import PhaseSamples
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.tolerances import BRANCH_ENDED, NEGLIGIBLE, SMALL

COSTATE_ERROR_WEIGHT = 20.0
"""A residual r counts as an error of (20 r)^2, since costates affect the cost only to second order."""


@dataclass(frozen=True, eq=False)
class ErrorScales:
    """Magnitudes of states, controls, integrals and path constraints in a phase, the references of relative errors."""

    leg: PhaseSolution
    functions: PhaseFunctions
    state: Array
    control: Array
    integral: Array
    path: Array
    path_has_control: Mask

    @classmethod
    def from_samples(cls, samples: PhaseSamples) -> ErrorScales:
        leg, functions = samples.leg, samples.functions
        at = samples.times, samples.x, samples.u_polynomial
        integrands = evaluate_clipped(functions.integrands, *at, leg.control_bounds)
        integral = np.sum(np.abs(integrands) * samples.weights, axis=1)
        path, has_control = np.zeros(0), np.zeros(0, dtype=bool)
        if leg.path_labels:
            limits = [
                np.where(np.isfinite(b), np.abs(b), 0.0)
                for b in (leg.path_bounds.lower, leg.path_bounds.upper)
            ]
            values = evaluate_clipped(functions.paths, *at, leg.control_bounds)
            path = np.maximum(np.max(np.abs(values), axis=1), np.maximum(*limits))
            has_control = np.any(functions.path_control_jacobian(*at) != 0, axis=(1, 2))
        return cls(
            leg,
            functions,
            samples.state_scale,
            samples.control_scale,
            np.where(integral > BRANCH_ENDED, integral, 1.0),
            np.where(path > BRANCH_ENDED, path, 1.0),
            has_control,
        )

    @property
    def pure_path_scales(self) -> Array:
        """Magnitude of each path constraint that depends on the states only; 0 for the others."""
        return np.where(self.path_has_control, 0.0, self.path)

    def evaluate_errors(self, samples: PhaseSamples, adjoint: Array) -> SegmentErrors:
        """Return the errors of each segment; ``adjoint`` is the `compute_costate_residual` (n_states, n_samples)."""
        f, leg, s = self.functions, self.leg, samples
        at = s.times, s.x, s.u_polynomial
        rates = evaluate_clipped(f.rates, *at, leg.control_bounds)
        dynamics = s.segment_integrals(np.abs(s.x_rate - rates)) / self.state[:, None]
        exact = s.segment_integrals(evaluate_clipped(f.integrands, *at, leg.control_bounds))
        integrals = np.abs(exact - s.collocated_integrals()) / self.integral[:, None]
        span = leg.duration
        states = _find_segment_maxima(s, _compute_bound_excess(s.x, leg.state_bounds, self.state, s.times))
        excess = _compute_bound_excess(s.u_polynomial, leg.control_bounds, self.control)
        controls = np.maximum(s.segment_integrals(excess) / span, SMALL * _find_segment_maxima(s, excess))
        overshoot = [states, controls]
        if leg.path_labels:
            values = evaluate_clipped(f.paths, *at, leg.control_bounds)
            mean = s.segment_integrals(_compute_bound_excess(values, leg.path_bounds, self.path)) / span
            peak = _find_segment_maxima(s, _compute_bound_excess(values, leg.path_bounds, self.path, s.times))
            overshoot.append(np.where(self.path_has_control[:, None], mean, peak))
        costates = (COSTATE_ERROR_WEIGHT * s.segment_integrals(adjoint)) ** 2
        return SegmentErrors(dynamics, integrals, np.concatenate(overshoot), costates)


def _find_segment_maxima(samples: PhaseSamples, values: Array) -> Array:
    return np.asarray(np.maximum.reduceat(values, samples.segment_starts, axis=1))


@dataclass(frozen=True, eq=False)
class SegmentErrors:
    """Errors of K segments, by kind.

    Attributes
    ----------
    dynamics, costates : array (n_states, K)
    integrals : array (n_integrals, K)
    overshoot : array (n_states + n_controls + n_paths, K)
    """

    dynamics: Array
    integrals: Array
    overshoot: Array
    costates: Array

    @property
    def error_table(self) -> Array:
        """Errors of all kinds, stacked by rows; NaN is replaced by infinity."""
        rows = np.concatenate([self.dynamics, self.integrals, self.overshoot, self.costates])
        return np.where(np.isnan(rows), np.inf, rows)

    @property
    def largest_errors(self) -> Array:
        """Largest error of each segment, (K,)."""
        return np.asarray(np.max(self.error_table, axis=0))

    def compute_required_decades(self, aim: float) -> Array:
        """Return the decades (K,) by which residuals and violations must decrease for errors of ``aim``."""
        table = np.log10(np.clip(self.error_table, 1e-99, 1e6) / aim)
        table[-self.costates.shape[0] :] /= 2.0  # squared residuals
        return np.asarray(np.max(table, axis=0))


@dataclass(frozen=True, eq=False)
class PhaseError:
    """The error estimate of one phase; ``adjoint`` (n_states, n_samples): costate residual per second."""

    samples: PhaseSamples
    yardstick: ErrorScales
    errors: SegmentErrors
    adjoint: Array

    @classmethod
    def from_samples(cls, samples: PhaseSamples) -> PhaseError:
        leg = samples.leg
        yardstick = ErrorScales.from_samples(samples)
        adjoint = compute_costate_residual(samples, yardstick.pure_path_scales)
        errors = yardstick.evaluate_errors(samples, adjoint)
        inner = leg.breaks[1:-1]
        if inner.size:
            jumps = np.abs(leg.x(inner, "right") - leg.x(inner, "left")) / yardstick.state[:, None]
            errors.dynamics[:, :-1] += jumps
        return cls(samples, yardstick, errors, adjoint)

    @property
    def largest_errors(self) -> Array:
        """Largest error of each segment, (K,)."""
        return self.errors.largest_errors

    @property
    def location(self) -> str:
        """Location and kind of the largest error."""
        table, leg = self.errors.error_table, self.samples.leg
        row, k = np.unravel_index(int(np.argmax(table)), table.shape)
        states, controls = leg.states.labels, leg.controls.labels
        names = [f"dynamics of {label}" for label in states]
        names += [f"integral {label}" for label in leg.integral_labels]
        names += [f"bounds of {label}" for label in (*states, *controls)]
        names += [f"path constraint {label}" for label in leg.path_labels]
        names += [f"costate of {label}" for label in states]
        return self.samples.describe_segment(int(k), names[int(row)])


def estimate_errors(solution: Solution) -> dict[str, PhaseError]:
    """Return the error estimate of every phase of a solution, which must have its problem."""
    return {name: PhaseError.from_samples(samples) for name, samples in solution.samples().items()}


def compute_costate_residual(samples: PhaseSamples, pure_paths: Array) -> Array:
    """Return the costate residual (n_states, n_samples), relative to the cost per second; zero where excluded.

    ``pure_paths`` (n_paths,) are the magnitudes of path constraints that depend on the states only; 0 for the others.
    """
    s, leg, times = samples, samples.leg, samples.times
    mu = leg.path_multiplier(times) if leg.path_labels else np.zeros((0, times.size))
    residual = s.lam_rate + s.functions.state_gradient(times, s.x, s.u, s.sample_signal(leg.lam), mu)
    if np.any(leg.state_multipliers):
        residual = residual + leg.state_multiplier(times)
    cost_shares = s.state_scale / s.cost_scale
    counts = _find_unconstrained_segments(s, pure_paths, cost_shares)[s.segments]
    return np.where(counts, np.abs(residual) * cost_shares[:, None], 0.0)


def _find_unconstrained_segments(samples: PhaseSamples, pure_paths: Array, cost_shares: Array) -> Mask:
    """Return the segments (K,) without an active pure state constraint, inside or at the ends."""
    leg = samples.leg
    forces = np.concatenate(
        [
            np.abs(leg.state_multipliers) * samples.state_scale[:, None],
            np.abs(leg.path_multipliers) * pure_paths[:, None],
        ]
    )
    pushed = np.any(forces > NEGLIGIBLE * samples.hamiltonian_scale, axis=0)
    jumps = np.any(np.abs(leg.state_impulses) * cost_shares[:, None] > NEGLIGIBLE, axis=0)
    jumps[[0, -1]] = False  # the ends of a phase have boundary conditions
    held = np.logical_or.reduceat(pushed, leg.mesh.point_offsets[:-1])
    return np.asarray(~(held | jumps[:-1] | jumps[1:]))


def find_largest_error(errors: Mapping[str, PhaseError]) -> tuple[float, str]:
    worst = max(errors.values(), key=lambda e: float(np.max(e.largest_errors)))
    return float(np.max(worst.largest_errors)), worst.location


def _compute_bound_excess(values: Array, bounds: Interval, scale: Array, times: Array | None = None) -> Array:
    """Return the violation of bounds at the samples; with ``times``, including peaks between samples."""
    below, above = bounds.lower[:, None] - values, values - bounds.upper[:, None]
    if times is not None:
        below, above = _interpolate_peaks(below, times), _interpolate_peaks(above, times)
    return np.asarray(np.maximum(np.maximum(below, above), 0.0) / scale[:, None])


def _interpolate_peaks(values: Array, times: Array) -> Array:
    """Replace each local maximum of the samples (n, n_samples) by the peak of the parabola through its neighbours."""
    left, right = times[1:-1] - times[:-2], times[2:] - times[1:-1]
    known = (left > 0) & (right > 0)  # segment ends are duplicated in the samples
    left, right = np.where(known, left, 1.0), np.where(known, right, 1.0)
    middle = values[:, 1:-1]
    with np.errstate(invalid="ignore"):  # without a bound
        a, b = (middle - values[:, :-2]) / left, (values[:, 2:] - middle) / right
        bend = (b - a) / (left + right)
        slope = (a * right + b * left) / (left + right)
        top = known & (a >= 0) & (b <= 0) & (bend < 0)
    gain = np.where(top, slope**2 / np.where(top, -4.0 * bend, 1.0), 0.0)
    raised = values.copy()
    raised[:, 1:-1] += gain
    return raised
