"""Interface to NLP solvers: minimise f(x, p) subject to lbx <= x <= ubx and lbg <= g(x, p) <= ubg.

All `nlpsol` plugins of CasADi are supported; IPOPT is the default and the only tuned one. Multipliers have CasADi's
sign: L = f + lam_g . g + lam_x . x is stationary; a multiplier is >= 0 at an upper and <= 0 at a lower bound.
"""

from __future__ import annotations

import contextlib
import io
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.numerical_tolerances import max_norm
from gnc_opt.planning.nlp.nlp_solver_options import SolverOptions, Start, build_nlpsol_options
from gnc_opt.planning.nlp.nlp_solver_status import Status, read_solver_status
from gnc_opt.planning.nlp.nonlinear_program import NlpProblem
from gnc_opt.planning.nlp.solve_monitor import (
    Bounds,
    Monitor,
    MonitoredSolve,
    ProgressCallback,
    convert_to_float_vector,
    stop_on_sigint,
)

DIVERGED_MIN_SIZE = 1e10
"""Divergence limit after a failure of the solver; scaled variables have order one."""

ACCEPTABLE_MAX_SIZE = 1e8
"""Divergence limit of an iterate of acceptable accuracy; gradients may vanish at infinity."""

_NEVER_STARTED = (Status.NOT_A_NUMBER, Status.TOO_FEW_DEGREES_OF_FREEDOM, Status.INVALID_OPTION)

_MAY_HIDE_UNBOUNDED = (
    Status.ITERATION_LIMIT,
    Status.NOT_A_NUMBER,
    Status.RESTORATION_FAILED,
    Status.SEARCH_DIRECTION_FAILED,
    Status.STEP_TOO_SMALL,
    Status.FAILED,
)


@dataclass(frozen=True, eq=False)
class NlpPoint:
    """Input of one solve: initial point, bounds and parameters. Scalars are constant vectors.

    Parameters
    ----------
    x0
        Initial point, (nx,).
    lbx, ubx
        Bounds of x, (nx,), may be infinite; x is fixed if they are equal.
    lbg, ubg
        Bounds of g, (ng,).
    p
        Parameters, (np,).
    lam_x0, lam_g0
        Multipliers of a nearby solution, (nx,) and (ng,); if given, the start is warm.
    """

    x0: npt.ArrayLike
    lbx: npt.ArrayLike
    ubx: npt.ArrayLike
    lbg: npt.ArrayLike
    ubg: npt.ArrayLike
    p: npt.ArrayLike
    lam_x0: npt.ArrayLike | None = None
    lam_g0: npt.ArrayLike | None = None

    @property
    def warm_or_cold_start(self) -> Start:
        """Kind of start: warm with multipliers, else cold."""
        return "cold" if self.lam_x0 is None and self.lam_g0 is None else "warm"

    def drop_multipliers(self) -> NlpPoint:
        return replace(self, lam_x0=None, lam_g0=None)

    def build_nlpsol_arguments(self, problem: NlpProblem) -> dict[str, Array]:
        sizes = {"p": problem.n_parameters} | dict.fromkeys(("lbg", "ubg", "lam_g0"), problem.n_constraints)
        given = {f.name: getattr(self, f.name) for f in fields(self)}
        return {
            name: convert_to_float_vector(name, value, sizes.get(name, problem.n_variables))
            for name, value in given.items()
            if value is not None
        }


@dataclass(frozen=True)
class NlpResult:
    """Last iterate and status of a solve.

    Parameters
    ----------
    x, g
        Variables (nx,) and constraints (ng,).
    f
        Objective.
    lam_x, lam_g
        Multipliers (nx,) and (ng,); grad f + J^T lam_g + lam_x = 0 at a solution.
    status, raw_status
        Status, and the status string of the solver.
    iterations
        Number of iterations.
    wall_time, function_time, linear_solver_time
        Times in s without the setup of the solver: total, functions and derivatives, remainder.
    """

    x: Array
    f: float
    g: Array
    lam_x: Array
    lam_g: Array
    status: Status
    raw_status: str
    iterations: int
    wall_time: float
    function_time: float
    linear_solver_time: float

    def with_summed_iterations_and_times(self, attempts: Sequence[NlpResult]) -> NlpResult:
        """Return this result with the iterations and times of all its attempts."""
        return replace(
            self,
            iterations=sum(r.iterations for r in attempts),
            wall_time=sum(r.wall_time for r in attempts),
            function_time=sum(r.function_time for r in attempts),
            linear_solver_time=sum(r.linear_solver_time for r in attempts),
        )


