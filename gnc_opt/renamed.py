"""Former public names and their replacements, for error messages and the page "Renamed"."""

from __future__ import annotations

from enum import Enum
from typing import NoReturn

from gnc_opt.errors import GncOptError

RENAMED = {
    "gnc_opt.Experiment": "gnc_opt.Scenario",
    "gnc_opt.Explanation": "gnc_opt.DesignReport",
    "gnc_opt.Result": "gnc_opt.ConditionResult",
    "gnc_opt.analysis.Experiment": "gnc_opt.analysis.Scenario",
    "gnc_opt.analysis.Share": "gnc_opt.analysis.IntervalEstimate",
    "gnc_opt.bound_below": "gnc_opt.lower_bound",
    "gnc_opt.continue_in": "gnc_opt.continuation",
    "gnc_opt.control.Deviation": "gnc_opt.control.ErrorDynamics",
    "gnc_opt.control.Estimator": "gnc_opt.estimation.Estimator",
    "gnc_opt.control.Explanation": "gnc_opt.control.DesignReport",
    "gnc_opt.control.Fact": "gnc_opt.control.ReportEntry",
    "gnc_opt.control.FilterOptions": "gnc_opt.estimation.FilterOptions",
    "gnc_opt.control.FlightCode": "gnc_opt.control.CCode",
    "gnc_opt.control.Measurement": "gnc_opt.estimation.Measurement",
    "gnc_opt.control.MockupUnit": "gnc_opt.control.Fmu",
    "gnc_opt.control.bridge_dropouts": "gnc_opt.control.with_dropout_handling",
    "gnc_opt.control.design_ekf": "gnc_opt.estimation.design_ekf",
    "gnc_opt.control.design_neighbouring_optimal": "gnc_opt.guidance.design_neighbouring_optimal",
    "gnc_opt.control.design_ukf": "gnc_opt.estimation.design_ukf",
    "gnc_opt.control.first_memory": "gnc_opt.control.initial_state_function",
    "gnc_opt.control.law": "gnc_opt.control.law_function",
    "gnc_opt.control.output_feedback": "gnc_opt.estimation.output_feedback",
    "gnc_opt.simulate_guess": "gnc_opt.guess_from_simulation",
    "gnc_opt.simulation.Ball": "gnc_opt.simulation.UniformInBall",
    "gnc_opt.simulation.Consistency": "gnc_opt.analysis.Consistency",
    "gnc_opt.simulation.Constant": "gnc_opt.simulation.ConstantDisturbance",
    "gnc_opt.simulation.Ending": "gnc_opt.simulation.FinalValues",
    "gnc_opt.simulation.Expression": "gnc_opt.simulation.ExpressionDisturbance",
    "gnc_opt.simulation.Flight": "gnc_opt.simulation.CompiledLoop",
    "gnc_opt.simulation.Hold": "gnc_opt.simulation.ZeroOrderHold",
    "gnc_opt.simulation.InnovationTest": "gnc_opt.analysis.InnovationTest",
    "gnc_opt.simulation.MinimumImpulse": "gnc_opt.simulation.Deadband",
    "gnc_opt.simulation.NonNegativeAllocation": "gnc_opt.simulation.Allocation",
    "gnc_opt.simulation.Occurrence": "gnc_opt.simulation.EventOccurrence",
    "gnc_opt.simulation.Outage": "gnc_opt.simulation.SensorOutage",
    "gnc_opt.simulation.RandomHold": "gnc_opt.simulation.PiecewiseConstantNoise",
    "gnc_opt.simulation.Replanner": "gnc_opt.guidance.Replanner",
    "gnc_opt.simulation.Sampling": "gnc_opt.simulation.ZeroOrderHold",
    "gnc_opt.simulation.Scale": "gnc_opt.simulation.ScaleFactor",
    "gnc_opt.simulation.SensorDelay": "gnc_opt.simulation.Delay",
    "gnc_opt.simulation.Sinusoid": "gnc_opt.simulation.SinusoidalDisturbance",
    "gnc_opt.simulation.Sphere": "gnc_opt.simulation.RandomDirection",
    "gnc_opt.simulation.Turn": "gnc_opt.simulation.RandomRotation",
    "gnc_opt.simulation.consistency": "gnc_opt.analysis.consistency",
}
"""Present full name of each former full name."""

REMOVED = {
    "gnc_opt.analysis.correlations": "scipy.stats.spearmanr on `campaign.parameters` and `campaign.measure(name)`",
    "gnc_opt.control.CodeOptions": "the keywords of `export_c`",
    "gnc_opt.control.GuidanceOptions": "the keywords of `gnc_opt.guidance.design_neighbouring_optimal`",
    "gnc_opt.control.PowerRate": "`ExponentialRate` or `SuperTwisting`",
    "gnc_opt.control.decoupling_matrix": "`output_errors(model, reference, outputs)`, which has it as an attribute",
    "gnc_opt.control.design_hierarchical_sliding_mode": "`design_sliding_mode` with a weighted sum of surfaces",
    "gnc_opt.control.design_neighbouring_extremal": "`design_tvlqr` along the plan, or a `Replanner`",
    "gnc_opt.control.design_scheduled_ekf": "`gnc_opt.estimation.design_ekf`",
    "gnc_opt.control.relative_degrees": "`output_errors(model, reference, outputs)`, which has them as an attribute",
    "gnc_opt.design_hierarchical_sliding_mode": "`design_sliding_mode` with a weighted sum of surfaces",
    "gnc_opt.design_neighbouring_extremal": "`design_tvlqr` along the plan, or a `Replanner`",
    "gnc_opt.design_scheduled_ekf": "`design_ekf`",
    "gnc_opt.plot.plot_refinement": "`solution.history` or the table in `write_report`",
    "gnc_opt.polish": "`refine`, which gives exact switching times",
    "gnc_opt.report.write_run_report": "`plot_run`, or `write_campaign_report`",
}
"""Replacement of each removed full name."""

RENAMED_STATUS_WORDS = {
    "alarm": "controller_alarm",
    "inaccurate": "integration_error",
    "not finite": "not_finite",
    "pass_limit": "iteration_limit",
    "refused": "invalid_parameters",
    "stopped": "terminated_by_event",
    "vanished": "branch_ended",
    "verdict_fails": "conditions_fail",
    "work_limit": "budget_limit",
}
"""Present word of each former status word: the member name in lower case."""

RENAMED_PARAMETERS = {"experiment": "scenario", "judge": "measures"}
"""Present name of each former parameter."""


class StatusWord(Enum):
    """Enumeration of statuses that accepts former words, so that older files can be loaded."""

    @classmethod
    def _missing_(cls, value: object) -> Enum | None:
        return cls._value2member_map_.get(RENAMED_STATUS_WORDS.get(str(value)))


class RenamedError(GncOptError, ImportError):
    """Use of a former name; an `ImportError`, because Python replaces the text of an `AttributeError`."""


def raise_missing_name(module: str, name: str) -> NoReturn:
    """Raise the error of a name that the module lacks: `RenamedError` with the replacement if it had the name."""
    former = f"{module}.{name}"
    if former in RENAMED:
        raise RenamedError(f"{former} is now {RENAMED[former]}: see the page 'Renamed' of the documentation.")
    if former in REMOVED:
        raise RenamedError(f"{former} is removed: use {REMOVED[former]}.")
    raise AttributeError(f"module {module!r} has no attribute {name!r}")
