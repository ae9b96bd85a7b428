r"""Estimated costates and multipliers of a given trajectory: least-squares solution of the first-order conditions.

On the mesh of the trajectory (Legendre-Gauss), stationarity in states, controls, free times, parameters and jump times
of the controls is :math:`\nabla f + g'^T\lambda_g + \lambda_x = 0`, linear in the multipliers. Multipliers of inactive
limits are zero. The row of a variable at its limit is omitted, unless its multiplier would have the wrong sign. The
result is mapped to costates like the multipliers of a solver (module `costates`).

At a touch point, entry or exit of a pure state constraint :math:`c(t, x) \le 0`, its multiplier has an atom
:math:`\eta \ge 0`: the costate jumps by :math:`-\eta\,\partial c/\partial x` (Hartl, Sethi & Vickson, SIAM Review
37(2), 1995, theorem 4.1). Since a program has rows at its collocation points only, terms :math:`\eta\,c(t_k, x_k)` at
segment boundaries are added to its Lagrangian: at arc ends of order two or more, touch points and phase ends.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy

from gnc_opt.array_types import Array, Indices, Mask, compute_interval_midpoints
from gnc_opt.numerical_tolerances import ACTIVE, NEGLIGIBLE, ROUNDING, TINY, max_norm, replace_zeros_by_one
from gnc_opt.planning.optimality.controllability_gramian import exponentiate_matrices
from gnc_opt.planning.optimality.kkt_system import compute_quadrature_weights
from gnc_opt.planning.optimality.trajectory_interpolation import FittedPhase
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.hamiltonian_functions import PhaseFunctions
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.state_constraint_order import get_constraint_order
from gnc_opt.planning.solution.costates import NlpIterate
from gnc_opt.planning.solution.initial_nlp_point import set_integral_variables_by_quadrature
from gnc_opt.planning.solution.solution_from_nlp_result import bind_parameters
from gnc_opt.planning.solution.state_and_control_scales import SPAN_MIN_SHARE
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.nlp_layout import PhaseIndices
from gnc_opt.planning.transcription.scaling import choose_variable_scales
from gnc_opt.planning.transcription.transcription import Transcription


def _find_jump_candidates(
    transcription: Transcription,
    problem: Problem,
    fitted: Mapping[str, FittedPhase],
    q: Array,
    scales: Array,
    share: float,
) -> tuple[Any, Array, _ActiveSet]:
    """Return the pure state path constraints that may have atoms at segment boundaries, along a trajectory.

    They are gradients in the program's variables, sparse (n_variables, n_atoms), variations of the constraints, and
    active limits; ``scales`` (n_variables,) are variations of the variables.
    """
    no_rows = np.zeros(0, dtype=bool)
    candidates = [(scipy.sparse.csc_array((transcription.n_variables, 0)), np.zeros(0), no_rows, no_rows)]
    for name, part in transcription.parts.items():
        functions, phase, fit = (bind_parameters(problem, name, q), problem.phases[name], fitted[name])
        orders = [get_constraint_order(problem, phase, i).order for i in range(len(phase.path_labels))]
        state_rows = np.flatnonzero([order != 0 for order in orders])
        times = fit.x.breaks
        # A shared value belongs to the segment that starts there; the last one to the last segment.
        x, u = fit.x(times), fit.u(times)
        variables, gradients = differentiate_path_constraints(transcription, part, functions, (times, x, u))
        gradients = gradients[:, state_rows]
        sizes = np.sum(np.abs(gradients) * scales[variables][:, None], axis=0)
        values, limits = functions.path_constraints(times, x, u)[state_rows], phase.get_path_bounds()
        at_lower = values <= limits.lower[state_rows, None] + share * sizes
        at_upper = values >= limits.upper[state_rows, None] - share * sizes
        touched_only = np.array([orders[i] == 1 for i in state_rows])
        possible = _mask_possible_costate_jumps(at_lower | at_upper, touched_only)
        constraint, k = np.nonzero(possible)
        entries = variables[:, k].ravel(), np.tile(np.arange(constraint.size), variables.shape[0])
        shape = scales.size, constraint.size
        matrix = scipy.sparse.csc_array((gradients[:, constraint, k].ravel(), entries), shape=shape)
        candidates.append((matrix, sizes[possible], at_lower[possible], at_upper[possible]))
    matrices, *arrays = zip(*candidates, strict=True)
    sizes, lower, upper = map(np.concatenate, arrays)
    return scipy.sparse.hstack(matrices, format="csc"), sizes, _ActiveSet(lower, upper)


def differentiate_path_constraints(
    transcription: Transcription,
    part: PhaseIndices,
    functions: PhaseFunctions,
    trajectory: tuple[Array, Array, Array],
) -> tuple[Indices, Array]:
    """Return the gradients of path constraints at segment boundaries of a phase in the variables of the program.

    ``trajectory`` are times (K + 1,), states and controls there. Returns the indices of the variables (states, free
    times, free parameters) (k, K + 1) and the gradients (k, n_paths, K + 1).
    """
    collocation, n = part.collocation, trajectory[0].size
    by_time, by_state, by_parameter = functions.path_gradients(*trajectory)
    is_free = part.times < transcription.n_variables
    common_variables = np.concatenate([part.times[is_free], transcription.parameter_indices])
    by_anchor = _differentiate_break_times(collocation.mesh)[is_free]
    return (
        np.vstack([collocation.boundary_states, np.repeat(common_variables[:, None], n, axis=1)]),
        np.concatenate([by_state, by_anchor[:, None] * by_time, by_parameter]),
    )


def _mask_possible_costate_jumps(active: Mask, touched_only: Mask) -> Mask:
    """Return where active constraints (n, K + 1) may have an atom: not inside arcs, nor at the ends of certain arcs."""
    before, after = np.zeros_like(active), np.zeros_like(active)
    before[:, 1:], after[:, :-1] = active[:, :-1], active[:, 1:]
    inside_arc = np.where(touched_only[:, None], before | after, before & after)
    inside_arc[:, [0, -1]] = False
    return np.asarray(active & ~inside_arc)


def _differentiate_break_times(mesh: Mesh) -> Array:
    """Return the derivatives of the boundary times in the anchor times (n_anchors, K + 1)."""
    fractions = np.asarray(mesh.breaks)
    anchors = fractions[list(mesh.arc_breaks)]
    return np.array([np.interp(fractions, anchors, unit) for unit in np.eye(anchors.size)])


MAX_TRANSITION_NORM = 1e4
"""Growth of adjoint errors above which costates at a boundary become additional unknowns."""

_ACTIVE_SET_MAX_ITERATIONS, _SIGN_MAX_ITERATIONS, _SIGN_MAX_ENTRIES = 8, 300, 5e6
"""Largest numbers of iterations of the active set, and of iterations (it needs few) and dense matrix entries (some
seconds) of the linear program for the signs."""


def estimate_multipliers(
    transcription: Transcription,
    problem: Problem,
    fitted: Mapping[str, FittedPhase],
    q: Array,
    share: float = ACTIVE,
) -> NlpIterate:
    """Return the program's variables at a trajectory, and the multipliers that explain it best.

    ``q`` are the free parameters; a limit may be active up to a distance of ``share``, relative to the scale.
    """
    x = _sample_trajectory_variables(transcription, problem, fitted, q)
    scales = _estimate_variable_scales(transcription, problem, fitted, x)
    values, gradient, nonzeros = transcription.evaluate_nlp_first_derivatives(problem, x)
    rows, columns = transcription.constraints.jacobian_pattern
    steepest = np.zeros(transcription.n_constraints)
    np.maximum.at(steepest, rows, np.abs(nonzeros * scales[columns]))
    row_scales = 1 / replace_zeros_by_one(steepest)
    factor = 1 / max(float(np.max(np.abs(gradient * scales))), TINY)
    shape = (transcription.n_variables, transcription.n_constraints)
    weights = scales / np.sqrt(compute_quadrature_weights(transcription)[0])
    matrix = scipy.sparse.csc_array(
        (nonzeros * weights[columns] * row_scales[rows], (columns, rows)), shape=shape
    )
    limits = _ActiveSet.determine_active_set(transcription.get_variable_bounds(problem), x, share * scales)
    row_limits = _ActiveSet.determine_active_set(
        transcription.get_constraint_bounds(problem), values, share / row_scales
    )
    gradients, sizes, at_limits = _find_jump_candidates(transcription, problem, fitted, q, scales, share)
    jumps = scipy.sparse.diags_array(weights) @ gradients
    jumps = jumps @ scipy.sparse.diags_array(1 / replace_zeros_by_one(sizes))
    with_atoms = scipy.sparse.hstack([matrix, jumps], format="csc")
    all_limits = _ActiveSet(
        np.append(row_limits.lower, at_limits.lower), np.append(row_limits.upper, at_limits.upper)
    )
    restarts = {name: _choose_shooting_nodes(problem, name, phase, q) for name, phase in fitted.items()}
    is_exact = _mask_adjoint_equation_rows(transcription, restarts)
    is_adjoint_multiplier = _mask_adjoint_multipliers(transcription, restarts)
    basis = np.append(is_adjoint_multiplier, np.zeros(sizes.size, dtype=bool))
    scaled = _fit_multipliers(with_atoms, gradient * weights * factor, is_exact, basis, limits, all_limits)
    lam_g = scaled[: values.size] * row_scales / factor
    residual = gradient + scipy.sparse.csc_array((nonzeros, (columns, rows)), shape=shape) @ lam_g
    return NlpIterate(x, np.where(limits.is_at_any_limit, -residual, 0.0), lam_g)


class _ActiveSet:
    """Limits that may be active: multipliers are <= 0 at lower, >= 0 at upper limits, of any sign for equalities."""

    def __init__(self, lower: Mask, upper: Mask) -> None:
        self.lower, self.upper = lower, upper

    @classmethod
    def determine_active_set(cls, box: Interval, values: Array, slack: Array) -> _ActiveSet:
        return cls((values <= box.lower + slack) | box.is_fixed, (values >= box.upper - slack) | box.is_fixed)

    @property
    def is_at_any_limit(self) -> Mask:
        return self.lower | self.upper

    def mask_wrong_multiplier_signs(self, multipliers: Array, size: float) -> Mask:
        """Return which multipliers have an inadmissible sign."""
        sign = np.where(np.abs(multipliers) > NEGLIGIBLE * size, np.sign(multipliers), 0.0)
        return self.is_at_any_limit & (((sign > 0) & ~self.upper) | ((sign < 0) & ~self.lower))


class _CostateFit:
    """Least-squares problem in the multipliers that the adjoint equation does not determine, with its rows eliminated.

    The residuals of the remaining rows are ``right + matrix @ unknowns``. The unknowns are the multipliers ``columns``
    and those of the eliminated rows ``freed``. For an exactly singular adjoint equation SciPy raises `RuntimeError`.
    """

    def __init__(
        self, matrix: Any, gradient: Array, exact: Mask, basis: Mask, limits: _ActiveSet, row_set: _ActiveSet
    ) -> None:
        self._loose, self.columns = np.flatnonzero(~exact), np.flatnonzero(row_set.is_at_any_limit & ~basis)
        self.freed, rows = np.flatnonzero(limits.is_at_any_limit & exact), np.flatnonzero(exact)
        self._basis, self._size = np.flatnonzero(basis), matrix.shape[1]
        matrix = scipy.sparse.csr_array(matrix)
        exact_rows, other_rows = matrix[rows], matrix[self._loose]
        factors = scipy.sparse.linalg.splu(scipy.sparse.csc_array(exact_rows[:, self._basis]))
        freed_columns = np.zeros((rows.size, self.freed.size))
        freed_columns[np.searchsorted(rows, self.freed), np.arange(self.freed.size)] = 1.0
        right = np.column_stack([exact_rows[:, self.columns].toarray(), freed_columns, gradient[rows]])
        response = -factors.solve(right)
        response -= factors.solve(right + exact_rows[:, self._basis] @ response)
        self.is_singular = not np.all(np.isfinite(response))
        reduced = other_rows[:, self._basis] @ response
        reduced[:, : self.columns.size] += other_rows[:, self.columns].toarray()
        reduced[:, -1] += gradient[self._loose]
        # The row of a derivative that is not finite, such as that of a norm at zero, is omitted.
        reduced[~np.all(np.isfinite(reduced), axis=1)] = 0.0
        self.matrix, self.right, self._response = reduced[:, :-1], reduced[:, -1], response

    def solve_least_squares(self, imposed: Mask, allowed: Mask) -> Array:
        """Return the unknowns with the smallest residual of the imposed rows; inactive ones are zero."""
        used = np.concatenate([allowed[self.columns], ~imposed[self.freed]])
        rows = imposed[self._loose]
        block = self.matrix[np.ix_(rows, used)]
        unknowns = np.zeros(used.size)
        if block.size:
            sizes = replace_zeros_by_one(np.linalg.norm(block, axis=0))
            scaled = scipy.linalg.lstsq(block / sizes, -self.right[rows], ROUNDING, lapack_driver="gelsy")[0]
            unknowns[used] = scaled / sizes
        return unknowns

    def compute_dual_residuals(self, unknowns: Array, n_rows: int) -> Array:
        """Return the residuals of all rows (n_rows,); for freed rows the negative multiplier."""
        residuals = np.zeros(n_rows)
        residuals[self._loose] = self.right + self.matrix @ unknowns
        residuals[self.freed] = -unknowns[self.columns.size :]
        return residuals

    def expand_unknown_multipliers(self, unknowns: Array) -> Array:
        """Return all scaled multipliers (n_multipliers,) for the unknowns."""
        multipliers = np.zeros(self._size)
        multipliers[self.columns] = unknowns[: self.columns.size]
        multipliers[self._basis] = self._response @ np.append(unknowns, 1.0)
        return multipliers


def _fit_multipliers(
    matrix: Any, gradient: Array, exact: Mask, basis: Mask, limits: _ActiveSet, row_limits: _ActiveSet
) -> Array:
    """Return the scaled least-squares multipliers of the rows, without those of inadmissible sign."""
    try:
        fit = _CostateFit(matrix, gradient, exact, basis, limits, row_limits)
    except RuntimeError:
        fit = None
    if fit is None or fit.is_singular:  # no multipliers explain the trajectory
        return np.zeros(matrix.shape[1])
    imposed, allowed = ~limits.is_at_any_limit, row_limits.is_at_any_limit.copy()
    unknowns = np.zeros(fit.matrix.shape[1])
    size = float(np.max(np.abs(fit.right), initial=TINY))
    for _ in range(_ACTIVE_SET_MAX_ITERATIONS):
        unknowns = fit.solve_least_squares(imposed, allowed)
        multipliers = np.zeros(matrix.shape[1])
        multipliers[fit.columns] = unknowns[: fit.columns.size]
        residuals = fit.compute_dual_residuals(unknowns, gradient.size)
        wrong_bounds = limits.mask_wrong_multiplier_signs(-residuals, size) & ~imposed
        largest = float(np.max(np.abs(multipliers), initial=TINY))
        wrong_rows = row_limits.mask_wrong_multiplier_signs(multipliers, largest) & allowed & ~basis
        if not (np.any(wrong_bounds) or np.any(wrong_rows)):
            break
        if not np.any(imposed & limits.is_at_any_limit) and np.all(allowed == row_limits.is_at_any_limit):
            signed = _fit_multipliers_with_right_signs(fit, unknowns, limits, row_limits, size)
            if signed is not None:
                return fit.expand_unknown_multipliers(signed)
        imposed, allowed = imposed | wrong_bounds, allowed & ~wrong_rows
    return fit.expand_unknown_multipliers(unknowns)


def _fit_multipliers_with_right_signs(
    fit: _CostateFit, first: Array, limits: _ActiveSet, row_limits: _ActiveSet, size: float
) -> Array | None:
    """Return unknowns of admissible sign from a linear program, if these fit equally well."""
    n_rows = limits.is_at_any_limit.size
    residual, imposed = fit.compute_dual_residuals(first, n_rows), ~limits.is_at_any_limit
    fits_exactly = max_norm(residual[imposed]) <= NEGLIGIBLE * size  # otherwise the sign does not matter
    if not fits_exactly or fit.matrix.size > _SIGN_MAX_ENTRIES:
        return None
    matrix, right = np.zeros((n_rows, first.size)), np.zeros(n_rows)
    matrix[fit._loose], right[fit._loose] = fit.matrix, fit.right
    matrix[fit.freed, fit.columns.size + np.arange(fit.freed.size)] = -1.0
    at_limit = limits.is_at_any_limit
    # At an active limit the residual -(g + A y) is the multiplier: >= 0 at upper, <= 0 at lower limits.
    only_upper, only_lower = at_limit & ~limits.lower, at_limit & ~limits.upper
    one_sided = np.vstack([matrix[only_upper], -matrix[only_lower]])
    # Multipliers are maximised, so that none is zero at a point with the wrong sign next to it.
    margin = np.ones((one_sided.shape[0], 1))
    remaining = imposed & np.isin(np.arange(n_rows), fit._loose)
    signs = [
        (None if row_limits.lower[k] else 0.0, None if row_limits.upper[k] else 0.0) for k in fit.columns
    ]
    result = scipy.optimize.linprog(
        np.append(np.zeros(first.size), -1.0),
        A_ub=np.hstack([one_sided, margin]),
        b_ub=np.concatenate([-right[only_upper], right[only_lower]]),
        A_eq=np.hstack([matrix[remaining], np.zeros((int(np.sum(remaining)), 1))]),
        b_eq=-right[remaining],
        bounds=[*signs, *([(None, None)] * fit.freed.size), (0.0, size)],
        method="highs",
        options={"maxiter": _SIGN_MAX_ITERATIONS},
    )
    return None if result.status != 0 else np.asarray(result.x[:-1])


def _sample_trajectory_variables(
    transcription: Transcription, problem: Problem, fitted: Mapping[str, FittedPhase], q: Array
) -> Array:
    """Return the variables of a nonlinear program (n_variables,) for given trajectories and free parameters."""
    x = np.zeros(transcription.n_variables)
    for name, part in transcription.parts.items():
        collocation, phase = part.collocation, fitted[name]
        breaks = phase.x.breaks
        points = breaks[0] + collocation.normalised_point_times * (breaks[-1] - breaks[0])
        x[collocation.boundary_states] = phase.x(breaks)
        x[collocation.boundary_states[:, -1]] = phase.x(breaks[-1])
        x[collocation.point_states], x[collocation.point_controls] = phase.x(points), phase.u(points)
        free_times = part.times < transcription.n_variables
        x[part.times[free_times]] = breaks[list(collocation.mesh.arc_breaks)][free_times]
    x[transcription.parameter_indices] = q
    return set_integral_variables_by_quadrature(transcription, problem, x)


def _mask_adjoint_equation_rows(transcription: Transcription, restarts: Mapping[str, Indices]) -> Mask:
    """Return the rows of the adjoint equation between restarts, which hold exactly for any costates there."""
    rows = transcription.mask_interior_states()
    for name, part in transcription.parts.items():
        rows[part.collocation.boundary_states[:, restarts[name]]] = False
    return rows


def _mask_adjoint_multipliers(transcription: Transcription, restarts: Mapping[str, Indices]) -> Mask:
    """Return the multipliers of the dynamics that these rows determine: all but those at phase ends and restarts."""
    columns = np.zeros(transcription.n_constraints, dtype=bool)
    for name, part in transcription.parts.items():
        collocation = part.collocation
        n, mesh = collocation.n_states, collocation.mesh
        counts = [n * (degree + collocation.family.extra_rows) for degree in mesh.degrees]
        segments = np.repeat(np.arange(mesh.segments), counts)
        ends = np.searchsorted(segments, np.append(restarts[name], segments[-1] + 1))
        is_determined = np.ones(segments.size, dtype=bool)
        is_determined[(ends[:, None] - 1 - np.arange(n)).ravel()] = False
        columns[collocation.first_row : collocation.first_row + segments.size] = is_determined
    return columns


def _choose_shooting_nodes(problem: Problem, name: str, phase: FittedPhase, q: Array) -> Indices:
    """Return the segment boundaries with unknown costates, needed because adjoint errors grow between them."""
    breaks = phase.x.breaks
    middles, widths = compute_interval_midpoints(breaks), np.diff(breaks)
    x = phase.x(middles)
    jacobian = bind_parameters(problem, name, q).state_jacobian(middles, x, phase.u(middles))
    jacobian = np.moveaxis(np.nan_to_num(jacobian), 2, 0)
    size = replace_zeros_by_one(np.ptp(x, axis=1))
    steps = exponentiate_matrices(jacobian * size / size[:, None] * widths[:, None, None])
    nodes, transition = [], np.eye(size.size)
    for k in range(widths.size - 1, 0, -1):
        transition = transition @ steps[k]
        if np.linalg.norm(transition, 2) > MAX_TRANSITION_NORM:
            nodes.append(k)
            transition = np.eye(size.size)
    return np.array(nodes[::-1], dtype=int)


def _estimate_variable_scales(
    transcription: Transcription, problem: Problem, fitted: Mapping[str, FittedPhase], x: Array
) -> Array:
    """Return the variations of the variables along the trajectory, independent of origin and guess."""
    scales = replace_zeros_by_one(np.abs(x))
    for name, part in transcription.parts.items():
        collocation, numbers = part.collocation, problem.phases[name].numbers
        for indices, bounds in (
            (collocation.point_states, numbers.states),
            (collocation.point_controls, numbers.controls),
        ):
            size = np.max(np.abs(x[indices]), axis=1)
            variation = np.ptp(x[indices], axis=1) if indices.size else np.zeros(indices.shape[0])
            width = bounds.upper - bounds.lower
            constant_scale = np.where(size > 0, size, np.where(np.isfinite(width) & (width > 0), width, 1.0))
            scales[indices] = np.where(variation > SPAN_MIN_SHARE * size, variation, constant_scale)[:, None]
        scales[collocation.boundary_states] = scales[collocation.point_states[:, [0]]]
        scales[part.times[part.times < x.size]] = np.ptp(fitted[name].x.breaks)
    # Rounding errors of a constant variable are no variation.
    return np.fmax(scales, NEGLIGIBLE * choose_variable_scales(transcription, problem, x))
