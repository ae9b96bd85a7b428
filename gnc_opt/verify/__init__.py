"""Verification: dense defects, independent propagation and Pontryagin's minimum principle."""

from gnc_opt.solution.quality import Quality
from gnc_opt.verify.verdict import Condition, Result, Verdict
from gnc_opt.verify.verify import verify
from gnc_opt.verify.verify_trajectory import verify_trajectory

__all__ = ["Condition", "Quality", "Result", "Verdict", "verify", "verify_trajectory"]
