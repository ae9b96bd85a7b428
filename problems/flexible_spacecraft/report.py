"""What ``python -m problems.flexible_spacecraft`` shows: every row of the comparison."""

from __future__ import annotations

from collections.abc import Sequence

import gnc_opt as go
from gnc_opt.plot import View
from problems.comparison import Row, run_comparison
from problems.flexible_spacecraft.flown import flown, flown_rows
from problems.flexible_spacecraft.optimal import front, optimal_rows, solved
from problems.flexible_spacecraft.plant import plant_rows
from problems.flexible_spacecraft.published import configuration_rows
from problems.flexible_spacecraft.studies import law_rows

__all__ = ["comparison", "front", "main", "moving"]


def comparison() -> list[Row]:
    """Return every row: plant, configurations, what the law does, optimal slews and tracking, and what is flown."""
    return plant_rows() + configuration_rows() + law_rows() + optimal_rows() + flown_rows()


def moving() -> tuple[go.Solution, View]:
    """Return what a film shows: the slew that is followed."""
    return solved("prompt"), View(attitude="q_BO")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a row does not pass."""
    from problems.flexible_spacecraft.plots import write_figures

    return run_comparison(
        "flexible_spacecraft", "Flexible spacecraft", comparison, write_figures, arguments, flown=flown
    )
