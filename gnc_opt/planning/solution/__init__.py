"""Solution: piecewise polynomials, costates by covector mapping, warm starts, files."""

from gnc_opt.planning.solution.diagnosis import Violation
from gnc_opt.planning.solution.history import Statistics
from gnc_opt.planning.solution.phase_solution import PhaseSolution, Signal
from gnc_opt.planning.solution.solution import Solution, load

__all__ = ["PhaseSolution", "Signal", "Solution", "Statistics", "Violation", "load"]
