"""solve_mesh: one solve on one mesh, and everything that is tried when it fails.

The tries, in this order:
====================  ======================================  ====================================================
try                   after                                   how
====================  ======================================  ====================================================
`CAREFUL`             endings that rounding can cause         the linear solver pivots with care, from where it stopped
`ADAPTIVE`            endings without a verdict, limit of     IPOPT's adaptive barrier, from the same start
                      iterations of a cold start
`TRAJECTORY_ONLY`     a warm start that has lost its way      the trajectory alone, without its multipliers
`CONSTRAINTS_FIRST`   "infeasible", without a trajectory as   the constraints are met first, the cost is lowered
                      a guess                                 afterwards
`LINES_ITERATIONS`    so many iterations from straight lines  IPOPT's adaptive barrier for a few; from a flight with
                                                              the guessed controls; next from where the constraints
                                                              are met in the guessed times; only then to the end from
                                                              the lines
====================  ======================================  ====================================================

All tries of one solve share its limit on wall time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gnc_opt.arrays import Array, Indices
from gnc_opt.planning.direct.mesh_problem import Attempt
from gnc_opt.planning.direct.minimum_norm_multipliers import minimum_norm_multipliers
from gnc_opt.planning.nlp import IterationInfo, NlpPoint, NlpResult, NlpSolver, SolverOptions, Status
from gnc_opt.planning.nlp.monitor import ProgressCallback
from gnc_opt.planning.problem.guess.perturbation import with_random_guess
from gnc_opt.planning.problem.guess.simulation import with_flown_guess
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.reformulation import restated
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.warm_start import (
    ProgramStart,
    guess_from_solution,
    mesh_at_rest,
    program_start,
    start_from_guess,
)
from gnc_opt.planning.transcription.mesh import Mesh, MeshLike, read_meshes
from gnc_opt.planning.transcription.scheme import GAUSS, Scheme
from gnc_opt.planning.transcription.transcription import Transcription

CAREFUL = (Status.ACCEPTABLE, Status.STEP_TOO_SMALL, Status.SEARCH_DIRECTION_FAILED)
"""Endings that rounding in the linear solver can cause."""

ADAPTIVE = (Status.RESTORATION_FAILED, Status.SEARCH_DIRECTION_FAILED, Status.STEP_TOO_SMALL)
"""Endings without a verdict. IPOPT's monotone barrier stalls where constraint gradients become dependent at the
solution (a phase that shrinks to nothing, say); its adaptive barrier is slower on ordinary problems."""

COLD_START_MAX_ITERATIONS = 1000
"""Iterations, SolverOptions' limit, after which a cold start has lost its way."""

LINES_ITERATIONS = 150
"""Iterations after which a start from straight lines gives way to a flight, which follows the dynamics if nothing else:
an entry through an atmosphere that is exponential in height goes on for thousands from a line, and takes 80 from a
flight. (Of 84 problems that are solved from straight lines none takes more than 143.) As many are enough to meet the
constraints alone, where that can be done."""

TRAJECTORY_ONLY = tuple(s for s in Status if not s.solved and s is not Status.INTERRUPTED)
"""Endings of a warm start after which its multipliers are given up."""

CONSTRAINTS_FIRST = (Status.INFEASIBLE, Status.RESTORATION_FAILED)
"""Endings that are looked into once more where the guess is not a trajectory.

A cost pulls the iterates, a free final time above all, into a corner where the constraints cannot be met and their
violation is stationary: there a solver stops and reports that the problem is infeasible, though it is not. Without
the cost nothing pulls; with the durations held, what remains of many problems is close to linear. Durations that are
too short are the usual trap, so longer ones are tried."""

TRAJECTORY_START_BARRIER = 1e-2
"""First barrier parameter when only the trajectory is kept."""

ADAPTIVE_MAX_ITERATIONS = 300
"""Those of the adaptive barrier where the monotone one has lost its way: above the apex of a cone it takes 20 to 30
from lines from which the other finds nothing in 1000, for a transfer between orbits with two burns 135."""

CAREFUL_MAX_ITERATIONS = 200
"""Those that pivoting with care gets to mend last digits, beyond which it crawls."""

HELD_TIME_FACTORS = (1.0, 4.0, 16.0, 64.0)
"""Multiples of the guessed times at which durations are held while constraints are met."""

