"""solve: from a stated problem to a solution."""

from __future__ import annotations

import platform
import time
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from typing import TypeAlias

import numpy as np

from gnc_opt.errors import ProblemError, SolveError, did_you_mean
from gnc_opt.model.layout import Array
from gnc_opt.nlp import IterationInfo, NlpResult, NlpSolver, SolverOptions
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.extract import Iterate, extract_phases
from gnc_opt.solution.solution import Solution, Statistics, Violation
from gnc_opt.solution.warm_start import start_from_solution
from gnc_opt.transcription.guess import start_variables
from gnc_opt.transcription.mesh import Mesh
from gnc_opt.transcription.quadrature import SCHEMES, Scheme
from gnc_opt.transcription.scaling import Scaling, scale_rows, scale_variables
from gnc_opt.transcription.transcription import Transcription, transcribe

MeshLike: TypeAlias = "Mesh | str"

DEFAULT_MESH = Mesh.uniform(20, 4)
_WORST = 10


def solve(
    problem: Problem,
    *,
    mesh: MeshLike | Mapping[str, MeshLike] | None = None,
    scheme: Scheme = "LG",
    guess: Solution | None = None,
    options: SolverOptions | None = None,
    progress: bool = False,
    throw: bool = True,
) -> Solution:
    """Solve an optimal control problem by collocation.

    Parameters
    ----------
    problem : Problem
    mesh : Mesh, str or mapping, optional
        ``Mesh.uniform(20, 3)`` or ``"20x3"``; a mapping from phase to mesh for several phases.
    scheme : {"LG", "LGR", "LGL"}
        Collocation points: Legendre-Gauss, -Radau or -Lobatto.
    guess : Solution, optional
        Start from states, controls and multipliers of an earlier solution, on any mesh. Without it the
        problem's own guess and straight lines are used.
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
    if scheme not in SCHEMES:
        raise ProblemError(f"there is no scheme {scheme!r}: {did_you_mean(str(scheme), SCHEMES)}")
    problem.check()
    options = options or SolverOptions()
    begin = time.perf_counter()
    known = len(problem.builds)
    transcription = transcribe(problem, _meshes(problem, mesh, guess), scheme)
    solver = _solver(problem, transcription, options)
    start, scaling, warm = _start(transcription, problem, guess)
    build_s = time.perf_counter() - begin
    result = _run(transcription, problem, solver, start, scaling, warm, progress)
    statistics = Statistics(
        result.iterations,
        build_s,
        result.wall_time,
        result.function_time,
        result.linear_solver_time,
        len(problem.builds) == known,
    )
    solution = _solution(transcription, problem, result, scaling, statistics, options)
    if throw and not (result.status.solved or result.status.value == "interrupted"):
        raise SolveError(failure_message(solution), solution)
    return solution


def failure_message(solution: Solution) -> str:
    """Return the sentence that a failed solve raises: status, remedy and the worst constraint."""
    worst = f" Worst: {solution.violations[0].name} (off by {solution.violations[0].amount:.2g})." if solution.violations else ""
    return (
        f"no solution of '{solution.problem_name}' after {solution.statistics.iterations} iterations: "
        f"{solution.status.value}. {solution.status.remedy}{worst}"
    )


def _meshes(
    problem: Problem, mesh: MeshLike | Mapping[str, MeshLike] | None, guess: Solution | None
) -> dict[str, Mesh]:
    if isinstance(mesh, Mapping):
        missing = [name for name in problem.phases if name not in mesh]
        if missing:
            raise ProblemError(f"mesh of problem '{problem.name}' lacks phase '{missing[0]}': give every phase one.")
        return {name: _mesh(m) for name, m in mesh.items()}
    if mesh is None and guess is not None and set(guess.phases) == set(problem.phases):
        return {name: guess.phases[name].mesh for name in problem.phases}
    return dict.fromkeys(problem.phases, DEFAULT_MESH if mesh is None else _mesh(mesh))


def _mesh(mesh: MeshLike) -> Mesh:
    if isinstance(mesh, Mesh):
        return mesh
    if isinstance(mesh, str):
        return Mesh.parse(mesh)
    raise ProblemError(f"{mesh!r} is not a mesh; give Mesh.uniform(20, 3) or '20x3'.")


def _solver(problem: Problem, transcription: Transcription, options: SolverOptions) -> NlpSolver:
    key = ("solver", id(transcription), repr(options))
    if key not in problem.builds:
        problem.builds[key] = NlpSolver(transcription.nlp, options)
    solver: NlpSolver = problem.builds[key]
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
    rows, objective = scale_rows(transcription, scales, _evaluate(transcription, problem, start)[1])
    return start, Scaling(scales, rows, objective), warm


def _with_integrals(transcription: Transcription, problem: Problem, start: Array) -> Array:
    """Set integral variables to the integrals of the guess: their rows are (integral - quadrature)."""
    places = transcription.integral_places
    if not places.size:
        return start
    values = _evaluate(transcription, problem, start)[0]
    start = start.copy()
    start[places] -= np.nan_to_num(values[-places.size :])
    return start


def _evaluate(transcription: Transcription, problem: Problem, x: Array) -> tuple[Array, Array]:
    """Values of (objective, rows) and nonzeros of their Jacobian at x, physical."""
    values, nonzeros = transcription.physical(x, transcription.numbers(problem))
    return np.asarray(values.full()).ravel(), np.asarray(nonzeros.full()).ravel()


def _run(
    transcription: Transcription,
    problem: Problem,
    solver: NlpSolver,
    start: Array,
    scaling: Scaling,
    warm: tuple[Array, Array] | None,
    progress: bool,
) -> NlpResult:
    variables, rows = transcription.variable_interval(problem), transcription.row_interval(problem)
    scales = scaling.variables
    lam_x = lam_g = None
    if warm is not None:
        lam_x = warm[0] * scales * scaling.objective
        lam_g = warm[1] / scaling.rows * scaling.objective
    arguments = (
        start / scales,
        variables.lower / scales,
        variables.upper / scales,
        rows.lower * scaling.rows,
        rows.upper * scaling.rows,
        transcription.parameter_vector(problem, scales, scaling.rows, scaling.objective),
        lam_x,
        lam_g,
    )
    if not progress:
        return solver.solve(*arguments)
    from gnc_opt.report.progress import solve_meter

    with solve_meter(problem.name) as show:

        def callback(info: IterationInfo) -> None:
            show(info.iteration, info.objective / scaling.objective, info.infeasibility)

        return solver.solve(*arguments, callback=callback)


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
        violations=() if result.status.solved else _violations(transcription, problem, result, scaling),
        statistics=statistics,
        provenance=_provenance(problem, transcription, options),
        problem=problem,
    )


def _violations(
    transcription: Transcription, problem: Problem, result: NlpResult, scaling: Scaling
) -> tuple[Violation, ...]:
    """The worst broken rows and bounds of an iterate, by scaled amount; NaN counts as worst."""
    rows, box = transcription.row_interval(problem), transcription.variable_interval(problem)
    scaled_rows = Interval(rows.lower * scaling.rows, rows.upper * scaling.rows)
    scaled_box = Interval(box.lower / scaling.variables, box.upper / scaling.variables)
    amounts = np.concatenate([_excess(result.g, scaled_rows), _excess(result.x, scaled_box)])
    labels = (*transcription.row_labels, *(f"bound of {label}" for label in transcription.variable_labels))
    worst = np.argsort(-np.where(np.isnan(amounts), np.inf, amounts), kind="stable")[:_WORST]
    return tuple(Violation(labels[i], float(amounts[i])) for i in worst if not amounts[i] <= 1e-9)


def _excess(values: Array, interval: Interval) -> Array:
    return np.maximum(np.maximum(interval.lower - values, values - interval.upper), 0.0)


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


def package_version(name: str) -> str:
    """Return an installed package's version, or "unknown"."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
