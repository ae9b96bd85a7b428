"""Solve a problem of a JSON set at default settings and compare it with its reference.

Every problem starts from its straight-line guess; nothing is tuned to a single one. A problem passes when it is
solved and its objective lies within ``accept_rel_tol`` of the reference; an ill-posed one when it ends with the report
that its ``expect`` asks for.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import gnc_opt as go
from benchmarks.validation.problem_set.reader import ExpressionError, build_problem

TOLERANCE = 1e-8
"""Of the refinement."""

WALL_TIME = 600.0
"""Limit on solving and refining one problem, s."""

ACCEPT = 1e-5
"""Relative error of the objective that passes where the file gives none."""

INPUT_ERROR, CRASH = "input_error", "crash"


@dataclass(frozen=True)
class Outcome:
    """What became of one problem.

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
    passed : bool
    iterations : int or None
        Of the solver, in all passes of the refinement (which, where switch times are optimised, begin after the
        first solve).
    refinements : int or None
        Passes of the refinement that led to the solution.
    expect : str or None
        What an ill-posed problem should end with.
    failed, inconclusive : tuple of str
        Conditions of the verdict that fail, and that are inconclusive.
    message : str
        Of the error, or of a solve without success.
    """

    name: str
    reference: float | None = None
    objective: float | None = None
    relative_error: float | None = None
    status: str = CRASH
    verdict_ok: bool | None = None
    passed: bool = False
    iterations: int | None = None
    refinements: int | None = None
    expect: str | None = None
    failed: tuple[str, ...] = ()
    inconclusive: tuple[str, ...] = ()
    message: str = ""


def run(
    document: Mapping[str, Any],
    *,
    build: Callable[[Mapping[str, Any]], go.Problem] = build_problem,
    mesh: go.Mesh | str | None = None,
    tol: float | None = None,
) -> tuple[Outcome, go.Solution | None]:
    """Build, solve, refine (on a given mesh: only to a given ``tol``), verify and compare one problem.

    Exceptions end in the outcome.
    """
    tol = TOLERANCE if tol is None and mesh is None else tol
    found: dict[str, Any] = {"name": str(document.get("name")), "expect": document.get("expect")}
    solution = None
    try:
        found["reference"] = _reference(document)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", go.ProblemWarning)
            problem = build(document)
            options = go.SolverOptions(max_wall_time=WALL_TIME)
            solution = go.solve(problem, mesh=mesh, tol=tol, options=options, throw=False)
        found |= _solved(document, solution)
    except (ExpressionError, go.GncOptError, KeyError) as error:
        message = f"the document lacks the key {error}." if type(error) is KeyError else str(error)
        found |= {"status": INPUT_ERROR if solution is None else CRASH, "message": message}
    except Exception as error:  # an exception in one problem must not stop the others
        found |= {"status": CRASH, "message": f"{type(error).__name__}: {error}"}
    outcome = Outcome(**found)
    passed = is_expected_report(document, outcome) if outcome.expect else _passed(document, outcome)
    return Outcome(**{**found, "passed": passed}), solution


def _reference(document: Mapping[str, Any]) -> float | None:
    value = document.get("reference")
    if value is None or (isinstance(value, (int, float)) and math.isfinite(value)):
        return value
    raise ExpressionError(f"the reference is {value!r}: give a finite number or null.")


def _categories(document: Mapping[str, Any]) -> set[str]:
    listed = document.get("category")
    return set(map(str, listed)) if isinstance(listed, list) else set()


def _solved(document: Mapping[str, Any], solution: go.Solution) -> dict[str, Any]:
    found: dict[str, Any] = {"status": solution.status.value, **_effort(solution)}
    if not solution.status.solved:
        worst = [f"{v.name} (off by {v.amount:.2g})" for v in solution.violations[:1]]
        return found | {"message": "; ".join([solution.status.remedy, *worst])}
    found["objective"] = solution.objective
    if document.get("reference") is not None:
        found["relative_error"] = abs(solution.objective - document["reference"]) / (
            abs(document["reference"]) or 1.0
        )
    verdict = go.verify(solution)
    for key, result in (
        ("failed", go.ConditionResult.FAIL),
        ("inconclusive", go.ConditionResult.INCONCLUSIVE),
    ):
        found[key] = tuple(c.name for c in verdict.conditions if c.result is result)
    found["verdict_ok"] = verdict.ok
    return found


def _effort(solution: go.Solution) -> dict[str, int]:
    """Iterations of all solves, and passes of the refinement."""
    if solution.history is None:
        return {"iterations": solution.statistics.iterations, "refinements": 0}
    passes = solution.history.passes
    return {"iterations": sum(p.iterations for p in passes), "refinements": len(passes)}


def _passed(document: Mapping[str, Any], outcome: Outcome) -> bool:
    accepted = document.get("accept_rel_tol", ACCEPT)
    return outcome.relative_error is not None and outcome.relative_error <= accepted


def is_expected_report(document: Mapping[str, Any], outcome: Outcome) -> bool:
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
