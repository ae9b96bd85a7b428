"""Solving again: how long, which way, and how far from the answer from the start.

    python -m benchmarks.performance.resolve [--runs 1000] [--cold 20] [--json OUT]

Workload: the time-optimal rendezvous, case 1, printed equation, refined to 1e-8 once; then random initial positions,
each component within 0.01 %, 1 % and 10 % of the distance, from one `go.Resolver`. Processor time of each, one thread;
its median, 99th percentile and maximum, and a histogram. The first ``--cold`` are solved from the start as well: where
both find the same local minimum, the objectives differ by what is shown; where not, that is counted.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import gnc_opt as go
from problems.rendezvous import CASES, build

CASE, SEED, MESH, TOL = 1, 1, "10x3", 1e-8
SIZES = (1e-4, 0.01, 0.1)
EDGES_MS = (0, 20, 40, 60, 80, 100, 150, 200, 300, 500, 1000, 2000, 5000)

SAME = 1e-6
"""Objectives nearer than this, relatively, are those of one local minimum."""


def measure(resolver: go.Resolver, problem: go.Problem, size: float, runs: int, cold: int) -> dict[str, Any]:
    """Solve again from random initial positions."""
    rng, position = np.random.default_rng(SEED), np.array(CASES[CASE])
    times, ways, differences, others = [], Counter[str](), [], 0
    for k in range(runs):
        changed = problem.with_initial(r_L=position + size * np.linalg.norm(position) * rng.uniform(-1, 1, 3))
        begin = time.process_time()
        found = resolver.solve(changed)
        times.append(1e3 * (time.process_time() - begin))
        ways[found.provenance["way"]] += 1
        if k < cold:
            reference = go.solve(changed, mesh=MESH, tol=TOL)
            difference = abs(found.objective / reference.objective - 1)
            others += difference >= SAME
            differences += [difference] if difference < SAME else []
    counts, _ = np.histogram(times, EDGES_MS)
    return {
        "size": size,
        "runs": runs,
        "median_ms": float(np.median(times)),
        "p99_ms": float(np.quantile(times, 0.99)),
        "max_ms": max(times),
        "ways": dict(ways),
        "histogram_ms": dict(zip(map(str, EDGES_MS[1:]), counts.tolist(), strict=True)),
        "largest_difference": max(differences, default=0.0),
        "other_minima": int(others),
        "compared": min(cold, runs),
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Measure all sizes and print one line each."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.performance.resolve")
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--cold", type=int, default=20)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args(argv)
    problem = build(CASE)
    resolver = go.Resolver(go.solve(problem, mesh=MESH, tol=TOL))
    found = [measure(resolver, problem, size, arguments.runs, arguments.cold) for size in SIZES]
    for row in found:
        print(
            f"{100 * row['size']:g} %: median {row['median_ms']:.0f} ms, 99 % {row['p99_ms']:.0f} ms, "
            f"most {row['max_ms']:.0f} ms; {row['ways']}; from the start: the same to "
            f"{row['largest_difference']:.1e}, {row['other_minima']} of {row['compared']} another minimum"
        )
        print("  up to ms:", row["histogram_ms"])
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
