"""Solve a set of optimal control problems from a JSON file, each at default settings, and tabulate the results.

    python -m benchmarks.validation.problem_set FILE.json [--only NAME ...] [--mesh 20x4 | --tol 1e-8]
                                                [--multistart] [--json OUT]

Every problem starts from its straight-line guess; nothing is tuned to a single one. A problem passes when it is
solved and its objective lies within ``accept_rel_tol`` of the reference (or beats it, if a search among local minima
found it and the verdict accepts it); an ill-posed one when it ends with the
report that its ``expect`` asks for. Failures are listed like the rest, and an exception in one problem does not
stop the others.
"""

from __future__ import annotations

import argparse
import json
import math
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

import gnc_opt as go
from benchmarks.validation.problem_set.reader import ExpressionError, build_problem, read_documents
from benchmarks.validation.problem_set.references import (
    closed_form_costate_error,
    costate_error_along,
    initial_costate_error,
    relative_error,
)

TOLERANCE = 1e-8
"""Of the refinement."""

STARTS = 12
"""Of a search."""

WALL_TIME = 600.0
"""Limit on solving and refining one problem, s."""

ACCEPT = 1e-5
"""Relative error of the objective that passes where the file gives none."""

INPUT_ERROR, CRASH = "input_error", "crash"

_SHORT = {
    "dynamics": "dyn", "limits": "lim", "boundary conditions": "ends", "cost": "cost", "stationarity": "stat",
    "active set": "act", "minimum principle": "min", "second order": "2nd", "switching times": "sw",
}  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """What became of one problem; written to the JSON output as it stands.

    Attributes
    ----------
    name : str
    reference : float or None
    objective : float or None
        None unless the problem was solved.
    relative_error : float or None
        Absolute where the reference is 0.
    status : str
        Of the solve, or "input_error" if gnc_opt or the reader refused the problem, or "crash".
    verdict_ok : bool or None
    seconds : float
        Build and solve, of the processor.
    passed : bool
    iterations : int or None
        Of the solver, in all passes of the refinement (which, where switch times are optimised, begin after the
        first solve).
    refinements : int or None
        Passes of the refinement that led to the solution.
    costate_error : float or None
        The largest of the three below.
    worst_costate_error : float or None
        At the start, against ``dJ_dx0``; see `benchmarks.validation.problem_set.references`.
    costate_error_along : float or None
        Mean over time against the reference trajectory.
    closed_form_costate_error : float or None
        Mean over time against closed forms.
    expect : str or None
        What an ill-posed problem should end with.
    failed, inconclusive : tuple of str
        Conditions of the verdict that fail, and that cannot be told.
    better : bool
        Whether a search has found a lower minimum than the reference, and the verdict accepts it.
    message : str
        Of the error, or of a solve without success.
    verify_seconds : float or None
    """

    name: str
    reference: float | None = None
    objective: float | None = None
    relative_error: float | None = None
    status: str = CRASH
    verdict_ok: bool | None = None
    seconds: float = 0.0
    passed: bool = False
    iterations: int | None = None
    refinements: int | None = None
    costate_error: float | None = None
    worst_costate_error: float | None = None
    costate_error_along: float | None = None
    closed_form_costate_error: float | None = None
    expect: str | None = None
    failed: tuple[str, ...] = ()
    inconclusive: tuple[str, ...] = ()
    better: bool = False
    message: str = ""
    verify_seconds: float | None = None


def run(
    document: Mapping[str, Any],
    solutions: Path,
    *,
    build: Callable[[Mapping[str, Any]], go.Problem] = build_problem,
    mesh: go.Mesh | str | None = None,
    scheme: str = "LG",
    tol: float | None = None,
    multistart: bool = False,
) -> tuple[Outcome, go.Solution | None]:
    """Build, solve, refine (on a given mesh: only to a given ``tol``), verify and compare one problem.

    Exceptions end in the outcome.
    """
    tol = TOLERANCE if tol is None and mesh is None else tol
    found: dict[str, Any] = {"name": str(document.get("name")), "expect": document.get("expect")}
    solution = None
    begin = time.process_time()
    try:
        found["reference"] = _reference(document)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", go.ProblemWarning)
            problem = build(document)
            if multistart and "local-minima" in _categories(document):
                solution = _best_of_many(problem, tol or TOLERANCE)
            else:
                solution = go.solve(
                    problem,
                    mesh=mesh,
                    scheme=scheme,  # type: ignore[arg-type]
                    tol=tol,
                    options=go.SolverOptions(max_wall_time=WALL_TIME),
                    throw=False,
                )
        found["seconds"] = time.process_time() - begin
        found |= _solved(document, solution, solutions)
    except (ExpressionError, go.GncOptError, KeyError) as error:
        message = f"the document lacks the key {error}." if type(error) is KeyError else str(error)
        found |= {"status": INPUT_ERROR if solution is None else CRASH, "message": message}
    except Exception as error:  # an exception in one problem must not stop the others
        found |= {"status": CRASH, "message": f"{type(error).__name__}: {error}"}
    found.setdefault("seconds", time.process_time() - begin)
    if multistart and "local-minima" in _categories(document):
        found["better"] = _is_better(document, found)
    outcome = Outcome(**found)
    passed = judge_ill_posed(document, outcome) if outcome.expect else _passed(document, outcome)
    return Outcome(**{**found, "passed": passed}), solution


