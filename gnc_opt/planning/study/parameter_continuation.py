"""continuation: solutions along a parameter, from an easy problem to the required one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from gnc_opt.argument_checks import read_float_array, read_positive_number, require_type, suggest_keywords
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, GncOptError
from gnc_opt.planning.direct.fixed_mesh_solve import solve_problem_on_mesh
from gnc_opt.planning.direct.solve_failure_report import SolveError
from gnc_opt.planning.nlp import SolverOptions, Status
from gnc_opt.planning.optimal_control_solver import solve
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.refinement.staged_refinement import refine
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.study.kkt_sensitivity import predict_solution
from gnc_opt.planning.transcription.collocation_families import GAUSS, Scheme
from gnc_opt.planning.transcription.mesh import MeshLike
from gnc_opt.renamed_public_names import StatusWord
from gnc_opt.text_html_and_json_formatting import PrintableResult
from gnc_opt.threads_and_package_versions import limit_to_one_thread

Family: TypeAlias = Callable[[float], Problem]

STEP_MIN_SHARE_OF_RANGE = 1e-4
"""Smallest step, as a share of the range."""

PREDICTION_ERROR_MAX = 0.3
"""Error of a prediction, in scales of the variables, above which a step is halved."""

PREDICTION_ERROR_SMALL = 0.05
"""Error of a prediction below which the next step is doubled."""

CONTINUATION_MAX_ITERATIONS = 300
"""Iteration limit of a step; the step is halved if it is exceeded."""


class ContinuationStatus(StatusWord):
    """Status of a continuation."""

    COMPLETE = "complete"
    BRANCH_ENDED = "branch_ended"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True, eq=False, repr=False)
class Continuation(PrintableResult):
    """Family of solutions along a parameter.

    Attributes
    ----------
    values : array (n,)
        Parameter values of all solutions, in order.
    solutions : tuple of Solution
        One solution per value.
    status : ContinuationStatus
    events : tuple of str
        Jumps to another branch, changes of the structure, and the end of the branch.

    Examples
    --------
    >>> family = go.continuation(lambda a: problem.with_bounds(a=(-a, a)), [1.0, 0.64])
    >>> print(family.status.value, family.values[-1], f"{family.final_solution.objective:.6f}")  # 2 / sqrt(a)
    complete 0.64 2.500000
    """

    values: Array
    solutions: tuple[Solution, ...]
    status: ContinuationStatus
    events: tuple[str, ...] = ()

    @property
    def final_solution(self) -> Solution:
        """Last solution."""
        return self.solutions[-1]

    @property
    def is_complete(self) -> bool:
        """Whether the last requested value was reached."""
        return self.status is ContinuationStatus.COMPLETE

    @property
    def objectives(self) -> Array:
        """Objectives of the solutions (n,), as stated."""
        return np.array([solution.objective for solution in self.solutions])

    def solution_at(self, value: float) -> Solution:
        """Return the solution at a solved value; raise `ArgumentError` for other values."""
        near = np.flatnonzero(np.isclose(self.values, value, rtol=1e-9, atol=1e-12))
        if not near.size:
            raise ArgumentError(f"the continuation has no solution at {value}: its values are {self.values}.")
        return self.solutions[int(near[0])]

    def __str__(self) -> str:
        lines = [
            f"{self.final_solution.problem_name}: continuation {self.status.value}, {self.values.size} solutions from "
            f"{self.values[0]:g} to {self.values[-1]:g}",
            f"{'value':>14} {'objective':>18} {'iterations':>10}",
        ]
        lines += [
            f"{value:14.6g} {solution.objective:18.10g} {solution.statistics.iterations:10d}"
            for value, solution in zip(self.values, self.solutions, strict=True)
        ]
        return "\n".join([*lines, *self.events])


@limit_to_one_thread()
@suggest_keywords
def continuation(
    problem_of: Family,
    values: Sequence[float],
    *,
    step: float | None = None,
    smallest: float | None = None,
    first: Solution | None = None,
    tol: float | None = None,
    mesh: MeshLike | Mapping[str, MeshLike] | None = None,
    scheme: Scheme = GAUSS,
    options: SolverOptions | None = None,
) -> Continuation:
    """Return solutions along a parameter, with adaptive steps.

    Each step is predicted by the sensitivities of the last solution (if the problems are variations of one another) or
    by linear extrapolation, and corrected by a warm-started solve. A step that fails or has a poor prediction is
    halved; after a good prediction the step is doubled.

    Parameters
    ----------
    problem_of : callable
        Returns the problem for a value, such as ``lambda k: problem.with_parameters(k=k)``.
    values : sequence of float
        Values at which solutions are required, from start to end: two or more, ascending or descending.
    step : float, optional
        First step, > 0; default: to the second value.
    smallest : float, optional
        Smallest step, > 0; default: `STEP_MIN_SHARE_OF_RANGE` of the whole range.
    first : Solution, optional
        Solution at the first value; default: solved from its problem's guess.
    tol : float, optional
        Tolerance of the refinement of every solution; detected arcs are reused, as in `solve`.
    mesh, scheme, options
        As in `solve`.

    Returns
    -------
    Continuation
        All solutions so far, also if the last value was not reached or after Ctrl-C.

    Raises
    ------
    ArgumentError
        Fewer than two values, or values that are not monotonic.
    SolveError
        The first problem has no solution.

    Examples
    --------
    >>> path = go.continuation(lambda a: problem.with_bounds(a=(-a, a)), [1.0, 1.44])
    >>> print(path.status.value, f"{path.solutions[-1].objective:.4f}")
    complete 1.6667
    """
    way = read_float_array(values, "the values of continuation()").ravel()
    turns = np.diff(way)
    if way.size < 2 or not np.all(np.isfinite(way)) or not (np.all(turns > 0) or np.all(turns < 0)):
        raise ArgumentError(
            f"the values of continuation() are {way}: give two or more, ascending or descending."
        )
    if not callable(problem_of):
        raise ArgumentError(
            "continuation() needs a function: write continuation(lambda k: problem.with_..., values)."
        )
    whole = abs(way[-1] - way[0])
    least = (
        STEP_MIN_SHARE_OF_RANGE * whole
        if smallest is None
        else read_positive_number(smallest, "the smallest step of continuation()")
    )
    length = whole if step is None else read_positive_number(step, "the step of continuation()")
    if first is not None:
        require_type(first, Solution, "the first solution of continuation()", "give a result of solve()")
    problem = _build_problem_at_parameter(problem_of, float(way[0]))
    start = first or solve(problem, mesh=mesh, scheme=scheme, tol=tol, options=options, throw=False)
    if not start.status.solved:
        raise SolveError(
            f"the first problem of continuation(), at {way[0]:g}, has no solution ({start.status.value}): start at an "
            "easier value.",
            start,
        )
    return _Branch(problem_of, way, max(least, 1e-14 * whole), tol, options).follow_solution_branch(
        start, length
    )


def _build_problem_at_parameter(problem_of: Family, value: float) -> Problem:
    problem = require_type(
        problem_of(value), Problem, "the result of the function of continuation()", "return the problem"
    )
    problem.check()
    return problem  # type: ignore[no-any-return]


@dataclass(frozen=True, eq=False)
class _Branch:
    problem_of: Family
    way: Array
    least: float
    tol: float | None
    options: SolverOptions | None

    def follow_solution_branch(self, start: Solution, length: float) -> Continuation:
        values, solutions, events = [float(self.way[0])], [start], list[str]()
        branch = 0  # start of the present branch; no extrapolation across a jump
        status = ContinuationStatus.COMPLETE
        ahead = float(np.sign(self.way[-1] - self.way[0]))
        try:
            while values[-1] != self.way[-1]:
                target = self.way[ahead * self.way > ahead * values[-1]][0]
                value = values[-1] + ahead * length
                if ahead * (value - target) > -self.least:
                    value = float(target)
                taken = abs(value - values[-1])
                found, miss = self._solve_problem_at_parameter(value, values[branch:], solutions[branch:])
                smooth = found.status.solved and miss <= PREDICTION_ERROR_MAX
                if found.status is Status.INTERRUPTED:
                    status = ContinuationStatus.INTERRUPTED
                    break
                if not smooth and taken > self.least * 1.0001:
                    length = max(0.5 * taken, self.least)
                    continue
                if not found.status.solved:
                    events.append(
                        f"no solution beyond {values[-1]:.10g}: at {value:.10g} the solve ended as {found.status.value}"
                    )
                    status = ContinuationStatus.BRANCH_ENDED
                    break
                if not smooth:
                    events.append(
                        f"jump between {values[-1]:.10g} and {value:.10g}: the solution leaves its branch (a "
                        f"bifurcation or a fold), by {miss:.2g} of its magnitude"
                    )
                    branch = len(values)
                if (
                    self.tol is not None
                    and found.structure != ()
                    and _list_arc_kinds(found) != _list_arc_kinds(solutions[-1])
                ):
                    events.append(f"structure changes between {values[-1]:.10g} and {value:.10g}")
                values.append(value)
                solutions.append(found)
                length = max(length, taken) if miss > PREDICTION_ERROR_SMALL else 2 * max(length, taken)
        except KeyboardInterrupt:
            status = ContinuationStatus.INTERRUPTED
        return Continuation(np.array(values), tuple(solutions), status, tuple(events))

    def _solve_problem_at_parameter(
        self, value: float, values: Sequence[float], solutions: Sequence[Solution]
    ) -> tuple[Solution, float]:
        problem, last = _build_problem_at_parameter(self.problem_of, value), solutions[-1]
        before, ratio = None, 0.0
        if len(values) > 1:
            before, ratio = solutions[-2], (value - values[-1]) / (values[-1] - values[-2])
        prediction = predict_solution(problem, last, before, ratio)
        if self.tol is not None and last.structure:
            found = solve(problem, guess=last, tol=self.tol, throw=False)
        else:
            options = self.options or SolverOptions(max_iterations=CONTINUATION_MAX_ITERATIONS)
            found = solve_problem_on_mesh(
                problem, scheme=last.scheme, guess=prediction.guess, options=options
            )
        if not found.status.solved:
            return found, np.inf
        miss = prediction.compute_prediction_error(found)
        if self.tol is None or last.structure:
            return found, miss
        try:
            return refine(found, tol=self.tol), miss
        except GncOptError:
            return found, miss


def _list_arc_kinds(solution: Solution) -> tuple[object, ...]:
    return tuple((arc.phase, arc.channel, arc.kind) for arc in solution.structure)
