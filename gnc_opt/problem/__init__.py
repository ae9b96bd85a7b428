"""Problem and Phase: time, boundary conditions, bounds, constraints, linkages, cost and guess."""

from gnc_opt.problem.constraint import Constraint
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.problem import Problem

__all__ = ["Constraint", "Interval", "Phase", "Problem"]
