"""Optimality check: dense defects, independent propagation and Pontryagin's minimum principle."""

from gnc_opt.planning.solution.quality import Quality
from gnc_opt.planning.solution.verdict import Condition, ConditionResult, Verdict
from gnc_opt.planning.verification.optimality_check import verify
from gnc_opt.planning.verification.verify_trajectory import verify_trajectory

__all__ = ["Condition", "ConditionResult", "Quality", "Verdict", "verify", "verify_trajectory"]
