"""Design of discrete-time controllers from a model, and their export as C code and FMU."""

from functools import partial

from gnc_opt.control.c_export.c_code_export import CCode, export_c
from gnc_opt.control.design_report import DesignReport, ReportEntry
from gnc_opt.control.discrete_time_controller import Controller, initial_state_function, law_function
from gnc_opt.control.feedback_linearization import design_feedback_linearization
from gnc_opt.control.feedforward_and_reference_schedule import feedforward
from gnc_opt.control.fmu_export import Fmu, export_fmu
from gnc_opt.control.input_output_linearization import lie_derivative, output_errors, zero_dynamics
from gnc_opt.control.integral_sliding_mode import design_integral_sliding_mode
from gnc_opt.control.lqr import design_lqr
from gnc_opt.control.measurement_dropouts import with_dropout_handling
from gnc_opt.control.mpc import design_mpc
from gnc_opt.control.quadratic_cost import bryson
from gnc_opt.control.reaching_laws import ConstantRate, ExponentialRate, SaturationLayer, Sign, SuperTwisting
from gnc_opt.control.reference_trajectory import Reference, trim
from gnc_opt.control.sliding_mode import design_sliding_mode
from gnc_opt.control.super_twisting_observer import SuperTwistingObserver
from gnc_opt.control.tracking_error_dynamics import ErrorDynamics
from gnc_opt.control.tvlqr import design_tvlqr
from gnc_opt.renamed_public_names import raise_missing_name_error

__all__ = [
    "CCode",
    "ConstantRate",
    "Controller",
    "DesignReport",
    "ErrorDynamics",
    "ExponentialRate",
    "Fmu",
    "Reference",
    "ReportEntry",
    "SaturationLayer",
    "Sign",
    "SuperTwisting",
    "SuperTwistingObserver",
    "bryson",
    "design_feedback_linearization",
    "design_integral_sliding_mode",
    "design_lqr",
    "design_mpc",
    "design_sliding_mode",
    "design_tvlqr",
    "export_c",
    "export_fmu",
    "feedforward",
    "initial_state_function",
    "law_function",
    "lie_derivative",
    "output_errors",
    "trim",
    "with_dropout_handling",
    "zero_dynamics",
]

__getattr__ = partial(raise_missing_name_error, __name__)
