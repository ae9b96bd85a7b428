"""What ``python -m problems.reaction_wheels`` shows: the published slews, then the optimal ones and their tracking."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

import gnc_opt as go
from gnc_opt.report import write_report
from problems.comparison import show, write_json
from problems.reaction_wheels.limits import angle_left
from problems.reaction_wheels.model import RPM, WHEEL_INERTIA
from problems.reaction_wheels.optimal import (
    MANOEUVRE,
    REFERENCE,
    SLEWS,
    TRACKED,
    fastest_wheel,
    optimal_slew,
    track,
)
from problems.reaction_wheels.published import rows
from problems.reaction_wheels.runs import published_slew


@dataclass(frozen=True)
class Optimal:
    """An optimal slew beside the published one of the same manoeuvre.

    Attributes
    ----------
    name : str
    objective, published : float
        Time to rest against the published settling time (s), or energy against the published law's (N^2 m^2 s).
    unit : str
    peak_speed, published_peak : float
        rpm.
    ok : bool
        The verdict.
    open : tuple of str
        Conditions that cannot be told.
    """

    name: str
    objective: float
    published: float
    unit: str
    peak_speed: float
    published_peak: float
    ok: bool
    open: tuple[str, ...]

    @property
    def ratio(self) -> float:
        """Ours over the published one."""
        return self.objective / self.published


def optimal_rows() -> list[Optimal]:
    """Solve and judge all optimal slews."""
    found = []
    for name in SLEWS:
        solution = optimal_slew(name)
        verdict = go.verify(solution)
        published = published_slew(MANOEUVRE[name], "FLC")
        in_time = name.startswith("time")
        found.append(
            Optimal(
                f"{name} (manoeuvre {MANOEUVRE[name]})",
                solution.objective,
                published.settling_time if in_time else published.energy,
                "s" if in_time else "N^2 m^2 s",
                fastest_wheel(solution),
                published.peak_speed,
                verdict.ok,
                tuple(c.name for c in verdict.untold),
            )
        )
    return found


@dataclass(frozen=True)
class Tracked:
    """How an optimal slew ends in closed loop.

    Attributes
    ----------
    name, outcome : str
    angle, rate : float
        Errors at the end of the slew, deg and deg/s.
    angle_later, rate_later : float
        30 s later.
    peak_speed : float
        rpm.
    saturated : float
        Longest time that a wheel's torque was limited, s.
    """

    name: str
    outcome: str
    angle: float
    rate: float
    angle_later: float
    rate_later: float
    peak_speed: float
    saturated: float


def tracked_rows() -> list[Tracked]:
    """Fly the optimal slews that leave torque for feedback."""
    found = []
    for name in TRACKED:
        run, end = track(name)
        k = int(np.argmin(np.abs(run.times - end)))
        rates = np.degrees(np.linalg.norm(run.error("omega").values, axis=0))
        found.append(
            Tracked(
                name,
                str(run.outcome),
                float(np.degrees(run.attitude_error("q", at=end))),
                float(rates[k]),
                angle_left(run),
                float(rates[-1]),
                float(np.max(np.abs(run.state("h").values))) / WHEEL_INERTIA / RPM,
                float(np.max(run.saturation_time("T"))),
            )
        )
    return found


# --- output ---------------------------------------------------------------------------------------------


def main(arguments: Sequence[str] | None = None) -> int:
    """Reproduce, optimise, track; see ``python -m problems.reaction_wheels --help``.

    Returns
    -------
    int
        0; 1 if a number misses its tolerance or a verdict fails.
    """
    options = _parser().parse_args(arguments)
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = 170
    try:
        found, optimal, tracked = rows(), optimal_rows(), tracked_rows()
    except go.SolveError as error:
        print(error, file=sys.stderr)
        return 1
    show(console, found, "published slews")
    console.print(_optimal_table(optimal))
    console.print(_tracked_table(tracked))
    reproduced = REFERENCE.agrees(optimal[0].objective)
    fine = all(row.passes for row in found) and all(slew.ok for slew in optimal) and reproduced
    console.print(
        f"{sum(slew.ok for slew in optimal)} of {len(optimal)} verdicts ok: {'pass' if fine else 'FAIL'}",
        markup=False,
    )
    if options.json is not None:
        write_json(
            options.json,
            found,
            optimal=[{**asdict(row), "ratio": row.ratio} for row in optimal],
            tracked=[asdict(row) for row in tracked],
        )
    if options.report is not None:
        from problems.reaction_wheels.plots import write_figures

        paths = write_figures(options.report)
        for name in SLEWS:
            solution = optimal_slew(name)
            folder = options.report / name.replace(",", "").replace(" ", "_")
            paths += write_report(solution, go.verify(solution), folder)
        console.print(f"report: {len(paths)} files in {options.report}", markup=False)
    return 0 if fine else 1


def _optimal_table(found: Sequence[Optimal]) -> Table:
    table = _table(
        "optimal slews against the published FLC", "slew", "objective", "published", "unit", "ratio", "peak rpm",
        "published rpm", "verdict", "cannot be told",
    )  # fmt: skip
    for row in found:
        numbers = (f"{row.objective:.8g}", f"{row.published:.6g}", row.unit, f"{row.ratio:.4f}")
        speeds = (f"{row.peak_speed:.0f}", f"{row.published_peak:.0f}")
        table.add_row(row.name, *numbers, *speeds, "ok" if row.ok else "NOT ok", ", ".join(row.open))
    return table


def _tracked_table(found: Sequence[Tracked]) -> Table:
    table = _table(
        "optimal slews tracked with 0.54 deg of error at the start, 5 % of inertia, and a constant torque",
        "slew", "outcome", "deg at end", "deg/s", "deg 30 s later", "deg/s", "peak rpm", "limited, s",
    )  # fmt: skip
    for row in found:
        errors = (f"{value:.2g}" for value in (row.angle, row.rate, row.angle_later, row.rate_later))
        table.add_row(row.name, row.outcome, *errors, f"{row.peak_speed:.0f}", f"{row.saturated:.2f}")
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", pad_edge=False)
    for column in columns:
        table.add_column(column)
    return table


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m problems.reaction_wheels",
        description="Slews with a pyramid of four reaction wheels: published laws and optimal trajectories.",
    )
    parser.add_argument(
        "--report", type=Path, metavar="DIR", help="write figures and the optimal solutions to a folder"
    )
    parser.add_argument("--json", type=Path, metavar="OUT", help="write all tables to a file")
    return parser
