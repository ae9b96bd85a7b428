"""Optimality check: feasibility, Pontryagin's minimum principle and second-order conditions."""

from gnc_opt.planning.solution.optimality_verdict import Condition, ConditionResult, Verdict
from gnc_opt.planning.verification.external_trajectory_check import verify_trajectory
from gnc_opt.planning.verification.optimality_check import verify

__all__ = ["Condition", "ConditionResult", "Verdict", "verify", "verify_trajectory"]
