r"""Goh transformation: controls on singular arcs are varied by their integrals.

If H is affine in controls :math:`u_S`, the second variation has no curvature in :math:`v = \delta u_S` but, by Goh's
transformation, in

.. math:: y(t) = \int_{t_0}^t v \,ds, \qquad h = y(t_f), \qquad
          \gamma = \int y^2\,dt + h^2 + \text{squares of all else that varies}.

Along first-order arcs that satisfy the strengthened generalised Legendre-Clebsch condition it is a Legendre form in
:math:`(y, h)`, and if it is positive, the minimum is strict (Goh, SIAM J. Control 4, 1966; Aronna, Bonnans,
Dmitruk & Lotito, Numer. Algebra Control Optim. 2(3), 2012, for controls that are bang-bang elsewhere; Aronna, Discrete
Contin. Dyn. Syst. S 11(6), 2018, with other controls determined by H). y may jump at the ends of a singular arc,
which replaces a variation of these times. If the end depends on h, the form must have curvature in h itself
(`find_cost_reducing_final_pulse`).

The degree of y is two less than that of the states, since quadrature has the wrong curvature for controls that
oscillate faster. The end segments of arcs are narrow, so that y can nearly jump.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.array_types import Indices, Mask, compute_interval_midpoints
from gnc_opt.numerical_tolerances import AT_LIMIT, EQUAL, RANK
from gnc_opt.planning.optimality.active_state_constraints import compute_free_control_directions
from gnc_opt.planning.optimality.kkt_system import compute_variation_norm_weights
from gnc_opt.planning.optimality.switching_time_problem import find_bound_to_bound_switches
from gnc_opt.planning.problem.hamiltonian_functions import get_endpoint_function
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.nlp_layout import PhaseIndices
from gnc_opt.planning.transcription.quadrature import (
    build_differentiation_matrix,
    get_collocation_points,
    get_quadrature_weights,
)
from gnc_opt.planning.verification.critical_cone import CriticalCone
from gnc_opt.planning.verification.minimum_principle import mask_undetermined_controls
from gnc_opt.planning.verification.singular_arcs import COUPLED, TOO_LARGE, analyse_singular_arcs

ARC_END_CUTS = (1e-2, 0.1), (0.9, 0.99)
"""Positions at which the first and the last segment of a singular arc are split, in shares of their widths."""

SINGULAR_SEGMENT_MIN_POINTS = 6
"""Smallest number of collocation points of a segment of a singular arc."""

LOWER_DEGREE = 2
"""Difference between the degrees of the states and of y."""

_RADAU = ((get_collocation_points, -1.0), (get_quadrature_weights, 1.0))


def mask_zero_hamiltonian_curvature(s: PhaseSamples) -> Mask:
    """Return where H has no positive curvature in a control (n_controls, n_samples)."""
    # A control at zero has the scale of its possible effect on the trajectory.
    scale = np.maximum(s.control_scale, s.control_span)
    curvature = np.einsum("iij->ij", s.control_hessian) * scale[:, None] ** 2
    return np.asarray(curvature <= AT_LIMIT * s.hamiltonian_scale)


@lru_cache(maxsize=8)
def mask_singular_samples(s: PhaseSamples) -> Mask:
    """Return where a control is interior, without curvature of H and not determined by active constraints (m, n)."""
    interior: Mask = ~np.any(s.is_at_control_bounds, axis=0)
    singular = mask_zero_hamiltonian_curvature(s) & interior & ~s.inactive_controls
    if not np.any(singular):
        return singular
    bases = compute_free_control_directions(s, interior, s.control_span)
    has_free_direction = np.stack([np.any(np.abs(basis) > RANK, axis=1) for basis in bases], axis=1)
    return np.asarray(singular & has_free_direction)


def mask_singular_segments(s: PhaseSamples) -> Mask:
    """Return the segments (n_controls, K) on which a control is singular."""
    singular, inside = mask_singular_samples(s), s.weights > 0
    rows = [np.all(singular[:, inside & (s.segments == k)], axis=1) for k in range(s.phase.mesh.segments)]
    return np.stack(rows, axis=1) & s.has_duration


def refine_mesh_at_singular_arc_ends(mesh: Mesh, singular: Mask) -> Mesh:
    """Return a mesh with narrow segments at the ends of singular arcs; ``singular`` (K,)."""
    breaks, degrees, movable = [0.0], [], []
    padded = np.concatenate([[False], singular, [False]])
    for k, degree in enumerate(mesh.degrees):
        if k in mesh.movable:
            movable.append(len(breaks) - 1)
        begins, ends = singular[k] and not padded[k], singular[k] and not padded[k + 2]
        cuts = (*(ARC_END_CUTS[0] if begins else ()), *(ARC_END_CUTS[1] if ends else ()))
        breaks += [mesh.breaks[k] + share * mesh.segment_widths[k] for share in cuts] + [mesh.breaks[k + 1]]
        degrees += [max(degree, SINGULAR_SEGMENT_MIN_POINTS) if singular[k] else degree] * (len(cuts) + 1)
    return Mesh(tuple(breaks), tuple(degrees), tuple(movable))


def transform_to_goh_variables(cone: CriticalCone, samples: Sequence[PhaseSamples]) -> CriticalCone:
    """Return the cone with singular controls varied by their integrals, unless limits fix them.

    Times at which only such an arc begins or ends are fixed.
    """
    strong, blocks = cone.strong.copy(), []
    squares = compute_variation_norm_weights(cone.point.transcription)
    is_unchanged = np.ones(squares.size, dtype=bool)
    for s in samples:
        part = cone.point.transcription.parts[s.phase.name]
        singular = _find_undetermined_singular_segments(cone, s)
        strong[_list_junction_time_variables(s, part, singular)] = True
        for i in map(int, np.flatnonzero(np.any(singular, axis=1))):
            if singular[i, -1]:
                final_states = part.collocation.boundary_states[_find_states_driven_by_controls(s, i), -1]
                squares[final_states] = 0.5 * part.collocation.mesh.segment_widths[-1]
            block, replaced = _build_integrated_control_variations(squares.size, part, i, singular[i])
            is_unchanged[replaced] = False
            blocks.append(block)
    if not blocks:
        return cone
    unchanged = scipy.sparse.diags_array(1 / np.sqrt(squares), format="csc")[:, np.flatnonzero(is_unchanged)]
    unit = scipy.sparse.csc_array(scipy.sparse.hstack([unchanged, *blocks]))
    return replace(cone, strong=strong, unit=unit)


def _find_undetermined_singular_segments(cone: CriticalCone, s: PhaseSamples) -> Mask:
    """Return the segments of the cone's mesh (n_controls, K) on which a control is singular and undetermined."""
    part = cone.point.transcription.parts[s.phase.name]
    singular = mask_singular_segments(s)
    if np.any(singular):
        singular &= ~_mask_segments_with_control_curvature(cone.point.problem, s)
    segments = _map_refined_to_coarse_segments(s.phase.mesh, part.collocation.mesh)
    return singular[:, segments] & _mask_segments_without_active_limits(cone, part)


