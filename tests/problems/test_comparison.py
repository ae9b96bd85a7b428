"""The table of the published systems: two marks that are judged apart, and no mark that contradicts its reason."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import gnc_opt as go
from problems.comparison import (
    Claim,
    Row,
    at_most,
    compare,
    count,
    printed,
    remark,
    require,
    run_comparison,
    show,
    write_json,
)
from problems.flown import Flight, flight_rows, with_settings

WHY = "the definition in print is unclear"
RIGHT = compare("agility (rad s)", 72.87, 72.85, relative=0.01, published="172.7", reason=WHY)
"""What the independent computation says, and not what is printed."""


def independent(row: Row) -> bool:
    assert row.independent is not None
    return row.independent.agrees


# --- against the independent computation ----------------------------------------------------------------


@pytest.mark.parametrize("sign", [-1, 1])
def test_numbers_are_met_from_both_sides(sign: int) -> None:
    assert independent(compare("a", (1.0, 2.0), (1.0, 2.0 + sign * 0.0199), relative=0.01))
    assert not independent(compare("a", (1.0, 2.0), (1.0, 2.0 + sign * 0.0201), relative=0.01))
    assert not independent(compare("a", (1.0, 2.0), (1.0 + sign * 0.0101, 2.0), relative=0.01))
    assert independent(compare("a", 0.0, sign * 0.09, absolute=0.1))
    assert not independent(compare("a", 0.0, sign * 0.11, absolute=0.1))


def test_what_is_no_number_agrees_with_nothing() -> None:
    assert not independent(compare("a", 1.0, np.nan, absolute=1.0))
    assert not independent(compare("a", np.inf, 1.0, relative=0.01))
    assert not independent(compare("a", 1.0, np.inf, relative=0.01))
    assert independent(compare("a", np.inf, np.inf, relative=0.01))
    assert not at_most("a", 1.0, np.nan).passes
    assert not printed("1.0", np.nan).agrees


def test_limits_and_conditions() -> None:
    assert at_most("a", 1.0, 1.0).passes and not at_most("a", 1.0, 1.1).passes
    assert require("a", "< 1", 0.5, True).passes and not require("a", "< 1", 1.5, False).passes


# --- against the publication ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "ours", "agrees"),
    [
        ("1.825", 1.8255, True),  # cut off
        ("0.06", 0.0613, True),  # rounded
        ("1.825", 1.8261, False),
        ("1.825", 1.8239, False),
        ("120", 149.4, False),
        ("-0.05, 0.05", (-0.0498, 0.0499), True),
        ("-0.05, 0.05", (-0.0498, 0.0390), False),
        ("about 16.1", 16.05, True),
        ("2e-4", 2.4e-4, True),
        ("2e-4", 3.1e-4, False),
    ],
)
def test_digits_in_print_say_what_agrees(text: str, ours: float, agrees: bool) -> None:
    assert printed(text, ours).agrees is agrees


def test_text_without_the_numbers_is_refused() -> None:
    with pytest.raises(ValueError, match="0 numbers, ours 1"):
        remark("a", 1.0, published="much weaker")
    with pytest.raises(ValueError, match="1 numbers, ours 2"):
        remark("a", (1.0, 2.0), published="1.0")


def test_the_two_marks_are_judged_apart() -> None:
    assert RIGHT.differs and independent(RIGHT) and RIGHT.passes
    print_only = compare("a", 2.0, 1.0, absolute=0.1, published="1.0")
    assert not print_only.differs and not independent(print_only) and not print_only.passes


def test_no_mark_contradicts_its_reason() -> None:
    assert not remark("a", 2.0, published="1.0").passes
    assert not remark("a", 1.0, published="1.0", reason=WHY).passes
    assert not remark("a", 1.0, reason=WHY).passes
    assert remark("a", 1.0, published="1.0").passes
    assert remark("a", 2.0, published="1.0", reason=WHY).passes
    assert remark("a", 2.0, note="anything").passes
    assert remark("a", 2.0, published=Claim("< 1", False), reason=WHY).passes
    assert not require("a", "< 1", 2.0, False, published="never").passes


# --- what is shown and written --------------------------------------------------------------------------


def test_both_counts_are_told() -> None:
    rows = [
        RIGHT,
        compare("b", 1.0, 1.0, absolute=0.1, published="1.0"),
        compare("c", 1.0, 2.0, absolute=0.1),
        remark("d", 1.0),
    ]
    assert count(rows) == (
        "1 of 2 agree with the publication, 1 differ for stated reasons; "
        "2 of 3 agree with the independent computation; FAIL: c"
    )


def test_table_shows_two_marks_and_what_contradicts_them() -> None:
    console = Console(width=200, highlight=False)
    with console.capture() as shown:
        show(console, [RIGHT, remark("b", 2.0, published="1.0"), remark("c", 1.0, reason=WHY)], "title")
    _, _, right, unexplained, needless, _ = shown.get().splitlines()
    assert (
        "172.7" in right
        and "differs -57.8 % (allowed 0.058 %)" in right
        and "agrees -0.0274 % (allowed 1 %)" in right
        and WHY in right
    )
    assert "NO REASON" in unexplained
    assert "NO DIFFERENCE" in needless


def test_main_writes_the_rows_and_fails_with_one_of_them(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    bad = compare("b", 1.0, np.inf, absolute=0.1)
    for rows, code in (([RIGHT], 0), ([RIGHT, bad], 1)):
        assert (
            run_comparison("name", "title", lambda rows=rows: rows, lambda _: [], ["--json", str(path)])
            == code
        )
    told = json.loads(path.read_text(encoding="utf-8"))
    assert told["publication"] == {"compared": 1, "agree": 0, "differ_with_reason": 1}
    assert told["independent"] == {"compared": 2, "agree": 1}
    assert told["failed"] == ["b"]
    assert [row["ours"] for row in told["rows"]] == [[72.85], [None]]
    assert told["rows"][0]["published"] == {
        "text": "172.7",
        "agrees": False,
        "difference": "-57.8 %",
        "allowed": "0.058 %",
    }


def test_numbers_and_marks_of_numpy_are_written(tmp_path: Path) -> None:
    values = np.array([1.0, 2.0])
    rows = [
        remark("a", values, published=Claim("rising", np.all(np.diff(values) > 0))),
        require("b", "< 1", values[0], values[0] < 1, published="small", reason=WHY),
    ]
    write_json(tmp_path / "out.json", rows)
    told = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert [row["published"]["agrees"] for row in told["rows"]] == [True, False]


# --- flown comparisons ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Conditions:
    gain: float = 0.5
    law: str = "own"
    seed: int = 1
    push: tuple[float, float] = (1.0, 2.0)


def test_settings_change_the_conditions_that_they_name() -> None:
    changed = with_settings(Conditions(), ["gain=2", "law=other", "push=[3, 4]"])
    assert changed == Conditions(2.0, "other", 1, (3.0, 4.0)) and type(changed.gain) is float
    for setting, words in (
        ("gian=1", "no condition 'gian': did you mean 'gain'"),
        ("seed=1.5", "has to be like 1"),
        ("gain=high", "has to be like 0.5"),
        ("push=[1]", "has to be like"),
        ("seed=true", "has to be like 1"),
        ("seed", "write NAME=VALUE"),
    ):
        with pytest.raises(go.GncOptError, match=words):
            with_settings(Conditions(), [setting])


def test_flights_are_judged_by_both_and_by_their_ratio() -> None:
    measures, law = ("time (s)", "effort", "miss"), Flight(10.0, 2.0, 0.1)
    known = (Flight(5.0, 3.0, 0.02), law)
    rows = flight_rows("plan", measures, Flight(5.0, 3.0, 0.0203), law, known)
    assert [row.passes for row in rows] == [True, True, False]
    assert rows[1].ours == pytest.approx((3.0, 2.0, 1.5))
    assert all(row.independent is None for row in flight_rows("plan", measures, law, law, None))


def test_main_shows_the_flown_rows_alone_under_other_conditions(capsys: pytest.CaptureFixture[str]) -> None:
    def flown(settings: Sequence[str]) -> list[Row]:
        return [remark(f"gain {with_settings(Conditions(), settings).gain}", 1.0)]

    def run(*arguments: str) -> int:
        return run_comparison("name", "title", lambda: [RIGHT], lambda _: [], arguments, flown=flown)

    assert run("--set", "gain=3") == 0
    assert "gain 3.0" in (shown := capsys.readouterr().out) and "agility" not in shown
    assert run() == 0 and "agility" in capsys.readouterr().out
    assert run("--set", "gain") == 2 and "NAME=VALUE" in capsys.readouterr().err
