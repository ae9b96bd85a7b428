"""What ``python -m problems.reaction_wheels`` shows: every row of the comparison."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import gnc_opt as go
from gnc_opt.plot import View
from gnc_opt.report import write_report
from problems.comparison import Row, run_comparison
from problems.reaction_wheels.flown import flown, flown_rows
from problems.reaction_wheels.optimal import SLEWS, front, optimal_rows, optimal_slew
from problems.reaction_wheels.published import rows

__all__ = ["comparison", "front", "main", "moving"]


def comparison() -> list[Row]:
    """Return every row: published slews, optimal slews, and what is flown."""
    return rows() + optimal_rows() + flown_rows()


def write_figures(folder: Path) -> list[Path]:
    """Write the optimal solutions and all figures; return the figures' paths."""
    from problems.reaction_wheels import plots

    for name in SLEWS:
        solution = optimal_slew(name)
        write_report(solution, go.verify(solution), folder / name.replace(",", "").replace(" ", "_"))
    return plots.write_figures(folder)


def moving() -> tuple[go.Solution, View]:
    """Return what a film shows: the least energy of manoeuvre 3."""
    return optimal_slew("energy"), View(attitude="q")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a row does not pass."""
    return run_comparison(
        "reaction_wheels", "Reaction wheels", comparison, write_figures, arguments, flown=flown
    )
