"""Closed-loop analysis: linear covariance, frequency response, global sensitivity, filter consistency."""

from functools import partial

from gnc_opt.analysis.dispersed_closed_loop_scenario import Scenario
from gnc_opt.analysis.filter_consistency import Consistency, InnovationTest, consistency
from gnc_opt.analysis.global_sensitivity import IntervalEstimate, SobolIndices, sobol_indices
from gnc_opt.analysis.linear_covariance import LinearCovariance, linear_covariance
from gnc_opt.analysis.loop_frequency_response import LoopResponse, loop_response
from gnc_opt.renamed_public_names import raise_missing_name_error

__all__ = [
    "Consistency",
    "InnovationTest",
    "IntervalEstimate",
    "LinearCovariance",
    "LoopResponse",
    "Scenario",
    "SobolIndices",
    "consistency",
    "linear_covariance",
    "loop_response",
    "sobol_indices",
]

__getattr__ = partial(raise_missing_name_error, __name__)
