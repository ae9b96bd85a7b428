"""Rows that compare a computed quantity with a publication and with an independent computation.

What is known of a quantity is data, in ``SYSTEM.json``: what the publication prints, what an independent computation
gives and how closely it has to be met, and why the two differ where they do. `compare` joins it with computed values.
The two comparisons are separate: a number may be right and still differ from the print, and then a reason is required.
"""

from __future__ import annotations

import json
import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass
from decimal import Decimal
from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.spacecraft import quaternion_product

FOLDER = Path(__file__).parent
_OPERATORS: dict[str, Callable[[Any, Any], Any]] = {"<": operator.lt, "<=": operator.le, ">": operator.gt}


@dataclass(frozen=True)
class Claim:
    """What somebody else states about a quantity, in numbers or words, and whether ours agrees.

    The difference of ours is that which is largest relative to what is allowed; both are empty for words.
    """

    text: str
    agrees: bool
    difference: str = ""
    allowed: str = ""


@dataclass(frozen=True)
class Row:
    """A quantity with its unit and both comparisons.

    ``independent`` is a claim of an independent computation or of theory. A ``reason`` why ours differs from the
    publication is there if and only if it does.
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
        """Whether ours agrees with the independent computation, and a reason is given exactly where one is due."""
        right = self.independent is None or self.independent.agrees
        return right and self.differs == bool(self.reason)


@dataclass(frozen=True)
class Value:
    """A computed quantity, named as in the system's data, and what the computation adds to the data's note.

    ``holds``: whether the condition, or the statement, that the data give in words holds; needed where they do.
    """

    quantity: str
    ours: ArrayLike
    holds: bool | None = None
    note: str = ""


@dataclass(frozen=True)
class FlightMeasures:
    """Measures of a run in closed loop: settling time (s), effort and final error, in the system's units."""

    time: float
    effort: float
    miss: float


def flight_values(
    what: str, names: tuple[str, str, str], plan: FlightMeasures, law: FlightMeasures
) -> Iterator[Value]:
    """Yield, for each measure (its name and unit), that of a plan, of the published controller, and their ratio."""
    for name, ours, theirs in zip(names, astuple(plan), astuple(law), strict=True):
        ratio = ours / theirs if np.isfinite(theirs) and theirs else float("nan")
        yield Value(f"{what}, flown: {name}; published law; ratio", (ours, theirs, ratio))


def verdict_value(quantity: str, verdict: go.Verdict) -> Value:
    """Return whether an optimality check passes, with the conditions that fail or are inconclusive."""
    failing = ", ".join(c.name for c in (*verdict.failed, *verdict.inconclusive))
    return Value(quantity, float(verdict.ok), verdict.ok, failing)


def outcome_value(what: str, run: go.Run) -> Value:
    """Return whether a run in closed loop reached its end."""
    return Value(f"{what}, flown: outcome", float(run.outcome.ok), run.outcome.ok)


def last_beyond(times: Array, distance: Array, band: float) -> float:
    """Return the last time (s) at which a distance exceeds a band: 0 if it never does, inf if it still does."""
    beyond = np.flatnonzero(distance > band)
    if beyond.size == 0:
        return 0.0
    return float("inf") if beyond[-1] == times.size - 1 else float(times[beyond[-1]])


def small_turn(q: Any, angle: Any) -> Any:
    """Return an attitude turned by a small rotation vector (rad) in its own axes, to first order."""
    return quaternion_product(q, ca.vertcat(1, 0.5 * angle))


def known(system: str) -> list[dict[str, Any]]:
    """Return what is known of a system, a dictionary per row, in the order of its table.

    Keys: ``quantity``; ``constants``, names in the system's modules, ``divided_by`` a number, if that is all that there
    is of ours (none if the list is empty), then also ``ours``; of the publication ``published`` (numbers, met within a
    unit of their last digit, or ``within``) or ``statement`` (words; ``agrees`` if that is fixed) with ``reason``; of
    the independent computation ``independent`` with ``relative`` and ``absolute`` tolerances (the larger counts),
    ``at_most`` (a limit), or ``condition`` (words, or ``< 1`` and the like); ``note``.
    """
    rows: list[dict[str, Any]] = json.loads((FOLDER / f"{system}.json").read_text(encoding="utf-8"))
    for row in rows:
        if "constants" in row:
            values = [np.ravel(_constant(system, name)) for name in row["constants"]]
            row["ours"] = np.concatenate([[], *values]) / row.get("divided_by", 1.0)
    return rows


def _constant(system: str, name: str) -> ArrayLike:
    module, _, place = name.partition(".")
    found: ArrayLike = operator.attrgetter(place)(import_module(f"problems.{system}.{module}"))
    return found