def _reference(document: Mapping[str, Any]) -> float | None:
    value = document.get("reference")
    if value is None or (isinstance(value, (int, float)) and math.isfinite(value)):
        return value
    raise ExpressionError(f"the reference is {value!r}: give a finite number or null.")


def _is_better(document: Mapping[str, Any], found: Mapping[str, Any]) -> bool:
    """Whether a search has beaten the reference with a solution that the verdict accepts."""
    reference, objective = found.get("reference"), found.get("objective")
    if reference is None or objective is None or not found.get("verdict_ok"):
        return False
    if found["relative_error"] <= _accepted(document):
        return False  # the same minimum
    return bool(objective > reference if document.get("sense") == "max" else objective < reference)


def _categories(document: Mapping[str, Any]) -> set[str]:
    listed = document.get("category")
    return set(map(str, listed)) if isinstance(listed, list) else set()


def _best_of_many(problem: go.Problem, tol: float) -> go.Solution:
    """The best minimum that a short seeded search finds."""
    search = go.multistart(problem, n=STARTS, seed=1, tol=tol, executor="serial")
    best = search.best.solution
    return best if best.problem is not None else best.with_problem(problem)


def _solved(document: Mapping[str, Any], solution: go.Solution, solutions: Path) -> dict[str, Any]:
    found: dict[str, Any] = {"status": solution.status.value, **_effort(solution)}
    if not solution.status.solved:
        worst = [f"{v.name} (off by {v.amount:.2g})" for v in solution.violations[:1]]
        return found | {"message": "; ".join([solution.status.remedy, *worst])}
    found["objective"] = solution.objective
    if document.get("reference") is not None:
        found["relative_error"] = relative_error(solution.objective, document["reference"])
    begin = time.process_time()
    verdict = go.verify(solution)
    found["verify_seconds"] = time.process_time() - begin
    for key, result in (
        ("failed", go.ConditionResult.FAIL),
        ("inconclusive", go.ConditionResult.INCONCLUSIVE),
    ):
        found[key] = tuple(c.name for c in verdict.conditions if c.result is result)
    found["verdict_ok"] = verdict.ok
    errors = {
        "worst_costate_error": initial_costate_error(document, solution),
        "costate_error_along": costate_error_along(solutions / f"{document['name']}.json", solution),
        "closed_form_costate_error": closed_form_costate_error(document, solution),
    }
    worst_error = max((error for error in errors.values() if error is not None), default=None)
    return found | errors | {"costate_error": worst_error}


def _effort(solution: go.Solution) -> dict[str, int]:
    """Iterations of all solves, and passes of the refinement."""
    if solution.history is None:
        return {"iterations": solution.statistics.iterations, "refinements": 0}
    passes = solution.history.passes
    return {"iterations": sum(p.iterations for p in passes), "refinements": len(passes)}


def _passed(document: Mapping[str, Any], outcome: Outcome) -> bool:
    close = outcome.relative_error is not None and outcome.relative_error <= _accepted(document)
    return close or outcome.better


def _accepted(document: Mapping[str, Any]) -> float:
    accepted = document.get("accept_rel_tol")
    return accepted if isinstance(accepted, (int, float)) else ACCEPT


def judge_ill_posed(document: Mapping[str, Any], outcome: Outcome) -> bool:
    """Whether a problem that has no proper solution ended with the report that its sheet asks for.

    The categories of the sheet decide; its ``expect`` sentence is for people.
    """
    category = _categories(document)
    refused, solved = outcome.status == INPUT_ERROR, outcome.objective is not None
    if outcome.status == CRASH:
        return False
    if "input-error" in category:
        return refused and _names_the_culprit(outcome)
    if "nan" in category:
        return refused or outcome.status == go.Status.NOT_A_NUMBER.value
    if category & {"infeasible", "unbounded"}:
        return not solved
    if "not-attained" in category:
        return not solved or outcome.verdict_ok is False
    return _passed(document, outcome)


def _names_the_culprit(outcome: Outcome) -> bool:
    """Whether the message quotes the symbol that the sheet gives in parentheses, if it gives one."""
    expect = str(outcome.expect or "")
    symbol = expect.partition("(")[2].partition(")")[0]
    return not symbol.isidentifier() or f"'{symbol}'" in outcome.message


