"""Guidance along a planned trajectory: neighbouring-optimal guidance, and re-planning in flight."""

from gnc_opt.guidance.neighbouring_bang_bang_guidance import design_neighbouring_optimal
from gnc_opt.guidance.trajectory_replanning import Replanner

__all__ = ["Replanner", "design_neighbouring_optimal"]
