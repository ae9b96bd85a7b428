"""Status of an NLP solve, independent of the solver."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

__all__ = ["Status", "status_from_stats"]


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
        return _REMEDIES[self]


_REMEDIES: dict[Status, str] = {
    Status.OPTIMAL: "The optimality conditions hold to the requested tolerance. Nothing needs to be done.",
    Status.ACCEPTABLE: (
        "The optimality conditions hold only to the solver's looser, acceptable tolerance. "
        "Improve the scaling, or raise the tolerance above the rounding errors of the problem."
    ),
    Status.INFEASIBLE: (
        "Near the last iterate no point satisfies all constraints. Look for bounds and boundary conditions "
        "that contradict each other or allow too little time; if there are none, start from a better guess."
    ),
    Status.UNBOUNDED: (
        "The iterates or the objective diverge. Bound the variables that grow, and check the sign of the objective."
    ),
    Status.NOT_A_NUMBER: (
        "A function or a derivative is NaN or infinite at an iterate. Move the guess away from the singularity "
        "(square root, logarithm or division at zero), or exclude it by bounds of the variables."
    ),
    Status.ITERATION_LIMIT: (
        "The iteration limit was reached before convergence. Improve scaling and guess, or raise `max_iterations` "
        "if the residuals are still decreasing."
    ),
    Status.INTERRUPTED: (
        "Ctrl-C, the wall-time limit or the callback stopped the solve; the last iterate is not a solution. "
        "Use it as the guess to continue."
    ),
    Status.RESTORATION_FAILED: (
        "The solver could not reduce the constraint violation further, but did not prove infeasibility. "
        "Look for contradictory or redundant constraints, then improve scaling and guess."
    ),
    Status.SEARCH_DIRECTION_FAILED: (
        "The solver found no usable step even with heavy regularisation. Look for redundant constraints, "
        "wrong or infinite derivatives, poor scaling, or an objective without a lower bound."
    ),
    Status.STEP_TOO_SMALL: (
        "The steps became too small before the tolerance was met. The iterate may have the accuracy that rounding "
        "permits: check the residuals, then improve the scaling or loosen the tolerance."
    ),
    Status.TOO_FEW_DEGREES_OF_FREEDOM: (
        "There are more equality constraints than free variables. Remove redundant boundary conditions, "
        "or free a time, a parameter or a control."
    ),
    Status.INVALID_OPTION: (
        "The solver rejected an option or the problem's definition. Check `extra`, and that `linear_solver` "
        "is installed on this machine (CasADi does not include the HSL solvers)."
    ),
    Status.FAILED: (
        "The solver failed with an internal error. Solve again with `SolverOptions(verbose=True)`, which shows its "
        "messages, or with another linear solver."
    ),
}

_FROM_NAME: dict[str, Status] = {
    "Solve_Succeeded": Status.OPTIMAL,
    "Solved_To_Acceptable_Level": Status.ACCEPTABLE,
    "Feasible_Point_Found": Status.ACCEPTABLE,  # square problem: no objective
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Search_Direction_Becomes_Too_Small": Status.STEP_TOO_SMALL,
    "Diverging_Iterates": Status.UNBOUNDED,
    "User_Requested_Stop": Status.INTERRUPTED,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
    "Restoration_Failed": Status.RESTORATION_FAILED,
    "Error_In_Step_Computation": Status.SEARCH_DIRECTION_FAILED,
    "Maximum_CpuTime_Exceeded": Status.INTERRUPTED,
    "Maximum_WallTime_Exceeded": Status.INTERRUPTED,
    "Not_Enough_Degrees_Of_Freedom": Status.TOO_FEW_DEGREES_OF_FREEDOM,
    "Invalid_Problem_Definition": Status.INVALID_OPTION,
    "Invalid_Option": Status.INVALID_OPTION,
    "Invalid_Number_Detected": Status.NOT_A_NUMBER,
    "Unrecoverable_Exception": Status.FAILED,
    "NonIpopt_Exception_Thrown": Status.FAILED,
    "Insufficient_Memory": Status.FAILED,
    "Internal_Error": Status.FAILED,
}

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


def status_from_stats(stats: Mapping[str, object]) -> Status:
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
