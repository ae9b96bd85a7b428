"""Work limits of a solve, independent of the machine.

Work is counted in iterations of one variable at one collocation point. A solve on N points with n states and
m controls that takes k iterations costs N (n + m) (k + 15); the 15 stand for derivatives, error estimates and
the next mesh. `WORK_PER_SECOND` converts work to CPU seconds. The search also ends at that CPU time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from gnc_opt.argument_checks import read_integer, read_positive_number
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.refinement_history import (
    SOLVE_FIXED_COST_ITERATIONS,
    compute_work_of_nlp_solve,
)
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh

WORK_PER_SECOND = 2e5
"""Work per CPU second on a processor of 2023: mean over the problems of `benchmarks.validation.engine`."""

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
    max_work: float = 35.0
    max_wall_time: float | None = None

    def __post_init__(self) -> None:
        read_integer(self.max_passes, "max_passes of RefinementLimits", 1)
        read_integer(self.max_points, "max_points of RefinementLimits", 1)
        if self.max_work != math.inf:
            read_positive_number(self.max_work, "max_work of RefinementLimits")
        if self.max_wall_time is not None:
            read_positive_number(self.max_wall_time, "max_wall_time of RefinementLimits")


def compute_refinement_work(solution: Solution) -> float:
    """Return the work of the refinement that led to a solution, s of the reference processor; 0 without one."""
    passes = () if solution.history is None else solution.history.passes
    points = sum(phase.mesh.size for phase in solution.phases.values())
    variables = _count_trajectory_variables(solution.phases.values())
    return sum(p.work for p in passes) * variables / points / WORK_PER_SECOND


def _count_trajectory_variables(phases: Iterable[PhaseSolution]) -> int:
    """Return the number of states and controls, summed over the collocation points."""
    return sum(phase.mesh.size * (phase.states.size + phase.controls.size) for phase in phases)


@dataclass
class WorkBudget:
    """Limits of a search or of a part of it, and spent work, s of the reference processor.

    The deadlines are those of wall time (`time.perf_counter`) and CPU time of this thread (`time.thread_time`);
    ``max_iterations`` limits all attempts of a solve together. After ``warm_iterations``, a start from a solution is
    repeated from its trajectory without multipliers (0: it starts from the trajectory; None: no repetition). The work
    is added to the budget ``whole``, too.
    """

    total: float = math.inf
    deadline: float = math.inf
    cpu_deadline: float = math.inf
    max_passes: int = RefinementLimits.max_passes
    max_points: int = RefinementLimits.max_points
    max_iterations: int | None = None
    warm_iterations: int | None = None
    spent: float = 0.0
    whole: WorkBudget | None = None
    _finishing_total: float = field(default=math.inf, repr=False)

    @classmethod
    def start_work_budget(cls, limits: RefinementLimits) -> WorkBudget:
        """Return the budget of a search that begins now."""
        wall = math.inf if limits.max_wall_time is None else limits.max_wall_time
        deadlines = time.perf_counter() + wall, time.thread_time() + limits.max_work
        return cls(limits.max_work, *deadlines, limits.max_passes, limits.max_points)

    @property
    def remaining_work(self) -> float:
        """Remaining work, s of the reference processor; at most the remaining CPU time."""
        work = min(self.total, self._finishing_total) - self.spent
        return max(0.0, min(work, self.cpu_deadline - time.thread_time()))

    def allot_work_budget_share(
        self, share: float = 1.0, *, max_iterations: int | None = None, warm_iterations: int | None = None
    ) -> WorkBudget:
        """Return the budget of a part of the search: a share of the total work, at most the rest, and own limits."""
        allotted = min(share * self.total, self.remaining_work)
        return replace(
            self,
            total=allotted,
            max_iterations=max_iterations,
            warm_iterations=warm_iterations,
            spent=0.0,
            whole=self,
            _finishing_total=math.inf,
        )

    def record_work(self, seconds: float) -> None:
        """Add work, s of the reference processor."""
        self.spent += seconds
        if self.whole is not None:
            self.whole.record_work(seconds)

    def record_solve_work(self, solution: Solution) -> None:
        """Add the work of a solve, including failed attempts."""
        variables = _count_trajectory_variables(solution.phases.values())
        work = compute_work_of_nlp_solve(variables, solution.statistics.iterations)
        self.record_work(work / WORK_PER_SECOND)

    def count_remaining_iterations(self, problem: Problem, meshes: Mapping[str, Mesh]) -> int | None:
        """Return the remaining iterations of a solve, at least one; None: unlimited."""
        if math.isinf(self.total):
            return self.max_iterations
        models = {name: problem.phases[name].model for name in meshes}
        variables = sum(meshes[name].size * (m.states.size + m.controls.size) for name, m in models.items())
        affordable = math.ceil(self.remaining_work * WORK_PER_SECOND / variables)
        remaining = max(1, affordable - SOLVE_FIXED_COST_ITERATIONS)
        return remaining if self.max_iterations is None else min(remaining, self.max_iterations)

    def limit_work_to_completing_solution(self, limited: bool) -> None:
        """Limit the remaining work to that of completing a solution, or cancel this limit."""
        if not limited:
            self._finishing_total = math.inf
        elif math.isinf(self._finishing_total):
            self._finishing_total = self.spent + max(FINISH_MIN_SECONDS, self.spent)
