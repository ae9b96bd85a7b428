r"""Critical cone: variations of a solution, on its mesh, that satisfy its active limits to first order.

If a magnitude s with a direction n is zero, :math:`H = H_0 + s\,(c + \sigma \cdot n)` does not depend on n, which is
fixed; the switching function of s is :math:`c - |\sigma|` (Lawden, Optimal Trajectories for Space Navigation, 1963).

The variation of a pure state path constraint vanishes along an arc on which it is active, and by continuity at the
entry. A program of Gauss collocation has rows at its points only, so that the entry needs an additional row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from gnc_opt.array_types import Array, Indices, Mask
from gnc_opt.model.split_and_magnitude_direction_controls import VectorControl
from gnc_opt.numerical_tolerances import ACTIVE, AT_LIMIT, NOTABLE, RANK, TINY
from gnc_opt.planning.optimality.kkt_system import NullSpace, ProgramLimits, ProgramPoint, compute_curvature
from gnc_opt.planning.optimality.multiplier_estimate import differentiate_path_constraints
from gnc_opt.planning.problem.bounds import stack_intervals
from gnc_opt.planning.solution.phase_solution import interpolate_point_values
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial
from gnc_opt.planning.transcription.collocation import PhaseCollocation
from gnc_opt.planning.transcription.nlp_layout import PhaseIndices


def find_vector_control(s: PhaseSamples, group: Indices) -> VectorControl | None:
    """Return the vector control of a group, if H is affine in it and only its length is limited."""
    layout, labels = s.phase.controls, s.phase.path_labels
    for vector in s.phase.vector_controls:
        indices = [np.arange(layout.size)[layout.slice(part)] for part in vector.parts]
        if not np.array_equal(np.sort(np.concatenate(indices)), group):
            continue
        hessian = s.functions.functions["switching"].jac_sparsity(0, 2)
        jacobian = s.functions.functions["paths"].jac_sparsity(0, 2)
        curved = {(i, j) for i, j in zip(hessian.row(), hessian.get_col(), strict=True) if i in group}
        pairs = {(int(i), int(j)) for i in indices[0] for j in indices[1]}
        rows = {labels[i] for i, j in zip(jacobian.row(), jacobian.get_col(), strict=True) if j in group}
        if curved <= pairs | {(j, i) for i, j in pairs} and rows == {vector.direction_norm_constraint_name}:
            return vector
    return None


def differentiate_augmented_hamiltonian(
    s: PhaseSamples, times: Array, x: Array, u: Array, lam: Array, mu: Array
) -> Array:
    """Return d(H + mu.c)/du (m, n_times); for a zero magnitude with its optimal direction."""
    gradient = s.functions.control_gradient(times, x, u, lam, mu)
    for vector in filter(None, (find_vector_control(s, group) for group in s.functions.coupled_controls)):
        magnitude, direction = (s.phase.controls.slice(part) for part in vector.parts)
        zero = np.flatnonzero(u[magnitude][0] <= AT_LIMIT * s.control_scale[magnitude][0])
        thrusting = u[:, zero].copy()
        thrusting[magnitude] = 1.0
        sigma = s.functions.switching_functions(times[zero], x[:, zero], thrusting, lam[:, zero])[direction]
        by_direction = np.sum(sigma * thrusting[direction], axis=0)
        gradient[magnitude, zero] -= by_direction + np.linalg.norm(sigma, axis=0)
    return gradient


def fix_vector_control_directions(cone: CriticalCone, samples: Sequence[PhaseSamples]) -> CriticalCone:
    """Return the cone with directions fixed where their magnitude is, and inactive angles fixed."""
    strong = cone.strong.copy()
    for s in samples:
        collocation = cone.point.transcription.parts[s.phase.name].collocation
        indices = collocation.point_controls
        times = s.phase.initial_time + s.phase.duration * collocation.normalised_point_times
        for i in np.flatnonzero(np.any(s.inactive_controls, axis=1)):
            is_inactive = np.interp(times, s.times, s.inactive_controls[i]) > (1 - NOTABLE)
            strong[indices[i, is_inactive & np.any(cone.strong[indices], axis=0)]] = True
        for vector in s.phase.vector_controls:
            magnitude, direction = (
                collocation.point_controls[s.phase.controls.slice(part)] for part in vector.parts
            )
            value = cone.point.x[magnitude[0]] * cone.point.scaling.variables[magnitude[0]]
            scale = s.control_scale[s.phase.controls.slice(vector.magnitude)][0]
            is_zero = strong[magnitude[0]] & (value <= AT_LIMIT * scale)
            length = collocation.path_rows[s.phase.path_labels.index(vector.direction_norm_constraint_name)]
            strong[direction[:, is_zero]] = True
            strong[cone.point.x.size + length[is_zero]] = False
    return replace(cone, strong=strong)


def fix_constraints_at_arc_entries(cone: CriticalCone, samples: Sequence[PhaseSamples]) -> CriticalCone:
    """Return the cone with path constraints also fixed at the entries of their arcs."""
    point = cone.point
    blocks = []
    for s in samples:
        part = point.transcription.parts[s.phase.name]
        rows, boundaries = np.nonzero(_find_arc_entries(cone, s, part))
        if not rows.size:
            continue
        breaks = np.interp(part.collocation.mesh.breaks, s.phase.mesh.breaks, s.phase.breaks)
        arguments = breaks, s.phase.x(breaks), s.phase.applied(breaks)
        columns, gradients = differentiate_path_constraints(point.transcription, part, s.functions, arguments)
        values = gradients[:, rows, boundaries] * point.scaling.variables[columns[:, boundaries]]
        row_numbers = np.tile(np.arange(rows.size), columns.shape[0])
        shape = rows.size, point.x.size
        entries = values.ravel(), (row_numbers, columns[:, boundaries].ravel())
        blocks.append(scipy.sparse.csc_array(entries, shape=shape))
    return replace(cone, extra_rows=scipy.sparse.vstack(blocks, format="csc")) if blocks else cone


def _find_arc_entries(cone: CriticalCone, s: PhaseSamples, part: PhaseIndices) -> Mask:
    """Return the arc entries (n_paths, K): active at all points of the segment, but not of the previous one."""
    collocation = part.collocation
    fixed = cone.strong[cone.point.x.size :][collocation.path_rows]
    is_active = np.zeros((collocation.n_paths, collocation.mesh.segments + 1), dtype=bool)
    for row in s.pure_state_constraints:
        is_active[row, 1:] = np.logical_and.reduceat(fixed[row], collocation.mesh.point_offsets[:-1])
    return np.asarray(is_active[:, 1:] & ~is_active[:, :-1])


@dataclass(frozen=True, eq=False)
class CriticalCone:
    """Variations of a point that are free to first order.

    ``strong`` and ``weak`` (n_variables + n_constraints,) are fixed variables and rows, and those at a limit with zero
    multiplier, which may leave it to one side. ``unit`` (sparse) are the scaled variables of each variation (module
    `goh_transformation`; None: one variable each); ``extra_rows`` (sparse) are further active conditions.
    """

    point: ProgramPoint
    strong: Mask
    weak: Mask
    unit: Any = None
    extra_rows: Any = None

    @classmethod
    def from_program_point(cls, point: ProgramPoint) -> CriticalCone:
        """Return the cone, with active limits determined from the gradient of the Lagrangian.

        By continuity the variation of a limited quantity vanishes at the ends of an active arc too: a node at the limit
        is fixed if it shares a segment with a node with a multiplier, or a control beside such a segment.
        """
        strong, weak = [], []
        of_variables, of_rows = _list_nlp_variables_along_segments(point)
        for limits, values, multipliers, lines in (
            (point.variables, point.x, point.multiplier_densities[0], of_variables),
            (point.rows, point.constraint_values, point.multiplier_densities[1], of_rows),
        ):
            active_set = ProgramLimits.determine_active_set(limits.box, values, multipliers, limits.labels)
            doubtful = active_set.mask_weakly_active_limits(values, multipliers)
            active = active_set.active & ~doubtful
            _extend_active_limits_along_arcs(lines, values, active & ~limits.box.is_fixed, active, doubtful)
            strong.append(active)
            weak.append(doubtful)
        return cls(point, np.concatenate(strong), np.concatenate(weak))

    def is_direction_in_cone(self, direction: Array, samples: list[PhaseSamples]) -> bool:
        """Return whether a direction satisfies weakly active limits at the nodes and active ones between them."""
        point = self.point
        changes = np.concatenate([direction, point.constraint_jacobian @ direction])[self.weak]
        values = np.concatenate([point.x, point.constraint_values])[self.weak]
        bounds = stack_intervals([point.variables.box, point.rows.box]).select_components(self.weak)
        outwards = np.where(values - bounds.lower < bounds.upper - values, -changes, changes)
        between_nodes = [self._compute_largest_limit_violation(s, direction) for s in samples]
        return bool(np.all(np.concatenate([outwards, *between_nodes]) <= NOTABLE))

    def is_curvature_multiplier_dependent(self, direction: Array) -> bool:
        """Return whether the curvature along a direction depends on the choice of multipliers that are not unique.

        Inverse iteration finds a change of the multipliers that preserves the first-order conditions.
        """
        space = NullSpace.with_fixed_variables(self.point, self.strong | self.weak)
        solve = space.projection_factors[1]
        change = np.random.default_rng(0).standard_normal(space.rows.size)
        for _ in range(2):
            change = solve(np.concatenate([np.zeros(space.dimension), change]))[space.dimension :]
            change /= max(float(np.linalg.norm(change)), TINY)
        if np.linalg.norm(space.jacobian.T @ change) > RANK:
            return False
        multipliers = self.point.lam.copy()
        multipliers[space.rows] += change / space.norms
        value, share = compute_curvature(self.point.lagrangian_hessian, direction)
        changed, _ = compute_curvature(self.point.evaluate_hessian(1.0, multipliers), direction)
        return abs(share * (changed - value)) > AT_LIMIT * abs(value)

    def _compute_largest_limit_violation(self, s: PhaseSamples, direction: Array) -> Array:
        """Return the largest outward change of each state and path constraint at its limit, relative to its size."""
        part = self.point.transcription.parts[s.phase.name]
        change = direction * self.point.scaling.variables
        breaks = np.interp(part.collocation.mesh.breaks, s.phase.mesh.breaks, s.phase.breaks)
        dx = s.sample_signal(_interpolate_state_variations(breaks, part.collocation, change))
        rules = part.collocation.collocation_rules
        du = s.sample_signal(interpolate_point_values(breaks, rules, change[part.collocation.point_controls]))
        by_state = s.functions.path_state_jacobian(s.times, s.x, s.u)
        by_control = s.functions.path_control_jacobian(s.times, s.x, s.u)
        dc = np.einsum("ijk,jk->ik", by_state, dx) + np.einsum("ijk,jk->ik", by_control, du)
        paths = s.functions.path_constraints(s.times, s.x, s.u)
        violations = []
        for values, changes, bounds, scale in (
            (s.x, dx, s.phase.state_bounds, s.state_scale),
            (paths, dc, s.phase.path_bounds, s.path_scale),
        ):
            at_lower, at_upper = bounds.is_near_limits(values, AT_LIMIT * scale)
            free = ~bounds.is_fixed[:, None]
            outward = np.where(at_upper & free, changes, 0.0) - np.where(at_lower & free, changes, 0.0)
            # A direction along a limit hardly changes it and does not violate it.
            largest = np.maximum(np.max(np.abs(changes), axis=1), NOTABLE * scale)
            violations.append(np.max(outward, axis=1, initial=0.0) / largest)
        return np.concatenate(violations)


def _list_nlp_variables_along_segments(point: ProgramPoint) -> tuple[list[Indices], list[Indices]]:
    """Return the states along each segment, the controls there and 1 % of the phase beyond, and the path rows."""
    variables, rows = [], []
    for part in point.transcription.parts.values():
        collocation = part.collocation
        times, breaks = collocation.normalised_point_times, collocation.mesh.breaks
        for k in range(collocation.mesh.segments):
            near = (times > breaks[k] - NOTABLE) & (times < breaks[k + 1] + NOTABLE)
            variables += [*_list_segment_states(collocation, k), *collocation.point_controls[:, near]]
            rows += [*_select_nlp_variables_of_segment(collocation, collocation.path_rows, k)]
    return variables, rows


def _extend_active_limits_along_arcs(
    lines: list[Indices], values: Array, nonzero: Mask, active: Mask, doubtful: Mask
) -> None:
    """Fix, in place, nodes at the same limit as a node of their line with a multiplier."""
    for line in lines:
        limits = np.unique(values[line[nonzero[line]]])
        is_near_limit = np.any(np.abs(values[line][:, None] - limits) <= 2 * ACTIVE, axis=1) & doubtful[line]
        active[line[is_near_limit]], doubtful[line[is_near_limit]] = True, False


def _select_nlp_variables_of_segment(collocation: PhaseCollocation, indices: Indices, k: int) -> Indices:
    return np.asarray(indices[:, collocation.mesh.point_offsets[k] : collocation.mesh.point_offsets[k + 1]])


def _list_segment_states(collocation: PhaseCollocation, k: int) -> Indices:
    """Return the state variables at start, points and end of a segment, without duplicates (n_states, nodes)."""
    points = _select_nlp_variables_of_segment(collocation, collocation.point_states, k)
    start, end = collocation.boundary_states[:, [k]], collocation.boundary_states[:, [k + 1]]
    family = collocation.family
    middle = points[:, int(family.starts_at_point) : points.shape[1] - int(family.ends_at_point)]
    return np.asarray(np.hstack([start, middle, end]))


def _interpolate_state_variations(
    breaks: Array, collocation: PhaseCollocation, change: Array
) -> PiecewisePolynomial:
    values = tuple(change[_list_segment_states(collocation, k)] for k in range(collocation.mesh.segments))
    nodes = tuple(np.union1d(rule.points, [-1.0, 1.0]) for rule in collocation.collocation_rules)
    return PiecewisePolynomial(breaks, nodes, values)
