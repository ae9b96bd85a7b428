"""solve: from a stated problem to a solution."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from gnc_opt.arguments import expect
from gnc_opt.diagnosis import failure_message, find_violations
from gnc_opt.errors import ProblemError, SolveError, shown
from gnc_opt.feasible import feasibility_starts, knows_trajectory
from gnc_opt.model.layout import Array
from gnc_opt.nlp import IterationInfo, NlpResult, NlpSolver, SolverOptions, Status
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.refine import StructureChoice, refine
from gnc_opt.second_opinion import at_rest, better_of_two
from gnc_opt.solution.extract import Iterate, extract_phases
from gnc_opt.solution.solution import Solution, Statistics
from gnc_opt.solution.warm_start import start_from_solution
from gnc_opt.transcription.guess import start_variables
from gnc_opt.transcription.mesh import Mesh
from gnc_opt.transcription.quadrature import Scheme, checked_scheme
from gnc_opt.transcription.scaling import Scaling, scale_rows, scale_variables
from gnc_opt.transcription.transcription import Transcription, transcribe

MeshLike: TypeAlias = "Mesh | str"

DEFAULT_MESH = Mesh.uniform(20, 4)

INFEASIBLE = (Status.INFEASIBLE, Status.RESTORATION_FAILED)
"""Endings that are looked into once more where the guess is not a trajectory; see `gnc_opt.feasible`."""


def solve(
    problem: Problem,
    *,
    mesh: MeshLike | Mapping[str, MeshLike] | None = None,
    scheme: Scheme = "LG",
    guess: Solution | None = None,
    tol: float | None = None,
    structure: StructureChoice = "auto",
    options: SolverOptions | None = None,
    progress: bool = False,
    throw: bool = True,
) -> Solution:
    """Solve an optimal control problem by collocation, and refine the solution if a tolerance is given.

    Parameters
    ----------
    problem : Problem
    mesh : Mesh, str or mapping, optional
        ``Mesh.uniform(20, 3)`` or ``"20x3"``; a mapping from phase to mesh for several phases.
    scheme : {"LG", "LGR", "LGL"}
        Collocation points: Legendre-Gauss, -Radau or -Lobatto.
    guess : Solution, optional
        Start from states, controls and multipliers of an earlier solution, on any mesh. Without it the
        problem's own guess and straight lines are used; where these end as infeasible, the constraints are met
        first and the cost is lowered afterwards, see `gnc_opt.feasible`.
    tol : float, optional
        Refine until the error between the nodes is below this; see `refine`. Without it the given mesh is final.
        A solution that does not come to rest is compared with another one; see `gnc_opt.second_opinion`.
    structure : {"auto", "bang-bang", "none"}
        How to refine; see `refine`.
    options : SolverOptions, optional
        Solver, tolerances, limits and raw options.
    progress : bool
        Show iterations while solving.
    throw : bool
        Raise `SolveError` when no solution was reached; with ``False`` the last iterate is returned, its
        ``status`` says what happened and ``violations`` name the worst constraints. An interrupted solve
        (Ctrl-C, time limit) never raises.

    Returns
    -------
    Solution

    Raises
    ------
    ProblemError
        The problem is not well stated; see ``Problem.check``.
    SolveError
        No solution was found; the error carries the last iterate.
    """
    expect(problem, Problem, "what solve() got", "write solve(problem), or solve(solution.problem)")
    checked_scheme(scheme)
    if guess is not None:
        expect(guess, Solution, "the guess of solve()", "give a solution, or use Problem.with_guess")
    options = SolverOptions() if options is None else options
    expect(options, SolverOptions, "the options of solve()", "write options=SolverOptions(tolerance=1e-9)")
    problem.check()
    begin = time.perf_counter()
    transcription = transcribe(problem, _meshes(problem, mesh, guess), scheme)
    suited = _suited(options, transcription)
    reused = repr(suited) in transcription.built
    solver = _solver(transcription, suited)
    start, scaling, warm = _start(transcription, problem, guess)
    build_s = time.perf_counter() - begin
    attempt = _Attempt(transcription, problem, solver, scaling, progress)
    result = attempt.run(start, warm)
    if result.status in INFEASIBLE and guess is None and not knows_trajectory(problem):
        result = _by_feasibility(attempt, start, result)
    statistics = Statistics(
        result.iterations,
        build_s,
        result.wall_time,
        result.function_time,
        result.linear_solver_time,
        reused,
    )
    solution = _solution(transcription, problem, result, scaling, statistics, options)
    if throw and not (result.status.solved or result.status.value == "interrupted"):
        raise SolveError(failure_message(solution), solution)
    if tol is None or not solution.status.solved:
        return solution

    def refined(found: Solution) -> Solution:
        return refine(found, tol=tol, structure=structure, progress=progress)

    final = refined(solution)
    if at_rest(final) or guess is not None:
        return final
    return better_of_two(problem, solution, final, refined, options, {"mesh": mesh, "scheme": scheme})


def _meshes(
    problem: Problem, mesh: MeshLike | Mapping[str, MeshLike] | None, guess: Solution | None
) -> dict[str, Mesh]:
    if isinstance(mesh, Mapping):
        missing = [name for name in problem.phases if name not in mesh]
        if missing:
            raise ProblemError(
                f"the mesh of problem '{problem.name}' lacks phase '{missing[0]}': give every phase one."
            )
        return {name: _mesh(m) for name, m in mesh.items()}
    if mesh is None and guess is not None and set(guess.phases) == set(problem.phases):
        return {name: guess.phases[name].mesh for name in problem.phases}
    return dict.fromkeys(problem.phases, DEFAULT_MESH if mesh is None else _mesh(mesh))


def _mesh(mesh: MeshLike) -> Mesh:
    if isinstance(mesh, Mesh):
        return mesh
    if isinstance(mesh, str):
        return Mesh.parse(mesh)
    raise ProblemError(f"{shown(mesh)} is not a mesh: give Mesh.uniform(20, 3) or '20x3'.")


def _suited(options: SolverOptions, transcription: Transcription) -> SolverOptions:
    """Pivot with care where switch times are variables: short arcs make the linear systems nearly singular."""
    movable = any(part.collocation.mesh.movable for part in transcription.parts.values())
    if options.careful_pivoting is None and movable:
        return replace(options, careful_pivoting=True)
    return options


def _solver(transcription: Transcription, options: SolverOptions) -> NlpSolver:
    key = repr(options)
    if key not in transcription.built:
        transcription.built[key] = NlpSolver(transcription.nlp, options)
    solver: NlpSolver = transcription.built[key]
    return solver


def _start(
    transcription: Transcription, problem: Problem, guess: Solution | None
) -> tuple[Array, Scaling, tuple[Array, Array] | None]:
    """Starting point and, from an earlier solution, multipliers (physical), with the scaling to use."""
    start = start_variables(transcription, problem)
    warm = None
    if guess is not None:
        start, *multipliers = start_from_solution(transcription, problem, guess, start)
        warm = (multipliers[0], multipliers[1])
    start = _with_integrals(transcription, problem, start)
    scales = scale_variables(transcription, problem, start)
    rows, objective = scale_rows(transcription, problem, start, scales)
    return start, Scaling(scales, rows, objective), warm


def _with_integrals(transcription: Transcription, problem: Problem, start: Array) -> Array:
    """Set integral variables to the integrals of the guess: their rows are (integral - quadrature)."""
    places = transcription.integral_places
    if not places.size:
        return start
    values = transcription.evaluate(problem, start)[0]
    start = start.copy()
    start[places] -= np.nan_to_num(values[-places.size :])
    return start


@dataclass(frozen=True, eq=False)
class _Attempt:
    """The program, ready to be solved from one start or another."""

    transcription: Transcription
    problem: Problem
    solver: NlpSolver
    scaling: Scaling
    progress: bool

    def run(
        self,
        start: Array,
        warm: tuple[Array, Array] | None = None,
        *,
        held: NDArray[np.int64] | None = None,
        with_cost: bool = True,
    ) -> NlpResult:
        """Solve from physical variables and multipliers, some variables held, with or without the cost."""
        transcription, problem, scaling = self.transcription, self.problem, self.scaling
        variables, rows = transcription.variable_interval(problem), transcription.row_interval(problem)
        if held is not None:
            variables.lower[held] = variables.upper[held] = start[held]
        scales, worth = scaling.variables, scaling.objective if with_cost else 0.0
        lam_x = lam_g = None
        if warm is not None:
            lam_x = warm[0] * scales * worth
            lam_g = warm[1] / scaling.rows * worth
        arguments = (
            start / scales,
            variables.lower / scales,
            variables.upper / scales,
            rows.lower * scaling.rows,
            rows.upper * scaling.rows,
            transcription.parameter_vector(problem, scales, scaling.rows, worth),
            lam_x,
            lam_g,
        )
        if not self.progress:
            return self.solver.solve(*arguments)
        from gnc_opt.report.progress import solve_meter

        with solve_meter(problem.name) as show:

            def callback(info: IterationInfo) -> None:
                show(info.iteration, info.objective / (worth or 1.0), info.infeasibility)

            return self.solver.solve(*arguments, callback=callback)


def _by_feasibility(attempt: _Attempt, start: Array, failed: NlpResult) -> NlpResult:
    """Return a solution by way of a point that meets the constraints, or else the failure; with all the effort."""
    spent = [failed]
    begin, limit = time.perf_counter(), attempt.solver.options.max_wall_time or math.inf
    for point in feasibility_starts(attempt.transcription, attempt.problem, start):
        if failed.wall_time + time.perf_counter() - begin > limit:
            break
        spent.append(attempt.run(point.variables, held=point.held, with_cost=False))
        if spent[-1].status.solved:
            spent.append(attempt.run(spent[-1].x * attempt.scaling.variables))
            if spent[-1].status not in INFEASIBLE:
                return spent[-1].with_effort(spent)
        elif spent[-1].status is Status.INTERRUPTED:
            break
    return failed.with_effort(spent)


def _solution(
    transcription: Transcription,
    problem: Problem,
    result: NlpResult,
    scaling: Scaling,
    statistics: Statistics,
    options: SolverOptions,
) -> Solution:
    iterate = Iterate(
        result.x * scaling.variables,
        result.lam_x / scaling.variables / scaling.objective,
        result.lam_g * scaling.rows / scaling.objective,
    )
    box = transcription.variable_interval(problem)
    # Scaling and unscaling rounds: a variable at its bound must sit exactly there.
    iterate = replace(iterate, x=np.where(box.fixed, box.lower, iterate.x))
    phases, gradients = extract_phases(transcription, problem, iterate)
    places = transcription.parameter_places
    return Solution(
        problem_name=problem.name,
        status=result.status,
        objective=gradients.cost,
        maximised=problem.sense < 0,
        phases=phases,
        free_parameters=problem.parameters,
        parameter_values=iterate.x[places],
        parameter_multipliers=iterate.lam_x[places],
        constraint_labels=problem.constraint_labels(),
        constraint_values=gradients.constraints,
        constraint_multipliers=iterate.lam_g[transcription.constraint_rows],
        violations=find_violations(transcription, problem, result, scaling, phases, iterate.x[places]),
        statistics=statistics,
        provenance=_provenance(problem, transcription, options),
        problem=problem,
    )


def _provenance(problem: Problem, transcription: Transcription, options: SolverOptions) -> dict[str, str]:
    meshes = ", ".join(f"{name} {part.collocation.mesh}" for name, part in transcription.parts.items())
    return {
        "gnc_opt": package_version("gnc_opt"),
        "casadi": package_version("casadi"),
        "numpy": np.__version__,
        "python": platform.python_version(),
        "scheme": transcription.scheme,
        "mesh": meshes,
        "options": repr(options),
        "fingerprint": problem.fingerprint(),
    }


@lru_cache
def package_version(name: str) -> str:
    """Return an installed package's version, or "unknown"."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
