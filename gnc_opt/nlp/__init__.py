"""The boundary to NLP solvers. Knows nothing about optimal control."""

from gnc_opt.nlp.solver import IterationInfo, NlpProblem, NlpResult, NlpSolver, SolverOptions
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
