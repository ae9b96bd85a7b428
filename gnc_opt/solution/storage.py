"""Solutions on disk: one compressed NumPy archive that holds numbers and text, no code.

The entry ``header`` is JSON: a tree of the solution's fields, tagged with their types. The arrays of that
tree are entries of their own, named by their place (``phases.leg.lam_start``; the segments of a polynomial
side by side), so ``numpy.load(path)`` alone can read a file. Floats keep every bit. Nothing is pickled:
opening a file from a stranger runs none of the stranger's code.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from gnc_opt.errors import GncOptError
from gnc_opt.model.layout import Array, Layout, Variable
from gnc_opt.nlp.status import Status
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.arc import Arc, ArcKind
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
    target = Path(path)
    target = target if target.suffix else target.with_suffix(".npz")
    arrays: dict[str, Array] = {}
    header = {
        "format": FORMAT,
        "version": VERSION,
        "written_by": solution.provenance.get("gnc_opt", "unknown"),
        "solution": _pack(solution, "", arrays),
        "quality": _pack(_quality(solution), "quality", arrays),
    }
    _write(target, {"header": np.array(json.dumps(header, allow_nan=False)), **arrays})
    return target


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
    header, arrays = _read(Path(path))
    try:
        solution = _unpack(header["solution"], arrays)
        quality = _unpack(header["quality"], arrays)
        if not isinstance(solution, Solution):
            raise TypeError("no solution")
    except Exception as error:  # whatever it is, this tree does not describe a solution
        raise _damaged(path) from error
    if problem is not None:
        return solution.with_problem(problem)
    if quality is not None:
        vars(solution)["quality"] = quality  # what the cached property would hold
    return solution


# --- file ---------------------------------------------------------------------------------------------


def _write(target: Path, entries: Mapping[str, Any]) -> None:
    """Write next to the target, then replace it: a crash leaves the old file."""
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            np.savez_compressed(stream, **entries)
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, target)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _read(path: Path) -> tuple[Any, dict[str, Array]]:
    with path.open("rb") as stream:
        try:
            entries = _entries(stream)
            header = json.loads(str(entries.pop("header"))) if "header" in entries else {}
        except _NoArchive:
            raise GncOptError(f"'{path}' is not a solution of gnc_opt, or only part of one.") from None
        except Exception as error:  # zipfile, zlib, NumPy and JSON each have their own
            raise _damaged(path) from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise GncOptError(f"'{path}' is an archive, but not a solution of gnc_opt.")
    if header.get("version") != VERSION:
        raise GncOptError(
            f"'{path}' has format version {header.get('version')} (gnc_opt {header.get('written_by')}), "
            f"but this gnc_opt reads version {VERSION}: load it with the version that wrote it."
        )
    return header, entries


class _NoArchive(Exception):
    """Not a zip file at all."""


def _entries(stream: BinaryIO) -> dict[str, Array]:
    """Return all arrays of an archive after looking at every checksum: NumPy may stop reading before the last byte."""
    if not zipfile.is_zipfile(stream):
        raise _NoArchive
    with zipfile.ZipFile(stream) as archive:
        broken = archive.testzip()
        if broken is not None:
            raise zipfile.BadZipFile(broken)
    stream.seek(0)
    with np.load(stream, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def _damaged(path: str | Path) -> GncOptError:
    return GncOptError(f"'{path}' is damaged: its content does not make up a solution; save it again.")


# --- tree ---------------------------------------------------------------------------------------------


@cache
def _classes() -> dict[str, type]:
    """The types a file may name; no others are ever made."""
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
