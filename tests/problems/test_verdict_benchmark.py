"""The benchmark of the verdict: how many answers it plants, how it counts, what it keeps."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import gnc_opt as go
from benchmarks.validation.verdict import __main__ as command
from benchmarks.validation.verdict.answers import Case, Pair
from benchmarks.validation.verdict.cases import MODULES, cases, check_case
from benchmarks.validation.verdict.statements import FAMILY, solved, trajectory
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
    case = Case("kind", "name", lambda: said, "why" if wrong else "", off, first_order)
    assert check_case(case).word == word


def test_operators_plant_what_they_say() -> None:
    planted = {p.kind: p for p in changes(ENERGY)}
    wrong = planted["end missed"].make()
    assert wrong.x[0, -1] == pytest.approx(1.003) or wrong.x[1, -1] != 0
    assert off_by(ENERGY, wrong) > 1e-4
    assert off_by(ENERGY, trajectory(solved(ENERGY))) == 0


ROOT = Path(__file__).parents[2]


def test_the_page_shows_the_numbers_of_the_last_run_and_nothing_passed_wrongly() -> None:
    rows = json.loads(command.NUMBERS.read_text(encoding="utf-8"))
    assert command.markdown(rows) in (command.NUMBERS.parent / "README.md").read_text(encoding="utf-8")
    assert rows["all wrong ones"]["planted"] >= 400 and rows["all right ones"]["planted"] >= 100
    assert rows["all wrong ones"]["passed wrongly"] == rows["all wrong ones"]["crash"] == 0
    planned = {c.kind for c in cases([], seed=0)}
    assert set(rows) - {"all wrong ones", "all right ones", "right: problem set"} == planned


@pytest.mark.parametrize(
    "pair", [pair for module in MODULES for pair in module.PAIRS if pair.name == "refraction"]
)
def test_of_a_pair_one_is_right(pair: Pair) -> None:
    assert pair.make(1e3, 1e-3, False).check().minimum
    assert pair.make(1e3, 1e-3, True).check().failed
