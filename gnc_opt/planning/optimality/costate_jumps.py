r"""Costate jumps of active state constraints, and admissible multiplier measures within a segment.

A constraint without controls, :math:`c(t, x) \le 0` or a state bound, enters the adjoint equation through a measure
(Hartl, Sethi & Vickson, SIAM Review 37(2), 1995, theorem 4.1),

.. math:: d\lambda = -\Big(\frac{\partial H}{\partial x}\Big)dt - \frac{\partial c}{\partial x}\,d\eta,
          \qquad d\eta \ge 0 \text{ at an upper, } \le 0 \text{ at a lower limit, } 0 \text{ away from both,}

hence :math:`\lambda(t^-) = \lambda(t^+) + \eta\,\partial c/\partial x` and
:math:`H(t^-) = H(t^+) - \eta\,\partial c/\partial t` where it has an atom, as at the ends of an arc
along the limit or where the limit is touched. Two things follow for the verifier.

* At a segment boundary, a jump is admissible if the active constraints explain it with multipliers of the
right sign.
* In a segment where the constraint becomes active or inactive, polynomials represent neither a jump nor a
kink. There the costate is integrated again from the segment's start, with the measure that best fits the
costate at the segment's end and the stationarity of H in between. The residual at the end is the violation of
the adjoint equation, and the integrated costate replaces the polynomial in all other conditions. If no
measure of the right sign on the active part explains the costates, the full violation counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from gnc_opt.arrays import Array, Indices, Mask
from gnc_opt.planning.optimality.cost_scale import AVERAGING_SHARE_OF_PHASE
from gnc_opt.planning.problem.functions import EndGradients, PhaseFunctions
from gnc_opt.planning.problem.interval import Interval, intersect
from gnc_opt.planning.solution.samples import EdgeSegment, PhaseSamples, sampling_rule
from gnc_opt.tolerances import AT_LIMIT

_PUSHES = 1e-3
"""A multiplier counts as pushing at a point if it reaches this share of its largest in the segment."""


@dataclass(frozen=True)
class StateConstraintSides:
    """Pure state constraints at some times.

    Attributes
    ----------
    directions : array (n_states, n_sides, n_times)
        Gradient of each side of each constraint, outwards: a legitimate push moves lambda against it.
    drifts : array (n_sides, n_times)
        Its partial derivative with respect to time.
    active : bool array (n_sides, n_times)
    """

    directions: Array
    drifts: Array
    active: Mask

    @classmethod
    def at(cls, s: PhaseSamples, times: Array, x: Array, u: Array) -> StateConstraintSides:
        """Evaluate state bounds and the path constraints that do not depend on controls."""
        leg, n = s.leg, s.leg.states.size
        gradients = [np.repeat(np.eye(n)[:, :, None], times.size, axis=2)]
        drifts = [np.zeros_like(x)]
        values, scales = [x], [s.state_scale]
        lower, upper = [leg.state_bounds.lower], [leg.state_bounds.upper]
        pure = s.pure_paths
        if pure.size:
            by_state, by_time, _ = path_gradients(s.functions, len(leg.path_labels), times, x, u)
            gradients.append(by_state[:, pure])
            drifts.append(by_time[pure])
            values.append(s.functions.paths(times, x, u)[pure])
            scales.append(s.path_scale[pure])
            lower.append(leg.path_bounds.lower[pure])
            upper.append(leg.path_bounds.upper[pure])
        value, near = np.vstack(values), (AT_LIMIT * np.concatenate(scales))[:, None]
        at_upper = value >= np.concatenate(upper)[:, None] - near
        at_lower = value <= np.concatenate(lower)[:, None] + near
        outward, drift = np.concatenate(gradients, axis=1), np.vstack(drifts)
        return cls(
            np.concatenate([outward, -outward], axis=1),
            np.vstack([drift, -drift]),
            np.vstack([at_upper, at_lower]),
        )


def path_gradients(
    functions: PhaseFunctions, n_paths: int, times: Array, x: Array, u: Array
) -> tuple[Array, Array, Array]:
    """dc/dx, (n_states, n_paths, n_times), dc/dt, (n_paths, n_times), and dc/dq, (n_parameters, n_paths, n_times)."""
    zero, mu = np.zeros_like(x), np.zeros((n_paths, times.size))

    def gradients() -> list[Array]:
        kinds = functions.state_gradient, functions.time_gradient, functions.parameter_gradient
        return [np.reshape(gradient(times, x, u, zero, mu), (-1, times.size)) for gradient in kinds]

    idle = gradients()
    found = [np.zeros((rows.shape[0], n_paths, times.size)) for rows in idle]
    for i in range(n_paths):
        mu[i] = 1.0
        for whole, one, without in zip(found, gradients(), idle, strict=True):
            whole[:, i] = one - without
        mu[i] = 0.0
    by_state, by_time, by_parameter = found
    return by_state, by_time[0], by_parameter


def jumps_explained(s: PhaseSamples) -> tuple[Array, Array, Array]:
    """Return the jumps at inner segment boundaries with the parts that active constraints explain.

    A jump of the wrong sign is explained as far as the adjacent multiplier density compensates it, see
    `pushed_beside`.

    Returns
    -------
    unexplained : array (n_states, K - 1)
        Unexplained part of the costate jumps.
    hamiltonian : array (K - 1,)
        Increase of H by the explained jumps.
    atoms : array (n_paths, K - 1)
        Multipliers of the path constraints that explain them, >= 0 at upper limits.
    """
    breaks = s.leg.breaks[1:-1]
    jumps = s.leg.lam(breaks, "left") - s.leg.lam(breaks, "right")
    pushers = StateConstraintSides.at(s, breaks, s.leg.x(breaks), s.leg.flown(breaks))
    rest, rises, every = jumps.copy(), np.zeros(breaks.size), np.zeros(pushers.active.shape)
    scale, spare = s.state_scale, _spare_pushes(s)
    for k in np.flatnonzero(np.any(pushers.active, axis=0) & np.all(np.isfinite(jumps), axis=0)):
        directions = pushers.directions[:, pushers.active[:, k], k]
        least = -spare[pushers.active[:, k], k]
        sizes, _ = scipy.optimize.nnls(
            directions * scale[:, None], (jumps[:, k] - directions @ least) * scale
        )
        every[pushers.active[:, k], k] = sizes + least
        rest[:, k] -= directions @ (sizes + least)
        rises[k] = pushers.drifts[pushers.active[:, k], k] @ (sizes + least)
    upper, lower = np.split(every, 2)
    atoms = np.zeros((len(s.leg.path_labels), breaks.size))
    atoms[s.pure_paths] = (upper - lower)[s.leg.states.size :]
    return rest, rises, atoms


@dataclass(frozen=True)
class EndPush:
    """Transversality residual at an end of a phase, and the part that path constraints without controls
    explain.

    Attributes
    ----------
    gap : array (n_states,)
        Costate less the gradients of cost and boundary constraints.
    multipliers : array (n_paths,)
        Atoms of the path constraints that are active there, >= 0 at upper limits; zero for all others.
    explained : array (n_states,)
        The part of the gap that they explain.
    drift : float
        Their contribution to the gap of H.
    limits : Interval
        Of the states there.
    """

    gap: Array
    multipliers: Array
    explained: Array
    drift: float
    limits: Interval


def end_push(s: PhaseSamples, at: int, ends: EndGradients) -> EndPush:
    """Explain a gap in the costate at the start (``at`` = 0) or the end (-1) of a phase by what is active there.

    States that are on limits of their own push too.
    """
    leg, name, pure, n = s.leg, s.leg.name, s.pure_paths, s.leg.states.size
    given = leg.final_bounds if at else leg.initial_bounds
    limits = intersect(given, leg.state_bounds)
    gap = s.lam[:, -1] - ends.final_state[name] if at else -(s.lam[:, 0] + ends.initial_state[name])
    multipliers, rows = np.zeros(len(leg.path_labels)), np.concatenate([pure, pure])
    nothing = EndPush(gap, multipliers, np.zeros(n), 0.0, limits)
    pushers = StateConstraintSides.at(s, s.times[[at]], s.x[:, [at]], s.u[:, [at]])
    sides = np.concatenate([n + np.arange(pure.size), 2 * n + pure.size + np.arange(pure.size)])
    active = pushers.active[sides, 0]
    rows, signs, sides = rows[active], np.repeat([1.0, -1.0], pure.size)[active], sides[active]
    if not sides.size or not np.all(np.isfinite(gap)):
        return nothing
    at_lower, at_upper = limits.near(s.x[:, at], AT_LIMIT * s.state_scale)
    own = np.eye(n)
    every = np.hstack([pushers.directions[:, sides, 0], own[:, at_upper], -own[:, at_lower]])
    sizes = scipy.optimize.nnls(every * s.state_scale[:, None], gap * s.state_scale)[0][: sides.size]
    np.add.at(multipliers, rows, signs * sizes)
    drift = float(pushers.drifts[sides, 0] @ sizes)
    return EndPush(gap, multipliers, every[:, : sides.size] @ sizes, drift, limits)


def pushed_beside(s: PhaseSamples, densities: Array) -> Array:
    """Return the integral of multipliers (n, N) within half of `AVERAGING_SHARE_OF_PHASE` of inner segment
    boundaries (n, K -
    1).

    A mesh does not resolve how a measure divides between an atom and the adjacent density: both give the same
    costate elsewhere.
    """
    offsets, near = np.array(s.leg.mesh.offsets[1:-1], dtype=int), 0.5 * AVERAGING_SHARE_OF_PHASE * s.span
    widths = np.minimum(np.diff(s.leg.breaks), near)
    sides = np.stack([densities[:, offsets - 1] * widths[:-1], densities[:, offsets] * widths[1:]])
    upper, lower = np.max(sides, axis=0), np.min(sides, axis=0)
    return np.asarray(np.where(upper > -lower, upper, lower))


def _spare_pushes(s: PhaseSamples) -> Array:
    """The same by sides of constraints as in `StateConstraintSides`, >= 0 (n_sides, K - 1)."""
    beside = pushed_beside(s, np.vstack([s.leg.state_multipliers, s.leg.path_multipliers[s.pure_paths]]))
    return np.vstack([np.maximum(beside, 0.0), np.maximum(-beside, 0.0)])


def settle_edges(s: PhaseSamples, tolerance: float) -> PhaseSamples:
    """Integrate the costates again in segments where a state constraint becomes active or inactive.

    Where they then miss the end of the segment, the polynomials stay.
    """
    residual = s.adjoint_residual
    edges = []
    for k in np.flatnonzero(_reached_or_left(s)):
        if np.max(residual[:, k]) > tolerance:
            edge = _integrate_anew(s, int(k), tolerance)
            if edge is not None and np.max(edge.violation) <= tolerance:
                edges.append(edge)
    return replace(s, edges=tuple(edges)) if edges else s


def _reached_or_left(s: PhaseSamples) -> Mask:
    """Segments (K,) in which a pure state constraint has a multiplier at some but not all points."""
    rows = np.vstack([s.leg.state_multipliers, s.leg.path_multipliers[s.pure_paths]])
    found = np.zeros(s.leg.mesh.segments, dtype=bool)
    for k in range(s.leg.mesh.segments):
        here = np.abs(rows[:, s.leg.mesh.offsets[k] : s.leg.mesh.offsets[k + 1]])
        pushing = here > _PUSHES * np.max(here, axis=1, keepdims=True)
        found[k] = bool(np.any(pushing.any(axis=1) & ~pushing.all(axis=1)))
    return found


def _integrate_anew(s: PhaseSamples, k: int, tolerance: float) -> EdgeSegment | None:
    """The costate of a segment from its start, with the measure that explains most; None if that is not it."""
    here = np.flatnonzero(s.segments == k)
    times, x, u, lam = s.times[here], s.x[:, here], s.u[:, here], s.lam[:, here]
    free, fundamental = _without_pushes(s, k, here)
    pushers = StateConstraintSides.at(s, times, x, u)
    responses = _responses(pushers, fundamental)
    if not responses.shape[2]:
        return None
    worth = s.state_scale / s.cost_scale
    slopes = s.functions.input_jacobian(times, x, u)
    bounds, near = s.leg.control_bounds, (AT_LIMIT * s.control_scale)[:, None]
    inside = (u > bounds.lower[:, None] + near) & (u < bounds.upper[:, None] - near)
    share = inside * (s.control_span / s.control_worth)[:, None] / np.sqrt(here.size)
    gradient = s.functions.control_gradient(times, x, u, free, s.mu[:, here]) * share
    moved = np.einsum("imt,ita->mta", slopes, responses) * share[:, :, None]
    matrix = np.vstack([responses[:, -1] * worth[:, None], moved.reshape(-1, moved.shape[2])])
    target = np.concatenate([(lam[:, -1] - free[:, -1]) * worth, -gradient.ravel()])
    sizes = np.linalg.norm(matrix, axis=0)
    if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(target)) and np.any(sizes > 0)):
        return None
    sizes = np.where(sizes > 0, sizes, 1.0)
    weights = scipy.optimize.nnls(matrix / sizes, target)[0] / sizes
    costates = free + responses @ weights
    # A polynomial through a jump is off by about the jump; one that is further off is another costate.
    reach = np.max(np.abs(responses) @ weights, axis=1)
    if np.any(np.abs(costates - lam) * worth[:, None] > (reach * worth + tolerance)[:, None]):
        return None
    return EdgeSegment(k, costates, np.abs(costates[:, -1] - lam[:, -1]) * worth)


def _without_pushes(s: PhaseSamples, k: int, here: Indices) -> tuple[Array, Array]:
    """Costates (n, m) from the segment's start without multipliers, and their fundamental matrices (n, n, m)."""
    leg, n = s.leg, s.leg.states.size
    rule = sampling_rule(leg.mesh.degrees[k])
    half = 0.5 * (leg.breaks[k + 1] - leg.breaks[k])
    inner = here[1:-1]
    times, x, u, mu = s.times[inner], s.x[:, inner], s.u[:, inner], s.mu[:, inner].copy()
    mu[s.pure_paths] = 0.0
    matrices = -np.transpose(s.functions.state_jacobian(times, x, u), (2, 1, 0))
    forcing = -s.functions.state_gradient(times, x, u, np.zeros_like(x), mu)
    # Collocation of the linear equation y' = M y + g at the samples, for all right sides at once.
    m = inner.size
    blocks = half * np.einsum("jl,lab->jalb", rule.integration, matrices).reshape(m * n, m * n)
    starts = np.hstack([np.eye(n), s.lam[:, here[:1]]])
    right = np.tile(starts, (m, 1)).reshape(m, n, n + 1)
    right[:, :, -1] += half * rule.integration @ forcing.T
    values = np.linalg.solve(np.eye(m * n) - blocks, right.reshape(m * n, n + 1)).reshape(m, n, n + 1)
    rates = np.einsum("jab,jbc->jac", matrices, values)
    rates[:, :, -1] += forcing.T
    last = starts + half * np.einsum("j,jac->ac", rule.weights, rates)
    every = np.concatenate([starts[None], values, last[None]])
    return every[:, :, -1].T, np.transpose(every[:, :, :-1], (1, 2, 0))


def _responses(pushers: StateConstraintSides, fundamental: Array) -> Array:
    """Costates (n, m, n_pushes) that a unit push between two neighbouring samples causes."""
    n, _, m = fundamental.shape
    columns = []
    at_start = np.stack(
        [np.linalg.solve(fundamental[:, :, j], pushers.directions[:, :, j]) for j in range(m)]
    )
    for j in range(m - 1):
        for side in np.flatnonzero(pushers.active[:, j] | pushers.active[:, j + 1]):
            push = 0.5 * (at_start[j, :, side] + at_start[j + 1, :, side])
            response = np.zeros((n, m))
            response[:, j + 1 :] = -np.einsum("abt,b->at", fundamental[:, :, j + 1 :], push)
            columns.append(response)
    return np.stack(columns, axis=2) if columns else np.zeros((n, m, 0))