FEASIBILITY_RANDOM_STARTS, FEASIBILITY_SEED = 2, 1
"""Random starts, with free durations, where the guess itself does not help to meet the constraints."""


@dataclass(frozen=True)
class SolveLimits:
    """When a solve on a mesh gives up sooner than the solver's options say.

    Attributes
    ----------
    warm_iterations : int, optional
        A start from a guess that takes more iterations has lost its way: `TRAJECTORY_ONLY`; 0: from the trajectory
        alone.
    iterations : int, optional
        Of all tries together: the last one ends as `Status.ITERATION_LIMIT` there.
    deadline : float
        When to stop, as `time.perf_counter` counts.
    cpu_deadline : float
        When to end as `Status.ITERATION_LIMIT`, as `time.thread_time` counts.
    """

    warm_iterations: int | None = None
    iterations: int | None = None
    deadline: float = math.inf
    cpu_deadline: float = math.inf


def solve_mesh(
    problem: Problem,
    mesh: MeshLike | Mapping[str, MeshLike] | None = None,
    *,
    scheme: Scheme = GAUSS,
    guess: Solution | None = None,
    options: SolverOptions | None = None,
    limits: SolveLimits = SolveLimits(),
    progress: bool = False,
) -> Solution:
    """Solve a problem on one mesh, by as many tries as it takes, and return the last iterate, solved or not.

    Parameters
    ----------
    problem : Problem
        One that passes its `check`.
    mesh : Mesh, str or mapping, optional
        Default: that of the guess, if it has the same phases, else `DEFAULT_MESH`.
    guess : Solution, optional
        Start from its trajectory and multipliers.
    options : SolverOptions, optional
    limits : SolveLimits
        When to give up sooner than the options say.
    progress : bool
        Show iterations while solving.
    """
    chosen, problem = options or SolverOptions(), restated(problem)
    if mesh is None and guess is not None and set(guess.phases) == set(problem.phases):
        known = {name: guess.phases[name] for name in problem.phases}
        # Boundaries that moved with arcs would, without these, move to where the points see least.
        meshes = {name: mesh_at_rest(leg) if guess.structure else leg.mesh for name, leg in known.items()}
    else:
        meshes = read_meshes(mesh, problem.phases, problem.name)
    task = _Task(problem, meshes, scheme, chosen, progress, limits)
    if guess is None:
        return task.solve()
    if limits.warm_iterations is None:
        return task.solve(guess)
    if limits.warm_iterations == 0:
        return task.along(guess)
    found = task.brief(limits.warm_iterations).solve(guess)
    task = task.after(found)
    if found.status not in TRAJECTORY_ONLY or task.is_spent:
        return found
    return task.along(guess, after=found)


@dataclass(frozen=True, eq=False)
class _Task:
    """A problem on meshes, and how it is solved; see `solve_mesh`."""

    problem: Problem
    meshes: Mapping[str, Mesh]
    scheme: Scheme
    options: SolverOptions
    progress: bool
    limits: SolveLimits

    def after(self, found: Solution) -> _Task:
        """Return the task with the iterations that are left after those of a solution."""
        if self.limits.iterations is None:
            return self
        left = max(0, self.limits.iterations - found.statistics.iterations)
        return replace(self, limits=replace(self.limits, iterations=left))

    @property
    def is_spent(self) -> bool:
        """Whether no iterations or no CPU time are left."""
        return self.limits.iterations == 0 or time.thread_time() > self.limits.cpu_deadline

    def along(self, guess: Solution, *, after: Solution | None = None) -> Solution:
        """Solve from the trajectory of a solution, without its multipliers."""
        start, cold = (
            guess_from_solution(self.problem, guess),
            replace(self.options, mu_init=TRAJECTORY_START_BARRIER),
        )
        found = replace(self, problem=start, options=cold).solve(after=after)
        return replace(found, problem=self.problem.frozen())

    def brief(self, iterations: int) -> _Task:
        """Return the task with so many iterations at most."""
        fewer = min(iterations, self.options.max_iterations)
        return replace(self, options=replace(self.options, max_iterations=fewer))

    def solve(self, guess: Solution | None = None, *, after: Solution | None = None) -> Solution:
        """Solve from one guess; what an earlier try took counts, and is gone of the limit on wall time."""
        attempt = Attempt.prepare(
            self.problem, self.meshes, self.scheme, guess, self.options, progress=self.progress
        )
        point = attempt.point(attempt.start)
        attempt.solver.set_up(point)  # the limit is on solving, not on setting up
        earlier_s = after.statistics.solve_s if after else 0.0
        deadline = min(self.limits.deadline, attempt.solver.deadline() - earlier_s)
        guided = guess is not None or knows_trajectory(self.problem)
        with attempt.meter() as show:
            solve_from = _solve_point if guided else partial(_solve_from_lines, attempt)
            allowance = _Allowance(show, self.limits)
            result = solve_from(attempt.solver, point, allowance, deadline)
        if not guided and result.status in CONSTRAINTS_FIRST:
            result = _constraints_first(attempt, result, allowance, deadline)
        if allowance.spent and result.status is Status.INTERRUPTED:
            result = replace(result, status=Status.ITERATION_LIMIT)
        if result.status.solved:
            result = minimum_norm_multipliers(attempt.transcription, point, result)
        found = attempt.solution(result)
        return replace(found, statistics=found.statistics.after(after.statistics)) if after else found


