"""Comparison with a publication and with an independent computation, each marked for itself; ``main`` of such a system.

A `Row` is one line: ours, what the publication prints, what an independent computation gives. The two are judged apart:
a number may be right and still differ from the print, and then the row has to say why.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Console
from rich.table import Table

from gnc_opt.errors import GncOptError

_WIDTH = 170
"""Columns where the output is no terminal."""


@dataclass(frozen=True)
class Claim:
    """What somebody else says about a quantity, and whether ours agrees.

    Attributes
    ----------
    text : str
        Numbers or words.
    agrees : bool
    difference, allowed : str
        Of ours from it, where it is largest by what is allowed; empty for words.
    """

    text: str
    agrees: bool
    difference: str = ""
    allowed: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "agrees", bool(self.agrees))  # NumPy's are not written to JSON


@dataclass(frozen=True)
class Row:
    """One line.

    Attributes
    ----------
    quantity : str
        With its unit.
    ours : tuple of float
    published : Claim or None
        Of the publication; ``None`` if it says nothing.
    independent : Claim or None
        Of an independent computation or of theory; ``None``: nothing is known, ours is shown only.
    reason : str
        Why ours differs from the publication; there if and only if it does.
    note : str
        Anything else.
    """

    quantity: str
    ours: tuple[float, ...]
    published: Claim | None = None
    independent: Claim | None = None
    reason: str = ""
    note: str = ""

    @property
    def differs(self) -> bool:
        """Whether ours differs from the publication."""
        return self.published is not None and not self.published.agrees

    @property
    def passes(self) -> bool:
        """Whether the independent computation agrees, if there is one, and a reason stands where one is due only."""
        right = self.independent is None or self.independent.agrees
        return right and self.differs == bool(self.reason)


# --- rows -----------------------------------------------------------------------------------------------


def compare(
    quantity: str,
    expected: ArrayLike,
    ours: ArrayLike,
    *,
    relative: float = 0.0,
    absolute: float = 0.0,
    published: str | Claim = "",
    reason: str = "",
    note: str = "",
) -> Row:
    """Return the row of numbers computed independently, each to be met within the larger of the two tolerances.

    Numbers in ``published`` are judged by their digits, see `printed`.
    """
    independent = _judge(numbers(expected), expected, ours, relative, absolute)
    return Row(quantity, tuple(_array(ours)), _claim(published, ours), independent, reason, note)


def require(
    quantity: str,
    condition: str,
    ours: ArrayLike,
    holds: bool,
    *,
    published: str | Claim = "",
    reason: str = "",
    note: str = "",
) -> Row:
    """Return the row of a condition that must hold; words in ``published`` say the same as it."""
    said = Claim(published, bool(holds)) if isinstance(published, str) and published else published
    return Row(quantity, tuple(_array(ours)), _claim(said, ours), Claim(condition, bool(holds)), reason, note)


def at_most(quantity: str, limit: float, ours: float, *, published: str = "") -> Row:
    """Return the row of a number that must not exceed a limit."""
    return require(quantity, f"<= {limit:g}", ours, bool(ours <= limit), published=published)


def remark(
    quantity: str, ours: ArrayLike, *, published: str | Claim = "", reason: str = "", note: str = ""
) -> Row:
    """Return the row of what was not computed independently."""
    return Row(quantity, tuple(_array(ours)), _claim(published, ours), None, reason, note)


def printed(text: str, ours: ArrayLike, within: float | None = None) -> Claim:
    """Return how printed numbers compare: ours agree within one unit of the last digit of each.

    A publication rounds or cuts off, which is less than a unit either way. ``within`` is for texts such as "about 70".
    """
    digits = re.findall(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?", text)
    units = [10.0 ** int(Decimal(number).as_tuple().exponent) for number in digits]
    values = [float(number) for number in digits]
    if len(values) != _array(ours).size:
        raise ValueError(f"{text!r} has {len(values)} numbers, ours {_array(ours).size}: give a Claim")
    return _judge(text, values, ours, 0.0, units if within is None else within)


def numbers(values: ArrayLike) -> str:
    """Return numbers with up to seven digits."""
    return ", ".join("> span" if np.isinf(v) else f"{v:.7g}" for v in _array(values))


def _claim(said: str | Claim, ours: ArrayLike) -> Claim | None:
    if isinstance(said, Claim):
        return said
    return printed(said, ours) if said else None


def _judge(text: str, claimed: ArrayLike, ours: ArrayLike, relative: float, absolute: ArrayLike) -> Claim:
    wanted, found = np.broadcast_arrays(_array(claimed), _array(ours))
    size = np.where(np.isfinite(wanted), np.abs(wanted), 0.0)
    slack = np.maximum(relative * size, _array(absolute)) * (1 + 1e-9)  # 1.8255 is within 0.0005 of 1.825
    off = np.subtract(
        found, wanted, out=np.zeros(found.shape), where=wanted != found
    )  # 0 if both are infinite
    far = np.nan_to_num(np.abs(off) / np.maximum(slack, 1e-300), nan=np.inf)
    worst = int(np.argmax(far))
    unit = size[worst] / 100 if size[worst] else 1.0
    sign = " %" if size[worst] else ""
    told = (f"{off[worst] / unit:+.3g}{sign}", f"{slack[worst] / unit:.2g}{sign}")
    return Claim(text, bool(np.all(np.abs(off) <= slack)), *told)


def _array(values: ArrayLike) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.atleast_1d(np.asarray(values, dtype=float))


# --- the table ------------------------------------------------------------------------------------------


def run_comparison(
    name: str,
    title: str,
    comparison: Callable[[], list[Row]],
    write_figures: Callable[[Path], list[Path]],
    arguments: Sequence[str] | None = None,
    *,
    flown: Callable[[Sequence[str]], list[Row]] | None = None,
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
    flown : callable, optional
        The rows of the flown comparison under other conditions, from the texts ``NAME=VALUE`` of ``--set``. Nothing
        else is shown then, since what is known holds for the default conditions only.

    Returns
    -------
    int
        0; 1 if a row does not pass; 2 if a setting is refused.
    """
    parser = argparse.ArgumentParser(prog=f"python -m problems.{name}", description=title)
    parser.add_argument("--report", type=Path, metavar="DIR", help="write the figures to a folder")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the table to a file")
    if flown is not None:
        parser.add_argument(
            "--set", action="append", default=[], metavar="NAME=VALUE",
            help="fly plans and published law under another law, gain, disturbance or seed, and show that only",
        )  # fmt: skip
    options = parser.parse_args(arguments)
    settings: list[str] = options.set if flown is not None else []
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, _WIDTH)
    try:
        rows = flown(settings) if flown is not None and settings else comparison()
    except GncOptError as error:
        print(error, file=sys.stderr)
        return 2 if settings else 1
    show(console, rows, f"{title}, {', '.join(settings)}" if settings else title)
    if options.json is not None:
        write_json(options.json, rows, settings=settings)
    if options.report is not None:
        paths = write_figures(options.report)
        console.print(f"report: {len(paths)} figures in {options.report}", markup=False)
    return 0 if all(row.passes for row in rows) else 1


