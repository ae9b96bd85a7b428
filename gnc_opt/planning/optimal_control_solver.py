"""solve: accurate solution of a problem with optimality check; Resolver: solutions of variations of a problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from enum import Enum
from typing import Any, Literal

from gnc_opt.argument_checks import StrictAttributes, read_positive_number, require_type, suggest_keywords
from gnc_opt.errors import ProblemError
from gnc_opt.planning.direct.computation_budget import RefinementLimits, WorkBudget, compute_refinement_work
from gnc_opt.planning.direct.fixed_mesh_solve import WARM_MAX_ITERATIONS, solve_problem_on_mesh
from gnc_opt.planning.direct.solve_failure_report import SolveError, format_solve_failure_message
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.problem.initial_state_clipping import clip_initial_states_to_bounds
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.problem_check import check_bounds_and_times
from gnc_opt.planning.problem.reformulation import reformulate_problem
from gnc_opt.planning.refinement.best_solution_selection import Candidate, select_best_candidate
from gnc_opt.planning.refinement.staged_refinement import StagedRefinement, StructureChoice
from gnc_opt.planning.refinement.warm_start_from_known_arcs import (
    KnownArcs,
    KnownSwitches,
    restore_initial_refinement_meshes,
    truncate_solution_to_start_time,
)
from gnc_opt.planning.solution.refinement_history import RefinementStatus
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_summary import MOVED_START
from gnc_opt.planning.transcription.collocation_families import GAUSS, Scheme, get_point_family
from gnc_opt.planning.transcription.mesh import MeshLike
from gnc_opt.threads_and_package_versions import limit_to_one_thread


class Resolver(StrictAttributes):
    """Solver of variations of a problem (`Problem.with_initial`, `with_parameters`, ...) from a known solution.

    The methods are tried in this order:

    * SWITCH_TIMES, for one phase with all controls at bounds and end conditions that are equalities: Newton's method on
      the switching times, to 1e-9 in the cost.
    * WARM, for all other problems: IPOPT with the known arcs or mesh and multipliers; refined if it was refined.
    * COLD, if the other methods fail: `solve` without a guess.

    WARM is within ``tol`` if the solution was refined; if arcs or mesh changed, it has a verdict. The first two methods
    find a local minimum, usually the nearest. An object must not be used by two threads at the same time.

    Parameters
    ----------
    solution : Solution
        Solved solution with its problem.
    tol : float, optional
        Tolerance of cold solves; default: that of the solution; None if it was not refined.
    cold : bool
        Whether to use COLD if the other methods fail.

    Raises
    ------
    GncOptError
        The solution has no problem or is not solved.

    Examples
    --------
    >>> resolver = go.Resolver(solution)
    >>> print(f"{resolver.solve(problem.with_initial(q=1.21)).objective:.6f}")
    2.200000
    """

    def __init__(self, solution: Solution, *, tol: float | None = None, cold: bool = True) -> None:
        require_type(solution, Solution, "the argument of Resolver()", "write Resolver(solve(problem))")
        self._problem = solution.need_solved_problem("solve")
        value = solution.history.tolerance if tol is None and solution.history is not None else tol
        self.tol = None if value is None else read_positive_number(value, "the tolerance of Resolver()")
        self.solution, self.cold = solution, cold
        known_switches = KnownSwitches.from_solution(solution)
        self._known_switches = None if known_switches is None else known_switches.with_newton_step()
        self._arcs = KnownArcs.from_solution(solution) if solution.structure or self.tol is not None else None

    @limit_to_one_thread()
    def solve(self, problem: Problem, *, near: Solution | None = None) -> Solution:
        """Return the solution of a variation; ``solution.provenance["way"]`` is its `SolveMethod`.

        A variation may start along the known trajectory: ``problem.with_time(initial=t).with_initial(...)``. Measured
        initial states slightly beyond a bound (2 % of the range) are moved to the bound;
        ``provenance["start"]`` names them.

        Parameters
        ----------
        problem : Problem
        near : Solution, optional
            Solution of a variation to start from; default: the solution of the resolver.

        Raises
        ------
        ProblemError
            The problem, or ``near``, is not a variation of the resolver's problem, or is invalid.
        SolveError
            All methods failed.
        """
        hint = "give for example problem.with_initial(...)"
        require_type(problem, Problem, "the argument of Resolver.solve()", hint)
        within, moved = clip_initial_states_to_bounds(problem)
        if moved:
            return _record_solution_provenance(self.solve(within, near=near), MOVED_START, moved)
        stated, problem = problem, reformulate_problem(problem)
        if not stated.has_same_expressions_as(self._problem):
            raise ProblemError(
                f"problem '{problem.name}' is not a variation of the resolver's problem: create it by "
                "with_initial(), with_parameters() or similar, or create a Resolver from its own solution."
            )
        if near is not None:
            hint = "give for example near=resolver.solve(...)"
            require_type(near, Solution, "the start of Resolver.solve()", hint)
            if _list_variable_names(near) != _list_variable_names(self.solution):
                raise ProblemError(
                    f"the solution of '{near.problem_name}' has other phases, states or controls than the "
                    "resolver's problem: give near= a solution of a variation."
                )
        check_bounds_and_times(stated)  # the cold solve alone uses the guess, and checks it
        is_same_form = problem.builds is self._problem.builds
        found = self._try_warm_start(stated, problem, near) if is_same_form else None
        if found is not None:
            return found
        if not self.cold:
            raise ProblemError(
                f"problem '{problem.name}' was not solved next to the known solution, and cold=False excludes a cold "
                "solve: use a smaller variation, or omit cold=False."
            )
        return label_solution_with_solve_method(solve(problem, tol=self.tol), SolveMethod.COLD)

    def _try_warm_start(self, stated: Problem, problem: Problem, near: Solution | None) -> Solution | None:
        """Return the solution of a variation in the form of the known one, if a warm method finds it."""
        known_switches = self._known_switches
        if near is not None and known_switches is not None:
            known_switches = KnownSwitches.from_solution(near)
        found = None if known_switches is None else known_switches.solve_with_known_switches(problem)
        if found is not None:
            return label_solution_with_solve_method(found, SolveMethod.SWITCH_TIMES)
        stated.check()
        if self._arcs is not None:
            arcs = self._arcs if near is None else KnownArcs.from_solution(near)
            found = arcs.solve_with_known_arcs(problem, self.tol or DEFAULT_TOLERANCE, check=False)
            return None if found is None else label_solution_with_solve_method(found, SolveMethod.WARM)
        start = self.solution if near is None else near
        meshes = {name: phase.mesh for name, phase in self.solution.phases.items()}
        found = solve_problem_on_mesh(
            problem,
            meshes,
            scheme=self.solution.scheme,
            guess=truncate_solution_to_start_time(start, problem),
            budget=WorkBudget(warm_iterations=WARM_MAX_ITERATIONS),
        )
        if found.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        return label_solution_with_solve_method(found, SolveMethod.WARM) if found.status.solved else None


def _list_variable_names(solution: Solution) -> dict[str, tuple[tuple[str, ...], ...]]:
    phases = solution.phases.items()
    return {name: (tuple(phase.states.labels), tuple(phase.controls.labels)) for name, phase in phases}


class SolveMethod(Enum):
    """Method by which a variation was solved; stored as ``solution.provenance["way"]``."""

    SWITCH_TIMES = "switching times"
    WARM = "warm start"
    COLD = "cold start"


DEFAULT_TOLERANCE = 1e-6
"""Default tolerance of a refinement."""


@limit_to_one_thread()
@suggest_keywords
def solve(
    problem: Problem,
    *,
    mesh: MeshLike | Mapping[str, MeshLike] | None = None,
    scheme: Scheme = GAUSS,
    guess: Solution | None = None,
    tol: float | Literal["auto"] | None = "auto",
    structure: StructureChoice = "auto",
    check: bool = True,
    limits: RefinementLimits | None = None,
    options: SolverOptions | None = None,
    progress: bool = False,
    throw: bool = True,
) -> Solution:
    """Return the solution of an optimal control problem by collocation, refined and checked for optimality.

    Parameters
    ----------
    problem : Problem
    mesh : Mesh, str or mapping, optional
        ``Mesh.uniform(20, 3)`` or ``"20x3"``; a mapping from phase to mesh for several phases. It is the first mesh of
        the refinement; ``tol=None`` solves on it only.
    scheme : {"LG", "LGR", "LGL"}
        Collocation points: Legendre-Gauss, -Radau or -Lobatto.
    guess : Solution, optional
        Start from states, controls and multipliers of an earlier solution, on any mesh. If it is the refined solution
        of a variation (`Problem.with_initial`, ...), and neither mesh nor options are given, its arcs or mesh are
        reused as by `Resolver`, with a new refinement if that fails. Default: the problem's guess and straight lines;
        see `gnc_opt.planning.direct.fixed_mesh_solve`.
    tol : float, "auto" or None
        Tolerance of the error between the nodes, with refinement and check; see `refine`. None: one solve on the given
        mesh, without a check. ``"auto"``: 1e-6 (`DEFAULT_TOLERANCE`); with a ``guess`` from a variation its tolerance,
        with any other guess None.
    structure : {"auto", "bang-bang", "none"}
        Refinement method; see `refine`.
    check : bool
        ``False``: the solve ends as soon as the estimated error of the objective is within the tolerance, without the
        optimality check; see `refine`.
    limits : RefinementLimits, optional
        Limits of solves and refinement together; see `refine`.
    options : SolverOptions, optional
        Solver, tolerances, limits and raw options. The wall-time limit applies to solves and refinement together.
    progress : bool
        Display iterations.
    throw : bool
        Raise `SolveError` if no solution was found; with ``False`` the last iterate is returned, with its
        ``status`` and ``violations``. An interrupted solve (Ctrl-C, time limit) returns the best solution so far.

    Returns
    -------
    Solution

    Raises
    ------
    ProblemError
        The problem is invalid; see ``Problem.check``.
    SolveError
        No solution was found; the error contains the last iterate.

    Examples
    --------
    >>> found = go.solve(problem)
    >>> print(f"{found.objective:.6f} {found.history.status.value}")
    2.000000 converged
    """
    hint = "write solve(problem), or solve(solution.problem)"
    require_type(problem, Problem, "the argument of solve()", hint)
    get_point_family(scheme)
    moved = ""
    if guess is not None:
        require_type(guess, Solution, "the guess of solve()", "give a solution, or use Problem.with_guess")
        problem, moved = clip_initial_states_to_bounds(problem)
    limits = RefinementLimits() if limits is None else limits
    require_type(limits, RefinementLimits, "the limits of solve()", "write RefinementLimits(max_work=10.0)")
    as_usual = mesh is None and structure == "auto" and options is None
    options = SolverOptions() if options is None else options
    hint = "write options=SolverOptions(tolerance=1e-9)"
    require_type(options, SolverOptions, "the options of solve()", hint)
    in_a_loop = tol == "auto" and guess is not None
    if tol == "auto":
        tol = None if in_a_loop else DEFAULT_TOLERANCE
    elif tol is not None:
        tol = read_positive_number(tol, "the tolerance of solve()")
    problem.check()
    problem = reformulate_problem(problem)
    if options.max_wall_time is not None:
        wall = min(options.max_wall_time, limits.max_wall_time or options.max_wall_time)
        limits = replace(limits, max_wall_time=wall)
    budget, found = WorkBudget.start_work_budget(limits), None
    is_refined = guess is not None and (guess.history is not None or bool(guess.structure))
    if guess is not None and is_refined and as_usual and scheme == guess.scheme:
        known = guess.problem
        if known is not None and known.builds is problem.builds and guess.status.solved:
            if in_a_loop:
                tol = DEFAULT_TOLERANCE if guess.history is None else guess.history.tolerance
            found = None if tol is None else _solve_modified_problem(problem, guess, tol, in_a_loop)
        if found is None and tol is not None:
            found = _restart_refinement(problem, guess, limits, tol=tol, check=check, progress=progress)
    if found is None:
        within = WorkBudget() if tol is None else WorkBudget(cpu_deadline=budget.cpu_deadline, whole=budget)
        found = solve_problem_on_mesh(
            problem, mesh, scheme=scheme, guess=guess, options=options, budget=within, progress=progress
        )
        if tol is not None and found.status.solved:
            found = StagedRefinement(found, tol, budget, check, None, progress).run_stages(structure)
        found = found if guess is None else label_solution_with_solve_method(found, SolveMethod.WARM)
    if moved:
        found = _record_solution_provenance(found, MOVED_START, moved)
    if throw and not (found.status.solved or found.status is Status.INTERRUPTED):
        raise SolveError(format_solve_failure_message(found), found)
    return found


def label_solution_with_solve_method(solution: Solution, way: SolveMethod) -> Solution:
    return _record_solution_provenance(solution, "way", way.value)


def _record_solution_provenance(solution: Solution, key: str, text: str) -> Solution:
    noted = replace(solution, provenance={**solution.provenance, key: text})
    return noted.with_verdict(solution.verdict)


def _solve_modified_problem(
    problem: Problem, known: Solution, tol: float, in_a_loop: bool
) -> Solution | None:
    """Return the solution of a variation, or None; with ``in_a_loop`` checked only if arcs or mesh changed."""
    if in_a_loop:
        known_switches = KnownSwitches.from_solution(known)
        found = None if known_switches is None else known_switches.solve_with_known_switches(problem)
        if found is not None:
            return label_solution_with_solve_method(found, SolveMethod.SWITCH_TIMES)
    check = not in_a_loop or not (known.history is None or _has_solution_converged(known))
    found = KnownArcs.from_solution(known).solve_with_known_arcs(problem, tol, check)
    return None if found is None else label_solution_with_solve_method(found, SolveMethod.WARM)


def _has_solution_converged(found: Solution) -> bool:
    reached_by = (RefinementStatus.CONVERGED, RefinementStatus.UNCHECKED)
    return found.history is not None and found.history.status in reached_by


def _restart_refinement(
    problem: Problem, known: Solution, limits: RefinementLimits, **settings: Any
) -> Solution:
    """Return the refinement from the known solution, or the better of it and a cold one if it does not converge."""
    budget, start = WorkBudget.start_work_budget(limits), truncate_solution_to_start_time(known, problem)
    settings |= {"mesh": restore_initial_refinement_meshes(known), "scheme": known.scheme, "throw": False}
    warm = solve(problem, guess=start, limits=limits, **settings)
    budget.record_work(compute_refinement_work(warm))
    ended = warm.status if warm.history is None else warm.history.status
    if _has_solution_converged(warm) or ended.value == Status.INTERRUPTED.value or budget.remaining_work <= 0:
        return warm
    cold = solve(problem, limits=replace(limits, max_work=budget.remaining_work), **settings)
    cold = label_solution_with_solve_method(cold, SolveMethod.COLD)
    found = [Candidate(s, s.history, "") for s in (cold, warm) if s.history is not None]
    return found[select_best_candidate(found, settings["tol"])].solution if found else cold
