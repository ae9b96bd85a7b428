"""The tables of docs/benchmarks.md: ``python -m benchmarks.page [NAME ...]`` measures what is named and writes them.

Numbers are kept in ``benchmarks/numbers/NAME.json`` with command, date, machine and versions, and the page shows them
all. Without a NAME nothing is measured anew.
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
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "benchmarks.md"
NUMBERS = Path(__file__).parent / "numbers"
_PACKAGES = ("gnc_opt", "casadi", "numpy", "scipy")
_PLACE = re.compile(r"(<!-- table of benchmarks\.(\w+) -->\n).*?(<!-- end of the table -->)", re.DOTALL)

Cells = Iterable[Sequence[str]]


@dataclass(frozen=True)
class Benchmark:
    """What is called, and how its numbers become rows below a heading."""

    arguments: tuple[str, ...]
    heading: tuple[str, ...]
    rows: Callable[[Any], Cells]


def _certified(told: Any) -> Cells:
    for row in told:
        parts = (f"{row['mean_s'][part]:.2f}" for part in ("solve", "refine", "verify", "all"))
        yield row["mesh"], *parts, _error(row["largest_error"]), f"{row['minima']} of {len(row['cases'])}"


def _convergence(told: Any) -> Cells:
    rows = [row for row in told["rows"] if row["scheme"] == "LG" and row["degree"] % 4 == 0]
    for row in rows:
        yield row["case"], str(row["degree"]), *(_error(row[key]) for key in ("state", "control", "costate"))


def _problem_files(told: Any) -> Cells:
    for row in told:
        file = f"{row['problem']}.py"
        place = file if (ROOT / "problems" / file).exists() else row["problem"]
        name = f"[`{row['problem']}`](../problems/{place})" + (
            f", {row['variant']}" if row["variant"] else ""
        )
        word = row["verdict"].partition(":")[0]
        yield (
            name,
            f"{row['first_s']:.2f}",
            f"{row['cpu_s']:.1f}",
            _error(row["off"]),
            row["status"].replace("_", " "),
            word,
        )


def _resolve(told: Any) -> Cells:
    for row in told:
        spent = (f"{row[key]:.0f}" for key in ("median_ms", "p99_ms", "max_ms"))
        others = f"{row['other_minima']} of {row['compared']}"
        yield f"{100 * row['size']:g} %", str(row["runs"]), *spent, _error(row["largest_difference"]), others


def _speed(told: Any) -> Cells:
    for row in told["build_and_solve"]:
        for name, run in row["medians"].items():
            yield f"{name}, {row['mesh']}", f"{run['cpu_s']:.2f}", f"{run['iterations']:.0f}"


def _refinement(told: Any) -> Cells:
    yield "by refinement", str(told["points"])
    yield f"smallest by hand: {told['hand_mesh']}", str(told["hand_points"])


def _error(value: float | None) -> str:
    return "" if value is None else f"{abs(value):.0e}" if value else "0"


BENCHMARKS = {
    "certified": Benchmark(
        ("--runs", "3"),
        (
            "first mesh",
            "solve (s)",
            "refine (s)",
            "verify (s)",
            "all (s)",
            "off the references (s)",
            "minima",
        ),
        _certified,
    ),
    "resolve": Benchmark(
        ("--runs", "100"),
        (
            "start moved by",
            "runs",
            "median (ms)",
            "99 % (ms)",
            "longest (ms)",
            "off the answer from the start",
            "another minimum",
        ),
        _resolve,
    ),
    "speed": Benchmark(("--quick",), ("program, mesh", "built and solved (s)", "iterations"), _speed),
    "refinement": Benchmark((), ("mesh of the hyper-sensitive problem", "points"), _refinement),
    "convergence": Benchmark((), ("problem", "points", "state", "control", "costate"), _convergence),
    "problem_files": Benchmark(
        (),
        ("problem", "first solve (s)", "refined and judged (s)", "off the reference", "ended", "verdict"),
        _problem_files,
    ),
}
"""Those that the page shows, by the name of their module."""


def measure(name: str) -> None:
    """Run a benchmark and keep its numbers, with what they depend on."""
    NUMBERS.mkdir(exist_ok=True)
    load = os.getloadavg()[0]
    arguments = BENCHMARKS[name].arguments
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.json"
        importlib.import_module(f"benchmarks.{name}").main([*arguments, "--json", str(out)])
        told = json.loads(out.read_text(encoding="utf-8"))
    about = {
        "load": round(load),
        "command": shlex.join(["python", "-m", f"benchmarks.{name}", *arguments]),
        "date": datetime.date.today().isoformat(),
        "machine": machine(),
        "versions": {"python": platform.python_version()}
        | {package: version(package) for package in _PACKAGES},
        "told": told,
    }
    (NUMBERS / f"{name}.json").write_text(
        json.dumps(about, indent=1, allow_nan=False) + "\n", encoding="utf-8"
    )


def machine() -> str:
    """Return processor and number of cores."""
    found = re.search(r"model name\s*:\s*(.+)", _text("/proc/cpuinfo"))
    processor = found[1].strip() if found else platform.processor() or platform.machine()
    return f"{processor}, {os.cpu_count()} cores, {platform.system()}"


def _text(path: str) -> str:
    return Path(path).read_text(encoding="utf-8") if Path(path).exists() else ""


def numbers(name: str) -> Any:
    """Return what is kept of a benchmark; None if it was never measured."""
    path = NUMBERS / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def markdown(name: str) -> str:
    """Return the table of a benchmark with its origin."""
    kept, benchmark = numbers(name), BENCHMARKS[name]
    if kept is None:
        raise ValueError(f"nothing is known of {name}: run python -m benchmarks.page {name}.")
    busy = f", {kept['load']} other programs at work" if kept["load"] else ""
    versions = ", ".join(f"{package} {number}" for package, number in kept["versions"].items())
    origin = (f"`{kept['command']}`", kept["date"], kept["machine"] + busy, versions)
    told = _table(benchmark.heading, benchmark.rows(kept["told"]))
    return f"{told}\n{_table(('measured by', 'on', 'machine', 'versions'), [origin])}"


def _table(heading: Sequence[str], rows: Cells) -> str:
    rules = ("---", *["--:"] * (len(heading) - 1))
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (heading, rules, *rows))


def written(text: str) -> str:
    """Return a page with each table between its two comments as the numbers have it."""
    return _PLACE.sub(lambda found: f"{found[1]}{markdown(found[2])}{found[3]}", text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is named and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.page", description="The tables of docs/benchmarks.md."
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"measured anew: {', '.join(BENCHMARKS)}")
    for name in (given := parser.parse_args(arguments)).names:
        if name not in BENCHMARKS:
            parser.error(f"the page has no table of {name}: choose among {', '.join(BENCHMARKS)}")
    for name in given.names:
        measure(name)
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
