"""Linear tables of one axis as the largest, or the least, of their lines."""

from __future__ import annotations

from typing import Any

import numpy as np

from gnc_opt.model.table import TableUse
from gnc_opt.planning.problem.interval_arithmetic import Domain
from gnc_opt.tolerances import EQUAL


def lines_of(use: TableUse, domain: Domain) -> tuple[int, list[Any]] | None:
    """Return 1 and the lines of which a table is the largest where it is used, -1 if it is the least; None if neither.

    None, too, where bounds do not keep the argument within the table: there the range is watched.

    Parameters
    ----------
    use : TableUse
        Of a linear table of one axis.
    domain : Domain
        Tells in which of its intervals the argument may be.
    """
    argument, grid, values = use.arguments[0], use.table.grids[0], use.table.values
    met = domain.surely().ranges(argument)
    if met.lower[0] < grid[0] or met.upper[0] > grid[-1]:
        return None
    here = (grid[1:] > met.lower[0]) & (grid[:-1] < met.upper[0])
    slopes = (np.diff(values) / np.diff(grid))[here]
    rises = np.diff(slopes)
    bends = np.abs(rises) > EQUAL * np.max(np.abs(slopes), initial=0.0)
    if not np.any(bends) or np.ptp(np.sign(rises[bends])) > 0:
        return None
    own = np.append([True], bends)
    points, heights = grid[:-1][here][own], values[:-1][here][own]
    lines = [v + s * (argument - x) for v, s, x in zip(heights, slopes[own], points, strict=True)]
    return int(np.sign(rises[bends][0])), lines
