"""Optimal control: problem statement, transcription, solution, optimality check, refinement and studies."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the same names for type checkers
    from gnc_opt.planning.direct.solve_failure_report import SolveError
    from gnc_opt.planning.nlp import SolverOptions, Status
    from gnc_opt.planning.optimal_control_solver import Resolver, solve
    from gnc_opt.planning.problem import Phase, Problem
    from gnc_opt.planning.problem.active_constraint_arcs import Arc, ArcKind
    from gnc_opt.planning.problem.guess.guess_from_table import guess_from_data
    from gnc_opt.planning.problem.guess.simulated_guess import guess_from_simulation
    from gnc_opt.planning.refinement import RefinementLimits, refine
    from gnc_opt.planning.solution import PhaseSolution, Solution, load
    from gnc_opt.planning.solution.initial_nlp_point import guess_from_solution
    from gnc_opt.planning.solution.optimality_verdict import Condition, ConditionResult, LowerBound, Verdict
    from gnc_opt.planning.solution.refinement_history import History, RefinementStatus
    from gnc_opt.planning.study import (
        Continuation,
        ContinuationStatus,
        Minimum,
        Multistart,
        Sweep,
        continuation,
        multistart,
        sweep,
    )
    from gnc_opt.planning.study.cost_lower_bounds import lower_bound
    from gnc_opt.planning.study.solution_sensitivity import Sensitivity, sensitivity
    from gnc_opt.planning.transcription.mesh import Mesh
    from gnc_opt.planning.verification import verify, verify_trajectory

__all__ = [
    "Arc",
    "ArcKind",
    "Condition",
    "ConditionResult",
    "Continuation",
    "ContinuationStatus",
    "History",
    "LowerBound",
    "Mesh",
    "Minimum",
    "Multistart",
    "Phase",
    "PhaseSolution",
    "Problem",
    "RefinementLimits",
    "RefinementStatus",
    "Resolver",
    "Sensitivity",
    "Solution",
    "SolveError",
    "SolverOptions",
    "Status",
    "Sweep",
    "Verdict",
    "continuation",
    "guess_from_data",
    "guess_from_simulation",
    "guess_from_solution",
    "load",
    "lower_bound",
    "multistart",
    "refine",
    "sensitivity",
    "solve",
    "sweep",
    "verify",
    "verify_trajectory",
]

_NAMES_OF_MODULES = {
    "planning.direct.solve_failure_report": "SolveError",
    "planning.nlp": "SolverOptions Status",
    "planning.problem": "Phase Problem",
    "planning.problem.active_constraint_arcs": "Arc ArcKind",
    "planning.problem.guess.guess_from_table": "guess_from_data",
    "planning.problem.guess.simulated_guess": "guess_from_simulation",
    "planning.refinement": "RefinementLimits refine",
    "planning.solution": "PhaseSolution Solution load",
    "planning.solution.refinement_history": "History RefinementStatus",
    "planning.solution.optimality_verdict": "Condition LowerBound ConditionResult Verdict",
    "planning.solution.initial_nlp_point": "guess_from_solution",
    "planning.optimal_control_solver": "Resolver solve",
    "planning.study": (
        "Continuation ContinuationStatus Minimum Multistart Sweep continuation multistart sweep"
    ),
    "planning.study.cost_lower_bounds": "lower_bound",
    "planning.study.solution_sensitivity": "Sensitivity sensitivity",
    "planning.transcription.mesh": "Mesh",
    "planning.verification": "verify verify_trajectory",
}
_MODULES = {name: module for module, names in _NAMES_OF_MODULES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """Load a public name at its first use (PEP 562), which keeps the import fast."""
    if name in _MODULES:
        value = getattr(import_module(f"gnc_opt.{_MODULES[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
