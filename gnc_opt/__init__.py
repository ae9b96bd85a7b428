"""gnc_opt: trajectory optimisation for guidance, navigation and control, with a proof of optimality."""

from gnc_opt.errors import (
    ArgumentError,
    GncOptError,
    ModelError,
    ProblemError,
    ProblemWarning,
    SolveError,
    UnknownAttributeError,
    UnknownNameError,
)
from gnc_opt.model import Model
from gnc_opt.nlp import SolverOptions, Status
from gnc_opt.problem import Phase, Problem
from gnc_opt.refine import History, Minimum, Multistart, RefinementStatus, multistart, polish, refine
from gnc_opt.solution import PhaseSolution, Solution, load
from gnc_opt.solve import solve
from gnc_opt.transcription.mesh import Mesh
from gnc_opt.verify import Condition, Result, Verdict, verify

__all__ = [
    "ArgumentError",
    "Condition",
    "GncOptError",
    "History",
    "Mesh",
    "Minimum",
    "Model",
    "ModelError",
    "Multistart",
    "Phase",
    "PhaseSolution",
    "Problem",
    "ProblemError",
    "ProblemWarning",
    "RefinementStatus",
    "Result",
    "Solution",
    "SolveError",
    "SolverOptions",
    "Status",
    "UnknownAttributeError",
    "UnknownNameError",
    "Verdict",
    "load",
    "multistart",
    "polish",
    "refine",
    "solve",
    "verify",
]
