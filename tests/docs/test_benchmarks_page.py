"""The page of benchmarks and the gallery say what the kept numbers say, with machine and date."""

from __future__ import annotations

import json
import re
import types

import pytest
from testing.pages import ROOT, doc

from benchmarks.performance import page
from gnc_opt.problem_file import examples


def test_the_page_shows_the_kept_numbers() -> None:
    text = "".join(each.read_text(encoding="utf-8") for each in page.PAGES)
    assert text == page.written(text), "run python -m benchmarks.performance.page"
    assert set(re.findall(r"<!-- table of benchmarks\.\w+\.(\w+) -->", text)) == set(page.BENCHMARKS)


@pytest.mark.parametrize("name", page.BENCHMARKS)
def test_every_table_has_its_origin(name: str) -> None:
    if page.numbers(name) is None:
        assert page.markdown(name).startswith(
            f"Not measured yet: `python -m benchmarks.performance.page {name}"
        )
        return
    table, origin = page.markdown(name).split("\n\n")
    assert len({line.count("|") for line in table.splitlines()}) == 1 and table.count("\n") > 1
    module = re.escape(page.module_of(name))
    wanted = rf"Measured by `python -m {module}.*` on \d{{4}}-\d\d-\d\d: .+ cores, .*; .*gnc_opt \d"
    assert re.match(wanted, origin)


def test_problems_that_are_measured_exist_and_meet_their_references() -> None:
    told = page.numbers("problem_files")["told"]
    known = {example.name for example in examples()}
    assert {row["problem"] for row in told} <= known
    realistic = doc("problems").section(
        "Realistic problems"
    )  # these are measured by benchmarks.validation.engine
    others = {name for name in known if f"[`{name}`]" not in realistic}
    assert len(told) > 0.8 * len(others)
    apart = [row["problem"] for row in told if row["off"] is not None and abs(row["off"]) > 1e-6]
    assert not apart


def test_measuring_keeps_numbers_with_machine_and_date(tmp_path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    def main(arguments: list[str]) -> int:
        with open(arguments[-1], "w", encoding="utf-8") as file:
            json.dump([{"size": 0.1, "spent": 3}], file)
        return 1  # a target that is missed is no reason to lose the numbers

    fake = types.SimpleNamespace(main=main)
    monkeypatch.setattr(
        page.importlib, "import_module", lambda name: {"benchmarks.performance.fake": fake}[name]
    )
    monkeypatch.setattr(page, "NUMBERS", tmp_path / "numbers")
    monkeypatch.setattr(page, "version", lambda package: "1")
    monkeypatch.setattr(page, "PAGES", (tmp_path / "page.md",))
    rows = page.Benchmark(
        ("--runs", "2"), ("size", "spent"), lambda told: [(str(r["size"]), str(r["spent"])) for r in told]
    )
    monkeypatch.setattr(page, "BENCHMARKS", {"fake": rows})
    page.PAGES[0].write_text(
        "before\n<!-- table of benchmarks.performance.fake -->\nold\n<!-- end of the table -->\nafter\n"
    )
    assert page.main(["fake"]) == 0
    text = page.PAGES[0].read_text()
    assert "| size | spent |\n| --- | --: |\n| 0.1 | 3 |\n" in text and "old" not in text
    assert "Measured by `python -m benchmarks.performance.fake --runs 2` on " in text
    assert text.startswith("before") and text.endswith("after\n")
    assert page.main([]) == 0 and page.PAGES[0].read_text() == text  # the same without measuring
    with pytest.raises(SystemExit):
        page.main(["other"])


def test_what_was_just_told_is_not_measured_twice_and_shows_no_folder(  # type: ignore[no-untyped-def]
    tmp_path, monkeypatch, capsys
) -> None:
    told, problems = tmp_path / "told.json", tmp_path / "problems.json"
    told.write_text("[1, 2]")
    problems.write_text("[]")
    rows = page.Benchmark((), ("n",), lambda told: [(str(n),) for n in told], needs="FILE.json")
    monkeypatch.setattr(page, "BENCHMARKS", {"fake": rows})
    monkeypatch.setattr(page, "NUMBERS", tmp_path / "numbers")
    monkeypatch.setattr(page, "version", lambda package: "1")
    monkeypatch.setattr(page, "PAGES", (tmp_path / "page.md",))
    page.PAGES[0].write_text("<!-- table of benchmarks.performance.fake -->\n<!-- end of the table -->\n")
    assert page.main([]) == 0
    assert (
        "Not measured yet: `python -m benchmarks.performance.page fake -- FILE.json`"
        in page.PAGES[0].read_text()
    )
    assert page.main(["fake", "--told", str(told), "--", str(problems)]) == 0
    text = page.PAGES[0].read_text()
    assert "| 1 |\n| 2 |\n" in text and "`python -m benchmarks.performance.fake problems.json`" in text
    assert str(tmp_path) not in text
    for wrong in (["fake"], ["--told", str(told)]):
        with pytest.raises(SystemExit):
            page.main(wrong)
    assert "fake needs to be told FILE.json" in capsys.readouterr().err


def test_peers_are_as_fast_as_their_fastest_way_that_is_right_everywhere() -> None:
    quick = {"1": {"s": 0.1, "error": 1e-4}, "2": {"s": 0.3, "error": 1e-5}}
    slow = {"1": {"s": 2.0, "error": 1e-9}, "2": {"s": 4.0, "error": 1e-9}}
    told = {"theirs": {"20x3": quick, "80x3": slow}, "lost": {"20x3": {"1": {"failed": "no"}}}}
    assert list(page.BENCHMARKS["peers"].rows(told)) == [
        ("theirs, case 1", "0.1", "0.1", "2", "2"),
        ("lost, case 1", *4 * ["never"]),
        ("theirs, mean of 2 cases", "0.2", "0.2", "3", "3"),
        ("lost, mean of 2 cases", *4 * ["never"]),
    ]


def test_what_became_of_a_problem_is_told_in_words() -> None:
    row = {
        "name": "a",
        "objective": 1.0,
        "relative_error": 1e-9,
        "costate_error": None,
        "seconds": 0.52,
        "iterations": 12,
        "refinements": 3,
        "verdict_ok": False,
        "failed": ["stationarity"],
        "inconclusive": [],
        "status": "optimal",
        "passed": True,
    }
    ended = row | {"objective": None, "relative_error": None, "status": "input_error", "iterations": None}
    (told, refused) = page.BENCHMARKS["problem_set"].rows([row, ended])
    assert told == ("a", "1e-09", "", "12", "3", "0.5", "fails stationarity", "yes")
    assert refused == ("a", "", "", "", "3", "0.5", "input error", "yes")


def test_pages_are_in_the_repository() -> None:
    assert (
        page.PAGES[0] == ROOT / "docs" / "benchmarks.md"
        and page.NUMBERS == ROOT / "benchmarks" / "performance" / "numbers"
    )
