"""Solutions on disk: one compressed NumPy archive that holds numbers and text, no code.

The entry ``header`` is JSON: a tree of the solution's fields, tagged with their types. The arrays of that
tree are entries of their own, named by their place (``phases.leg.lam_start``; the segments of a polynomial
side by side), so ``numpy.load(path)`` alone can read a file. Floats keep every bit. Nothing is pickled:
opening a file from a stranger runs none of the stranger's code.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from gnc_opt.archive import damaged, read_archive, write_archive
from gnc_opt.arrays import Array
from gnc_opt.model.layout import Layout, Variable
from gnc_opt.nlp.status import Status
from gnc_opt.problem.arc import Arc, ArcKind
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.phase_solution import PhaseSolution
from gnc_opt.solution.polynomial import PiecewisePolynomial
from gnc_opt.solution.solution import Solution, Statistics, Violation
from gnc_opt.transcription.mesh import Mesh

FORMAT = "gnc_opt solution"
VERSION = 1
"""Raise it whenever a stored class changes its fields."""

_LEFT_OUT: dict[type, tuple[str, ...]] = {Solution: ("problem", "history")}


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
    arrays: dict[str, Array] = {}
    header = {
        "format": FORMAT,
        "version": VERSION,
        "written_by": solution.provenance.get("gnc_opt", "unknown"),
        "solution": _pack(solution, "", arrays),
        "quality": _pack(_quality(solution), "quality", arrays),
    }
    return write_archive(path, header, arrays)


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
    header, arrays = read_archive(path, FORMAT, VERSION)
    try:
        solution = _unpack(header["solution"], arrays)
        quality = _unpack(header["quality"], arrays)
        if not isinstance(solution, Solution):
            raise TypeError("no solution")
    except Exception as error:  # whatever it is, this tree does not describe a solution
        raise damaged(path, "solution") from error
    if problem is not None:
        return solution.with_problem(problem)
    if quality is not None:
        vars(solution)["quality"] = quality  # what the cached property would hold
    return solution


# --- tree ---------------------------------------------------------------------------------------------


@cache
def _classes() -> dict[str, type]:
    """The types a file may name; no others are ever made."""
    from gnc_opt.solution.quality import Quality

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
    )
    return {c.__name__: c for c in (*stored, ArcKind, Status, Quality)}


def _stored_fields(kind: type) -> list[str]:
    return [f.name for f in fields(cast(Any, kind)) if f.name not in _LEFT_OUT.get(kind, ())]


def _pack(value: Any, place: str, arrays: dict[str, Array]) -> Any:
    """Return the JSON tree of a value; its arrays go to ``arrays`` under their place in the tree."""
    if isinstance(value, np.ndarray):
        arrays[place] = value
        return {"array": place}
    if isinstance(value, Enum):
        return {"type": type(value).__name__, "value": value.value}
    if is_dataclass(value):
        kind = type(value)
        members = {
            name: _pack(getattr(value, name), _join(place, name), arrays) for name in _stored_fields(kind)
        }
        return {"type": kind.__name__, "fields": members}
    if isinstance(value, Mapping):
        return {"map": {key: _pack(item, _join(place, key), arrays) for key, item in value.items()}}
    if isinstance(value, tuple) and value and all(isinstance(item, np.ndarray) for item in value):
        # One entry for all segments of a polynomial: thousands of tiny entries would be slow and big.
        arrays[place] = np.concatenate(value, axis=-1)
        return {"pieces": place, "sizes": [item.shape[-1] for item in value]}
    if isinstance(value, (tuple, list)):
        return [_pack(item, _join(place, str(i)), arrays) for i, item in enumerate(value)]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else {"float": repr(float(value))}
    return value.item() if isinstance(value, np.generic) else value


def _unpack(tree: Any, arrays: Mapping[str, Array]) -> Any:
    if isinstance(tree, list):
        return tuple(_unpack(item, arrays) for item in tree)
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        array = arrays[tree["array"]]
        array.setflags(write=False)
        return array
    if "pieces" in tree:
        return tuple(np.split(arrays[tree["pieces"]], np.cumsum(tree["sizes"])[:-1], axis=-1))
    if "float" in tree:
        return float(tree["float"])
    if "map" in tree:
        return {key: _unpack(item, arrays) for key, item in tree["map"].items()}
    kind: Any = _classes()[tree["type"]]
    if "value" in tree:
        return kind(tree["value"])
    return kind(**{key: _unpack(item, arrays) for key, item in tree["fields"].items()})


def _join(place: str, name: str) -> str:
    return f"{place}.{name}" if place else name


# --- quality ------------------------------------------------------------------------------------------


def _quality(solution: Solution) -> Any:
    """The quality figures; None if they were not saved with a solution that has come without its problem."""
    return vars(solution).get("quality") if solution.problem is None else solution.quality
