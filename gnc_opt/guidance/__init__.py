"""Where planning meets flight: neighbouring-optimal guidance about a solution, and re-planning in flight."""

from gnc_opt.guidance.neighbouring_bang_bang import GuidanceOptions, design_neighbouring_optimal
from gnc_opt.guidance.neighbouring_extremal import design_neighbouring_extremal
from gnc_opt.guidance.replanning import Replanner

__all__ = [
    "GuidanceOptions",
    "Replanner",
    "design_neighbouring_extremal",
    "design_neighbouring_optimal",
]
