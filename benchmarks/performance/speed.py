"""Speed: gnc_opt against a bare CasADi script, re-solving, and growth with the number of segments.

    python -m benchmarks.performance.speed [--runs 7] [--quick] [--json OUT]

Workload: the time-optimal rendezvous, case 1, printed equation. Four questions:

1. Build and solve from nothing, against a bare CasADi script (`bare_rendezvous`) on the same mesh, guess, IPOPT options
   and variable scales (and once unscaled, as such scripts often are). Runs alternate; every run builds a new problem.
   Ours includes stating and checking the problem, costates and everything else that `solve` returns.
2. Solving again with other boundary values, on the build of the first solve.
3. Time per iteration for 20 to 1000 segments of degree 3: the functions of the program (one evaluation of each)
   and, from solves that stop after a few iterations, the rest of IPOPT, which is mostly the linear solver.
4. The verdict on the refined bang-bang solution, second order included, against one build and solve on 60x4.

One thread. Ratios are of processor time, medians over runs, since other programs disturb it less than wall time, which
stands beside it; the third question takes the least of its runs. Exit code 1 if a target is missed.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

import gnc_opt as go
from benchmarks.performance.bare_rendezvous import BareResult, solve_bare
from gnc_opt.planning.nlp.options import _ipopt_options
from gnc_opt.planning.solution.warm_start import start_from_guess
from gnc_opt.planning.transcription.quadrature import collocation_rule
from gnc_opt.planning.transcription.scaling import phase_magnitudes
from gnc_opt.planning.transcription.transcription import transcribe
from problems.rendezvous import build

CASE = 1
TARGETS = {"20x3": 0.7, "60x4": 0.6}
"""Mesh and the largest accepted ratio of our build and solve to the bare script's."""

LARGEST_GROWTH = 1.2
"""Of the time of function evaluations per iteration and segment, over that of the smallest mesh."""

LARGEST_OVERHEAD = 1.15
"""Of a re-solve over IPOPT's time in it."""

LARGEST_VERDICT = 0.2
"""Of `verify` on the refined solution over one build and solve on `VERDICT_MESH`."""

VERDICT_MESH = (60, 4)

SEGMENTS = (20, 50, 100, 200, 500, 1000)
ITERATIONS = 8
UNSCALED_RUNS = 1
SWEEP = 2**19
"""Numbers that are touched between two evaluations, as many as the linear solver touches on a small mesh (4 MiB)."""

T = TypeVar("T")


@dataclass(frozen=True)
class Run:
    """One build and solve.

    Attributes
    ----------
    cpu_s, wall_s : float
        All of it.
    build_s, solve_s, function_s, linear_s : float
        Wall time of its parts: until the solver starts, in the solver, in the functions of the program, and in the
        rest of the solver (mostly the linear solver).
    iterations : int
    final_time : float
        The minimum time found (s).
    """

    cpu_s: float
    wall_s: float
    build_s: float
    solve_s: float
    function_s: float
    linear_s: float
    iterations: int
    final_time: float


def ours(segments: int, degree: int) -> Run:
    """State, build and solve a new problem."""
    solution, cpu, wall = _timed(lambda: go.solve(build(CASE), mesh=f"{segments}x{degree}", tol=None))
    return _run(solution, cpu, wall)


def bare(segments: int, degree: int, *, scaled: bool) -> Run:
    """The bare script from the same start, with or without our variable scales."""
    problem = build(CASE)
    phase = problem.get_phase()
    transcription = transcribe(problem, {phase.name: go.Mesh.uniform(segments, degree)}, "LG")
    start = start_from_guess(transcription, problem)
    rule = collocation_rule("LG", degree)
    scales = (*phase_magnitudes(phase), float(start[-1])) if scaled else None
    numbers = rule.points, rule.weights, rule.differentiation
    options = ipopt_options(transcription.n_variables + transcription.n_constraints)
    result, cpu, wall = _timed(lambda: solve_bare(CASE, segments, numbers, start, options, scales))
    return _bare_run(result, cpu, wall)


def ipopt_options(size: int) -> dict[str, Any]:
    """The very options that our solver gives IPOPT, and those of `nlpsol` that spare it the parameters' multipliers."""
    quiet = {"print_time": False, "calc_lam_p": False, "no_nlp_grad": True}
    return quiet | _ipopt_options(go.SolverOptions(), "cold", size)


