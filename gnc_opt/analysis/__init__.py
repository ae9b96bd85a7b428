"""Statements about a closed loop: covariance, frequency response, sensitivity, rare events, worst case,
filter consistency."""

from gnc_opt.analysis.filter_consistency import Consistency, InnovationTest, consistency
from gnc_opt.analysis.global_sensitivity import Correlations, Share, SobolIndices, correlations, sobol_indices
from gnc_opt.analysis.linear_covariance import Agreement, LinearCovariance, linear_covariance
from gnc_opt.analysis.loop_response import LoopResponse, loop_response
from gnc_opt.analysis.scenario import Experiment
from gnc_opt.analysis.subset_simulation import FailureProbability, failure_probability
from gnc_opt.analysis.worst_case import WorstCase, worst_case

__all__ = [
    "Agreement",
    "Consistency",
    "Correlations",
    "Experiment",
    "FailureProbability",
    "InnovationTest",
    "LinearCovariance",
    "LoopResponse",
    "Share",
    "SobolIndices",
    "WorstCase",
    "consistency",
    "correlations",
    "failure_probability",
    "linear_covariance",
    "loop_response",
    "sobol_indices",
    "worst_case",
]