def compare(rows: Sequence[Mapping[str, Any]], values: Iterable[Value]) -> list[Row]:
    """Return the rows of a table.

    Raises
    ------
    ValueError
        The values are not those of the rows without ``ours``, in their order.
    """
    computed = list(values)
    wanted = [row["quantity"] for row in rows if "ours" not in row]
    found = [value.quantity for value in computed]
    if wanted != found:
        first = next((i for i, (a, b) in enumerate(zip(wanted, found, strict=False)) if a != b), len(found))
        here = found[first] if first < len(found) else "nothing"
        there = wanted[first] if first < len(wanted) else "nothing"
        raise ValueError(
            f"row {first + 1} is {there!r} in the data and {here!r} computed: make both the same."
        )
    left = iter(computed)
    return [_row(row, Value(row["quantity"], row["ours"]) if "ours" in row else next(left)) for row in rows]


def _row(known: Mapping[str, Any], value: Value) -> Row:
    note = "; ".join(filter(None, (known.get("note"), value.note)))
    claims = _published(known, value), _independent(known, value)
    return Row(value.quantity, tuple(_array(value.ours)), *claims, known.get("reason", ""), note)


def _published(known: Mapping[str, Any], value: Value) -> Claim | None:
    if "published" in known:
        return printed(known["published"], value.ours, known.get("within"))
    if "statement" in known:
        return Claim(known["statement"], _holds(known["statement"], known.get("agrees"), value))
    return None


def _independent(known: Mapping[str, Any], value: Value) -> Claim | None:
    if "independent" in known:
        expected, tolerances = known["independent"], (known.get("relative", 0.0), known.get("absolute", 0.0))
        return difference(numbers(expected), expected, value.ours, *tolerances)
    if "at_most" in known:
        limit = known["at_most"]
        return Claim(f"<= {limit:g}", bool(np.all(_array(value.ours) <= limit)))
    if "condition" in known:
        return Claim(known["condition"], _holds(known["condition"], None, value))
    return None


def _holds(words: str, fixed: bool | None, value: Value) -> bool:
    """Whether a statement holds: as is fixed, as was computed, or by the comparison that it is."""
    if fixed is not None:
        return fixed
    if value.holds is not None:
        return bool(value.holds)
    sign, _, limit = words.partition(" ")
    if sign not in _OPERATORS:
        raise ValueError(f"{value.quantity!r}: whether {words!r} holds has to be computed: give `holds`.")
    return bool(np.all(_OPERATORS[sign](_array(value.ours), float(limit))))


def printed(text: str, ours: ArrayLike, within: float | None = None) -> Claim:
    """Return how printed numbers compare: ours agree within one unit of the last digit of each.

    A publication rounds or cuts off, which is less than a unit either way. ``within`` is for texts such as "about 70".
    """
    digits = re.findall(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?", text)
    units = [10.0 ** int(Decimal(number).as_tuple().exponent) for number in digits]
    if len(digits) != _array(ours).size:
        raise ValueError(f"{text!r} has {len(digits)} numbers, ours {_array(ours).size}: give a statement.")
    return difference(
        text, [float(number) for number in digits], ours, 0.0, units if within is None else within
    )


def difference(text: str, claimed: ArrayLike, ours: ArrayLike, relative: float, absolute: ArrayLike) -> Claim:
    """Return how ours compare with claimed numbers, each within the larger of two tolerances."""
    wanted, found = np.broadcast_arrays(_array(claimed), _array(ours))
    size = np.where(np.isfinite(wanted), np.abs(wanted), 0.0)
    slack = np.maximum(relative * size, _array(absolute)) * (1 + 1e-9)  # 1.8255 is within 0.0005 of 1.825
    off = np.subtract(
        found, wanted, out=np.zeros(found.shape), where=wanted != found
    )  # 0 if both are infinite
    share = np.nan_to_num(np.abs(off) / np.maximum(slack, 1e-300), nan=np.inf)
    worst = int(np.argmax(share))
    unit, sign = (size[worst] / 100, " %") if size[worst] else (1.0, "")
    results = (f"{off[worst] / unit:+.3g}{sign}", f"{slack[worst] / unit:.2g}{sign}")
    return Claim(text, bool(np.all(np.abs(off) <= slack)), *results)


def numbers(values: ArrayLike) -> str:
    """Return numbers with up to seven digits."""
    return ", ".join("> span" if np.isinf(v) else f"{v:.7g}" for v in _array(values))


def _array(values: ArrayLike) -> Array:
    return np.atleast_1d(np.asarray(values, dtype=float))


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the rows as JSON values, the counts of both comparisons, and the quantities that fail."""
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
