"""Validate the solver on every problem with a known optimum.

    python -m benchmarks.validation.engine [--groups set gallery ...] [--only NAME ...] [--json OUT]
        [--compare FORMER.json] [--set FILE] [--limit CPU_S] [--pictures FOLDER]

Groups: ``set``, the problems of a JSON file with references (default ``../shared/ocp/problems.json``); ``gallery``,
the files and systems of ``problems/`` that the solver was developed with; ``rendezvous``, the ten published rendezvous;
``flagship``, 26 published problems with references by an independent program; ``further``, all other files of
``problems/``. Each problem is solved by the default call from its own guess and checked, on one thread, within a limit
of CPU time. Imports are not counted.

A row shows whether the objective is right (within the tolerance of the reference), ``ok`` and ``minimum`` of the
optimality check, CPU seconds, the relative error of the objective and its tolerance, the estimated over the true error
of the objective (if the solution has an estimate), and the stage of the solver that returned the answer. ``--pictures``
draws each solution for the page of examples (``docs/pictures``).
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import multiprocessing
import resource
import statistics
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import gnc_opt as go
from benchmarks.validation.problem_set import solve as problem_set
from benchmarks.validation.problem_set.reader import read_documents
from benchmarks.validation.verdict.answers import cart
from gnc_opt.problem_files_and_examples import Example, find_example, list_examples
from problems._example import Reference
from website import thumbnails

SET_FILE = Path("../shared/ocp/problems.json")
"""Default file of the problem set."""

GROUPS = ("set", "gallery", "rendezvous", "flagship", "further")

TOLERANCES = {"set": 1e-8, "gallery": 1e-8, "rendezvous": 1e-8, "flagship": 1e-6, "further": 1e-6}
"""Tolerance of the solve by group."""

CPU_LIMIT_S = 200.0
"""CPU time after which a problem is given up."""

SLOW_CPU_S = 15.0
"""Problems that take longer are counted."""

KNOWN_SHARE_OF_TOLERANCE = 0.1
"""True errors below this share of the tolerance of the reference are not compared with estimates."""

_MEMBERS: dict[str, list[str]] = json.loads(
    Path(__file__).with_name("engine_groups.json").read_text(encoding="utf-8")
)
"""Names of the files of the groups "gallery" and "flagship"."""


@dataclass(frozen=True)
class Case:
    """A problem to solve: its group, its name, and the variant (a case number or a key of ``VARIANTS``) or ""."""

    group: str
    name: str
    variant: str = ""

    @property
    def label(self) -> str:
        """Name and variant."""
        return f"{self.name} ({self.variant})" if self.variant else self.name


@dataclass(frozen=True)
class Row:
    """What became of one problem.

    ``right``: the objective is within the absolute tolerance of the reference (of an ill-posed problem: the report is
    the expected one). ``ok`` and ``minimum`` are those of the optimality check, ``estimated`` and ``true`` absolute
    errors of the objective. The note has failed conditions, or why there is no solution.
    """

    group: str
    problem: str
    right: bool = False
    ok: bool = False
    minimum: bool = False
    cpu_s: float = 0.0
    objective: float | None = None
    reference: float | None = None
    tolerance: float | None = None
    estimated: float | None = None
    true: float | None = None
    stage: str = ""
    note: str = ""

    @property
    def relative_error(self) -> float | None:
        """Distance from the reference, relative unless the reference is zero."""
        if self.true is None or self.reference is None:
            return None
        return self.true / (abs(self.reference) or 1.0)

    @property
    def estimate_ratio(self) -> float | None:
        """Estimated over true error, None where the tolerance of the reference hides the true one."""
        if self.estimated is None or self.true is None or self.tolerance is None:
            return None
        if self.true <= KNOWN_SHARE_OF_TOLERANCE * self.tolerance:
            return None
        return self.estimated / self.true

    def __str__(self) -> str:
        marks = "".join(
            letter if holds else "-"
            for letter, holds in (("R", self.right), ("O", self.ok), ("M", self.minimum))
        )
        tolerance = None if self.tolerance is None else self.tolerance / (abs(self.reference or 0.0) or 1.0)
        return (
            f"{self.group:10} {self.problem:44} {marks:4} {self.cpu_s:7.2f} {_shown(self.objective, '.13g'):>18} "
            f"{_shown(self.relative_error, '.1e'):>8} {_shown(tolerance, '.0e'):>6} "
            f"{_shown(self.estimate_ratio, '.1e'):>8}  {self.stage:24} {self.note}"
        ).rstrip()


HEADING = (
    f"{'group':10} {'problem':44} {'ROM':4} {'CPU s':>7} {'objective':>18} {'error':>8} {'tol.':>6} "
    f"{'est/true':>8}  {'returned by':24}"
)


def _shown(value: float | None, form: str) -> str:
    return "-" if value is None or math.isnan(value) else format(value, form)


# --- what is solved -------------------------------------------------------------------------------------


def cases(groups: Sequence[str], names: Sequence[str], set_file: Path) -> list[Case]:
    """Return the cases of these groups; only those of the given names if there are any."""
    found = [case for group in GROUPS if group in groups for case in _cases_of(group, set_file)]
    return [case for case in found if not names or case.name in names or case.label in names]


def _cases_of(group: str, set_file: Path) -> Iterator[Case]:
    if group == "set":
        if set_file.is_file():
            yield from (Case(group, str(document["name"])) for document in read_documents(set_file))
        else:
            print(f"{set_file} does not exist, so the problem set is left out: give its place with --set.")
        return
    if group == "rendezvous":
        references = importlib.import_module("problems.rendezvous").REFERENCE
        yield from (Case(group, "rendezvous", f"{case} {equation}") for case, equation in references)
        return
    for each in list_examples():
        if group_of(each) == group:
            module = each.module
            if hasattr(module, "build"):
                yield from (Case(group, each.name, v) for v in ("", *getattr(module, "VARIANTS", {})))


def group_of(problem: Example) -> str:
    """Return the group of a problem file or a system."""
    if problem.is_package:
        return "gallery"
    return next((group for group, names in _MEMBERS.items() if problem.name in names), "further")


# --- one problem ----------------------------------------------------------------------------------------


def measure(case: Case, set_file: Path, limit_s: float, pictures: Path | None = None) -> Row:
    """Solve and check one problem; the process is killed by the system at the limit of CPU time."""
    warnings.simplefilter("ignore")
    begin = time.process_time()
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(begin + limit_s), hard))
    row = Row(case.group, case.label)
    try:
        if case.group == "set":
            return _from_set(row, case, set_file, begin)
        problem, reference = stated(case)
        if reference is not None:
            row = replace(row, reference=reference.value, tolerance=reference.tolerance)
        solution = go.solve(problem, tol=TOLERANCES[case.group], throw=False)
        row = _checked(row, solution, begin)
        if pictures is not None and not case.variant:
            thumbnails.save(case.name, solution, pictures)
        return row
    except Exception as error:  # an exception in one problem must not stop the others
        cpu_s = time.process_time() - begin
        return replace(row, cpu_s=cpu_s, note=f"{type(error).__name__}: {error}".split("\n")[0])


def stated(case: Case) -> tuple[go.Problem, Reference | None]:
    if case.group == "rendezvous":
        module = importlib.import_module("problems.rendezvous")
        number, equation = case.variant.split()
        reference = module.REFERENCE[int(number), equation]["exact"]
        return module.build(int(number), equation), reference
    module = find_example(case.name).module
    options, reference = (
        module.VARIANTS[case.variant] if case.variant else ({}, getattr(module, "REFERENCE", None))
    )
    return module.build(**options), reference if isinstance(reference, Reference) else None


def _checked(row: Row, solution: go.Solution, begin: float) -> Row:
    """Return the row of a solution, after its optimality check."""
    if not solution.status.solved:
        cpu_s = time.process_time() - begin
        return replace(row, cpu_s=cpu_s, objective=solution.objective, note=solution.status.value)
    verdict = go.verify(solution)
    row = replace(
        row,
        cpu_s=time.process_time() - begin,
        objective=solution.objective,
        ok=verdict.ok,
        minimum=verdict.minimum,
        estimated=estimated_error(solution),
        stage=stage(solution),
        note="; ".join(f"{c.name} {c.value:.1e}" for c in verdict.failed),
    )
    if row.reference is None or row.tolerance is None:
        return row
    true = abs(solution.objective - row.reference)
    return replace(row, true=true, right=true <= row.tolerance)


def _from_set(row: Row, case: Case, set_file: Path, begin: float) -> Row:
    """Solve a problem of the set; what it counts as right is decided by `benchmarks.validation.problem_set`."""
    document = next(d for d in read_documents(set_file) if d["name"] == case.name)
    outcome, solution = problem_set.run(document, tol=TOLERANCES["set"])
    reference = outcome.reference
    if reference is not None and not outcome.expect:
        accepted = document.get("accept_rel_tol", problem_set.ACCEPT)
        row = replace(row, reference=reference, tolerance=accepted * (abs(reference) or 1.0))
    if solution is None or outcome.expect:
        cpu_s = time.process_time() - begin
        note = f"ill-posed, reported as {outcome.status}" if outcome.expect else outcome.message
        return replace(row, cpu_s=cpu_s, right=outcome.passed, objective=outcome.objective, note=note)
    row = _checked(row, solution, begin)
    return replace(row, right=outcome.passed)


def estimated_error(solution: go.Solution) -> float | None:
    """Return the solution's own estimate of the error of its objective, in its unit, or None if it has none."""
    error = getattr(solution, "objective_error", None)
    return float(error.value) if hasattr(error, "value") else None


