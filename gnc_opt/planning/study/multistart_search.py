"""multistart: search for the best of several local minima from many initial guesses.

Starts differ in durations, revolutions of angles, state perturbations and control switches
(`gnc_opt.planning.problem.guess.random_guess`). Every start is solved on a coarse mesh, and again with halved segments
if the integrated dynamics do not confirm it. Equal solutions are merged; the best are refined, checked and merged.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Literal, TypeAlias, TypeVar, get_args

import numpy as np

from gnc_opt.argument_checks import read_integer, read_positive_number, require_type, suggest_keywords
from gnc_opt.array_types import compute_interval_midpoints
from gnc_opt.errors import ArgumentError, GncOptError, ProblemError, suggest_similar_name
from gnc_opt.planning.direct.computation_budget import RefinementLimits
from gnc_opt.planning.direct.fixed_mesh_solve import solve_problem_on_mesh
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.problem.guess.random_guess import does_start_keep_guess_shape, with_random_guess
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.staged_refinement import StructureChoice
from gnc_opt.planning.refinement.staged_refinement import refine as refine_solution
from gnc_opt.planning.solution.defects_and_violations import find_worst_defect
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.refinement_history import RefinementStatus
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.study.local_minima import Minimum, list_distinct_minima
from gnc_opt.planning.transcription.mesh import Mesh, MeshLike
from gnc_opt.planning.verification.optimality_check import verify
from gnc_opt.text_html_and_json_formatting import PrintableResult
from gnc_opt.threads_and_package_versions import limit_to_one_thread

MIN_ERROR = 0.1
"""Relative propagation error and defect of a phase above which, together, a solution is spurious (rendezvous: 0.3 and
0.8)."""


@dataclass(frozen=True)
class RefinementTask:
    """Return a refined and checked minimum; unchanged after a failure."""

    structure: StructureChoice
    tol: float
    limits: RefinementLimits

    def __call__(self, problem: Problem, minimum: Minimum) -> Minimum:
        known = set(problem.builds)
        try:
            return self._refine_local_minimum(problem, minimum)
        finally:
            for key in set(problem.builds) - known:  # its meshes are not needed for other minima
                del problem.builds[key]

    def _refine_local_minimum(self, problem: Problem, minimum: Minimum) -> Minimum:
        coarse = minimum.solution.with_problem(problem)
        solution = refine_solution(coarse, structure=self.structure, tol=self.tol, limits=self.limits)
        if solution.history is not None and solution.history.status is RefinementStatus.INTERRUPTED:
            raise KeyboardInterrupt
        if not solution.status.solved or is_spurious_collocation_solution(solution):
            return minimum
        return replace(
            minimum,
            solution=replace(solution, problem=None),
            objective=solution.objective,
            refined=True,
            verdict_ok=verify(solution).ok,
        )


def _halve_mesh_segments(mesh: Mesh) -> Mesh:
    breaks = np.asarray(mesh.breaks)
    middles = compute_interval_midpoints(breaks)
    return Mesh(tuple(np.sort(np.concatenate([breaks, middles]))), tuple(np.repeat(mesh.degrees, 2).tolist()))


def is_spurious_collocation_solution(solution: Solution) -> bool:
    """Return whether a collocation solution does not satisfy the differential equations; see `MIN_ERROR`."""

    def is_propagation_error_small(s: PhaseSamples) -> bool:
        error = solution.propagate(s.phase.name).error
        return bool(np.max(np.abs(error) / s.state_scale) < MIN_ERROR)

    samples = solution.samples().values()
    return any(not (find_worst_defect(s).value < MIN_ERROR or is_propagation_error_small(s)) for s in samples)


def raise_keyboard_interrupt_of_solver(solution: Solution, options: SolverOptions) -> None:
    """Raise KeyboardInterrupt if Ctrl-C, and not the time limit, stopped the solver."""
    limit = options.max_wall_time
    if solution.status is Status.INTERRUPTED and (limit is None or solution.statistics.solve_s < limit):
        raise KeyboardInterrupt


if TYPE_CHECKING:  # slow import
    from concurrent.futures import Executor

    from gnc_opt.workers import SharedObject, TaskResult, WorkerPool

ShowEnding: TypeAlias = Callable[["float | None"], None]
"""Displays the objective of a completed task, None without one."""

Builder: TypeAlias = Callable[[], Problem]
Item = TypeVar("Item")
Answer = TypeVar("Answer")

COARSE_MESH = "20x3"

PLAIN_BARRIER, NEAR_BARRIER = 1e-3, 1e-5
"""Initial barrier parameters of plain starts and of every second start; others have IPOPT's 0.1."""

