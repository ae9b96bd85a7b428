"""hp refinement: solve, estimate the error between the nodes, improve the mesh, until the error is small.

Every pass starts warm from states, controls and multipliers of the last one. The error comes from model and
trajectory alone, see `gnc_opt.planning.refinement.error_estimation`; how the mesh changes is in
`gnc_opt.planning.refinement.mesh.remesh`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from gnc_opt.errors import GncOptError
from gnc_opt.planning.direct.solve_mesh import WARM_MAX_ITERATIONS, solve_mesh
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.nlp.options import final_barrier_parameter
from gnc_opt.planning.refinement.error_estimation import PhaseError, estimate_errors
from gnc_opt.planning.refinement.iterations import (
    IterationLimits,
    is_stagnating,
    record_iteration,
    show_progress,
)
from gnc_opt.planning.refinement.mesh.remesh import Past, Remesh, index_segments
from gnc_opt.planning.solution.history import Actions, History, RefinementIteration, RefinementStatus
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.tolerances import NOTABLE

WARM_BARRIER = 1e-6
"""Barrier parameter of a warm start, per unit of the error that is left: what is nearly right must not be pushed off
its bounds only to come back in ten iterations. Where no error exceeds `NOTABLE` it begins at the last
barrier: each one before costs two iterations or more."""

DEFAULT_ITERATIONS = 20
"""At most so many solves, if nobody says otherwise."""

STAGE_ERROR_SHARE = 1e-4
"""Each pass aims at this share of the error before it, ..."""

COARSE_MESH_TOLERANCE_SHARE = 1e-3
"""... at this share while some segment is hopelessly coarse, and all others still move with it; ..."""

NEAR_TOLERANCE_RATIO = 30.0
"""... but at the tolerance itself where that is no further than this: another pass costs more than a few points."""

SOLVER_MAX_TOLERANCE, SOLVER_SHARE = 1e-9, 0.1
"""Tolerance of the solver at most, and in shares of the error that the pass aims at: more digits of a mesh that is
given up at once are worth nothing."""

NextMeshes: TypeAlias = "tuple[dict[str, Mesh], Actions]"


@dataclass(frozen=True, eq=False)
class _MeshSolution:
    """A solution with its error."""

    solution: Solution
    errors: dict[str, PhaseError]
    record: RefinementIteration

    @property
    def finite_error(self) -> float:
        """Largest error of the segments whose functions are defined."""
        worst = np.concatenate([e.largest_errors for e in self.errors.values()])
        return float(np.max(worst, initial=0.0, where=np.isfinite(worst)))

    @property
    def total_error(self) -> float:
        return float(sum(np.sum(np.minimum(e.largest_errors, 1e6)) for e in self.errors.values()))


def refine_mesh(
    solution: Solution,
    *,
    tol: float = 1e-8,
    limits: IterationLimits | None = None,
    options: SolverOptions | None = None,
    progress: bool = False,
) -> tuple[Solution, History]:
    """Return the solution on a mesh on which its estimated error is at most ``tol``, and how it came about.

    Parameters
    ----------
    solution : Solution
        With its problem; its mesh is the first.
    tol : float
        Bound on the error of every segment: dynamics, integrals, bounds and paths between the nodes, each
        dimensionless; see `gnc_opt.planning.refinement.error_estimation`.
    limits : IterationLimits, optional
        Default: `DEFAULT_ITERATIONS`. Twice as much work is allowed while the error falls to a third or less each time.
    options : SolverOptions, optional
        For the solves.
    progress : bool
        Show one line per pass.

    Returns
    -------
    Solution
        The one within the tolerance, or else the one whose objective has the least error.
    History
        Its ``status`` and ``message`` say how it ended.

    Raises
    ------
    GncOptError
        The solution has no problem, or did not converge itself.
    """
    if not solution.status.solved:
        raise GncOptError(
            f"the solution of '{solution.problem_name}' ended as {solution.status.value}: refine one that is solved."
        )
    limits = limits or IterationLimits(DEFAULT_ITERATIONS)
    refinement = _Refinement(solution, tol, limits, options)
    with show_progress(solution.problem_name, tol, progress) as show:
        try:
            status = refinement.refine_until_converged(show)
        except KeyboardInterrupt:
            status = refinement.classify_failed_solve(Status.INTERRUPTED)
    return refinement.build_result(status)


class _Refinement:
    """The loop and what it remembers."""

    def __init__(
        self,
        solution: Solution,
        tol: float,
        limits: IterationLimits,
        options: SolverOptions | None,
    ) -> None:
        self._problem = solution.need_problem("refine")
        self._scheme = solution.scheme
        self._tol, self._limits = tol, limits
        self._options = options or SolverOptions(tolerance=min(SOLVER_MAX_TOLERANCE, SOLVER_SHARE * tol))
        self._asked = options is not None
        self._records: list[RefinementIteration] = []
        self._past: dict[str, Past] = {}
        self._totals: list[float] = []
        self._begin = time.perf_counter()
        self._state = self._evaluate_solution(solution, self._begin, Actions())
        self._best, self._chosen = self._state, 0

    def refine_until_converged(self, show: Callable[[RefinementIteration], None]) -> RefinementStatus:
        show(self._records[-1])
        for _ in range(self._limits.passes):
            if time.perf_counter() > self._limits.deadline:
                return self.classify_failed_solve(Status.INTERRUPTED)
            plan = self._plan_next_meshes()
            if isinstance(plan, RefinementStatus):
                return plan
            if self._limits.are_exhausted(self._spent_work):
                return self._classify_ending(RefinementStatus.BUDGET_LIMIT)
            meshes, actions = plan
            self._past = {name: index_segments(e) for name, e in self._state.errors.items()}
            status = self._solve_on_meshes(meshes, actions)
            show(self._records[-1])
            if status is Status.ITERATION_LIMIT and self._limits.are_exhausted(self._spent_work):
                return self._classify_ending(RefinementStatus.BUDGET_LIMIT)
            if not status.solved:
                return self.classify_failed_solve(status)
        return self._classify_ending(RefinementStatus.ITERATION_LIMIT)

    @property
    def _spent_work(self) -> float:
        """Work of all passes but the first, which was given."""
        return sum(record.work for record in self._records[1:])

    def _plan_next_meshes(self) -> NextMeshes | RefinementStatus:
        """Return the next meshes with what was done to get them, or how it ends here.

        The aim comes closer in stages: while the trajectory still moves, details are premature. Where the points
        do not suffice for a stage, they go to the worst segments.
        """
        last = self._state.record
        if self._has_converged(last):
            return RefinementStatus.CONVERGED
        error = min(self._state.finite_error, 1.0)
        stage = max(
            self._tol,
            (STAGE_ERROR_SHARE if error < NOTABLE else COARSE_MESH_TOLERANCE_SHARE) * error,
        )
        stage = stage if stage > NEAR_TOLERANCE_RATIO * self._tol else self._tol
        plan = self._refine_meshes(stage)
        limited = self._exceeds_point_limit(plan[0])
        while self._exceeds_point_limit(plan[0]):
            stage *= 10.0
            if stage > 0.5 * last.error:
                return RefinementStatus.POINT_LIMIT
            plan = self._refine_meshes(stage)
        if not self._is_stalled(plan[0]):
            return plan
        return RefinementStatus.POINT_LIMIT if limited else RefinementStatus.STALLED

    def _refine_meshes(self, stage: float) -> NextMeshes:
        meshes, total = {}, Actions()
        for name, error in self._state.errors.items():
            meshes[name], actions = Remesh(error, stage, self._past.get(name, {})).mesh()
            total = total + actions
        return meshes, total

    def _exceeds_point_limit(self, meshes: dict[str, Mesh]) -> bool:
        return max(mesh.size for mesh in meshes.values()) > self._limits.points

    def build_result(self, status: RefinementStatus) -> tuple[Solution, History]:
        """Return the best solution and the record."""
        best = self._best.record
        message = f"{status.value}: error {best.error:.1e} (tolerance {self._tol:.1e})"
        message += "" if status is RefinementStatus.CONVERGED else f" at {best.where}. {status.remedy}"
        seconds = time.perf_counter() - self._begin
        history = History(status, self._tol, tuple(self._records), self._chosen, message, seconds)
        return self._best.solution, history

    def classify_failed_solve(self, status: Status) -> RefinementStatus:
        """Return how it ends without another solution, because of what became of the last solve."""
        interrupted = status is Status.INTERRUPTED
        return self._classify_ending(RefinementStatus.INTERRUPTED if interrupted else RefinementStatus.FAILED)

    def _classify_ending(self, otherwise: RefinementStatus) -> RefinementStatus:
        """Return how it ends if no pass follows: there may be an accurate solution already."""
        return RefinementStatus.CONVERGED if self._has_converged(self._best.record) else otherwise

    def _has_converged(self, record: RefinementIteration) -> bool:
        return record.solved and record.error <= self._tol

    def _is_stalled(self, meshes: dict[str, Mesh]) -> bool:
        """Whether nothing is left to do, or neither the largest error nor the sum of all falls fast enough."""
        if meshes == self._state.record.meshes:
            return True
        errors = [r.error for r in self._records]
        return all(is_stagnating(values, self._tol) for values in (errors, self._totals))

    def _solve_on_meshes(self, meshes: dict[str, Mesh], actions: Actions) -> Status:
        """Solve on new meshes, warm, then cold; remember the pass."""
        begin = time.perf_counter()
        within = self._limits.limit_solve(meshes.values(), self._spent_work)
        solution = solve_mesh(
            self._problem,
            meshes,
            scheme=self._scheme,
            guess=self._state.solution,
            options=self._choose_warm_options(),
            limits=replace(within, warm_iterations=WARM_MAX_ITERATIONS),
        )
        self._state = self._evaluate_solution(solution, begin, actions)
        if self._is_better(self._state, self._best):
            self._best, self._chosen = self._state, len(self._records) - 1
        return solution.status

    def _choose_warm_options(self) -> SolverOptions:
        """Return the options with tolerance and barrier parameter that suit how far the solution still has to move."""
        options, left = self._options, min(self._state.finite_error, 1.0)
        if not self._asked:
            options = replace(
                options, tolerance=max(options.tolerance, SOLVER_SHARE * STAGE_ERROR_SHARE * left)
            )
        if options.mu_init is None:
            last = final_barrier_parameter(options.tolerance)
            options = replace(options, mu_init=last if left <= NOTABLE else max(WARM_BARRIER * left, last))
        return options

    def _evaluate_solution(self, solution: Solution, begin: float, actions: Actions) -> _MeshSolution:
        errors = estimate_errors(solution)
        record = record_iteration(solution, errors, begin, actions)
        self._records.append(record)
        state = _MeshSolution(solution, errors, record)
        self._totals.append(state.total_error)
        return state

    def _is_better(self, new: _MeshSolution, old: _MeshSolution) -> bool:
        """Whether a solution is within the tolerance, or its objective has the smaller error."""
        if self._has_converged(new.record) != self._has_converged(old.record):
            return self._has_converged(new.record)
        if not new.record.solved:
            return False
        return new.solution.objective_error.value < old.solution.objective_error.value
