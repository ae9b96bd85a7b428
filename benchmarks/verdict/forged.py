"""Numbers changed in a file that is then loaded with the problem: saved and read back by the public interface."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import gnc_opt as go
from benchmarks.verdict.statements import FAMILY, Statement, build, solved

Edit = Callable[[dict[str, Any], dict[str, Any]], None]


@dataclass(frozen=True)
class Forged:
    """A file that is not what its problem's answer is.

    Attributes
    ----------
    name, why : str
    off : float
        By which share numbers are changed.
    judge : callable
        () -> Verdict.
    """

    name: str
    why: str
    off: float
    judge: Callable[[], go.Verdict]


def forged() -> Iterator[Forged]:
    """Yield all of them: every statement's answer with costates, states or controls changed, and other problems'."""
    for s in FAMILY:
        for what, why, off, edit in _edits():
            yield Forged(f"{s.name}: {what}", why, off, lambda s=s, e=edit: _judged(s, s, e))
        for name, value in s.numbers.items():
            other = replace(s, numbers={**s.numbers, name: 1.05 * value})
            why = f"the answer for {name} 5 % larger, under this problem's fingerprint"
            yield Forged(
                f"{s.name}: {name} of another problem", why, 0.05, lambda a=s, b=other: _judged(a, b, _same)
            )


def _judged(s: Statement, answered: Statement, edit: Edit) -> go.Verdict:
    problem = build(s)
    with tempfile.TemporaryDirectory() as folder:
        file = solved(answered).save(Path(folder) / "answer.npz")
        with np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name].copy() for name in archive.files}
        header = json.loads(str(arrays.pop("header")))
        header["solution"]["fields"]["provenance"]["map"]["fingerprint"] = solved(s).provenance["fingerprint"]
        edit(header, arrays)
        changed = Path(folder) / "forged.npz"
        np.savez_compressed(changed, header=np.array(json.dumps(header)), **arrays)
        return go.verify(go.load(changed, problem=problem))


def _same(header: dict[str, Any], arrays: dict[str, Any]) -> None:
    """Nothing is changed but the fingerprint."""


def _edits() -> Iterator[tuple[str, str, float, Edit]]:
    for field, what in (("lam", "costates"), ("x", "states"), ("u", "controls")):
        yield f"{what} scaled", f"{what} 1 % larger", 0.01, _on(field, lambda v: 1.01 * v)
    yield "costates of another sign", "costates reversed", 2.0, _on("lam", lambda v: -v)
    yield "costates missing", "a costate is not a number", 1.0, _on("lam", _spoiled)


def _spoiled(values: Any) -> Any:
    values = values.copy()
    values.flat[values.size // 2] = np.nan
    return values


def _on(field: str, change: Callable[[Any], Any]) -> Edit:
    """Change the values of a polynomial of the phase."""

    def edit(header: dict[str, Any], arrays: dict[str, Any]) -> None:
        name = f"phases.leg.{field}.values"
        arrays[name] = change(arrays[name])

    return edit
