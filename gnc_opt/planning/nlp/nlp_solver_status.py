"""Status of an NLP solve, independent of the solver."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from gnc_opt.text_html_and_json_formatting import read_status_explanations

__all__ = ["Status", "read_solver_status"]


class Status(Enum):
    """Status of an NLP solve.

    The value is a stable lower-case string for files; `remedy` contains its meaning and a remedy.

    Examples
    --------
    >>> print(go.Status.INFEASIBLE.solved, go.Status.ACCEPTABLE.solved)
    False True
    """

    OPTIMAL = "optimal"
    ACCEPTABLE = "acceptable"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    NOT_A_NUMBER = "not_a_number"
    ITERATION_LIMIT = "iteration_limit"
    INTERRUPTED = "interrupted"
    RESTORATION_FAILED = "restoration_failed"
    SEARCH_DIRECTION_FAILED = "search_direction_failed"
    STEP_TOO_SMALL = "step_too_small"
    TOO_FEW_DEGREES_OF_FREEDOM = "too_few_degrees_of_freedom"
    INVALID_OPTION = "invalid_option"
    FAILED = "failed"

    @property
    def solved(self) -> bool:
        """Whether the iterate satisfies the optimality conditions (to full or to acceptable tolerance)."""
        return self in (Status.OPTIMAL, Status.ACCEPTABLE)

    @property
    def remedy(self) -> str:
        """Meaning of the status, and a remedy."""
        return _REMEDIES[self.value]


_REMEDIES = read_status_explanations("solve")

_FROM_NAME = {name: Status(value) for name, value in read_status_explanations("solver names").items()}

_FROM_UNIFIED: dict[str, Status] = {
    "SOLVER_RET_SUCCESS": Status.OPTIMAL,
    "SOLVER_RET_LIMITED": Status.ITERATION_LIMIT,
    "SOLVER_RET_NAN": Status.NOT_A_NUMBER,
    "SOLVER_RET_INFEASIBLE": Status.INFEASIBLE,
}


_FROM_WORD: dict[str, Status] = {
    "unbounded": Status.UNBOUNDED,
    "infeasible": Status.INFEASIBLE,
    "interrupt": Status.INTERRUPTED,
    "limit": Status.ITERATION_LIMIT,
}


def read_solver_status(stats: Mapping[str, object]) -> Status:
    """Return the `Status` of the `stats()` of a CasADi `nlpsol`; FAILED for unknown ones."""
    name = str(stats.get("return_status", ""))
    if name in _FROM_NAME:
        return _FROM_NAME[name]
    for word, status in _FROM_WORD.items():
        if word in name.lower():
            return status
    if stats.get("success"):
        return Status.OPTIMAL
    return _FROM_UNIFIED.get(str(stats.get("unified_return_status", "")), Status.FAILED)
