"""The same problem solved again on the same mesh, for a better solution than the first one, or a sharper one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from gnc_opt.planning.direct.solve_mesh import solve_mesh
from gnc_opt.planning.nlp import SolverOptions
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import MeshLike
from gnc_opt.planning.transcription.scheme import Scheme

STRATEGY = "ipopt.mu_strategy"

CLEARLY = 1e-3
"""Relative gain in the objective on the same mesh that makes another solution worth refining."""

SHARP = 1e-12
"""Solver tolerance that tells active limits from others."""


def another_way(
    problem: Problem,
    first: Solution,
    mesh: MeshLike | Mapping[str, MeshLike] | None,
    scheme: Scheme,
    options: SolverOptions,
) -> Solution | None:
    """Return a clearly better solution on the same mesh by another way through the iterates, or None.

    A local minimum on a coarse mesh need not be one of the problem, and where refining it goes on without end it is a
    poor one: it hugs bounds that finer meshes shift. Another barrier strategy takes another way from the same guess,
    for the price of one coarse solve. Both answers are on the same mesh, so a clearly better one is no accident of
    the discretisation.
    """
    if options.solver != "ipopt" or _strategy_chosen(options):
        return None
    other = replace(options, extra={**options.extra, STRATEGY: "adaptive"})
    second = solve_mesh(problem, mesh, scheme=scheme, options=other)
    return second if second.status.solved and relative_gain(first, second) >= CLEARLY else None


def _strategy_chosen(options: SolverOptions) -> bool:
    nested = options.extra.get("ipopt")
    return STRATEGY in options.extra or (isinstance(nested, Mapping) and "mu_strategy" in nested)


def relative_gain(old: Solution, new: Solution) -> float:
    """Return by how much the new objective is better, relative to the larger one."""
    size = max(abs(old.objective), abs(new.objective))
    gain = new.objective - old.objective if new.maximised else old.objective - new.objective
    return gain / size if size > 0 else 0.0


def sharper(solution: Solution) -> Solution:
    """Return the solution on its own mesh, sharp enough to tell active limits from others; itself if that fails."""
    problem = solution.need_problem("solve")
    options = SolverOptions(tolerance=SHARP)
    again = solve_mesh(problem, scheme=solution.scheme, guess=solution, options=options)
    return again if again.status.solved else solution
