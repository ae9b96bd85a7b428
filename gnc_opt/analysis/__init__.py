"""Statements about a closed loop: covariance, frequency response, sensitivity, filter consistency."""

from typing import Any

from gnc_opt.analysis.filter_consistency import Consistency, InnovationTest, consistency
from gnc_opt.analysis.global_sensitivity import (
    IntervalEstimate,
    SobolIndices,
    sobol_indices,
)
from gnc_opt.analysis.linear_covariance import LinearCovariance, linear_covariance
from gnc_opt.analysis.loop_response import LoopResponse, loop_response
from gnc_opt.analysis.scenario import Scenario
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
    """Report the present name of a former one."""
    check_renamed(__name__, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
