"""The boundary to NLP solvers. Knows nothing about optimal control."""

from gnc_opt.nlp.monitor import IterationInfo
from gnc_opt.nlp.options import SolverOptions
from gnc_opt.nlp.solver import NlpPoint, NlpResult, NlpSolver
from gnc_opt.nlp.status import Status, status_from_stats
from gnc_opt.transcription.nonlinear_program import NlpProblem

__all__ = [
    "IterationInfo",
    "NlpPoint",
    "NlpProblem",
    "NlpResult",
    "NlpSolver",
    "SolverOptions",
    "Status",
    "status_from_stats",
]
