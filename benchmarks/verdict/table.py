"""What a run has told, class by class: the numbers, kept beside the benchmark, and the table that a page shows."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from benchmarks.verdict.cases import Outcome

COLUMNS = (
    "planted",
    "failed",
    "passed wrongly",
    "false alarm",
    "untold",
    "crash",
    "not planted",
    "not found",
)

NUMBERS = Path(__file__).parent / "numbers.json"
"""Those of the last whole run."""

_PLACE = re.compile(r"(<!-- table of benchmarks\.verdict -->\n).*?(<!-- end of the table -->)", re.DOTALL)

Rows = dict[str, dict[str, int]]


def count(outcomes: Sequence[Outcome]) -> Rows:
    """Return the numbers of every class, then of all wrong answers and of all right ones."""
    rows = {
        kind: _numbers([o for o in outcomes if o.kind == kind])
        for kind in dict.fromkeys(o.kind for o in outcomes)
    }
    rows["all wrong ones"] = _numbers([o for o in outcomes if o.wrong])
    rows["all right ones"] = _numbers([o for o in outcomes if not o.wrong])
    return rows


def _numbers(outcomes: Sequence[Outcome]) -> dict[str, int]:
    words = Counter(o.word for o in outcomes) + Counter(o.told for o in outcomes if o.told.startswith("not"))
    words["planted"] = sum(not o.told.startswith("not") for o in outcomes)
    words["failed"] = sum(o.wrong and o.told == "failed" for o in outcomes)
    return {column: words[column] for column in COLUMNS}


def shown(rows: Rows) -> list[list[str]]:
    """Return the cells of the table: the class and its numbers, nothing for zero."""
    return [
        [kind, *(str(numbers[c]) if numbers[c] else "" for c in COLUMNS)] for kind, numbers in rows.items()
    ]


def markdown(rows: Rows) -> str:
    """Return the table as a page shows it."""
    head = ["class", *COLUMNS]
    lines = [head, ["---", *["--:"] * len(COLUMNS)], *shown(rows)]
    return "".join("| " + " | ".join(cells) + " |\n" for cells in lines)


def write(rows: Rows, page: Path, numbers: Path = NUMBERS) -> None:
    """Keep the numbers and put the table into a page, between its two comments."""
    numbers.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    text = page.read_text(encoding="utf-8")
    if not _PLACE.search(text):
        raise ValueError(
            f"{page} has no place for the table: put the two comments of {_PLACE.pattern!r} there."
        )
    page.write_text(_PLACE.sub(lambda m: m[1] + markdown(rows) + m[2], text), encoding="utf-8")
