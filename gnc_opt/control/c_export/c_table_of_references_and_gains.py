"""Table of a controller's schedule in C, with one row per control step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gnc_opt.argument_checks import read_float_array
from gnc_opt.array_types import Array
from gnc_opt.control.c_export.c_statement_generation import CFloatType
from gnc_opt.control.discrete_time_controller import Controller
from gnc_opt.errors import ArgumentError, quote_value
from gnc_opt.model.model_variables import Layout
from gnc_opt.numerical_tolerances import ROUNDING, max_norm

_TABLE_MAX_ENTRIES = 50_000_000
"""Largest number of table entries; larger sources exceed the capacity of compilers."""


@dataclass(frozen=True, eq=False)
class CScheduleTable:
    """Schedule rows (n_rows, n_signals) at multiples of the control step from ``first`` (s); the last one remains."""

    first: float
    rows: Array
    layout: Layout

    def count_schedule_table_bytes(self, numbers: CFloatType) -> int:
        return self.rows.size * numbers.float_size_bytes

    def write_schedule_table_code(self, numbers: CFloatType) -> list[str]:
        """Return the C code of the tables and of ``static void look_up(long row, real_t *r)``."""
        if self.layout.size == 0:
            return [
                "static void look_up(long row, real_t *r)",
                "{",
                "    (void)row;",
                "    (void)r;",
                "}",
                "",
            ]
        return [
            numbers.write_c_array_definition("schedule", self.rows),
            "",
            f"static void look_up(long row, {numbers.type} *r)",
            "{",
            "    int i;",
            f"    for (i = 0; i < {self.layout.size}; ++i)",
            "        r[i] = schedule[row][i];",
            "}",
            "",
        ]


def tabulate_references_and_gains(
    controller: Controller, dt: float, span: tuple[float, float] | None
) -> CScheduleTable:
    if controller.signals.size == 0:
        return CScheduleTable(0.0, np.zeros((1, 0)), controller.signals)
    interval = controller.span if span is None else span
    if interval is None:
        raise ArgumentError(
            f"the schedule of '{controller.name}' has no known end: give export_c(..., span=(t_0, t_f))."
        )
    ends = read_float_array(interval, "the span of a schedule").ravel()
    if ends.size != 2 or not (np.isfinite(ends).all() and ends[0] <= ends[1]):
        raise ArgumentError(
            f"the span of a schedule is {quote_value(interval)}: give finite times (t_0, t_f), t_0 <= t_f."
        )
    first, last = (float(t) for t in ends)
    # tolerance of rounding: a row at the end itself belongs to the tail
    count = int(np.ceil((last - first) / dt - 1e-9)) + 1
    if count * controller.signals.size > _TABLE_MAX_ENTRIES:
        raise ArgumentError(
            f"the schedule of '{controller.name}' has {count} rows from {first:g} s to {last:g} s, too many for a "
            "table: give a shorter span."
        )
    times = first + dt * np.append(np.arange(count + 1), count + 1000)
    rows = controller.schedule(times, dt).T
    change = max_norm(rows[count:] - rows[count - 1])
    if change > ROUNDING * max(max_norm(rows[count - 1]), 1.0):
        raise ArgumentError(
            f"the schedule of '{controller.name}' still changes by {change:.3g} after {last:g} s: "
            "give a span that holds all its changes."
        )
    return CScheduleTable(first, rows[:count], controller.signals)
