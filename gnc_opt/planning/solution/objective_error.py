r"""Estimated error of the objective: difference between a collocation solution and its local optimum.

Let :math:`\lambda = \partial J / \partial x` be the costates of the minimised functional. Along the polynomials
:math:`x_h, u_h` of the mesh, every segment contributes three terms:

.. math::

    d &= \int \lambda^T (f(x_h, u_h) - \dot x_h) \, dt
         + \sum_i w_i \Big( \int L_i \, dt - Q_i \Big), \\
    o &= \sum_j \int \mu_j^+ (c_j - c_{j,\max})^+ \, dt \quad
         (\text{of an equation } c_j = c_{j,0}: \big|\int \mu_j (c_j - c_{j,0}) \, dt\big|), \\
    g &= \int \sum_k \max_\delta \, -\big( H_{u_k} \delta + \tfrac12 H_{u_k u_k} \delta^2 \big) \, dt:

effects of defects and quadratures Q; of limits exceeded between the points; of other controls on H (with path
constraints, mu of the correct sign; exact if H is affine in a control, else one projected Newton step). The estimate is
:math:`A = \sum (|d| + o + |g|)`; errors cancel within a segment only, decreases of H by three quarters at most (beside
a switch, the polynomial is beyond its bounds). To first order it is the dual-weighted residual of the optimality system
(Becker & Rannacher, Acta Numerica 10, 2001): an estimate, not a bound.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import NEGLIGIBLE, zero_nonfinite
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.solution.defects_and_violations import compute_dynamics_residual, evaluate_within_bounds
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples

UNCANCELLED_SHARE = 0.25
"""Smallest share of the decreases of H in a segment that remains in the estimate; without it, the estimate is down to
0.12 of the error where a switch lies within a segment."""


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
    infeasibility, suboptimality, scale = 0.0, 0.0, abs(objective)
    for s in samples:
        scale = max(scale, NEGLIGIBLE * s.cost_scale)
        with np.errstate(all="ignore"):  # non-finite values make the estimate infinite
            infeasibility += np.sum(np.abs(_compute_marginal_defect_costs(s)) + _compute_violation_costs(s))
            suboptimality += np.sum(_compute_hamiltonian_decreases(s))
    found = np.nan_to_num([infeasibility, suboptimality], nan=np.inf, posinf=np.inf)
    return ObjectiveError(float(found[0]), float(found[1]), scale)


def _compute_marginal_defect_costs(s: PhaseSamples) -> Array:
    """Return d of each segment (K,); a jump of the states at a boundary belongs to the segment before it."""
    leg, at, weights = s.leg, (s.inner_times, s.x, s.u_polynomial), s.functions.weights
    total = -s.segment_integrals(np.sum(s.lam * compute_dynamics_residual(s, s.u_polynomial), axis=0))
    if weights.size:
        integrands = evaluate_within_bounds(s.functions.integrands, *at, leg.control_bounds)
        total = total + s.segment_integrals(weights @ integrands) - weights @ s.quadrature_integrals()
    inner = leg.breaks[1:-1]
    jumps = leg.x(inner, "left") - leg.x(inner, "right")
    total[:-1] += np.sum(leg.lam(inner, "left") * jumps, axis=0)
    return total


def _compute_violation_costs(s: PhaseSamples) -> Array:
    """Return o of each segment (K,)."""
    leg = s.leg
    of_states = _weight_violations_by_multipliers(s, s.x, leg.state_bounds, s.state_multiplier)
    at = s.inner_times, s.x, s.u_polynomial
    paths = evaluate_within_bounds(s.functions.path_constraints, *at, leg.control_bounds)
    return of_states + _weight_violations_by_multipliers(s, paths, leg.path_bounds, s.mu)


def _weight_violations_by_multipliers(
    s: PhaseSamples, values: Array, bounds: Interval, multipliers: Array
) -> Array:
    """Return exceeded limits times their multipliers, if these have the correct sign (K,).

    Errors of equalities have both signs; their absolute value is taken after integration over a segment.
    """
    priced = np.maximum(multipliers, 0.0) * np.maximum(values - bounds.upper[:, None], 0.0)
    priced += np.maximum(-multipliers, 0.0) * np.maximum(bounds.lower[:, None] - values, 0.0)
    equations = bounds.is_fixed
    priced[equations] = multipliers[equations] * (values - bounds.upper[:, None])[equations]
    return np.asarray(np.sum(np.abs(s.segment_integrals(priced)), axis=0))


def _compute_hamiltonian_decreases(s: PhaseSamples) -> Array:
    """Return |g| of each segment (K,)."""
    if not s.leg.controls.size:
        return np.zeros(s.leg.mesh.segments)
    bounds = s.leg.path_bounds  # interpolated multipliers may have the wrong sign between the points
    least = np.where(np.isfinite(bounds.lower), -np.inf, 0.0)[:, None]
    most = np.where(np.isfinite(bounds.upper), np.inf, 0.0)[:, None]
    at = s.inner_times, s.x, s.u_polynomial, s.lam, np.clip(s.mu, least, most)
    slope = zero_nonfinite(s.functions.control_gradient(*at))
    curvature = np.einsum("iij->ij", s.functions.control_hessian(*at))
    curvature = zero_nonfinite(curvature)
    bounds = s.leg.control_bounds
    reach = np.maximum(s.control_span, np.max(np.abs(s.u), axis=1))[:, None]
    lower = np.where(np.isfinite(bounds.lower)[:, None], bounds.lower[:, None] - s.u_polynomial, -reach)
    upper = np.where(np.isfinite(bounds.upper)[:, None], bounds.upper[:, None] - s.u_polynomial, reach)
    gains = _maximise_quadratic_decrease(slope, curvature, lower, upper)
    net = s.segment_integrals(np.sum(gains, axis=0))
    positive = s.segment_integrals(np.sum(np.maximum(gains, 0.0), axis=0))
    return np.maximum(np.abs(net), UNCANCELLED_SHARE * positive)


def _maximise_quadratic_decrease(slope: Array, curvature: Array, lower: Array, upper: Array) -> Array:
    """Return the maximum of -(slope d + curvature d^2 / 2) over lower <= d <= upper, elementwise."""

    def compute_decrease(step: Array) -> Array:
        return np.asarray(-(slope + 0.5 * curvature * step) * step)

    newton = np.divide(-slope, curvature, out=np.zeros_like(slope), where=curvature > 0)
    inside = np.where(curvature > 0, compute_decrease(np.clip(newton, lower, upper)), -np.inf)
    return np.asarray(np.maximum(inside, np.maximum(compute_decrease(lower), compute_decrease(upper))))
