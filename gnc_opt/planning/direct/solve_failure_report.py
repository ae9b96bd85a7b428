"""Failure of a solve: exception, message and remedies."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from gnc_opt.errors import GncOptError
from gnc_opt.planning.direct.fixed_mesh_solve import has_trajectory_guess
from gnc_opt.planning.nlp import Status
from gnc_opt.planning.problem.differentiability_checks import find_singular_norms
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.problem_check import describe_missing_bounds
from gnc_opt.planning.solution.solution import Solution

GUESS_DEPENDENT_STATUSES = (Status.INFEASIBLE, Status.RESTORATION_FAILED, Status.ITERATION_LIMIT)
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


def format_solve_failure_message(solution: Solution) -> str:
    """Return the message of a failed solve: status and most severe violation, then remedies as a list."""
    problem, status = solution.problem, solution.status
    linear_solver = re.search(r"linear_solver='(\w+)'", solution.provenance.get("options", ""))
    if status is Status.INVALID_OPTION and linear_solver and linear_solver[1] != "mumps":
        return (
            f"linear solver '{linear_solver[1]}' is not installed, or IPOPT rejects an option: no solution of "
            f"'{solution.problem_name}', status {status.value}. Install it (`extra` sets its library) or use 'mumps'."
        )
    worst = "all constraints hold at the last iterate"
    if solution.violations:
        first = solution.violations[0]
        worst = f"worst: {first.name}" + f" ({first.amount:.2g} of its scale)" * (not np.isnan(first.amount))
    meaning, _, remedy = status.remedy.partition(". ")
    remedies = [remedy]
    if problem:
        remedies += suggest_initial_guesses(problem) if status in GUESS_DEPENDENT_STATUSES else []
        norms = [text for phase in problem.phases.values() for text in find_singular_norms(problem, phase)]
        remedies += [f"{text}." for text in norms] + [describe_missing_bounds(problem)]
    ending = f"after {solution.statistics.iterations} iterations, status {status.value}"
    cause = f"no solution of '{solution.problem_name}' {ending}; {worst}. {meaning}."
    return "\n* ".join([cause, *(text[0].upper() + text[1:] for text in remedies if text)])


def suggest_initial_guesses(problem: Problem) -> list[str]:
    """Return remedies: useful guesses, and states of unknown magnitude; none if a trajectory is given."""
    if has_trajectory_guess(problem):
        return []
    hint = (
        "Give a trajectory as the guess: a simulation by go.guess_from_simulation(), waypoints in "
        "phase.guess(time=..., ...), or a simpler problem's solution in go.guess_from_solution(). For motion around a "
        "centre, give an arc instead of a straight line, or use polar coordinates."
    )
    names = _find_states_of_unknown_magnitude(problem)
    if not names:
        return [hint]
    listed = ", ".join(f"'{name}'" for name in names)
    return [hint, f"Start with {listed}, whose magnitude is unknown: use phase.guess({names[0]}=...)."]


def _find_states_of_unknown_magnitude(problem: Problem) -> list[str]:
    has_magnitude: dict[str, bool] = {}
    for phase in problem.phases.values():
        numbers, states = phase.numbers, phase.model.states
        boxes = (numbers.initial, numbers.final, numbers.states)
        known = np.any([np.isfinite(limit) for box in boxes for limit in (box.lower, box.upper)], axis=0)
        for name in states.names:
            by_constraint = any(state == name for _, state in phase.known_ends)
            here = by_constraint or name in numbers.guess.values or bool(np.any(known[states.slice(name)]))
            has_magnitude[name] = here or has_magnitude.get(name, False)
    return [name for name, known in has_magnitude.items() if not known]