def compare(mesh: str, runs: int) -> dict[str, Any]:
    """Return the runs of all three on one mesh, alternating, and the ratios of their medians."""
    segments, degree = (int(n) for n in mesh.split("x"))
    found: dict[str, list[Run]] = {"bare, same scales": [], "gnc_opt": [], "bare, unscaled": []}
    for i in range(runs):
        found["bare, same scales"].append(bare(segments, degree, scaled=True))
        found["gnc_opt"].append(ours(segments, degree))
        if i < UNSCALED_RUNS:
            found["bare, unscaled"].append(bare(segments, degree, scaled=False))
    medians = {name: _median(kind) for name, kind in found.items()}
    mine, other = medians["gnc_opt"], medians["bare, same scales"]
    ratio = mine.cpu_s / other.cpu_s
    return {
        "mesh": mesh,
        "medians": {name: asdict(run) for name, run in medians.items()},
        "runs": {name: [asdict(run) for run in kind] for name, kind in found.items()},
        "ratio": ratio,
        "wall_ratio": mine.wall_s / other.wall_s,
        "ratio_to_unscaled": mine.cpu_s / medians["bare, unscaled"].cpu_s,
        "target": TARGETS[mesh],
        "met": ratio <= TARGETS[mesh],
    }


def resolve(mesh: str, runs: int) -> dict[str, Any]:
    """Solve again and again with another initial position each time, cold, on the first build."""
    problem = build(CASE)
    first = go.solve(problem, mesh=mesh, tol=None)
    found = []
    for i in range(runs):
        other = problem.with_initial(r_L=[20.0, 0.2 * (i + 1), 0.1 * (i + 1)])
        solution, cpu, wall = _timed(partial(go.solve, other, mesh=mesh, tol=None))
        assert solution.statistics.compiled_before, "a re-solve has built again"
        found.append(_run(solution, cpu, wall))
    overheads = [run.wall_s / run.solve_s for run in found]
    return {
        "mesh": mesh,
        "first_build_s": first.statistics.build_s,
        "preparation_s": statistics.median(run.build_s for run in found),
        "ipopt_s": statistics.median(run.solve_s for run in found),
        "total_s": statistics.median(run.wall_s for run in found),
        "total_over_ipopt": statistics.median(overheads),
        "target": LARGEST_OVERHEAD,
        "met": statistics.median(overheads) <= LARGEST_OVERHEAD,
        "runs": [asdict(run) for run in found],
    }


def verdict(runs: int) -> dict[str, Any]:
    """Verify the refined solution again and again, each time after a solve on the mesh that it is compared with."""
    refined = go.refine(go.solve(build(CASE), mesh="20x3", tol=None), structure="bang-bang")
    verifications, solves = [], []
    for _ in range(runs):
        solves.append(ours(*VERDICT_MESH).cpu_s)
        judged, cpu, _ = _timed(partial(go.verify, refined))
        assert judged.minimum, "the refined solution is not a strict minimum"
        verifications.append(cpu)
    verify_s, solve_s = statistics.median(verifications), statistics.median(solves)
    return {
        "verify_s": verify_s,
        "solve_s": solve_s,
        "ratio": verify_s / solve_s,
        "target": LARGEST_VERDICT,
        "met": verify_s / solve_s <= LARGEST_VERDICT,
    }


def growth(segments: Sequence[int], runs: int) -> list[dict[str, Any]]:
    """Time per iteration on growing meshes; meshes alternate, and the least time of all runs counts."""
    problems = {k: build(CASE) for k in segments}
    evaluations = {k: Evaluations(build(CASE), k) for k in segments}
    options = go.SolverOptions(max_iterations=ITERATIONS)
    functions: dict[int, list[float]] = {k: [] for k in segments}
    solves: dict[int, list[go.Solution]] = {k: [] for k in segments}
    for _ in range(runs):
        for k in segments:
            functions[k].append(evaluations[k].time())
            solves[k].append(go.solve(problems[k], mesh=f"{k}x3", options=options, throw=False, tol=None))
    rows: list[dict[str, Any]] = []
    for k in segments:
        found = [solution.statistics for solution in solves[k]]
        per_segment = 1e6 * min(functions[k]) / k
        first = rows[0]["functions_us_per_segment"] if rows else per_segment
        linear = min(s.linear_solver_s / s.iterations for s in found)
        rows.append(
            {
                "segments": k,
                "build_s": found[0].build_s,
                "functions_ms": 1e3 * min(functions[k]),
                "functions_in_ipopt_ms": 1e3 * min(s.function_s / s.iterations for s in found),
                "linear_ms": 1e3 * linear,
                "functions_us_per_segment": per_segment,
                "linear_us_per_segment": 1e6 * linear / k,
                "growth": per_segment / first,
                "met": per_segment / first <= LARGEST_GROWTH,
            }
        )
    return rows


