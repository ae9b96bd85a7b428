"""The generated pages of the published systems: whole, right where they judge, and what is flown today."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from problems.all import FILM_RATE, FILM_SECONDS, PAGES, SYSTEMS


def told(name: str) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((PAGES / f"{name}.json").read_text(encoding="utf-8"))
    return loaded


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_page_has_every_row_of_its_numbers_and_none_fails(name: str) -> None:
    page, numbers = (PAGES / f"{name}.md").read_text(encoding="utf-8"), told(name)
    assert numbers["failed"] == [] and "FAIL" not in page
    rows = [line for line in page.splitlines() if line.startswith("| ")][1:]
    assert len(rows) == len(numbers["rows"])
    for line, row in zip(rows, numbers["rows"], strict=True):
        assert line.startswith("| " + row["quantity"].replace("|", "\\|") + " |")
        assert row["published"] is None or row["published"]["agrees"] != bool(row["reason"])
    front = [row for row in numbers["rows"] if row["quantity"].startswith("front, ")]
    assert len(front) >= 5 and all(row["independent"]["text"] == "certified" for row in front)
    assert (PAGES / f"{name}.png").stat().st_size > 10_000 and Path(f"{name}.png").name in page


@pytest.mark.parametrize("name", SYSTEMS)
def test_what_moves_in_space_is_filmed_on_its_page(name: str) -> None:
    film = PAGES / f"{name}.gif"
    page = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    assert hasattr(import_module(f"problems.{name}.report"), "moving") == film.exists() == (film.name in page)
    if film.exists():
        with Image.open(film) as shown:
            assert shown.n_frames == FILM_SECONDS * FILM_RATE and film.stat().st_size < 2_000_000
