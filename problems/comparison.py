"""The comparison table: what was expected, what came out, and whether that is good enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Console
from rich.table import Table


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


def show(console: Console, rows: Sequence[Row], title: str) -> None:
    """Print the table."""
    table = Table(title=title, title_justify="left", pad_edge=False, box=None)
    for heading in ("quantity", "publication", "expected", "ours", "difference", "", "reason"):
        table.add_column(heading, overflow="fold")
    for row in rows:
        mark = {True: "pass", False: "FAIL", None: "-"}[row.passes]
        table.add_row(row.quantity, row.published, row.expected, row.ours, row.difference, mark, row.reason)
    console.print(table, markup=False)