COARSE_MAX_ITERATIONS = 200
"""Iteration limit of a coarse solve."""


@dataclass(frozen=True, repr=False)
class Multistart(PrintableResult):
    """Result of `multistart`.

    Attributes
    ----------
    problem_name : str
    minima : tuple of Minimum
        In ascending order.
    failures : dict of str to int
        Number of starts without a minimum, by solver status, "spurious" (not confirmed by the dynamics) or "bad guess"
        (functions that are not finite along it).
    starts : int
        Number of requested starts.
    finished : int
        Number of completed starts; fewer than ``starts`` after an interrupt.
    seed : int
    interrupted : bool
        Whether Ctrl-C ended the search early.

    Examples
    --------
    >>> found = go.multistart(problem, n=2, seed=1, executor="serial", refine=False)
    >>> print(f"{found.best.objective:.1f}", found.finished, dict(found.failures))
    2.0 2 {}
    """

    problem_name: str
    minima: tuple[Minimum, ...]
    failures: Mapping[str, int]
    starts: int
    finished: int
    seed: int
    interrupted: bool = False

    @property
    def best(self) -> Minimum:
        """Best minimum; raises `GncOptError` if there is none."""
        if not self.minima:
            raise GncOptError(
                f"none of {self.finished} starts of '{self.problem_name}' found a minimum "
                f"({_format_failure_counts(self.failures)}): "
                "solve() it once and look at the violations, or try more starts."
            )
        return self.minima[0]

    def __str__(self) -> str:
        heading = (
            f"{self.problem_name}: {len(self.minima)} minima from {self.finished} of {self.starts} starts"
        )
        lines = [f"{heading}, seed {self.seed}{', interrupted' if self.interrupted else ''}"]
        lines.append(f"{'objective':>18} {'above best':>11} {'hits':>5} {'ways':>5}  verdict")
        for minimum in self.minima:
            digits = f"{minimum.objective:.10g}" if minimum.verdict_ok else f"{minimum.objective:.6g}"
            lines.append(
                f"{digits:>18} {abs(minimum.objective - self.minima[0].objective):11.3g} "
                f"{minimum.hits:5d} {minimum.trajectories:5d}  {minimum.check_result}"
            )
        if self.failures:
            lines.append(f"without a minimum: {_format_failure_counts(self.failures)}")
        return "\n".join(lines)


def _format_failure_counts(failures: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in failures.items()) or "no failures"


