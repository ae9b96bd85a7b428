"""Interface to NLP solvers, independent of optimal control."""

from gnc_opt.planning.nlp.nlp_solver import NlpPoint, NlpResult, NlpSolver
from gnc_opt.planning.nlp.nlp_solver_options import SolverOptions
from gnc_opt.planning.nlp.nlp_solver_status import Status, read_solver_status
from gnc_opt.planning.nlp.nonlinear_program import NlpProblem
from gnc_opt.planning.nlp.solve_monitor import IterationInfo

__all__ = [
    "IterationInfo",
    "NlpPoint",
    "NlpProblem",
    "NlpResult",
    "NlpSolver",
    "SolverOptions",
    "Status",
    "read_solver_status",
]
