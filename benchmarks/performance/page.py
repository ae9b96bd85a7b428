"""The tables of docs/benchmarks.md and benchmarks/validation/README.md.

    python -m benchmarks.performance.page [NAME [ARGUMENT ...]]

runs the benchmark with these arguments, stores its results in ``numbers/NAME.json`` with command, date, machine and
versions, and writes the tables of all stored results.
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import json
import os
import platform
import re
import shlex
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.performance.profile import compare as profile

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "docs" / "benchmarks.md", ROOT / "benchmarks" / "validation" / "README.md")
NUMBERS = Path(__file__).parent / "numbers"
_PACKAGES = ("gnc_opt", "casadi", "numpy", "scipy")
_PLACE = re.compile(r"(<!-- table of benchmarks\.\w+\.(\w+) -->\n).*?(<!-- end of the table -->)", re.DOTALL)

Cells = Iterable[Sequence[str]]
Columns = Mapping[str, Callable[[Any], str]]
"""Cells of a row by heading."""


Tables = Iterable[tuple[str, Sequence[str], Cells]]
"""Heading of the first column, those of the others, and rows."""


def _closed_loop(results: Any) -> Cells:
    yield "loop in Python with SciPy (s per run)", f"{results['plain_s_per_run']:.2f}"
    yield "campaign (s per run)", f"{results['campaign_s_per_run']:.4f}"
    yield "speed-up", f"{results['speed_up']:.0f}"
    yield "speed-up with design and building", f"{results['speed_up_built']:.0f}"
    for law, rate in results["runs_per_s"].items():
        yield f"{law} (runs per s, one processor)", f"{rate:.0f}"
    for name, ratio in results.get("filtered_over_plain", {}).items():
        yield f"TVLQR with {name}: time relative to TVLQR", f"{ratio:.1f}"
    yield "difference of the final states", _error(results["apart"])
    yield "runs within all limits", f"{100 * results['pass_rate']:.1f} %"
    yield "identical on any number of processes", "yes" if results["same_bits"] else "no"


def _error(value: float | None) -> str:
    return "" if value is None else f"{abs(value):.0e}" if value else "0"


_CERTIFIED: Columns = {
    "first mesh": lambda row: row["mesh"],
    "solve (s)": lambda row: f"{row['mean_s']['solve']:.2f}",
    "refine and verify (s)": lambda row: f"{row['mean_s']['refine'] + row['mean_s']['verify']:.2f}",
    "all (s)": lambda row: f"{row['mean_s']['all']:.2f}",
    "error (s)": lambda row: _error(row["largest_error"]),
    "minima": lambda row: f"{row['minima']} of {len(row['cases'])}",
}
_RESOLVE: Columns = {
    "initial state moved by": lambda row: f"{100 * row['size']:g} %",
    "runs": lambda row: str(row["runs"]),
    "median (ms)": lambda row: f"{row['median_ms']:.0f}",
    "99 % (ms)": lambda row: f"{row['p99_ms']:.0f}",
    "longest (ms)": lambda row: f"{row['max_ms']:.0f}",
    "difference to a cold start": lambda row: _error(row["largest_difference"]),
    "another minimum": lambda row: f"{row['other_minima']} of {row['compared']}",
}
_SCALE: Columns = {
    "problem, mesh": lambda row: row["what"],
    "iterations": lambda row: str(row["iterations"]),
    "built and solved (s)": lambda row: f"{row['all_s']:.1f}" if "all_s" in row else "",
    "per iteration and segment (ms)": lambda row: (
        f"{row['per_segment_ms']:.2f}" if row.get("per_segment_ms") is not None else ""
    ),
    "functions' share": lambda row: f"{100 * row['functions']:.0f} %",
    "largest memory (MB)": lambda row: f"{row['memory_mb']:.0f}",
}


def _by_columns(columns: Columns) -> Callable[[Any], Tables]:
    """Return a function whose results have a row of one table each."""
    first, *others = columns
    return lambda results: [(first, others, ([cell(row) for cell in columns.values()] for row in results))]


def _profile(results: Any) -> Tables:
    accuracies = [f"to {accuracy:.0e}".replace("e-0", "e-") for accuracy in profile.ACCURACIES]
    return ((title, accuracies, cells) for title, cells in profile.tables(results))


BENCHMARKS: Mapping[str, Callable[[Any], Tables]] = {
    "certified": _by_columns(_CERTIFIED),
    "resolve": _by_columns(_RESOLVE),
    "scale": _by_columns(_SCALE),
    "closed_loop": lambda results: [("rendezvous tracked by a TVLQR", [""], _closed_loop(results))],
    "profile": _profile,
}
"""Those that the page shows, by the name of their module."""


def module_of(name: str) -> str:
    """Return the module that measures a table."""
    return f"benchmarks.performance.{name}"


def measure(name: str, arguments: Sequence[str] = ()) -> None:
    """Run a benchmark with these arguments and store its results and what they depend on.

    Of files and folders among the arguments the page shows the last part.
    """
    NUMBERS.mkdir(exist_ok=True)
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.json"
        importlib.import_module(module_of(name)).main([*arguments, "--json", str(out)])
        numbers = json.loads(out.read_text(encoding="utf-8"))
    shown = [Path(each).name if Path(each).exists() else each for each in arguments]
    about = {
        "load": round(load),
        "command": shlex.join(["python", "-m", module_of(name), *shown]),
        "date": datetime.date.today().isoformat(),
        "machine": machine(),
        "versions": {"python": platform.python_version()}
        | {package: version(package) for package in _PACKAGES},
        "results": numbers,
    }
    (NUMBERS / f"{name}.json").write_text(
        json.dumps(about, indent=1, allow_nan=False) + "\n", encoding="utf-8"
    )


def machine() -> str:
    """Return processor and number of cores."""
    cpus = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*:\s*(.+)", cpus.read_text(encoding="utf-8") if cpus.exists() else "")
    processor = found[1].strip() if found else platform.processor() or platform.machine()
    return f"{processor}, {os.cpu_count()} cores, {platform.system()}"


def numbers(name: str) -> Any:
    """Return what is kept of a benchmark; None if it was never measured."""
    path = NUMBERS / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def markdown(name: str) -> str:
    """Return the table of a benchmark with its origin, or how to get it."""
    kept = numbers(name)
    if kept is None:
        return f"Not measured yet: `python -m benchmarks.performance.page {name}` puts the table here.\n"
    busy = f", {kept['load']} other programs at work" if kept["load"] else ""
    versions = ", ".join(f"{package} {number}" for package, number in kept["versions"].items())
    origin = f"Measured by `{kept['command']}` on {kept['date']}: {kept['machine']}{busy}; {versions}."
    tables = (_table((first, *others), rows) for first, others, rows in BENCHMARKS[name](kept["results"]))
    return "\n".join((*tables, f"{origin}\n"))


def _table(heading: Sequence[str], rows: Cells) -> str:
    rules = ("---", *["--:"] * (len(heading) - 1))
    return "".join(f"|{'|'.join(cells)}|\n" for cells in (heading, rules, *rows))


def written(text: str) -> str:
    """Return a page with each table between its two comments as the numbers have it."""
    return _PLACE.sub(lambda found: f"{found[1]}{markdown(found[2])}{found[3]}", text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is named and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.performance.page", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("name", nargs="?", choices=BENCHMARKS, help="measured anew")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help="of this benchmark")
    given = parser.parse_args(arguments)
    if given.name:
        measure(given.name, given.arguments)
    for page in PAGES:
        page.write_text(written(page.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
