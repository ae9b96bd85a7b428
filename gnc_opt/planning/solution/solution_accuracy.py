r"""Accuracy of a solution: objective, limits and final states in their units, and defects.

The applied (saturated) control is integrated from the initial state of every phase by DOP853, independently of the
collocation. Limits are evaluated along that trajectory at Chebyshev points between the jumps of the control.

The error of the objective is its difference from the local optimum. Every segment contributes the effects d of defects
and quadratures, o of limits exceeded between the points, and g of other controls on H (with path constraints, mu of the
correct sign; exact if H is affine in a control, else one projected Newton step). The section "Estimated error of the
objective" of ``docs/refinement.md`` has the equations. The estimate is :math:`A = \sum (|d| + o + |g|)`; errors cancel
within a segment only, decreases of H by three quarters at most (next to a switch, the polynomial exceeds its bounds).
To first order it is the dual-weighted residual of the optimality system (Becker & Rannacher, Acta Numerica 10, 2001),
not a bound.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import itemgetter

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import NEGLIGIBLE, ROUNDING, set_nonfinite_to_zero
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.solution.defects_and_violations import (
    NO_VIOLATION,
    compute_dynamics_residual,
    find_worst_defect,
    integrate_states_to_times,
)
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.transcription.quadrature import build_lagrange_interpolation_matrix

UNCANCELLED_SHARE = 0.25
"""Smallest share of the decreases of H in a segment that remains in the estimate; without it, the estimate can
be as small as 0.12 of the error if a switch lies within a segment."""


@dataclass(frozen=True)
class ObjectiveError:
    """Estimated error of the objective, and the magnitude of the objective (``scale``).

    ``infeasibility`` is the sum of |d| + o, infinite if a function is not finite; ``suboptimality`` that of |g|.
    """

    infeasibility: float
    suboptimality: float
    scale: float

    @property
    def absolute_error(self) -> float:
        """A, in units of the objective; infinite if a function of the problem is not finite."""
        return self.infeasibility + self.suboptimality

    @property
    def relative_error(self) -> float:
        """A relative to the objective."""
        return self.absolute_error / self.scale


def estimate_objective_error(samples: Iterable[PhaseSamples], objective: float) -> ObjectiveError:
    """Return the estimated error of the objective from all phases; see the module."""
    infeasibility, suboptimality, scale = 0.0, 0.0, abs(objective)
    for s in samples:
        scale = max(scale, NEGLIGIBLE * s.cost_scale)
        with np.errstate(all="ignore"):  # non-finite values make the estimate infinite
            defects = np.abs(_compute_cost_of_segment_defects(s))
            paths = s.evaluate_with_clipped_controls(s.functions.path_constraints)
            excess = _weight_violations_by_multipliers(s, paths, s.phase.path_bounds, s.mu)
            excess += _weight_violations_by_multipliers(s, s.x, s.phase.state_bounds, s.state_multiplier)
            infeasibility += np.sum(defects + excess)
            suboptimality += np.sum(_compute_hamiltonian_decreases(s))
    sums = np.nan_to_num([infeasibility, suboptimality], nan=np.inf, posinf=np.inf)
    return ObjectiveError(float(sums[0]), float(sums[1]), scale)


def _compute_cost_of_segment_defects(s: PhaseSamples) -> Array:
    """Return d of each segment (K,); a jump of the states at a boundary belongs to the segment before it."""
    phase, weights = s.phase, s.functions.weights
    total = -s.integrate_over_segments(np.sum(s.lam * compute_dynamics_residual(s, s.u_polynomial), axis=0))
    if weights.size:
        integrands = weights @ s.evaluate_with_clipped_controls(s.functions.integrands)
        total = total + s.integrate_over_segments(integrands) - weights @ s.quadrature_integrals()
    inner = phase.breaks[1:-1]
    jumps = phase.x(inner, "left") - phase.x(inner, "right")
    total[:-1] += np.sum(phase.lam(inner, "left") * jumps, axis=0)
    return total


def _weight_violations_by_multipliers(
    s: PhaseSamples, values: Array, bounds: Interval, multipliers: Array
) -> Array:
    """Return o of each segment (K,): exceeded limits times their multipliers, if these have the correct sign.

    Errors of equalities have both signs; their absolute value is taken after integration over a segment.
    """
    weighted = np.maximum(multipliers, 0.0) * np.maximum(values - bounds.upper[:, None], 0.0)
    weighted += np.maximum(-multipliers, 0.0) * np.maximum(bounds.lower[:, None] - values, 0.0)
    equations = bounds.is_fixed
    weighted[equations] = multipliers[equations] * (values - bounds.upper[:, None])[equations]
    return np.asarray(np.sum(np.abs(s.integrate_over_segments(weighted)), axis=0))


def _compute_hamiltonian_decreases(s: PhaseSamples) -> Array:
    """Return |g| of each segment (K,)."""
    if not s.phase.controls.size:
        return np.zeros(s.phase.mesh.segments)
    bounds = s.phase.path_bounds  # interpolated multipliers may have the wrong sign between the points
    lower_mu = np.where(np.isfinite(bounds.lower), -np.inf, 0.0)[:, None]
    upper_mu = np.where(np.isfinite(bounds.upper), np.inf, 0.0)[:, None]
    arguments = s.times_inside_segments, s.x, s.u_polynomial, s.lam, np.clip(s.mu, lower_mu, upper_mu)
    gradient = set_nonfinite_to_zero(s.functions.control_gradient(*arguments))
    hessian = set_nonfinite_to_zero(s.functions.control_hessian(*arguments))
    slope, curvature = _project_hamiltonian_derivatives_on_active_paths(s, arguments[-1], gradient, hessian)
    bounds = s.phase.control_bounds
    range = np.maximum(s.control_span, np.max(np.abs(s.u), axis=1))[:, None]
    lower = np.where(np.isfinite(bounds.lower)[:, None], bounds.lower[:, None] - s.u_polynomial, -range)
    upper = np.where(np.isfinite(bounds.upper)[:, None], bounds.upper[:, None] - s.u_polynomial, range)
    gains = _maximise_bounded_quadratic(slope, curvature, lower, upper)
    net_decrease = s.integrate_over_segments(np.sum(gains, axis=0))
    sum_of_decreases = s.integrate_over_segments(np.sum(np.maximum(gains, 0.0), axis=0))
    return np.maximum(np.abs(net_decrease), UNCANCELLED_SHARE * sum_of_decreases)


def _project_hamiltonian_derivatives_on_active_paths(
    s: PhaseSamples, mu: Array, gradient: Array, hessian: Array
) -> tuple[Array, Array]:
    """Return slopes and curvatures of H (m, n_times) along single controls, corrected onto active path constraints.

    These are equations, and inequalities whose multipliers ``mu`` (n_paths, n_times) are not negligible.
    """
    active = np.abs(mu) * s.path_scale[:, None] > NEGLIGIBLE * s.hamiltonian_scale
    active = (active | s.phase.path_bounds.is_fixed[:, None]) & s.functions.mixed_path_constraints[:, None]
    if not np.any(active):
        return gradient, np.einsum("iij->ij", hessian)
    normals = s.functions.path_control_jacobian(s.times_inside_segments, s.x, s.u_polynomial)
    normals = np.moveaxis(set_nonfinite_to_zero(normals) * active[:, None], -1, 0)
    tangents = np.eye(len(gradient)) - np.linalg.pinv(normals) @ normals
    slopes = np.einsum("tij,jt->it", tangents, gradient)
    return slopes, np.einsum("tij,jkt,tik->it", tangents, hessian, tangents)


def _maximise_bounded_quadratic(slope: Array, curvature: Array, lower: Array, upper: Array) -> Array:
    """Return the maximum of -(slope d + curvature d^2 / 2) over lower <= d <= upper, elementwise."""

    def compute_quadratic_decrease(step: Array) -> Array:
        return np.asarray(-(slope + 0.5 * curvature * step) * step)

    newton = np.divide(-slope, curvature, out=np.zeros_like(slope), where=curvature > 0)
    inside = np.where(curvature > 0, compute_quadratic_decrease(np.clip(newton, lower, upper)), -np.inf)
    ends = np.maximum(compute_quadratic_decrease(lower), compute_quadratic_decrease(upper))
    return np.asarray(np.maximum(inside, ends))


POINTS_PER_PIECE = 12
"""Number of points between two jumps of the control, including the ends."""

PIECE_POINTS = -np.cos(np.pi * np.arange(POINTS_PER_PIECE) / (POINTS_PER_PIECE - 1))
"""These points on [-1, 1]."""

PEAK_SEARCH_TIMES = 401
"""Number of times between two jumps at which the polynomial is evaluated to find a peak."""


@dataclass(frozen=True)
class Accuracy:
    """Error estimate of the objective, violation of limits, and error of the final states.

    Attributes
    ----------
    objective : float
    objective_error : float
        Estimate, not a bound, in the unit of the objective: at least its rounding error (1e-15 of it); infinite without
        a value.
    violation : float
        Largest violation of a state limit or path constraint along the trajectory of the applied control, in the unit
        of the limit; 0 at rounding level. The largest is selected relative to the variation of the quantity.
    violation_where : str
        Location, quantity and unit of the violation.
    miss : float
        Largest difference of the final state of that trajectory from that of the solution, or from its bounds, over all
        phases, in the unit of the state; infinite without a trajectory. Selected relative to the state's variation.
    miss_where : str
    defect : float
        Largest integral over a segment of |dx/dt - f(t, x, u)|, including the jump to the next segment, relative to the
        variation of the state along the phase.
    defect_where : str

    Examples
    --------
    >>> accuracy = solution.accuracy
    >>> print(accuracy.objective_error < 1e-6, accuracy.miss < 1e-9, accuracy.violation)
    True True 0.0
    """

    objective: float
    objective_error: float
    violation: float
    violation_where: str
    miss: float
    miss_where: str
    defect: float
    defect_where: str

    @property
    def summary_text(self) -> str:
        """Accuracy of final states and limits: "final state within 2e-12 m/s; limits satisfied"."""
        ends = (
            f"final state within {self.miss:.1g}{_extract_unit_from_label(self.miss_where)}"
            if np.isfinite(self.miss)
            else "the applied control does not reach the end"
        )
        limits = f"limits exceeded by {self.violation:.1g}{_extract_unit_from_label(self.violation_where)}"
        return f"{ends}; {limits if self.violation else 'limits satisfied'}"

    def __str__(self) -> str:
        return f"objective ± {self.objective_error:.1g}; {self.summary_text}"


def measure_accuracy(samples: Iterable[PhaseSamples], objective: float, objective_error: float) -> Accuracy:
    """Return the accuracy along the integrated trajectories of all phases, with a given error of the objective."""
    violation, end_error, defect = (0.0, 0.0, ""), (0.0, 0.0, ""), NO_VIOLATION
    for s in samples:
        defect = defect.select_larger(find_worst_defect(s))
        phase, edges = s.phase, s.phase.applied.jump_times
        pieces = edges[:-1, None] + 0.5 * (1 + PIECE_POINTS) * np.diff(edges)[:, None]
        pieces[:, -1] = edges[1:]  # exact
        u = phase.applied(pieces.ravel())
        u[:, POINTS_PER_PIECE - 1 :: POINTS_PER_PIECE] = phase.applied(pieces[:, -1], "left")
        pairs = zip(phase.states.labels, phase.states.units, strict=True)
        labels = [f"{label} ({unit})" if unit else label for label, unit in pairs]
        x = integrate_states_to_times(phase, s.functions, pieces.ravel())
        end_error = max(end_error, _find_largest_end_error(s, x[:, -1], labels), key=itemgetter(0))
        paths = s.functions.path_constraints(pieces.ravel(), x, u)
        of_states = _find_limit_violation(s, pieces, x, phase.state_bounds, s.state_scale, labels)
        of_paths = _find_limit_violation(s, pieces, paths, phase.path_bounds, s.path_scale, phase.path_labels)
        violation = max([violation, *of_states, *of_paths], key=itemgetter(0))
    error = max(objective_error, 5 * float(np.finfo(float).eps) * abs(objective))
    return Accuracy(objective, error, *violation[1:], *end_error[1:], defect.value, defect.where)


def _find_largest_end_error(s: PhaseSamples, end: Array, labels: Sequence[str]) -> tuple[float, float, str]:
    """Return relative size, size and location of the largest error at the end of a phase."""
    phase, box = s.phase, s.phase.final_bounds
    difference = np.abs(end - phase.x(phase.breaks[-1]))
    error = np.max([difference, box.lower - end, end - box.upper], axis=0)
    if not np.all(np.isfinite(error)):
        return np.inf, np.inf, f"phase {phase.name}"
    i = int(np.argmax(error / s.state_scale))
    return float(error[i] / s.state_scale[i]), float(error[i]), f"phase {phase.name}, {labels[i]}"


def _find_limit_violation(
    s: PhaseSamples, pieces: Array, values: Array, box: Interval, scale: Array, labels: Sequence[str]
) -> list[tuple[float, float, str]]:
    """Return [(relative size, size, location)] of the largest violation by values (n, n_pieces * POINTS_PER_PIECE)."""
    if not labels:
        return []
    with np.errstate(invalid="ignore"):
        excess = np.maximum(box.lower[:, None] - values, values - box.upper[:, None])
    excess = np.where(np.isfinite(values), excess, -np.inf)
    magnitudes = np.minimum(*(np.abs(set_nonfinite_to_zero(b)) for b in (box.lower, box.upper)))
    i, j = np.unravel_index(int(np.argmax(excess / scale[:, None])), excess.shape)
    piece = values[i].reshape(pieces.shape)[j // POINTS_PER_PIECE]
    tau = np.linspace(-1.0, 1.0, PEAK_SEARCH_TIMES)
    curve = np.append(piece, build_lagrange_interpolation_matrix(PIECE_POINTS, tau) @ piece)
    curve_excess = np.maximum(box.lower[i] - curve, curve - box.upper[i])
    peak = float(np.max(curve_excess, where=np.isfinite(curve), initial=-np.inf))
    if not peak > ROUNDING * max(float(magnitudes[i]), float(scale[i])):
        return []
    return [(peak / float(scale[i]), peak, s.describe_time(float(pieces.ravel()[j]), labels[int(i)]))]


def _extract_unit_from_label(where: str) -> str:
    """Return " m" from "phase leg, q (m)"."""
    return f" {where.rpartition('(')[2][:-1]}" if where.endswith(")") else ""
