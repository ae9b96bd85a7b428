"""Has anything moved? Solve a problem set and the ten rendezvous, and compare them with what they gave before.

    python -m benchmarks.validation.regression FILE.json [--only NAME ...] [--write] [--baseline PATH]

FILE.json is a set in the format of `benchmarks.validation.problem_set`. Every problem is solved at default settings
(the rendezvous on the published mesh), refined to 1e-8 and verified. What is kept of it, in ``baseline.json`` beside
this file: status, objective, costates at the start, iterations, refinement iterations, and the conditions of the
verdict that fail or are inconclusive. Function evaluations are not kept: solutions do not carry their number.

The exit code is 1 if a status, an objective or a verdict has moved, or a problem is on one side only. Costates and the
effort are shown when they move, but do not count: multipliers need not be unique, and effort is not correctness.
``--write`` makes the present results the baseline; with ``--only``, for these problems alone.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

import gnc_opt as go
from benchmarks.validation.problem_set.reader import build_problem, read_documents
from benchmarks.validation.problem_set.references import costate_errors
from benchmarks.validation.problem_set.solve import TOLERANCE, Outcome, run
from problems import rendezvous

BASELINE = Path(__file__).with_name("baseline.json")

OBJECTIVE = 1e-9
"""Relative change of the objective that counts as a move."""

SMALL = 1e-3
"""Objectives below this are compared with it instead: 0 plus rounding has no relative change."""

COSTATES = 1e-6
"""Change of a costate that counts as a move, relative as in `benchmarks.validation.problem_set.references`: a hundred
times the tolerance of the refinement."""

EFFORT = 0.2
"""Relative change of the number of iterations that counts as a move."""


@dataclass(frozen=True)
class Record:
    """What is kept of a problem.

    Attributes
    ----------
    name, status : str
    objective : float or None
        None unless the problem was solved.
    costates : dict of float
        At the start of the first phase, by state and component, in the units of the minimised cost per state.
    magnitudes : dict of float
        Largest absolute value of these states along the phase: what the costates are weighed with.
    iterations, passes : int or None
    failed, inconclusive : tuple of str
        Conditions of the verdict.
    """

    name: str
    status: str
    objective: float | None = None
    costates: Mapping[str, float] | None = None
    magnitudes: Mapping[str, float] | None = None
    iterations: int | None = None
    passes: int | None = None
    failed: tuple[str, ...] = ()
    inconclusive: tuple[str, ...] = ()


@dataclass(frozen=True)
class Move:
    """Something that is no longer what it was.

    Attributes
    ----------
    name : str
        Of the problem.
    what, before, now : str
    counts : bool
        Whether it makes the exit code 1.
    """

    name: str
    what: str
    before: str
    now: str
    counts: bool = True


def record(outcome: Outcome, solution: go.Solution | None) -> Record:
    """Return what is kept of a solved problem."""
    solved = outcome.objective is not None and solution is not None
    costates, magnitudes = _start(solution) if solved and solution is not None else (None, None)
    return Record(
        outcome.name,
        outcome.status,
        outcome.objective,
        costates,
        magnitudes,
        outcome.iterations,
        outcome.refinements,
        outcome.failed,
        outcome.inconclusive,
    )


def _start(solution: go.Solution) -> tuple[dict[str, float], dict[str, float]]:
    """Costates at the start of the first phase, and the magnitudes of their states."""
    leg = next(iter(solution.phases.values()))
    costates = np.atleast_1d(leg.lam(leg.initial_time))
    magnitudes = np.max(np.abs(leg.x(leg.sample_times())), axis=1)
    labels = leg.states.labels
    return (
        dict(zip(labels, map(float, costates), strict=True)),
        dict(zip(labels, map(float, magnitudes), strict=True)),
    )


# --- comparing ----------------------------------------------------------------------------------------


def compare(before: Mapping[str, Record], now: Mapping[str, Record]) -> list[Move]:
    """Return what has moved, problem by problem in the order of the baseline."""
    moves: list[Move] = []
    for name in [*before, *(name for name in now if name not in before)]:
        if name not in now:
            moves.append(Move(name, "problem", "known", "missing"))
        elif name not in before:
            moves.append(Move(name, "problem", "unknown", "new"))
        else:
            moves += _moves(before[name], now[name])
    return moves


def _moves(before: Record, now: Record) -> Iterator[Move]:
    name = now.name
    if before.status != now.status:
        yield Move(name, "status", before.status, now.status)
    if (before.failed, before.inconclusive) != (now.failed, now.inconclusive):
        yield Move(name, "verdict", _verdict(before), _verdict(now))
    if before.objective is None or now.objective is None:
        return
    change = abs(now.objective - before.objective) / max(abs(before.objective), SMALL)
    if not change <= OBJECTIVE:
        yield Move(name, f"objective, by {change:.1e}", f"{before.objective:.14g}", f"{now.objective:.14g}")
    yield from _moved_costates(before, now)
    yield from _moved_effort(before, now)


def _moved_costates(before: Record, now: Record) -> Iterator[Move]:
    old, new, sizes = (_column(d) for d in (before.costates, now.costates, now.magnitudes))
    if (before.costates or {}).keys() != (now.costates or {}).keys():
        yield Move(before.name, "costates", f"of {old.size} states", f"of {new.size} states", counts=False)
        return
    changes = costate_errors(new, old, sizes)[:, 0] if old.size else np.zeros(0)
    if not np.all(changes <= COSTATES):
        i = int(np.argmax(changes))
        what = f"costate of {list(now.costates or {})[i]}, by {changes[i]:.1e}"
        yield Move(before.name, what, f"{old[i, 0]:.8g}", f"{new[i, 0]:.8g}", counts=False)


def _moved_effort(before: Record, now: Record) -> Iterator[Move]:
    old, new = before.iterations or 0, now.iterations or 0
    if abs(new - old) > EFFORT * old:
        yield Move(before.name, "iterations", str(old), str(new), counts=False)
    if before.passes != now.passes:
        yield Move(before.name, "passes", str(before.passes), str(now.passes), counts=False)


def _column(values: Mapping[str, float] | None) -> Any:
    return np.array(list((values or {}).values()), dtype=float).reshape(-1, 1)


def _verdict(kept: Record) -> str:
    results = [*(f"FAIL {name}" for name in kept.failed), *(f"? {name}" for name in kept.inconclusive)]
    return ", ".join(results) or "every condition passes"


# --- solving ------------------------------------------------------------------------------------------


def rendezvous_documents() -> list[dict[str, Any]]:
    """Return both equations and all cases of the rendezvous as entries of a set."""
    return [
        {
            "name": f"rendezvous_{equation}_{case}",
            "case": case,
            "equation": equation,
            "reference": rendezvous.REFERENCE[case, equation]["exact"].value,
        }
        for equation in rendezvous.EQUATIONS
        for case in rendezvous.CASES
    ]


def _build(document: Mapping[str, Any]) -> go.Problem:
    if "equation" in document:
        return rendezvous.build(document["case"], document["equation"])
    return build_problem(document)


def solve_all(documents: Sequence[Mapping[str, Any]], folder: Path, console: Console) -> Iterator[Record]:
    """Solve one problem after the other."""
    with console.status("") as status:
        for i, document in enumerate(documents, 1):
            status.update(f"{i} of {len(documents)}: {document['name']}")
            mesh = rendezvous.MESH if "equation" in document else None
            yield record(*run(document, folder, build=_build, mesh=mesh, tol=TOLERANCE))


# --- files --------------------------------------------------------------------------------------------


def read_baseline(path: Path) -> dict[str, Record]:
    """Return the records of a baseline by name."""
    kept = json.loads(path.read_text(encoding="utf-8"))["problems"]
    lists = ("failed", "inconclusive")
    return {entry["name"]: Record(**entry | {key: tuple(entry[key]) for key in lists}) for entry in kept}


def write_baseline(path: Path, records: Iterable[Record], provenance: Mapping[str, str]) -> None:
    """Write the records, and with which versions they were found."""
    results = {"tolerance": TOLERANCE, "versions": dict(provenance), "problems": [asdict(r) for r in records]}
    path.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


def _versions() -> dict[str, str]:
    from importlib.metadata import version
    from platform import python_version

    return {
        **{name: version(name) for name in ("gnc_opt", "casadi", "numpy", "scipy")},
        "python": python_version(),
    }


def table(moves: Iterable[Move], compared: int) -> Table:
    """Return what has moved as a rich table."""
    moves = list(moves)
    title = f"{compared} problems compared: " + (
        f"{len({m.name for m in moves})} moved" if moves else "nothing moved"
    )
    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False, title=title)
    for heading in ("problem", "what", "before", "now", ""):
        shown.add_column(heading)
    for move in moves:
        shown.add_row(
            move.name, move.what, move.before, move.now, "[bold red]MOVED[/]" if move.counts else "shown only"
        )
    return shown


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.validation.regression", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("file", type=Path, help="problems in JSON")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="solve these problems")
    parser.add_argument("--write", action="store_true", help="make the results the new baseline")
    parser.add_argument(
        "--baseline", type=Path, default=BASELINE, metavar="PATH", help="default: beside this file"
    )
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Solve, compare with the baseline, say what moved; return 1 if a status, an objective or a verdict did."""
    arguments = _arguments(argv)
    console = Console()
    if not console.is_terminal:
        console.width = max(console.width, 160)
    documents = [*read_documents(arguments.file), *rendezvous_documents()]
    before = read_baseline(arguments.baseline) if arguments.baseline.exists() else {}
    if arguments.only:
        documents = [d for d in documents if d["name"] in arguments.only]
    now = {kept.name: kept for kept in solve_all(documents, arguments.file.parent / "solutions", console)}
    known = {name: kept for name, kept in before.items() if not arguments.only or name in arguments.only}
    moves = compare(known, now)
    console.print(table(moves, len(now)))
    if arguments.write:
        kept = {**before, **now} if arguments.only else now
        write_baseline(arguments.baseline, kept.values(), _versions())
        return 0
    return 1 if any(move.counts for move in moves) else 0


if __name__ == "__main__":
    raise SystemExit(main())