@limit_to_one_thread()
@suggest_keywords
def multistart(
    problem: Problem | Builder,
    *,
    n: int = 40,
    seed: int = 0,
    mesh: MeshLike | Mapping[str, MeshLike] | None = None,
    structure: StructureChoice = "auto",
    tol: float = 1e-8,
    refine: bool = True,
    max_refined: int = 6,
    within: float | None = None,
    limits: RefinementLimits | None = None,
    executor: Executor | Literal["serial"] | None = None,
    options: SolverOptions | None = None,
    progress: bool = False,
) -> Multistart:
    """Return the distinct local minima of a problem, found from many guesses.

    Parameters
    ----------
    problem : Problem or callable
        Problem, or function without arguments that returns it, such as ``functools.partial(build, case=2)``; process
        executors need the function unless processes are forked (Linux).
    n : int
        Number of starts. The first one is the problem's own guess, the others are random.
    seed : int
        Seed; the result does not depend on the executor or on the order in which starts are completed.
    mesh : Mesh, str or mapping, optional
        Coarse mesh; default "20x3".
    structure, tol
        See `refine`.
    refine : bool
        Whether to refine and check the minima, or leave them on the coarse mesh.
    max_refined : int
        Number of distinct refined minima at which the refinement ends; at most twice as many are refined.
    within : float, optional
        Minima whose objective exceeds the best by more than this share stay on the coarse mesh.
    limits : RefinementLimits, optional
        Limits of all refinements together; default: those of `refine`. All minima are refined first, each with half
        of the work divided by ``max_refined``; the best one again with the other half if it does not pass the check.
    executor : concurrent.futures.Executor or "serial", optional
        Default: one process per processor. Threads of one process take turns, because the solver is not thread-safe.
    options : SolverOptions, optional
        Options of the coarse solves. Default: at most `COARSE_MAX_ITERATIONS` iterations. Unless ``mu_init`` is set,
        most starts use a small one.
    progress : bool
        Display the number of completed starts and the best objective.

    Returns
    -------
    Multistart
        After Ctrl-C, the result so far.

    Raises
    ------
    ProblemError
        The problem is invalid.
    GncOptError
        The problem cannot be pickled for the processes of the executor.

    Examples
    --------
    >>> found = go.multistart(problem, n=2, seed=1, executor="serial", refine=False)
    >>> print(f"{found.minima[0].objective:.1f}")
    2.0
    """
    from gnc_opt.workers import WorkerPool

    read_integer(n, "the number of starts of multistart()", 1)
    read_integer(seed, "the seed of multistart()", 0)
    read_integer(max_refined, "max_refined of multistart()", 0)
    read_positive_number(tol, "the tolerance of multistart()")
    if within is not None:
        read_positive_number(within, "within of multistart()", or_zero=True)
    if structure not in get_args(StructureChoice):
        raise ProblemError(
            f"multistart() has no structure {structure!r}: "
            f"{suggest_similar_name(str(structure), get_args(StructureChoice))}"
        )
    if limits is not None:
        require_type(
            limits, RefinementLimits, "the limits of multistart()", "write RefinementLimits(max_work=20)"
        )
    if options is not None:
        require_type(
            options, SolverOptions, "the options of multistart()", "write options=SolverOptions(...)"
        )
    chosen = SolverOptions(max_iterations=COARSE_MAX_ITERATIONS) if options is None else options
    shared = _prepare_problem_for_workers(problem)
    stated = shared.value
    with WorkerPool(shared, executor, "multistart()") as pool:
        stated.check()
        search = _MultistartSearch(pool, stated, progress)
        coarse = _CoarseTask(seed, COARSE_MESH if mesh is None else mesh, chosen)
        endings = search.solve_from_starts(coarse, n)
        minima = list_distinct_minima(_list_minima_of_coarse_solves(endings))
        if refine and not pool.interrupted:
            count = _count_minima_to_refine(minima, within)
            whole = limits or RefinementLimits()
            half = replace(whole, max_work=0.5 * whole.max_work)
            each = replace(half, max_work=half.max_work / max(max_refined, 1))
            refined = search.refine_local_minima(
                RefinementTask(structure, tol, each), minima[:count], max_refined
            )
            minima = list_distinct_minima([*refined, *minima[count:]])
            if minima and minima[0].check_result == "NOT ok":
                best = search.refine_local_minima(RefinementTask(structure, tol, half), minima[:1], 1)
                minima = list_distinct_minima([*best, *minima[1:]])
    return Multistart(
        stated.name,
        tuple(replace(m, solution=m.solution.with_problem(stated)) for m in minima),
        dict(sorted(Counter(ending.failure for ending in endings if ending.failure).items())),
        n,
        len(endings),
        seed,
        pool.interrupted,
    )


@dataclass(frozen=True)
class _MultistartSearch:
    pool: WorkerPool[Problem]
    problem: Problem
    progress: bool

    def solve_from_starts(self, coarse: _CoarseTask, n: int) -> list[_StartResult]:
        """Solve n starts: the problem's guess and random ones, every second one with about the best duration so far."""
        endings: list[_StartResult] = []
        with _display_search_progress(
            f"{self.problem.name}: starts", n, self.progress, self.problem.sense
        ) as show:
            try:
                for starts in (range(0, n, 2), range(1, n, 2)):
                    if not self.pool.interrupted:
                        done = self.pool.map(
                            coarse, starts, lambda start: show(_get_worker_result(start).objective)
                        )
                        endings += [_get_worker_result(start) for start in done]
                        coarse = replace(coarse, durations=_find_phase_durations(endings))
            except KeyboardInterrupt:  # between two runs
                self.pool.interrupted = True
        return endings

    def refine_local_minima(
        self, refining: RefinementTask, minima: Sequence[Minimum], most: int
    ) -> list[Minimum]:
        """Refine minima in ascending order up to a number of distinct ones; return the others unchanged."""
        finer: list[Minimum] = []
        waiting = list(minima)
        while not self.pool.interrupted:
            left = min(most - len(list_distinct_minima(finer)), 2 * most - len(finer))
            batch, waiting = waiting[: max(left, 0)], waiting[max(left, 0) :]
            if not batch:
                break
            with _display_search_progress(
                "refinements", len(batch), self.progress, self.problem.sense
            ) as show:
                done = self.pool.map(
                    refining, batch, lambda minimum: show(_get_worker_result(minimum).objective)
                )
            answers = {id(minimum.item): _get_worker_result(minimum) for minimum in done}
            finer += [answers.get(id(minimum), minimum) for minimum in batch]
        return [*finer, *waiting]