def stage(solution: go.Solution) -> str:
    """Return which stage of the solver returned the answer, or the place of its mesh among all that were solved."""
    named = solution.provenance.get("stage") or getattr(solution.history, "stage", None)
    if named:
        return str(named)
    history = solution.history
    if history is None:
        return "first solve"
    structured = "arcs" if solution.structure else "mesh"
    return f"{structured} {history.chosen + 1} of {len(history.passes)}, {history.status.value}"


def warm_up() -> None:
    """Solve a small problem, so that later times contain no imports."""
    problem, leg, _, _ = cart(1.0, (0.0, (0.5, 10.0)), end=(1.0, 0.0))
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    go.verify(go.solve(problem))


# --- all problems ---------------------------------------------------------------------------------------


def run(
    chosen: Sequence[Case],
    set_file: Path,
    limits_s: float | Sequence[float],
    solve: Callable[[Case, Path, float], Row] = measure,
) -> Iterator[Row]:
    """Yield the row of every case; a group shares a process, which is replaced if a limit (s) has ended it."""
    context = multiprocessing.get_context("spawn")
    pool, group = None, ""
    limits = [limits_s] * len(chosen) if isinstance(limits_s, (int, float)) else limits_s
    for case, limit_s in zip(chosen, limits, strict=True):
        if pool is None or case.group != group:
            if pool is not None:
                pool.shutdown()
            pool, group = ProcessPoolExecutor(1, context, initializer=warm_up), case.group
        try:
            yield pool.submit(solve, case, set_file, limit_s).result()
        except BrokenProcessPool:
            pool.shutdown()
            pool = None
            yield Row(case.group, case.label, cpu_s=limit_s, note="stopped at the limit of CPU time")
    if pool is not None:
        pool.shutdown()


