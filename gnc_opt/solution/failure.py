"""A solve that failed, as an error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gnc_opt.errors import GncOptError
from gnc_opt.problem.check_norms import norms_by_hand
from gnc_opt.solution.solution import Solution


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


def failure_message(solution: Solution) -> str:
    """Return what a failed solve raises: status, worst constraint, remedy, and norms that are written by hand."""
    worst = "all constraints hold at the last iterate"
    if solution.violations:
        first = solution.violations[0]
        amount = "" if np.isnan(first.amount) else f" ({first.amount:.2g} of its scale)"
        worst = f"worst: {first.name}{amount}"
    problem = solution.problem
    norms = (
        [text for leg in problem.phases.values() for text in norms_by_hand(problem, leg)] if problem else []
    )
    return (
        f"no solution of '{solution.problem_name}' after {solution.statistics.iterations} iterations, "
        f"status {solution.status.value}; {worst}. {solution.status.remedy}"
        + "".join(f" And {text}." for text in norms)
    )
