"""Validate the stated accuracy of answers: the objective's error, the miss at the ends, exceeded limits.

    python -m benchmarks.validation.accuracy [--quick] [--only NAME ...] [--json OUT] [--set FILE] [--limit CPU_S]

Problems: those of the groups "set", "gallery" and "rendezvous" of `benchmarks.validation.engine` whose optimum is known
to `REFERENCE_MAX_ERROR`. Each is solved on the meshes of `MESHES` as they are, and once refined.

Two questions. Is the estimated error of the objective near the true one? The ratio is taken where the true error
exceeds `KNOWN_RATIO` times the error of the reference and `PROGRAM_ERROR`; of the other answers the largest estimate
is printed. An answer that a fine mesh confirms is another local minimum, of which the estimate says nothing; it is
counted. Are misses and violations those of SciPy's integration of the applied control, within `AGREEMENT`?
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import resource
import time
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import gnc_opt as go
from benchmarks.validation import engine
from benchmarks.validation.problem_set.reader import build_problem, read_documents
from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import NEGLIGIBLE
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples

GROUPS = ("set", "gallery", "rendezvous")

MESHES = ("5x3", "10x3", "20x4", "60x4", "refined")

FINE_MESHES = ("120x4", "90x4")
"""Meshes on which an answer is solved again, the second one if the first one has no solution."""

REFERENCE_MAX_ERROR = 1e-7
"""Largest relative error of a reference."""

KNOWN_RATIO = 10.0
"""True errors below this many times the error of the reference are not compared."""

PROGRAM_ERROR = go.SolverOptions().tolerance
"""True errors below this share of the objective are not compared: the barrier leaves them, and they are not the mesh's.

An answer whose mesh happens to have the switches on its boundaries has no other error, while costates and estimate have
that of the mesh."""

MOST_RATIO = 60.0
"""Estimated over true error that is wanted in 95 % of the answers."""

AGREEMENT = 1e-2
"""Relative difference of a miss or violation from SciPy's that agrees."""

DIVERGED = 1e6
"""A trajectory that ends this many sizes away does not reach the end, as solutions say of it."""

INTEGRATION_ERROR = 1e-7
"""Misses and violations below this share of the quantity's size are not compared."""

RELATIVE_ERRORS = 1e-12, 1e-11
"""Tolerances of SciPy's two integrations; if they differ by a tenth of `AGREEMENT`, nothing is compared."""

CPU_LIMIT_S = 120.0
QUICK = 6
"""With ``--quick`` every sixth problem."""


@dataclass(frozen=True)
class Row:
    """One answer; errors of the objective are absolute, misses and violations relative to the quantity's size.

    ``size`` is that of the objective.
    """

    problem: str
    mesh: str
    error: float | None = None
    estimate: float | None = None
    ratio: float | None = None
    relative_error: float | None = None
    size: float = 1.0
    other_minimum: bool = False
    miss_difference: float | None = None
    violation_difference: float | None = None
    note: str = ""

    def __str__(self) -> str:
        numbers = (self.relative_error, self.ratio, self.miss_difference, self.violation_difference)
        shown = " ".join(f"{'-' if v is None else format(v, '.1e'):>9}" for v in numbers)
        return f"{self.problem:34} {self.mesh:8} {shown}  {self.note}".rstrip()


HEADING = f"{'problem':34} {'mesh':8} {'error':>9} {'est/true':>9} {'miss':>9} {'violation':>9}"


def known_cases(set_file: Path) -> Iterator[tuple[engine.Case, float, float]]:
    """Yield the problems whose optimum is known, each once: case, reference, its absolute error."""
    documents = {d["name"]: d for d in read_documents(set_file)} if set_file.is_file() else {}
    known: list[float] = []
    for case in engine.cases(GROUPS, (), set_file):
        if case.group == "set":
            document = documents[case.name]
            value, error = document.get("reference"), document.get("reference_uncertainty")
            if document.get("expect") or value is None or error is None:
                continue
        else:
            reference = engine.stated(case)[1]
            if reference is None:
                continue
            value, error = reference.value, reference.tolerance
        size = abs(value) or 1.0
        if error <= REFERENCE_MAX_ERROR * size and all(
            abs(value - v) > REFERENCE_MAX_ERROR * size for v in known
        ):
            known.append(value)
            yield case, float(value), float(error)


