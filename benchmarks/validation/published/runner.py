"""The tables of the published systems.

    python -m benchmarks.validation.published [SYSTEM ...] [--json OUT]

A row has what the publication prints, our value, what an independent computation gives, and why they differ where they
do. The exit code is 1 if a row fails.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from rich.table import Table

from benchmarks.validation.published.comparison import Claim, Row, compare, known, numbers, summary
from problems._example import wide_console

SYSTEMS = {
    "rendezvous": "Time-optimal rendezvous",
    "formation_flying": "Formation flying",
    "reaction_wheels": "Reaction wheels",
    "flexible_spacecraft": "Flexible spacecraft",
    "tethered_formation": "Tethered pair",
}
"""Titles by module of this package; each has ``values()``."""

_WIDTH = 170
"""Columns where the output is no terminal."""


def table_rows(system: str) -> list[Row]:
    """Return the rows of a system's table."""
    return compare(known(system), import_module(f"{__package__}.{system}").values())


def table(title: str, rows: Sequence[Row]) -> Table:
    """Return the table of rows."""
    found = Table(title=title, title_justify="left", pad_edge=False, box=None)
    reason = "reason of the difference; note"
    for heading in ("quantity", "ours", "publication", "", "independent", "", reason):
        found.add_column(heading, overflow="fold")
    for row in rows:
        text = "; ".join(part for part in (row.reason, row.note) if part)
        if row.differs != bool(row.reason):
            text = "; ".join(filter(None, ("NO REASON" if row.differs else "NO DIFFERENCE", text)))
        cells = (*_cells(row.published, "differs"), *_cells(row.independent, "FAIL"))
        found.add_row(row.quantity, numbers(row.ours), *cells, text)
    return found


def _cells(claim: Claim | None, otherwise: str) -> tuple[str, str]:
    if claim is None:
        return "", ""
    size = f" {claim.difference} (allowed {claim.allowed})" if claim.difference else ""
    return claim.text, f"{'agrees' if claim.agrees else otherwise}{size}"


def count(rows: Sequence[Row]) -> str:
    """Return how many rows agree with the publication, and with the independent computation."""
    results = summary(rows)
    publication, independent = results["publication"], results["independent"]
    line = (
        f"{publication['agree']} of {publication['compared']} agree with the publication, "
        f"{publication['differ_with_reason']} differ for stated reasons; "
        f"{independent['agree']} of {independent['compared']} agree with the independent computation"
    )
    return line + (f"; FAIL: {', '.join(results['failed'])}" if results["failed"] else "")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; return 1 if a row fails."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.validation.published", description="Published systems."
    )
    parser.add_argument("systems", nargs="*", metavar="SYSTEM", help=f"{', '.join(SYSTEMS)}; default all")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the rows to a file")
    options = parser.parse_args(arguments)
    for name in options.systems:
        if name not in SYSTEMS:
            parser.error(f"there is no system {name}: choose among {', '.join(SYSTEMS)}")
    console = wide_console(_WIDTH)
    found = {}
    for name in options.systems or SYSTEMS:
        begin = time.process_time()
        rows = table_rows(name)
        found[name] = summary(rows)
        console.print(table(SYSTEMS[name], rows), markup=False)
        spent = time.process_time() - begin
        console.print(f"{name}: {count(rows)}; {spent:.0f} s of processor time", markup=False, soft_wrap=True)
        if options.json:  # after every system: what is done survives whatever ends the run
            text = json.dumps(found, indent=1, ensure_ascii=False, allow_nan=False)
            options.json.write_text(text + "\n", encoding="utf-8")
    return int(any(results["failed"] for results in found.values()))
