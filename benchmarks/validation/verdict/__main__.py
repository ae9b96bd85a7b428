"""Planted wrong answers and right ones, and what the verdict says about each.

    python -m benchmarks.validation.verdict [FILE.json] [--class TEXT ...] [--only TEXT ...] [--seed 0]
                                            [--json OUT [--resume]] [--page PAGE.md]

Wrong answers are wrong by construction, and say by how much; one that is off by less than 1e-4 does not count. Most
are made by operators: the right answer of a changed problem (another end, limit, parameter, weight, duration, cost), or
one flown differently, is checked as an answer of the old problem, as arrays, as stated and in another frame
(units, origin, constant in the cost, scale of the cost). Others are extremals that are no minima (conjugate points,
saddles of switch times, narrow wells of H, singular maxima), answers that look like a closed form and are none, what
default calls yield past a limit, and files whose numbers were changed. Right answers are those of closed forms, of
`problems`, and of FILE.json, a set in the format of `benchmarks.validation.problem_set.reader`.

The table counts, by class: planted; failed; passed wrongly; false alarms; inconclusive (neither failed nor known to be
a minimum). What is amiss is listed by name. The exit code is 1 if a wrong answer passes or a right one fails. Ctrl-C
ends the run and keeps what is done, in the JSON file too; ``--resume`` leaves out what that file already has.
``--page`` puts the table into a page (`README.md` of this folder) and keeps its numbers beside the benchmark.
"""

from __future__ import annotations

import argparse
import json
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.validation.problem_set.reader import read_documents
from benchmarks.validation.verdict.cases import Case, Outcome, cases, check_case
from problems._example import wide_console

COLUMNS = (
    "planted",
    "failed",
    "passed wrongly",
    "false alarm",
    "inconclusive",
    "crash",
    "not planted",
    "not found",
)

NUMBERS = Path(__file__).parent / "numbers.json"
"""Those of the last whole run."""

_PLACE = re.compile(
    r"(<!-- table of benchmarks\.validation\.verdict -->\n).*?(<!-- end of the table -->)", re.DOTALL
)

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
    words = Counter(o.word for o in outcomes) + Counter(
        o.result for o in outcomes if o.result.startswith("not")
    )
    words["planted"] = sum(not o.result.startswith("not") for o in outcomes)
    words["failed"] = sum(o.wrong and o.result == "failed" for o in outcomes)
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


def write_page(rows: Rows, page: Path, numbers: Path = NUMBERS) -> None:
    """Keep the numbers and put the table into a page, between its two comments."""
    numbers.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    text = page.read_text(encoding="utf-8")
    if not _PLACE.search(text):
        raise ValueError(
            f"{page} has no place for the table: put the two comments of {_PLACE.pattern!r} there."
        )
    page.write_text(_PLACE.sub(lambda m: m[1] + markdown(rows) + m[2], text), encoding="utf-8")


_WIDTH = 140
"""Columns where the output is no terminal."""

INCONCLUSIVE_LIMIT = 3
"""Most cases that may be inconclusive."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see the module's text."""
    options = _parser().parse_args(arguments)
    console = wide_console(_WIDTH)
    documents = [] if options.file is None else read_documents(options.file)
    chosen = [c for c in cases(documents, options.seed) if _is_chosen(c, options)]
    outcomes = _kept(options.json) if options.resume and options.json else []
    done = {(o.kind, o.name) for o in outcomes}
    try:
        with console.status("") as status:
            for i, case in enumerate(chosen, 1):
                if (case.kind, case.name) not in done:
                    status.update(f"{i} of {len(chosen)}: {case.kind}, {case.name}")
                    outcomes.append(check_case(case))
                    if options.json:  # after every case: what is done survives whatever ends the run
                        _write(options.json, outcomes, options.seed)
    except KeyboardInterrupt:
        console.print("interrupted")
    _show(console, outcomes)
    if options.page:
        write_page(count(outcomes), options.page)
    return int(any(o.word in ("passed wrongly", "false alarm", "crash") for o in outcomes))


def _is_chosen(case: Case, options: argparse.Namespace) -> bool:
    """Whether the class and the name contain what was asked for."""
    kinds, names = options.kinds or [""], options.only or [""]
    return any(k in case.kind for k in kinds) and any(n in case.name for n in names)


def _show(console: Console, outcomes: Sequence[Outcome]) -> None:
    grid = Table(box=box.SIMPLE_HEAD, title="the verdict on planted answers", title_justify="left")
    grid.add_column("class", no_wrap=True)
    for column in COLUMNS:
        grid.add_column(column, justify="right")
    cells = shown(count(outcomes))
    for k, row in enumerate(cells):
        if k == len(cells) - 2:
            grid.add_section()
        grid.add_row(*row)
    console.print(grid)
    for o in outcomes:
        if o.word:
            off = "" if not o.off else f" (off by {o.off:.1e})"
            conditions = "; ".join(o.conditions) or "every condition passes"
            console.print(f"{o.word}: {o.kind}: {o.name}{off}: {conditions}", markup=False, soft_wrap=True)
    console.print(
        f"{sum(o.seconds for o in outcomes):.0f} s of processor time; inconclusive: at most {INCONCLUSIVE_LIMIT} wanted"
    )


def _write(path: Path, outcomes: Sequence[Outcome], seed: int) -> None:
    text = {"seed": seed, "outcomes": [_finite(o) for o in outcomes]}
    path.write_text(json.dumps(text, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _finite(outcome: Outcome) -> dict[str, object]:
    plain = outcome.plain()
    return plain | {"off": "unbounded"} if plain["off"] == float("inf") else plain


def _kept(path: Path) -> list[Outcome]:
    if not path.exists():
        return []
    kept = json.loads(path.read_text(encoding="utf-8"))["outcomes"]
    for entry in kept:
        del entry["word"]
        entry["conditions"] = tuple(entry["conditions"])
        entry["off"] = float("inf") if entry["off"] == "unbounded" else entry["off"]
    return [Outcome(**entry) for entry in kept]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.validation.verdict",
        description=(__doc__ or "").partition("\n")[0],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "file", nargs="?", type=Path, metavar="FILE.json", help="a set of problems with references"
    )
    parser.add_argument(
        "--class", dest="kinds", nargs="+", metavar="TEXT", help="only classes that contain a text"
    )
    parser.add_argument("--only", nargs="+", metavar="TEXT", help="only cases whose names contain a text")
    parser.add_argument("--seed", type=int, default=0, help="of units, origins and constants")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the outcomes after every case")
    parser.add_argument("--resume", action="store_true", help="leave out what OUT already has")
    parser.add_argument("--page", type=Path, metavar="PAGE", help="put the table into a page")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
