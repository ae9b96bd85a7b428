"""The table of realistic problems on the page of examples, from results of `benchmarks.validation.engine`.

    python -m benchmarks.validation.engine_page RESULTS.json

writes the table between its markers in ``docs/problems.md``: question, reference, whether the objective agrees or its
relative difference, CPU time, and result of the optimality check; above it, how many agree and pass. Problems without
a result have empty cells.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.validation.engine import Row, group_of, read_rows
from gnc_opt.problem_file import Example, examples

PAGE = Path(__file__).parents[2] / "docs" / "problems.md"
BEGIN, END = "<!-- table of benchmarks.validation.engine -->", "<!-- end of the table -->"
_HEADING = "| file | question | reference | agrees | CPU s | check | source of the reference |"
_AGREES = 3
_CHECK = 5
"""Columns."""


def table(rows: Sequence[Row]) -> str:
    """Return the table in Markdown, by folder and name."""
    known = {row.problem: row for row in rows}
    chosen = [e for e in examples() if group_of(e) in ("flagship", "further")]
    chosen.sort(key=lambda e: (e.path.parent.name, e.name))
    cells = [tuple(_cells(each, known.get(each.name))) for each in chosen]
    lines = [_counts(cells), "", _HEADING, "|---" * (_HEADING.count("|") - 1) + "|"]
    lines += ["| " + " | ".join(row) + " |" for row in cells]
    return "\n".join(lines)


def _counts(cells: Sequence[tuple[str, ...]]) -> str:
    """Return how many problems agree with the reference, and how many have which result of the check."""
    agree = sum(row[_AGREES] == "yes" for row in cells)
    found = Counter(row[_CHECK] for row in cells)
    best, others = found["minimum"], found["ok"]
    return (
        f"Of {len(cells)} problems, {agree} agree with the reference. The check certifies {best} as a strict local "
        f"minimum; {others} more pass, and {len(cells) - best - others} are not certified."
    )


def _cells(problem: Example, row: Row | None) -> Iterator[str]:
    trade, reference = problem.path.parent.name, problem.module.REFERENCE
    yield f"[`{problem.name}`](../problems/{trade}/{problem.path.name})"
    yield problem.title.partition(": ")[2]
    yield f"{reference.value:.10g} {reference.unit}".rstrip()
    if row is None or row.relative_error is None:
        yield from ("", "" if row is None else f"{row.cpu_s:.1f}", "" if row is None else "not solved")
    else:
        yield "yes" if row.right else f"no: {row.relative_error:.0e}"
        yield f"{row.cpu_s:.1f}"
        yield "minimum" if row.minimum else "ok" if row.ok else "not ok"
    yield reference.source.replace("independent Radau collocation", "Radau")


def write(rows: Sequence[Row], page: Path = PAGE) -> None:
    """Put the table between its markers on the page."""
    text = page.read_text(encoding="utf-8")
    found = f"{BEGIN}\n\n{table(rows)}\n\n{END}"
    page.write_text(
        re.sub(f"{re.escape(BEGIN)}.*?{re.escape(END)}", lambda _: found, text, flags=re.DOTALL),
        encoding="utf-8",
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("results", type=Path, metavar="RESULTS.json", help="written by the engine's --json")
    write(read_rows(parser.parse_args(arguments).results))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
