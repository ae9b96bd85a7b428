"""sweep: solutions of a family of problems on a parameter grid, each started from a neighbour."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from gnc_opt.argument_checks import (
    read_float_array,
    read_optional_mapping,
    read_variable_name,
    require_type,
    suggest_keywords,
)
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, GncOptError, quote_value, suggest_similar_name
from gnc_opt.planning.direct.fixed_mesh_solve import solve_problem_on_mesh
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.optimal_control_solver import solve
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.transcription.mesh import MeshLike
from gnc_opt.text_html_and_json_formatting import PrintableResult
from gnc_opt.threads_and_package_versions import limit_to_one_thread

if TYPE_CHECKING:
    from concurrent.futures import Executor

Family: TypeAlias = Callable[..., Problem]
Output: TypeAlias = Callable[[Solution], float]

NOT_REACHED = "not reached"
"""Ending of points that were not solved because of an interrupt."""

PROGRAMMING_ERRORS = (NameError, AttributeError, TypeError, ImportError)
"""Exceptions of a function that fails at every point; they end a sweep."""


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(PrintableResult):
    """Solutions on a parameter grid.

    Attributes
    ----------
    grid : mapping of str to array
        Values of each parameter, in the order of the axes.
    solutions : array of Solution or None
        One solution per grid point, shape (n_1, n_2, ...), or None. They have no problem; add it with
        ``solution.with_problem(problem_of(...))``.
    endings : array of str
        Ending of each point: the solver status, or the error.
    outputs : mapping of str to array
        Additional quantities, NaN without a solution.
    interrupted : bool
        Whether Ctrl-C ended the sweep early.

    Examples
    --------
    >>> swept = go.sweep(lambda q: problem.with_initial(q=q), {"q": [1.0, 4.0]}, executor="serial")
    >>> print(swept.is_solved, np.round(swept.objective, 4))
    [ True  True] [2. 4.]
    """

    grid: Mapping[str, Array]
    solutions: Any
    endings: Any
    outputs: Mapping[str, Array]
    interrupted: bool = False

    @property
    def is_solved(self) -> Any:
        """Whether each point has a solution, bool array of the grid's shape."""
        return np.array([s is not None for s in self.solutions.flat]).reshape(self.solutions.shape)

    @property
    def objective(self) -> Array:
        """Objectives, NaN without a solution."""
        return self.array("objective")

    def array(self, name: str) -> Array:
        """Return "objective", "final_time" (of the last phase), "iterations", an output or a parameter on the grid."""
        own: dict[str, Output] = {
            "objective": lambda s: s.objective,
            "final_time": lambda s: list(s.phases.values())[-1].final_time,
            "iterations": lambda s: s.statistics.iterations,
        }
        if name in self.outputs:
            return self.outputs[name]
        if name in self.grid and name not in own:
            axes = dict(zip(self.grid, np.meshgrid(*self.grid.values(), indexing="ij"), strict=True))
            return np.asarray(np.where(self.is_solved, axes[name], np.nan))
        if name not in own:
            known = [*own, *self.outputs, *self.grid]
            raise ArgumentError(
                f"the sweep has no quantity {quote_value(name)}: {suggest_similar_name(str(name), known)}"
            )
        values = [np.nan if s is None else own[name](s) for s in self.solutions.flat]
        return np.array(values, dtype=float).reshape(self.solutions.shape)

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset of objective, final time, iterations, ending and outputs on the grid."""
        try:
            import xarray
        except ImportError as error:
            raise GncOptError('xarray is not installed: pip install "gnc_opt[data]".') from error
        names = ["objective", "final_time", "iterations", *self.outputs]
        data = {name: (tuple(self.grid), self.array(name)) for name in names}
        data["ending"] = (tuple(self.grid), self.endings.astype(str))
        return xarray.Dataset(data, coords=dict(self.grid))

    def __str__(self) -> str:
        total, good = self.solutions.size, int(np.sum(self.is_solved))
        sizes = " x ".join(f"{values.size} {name}" for name, values in self.grid.items())
        lines = [f"sweep over {sizes}: {good} of {total} solved{', interrupted' if self.interrupted else ''}"]
        if good:
            objective = self.objective
            lines.append(f"  objective    {np.nanmin(objective):.10g} to {np.nanmax(objective):.10g}")
        points = itertools.product(*self.grid.values())
        for point, ending, solution in zip(points, self.endings.flat, self.solutions.flat, strict=True):
            if solution is None:
                where = ", ".join(f"{name} = {value:g}" for name, value in zip(self.grid, point, strict=True))
                lines.append(f"  unsolved     {where}: {ending}")
        return "\n".join(lines)


@limit_to_one_thread()
@suggest_keywords
def sweep(
    problem_of: Family,
    grid: Mapping[str, Sequence[float]],
    *,
    outputs: Mapping[str, Output] | None = None,
    mesh: MeshLike | Mapping[str, MeshLike] | None = None,
    tol: float | None = None,
    options: SolverOptions | None = None,
    executor: Executor | Literal["serial"] | None = None,
) -> Sweep:
    """Return the solutions of a family of problems on a parameter grid.

    Lines along the last parameter are solved in parallel. Within a line, every problem starts from the solution of its
    neighbour and, if that fails, from its own guess. A failed point does not affect others.

    Parameters
    ----------
    problem_of : callable
        Returns the problem for keyword arguments named as in ``grid``; for process executors it must be picklable, that
        is, a module-level function.
    grid : mapping of str to sequence of float
    outputs : mapping of str to callable, optional
        Additional quantities of a solution, evaluated with its problem: ``{"peak": lambda s: ...}``.
    mesh, tol, options
        As in `solve`.
    executor : concurrent.futures.Executor or "serial", optional
        Default: one process per processor.

    Returns
    -------
    Sweep
        After Ctrl-C, the complete lines.

    Raises
    ------
    ArgumentError
        An empty grid, values that are not numbers, a function that does not accept the grid's parameters, or outputs
        that are not functions.
    GncOptError
        The family cannot be pickled for the processes of the executor.

    Examples
    --------
    >>> swept = go.sweep(lambda q: problem.with_initial(q=q), {"q": [1.0, 4.0]}, tol=1e-6, executor="serial")
    >>> print(np.round(swept.objective, 4))
    [2. 4.]
    """
    from gnc_opt.workers import SharedObject, WorkerDiedError, WorkerPool

    if not callable(problem_of):
        raise ArgumentError("sweep() needs a function: write sweep(build, {...}), build returns a problem.")
    axes = _read_parameter_grid(grid)
    _check_problem_builder_arguments(problem_of, axes)
    named = read_optional_mapping(outputs, "outputs of sweep()", 'write {"miss": lambda solution: ...}')
    for name, output in named.items():
        if not callable(output):
            raise ArgumentError(
                f"output '{name}' of sweep() is {quote_value(output)}: give a function of a solution."
            )
    line = _GridLineTask(tuple(axes), tuple(axes.values())[-1], mesh, tol, options)
    shared = SharedObject.wrap_picklable_object(
        _UserFunctions(problem_of, dict(named)),
        "the family of problems, or an output,",
        'define them with def at the top of a module, or use executor="serial"',
    )
    shape = tuple(values.size for values in axes.values())
    solutions, endings = np.full(shape, None, dtype=object), np.full(shape, NOT_REACHED, dtype=object)
    found = {name: np.full(shape, np.nan) for name in named}
    starts = list(itertools.product(*list(axes.values())[:-1]))
    with WorkerPool(shared, executor, "sweep()") as pool:
        done = pool.map(line, list(enumerate(starts)), lambda _: None)
        interrupted = pool.interrupted
    for finished in done:
        row, error = finished.item[0], finished.error
        line_of = {name: array.reshape(-1, shape[-1])[row] for name, array in found.items()}
        if isinstance(error, WorkerDiedError):
            endings.reshape(-1, shape[-1])[row] = str(error)
            continue
        if error is not None:
            raise error
        for k, point in enumerate(finished.answer or ()):
            solutions.reshape(-1, shape[-1])[row, k] = point.solution
            endings.reshape(-1, shape[-1])[row, k] = point.ending
            for name, value in point.outputs.items():
                line_of[name][k] = value
    return Sweep(axes, solutions, endings, found, interrupted)


def _check_problem_builder_arguments(problem_of: Family, axes: Mapping[str, Array]) -> None:
    """Raise `ArgumentError` if the family does not accept the grid's parameters."""
    try:
        signature = inspect.signature(problem_of)
    except ValueError:  # functions not written in Python
        return
    try:
        signature.bind(**dict.fromkeys(axes))
    except TypeError as error:
        raise ArgumentError(
            f"the function of sweep() takes {signature}, but the grid has {', '.join(axes)} ({error}): name its "
            "arguments as in the grid."
        ) from None


