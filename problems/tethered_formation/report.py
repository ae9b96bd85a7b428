"""What ``python -m problems.tethered_formation`` shows: every row of the comparison."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gnc_opt.report import write_report
from problems.comparison import Row, run_comparison
from problems.fronts import Front
from problems.tethered_formation.flown import flown, flown_rows
from problems.tethered_formation.optimal import front as optimal_front
from problems.tethered_formation.optimal import optimal_rows, optimum, track
from problems.tethered_formation.published import data_rows, law_rows, plant_rows, result_rows, study_rows
from problems.tethered_formation.runs import comparison as laws


def comparison() -> list[Row]:
    """Return every row: plant, law, results, studies, optima, and what is flown."""
    runs = laws()
    published = data_rows() + plant_rows() + law_rows() + result_rows(runs) + study_rows(runs["MPC"])
    return published + optimal_rows(runs["MPC"]) + flown_rows()


def front() -> Front:
    """Return what less time costs."""
    return optimal_front(laws()["MPC"])


def write_figures(folder: Path) -> list[Path]:
    """Write the optimal solutions and all figures; return the figures' paths."""
    from problems.tethered_formation import plots

    optima = {name: optimum(name) for name in ("time", "effort", "planned")}
    for name, best in optima.items():
        write_report(best.solution, best.verdict, folder / name)
    return plots.write_figures(folder, laws(), optima, track(optima["planned"].solution, "published"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a row does not pass."""
    return run_comparison(
        "tethered_formation", "Tethered pair", comparison, write_figures, arguments, flown=flown
    )
