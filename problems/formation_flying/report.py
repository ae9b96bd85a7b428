"""What ``python -m problems.formation_flying`` shows: every row of the comparison."""

from __future__ import annotations

from collections.abc import Sequence

import gnc_opt as go
from gnc_opt.plot import View
from problems.comparison import Row, run_comparison
from problems.formation_flying.flown import flown, flown_rows
from problems.formation_flying.optimal import front, optimal_rows, plan
from problems.formation_flying.published import (
    claim_rows,
    course_rows,
    data_rows,
    sweep_rows,
    switching_rows,
    table_rows,
    truth_rows,
)

__all__ = ["comparison", "front", "main", "moving"]


def comparison() -> list[Row]:
    """Return every row: publication, courses, switching, inertial truth, phases, the optima, and what is flown."""
    published = (
        data_rows()
        + table_rows()
        + course_rows()
        + switching_rows()
        + truth_rows()
        + sweep_rows()
        + claim_rows()
    )
    return published + optimal_rows() + flown_rows()


def moving() -> tuple[go.Solution, View]:
    """Return what a film shows: the least time to the formation."""
    return plan("least time").solution, View("r", force="a")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a row does not pass."""
    from problems.formation_flying.plots import write_figures

    return run_comparison(
        "formation_flying", "Formation flying", comparison, write_figures, arguments, flown=flown
    )