def _mask_segments_with_control_curvature(problem: Problem, s: PhaseSamples) -> Mask:
    """Return the segments (n_controls, K) on which the second variation has curvature in the controls themselves."""
    mask = np.zeros((s.phase.controls.size, s.phase.mesh.segments), dtype=bool)
    for arc in analyse_singular_arcs(problem, s, *mask_undetermined_controls(s, AT_LIMIT), AT_LIMIT):
        is_unknown = arc.why.startswith(TOO_LARGE) or (arc.why.startswith(COUPLED) and arc.least >= -EQUAL)
        if arc.order == 0 and arc.why and not is_unknown:
            for i in arc.channels:
                mask[i, s.segments[slice(*arc.samples)]] = True
    return mask


def _map_refined_to_coarse_segments(mesh: Mesh, fine: Mesh) -> Indices:
    middles = compute_interval_midpoints(np.asarray(fine.breaks))
    return np.asarray(np.searchsorted(np.asarray(mesh.breaks), middles) - 1)


def _mask_segments_without_active_limits(cone: CriticalCone, part: PhaseIndices) -> Mask:
    """Return the segments (n_controls, K) without a fixed control, state or path constraint."""
    collocation, n = part.collocation, cone.point.x.size
    is_inner = ~np.isin(collocation.point_states, collocation.boundary_states)
    others_fixed = np.any(cone.strong[:n][collocation.point_states] & is_inner, axis=0)
    others_fixed |= np.any(cone.strong[n:][collocation.path_rows], axis=0)
    is_fixed = cone.strong[:n][collocation.point_controls] | others_fixed
    return ~np.logical_or.reduceat(is_fixed, collocation.mesh.point_offsets[:-1], axis=1)


