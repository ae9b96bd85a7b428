r"""Active state constraints: touch points of a program, controls that they determine, and costate jumps.

If a constraint :math:`S(t, x) \le 0` of order two or more is active at an isolated time, the *maximum* of S is zero on
all neighbouring trajectories: with a free breakpoint there, :math:`S = \dot S = 0`. The multiplier of
:math:`\dot S = 0` is zero; that of S = 0 is the costate jump along :math:`\partial S/\partial x` (Bryson & Ho,
Applied Optimal Control, 1975, section 3.11). Neighbouring trajectories of an active arc satisfy
:math:`S = \dots = S^{(q-1)} = 0` at its entry.

Where one limit of a control replaces another, neighbouring trajectories reach both limits at the same time.

Along an arc with an active pure state constraint, the first time derivative that contains controls, of its order q,
determines as many controls as it has independent gradients (Bryson, Denham & Dreyfus, AIAA J. 1(11), 1963; Hartl, Sethi
& Vickson, SIAM Review 37(2), 1995, sec. 2). H determines the others, or all if the multiplier is zero.

A pure state constraint, :math:`c(t, x) \le 0` or a state bound, enters the adjoint equation through a measure
(Hartl, Sethi & Vickson, SIAM Review 37(2), 1995, theorem 4.1),

.. math:: d\lambda = -\Big(\frac{\partial H}{\partial x}\Big)dt - \frac{\partial c}{\partial x}\,d\eta,
          \qquad d\eta \ge 0 \text{ at an upper, } \le 0 \text{ at a lower limit, } 0 \text{ away from both,}

therefore :math:`\lambda(t^-) = \lambda(t^+) + \eta\,\partial c/\partial x` and
:math:`H(t^-) = H(t^+) - \eta\,\partial c/\partial t` at an atom, as at the ends of an active arc
or at a touch point. A jump at a segment boundary is admissible if active constraints explain it with correct signs.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.array_types import Array, Indices, Mask
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch, evaluate_casadi_function
from gnc_opt.numerical_tolerances import ACTIVE, AT_LIMIT, NOTABLE, RANK, SMALL, replace_zeros_by_one
from gnc_opt.planning.optimality.cost_and_endpoint_scales import AVERAGING_SHARE_OF_PHASE
from gnc_opt.planning.problem.active_constraint_arcs import Arc, ArcKind, Junction
from gnc_opt.planning.problem.bounds import Interval, intersect_bounds, stack_intervals
from gnc_opt.planning.problem.hamiltonian_functions import EndGradients, PhaseFunctions
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.state_constraint_order import (
    ConstraintOrder,
    differentiate_until_controls_appear,
    get_constraint_order,
)
from gnc_opt.planning.solution.phase_trajectory_samples import COSTATE_MIN_SHARE_OF_COST, PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.state_and_control_scales import STILL_STATE_SHARE
from gnc_opt.planning.transcription.mesh import Mesh


@dataclass(frozen=True, eq=False)
class StateConstraints:
    """Path constraints and states of a phase as functions of the state, with time derivatives.

    Rows are path constraints, followed by states.
    """

    problem: Problem
    samples: PhaseSamples

    @property
    def n_rows(self) -> int:
        return len(self.samples.phase.path_labels) + self.samples.phase.states.size

    @cached_property
    def constraint_row_bounds(self) -> Interval:
        return stack_intervals([self.samples.phase.path_bounds, self.samples.phase.state_bounds])

    def list_finite_limits(self, row: int) -> list[tuple[ArcKind, float]]:
        """Return side and value of each finite limit of a row."""
        bounds = self.constraint_row_bounds
        limits = (ArcKind.LOWER, float(bounds.lower[row])), (ArcKind.UPPER, float(bounds.upper[row]))
        return [(kind, limit) for kind, limit in limits if np.isfinite(limit)]

    @property
    def row_scales(self) -> Array:
        """Variation of each row along the phase."""
        return np.concatenate([self.samples.path_scale, self.samples.state_scale])

    def get_order_of_constraint_contact(self, row: int) -> int:
        """Return the order of a row with possible contacts, else 0."""
        bounds = self.constraint_row_bounds
        if not bounds.lower[row] < bounds.upper[row] or not self.list_finite_limits(row):
            return 0
        return self.get_constraint_order(row).order or 0

    def rank_controls_by_constraint_effect(self, row: int) -> tuple[tuple[int, int], ...]:
        """Return the controls that can keep a row at its limit, and the signs of their effects on it; 0 if it varies.

        They are sorted by their smallest effect on the first derivative with controls.
        """
        controls = self.get_constraint_order(row).controls
        effects = {c: self._differentiate_constraint_by_control(row, c) for c in controls}
        ranked = sorted(effects, key=lambda c: float(np.min(np.abs(effects[c]))), reverse=True)
        signs = {c: int(np.sign(v[0])) if np.all(v * v[0] > 0) else 0 for c, v in effects.items()}
        return tuple((c, signs[c]) for c in ranked)

    def _differentiate_constraint_by_control(self, row: int, control: int) -> Array:
        """Return the effect of a control on the first derivative with controls, at the samples nearest to limits."""
        s, order = self.samples, self.get_order_of_constraint_contact(row)
        values = self.evaluate_constraints(s.times, s.x, s.u)[row]
        distance = np.min([np.abs(values - limit) for _, limit in self.list_finite_limits(row)], axis=0)
        nearest = distance <= max(NOTABLE * self.row_scales[row], np.min(distance))
        times, x, u = s.times[nearest], s.x[:, nearest], s.u[:, nearest]
        varied = u.copy()
        varied[control] += SMALL * s.control_scale[control]
        before, after = (self.evaluate_time_derivative(row, order, times, x, v) for v in (u, varied))
        return after - before

    def get_constraint_order(self, row: int) -> ConstraintOrder:
        return get_constraint_order(self.problem, self.problem.phases[self.samples.phase.name], row)

    def evaluate_constraints(self, times: Array, x: Array, u: Array) -> Array:
        """Return the values of all rows, (n_rows, n_times)."""
        return np.vstack([self.samples.functions.path_constraints(times, x, u), x])

    def is_near_limits(self, values: Array) -> Mask:
        """Return whether rows are at their lower and at their upper limit (2, n_rows, n_times)."""
        near = np.stack(self.constraint_row_bounds.is_near_limits(values, AT_LIMIT * self.row_scales))
        return np.asarray(near & ~self.constraint_row_bounds.is_fixed[:, None])

    def compute_costate_jumps(self, times: Array, x: Array, u: Array) -> Array:
        """Return the costate jumps along the gradient of each row, in units of the cost (n_rows, n_times)."""
        s = self.samples
        units = np.repeat(np.eye(len(x))[:, :, None], times.size, axis=2)
        by_state = np.concatenate([s.functions.path_state_jacobian(times, x, u), units])
        gradients = by_state * s.state_scale[:, None]
        jumps = (s.phase.lam(times, "left") - s.phase.lam(times, "right")) * s.state_scale[:, None]
        sizes = np.linalg.norm(gradients, axis=1)
        projections = np.einsum("ijk,jk->ik", gradients, jumps)
        return np.asarray(np.divide(projections, sizes, out=np.zeros_like(sizes), where=sizes > 0))

    def evaluate_time_derivative(self, row: int, k: int, times: Any, x: Array, u: Array) -> Array:
        """Return the k-th derivative of a row along the dynamics, shape of times."""
        name, f = self.samples.phase.name, self.samples.functions

        def build_derivative_function() -> Any:
            symbols = *self.problem.phases[name].model.symbolic_arguments(), self.problem.parameter_symbols()
            expression = self.get_constraint_order(row).derivatives[k]
            return ca.Function("derivative", [*symbols], [ca.densify(expression)])

        function = self.problem.memoize(("derivative", name, row, k), build_derivative_function)
        return np.asarray(evaluate_casadi_function(function, times, x, u, f.p, f.q)[0])


def compute_free_control_directions(s: PhaseSamples, free: Mask, unit: Array) -> list[Array]:
    """Return, for every sample, an orthonormal basis (m, k) of the control directions along active constraints.

    ``free`` (m, n_samples) are the interior controls, ``unit`` (m,) are unit steps in each control.
    """
    rows, axes = _evaluate_constraint_control_gradients(s) * unit[None, :, None], np.eye(unit.size)
    bases = [axes[:, samples] for samples in free.T]
    if not rows.size:
        return bases
    for pattern in np.unique(free, axis=1).T:
        samples = np.flatnonzero(np.all(free == pattern[:, None], axis=0))
        gradients = np.moveaxis(rows[:, pattern][:, :, samples], 2, 0)
        largest = np.max(np.abs(gradients), axis=2, keepdims=True, initial=0.0)
        limited = np.any(largest > 0, axis=(1, 2)) & np.all(np.isfinite(gradients), axis=(1, 2))
        if not np.any(limited):
            continue
        _, sizes, vectors = np.linalg.svd(gradients[limited] / replace_zeros_by_one(largest[limited]))
        ranks = np.sum(sizes > RANK * sizes[:, :1], axis=1)
        for j, rank, directions in zip(samples[limited], ranks, vectors, strict=True):
            bases[j] = axes[:, pattern] @ directions[rank:].T
    return bases


def mask_singular_controls(s: PhaseSamples, free: Mask, unit: Array, threshold: float) -> tuple[Mask, Mask]:
    """Return which free controls have a direction without curvature of H (m, n_samples), and where all directions do.

    Arguments as in `compute_free_control_directions`; curvatures up to ``threshold`` count as zero. Without active
    constraints the curvature is not evaluated.
    """
    if not _evaluate_constraint_control_gradients(s).size:
        return free, np.ones(s.times.size, dtype=bool)
    bases = compute_free_control_directions(s, free, unit)
    is_unconstrained = np.array([basis.shape[1] for basis in bases]) == np.sum(free, axis=0)
    hessian = s.control_hessian * unit[:, None, None] * unit[None, :, None]
    for j in np.flatnonzero(~is_unconstrained):
        bases[j] = _select_zero_curvature_directions(bases[j], hessian[:, :, j], threshold)
    return np.stack([np.linalg.norm(basis, axis=1) > RANK for basis in bases], axis=1), is_unconstrained


def _select_zero_curvature_directions(basis: Array, hessian: Array, tolerance: float) -> Array:
    """Return the directions of a basis in which a quadratic form is flat or not finite."""
    reduced = basis.T @ hessian @ basis
    if not reduced.size or not np.all(np.isfinite(reduced)):
        return basis
    curvatures, vectors = np.linalg.eigh(0.5 * (reduced + reduced.T))
    return np.asarray(basis @ vectors[:, np.abs(curvatures) <= tolerance])


@lru_cache(maxsize=8)  # several conditions of a verdict need them
def _evaluate_constraint_control_gradients(s: PhaseSamples) -> Array:
    """Return the control gradients of the quantities that active constraints keep zero (n, m, n_samples); else zero."""
    phase = s.phase
    gradients = [np.zeros((0, phase.controls.size, s.times.size))]
    if phase.path_labels:
        # A constraint active on the whole phase hardly varies; its distance is relative to its possible variation.
        varies = s.path_scale > STILL_STATE_SHARE * s.path_constraint_variations
        scale = np.where(varies, s.path_scale, s.path_constraint_variations)
        paths = s.functions.path_constraints(s.times, s.x, s.u)
        at_path_limit = np.logical_or(*phase.path_bounds.is_near_limits(paths, ACTIVE * scale))
        gradients.append(s.functions.path_control_jacobian(s.times, s.x, s.u) * at_path_limit[:, None])
    density = COSTATE_MIN_SHARE_OF_COST * s.cost_scale / s.span
    state_rows = np.logical_or(*phase.state_bounds.is_near_limits(s.x, ACTIVE * s.state_scale))
    state_rows &= np.abs(s.state_multiplier) * s.state_scale[:, None] > density
    path_rows = np.zeros((len(phase.path_labels), s.times.size), dtype=bool)
    if s.pure_state_constraints.size:
        has_multiplier = np.abs(s.mu) * s.path_scale[:, None] > density
        path_rows[s.pure_state_constraints] = (at_path_limit & has_multiplier)[s.pure_state_constraints]
    active = np.vstack([state_rows, path_rows])
    # A limit reached at a single sample is touched: its derivatives need not vanish there.
    lasting = active & (np.roll(active, 1, axis=1) | np.roll(active, -1, axis=1))
    chosen = np.flatnonzero(np.any(lasting, axis=1))
    if chosen.size:
        gradient_function = _build_constraint_rate_gradient_function(s.functions, chosen)
        numbers = np.concatenate([s.functions.weights, s.functions.p, s.functions.q])
        values = evaluate_casadi_batch(gradient_function, s.times.size, s.times[None], s.x, s.u, numbers)
        rows = values.reshape(chosen.size, phase.controls.size, s.times.size)
        gradients.append(rows * lasting[chosen][:, None])
    return np.concatenate(gradients)


def _build_constraint_rate_gradient_function(functions: PhaseFunctions, chosen: Indices) -> Any:
    """Return the u-gradients of the first time derivatives that contain u: states, paths (n * m, by rows)."""
    rates = functions.functions["rates"]
    t, x, u, lam, mu = (ca.SX.sym("v", rates.size1_in(i)) for i in range(5))
    numbers = [ca.SX.sym("v", rates.size1_in(i)) for i in range(5, 8)]
    f = rates(t, x, u, lam, mu, *numbers)
    values = ca.vertcat(x, functions.functions["paths"](t, x, u, lam, mu, *numbers))
    constraints = (differentiate_until_controls_appear("", values[int(i)], t, x, u, f) for i in chosen)
    gradients = [ca.densify(ca.jacobian(constraint.derivatives[-1], u)) for constraint in constraints]
    return ca.Function("held", [t, x, u, ca.vertcat(*numbers)], [ca.vec(ca.vertcat(*gradients).T)])


def impose_touch_points(solution: Solution, with_arcs: bool = False) -> Problem:
    """Return the problem of a solution with state constraints active at touch points, perhaps also along their arcs.

    Touch points are free breakpoints with multipliers. Next to them the constraints are released, since an
    interior-point method has spurious multipliers there. Phases with user-defined arcs are unchanged.
    """
    problem = solution.need_problem("linearise")
    for name, s in solution.samples().items():
        if problem.phases[name].numbers.arcs is None:
            constraints, structure = StateConstraints(problem, s), solution.structure if with_arcs else ()
            by_arc = (_find_high_order_constraint_arcs(constraints, arc) for arc in structure)
            arcs = list(itertools.chain(*by_arc))
            ends = {(start.constraint, k) for start, last in arcs for k in (start.boundary, last)}
            touches = [j for j in _find_touch_points(constraints) if (j.constraint, j.boundary) not in ends]
            if touches or arcs:
                problem = _constrain_touch_points_and_arcs(constraints, touches, arcs)
    return problem


def _find_high_order_constraint_arcs(constraints: StateConstraints, arc: Arc) -> list[tuple[Junction, int]]:
    """Return [entry and last break of the arc]; empty unless it is a state-constraint arc of order two or more."""
    phase = constraints.samples.phase
    labels = (*phase.path_labels, *phase.states.labels)
    if arc.phase != phase.name or arc.channel not in labels or not arc.kind.is_at_limit:
        return []
    row = labels.index(arc.channel)
    order = constraints.get_constraint_order(row).order or 0
    first, last = (int(np.argmin(np.abs(phase.breaks - t))) for t in (arc.start, arc.end))
    return [(Junction(row, first, arc.kind, order), last)] if order >= 2 and first != last else []


def _constrain_touch_points_and_arcs(
    constraints: StateConstraints, touches: list[Junction], arcs: list[tuple[Junction, int]]
) -> Problem:
    s = constraints.samples
    phase, n_paths = s.phase, len(s.phase.path_labels)
    kinds = np.full((constraints.n_rows, phase.mesh.segments), ArcKind.INTERIOR, dtype=object)
    values = constraints.evaluate_constraints(s.times, s.x, s.u)
    is_active = np.any(constraints.is_near_limits(values), axis=0)
    for junction in touches:
        for k in (junction.boundary - 1, junction.boundary):
            if not np.all(is_active[junction.constraint, s.segments == k]):  # no arc begins or ends there
                kinds[junction.constraint, k] = ArcKind.RELEASED
    for entry, last in arcs:
        row, first = entry.constraint, entry.boundary
        kinds[row, first:last] = entry.kind
        for k in (first - 1, last):  # the segments at its ends contain all active rows next to it
            if 0 <= k < phase.mesh.segments and kinds[row, k] is ArcKind.INTERIOR:
                kinds[row, k] = ArcKind.RELEASED
    entries = tuple(entry for entry, _ in arcs if entry.boundary > 0)
    return constraints.problem.with_fixed_arcs(
        phase.name,
        arcs=np.zeros((phase.controls.size, phase.mesh.segments), dtype=int),
        paths=kinds[:n_paths] if n_paths else None,
        states=kinds[n_paths:],
        junctions=(*touches, *entries),
    )


def _find_active_constraints(constraints: StateConstraints, boundaries: Sequence[int]) -> tuple[Mask, Mask]:
    """Return which constraints are active, and which have multipliers, at lower and upper limits (2, n_rows, n)."""
    s = constraints.samples
    times = s.phase.breaks[list(boundaries)]
    point = times, s.phase.x(times), s.phase.applied(times)
    at_limit = constraints.is_near_limits(constraints.evaluate_constraints(*point))
    jumps = constraints.compute_costate_jumps(*point)
    has_multiplier = at_limit & (np.stack([-jumps, jumps]) > ACTIVE * s.cost_scale)
    return np.array(at_limit, dtype=bool), np.array(has_multiplier, dtype=bool)


def free_touch_point_times(solution: Solution) -> Solution:
    """Return a solution with variable times of touch points, if other break times are variable.

    A mesh is stretched between its variable times; a touch point at a fixed break would be moved off the peak.
    """
    phases = dict(solution.phases)
    for name, s in solution.samples().items():
        mesh = s.phase.mesh
        if mesh.segments < 3:
            continue
        constraints = StateConstraints(solution.need_problem("linearise"), s)
        at_limit, has_multiplier = _find_active_constraints(constraints, range(1, mesh.segments))
        at_limit = np.pad(at_limit, ((0, 0), (0, 0), (1, 1)))
        is_isolated = has_multiplier & ~at_limit[:, :, :-2] & ~at_limit[:, :, 2:]
        touch_breaks = 1 + np.flatnonzero(np.any(is_isolated, axis=(0, 1)))
        movable = tuple({*mesh.movable, *map(int, touch_breaks)})
        phases[name] = replace(s.phase, mesh=Mesh(mesh.breaks, mesh.degrees, movable))
    return replace(solution, phases=phases)


def _find_touch_points(constraints: StateConstraints) -> tuple[Junction, ...]:
    """Return the touch points at movable breaks, with multipliers, and exchanges of limits."""
    boundaries, touches = constraints.samples.phase.mesh.movable, []
    if not boundaries:
        return ()
    has_multiplier = _find_active_constraints(constraints, boundaries)[1]
    for kind, at_limit in zip((ArcKind.LOWER, ArcKind.UPPER), has_multiplier, strict=True):
        for row, k in np.argwhere(at_limit):
            if (constraints.get_constraint_order(int(row)).order or 0) >= 2:
                touches.append(Junction(int(row), boundaries[k], kind, 2))
    return tuple(touches) + _find_limit_exchanges(constraints)


def _find_limit_exchanges(constraints: StateConstraints) -> tuple[Junction, ...]:
    """Return the breaks where a path constraint and another limit of a control replace each other."""
    s, phase = constraints.samples, constraints.samples.phase
    orders = [constraints.get_constraint_order(i) for i in range(len(phase.path_labels))]
    controls = [order.controls if order.order == 0 else () for order in orders]
    paths = [row for row, row_controls in enumerate(controls) if len(row_controls) == 1]
    if not paths:
        return ()
    at_path = constraints.is_near_limits(constraints.evaluate_constraints(s.times, s.x, s.u))
    at_bound = np.any(s.is_at_control_bounds, axis=0)
    exchanges: dict[int, Junction] = {}
    for row in paths:
        other = [np.any(at_path[:, i], axis=0) for i in paths if i != row and controls[i] == controls[row]]
        limits = [at_bound[controls[row][0]], *other]
        for kind, at_limit in zip((ArcKind.LOWER, ArcKind.UPPER), at_path[:, row], strict=True):
            for k in phase.mesh.movable:
                if side := _find_side_of_other_limit(s, at_limit, limits, k):
                    exchanges.setdefault(k, Junction(row, k, kind, 0, side))
    return tuple(exchanges.values())


def _find_side_of_other_limit(s: PhaseSamples, at_limit: Mask, others: list[Mask], boundary: int) -> int:
    """Return the side, -1 or 1, on which another limit determines the control up to the contact; 0 if there is none."""
    for side in (-1, 1):
        off, on = (s.segments == boundary + min(way, 0) for way in (side, -side))
        touch = np.flatnonzero(off)[-1 if side < 0 else 0]
        leaves = np.all(at_limit[on]) and not np.all(at_limit[off])
        if at_limit[touch] and leaves and any(np.all(limit[off]) for limit in others):
            return side
    return 0


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
    def from_states(
        cls, s: PhaseSamples, limits: Interval, times: Array, x: Array, u: Array
    ) -> PureStateConstraints:
        """Evaluate limits of the states and pure state path constraints."""
        phase, rows = s.phase, s.pure_state_constraints
        by_time, by_state, _ = s.functions.path_gradients(times, x, u)
        units = np.repeat(np.eye(phase.states.size)[:, :, None], times.size, axis=2)
        outward, drift = np.hstack([units, by_state[:, rows]]), np.vstack([np.zeros_like(x), by_time[rows]])
        bounds = stack_intervals([limits, phase.path_bounds.select_components(rows)])
        scales = np.concatenate([s.state_scale, s.path_scale[rows]])
        values = np.vstack([x, s.functions.path_constraints(times, x, u)[rows]])
        at_lower, at_upper = bounds.is_near_limits(values, AT_LIMIT * scales)
        directions = np.concatenate([outward, -outward], axis=1)
        return cls(directions, np.vstack([drift, -drift]), np.vstack([at_upper, at_lower]))


def explain_costate_jumps(s: PhaseSamples) -> tuple[Array, Array]:
    """Return the unexplained part of the costate jumps and the multipliers of active constraints at segment boundaries.

    Adjacent multiplier densities may compensate a jump of the wrong sign (`integrate_multipliers_near_boundaries`).
    The results are (n_states, K - 1) and (n_paths, K - 1); multipliers are >= 0 at upper limits.
    """
    breaks = s.phase.breaks[1:-1]
    jumps = s.phase.lam(breaks, "left") - s.phase.lam(breaks, "right")
    arguments = breaks, s.phase.x(breaks), s.phase.applied(breaks)
    constraints = PureStateConstraints.from_states(s, s.phase.state_bounds, *arguments)
    unexplained, multipliers = jumps.copy(), np.zeros(constraints.active.shape)
    densities = [s.phase.state_multipliers, s.phase.path_multipliers[s.pure_state_constraints]]
    nearby = integrate_multipliers_near_boundaries(s, np.vstack(densities))
    scale, available = s.state_scale, np.vstack([np.maximum(nearby, 0.0), np.maximum(-nearby, 0.0)])
    for k in np.flatnonzero(np.any(constraints.active, axis=0) & np.all(np.isfinite(jumps), axis=0)):
        directions = constraints.directions[:, constraints.active[:, k], k]
        smallest = -available[constraints.active[:, k], k]
        remainder = (jumps[:, k] - directions @ smallest) * scale
        excess, _ = scipy.optimize.nnls(directions * scale[:, None], remainder)
        multipliers[constraints.active[:, k], k] = excess + smallest
        unexplained[:, k] -= directions @ (excess + smallest)
    upper, lower = np.split(multipliers, 2)
    atoms = np.zeros((len(s.phase.path_labels), breaks.size))
    atoms[s.pure_state_constraints] = (upper - lower)[s.phase.states.size :]
    return unexplained, atoms


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


def explain_transversality_residual(s: PhaseSamples, end: int, ends: EndGradients) -> TransversalityResidual:
    """Explain the costate gap at the start (``end`` = 0) or end (-1) of a phase by active constraints and limits."""
    phase, name, state_rows, n = s.phase, s.phase.name, s.pure_state_constraints, s.phase.states.size
    end_bounds = phase.final_bounds if end else phase.initial_bounds
    limits = intersect_bounds(end_bounds, phase.state_bounds)
    gap = s.lam[:, -1] - ends.final_state[name] if end else -(s.lam[:, 0] + ends.initial_state[name])
    constraints = PureStateConstraints.from_states(s, limits, s.times[[end]], s.x[:, [end]], s.u[:, [end]])
    active = np.flatnonzero(constraints.active[:, 0])
    directions, sizes = constraints.directions[:, active, 0], np.zeros(active.size)
    if active.size and np.all(np.isfinite(gap)):
        sizes = scipy.optimize.nnls(directions * s.state_scale[:, None], gap * s.state_scale)[0]
    path_multipliers = np.where(active % (n + state_rows.size) >= n, sizes, 0.0)
    all_multipliers, multipliers = np.zeros(constraints.active.shape[0]), np.zeros(len(phase.path_labels))
    all_multipliers[active] = path_multipliers
    upper, lower = np.split(all_multipliers, 2)
    multipliers[state_rows] = (upper - lower)[n:]
    drift = float(constraints.drifts[active, 0] @ path_multipliers)
    return TransversalityResidual(gap, multipliers, directions @ path_multipliers, drift, limits)


def integrate_multipliers_near_boundaries(s: PhaseSamples, densities: Array) -> Array:
    """Return the integral of multipliers (n, N) within half of `AVERAGING_SHARE_OF_PHASE` of (K - 1) boundaries."""
    offsets = np.array(s.phase.mesh.point_offsets[1:-1], dtype=int)
    half_interval = 0.5 * AVERAGING_SHARE_OF_PHASE * s.span
    widths = np.minimum(np.diff(s.phase.breaks), half_interval)
    sides = np.stack([densities[:, offsets - 1] * widths[:-1], densities[:, offsets] * widths[1:]])
    upper, lower = np.max(sides, axis=0), np.min(sides, axis=0)
    return np.asarray(np.where(upper > -lower, upper, lower))
