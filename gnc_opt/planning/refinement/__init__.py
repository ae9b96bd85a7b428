"""From a first solution to an accurate one: error estimate, meshes, arcs, switching times."""

from gnc_opt.planning.refinement.budget import RefinementLimits
from gnc_opt.planning.refinement.engine import refine
from gnc_opt.planning.solution.history import History, RefinementStatus

__all__ = [
    "History",
    "RefinementLimits",
    "RefinementStatus",
    "refine",
]
