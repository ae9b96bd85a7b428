"""Refinement: meshes, control structure, exact switch times, global search."""

from gnc_opt.refine.indirect.polish import polish
from gnc_opt.refine.limits import RefinementLimits
from gnc_opt.refine.refine import refine
from gnc_opt.refine.search.minima import Minimum
from gnc_opt.refine.search.multistart import Multistart, multistart
from gnc_opt.solution.history import History, RefinementStatus

__all__ = [
    "History",
    "Minimum",
    "Multistart",
    "RefinementLimits",
    "RefinementStatus",
    "multistart",
    "polish",
    "refine",
]
