"""Lower bounds by a part of the problem: when is the time of the rotation that of the whole rendezvous?

    python -m benchmarks.validation.lower_bounds [--runs 12] [--seed 1] [--json OUT]

Workload: the time-optimal rendezvous from rest at random attitudes (turned by 60 to 180 degrees from the axes of the
orbit, about any axis) and random places (1 to 20 m from where it ends, in any direction), so that mostly turning takes
longer than flying there. Each is solved by itself, refined to 1e-8 and checked; then `lower_bound` solves the rotation
alone. Where both take the same time the bound is attained, and the translation has time to spare.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import gnc_opt as go
from problems.rendezvous import build
from problems.rendezvous.model import FINAL_POSITION

ATTAINED = 1e-7
"""Gaps below this are those of solvers."""


def start(rng: np.random.Generator) -> dict[str, Any]:
    """Return a random initial attitude (MRP) and position (m)."""
    axis, direction = rng.standard_normal(3), rng.standard_normal(3)
    angle, distance = np.radians(rng.uniform(60.0, 180.0)), rng.uniform(1.0, 20.0)
    sigma = np.tan(angle / 4) * axis / np.linalg.norm(axis)
    return {
        "sigma": sigma,
        "r_L": np.array(FINAL_POSITION) + distance * direction / np.linalg.norm(direction),
    }


def measure(runs: int, seed: int) -> list[dict[str, Any]]:
    """Solve, check and bound every case."""
    rng, rows = np.random.default_rng(seed), []
    for k in range(runs):
        begin = time.process_time()
        found = go.solve(build().with_initial(**start(rng)), tol=1e-8, throw=False)
        bounded = go.lower_bound(found)
        bound, verdict = bounded.bound, go.verify(bounded)
        rows.append(
            {
                "case": k + 1,
                "final_time": found.objective,
                "verdict": verdict.outcome,
                "minimum": verdict.minimum,
                "bound": None if bound is None else bound.value,
                "states": [] if bound is None else list(bound.states),
                "certified": bound is not None and bound.certified,
                "gap": bounded.gap,
                "seconds": time.process_time() - begin,
            }
        )
        print({key: value for key, value in rows[-1].items() if key != "states"}, flush=True)
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the benchmark; see the module's text."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.validation.lower_bounds", description=__doc__)
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, metavar="OUT")
    options = parser.parse_args(arguments)
    rows = measure(options.runs, options.seed)
    known = [row for row in rows if row["gap"] is not None]
    attained = sum(abs(row["gap"]) < ATTAINED for row in known)
    print(f"{len(known)} of {len(rows)} bounded, {attained} of them attained")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
