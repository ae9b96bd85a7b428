"""Design report: facts of a design with names, values and units."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gnc_opt.arguments import Strict
from gnc_opt.errors import unknown_name
from gnc_opt.tolerances import ROUNDING


@dataclass(frozen=True)
class ReportEntry:
    """One statement about a design.

    Attributes
    ----------
    name : str
        What it is, e.g. ``"closed-loop poles"``.
    value : float, complex, str, or an array of them
    unit : str
    remark : str
        What it means, or where it comes from.

    Examples
    --------
    >>> for fact in regulator.explain().facts[:2]:
    ...     print(fact.name, np.round(np.abs(fact.value), 3))
    gain [[0.918 1.636]]
    sampled poles [0.917 0.917]
    """

    name: str
    value: object
    unit: str = ""
    remark: str = ""

    def __str__(self) -> str:
        value = self.value if isinstance(self.value, str) else number_text(self.value)
        line = f"{self.name}: {value}{' ' + self.unit if self.unit else ''}"
        return f"{line} ({self.remark})" if self.remark else line


@dataclass(frozen=True)
class DesignReport(Strict):
    """The facts of one design; ``explanation["closed-loop poles"]`` returns a value, ``print`` shows all.

    Attributes
    ----------
    title : str
    facts : tuple of Fact

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
        raise unknown_name("fact", name, f"the explanation of {self.title}", [f.name for f in self.facts])

    def __iter__(self) -> Iterator[ReportEntry]:
        return iter(self.facts)

    def __str__(self) -> str:
        return "\n".join([self.title, *(f"  {fact}" for fact in self.facts)])


def number_text(value: object) -> str:
    """Return a number, or an array of them, as text: as real ones where no imaginary part is more than rounding."""
    array = np.asarray(value)
    if np.iscomplexobj(array) and np.all(np.abs(array.imag) <= ROUNDING * np.abs(array)):
        array = array.real
    if array.ndim == 0:
        return f"{array[()]:.6g}"
    return np.array2string(array, precision=6, max_line_width=100, separator=", ")
