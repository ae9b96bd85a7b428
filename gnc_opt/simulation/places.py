"""Places: consecutive parts of a column, by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca

from gnc_opt.simulation.block import rows


@dataclass(frozen=True)
class Places:
    """Names and sizes of consecutive parts of a column; ``split`` takes it apart, ``join`` puts it together."""

    parts: tuple[tuple[str, int], ...]

    @property
    def size(self) -> int:
        """Length of the column."""
        return sum(n for _, n in self.parts)

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Where each part is."""
        out, at = {}, 0
        for name, n in self.parts:
            out[name], at = slice(at, at + n), at + n
        return out

    def split(self, column: Any) -> dict[str, Any]:
        """Return the parts (rows) of a column or an array by name."""
        if isinstance(column, (ca.SX, ca.MX)):
            return {name: rows(column, place.start, place.stop) for name, place in self.slices.items()}
        return {name: column[place] for name, place in self.slices.items()}

    def join(self, values: Mapping[str, Any]) -> Any:
        """Return the column of all parts."""
        return ca.vertcat(*[values[name] for name, _ in self.parts])
