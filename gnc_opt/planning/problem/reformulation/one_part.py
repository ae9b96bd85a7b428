r"""Path limits of a split control as limits of its parts on one side of the first corner.

With :math:`u = c + p - m`, let a row :math:`a u + b` with :math:`a \ge 0` be within its upper limit at c. It is within
it at u if and only if some parts of u have :math:`a (c + p) + b` within it: where u is below c, p = 0 has, and
:math:`- a m` is never above zero. So the limit is one of p alone, which, where H is linear, tells where p is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.planning.problem.constraints import Constraint
from gnc_opt.planning.problem.interval_arithmetic import Domain, is_affine
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.reformulation.epigraph import is_smooth, rows_of


@dataclass(frozen=True)
class OneSided:
    """A row of a path constraint that is affine in a split control.

    Attributes
    ----------
    place : int
        Of the control.
    sign : int
        Of the slope.
    above, below : bool
        Whether the row is surely within a finite upper, and lower, limit at the first corner.
    """

    place: int
    sign: int
    above: bool
    below: bool


def one_sided(
    leg: Phase, corners: Mapping[int, tuple[float, ...]], domain: Domain
) -> dict[tuple[str, int], OneSided]:
    """Return the rows whose limits are of some parts only, by constraint and row; ``corners`` by control."""
    symbols, surely, found = ca.vertsplit(leg.model.symbols("control")), domain.surely(), {}
    for name, constraint in leg.paths.items():
        box = constraint.interval
        for i, row in enumerate(rows_of(constraint.expression)):
            own = [place for place in corners if ca.depends_on(row, symbols[place])]
            if len(own) != 1 or box.fixed[i] or not is_smooth(row) or not is_affine(row, symbols[own[0]]):
                continue
            u = symbols[own[0]]
            sign = surely.sign(ca.jacobian(row, u))
            here = surely.ranges(ca.substitute(row, u, corners[own[0]][0]))
            above = bool(np.isfinite(box.upper[i]) and here.upper[0] <= box.upper[i])
            below = bool(np.isfinite(box.lower[i]) and here.lower[0] >= box.lower[i])
            if sign and (above or below):
                found[name, i] = OneSided(own[0], sign, above, below)
    return found


def rows_by_parts(
    constraint: Constraint, i: int, side: OneSided, upper_part: Any, lower_part: Any, whole: Any
) -> Iterator[tuple[Any, float, float]]:
    """Yield expressions with their limits in place of a row.

    Parameters
    ----------
    upper_part, lower_part, whole : casadi.SX
        The row in the parts beyond the first corner, in those below it, and in all.
    """
    lower, upper = float(constraint.interval.lower[i]), float(constraint.interval.upper[i])
    most, least = (upper_part, lower_part) if side.sign > 0 else (lower_part, upper_part)
    if np.isfinite(upper):
        yield most if side.above else whole, -np.inf, upper
    if np.isfinite(lower):
        yield least if side.below else whole, lower, np.inf
