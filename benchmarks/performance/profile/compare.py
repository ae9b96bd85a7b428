"""Performance profiles (Dolan and Moré 2002): gnc_opt and other programs over a set of problems.

    python -m benchmarks.performance.profile [--set FILE] [--groups NAME ...] [--programs NAME ...] [--only NAME ...]
        [--environments DIR] [--lines DIR] [--json OUT] [--figure OUT.svg]

Problems: those of one phase with a known optimum in a JSON file (default ``../shared/ocp/problems.json``) and in groups
of `benchmarks.validation.engine` (default: flagship; see `documents`). Every program states them from the same file and
guess (`statement`), solves on one thread, and is stopped after `LIMIT_S` of CPU time. The time of a solve is processor
time from stating the problem to the answer; imports and a first small solve are not counted. Other programs run with
DIR/NAME/bin/python (default DIR: .peers), made by

    python -m venv .peers/yapss && .peers/yapss/bin/pip install yapss
    python -m venv .peers/rockit && .peers/rockit/bin/pip install rockit-meco
    python -m venv .peers/maptor && .peers/maptor/bin/pip install maptor
    python -m venv .peers/pockit && .peers/pockit/bin/pip install 'pockit-optimal-control[ipopt]'

and are skipped if these are missing. cyipopt, which pockit needs, has no wheel: it is built with a compiler and the
IPOPT library of the casadi wheel (3.14.19, as for rockit and maptor; yapss needs casadi 3.7, with IPOPT 3.14.11).

An answer counts for an accuracy if its objective is within that share of the reference, or within the tolerance of the
reference; a failure, a local minimum and an answer that is not accurate enough count alike. References whose tolerance
is more than `KNOWN_FACTOR` times the accuracy are left out there. For each accuracy the curve of a program is the share
of the problems that it solves in at most r times the time of the fastest one.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.performance.profile.documents import documents
from benchmarks.performance.profile.statement import LIMIT_S
from benchmarks.validation.engine import GROUPS
from benchmarks.validation.problem_set.reader import read_documents

HERE = Path(__file__).parent
SET_FILE = Path("../shared/ocp/problems.json")
PROGRAMS = ("gnc_opt", "casadi", "yapss", "rockit", "maptor", "pockit")
OURS = ("gnc_opt", "casadi")
"""What runs in this environment."""
ACCURACIES = (1e-3, 1e-4, 1e-6, 1e-8)
TABLE_FACTOR, LARGEST_FACTOR = 10.0, 1e3
"""Times over that of the fastest program: second one of the table, and end of the figure's axis."""
COLOURS = 10
"""Curves after which the colours repeat."""
KNOWN_FACTOR = 3.0
"""Largest tolerance of a reference over the accuracy for which it is used."""

Row = Mapping[str, Any]
"""Program, way, problem, reference, its relative tolerance; objective and seconds, or why it failed."""


def problems(
    documents: Sequence[Mapping[str, Any]], only: Sequence[str] = ()
) -> dict[str, tuple[float, float]]:
    """Return optimal objectives and their relative tolerances of the problems that every program can state, by name."""
    return {
        str(d["name"]): (
            float(d["reference"]), float(d["reference_uncertainty"]) / (abs(d["reference"]) or 1.0)
        )
        for d in documents
        if len(d["phases"]) == 1 and d.get("reference") is not None and not d.get("expect")
        if not only or d["name"] in only
    }  # fmt: skip


