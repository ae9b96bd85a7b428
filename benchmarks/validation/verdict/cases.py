"""All cases: what is checked, what the truth is, and by how much a wrong answer is wrong."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import gnc_opt as go
from benchmarks.validation.verdict import (
    bounded_controls,
    degenerate,
    end_and_integral_constraints,
    multi_phase,
    parameters_and_control_sets,
    state_constraints,
    unconstrained,
)
from benchmarks.validation.verdict.answers import SCALES, Pair
from benchmarks.validation.verdict.correct_answers import NotRight, right
from benchmarks.validation.verdict.non_minimal_extremals import extremals
from benchmarks.validation.verdict.statements import FAMILY, Frame, Statement, build, frames, in_frame
from benchmarks.validation.verdict.thresholds import members
from benchmarks.validation.verdict.wrong_answers import LEAST, Planted, changes, forged, off_by

Result = Literal["failed", "passed", "inconclusive", "not planted", "not found", "crash"]


@dataclass(frozen=True)
class Case:
    """One answer to check.

    Attributes
    ----------
    kind, name, why : str
    wrong : bool
    first_order : bool
        Of a wrong one: whether necessary conditions of the first order fail. Where only sufficient ones do, a
        verdict that claims no more than the former is inconclusive, not a wrong pass.
    check : callable
        () -> (Verdict, by how much the answer is wrong).
    """

    kind: str
    name: str
    why: str
    wrong: bool
    first_order: bool
    check: Callable[[], tuple[go.Verdict, float]]


@dataclass(frozen=True)
class Outcome:
    """What the verdict said.

    Attributes
    ----------
    kind, name, why : str
    wrong : bool
    result : str
        "failed", "passed", "inconclusive"; "not planted" if the answer is off by too little to count, "not found" if
        the solver did not find the right answer, "crash" if the check ended in an error.
    off : float or None
    conditions : tuple of str
        Those that fail ("FAIL name value at place") or are inconclusive ("? name at place").
    seconds : float
        Processor time, the solve included.
    """

    kind: str
    name: str
    why: str
    wrong: bool
    result: Result
    off: float | None
    conditions: tuple[str, ...]
    seconds: float

    @property
    def word(self) -> str:
        """What is amiss: "passed wrongly", "false alarm", "inconclusive", "crash"; or nothing."""
        if self.result in ("inconclusive", "crash"):
            return self.result
        if self.wrong:
            return "passed wrongly" if self.result == "passed" else ""
        return "false alarm" if self.result == "failed" else ""

    def plain(self) -> dict[str, Any]:
        """As JSON values."""
        return asdict(self) | {"word": self.word}


def closed_form_pairs() -> Iterator[Pair]:
    """Yield a right answer and a wrong one of every closed form."""
    for module in (
        unconstrained,
        bounded_controls,
        end_and_integral_constraints,
        multi_phase,
        state_constraints,
        parameters_and_control_sets,
        degenerate,
    ):
        yield from module.PAIRS


def cases(documents: Sequence[Mapping[str, Any]], seed: int) -> Iterator[Case]:
    """Yield every case."""
    for s in FAMILY:
        for k, planted in enumerate(changes(s)):
            framed = frames(s, seed)
            for frame in (framed[0], framed[1 + k % (len(framed) - 1)]):
                name = f"{s.name}, {frame.name}: {planted.why}"
                yield Case(planted.kind, name, planted.why, True, True, _sampled(s, planted, frame))
    for e in extremals():
        yield Case(e.kind, e.name, e.why, True, e.first_order, lambda e=e: (e.check(), e.off))
    for f in forged():
        yield Case("forged file", f.name, f.why, True, True, lambda f=f: (f.check(), f.off))
    for pair in closed_form_pairs():
        for scale in SCALES:
            name = f"{pair.name}, unit {scale[0]:g}, cost {scale[1]:g}"
            yield Case(pair.kind, name, pair.why, True, pair.first_order, _paired(pair, scale, True))
            yield Case("right: closed forms", name, "", False, True, _paired(pair, scale, False))
    for m in members():
        kind = "beyond a threshold" if m.wrong else "right: before a threshold"
        yield Case(
            kind, m.name, m.why, m.wrong, m.first_order, lambda m=m: (m.check(), 1.0 if m.wrong else 0.0)
        )
    for r in right(documents, seed):
        yield Case(f"right: {r.kind}", r.name, "", False, True, lambda r=r: (r.check(), 0.0))


def _sampled(s: Statement, planted: Planted, frame: Frame) -> Callable[[], tuple[go.Verdict, float]]:
    def check() -> tuple[go.Verdict, float]:
        wrong = planted.make()
        off = off_by(s, wrong)
        return go.verify_trajectory(build(s, frame), *in_frame(s, wrong, frame)), off

    return check


def _paired(pair: Pair, scale: tuple[float, float], wrong: bool) -> Callable[[], tuple[go.Verdict, float]]:
    return lambda: (pair.make(*scale, wrong).check(), pair.off if wrong else 0.0)


def check_case(case: Case) -> Outcome:
    """Return what the verdict says about a case; errors end in the outcome."""
    begin = time.process_time()

    def outcome(result: Result, off: float | None, conditions: tuple[str, ...]) -> Outcome:
        return Outcome(
            case.kind, case.name, case.why, case.wrong, result, off, conditions, time.process_time() - begin
        )

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            verdict, off = case.check()
    except NotRight as error:
        return outcome("not found", None, (str(error),))
    except go.SolveError as error:
        return outcome("not found", None, (str(error).partition("\n")[0],))
    except Exception as error:  # one case must not stop the others
        return outcome("crash", None, (f"{type(error).__name__}: {error}",))
    if case.wrong and not off >= LEAST:
        return outcome("not planted", off, ())
    return outcome(_result_of(case, verdict), off, _conditions(verdict))


def _result_of(case: Case, verdict: go.Verdict) -> Result:
    if verdict.failed:
        return "failed"
    if case.wrong:
        if not verdict.ok:
            return "failed" if verdict.not_checked else "inconclusive"  # it claims nothing
        return "passed" if verdict.minimum or case.first_order else "inconclusive"
    return "passed" if verdict.minimum else "inconclusive"


def _conditions(verdict: go.Verdict) -> tuple[str, ...]:
    failed = [f"FAIL {c.name} {c.value:.1e} at {c.where}" for c in verdict.failed]
    return (*failed, *(f"? {c.name} at {c.where}" for c in verdict.inconclusive))
