"""The schedule of flight code: a table of rows, whole or with what lies between knots interpolated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gnc_opt.arguments import read_numbers
from gnc_opt.arrays import Array, Indices
from gnc_opt.control.c_export.c_writer import CNumbers, wrapped
from gnc_opt.control.controller import Controller
from gnc_opt.errors import ArgumentError, shown
from gnc_opt.model.variables import Layout

_TAIL_TOLERANCE = 1e-12
_KEPT = ("_ref", "_ff")
"""Ends of the names of what is never interpolated: references and feedforwards, whose errors act undamped."""

_MOST_NUMBERS = 50_000_000
"""In a table at most: some gigabytes of source, which no compiler takes."""

_SHORT = 65535
"""The largest row that a short number holds."""

_INTERPOLATION = """
/* Between two knots, which are rows; how often the search halves depends on t alone. */
static real_t between(long row, const knot *knots, const real_t *values, int count)
{
    int low = 0, high = count - 1;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (knots[middle] <= row)
            low = middle;
        else
            high = middle;
    }
    if (high == low)
        return values[low];
    return values[low] + (values[high] - values[low]) * (real_t)(row - knots[low]) / (real_t)(knots[high] - knots[low]);
}
"""


@dataclass(frozen=True, eq=False)
class FlightTable:
    """Rows of a schedule.

    Attributes
    ----------
    first : float
        Time of the first row, s.
    rows : array (n_rows, n_signals)
        At multiples of the control step; the last of them good for ever.
    layout : Layout
        Of a row.
    tolerance : float
        Permitted error of what is interpolated, relative to the largest number of its column; 0: all rows are kept.
    """

    first: float
    rows: Array
    layout: Layout
    tolerance: float = 0.0

    @cached_property
    def knots(self) -> dict[int, Indices]:
        """Rows that are kept of the columns that are interpolated."""
        if self.tolerance == 0:
            return {}
        places = [self.layout.slice(n) for n in self.layout.names if not n.endswith(_KEPT)]
        columns = [k for place in places for k in range(place.start, place.stop)]
        return {k: _knots(self.rows[:, k], self.tolerance * np.max(np.abs(self.rows[:, k]))) for k in columns}

    @property
    def interpolated(self) -> Array:
        """The rows as flight code finds them again, (n_rows, n_signals)."""
        every, found = np.arange(len(self.rows)), self.rows.copy()
        for k, knots in self.knots.items():
            found[:, k] = np.interp(every, knots, self.rows[knots, k])
        return found

    @property
    def error(self) -> float:
        """Largest error of interpolation, relative to the largest number of its column."""
        scale = np.max(np.abs(self.rows), axis=0, initial=0.0)
        found = np.max(np.abs(self.interpolated - self.rows), axis=0, initial=0.0)
        return float(np.max(found / np.where(scale > 0, scale, 1.0), initial=0.0))

    def size(self, numbers: CNumbers) -> int:
        """Return its bytes."""
        knot = 2 if len(self.rows) <= _SHORT else 4
        whole = len(self.rows) * len(self._kept) * numbers.size
        return int(whole + sum(len(k) * (numbers.size + knot) for k in self.knots.values()))

    @property
    def operations(self) -> int:
        """Of a look-up beyond the copying of a row."""
        return sum(2 * int(np.ceil(np.log2(len(k) + 1))) + 5 for k in self.knots.values())

    def text(self, numbers: CNumbers) -> list[str]:
        """Return the C of the tables and of ``static void look_up(long row, real_t *r)``."""
        kept, knots = self._kept, self.knots
        if self.layout.size == 0:
            return []
        lines, body = [], ["    int i;"]
        if kept:
            lines.append(numbers.table("schedule", self.rows[:, kept]))
            place = "i" if kept == list(range(len(kept))) else "kept[i]"
            if place != "i":
                lines.append(f"static const int kept[] = {{{wrapped(map(str, kept))}}};")
            body += [f"    for (i = 0; i < {len(kept)}; ++i)", f"        r[{place}] = schedule[row][i];"]
        if knots:
            begin = np.cumsum([0, *(len(k) for k in knots.values())])
            every = [str(row) for k in knots.values() for row in k]
            values = np.concatenate([self.rows[k, column] for column, k in knots.items()])
            lines += [
                f"typedef unsigned {'short' if len(self.rows) <= _SHORT else 'int'} knot;",
                f"static const knot knots[] = {{{wrapped(every)}}};",
                numbers.table("values", values),
                f"static const int begin[] = {{{wrapped(map(str, begin))}}};",
                f"static const int column[] = {{{wrapped(map(str, knots))}}};",
                numbers.typed(_INTERPOLATION),
            ]
            body += [
                f"    for (i = 0; i < {len(knots)}; ++i)",
                "        r[column[i]] = between(row, &knots[begin[i]], &values[begin[i]], begin[i + 1] - begin[i]);",
            ]
        return [*lines, "", f"static void look_up(long row, {numbers.type} *r)", "{", *body, "}", ""]

    @property
    def _kept(self) -> list[int]:
        return [k for k in range(self.layout.size) if k not in self.knots]


def flight_table(
    controller: Controller, dt: float, span: tuple[float, float] | None, tolerance: float
) -> FlightTable:
    """Return the schedule of a controller as a table.

    Raises
    ------
    ArgumentError
        Nobody knows its span, or it still changes after it.
    """
    if controller.signals.size == 0:
        return FlightTable(0.0, np.zeros((1, 0)), controller.signals)
    found = controller.span if span is None else span
    if found is None:
        raise ArgumentError(
            f"the schedule of '{controller.name}' does not tell when it ends: give export_c(..., span=(t_0, t_f))."
        )
    ends = read_numbers(found, "the span of a schedule").reshape(-1)
    if ends.size != 2 or not (np.isfinite(ends).all() and ends[0] <= ends[1]):
        raise ArgumentError(
            f"the span of a schedule is {shown(found)}: give finite times (t_0, t_f), t_0 <= t_f."
        )
    first, last = (float(t) for t in ends)
    # rounding: a row at the end itself is of the tail; a little before it is not
    count = int(np.ceil((last - first) / dt - 1e-9)) + 1
    if count * controller.signals.size > _MOST_NUMBERS:
        raise ArgumentError(
            f"the schedule of '{controller.name}' has {count} rows from {first:g} s to {last:g} s, too many for a "
            "table: give a shorter span."
        )
    times = first + dt * np.append(np.arange(count + 1), count + 1000)
    try:
        rows = controller.schedule(times, dt).T
    except ArgumentError as error:
        raise ArgumentError(
            f"flight code goes on after {last:g} s, where the schedule of '{controller.name}' tells nothing: {error}"
        ) from error
    change = np.max(np.abs(rows[count:] - rows[count - 1]), initial=0.0)
    if change > _TAIL_TOLERANCE * max(np.max(np.abs(rows[count - 1]), initial=0.0), 1.0):
        raise ArgumentError(
            f"the schedule of '{controller.name}' still changes by {change:.3g} after {last:g} s: "
            "give a span that holds all its changes."
        )
    return FlightTable(first, rows[:count], controller.signals, tolerance)


def _knots(values: Array, permitted: float) -> Indices:
    """Return rows between which straight lines miss values (n_rows,) by no more than is permitted."""
    last, found = len(values) - 1, [0]
    while found[-1] < last:
        begin = found[-1]
        good, bad = begin + 1, last + 1
        while bad - good > 1:
            # in doubling steps, then by halving: the longest piece is not sought, a long one is enough
            trial = min(begin + 2 * (good - begin), last) if bad > last else (good + bad) // 2
            if _straight(values[begin : trial + 1], permitted):
                good = trial
            else:
                bad = trial
        found.append(good)
    return np.array(found)


def _straight(values: Array, permitted: float) -> bool:
    line = np.linspace(values[0], values[-1], len(values))
    return bool(np.all(np.abs(line - values) <= permitted))