class NlpSolver:
    """Solver of one NLP for different bounds, parameters and initial points, cold or warm.

    An object must not be used by two threads at the same time.

    Parameters
    ----------
    problem
        Nonlinear program.
    options
        Solver options.
    """

    def __init__(self, problem: NlpProblem, options: SolverOptions | None = None) -> None:
        self.problem = problem
        self.options = SolverOptions() if options is None else options
        self._monitor = Monitor(problem.n_variables, problem.n_constraints, problem.n_parameters)
        self._instances: dict[Start, Any] = {}

    def solve(
        self,
        point: NlpPoint,
        way: Start | None = None,
        *,
        callback: ProgressCallback | None = None,
        deadline: float | None = None,
    ) -> NlpResult:
        """Solve once; after Ctrl-C the last iterate is returned with `Status.INTERRUPTED`.

        Parameters
        ----------
        point
            Initial point, bounds and parameters.
        way
            Kind of start; default: warm with multipliers, else cold.
        callback
            Called with an `IterationInfo` at every iteration; returning True stops the solve.
        deadline
            End time on the clock `time.perf_counter`; default: from the options, counted after the setup.

        Returns
        -------
        NlpResult
            Also after a failure; see its `status`.

        Raises
        ------
        ArgumentError
            A vector has a wrong length, bounds are crossed or NaN, or the plugin rejects its options.
        """
        arguments = point.build_nlpsol_arguments(self.problem)
        box_x = Bounds.create_checked_bounds("x", arguments["lbx"], arguments["ubx"])
        box_g = Bounds.create_checked_bounds("g", arguments["lbg"], arguments["ubg"])
        self.create_nlp_solver(point, way)  # the time limit excludes the setup
        end = self.compute_deadline() if deadline is None else deadline
        return self._run_nlpsol(
            way or point.warm_or_cold_start, arguments, MonitoredSolve(box_x, box_g, callback, end)
        )

    def create_nlp_solver(self, point: NlpPoint, way: Start | None = None) -> None:
        """Create the solver for this kind of start, unless it exists."""
        self._get_nlp_solver(way or point.warm_or_cold_start)

    def compute_deadline(self) -> float:
        """Return the end time of a solve that starts now, on the clock `time.perf_counter`."""
        limit = self.options.max_wall_time
        return math.inf if limit is None else time.perf_counter() + limit

    def _run_nlpsol(self, start: Start, arguments: Mapping[str, Array], run: MonitoredSolve) -> NlpResult:
        solver = self._get_nlp_solver(start)
        overdetermined = int(run.box_x.is_fixed.sum() + run.box_g.is_fixed.sum()) > self.problem.n_variables
        self._monitor.run = run
        begin = time.perf_counter()
        try:
            with stop_on_sigint(run), _suppress_stderr(overdetermined):
                raw = solver(**arguments)
        finally:
            self._monitor.run = None
        wall_time = time.perf_counter() - begin
        if run.error is not None:
            raise run.error
        return self._build_nlp_result(raw, solver.stats(), run, arguments, wall_time)

    def _get_nlp_solver(self, start: Start) -> Any:
        """Return the `nlpsol` Function for a kind of start, created at first use."""
        key = start if self.options.solver == "ipopt" else "cold"
        if key not in self._instances:
            nlp = {name: getattr(self.problem, name) for name in ("x", "p", "f", "g")}
            chosen = build_nlpsol_options(self.problem, self.options, key) | {
                "iteration_callback": self._monitor
            }
            try:
                self._instances[key] = ca.nlpsol("nlp", self.options.solver, nlp, chosen)
            except RuntimeError as error:
                reason = str(error).strip()
                raise ArgumentError(
                    f"CasADi cannot set up solver {self.options.solver!r}: {reason}"
                ) from error
        return self._instances[key]

    def _build_nlp_result(
        self,
        raw: Mapping[str, Any],
        stats: Mapping[str, Any],
        run: MonitoredSolve,
        arguments: Mapping[str, Array],
        wall: float,
    ) -> NlpResult:
        status = read_solver_status(stats)
        if run.stop and not status.solved:  # requested before the solver had finished, for all plugins
            status = Status.INTERRUPTED
        started = run.count > 0 or status not in _NEVER_STARTED
        x, lam_x, lam_g = (_flatten_casadi_matrix(raw[name]) for name in ("x", "lam_x", "lam_g"))
        f, g = float(raw["f"]), _flatten_casadi_matrix(raw["g"])
        if not started:  # the outputs of the plugin are then undefined
            x, lam_x, lam_g = arguments["x0"].copy(), np.zeros_like(x), np.zeros_like(lam_g)
        fixed = run.box_x.is_fixed
        if fixed.any() or not status.solved:
            f_dm, g_dm, gradient = self.problem.lagrangian_function(x, arguments["p"], lam_g)
            f, g = float(f_dm), _flatten_casadi_matrix(g_dm)
            lam_x[fixed] = -_flatten_casadi_matrix(gradient)[fixed]
        doubtful = status in _MAY_HIDE_UNBOUNDED and _has_iterate_diverged(x, f, DIVERGED_MIN_SIZE)
        if started and (
            doubtful or (status is Status.ACCEPTABLE and _has_iterate_diverged(x, f, ACCEPTABLE_MAX_SIZE))
        ):
            status = Status.UNBOUNDED
        function_time = _sum_solver_timings(stats, "t_wall_nlp_")
        return NlpResult(
            x=x,
            f=f,
            g=g,
            lam_x=lam_x,
            lam_g=lam_g,
            status=status,
            raw_status=str(stats.get("return_status", "")),
            iterations=int(stats.get("iter_count", 0)) if started else 0,
            wall_time=wall,
            function_time=function_time,
            linear_solver_time=max(
                0.0, wall - function_time - _sum_solver_timings(stats, "t_wall_callback_fun")
            ),
        )


@contextlib.contextmanager
def _suppress_stderr(active: bool) -> Iterator[None]:
    """Suppress CasADi's warning about overdetermined problems, which has no option."""
    if not active:
        yield
        return
    with contextlib.redirect_stderr(io.StringIO()):
        yield


def _has_iterate_diverged(x: Array, f: float, limit: float) -> bool:
    return bool(max_norm(x) >= limit) or f <= -limit


def _sum_solver_timings(stats: Mapping[str, Any], prefix: str) -> float:
    return float(sum(value for name, value in stats.items() if name.startswith(prefix)))


def _flatten_casadi_matrix(matrix: Any) -> Array:
    return np.asarray(matrix.full(), dtype=np.float64).ravel()