class Evaluations:
    """One evaluation each of all functions that an iteration of IPOPT needs, at the start, without Python overhead."""

    def __init__(self, problem: go.Problem, segments: int) -> None:
        phase = problem.get_phase()
        transcription = transcribe(problem, {phase.name: go.Mesh.uniform(segments, 3)}, "LG")
        nlp = transcription.nlp
        f, g = (ca.Function(name, [nlp.x, nlp.p], [getattr(nlp, name)]) for name in ("f", "g"))
        x = start_from_guess(transcription, problem)
        ones = np.ones(transcription.n_variables), np.ones(transcription.n_constraints)
        values = x, transcription.parameter_vector(problem, *ones, 1.0), np.ones(1), ones[1]
        self._repeats = max(3, 1000 // segments)
        self._sweep = np.zeros(SWEEP)
        self._keep: list[Any] = []
        self._calls = [
            self._bound(function, values) for function in (f, g, nlp.grad_f, nlp.jac_g, nlp.hess_lag)
        ]

    def _bound(self, function: Any, values: Sequence[Any]) -> Callable[[], None]:
        call: Callable[[], None]
        buffer, call = function.buffer()
        for i in range(function.n_in()):
            buffer.set_arg(i, memoryview(values[i]))
        for i in range(function.n_out()):
            # IPOPT wants the last output only; the gradient's f and the Jacobian's g it asks for apart.
            if i == function.n_out() - 1:
                result: Any = np.zeros(function.nnz_out(i))
                buffer.set_res(i, memoryview(result))
                self._keep += [buffer, result, values]
        return call

    def time(self) -> float:
        """Processor time of one round (s); as in a solve, something else has swept the caches before each call."""
        total = 0.0
        for _ in range(self._repeats):
            for call in self._calls:
                self._sweep += 1.0
                begin = time.process_time()
                call()
                total += time.process_time() - begin
        return total / self._repeats


# --- tables ---------------------------------------------------------------------------------------------


def comparison_table(comparison: dict[str, Any]) -> Table:
    """One mesh: what each takes, per part and per iteration."""
    title = f"build + solve, {comparison['mesh']}: ratio {comparison['ratio']:.2f} (target: <= {comparison['target']})"
    columns = ("", "cpu s", "wall s", "build s", "solve s", "iter", "func ms/it", "rest ms/it", "t_f s")
    rows = []
    for name, run in comparison["medians"].items():
        per_iteration = 1e3 / run["iterations"]
        rows.append(
            (
                name,
                f"{run['cpu_s']:.3f}",
                f"{run['wall_s']:.3f}",
                f"{run['build_s']:.3f}",
                f"{run['solve_s']:.3f}",
                f"{run['iterations']:.0f}",
                f"{run['function_s'] * per_iteration:.2f}",
                f"{run['linear_s'] * per_iteration:.2f}",
                f"{run['final_time']:.6f}",
            )
        )
    table = _table(title, columns, rows)
    walls, unscaled = comparison["wall_ratio"], comparison["ratio_to_unscaled"]
    table.caption = f"ratio of wall times {walls:.2f}; to the unscaled script {unscaled:.2f}"
    return table


def resolve_table(found: dict[str, Any]) -> Table:
    """What solving again takes."""
    columns = ("first build s", "preparation s", "IPOPT s", "total s", "total / IPOPT")
    values = [f"{found[key]:.4f}" for key in ("first_build_s", "preparation_s", "ipopt_s", "total_s")]
    title = f"solving again, other boundary values, {found['mesh']} (target: <= {found['target']})"
    return _table(title, columns, [(*values, f"{found['total_over_ipopt']:.3f}")])


def verdict_table(found: dict[str, Any]) -> Table:
    """What the verdict takes."""
    mesh = "x".join(str(n) for n in VERDICT_MESH)
    columns = ("verify cpu s", f"solve {mesh} cpu s", "ratio")
    values = [f"{found[key]:.3f}" for key in ("verify_s", "solve_s", "ratio")]
    return _table(f"verdict (target: <= {found['target']})", columns, [values])


def growth_table(rows: list[dict[str, Any]]) -> Table:
    """Time per iteration against segments."""
    columns = (
        "segments", "build s", "functions ms", "us/segment", "growth",
        "functions in IPOPT ms", "linear solver ms", "us/segment",
    )  # fmt: skip
    cells = [
        (
            f"{row['segments']}",
            f"{row['build_s']:.3f}",
            f"{row['functions_ms']:.2f}",
            f"{row['functions_us_per_segment']:.1f}",
            f"{row['growth']:.2f}",
            f"{row['functions_in_ipopt_ms']:.2f}",
            f"{row['linear_ms']:.1f}",
            f"{row['linear_us_per_segment']:.0f}",
        )
        for row in rows
    ]
    return _table(f"time per iteration, degree 3 (target: growth <= {LARGEST_GROWTH})", columns, cells)


def _table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(title=title, box=box.SIMPLE, title_justify="left")
    for i, column in enumerate(columns):
        table.add_column(
            column, justify="right" if i or not rows[0][0].startswith(("bare", "gnc")) else "left"
        )
    for row in rows:
        table.add_row(*row)
    return table


# --- internals ------------------------------------------------------------------------------------------


def _timed(action: Callable[[], T]) -> tuple[T, float, float]:
    """Return the result, processor time and wall time (s)."""
    cpu, wall = time.process_time(), time.perf_counter()
    result = action()
    return result, time.process_time() - cpu, time.perf_counter() - wall


def _run(solution: go.Solution, cpu: float, wall: float) -> Run:
    s = solution.statistics
    return Run(
        cpu,
        wall,
        s.build_s,
        s.solve_s,
        s.function_s,
        s.linear_solver_s,
        s.iterations,
        solution.phase().final_time,
    )


def _bare_run(r: BareResult, cpu: float, wall: float) -> Run:
    return Run(cpu, wall, r.build_s, r.solve_s, r.function_s, r.linear_s, r.iterations, r.final_time)


def _median(runs: Sequence[Run]) -> Run:
    """Medians of every number apart."""
    columns = zip(*(asdict(run).values() for run in runs), strict=True)
    return Run(*(statistics.median(column) for column in columns))


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.performance.speed", description="How fast gnc_opt is."
    )
    parser.add_argument("--runs", type=int, default=7, help="alternating runs per comparison")
    parser.add_argument("--quick", action="store_true", help="two runs, 20x3 and at most 100 segments only")
    parser.add_argument("--json", metavar="OUT", help="write all figures there")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print the tables, write JSON; 1 if a target is missed."""
    arguments = _arguments(argv)
    runs = 2 if arguments.quick else arguments.runs
    console = Console(width=110)
    go.solve(
        build(CASE), mesh="4x3", options=go.SolverOptions(max_iterations=1), throw=False, tol=None
    )  # load the libraries
    comparisons = []
    for mesh in list(TARGETS)[: 1 if arguments.quick else None]:
        comparisons.append(compare(mesh, runs))
        console.print(comparison_table(comparisons[-1]))
    again = resolve("20x3", runs)
    console.print(resolve_table(again))
    judged = verdict(runs)
    console.print(verdict_table(judged))
    rows = growth([k for k in SEGMENTS if k <= 100 or not arguments.quick], runs)
    console.print(growth_table(rows))
    met = all(part["met"] for part in (*comparisons, again, judged, *rows))
    console.print("all targets met" if met else "a target is missed")
    if arguments.json:
        report = {
            "machine": {
                "python": platform.python_version(),
                "processor": platform.processor() or platform.machine(),
            },
            "versions": {name: version(name) for name in ("gnc_opt", "casadi", "numpy")},
            "build_and_solve": comparisons,
            "resolve": again,
            "verdict": judged,
            "growth": rows,
            "met": met,
        }
        Path(arguments.json).write_text(json.dumps(report, indent=2), encoding="utf-8")
    return 0 if met else 1


if __name__ == "__main__":
    raise SystemExit(main())
