"""Solutions: polynomials, costates, accuracy, verdict, warm starts, files."""

from gnc_opt.planning.solution.constraint_violation_diagnosis import Violation
from gnc_opt.planning.solution.optimality_verdict import Condition, ConditionResult, LowerBound, Verdict
from gnc_opt.planning.solution.phase_solution import PhaseSolution, Signal
from gnc_opt.planning.solution.refinement_history import History, RefinementStatus, Statistics
from gnc_opt.planning.solution.solution import Solution, load
from gnc_opt.planning.solution.solution_accuracy import Accuracy

__all__ = [
    "Accuracy",
    "Condition",
    "ConditionResult",
    "History",
    "LowerBound",
    "PhaseSolution",
    "RefinementStatus",
    "Signal",
    "Solution",
    "Statistics",
    "Verdict",
    "Violation",
    "load",
]
