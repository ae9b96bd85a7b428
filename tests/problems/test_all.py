"""All systems in one run: pages, JSON, and what has changed since."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from problems import all as everything
from problems.all import SYSTEMS, changes, main, page
from problems.comparison import Row, compare, remark


def rows(a: float = 1.0, printed: str = "1.0") -> list[Row]:
    reason = "" if abs(a - float(printed)) <= 0.1 else "printed otherwise"
    return [
        compare("a", 1.0, a, absolute=0.5, published=printed, reason=reason),
        remark("b |x|", np.inf, note="only ours"),
    ]


def test_every_system_has_its_rows() -> None:
    """By name only: computing them is each system's own test."""
    folder = Path(everything.__file__).parent
    assert {p.parent.name for p in folder.glob("*/report.py")} - {"rendezvous_tracking"} == set(SYSTEMS)
    for name in SYSTEMS:
        assert "def comparison() -> list[Row]:" in (folder / name / "report.py").read_text(encoding="utf-8")


def test_pages_are_written_and_changes_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--pages", str(tmp_path / "pages"), "--only", "rendezvous"]
    for found, code, words in (
        (rows(), 0, "1 of 1 agree with the publication"),
        (rows(), 0, "nothing has changed"),
        (rows(1.02), 0, "moved: a, (1) to (1.02)"),
        (rows(1.3), 0, "marks: a, publication agrees, independent agrees to publication differs"),
        (rows(1.6), 1, "FAIL: a"),
        (rows()[:1], 0, "gone: b |x|"),
    ):
        monkeypatch.setattr(everything, "table_rows", lambda name, found=found: found[:1])
        monkeypatch.setattr(everything, "study_rows", lambda name, folder, runs, found=found: found[1:])
        assert main(arguments) == code
        assert words in capsys.readouterr().out
    told = json.loads((tmp_path / "pages" / "rendezvous.json").read_text(encoding="utf-8"))
    assert [row["quantity"] for row in told["rows"]] == ["a"]


def test_a_quick_run_compares_the_tables_alone_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--pages", str(tmp_path), "--only", "rendezvous"]
    monkeypatch.setattr(everything, "table_rows", lambda name: rows(1.02)[:1])
    monkeypatch.setattr(everything, "study_rows", lambda name, folder, runs: rows()[1:])
    assert main([*arguments, "--quick"]) == 0
    assert list(tmp_path.iterdir()) == [] and "changed" not in capsys.readouterr().out
    assert main(arguments) == 0
    written = {path: path.read_bytes() for path in tmp_path.iterdir()}
    monkeypatch.setattr(everything, "table_rows", lambda name: rows(1.03)[:1])
    assert main([*arguments, "--quick"]) == 0
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == written
    out = capsys.readouterr().out
    assert "moved: a, (1.02) to (1.03)" in out and "gone" not in out


def test_a_page_says_where_it_differs_and_why() -> None:
    text = page("title", rows(1.3))
    assert "| a | 1.0: differs | 1.3 | 1: agrees | printed otherwise |" in text
    assert "| b \\|x\\| |  | > span |  | only ours |" in text
    assert changes([], rows()) == ["new: a", "new: b |x|"]
