"""Recomputed solution: trajectory and multipliers of a solution, with all other numbers from its problem."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.errors import ProblemError
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.hamiltonian_functions import EndGradients, evaluate_endpoint_gradients
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.defects_and_violations import NO_VIOLATION, Worst
from gnc_opt.planning.solution.optimality_verdict import Condition
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.phase_trajectory_samples import COSTATE_MIN_SHARE_OF_COST, PhaseSamples
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_from_nlp_result import copy_problem_data_to_solution
from gnc_opt.planning.verification.feasibility import check_value_within_tolerance, integrate_cost_terms

_PROBLEM_FIELDS = (
    "parameters",
    *("state_bounds", "control_bounds", "path_bounds", "initial_bounds", "final_bounds"),
    *("initial_time_bounds", "final_time_bounds", "duration_bounds"),
)
"""Fields of a phase solution that equal those of the problem."""

_COSTATE_FIELDS = (
    *("lam", "lam_start", "lam_end", "point_costates", "path_multipliers", "state_multipliers"),
    *("control_multipliers", "state_impulses", "time_multipliers", "duration_multiplier", "integral_weights"),
    *("parameter_multipliers", "constraint_multipliers"),
)
"""Fields of solutions with costates only."""


def recompute_stored_data(solution: Solution) -> Solution:
    """Return the solution with names, limits, model parameters, integrals and their weights from its problem.

    Times, states, controls, costates, multipliers and free parameters are unchanged. Integrals are quadratures along
    the applied control; their weights are gradients of cost and constraints at the ends of the trajectory.

    Raises
    ------
    GncOptError
        The solution has no problem, or one with other phases, variables or constraints.
    """
    problem = solution.need_problem("verify")
    _require_matching_problem_sizes(problem, solution)
    phases = {name: _recompute_stored_phase_data(problem, solution, name) for name in problem.phases}
    checked = replace(
        solution,
        maximised=problem.sense < 0,
        phases=phases,
        free_parameters=problem.parameters,
        constraint_labels=problem.constraint_labels(),
    )
    integrated = phases | {
        name: replace(
            phase,
            integrals=integrate_cost_terms(PhaseSamples.from_phase(phase, checked.phase_functions(name))),
        )
        for name, phase in phases.items()
        if phase.integral_labels
    }
    weights = get_endpoint_gradients(replace(checked, phases=integrated)).integrals
    weighted = {name: replace(phase, integral_weights=weights[name]) for name, phase in integrated.items()}
    return replace(checked, phases=weighted)


def get_endpoint_gradients(solution: Solution) -> EndGradients:
    """Return cost, boundary constraints and their gradients at the ends of the trajectory."""
    problem = solution.need_problem("verify")
    ends = {name: phase.endpoint_arguments for name, phase in solution.phases.items()}
    return evaluate_endpoint_gradients(
        problem, ends, solution.parameter_values, solution.constraint_multipliers
    )


def find_nonfinite_stored_value(stored: Solution, with_costates: bool) -> Worst:
    """Return the first number that is not finite, as an infinite violation, else zero; costates only on request."""
    worst = _find_first_nonfinite_value(stored, "", with_costates)
    for name, phase in stored.phases.items():
        worst = worst.select_larger(_find_first_nonfinite_value(phase, f"phase {name}, ", with_costates))
    return worst


def check_stored_data(stored: Solution, checked: Solution, missing: Worst, tolerance: float) -> Condition:
    """Return the condition that data stored from the problem equal those of the problem, and no number is missing.

    ``checked`` is from `recompute_stored_data`; ``missing`` from `find_nonfinite_stored_value`, or `compare_costates`
    where that is worse.
    """
    worst = missing
    if stored.maximised != (checked.need_problem("verify").sense < 0):
        worst = Worst(np.inf, "the problem and the solution optimise in opposite directions")
    for name, phase in checked.phases.items():
        for what in _PROBLEM_FIELDS:
            values = (_get_stored_value_arrays(owner, what) for owner in (stored.phases[name], phase))
            for a, b in zip(*values, strict=True):
                difference = float(np.max(_compute_relative_difference(a, b), initial=0.0))
                if difference > worst.value:
                    worst = Worst(difference, f"phase {name}, {what}")
    return check_value_within_tolerance(
        "stored numbers",
        worst,
        tolerance,
        "Stored numbers must be finite. Limits and model parameters must be those of the problem, and costates at "
        "segment ends and points must be those of their polynomials. A failure means that the solution belongs to "
        "another problem or was changed.",
    )


def compare_costates(samples: list[PhaseSamples]) -> Worst:
    """Return the largest difference, relative to the cost, between stored costates and their polynomials.

    Costates at the points of other schemes than Gauss are of lower order than the polynomials, and not compared.
    """
    worst = NO_VIOLATION
    for s in samples:
        phase, share = s.phase, s.state_scale / s.cost_scale
        comparisons = [
            ("the start of segment", phase.lam_start, phase.lam(phase.breaks[:-1], "right")),
            ("the end of segment", phase.lam_end, phase.lam(phase.breaks[1:], "left")),
        ]
        if phase.scheme == "LG":
            comparisons.append(("point", phase.point_costates, phase.lam(phase.point_times)))
        for what, values, polynomial in comparisons:
            error = np.nan_to_num(np.abs(values - polynomial) * share[:, None])  # NaN is reported separately
            i, k = np.unravel_index(np.argmax(error), error.shape)
            location = f"phase {phase.name}, {phase.states.labels[i]}, costate at {what} {k + 1}"
            worst = worst.select_larger(Worst(float(error[i, k]), location))
    return worst


def has_costates(samples: list[PhaseSamples], ends: EndGradients, amount: float) -> bool:
    """Return whether costates can be checked; all may be zero only in special cases.

    In these, an integral has a weight, or the cost of magnitude ``amount`` is nearly independent of the end points.
    """
    values = [v for s in samples for v in s.phase.lam.values]
    if any(np.any(np.isfinite(v) & (v != 0)) for v in values):
        return True
    if not all(np.all(np.isfinite(v)) for v in values):
        return False
    has_weights = any(np.any(s.phase.integral_weights != 0) for s in samples)
    return has_weights or all(
        _find_largest_endpoint_cost_change(s, ends) <= COSTATE_MIN_SHARE_OF_COST * amount for s in samples
    )


def _find_largest_endpoint_cost_change(s: PhaseSamples, ends: EndGradients) -> float:
    name = s.phase.name
    states = np.abs(np.concatenate([ends.initial_state[name], ends.final_state[name]]))
    times = np.abs(np.array([ends.initial_time[name], ends.final_time[name]]))
    return float(np.max(np.concatenate([states * np.tile(s.state_scale, 2), times * s.span])))


def _recompute_stored_phase_data(problem: Problem, solution: Solution, name: str) -> PhaseSolution:
    phase = problem.phases[name]
    return replace(
        solution.phases[name],
        integral_weights=np.zeros(len(phase.integrands)),
        **copy_problem_data_to_solution(problem, phase, solution.parameter_values),
    )


def _require_matching_problem_sizes(problem: Problem, solution: Solution) -> None:
    stored_sizes = {"phases": list(solution.phases), "free parameters": solution.parameter_values.size}
    required_sizes = {"phases": list(problem.phases), "free parameters": problem.parameters.size}
    stored_sizes["boundary constraints"] = solution.constraint_multipliers.size
    required_sizes["boundary constraints"] = len(problem.constraint_labels())
    if stored_sizes["phases"] == required_sizes["phases"]:
        for name, phase in problem.phases.items():
            stored, model = solution.phases[name], phase.model
            stored_sizes[f"sizes of phase '{name}'"] = [
                *(stored.states.size, stored.controls.size, stored.parameters.size),
                *(len(stored.path_labels), stored.integrals.size),
            ]
            required_sizes[f"sizes of phase '{name}'"] = [
                *(model.states.size, model.controls.size, model.parameters.size),
                *(len(phase.path_labels), len(phase.integrands)),
            ]
    for what, value in required_sizes.items():
        if stored_sizes[what] != value:
            raise ProblemError(
                f"the solution of '{solution.problem_name}' does not fit problem '{problem.name}': {what} are "
                f"{stored_sizes[what]} instead of {value}; check it with the problem that was solved."
            )


def _find_first_nonfinite_value(owner: Solution | PhaseSolution, place: str, with_costates: bool) -> Worst:
    for field in fields(owner):
        value = getattr(owner, field.name)
        if field.name in _COSTATE_FIELDS and not with_costates:
            continue
        if isinstance(value, PiecewisePolynomial):
            for k, piece in enumerate(value.values):
                if not np.all(np.isfinite(piece)):
                    segment = f"segment {k + 1} (from t = {value.breaks[k]:.6g})"
                    return Worst(float("inf"), f"{place}{segment}, {field.name} is not finite")
        elif isinstance(value, (float, np.ndarray)) and not np.all(np.isfinite(value)):
            return Worst(float("inf"), f"{place}{field.name} is not finite")
    return NO_VIOLATION


def _get_stored_value_arrays(phase: PhaseSolution, name: str) -> tuple[Array, ...]:
    value = getattr(phase, name)
    return (value.lower, value.upper) if isinstance(value, Interval) else (value,)


def _compute_relative_difference(a: Array, b: Array) -> Array:
    """Return |a - b| relative to the larger one; infinite if exactly one is infinite or a number is missing."""
    if a.shape != b.shape:
        return np.array([np.inf])
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = np.abs(a - b) / np.maximum(np.abs(a), np.abs(b))
    return np.where(a == b, 0.0, np.where(np.isfinite(shares), shares, np.inf))