def _list_junction_time_variables(s: PhaseSamples, part: PhaseIndices, singular: Mask) -> Indices:
    """Return the time variables at which singular arcs begin or end without a bound-to-bound jump of a control."""
    movable, switches = s.phase.mesh.movable, find_bound_to_bound_switches(s)[0]
    is_singular = np.any(singular, axis=0)
    times = [
        part.times[k]
        for k, (boundary, j) in enumerate(zip(part.collocation.mesh.movable, movable, strict=True), 1)
        if (is_singular[boundary - 1] or is_singular[boundary]) and s.phase.breaks[j] not in switches
    ]
    return np.array(times, dtype=int)


def find_cost_reducing_final_pulse(cone: CriticalCone, s: PhaseSamples) -> tuple[str, float]:
    r"""Return a control, singular up to the end, whose final pulse may reduce the cost, and its relative curvature.

    Either cost and end conditions do not depend on the displacement by h, or the form has positive curvature in h,
    :math:`h^T (B^T \ell'' B + H_{ux} B) h > 0` in the directions free of the conditions. If it is negative, a pulse
    just before the end reduces the cost.
    """
    channels = np.flatnonzero(_find_undetermined_singular_segments(cone, s)[:, -1])
    if not channels.size or not _do_end_conditions_depend_on_controls(cone.point.problem, s, channels):
        return "", np.inf
    point, n, span = cone.point, cone.point.x.size, s.control_span[channels] * s.span
    final_states = point.transcription.parts[s.phase.name].collocation.boundary_states[:, -1]
    end_values = (v[..., -1:] for v in (s.times, s.x, s.u, s.lam))
    numbers = s.functions.weights, s.functions.p, s.functions.q
    slopes = _build_hamiltonian_mixed_derivatives(point.problem, s)(*end_values, *numbers)[0].full()
    by_control = (
        s.functions.dynamics_control_jacobian(s.times[-1:], s.x[:, -1:], s.u[:, -1:])[:, channels, 0] * span
    )
    mixed_curvature = span[:, None] * slopes[channels] @ by_control
    by_control = by_control / point.scaling.variables[final_states, None]
    ends = point.lagrangian_hessian[final_states][:, final_states] / point.scaling.objective
    form = by_control.T @ ends @ by_control + 0.5 * (mixed_curvature + mixed_curvature.T)
    rows = np.intersect1d(point.transcription.constraint_rows, np.flatnonzero(cone.strong[n:]))
    by_constraint = point.constraint_jacobian[rows][:, final_states] @ by_control
    fixed = np.vstack([by_constraint, by_control[cone.strong[:n][final_states]]])
    basis = scipy.linalg.null_space(fixed, rcond=RANK) if np.any(fixed) else np.eye(channels.size)
    magnitude = s.hamiltonian_scale * s.span
    smallest = float(np.min(np.linalg.eigvalsh(basis.T @ form @ basis), initial=np.inf))
    if smallest > AT_LIMIT * magnitude:
        return "", np.inf
    sign = "negative" if smallest < -AT_LIMIT * magnitude else "zero"
    label = s.phase.controls.labels[channels[0]]
    return (
        f"phase {s.phase.name}, {label}: the curvature of the cost along a final impulse of the control is {sign}",
        smallest / max(magnitude, s.cost_magnitude),
    )


