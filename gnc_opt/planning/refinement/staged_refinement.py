"""Sequence of solves for an accurate solution that passes the optimality check.

``docs/refinement.md`` lists the stages. Every converged solution is a `Candidate`. The first one that passes the
optimality check with local errors within the tolerance is returned at once; without a check, the first one whose
estimated error of the objective is within the tolerance. If another stage on the first mesh finds a lower cost, the
first stage is repeated from its solution, and finer stages start from it. At the end, at limits and after Ctrl-C the
best candidate is returned (`best_solution_selection.select_best_candidate`).
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias, get_args

import numpy as np

from gnc_opt.argument_checks import read_positive_number, require_type, suggest_keywords
from gnc_opt.errors import ProblemError, suggest_similar_name
from gnc_opt.planning.direct.computation_budget import RefinementLimits, WorkBudget
from gnc_opt.planning.direct.fixed_mesh_solve import WARM_MAX_ITERATIONS, solve_problem_on_mesh
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.problem.guess.simulated_guess import with_simulated_guess
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.arcs.control_structure import PhaseStructure
from gnc_opt.planning.refinement.arcs.hamiltonian_convexity import mask_affine_controls
from gnc_opt.planning.refinement.arcs.structure_detection import detect_arc_structures
from gnc_opt.planning.refinement.arcs.switching_time_optimization import Segments, optimise_switching_times
from gnc_opt.planning.refinement.best_solution_selection import Candidate, build_best_solution
from gnc_opt.planning.refinement.hp_refinement import refine_mesh
from gnc_opt.planning.solution.initial_nlp_point import fix_mesh_breaks
from gnc_opt.planning.solution.refinement_history import RefinementStatus
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.verification.hamiltonian_minimum import minimise_hamiltonian
from gnc_opt.threads_and_package_versions import limit_to_one_thread

MIDDLE_SEGMENTS, FINE_SEGMENTS, STAGE_DEGREE = 60, 200, 3
"""Segments of the two finer stages in all phases together, at least a quarter of them in each, and their degree."""

STAGE_MAX_SHARE = 0.25
"""Largest share of the budget for a switching-time formulation, or for hp refinement in the first stage."""

TIGHTER_TOLERANCE_SHARES = (1e-2, 1e-4)
"""Further mesh tolerances relative to ``tol``, used in turn while only the optimality check fails and each one at least
halves the estimated error of the objective."""

FIRST, MINIMUM_OF_H, HP = "first mesh", "minimum of H", "hp refinement"
MIDDLE, FINE = f"{MIDDLE_SEGMENTS} segments", f"{FINE_SEGMENTS} segments"
"""Names of the stages."""

BARRIER_OPTION = "ipopt.mu_strategy"


StructureChoice: TypeAlias = Literal["auto", "bang-bang", "none"]


@limit_to_one_thread()
@suggest_keywords
def refine(
    solution: Solution,
    *,
    tol: float = 1e-8,
    structure: StructureChoice = "auto",
    check: bool = True,
    limits: RefinementLimits | None = None,
    options: SolverOptions | None = None,
    progress: bool = False,
) -> Solution:
    """Return a more accurate solution of the same problem, with its ``history``.

    Parameters
    ----------
    solution : Solution
        A converged solution with its problem. Arcs fixed by `Problem.with_fixed_arcs` belong to its mesh: the refined
        solution is one of the problem without them.
    tol : float
        On the local errors (`gnc_opt.planning.refinement.collocation_error_estimate`) and on the estimated
        relative error of the objective (`gnc_opt.planning.solution.solution_accuracy`).
    structure : {"auto", "bang-bang", "none"}
        ``"none"``: hp refinement of the mesh. ``"bang-bang"``: detect the bound arcs of each control, optimise their
        switching times, and update the structure until it agrees with the switching functions. Kinks at which controls
        enter or leave bounds or mixed path constraints, singular arcs and arcs on state bounds are detected likewise.
        ``"auto"``: the stages of ``docs/refinement.md``.
    check : bool
        Whether the solution must pass the optimality check. Without the check, the first solution is returned whose
        estimated error of the objective is within the tolerance; its history ends as UNCHECKED.
    limits : RefinementLimits, optional
        On passes, points, work and wall time. At a limit, and after Ctrl-C, the best solution so far is returned.
    options : SolverOptions, optional
        Options of the solves; a wall time limit in them applies to one solve.
    progress : bool
        Print one line per pass.

    Returns
    -------
    Solution
        With ``history`` and, if switching times were optimised, ``structure``. The history ends as CONVERGED only if
        the tolerance was reached and no condition of the optimality check fails; otherwise its message lists them. The
        verdict is stored in the solution: ``verify(solution)`` returns it without another check.

    Raises
    ------
    GncOptError
        The solution has no problem or is not solved.
    ProblemError
        ``structure`` is unknown, or is ``"bang-bang"`` and no control is linear in H with finite bounds.

    Examples
    --------
    >>> coarse = go.solve(problem, mesh="5x3", tol=None)
    >>> print(abs(coarse.objective - 2) < 1e-6, abs(go.refine(coarse).objective - 2) < 1e-8)
    False True
    """
    require_type(solution, Solution, "the argument of refine()", "write refine(solve(problem))")
    read_positive_number(tol, "the tolerance of refine()")
    limits = limits or RefinementLimits()
    require_type(limits, RefinementLimits, "the limits of refine()", "write RefinementLimits(max_points=500)")
    solution.need_solved_problem("refine")
    budget = WorkBudget.start_work_budget(limits)
    return StagedRefinement(solution, tol, budget, check, options, progress).run_stages(structure)


@dataclass(eq=False)
class StagedRefinement:
    """Search for an accurate solution from the ``first`` one, on a first mesh: settings, work budget and candidates.

    ``begin`` is the time at which the search began, s, of `time.perf_counter`; ``_first_solve`` that of ``first``.
    """

    first: Solution
    tol: float
    budget: WorkBudget
    check: bool = True
    options: SolverOptions | None = None
    progress: bool = False
    begin: float = field(default_factory=time.perf_counter)
    candidates: list[Candidate] = field(default_factory=list)
    _first_solve: Candidate | None = None
    _converged_orders: list[dict[str, PhaseStructure]] = field(default_factory=list)

    def run_stages(self, structure: StructureChoice) -> Solution:
        """Return the best solution that the stages find; see `refine`."""
        if structure not in get_args(StructureChoice):
            similar = suggest_similar_name(str(structure), get_args(StructureChoice))
            raise ProblemError(f"refine() has no structure {structure!r}: {similar}")
        stop: RefinementStatus | None = None
        try:
            for candidate in self._iterate_stages_of_structure(structure):
                self._record_candidate_solution(candidate)
                stop = self._classify_termination(candidate)
                if stop is not None:
                    break
        except KeyboardInterrupt:
            stop = RefinementStatus.INTERRUPTED
        if stop is RefinementStatus.CONVERGED:
            stop = None
        elif not any(c.is_solved and c.solution is self.first for c in self.candidates):
            self.candidates.append(Candidate.from_solve(self.first, self.tol, self.begin, FIRST))
        return build_best_solution(self.candidates, stop, self.tol, self.begin, self.check, self._first_solve)

    def _iterate_stages_of_structure(self, structure: StructureChoice) -> Iterator[Candidate]:
        self._solve_without_fixed_arcs()
        if structure == "auto":
            yield from self._iterate_refinement_stages()
        elif structure == "none":
            self._record_candidate_solution(Candidate.from_solve(self.first, self.tol, self.begin, FIRST))
            yield from self._refine_mesh_by_hp(self.first, 1.0)
        else:
            structures = detect_arc_structures(self.first)
            is_linear = any(np.any(mask_affine_controls(s)) for s in self.first.samples().values())
            if not (is_linear or _has_arcs(structures)):
                raise ProblemError(
                    f"no control of '{self.first.problem_name}' enters the Hamiltonian linearly between two finite "
                    'bounds: use structure="none".'
                )
            yield from self._solve_with_arcs(self.first, FIRST, structures, share=1.0)

    # --- sequence of solves -------------------------------------------------------------------------------------

    def _record_candidate_solution(self, candidate: Candidate) -> None:
        self.candidates.append(candidate)
        solved = [c for c in self.candidates if c.is_solved]
        accurate = [c for c in solved if c.largest_local_error <= self.tol or c.is_cost_accurate(self.tol)]
        lowest = [c for c in accurate if not any(other.has_lower_cost(c) for other in solved)]
        self.budget.limit_work_to_completing_solution(bool(lowest))

    def _classify_termination(self, candidate: Candidate) -> RefinementStatus | None:
        status = candidate.history.status
        if status is RefinementStatus.INTERRUPTED or time.perf_counter() > self.budget.deadline:
            return RefinementStatus.INTERRUPTED
        if self._is_acceptable_final_solution(candidate):
            return RefinementStatus.CONVERGED
        return RefinementStatus.BUDGET_LIMIT if self.budget.remaining_work <= 0 else None

    def _is_acceptable_final_solution(self, candidate: Candidate) -> bool:
        if not candidate.is_solved:
            return False
        if not self.check:
            return candidate.is_cost_accurate(self.tol) and not candidate.is_false_extremal
        has_final_arcs = bool(candidate.solution.structure) and candidate.history.converged
        return (candidate.largest_local_error <= self.tol or has_final_arcs) and candidate.verdict.ok

    def _iterate_refinement_stages(self) -> Iterator[Candidate]:
        first = self._first_solve = Candidate.from_solve(self.first, self.tol, self.begin, FIRST)
        yield from self._refine_first_mesh(first)
        for stage, solve in (
            (MINIMUM_OF_H, self._solve_from_minimum_hamiltonian),
            ("adaptive barrier", self._solve_with_adaptive_barrier),
        ):
            alternative = solve(first, stage)
            if alternative is not None:
                yield alternative
                if alternative.has_lower_cost_on_same_mesh(first):
                    first = alternative
                    yield from self._refine_first_mesh(first)
        middle = yield from self._solve_on_medium_mesh(first.solution)
        with_arcs = [c.history.passes for c in self.candidates if c.stage.endswith("switching times")]
        if not any(p.solved for passes in with_arcs for p in passes):
            yield from self._solve_with_arcs(middle, f"{MIDDLE}, switching times")
        fine = self._solve_on_mesh(FINE, self._build_uniform_meshes(FINE_SEGMENTS, middle), middle)
        yield fine
        if fine.is_solved:
            restarted = self._solve_from_minimum_hamiltonian(fine, f"{FINE}, {MINIMUM_OF_H}")
            if restarted is not None:
                yield restarted
            yield from self._solve_with_arcs(fine.solution, f"{FINE}, switching times")
        yield from self._refine_best_mesh()

    def _refine_first_mesh(self, first: Candidate) -> Iterator[Candidate]:
        structures = detect_arc_structures(first.solution)
        has_arcs = _has_arcs(structures)
        if has_arcs:
            yield from self._solve_with_arcs(first.solution, f"{first.stage}, switching times", structures)
        if first is self._first_solve:
            yield first
        if not has_arcs or first.is_cost_accurate(self.tol):
            yield from self._refine_mesh_by_hp(first.solution, STAGE_MAX_SHARE, f"{first.stage}, {HP}")

    def _solve_on_medium_mesh(self, first: Solution) -> Generator[Candidate, None, Solution]:
        """Yield the candidates of the stage with 60 segments; return the solution from which the next stage starts."""
        meshes = self._build_uniform_meshes(MIDDLE_SEGMENTS, first)
        best = self._solve_on_mesh(MIDDLE, meshes, first)
        yield best
        simulated = with_simulated_guess(self.first.need_problem("refine"))
        if simulated is not None:
            max_iterations = WARM_MAX_ITERATIONS + first.statistics.iterations
            stage = f"{MIDDLE}, integrated guess"
            second = self._solve_on_mesh(stage, meshes, None, simulated, max_iterations)
            yield second
            if second.is_solved and (not best.is_solved or second.has_lower_cost_on_same_mesh(best)):
                best = second
        return best.solution if best.is_solved else first

    def _refine_best_mesh(self) -> Iterator[Candidate]:
        """Refine the best mesh, then solve with its arcs; refine further while only the optimality check fails."""
        meshes = [c for c in self.candidates if c.is_solved and not c.solution.structure]
        start = min(meshes, key=lambda c: c.get_errors_for_solution_ranking(self.tol))
        refined = yield from self._refine_mesh_by_hp(start.solution, 1.0)
        yield from self._solve_with_arcs(refined.solution, f"{HP}, switching times", segments="kept")
        for share in TIGHTER_TOLERANCE_SHARES:
            if not refined.largest_local_error <= self.tol:
                return
            finer = yield from self._refine_mesh_by_hp(refined.solution, 1.0, HP, share * self.tol)
            if not finer.objective_error <= 0.5 * refined.objective_error:
                return
            refined = finer

    # --- single solves ------------------------------------------------------------------------------------------------

    def _solve_without_fixed_arcs(self) -> None:
        """Solve the problem on the first mesh without its fixed arcs, which belong to that mesh, if it has any."""
        problem = self.first.need_problem("refine")
        for name, phase in problem.phases.items():
            if phase.numbers.arcs is not None:
                problem = problem.with_fixed_arcs(name, arcs=None)
        if problem is not self.first.problem:
            self.first = replace(self.first, problem=problem.frozen())
            meshes = {name: fix_mesh_breaks(phase) for name, phase in self.first.phases.items()}
            candidate = self._solve_on_mesh(FIRST, meshes, self.first)
            self.first = candidate.solution if candidate.is_solved else self.first

    def _build_uniform_meshes(self, segments: int, solution: Solution) -> dict[str, Mesh]:
        """Return uniform meshes with a total number of segments; phases with a finer mesh keep it."""
        segments_per_phase = max(segments // len(solution.phases), segments // 4)
        uniform = Mesh.uniform(segments_per_phase, STAGE_DEGREE)
        return {name: max(uniform, p.mesh, key=lambda m: m.size) for name, p in solution.phases.items()}

    def _solve_on_mesh(
        self,
        stage: str,
        meshes: Mapping[str, Mesh],
        guess: Solution | None,
        problem: Problem | None = None,
        iterations: int | None = None,
        options: SolverOptions | None = None,
        trajectory_only: bool = False,
    ) -> Candidate:
        begin = time.perf_counter()
        solution = solve_problem_on_mesh(
            problem or self.first.need_problem("refine"),
            meshes,
            scheme=self.first.scheme,
            guess=guess,
            options=options or self.options,
            budget=self.budget.allot_work_budget_share(
                max_iterations=iterations, warm_iterations=0 if trajectory_only else None
            ),
            progress=self.progress,
        )
        if solution.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        solution = replace(solution, problem=self.first.problem)
        return Candidate.from_solve(solution, self.tol, begin, stage)

    def _solve_from_minimum_hamiltonian(self, start: Candidate, stage: str) -> Candidate | None:
        """Solve on the same mesh from the controls that minimise H, if the present controls do not minimise it."""
        if not start.is_false_extremal:
            return None
        meshes = {name: phase.mesh for name, phase in start.solution.phases.items()}
        guess = guess_by_minimum_hamiltonian(start.solution)
        return self._solve_on_mesh(stage, meshes, guess, iterations=WARM_MAX_ITERATIONS, trajectory_only=True)

    def _solve_with_adaptive_barrier(self, start: Candidate, stage: str) -> Candidate | None:
        """Solve on the same mesh from the problem's own guess, with IPOPT's adaptive barrier strategy."""
        options = self.options or SolverOptions()
        if any(c.is_cost_accurate(self.tol) for c in self.candidates):
            return None
        if options.solver != "ipopt" or BARRIER_OPTION in options.extra or "ipopt" in options.extra:
            return None
        adaptive_options = replace(options, extra={**options.extra, BARRIER_OPTION: "adaptive"})
        meshes = {name: phase.mesh for name, phase in start.solution.phases.items()}
        max_iterations = WARM_MAX_ITERATIONS + start.solution.statistics.iterations
        return self._solve_on_mesh(stage, meshes, None, iterations=max_iterations, options=adaptive_options)

    def _refine_mesh_by_hp(
        self, start: Solution, share: float, stage: str = HP, tol: float | None = None
    ) -> Generator[Candidate, None, Candidate]:
        solution, history = refine_mesh(
            start,
            tol=tol or self.tol,
            budget=self.budget.allot_work_budget_share(share),
            options=self.options,
            progress=self.progress,
        )
        if history.chosen > 0:  # index 0 is the given solution
            history = replace(history, passes=history.passes[1:], chosen=history.chosen - 1)
        candidate = Candidate(solution, history, stage)
        yield candidate
        return candidate

    def _solve_with_arcs(
        self,
        start: Solution,
        stage: str,
        structures: Mapping[str, PhaseStructure] | None = None,
        share: float = STAGE_MAX_SHARE,
        segments: Segments = "few",
    ) -> Iterator[Candidate]:
        """Yield the candidate of the switching-time formulation, if there are arcs whose order has not converged."""
        structures = structures or detect_arc_structures(start)
        arc_order = {name: structure.with_switch_times(()) for name, structure in structures.items()}
        if share < 1.0 and (not _has_arcs(structures) or arc_order in self._converged_orders):
            return
        solution, history = optimise_switching_times(
            start,
            tol=self.tol,
            budget=self.budget.allot_work_budget_share(share),
            structures=structures,
            options=self.options,
            progress=self.progress,
            segments=segments,
        )
        if history.converged:
            self._converged_orders.append(arc_order)
        yield Candidate(solution, history, stage)


def _has_arcs(structures: Mapping[str, PhaseStructure]) -> bool:
    """Return whether a phase has several subarcs, or limits that are touched at its ends."""
    return any(s.n_subarcs > 1 or any(s.touches[0] + s.touches[-1]) for s in structures.values())


def guess_by_minimum_hamiltonian(solution: Solution) -> Solution:
    """Return a guess with the controls that minimise H along the states and costates of a solution.

    A collocation program may converge to controls at which H is stationary but not minimal. If the states are nearly
    optimal, so are the costates.
    """
    phases = dict(solution.phases)
    for name, s in solution.samples().items():
        if s.phase.controls.size:
            times, controls = minimise_hamiltonian(s)
            nearest = np.argmin(np.abs(times[:, None] - s.phase.point_times), axis=0)
            phases[name] = replace(s.phase, u=s.phase.interpolate_point_values(controls[:, nearest]))
    return replace(solution, phases=phases)