def measure(case: engine.Case, value: float, error: float, set_file: Path, limit_s: float) -> list[Row]:
    """Return the rows of one problem."""
    warnings.simplefilter("ignore")
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    end = time.process_time() + limit_s
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(end), hard))
    problem = (
        build_problem(next(d for d in read_documents(set_file) if d["name"] == case.name))
        if case.group == "set"
        else engine.stated(case)[0]
    )
    return [_row(Row(case.label, mesh), problem, value, error) for mesh in MESHES]


def _row(row: Row, problem: go.Problem, value: float, error: float) -> Row:
    mesh = None if row.mesh == "refined" else row.mesh
    try:
        solution = go.solve(
            problem, mesh=mesh, tol=None if mesh else engine.TOLERANCES["set"], check=False, throw=False
        )
    except go.GncOptError as why:
        return replace(row, note=str(why).partition("\n")[0])
    if not solution.status.solved:
        return replace(row, note=solution.status.value)
    size = abs(value) or 1.0
    true = abs(solution.objective - value)
    estimate = solution.objective_error.absolute_error
    row = replace(row, error=true, estimate=estimate, relative_error=true / size, size=size)
    if true > max(KNOWN_RATIO * error, PROGRAM_ERROR * size):
        row = replace(row, ratio=estimate / true)
        if estimate < 0.5 * true and _is_other_minimum(solution, problem, true):
            row = replace(row, ratio=None, other_minimum=True, note="another minimum")
    return replace(row, **compare_trajectory(solution))


def _is_other_minimum(solution: go.Solution, problem: go.Problem, true: float) -> bool:
    """Whether the first fine mesh with a solution, started from an answer, stays at its objective."""
    for mesh in FINE_MESHES:
        fine = go.solve(problem, mesh=mesh, guess=solution, tol=None, throw=False)
        if fine.status.solved:
            return abs(fine.objective - solution.objective) < 0.5 * true
    return False


def compare_trajectory(solution: go.Solution) -> dict[str, float | None]:
    """Return the differences of the miss and the violation from those of SciPy's integration, relative."""
    accuracy, (fine, coarse) = solution.accuracy, (_largest_amounts(solution, e) for e in RELATIVE_ERRORS)
    if fine is None or coarse is None:
        return {}
    if math.isinf(accuracy.miss):
        return {"miss_difference": 0.0 if fine[0] > DIVERGED else math.inf}
    return {
        f"{name}_difference": abs(stated - one) / one if abs(one - other) <= AGREEMENT / 10 * one else None
        for name, stated, one, other in zip(
            ("miss", "violation"), (accuracy.miss, accuracy.violation), fine, coarse, strict=True
        )
    }


def _largest_amounts(solution: go.Solution, relative_error: float) -> tuple[float, float] | None:
    """Return the miss and the violation according to SciPy's integration; NaN if its errors are as large."""
    misses, violations = [], []
    for s in solution.samples().values():
        fine = integrated(s, relative_error)
        if fine is None:
            return None
        times, x, u = fine
        end, box = x[:, -1], s.phase.final_bounds
        miss = np.abs(end - s.phase.x(s.phase.breaks[-1], "left")), box.lower - end, end - box.upper
        misses.append((np.max(miss, axis=0), np.max(np.abs(x), axis=1), s.state_scale))
        rows = [(x, s.phase.state_bounds, s.state_scale)]
        if s.phase.path_labels:
            rows.append((s.functions.path_constraints(times, x, u), s.phase.path_bounds, s.path_scale))
        for values, box, scale in rows:
            excess = np.maximum(box.lower[:, None] - values, values - box.upper[:, None])
            violations.append((np.max(excess, axis=1), np.max(np.abs(values), axis=1), scale))
    return _largest_amount(misses), _largest_amount(violations)


def _largest_amount(found: Sequence[tuple[Array, Array, Array]]) -> float:
    """Return the largest in shares of the scale; NaN if that is within the error of the integration."""
    amount, size, scale = (np.concatenate(part) for part in zip(*found, strict=True))
    i = int(np.argmax(amount / scale))
    return float(amount[i]) if amount[i] > INTEGRATION_ERROR * max(size[i], scale[i]) else math.nan