def _read_parameter_grid(grid: Mapping[str, Sequence[float]]) -> dict[str, Array]:
    require_type(grid, Mapping, "the grid of sweep()", 'write {"k": [1.0, 2.0]}')
    axes = {}
    for name, values in grid.items():
        read_variable_name(name, "parameter of sweep()")
        axes[name] = read_float_array(values, f"the values of '{name}' in the grid of sweep()").ravel()
        if not axes[name].size or not np.all(np.isfinite(axes[name])):
            raise ArgumentError(
                f"the values of '{name}' in the grid of sweep() are {axes[name]}: give finite numbers."
            )
    if not axes:
        raise ArgumentError('the grid of sweep() is empty: write {"k": [1.0, 2.0]}.')
    return axes


# --- worker tasks -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _GridPoint:
    solution: Solution | None
    ending: str
    outputs: Mapping[str, float]


@dataclass(frozen=True)
class _UserFunctions:
    problem_of: Family
    outputs: Mapping[str, Output]


@dataclass(frozen=True)
class _GridLineTask:
    names: tuple[str, ...]
    values: Array
    mesh: MeshLike | Mapping[str, MeshLike] | None
    tol: float | None
    options: SolverOptions | None

    def __call__(self, functions: _UserFunctions, item: tuple[int, tuple[float, ...]]) -> list[_GridPoint]:
        return list(self._solve_along_sweep_line(functions, item[1]))

    def _solve_along_sweep_line(
        self, functions: _UserFunctions, fixed: tuple[float, ...]
    ) -> Iterator[_GridPoint]:
        neighbour: Solution | None = None
        for value in self.values:
            arguments = dict(zip(self.names, (*map(float, fixed), float(value)), strict=True))
            try:
                problem = require_type(
                    functions.problem_of(**arguments),
                    Problem,
                    "the result of the family of sweep()",
                    "return the problem",
                )
                solution = self._solve_at_sweep_grid_point(problem, neighbour)
                if solution.status is Status.INTERRUPTED and not self._has_time_limit:
                    raise KeyboardInterrupt
                outputs = functions.outputs if solution.status.solved else {}
                more = {name: float(output(solution)) for name, output in outputs.items()}
            except PROGRAMMING_ERRORS:
                raise
            except GncOptError as error:  # invalid grid point
                yield _GridPoint(None, str(error), {})
                continue
            except Exception as error:  # error of a user function, such as a division by zero
                yield _GridPoint(None, f"{type(error).__name__}: {error}", {})
                continue
            if not solution.status.solved:
                yield _GridPoint(None, solution.status.value, {})
                continue
            neighbour = solution
            yield _GridPoint(replace(solution, problem=None), solution.status.value, more)

    @property
    def _has_time_limit(self) -> bool:
        return self.options is not None and self.options.max_wall_time is not None

    def _solve_at_sweep_grid_point(self, problem: Problem, neighbour: Solution | None) -> Solution:
        if neighbour is not None:
            problem.check()
            warm = solve_problem_on_mesh(problem, guess=neighbour, mesh=self.mesh, options=self.options)
            if warm.status.solved:
                if self.tol is None:
                    return warm
                return solve(
                    problem, mesh=self.mesh, guess=warm, tol=self.tol, options=self.options, throw=False
                )
        return solve(problem, mesh=self.mesh, tol=self.tol, options=self.options, throw=False)
