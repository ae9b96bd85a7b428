r"""Sufficiency: convexity, attained lower bound and uniqueness, which resolve inconclusive conditions.

**Convex problems.** With fixed times, dynamics, path constraints and end conditions that are affine in states, controls
and parameters, and a convex cost, every extremal is a global minimum (O. L. Mangasarian, SIAM J. Control 4, 1966).

**Least cost.** Interval arithmetic on integrands and end costs yields a lower bound of the cost. A trajectory that
attains the bound is a global minimum; its costates vanish, up to rounding.

**Uniqueness.** The difference :math:`\delta` of two solutions of a convex problem satisfies :math:`H \delta = 0` with
the Hessian H of the integrands, and :math:`\dot{\delta x} = A \delta x + B \delta u`, :math:`\delta x(t_0) = 0`. It
vanishes if this system is left invertible: for constant A, B, H, if the pencil

.. math:: \begin{pmatrix} A - s I & B \\ H_x & H_u \end{pmatrix}

has full column rank for some s (Trentelman, Stoorvogel & Hautus, Control Theory for Linear Systems, 2001, section 8.2).
A control at its bound whose switching function vanishes at isolated times only is equal in all solutions: no column.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.array_types import Array, Indices, Mask
from gnc_opt.numerical_tolerances import MINOR, NEGLIGIBLE, RANK, ROUNDING, max_norm, replace_zeros_by_one
from gnc_opt.planning.optimality.cost_and_endpoint_scales import (
    AVERAGING_SHARE_OF_PHASE,
    remove_short_intervals_from_mask,
)
from gnc_opt.planning.optimality.optimality_check_scales import EndPoints
from gnc_opt.planning.problem.bounds import Interval, intersect_bounds
from gnc_opt.planning.problem.constraints import make_constraint
from gnc_opt.planning.problem.interval_arithmetic import bound_function_values, is_affine
from gnc_opt.planning.problem.kink_detection import has_kinks
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.symbolic_expressions import (
    build_endpoint_expression_function,
    build_function_along_phase,
    substitute_parameters,
)
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.verification.solution_data_check import get_endpoint_gradients, recompute_stored_data

_PENCIL_TEST_POINT = 0.73 + 0.41j
"""Value of s, in units of the largest entry of A; the rank is exceptional at few values only."""


def has_unique_solution(problem: Problem, determined: Mapping[str, Mask]) -> bool:
    """Return whether a problem is convex with one solution; ``determined`` (m,): controls common to all solutions."""
    if not is_convex(problem) or problem.parameters.size:
        return False
    phases = list(problem.phases.values())
    points = [phase.end_states(end) for phase in phases for end in ("initial", "final")]
    conditions = problem.constraint_expression()
    rows = _read_constant_matrix(ca.jacobian(conditions, ca.vertcat(*points)))
    if rows is None:
        return False
    integrals = ca.vertcat(*(phase.integral_symbols() for phase in phases))
    of_ends = np.ones(
        conditions.numel(), dtype=bool
    )  # terms with integrals are not functions of the ends alone
    of_ends[ca.jacobian_sparsity(conditions, integrals).row()] = False
    links = rows[problem.get_boundary_constraint_bounds().is_fixed & of_ends]
    known = np.concatenate(
        [np.append(phase.numbers.initial.is_fixed, phase.numbers.final.is_fixed) for phase in phases]
    )
    rest, indices = phases, _index_boundary_states(phases)
    while rest:
        unique = [phase for phase in rest if _is_initial_state_unique(links, known, indices[phase.name][0])]
        if not unique or not all(
            _is_dynamics_left_invertible(problem, phase, determined[phase.name]) for phase in unique
        ):
            return False
        for phase in unique:
            known[np.concatenate(indices[phase.name])] = True
        rest = [phase for phase in rest if phase not in unique]
    return True


def _index_boundary_states(phases: list[Phase]) -> dict[str, tuple[Indices, Indices]]:
    indices, first = {}, 0
    for phase in phases:
        n = phase.model.states.size
        indices[phase.name] = np.arange(first, first + n), np.arange(first + n, first + 2 * n)
        first += 2 * n
    return indices


def _is_initial_state_unique(links: Array, known: Mask, initial: Indices) -> bool:
    """Return whether equations between end states imply the same initial state of a phase in all solutions."""
    unknown = initial[~known[initial]]
    other_unknown = np.setdiff1d(np.flatnonzero(~known), unknown)
    rows = links[~np.any(links[:, other_unknown] != 0, axis=1)]
    return unknown.size == 0 or _has_full_column_rank(rows[:, unknown])


def mask_bang_bang_controls(s: PhaseSamples) -> Mask:
    """Return which controls are at bounds at all times, with switching functions zero at most momentarily (m,)."""
    is_zero = ~(np.abs(s.relative_control_gradient) > NEGLIGIBLE)
    is_zero = remove_short_intervals_from_mask(s.times, is_zero, AVERAGING_SHARE_OF_PHASE)
    is_interior = ~np.any(s.is_at_control_bounds, axis=0)
    is_interior = remove_short_intervals_from_mask(s.times, is_interior, MINOR)
    return np.asarray(~np.any(is_zero | is_interior, axis=1))


def _is_dynamics_left_invertible(problem: Problem, phase: Phase, determined: Mask) -> bool:
    _, x, u, p = phase.model.symbolic_arguments()
    u = u[np.flatnonzero(~determined).tolist()]
    if u.is_empty():
        return True
    rates = phase.model.state_derivative()
    z = ca.vertcat(x, u)
    cost_hessian = ca.SX(z.numel(), z.numel())
    for symbol, integrand in phase.integrands.values():
        cost_hessian += problem.sense * ca.jacobian(problem.cost, symbol) * ca.hessian(integrand, z)[0]
    values = phase.model.parameter_values
    parts = [ca.jacobian(rates, x), ca.jacobian(rates, u), cost_hessian]
    a, b, h = (_read_constant_matrix(ca.substitute(part, p, ca.DM(values))) for part in parts)
    if a is None or b is None or h is None:
        return False
    s = _PENCIL_TEST_POINT * max(max_norm(a), 1.0)
    pencil = np.block([[a - s * np.eye(len(a)), b], [h]])
    return _has_full_column_rank(pencil)


def _has_full_column_rank(matrix: Array) -> bool:
    for axis in (1, 0):
        sizes = np.max(np.abs(matrix), axis=axis, keepdims=True, initial=0.0)
        matrix = matrix / replace_zeros_by_one(sizes)
    if matrix.shape[0] < matrix.shape[1]:
        return False
    return bool(scipy.linalg.svdvals(matrix)[-1] > RANK)


def _read_constant_matrix(expression: Any) -> Array | None:
    simplified = ca.simplify(expression)
    return np.asarray(ca.DM(simplified).full()) if simplified.is_constant() else None


def is_convex(problem: Problem) -> bool:
    """Return whether a problem is convex in its trajectory, as far as constant Hessians show."""
    return (
        all(time.is_fixed[0] for phase in problem.phases.values() for time in phase.time_ranges())
        and _is_endpoint_problem_convex(problem)
        and _are_dynamics_affine(problem)
    )


def _are_dynamics_affine(problem: Problem) -> bool:
    for phase in problem.phases.values():
        _, x, u, _ = phase.model.symbolic_arguments()
        z = ca.vertcat(x, u, problem.parameter_symbols())
        rows = problem.substitute_parameters(
            phase, ca.vertcat(phase.model.state_derivative(), phase.path_expression())
        )
        if not is_affine(rows, z):
            return False
    return True


def _is_endpoint_problem_convex(problem: Problem) -> bool:
    """Return whether end conditions are affine, and the cost convex, in end points, parameters and integrals."""
    phases = problem.phases.values()
    integrals = ca.vertcat(*(phase.integral_symbols() for phase in phases))
    points = [value for phase in phases for value in (phase.end_states("initial"), phase.end_states("final"))]
    z = ca.vertcat(*points, problem.parameter_symbols(), integrals)
    conditions = substitute_parameters(problem, problem.constraint_expression())
    cost = substitute_parameters(problem, problem.sense * problem.cost)
    if not is_affine(conditions, z) or not _is_convex_quadratic(cost, z):
        return False
    for phase in phases:
        _, x, u, _ = phase.model.symbolic_arguments()
        variables = ca.vertcat(x, u, problem.parameter_symbols())
        for symbol, integrand in phase.integrands.values():
            expression = problem.substitute_parameters(phase, integrand)
            if is_affine(expression, variables):
                continue
            weight = ca.jacobian(cost, symbol)
            if not weight.is_constant() or float(ca.DM(weight)) < 0 or ca.depends_on(conditions, symbol):
                return False
            if not _is_convex_quadratic(expression, variables):
                return False
    return True


def _is_convex_quadratic(expression: Any, z: Any) -> bool:
    """Return whether the Hessian of a scalar expression is constant and positive semidefinite, without kinks."""
    hessian = ca.hessian(expression, z)[0]
    if not hessian.is_constant() or has_kinks(expression):
        return False
    matrix = ca.DM(hessian).full()
    curved = np.diag(matrix) > 0
    units = np.sqrt(np.diag(matrix)[curved])
    scaled = matrix[np.ix_(curved, curved)] / np.outer(units, units)
    return not np.any(matrix[~curved]) and bool(np.all(np.linalg.eigvalsh(scaled) >= -ROUNDING))


def compute_cost_lower_bound(problem: Problem) -> float:
    """Return a lower bound of the minimised cost by interval arithmetic; -inf if unknown."""
    return float(_bound_endpoint_functions_from_below(problem, [problem.sense * problem.cost])[0])


def _bound_endpoint_functions_from_below(problem: Problem, expressions: Sequence[Any]) -> Array:
    """Return lower bounds (n,) of functions of the ends for all end values and parameters within bounds."""
    q, boxes = problem.get_parameter_bounds(), []
    for phase in problem.phases.values():
        p = _read_parameter_interval(phase)
        ends = [
            intersect_bounds(end_states, phase.numbers.states)
            for end_states in (phase.numbers.initial, phase.numbers.final)
        ]
        boxes += [*ends, *phase.time_ranges(), _bound_phase_integrals(problem, phase, q), p]
    function = build_endpoint_expression_function(problem, "of_ends", ca.vertcat(*expressions))
    return bound_function_values(function, [*boxes, q]).lower


def attains_lower_bound(
    solution: Solution, samples: Sequence[PhaseSamples], cost: float, scale: float, tolerance: float
) -> bool:
    """Return whether cost and costates are at their lower bounds, to ``tolerance`` of the scale ``scale``."""
    problem = solution.need_problem("verify")
    magnitudes = [np.max(np.abs(s.lam) * s.state_scale[:, None], initial=0.0) for s in samples]
    if not all(magnitude <= tolerance * scale for magnitude in magnitudes):  # also for NaN
        return False
    is_near = problem.sense * cost - compute_cost_lower_bound(problem) <= tolerance**2 * scale
    return bool(is_near and np.all(_compute_bound_excess(solution) <= tolerance**2))


def _compute_bound_excess(solution: Solution) -> Array:
    """Return the differences of the cost terms and their lower bounds (n_terms,), relative to their variations."""
    problem = solution.need_problem("verify").clone()
    summands = list(_list_summands(problem.sense * problem.cost))
    for phase in problem.phases.values():
        for symbol, integrand in list(phase.integrands.values()):
            integrals = [phase.integral(part) for part in _list_summands(integrand)]
            summands = [
                part
                for term in summands
                for part in _list_summands(ca.substitute(term, symbol, sum(integrals[1:], integrals[0])))
            ]
    problem.constraints = {
        f"term {k}": make_constraint(f"term {k}", term, None, 0.0, None, "a term of the cost")
        for k, term in enumerate(summands)
    }
    problem.clear_cache()
    zeros = {name: np.zeros(len(phase.integrands)) for name, phase in problem.phases.items()}
    split = replace(
        solution,
        problem=problem,
        phases={
            k: replace(v, integrals=zeros[k], integral_weights=zeros[k]) for k, v in solution.phases.items()
        },
        constraint_labels=problem.constraint_labels(),
        constraint_values=np.zeros(len(summands)),
        constraint_multipliers=np.zeros(len(summands)),
    )
    split = recompute_stored_data(split)
    scales = EndPoints.from_solution(split, list(split.samples().values())).compute_endpoint_changes()[:-1]
    return np.asarray(
        (get_endpoint_gradients(split).constraints - _bound_endpoint_functions_from_below(problem, summands))
        / replace_zeros_by_one(scales)
    )


def _list_summands(expression: Any, factor: float = 1.0) -> Iterator[Any]:
    if expression.op() in (ca.OP_ADD, ca.OP_SUB):
        first, second = (expression.dep(k) for k in range(2))
        yield from _list_summands(first, factor)
        yield from _list_summands(second, -factor if expression.op() == ca.OP_SUB else factor)
    elif expression.op() in (ca.OP_NEG, ca.OP_TWICE):
        yield from _list_summands(
            expression.dep(0), -factor if expression.op() == ca.OP_NEG else 2.0 * factor
        )
    elif expression.op() == ca.OP_MUL and expression.dep(0).is_constant():  # CasADi puts constants first
        yield from _list_summands(expression.dep(1), factor * float(expression.dep(0)))
    elif expression.op() == ca.OP_DIV and expression.dep(1).is_constant():
        yield from _list_summands(expression.dep(0), factor / float(expression.dep(1)))
    else:
        yield factor * expression


def _read_parameter_interval(phase: Phase) -> Interval:
    return Interval(phase.model.parameter_values, phase.model.parameter_values)


def _bound_phase_integrals(problem: Problem, phase: Phase, q: Interval) -> Interval:
    (initial, final), numbers = phase.time_ranges(), phase.numbers
    times = Interval(initial.lower, final.upper)
    column = phase.integrand_expression()
    integrands = phase.memoize(
        "integrands by all", lambda: build_function_along_phase(problem, phase, "rates", column)
    )
    arguments = [times, numbers.states, numbers.controls, _read_parameter_interval(phase), q]
    rates = bound_function_values(integrands, arguments)
    shortest = max(float(numbers.duration.lower[0]), float(final.lower[0] - initial.upper[0]), 0.0)
    longest = min(float(numbers.duration.upper[0]), float(final.upper[0] - initial.lower[0]))
    spans = Interval(np.full(rates.lower.size, shortest), np.full(rates.lower.size, longest))
    rate, span = ca.SX.sym("rate", rates.lower.size), ca.SX.sym("span", rates.lower.size)
    return bound_function_values(ca.Function("integrals", [rate, span], [rate * span]), [rates, spans])
