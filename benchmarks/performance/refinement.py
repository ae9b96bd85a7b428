"""hp refinement: the hyper-sensitive problem against the best mesh by hand, and a whole problem set.

    python -m benchmarks.performance.refinement [FILE.json] [--only NAME ...] [--tol 1e-8] [--structure auto|none]
                                                [--json OUT] [--figure OUT.png]

Without a file only the hyper-sensitive problem is solved (t_f = 10000, from the straight-line guess and the default
mesh) and compared with the smallest meshes that a person can find for it by hand. With a file in the format of
`benchmarks.validation.problem_set` every problem is solved and refined at default settings; nothing is tuned to a
single one. The time of refinement (and verification) is processor time, as a multiple of the first solve's.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

import gnc_opt as go
from benchmarks.validation.problem_set.reader import build_problem, read_documents
from gnc_opt.planning.refinement.engine import StructureChoice
from gnc_opt.planning.refinement.error import estimate_errors, largest_error
from gnc_opt.planning.refinement.mesh.refinement import refine_mesh
from gnc_opt.plot.refinement import plot_refinement
from gnc_opt.plot.style import save_figure

REFERENCE = 1.3308069049430022
"""Optimal cost of the hyper-sensitive problem, from stitching the stable and unstable manifolds."""

WALL_TIME = 60.0
"""Limit on the solver's time for one solve, s."""

LAYERS = (10.0, 12.0, 14.0, 16.0, 18.0, 20.0, 24.0)
"""Widths of the boundary layers that are tried by hand, s: the solution decays like exp(-t)."""

GEOMETRIC = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
"""Ratios of neighbouring segments in a layer."""


def hypersensitive(final_time: float = 10_000.0) -> go.Problem:
    """Return min 1/2 int x^2 + u^2, x' = -x^3 + u, x(0) = 1.5, x(t_f) = 1 (Rao & Mease, 2000)."""
    model = go.Model("cubic")
    x, u = model.state("x"), model.control("u")
    model.ode({x: -(x**3) + u})
    problem = go.Problem("hyper-sensitive")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=final_time)
    leg.initial(x=1.5)
    leg.final(x=1.0)
    problem.minimize(leg.integral((x**2 + u**2) / 2))
    return problem


def hand_mesh(layer: float, ratio: float, pieces: int, degree: int, final_time: float = 10_000.0) -> go.Mesh:
    """Return a mesh with graded layers at both ends and one coarse segment of two points between them."""
    widths = [ratio**i for i in range(pieces)]
    edges = [layer * sum(widths[:i]) / sum(widths) for i in range(pieces + 1)]
    times = edges + [final_time - t for t in reversed(edges)]
    return go.Mesh.at_times(times, [degree] * pieces + [2] + [degree] * pieces)


def smallest_hand_mesh(start: go.Solution, tol: float) -> tuple[go.Mesh, float]:
    """Return the smallest graded mesh whose error is below the tolerance, and its error.

    Parameters
    ----------
    start : Solution
        A refined one, as the guess.
    """
    problem = start.problem
    assert problem is not None
    found: tuple[go.Mesh, float] | None = None
    options = go.SolverOptions(tolerance=0.1 * tol)
    for pieces, ratio, layer in itertools.product((1, 2, 3, 4, 5), GEOMETRIC, LAYERS):
        if pieces == 1 and ratio > 1.0:
            continue
        for degree in range(4, 33):
            mesh = hand_mesh(layer, ratio, pieces, degree)
            if found is not None and mesh.size >= found[0].size:
                break
            solution = go.solve(problem, mesh=mesh, guess=start, options=options, throw=False, tol=None)
            if not solution.status.solved:
                continue
            error, where = largest_error(estimate_errors(solution))
            if error <= tol:
                found = mesh, error
                break
            if "integral" not in where and error > tol and f"segment {pieces + 1} " in where:
                break  # the middle is at fault: no degree of the layers can help
    assert found is not None, "some hand-made mesh reaches the tolerance"
    return found


@dataclass(frozen=True)
class Row:
    """One refined problem.

    Attributes
    ----------
    name, status : str
        Status of the refinement, or of the first solve if that failed.
    reference, objective, relative_error : float or None
        The error is signed, and absolute where the reference is 0.
    accepted : bool or None
        Whether it lies within the problem's ``accept_rel_tol``.
    error : float or None
        Final estimate.
    points, segments, passes : int or None
    seconds : float
        First solve included.
    cost : float or None
        Processor time of refining in shares of the first solve's.
    verdict : tuple of str
        Conditions of `verify` that fail.
    where : str
    """

    name: str
    status: str
    reference: float | None = None
    objective: float | None = None
    relative_error: float | None = None
    accepted: bool | None = None
    error: float | None = None
    points: int | None = None
    segments: int | None = None
    passes: int | None = None
    seconds: float = 0.0
    cost: float | None = None
    verdict: tuple[str, ...] = ()
    where: str = ""


