"""The benchmark of the verdict: how many answers it plants, how it counts, what it keeps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gnc_opt as go
from benchmarks.validation.verdict import __main__ as command
from benchmarks.validation.verdict.answers import Pair
from benchmarks.validation.verdict.cases import Case, Outcome, cases, closed_form_pairs, judged
from benchmarks.validation.verdict.non_minimal_extremals import great_circle
from benchmarks.validation.verdict.statements import FAMILY, build, frames, in_frame, solved, trajectory
from benchmarks.validation.verdict.wrong_answers import changes, off_by

ENERGY = FAMILY[0]


def verdict(*results: go.ConditionResult, sufficient: bool = True) -> go.Verdict:
    conditions = [
        go.Condition(f"condition {i}", r, 0.0, 1e-5, "here", "It holds.") for i, r in enumerate(results)
    ]
    last = go.Condition(
        "last",
        go.ConditionResult.PASS if sufficient else go.ConditionResult.INCONCLUSIVE,
        0.0,
        0.0,
        "here",
        "",
        True,
    )
    return go.Verdict("p", (*conditions, last))


def test_enough_is_planted_and_every_name_is_used_once() -> None:
    listed = list(cases([], seed=0))
    assert sum(c.wrong for c in listed) >= 400 and sum(not c.wrong for c in listed) >= 100
    names = [(c.kind, c.name) for c in listed]
    assert len(set(names)) == len(names)


PASS, FAIL = go.ConditionResult.PASS, go.ConditionResult.FAIL


@pytest.mark.parametrize(
    ("wrong", "first_order", "off", "said", "word"),
    [
        (True, True, 0.1, verdict(PASS, FAIL), ""),
        (True, True, 0.1, verdict(PASS), "passed wrongly"),
        (True, True, 0.1, verdict(PASS, sufficient=False), "passed wrongly"),
        (True, False, 0.1, verdict(PASS, sufficient=False), "inconclusive"),
        (True, False, 0.1, verdict(PASS), "passed wrongly"),
        (True, True, 1e-5, verdict(PASS), ""),
        (False, True, 0.0, verdict(PASS), ""),
        (False, True, 0.0, verdict(PASS, sufficient=False), "inconclusive"),
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


ROOT = Path(__file__).parents[2]


def outcome(kind: str, told: Any, wrong: bool = True) -> Outcome:
    return Outcome(kind, f"{kind} {told}", "why", wrong, told, 0.1, (), 0.1)


def test_classes_are_counted_and_shown(tmp_path: Path) -> None:
    told = [outcome("a", t) for t in ("failed", "failed", "passed", "not found", "crash")]
    told += [outcome("right: b", t, wrong=False) for t in ("passed", "failed", "inconclusive")]
    rows = command.count(told)
    assert [rows["a"][c] for c in ("planted", "failed", "passed wrongly", "crash", "not found")] == [
        4,
        2,
        1,
        1,
        1,
    ]
    assert [rows["right: b"][c] for c in ("planted", "failed", "false alarm", "inconclusive")] == [3, 0, 1, 1]
    assert rows["all wrong ones"] == rows["a"] and rows["all right ones"] == rows["right: b"]
    page, numbers = tmp_path / "page.md", tmp_path / "numbers.json"
    place = "<!-- table of benchmarks.validation.verdict -->\nstale\n<!-- end of the table -->"
    page.write_text(f"before\n{place}\nafter\n")
    for _ in range(2):  # again, it replaces the table
        command.write_page(rows, page, numbers)
    text = page.read_text()
    assert "| a | 4 | 2 | 1 |  |  | 1 |  | 1 |\n" in text and "stale" not in text
    assert text.startswith("before\n") and text.endswith("<!-- end of the table -->\nafter\n")
    assert json.loads(numbers.read_text()) == rows
    page.write_text("no place")
    with pytest.raises(ValueError, match="no place for the table"):
        command.write_page(rows, page, numbers)


def test_the_page_shows_the_numbers_of_the_last_run_and_nothing_passed_wrongly() -> None:
    rows = json.loads(command.NUMBERS.read_text(encoding="utf-8"))
    assert command.markdown(rows) in (ROOT / "docs" / "verdict.md").read_text(encoding="utf-8")
    assert rows["all wrong ones"]["planted"] >= 400 and rows["all right ones"]["planted"] >= 100
    assert rows["all wrong ones"]["passed wrongly"] == rows["all wrong ones"]["crash"] == 0
    planned = {c.kind for c in cases([], seed=0)}
    assert set(rows) - {"all wrong ones", "all right ones", "right: problem set"} == planned


@pytest.mark.parametrize(
    "pair", [p for p in closed_form_pairs() if p.name in ("refraction", "loss of speed between phases")]
)
def test_of_a_pair_one_is_right(pair: Pair) -> None:
    assert pair.make(1e3, 1e-3, False).judge().minimum
    assert pair.make(1e3, 1e-3, True).judge().failed
