"""Comparison with a publication: expected, ours, good enough or not; and the ``main`` of such a system.

A `Number` is one number and judges itself; a `Row` is a line of text, also for several numbers or a condition.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Console
from rich.table import Table

_WIDTH = 170
"""Columns where the output is no terminal."""


@dataclass(frozen=True)
class Number:
    """One number.

    Attributes
    ----------
    quantity : str
    expected, ours : float
    tolerance : float or None
        Absolute; ``None``: shown, not asserted. With ``below``, ours must not exceed ``expected``.
    published : str
        What the publication says, in words.
    reason : str
        Why there is a difference, or nothing is asserted.
    below : bool
    unit : str
        If the quantity's name does not tell it.
    source : str
        Where ``expected`` comes from.
    """

    quantity: str
    expected: float
    ours: float
    tolerance: float | None = None
    published: str = ""
    reason: str = ""
    below: bool = False
    unit: str = ""
    source: str = ""

    @property
    def passes(self) -> bool | None:
        """Whether it is close enough; ``None`` where nothing is asserted."""
        if self.below:
            return bool(self.ours <= self.expected)
        if self.tolerance is None:
            return None
        if not np.isfinite(self.expected):
            return bool(self.ours == self.expected)
        return bool(abs(self.ours - self.expected) <= self.tolerance)


@dataclass(frozen=True)
class Row:
    """One line.

    Attributes
    ----------
    quantity : str
        With its unit.
    published : str
        As printed in the publication; empty if it says nothing.
    expected : str
        By an independent calculation of the same case, or from theory.
    ours : str
    difference : str
        Of ours from what is expected.
    passes : bool or None
        ``None``: nothing is asserted.
    reason : str
        Why ours differs from the publication, or is not asserted.
    """

    quantity: str
    published: str
    expected: str
    ours: str
    difference: str
    passes: bool | None
    reason: str = ""


def compare(
    quantity: str,
    expected: ArrayLike,
    ours: ArrayLike,
    *,
    relative: float = 0.0,
    absolute: float = 0.0,
    published: str = "",
    reason: str = "",
) -> Row:
    """Return the row of numbers that must agree, each within the larger of the two tolerances."""
    wanted, found = np.atleast_1d(np.asarray(expected, float)), np.atleast_1d(np.asarray(ours, float))
    allowed = np.maximum(relative * np.abs(wanted), absolute)
    off = found - wanted
    worst = int(np.argmax(np.abs(off) / allowed))
    difference = f"{off[worst]:+.1e}" if not relative else f"{100 * off[worst] / abs(wanted[worst]):+.2f} %"
    passes = bool(np.all(np.abs(off) <= allowed))
    return Row(quantity, published, numbers(wanted), numbers(found), difference, passes, reason)


def require(
    quantity: str, condition: str, ours: ArrayLike, holds: bool, *, published: str = "", reason: str = ""
) -> Row:
    """Return the row of a condition that must hold."""
    return Row(quantity, published, condition, numbers(ours), "", bool(holds), reason)


def remark(quantity: str, published: str, ours: ArrayLike, reason: str) -> Row:
    """Return the row of a number that is shown, not asserted."""
    return Row(quantity, published, "", numbers(ours), "", None, reason)


def numbers(values: ArrayLike) -> str:
    """Return numbers with four to seven digits."""
    array = np.atleast_1d(np.asarray(values, dtype=float))
    return ", ".join("> span" if np.isinf(v) else f"{v:.5g}" for v in array)


def run_comparison(
    name: str,
    title: str,
    comparison: Callable[[], list[Row]],
    write_figures: Callable[[Path], list[Path]],
    arguments: Sequence[str] | None = None,
) -> int:
    """Print the table of a published system, and write JSON and figures if asked to.

    Parameters
    ----------
    name, title : str
        Of the module in ``problems``, and of the table.
    comparison, write_figures : callable
        The rows, and the figures in a folder.
    arguments : sequence of str, optional
        Of the command line, without the program's name; default ``sys.argv[1:]``.

    Returns
    -------
    int
        0; 1 if a number that is asserted misses its tolerance.
    """
    parser = argparse.ArgumentParser(prog=f"python -m problems.{name}", description=title)
    parser.add_argument("--report", type=Path, metavar="DIR", help="write the figures to a folder")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the table to a file")
    options = parser.parse_args(arguments)
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, _WIDTH)
    rows = comparison()
    show(console, rows, title)
    failed = [row.quantity for row in rows if row.passes is False]
    asserted = sum(row.passes is not None for row in rows)
    console.print(f"{asserted - len(failed)} of {asserted} asserted numbers pass", markup=False)
    if options.json is not None:
        told = {"rows": [asdict(row) for row in rows], "asserted": asserted, "failed": failed}
        options.json.write_text(json.dumps(told, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    if options.report is not None:
        paths = write_figures(options.report)
        console.print(f"report: {len(paths)} figures in {options.report}", markup=False)
    return 1 if failed else 0


def show(console: Console, rows: Sequence[Row], title: str) -> None:
    """Print the table."""
    table = Table(title=title, title_justify="left", pad_edge=False, box=None)
    for heading in ("quantity", "publication", "expected", "ours", "difference", "", "reason"):
        table.add_column(heading, overflow="fold")
    for row in rows:
        mark = {True: "pass", False: "FAIL", None: "-"}[row.passes]
        table.add_row(row.quantity, row.published, row.expected, row.ours, row.difference, mark, row.reason)
    console.print(table, markup=False)
