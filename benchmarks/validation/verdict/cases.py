"""All cases: what is checked, what the truth is, and by how much a wrong answer is wrong."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
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
from benchmarks.validation.verdict.answers import SCALES, Case, Pair
from benchmarks.validation.verdict.correct_answers import NotRight, right
from benchmarks.validation.verdict.non_minimal_extremals import extremals
from benchmarks.validation.verdict.statements import (
    FAMILY,
    Frame,
    Statement,
    Trajectory,
    build,
    frames,
    in_frame,
)
from benchmarks.validation.verdict.thresholds import members
from benchmarks.validation.verdict.wrong_answers import LEAST, changes, forged, off_by

Result = Literal["failed", "passed", "inconclusive", "not planted", "not found", "crash"]


@dataclass(frozen=True)
class Outcome:
    """What the verdict said, and which conditions fail or are inconclusive; processor time with the solve.

    A result is "not planted" if the answer is off by too little to count, "not found" if the solver did not find the
    right answer, "crash" if the check ended in an error.
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


MODULES = (
    unconstrained,
    bounded_controls,
    end_and_integral_constraints,
    multi_phase,
    state_constraints,
    parameters_and_control_sets,
    degenerate,
)
"""Those with pairs."""


def cases(documents: Sequence[Mapping[str, Any]], seed: int) -> Iterator[Case]:
    """Yield every case; ``documents`` is a problem set, possibly empty."""
    for s in FAMILY:
        for k, planted in enumerate(changes(s)):
            framed, wrong = frames(s, seed), cache(planted.make)
            for frame in (framed[0], framed[1 + k % (len(framed) - 1)]):
                name = f"{s.name}, {frame.name}: {planted.why}"
                yield Case(
                    planted.kind, name, partial(_check_samples, s, wrong, frame), planted.why,
                    partial(_distance, s, wrong),
                )  # fmt: skip
    yield from extremals()
    yield from forged()
    for pair in (pair for module in MODULES for pair in module.PAIRS):
        for scale in SCALES:
            name = f"{pair.name}, unit {scale[0]:g}, cost {scale[1]:g}"
            wrong_one, right_one = (partial(_check_pair, pair, *scale, wrong) for wrong in (True, False))
            yield Case(pair.kind, name, wrong_one, pair.why, pair.off, pair.first_order)
            yield Case("right: closed forms", name, right_one)
    yield from members()
    yield from right(documents, seed)


def _check_samples(s: Statement, wrong: Callable[[], Trajectory], frame: Frame) -> go.Verdict:
    return go.verify_trajectory(build(s, frame), *in_frame(s, wrong(), frame))


def _distance(s: Statement, wrong: Callable[[], Trajectory]) -> float:
    return off_by(s, wrong())


def _check_pair(pair: Pair, unit: float, cost: float, wrong: bool) -> go.Verdict:
    return pair.make(unit, cost, wrong).check()


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
            verdict = case.check()
            off = case.off() if callable(case.off) else case.off
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
