"""Refinement: meshes, control structure, exact switch times."""

from gnc_opt.refine.history import History, RefinementStatus
from gnc_opt.refine.refine import refine

__all__ = ["History", "RefinementStatus", "refine"]
