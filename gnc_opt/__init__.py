"""gnc_opt: trajectory optimisation for guidance, navigation and control, with a verdict on every answer."""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gnc_opt.analysis import Experiment, LinearCovariance, linear_covariance
    from gnc_opt.bound_below import bound_below
    from gnc_opt.control import (
        Controller,
        Explanation,
        Reference,
        bryson,
        design_ekf,
        design_feedback_linearization,
        design_hierarchical_sliding_mode,
        design_integral_sliding_mode,
        design_lqr,
        design_mpc,
        design_neighbouring_extremal,
        design_neighbouring_optimal,
        design_scheduled_ekf,
        design_sliding_mode,
        design_tvlqr,
        design_ukf,
        export_c,
        export_fmu,
        feedforward,
        output_feedback,
    )
    from gnc_opt.errors import (
        ArgumentError,
        DesignError,
        GncOptError,
        ModelError,
        ProblemError,
        ProblemWarning,
        UnknownAttributeError,
        UnknownNameError,
    )
    from gnc_opt.model import Model
    from gnc_opt.model.smooth import smooth_abs
    from gnc_opt.model.table import Table, table, table_from_csv
    from gnc_opt.nlp import SolverOptions, Status
    from gnc_opt.problem import Phase, Problem
    from gnc_opt.problem.arc import Arc, ArcKind
    from gnc_opt.problem.guess.data import guess_from_data
    from gnc_opt.problem.guess.simulate import simulate_guess
    from gnc_opt.refine import (
        History,
        Minimum,
        Multistart,
        RefinementLimits,
        RefinementStatus,
        multistart,
        polish,
        refine,
    )
    from gnc_opt.refine.sensitivity.derivatives import Sensitivity
    from gnc_opt.refine.sensitivity.sensitivity import sensitivity
    from gnc_opt.resolve import Resolver
    from gnc_opt.simulation import Campaign, ClosedLoop, Outcome, Run, RunStatus, monte_carlo
    from gnc_opt.solution import PhaseSolution, Solution, load
    from gnc_opt.solution.failure import SolveError
    from gnc_opt.solution.lower_bound import LowerBound
    from gnc_opt.solution.start import guess_from_solution
    from gnc_opt.solve import solve
    from gnc_opt.study import Continuation, ContinuationStatus, Sweep, continue_in, sweep
    from gnc_opt.transcription.mesh import Mesh
    from gnc_opt.verify import Condition, Result, Verdict, verify, verify_trajectory

__all__ = [
    "Arc",
    "ArcKind",
    "ArgumentError",
    "Campaign",
    "ClosedLoop",
    "Condition",
    "Continuation",
    "ContinuationStatus",
    "Controller",
    "DesignError",
    "Experiment",
    "Explanation",
    "GncOptError",
    "History",
    "LinearCovariance",
    "LowerBound",
    "Mesh",
    "Minimum",
    "Model",
    "ModelError",
    "Multistart",
    "Outcome",
    "Phase",
    "PhaseSolution",
    "Problem",
    "ProblemError",
    "ProblemWarning",
    "Reference",
    "RefinementLimits",
    "RefinementStatus",
    "Resolver",
    "Result",
    "Run",
    "RunStatus",
    "Sensitivity",
    "Solution",
    "SolveError",
    "SolverOptions",
    "Status",
    "Sweep",
    "Table",
    "UnknownAttributeError",
    "UnknownNameError",
    "Verdict",
    "bound_below",
    "bryson",
    "continue_in",
    "design_ekf",
    "design_feedback_linearization",
    "design_hierarchical_sliding_mode",
    "design_integral_sliding_mode",
    "design_lqr",
    "design_mpc",
    "design_neighbouring_extremal",
    "design_neighbouring_optimal",
    "design_scheduled_ekf",
    "design_sliding_mode",
    "design_tvlqr",
    "design_ukf",
    "export_c",
    "export_fmu",
    "feedforward",
    "guess_from_data",
    "guess_from_solution",
    "linear_covariance",
    "load",
    "monte_carlo",
    "multistart",
    "output_feedback",
    "polish",
    "refine",
    "sensitivity",
    "simulate_guess",
    "smooth_abs",
    "solve",
    "sweep",
    "table",
    "table_from_csv",
    "verify",
    "verify_trajectory",
]

_HOLDS = {  # what each module holds of these
    "analysis": "Experiment LinearCovariance linear_covariance",
    "bound_below": "bound_below",
    "control": (
        "Controller Explanation Reference bryson design_ekf design_feedback_linearization "
        "design_hierarchical_sliding_mode design_integral_sliding_mode design_lqr design_mpc "
        "design_neighbouring_extremal design_neighbouring_optimal design_scheduled_ekf design_sliding_mode "
        "design_tvlqr design_ukf export_c export_fmu feedforward output_feedback"
    ),
    "errors": (
        "ArgumentError DesignError GncOptError ModelError ProblemError ProblemWarning UnknownAttributeError "
        "UnknownNameError"
    ),
    "model": "Model",
    "model.smooth": "smooth_abs",
    "model.table": "Table table table_from_csv",
    "nlp": "SolverOptions Status",
    "problem": "Phase Problem",
    "problem.arc": "Arc ArcKind",
    "problem.guess.data": "guess_from_data",
    "problem.guess.simulate": "simulate_guess",
    "refine": "History Minimum Multistart RefinementLimits RefinementStatus multistart polish refine",
    "refine.sensitivity.derivatives": "Sensitivity",
    "refine.sensitivity.sensitivity": "sensitivity",
    "resolve": "Resolver",
    "simulation": "Campaign ClosedLoop Outcome Run RunStatus monte_carlo",
    "solution": "PhaseSolution Solution load",
    "solution.failure": "SolveError",
    "solution.lower_bound": "LowerBound",
    "solution.start": "guess_from_solution",
    "solve": "solve",
    "study": "Continuation ContinuationStatus Sweep continue_in sweep",
    "transcription.mesh": "Mesh",
    "verify": "Condition Result Verdict verify verify_trajectory",
}
_MODULES = {name: module for module, names in _HOLDS.items() for name in names.split()}
_ROOMS = [
    "analysis",
    "control",
    "model",
    "plot",
    "problem",
    "report",
    "simulation",
    "solution",
    "spacecraft",
    "study",
]


class _Package(ModuleType):
    """Loads what it is asked for, and what that needs: all together takes several times as long as NumPy and CasADi."""

    def __getattr__(self, name: str) -> Any:
        if name in _MODULES:
            value = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
            setattr(self, name, value)
            return value
        if name in _ROOMS:
            return import_module(f"{__name__}.{name}")
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __setattr__(self, name: str, value: Any) -> None:
        """Set what `import` sets but modules that have the name of a function (`solve`): the name is the function's."""
        if not (name in _MODULES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        """What is sent to other processes may refer to the package."""
        return import_module, (self.__name__,)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *__all__, *_ROOMS})


if not TYPE_CHECKING:  # Type checkers would take any name for one of the package.
    sys.modules[__name__].__class__ = _Package