def solved_by(program: str, path: Path, names: Sequence[str], environments: Path) -> str:
    """Return the lines of JSON that a program writes; empty if its environment is missing."""
    python = Path(sys.executable) if program in OURS else environments / program / "bin" / "python"
    if not python.exists():
        print(f"{program}: skipped, {python} is missing")
        return ""
    environment = {
        **os.environ,
        **dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"),
        "PYTHONPATH": str(HERE.parents[2]) if program in OURS else "",
    }
    script = str(HERE / f"run_{program}.py")
    done = subprocess.run(
        [str(python), script, str(path.resolve()), *names],
        env=environment, stdout=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    return done.stdout


def rows_of(
    program: str, lines: str, references: Mapping[str, tuple[float, float]]
) -> Iterator[dict[str, Any]]:
    """Yield the rows of what a program wrote."""
    for line in lines.splitlines():
        if line.startswith('{"problem"'):
            found = json.loads(line)
            if found["problem"] in references:
                reference, tolerance = references[found["problem"]]
                yield {"program": program, "reference": reference, "tolerance": tolerance, **found}


def time_to(row: Row, accuracy: float) -> float:
    """Return the processor time (s) of an answer within an accuracy; infinite for any other one."""
    if row.get("objective") is None:
        return math.inf
    scale = abs(row["reference"]) or 1.0
    right = abs(row["objective"] - row["reference"]) <= max(accuracy, row["tolerance"]) * scale
    return float(row["seconds"]) if right else math.inf


def ratios(rows: Sequence[Row], accuracy: float) -> dict[tuple[str, str], list[float]]:
    """Return times over the least time of each problem that any program solves, by program and way.

    A problem that no program solves counts as a failure of all. Only problems that all ways have tried are counted.
    """
    times: dict[str, dict[tuple[str, str], float]] = {}
    for row in rows:
        if row["tolerance"] <= KNOWN_FACTOR * accuracy:
            times.setdefault(row["problem"], {})[row["program"], row["way"]] = time_to(row, accuracy)
    curves: dict[tuple[str, str], list[float]] = {(row["program"], row["way"]): [] for row in rows}
    for found in times.values():
        if len(found) < len(curves):
            continue
        least = min(found.values())
        for key, curve in curves.items():
            spent = found.get(key, math.inf)
            curve.append(spent / least if math.isfinite(spent) else math.inf)
    return curves


def share_within(curve: Sequence[float], factor: float) -> float:
    """Return the share of the problems solved in at most so many times the least time."""
    return sum(ratio <= factor for ratio in curve) / max(len(curve), 1)


def tables(rows: Sequence[Row]) -> Iterator[tuple[str, list[tuple[str, ...]]]]:
    """Yield titles and rows: a program and how many problems, or which share, it solves at each accuracy."""
    curves, near = [ratios(rows, accuracy) for accuracy in ACCURACIES], TABLE_FACTOR
    counts = [str(len(next(iter(found.values())))) for found in curves]
    measures: dict[str, Callable[[Sequence[float]], float]] = {
        f"problems solved, of {' / '.join(counts)}": lambda c: sum(map(math.isfinite, c)),
        "fastest (%)": lambda curve: 100 * share_within(curve, 1.0),
        f"within {near:g} times the least time (%)": lambda curve: 100 * share_within(curve, near),
    }
    for title, measure in measures.items():
        yield title, [(", ".join(k), *(f"{measure(found[k]):.0f}" for found in curves)) for k in curves[0]]


def figure(rows: Sequence[Row], path: Path) -> None:
    """Draw the performance profiles of all accuracies into an SVG file."""
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    mpl.rcParams["svg.hashsalt"] = "gnc_opt"
    drawn, axes = plt.subplots(2, 2, figsize=(9, 7.5), sharex=True, sharey=True, layout="constrained")
    drawn.get_layout_engine().set(wspace=0.06)  # tick labels at 1 and at the end do not touch
    for ax, accuracy in zip(axes.flat, ACCURACIES, strict=True):
        for k, ((program, way), curve) in enumerate(ratios(rows, accuracy).items()):
            finite = sorted(ratio for ratio in curve if math.isfinite(ratio))
            edges = [1.0, *finite, LARGEST_FACTOR]
            shares = [share_within(curve, factor) for factor in edges]
            style = "-" if program == "gnc_opt" else "--" if k < COLOURS else ":"
            ax.step(edges, shares, style, where="post", label=f"{program}, {way}")
        title = f"relative error at most $10^{{{math.log10(accuracy):.0f}}}$"
        ax.set(xscale="log", xlim=(1, LARGEST_FACTOR), ylim=(0, 1.02), title=title)
        ax.grid(alpha=0.3)
    for ax in axes[-1]:
        ax.set_xlabel("time relative to the fastest program")
    for ax in axes[:, 0]:
        ax.set_ylabel("share of the problems")
    drawn.legend(*axes.flat[-1].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    drawn.savefig(path, metadata={"Date": None})
    plt.close(drawn)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, or read what has been measured; print the table, write JSON and figure."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.performance.profile", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--set", type=Path, default=SET_FILE, metavar="FILE", help="default: %(default)s")
    parser.add_argument("--groups", nargs="*", choices=GROUPS, default=("flagship",), metavar="NAME")
    parser.add_argument("--programs", nargs="+", choices=PROGRAMS, default=PROGRAMS, metavar="NAME")
    parser.add_argument("--only", nargs="+", default=(), metavar="NAME", help="these problems")
    parser.add_argument("--environments", type=Path, default=Path(".peers"), metavar="DIR")
    parser.add_argument("--lines", type=Path, metavar="DIR", help="folder of NAME.jsonl written already")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write all rows")
    parser.add_argument("--figure", type=Path, metavar="OUT", help="draw the profiles into an SVG file")
    given = parser.parse_args(arguments)
    known = [*read_documents(given.set), *documents(given.groups, given.only)]
    references = problems(known, given.only)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "problems.json")
        path.write_text(json.dumps(known), encoding="utf-8")
        for program in given.programs:
            if given.lines is None:
                lines = solved_by(program, path, list(references), given.environments)
            else:
                found = given.lines / f"{program}.jsonl"
                lines = found.read_text(encoding="utf-8") if found.exists() else ""
            rows += rows_of(program, lines, references)
            if given.json is not None:  # after every program: an interrupted run leaves what is done
                given.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(f"{len(references)} problems, at most {LIMIT_S:g} s of CPU time each")
    for title, lines_of_table in tables(rows):
        for program, *cells in ((title, *map(str, ACCURACIES)), *lines_of_table):
            print(f"{program:<46}", *(f"{cell:<8}" for cell in cells))
    if given.figure is not None:
        figure(rows, given.figure)
    return 0
