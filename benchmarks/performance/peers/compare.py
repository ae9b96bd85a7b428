"""Time to accuracy: the time-optimal rendezvous by gnc_opt and by other programs, each in its own environment.

    python -m benchmarks.performance.peers [--cases 1 2 3 4 5] [--runs 7] [--environments DIR] [--json OUT]

A program NAME of yapss, maptor, asset runs with DIR/NAME/bin/python (default DIR: .peers), made by

    python -m venv .peers/yapss && .peers/yapss/bin/pip install yapss        (maptor; asset-asrl for asset)

and is skipped where that is missing. All state the same plain equations, start from the same straight line between the
ends, 50.5 s long, with a tenth of all controls, and solve to 1e-8 on one thread; gnc_opt has its own default start. The
time is processor time from stating the problem to the answer, imports and a first small solve left out, medians of
the runs, of which there are fewer where they take long (`plain.LONG_S` in all). Each program counts with the least
time of all its meshes and options whose final time is within the accuracy of the reference, on every case.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import mean, median
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from problems.rendezvous import REFERENCE

HERE = Path(__file__).parent
PROGRAMS = ("gnc_opt", "casadi", "yapss", "maptor", "asset")
OURS = ("gnc_opt", "casadi")
"""What runs in this environment."""
ACCURACIES = (1e-3, 1e-4, 1e-6, 1e-8)
LONGEST_S = 1800
"""Of one program on one case, wall time."""

SolveMethod = dict[int, dict[str, Any]]
"""Results of a program on one mesh with its options, by case."""


def measured(program: str, case: int, runs: int, environments: Path) -> list[dict[str, Any]] | None:
    """Return what a program tells of a case, None where it is not there."""
    python = Path(sys.executable) if program in OURS else environments / program / "bin" / "python"
    if not python.exists():
        return None
    alone = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    path = {"PYTHONPATH": str(HERE.parents[2])} if program in OURS else {}
    script = HERE / f"run_{program}.py"
    try:
        done = subprocess.run(
            [str(python), str(script), str(case), str(runs)],
            env={**os.environ, **alone, **path}, capture_output=True, text=True, check=False, timeout=LONGEST_S,
        )  # fmt: skip
        output, why = done.stdout, done.stderr
    except subprocess.TimeoutExpired as late:
        output, why = (late.stdout or b"").decode(), "took too long"
    found = [json.loads(line) for line in output.splitlines() if line.startswith('{"way"')]
    if not found:
        print(f"{program}, case {case}: nothing came of it: {why.strip()[-200:]}", file=sys.stderr)
    return found


def measure(cases: Sequence[int], runs: int, environments: Path) -> dict[str, dict[str, SolveMethod]]:
    """Return the ways of every program that is there; cases in turn, so that all see the same machine."""
    found: dict[str, dict[str, SolveMethod]] = {}
    for case in cases:
        exact = REFERENCE[case, "printed"]["exact"].value
        for program in PROGRAMS:
            rows = measured(program, case, runs, environments)
            if rows is None:
                if case == cases[0]:
                    print(f"{program}: skipped, {environments / program} is missing")
                continue
            for row in rows:
                way = found.setdefault(program, {}).setdefault(row["way"], {})
                if "seconds" in row:
                    way[case] = {"s": median(row["seconds"]), "error": abs(row["final_time"] - exact)}
                else:
                    way[case] = {"failed": row["failed"]}
    return found


def best(ways: dict[str, SolveMethod], cases: Sequence[int], accuracy: float) -> tuple[float, str] | None:
    """Return the least mean time (s) of the ways that are right on all cases, and which; None if none is."""
    right = [
        (mean(way[case]["s"] for case in cases), name)
        for name, way in ways.items()
        if all(case in way and way[case].get("error", 1.0) <= accuracy for case in cases)
    ]
    return min(right, default=None)


def table(found: dict[str, dict[str, SolveMethod]], cases: Sequence[int]) -> Table:
    """Least times by program and accuracy."""
    which = f"case {cases[0]}" if len(cases) == 1 else f"mean of {len(cases)} cases"
    made = Table(title=f"Processor time to accuracy, {which} (s)", box=box.SIMPLE_HEAD)
    for heading in ("", *(f"{a:g} s" for a in ACCURACIES)):
        made.add_column(heading, no_wrap=True)
    for program, ways in found.items():
        cells = (best(ways, cases, accuracy) for accuracy in ACCURACIES)
        made.add_row(program, *("never" if cell is None else f"{cell[0]:.3g} ({cell[1]})" for cell in cells))
    return made


def ahead(found: dict[str, dict[str, SolveMethod]], cases: Sequence[int]) -> bool:
    """Whether gnc_opt is the fastest to every accuracy."""
    for accuracy in ACCURACIES:
        least = {name: best(ways, cases, accuracy) for name, ways in found.items()}
        times = {name: cell[0] for name, cell in least.items() if cell is not None}
        if min(times, key=lambda name: times[name], default="") != "gnc_opt":
            return False
    return True


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print the tables; 1 if another program is ahead in a column."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.performance.peers", description="Time to accuracy."
    )
    parser.add_argument("--cases", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--environments", type=Path, default=Path(".peers"))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(argv)
    found = measure(options.cases, options.runs, options.environments)
    groups = [[options.cases[0]], options.cases] if len(options.cases) > 1 else [options.cases]
    console = Console(highlight=False, width=150)
    for cases in groups:
        console.print(table(found, cases))
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))
    return 0 if all(ahead(found, cases) for cases in groups) else 1