def show(console: Console, rows: Sequence[Row], title: str) -> None:
    """Print the table, and the count below it."""
    table = Table(title=title, title_justify="left", pad_edge=False, box=None)
    for heading in (
        "quantity",
        "ours",
        "publication",
        "",
        "independent",
        "",
        "reason of the difference; note",
    ):
        table.add_column(heading, overflow="fold")
    for row in rows:
        text = "; ".join(part for part in (row.reason, row.note) if part)
        if not row.reason and row.differs:
            text = "; ".join(("NO REASON", *filter(None, [row.note])))
        elif row.reason and not row.differs:
            text = f"NO DIFFERENCE: {text}"
        cells = (*_cells(row.published, "differs"), *_cells(row.independent, "FAIL"))
        table.add_row(row.quantity, numbers(row.ours), *cells, text)
    console.print(table, markup=False)
    console.print(count(rows), markup=False, soft_wrap=True)


def _cells(claim: Claim | None, otherwise: str) -> tuple[str, str]:
    if claim is None:
        return "", ""
    size = f" {claim.difference} (allowed {claim.allowed})" if claim.difference else ""
    return claim.text, f"{'agrees' if claim.agrees else otherwise}{size}"


def count(rows: Sequence[Row]) -> str:
    """Return the line below the table: how many agree with the publication, and with the independent computation."""
    told = summary(rows)
    publication, independent = told["publication"], told["independent"]
    line = (
        f"{publication['agree']} of {publication['compared']} agree with the publication, "
        f"{publication['differ_with_reason']} differ for stated reasons; "
        f"{independent['agree']} of {independent['compared']} agree with the independent computation"
    )
    return line + (f"; FAIL: {', '.join(told['failed'])}" if told["failed"] else "")


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Return what the JSON of every system has: the rows, both counts, and the quantities that fail."""
    published = [row for row in rows if row.published is not None]
    independent = [row.independent for row in rows if row.independent is not None]
    return {
        "rows": [
            {**asdict(row), "ours": [float(v) if np.isfinite(v) else None for v in row.ours]} for row in rows
        ],
        "publication": {
            "compared": len(published),
            "agree": sum(not row.differs for row in published),
            "differ_with_reason": sum(row.differs and bool(row.reason) for row in published),
        },
        "independent": {"compared": len(independent), "agree": sum(claim.agrees for claim in independent)},
        "failed": [row.quantity for row in rows if not row.passes],
    }


def write_json(path: Path, rows: Sequence[Row], **more: Any) -> None:
    """Write `summary`, and what else a system has to tell."""
    told = {**summary(rows), **more}
    path.write_text(json.dumps(told, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
