"""Solution of a problem on one mesh, with repeated attempts after failures.

If a start from a solution fails, it is repeated from its trajectory without multipliers. A failed cold start is
repeated with careful pivoting if rounding may be the cause, and with IPOPT's adaptive barrier. If the guess is not a
trajectory, it is also repeated from a simulation, and from points that satisfy the constraints without the cost. All
attempts share the limit on wall time.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from gnc_opt.array_types import Array, Indices
from gnc_opt.planning.direct.computation_budget import WorkBudget
from gnc_opt.planning.direct.minimum_norm_multipliers import minimise_multiplier_norm
from gnc_opt.planning.direct.scaled_nlp_setup import ScaledNlp
from gnc_opt.planning.nlp import IterationInfo, NlpPoint, NlpResult, SolverOptions, Status
from gnc_opt.planning.nlp.nlp_solver_options import Start
from gnc_opt.planning.problem.guess.random_guess import with_random_guess
from gnc_opt.planning.problem.guess.simulated_guess import with_simulated_guess
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.reformulation import reformulate_problem
from gnc_opt.planning.solution.initial_nlp_point import (
    build_nlp_point_from_guess,
    choose_initial_variables,
    fix_mesh_breaks,
    guess_from_solution,
)
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.collocation_families import GAUSS, Scheme
from gnc_opt.planning.transcription.mesh import Mesh, MeshLike, read_meshes
from gnc_opt.planning.transcription.transcription import Transcription

TRY_MAX_ITERATIONS = 300
"""Iterations of an attempt if others follow and the guess is not a trajectory."""

WARM_MAX_ITERATIONS = 150
"""Iterations after which a start near a known solution, or the first one from straight lines, is ended. None of 84
problems solved from straight lines needs more than 143."""

ROUNDING_STATUSES = (Status.ACCEPTABLE, Status.STEP_TOO_SMALL, Status.SEARCH_DIRECTION_FAILED)
"""Statuses that rounding in the linear solver can cause; the solve is repeated with careful pivoting."""

FEASIBILITY_STATUSES = (Status.INFEASIBLE, Status.RESTORATION_FAILED)
"""Statuses after which the constraints are solved without the cost from several initial points: a cost, above all of a
free final time, can drive the iterates to points where the constraint violation is stationary. Too short durations are
the most frequent cause, so that longer ones are tried."""

INCONCLUSIVE_STATUSES = (*ROUNDING_STATUSES[1:], Status.RESTORATION_FAILED, Status.ITERATION_LIMIT)
"""Statuses that do not indicate a property of the problem."""

TRAJECTORY_START_BARRIER = 1e-2
"""Initial barrier parameter of a start from a trajectory without multipliers."""

FIXED_TIME_FACTORS = (1.0, 4.0, 16.0, 64.0)
"""Multiples of the guessed times that are fixed while the constraints are solved."""

FEASIBILITY_RANDOM_STARTS, FEASIBILITY_SEED = 2, 1
"""Number of random starts with free durations, if the guess does not lead to a feasible point."""


def solve_problem_on_mesh(
    problem: Problem,
    mesh: MeshLike | Mapping[str, MeshLike] | None = None,
    *,
    scheme: Scheme = GAUSS,
    guess: Solution | None = None,
    options: SolverOptions | None = None,
    budget: WorkBudget | None = None,
    progress: bool = False,
) -> Solution:
    """Return the last iterate of a problem on one mesh, solved or not, after as many attempts as necessary.

    The problem has passed its `check`. By default the mesh is that of the guess, if it has the same phases, else
    `DEFAULT_MESH`. At the limits of a budget, to which the work is added, it ends as `Status.ITERATION_LIMIT`.
    """
    settings, problem = options or SolverOptions(), reformulate_problem(problem)
    if mesh is None and guess is not None and set(guess.phases) == set(problem.phases):
        guess_phases = {name: guess.phases[name] for name in problem.phases}
        # Boundaries that were moved with arcs would otherwise move to where the points have the least accuracy.
        meshes = {n: fix_mesh_breaks(p) if guess.structure else p.mesh for n, p in guess_phases.items()}
    else:
        meshes = read_meshes(mesh, problem.phases, problem.name)
    budget = WorkBudget() if budget is None else budget
    max_iterations = budget.count_remaining_iterations(problem, meshes)
    task = _FixedMeshSolve(problem, meshes, scheme, settings, progress, budget, max_iterations)
    solution = task.solve_from_known_solution(guess)
    budget.record_solve_work(solution)
    return solution


@dataclass(frozen=True, eq=False)
class _FixedMeshSolve:
    problem: Problem
    meshes: Mapping[str, Mesh]
    scheme: Scheme
    options: SolverOptions
    progress: bool
    budget: WorkBudget
    max_iterations: int | None

    def solve_from_known_solution(self, guess: Solution | None) -> Solution:
        """Solve from a solution with its multipliers; if that fails, from its trajectory only."""
        max_warm = self.budget.warm_iterations
        if guess is None or max_warm is None:
            return self.solve_with_retries(guess)
        if max_warm == 0:
            return self.solve_from_known_trajectory(guess)
        limited = replace(self.options, max_iterations=min(max_warm, self.options.max_iterations))
        first = replace(self, options=limited).solve_with_retries(guess)
        allowed = self.max_iterations
        remaining = None if allowed is None else max(0, allowed - first.statistics.iterations)
        is_final = first.status.solved or first.status is Status.INTERRUPTED
        if is_final or remaining == 0 or time.thread_time() > self.budget.cpu_deadline:
            return first
        return replace(self, max_iterations=remaining).solve_from_known_trajectory(guess, after=first)

    def solve_from_known_trajectory(self, guess: Solution, *, after: Solution | None = None) -> Solution:
        """Solve from the trajectory of a solution, without its multipliers."""
        start = guess_from_solution(self.problem, guess)
        options = replace(self.options, mu_init=TRAJECTORY_START_BARRIER)
        solution = replace(self, problem=start, options=options).solve_with_retries(after=after)
        return replace(solution, problem=self.problem.frozen())

    def solve_with_retries(self, guess: Solution | None = None, *, after: Solution | None = None) -> Solution:
        """Solve from a guess; effort and wall time of an earlier attempt (``after``) are included."""
        setup = self.problem, self.meshes, self.scheme, guess, self.options
        attempt = ScaledNlp.from_problem(*setup, progress=self.progress)
        point = attempt.build_scaled_nlp_point(attempt.start, attempt.known)
        attempt.solver.create_nlp_solver(point)  # the time limit excludes the setup
        earlier_s = after.statistics.solve_s if after else 0.0
        deadline = min(self.budget.deadline, attempt.solver.compute_deadline() - earlier_s)
        attempts = _SolveAttempts(attempt, self.max_iterations, self.budget.cpu_deadline, deadline)
        attempts.run_solve_attempts(point, search=guess is None and not has_trajectory_guess(self.problem))
        result = attempts.select_conclusive_solver_result()
        if attempts.is_iteration_or_cpu_limit_hit and result.status is Status.INTERRUPTED:
            result = replace(result, status=Status.ITERATION_LIMIT)
        if result.status.solved:
            result = minimise_multiplier_norm(attempt.transcription, point, result)
        found = attempt.build_solution_from_nlp_result(result)
        return replace(found, statistics=found.statistics.add_earlier(after.statistics)) if after else found


@dataclass(eq=False)
class _SolveAttempts:
    """Attempts from several points with common limits; results of all (``spent``), of those with cost (``whole``)."""

    attempt: ScaledNlp
    most: int | None
    cpu_deadline: float
    deadline: float
    count: int = 0
    spent: list[NlpResult] = field(default_factory=list)
    whole: list[NlpResult] = field(default_factory=list)

    def run_solve_attempts(self, point: NlpPoint, *, search: bool) -> None:
        """Solve from a point, then with other numerical options; with ``search`` also from other points."""
        options = self.attempt.solver.options
        ipopt = options.solver == "ipopt"
        cold = ipopt and point.warm_or_cold_start == "cold" and options.max_iterations > TRY_MAX_ITERATIONS
        search = search and cold
        first = self._solve_nonlinear_program(point, most=WARM_MAX_ITERATIONS if search else None)
        if first.status in ROUNDING_STATUSES and ipopt and not options.careful_pivoting:
            reached = replace(point, x0=first.x, lam_x0=first.lam_x, lam_g0=first.lam_g)
            self._solve_nonlinear_program(reached, "careful", most=TRY_MAX_ITERATIONS)
        is_numerical = ipopt and first.status in (*ROUNDING_STATUSES, Status.RESTORATION_FAILED)
        if self._is_solve_finished or not (cold or is_numerical):
            return
        is_cut_off = first.status is Status.ITERATION_LIMIT
        most = TRY_MAX_ITERATIONS if search else None
        self._solve_nonlinear_program(point.drop_multipliers(), "adaptive", most=most if is_cut_off else None)
        if self._is_solve_finished or not search or not (is_cut_off or first.status in FEASIBILITY_STATUSES):
            return
        simulated = with_simulated_guess(self.attempt.problem)
        if simulated is not None:
            start = choose_initial_variables(self.attempt.transcription, simulated)
            self._solve_nonlinear_program(self.attempt.build_scaled_nlp_point(start), most=most)
        if not self._is_solve_finished:
            self._solve_from_feasible_points()
        if is_cut_off and not self._is_solve_finished:
            self._solve_nonlinear_program(point)

    def select_conclusive_solver_result(self) -> NlpResult:
        """Return the solution; without one the first conclusive failure, or else the first failure."""
        last, first = self.spent[-1], self.spent[0]
        if last.status.solved or first.status.solved:
            return (last if last.status.solved else first).with_summed_iterations_and_times(self.spent)
        conclusive = [r for r in self.whole if r.status not in INCONCLUSIVE_STATUSES]
        fallback = self.whole[-1] if first.status is Status.ITERATION_LIMIT else first
        if last.status is Status.INTERRUPTED and not conclusive:
            return last.with_summed_iterations_and_times(self.spent)
        return (conclusive[0] if conclusive else fallback).with_summed_iterations_and_times(self.spent)

    @property
    def is_iteration_or_cpu_limit_hit(self) -> bool:
        is_spent = self.most is not None and self.count >= self.most
        return is_spent or time.thread_time() > self.cpu_deadline

    @property
    def _is_solve_finished(self) -> bool:
        is_over = self.is_iteration_or_cpu_limit_hit or time.perf_counter() > self.deadline
        is_solved = self.spent[-1].status.solved or self.spent[0].status.solved
        return is_over or is_solved or self.spent[-1].status is Status.INTERRUPTED

    def _solve_nonlinear_program(
        self, point: NlpPoint, way: Start | None = None, *, most: int | None = None, with_cost: bool = True
    ) -> NlpResult:
        is_cut_off = False
        with self.attempt.display_solver_progress(with_cost=with_cost) as show:

            def stop_at_iteration_limit(info: IterationInfo) -> bool:
                nonlocal is_cut_off
                show(info)
                self.count += info.iteration > 0
                is_cut_off = most is not None and info.iteration >= most
                return is_cut_off or self.is_iteration_or_cpu_limit_hit

            solver, stop = self.attempt.solver, stop_at_iteration_limit
            result = solver.solve(point, way, callback=stop, deadline=self.deadline)
        if is_cut_off and result.status is Status.INTERRUPTED:
            result = replace(result, status=Status.ITERATION_LIMIT)
        self.spent.append(result)
        if with_cost:
            self.whole.append(result)
        return result

    def _solve_from_feasible_points(self) -> None:
        """Solve from points that satisfy the constraints, until a status is not in `FEASIBILITY_STATUSES`."""
        attempt = self.attempt
        starts = generate_feasibility_initial_points(attempt.transcription, attempt.problem, attempt.start)
        for variables, fixed in starts:
            point = attempt.build_scaled_nlp_point(variables, held=fixed, with_cost=False)
            feasible = self._solve_nonlinear_program(point, most=TRY_MAX_ITERATIONS, with_cost=False)
            if feasible.status.solved:
                restart = attempt.build_scaled_nlp_point(feasible.x * attempt.scaling.variables)
                self._solve_nonlinear_program(restart, most=TRY_MAX_ITERATIONS)
                if self.spent[-1].status not in FEASIBILITY_STATUSES:
                    return
            if self._is_solve_finished:
                return


def generate_feasibility_initial_points(
    transcription: Transcription, problem: Problem, start: Array
) -> Iterator[tuple[Array, Indices]]:
    """Yield initial points: the guess with free times, with times fixed at multiples of the guess, random ones.

    Each is the physical variables (n_variables,), and indices of those fixed until the constraints are satisfied.
    """
    all_times = np.concatenate([part.times for part in transcription.parts.values()])
    times = np.unique(all_times[all_times < transcription.n_variables])
    bounds = transcription.get_variable_bounds(problem)
    yield start, times[:0]
    earlier_values: list[Array] = []
    for stretch in FIXED_TIME_FACTORS if times.size else ():
        values = np.clip(stretch * start[times], bounds.lower[times], bounds.upper[times])
        if any(np.array_equal(values, earlier) for earlier in earlier_values):
            continue
        earlier_values.append(values)
        stretched = start.copy()
        stretched[times] = values
        yield stretched, times
    for index in range(1, FEASIBILITY_RANDOM_STARTS + 1):
        randomised = with_random_guess(problem, FEASIBILITY_SEED, index)
        yield build_nlp_point_from_guess(transcription, randomised), times[:0]


def has_trajectory_guess(problem: Problem) -> bool:
    """Return whether the guess is a trajectory over time, and not only end values."""
    for guess in (phase.numbers.guess for phase in problem.phases.values()):
        has_times = guess.time is not None and guess.time.size > 2
        if any(callable(value) or has_times for value in guess.values.values()):
            return True
    return False
