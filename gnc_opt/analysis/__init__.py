"""Closed-loop analysis: linear covariance, frequency response, global sensitivity, filter consistency."""

from typing import Any

from gnc_opt.analysis.campaign_scenario import Scenario
from gnc_opt.analysis.filter_consistency import Consistency, InnovationTest, consistency
from gnc_opt.analysis.global_sensitivity import IntervalEstimate, SobolIndices, sobol_indices
from gnc_opt.analysis.linear_covariance import LinearCovariance, linear_covariance
from gnc_opt.analysis.loop_response import LoopResponse, loop_response
from gnc_opt.renamed import check_renamed

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


def __getattr__(name: str) -> Any:
    """Raise an error that names the replacement of a renamed name."""
    check_renamed(__name__, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
