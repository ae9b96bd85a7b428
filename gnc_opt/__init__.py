"""gnc_opt: trajectory optimisation for guidance, navigation and control, with a proof of optimality."""

from gnc_opt.errors import (
    GncOptError,
    ModelError,
    ProblemError,
    ProblemWarning,
    SolveError,
    UnknownNameError,
)
from gnc_opt.model import Model
from gnc_opt.nlp import SolverOptions, Status
from gnc_opt.problem import Phase, Problem
from gnc_opt.solution import PhaseSolution, Solution, load
from gnc_opt.solve import solve
from gnc_opt.transcription.mesh import Mesh
from gnc_opt.verify import Condition, Result, Verdict, verify

__all__ = [
    "Condition",
    "GncOptError",
    "Mesh",
    "Model",
    "ModelError",
    "Phase",
    "PhaseSolution",
    "Problem",
    "ProblemError",
    "ProblemWarning",
    "Result",
    "Solution",
    "SolveError",
    "SolverOptions",
    "Status",
    "UnknownNameError",
    "Verdict",
    "load",
    "solve",
    "verify",
]
