"""Solve a problem of a JSON set at default settings and compare it with its reference.

Every problem starts from its straight-line guess; nothing is tuned to a single one. A problem passes when it is
solved and its objective lies within ``accept_rel_tol`` of the reference; an ill-posed one when it ends with the report
that its ``expect`` asks for.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
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
    """What became of one problem; only a problem that was solved has an objective.

    The status is that of the solve, "input_error" if gnc_opt or the reader refused the problem, or "crash"; the message
    is that of the error, or of a solve without success. ``expect``: what an ill-posed problem should end with.
    """

    reference: float | None = None
    objective: float | None = None
    status: str = CRASH
    verdict_ok: bool | None = None
    passed: bool = False
    expect: str | None = None
    message: str = ""


def run(
    document: Mapping[str, Any], *, mesh: go.Mesh | str | None = None, tol: float | None = None
) -> tuple[Outcome, go.Solution | None]:
    """Build, solve, refine (on a given mesh: only to a given ``tol``), verify and compare one problem.

    Exceptions end in the outcome.
    """
    tol = TOLERANCE if tol is None and mesh is None else tol
    found: dict[str, Any] = {"expect": document.get("expect")}
    solution = None
    try:
        found["reference"] = _reference(document)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", go.ProblemWarning)
            options = go.SolverOptions(max_wall_time=WALL_TIME)
            problem = build_problem(document)
            solution = go.solve(problem, mesh=mesh, tol=tol, options=options, throw=False)
        found["status"] = solution.status.value
        if solution.status.solved:
            found |= {"objective": solution.objective, "verdict_ok": go.verify(solution).ok}
        else:
            worst = [f"{v.name} (off by {v.amount:.2g})" for v in solution.violations[:1]]
            found["message"] = "; ".join([solution.status.remedy, *worst])
    except (ExpressionError, go.GncOptError, KeyError) as error:
        message = f"the document lacks the key {error}." if type(error) is KeyError else str(error)
        found |= {"status": INPUT_ERROR if solution is None else CRASH, "message": message}
    except Exception as error:  # an exception in one problem must not stop the others
        found |= {"status": CRASH, "message": f"{type(error).__name__}: {error}"}
    outcome = Outcome(**found)
    passed = is_expected_report(document, outcome) if outcome.expect else _passed(document, outcome)
    return replace(outcome, passed=passed), solution


def _reference(document: Mapping[str, Any]) -> float | None:
    value = document.get("reference")
    if value is None or (isinstance(value, (int, float)) and math.isfinite(value)):
        return value
    raise ExpressionError(f"the reference is {value!r}: give a finite number or null.")


def _passed(document: Mapping[str, Any], outcome: Outcome) -> bool:
    if outcome.objective is None or outcome.reference is None:
        return False
    accepted = document.get("accept_rel_tol", ACCEPT) * (abs(outcome.reference) or 1.0)
    return bool(abs(outcome.objective - outcome.reference) <= accepted)


def is_expected_report(document: Mapping[str, Any], outcome: Outcome) -> bool:
    """Whether a problem that has no proper solution ended with the report that its sheet asks for.

    The categories of the sheet decide; its ``expect`` sentence is for people.
    """
    listed = document.get("category")
    category = set(map(str, listed)) if isinstance(listed, list) else set()
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
