"""The page of benchmarks and the gallery say what the kept numbers say, with machine and date."""

from __future__ import annotations

import re

import pytest
from testing.pages import ROOT

from benchmarks.performance import page


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
    *tables, origin = page.markdown(name).split("\n\n")
    for table in tables:
        assert len({line.count("|") for line in table.splitlines()}) == 1 and table.count("\n") > 1
    module = re.escape(page.module_of(name))
    wanted = rf"Measured by `python -m {module}.*` on \d{{4}}-\d\d-\d\d: .+ cores, .*; .*gnc_opt \d"
    assert re.match(wanted, origin)


def test_pages_are_in_the_repository() -> None:
    assert page.PAGES[0] == ROOT / "docs" / "benchmarks.md"
    assert page.NUMBERS == ROOT / "benchmarks" / "performance" / "numbers"
