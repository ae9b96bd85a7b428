"""All published systems in one run: a table and a page each, and what has changed since the pages were last written.

A page is a reproducibility matrix: what the publication says, ours, what an independent computation says, and why they
differ where they do; below it the front of what less time costs, and plans beside the published law over many
dispersed runs, and a film of an optimum where it moves in space.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

from rich.console import Console

from gnc_opt.errors import GncOptError
from problems.comparison import Row, count, numbers, summary, write_json
from problems.dispersed import RUNS, Rivals, dispersed_rows
from problems.fronts import Front, front_figure, front_rows

SYSTEMS = {
    "rendezvous": "Time-optimal rendezvous",
    "formation_flying": "Formation flying",
    "reaction_wheels": "Reaction wheels",
    "flexible_spacecraft": "Flexible spacecraft",
    "tethered_formation": "Tethered pair",
}
"""Folders with their titles; each has ``report.comparison``, which returns its rows, and ``report.front``; those
that can be seen moving in space ``report.moving``."""
FILM_SECONDS, FILM_RATE = 6.0, 10.0
"""Of the films: how long they are, and pictures per second."""
FLOWN = {name: f"problems.{name}.flown" for name in SYSTEMS} | {
    "rendezvous": "problems.rendezvous_tracking.flown"
}
"""Modules that fly them, each with ``rivals``."""
PAGES = Path(__file__).parent.parent / "docs" / "systems"
MOVED = 1e-6
"""A number has changed if it moved by more than this share of itself."""


def table_rows(name: str) -> list[Row]:
    """Return the rows of a system's own table."""
    rows: list[Row] = import_module(f"problems.{name}.report").comparison()
    return rows


def study_rows(name: str, folder: Path, runs: int) -> list[Row]:
    """Return the rows of a system's front and of dispersed runs; draw the front, and film an optimum, into a folder."""
    from gnc_opt.plot import save_film
    from gnc_opt.plot.style import save_figure

    report = import_module(f"problems.{name}.report")
    front: Front = report.front()
    save_figure(front_figure(front), folder / f"{name}.png")
    if hasattr(report, "moving"):
        solution, view = report.moving()
        save_film(solution, folder / f"{name}.gif", view, seconds=FILM_SECONDS, rate=FILM_RATE)
    rows = front_rows(front)
    if runs > 0:
        rivals: Rivals = import_module(FLOWN[name]).rivals()
        rows += dispersed_rows(rivals, rivals.fly(runs))
    return rows


def page(title: str, rows: Sequence[Row], pictures: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the matrix of a system, Markdown, with pictures by what they show."""
    lines = [
        f"# {title}",
        "",
        "Written by `python -m problems.all`; the two marks are [those of every system](../problems.md#systems).",
        "",
        count(rows) + ".",
        "",
        *(line for shows, file in pictures.items() for line in (f"![{shows}]({file})", "")),
        "| quantity | publication | ours | independent | |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        cells = [row.quantity, "", numbers(row.ours), "", "; ".join(filter(None, (row.reason, row.note)))]
        for i, claim, otherwise in ((1, row.published, "differs"), (3, row.independent, "FAIL")):
            if claim is not None:
                cells[i] = f"{claim.text}: {'agrees' if claim.agrees else otherwise}"
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def pictures(name: str, folder: Path) -> dict[str, str]:
    """Return the pictures of a system's page that are in a folder, by what they show."""
    shown = {"what less time costs": f"{name}.png", "an optimum in motion": f"{name}.gif"}
    return {shows: file for shows, file in shown.items() if (folder / file).exists()}


def changes(before: Sequence[dict[str, Any]], rows: Sequence[Row], *, all_rows: bool = True) -> list[str]:
    """Return what differs between the rows of a page's JSON and those of now, a line each.

    Unless these are all rows, no row counts as gone.
    """
    old, new = {row["quantity"]: row for row in before}, {r["quantity"]: r for r in summary(rows)["rows"]}
    told = [f"gone: {name}" for name in old if all_rows and name not in new]
    for name, row in new.items():
        if name not in old:
            told.append(f"new: {name}")
            continue
        then = old[name]
        if _marks(then) != _marks(row):
            told.append(f"marks: {name}, {_marks(then)} to {_marks(row)}")
        elif not _same(then["ours"], row["ours"]):
            told.append(f"moved: {name}, {_list(then['ours'])} to {_list(row['ours'])}")
    return told


def _marks(row: dict[str, Any]) -> str:
    claims = (("publication", row["published"]), ("independent", row["independent"]))
    return (
        ", ".join(f"{who} {'agrees' if claim['agrees'] else 'differs'}" for who, claim in claims if claim)
        or "none"
    )


def _same(before: Sequence[float | None], now: Sequence[float | None]) -> bool:
    def near(a: float | None, b: float | None) -> bool:
        return a is b if a is None or b is None else abs(a - b) <= MOVED * max(abs(a), abs(b))

    return len(before) == len(now) and all(near(a, b) for a, b in zip(before, now, strict=True))


def _list(values: Sequence[float | None]) -> str:
    return "(" + ", ".join("none" if v is None else f"{v:.7g}" for v in values) + ")"


def main(arguments: Sequence[str] | None = None) -> int:
    """Compute every system, write the pages, say what changed; see ``python -m problems.all --help``.

    Returns
    -------
    int
        0; 1 if a row of a system does not pass, or one cannot be computed.
    """
    parser = argparse.ArgumentParser(prog="python -m problems.all", description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--pages",
        type=Path,
        default=PAGES,
        metavar="DIR",
        help=f"folder of pages and JSON, default {PAGES}",
    )
    parser.add_argument("--runs", type=int, default=RUNS, help=f"dispersed runs of each loop, default {RUNS}")
    parser.add_argument("--only", choices=list(SYSTEMS), action="append", help="this system; may be repeated")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="tables only, beside the pages as they are: no fronts, no dispersed runs, nothing is written",
    )
    options = parser.parse_args(arguments)
    console, fine = Console(highlight=False), True
    for name in options.only or SYSTEMS:
        begin, told = time.perf_counter(), options.pages / f"{name}.json"
        try:
            rows = table_rows(name)
            if not options.quick:
                options.pages.mkdir(parents=True, exist_ok=True)
                rows += study_rows(name, options.pages, options.runs)
        except GncOptError as error:
            console.print(f"{name}: {error}", markup=False, soft_wrap=True)
            fine = False
            continue
        fine = fine and all(row.passes for row in rows)
        before = json.loads(told.read_text(encoding="utf-8"))["rows"] if told.exists() else None
        if not options.quick:
            write_json(told, rows)
            text = page(SYSTEMS[name], rows, pictures(name, options.pages))
            (options.pages / f"{name}.md").write_text(text, encoding="utf-8")
        spent = time.perf_counter() - begin
        console.print(f"{name}: {count(rows)}; {spent:.0f} s", markup=False, soft_wrap=True)
        differ = [] if before is None else changes(before, rows, all_rows=not options.quick)
        for change in differ if before is None else differ or ["nothing has changed"]:
            console.print(f"  {change}", markup=False, soft_wrap=True)
    return 0 if fine else 1


if __name__ == "__main__":
    raise SystemExit(main())
