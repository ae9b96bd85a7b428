r"""Covector mapping: costates, multiplier densities and impulses from the multipliers of the nonlinear program.

With the multipliers :math:`m = W^T \Lambda` of the point values, the Lagrangian contains
:math:`\sum_j m_j^T \Delta\, f(t_j, X_j, U_j)`, a quadrature of :math:`\int \lambda^T f\,dt` with weights
:math:`\omega_j` (fractions of the arc, sum 1). For every scheme therefore

.. math:: \lambda(t_j) = m_j / \omega_j ,

for LG :math:`-\Lambda_j / w_j` with Gauss weights w_j. At segment boundaries the costate is the derivative of the
segment's part of the Lagrangian in the shared boundary state, with + at the start and - at the end of the segment, as
:math:`\lambda(t_0) = \partial J^* / \partial x_0` in the continuous problem. The boundary values converge twice as
fast as those at the points (for LG all do).

**Between the points** the costate is :math:`\lambda(t) = \lambda_k - \int (H_x + \mu^T c_x + z)\,dt` from the start
of a segment, with the interpolating polynomial of the integrand. This agrees with the value at the end of the segment,
and for LG with the point values; for LGR and LGL it is more accurate than those by one order.

**Active state constraints.** At a collocation point on a segment boundary, the multiplier of a bound or of a pure state
constraint is the sum of a density and an impulse (a jump of the costate). Next to a segment without an active
constraint it is treated as an impulse. Along an active segment the one-sided costates are those of the points, and
the remainder in the stationarity of the boundary state is the density. LG has no such point: a bound active at every
node makes the row of the end state redundant, and the bound multipliers oscillate like :math:`e_j` (the coefficients of
the row). The costate is then extrapolated from the points without that oscillation.

**Pure state constraints as path constraints.** Gauss collocation has no row for the atom of the measure at the end of
an arc: it is distributed over the multipliers of the points, which oscillate, while the costates there are correct.
One-sided costates at segment ends are extrapolated in the direction of the constraint gradient. The density is the
residual of the adjoint equation along that gradient.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.array_types import Array, Mask
from gnc_opt.numerical_tolerances import AT_LIMIT, NEGLIGIBLE, SMALL
from gnc_opt.planning.problem.active_constraint_arcs import FixedArcs
from gnc_opt.planning.problem.hamiltonian_functions import PhaseFunctions
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial
from gnc_opt.planning.transcription.collocation import PhaseCollocation
from gnc_opt.planning.transcription.collocation_families import GAUSS
from gnc_opt.planning.transcription.quadrature import build_lagrange_interpolation_matrix


def correct_constraint_arc_costates(
    phase: PhaseSolution, fixed_arcs: FixedArcs | None, functions: PhaseFunctions
) -> PhaseSolution:
    """Return a phase solution with costates and multipliers corrected along active segments."""
    if fixed_arcs is None or not fixed_arcs.paths or phase.scheme != GAUSS:
        return phase
    at_limit = np.array([[kind.is_at_limit for kind in row] for row in fixed_arcs.paths])
    at_limit &= ~functions.mixed_path_constraints[:, None]
    if not np.any(at_limit):
        return phase
    start, end, values = phase.lam_start.copy(), phase.lam_end.copy(), [v.copy() for v in phase.lam.values]
    signals = phase.x, phase.u, phase.interpolate_point_values(phase.point_costates)
    x, u, point_costates = (signal.evaluate_at_normalised_times([-1.0, 1.0]) for signal in signals)
    for k in np.flatnonzero(np.any(at_limit, axis=0)):
        for i, boundary_costates in enumerate((start, end)):
            gradients = functions.path_state_jacobian(phase.breaks[k + i], x[:, k, i], u[:, k, i])
            directions = gradients[at_limit[:, k]].T
            difference = point_costates[:, k, i] - boundary_costates[:, k]
            boundary_costates[:, k] += directions @ np.linalg.lstsq(directions, difference, rcond=None)[0]
        values[k][:, -1] = end[:, k]
    lam = PiecewisePolynomial(phase.breaks, phase.lam.nodes, tuple(values))
    at_points = np.repeat(at_limit, phase.mesh.degrees, axis=1)
    multipliers = _solve_path_multipliers(phase, lam, functions, at_points)
    return replace(phase, lam=lam, lam_start=start, lam_end=end, path_multipliers=multipliers)


def _solve_path_multipliers(
    phase: PhaseSolution, lam: PiecewisePolynomial, functions: PhaseFunctions, at_limit: Mask
) -> Array:
    """Return the path multipliers; at their limits they are the residual of the adjoint equation."""
    mu = phase.path_multipliers.copy()
    active_points = np.flatnonzero(np.any(at_limit, axis=0))
    times, other_mu = phase.point_times[active_points], np.where(at_limit, 0.0, mu)[:, active_points]
    x, u = phase.x(times), phase.u(times)
    residual = -lam.derivative()(times) - functions.state_gradient(times, x, u, lam(times), other_mu)
    gradients = functions.path_state_jacobian(times, x, u)
    for j, point in enumerate(active_points):
        rows = np.flatnonzero(at_limit[:, point])
        mu[rows, point] = np.linalg.lstsq(gradients[rows, :, j].T, residual[:, j], rcond=None)[0]
    return mu


@dataclass(frozen=True, eq=False)
class NlpIterate:
    """Physical x, lam_x (n_variables,) and lam_g (n_constraints,); multipliers of the minimised functional."""

    x: Array
    lam_x: Array
    lam_g: Array


def compute_costates_at_collocation_points(collocation: PhaseCollocation, lam_g: Array) -> Array:
    """Return the costates at the collocation points (n_states, N): m_j / omega_j."""
    pieces = []
    for k, rule in enumerate(collocation.collocation_rules):
        # The factor w_k / 2 of multipliers and quadrature weights cancels.
        multipliers = lam_g[collocation.dynamics_rows[k]]
        pieces.append(-multipliers @ collocation.build_dynamics_rate_matrix(k) / rule.weights)
    return np.hstack(pieces)


def invert_costate_map(collocation: PhaseCollocation, costates: Array, end_costates: Array) -> list[Array]:
    """Return the row multipliers of each segment for costates (n_states, N) and end costates (n_states, K; LG)."""
    pieces: list[Array] = []
    for k, rule in enumerate(collocation.collocation_rules):
        weighted = -costates[:, _get_segment_point_slice(collocation, k)] * rule.weights
        if collocation.family.has_dynamics_row_at_segment_end:
            pieces.append(np.hstack([weighted, -end_costates[:, [k]]]))
        else:
            matrix = collocation.build_dynamics_rate_matrix(k)
            pieces.append(np.asarray(np.linalg.lstsq(matrix.T, weighted.T, rcond=None)[0].T))
    return pieces


def split_duplicate_multipliers(
    collocation: PhaseCollocation, paths: Array, weights: Array, mixed: Mask
) -> Array:
    """Distribute the multipliers of path constraints that LGL contains twice.

    At a segment boundary only the sum of both is unique. One active side gets all, two get equal densities. ``paths``
    (n_paths, N) are densities; ``mixed`` constraints, which depend on controls, keep theirs.
    """
    if not collocation.family.ends_at_point or not paths.size:
        return paths
    split = paths.copy()
    spans = np.repeat(_compute_segment_durations(collocation, weights), collocation.mesh.degrees)
    nonzero = np.abs(paths) * spans > NEGLIGIBLE * np.max(np.abs(paths) * spans, axis=1, keepdims=True)
    shared = np.isin(np.arange(collocation.mesh.size), [*collocation.mesh.point_offsets[1:-1]])
    shared |= np.append(shared[1:], False)
    active = _mask_segments_with_multipliers(collocation, nonzero, np.tile(shared, (paths.shape[0], 1)))
    for k, right in enumerate(collocation.mesh.point_offsets[1:-1]):
        shares = np.stack([active[:, k] * weights[right - 1], active[:, k + 1] * weights[right]], axis=1)
        total = paths[:, right - 1 : right + 1] @ weights[right - 1 : right + 1]
        rows = ~mixed & np.any(shares > 0, axis=1)
        density = total[rows] / np.sum(shares[rows], axis=1)
        split[rows, right - 1], split[rows, right] = density * active[rows, k], density * active[rows, k + 1]
    return split


@dataclass(eq=False)
class PhaseCostates:
    """Result of the covector mapping for one phase with N points and K segments.

    At the points: quadrature ``weights`` (N,) in s; costates ``lam``, state bound multipliers ``densities`` per second,
    ``decay`` = -d(lambda)/dt without impulses, whether a bound (``bounded``) or any constraint (``nonzero``) has a
    nonzero multiplier, (n_states, N) each. In the segments: one-sided costates ``start`` and ``end``, whether an active
    constraint contributes to the costate rate (``active``), whether the state is constant (``steady``),
    (n_states, K) each. At segment boundaries: ``impulses`` (n_states, K + 1), multipliers of state bounds and ends.
    """

    collocation: PhaseCollocation
    weights: Array
    lam: Array
    start: Array
    end: Array
    densities: Array
    impulses: Array
    decay: Array
    active: Mask
    steady: Mask
    nonzero: Mask
    bounded: Mask

    @classmethod
    def from_multipliers(
        cls, collocation: PhaseCollocation, iterate: NlpIterate, weights: Array, gradient: Array, pure: Array
    ) -> PhaseCostates:
        """Return the costates and state bound multipliers of a phase.

        ``gradient`` is d(H + mu.c)/dx at the points (n_states, N); ``pure`` is the contribution of pure state
        path constraints to it.
        """
        x, lam_x, lam_g = iterate.x, iterate.lam_x, iterate.lam_g
        lam = compute_costates_at_collocation_points(collocation, lam_g)
        at_boundary = np.isin(collocation.point_states, collocation.boundary_states)
        multipliers = lam_x[collocation.point_states] / weights
        densities = np.where(at_boundary, 0.0, multipliers)
        # At the end of a phase a path constraint contributes its density; inside, see the module docstring.
        at_break = np.isin(collocation.point_states, collocation.boundary_states[:, 1:-1])
        decay = gradient - np.where(at_break, pure, 0.0) + densities
        start, end = _compute_boundary_costates(collocation, lam_g, weights * decay)
        size = np.max(np.abs(lam), axis=1, keepdims=True, initial=0.0)
        spans = np.repeat(_compute_segment_durations(collocation, weights), collocation.mesh.degrees)
        bounded = np.abs(np.where(at_boundary & ~at_break, 0.0, multipliers)) * spans > NEGLIGIBLE * size
        nonzero = bounded | (np.abs(pure) * spans > NEGLIGIBLE * size)
        active = _mask_segments_with_multipliers(collocation, nonzero, at_boundary)
        segments = range(collocation.mesh.segments)
        variations = [np.ptp(x[collocation.index_segment_states(k)], axis=1) for k in segments]
        sizes = np.max(np.abs(x[collocation.point_states]), axis=1)
        steady = np.stack(variations, axis=1) <= AT_LIMIT * sizes[:, None]
        impulses = lam_x[collocation.boundary_states]
        rates_and_masks = (decay, active, steady, nonzero, bounded)
        costates = cls(collocation, weights, lam, start, end, densities, impulses, *rates_and_masks)
        if collocation.family.has_dynamics_row_at_segment_end:
            costates.extrapolate_costates_along_bounds()
        else:
            costates.split_boundary_multipliers()
        return costates

    def split_boundary_multipliers(self) -> None:
        """LGR, LGL: use the costates of the points at the ends of active segments; separate densities from impulses."""
        collocation = self.collocation
        for k in range(collocation.mesh.segments):
            j = _get_segment_point_slice(collocation, k)
            self._split_density_and_impulse(k, k, j.start, self.start, 1.0)
            if collocation.family.ends_at_point:
                self._split_density_and_impulse(k, k + 1, j.stop - 1, self.end, -1.0)

    def _split_density_and_impulse(self, k: int, boundary: int, point: int, side: Array, sign: float) -> None:
        """Replace a costate jump at a segment boundary by a multiplier density and an impulse of the active bounds."""
        bounded, rows = self.bounded[:, point], self.active[:, k] & self.nonzero[:, point]
        if boundary in (0, self.collocation.mesh.segments):
            # A fixed end value has a multiplier too; it is attributed to the bound if that is active up to the end of
            # the phase.
            j = _get_segment_point_slice(self.collocation, k)
            rows = bounded = self.steady[:, k] & np.any(self.bounded[:, j], axis=1)
        difference = sign * (self.lam[:, point] - side[:, k])
        side[rows, k] = self.lam[rows, point]
        rows = rows & bounded
        self.densities[rows, point] = difference[rows] / self.weights[point]
        self.impulses[rows, boundary] -= difference[rows]

    def extrapolate_costates_along_bounds(self) -> None:
        """LG: extrapolate the costate of the points if a bound is active at every node of a segment."""
        for k, rule in enumerate(self.collocation.collocation_rules):
            j = _get_segment_point_slice(self.collocation, k)
            rows = self.steady[:, k] & np.any(self.bounded[:, j], axis=1)
            to_end = build_lagrange_interpolation_matrix(rule.points, [1.0])[0]
            change = self.lam[:, j] @ to_end - self.end[:, k]
            change = np.where(rows, change, 0.0)
            densities = self.densities[:, j] - np.outer(change, rule.end_values[1:]) / self.weights[j]
            # The state is nearly constant on a segment with a touch point too; there the correction would reverse the
            # signs of multipliers.
            pushes = densities * self.weights[j]
            reverses = np.minimum(-np.min(pushes, axis=1), np.max(pushes, axis=1)) > SMALL * np.abs(change)
            change = np.where(reverses, 0.0, change)
            self.end[:, k] += change
            self.start[:, k] += change * rule.end_values[0]
            self.densities[:, j] -= np.outer(change, rule.end_values[1:]) / self.weights[j]
            self.impulses[:, k + 1] += change
            self.impulses[:, k] -= change * rule.end_values[0]

    def build_costate_polynomial(self, breaks: Array) -> PiecewisePolynomial:
        """Return the costates between the points."""
        collocation = self.collocation
        nodes, values = [], []
        for k, rule in enumerate(collocation.collocation_rules):
            j = _get_segment_point_slice(collocation, k)
            if collocation.family.has_dynamics_row_at_segment_end:
                nodes.append(np.append(rule.points, 1.0))
                values.append(np.hstack([self.lam[:, j], self.end[:, [k]]]))
                continue
            half = 0.5 * (breaks[k + 1] - breaks[k])
            integration_matrix = rule.build_integration_matrix(rule.state_nodes)
            integrated = self.start[:, [k]] - half * self.decay[:, j] @ integration_matrix.T
            fitted = self.lam[:, j] @ build_lagrange_interpolation_matrix(rule.points, rule.state_nodes).T
            if not collocation.family.ends_at_point:
                fitted[:, -1] = self.end[:, k]
            nodes.append(rule.state_nodes)
            values.append(np.where(self.active[:, [k]], fitted, integrated))
        return PiecewisePolynomial(breaks, tuple(nodes), tuple(values))


def _get_segment_point_slice(collocation: PhaseCollocation, k: int) -> slice:
    return slice(collocation.mesh.point_offsets[k], collocation.mesh.point_offsets[k + 1])


def _compute_segment_durations(collocation: PhaseCollocation, weights: Array) -> Array:
    return np.add.reduceat(weights, collocation.mesh.point_offsets[:-1])


def _mask_segments_with_multipliers(collocation: PhaseCollocation, nonzero: Mask, at_boundary: Mask) -> Mask:
    """Return the segments with a multiplier at an interior point or (trapezoidal rule) all points; (n_states, K)."""
    columns = []
    for k in range(collocation.mesh.segments):
        points = _get_segment_point_slice(collocation, k)
        inner, mask = ~at_boundary[:, points], nonzero[:, points]
        columns.append(np.where(inner.any(axis=1), np.any(mask & inner, axis=1), np.all(mask, axis=1)))
    return np.stack(columns, axis=1)


def _compute_boundary_costates(
    collocation: PhaseCollocation, lam_g: Array, point_gradients: Array
) -> tuple[Array, Array]:
    """Return the costates at the start and at the end of every segment, (n_states, K) each."""
    starts, ends = [], []
    for k in range(collocation.mesh.segments):
        derivative = lam_g[collocation.dynamics_rows[k]] @ collocation.build_dynamics_state_matrix(k)
        first, last = collocation.mesh.point_offsets[k], collocation.mesh.point_offsets[k + 1] - 1
        start, end = derivative[:, 0], derivative[:, -1]
        if collocation.family.starts_at_point:
            start = start + point_gradients[:, first]
        if collocation.family.ends_at_point:
            end = end + point_gradients[:, last]
        starts.append(start)
        ends.append(-end)
    return np.stack(starts, axis=1), np.stack(ends, axis=1)
