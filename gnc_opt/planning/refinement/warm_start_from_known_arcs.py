"""Warm start of a modified problem from a refined solution, with its arcs or on its mesh.

With known arcs, the switching-time formulation starts from them; otherwise the known mesh is refined if necessary.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

from gnc_opt.planning.direct.computation_budget import WorkBudget, compute_refinement_work
from gnc_opt.planning.direct.fixed_mesh_solve import WARM_MAX_ITERATIONS, solve_problem_on_mesh
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.arcs.control_structure import PhaseStructure
from gnc_opt.planning.refinement.arcs.structure_detection import detect_arc_structures
from gnc_opt.planning.refinement.arcs.switching_time_optimization import (
    ARC_SOLVE_TOLERANCE,
    optimise_switching_times,
)
from gnc_opt.planning.refinement.best_solution_selection import Candidate, build_final_solution
from gnc_opt.planning.refinement.mesh.hp_refinement import refine_mesh
from gnc_opt.planning.refinement.staged_refinement import FIRST
from gnc_opt.planning.refinement.switching.switching_time_warm_start import truncate_to_start_time
from gnc_opt.planning.solution.refinement_history import History, RefinementStatus
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh, read_meshes

WARM_START_MAX_SOLVES = 6
"""Largest number of solves; more indicate that the known solution is not close."""

KNOWN_ARCS_OPTIONS = SolverOptions(tolerance=ARC_SOLVE_TOLERANCE, max_iterations=30)
"""Initial barrier parameter with known arcs: a nearby solution takes fewer iterations."""

WARM_START_MIN_WORK = 1.0
"""Least work limit of a warm start, s of the reference processor; otherwise the work of the known solution."""


@dataclass(frozen=True, eq=False)
class KnownArcs:
    """Solution and its structures by phase (empty if its mesh was refined without a structure)."""

    solution: Solution
    structures: Mapping[str, PhaseStructure]

    @classmethod
    def from_solution(cls, solution: Solution) -> KnownArcs:
        if not solution.structure:
            return cls(solution, {})
        found = detect_arc_structures(replace(solution, structure=()))
        arcs, phases = solution.structure, solution.phases
        return cls(solution, {name: s.with_listed_arcs(arcs, phases[name]) for name, s in found.items()})

    def solve_with_known_arcs(self, problem: Problem, tol: float, check: bool) -> Solution | None:
        """Return the solution of a modified problem within a tolerance, or None if no nearby solution is found.

        With ``check``, or if arcs or mesh changed, it must pass the optimality check; it contains the verdict. Ctrl-C
        before there is a solution raises `KeyboardInterrupt`.
        """
        begin = time.perf_counter()
        start = replace(
            truncate_to_start_time(self.solution, problem), problem=problem.frozen(), structure=()
        )
        found = (
            self._solve_with_arcs(start, tol)
            if self.structures
            else self._solve_on_known_mesh(start, problem, tol)
        )
        if found is None:
            return None
        candidate = Candidate(*found, "nearby")
        if candidate.history.status is RefinementStatus.INTERRUPTED:
            raise KeyboardInterrupt
        check = check or not self._has_known_structure(candidate)
        if not candidate.history.converged or (check and not candidate.verdict.ok):
            return None
        return build_final_solution([candidate], None, tol, begin, check)

    def _solve_with_arcs(self, start: Solution, tol: float) -> tuple[Solution, History]:
        left = {
            name: s.truncate_before(start.phases[name].initial_time) for name, s in self.structures.items()
        }
        return optimise_switching_times(
            start,
            tol=tol,
            budget=self._create_work_budget(),
            structures=left,
            options=KNOWN_ARCS_OPTIONS,
            segments="nearby",
        )

    def _solve_on_known_mesh(
        self, start: Solution, problem: Problem, tol: float
    ) -> tuple[Solution, History] | None:
        budget = self._create_work_budget()
        first = budget.allot_share_of_total_work(warm_iterations=WARM_MAX_ITERATIONS)
        found = solve_problem_on_mesh(problem, scheme=start.scheme, guess=start, budget=first)
        if found.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if not found.status.solved:
            return None
        return refine_mesh(found, tol=tol, budget=budget)

    def _has_known_structure(self, found: Candidate) -> bool:
        """Return whether a solution has the arcs of the known one, or the same mesh."""
        known = [(arc.phase, arc.channel, arc.kind) for arc in self.solution.structure]
        same = known == [(arc.phase, arc.channel, arc.kind) for arc in found.solution.structure]
        return same and (bool(known) or len(found.history.passes) == 1)

    def _create_work_budget(self) -> WorkBudget:
        most = max(compute_refinement_work(self.solution), WARM_START_MIN_WORK)
        return WorkBudget(most, max_passes=WARM_START_MAX_SOLVES)


def recover_initial_meshes(known: Solution) -> dict[str, Mesh]:
    """Return the meshes of the first stage of a refinement; the default meshes if only its arcs or meshes are known."""
    passes = () if known.history is None else known.history.passes
    meshes = next((p.meshes for p in passes if p.stage == FIRST), None)
    return read_meshes(meshes, known.phases, known.problem_name)
