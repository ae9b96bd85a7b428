"""Design report: results of a controller design with names, values and units."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gnc_opt.argument_checks import StrictAttributes
from gnc_opt.array_types import Array
from gnc_opt.errors import unknown_name_error
from gnc_opt.numerical_tolerances import EQUAL, ROUNDING
from gnc_opt.text_html_and_json_formatting import format_html_heading, format_html_table

REPORT_VALUE_WIDTH = 44
"""Width of the value column in characters; longer values shift the unit to the right."""


@dataclass(frozen=True)
class ReportEntry:
    """One result of a design.

    Attributes
    ----------
    name : str
        Quantity, for example ``"closed-loop poles"``.
    value : float, complex, str, or an array of them
    unit : str
    remark : str
        Meaning or source of the value.

    Examples
    --------
    >>> for fact in regulator.explain().facts[3:5]:
    ...     print(fact.name, np.round(np.abs(fact.value), 3))
    gain [[0.918 1.636]]
    sampled poles [0.917 0.917]
    """

    name: str
    value: object
    unit: str = ""
    remark: str = ""

    def __str__(self) -> str:
        value = self.value if isinstance(self.value, str) else format_number(self.value)
        line = f"{self.name}: {value}{' ' + self.unit if self.unit else ''}"
        return f"{line} ({self.remark})" if self.remark else line


@dataclass(frozen=True)
class DesignReport(StrictAttributes):
    """Results of one design; ``report["closed-loop poles"]`` returns a value, ``print`` shows a table.

    Attributes
    ----------
    title : str
    facts : tuple of ReportEntry

    Examples
    --------
    >>> facts = regulator.explain()
    >>> print(facts.title, np.round(facts["gain"], 3), sep=": ")
    LQR of 'double integrator': [[0.918 1.636]]
    """

    title: str
    facts: tuple[ReportEntry, ...] = ()

    def __getitem__(self, name: str) -> object:
        for fact in self.facts:
            if fact.name == name:
                return fact.value
        raise unknown_name_error(
            "fact", name, f"the explanation of {self.title}", [f.name for f in self.facts]
        )

    def __iter__(self) -> Iterator[ReportEntry]:
        return iter(self.facts)

    def __str__(self) -> str:
        rows = [
            ("quantity", "value", "unit", "remark"),
            *(row for fact in self.facts for row in _format_design_report_rows(fact)),
        ]
        widths = [max(len(row[k]) for row in rows) for k in range(3)]
        widths[1] = min(widths[1], REPORT_VALUE_WIDTH)
        lines = ["  ".join(f"{cell:<{w}}" for cell, w in zip(row, [*widths, 0], strict=True)) for row in rows]
        return "\n".join([self.title, *(f"  {line}".rstrip() for line in lines)])

    @property
    def rows(self) -> list[tuple[str, str, str, str]]:
        """Name, value as text, unit and remark of every result."""
        return [(fact.name, _format_design_report_value(fact), fact.unit, fact.remark) for fact in self.facts]

    def _repr_html_(self) -> str:
        return format_html_heading(self.title) + format_html_table(
            ("quantity", "value", "unit", "remark"), self.rows
        )


def _format_design_report_rows(fact: ReportEntry) -> list[tuple[str, str, str, str]]:
    first, *more = _format_design_report_value(fact).splitlines()
    if more:
        first, more = f"{len(more) + 1} rows:", [first, *more]
    return [(fact.name, first, fact.unit, fact.remark), *(("", line, "", "") for line in more)]


def _format_design_report_value(fact: ReportEntry) -> str:
    """Return the value as text: comma-separated numbers, a matrix row by row, conjugate poles as ``-1 ± 2j``."""
    if isinstance(fact.value, str):
        return fact.value
    array = np.asarray(fact.value)
    if array.ndim == 2:
        array = np.where(np.abs(array) > EQUAL * np.max(np.abs(array), axis=0), array, 0.0)
        return "\n".join(_format_number_list(row) for row in array)
    return _format_number_list(np.atleast_1d(array))


def _format_number_list(values: Array) -> str:
    texts, remaining = [], list(values)
    while remaining:
        value = remaining.pop(0)
        if remaining and np.iscomplexobj(value) and value.imag and remaining[0] == np.conj(value):
            remaining.pop(0)
            texts.append(f"{value.real:.3g} ± {abs(value.imag):.3g}j")
        else:
            texts.append(format_number(value))
    return ", ".join(texts)


def format_number(value: object) -> str:
    """Return a number or an array as text; imaginary parts at rounding level are omitted."""
    array = np.asarray(value)
    if np.iscomplexobj(array) and np.all(np.abs(array.imag) <= ROUNDING * np.abs(array)):
        array = array.real
    if array.ndim == 0:
        return f"{array[()]:.3g}"
    return np.array2string(array, precision=3, max_line_width=100, separator=", ")
