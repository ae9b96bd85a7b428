"""verify: optimality check of a solution by Pontryagin's minimum principle and second-order conditions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.errors import GncOptError, ProblemError
from gnc_opt.planning.optimality.active_state_constraints import free_touch_point_times
from gnc_opt.planning.optimality.optimality_check_scales import EndPoints, Scales
from gnc_opt.planning.optimality.sampling_at_narrow_peaks import choose_cell_edges_at_narrow_features
from gnc_opt.planning.problem.hamiltonian_functions import EndGradients
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.symbolic_expressions import list_boundary_table_calls, list_table_calls
from gnc_opt.planning.solution.defects_and_violations import NO_VIOLATION
from gnc_opt.planning.solution.optimality_verdict import SEVERITY, Condition, ConditionResult, Verdict
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.verification import bang_bang_second_order_conditions as second_order
from gnc_opt.planning.verification import costate_conditions as costates
from gnc_opt.planning.verification import feasibility
from gnc_opt.planning.verification import minimum_principle as controls
from gnc_opt.planning.verification.costate_conditions import impose_constraints_active_at_ends
from gnc_opt.planning.verification.feasibility import check_value_within_tolerance
from gnc_opt.planning.verification.nonsmooth_points import (
    check_concave_kinks,
    find_concave_kink,
    find_nonsmooth_point,
    mark_condition_inconclusive_at_kink,
)
from gnc_opt.planning.verification.reduced_hessian import (
    build_critical_cone,
    check_reduced_hessian,
    estimate_cost_rounding_error,
)
from gnc_opt.planning.verification.singular_arcs import (
    analyse_singular_arcs,
    check_generalised_legendre_clebsch,
    mask_first_order_singular_arcs,
)
from gnc_opt.planning.verification.solution_data_check import (
    check_stored_data,
    compare_costates,
    find_nonfinite_stored_value,
    get_endpoint_gradients,
    has_costates,
    recompute_stored_data,
)
from gnc_opt.planning.verification.sufficient_conditions import (
    attains_lower_bound,
    has_unique_solution,
    is_convex,
    mask_bang_bang_controls,
)
from gnc_opt.planning.verification.switching_time_optimality import check_switching_times
from gnc_opt.threads_and_package_versions import limit_to_one_thread

CONDITION_TOLERANCE = 1e-5

_PASS, _INCONCLUSIVE = ConditionResult.PASS, ConditionResult.INCONCLUSIVE

_SECOND_ORDER = ("second order", "switching times")
SINGULAR_ARCS = "singular arcs"

_STATIONARITY = (
    "The cost must not change to first order if a quantity varies: a state (adjoint equation), an end value or time "
    "(transversality), a parameter, or a control between its limits (dH/du = 0). If it changes, refine the mesh."
)
_ACTIVE_SET = (
    "The multiplier of a limit must have the sign of the limit, and be zero while the limit is inactive. A switching "
    "function must be positive at a lower limit and negative at an upper limit. If not, a switch is misplaced or an "
    "arc is missing."
)
_NO_EXTREMAL = "Second-order conditions apply to extremals only: correct the conditions that fail first."
_UNIQUE = "the problem is convex and has only one solution"
_AFTER_OTHERS = "not evaluated, because other conditions fail"
_NO_COSTATES = (
    "The solution has no costates (none finite and non-zero): the minimum principle cannot be checked."
)
_INCOMPLETE = "The condition holds for all available numbers, but a number is missing."
_CANNOT_VARY = "Costates or other numbers are missing: the cost of variations is unknown."


@limit_to_one_thread()
def verify(solution: Solution, *, tol: float = CONDITION_TOLERANCE) -> Verdict:
    """Return the verdict on a solution: its trajectory and costates are checked against the problem, densely in time.

    Residuals of the solver are not used. Everything except times, states, controls, free parameters, costates and
    multipliers is recomputed from the problem, so that trajectories from any source can be checked. All values are
    dimensionless, see the ``meaning`` of each condition.

    Parameters
    ----------
    solution : Solution
        Solution with its problem (``load(path, problem=...)`` after loading).
    tol : float
        Tolerance of every condition.

    Returns
    -------
    Verdict
        ``ok``: the necessary conditions of a minimum hold; ``minimum``: sufficient conditions hold too. PASS, FAIL or
        INCONCLUSIVE for each of ten conditions: dynamics, limits, boundary conditions, cost; stationarity, active set,
        minimum principle, kinks; second order, switching times.
        The solution caches its verdict; a second call with the same tolerance returns it.

    Raises
    ------
    GncOptError
        The argument is not a solution, has no problem, or has one with other variables.

    Examples
    --------
    >>> verdict = go.verify(solution)
    >>> print(verdict.ok, verdict.minimum, verdict["stationarity"].result.value)
    True True PASS
    """
    if not isinstance(solution, Solution):
        raise GncOptError(f"verify() needs a Solution, as solve() returns it, not {type(solution).__name__}.")
    if not (np.isfinite(tol) and tol > 0):
        raise ProblemError(f"the tolerance of verify() is {tol!r}: give a positive number.")
    verdict = solution.verdict if tol == CONDITION_TOLERANCE and solution.problem is not None else None
    if verdict is None:
        verdict = _check_optimality_conditions(solution, tol)
        if tol == CONDITION_TOLERANCE:  # the only field of a solution that is set after its construction
            object.__setattr__(solution, "verdict", verdict)
    return verdict if solution.bound is None else replace(verdict, bound=solution.bound, gap=solution.gap)


def _check_optimality_conditions(solution: Solution, tol: float) -> Verdict:
    stored, solution = solution, recompute_stored_data(solution)
    samples = list(solution.samples().values())
    ends = get_endpoint_gradients(solution)
    size = float(EndPoints.from_solution(solution, samples).compute_endpoint_changes()[-1])
    with_costates = has_costates(samples, ends, size)
    missing = find_nonfinite_stored_value(stored, with_costates)
    problem = solution.need_problem("verify")
    samples = [s.with_cost_scale(size, choose_cell_edges_at_narrow_features(problem, s)) for s in samples]
    scales = Scales.from_solution(solution, samples)
    nonempty = [s for s in samples if s.has_duration]
    costs = [feasibility.check_reported_cost(stored, samples, ends, with_costates, scales, tol)]
    stored_worst = missing.select_larger(compare_costates(samples) if with_costates else NO_VIOLATION)
    costs.append(check_stored_data(stored, solution, stored_worst, tol))
    trajectory = _check_trajectory(solution, samples, ends, scales, tol)
    cost = _combine_optimality_conditions("cost", costs)
    first = _check_first_order_conditions(solution, samples, ends, scales, tol)
    kink = None if missing.value or not with_costates else find_concave_kink(nonempty, scales)
    concave = kink if kink is not None and kink.resolved else None
    is_least = with_costates and attains_lower_bound(solution, samples, ends.cost, scales.change_of_cost, tol)
    if is_least:
        first = [_resolve_condition_by_lower_bound(c) for c in first]
    extremal = (*trajectory, *first)
    fails = concave is not None or any(c.result is ConditionResult.FAIL for c in extremal)
    if fails and with_costates:
        second = [_create_inconclusive_condition(name, _AFTER_OTHERS, _NO_EXTREMAL) for name in _SECOND_ORDER]
        second[0] = _describe_undetermined_arcs(second[0], _check_singular_arcs(problem, nonempty, tol))
    elif with_costates and not missing.value:
        second = _check_second_order_and_switching_times(solution, samples, ends, scales, tol)
    else:
        second = [_create_inconclusive_condition(name, missing.where, _CANNOT_VARY) for name in _SECOND_ORDER]
    checked = [*first, *second]
    if len(nonempty) < len(samples):
        phase_without_duration = next(s.phase.name for s in samples if not s.has_duration)
        checked = [_mark_condition_of_zero_duration_phase(c, phase_without_duration) for c in checked]
    if is_least:
        checked = [_resolve_condition_by_lower_bound(c) for c in checked]
    unproved = [c for c in checked if c.result is ConditionResult.INCONCLUSIVE]
    if unproved and not fails and with_costates and _is_solution_unique(problem, nonempty):
        checked = [_replace_condition_result(c, _PASS, _UNIQUE) if c in unproved else c for c in checked]
    skipped = concave is not None or missing.value
    nonsmooth_point = None if skipped else find_nonsmooth_point(problem, nonempty, tol) or kink
    failing = any(c.result is ConditionResult.FAIL for c in checked)
    kinks = check_concave_kinks(concave or nonsmooth_point, failing, falls=concave is not None)
    if nonsmooth_point is not None:
        checked = [mark_condition_inconclusive_at_kink(c, nonsmooth_point) for c in checked]
    if missing.value:
        checked = [
            _mark_condition_inconclusive(c, missing.where, _INCOMPLETE) if c.result is _PASS else c
            for c in checked
        ]
    if not with_costates:
        checked = [_mark_condition_inconclusive(c, "everywhere", _NO_COSTATES) for c in checked]
    conditions = (*trajectory, cost, *checked[: len(first)], kinks, *checked[len(first) :])
    unchecked, status = "" if with_costates else "no costates", solution.status
    failure = "" if status.solved else f"{status.value}: {status.remedy}"
    return Verdict(solution.problem_name, conditions, unchecked, solver_failure=failure)


def _check_trajectory(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, scales: Scales, tol: float
) -> list[Condition]:
    """Return the conditions that trajectory and parameters satisfy dynamics, limits and boundary conditions."""
    problem = solution.need_problem("verify")
    limits = [feasibility.check_trajectory_limits(solution, samples, scales, tol)]
    table_calls = (list_table_calls(problem, phase) for phase in problem.phases.values())
    if any(table_calls) or list_boundary_table_calls(problem):
        limits.append(feasibility.check_table_ranges(solution))
    return [
        feasibility.check_dynamics(samples, scales, tol),
        _combine_optimality_conditions("limits", limits),
        feasibility.check_boundary_conditions(solution, samples, ends, scales, tol),
    ]


def _check_first_order_conditions(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, scales: Scales, tol: float
) -> list[Condition]:
    nonempty = [s for s in samples if s.has_duration]
    stationarity = (
        costates.check_adjoint_equation(nonempty, scales, tol)
        .select_larger(costates.check_transversality(nonempty, ends, scales))
        .select_larger(controls.check_control_stationarity(nonempty, scales, tol))
        .select_larger(costates.check_parameter_stationarity(solution, samples, ends, scales))
    )
    active_set = controls.check_switching_signs(nonempty, scales).select_larger(
        costates.check_complementarity(solution, nonempty, ends, scales)
    )
    return [
        check_value_within_tolerance("stationarity", stationarity, tol, _STATIONARITY),
        check_value_within_tolerance("active set", active_set, tol, _ACTIVE_SET),
        controls.check_minimum_principle(nonempty, scales, tol, solution.need_problem("verify").cost_unit),
    ]


def _combine_optimality_conditions(name: str, parts: list[Condition]) -> Condition:
    """Return one condition with the combined result; value and location are those of the decisive part."""
    passed = all(c.result is ConditionResult.PASS for c in parts)
    decisive = min(parts, key=lambda c: (SEVERITY[c.result], not passed and c.sufficient, c.name != name))
    where = decisive.where if decisive.name == name else f"{decisive.name}: {decisive.where}"
    return replace(decisive, name=name, where=where)


def _check_second_order_and_switching_times(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, scales: Scales, tol: float
) -> list[Condition]:
    nonempty = [s for s in samples if s.has_duration]
    has_switches = bool(solution.structure) or second_order.is_bang_bang(nonempty)
    switch_conditions = [second_order.check_strict_bang_bang_property(nonempty)] if has_switches else []
    switch_conditions.append(check_switching_times(solution, samples, ends, scales))
    parts = check_second_order_conditions(solution, samples, ends, tol)
    return [
        _describe_undetermined_arcs(_combine_optimality_conditions("second order", parts), parts),
        _combine_optimality_conditions("switching times", switch_conditions),
    ]


def _describe_undetermined_arcs(condition: Condition, parts: list[Condition]) -> Condition:
    """Return a condition that names the undetermined singular arcs, whatever its result."""
    arcs = next((c for c in parts if c.name == SINGULAR_ARCS), None)
    if arcs is None or arcs.result is ConditionResult.PASS or SINGULAR_ARCS in condition.where:
        return condition
    return replace(condition, where=f"{condition.where}; {SINGULAR_ARCS}: {arcs.where}")


def check_second_order_conditions(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, tol: float
) -> list[Condition]:
    """Return the second variation, the Legendre-Clebsch condition and the conditions of singular arcs."""
    problem, nonempty = solution.need_problem("verify"), [s for s in samples if s.has_duration]
    limited, limited_ends = impose_constraints_active_at_ends(solution, samples, ends)
    conditions = _check_second_variation(limited, samples, limited_ends)
    if any(c.result is not ConditionResult.PASS for c in conditions) and is_convex(problem):
        conditions = [_mark_inconclusive_by_convexity(c) for c in conditions]
    return [*conditions, *_check_singular_arcs(problem, nonempty, tol)]


def _check_singular_arcs(problem: Problem, samples: list[PhaseSamples], tol: float) -> list[Condition]:
    """Return the Legendre-Clebsch condition, the determinacy of singular arcs, and the generalised condition."""
    undetermined = [controls.mask_undetermined_controls(s, tol) for s in samples]
    singular = [mask for mask, _ in undetermined]
    arcs = [
        analyse_singular_arcs(problem, s, *masks, tol) for s, masks in zip(samples, undetermined, strict=True)
    ]
    determined = [
        mask_first_order_singular_arcs(s, own_arcs, tol) for s, own_arcs in zip(samples, arcs, strict=True)
    ]
    return [
        controls.check_legendre_clebsch(samples, tol, singular),
        controls.check_singular_arcs(samples, tol, singular, determined),
        check_generalised_legendre_clebsch([arc for own_arcs in arcs for arc in own_arcs], tol),
    ]


def _check_second_variation(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients
) -> list[Condition]:
    if not second_order.explain_why_not_bang_bang(samples):
        return [second_order.check_bang_bang_second_order(solution, samples, ends)]
    solution = free_touch_point_times(solution)
    freed = [s for s in samples if solution.phases[s.phase.name] is not s.phase]
    samples = [replace(s, phase=solution.phases[s.phase.name]) if s in freed else s for s in samples]
    rounding = estimate_cost_rounding_error(samples)
    cone = build_critical_cone(solution, samples, rounding)
    if not cone.point.is_finite:
        reason = "a derivative of the problem is not finite"
        return [_create_inconclusive_condition("second order", reason, _CANNOT_VARY)]
    return [check_reduced_hessian(solution, samples, cone)]


def _replace_condition_result(condition: Condition, result: ConditionResult, reason: str) -> Condition:
    return replace(condition, result=result, where=f"{condition.where}; {reason}")


def _mark_inconclusive_by_convexity(condition: Condition) -> Condition:
    """Return a failed sufficient condition as inconclusive: negative curvature is a discretisation error then."""
    if condition.result is _PASS or not condition.sufficient:
        return condition
    reason = "the problem is convex, but the minimum may not be unique"
    return _replace_condition_result(condition, _INCONCLUSIVE, reason)


def _resolve_condition_by_lower_bound(condition: Condition) -> Condition:
    """Return a necessary condition as passed, a sufficient one as inconclusive; costates are rounding errors then."""
    if condition.result is _PASS:
        return condition
    result = _INCONCLUSIVE if condition.sufficient else _PASS
    reason = "the cost is at its lower bound, but the minimum may not be unique"
    return _replace_condition_result(condition, result, reason)


def _is_solution_unique(problem: Problem, samples: list[PhaseSamples]) -> bool:
    bang_bang = {s.phase.name: mask_bang_bang_controls(s) for s in samples}
    return len(bang_bang) == len(problem.phases) and has_unique_solution(problem, bang_bang)


def _create_inconclusive_condition(name: str, where: str, meaning: str) -> Condition:
    return Condition(name, ConditionResult.INCONCLUSIVE, float("nan"), 0.0, where, meaning, sufficient=True)


def _mark_condition_inconclusive(condition: Condition, where: str, meaning: str) -> Condition:
    inconclusive = replace(condition, result=_INCONCLUSIVE, value=float("nan"), where=where, meaning=meaning)
    return replace(inconclusive, loss=None, unit="")


def _mark_condition_of_zero_duration_phase(condition: Condition, phase: str) -> Condition:
    if condition.result is ConditionResult.FAIL:  # in another phase
        return condition
    inconclusive = _mark_condition_inconclusive(
        condition,
        f"phase {phase} has no length",
        "The duration of the phase is zero, so costates and controls have no values along it. Remove the phase, or "
        "require a positive duration.",
    )
    return replace(inconclusive, sufficient=True)  # no evidence against the solution
