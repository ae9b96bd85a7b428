"""Violations of an unsolved iterate, by name in descending order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import EQUAL
from gnc_opt.planning.nlp import NlpResult, Status
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.differentiability_checks import find_nonfinite_function
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.transcription.scaling import Scaling
from gnc_opt.planning.transcription.transcription import Transcription

_MAX_VIOLATIONS = 10
_DIVERGED_MIN_SIZE = 1e6
"""Magnitude of scaled variables above which they are named for an unbounded problem."""


@dataclass(frozen=True)
class Violation:
    """Violated constraint or bound of an iterate.

    Attributes
    ----------
    name : str
        For example ``"v_L[2] defect, phase approach, segment 3, point 2"``.
    amount : float
        Size, relative to the scale of the row or variable.

    Examples
    --------
    >>> failed = go.solve(problem.with_bounds(a=(-0.01, 0.01)), mesh="4x3", tol=None, throw=False)
    >>> print(failed.status.value, failed.violations[0].amount > 0.0)
    infeasible True
    """

    name: str
    amount: float


def list_iterate_violations(
    transcription: Transcription,
    problem: Problem,
    result: NlpResult,
    scaling: Scaling,
    phases: dict[str, PhaseSolution],
    parameters: Array,
) -> tuple[Violation, ...]:
    """Return the violations of the iterate in descending order, relative to the scales of rows and variables.

    First come diverging variables if the problem is unbounded, and non-finite functions if these stopped the solver.
    """
    if result.status.solved or result.status is Status.INVALID_OPTION:  # the latter: no iterate
        return ()
    causes: list[Violation] = []
    if result.status is Status.UNBOUNDED:
        causes = _find_unbounded_variables(transcription, result.x)
    if result.status is Status.NOT_A_NUMBER:
        causes = _find_nonfinite(problem, phases, parameters)
    rows = _find_violated_constraint_rows(transcription, problem, result, scaling)
    return (*causes, *rows)[:_MAX_VIOLATIONS]


def _find_violated_constraint_rows(
    transcription: Transcription, problem: Problem, result: NlpResult, scaling: Scaling
) -> list[Violation]:
    rows, bounds = transcription.get_constraint_bounds(problem), transcription.get_variable_bounds(problem)
    scaled_rows = Interval(rows.lower * scaling.rows, rows.upper * scaling.rows)
    scaled_box = Interval(bounds.lower / scaling.variables, bounds.upper / scaling.variables)
    limits_and_values = (scaled_rows, result.g), (scaled_box, result.x)
    amounts = np.concatenate([limits.compute_bound_violation(values) for limits, values in limits_and_values])
    bound_labels = [f"bound of {label}" for label in transcription.variable_labels]
    labels = (*transcription.constraint_row_labels, *bound_labels)
    worst = np.argsort(-np.where(np.isnan(amounts), np.inf, amounts), kind="stable")[:_MAX_VIOLATIONS]
    return [Violation(labels[i], float(amounts[i])) for i in worst if not amounts[i] <= EQUAL]


def _find_unbounded_variables(transcription: Transcription, scaled: Array) -> list[Violation]:
    largest: dict[str, Violation] = {}
    for i in np.argsort(-np.abs(scaled), kind="stable"):
        if not abs(scaled[i]) > _DIVERGED_MIN_SIZE:
            break
        label = transcription.variable_labels[i]
        largest.setdefault(label.split(",")[0], Violation(f"{label} diverges", float(abs(scaled[i]))))
    return list(largest.values())


def _find_nonfinite(problem: Problem, phases: dict[str, PhaseSolution], parameters: Array) -> list[Violation]:
    violations = []
    for name, phase in phases.items():
        times = phase.point_times
        trajectory = times, phase.x(times), phase.u(times)
        nonfinite = find_nonfinite_function(problem, problem.phases[name], *trajectory, parameters)
        if nonfinite:
            time = f"t = {nonfinite.time:.4g} {problem.time_unit}"
            violations.append(Violation(f"{nonfinite.what}, phase {name}, {time}", np.nan))
    return violations
