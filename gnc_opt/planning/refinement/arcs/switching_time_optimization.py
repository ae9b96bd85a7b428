"""Optimisation of switching times with an iteration on the control structure; steps: ``docs/refinement.md``.

If several controls change at one time, not all from bound to bound, the multipliers are not unique. They become unique
if the controls are free in short intervals on both sides of the time; that program has a warm start.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from gnc_opt.numerical_tolerances import EQUAL, ROUNDING
from gnc_opt.planning.direct.computation_budget import WorkBudget
from gnc_opt.planning.direct.fixed_mesh_solve import WARM_MAX_ITERATIONS, solve_problem_on_mesh
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.problem.active_constraint_arcs import Arc, ArcKind
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.arcs.arc_mesh import ArcMesh, SubarcMesh
from gnc_opt.planning.refinement.arcs.control_structure import PhaseStructure
from gnc_opt.planning.refinement.arcs.structure_detection import detect_arc_structures
from gnc_opt.planning.refinement.arcs.structure_update import (
    DEGREE_RAISED,
    KINKS_MOVED,
    LIMITS_RELEASED,
    REFINED,
    correct_arc_structure,
)
from gnc_opt.planning.refinement.collocation_error_estimate import print_iterations, record_iteration
from gnc_opt.planning.refinement.switching.bang_bang_extremal import (
    collocate_trajectory,
    satisfies_inequality_limits,
)
from gnc_opt.planning.refinement.switching.newton_iteration import find_optimal_switching_times
from gnc_opt.planning.solution.costates import NlpIterate
from gnc_opt.planning.solution.initial_nlp_point import build_nlp_point_from_solution
from gnc_opt.planning.solution.refinement_history import History, RefinementIteration, RefinementStatus
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_from_nlp_result import build_phase_solutions
from gnc_opt.planning.transcription.transcription import transcribe_problem
from gnc_opt.planning.verification.optimality_check import verify

NEARBY_MAX_ERROR = 0.1
"""Largest local error of a first pass with the arcs of a nearby solution (of 30 successful warm starts, all began below
2e-3)."""

Segments: TypeAlias = Literal["few", "kept", "nearby"]


def optimise_switching_times(
    solution: Solution,
    *,
    tol: float = EQUAL,
    budget: WorkBudget | None = None,
    structures: Mapping[str, PhaseStructure] | None = None,
    options: SolverOptions | None = None,
    progress: bool = False,
    segments: Segments = "few",
) -> tuple[Solution, History]:
    """Return the solution with exact switching times and its `structure`, and the history of the passes.

    Without convergence, the solution has the smallest estimated error, or is the given one if no pass had a solution.

    Parameters
    ----------
    structures : mapping of PhaseStructure, optional
        Initial structures by phase; by default those detected in the solution.
    segments : {"few", "kept", "nearby"}
        Begin with few segments per subarc, or with those of the mesh of the solution. "nearby": those of a solution of
        nearly the same problem; a structure with a larger first error than `NEARBY_MAX_ERROR` is rejected, and
        switching times are final when local errors and error of the objective are within ``tol``.
    """
    begin = time.perf_counter()
    problem = solution.need_problem("refine")
    settings = options or SolverOptions(max_iterations=WARM_MAX_ITERATIONS)
    arc_meshes = {}
    for name, structure in (structures or detect_arc_structures(solution)).items():
        refined = ArcMesh.from_refined_mesh(structure, solution.phases[name].mesh)
        arc_meshes[name] = ArcMesh.from_structure(structure) if segments == "few" else refined
    work_budget = budget or WorkBudget()
    with print_iterations(solution.problem_name, tol, progress) as show:
        loop = StructureIteration(problem, tol, work_budget, segments == "nearby", settings, show)
        guess, new_meshes, integrated = solution, arc_meshes, None
        try:
            if segments == "few":
                guess, new_meshes, integrated = _optimise_switching_times_by_newton(solution, arc_meshes)
            status = loop.iterate_control_structure(guess, new_meshes, integrated)
            if status is RefinementStatus.FAILED and guess is not solution:
                status = loop.iterate_control_structure(solution, arc_meshes)
        except KeyboardInterrupt:
            status = RefinementStatus.INTERRUPTED
    iterates = loop.iterates
    best = _choose_best_iterate(iterates, status, tol)
    records = [iterate.record for iterate in iterates] or [record_iteration(solution, begin, "not begun")]
    message, seconds = f"{status.value}: {records[-1].actions}", time.perf_counter() - begin
    history = History(status, tol, tuple(records), best or 0, message, seconds)
    if best is None:
        return solution, history
    solution, arc_meshes = iterates[best].solution, iterates[best].arc_meshes
    if status is RefinementStatus.CONVERGED:
        solution = _solve_costates_at_simultaneous_switches(solution, arc_meshes, settings, work_budget)
    arcs: list[Arc] = []
    for name, phase in solution.phases.items():
        labels = (*phase.controls.labels, *phase.path_labels, *phase.states.labels)
        arcs += arc_meshes[name].structure.list_arcs(name, labels)
    return replace(solution, structure=tuple(arcs)), history


def _solve_costates_at_simultaneous_switches(
    solution: Solution, arc_meshes: Mapping[str, ArcMesh], options: SolverOptions, budget: WorkBudget
) -> Solution:
    """Return the solution with costates for which every switching function vanishes at simultaneous switches."""
    structures = (arc_mesh.structure for arc_mesh in arc_meshes.values())
    if not any(map(find_simultaneous_switches, structures)) or verify(solution).ok:
        return solution
    split = solve_with_split_switches(solution, arc_meshes, options, budget)
    if split is None or verify(split).ok:
        return split or solution
    return min(solution, split, key=lambda each: each.objective_error.absolute_error)


@dataclass(frozen=True, eq=False)
class _Iterate:
    solution: Solution
    arc_meshes: dict[str, ArcMesh]
    record: RefinementIteration


def _choose_best_iterate(iterates: list[_Iterate], status: RefinementStatus, tol: float) -> int | None:
    """Return the index of the converged pass, else of the one with the smallest error of the objective, or None."""
    solved = {k: iterate for k, iterate in enumerate(iterates) if iterate.record.solved}
    if not solved or status is RefinementStatus.CONVERGED:
        return max(solved, default=None)
    errors = {k: max(iterate.solution.objective_error.relative_error, tol) for k, iterate in solved.items()}
    return min(solved, key=lambda k: (errors[k], solved[k].record.error))


def _optimise_switching_times_by_newton(
    solution: Solution, arc_meshes: dict[str, ArcMesh]
) -> tuple[Solution, dict[str, ArcMesh], Solution | None]:
    """Optimise the switching times by Newton's method and choose the mesh for the resulting trajectory.

    Returns the trajectory as a guess, its arc mesh and, unless a limit is violated or the optimum may be degenerate,
    the same trajectory as the solution; the given solution and meshes if Newton's method does not apply.
    """
    if len(arc_meshes) > 1:
        return solution, arc_meshes, None  # the switching times of one phase depend on the others
    ((name, arc_mesh),) = arc_meshes.items()
    optimum = find_optimal_switching_times(solution, arc_mesh.structure)
    if optimum is None:
        return solution, arc_meshes, None
    structure, extremal = optimum
    arc_mesh = ArcMesh.from_integration_steps(structure, extremal.step_times)
    collocated = collocate_trajectory(solution, extremal, arc_mesh)
    feasible = satisfies_inequality_limits(collocated, extremal.s.state_scale)
    final = collocated if feasible and solution.status is Status.OPTIMAL else None
    return collocated, {name: arc_mesh}, final


@dataclass(frozen=True, eq=False)
class StructureIteration:
    problem: Problem
    tol: float
    budget: WorkBudget
    nearby: bool
    options: SolverOptions
    show: Callable[[RefinementIteration], None]
    iterates: list[_Iterate] = field(default_factory=list)

    def iterate_control_structure(
        self, solution: Solution, arc_meshes: dict[str, ArcMesh], integrated: Solution | None = None
    ) -> RefinementStatus:
        """Solve, except in the first pass if its solution is integrated, and update until nothing changes."""
        changes: list[tuple[dict[str, PhaseStructure], dict[str, PhaseStructure]]] = []
        for _ in range(self.budget.max_passes):
            begin = time.perf_counter()
            if begin > self.budget.deadline:
                return RefinementStatus.INTERRUPTED
            if any(arc_mesh.build_mesh().size > self.budget.max_points for arc_mesh in arc_meshes.values()):
                return RefinementStatus.POINT_LIMIT
            if self.budget.remaining_work <= 0:
                return RefinementStatus.BUDGET_LIMIT
            candidate, integrated = integrated or self._solve_on_arc_mesh(arc_meshes, solution), None
            if not candidate.status.solved:
                self._record_iterate(candidate, arc_meshes, begin, f"not solved ({candidate.status.value})")
                interrupted = candidate.status is Status.INTERRUPTED
                return RefinementStatus.INTERRUPTED if interrupted else RefinementStatus.FAILED
            solution, solved_meshes = candidate, dict[str, ArcMesh]()
            for name, arc_mesh in arc_meshes.items():
                times = tuple(map(float, solution.phases[name].breaks[list(arc_mesh.subarc_boundary_breaks)]))
                solved_meshes[name] = replace(arc_mesh, structure=arc_mesh.structure.with_switch_times(times))
            # Subarcs converge so fast that a small tolerance costs a few iterations, if any.
            target = self.tol if self.nearby else min(self.tol, EQUAL)
            arc_meshes, action = correct_arc_structure(solution, solved_meshes, target)
            record = self._record_iterate(solution, solved_meshes, begin, action or "arcs unchanged")
            if self.nearby and len(self.iterates) == 1 and record.error > NEARBY_MAX_ERROR:
                return RefinementStatus.FAILED
            if not action or self._is_accuracy_sufficient(solution, record):
                return RefinementStatus.CONVERGED
            if not set(action.split(", ")) <= {KINKS_MOVED, REFINED, DEGREE_RAISED, LIMITS_RELEASED}:
                old_structures, new_structures = (
                    {name: arc_mesh.structure.with_switch_times(()) for name, arc_mesh in meshes.items()}
                    for meshes in (solved_meshes, arc_meshes)
                )
                if (old_structures, new_structures) in changes:
                    return RefinementStatus.STALLED
                changes.append((old_structures, new_structures))
        return RefinementStatus.ITERATION_LIMIT

    def _is_accuracy_sufficient(self, solution: Solution, record: RefinementIteration) -> bool:
        """Return whether the solution is accurate enough, and subarcs would only be refined further."""
        tolerance, refined_only = self.tol if self.nearby else 0.0, {REFINED, DEGREE_RAISED}
        if record.error > tolerance or not set(str(record.actions).split(", ")) <= refined_only:
            return False
        return solution.objective_error.relative_error <= tolerance

    def _record_iterate(
        self, solution: Solution, arc_meshes: dict[str, ArcMesh], begin: float, action: str
    ) -> RefinementIteration:
        record = record_iteration(solution, begin, action)
        self.iterates.append(_Iterate(solution, arc_meshes, record))
        self.show(record)
        return record

    def _solve_on_arc_mesh(self, arc_meshes: Mapping[str, ArcMesh], guess: Solution) -> Solution:
        problem = self.problem
        for name, arc_mesh in arc_meshes.items():
            problem = arc_mesh.fix_arcs_in_problem(problem, name)
        meshes = {name: arc_mesh.build_mesh() for name, arc_mesh in arc_meshes.items()}
        found = solve_problem_on_mesh(problem, meshes, guess=guess, options=self.options, budget=self.budget)
        return replace(found, problem=self.problem)


FREE_INTERVAL = 3e-6
"""Length of the intervals, relative to the phase; in shorter ones, multipliers are dominated by rounding."""

FREE_INTERVAL_POINTS = 2
"""Collocation points of each interval."""

SUBARC_MIN_INTERVALS = 10.0
"""Shortest subarc with space for an interval, in interval lengths."""


def find_simultaneous_switches(structure: PhaseStructure) -> tuple[int, ...]:
    """Return the boundaries at which several controls change, with sufficiently long adjacent subarcs."""
    shortest = SUBARC_MIN_INTERVALS * FREE_INTERVAL * (structure.times[-1] - structure.times[0])
    return tuple(
        k
        for k in range(1, structure.n_subarcs)
        if sum(row < structure.n_controls for row in structure.find_changed_arcs(k)) > 1
        and not structure.has_only_control_kinks(k)
        and not structure.touches[k]
        and min(structure.subarc_lengths[k - 1 : k + 1]) > shortest
    )


def solve_with_split_switches(
    solution: Solution, arc_meshes: Mapping[str, ArcMesh], options: SolverOptions, budget: WorkBudget
) -> Solution | None:
    """Return a solution with the multipliers of the program with split switches; None if that has no solution."""
    problem, meshes = solution.need_problem("refine"), {}
    for name, arc_mesh in arc_meshes.items():
        split = split_simultaneous_switch_times(arc_mesh)
        problem, mesh = split.fix_arcs_in_problem(problem, name), split.build_mesh()
        lengths = np.diff(mesh.breaks)  # the ends of the intervals are fixed
        movable = tuple(k for k in mesh.movable if min(lengths[k - 1 : k + 1]) > 2 * FREE_INTERVAL)
        meshes[name] = replace(mesh, movable=movable)
    tight_options = replace(options, tolerance=min(ROUNDING, options.tolerance))
    result = solve_problem_on_mesh(problem, meshes, guess=solution, options=tight_options, budget=budget)
    return _copy_multipliers(solution, result, arc_meshes) if result.status.solved else None


def _copy_multipliers(solution: Solution, other: Solution, arc_meshes: Mapping[str, ArcMesh]) -> Solution:
    problem = solution.need_problem("refine")
    for name, arc_mesh in arc_meshes.items():
        problem = arc_mesh.fix_arcs_in_problem(problem, name)
    meshes = {name: arc_mesh.build_mesh() for name, arc_mesh in arc_meshes.items()}
    transcription = transcribe_problem(problem, meshes, solution.scheme)
    point, other_point = (build_nlp_point_from_solution(transcription, problem, s) for s in (solution, other))
    iterate = NlpIterate(point.x, other_point.lam_x, other_point.lam_g)
    phases, _ = build_phase_solutions(transcription, problem, iterate)
    return replace(
        solution,
        phases=phases,
        parameter_multipliers=iterate.lam_x[transcription.parameter_indices],
        constraint_multipliers=iterate.lam_g[transcription.constraint_rows],
    )


def split_simultaneous_switch_times(arc_mesh: ArcMesh) -> ArcMesh:
    """Return the mesh with intervals before and after shared boundaries in which the changing rows are interior."""
    s = arc_mesh.structure
    shared, span = find_simultaneous_switches(s), FREE_INTERVAL * (s.times[-1] - s.times[0])
    times, kinds, subarc_meshes = [s.times[0]], list[tuple[ArcKind, ...]](), list[SubarcMesh]()
    for k, (row, subarc_mesh) in enumerate(zip(s.kinds, arc_mesh.subarc_meshes, strict=True)):
        begins, ends = k in shared, k + 1 in shared
        intervals = [(s.times[k] + span, k)] if begins else []
        intervals += [(s.times[k + 1] - span * ends, 0), (s.times[k + 1], k + 1)][: 1 + ends]
        for end, boundary in intervals:
            changed = s.find_changed_arcs(boundary) if boundary else ()
            times.append(end)
            kinds.append(tuple(ArcKind.INTERIOR if i in changed else kind for i, kind in enumerate(row)))
            subarc_meshes.append(SubarcMesh(1, FREE_INTERVAL_POINTS) if boundary else subarc_mesh)
    touches_by_time = dict(zip(s.times, s.touches, strict=True))
    touches = tuple(touches_by_time.get(t, ()) for t in times)
    structure = replace(s, times=tuple(times), kinds=tuple(kinds), touches=touches)
    return replace(arc_mesh, structure=structure, subarc_meshes=tuple(subarc_meshes))
