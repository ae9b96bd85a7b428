"""Constraint: an expression with limits, along a phase or at the ends of phases."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.errors import ProblemError
from gnc_opt.model.model_variables import Variable, convert_to_sx_column, read_vector
from gnc_opt.planning.problem.bounds import Interval, read_lower_and_upper_limits, read_value_or_range


@dataclass(frozen=True)
class Constraint:
    """Constraint ``lower <= expression <= upper`` on an SX column vector of ``size`` rows.

    Attributes
    ----------
    expression : casadi.SX (size, 1)
    interval : Interval
        Limits.

    Examples
    --------
    >>> slow = problem.with_bounds(a=(-1.0, 1.0)).phases["leg"]
    >>> slow.path("speed", v, lower=-0.8)
    >>> print([(name, limit.interval.lower) for name, limit in slow.paths.items()])
    [('speed', array([-0.8]))]
    """

    name: str
    expression: Any
    interval: Interval
    unit: str = ""

    @property
    def size(self) -> int:
        """Number of rows."""
        return int(self.interval.lower.size)

    @property
    def labels(self) -> tuple[str, ...]:
        """Row names."""
        return Variable(self.name, self.size).labels


def make_constraint(name: str, expression: Any, lower: Any, upper: Any, equals: Any, what: str) -> Constraint:
    """Return a `Constraint`; raise an error for contradictory or missing limits. ``a <= b`` becomes ``a - b <= 0``."""
    value = convert_to_sx_column(expression, what, None, ProblemError)
    if any(row.op() in _COMPARISONS for row in ca.vertsplit(value)):
        if not (lower is equals is upper is None):
            raise ProblemError(f"{what} is a comparison and has another limit: give one or the other.")
        return _read_comparison_constraint(name, value, what)
    if equals is not None and (lower is not None or upper is not None):
        raise ProblemError(f"{what} has both equals and lower/upper: give one or the other.")
    if equals is None and lower is None and upper is None:
        raise ProblemError(f"{what} has no limit: give lower, upper or equals, or write it as a <= b.")
    size = value.shape[0]
    if equals is not None:
        return Constraint(name, value, read_value_or_range(read_vector(equals, size, what), size, what))
    return Constraint(name, value, read_lower_and_upper_limits(lower, upper, size, what))


_COMPARISONS = (ca.OP_LE, ca.OP_LT, ca.OP_EQ, ca.OP_NE)


def _read_comparison_constraint(name: str, value: Any, what: str) -> Constraint:
    """Return the constraint of rows ``a <= b``, ``a < b`` (equivalent) or ``a == b``; numbers become limits."""
    rows, ends = [], []
    for row in ca.vertsplit(value):
        if row.op() not in _COMPARISONS[:3]:
            remedy = "write all of its rows with <=, >= or =="
            raise ProblemError(f"{what} has a row that is neither an inequality nor an equation: {remedy}.")
        left, right = row.dep(0), row.dep(1)
        is_equation = row.op() == ca.OP_EQ
        if right.is_constant():
            rows.append(left)
            ends.append((float(right) if is_equation else -np.inf, float(right)))
        elif left.is_constant():
            rows.append(right)
            ends.append((float(left), float(left) if is_equation else np.inf))
        else:
            rows.append(left - right)
            ends.append((0.0 if is_equation else -np.inf, 0.0))
    lower, upper = np.array(ends).T
    return Constraint(name, ca.vertcat(*rows), read_lower_and_upper_limits(lower, upper, len(rows), what))
