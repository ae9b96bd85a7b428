"""The numbers of flight code: their type in C, how they are written, and what they are good for."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError

_LINE = 8
"""Numbers on a line of a table."""
_LITERAL = re.compile(r"(?<![\w.\[])(\d+\.\d+)(?![\w.])")
_CALL = re.compile(r"\b([a-z][a-z0-9]*)\(")


@dataclass(frozen=True)
class CNumbers:
    """A floating-point type of C.

    Attributes
    ----------
    type : str
        ``"double"`` or ``"float"``.
    suffix : str
        Of literals and of the functions of <math.h>.
    dtype : type
        The same in NumPy.
    solved : float
        How far scaled rows of a quadratic programme may be outside.
    dependent : float
        Share of a row's square below which it depends on others.
    """

    type: str
    suffix: str
    dtype: Any
    solved: float
    dependent: float

    @property
    def size(self) -> int:
        """Bytes."""
        return int(np.dtype(self.dtype).itemsize)

    def __call__(self, value: float) -> str:
        """Return a literal, shortest that is read as the same number."""
        if np.isnan(value):
            return "NAN"
        if np.isinf(value):
            return "INFINITY" if value > 0 else "-INFINITY"
        with np.errstate(over="ignore"):
            rounded = self.dtype(value)
        if not np.isfinite(rounded):
            raise ArgumentError(f"{value:g} is beyond the numbers of the type '{self.type}': write double.")
        text = repr(float(value)) if self.dtype is np.float64 else str(rounded)
        return text + self.suffix

    def entry(self, value: float) -> str:
        """Return a literal of a table, which has to be finite."""
        if not np.isfinite(value):
            raise ArgumentError(
                f"the flight code would hold the number {value!r}: a schedule must be finite."
            )
        return self(value)

    def expression(self, text: str) -> str:
        """Return an expression with its literals and its calls of <math.h> in this type."""
        if not self.suffix:
            return text
        return _CALL.sub(rf"\1{self.suffix}(", _LITERAL.sub(rf"\1{self.suffix}", text))

    def typed(self, text: str) -> str:
        """Return C with the type in place of ``real_t``."""
        return re.sub(r"\breal_t\b", self.type, text)

    def nested(self, values: Array) -> str:
        """Return the initializer of an array of any dimension."""
        if np.ndim(values) == 1:
            return "{" + wrapped(self.entry(float(v)) for v in values) + "}"
        return "{" + ",\n".join(self.nested(row) for row in values) + "}"

    def table(self, name: str, values: Array) -> str:
        """Return the definition of a constant array."""
        shape = "".join(f"[{n}]" for n in np.shape(values))
        return f"static const {self.type} {name}{shape} = {self.nested(np.asarray(values))};"


DOUBLE = CNumbers("double", "", np.float64, 1e-9, 1e-11)
FLOAT = CNumbers("float", "f", np.float32, 1e-4, 1e-5)


def wrapped(entries: Iterable[str]) -> str:
    """Return entries of an initializer over lines."""
    texts = list(entries)
    lines = [", ".join(texts[i : i + _LINE]) for i in range(0, len(texts), _LINE)]
    return ",\n    ".join(lines)
