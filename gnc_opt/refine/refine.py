"""refine: from a first solution to one that is right to many digits."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, TypeAlias, get_args

import numpy as np

from gnc_opt.arguments import expect, read_positive
from gnc_opt.errors import GncOptError, ProblemError, did_you_mean
from gnc_opt.nlp import SolverOptions
from gnc_opt.refine.detect import affine_channels, detect
from gnc_opt.refine.history import History
from gnc_opt.refine.hp import refine_mesh
from gnc_opt.refine.switching import optimise_switches
from gnc_opt.solution.solution import Solution
from gnc_opt.verify.samples import PhaseSamples
from gnc_opt.verify.verify import verify

StructureChoice: TypeAlias = Literal["auto", "bang-bang", "none"]

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
        ``"auto"``: the latter where controls enter linearly and switch, if the result passes the verdict; else hp.
    max_passes : int
        At most so many solves.
    max_points : int
        At most so many collocation points in any phase (hp).
    options : SolverOptions, optional
        For the solves.
    progress : bool
        Show one line per pass (hp).

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
    if structure == "bang-bang":
        if not _switches(solution, at_least=0):
            raise ProblemError(
                f"no control of '{solution.problem_name}' enters the Hamiltonian linearly between two finite bounds: "
                'use structure="none".'
            )
        return _with_history(
            *optimise_switches(solution, tol=min(tol, 1e-9), max_passes=max_passes, options=options)
        )
    if structure == "auto" and _switches(solution, at_least=1):
        candidate = _with_history(
            *optimise_switches(solution, tol=min(tol, 1e-9), max_passes=max_passes, options=options)
        )
        if _convincing(candidate):
            return candidate
    return _with_history(
        *refine_mesh(
            solution,
            tol=tol,
            max_passes=max_passes,
            max_points=max_points,
            options=options,
            progress=progress,
        )
    )


def _check(solution: Solution) -> None:
    if solution.problem is None:
        raise GncOptError(
            f"cannot refine the solution of '{solution.problem_name}' without its problem: "
            "load it with load(path, problem=...)."
        )
    if not solution.status.solved:
        raise GncOptError(
            f"the solution of '{solution.problem_name}' ended as {solution.status.value}: refine one that is solved."
        )


def _with_history(solution: Solution, history: History) -> Solution:
    return replace(solution, history=history)


def _switches(solution: Solution, at_least: int) -> bool:
    """Whether some control enters H linearly and the structure has at least so many switches."""
    for name, leg in solution.phases.items():
        samples = PhaseSamples.of(leg, solution.functions(name))
        if np.any(affine_channels(samples)) and detect(samples).pieces > at_least:
            return True
    return False


def _convincing(candidate: Solution) -> bool:
    """Whether a structure that nobody asked for passes the verdict."""
    assert candidate.history is not None, "optimise_switches has just made one"
    return candidate.history.converged and verify(candidate, tol=ACCEPTED).ok