def run(document: Mapping[str, Any], tol: float, structure: StructureChoice = "auto") -> Row:
    """Solve and refine one problem of a set."""
    name, begin = str(document["name"]), time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", go.ProblemWarning)
            problem = build_problem(document)
            start = time.process_time()
            first = go.solve(
                problem, options=go.SolverOptions(max_wall_time=WALL_TIME), throw=False, tol=None
            )
            if not first.status.solved:
                return Row(name, first.status.value, seconds=time.perf_counter() - begin)
            middle = time.process_time()
            solution = go.refine(first, tol=tol, structure=structure)
            cost = (time.process_time() - middle) / (middle - start)
    except Exception as error:  # an exception in one problem must not stop the others
        return Row(name, type(error).__name__, seconds=time.perf_counter() - begin, where=str(error))
    return _row(document, solution, time.perf_counter() - begin, cost)


def _row(document: Mapping[str, Any], solution: go.Solution, seconds: float, cost: float) -> Row:
    history = solution.history
    assert history is not None, "it has just been refined"
    reference, relative, accepted = document.get("reference"), None, None
    if reference is not None:
        relative = (solution.objective - reference) / (abs(reference) or 1.0)
        accepted = abs(relative) <= document.get("accept_rel_tol", 1e-5)
    final = history.final
    failed = tuple(c.name for c in go.verify(solution).conditions if c.result is go.ConditionResult.FAIL)
    return Row(
        str(document["name"]),
        history.status.value,
        reference,
        solution.objective,
        relative,
        accepted,
        final.error,
        final.points,
        final.segments,
        len(history.passes) - 1,
        seconds,
        cost,
        failed,
        "" if history.converged else final.where,
    )


def table(rows: Iterable[Row]) -> Table:
    """Return the results as a rich table."""
    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    shown.add_column("problem", no_wrap=True)
    for heading in ("rel. error", "estimate", "points", "segments", "passes", "time/s", "cost"):
        shown.add_column(heading, justify="right", no_wrap=True)
    shown.add_column("ended")
    shown.add_column("verdict fails")
    for r in rows:
        shown.add_row(
            r.name,
            "-" if r.relative_error is None else f"{r.relative_error:+.1e}",
            "-" if r.error is None else f"{r.error:.1e}",
            *("-" if v is None else str(v) for v in (r.points, r.segments, r.passes)),
            f"{r.seconds:.2f}",
            "-" if r.cost is None else f"{r.cost:.1f}",
            r.status + ("" if r.accepted in (True, None) else " [bold red]OFF[/]"),
            ", ".join(r.verdict),
        )
    return shown


def compare_with_hand(console: Console, tol: float, figure: Path | None) -> dict[str, Any]:
    """Refine the hyper-sensitive problem, find the smallest mesh by hand; return points and errors of both."""
    begin = time.perf_counter()
    solution, history = refine_mesh(go.solve(hypersensitive(), tol=None), tol=tol)
    seconds = time.perf_counter() - begin
    console.print(str(history), markup=False, highlight=False)
    mesh, error = smallest_hand_mesh(solution, tol)
    ratio = history.final.points / mesh.size
    console.print(
        f"hyper-sensitive: {history.final.points} points, cost off by {solution.objective / REFERENCE - 1:+.1e}, "
        f"{seconds:.2f} s; smallest by hand: {mesh.size} points ({mesh}, error {error:.1e}); ratio {ratio:.2f}"
    )
    if figure is not None:
        save_figure(plot_refinement(history), figure)
    off = solution.objective / REFERENCE - 1
    by_hand = {"hand_mesh": str(mesh), "hand_points": mesh.size, "hand_error": error}
    return {
        "points": history.final.points,
        "error": history.final.error,
        "off": off,
        "seconds": seconds,
        "ratio": ratio,
        **by_hand,
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Run; return 0 if every objective is within its tolerance."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.performance.refinement", description=__doc__.split("\n")[0]
    )
    parser.add_argument("file", nargs="?", type=Path, help="problems in JSON")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="refine these problems")
    parser.add_argument("--tol", type=float, default=1e-8)
    parser.add_argument("--structure", choices=("auto", "none"), default="auto", help="how to refine")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the rows to this file")
    parser.add_argument("--figure", type=Path, metavar="OUT.png", help="draw the hyper-sensitive history")
    arguments = parser.parse_args(argv)
    console = Console()
    if arguments.file is None:
        found = compare_with_hand(console, arguments.tol, arguments.figure)
        if arguments.json:
            arguments.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        return 0 if found["ratio"] <= 1.5 else 1
    rows = []
    with console.status("") as status:
        for document in read_documents(arguments.file):
            if arguments.only and document["name"] not in arguments.only:
                continue
            status.update(document["name"])
            rows.append(run(document, arguments.tol, arguments.structure))
            if arguments.json:
                text = json.dumps([asdict(r) for r in rows], indent=1)
                arguments.json.write_text(text + "\n", encoding="utf-8")
    console.print(table(rows))
    costs = [r.cost for r in rows if r.cost is not None]
    if costs:
        console.print(
            f"cost of refining in first solves: median {median(costs):.1f}, at most {max(costs):.1f}"
        )
    return 1 if any(r.accepted is False for r in rows) else 0


if __name__ == "__main__":
    raise SystemExit(main())