def sums(rows: Sequence[Row]) -> Iterator[str]:
    """Yield a line per group: how many are right, ok, minima, slow, the CPU time, quantiles of the estimate."""
    for group in (*GROUPS, "all"):
        some = [row for row in rows if group in (row.group, "all")]
        if not some:
            continue
        right_and_ok = sum(row.right and row.ok for row in some)
        wrong_and_ok = sum(row.ok and row.reference is not None and not row.right for row in some)
        slow = sum(row.cpu_s > SLOW_CPU_S for row in some)
        cpu = [row.cpu_s for row in some]
        line = (
            f"{group:10} {len(some):3} problems: {sum(row.right for row in some)} right, {right_and_ok} right and ok, "
            f"{sum(row.ok for row in some)} ok, {sum(row.minimum for row in some)} minima, "
            f"{wrong_and_ok} wrong and ok; CPU {sum(cpu):.1f} s, median {statistics.median(cpu):.2f} s, "
            f"{slow} over {SLOW_CPU_S:g} s"
        )
        ratios = sorted(row.estimate_ratio for row in some if row.estimate_ratio is not None)
        if ratios:
            quantiles = ", ".join(
                f"{name} {ratios[min(int(share * len(ratios)), len(ratios) - 1)]:.2g}"
                for name, share in (("5 %", 0.05), ("median", 0.5), ("95 %", 0.95))
            )
            line += f"; estimated over true error: {quantiles}"
        yield line


