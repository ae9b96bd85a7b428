"""The verdict that a solution carries, so that judging it again costs nothing.

It is kept beside the solution's fields and goes with the object: a copy with other fields (`dataclasses.replace`) has
none, and numbers that were changed in place are noticed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from functools import cache
from typing import Any

import numpy as np

from gnc_opt.planning.solution.solution import SOLUTION_FILES, Solution
from gnc_opt.planning.solution.verdict import Verdict

_PLACE = "verdicts"
"""In ``vars(solution)``: the solution's problem and digest with its verdicts by tolerance."""


def keep_verdict(solution: Solution, verdict: Verdict, tol: float) -> None:
    """Let a solution carry the verdict on it at a tolerance."""
    kept = {**_kept(solution), tol: verdict}
    vars(solution)[_PLACE] = (solution.problem, _digest(solution), kept)


def kept_verdict(solution: Solution, tol: float) -> Verdict | None:
    """Return the verdict at a tolerance that a solution carries, or None."""
    return _kept(solution).get(tol)


def with_verdicts(copy: Solution, judged: Solution) -> Solution:
    """Let a copy that differs in nothing that is judged carry the verdicts of the solution that it was made of."""
    for tol, verdict in _kept(judged).items():
        keep_verdict(copy, verdict, tol)
    return copy


def _kept(solution: Solution) -> dict[float, Verdict]:
    problem, digest, kept = vars(solution).get(_PLACE, (None, "", {}))
    valid = bool(kept) and problem is solution.problem and digest == _digest(solution)
    return kept if valid else {}


def _digest(solution: Solution) -> str:
    """Return a digest of all numbers and words that a file would hold."""
    digest = hashlib.blake2b(digest_size=16)
    _feed(digest.update, solution)
    return digest.hexdigest()


def _feed(update: Callable[[bytes], None], value: Any) -> None:
    if isinstance(value, np.ndarray):
        update(f"{value.dtype}{value.shape}".encode())
        update(value.tobytes())
    elif isinstance(value, (tuple, list)):
        update(f"{len(value)}".encode())
        for item in value:
            _feed(update, item)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            update(repr(key).encode())
            _feed(update, item)
    elif is_dataclass(value):
        update(type(value).__name__.encode())
        kind: Any = type(value)
        for name in _stored_fields(kind):
            _feed(update, getattr(value, name))
    else:
        update(repr(value).encode())


@cache
def _stored_fields(kind: type) -> tuple[str, ...]:
    return tuple(SOLUTION_FILES.packing.stored_fields(kind))
