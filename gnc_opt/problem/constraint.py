"""Constraint: an expression between limits, along a phase or at the ends of phases."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gnc_opt.errors import ProblemError
from gnc_opt.model.layout import Variable, as_vector
from gnc_opt.model.symbol import as_expression
from gnc_opt.problem.interval import Interval, read_interval, read_range


@dataclass(frozen=True)
class Constraint:
    """``lower <= expression <= upper``, the expression an SX column vector of ``size`` rows."""

    name: str
    expression: Any
    interval: Interval

    @property
    def size(self) -> int:
        """Number of rows."""
        return int(self.interval.lower.size)

    @property
    def labels(self) -> tuple[str, ...]:
        """Row names."""
        return Variable(self.name, self.size).labels


def make_constraint(name: str, expression: Any, lower: Any, upper: Any, equals: Any, what: str) -> Constraint:
    """Build a `Constraint`, refusing contradictory or missing limits."""
    value = as_expression(expression, what, None, ProblemError)
    if equals is not None and (lower is not None or upper is not None):
        raise ProblemError(f"{what} has both equals and lower/upper: give one or the other.")
    if equals is None and lower is None and upper is None:
        raise ProblemError(f"{what} has no limit: give lower, upper or equals.")
    size = value.shape[0]
    if equals is not None:
        return Constraint(name, value, read_interval(as_vector(equals, size, what), size, what))
    return Constraint(name, value, read_range(lower, upper, size, what))
