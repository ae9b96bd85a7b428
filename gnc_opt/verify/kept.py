"""The verdict that a solution carries, so that judging it again costs nothing.

It is kept beside the solution's fields and goes with the object: a copy with other fields (`dataclasses.replace`) has
none, and numbers that were changed in place are noticed.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

from gnc_opt.arrays import Array
from gnc_opt.solution.solution import SOLUTION_FILES, Solution
from gnc_opt.verify.verdict import Verdict

_PLACE = "verdicts"
"""In ``vars(solution)``: the solution's problem and digest with its verdicts by tolerance."""


def keep_verdict(solution: Solution, verdict: Verdict, tol: float) -> None:
    """Let a solution carry the verdict on it at a tolerance."""
    kept = {**_kept(solution), tol: verdict}
    vars(solution)[_PLACE] = (solution.problem, _digest(solution), kept)


def kept_verdict(solution: Solution, tol: float) -> Verdict | None:
    """Return the verdict at a tolerance that a solution carries, or None."""
    return _kept(solution).get(tol)


def _kept(solution: Solution) -> dict[float, Verdict]:
    problem, digest, kept = vars(solution).get(_PLACE, (None, "", {}))
    valid = bool(kept) and problem is solution.problem and digest == _digest(solution)
    return kept if valid else {}


def _digest(solution: Solution) -> str:
    """Return a digest of all numbers and words that a file would hold."""
    arrays: dict[str, Array] = {}
    tree: Any = SOLUTION_FILES.packing.pack(solution, "", arrays)
    digest = hashlib.blake2b(json.dumps(tree).encode(), digest_size=16)
    for array in arrays.values():
        digest.update(array.tobytes())
    return digest.hexdigest()
