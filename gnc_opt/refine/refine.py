"""refine: from a first solution to one that is right to many digits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal, TypeAlias, get_args

import numpy as np

from gnc_opt.arguments import expect, read_positive
from gnc_opt.errors import GncOptError, ProblemError, did_you_mean
from gnc_opt.nlp import SolverOptions
from gnc_opt.refine.hp.mesh_refinement import refine_mesh
from gnc_opt.refine.structure.detect import affine_channels, detect, regular_channels
from gnc_opt.refine.structure.switching import optimise_switches
from gnc_opt.solution.history import History
from gnc_opt.solution.solution import Solution
from gnc_opt.verify.verify import verify

StructureChoice: TypeAlias = Literal["auto", "bang-bang", "none"]

PATIENCE = 25
"""Passes after which a control structure that nobody asked for is given up."""

ACCEPTED = 1e-5
"""Tolerance of the verdict on a control structure that is chosen without being asked for."""


def refine(
    solution: Solution,
    *,
    tol: float = 1e-8,
    structure: StructureChoice = "auto",
    max_passes: int = 40,
    max_points: int = 1000,
    options: SolverOptions | None = None,
    progress: bool = False,
) -> Solution:
    """Return a more accurate solution of the same problem, with its ``history``.

    Parameters
    ----------
    solution : Solution
        A solved one, with its problem.
    tol : float
        On the dimensionless error between the nodes; see `gnc_opt.refine.error`.
    structure : {"auto", "bang-bang", "none"}
        ``"none"``: hp refinement of the mesh. ``"bang-bang"``: recognise which control sits on which bound when,
        make the switch times variables, and mend the structure until the switching functions agree with it.
        The same for kinks, where controls enter and leave their bounds or mixed path constraints, and for singular
        arcs and arcs on state bounds.
        ``"auto"``: the latter where the structure has more than one piece, if the result passes the verdict; else hp,
        and the structure once more from there if that does not pass.
    max_passes : int
        At most so many solves.
    max_points : int
        At most so many collocation points in any phase (hp).
    options : SolverOptions, optional
        For the solves.
    progress : bool
        Show one line per pass.

    Returns
    -------
    Solution
        With ``history`` (its ``status`` says whether the tolerance was reached) and, where switch times were
        optimised, ``structure``.

    Raises
    ------
    GncOptError
        The solution has no problem or is not solved.
    ProblemError
        ``structure`` is none of the three, or it is ``"bang-bang"`` and no control can be.
    """
    expect(solution, Solution, "what refine() got", "write refine(solve(problem))")
    read_positive(tol, "the tolerance of refine()")
    if structure not in get_args(StructureChoice):
        raise ProblemError(
            f"refine() knows no structure {structure!r}: {did_you_mean(str(structure), get_args(StructureChoice))}"
        )
    _check(solution)
    switch = partial(optimise_switches, tol=min(tol, 1e-9), options=options, progress=progress)
    if structure == "bang-bang":
        if not _switches(solution, at_least=0):
            raise ProblemError(
                f"no control of '{solution.problem_name}' enters the Hamiltonian linearly between two finite bounds: "
                'use structure="none".'
            )
        return _with_history(*switch(solution, max_passes=max_passes))
    attempt = partial(_convincing, switch=partial(switch, max_passes=min(max_passes, PATIENCE)))
    candidate = attempt(solution) if structure == "auto" else None
    if candidate is not None:
        return candidate
    refined = _with_history(
        *refine_mesh(
            solution,
            tol=tol,
            max_passes=max_passes,
            max_points=max_points,
            options=options,
            progress=progress,
        )
    )
    # A fine mesh shows arcs that the first one was too coarse for.
    if structure == "auto" and not verify(refined, tol=ACCEPTED).ok:
        return attempt(refined) or refined
    return refined


def _check(solution: Solution) -> None:
    solution.need_problem("refine")
    if not solution.status.solved:
        raise GncOptError(
            f"the solution of '{solution.problem_name}' ended as {solution.status.value}: refine one that is solved."
        )


def _with_history(solution: Solution, history: History) -> Solution:
    return replace(solution, history=history)


def _switches(solution: Solution, at_least: int) -> bool:
    """Whether some control can have switches or kinks and the structure has more pieces than that."""
    for samples in solution.samples().values():
        pieces = detect(samples).pieces
        if np.any(affine_channels(samples)) and pieces > at_least:
            return True
        # Controls that H determines have nothing to settle if they stay between their bounds.
        if np.any(regular_channels(samples)) and pieces > 1:
            return True
    return False


def _convincing(start: Solution, switch: Callable[[Solution], tuple[Solution, History]]) -> Solution | None:
    """Return the solution with a structure that nobody asked for, if there is one and it passes the verdict."""
    if not _switches(start, at_least=1):
        return None
    candidate, history = switch(start)
    if history.converged and verify(candidate, tol=ACCEPTED).ok:
        return _with_history(candidate, history)
    return None