def table(outcomes: Iterable[Outcome]) -> Table:
    """Return the results as a rich table."""
    outcomes = list(outcomes)
    passed = sum(o.passed for o in outcomes)
    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False, title=f"{passed} of {len(outcomes)} problems pass")
    shown.add_column("problem", no_wrap=True)
    for heading in (
        "reference",
        "ours",
        "relative\nerror",
        "iter-\nations",
        "refine-\nments",
        "time\n(s)",
        "costate\nerror",
    ):
        shown.add_column(heading, justify="right", no_wrap=True)
    shown.add_column("verdict")
    shown.add_column("", no_wrap=True)
    for o in outcomes:
        shown.add_row(
            o.name,
            _number(o.reference, ".9g"),
            _number(o.objective, ".9g"),
            _number(o.relative_error, ".1e"),
            _number(o.iterations, "d"),
            _number(o.refinements, "d"),
            _number(o.seconds, ".2f"),
            _number(o.costate_error, ".0e"),
            _verdict(o),
            "[green]pass[/]" if o.passed else "[bold red]FAIL[/]",
        )
    return shown


def _verdict(outcome: Outcome) -> str:
    if outcome.objective is None:
        return outcome.status
    words = "ok" if outcome.verdict_ok else " ".join(_SHORT.get(name, name) for name in outcome.failed)
    prefix = "" if outcome.status == go.Status.OPTIMAL.value else f"{outcome.status}; "
    inconclusive = "".join(f" ?{_SHORT.get(name, name)}" for name in outcome.inconclusive)
    return prefix + (words or "-") + inconclusive + (" (better minimum)" if outcome.better else "")


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.validation.problem_set", description=__doc__.split("\n")[0]
    )
    parser.add_argument(
        "file", type=Path, help="problems in JSON; reference trajectories are looked for in solutions/"
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", help="solve these problems")
    parser.add_argument("--core", action="store_true", help="solve the problems marked as core")
    parser.add_argument("--mesh", help='e.g. "20x4": solve on it, without refinement')
    parser.add_argument("--tol", type=float, default=TOLERANCE, help="refine to this (default: %(default)g)")
    parser.add_argument(
        "--multistart", action="store_true", help="search, where the sheet says that there are local minima"
    )
    parser.add_argument("--scheme", default="LG", choices=("LG", "LGR", "LGL"))
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the outcomes to this file")
    return parser.parse_args(argv)


def _documents(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    documents = read_documents(arguments.file)
    for i, document in enumerate(documents, 1):
        document.setdefault("name", f"problem {i}")
    if arguments.only:
        unknown = set(arguments.only) - {d["name"] for d in documents}
        if unknown:
            raise ValueError(f"{arguments.file} has no problem named {', '.join(sorted(unknown))}.")
        documents = [d for d in documents if d["name"] in arguments.only]
    return [d for d in documents if d.get("core")] if arguments.core else documents


def _outcomes(console: Console, arguments: argparse.Namespace) -> Iterator[Outcome]:
    """Solve one problem after the other; a file that cannot be read is an outcome, too."""
    try:
        chosen = _documents(arguments)
    except (OSError, ValueError) as error:
        yield Outcome(arguments.file.name, status=INPUT_ERROR, message=str(error))
        return
    with console.status("") as status:
        for i, document in enumerate(chosen, 1):
            status.update(f"{i} of {len(chosen)}: {document['name']}")
            outcome, _ = run(
                document,
                arguments.file.parent / "solutions",
                mesh=arguments.mesh,
                scheme=arguments.scheme,
                tol=None if arguments.mesh else arguments.tol,
                multistart=arguments.multistart,
            )
            yield outcome


def _write(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Write the outcomes as JSON, which knows no infinite numbers: null stands for them."""
    told = [
        {key: None if isinstance(v, float) and not math.isfinite(v) else v for key, v in asdict(o).items()}
        for o in outcomes
    ]
    path.write_text(json.dumps(told, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the set; return 0 if every problem passes, else 1."""
    arguments = _arguments(argv)
    console = Console()
    if not console.is_terminal:
        console.width = max(console.width, 180)
    outcomes: list[Outcome] = []
    for outcome in _outcomes(console, arguments):
        outcomes.append(outcome)
        if arguments.json:  # after every problem: what is done survives whatever ends the run
            _write(arguments.json, outcomes)
    console.print(table(outcomes))
    for outcome in outcomes:
        if outcome.message:
            console.print(f"{outcome.name}: {outcome.message}", markup=False, highlight=False)
    return 0 if outcomes and all(o.passed for o in outcomes) else 1
