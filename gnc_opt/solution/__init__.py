"""Solution: piecewise polynomials, costates by covector mapping, warm starts, files."""

from gnc_opt.solution.diagnosis import Violation
from gnc_opt.solution.phase_solution import PhaseSolution, Signal
from gnc_opt.solution.solution import Solution, load
from gnc_opt.solution.statistics import Statistics

__all__ = ["PhaseSolution", "Signal", "Solution", "Statistics", "Violation", "load"]