# --- the same program, the same start -------------------------------------------------------------------


def _solve_point(
    solver: NlpSolver,
    point: NlpPoint,
    show: ProgressCallback,
    deadline: float,
    first: NlpResult | None = None,
) -> NlpResult:
    """Solve a program from one point, with other numerics where they can help; a first try may have been made."""
    result = solver.solve(point, callback=show, deadline=deadline) if first is None else first
    if solver.options.solver != "ipopt":
        return result
    if result.status in CAREFUL and not solver.options.careful_pivoting:
        there = replace(point, x0=result.x, lam_x0=result.lam_x, lam_g0=result.lam_g)
        patience = _Patience(show, CAREFUL_MAX_ITERATIONS)
        again = solver.solve(there, "careful", callback=patience, deadline=deadline)
        result = again.with_effort([result, again]) if again.status.solved else result
    wandered = (
        result.status is Status.ITERATION_LIMIT and solver.options.max_iterations >= COLD_START_MAX_ITERATIONS
    )
    if result.status in ADAPTIVE or (wandered and point.way == "cold"):
        again = solver.solve(point.cold(), "adaptive", callback=show, deadline=deadline)
        worse = again.status in ADAPTIVE or (wandered and not again.status.solved)
        result = (result if worse else again).with_effort([result, again])
    return result


# --- the same program, other starts ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FeasibilityStart:
    """Physical variables (n_variables,) to start from, and places of those to hold until the constraints are met."""

    variables: Array
    held: Indices


def _constraints_first(
    attempt: Attempt, failed: NlpResult, allowance: _Allowance, deadline: float
) -> NlpResult:
    """Return a solution by way of a point that meets the constraints, or else the failure; with all the effort."""
    spent = [failed]
    for place in feasibility_starts(attempt.transcription, attempt.problem, attempt.start.x):
        if allowance.spent or time.perf_counter() > deadline:
            break
        point = attempt.point(ProgramStart(place.variables), held=place.held, with_cost=False)
        with attempt.meter(with_cost=False) as allowance.show:
            patience = _Patience(allowance)
            spent.append(_solve_point(attempt.solver, point, patience, deadline))
        if spent[-1].status.solved:
            point = attempt.point(ProgramStart(spent[-1].x * attempt.scaling.variables))
            with attempt.meter() as allowance.show:
                spent.append(_solve_point(attempt.solver, point, allowance, deadline))
            if spent[-1].status not in CONSTRAINTS_FIRST:
                return spent[-1].with_effort(spent)
        elif spent[-1].status is Status.INTERRUPTED and not patience.lost:
            break
    return failed.with_effort(spent)


def _solve_from_lines(
    attempt: Attempt, solver: NlpSolver, point: NlpPoint, show: ProgressCallback, deadline: float
) -> NlpResult:
    """Solve from the straight lines of a guess; after `LINES_ITERATIONS` iterations, first in other ways."""
    if solver.options.solver != "ipopt" or solver.options.max_iterations < COLD_START_MAX_ITERATIONS:
        return _solve_point(solver, point, show, deadline)
    patience = _Patience(show)
    first = solver.solve(point, callback=patience, deadline=deadline)
    if not patience.lost:
        return _solve_point(solver, point, show, deadline, first)
    spent = [
        first,
        solver.solve(point, "adaptive", callback=_Patience(show, ADAPTIVE_MAX_ITERATIONS), deadline=deadline),
    ]
    if not spent[-1].status.solved:
        spent += _from_simulation(attempt, show, deadline)
    if not spent[-1].status.solved:
        spent += _from_feasible_point(attempt, show, deadline)
    if not spent[-1].status.solved:
        spent.append(_solve_point(solver, point, show, deadline))
    return spent[-1].with_effort(spent)


