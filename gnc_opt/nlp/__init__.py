"""The boundary to NLP solvers. Knows nothing about optimal control."""

from gnc_opt.nlp.monitor import IterationInfo
from gnc_opt.nlp.options import SolverOptions
from gnc_opt.nlp.problem import NlpProblem
from gnc_opt.nlp.solver import NlpResult, NlpSolver
from gnc_opt.nlp.status import Status, status_from_stats

__all__ = [
    "IterationInfo",
    "NlpProblem",
    "NlpResult",
    "NlpSolver",
    "SolverOptions",
    "Status",
    "status_from_stats",
]
