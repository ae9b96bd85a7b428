"""Failure of a solve: exception, message and remedies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.errors import GncOptError
from gnc_opt.planning.direct.fixed_mesh_solve import has_trajectory_guess
from gnc_opt.planning.nlp import Status
from gnc_opt.planning.problem.differentiability_checks import find_singular_norms
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.problem_check import describe_missing_bounds
from gnc_opt.planning.solution.solution import Solution

GUESS_HELPS = (Status.INFEASIBLE, Status.RESTORATION_FAILED, Status.ITERATION_LIMIT)
"""Statuses of failures that another initial guess may avoid."""


class SolveError(GncOptError, RuntimeError):
    """The solver did not find a solution; `solution` contains the last iterate and its status.

    The problem of the iterate is not pickled, because its symbols cannot be pickled;
    ``error.solution.with_problem(problem)`` restores it.
    """

    def __init__(self, message: str, solution: Solution) -> None:
        super().__init__(message)
        self.solution = solution

    def __reduce__(self) -> tuple[type[SolveError], tuple[str, Solution]]:
        return type(self), (str(self), replace(self.solution, problem=None))


def format_failure(solution: Solution) -> str:
    """Return the message of a failed solve: status, worst constraint, remedies for guess and norms."""
    worst = "all constraints hold at the last iterate"
    if solution.violations:
        first = solution.violations[0]
        amount = "" if np.isnan(first.amount) else f" ({first.amount:.2g} of its scale)"
        worst = f"worst: {first.name}{amount}"
    problem = solution.problem
    norms = (
        [text for leg in problem.phases.values() for text in find_singular_norms(problem, leg)]
        if problem
        else []
    )
    return (
        f"no solution of '{solution.problem_name}' after {solution.statistics.iterations} iterations, "
        f"status {solution.status.value}; {worst}. {solution.status.remedy}"
        + (suggest_better_guess(problem) if problem and solution.status in GUESS_HELPS else "")
        + "".join(f" And {text}." for text in norms)
        + (f" And {missing}" if problem and (missing := describe_missing_bounds(problem)) else "")
    )


def suggest_better_guess(problem: Problem) -> str:
    """Return a remedy on useful guesses, with states of unknown magnitude; "" if a trajectory is given."""
    if has_trajectory_guess(problem):
        return ""
    hint = (
        " Guesses that help are trajectories: a simulation by go.guess_from_simulation(), waypoints over time in "
        "with_guess(phase, times, ...) (around a centre an arc instead of a straight line; or use polar "
        "coordinates), or a simpler problem's solution in go.guess_from_solution()."
    )
    names = _find_states_without_scale(problem)
    if not names:
        return hint
    listed = ", ".join(f"'{name}'" for name in names)
    return f"{hint} Start with {listed}, whose magnitude is unknown: use with_guess(phase, {names[0]}=...)."


def _find_states_without_scale(problem: Problem) -> list[str]:
    told: dict[str, bool] = {}
    for leg in problem.phases.values():
        numbers, states = leg.numbers, leg.model.states
        boxes = (numbers.initial, numbers.final, numbers.states)
        known = np.any([np.isfinite(limit) for box in boxes for limit in (box.lower, box.upper)], axis=0)
        for name in states.names:
            by_constraint = any(state == name for _, state in leg.told)
            here = by_constraint or name in numbers.guess.values or bool(np.any(known[states.slice(name)]))
            told[name] = here or told.get(name, False)
    return [name for name, known in told.items() if not known]
