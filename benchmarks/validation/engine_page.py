"""The tables of solved problems on the page of examples, from results of `benchmarks.validation.engine`.

    python -m benchmarks.validation.engine_page RESULTS.json ...

writes them between their markers in ``docs/problems.md``: a table per trade with picture, question, objective,
reference, CPU time and result of the optimality check; above them, how many agree and pass. Problems without a result
have empty cells.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterator, Sequence
from importlib import import_module
from itertools import groupby
from pathlib import Path

from benchmarks.validation.engine import Row, read_rows
from gnc_opt.problem_files_and_examples import Example, list_examples
from website.thumbnails import superscripts

PAGE = Path(__file__).parents[2] / "docs" / "problems.md"
BEGIN, END = "<!-- tables of benchmarks.validation.engine -->", "<!-- end of the tables -->"
_HEADING = "| | problem | objective | reference | CPU&nbsp;s | check |\n|---|---|---|---|--:|---|"


def tables(rows: Sequence[Row]) -> str:
    """Return the tables in Markdown, by folder and name."""
    known = {row.problem: row for row in rows}
    files = sorted(
        (e for e in list_examples() if not e.is_package), key=lambda e: (e.path.parent.name, e.name)
    )
    lines = [_counts([known[e.name] for e in files if e.name in known])]
    for _, members in groupby(files, key=lambda e: e.path.parent):
        some = list(members)
        package = import_module(some[0].module_name.rpartition(".")[0])
        trade = (package.__doc__ or package.__name__).partition(":")[0]
        cells = ("| " + " | ".join(_cells(each, known.get(each.name))) + " |" for each in some)
        lines += ["", f"### {trade}", "", _HEADING, *cells]
    return "\n".join(lines)


def _counts(rows: Sequence[Row]) -> str:
    """Return how many problems agree with the reference, and how many have which result of the check."""
    minima, passed = sum(row.minimum for row in rows), sum(row.ok for row in rows)
    return (
        f"Of {len(rows)} problems, {sum(row.right for row in rows)} agree with the reference. The check certifies "
        f"{minima} as a strict local optimum; {passed - minima} more pass, and {len(rows) - passed} fail a condition."
    )


def _cells(problem: Example, row: Row | None) -> Iterator[str]:
    file = f"../problems/{problem.path.parent.name}/{problem.path.name}"
    name, colon, question = problem.title.partition(":")
    reference = problem.module.REFERENCE
    yield f"[![{problem.name}](pictures/{problem.name}.png)]({file})"
    yield f"[{name}]({file}){colon}{question}"
    sense = "max " if problem.module.build().sense < 0 else ""
    yield "" if row is None or row.objective is None else sense + _objective(row, reference.unit)
    yield f"{reference.value:.10g}"
    yield "" if row is None else f"{row.cpu_s:.1f}"
    yield "" if row is None else _check(row)


def _check(row: Row) -> str:
    """Return the result of the optimality check with the conditions that fail, or why there is no solution."""
    if row.ok:
        return "optimum" if row.minimum else "necessary conditions"
    return f"**fails**: {re.sub(r' [-+.0-9e]+(?=;|$)', '', row.note).replace(';', ',').replace('_', ' ')}"


def _objective(row: Row, unit: str) -> str:
    """Return the objective with the digits that the tolerance of the reference allows, and its distance."""
    digits = max(0, -math.floor(math.log10(row.tolerance or 1.0)))
    text = f"{round(row.objective or 0.0, digits):.10g} {superscripts(unit)}".rstrip()
    return text if row.right else f"{text}, **differs by {100.0 * (row.relative_error or 0.0):.2g} %**"


def write(rows: Sequence[Row], page: Path = PAGE) -> None:
    """Put the tables between their markers on the page."""
    text = page.read_text(encoding="utf-8")
    found = f"{BEGIN}\n\n{tables(rows)}\n\n{END}"
    page.write_text(
        re.sub(f"{re.escape(BEGIN)}.*?{re.escape(END)}", lambda _: found, text, flags=re.DOTALL),
        encoding="utf-8",
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "results", type=Path, nargs="+", metavar="RESULTS.json", help="written by the engine's --json"
    )
    write([row for path in parser.parse_args(arguments).results for row in read_rows(path)])
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
