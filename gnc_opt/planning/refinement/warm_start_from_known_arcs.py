"""Warm start of a modified problem from a refined solution: with its switching times, its arcs or on its mesh.

If all controls are at bounds, Newton's method starts from the known switching times. With other known arcs, the
switching-time formulation starts from them; otherwise the known mesh is refined if necessary.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import EQUAL, INNER_TOLERANCE_SHARE
from gnc_opt.planning.direct.computation_budget import WorkBudget, compute_refinement_work
from gnc_opt.planning.direct.fixed_mesh_solve import WARM_MAX_ITERATIONS, solve_problem_on_mesh
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.optimality.bang_bang_sensitivity import FLOW_INITIAL_STEPS
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.arcs.control_structure import PhaseStructure
from gnc_opt.planning.refinement.arcs.structure_detection import (
    detect_arc_structures,
    detect_control_structure,
)
from gnc_opt.planning.refinement.arcs.switching_time_optimization import optimise_switching_times
from gnc_opt.planning.refinement.best_solution_selection import Candidate, build_best_solution
from gnc_opt.planning.refinement.hp_refinement import refine_mesh
from gnc_opt.planning.refinement.staged_refinement import FIRST
from gnc_opt.planning.refinement.switching.bang_bang_extremal import (
    BangBangExtremal,
    NewtonStep,
    satisfies_inequality_limits,
)
from gnc_opt.planning.refinement.switching.newton_iteration import find_optimal_switching_times
from gnc_opt.planning.solution.phase_solution import truncate_phase_to_start_time
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial
from gnc_opt.planning.solution.refinement_history import RefinementStatus
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh, read_meshes
from gnc_opt.planning.verification.solution_data_check import recompute_stored_data

WARM_START_MAX_SOLVES = 6
"""Largest number of solves; more indicate that the known solution is not close."""

KNOWN_ARCS_OPTIONS = SolverOptions(max_iterations=30)
"""Options with known arcs: a nearby solution takes fewer iterations."""

WARM_START_MIN_WORK = 1.0
"""Least work limit of a warm start, s of the reference processor; otherwise the work of the known solution."""


@dataclass(frozen=True, eq=False)
class KnownSwitches:
    """Known one-phase solution for modifications of its problem; ``step`` is the Newton step at its optimum."""

    solution: Solution
    structure: PhaseStructure
    state_scale: Array
    step: NewtonStep | None = None

    @classmethod
    def from_solution(cls, solution: Solution) -> KnownSwitches | None:
        """Return the data of a refined solution; None unless all its arcs are those of controls at bounds."""
        labels = {label for phase in solution.phases.values() for label in phase.controls.labels}
        all_bounded = all(arc.kind.is_at_limit and arc.channel in labels for arc in solution.structure)
        if not solution.structure or len(solution.phases) != 1 or not all_bounded:
            return None
        (s,) = solution.samples().values()
        structure = detect_control_structure(s).replace_arcs(solution.structure, s.phase)
        return cls(replace(solution, structure=()), structure, s.state_scale)

    def with_newton_step(self) -> KnownSwitches | None:
        """Return the same data with the Newton step; None if Newton's method does not apply."""
        optimum = _find_accurate_switching_times(self.solution, self.structure, EQUAL)
        if optimum is None:
            return None
        half = replace(optimum[1].step, steps=FLOW_INITIAL_STEPS // 2)  # of the converged structure
        finer = _find_accurate_switching_times(self.solution, optimum[0], INNER_TOLERANCE_SHARE * EQUAL, half)
        structure, flight = finer or optimum
        return replace(self, structure=structure, step=flight.step)

    def solve_with_known_switches(self, problem: Problem) -> Solution | None:
        """Return the solution of a modified problem with its own switching times; None if that fails."""
        start = truncate_solution_to_start_time(self.solution, problem)
        (phase,) = start.phases.values()
        remaining = self.structure.truncate_arcs_before(phase.initial_time)
        step = self.step if remaining.n_subarcs == self.structure.n_subarcs else None
        start = recompute_stored_data(replace(start, problem=problem.frozen()))
        shifted = _shift_trajectory_to_initial_states(start)
        optimum = None if shifted is None else _find_accurate_switching_times(shifted, remaining, EQUAL, step)
        if shifted is None or optimum is None:
            return None
        structure, flight = optimum
        trajectory = flight.build_solution(shifted)
        if not satisfies_inequality_limits(trajectory, self.state_scale):
            return None
        labels = (*phase.controls.labels, *phase.path_labels, *phase.states.labels)
        return replace(trajectory, structure=structure.list_arcs(phase.name, labels))


def _find_accurate_switching_times(
    solution: Solution, structure: PhaseStructure, accuracy: float, known_step: NewtonStep | None = None
) -> tuple[PhaseStructure, BangBangExtremal] | None:
    """Return structure and extremal if the cost is accurate and no arc is missing, else None."""
    optimum = find_optimal_switching_times(solution, structure, accuracy, known_step)
    return optimum if optimum is not None and optimum[1].is_cost_accurate(accuracy) else None


def truncate_solution_to_start_time(known_solution: Solution, problem: Problem) -> Solution:
    """Return the part of a known solution after the start of a modified problem, without arcs."""
    if len(known_solution.phases) != 1:
        return known_solution
    ((name, phase),) = known_solution.phases.items()
    start, first, last = problem.phases[name].numbers.initial_time, phase.initial_time, phase.final_time
    if start is None or not start.is_fixed[0] or not first < start.lower[0] < last:
        return known_solution
    remaining_phase = truncate_phase_to_start_time(phase, float(start.lower[0]))
    return replace(known_solution, phases={name: remaining_phase}, structure=())


def _shift_trajectory_to_initial_states(known_solution: Solution) -> Solution | None:
    """Return the trajectory shifted to the initial states of its problem; None if the problem fixes other times."""
    (phase,) = known_solution.phases.values()
    for bounds, t in (
        (phase.initial_time_bounds, phase.initial_time),
        (phase.final_time_bounds, phase.final_time),
    ):
        if bounds.is_fixed[0] and bounds.lower[0] != t:
            return None
    initial_bounds = phase.initial_bounds
    offset = np.where(initial_bounds.is_fixed, initial_bounds.lower - phase.x(phase.breaks[0]), 0.0)
    x = PiecewisePolynomial(phase.x.breaks, phase.x.nodes, tuple(v + offset[:, None] for v in phase.x.values))
    return replace(known_solution, phases={phase.name: replace(phase, x=x)})


@dataclass(frozen=True, eq=False)
class KnownArcs:
    """Solution and its structures by phase (empty if its mesh was refined without a structure)."""

    solution: Solution
    structures: Mapping[str, PhaseStructure]

    @classmethod
    def from_solution(cls, solution: Solution) -> KnownArcs:
        if not solution.structure:
            return cls(solution, {})
        detected = detect_arc_structures(replace(solution, structure=()))
        arcs, phases = solution.structure, solution.phases
        return cls(solution, {name: s.replace_arcs(arcs, phases[name]) for name, s in detected.items()})

    def solve_with_known_arcs(self, problem: Problem, tol: float, check: bool) -> Solution | None:
        """Return the solution of a modified problem within a tolerance, or None if no nearby solution is found.

        With ``check``, or if arcs or mesh changed, it must pass the optimality check. Ctrl-C before there is a solution
        raises `KeyboardInterrupt`.
        """
        begin = time.perf_counter()
        start = truncate_solution_to_start_time(self.solution, problem)
        start = replace(start, problem=problem.frozen(), structure=())
        max_work = max(compute_refinement_work(self.solution), WARM_START_MIN_WORK)
        budget = WorkBudget(max_work, max_passes=WARM_START_MAX_SOLVES)
        if self.structures:
            phases, arcs = start.phases, self.structures.items()
            result = optimise_switching_times(
                start,
                tol=tol,
                budget=budget,
                structures={name: s.truncate_arcs_before(phases[name].initial_time) for name, s in arcs},
                options=KNOWN_ARCS_OPTIONS,
                segments="nearby",
            )
        else:
            warm = budget.allot_work_budget_share(warm_iterations=WARM_MAX_ITERATIONS)
            first = solve_problem_on_mesh(problem, scheme=start.scheme, guess=start, budget=warm)
            if first.status is Status.INTERRUPTED:
                raise KeyboardInterrupt
            if not first.status.solved:
                return None
            result = refine_mesh(first, tol=tol, budget=budget)
        candidate = Candidate(*result, "nearby")
        if candidate.history.status is RefinementStatus.INTERRUPTED:
            raise KeyboardInterrupt
        check = check or not self._has_arcs_of_known_solution(candidate)
        if not candidate.history.converged or (check and not candidate.verdict.ok):
            return None
        return build_best_solution([candidate], None, tol, begin, check)

    def _has_arcs_of_known_solution(self, found: Candidate) -> bool:
        """Return whether a solution has the arcs of the known one, or the same mesh."""
        known_arcs = [(arc.phase, arc.channel, arc.kind) for arc in self.solution.structure]
        has_same_arcs = known_arcs == [(arc.phase, arc.channel, arc.kind) for arc in found.solution.structure]
        return has_same_arcs and (bool(known_arcs) or len(found.history.passes) == 1)


def restore_initial_refinement_meshes(known_solution: Solution) -> dict[str, Mesh]:
    """Return the meshes of the first stage of a refinement; the default meshes if only its arcs or meshes are known."""
    passes = () if known_solution.history is None else known_solution.history.passes
    meshes = next((p.meshes for p in passes if p.stage == FIRST), None)
    return read_meshes(meshes, known_solution.phases, known_solution.problem_name)
