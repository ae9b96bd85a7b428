"""The page of benchmarks and the gallery say what the kept numbers say, with machine and date."""

from __future__ import annotations

import json
import re
import types

import pytest
from pages import ROOT

from benchmarks import page
from gnc_opt.examples import examples


def test_the_page_shows_the_kept_numbers() -> None:
    text = page.PAGE.read_text(encoding="utf-8")
    assert text == page.written(text), "run python -m benchmarks.page"
    assert set(re.findall(r"<!-- table of benchmarks\.(\w+) -->", text)) == set(page.BENCHMARKS)


@pytest.mark.parametrize("name", page.BENCHMARKS)
def test_every_table_has_its_origin(name: str) -> None:
    table = page.markdown(name)
    assert f"| `python -m benchmarks.{name}" in table
    assert re.search(r"\| \d{4}-\d\d-\d\d \| .+ cores, .* \| .*gnc_opt \d", table)
    for part in table.split("\n\n"):
        assert len({line.count("|") for line in part.splitlines()}) == 1 and part.count("\n") > 1


def test_problems_that_are_measured_exist_and_meet_their_references() -> None:
    told = page.numbers("problem_files")["told"]
    known = {example.name for example in examples()}
    assert {row["problem"] for row in told} <= known and len(told) > 0.8 * len(known)
    apart = [row["problem"] for row in told if row["off"] is not None and abs(row["off"]) > 1e-6]
    assert not apart


def test_measuring_keeps_numbers_with_machine_and_date(tmp_path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    def main(arguments: list[str]) -> int:
        with open(arguments[-1], "w", encoding="utf-8") as file:
            json.dump([{"size": 0.1, "spent": 3}], file)
        return 1  # a target that is missed is no reason to lose the numbers

    fake = types.SimpleNamespace(main=main)
    monkeypatch.setattr(page.importlib, "import_module", lambda name: {"benchmarks.fake": fake}[name])
    monkeypatch.setattr(page, "NUMBERS", tmp_path / "numbers")
    monkeypatch.setattr(page, "version", lambda package: "1")
    monkeypatch.setattr(page, "PAGE", tmp_path / "page.md")
    rows = page.Benchmark(
        ("--runs", "2"), ("size", "spent"), lambda told: [(str(r["size"]), str(r["spent"])) for r in told]
    )
    monkeypatch.setattr(page, "BENCHMARKS", {"fake": rows})
    page.PAGE.write_text("before\n<!-- table of benchmarks.fake -->\nold\n<!-- end of the table -->\nafter\n")
    assert page.main(["fake"]) == 0
    text = page.PAGE.read_text()
    assert "| size | spent |\n| --- | --: |\n| 0.1 | 3 |\n" in text and "old" not in text
    assert (
        "| `python -m benchmarks.fake --runs 2` | " in text
        and text.startswith("before")
        and text.endswith("after\n")
    )
    assert page.main([]) == 0 and page.PAGE.read_text() == text  # the same without measuring
    with pytest.raises(SystemExit):
        page.main(["other"])


def test_pages_are_in_the_repository() -> None:
    assert page.PAGE == ROOT / "docs" / "benchmarks.md" and page.NUMBERS == ROOT / "benchmarks" / "numbers"