@dataclass
class _Allowance:
    """Shows iterations, and ends the try that takes the last one, or the CPU time, of all tries together."""

    show: ProgressCallback | None
    limits: SolveLimits
    count: int = 0

    def __call__(self, info: IterationInfo) -> bool:
        if self.show is not None:
            self.show(info)
        self.count += info.iteration > 0
        return self.spent

    @property
    def spent(self) -> bool:
        """Whether none is left."""
        most = self.limits.iterations
        return (most is not None and self.count >= most) or time.thread_time() > self.limits.cpu_deadline


@dataclass
class _Patience:
    """Shows iterations, and ends a solve after so many (`LINES_ITERATIONS`) or the last that all tries may take."""

    show: ProgressCallback
    most: int | None = None
    lost: bool = False

    def __call__(self, info: IterationInfo) -> bool:
        spent = bool(self.show(info))
        self.lost = info.iteration >= (LINES_ITERATIONS if self.most is None else self.most)
        return self.lost or spent


def _from_simulation(attempt: Attempt, show: ProgressCallback, deadline: float) -> Iterator[NlpResult]:
    """Yield what comes of a start from a flight, if one can be made and there is time."""
    flown = with_flown_guess(attempt.problem) if time.perf_counter() < deadline else None
    if flown is not None:
        start = program_start(attempt.transcription, flown, None)
        yield attempt.solver.solve(attempt.point(start), callback=_Patience(show), deadline=deadline)


def _from_feasible_point(attempt: Attempt, show: ProgressCallback, deadline: float) -> Iterator[NlpResult]:
    """Yield results: constraints first, at the guessed times; from there the cost, times free."""
    solver, held = attempt.solver, _free_times(attempt.transcription)
    if not held.size or time.perf_counter() > deadline:
        return
    point = attempt.point(attempt.start, held=held, with_cost=False)
    met = solver.solve(point, callback=_Patience(show), deadline=deadline)
    if not met.status.solved:
        yield met
        return
    there = attempt.point(ProgramStart(met.x * attempt.scaling.variables))
    found = solver.solve(there, callback=_Patience(show), deadline=deadline)
    yield found.with_effort([met, found])


def _free_times(transcription: Transcription) -> Indices:
    """Return the places of the times among the variables."""
    places = np.concatenate([part.times for part in transcription.parts.values()])
    return np.unique(places[places < transcription.n_variables])


def feasibility_starts(
    transcription: Transcription, problem: Problem, start: Array
) -> Iterator[FeasibilityStart]:
    """Yield starts: the guess with free times, with times held at multiples of the guess, a flight, random ones."""
    times, box = _free_times(transcription), transcription.variable_interval(problem)
    yield FeasibilityStart(start, times[:0])
    tried: list[Array] = []
    for stretch in HELD_TIME_FACTORS if times.size else ():
        values = np.clip(stretch * start[times], box.lower[times], box.upper[times])
        if any(np.array_equal(values, earlier) for earlier in tried):
            continue
        tried.append(values)
        stretched = start.copy()
        stretched[times] = values
        yield FeasibilityStart(stretched, times)
    flown = with_flown_guess(problem)
    if flown is not None:
        yield FeasibilityStart(start_from_guess(transcription, flown), times[:0])
    for index in range(1, FEASIBILITY_RANDOM_STARTS + 1):
        twin = with_random_guess(problem, FEASIBILITY_SEED, index)
        yield FeasibilityStart(start_from_guess(transcription, twin), times[:0])


def knows_trajectory(problem: Problem) -> bool:
    """Whether the problem's guess is a trajectory over time, not merely end values: then its failure is the user's."""
    guesses = [leg.numbers.guess for leg in problem.phases.values()]
    return any(
        callable(value) or (guess.time is not None and guess.time.size > 2)
        for guess in guesses
        for value in guess.values.values()
    )
