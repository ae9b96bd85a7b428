"""Checks of a problem statement before the solve."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.errors import ProblemError, suggest_similar_name, warn_user
from gnc_opt.model.model_variables import Variable
from gnc_opt.numerical_tolerances import ACTIVE, ROUNDING
from gnc_opt.planning.problem.bounds import Interval, intersect_bounds, unbounded_interval
from gnc_opt.planning.problem.differentiability_checks import (
    check_functions_finite_at_guess,
    check_guess_in_tables,
    warn_of_kinks,
    warn_of_singular_end_states,
    warn_of_singular_norms,
)
from gnc_opt.planning.problem.guess.singularity_avoidance import with_curved_guess
from gnc_opt.planning.problem.interval_arithmetic import bound_function_values
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.reformulation import reformulate_problem
from gnc_opt.planning.problem.symbolic_expressions import (
    build_function_along_phase,
    list_endpoint_arguments,
    stack_phase_expressions,
    substitute_parameters,
)


def check_problem(problem: ProblemData) -> None:
    """Raise `ProblemError` at the first mistake; ``Problem.check`` lists the checks."""
    check_bounds_and_times(problem)
    first = "checked" not in problem.builds
    solved = reformulate_problem(problem)
    if first:
        check_unused_controls(problem)
        for phase in solved.phases.values():
            warn_of_kinks(solved, phase)
            _warn_of_duplicate_bounds(solved, phase)
        _check_unused_parameters(problem)
        _warn_of_constant_cost(problem)
        problem.builds["checked"] = True
    for phase in problem.phases.values():
        check_guess_in_tables(problem, phase, warn=first)
    guessed = solved
    try:
        check_functions_finite_at_guess(solved)
    except ProblemError:  # most straight lines need no curvature
        guessed = with_curved_guess(solved)  # the same guess as the solver
        check_functions_finite_at_guess(guessed)
    if first:
        for name, phase in solved.phases.items():
            warn_of_singular_norms(solved, phase)
            warn_of_singular_end_states(guessed, guessed.phases[name])


def check_bounds_and_times(problem: ProblemData) -> None:
    """Raise `ProblemError` for missing declarations and contradictory times, bounds and end values."""
    if not problem.phases:
        raise ProblemError(f"problem '{problem.name}' has no phase: add one with phase(name, model).")
    if problem.cost is None:
        raise ProblemError(f"problem '{problem.name}' has no cost: call minimize() or maximize().")
    for phase in problem.phases.values():
        _check_phase_times(phase)
        _check_boundary_values_in_bounds(phase)
        _check_path_constraints_at_ends(problem, phase)
    for phase in problem.phases.values():
        _check_phase_start_after_predecessor(problem, phase)
    _check_boundary_constraints(problem)


def _check_phase_times(phase: Phase) -> None:
    initial, final = phase.time_ranges()
    span = phase.numbers.duration
    shortest, longest = final.lower[0] - initial.upper[0], final.upper[0] - initial.lower[0]
    first, last = (_format_range(time, 0) for time in (phase.numbers.initial_time, phase.numbers.final_time))
    times = f"initial time {first} s, final time {last} s"
    if longest < 0:
        raise ProblemError(
            f"{phase.label} ends before it starts ({times}): correct time(initial=..., final=...)."
        )
    if min(longest, span.upper[0]) == 0:
        raise ProblemError(f"{phase.label} has no duration ({times}): let the final time be later.")
    slack = ROUNDING * max(abs(initial.lower[0]), abs(final.upper[0]), 1.0)
    crossed = max(initial.lower[0] - initial.upper[0], final.lower[0] - final.upper[0])
    if max(crossed, shortest - span.upper[0], span.lower[0] - longest) > slack:
        raise ProblemError(
            f"{phase.label} cannot last {_format_range(span, 0)} s between an initial time of {first} s "
            f"and a final time of {last} s: correct time(..., duration=...)."
        )


def _check_boundary_values_in_bounds(phase: Phase) -> None:
    for end, values in (("initial", phase.numbers.initial), ("final", phase.numbers.final)):
        intersection = intersect_bounds(values, phase.numbers.states)
        slack = ROUNDING * (1.0 + np.abs(intersection.lower))
        wrong = np.flatnonzero(intersection.lower > intersection.upper + slack)
        if wrong.size:
            i = int(wrong[0])
            raise ProblemError(
                f"the {end} value of '{phase.model.states.labels[i]}' in {phase.label} is {_format_range(values, i)}, "
                f"outside its bounds {_format_range(phase.numbers.states, i)}: correct one of the two."
            )


def _check_path_constraints_at_ends(problem: ProblemData, phase: Phase) -> None:
    """Raise an error if a path constraint cannot hold at an end for any controls and free parameters."""
    box, numbers, q = phase.get_path_bounds(), phase.numbers, problem.get_parameter_bounds()
    if not box.lower.size:
        return
    function = _build_path_constraint_function(problem, phase)
    p = Interval(phase.model.parameter_values, phase.model.parameter_values)
    for end, time, values in zip(
        ("initial", "final"), phase.time_ranges(), (numbers.initial, numbers.final), strict=True
    ):
        arguments = (time, intersect_bounds(values, numbers.states), numbers.controls, p, q)
        value_range = bound_function_values(function, arguments)
        for k in _find_infeasible_constraint_rows(value_range, box):
            raise ProblemError(
                f"path constraint '{phase.path_labels[k]}' cannot hold with the {end} values of {phase.label}: it is "
                f"{_format_range(value_range, k)} there, not within {_format_range(box, k)}: correct one of the two."
            )


def _warn_of_duplicate_bounds(problem: ProblemData, phase: Phase) -> None:
    """Issue a `ProblemWarning` for path constraint rows that repeat a bound of a state or control."""
    box, numbers, q = phase.get_path_bounds(), phase.numbers, problem.get_parameter_bounds()
    if not box.lower.size:
        return
    p = Interval(phase.model.parameter_values, phase.model.parameter_values)
    time = Interval(phase.time_ranges()[0].lower, phase.time_ranges()[1].upper)
    function = _build_path_constraint_function(problem, phase)
    values = bound_function_values(function, (time, numbers.states, numbers.controls, p, q))
    slack = ROUNDING * np.maximum(np.abs(values.lower), np.abs(values.upper))
    with np.errstate(invalid="ignore"):
        implied = (np.abs(values.upper - box.upper) <= slack) | (np.abs(values.lower - box.lower) <= slack)
    rows = ca.vertsplit(phase.path_expression())
    for k in np.flatnonzero(implied & np.isfinite(slack) & ~box.is_fixed):
        symbols = ca.symvar(rows[int(k)])
        if len(symbols) == 1:
            warn_user(
                f"path constraint '{phase.path_labels[k]}' of {phase.label} repeats a bound of '{symbols[0].name()}': "
                "remove one of them, since only the sum of their multipliers is unique."
            )


def _find_infeasible_constraint_rows(value_range: Interval, box: Interval) -> list[int]:
    slack = ACTIVE * (1.0 + np.minimum(np.abs(value_range.lower), np.abs(value_range.upper)))
    outside = (value_range.lower > box.upper + slack) | (value_range.upper < box.lower - slack)
    return [int(i) for i in np.flatnonzero(outside)]


def _build_path_constraint_function(problem: ProblemData, phase: Phase) -> Any:
    return phase.memoize(
        "paths and parameters",
        lambda: build_function_along_phase(problem, phase, "paths", phase.path_expression()),
    )


def _check_phase_start_after_predecessor(problem: ProblemData, phase: Phase) -> None:
    """Raise an error for a phase that starts with its predecessor, because ``time()`` sets the start to 0."""
    if phase.preceding_phase is None:
        return
    before, start = problem.phases[phase.preceding_phase].time_ranges()[0], phase.time_ranges()[0]
    if start.upper[0] <= before.lower[0]:
        raise ProblemError(
            f"{phase.label} follows phase '{phase.preceding_phase}' but starts at {_format_range(start, 0)} s, its "
            f"start: set a free start, {phase.name}.time(initial=None, final=...)."
        )


def _check_boundary_constraints(problem: ProblemData) -> None:
    """Raise an error for boundary constraints that cannot hold for any free end values."""
    box = problem.get_boundary_constraint_bounds()
    if not box.lower.size:
        return

    def build_constraint_function() -> Any:
        rows = substitute_parameters(problem, problem.constraint_expression())
        return ca.Function("constraints", list_endpoint_arguments(problem), [ca.densify(rows)])

    function = problem.memoize("constraints", build_constraint_function)
    value_range = bound_function_values(function, _list_endpoint_ranges(problem))
    for k in _find_infeasible_constraint_rows(value_range, box):
        raise ProblemError(
            f"constraint '{problem.constraint_labels()[k]}' of problem '{problem.name}' cannot hold with the times "
            f"and end values of the phases: it is {_format_range(value_range, k)} there, not within "
            f"{_format_range(box, k)}: correct one of the two."
        )


def _warn_of_constant_cost(problem: ProblemData) -> None:
    """Issue a `ProblemWarning` for a cost of fixed quantities alone, for which all controls are optimal."""
    if all(np.all(phase.numbers.controls.is_fixed) for phase in problem.phases.values()):
        return  # a boundary value problem
    spans = [phase.numbers.duration for phase in problem.phases.values()]
    fixed = tuple(span.lower[0] if span.is_fixed[0] else None for span in spans)

    def build_cost_function() -> Any:
        cost = substitute_parameters(problem, problem.cost)
        for phase, span in zip(problem.phases.values(), fixed, strict=True):
            if span is not None:
                cost = ca.substitute(cost, phase.final_time, phase.initial_time + span)
            for symbol, value in phase.integrands.values():
                cost = ca.substitute(cost, symbol, value * phase.duration) if value.is_constant() else cost
        return ca.Function("cost", list_endpoint_arguments(problem), [ca.densify(cost)])

    function = problem.memoize(("cost", fixed), build_cost_function)
    cost_range = bound_function_values(function, _list_endpoint_ranges(problem))
    lower, upper = float(cost_range.lower[0]), float(cost_range.upper[0])
    if upper <= lower + ROUNDING * abs(lower):
        warn_user(
            f"the cost of problem '{problem.name}' is {lower:g} for all controls, because it contains only fixed "
            "quantities: every feasible trajectory is optimal, and the solver returns one of them. Free one of the "
            "quantities, or minimise another; the integral of the squared controls gives a smooth trajectory."
        )


def _list_endpoint_ranges(problem: ProblemData) -> list[Interval]:
    """Return the ranges of `list_endpoint_arguments`; those of integrals are unbounded."""
    arguments: list[Interval] = []
    for phase in problem.phases.values():
        values, p = phase.numbers, phase.model.parameter_values
        ends = (intersect_bounds(end, values.states) for end in (values.initial, values.final))
        arguments += [*ends, *phase.time_ranges(), unbounded_interval(len(phase.integrands)), Interval(p, p)]
    return [*arguments, problem.get_parameter_bounds()]


def _format_range(interval: Interval | None, i: int) -> str:
    if interval is None:
        return "free"
    lower, upper = interval.lower[i], interval.upper[i]
    return f"{lower:g}" if lower == upper else f"[{lower:g}, {upper:g}]"


def _collect_used_symbols(expressions: list[Any]) -> set[int]:
    return {symbol.element_hash() for expression in expressions for symbol in ca.symvar(expression)}


def _find_unused_variable_components(variable: Variable, symbol: Any, used: set[int]) -> list[str]:
    scalars = ca.vertsplit(symbol)
    return [name for name, s in zip(variable.labels, scalars, strict=True) if s.element_hash() not in used]


def check_unused_controls(problem: ProblemData) -> None:
    """Raise `ProblemError` for a control without effect on dynamics, limits and integrals of the cost."""
    ends = _collect_used_symbols([ca.vertcat(problem.cost, problem.constraint_expression())])
    for phase in problem.phases.values():
        counts = [value for symbol, value in phase.integrands.values() if symbol.element_hash() in ends]
        acted_on = ca.vertcat(phase.model.state_derivative(), phase.path_expression(), *counts)
        used = _collect_used_symbols([problem.substitute_parameters(phase, acted_on)])
        for variable in phase.model.controls.variables:
            unused = _find_unused_variable_components(variable, phase.model.symbol(variable.name), used)
            if unused:
                raise ProblemError(
                    f"control '{unused[0]}' of {phase.label} appears in no dynamics, path constraint or integral of "
                    "the cost or a constraint: use it or remove it (its value would be arbitrary)."
                )


def _check_unused_parameters(problem: ProblemData) -> None:
    ends = ca.vertcat(problem.cost, problem.constraint_expression())
    phases = problem.phases.values()
    used = _collect_used_symbols(
        [
            ends,
            *(problem.substitute_parameters(phase, ends) for phase in phases),
            *(problem.substitute_parameters(phase, stack_phase_expressions(phase)) for phase in phases),
        ]
    )
    models = {id(phase.model): phase.model for phase in phases}.values()
    known = [name for model in models for name in model.parameters.names]
    for variable in problem.parameters.variables:
        symbol = problem.parameter_symbols()[problem.parameters.slice(variable.name)]
        if len(_find_unused_variable_components(variable, symbol, used)) == variable.size:
            raise ProblemError(
                f"parameter '{variable.name}' of problem '{problem.name}' appears in no function and no "
                "model has a "
                f"parameter of that name: {suggest_similar_name(variable.name, known)}"
            )
    for model in models:
        for variable in model.parameters.variables:
            bound = variable.name in problem.parameters
            if (
                not bound
                and len(_find_unused_variable_components(variable, model.symbol(variable.name), used))
                == variable.size
            ):
                warn_user(
                    f"parameter '{variable.name}' of model '{model.name}' is used nowhere: remove it or use "
                    "it."
                )


def describe_missing_bounds(problem: ProblemData) -> str:
    """Return which controls lack bounds in a minimum-time problem; "" if none does."""
    times = ca.vertcat(
        *[t for phase in problem.phases.values() for t in (phase.initial_time, phase.final_time)]
    )
    without_times = ca.substitute(problem.cost, times, ca.DM.zeros(times.shape))
    if ca.symvar(without_times):
        return ""
    missing = [f"'{name}'" for phase in problem.phases.values() for name in _find_unbounded_controls(phase)]
    if not missing:
        return ""
    names = ", ".join(dict.fromkeys(missing))
    return (
        f"the cost is time only, but neither bounds nor path constraints limit {names} on both sides: give bounds(), "
        "otherwise only the states limit the duration."
    )


def _find_unbounded_controls(phase: Phase) -> list[str]:
    """Return the controls of a phase that enter the dynamics affinely, without limits and without cost."""
    box, model = phase.numbers.controls, phase.model
    u, rates = model.symbolic_arguments()[2], model.state_derivative()
    if phase.vector_controls:  # these are limited by their length
        return []
    limits = ca.vertcat(phase.path_expression(), phase.integrand_expression())
    unbounded = []
    for i in np.flatnonzero(np.isinf(box.lower) | np.isinf(box.upper)):
        slope = ca.jacobian(rates, u[int(i)])
        is_affine = slope.nnz() > 0 and not ca.depends_on(slope, u)
        if is_affine and not ca.depends_on(limits, u[int(i)]):
            unbounded.append(phase.model.controls.labels[i])
    return unbounded
