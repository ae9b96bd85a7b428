"""Solutions on disk: one compressed NumPy archive that holds numbers and text, no code; see `archive`."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from gnc_opt.archive import FileFormat
from gnc_opt.model.layout import Layout, Variable
from gnc_opt.nlp.status import Status
from gnc_opt.packing import Packing
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.arc import Arc, ArcKind
from gnc_opt.solution.phase_solution import PhaseSolution
from gnc_opt.solution.polynomial import PiecewisePolynomial
from gnc_opt.solution.solution import Solution, Statistics, Violation
from gnc_opt.transcription.mesh import Mesh

VERSION = 1
"""Raise it whenever a stored class changes its fields."""


@cache
def file_format() -> FileFormat:
    """Return how solutions are written."""
    from gnc_opt.verify.quality import Quality

    stored = (
        Solution,
        PhaseSolution,
        PiecewisePolynomial,
        Layout,
        Variable,
        Interval,
        Mesh,
        Statistics,
        Violation,
        Arc,
        ArcKind,
        Status,
        Quality,
    )
    return FileFormat(
        Solution, "solution", VERSION, Packing(stored, left_out={Solution: ("problem", "history")})
    )


def save(solution: Solution, path: str | Path) -> Path:
    """Write a solution to a file that `load` reads without the model.

    Parameters
    ----------
    solution : Solution
        Its quality figures are measured now (or carried over, if it was itself loaded without its problem).
    path : str or Path
        ``.npz`` is appended if it has no suffix. An existing file is replaced, and only once the new one is
        complete.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    OSError
        The file cannot be written, e.g. because its folder does not exist.
    """
    written_by = solution.provenance.get("gnc_opt", "unknown")
    return file_format().write(path, solution, written_by=written_by, quality=_quality(solution))


def load(path: str | Path, problem: Problem | None = None) -> Solution:
    """Read a solution that `save` wrote.

    Parameters
    ----------
    path : str or Path
    problem : Problem, optional
        The problem that was solved, built again. Without it states, controls, costates, multipliers and the
        quality figures of saving time are there; Hamiltonian, expressions and verification need it.

    Returns
    -------
    Solution

    Raises
    ------
    FileNotFoundError
        There is no such file.
    GncOptError
        The file is damaged, no solution of gnc_opt, or of another format version.
    ProblemError
        ``problem`` is not the one that was solved. (Functions are compared as CasADi writes them down, which
        may change with a new CasADi.)
    """
    solution, more = file_format().read(path)
    assert isinstance(solution, Solution)
    if problem is not None:
        return solution.with_problem(problem)
    if more.get("quality") is not None:
        vars(solution)["quality"] = more["quality"]  # what the cached property would hold
    return solution


def _quality(solution: Solution) -> Any:
    """The quality figures; None if they were not saved with a solution that has come without its problem."""
    return vars(solution).get("quality") if solution.problem is None else solution.quality
