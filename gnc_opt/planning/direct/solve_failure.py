"""A solve that failed, as an error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.errors import GncOptError
from gnc_opt.planning.direct.solve_mesh import has_trajectory_guess
from gnc_opt.planning.nlp import Status
from gnc_opt.planning.problem.check_functions import singular_norms
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.problem_check import missing_bounds_text
from gnc_opt.planning.solution.solution import Solution

GUESS_HELPS = (Status.INFEASIBLE, Status.RESTORATION_FAILED, Status.ITERATION_LIMIT)
"""Endings of a way through the iterates that another start may spare."""


class SolveError(GncOptError, RuntimeError):
    """The solver did not reach a solution; `solution` holds the last iterate and its status.

    On its way to another process the iterate loses its problem, whose symbols cannot travel;
    ``error.solution.with_problem(problem)`` joins the two again.
    """

    def __init__(self, message: str, solution: Solution) -> None:
        super().__init__(message)
        self.solution = solution

    def __reduce__(self) -> tuple[type[SolveError], tuple[str, Solution]]:
        return type(self), (str(self), replace(self.solution, problem=None))


def format_failure(solution: Solution) -> str:
    """Return what a failed solve raises: status, worst constraint, remedy, what to guess, and norms to declare."""
    worst = "all constraints hold at the last iterate"
    if solution.violations:
        first = solution.violations[0]
        amount = "" if np.isnan(first.amount) else f" ({first.amount:.2g} of its scale)"
        worst = f"worst: {first.name}{amount}"
    problem = solution.problem
    norms = (
        [text for leg in problem.phases.values() for text in singular_norms(problem, leg)] if problem else []
    )
    return (
        f"no solution of '{solution.problem_name}' after {solution.statistics.iterations} iterations, "
        f"status {solution.status.value}; {worst}. {solution.status.remedy}"
        + (suggest_better_guess(problem) if problem and solution.status in GUESS_HELPS else "")
        + "".join(f" And {text}." for text in norms)
        + (f" And {missing}" if problem and (missing := missing_bounds_text(problem)) else "")
    )


def suggest_better_guess(problem: Problem) -> str:
    """Return which kind of guess can help, and the states of unknown size; empty where a trajectory is given."""
    if has_trajectory_guess(problem):
        return ""
    hint = (
        " Guesses that help are trajectories: one that go.guess_from_simulation() flies, waypoints over time in "
        "with_guess(phase, times, ...) (about a centre on an arc, not a straight line; or state the problem in polar "
        "coordinates), or a simpler problem's solution in go.guess_from_solution()."
    )
    names = _find_unsized_states(problem)
    if not names:
        return hint
    listed = ", ".join(f"'{name}'" for name in names)
    return (
        f"{hint} Begin with {listed}: no bound, end value or guess gives the size; use "
        f"with_guess(phase, {names[0]}=...)."
    )


def _find_unsized_states(problem: Problem) -> list[str]:
    """Return the states of which neither a bound, nor an end, nor a guess is known in any phase."""
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
