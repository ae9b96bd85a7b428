"""Refinement: meshes, control structure, exact switch times, global search."""

from gnc_opt.refine.history import History, RefinementStatus
from gnc_opt.refine.minima import Minimum
from gnc_opt.refine.multistart import Multistart, multistart
from gnc_opt.refine.polish import polish
from gnc_opt.refine.refine import refine

__all__ = ["History", "Minimum", "Multistart", "RefinementStatus", "multistart", "polish", "refine"]
