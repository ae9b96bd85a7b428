"""The benchmark of the verdict: how many answers it plants, how it counts, what it keeps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import gnc_opt as go
from benchmarks.verdict import command
from benchmarks.verdict.cases import Case, Outcome, cases, judged
from benchmarks.verdict.changes import changes, off_by
from benchmarks.verdict.extremals import great_circle
from benchmarks.verdict.statements import FAMILY, build, frames, in_frame, solved, trajectory

ENERGY = FAMILY[0]


def verdict(*results: go.Result, sufficient: bool = True) -> go.Verdict:
    conditions = [
        go.Condition(f"condition {i}", r, 0.0, 1e-5, "here", "It holds.") for i, r in enumerate(results)
    ]
    last = go.Condition(
        "last", go.Result.PASS if sufficient else go.Result.CANNOT_TELL, 0.0, 0.0, "here", "", True
    )
    return go.Verdict("p", (*conditions, last))


def test_enough_is_planted_and_every_name_is_used_once() -> None:
    listed = list(cases([], seed=0))
    assert sum(c.wrong for c in listed) >= 400 and sum(not c.wrong for c in listed) >= 100
    names = [(c.kind, c.name) for c in listed]
    assert len(set(names)) == len(names)


PASS, FAIL = go.Result.PASS, go.Result.FAIL


@pytest.mark.parametrize(
    ("wrong", "first_order", "off", "said", "word"),
    [
        (True, True, 0.1, verdict(PASS, FAIL), ""),
        (True, True, 0.1, verdict(PASS), "passed wrongly"),
        (True, True, 0.1, verdict(PASS, sufficient=False), "passed wrongly"),
        (True, False, 0.1, verdict(PASS, sufficient=False), "untold"),
        (True, False, 0.1, verdict(PASS), "passed wrongly"),
        (True, True, 1e-5, verdict(PASS), ""),
        (False, True, 0.0, verdict(PASS), ""),
        (False, True, 0.0, verdict(PASS, sufficient=False), "untold"),
        (False, True, 0.0, verdict(FAIL), "false alarm"),
    ],
)
def test_what_counts_as_what(wrong: bool, first_order: bool, off: float, said: go.Verdict, word: str) -> None:
    assert judged(Case("kind", "name", "why", wrong, first_order, lambda: (said, off))).word == word


def test_an_error_is_a_crash_of_this_case_alone() -> None:
    def crash() -> tuple[go.Verdict, float]:
        raise ValueError("lost")

    outcome = judged(Case("kind", "name", "why", True, True, crash))
    assert outcome.word == "crash" and "lost" in outcome.conditions[0]


def test_frames_change_the_numbers_and_not_the_flight() -> None:
    flown = trajectory(solved(ENERGY))
    for frame in frames(ENERGY, seed=0):
        t, x, u = in_frame(ENERGY, flown, frame)
        back = [frame.value(n, row) for n, row in zip(ENERGY.states, x, strict=True)]
        np.testing.assert_allclose(back, flown.x, rtol=1e-9, atol=1e-9)
        assert {c.name for c in go.verify_trajectory(build(ENERGY, frame), t, x, u, tol=1e-4).failed} == set()


def test_operators_plant_what_they_say() -> None:
    planted = {p.kind: p for p in changes(ENERGY)}
    wrong = planted["end missed"].make()
    assert wrong.x[0, -1] == pytest.approx(1.003) or wrong.x[1, -1] != 0
    assert off_by(ENERGY, wrong) > 1e-4
    assert off_by(ENERGY, trajectory(solved(ENERGY))) == 0


def test_run_writes_resumes_and_keeps_what_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[str] = []

    def judge(case: Case) -> Outcome:
        asked.append(case.name)
        if len(asked) == 3:
            raise KeyboardInterrupt
        return Outcome(case.kind, case.name, case.why, case.wrong, "failed", float("inf"), ("FAIL x",), 0.1)

    monkeypatch.setattr(command, "judged", judge)
    file = tmp_path / "out.json"
    assert command.main(["--class", "switch times", "--json", str(file)]) == 0
    assert len(json.loads(file.read_text())["outcomes"]) == 2
    assert "interrupted" in capsys.readouterr().out
    assert command.main(["--class", "switch times", "--json", str(file), "--resume"]) == 0
    listed = [c.name for c in cases([], 0) if c.kind == "switch times"]
    assert asked[3:] == listed[2:]
    assert [o["name"] for o in json.loads(file.read_text())["outcomes"]] == listed


def test_the_long_way_round_is_longer() -> None:
    """Its excess over the way across a pole, by the lengths themselves."""
    long = go.solve(great_circle(1.5 * np.pi), mesh="10x4", tol=None).objective
    assert long == pytest.approx(0.5 * (1.5 * np.pi) ** 2, rel=1e-6)
