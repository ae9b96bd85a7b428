"""What ``python -m problems.tethered_formation`` shows: every row of the comparison."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gnc_opt.report import write_report
from problems.comparison import Claim, Row, remark, run_comparison
from problems.tethered_formation.flown import flown, flown_rows
from problems.tethered_formation.optimal import optimal_rows, optimum, track
from problems.tethered_formation.published import law_rows, plant_rows, result_rows, study_rows
from problems.tethered_formation.runs import comparison as laws

NOT_REPRODUCED = {
    "any number of the publication's figures, digit by digit": "its equations and both tables of data are images that "
    "are lost; structure theirs, equations derived, data and gains chosen",
    "the rival scheme": "it is named, not described; switching and linear laws stand in its place",
    "exact tracking of the orbit later on": "impossible with this input: deflection costs speed along the orbit, "
    "and with that deficit r and swing cannot both be at their references",
}


def comparison() -> list[Row]:
    """Return every row: plant, law, results, studies, optima, and what is flown."""
    runs = laws()
    lost = [
        remark(what, (), published=Claim("claimed", False), reason=why)
        for what, why in NOT_REPRODUCED.items()
    ]
    published = plant_rows() + law_rows() + result_rows(runs) + study_rows(runs["MPC"]) + lost
    return published + optimal_rows(runs["MPC"]) + flown_rows()


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
