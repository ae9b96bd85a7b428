"""Every problem file by the default call: ``python -m benchmarks.problem_files [NAME ...] [--tol T] [--limit S]``.

Each problem, and each of its variants, is solved from no guess but the file's own, refined and judged as the command
``gnc-opt solve`` does it, in a process of its own. The table tells CPU time, status, distance from the reference, and
what the verdict finds.
"""

from __future__ import annotations

import argparse
import importlib
import multiprocessing
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gnc_opt as go

FOLDER = Path(__file__).parent.parent / "problems"
NO_PROBLEMS = {"__init__", "all", "comparison", "flown", "reference", "run"}
LIMIT = 120.0
"""CPU time that one may take, roughly, s."""


def cases(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return file and variant (or "") of all that is to be solved."""
    files = names or sorted({path.stem for path in FOLDER.glob("*.py")} - NO_PROBLEMS)
    modules = {name: importlib.import_module(f"problems.{name}") for name in files}
    return [(name, variant) for name, module in modules.items() for variant in ("", *_variants(module))]


def _variants(module: Any) -> dict[str, Any]:
    return getattr(module, "VARIANTS", {})


def measure(name: str, variant: str, tol: float, limit: float) -> str:
    """Solve, refine and judge one problem; return its row of the table."""
    warnings.simplefilter("ignore")
    module = importlib.import_module(f"problems.{name}")
    options, reference = _variants(module)[variant] if variant else ({}, module.REFERENCE)
    problem, start = module.build(**options), time.process_time()
    first = go.solve(problem, tol=None, throw=False)
    first_s = time.process_time() - start
    if not first.status.solved:
        return f"{first_s:7.2f} {first_s:7.2f}  {first.status.value}"
    solution = go.refine(first, tol=tol, max_wall_time=limit)
    verdict = go.verify(solution)
    cpu_s = time.process_time() - start
    assert solution.history is not None
    off = reference.difference(solution.objective) / max(1.0, abs(reference.value))
    failed = ", ".join(f"{c.name} {c.value:.1e}" for c in verdict.failed)
    word = "minimum" if verdict.minimum else "ok" if verdict.ok else f"NOT ok: {failed}"
    ended = f"{solution.history.status.value:13} {solution.objective:<18.12g}"
    return f"{first_s:7.2f} {cpu_s:7.2f}  {ended} {off:+9.1e}  {word}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("names", nargs="*", metavar="NAME", help="problem files; default all")
    parser.add_argument("--tol", type=float, default=1e-8)
    parser.add_argument(
        "--limit", type=float, default=LIMIT, metavar="S", help="wall time of each refinement"
    )
    given = parser.parse_args(arguments)
    print(
        f"{'problem':40} {'first':>7} {'all, s':>7}  status        objective          of reference  verdict"
    )
    context = multiprocessing.get_context("spawn")
    for name, variant in cases(given.names):
        with context.Pool(1) as pool:
            row = pool.apply(measure, (name, variant, given.tol, given.limit))
        print(f"{name + (f' ({variant})' if variant else ''):40} {row}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
