"""Optimality check: feasibility, Pontryagin's minimum principle and second-order conditions."""

from gnc_opt.planning.solution.quality import Quality
from gnc_opt.planning.solution.verdict import Condition, ConditionResult, Verdict
from gnc_opt.planning.verification.optimality_check import verify
from gnc_opt.planning.verification.verify_trajectory import verify_trajectory

__all__ = ["Condition", "ConditionResult", "Quality", "Verdict", "verify", "verify_trajectory"]
