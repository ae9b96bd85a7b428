"""hp refinement: iteration of solve, error estimate and mesh improvement until the error is within the tolerance.

Every solve starts from states, controls and multipliers of the previous one. Error estimate:
`gnc_opt.planning.refinement.collocation_error_estimate`; next mesh: `gnc_opt.planning.refinement.mesh.mesh_update`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.numerical_tolerances import INNER_TOLERANCE_SHARE, NOTABLE
from gnc_opt.planning.direct.computation_budget import WorkBudget
from gnc_opt.planning.direct.fixed_mesh_solve import WARM_MAX_ITERATIONS, solve_problem_on_mesh
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.nlp.nlp_solver_options import WARM_MU, compute_final_barrier_parameter
from gnc_opt.planning.refinement.collocation_error_estimate import (
    PhaseError,
    estimate_segment_errors,
    is_refinement_stagnating,
    print_iterations,
    record_iteration,
)
from gnc_opt.planning.refinement.mesh.mesh_update import build_next_mesh
from gnc_opt.planning.solution.refinement_history import (
    Actions,
    History,
    RefinementIteration,
    RefinementStatus,
)
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh

STAGE_ERROR_SHARE = 1e-4
"""Target error of each pass, relative to the error of the previous one."""

NEAR_TOLERANCE_RATIO = 30.0
"""Ratio of target error to tolerance below which the tolerance is used: a further pass costs more than a few points."""


@dataclass(frozen=True, eq=False)
class _MeshSolution:
    solution: Solution
    errors: dict[str, PhaseError]
    record: RefinementIteration

    @property
    def largest_finite_error(self) -> float:
        """Largest error of the segments in which all functions are defined."""
        worst = np.concatenate([e.largest_segment_errors for e in self.errors.values()])
        return float(np.max(worst, initial=0.0, where=np.isfinite(worst)))


def refine_mesh(
    solution: Solution,
    *,
    tol: float = 1e-8,
    budget: WorkBudget | None = None,
    options: SolverOptions | None = None,
    progress: bool = False,
) -> tuple[Solution, History]:
    """Return the solution on a mesh on which every segment's error is at most ``tol``, and the history of the passes.

    If the tolerance is not reached, the solution has the smallest error of the objective; ``status`` and ``message`` of
    the history describe the result. Without a budget, work and time are unlimited.
    """
    refinement = _Refinement(solution, tol, budget or WorkBudget(), options)
    with print_iterations(solution.problem_name, tol, progress) as show:
        try:
            status = refinement.refine_mesh_until_converged(show)
        except KeyboardInterrupt:
            status = RefinementStatus.INTERRUPTED
    return refinement.build_refinement_result(status)


class _Refinement:
    def __init__(
        self, solution: Solution, tol: float, budget: WorkBudget, options: SolverOptions | None
    ) -> None:
        self._problem = solution.need_problem("refine")
        self._scheme = solution.scheme
        self._tol, self._budget = tol, budget
        tolerance = min(SolverOptions.tolerance, INNER_TOLERANCE_SHARE * tol)
        self._options = options or SolverOptions(tolerance=tolerance)
        self._asked = options is not None
        self._iterations: list[RefinementIteration] = []
        self._totals: list[float] = []
        self._begin = time.perf_counter()
        self._state = self._estimate_mesh_errors(solution, self._begin, Actions())
        self._best, self._chosen = self._state, 0

    def refine_mesh_until_converged(self, show: Callable[[RefinementIteration], None]) -> RefinementStatus:
        show(self._iterations[-1])
        for _ in range(self._budget.max_passes):
            if time.perf_counter() > self._budget.deadline:
                return RefinementStatus.INTERRUPTED
            plan = self._plan_next_meshes()
            if isinstance(plan, RefinementStatus):
                return plan
            if self._budget.remaining_work <= 0:
                return RefinementStatus.BUDGET_LIMIT
            meshes, actions = plan
            status = self._solve_on_refined_meshes(meshes, actions)
            show(self._iterations[-1])
            if status is Status.ITERATION_LIMIT and self._budget.remaining_work <= 0:
                return RefinementStatus.BUDGET_LIMIT
            if not status.solved:
                interrupted = status is Status.INTERRUPTED
                return RefinementStatus.INTERRUPTED if interrupted else RefinementStatus.FAILED
        return RefinementStatus.ITERATION_LIMIT

    def _plan_next_meshes(self) -> tuple[dict[str, Mesh], Actions] | RefinementStatus:
        """Return the next meshes and the changes, or the final status.

        The target error decreases in stages, since small features of a trajectory that still changes are irrelevant. If
        the points do not suffice for a stage, they are assigned to the segments with the largest errors.
        """
        last = self._state.record
        if self._is_tolerance_met(last):
            return RefinementStatus.CONVERGED
        error = min(self._state.largest_finite_error, 1.0)
        stage = max(self._tol, STAGE_ERROR_SHARE * error)
        stage = stage if stage > NEAR_TOLERANCE_RATIO * self._tol else self._tol
        limited = False
        while True:
            found = {name: build_next_mesh(error, stage) for name, error in self._state.errors.items()}
            meshes = {name: mesh for name, (mesh, _) in found.items()}
            if max(mesh.size for mesh in meshes.values()) <= self._budget.max_points:
                break
            limited, stage = True, 10.0 * stage
            if stage > 0.5 * last.error:
                return RefinementStatus.POINT_LIMIT
        errors = [r.error for r in self._iterations]
        is_slow = all(is_refinement_stagnating(values, self._tol) for values in (errors, self._totals))
        if is_slow or meshes == last.meshes:
            return RefinementStatus.POINT_LIMIT if limited else RefinementStatus.STALLED
        return meshes, sum((actions for _, actions in found.values()), Actions())

    def build_refinement_result(self, status: RefinementStatus) -> tuple[Solution, History]:
        """Return the best solution and the history; CONVERGED if the solution is within the tolerance."""
        best = self._best.record
        status = RefinementStatus.CONVERGED if self._is_tolerance_met(best) else status
        message = f"{status.value}: error {best.error:.1e} (tolerance {self._tol:.1e})"
        message += "" if status is RefinementStatus.CONVERGED else f" at {best.where}. {status.remedy}"
        seconds = time.perf_counter() - self._begin
        history = History(status, self._tol, tuple(self._iterations), self._chosen, message, seconds)
        return self._best.solution, history

    def _is_tolerance_met(self, record: RefinementIteration) -> bool:
        return record.solved and record.error <= self._tol

    def _solve_on_refined_meshes(self, meshes: dict[str, Mesh], actions: Actions) -> Status:
        """Solve on new meshes with a warm start, then without one if that fails; record the pass."""
        begin = time.perf_counter()
        solution = solve_problem_on_mesh(
            self._problem,
            meshes,
            scheme=self._scheme,
            guess=self._state.solution,
            options=self._choose_warm_start_options(),
            budget=self._budget.allot_work_budget_share(warm_iterations=WARM_MAX_ITERATIONS),
        )
        self._state = self._estimate_mesh_errors(solution, begin, actions)
        if self._is_better_solution(self._state, self._best):
            self._best, self._chosen = self._state, len(self._iterations) - 1
        return solution.status

    def _choose_warm_start_options(self) -> SolverOptions:
        """Return the options with tolerance and barrier parameter adapted to the error of the solution."""
        options, left = self._options, min(self._state.largest_finite_error, 1.0)
        if not self._asked:
            loose = INNER_TOLERANCE_SHARE * STAGE_ERROR_SHARE * left
            options = replace(options, tolerance=max(options.tolerance, loose))
        if options.mu_init is None:
            # A larger barrier parameter moves a nearly optimal point off its bounds and costs iterations.
            last = compute_final_barrier_parameter(options.tolerance)
            options = replace(options, mu_init=last if left <= NOTABLE else max(WARM_MU * left, last))
        return options

    def _estimate_mesh_errors(self, solution: Solution, begin: float, actions: Actions) -> _MeshSolution:
        errors = estimate_segment_errors(solution)
        record = record_iteration(solution, begin, actions, errors)
        self._iterations.append(record)
        worst = np.concatenate([e.largest_segment_errors for e in errors.values()])
        self._totals.append(float(np.sum(np.minimum(worst, 1e6))))
        return _MeshSolution(solution, errors, record)

    def _is_better_solution(self, new: _MeshSolution, old: _MeshSolution) -> bool:
        """Return whether a solution is within the tolerance, or its objective has the smaller error."""
        if self._is_tolerance_met(new.record) != self._is_tolerance_met(old.record):
            return self._is_tolerance_met(new.record)
        if not new.record.solved:
            return False
        return new.solution.objective_error.absolute_error < old.solution.objective_error.absolute_error
