"""Mesh refinement, switching-time optimisation and the sequence of stages between first and final solution."""

from gnc_opt.planning.direct.computation_budget import RefinementLimits
from gnc_opt.planning.refinement.staged_refinement import refine
from gnc_opt.planning.solution.refinement_history import History, RefinementStatus

__all__ = ["History", "RefinementLimits", "RefinementStatus", "refine"]
