"""Statement of optimal control problems: phases, bounds, constraints, linkages, cost and guess."""

from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.constraints import Constraint
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem

__all__ = ["Constraint", "Interval", "Phase", "Problem"]
