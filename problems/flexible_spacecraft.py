"""Attitude control of a flexible spacecraft: quasi-sliding mode as published, and the same slew made optimal.

The publication turns a hub with four appendage modes by 143 degrees under a torque limit of 0.5 N m. Its numbers are
reproduced as far as they can be (`problems.flexible_spacecraft_published`); the slew is done in the least time and with
the least vibration, no modal energy left at the end, and tracked (`problems.flexible_spacecraft_optimal`). One model
serves all of it: `problems.flexible_spacecraft_system`. The page is docs/flexible_spacecraft.md.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console

from problems.comparison import Row, show
from problems.flexible_spacecraft_law import law_rows
from problems.flexible_spacecraft_optimal import REFERENCE, build, build_gentle, optimal_rows
from problems.flexible_spacecraft_plant import plant_rows
from problems.flexible_spacecraft_published import configuration_rows
from problems.flexible_spacecraft_system import build_model, quasi_sliding_mode

__all__ = ["REFERENCE", "build", "build_gentle", "build_model", "comparison", "main", "quasi_sliding_mode"]

_WIDTH = 170
"""Columns where the output is no terminal."""


def comparison() -> list[Row]:
    """Return every row: plant, configurations, what the law does, optimal slews and their tracking."""
    return plant_rows() + configuration_rows() + law_rows() + optimal_rows()


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a number that is asserted misses its tolerance."""
    options = _parser().parse_args(arguments)
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, _WIDTH)
    rows = comparison()
    show(console, rows, "Flexible spacecraft")
    failed = [row.quantity for row in rows if row.passes is False]
    asserted = sum(row.passes is not None for row in rows)
    console.print(f"{asserted - len(failed)} of {asserted} asserted numbers pass", markup=False)
    if options.json is not None:
        told = {"rows": [asdict(row) for row in rows], "asserted": asserted, "failed": failed}
        options.json.write_text(json.dumps(told, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    if options.report is not None:
        from problems.flexible_spacecraft_figures import write_figures

        paths = write_figures(options.report)
        console.print(f"report: {len(paths)} figures in {options.report}", markup=False)
    return 1 if failed else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m problems.flexible_spacecraft", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--report", type=Path, metavar="DIR", help="write the figures to a folder")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the table to a file")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
