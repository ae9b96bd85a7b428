"""Analysis of closed loops: how far errors scatter and why, how rare failures are, what loops do to frequencies."""

from gnc_opt.analysis.agreement import Agreement
from gnc_opt.analysis.covariance import LinearCovariance, linear_covariance
from gnc_opt.analysis.drivers import Correlations, Share, SobolIndices, correlations, sobol_indices
from gnc_opt.analysis.experiment import Experiment
from gnc_opt.analysis.frequency import LoopResponse, loop_response
from gnc_opt.analysis.rare import FailureProbability, failure_probability
from gnc_opt.analysis.worst import WorstCase, worst_case

__all__ = [
    "Agreement",
    "Correlations",
    "Experiment",
    "FailureProbability",
    "LinearCovariance",
    "LoopResponse",
    "Share",
    "SobolIndices",
    "WorstCase",
    "correlations",
    "failure_probability",
    "linear_covariance",
    "loop_response",
    "sobol_indices",
    "worst_case",
]
