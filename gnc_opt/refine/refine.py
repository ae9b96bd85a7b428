"""refine: from a collocation solution to one that is right to the last digits."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from gnc_opt.errors import GncOptError, ProblemError
from gnc_opt.nlp import SolverOptions
from gnc_opt.refine.switching import optimise_switches
from gnc_opt.solution.solution import Solution

StructureChoice = Literal["none", "bang-bang", "auto"]


def refine(
    solution: Solution,
    *,
    structure: StructureChoice = "auto",
    tol: float = 1e-9,
    options: SolverOptions | None = None,
) -> Solution:
    """Return a solution with exact switch times."""
    if solution.problem is None:
        raise GncOptError(f"cannot refine the solution of '{solution.problem_name}' without its problem.")
    if structure not in ("none", "bang-bang", "auto"):
        raise ProblemError(f"there is no structure {structure!r}.")
    refined, arcs, _ = optimise_switches(solution, tol=tol, options=options)
    return replace(refined, structure=arcs)
