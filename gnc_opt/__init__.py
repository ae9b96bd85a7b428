"""gnc_opt: trajectory optimisation for guidance, navigation and control, with optimality checks of solutions."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the same names for type checkers
    from gnc_opt.analysis import LinearCovariance, Scenario, linear_covariance
    from gnc_opt.control import (
        Controller,
        DesignReport,
        Reference,
        bryson,
        design_feedback_linearization,
        design_integral_sliding_mode,
        design_lqr,
        design_mpc,
        design_sliding_mode,
        design_tvlqr,
        export_c,
        export_fmu,
        feedforward,
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
    from gnc_opt.estimation import design_ekf, design_ukf, output_feedback
    from gnc_opt.guidance import design_neighbouring_optimal
    from gnc_opt.model import Model
    from gnc_opt.model.casadi_expression_graph import smooth_abs
    from gnc_opt.model.lookup_table import Table, table, table_from_csv
    from gnc_opt.planning import (
        Arc,
        ArcKind,
        Condition,
        ConditionResult,
        Continuation,
        ContinuationStatus,
        History,
        LowerBound,
        Mesh,
        Minimum,
        Multistart,
        Phase,
        PhaseSolution,
        Problem,
        RefinementLimits,
        RefinementStatus,
        Resolver,
        Sensitivity,
        Solution,
        SolveError,
        SolverOptions,
        Status,
        Sweep,
        Verdict,
        continuation,
        guess_from_data,
        guess_from_simulation,
        guess_from_solution,
        load,
        lower_bound,
        multistart,
        refine,
        sensitivity,
        solve,
        sweep,
        verify,
        verify_trajectory,
    )
    from gnc_opt.simulation import Campaign, ClosedLoop, Outcome, Run, RunStatus, monte_carlo

__all__ = [
    "Arc",
    "ArcKind",
    "ArgumentError",
    "Campaign",
    "ClosedLoop",
    "Condition",
    "ConditionResult",
    "Continuation",
    "ContinuationStatus",
    "Controller",
    "DesignError",
    "DesignReport",
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
    "Run",
    "RunStatus",
    "Scenario",
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
    "bryson",
    "continuation",
    "design_ekf",
    "design_feedback_linearization",
    "design_integral_sliding_mode",
    "design_lqr",
    "design_mpc",
    "design_neighbouring_optimal",
    "design_sliding_mode",
    "design_tvlqr",
    "design_ukf",
    "export_c",
    "export_fmu",
    "feedforward",
    "guess_from_data",
    "guess_from_simulation",
    "guess_from_solution",
    "linear_covariance",
    "load",
    "lower_bound",
    "monte_carlo",
    "multistart",
    "output_feedback",
    "refine",
    "sensitivity",
    "smooth_abs",
    "solve",
    "sweep",
    "table",
    "table_from_csv",
    "verify",
    "verify_trajectory",
]

_NAMES_OF_MODULES = {
    "analysis": "Scenario LinearCovariance linear_covariance",
    "control": (
        "Controller DesignReport Reference bryson design_feedback_linearization "
        "design_integral_sliding_mode design_lqr design_mpc "
        "design_sliding_mode design_tvlqr export_c export_fmu feedforward"
    ),
    "errors": (
        "ArgumentError DesignError GncOptError ModelError ProblemError ProblemWarning "
        "UnknownAttributeError UnknownNameError"
    ),
    "estimation": "design_ekf design_ukf output_feedback",
    "guidance": "design_neighbouring_optimal",
    "model": "Model",
    "model.casadi_expression_graph": "smooth_abs",
    "model.lookup_table": "Table table table_from_csv",
    "planning": (
        "Arc ArcKind Condition Continuation ContinuationStatus History LowerBound Mesh Minimum "
        "Multistart Phase PhaseSolution Problem RefinementLimits RefinementStatus Resolver ConditionResult "
        "Sensitivity Solution SolveError SolverOptions Status Sweep Verdict lower_bound continuation "
        "guess_from_data guess_from_solution load multistart refine sensitivity "
        "guess_from_simulation solve sweep verify verify_trajectory"
    ),
    "simulation": "Campaign ClosedLoop Outcome Run RunStatus monte_carlo",
}
_MODULES = {name: module for module, names in _NAMES_OF_MODULES.items() for name in names.split()}
_PACKAGES = [
    "analysis",
    "control",
    "estimation",
    "guidance",
    "model",
    "planning",
    "plot",
    "report",
    "simulation",
    "spacecraft",
]


def __getattr__(name: str) -> Any:
    """Load a public name at its first use (PEP 562), which keeps the import fast."""
    if name in _MODULES:
        value = getattr(import_module(f"gnc_opt.{_MODULES[name]}"), name)
        globals()[name] = value
        return value
    if name in _PACKAGES:
        return import_module(f"gnc_opt.{name}")
    if name == "__version__":
        from gnc_opt.threads_and_package_versions import get_package_version

        return get_package_version("gnc_opt")
    from gnc_opt.renamed_public_names import raise_missing_name_error

    return raise_missing_name_error(__name__, name)


def __dir__() -> list[str]:
    return [*__all__, *_PACKAGES]
