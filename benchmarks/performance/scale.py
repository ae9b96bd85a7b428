r"""Scale: time and memory of one solve from 20 to 2000 segments, and a spiral of a hundred revolutions.

    python -m benchmarks.performance.scale [--quick] [--json OUT]

Workload: the time-optimal rendezvous, case 1, on 20x3 to 2000x3, `ITERATIONS` iterations each: processor time of one
thread per iteration and segment, without what stating, building and setting up take, which stands beside it; which
share of the solver's time its functions take, all that more threads could share; and the most memory of the process,
which is a new one for each size.

The spiral: thrust of 3e-4 of the weight at the start, its direction free, from the unit circle to twice its radius in
least time, 1000x4. Quasi-circular orbits have dr/dt = 2 a r^(3/2), which makes
:math:`(1 - r_f^{-2}) / (8 \pi a)` revolutions, a hundred, and the time :math:`(1 - r_f^{-1/2}) / a` (Edelbaum, ARS
Journal 31, 1961). From straight lines between the ends.

Exit code 1 if the time per iteration and segment grows by more than `GROWTH` from the least, or the spiral is not
found.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import casadi as ca

import gnc_opt as go
from gnc_opt.planning.direct.scaled_nlp_setup import ScaledNlp
from problems import rendezvous

SEGMENTS = (20, 60, 200, 600, 2000)
ITERATIONS = 33
"""Many, as some iterations need several factorisations, on one mesh more than on another."""

GROWTH = 1.3
THRUST, RADIUS = 2.984e-4, 2.0
"""Thrust per unit of mass, and the radius at the end; the unit is that of the start, with mu = 1."""

NODES = "1000x4"
NEAR = 0.02
"""How far the spiral may be from Edelbaum's time, relatively: his orbits stay circular."""


def rendezvous_of(segments: int) -> dict[str, Any]:
    """Return what `ITERATIONS` of the rendezvous take on so many segments, from the straight line."""
    begin = time.process_time()
    problem = rendezvous.build(1)
    meshes = dict.fromkeys(problem.phases, go.Mesh.uniform(segments, 3))
    options = go.SolverOptions(max_iterations=ITERATIONS)
    attempt = ScaledNlp.from_problem(problem, meshes, "LG", None, options)
    point = attempt.build_scaled_nlp_point(attempt.start)
    attempt.solver.create_nlp_solver(point)
    middle = time.process_time()
    found = attempt.solver.solve(point)
    each = (time.process_time() - middle) / found.iterations
    return {
        "what": f"rendezvous, {segments}x3",
        "segments": segments,
        "iterations": found.iterations,
        "once_s": middle - begin,
        "per_iteration_ms": 1e3 * each,
        "per_segment_ms": 1e3 * each / segments,
        "functions": found.function_time / found.wall_time,
        "memory_mb": _most_memory(),
    }


def spiral() -> go.Problem:
    """Return the least time from one circular orbit to another by a small thrust."""
    model = go.Model("spiral")
    r, theta, radial, across = (model.state(name) for name in ("r", "theta", "radial", "across"))
    steering = model.control("steering")
    model.ode(
        {
            r: radial,
            theta: across / r,
            radial: across**2 / r - 1 / r**2 + THRUST * ca.sin(steering),
            across: -radial * across / r + THRUST * ca.cos(steering),
        }
    )
    problem = go.Problem("spiral of a hundred revolutions")
    leg = problem.phase("leg", model)
    expected = (1 - RADIUS**-0.5) / THRUST
    leg.time(0.0, (0.1 * expected, 10 * expected))
    leg.initial(r=1.0, theta=0.0, radial=0.0, across=1.0)
    leg.final(r=RADIUS, radial=0.0, across=RADIUS**-0.5)
    leg.bounds(r=(0.5, 2 * RADIUS), steering=(-math.pi, math.pi))
    turns = 2 * math.pi * (1 - RADIUS**-2) / (8 * math.pi * THRUST)
    leg.guess(time=[0.0, expected], theta=[0.0, turns])
    problem.minimize(leg.final_time)
    return problem


def spiral_of_a_hundred() -> dict[str, Any]:
    """Return what the spiral takes, from straight lines."""
    problem = spiral()
    begin = time.process_time()
    found = go.solve(problem, mesh=NODES, tol=None, throw=False)
    spent = time.process_time() - begin
    segments, iterations = found.phase().mesh.segments, found.statistics.iterations
    expected = (1 - RADIUS**-0.5) / THRUST
    return {
        "what": f"spiral, {NODES}",
        "segments": segments,
        "iterations": iterations,
        "solved": found.status.solved,
        "all_s": spent,
        "revolutions": float(found.state("theta")(found.phase().final_time)) / (2 * math.pi),
        "off": found.objective / expected - 1,
        "functions": found.statistics.function_s / found.statistics.solve_s,
        "memory_mb": _most_memory(),
    }


def _most_memory() -> float:
    """Peak of this process, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _apart(action: Callable[..., dict[str, Any]], *arguments: Any) -> dict[str, Any]:
    """Return what a function finds in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(action, *arguments).result()


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print, write JSON; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.performance.scale", description="Time and memory by size."
    )
    parser.add_argument("--quick", action="store_true", help="up to 200 segments, and no spiral")
    parser.add_argument("--spiral", action="store_true", help="the spiral alone")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the rows to this file")
    options = parser.parse_args(argv)
    rows = []
    for segments in () if options.spiral else SEGMENTS[: 3 if options.quick else None]:
        rows.append(_apart(rendezvous_of, segments))
        print(rows[-1], flush=True)
    times = [row["per_segment_ms"] for row in rows] or [1.0]
    met = max(times) <= GROWTH * min(times)
    if not options.quick:
        rows.append(_apart(spiral_of_a_hundred))
        print(rows[-1], flush=True)
        met = met and rows[-1]["solved"] and abs(rows[-1]["off"]) < NEAR
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(f"time per iteration and segment within {max(times) / min(times):.2f}")
    return 0 if met else 1


if __name__ == "__main__":
    raise SystemExit(main())