def integrated(s: PhaseSamples, relative_error: float) -> tuple[Array, Array, Array] | None:
    """Integrate the applied control from the initial state by SciPy: times, states and controls, finely; or None."""
    leg, pieces = s.phase, []
    x = leg.x(leg.breaks[0])
    absolute = 0.1 * relative_error * np.maximum(np.max(np.abs(s.x), axis=1), 1e-30)
    for left, right in itertools.pairwise(leg.applied.jump_times):
        inside = np.linspace(left, right, 65)
        if not right - left > 1e-12 * s.span:
            continue

        def rate(t: float, x: Array, left: float = left, right: float = right) -> Array:
            at = np.clip([t], left + 1e-12 * (right - left), right - 1e-12 * (right - left))
            return s.functions.state_rates(at, x[:, None], leg.applied(at))[:, 0]

        run = solve_ivp(rate, (left, right), x, "DOP853", inside, rtol=relative_error, atol=absolute)
        if not run.success or not np.all(np.isfinite(run.y)):
            return None
        u = leg.applied(np.clip(inside, left, right - 1e-12 * (right - left)))
        pieces.append((inside, run.y, u))
        x = run.y[:, -1]
    times, states, controls = (np.concatenate(part, axis=-1) for part in zip(*pieces, strict=True))
    return times, states, controls


def summary(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the shares that the acceptance asks for."""
    for mesh in (*MESHES, "all"):
        some = [row for row in rows if mesh in (row.mesh, "all")]
        ratios = np.array([row.ratio for row in some if row.ratio is not None])
        if not ratios.size:
            continue
        least = min(
            (row for row in some if row.ratio is not None), key=lambda row: row.ratio or 0.0, default=None
        )
        others = sum(row.other_minimum for row in some)
        yield (
            f"{mesh:8} {len(some)} answers, {ratios.size} compared, {others} another minimum: "
            f"ratio at least 0.5 in {np.mean(ratios >= 0.5):.1%}, median {np.median(ratios):.2g}, "
            f"at most {MOST_RATIO:g} in {np.mean(ratios <= MOST_RATIO):.1%}, 95 % {np.quantile(ratios, 0.95):.2g}"
            + (f", smallest {least.ratio:.2g} ({least.problem}, {least.mesh})" if least else "")
        )
    silent = [row for row in rows if row.estimate and row.error is not None and row.ratio is None]
    silent = [row for row in silent if not row.other_minimum]
    most = max(silent, key=_relative_estimate, default=None)
    if most:
        yield (
            f"not compared: {len(silent)} answers, estimates at most {_relative_estimate(most):.1e} of the objective "
            f"({most.problem}, {most.mesh}), {sum(_relative_estimate(r) <= NEGLIGIBLE for r in silent)} of them at "
            f"most {NEGLIGIBLE:.0e}"
        )
    for what in ("miss", "violation"):
        found = [v for row in rows if (v := getattr(row, f"{what}_difference")) is not None]
        agreeing = sum(v <= AGREEMENT for v in found)
        yield f"{what}: {agreeing} of {len(found)} within {AGREEMENT:.0%} of SciPy, largest {max(found, default=0):.1e}"


def _relative_estimate(row: Row) -> float:
    """The estimate in shares of the objective, whose size is that of the error over the relative one."""
    return (row.estimate or 0.0) / row.size


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the rows and the shares."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.validation.accuracy")
    parser.add_argument("--quick", action="store_true", help=f"every {QUICK}th problem")
    parser.add_argument("--only", nargs="+", default=(), metavar="NAME")
    parser.add_argument(
        "--set", type=Path, default=engine.SET_FILE, metavar="FILE", help="default: %(default)s"
    )
    parser.add_argument("--limit", type=float, default=CPU_LIMIT_S, metavar="S", help="CPU time of a problem")
    parser.add_argument("--json", type=Path, metavar="OUT")
    given = parser.parse_args(arguments)
    chosen = [c for c in known_cases(given.set) if not given.only or c[0].name in given.only]
    rows: list[Row] = []
    print(HEADING)
    for case, value, error in chosen[:: QUICK if given.quick else 1]:
        with ProcessPoolExecutor(1) as pool:  # ends with the problem: a limit on CPU time kills it
            try:
                found = pool.submit(measure, case, value, error, given.set, given.limit).result()
            except BrokenProcessPool:
                found = [Row(case.label, "all", note="stopped at the limit of CPU time")]
        print(*found, sep="\n", flush=True)
        rows += found
        if given.json is not None:
            results = [{k: engine.finite(v) for k, v in asdict(row).items()} for row in rows]
            given.json.write_text(json.dumps({"rows": results}, indent=1) + "\n", encoding="utf-8")
    print(f"{len(chosen)} problems", *summary(rows), sep="\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
