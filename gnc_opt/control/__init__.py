"""Controllers from the model that the trajectory came from: each a symbolic discrete-time law with its reasons."""

from gnc_opt.control.controller import Controller, first_memory, law
from gnc_opt.control.deviation import Deviation
from gnc_opt.control.dropout import bridge_dropouts
from gnc_opt.control.estimation.estimator import Estimator, output_feedback
from gnc_opt.control.estimation.kalman import design_ekf, design_ukf
from gnc_opt.control.estimation.measurement import Measurement
from gnc_opt.control.estimation.options import FilterOptions, UnscentedOptions
from gnc_opt.control.estimation.scheduled import design_scheduled_ekf
from gnc_opt.control.explanation import Explanation, Fact
from gnc_opt.control.feedback_linearization import design_feedback_linearization
from gnc_opt.control.feedforward import feedforward
from gnc_opt.control.flight_code import CodeOptions, FlightCode, export_c
from gnc_opt.control.functional_mockup import MockupUnit, export_fmu
from gnc_opt.control.lie import (
    decoupling_matrix,
    lie_derivative,
    output_errors,
    relative_degrees,
    zero_dynamics,
)
from gnc_opt.control.linear.gain_schedule import design_gain_schedule
from gnc_opt.control.linear.lqr import design_lqr
from gnc_opt.control.linear.tvlqr import design_tvlqr
from gnc_opt.control.linear.weights import bryson
from gnc_opt.control.neighbouring.design import GuidanceOptions, design_neighbouring_optimal
from gnc_opt.control.neighbouring.extremal import design_neighbouring_extremal
from gnc_opt.control.predictive.mpc import design_mpc
from gnc_opt.control.reference import Reference, trim
from gnc_opt.control.sliding.hierarchical import design_hierarchical_sliding_mode
from gnc_opt.control.sliding.integral_sliding_mode import design_integral_sliding_mode
from gnc_opt.control.sliding.reaching import (
    ConstantRate,
    ExponentialRate,
    PowerRate,
    SaturationLayer,
    Sign,
    SuperTwisting,
    TanhLayer,
)
from gnc_opt.control.sliding.reaching_mpc import PredictiveReaching
from gnc_opt.control.sliding.sliding_mode import design_sliding_mode
from gnc_opt.control.sliding.super_twisting import SuperTwistingObserver

__all__ = [
    "CodeOptions",
    "ConstantRate",
    "Controller",
    "Deviation",
    "Estimator",
    "Explanation",
    "ExponentialRate",
    "Fact",
    "FilterOptions",
    "FlightCode",
    "GuidanceOptions",
    "Measurement",
    "MockupUnit",
    "PowerRate",
    "PredictiveReaching",
    "Reference",
    "SaturationLayer",
    "Sign",
    "SuperTwisting",
    "SuperTwistingObserver",
    "TanhLayer",
    "UnscentedOptions",
    "bridge_dropouts",
    "bryson",
    "decoupling_matrix",
    "design_ekf",
    "design_feedback_linearization",
    "design_gain_schedule",
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
    "first_memory",
    "law",
    "lie_derivative",
    "output_errors",
    "output_feedback",
    "relative_degrees",
    "trim",
    "zero_dynamics",
]