def _find_phase_durations(endings: Sequence[_StartResult]) -> dict[str, float]:
    """Return the duration of each phase in the best solution; empty without a solution."""
    best = next(iter(list_distinct_minima(_list_minima_of_coarse_solves(endings))), None)
    return {} if best is None else {name: phase.duration for name, phase in best.solution.phases.items()}


def _prepare_problem_for_workers(problem: Problem | Builder) -> SharedObject[Problem]:
    """Return the problem for all workers; for other processes only as a function that builds it."""
    from gnc_opt.workers import SharedObject

    if isinstance(problem, Problem):
        remedy = 'give a function that builds it, e.g. functools.partial(build, case=2), or executor="serial"'
        return SharedObject(problem, f"problem '{problem.name}', which holds symbols,", remedy)
    if not callable(problem):
        raise ArgumentError(
            "the argument of multistart() must be a Problem or a function that returns one, not of type "
            f"{type(problem).__name__}."
        )
    remedy = "define it with def at the top of a module, and give its arguments by functools.partial"
    builder = partial(_build_problem_in_worker_process, problem)
    return SharedObject(builder(), "the function that builds the problem", remedy, builder)


def _build_problem_in_worker_process(builder: Builder) -> Problem:
    return require_type(builder(), Problem, "the result of the builder", "return the problem")  # type: ignore[no-any-return]


def _get_worker_result(done: TaskResult[Item, Answer]) -> Answer:
    from gnc_opt.workers import WorkerDiedError

    error = done.error
    if isinstance(error, WorkerDiedError):
        raise GncOptError(
            "a process of multistart() has died, possibly out of memory: use a coarser mesh, or "
            'executor="serial".'
        ) from error
    if error is not None:
        raise error
    assert done.answer is not None
    return done.answer


def _count_minima_to_refine(minima: Sequence[Minimum], within: float | None) -> int:
    """Return the number of minima, in ascending order, that are not far worse than the best."""
    if within is None or not minima:
        return len(minima)
    best = minima[0].objective
    return sum(abs(minimum.objective - best) <= within * abs(best) for minimum in minima)


def _display_search_progress(
    name: str, total: int, visible: bool, sense: float
) -> AbstractContextManager[ShowEnding]:
    if not visible:
        return nullcontext(lambda objective: None)
    from gnc_opt.progress_display import show_multistart_progress

    return show_multistart_progress(name, total, sense)


# --- worker tasks -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _StartResult:
    index: int
    failure: str = ""
    solution: Solution | None = None

    @property
    def objective(self) -> float | None:
        return None if self.solution is None else self.solution.objective


@dataclass(frozen=True)
class _CoarseTask:
    seed: int
    mesh: MeshLike | Mapping[str, MeshLike]
    options: SolverOptions
    durations: Mapping[str, float] = field(default_factory=dict)

    def __call__(self, problem: Problem, index: int) -> _StartResult:
        options = self.options
        if index and options.mu_init is None:
            small = (
                NEAR_BARRIER if index % 2 else PLAIN_BARRIER if does_start_keep_guess_shape(index) else None
            )
            options = replace(options, mu_init=small)
        try:
            durations = self.durations if index % 2 else None
            started = with_random_guess(problem, self.seed, index, durations)
            started.check()
            solution = solve_problem_on_mesh(started, self.mesh, options=options)
        except ProblemError:
            if index == 0:
                raise
            return _StartResult(index, "bad guess")
        if solution.status.solved and is_spurious_collocation_solution(solution):
            finer = {name: _halve_mesh_segments(phase.mesh) for name, phase in solution.phases.items()}
            solution = solve_problem_on_mesh(problem, finer, guess=solution, options=self.options)
        if not solution.status.solved:
            raise_keyboard_interrupt_of_solver(solution, options)
            return _StartResult(index, solution.status.value)
        if is_spurious_collocation_solution(solution):
            return _StartResult(index, "spurious")
        return _StartResult(index, solution=replace(solution, problem=None))


def _list_minima_of_coarse_solves(endings: Iterable[_StartResult]) -> Iterator[Minimum]:
    for ending in endings:
        if ending.solution is not None:
            objective = ending.solution.objective
            yield Minimum(ending.solution, objective, 1, (ending.index,), 1, (objective,))