def _do_end_conditions_depend_on_controls(problem: Problem, s: PhaseSamples, channels: Indices) -> bool:
    """Return whether end conditions or cost, apart from costates, depend on the states that controls move."""
    driven = np.concatenate([_find_states_driven_by_controls(s, i) for i in map(int, channels)])
    ends, final = get_endpoint_function(problem), 6 * list(problem.phases).index(s.phase.name) + 1
    relevant = [i for output in (0, 1) for i in ends.jac_sparsity(output, final).get_col()]
    # Vector fields of several controls need not have common straightening coordinates.
    slopes = _build_hamiltonian_mixed_derivatives(problem, s).sparsity_out(1 if channels.size == 1 else 0)
    relevant += [i for k, i in zip(slopes.row(), slopes.get_col(), strict=True) if k in channels]
    is_limited = np.logical_or(*s.phase.final_bounds.is_near_limits(s.x[:, -1], AT_LIMIT * s.state_scale))
    return bool(np.any(np.isin(driven, relevant)) or np.any(is_limited[driven]))


def _build_hamiltonian_mixed_derivatives(problem: Problem, s: PhaseSamples) -> Any:
    """Return the Function of d2H/(du dx), and of the same with zero costates, which leaves the integrands."""

    def build_mixed_derivative_function() -> Any:
        slope = s.functions.functions["switching"]
        t, x, u, lam, mu, *numbers = (ca.SX.sym("v", slope.size1_in(i)) for i in range(8))
        no_mu = np.zeros(mu.shape)
        mixed = [ca.jacobian(slope(t, x, u, costates, no_mu, *numbers), x) for costates in (lam, 0 * lam)]
        return ca.Function("mixed", [t, x, u, lam, *numbers], mixed)

    return problem.memoize(("mixed derivatives", s.phase.name), build_mixed_derivative_function)


def _find_states_driven_by_controls(s: PhaseSamples, control: int) -> Indices:
    moves = s.functions.functions["rates"].jac_sparsity(0, 2)
    return np.unique(np.array(moves.row(), dtype=int)[np.array(moves.get_col(), dtype=int) == control])


def _build_integrated_control_variations(
    n: int, part: PhaseIndices, control: int, singular: Mask
) -> tuple[Any, Indices]:
    """Return variations y of a control of a phase (n, n_variations), and the variables that they replace."""
    collocation, count = part.collocation, 0
    mesh, entries, squares = collocation.mesh, [], []
    segments = np.flatnonzero(singular)
    for k, next_segment in zip(segments, np.append(segments[1:], mesh.segments), strict=True):
        # Radau's rule, reversed to include the end of the segment.
        nodes, shares = (sign * rule("LGR", mesh.degrees[k] - LOWER_DEGREE)[::-1] for rule, sign in _RADAU)
        slopes = build_differentiation_matrix(np.append(-1.0, nodes), collocation.collocation_rules[k].points)
        indices = collocation.point_controls[control, mesh.point_offsets[k] : mesh.point_offsets[k + 1]]
        columns = np.arange(count - 1, count + nodes.size)[int(count == 0) :]  # y = 0 at the start
        slopes = 2 / mesh.segment_widths[k] * slopes[:, int(count == 0) :]
        entries.append((np.repeat(indices, columns.size), np.tile(columns, indices.size), slopes.ravel()))
        count += nodes.size
        squares.append(0.5 * mesh.segment_widths[k] * shares)
        squares[-1][-1] += mesh.breaks[next_segment] - mesh.breaks[k + 1]
    rows, columns, values = map(np.concatenate, zip(*entries, strict=True))
    block = scipy.sparse.csc_array((values, (rows, columns)), shape=(n, count))
    return block @ scipy.sparse.diags_array(1 / np.sqrt(np.concatenate(squares))), np.unique(rows)