def changes(rows: Sequence[Row], former: Sequence[Row]) -> Iterator[str]:
    """Yield what was gained and lost since an earlier run, larger errors, and the ratio of CPU times."""
    before = {(row.group, row.problem): row for row in former}
    pairs = [(before[row.group, row.problem], row) for row in rows if (row.group, row.problem) in before]
    for name in ("right", "ok", "minimum"):
        for word, old_value in (("lost", True), ("gained", False)):
            found = [
                new.problem
                for old, new in pairs
                if getattr(old, name) is old_value and getattr(new, name) is not old_value
            ]
            if found:
                yield f"{word} {name}: {', '.join(found)}"
    for old, new in pairs:
        if old.objective is None or new.objective is None or not (old.right and new.right):
            continue
        change = (new.objective - old.objective) / max(1.0, abs(old.objective))
        if abs(change) > 1e-9:
            yield (
                f"objective of {new.problem} changed by {change:+.1e} (relative error before "
                f"{_shown(old.relative_error, '.1e')}, now {_shown(new.relative_error, '.1e')})"
            )
    for group in (*GROUPS, "all"):
        some = [(old.cpu_s, new.cpu_s) for old, new in pairs if group in (new.group, "all")]
        if some:
            old_sum, new_sum = (sum(times) for times in zip(*some, strict=True))
            yield f"CPU {group}: {old_sum:.1f} s before, {new_sum:.1f} s now, ratio {new_sum / old_sum:.2f}"


def read_rows(path: Path) -> list[Row]:
    """Read the rows that `write_rows` has written."""
    rows = json.loads(path.read_text(encoding="utf-8"))["rows"]
    return [Row(**{key: value for key, value in row.items() if key != "costate_error"}) for row in rows]


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write the rows as JSON; null stands for numbers that are not finite."""
    results = [{key: finite(value) for key, value in asdict(row).items()} for row in rows]
    text = json.dumps({"rows": results}, indent=1, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.validation.engine", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--groups", nargs="+", choices=GROUPS, default=GROUPS, metavar="GROUP")
    parser.add_argument("--only", nargs="+", default=(), metavar="NAME", help="solve these problems")
    parser.add_argument("--set", type=Path, default=SET_FILE, metavar="FILE", help="default: %(default)s")
    parser.add_argument(
        "--limit", type=float, default=CPU_LIMIT_S, metavar="S", help="CPU time of a problem (%(default)s)"
    )
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the rows to this file")
    parser.add_argument(
        "--pictures", type=Path, metavar="FOLDER", help="write a small picture of each solution"
    )
    parser.add_argument("--compare", type=Path, metavar="FILE", help="compare with a file written by --json")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the rows, sums per group and changes; return 1 if an answer is ok and wrong."""
    given = _parser().parse_args(arguments)
    former = [] if given.compare is None else read_rows(given.compare)
    print(HEADING)
    rows: list[Row] = []
    solve = partial(measure, pictures=given.pictures)
    for row in run(cases(given.groups, given.only, given.set), given.set, given.limit, solve):
        rows.append(row)
        print(row, flush=True)
        if given.json is not None:  # after every problem: an interrupted run leaves what is done
            write_rows(given.json, rows)
    print(*sums(rows), *changes(rows, former), sep="\n")
    return int(any(row.ok and row.reference is not None and not row.right for row in rows))


if __name__ == "__main__":
    raise SystemExit(main())
