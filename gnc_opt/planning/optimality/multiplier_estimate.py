r"""Estimated costates and multipliers of a given trajectory: least-squares solution of the first-order conditions.

On the mesh of the trajectory (Legendre-Gauss), stationarity in states, controls, free times, parameters and jump times
of the controls is :math:`\nabla f + g'^T\lambda_g + \lambda_x = 0`, linear in the multipliers. Multipliers of inactive
limits are zero, those of active ones have their sign. The adjoint equation holds exactly; the least squares of the
other rows are the solution of a quadratic program. The result is mapped to costates like the multipliers of a solver
(module `costates`).

At a touch point, entry or exit of a pure state constraint :math:`c(t, x) \le 0`, its multiplier has an atom
:math:`\eta \ge 0`: the costate jumps by :math:`-\eta\,\partial c/\partial x` (Hartl, Sethi & Vickson, SIAM Review
37(2), 1995, theorem 4.1). Since a program has rows at its collocation points only, terms :math:`\eta\,c(t_k, x_k)` at
segment boundaries are added to its Lagrangian: at arc ends of order two or more, touch points and phase ends.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.array_types import Array, Indices, Mask
from gnc_opt.planning.nlp import NlpPoint, NlpProblem, NlpSolver, SolverOptions
from gnc_opt.planning.nlp.partially_separable_nlp import convert_to_casadi
from gnc_opt.planning.optimality.kkt_point import compute_quadrature_weights
from gnc_opt.planning.optimality.trajectory_fit import FittedPhase
from gnc_opt.planning.problem.bounds import Interval, stack_intervals, unbounded
from gnc_opt.planning.problem.hamiltonian_functions import PhaseFunctions
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.state_constraint_order import get_constraint_order
from gnc_opt.planning.solution.costates import NlpIterate
from gnc_opt.planning.solution.initial_nlp_point import set_integral_variables
from gnc_opt.planning.solution.solution_from_nlp_result import bind_parameters
from gnc_opt.planning.solution.state_and_control_scales import SPAN_MIN_SHARE
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.nlp_layout import PhaseIndices
from gnc_opt.planning.transcription.scaling import choose_variable_scales
from gnc_opt.planning.transcription.transcription import Transcription
from gnc_opt.tolerances import ACTIVE, NEGLIGIBLE, TINY


def _find_costate_jump_candidates(
    transcription: Transcription,
    problem: Problem,
    fitted: Mapping[str, FittedPhase],
    q: Array,
    scales: Array,
    near: float,
) -> tuple[Any, Interval]:
    """Return the pure state path constraints that may have atoms at segment boundaries along a trajectory.

    Parameters
    ----------
    scales : array (n_variables,)
        Variations of the variables.

    Returns
    -------
    gradients : sparse array (n_variables, n_atoms)
        Gradients in the program's variables, relative to the variations of the constraints.
    multipliers : Interval
        Bounds of the atoms.
    """
    gradients: list[Any] = [scipy.sparse.csc_array((scales.size, 0))]
    multipliers = [unbounded(0)]
    for name, part in transcription.parts.items():
        leg, functions, phase = (problem.phases[name], bind_parameters(problem, name, q), fitted[name])
        orders = [get_constraint_order(problem, leg, i).order for i in range(len(leg.path_labels))]
        pure = np.flatnonzero([order != 0 for order in orders])
        if not pure.size:
            continue
        times = phase.x.breaks
        # A shared value belongs to the segment that starts there; the last one to the last segment.
        x, u = (np.hstack([p(times[:-1]), p(times[-1:], "left")]) for p in (phase.x, phase.u))
        places, slopes = differentiate_path_constraints(transcription, part, functions, (times, x, u))
        slopes = slopes[:, pure]
        sizes = np.sum(np.abs(slopes) * scales[places][:, None], axis=0)
        values, limits = functions.paths(times, x, u)[pure], leg.path_interval().select(pure)
        box = _bound_multipliers(Interval(limits.lower[:, None], limits.upper[:, None]), values, near * sizes)
        touched_only = np.array([orders[i] == 1 for i in pure])
        chosen = _can_have_costate_jump(~box.is_fixed, touched_only)
        which, k = np.nonzero(chosen)
        entries = places[:, k].ravel(), np.tile(np.arange(which.size), places.shape[0])
        relative = slopes[:, which, k] / _replace_zeros_by_one(sizes[chosen])
        gradients.append(scipy.sparse.csc_array((relative.ravel(), entries), (scales.size, which.size)))
        multipliers.append(box.select(chosen))
    return scipy.sparse.hstack(gradients, format="csc"), stack_intervals(multipliers)


def differentiate_path_constraints(
    transcription: Transcription,
    part: PhaseIndices,
    functions: PhaseFunctions,
    at: tuple[Array, Array, Array],
) -> tuple[Indices, Array]:
    """Return the gradients of path constraints at segment boundaries of a phase in the variables of the program.

    Parameters
    ----------
    at : (K + 1,), (n_states, K + 1), (n_controls, K + 1)
        Times, states and controls at the boundaries.

    Returns
    -------
    places : int array (k, K + 1)
        Indices of the variables: states, free times, free parameters.
    gradients : array (k, n_paths, K + 1)
    """
    collocation, n = part.collocation, at[0].size
    by_time, by_state, by_parameter = functions.path_gradients(*at)
    free = part.times < transcription.n_variables
    others = np.concatenate([part.times[free], transcription.parameter_places])
    moved = _differentiate_break_times(collocation.mesh)[free]
    return (
        np.vstack([collocation.boundary_states, np.repeat(others[:, None], n, axis=1)]),
        np.concatenate([by_state, moved[:, None] * by_time, by_parameter]),
    )


def _can_have_costate_jump(active: Mask, touched_only: Mask) -> Mask:
    """Return where active constraints (n, K + 1) may have an atom: not inside arcs, nor at the ends of certain arcs."""
    before, after = np.zeros_like(active), np.zeros_like(active)
    before[:, 1:], after[:, :-1] = active[:, :-1], active[:, 1:]
    beside = np.where(touched_only[:, None], before | after, before & after)
    beside[:, [0, -1]] = False
    return np.asarray(active & ~beside)


def _differentiate_break_times(mesh: Mesh) -> Array:
    """Return the derivatives of the boundary times in the anchor times (n_anchors, K + 1)."""
    fractions = np.asarray(mesh.breaks)
    anchors = fractions[list(mesh.anchor_breaks)]
    return np.array([np.interp(fractions, anchors, one) for one in np.eye(anchors.size)])


_OPTIONS = SolverOptions(
    tolerance=1e-10, extra={"ipopt.hessian_constant": "yes", "ipopt.jac_c_constant": "yes"}
)
"""Options of the quadratic program for multipliers, with scaled gradients of at most 1."""


def estimate_multipliers(
    transcription: Transcription,
    problem: Problem,
    fitted: Mapping[str, FittedPhase],
    q: Array,
    near: float = ACTIVE,
) -> NlpIterate:
    """Return the program's variables at a trajectory, and the multipliers that explain it best.

    Parameters
    ----------
    q : array (n_parameters,)
        Free parameters.
    near : float
        Distance from a limit, relative to the scale, up to which it may be active.
    """
    x = _sample_nlp_variables(transcription, problem, fitted, q)
    scales = _estimate_variable_scales(transcription, problem, fitted, x)
    values, gradient, nonzeros = transcription.evaluate_derivatives(problem, x)
    rows, columns = transcription.constraints.jacobian_pattern
    steepest = np.zeros(transcription.n_constraints)
    np.maximum.at(steepest, rows, np.abs(nonzeros * scales[columns]))
    row_scales = 1 / np.where(steepest > 0, steepest, 1.0)
    worth = 1 / max(float(np.max(np.abs(gradient * scales))), TINY)
    shape = (transcription.n_variables, transcription.n_constraints)
    weights = scales / np.sqrt(compute_quadrature_weights(transcription)[0])
    matrix = scipy.sparse.csc_array(
        (nonzeros * weights[columns] * row_scales[rows], (columns, rows)), shape=shape
    )
    limits = _bound_multipliers(transcription.variable_interval(problem), x, near * scales)
    row_limits = _bound_multipliers(transcription.constraint_bounds(problem), values, near / row_scales)
    atoms, atom_limits = _find_costate_jump_candidates(transcription, problem, fitted, q, scales, near)
    with_atoms = scipy.sparse.hstack([matrix, scipy.sparse.diags_array(weights) @ atoms], format="csc")
    scaled = _fit_multipliers(
        with_atoms,
        gradient * weights * worth,
        _mask_adjoint_rows(transcription),
        limits,
        stack_intervals([row_limits, atom_limits]),
    )
    lam_g = scaled[: values.size] * row_scales / worth
    residual = gradient + scipy.sparse.csc_array((nonzeros, (columns, rows)), shape=shape) @ lam_g
    return NlpIterate(x, np.where(limits.is_fixed, 0.0, -residual), lam_g)


def _bound_multipliers(box: Interval, values: Array, slack: Array) -> Interval:
    """Return the bounds of multipliers: <= 0 at lower limits, >= 0 at upper limits, any sign for equalities, else 0."""
    at_lower, at_upper = values <= box.lower + slack, values >= box.upper - slack
    return Interval(
        np.where(at_lower | box.is_fixed, -np.inf, 0.0), np.where(at_upper | box.is_fixed, np.inf, 0.0)
    )


def _fit_multipliers(
    matrix: Any, gradient: Array, exact: Mask, limits: Interval, row_limits: Interval
) -> Array:
    """Return the multipliers y of the rows (n_rows,) that have the right signs and minimise the squares of a residual.

    The residual is gradient + matrix @ y + z, with the multipliers z of the variables' limits; it is zero in ``exact``
    entries. If multipliers are not unique, those without regard to signs are near zero; where their signs are wrong,
    those of an interior-point method are off zero.
    """
    # The row of a derivative that is not finite, such as that of a norm at zero, is omitted.
    finite = np.isfinite(gradient) & np.isfinite(matrix.sum(axis=1))
    columns, bound = np.flatnonzero(~row_limits.is_fixed), np.flatnonzero(~limits.is_fixed)
    free = np.flatnonzero(finite & ~exact)
    found = np.zeros(matrix.shape[1])
    if not np.all(finite[exact]):  # no multipliers explain the trajectory
        return found
    units = scipy.sparse.eye_array(gradient.size, format="csc")
    parts = [matrix[:, columns], units[:, bound], -units[:, free]]
    rows = convert_to_casadi(scipy.sparse.hstack(parts, format="csr")[finite])
    box = stack_intervals([row_limits.select(columns), limits.select(bound), unbounded(free.size)])
    squares = np.repeat([0.0, 1.0], [columns.size + bound.size, free.size])
    found[columns] = _solve_quadratic_program(squares, rows, -gradient[finite], box)[: columns.size]
    return found


def _solve_quadratic_program(squares: Array, rows: Any, right: Array, box: Interval) -> Array:
    """Return the y in a box that minimises ``squares @ y**2`` with ``rows @ y = right``; see `_fit_multipliers`."""
    y, p = ca.MX.sym("y", squares.size), ca.MX.sym("p", 0)
    cost, product, factor = 0.5 * ca.dot(squares, y**2), ca.mtimes(rows, y), ca.MX.sym("factor")
    hessian = [y, p, factor, ca.MX.sym("lam", right.size)], [factor * ca.diag(ca.DM(squares))]
    program = NlpProblem(
        y,
        p,
        cost,
        product,
        grad_f=ca.Function("grad_f", [y, p], [cost, squares * y]),
        jac_g=ca.Function("jac_g", [y, p], [product, rows]),
        hess_lag=ca.Function("hess_lag", *hessian),
    )
    solver, start, none = NlpSolver(program, _OPTIONS), np.zeros(squares.size), np.zeros(0)
    found = solver.solve(NlpPoint(start, start - np.inf, start + np.inf, right, right, none)).x
    slack = NEGLIGIBLE * float(np.max(np.abs(found), initial=TINY))
    if np.any((found < box.lower - slack) | (found > box.upper + slack)):
        found = solver.solve(NlpPoint(start, box.lower, box.upper, right, right, none)).x
    return np.asarray(found)


def _sample_nlp_variables(
    transcription: Transcription, problem: Problem, fitted: Mapping[str, FittedPhase], q: Array
) -> Array:
    x = np.zeros(transcription.n_variables)
    for name, part in transcription.parts.items():
        collocation, phase = part.collocation, fitted[name]
        breaks = phase.x.breaks
        points = breaks[0] + collocation.point_fractions * (breaks[-1] - breaks[0])
        x[collocation.boundary_states] = phase.x(breaks)
        x[collocation.boundary_states[:, -1]] = phase.x(breaks[-1], "left")
        x[collocation.point_states], x[collocation.point_controls] = phase.x(points), phase.u(points)
        free_times = part.times < transcription.n_variables
        x[part.times[free_times]] = breaks[list(collocation.mesh.anchor_breaks)][free_times]
    x[transcription.parameter_places] = q
    return set_integral_variables(transcription, problem, x)


def _mask_adjoint_rows(transcription: Transcription) -> Mask:
    """Return the rows of the adjoint equation, which hold exactly for any final costates."""
    rows = np.zeros(transcription.n_variables, dtype=bool)
    for part in transcription.parts.values():
        rows[part.collocation.point_states] = True
        rows[part.collocation.boundary_states[:, 1:-1]] = True
    return rows


def _estimate_variable_scales(
    transcription: Transcription, problem: Problem, fitted: Mapping[str, FittedPhase], x: Array
) -> Array:
    """Return the variations of the variables along the trajectory, independent of origin and guess."""
    scales = _replace_zeros_by_one(np.abs(x))
    for name, part in transcription.parts.items():
        collocation, numbers = part.collocation, problem.phases[name].numbers
        for places, box in (
            (collocation.point_states, numbers.states),
            (collocation.point_controls, numbers.controls),
        ):
            size = np.max(np.abs(x[places]), axis=1)
            varies = np.ptp(x[places], axis=1) if places.size else np.zeros(places.shape[0])
            extent = box.upper - box.lower
            still = np.where(size > 0, size, np.where(np.isfinite(extent) & (extent > 0), extent, 1.0))
            scales[places] = np.where(varies > SPAN_MIN_SHARE * size, varies, still)[:, None]
        scales[collocation.boundary_states] = scales[collocation.point_states[:, [0]]]
        scales[part.times[part.times < x.size]] = np.ptp(fitted[name].x.breaks)
    # Rounding errors of an idle variable are no variation.
    return np.fmax(scales, NEGLIGIBLE * choose_variable_scales(transcription, problem, x))


def _replace_zeros_by_one(values: Array) -> Array:
    return np.where(values > 0, values, 1.0)
