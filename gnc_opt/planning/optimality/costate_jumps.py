r"""Costate jumps of active state constraints.

A pure state constraint, :math:`c(t, x) \le 0` or a state bound, enters the adjoint equation through a measure
(Hartl, Sethi & Vickson, SIAM Review 37(2), 1995, theorem 4.1),

.. math:: d\lambda = -\Big(\frac{\partial H}{\partial x}\Big)dt - \frac{\partial c}{\partial x}\,d\eta,
          \qquad d\eta \ge 0 \text{ at an upper, } \le 0 \text{ at a lower limit, } 0 \text{ away from both,}

therefore :math:`\lambda(t^-) = \lambda(t^+) + \eta\,\partial c/\partial x` and
:math:`H(t^-) = H(t^+) - \eta\,\partial c/\partial t` at an atom, as at the ends of an active arc
or at a touch point. A jump at a segment boundary is admissible if active constraints explain it with correct signs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from gnc_opt.array_types import Array, Mask
from gnc_opt.numerical_tolerances import AT_LIMIT
from gnc_opt.planning.optimality.cost_and_endpoint_scales import AVERAGING_SHARE_OF_PHASE
from gnc_opt.planning.problem.bounds import Interval, intersect_bounds, stack_intervals
from gnc_opt.planning.problem.hamiltonian_functions import EndGradients
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples


@dataclass(frozen=True)
class PureStateConstraints:
    """Pure state constraints at given times, by sides: upper, then lower ones.

    ``directions`` (n_states, n_sides, n_times) are outward gradients; an admissible multiplier moves lambda against
    them. ``drifts`` (n_sides, n_times) are partial derivatives in time.
    """

    directions: Array
    drifts: Array
    active: Mask

    @classmethod
    def from_states(cls, s: PhaseSamples, times: Array, x: Array, u: Array) -> PureStateConstraints:
        """Evaluate state bounds and pure state path constraints."""
        phase, pure = s.leg, s.pure_state_paths
        by_time, by_state, _ = s.functions.path_gradients(times, x, u)
        units = np.repeat(np.eye(phase.states.size)[:, :, None], times.size, axis=2)
        outward, drift = np.hstack([units, by_state[:, pure]]), np.vstack([np.zeros_like(x), by_time[pure]])
        box = stack_intervals([phase.state_bounds, phase.path_bounds.select_components(pure)])
        scales = np.concatenate([s.state_scale, s.path_scale[pure]])
        values = np.vstack([x, s.functions.path_constraints(times, x, u)[pure]])
        at_lower, at_upper = box.is_near_limits(values, AT_LIMIT * scales)
        return cls(
            np.concatenate([outward, -outward], axis=1),
            np.vstack([drift, -drift]),
            np.vstack([at_upper, at_lower]),
        )


def explain_costate_jumps(s: PhaseSamples) -> tuple[Array, Array]:
    """Return the unexplained part of the costate jumps and the multipliers of active constraints at segment boundaries.

    Adjacent multiplier densities may compensate a jump of the wrong sign, see `integrate_nearby_multipliers`. The
    results are (n_states, K - 1) and (n_paths, K - 1); multipliers are >= 0 at upper limits.
    """
    breaks = s.leg.breaks[1:-1]
    jumps = s.leg.lam(breaks, "left") - s.leg.lam(breaks, "right")
    pushers = PureStateConstraints.from_states(s, breaks, s.leg.x(breaks), s.leg.applied(breaks))
    rest, every = jumps.copy(), np.zeros(pushers.active.shape)
    scale, spare = s.state_scale, _integrate_multiplier_impulses(s)
    for k in np.flatnonzero(np.any(pushers.active, axis=0) & np.all(np.isfinite(jumps), axis=0)):
        directions = pushers.directions[:, pushers.active[:, k], k]
        least = -spare[pushers.active[:, k], k]
        sizes, _ = scipy.optimize.nnls(
            directions * scale[:, None], (jumps[:, k] - directions @ least) * scale
        )
        every[pushers.active[:, k], k] = sizes + least
        rest[:, k] -= directions @ (sizes + least)
    upper, lower = np.split(every, 2)
    atoms = np.zeros((len(s.leg.path_labels), breaks.size))
    atoms[s.pure_state_paths] = (upper - lower)[s.leg.states.size :]
    return rest, atoms


@dataclass(frozen=True)
class TransversalityResidual:
    """Transversality residual at an end of a phase, and the part that pure state path constraints explain.

    ``gap`` (n_states,) is the costate minus the gradients of cost and boundary constraints. The atoms ``multipliers``
    (n_paths,) of active path constraints, >= 0 at upper limits, explain the part ``explained`` of it, and contribute
    ``drift`` to the gap of H. ``limits`` are those of the states at this end.
    """

    gap: Array
    multipliers: Array
    explained: Array
    drift: float
    limits: Interval


def explain_costate_gap(s: PhaseSamples, at: int, ends: EndGradients) -> TransversalityResidual:
    """Explain the costate gap at the start (``at`` = 0) or end (-1) of a phase by active constraints and limits."""
    phase, name, pure, n = s.leg, s.leg.name, s.pure_state_paths, s.leg.states.size
    given = phase.final_bounds if at else phase.initial_bounds
    limits = intersect_bounds(given, phase.state_bounds)
    gap = s.lam[:, -1] - ends.final_state[name] if at else -(s.lam[:, 0] + ends.initial_state[name])
    multipliers, rows = np.zeros(len(phase.path_labels)), np.concatenate([pure, pure])
    nothing = TransversalityResidual(gap, multipliers, np.zeros(n), 0.0, limits)
    pushers = PureStateConstraints.from_states(s, s.times[[at]], s.x[:, [at]], s.u[:, [at]])
    sides = np.concatenate([n + np.arange(pure.size), 2 * n + pure.size + np.arange(pure.size)])
    active = pushers.active[sides, 0]
    rows, signs, sides = rows[active], np.repeat([1.0, -1.0], pure.size)[active], sides[active]
    if not sides.size or not np.all(np.isfinite(gap)):
        return nothing
    at_lower, at_upper = limits.is_near_limits(s.x[:, at], AT_LIMIT * s.state_scale)
    own = np.eye(n)
    every = np.hstack([pushers.directions[:, sides, 0], own[:, at_upper], -own[:, at_lower]])
    sizes = scipy.optimize.nnls(every * s.state_scale[:, None], gap * s.state_scale)[0][: sides.size]
    np.add.at(multipliers, rows, signs * sizes)
    drift = float(pushers.drifts[sides, 0] @ sizes)
    return TransversalityResidual(gap, multipliers, every[:, : sides.size] @ sizes, drift, limits)


def integrate_nearby_multipliers(s: PhaseSamples, densities: Array) -> Array:
    """Return the integral of multipliers (n, N) within half of `AVERAGING_SHARE_OF_PHASE` of (K - 1) boundaries."""
    offsets = np.array(s.leg.mesh.point_offsets[1:-1], dtype=int)
    near = 0.5 * AVERAGING_SHARE_OF_PHASE * s.span
    widths = np.minimum(np.diff(s.leg.breaks), near)
    sides = np.stack([densities[:, offsets - 1] * widths[:-1], densities[:, offsets] * widths[1:]])
    upper, lower = np.max(sides, axis=0), np.min(sides, axis=0)
    return np.asarray(np.where(upper > -lower, upper, lower))


def _integrate_multiplier_impulses(s: PhaseSamples) -> Array:
    """Return the integrals by sides of constraints as in `PureStateConstraints`, >= 0 (n_sides, K - 1)."""
    beside = integrate_nearby_multipliers(
        s, np.vstack([s.leg.state_multipliers, s.leg.path_multipliers[s.pure_state_paths]])
    )
    return np.vstack([np.maximum(beside, 0.0), np.maximum(-beside, 0.0)])
