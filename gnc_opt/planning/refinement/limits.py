"""RefinementLimits: what a refinement may cost."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gnc_opt.arguments import read_integer, read_positive


@dataclass(frozen=True)
class RefinementLimits:
    """Where a refinement ends that has not reached its tolerance; see `gnc_opt.refine`.

    Parameters
    ----------
    max_passes : int
        At most so many solves (of each attempt, where structure and mesh are tried in turn).
    max_points : int
        At most so many collocation points in any phase.
    max_work : float
        No pass begins when all of them have cost this many times what the given solution did, counted in iterations
        at one collocation point (`Pass.work`), so that it ends in the same place on every machine. (Of tries that led
        nowhere before that solution no more than 300 iterations count.) What costs about a second
        (`gnc_opt.planning.refinement.engine.LEAST_WORK`) is allowed in any case, twice as much of either
        while the error falls to a
        third or less from pass to pass; ``math.inf`` allows everything. Where all of it was less than about two seconds
        (`gnc_opt.planning.refinement.engine.LITTLE`) and the error of the mesh has fallen to a tenth,
        refining begins once more from
        there, with as much work for the mesh that it has come to. A structure that is tried unasked
        may cost half as much, and a quarter when a finer mesh shows another and so much is left of it all; on the
        segments of that mesh, once, as much as all. Meshes may cost half as much in any case. A pass that has begun may
        cost half of what its way may cost more at most, or 25 iterations.
    max_wall_time : float, optional
        Limit in s on all of it; then, and after Ctrl-C, the best solution so far is returned, without a verdict.

    Raises
    ------
    ArgumentError
        A limit is no positive number.

    Examples
    --------
    >>> coarse = go.solve(problem, mesh="5x3", tol=None)
    >>> print(go.refine(coarse, structure="none", limits=go.RefinementLimits(max_points=15)).history.status.value)
    point_limit
    """

    max_passes: int = 40
    max_points: int = 2000
    max_work: float = 10.0
    max_wall_time: float | None = None

    def __post_init__(self) -> None:
        read_integer(self.max_passes, "max_passes of RefinementLimits", 1)
        read_integer(self.max_points, "max_points of RefinementLimits", 1)
        if self.max_work != math.inf:
            read_positive(self.max_work, "max_work of RefinementLimits")
        if self.max_wall_time is not None:
            read_positive(self.max_wall_time, "max_wall_time of RefinementLimits")
