"""Work limits of a solve, independent of the machine.

Work is counted in iterations of one variable at one collocation point. A solve on N points with n states and
m controls that takes k iterations costs N (n + m) (k + 15); the 15 stand for derivatives, error estimates and
the next mesh. `WORK_PER_SECOND` converts work to CPU seconds. The search also ends at that CPU time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

from gnc_opt.argument_checks import read_integer, read_positive
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.refinement_history import compute_solve_cost, count_affordable_iterations
from gnc_opt.planning.solution.solution import Solution

WORK_PER_SECOND = 1e5
"""Work per CPU second for expensive iterations on a processor of 2023."""

FINISH_MIN_SECONDS = 10.0
"""Shortest time for local errors and check after the objective's estimated error is within the tolerance, s."""


@dataclass(frozen=True)
class RefinementLimits:
    """Limits of solve and refinement; if one is reached before the tolerance, the best solution is returned.

    Parameters
    ----------
    max_passes : int
        Largest number of solves in one refinement of a mesh, or with one structure.
    max_points : int
        Largest number of collocation points per phase.
    max_work : float
        CPU seconds of a reference processor, from counted iterations (see the module): the same result on every machine
        that needs no more CPU time. ``math.inf``: unlimited.
    max_wall_time : float, optional
        Wall time limit of the whole search, s.

    Raises
    ------
    ArgumentError
        A limit is not a positive number.

    Examples
    --------
    >>> coarse = go.solve(problem, mesh="5x3", tol=None)
    >>> print(go.refine(coarse, structure="none", limits=go.RefinementLimits(max_points=15)).history.status.value)
    point_limit
    """

    max_passes: int = 40
    max_points: int = 2000
    max_work: float = 60.0
    max_wall_time: float | None = None

    def __post_init__(self) -> None:
        read_integer(self.max_passes, "max_passes of RefinementLimits", 1)
        read_integer(self.max_points, "max_points of RefinementLimits", 1)
        if self.max_work != math.inf:
            read_positive(self.max_work, "max_work of RefinementLimits")
        if self.max_wall_time is not None:
            read_positive(self.max_wall_time, "max_wall_time of RefinementLimits")


def count_variables_per_point(phases: Mapping[str, PhaseSolution]) -> float:
    """Return the mean number of states and controls per collocation point over all phases."""
    points = sum(leg.mesh.size for leg in phases.values())
    return sum(leg.mesh.size * (leg.states.size + leg.controls.size) for leg in phases.values()) / points


@dataclass
class WorkBudget:
    """Allowed and spent work.

    Attributes
    ----------
    total : float
        Allowed work, s of the reference processor.
    deadline : float
        Wall time limit, `time.perf_counter`.
    spent : float
        Spent work, s of the reference processor.
    cpu_deadline : float
        CPU time limit of this thread, `time.thread_time`.
    """

    total: float
    deadline: float = math.inf
    spent: float = 0.0
    cpu_deadline: float = math.inf
    _shortened: bool = field(default=False, repr=False)

    @classmethod
    def from_limits(cls, limits: RefinementLimits) -> WorkBudget:
        """Return the budget of a search that begins now."""
        wall = math.inf if limits.max_wall_time is None else limits.max_wall_time
        return cls(
            limits.max_work, time.perf_counter() + wall, cpu_deadline=time.thread_time() + limits.max_work
        )

    @property
    def remaining_work(self) -> float:
        """Remaining work, s of the reference processor; at most the remaining CPU time."""
        return max(0.0, min(self.total - self.spent, self.cpu_deadline - time.thread_time()))

    def add_work_of_solve(self, solution: Solution) -> None:
        """Add the work of a solve, including failed attempts."""
        points = sum(leg.mesh.size for leg in solution.phases.values())
        self.add_work(solution, compute_solve_cost(points, solution.statistics.iterations))

    def add_work(self, like: Solution, work: float) -> None:
        """Add work, iterations at one collocation point (`RefinementIteration.work`) with the variables of ``like``."""
        self.spent += work * count_variables_per_point(like.phases) / WORK_PER_SECOND

    def allot_work(self, like: Solution, share: float = 1.0) -> float:
        """Return a share of the total work, at most the rest, in iterations at one collocation point."""
        seconds = min(share * self.total, self.remaining_work)
        return seconds * WORK_PER_SECOND / count_variables_per_point(like.phases)

    def count_remaining_iterations(self, like: Solution, points: int) -> int | None:
        """Return the remaining iterations, at least one, with ``points`` collocation points; None: unlimited."""
        left = self.allot_work(like)
        return None if math.isinf(left) else max(1, count_affordable_iterations(left, points))

    def limit_finishing_work(self) -> None:
        """Limit the remaining work to that of completing a solution, once."""
        if not self._shortened:
            self.total = min(self.total, self.spent + max(FINISH_MIN_SECONDS, self.spent))
            self._shortened = True
