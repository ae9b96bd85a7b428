"""Every problem by the default call: ``python -m benchmarks.performance.problem_files [NAME ...] [--json OUT]``.

Each problem, file or folder, and each of its variants, is solved from no guess but its own, refined and checked as the
command ``gnc-opt solve`` does it, in a process of its own. The table tells CPU time, status, distance from the
reference (systems have other ones), and what the verdict finds.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gnc_opt as go
from gnc_opt.problem_file import example, examples
from problems._example import Reference

LIMIT = 120.0
"""CPU time that one may take, roughly, s."""


def cases(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return file and variant (or "") of all that is to be solved."""
    modules = {name: example(name).module for name in names or [each.name for each in examples()]}
    solved = {name: module for name, module in modules.items() if hasattr(module, "build")}
    return [(name, variant) for name, module in solved.items() for variant in ("", *_variants(module))]


def _variants(module: Any) -> dict[str, Any]:
    return getattr(module, "VARIANTS", {})


@dataclass(frozen=True)
class Row:
    """One problem: CPU time (s) of the first solve and of all, how it ended, relative distance from the reference."""

    problem: str
    variant: str
    first_s: float
    cpu_s: float
    status: str
    objective: float
    off: float
    verdict: str

    @property
    def shown(self) -> str:
        """Its line of the table."""
        name = self.problem + (f" ({self.variant})" if self.variant else "")
        times = f"{name:40} {self.first_s:7.2f} {self.cpu_s:7.2f}"
        return f"{times}  {self.status:13} {self.objective:<18.12g} {self.off:+9.1e}  {self.verdict}"


def measure(name: str, variant: str, tol: float, limit: float) -> Row:
    """Solve, refine and check one problem."""
    warnings.simplefilter("ignore")
    module = example(name).module
    options, reference = _variants(module)[variant] if variant else ({}, getattr(module, "REFERENCE", None))
    problem, start = module.build(**options), time.process_time()
    first = go.solve(problem, mesh=getattr(module, "MESH", None), tol=None, throw=False)
    first_s = time.process_time() - start
    if not first.status.solved:
        return Row(
            name, variant, first_s, first_s, first.status.value, first.objective, float("nan"), "not solved"
        )
    solution = go.refine(first, tol=tol, limits=go.RefinementLimits(max_wall_time=limit))
    verdict = go.verify(solution)
    cpu_s = time.process_time() - start
    assert solution.history is not None
    known = isinstance(reference, Reference)
    off = reference.difference(solution.objective) / max(1.0, abs(reference.value)) if known else float("nan")
    failed = ", ".join(f"{c.name} {c.value:.1e}" for c in verdict.failed)
    word = "minimum" if verdict.minimum else "ok" if verdict.ok else f"NOT ok: {failed}" if failed else "open"
    return Row(name, variant, first_s, cpu_s, solution.history.status.value, solution.objective, off, word)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("names", nargs="*", metavar="NAME", help="problem files; default all")
    parser.add_argument("--tol", type=float, default=1e-8)
    parser.add_argument(
        "--limit", type=float, default=LIMIT, metavar="S", help="wall time of each refinement"
    )
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the rows to this file")
    given = parser.parse_args(arguments)
    print(
        f"{'problem':40} {'first':>7} {'all, s':>7}  status        objective          of reference  verdict"
    )
    context = multiprocessing.get_context("spawn")
    rows = []
    for name, variant in cases(given.names):
        with context.Pool(1) as pool:
            rows.append(pool.apply(measure, (name, variant, given.tol, given.limit)))
        print(rows[-1].shown, flush=True)
    if given.json is not None:
        results = json.dumps([asdict(row) for row in rows], indent=1).replace("NaN", "null")
        given.json.write_text(results + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
