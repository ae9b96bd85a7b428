"""The boundary to NLP solvers: minimise f(x, p) subject to lbx <= x <= ubx and lbg <= g(x, p) <= ubg.

Any `nlpsol` plugin of CasADi can be behind it; IPOPT is the default and the one that is tuned. Multipliers
follow CasADi's sign: L = f + lam_g . g + lam_x . x is stationary, so a multiplier is >= 0 at an upper bound
and <= 0 at a lower bound.
"""

from __future__ import annotations

import contextlib
import io
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import FrameType
from typing import Any, Literal, TypeAlias

import casadi as ca
import numpy as np
import numpy.typing as npt

from gnc_opt.arguments import expect, read_integer, read_positive
from gnc_opt.errors import ArgumentError, unknown_name
from gnc_opt.nlp.status import Status, status_from_stats

__all__ = ["IterationInfo", "NlpProblem", "NlpResult", "NlpSolver", "SolverOptions"]

FloatArray: TypeAlias = npt.NDArray[np.float64]

DIVERGED = 1e15
"""A variable beyond this magnitude, or an objective below minus this, counts as running off to infinity."""

RUNAWAY = 1e10
"""The same once the solver has given up anyway: scaled variables are of order one."""

SUSPICIOUS = 1e8
"""Magnitude at which an iterate that is merely acceptable counts as running off: its gradients fade out there."""

WARM_PUSH = 1e-9
"""How far a warm start is moved off its bounds and its multipliers off zero (IPOPT's cold default: 1e-2)."""

WARM_MU = 1e-6
"""Barrier parameter at which a warm start begins (IPOPT's cold default: 0.1)."""

# No "ma97": if its library is missing, IPOPT 3.14 answers Invalid_Option and then crashes as it is freed.
_IPOPT_LINEAR_SOLVERS = (
    "mumps", "ma27", "ma57", "ma77", "ma86", "pardiso", "pardisomkl", "spral", "wsmp", "custom",
)  # fmt: skip

# By default MUMPS permutes and scales all matrices by the numbers of the first one. Where these are untypical, later
# factorisations fill up: on some problems of benchmarks.ocp_set iterations then take 10 to 100 times as long. Without,
# badly scaled problems need pivots better than IPOPT's 1e-6. On ordinary problems the two cost about 5 %.
_MUMPS = {"mumps_permuting_scaling": 0, "mumps_pivtol": 1e-4}

# From this many variables and constraints on MUMPS orders by METIS, which bears a dense row (a free final time) badly:
# approximate minimum degree with quasi-dense rows needs half the time for the analysis and up to 40 % less afterwards.
_LARGE = 10_000
_MUMPS_LARGE = {"mumps_pivot_order": 6}

# Nearly singular systems (badly scaled variables, very short segments) need larger pivots and balanced rows.
_MUMPS_CAREFUL = {"mumps_pivtol": 1e-2, "mumps_scaling": 8}

# Endings that rounding in the linear solver can cause: careful pivoting then goes on from where it stopped.
_ROUNDING = (Status.ACCEPTABLE, Status.STEP_TOO_SMALL, Status.SEARCH_DIRECTION_FAILED)

# For lam_p alone CasADi differentiates the whole NLP once more; these plugins can do without.
_WITHOUT_NLP_GRAD = ("ipopt", "sqpmethod", "bonmin")

_Start: TypeAlias = Literal["cold", "warm", "careful", "adaptive"]
_COLD = ("x0", "p", "lbx", "ubx", "lbg", "ubg")

# IPOPT's monotone barrier stalls where constraint gradients become dependent at the solution (a phase that
# shrinks to nothing, say). Its adaptive barrier, slower on ordinary problems, then tries from the same guess.
_GAVE_UP = (Status.RESTORATION_FAILED, Status.SEARCH_DIRECTION_FAILED, Status.STEP_TOO_SMALL)

_NEVER_STARTED = (Status.NOT_A_NUMBER, Status.TOO_FEW_DEGREES_OF_FREEDOM, Status.INVALID_OPTION)
_MAY_HIDE_UNBOUNDED = (
    Status.ITERATION_LIMIT,
    Status.NOT_A_NUMBER,
    Status.RESTORATION_FAILED,
    Status.SEARCH_DIRECTION_FAILED,
    Status.STEP_TOO_SMALL,
    Status.FAILED,
)


@dataclass(frozen=True)
class NlpProblem:
    """A nonlinear programme, with or without its derivatives.

    Parameters
    ----------
    x, p
        Symbols, (nx, 1) and (np, 1): variables and parameters. `p` may be empty.
    f
        Objective, scalar.
    g
        Constraints, (ng, 1); may be empty.
    grad_f
        `(x, p) -> (f, grad_f_x)`, the gradient a column (nx, 1).
    jac_g
        `(x, p) -> (g, jac_g_x)`, the Jacobian sparse (ng, nx).
    hess_lag
        `(x, p, lam_f, lam_g) -> (triu_hess_gamma_x_x)`: the upper triangle, sparse (nx, nx), of the Hessian
        of lam_f f + lam_g . g.

    Raises
    ------
    ArgumentError
        If a derivative does not have the signature above.

    Notes
    -----
    The signatures are those of CasADi 3.8's IPOPT interface, which binds arguments by position and not by
    name. Derivatives that are left out come from CasADi's automatic differentiation.
    """

    x: Any
    p: Any
    f: Any
    g: Any
    grad_f: Any = None
    jac_g: Any = None
    hess_lag: Any = None

    def __post_init__(self) -> None:
        nx, ng = self.n_variables, self.n_constraints
        _check_function("grad_f", self.grad_f, 2, ((1, 1), (nx, 1)))
        _check_function("jac_g", self.jac_g, 2, ((ng, 1), (ng, nx)))
        _check_function("hess_lag", self.hess_lag, 4, ((nx, nx),))
        if self.hess_lag is not None and not self.hess_lag.sparsity_out(0).is_triu():
            raise ArgumentError("hess_lag must return only the upper triangle of the Hessian (casadi.triu)")

    @property
    def n_variables(self) -> int:
        """Number of variables nx."""
        return int(self.x.numel())

    @property
    def n_constraints(self) -> int:
        """Number of constraints ng."""
        return int(self.g.numel())

    @property
    def n_parameters(self) -> int:
        """Number of parameters np."""
        return int(self.p.numel())

    @cached_property
    def lagrangian(self) -> Any:
        """Function `(x, p, lam_g) -> (f, g, gradient of f + lam_g . g)`; the gradient is (nx, 1)."""
        x, p, lam_g = _symbols(self, "x", "p", "lam_g")
        if self.grad_f is not None and self.jac_g is not None:
            f, gradient = self.grad_f(x, p)
            g, jacobian = self.jac_g(x, p)
            total = gradient + ca.mtimes(jacobian.T, lam_g)
        else:
            x, p, f, g = self.x, self.p, self.f, self.g
            total = ca.gradient(f + ca.dot(lam_g, g), x)
        return ca.Function("lagrangian", [x, p, lam_g], [f, g, ca.densify(total)])


@dataclass(frozen=True)
class SolverOptions:
    """What to ask of the solver.

    Parameters
    ----------
    solver
        CasADi `nlpsol` plugin.
    linear_solver
        IPOPT's linear solver. All but "mumps" and "spral" must be installed by the user; "ma97" is reached
        only through `extra`, since IPOPT crashes the process where it is missing.
    tolerance
        On the scaled optimality conditions (IPOPT `tol`; `tol_pr` and `tol_du` of the SQP methods).
    max_iterations
        Limit on the number of iterations.
    max_wall_time
        Limit in s; None for no limit. Looked at once per iteration.
    bound_relax
        IPOPT's `bound_relax_factor`. Zero, because IPOPT would otherwise widen every bound by 1e-8, and a
        trajectory with a little more thrust than there is has a minimum time better than the true one.
    careful_pivoting
        Have MUMPS scale rows and columns and pivot at 1e-2 instead of IPOPT's 1e-6: some 20 % slower per iteration,
        and what nearly singular systems need. None: on meshes with movable boundaries only.
    mu_init
        First barrier parameter of IPOPT; None for 0.1 cold (IPOPT's own) and 1e-6 warm.
    extra
        Options of `nlpsol` that win over all of the above, such as `{"expand": True, "ipopt.mu_strategy":
        "adaptive"}`; a nested `{"ipopt": {...}}` means the same.
    verbose
        Let the solver print its log. Silent otherwise.

    Raises
    ------
    ArgumentError
        If a value is out of range, or a solver's name is unknown.
    """

    solver: str = "ipopt"
    linear_solver: str = "mumps"
    tolerance: float = 1e-9
    max_iterations: int = 1000
    max_wall_time: float | None = None
    bound_relax: float = 0.0
    mu_init: float | None = None
    careful_pivoting: bool | None = None
    extra: Mapping[str, object] = field(default_factory=dict)
    verbose: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.solver, str) or not ca.has_nlpsol(self.solver):
            raise unknown_name("solver", self.solver, "this installation of CasADi", _installed_solvers())
        known = isinstance(self.linear_solver, str) and self.linear_solver in _IPOPT_LINEAR_SOLVERS
        if self.solver == "ipopt" and not known:
            raise unknown_name("linear_solver", self.linear_solver, "IPOPT", _IPOPT_LINEAR_SOLVERS)
        read_positive(self.tolerance, "the solver option tolerance")
        read_integer(self.max_iterations, "the solver option max_iterations", 0)
        if self.max_wall_time is not None:
            read_positive(self.max_wall_time, "the solver option max_wall_time")
        if self.mu_init is not None:
            read_positive(self.mu_init, "the solver option mu_init")
        read_positive(self.bound_relax, "the solver option bound_relax", or_zero=True)
        expect(self.extra, Mapping, "the solver option extra", 'write extra={"ipopt.max_soc": 0}')


@dataclass(frozen=True)
class IterationInfo:
    """What the progress callback is told.

    Parameters
    ----------
    iteration
        0 for the (projected) guess.
    objective
        f at the iterate.
    infeasibility
        Largest violation of a bound on x or g, >= 0.
    """

    iteration: int
    objective: float
    infeasibility: float


ProgressCallback: TypeAlias = Callable[[IterationInfo], "bool | None"]


@dataclass(frozen=True)
class NlpResult:
    """The last iterate and how the solve ended.

    Parameters
    ----------
    x, g
        (nx,) and (ng,): variables and constraints.
    f
        Objective.
    lam_x, lam_g
        (nx,) and (ng,): multipliers; grad f + J^T lam_g + lam_x = 0 at a solution.
    status
        How it ended, and what to do about it.
    raw_status
        The solver's own word for it.
    iterations
        Number of iterations.
    wall_time
        In s, without the time to set the solver up.
    function_time
        In s, spent in the objective, the constraints and their derivatives.
    linear_solver_time
        In s, what remains of the wall time without functions and callback: linear algebra and line search.
    """

    x: FloatArray
    f: float
    g: FloatArray
    lam_x: FloatArray
    lam_g: FloatArray
    status: Status
    raw_status: str
    iterations: int
    wall_time: float
    function_time: float
    linear_solver_time: float


class NlpSolver:
    """Solve one NLP many times: for other bounds, parameters and guesses, cold or warm.

    IPOPT takes its options when it is created, so the cold, the warm and the adaptive solver are three
    instances; each is created when it is first needed. Where IPOPT gives up without a verdict, the adaptive
    one starts again from the guess. One object must not be used by two threads at once.

    Parameters
    ----------
    problem
        The programme.
    options
        What to ask of the solver.
    """

    def __init__(self, problem: NlpProblem, options: SolverOptions | None = None) -> None:
        self.problem = problem
        self.options = SolverOptions() if options is None else options
        self._monitor = _Monitor(problem.n_variables, problem.n_constraints, problem.n_parameters)
        self._instances: dict[_Start, Any] = {}

    def solve(
        self,
        x0: npt.ArrayLike,
        lbx: npt.ArrayLike,
        ubx: npt.ArrayLike,
        lbg: npt.ArrayLike,
        ubg: npt.ArrayLike,
        p: npt.ArrayLike,
        lam_x0: npt.ArrayLike | None = None,
        lam_g0: npt.ArrayLike | None = None,
        callback: ProgressCallback | None = None,
    ) -> NlpResult:
        """Solve from a guess; with multipliers, start warm.

        Ctrl-C ends the solve after the running iteration and returns the last iterate with
        `Status.INTERRUPTED`; a second Ctrl-C acts as it does everywhere else.

        Parameters
        ----------
        x0
            (nx,): guess. Scalars stand for constant vectors, here and below.
        lbx, ubx
            (nx,): bounds on x, may be infinite. Where they are equal x is fixed.
        lbg, ubg
            (ng,): bounds on g.
        p
            (np,): parameters.
        lam_x0, lam_g0
            (nx,) and (ng,): multipliers of a nearby solution. With either, the solver starts warm.
        callback
            Called with an `IterationInfo` at every iteration; returning True stops the solve.

        Returns
        -------
        NlpResult
            Also if the solve failed; look at its `status`.

        Raises
        ------
        ArgumentError
            If a length is wrong, bounds are crossed or NaN, or the plugin refuses its options.
        RuntimeError
            If a plugin other than IPOPT breaks down instead of reporting its failure.
        Exception
            Whatever `callback` raises.
        """
        nx, ng = self.problem.n_variables, self.problem.n_constraints
        start = _vector("x0", x0, nx)
        box_x, box_g = _Box.of("x", lbx, ubx, nx), _Box.of("g", lbg, ubg, ng)
        arguments = {
            "x0": start,
            "p": _vector("p", p, self.problem.n_parameters),
            "lbx": box_x.lower,
            "ubx": box_x.upper,
            "lbg": box_g.lower,
            "ubg": box_g.upper,
        }
        if lam_x0 is not None:
            arguments["lam_x0"] = _vector("lam_x0", lam_x0, nx)
        if lam_g0 is not None:
            arguments["lam_g0"] = _vector("lam_g0", lam_g0, ng)
        limit = math.inf if self.options.max_wall_time is None else self.options.max_wall_time
        run = _Run(box_x, box_g, callback, time.perf_counter() + limit)
        result = self._attempt("warm" if len(arguments) > len(_COLD) else "cold", arguments, run)
        if (
            result.status in _ROUNDING
            and self.options.solver == "ipopt"
            and not self.options.careful_pivoting
        ):
            found = {"x0": result.x, "lam_x0": result.lam_x, "lam_g0": result.lam_g}
            again = self._attempt("careful", arguments | found, run)
            result = _joined(result, again) if again.status.solved else result
        if result.status in _GAVE_UP and self.options.solver == "ipopt":
            again = self._attempt("adaptive", {name: arguments[name] for name in _COLD}, run)
            result = _joined(result, again)
        return result

    def _attempt(self, start: _Start, arguments: Mapping[str, FloatArray], run: _Run) -> NlpResult:
        solver = self._instance(start)
        overdetermined = int(run.box_x.fixed.sum() + run.box_g.fixed.sum()) > self.problem.n_variables
        self._monitor.run = run
        begin = time.perf_counter()
        try:
            with _sigint_stops(run), _swallow_stderr(overdetermined):
                raw = solver(**arguments)
        finally:
            self._monitor.run = None
        wall_time = time.perf_counter() - begin
        if run.error is not None:
            raise run.error
        return self._result(raw, solver.stats(), run, arguments, wall_time)

    def _instance(self, start: _Start) -> Any:
        """The `nlpsol` Function for one way to start, created when first asked for."""
        key = start if self.options.solver == "ipopt" else "cold"
        if key not in self._instances:
            nlp = {name: getattr(self.problem, name) for name in ("x", "p", "f", "g")}
            chosen = _nlpsol_options(self.problem, self.options, key) | {"iteration_callback": self._monitor}
            try:
                self._instances[key] = ca.nlpsol("nlp", self.options.solver, nlp, chosen)
            except RuntimeError as error:
                reason = str(error).strip()
                raise ArgumentError(
                    f"CasADi cannot set up solver {self.options.solver!r}: {reason}"
                ) from error
        return self._instances[key]

    def _result(
        self,
        raw: Mapping[str, Any],
        stats: Mapping[str, Any],
        run: _Run,
        arguments: Mapping[str, FloatArray],
        wall: float,
    ) -> NlpResult:
        status = _stopped_status(status_from_stats(stats), run)
        started = run.count > 0 or status not in _NEVER_STARTED
        x, lam_x, lam_g = (_flat(raw[name]) for name in ("x", "lam_x", "lam_g"))
        f, g = float(raw["f"]), _flat(raw["g"])
        if not started:  # the plugin's outputs are then whatever was in memory
            x, lam_x, lam_g = arguments["x0"].copy(), np.zeros_like(x), np.zeros_like(lam_g)
        fixed = run.box_x.fixed
        if fixed.any() or not status.solved:
            f_dm, g_dm, gradient = self.problem.lagrangian(x, arguments["p"], lam_g)
            f, g = float(f_dm), _flat(g_dm)
            lam_x[fixed] = -_flat(gradient)[fixed]
        doubtful = status in _MAY_HIDE_UNBOUNDED and _diverged(x, f, RUNAWAY)
        if started and (doubtful or (status is Status.ACCEPTABLE and _diverged(x, f, SUSPICIOUS))):
            status = Status.UNBOUNDED
        function_time = _time_in(stats, "t_wall_nlp_")
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
            linear_solver_time=max(0.0, wall - function_time - _time_in(stats, "t_wall_callback_fun")),
        )


@dataclass(frozen=True)
class _Box:
    """Bounds on a vector, (n,) each."""

    lower: FloatArray
    upper: FloatArray

    @classmethod
    def of(cls, name: str, lower: npt.ArrayLike, upper: npt.ArrayLike, size: int) -> _Box:
        box = cls(_vector(f"lb{name}", lower, size), _vector(f"ub{name}", upper, size))
        wrong = ~(box.lower <= box.upper) | (box.lower == np.inf) | (box.upper == -np.inf)
        if wrong.any():
            i = int(np.argmax(wrong))
            raise ArgumentError(
                f"the bounds of {name}[{i}] admit no number: {box.lower[i]} to {box.upper[i]}"
            )
        return box

    @property
    def fixed(self) -> npt.NDArray[np.bool_]:
        return np.asarray(self.lower == self.upper, dtype=np.bool_)

    def violation(self, value: FloatArray) -> float:
        return max(
            0.0,
            float(np.max(self.lower - value, initial=0.0)),
            float(np.max(value - self.upper, initial=0.0)),
        )


@dataclass
class _Run:
    """What the monitor must know about the solve under way, and what it has seen of it."""

    box_x: _Box
    box_g: _Box
    callback: ProgressCallback | None
    deadline: float
    stop: bool = False
    count: int = 0
    error: BaseException | None = None

    def see(self, x: FloatArray, f: float, g: FloatArray) -> None:
        """Note one iterate; sets `stop`, never raises."""
        try:
            if self.callback is not None:
                infeasibility = max(self.box_x.violation(x), self.box_g.violation(g))
                if self.callback(IterationInfo(self.count, f, infeasibility)):
                    self.stop = True
        except BaseException as error:  # must not travel through the solver; raised again after it
            self.error, self.stop = error, True
        self.count += 1
        if time.perf_counter() > self.deadline:
            self.stop = True


class _Monitor(ca.Callback):  # type: ignore[misc]
    """The `iteration_callback` of `nlpsol`: shows each iterate to the run and tells the solver to stop.

    It reads the solver's memory through buffers, which is several times cheaper than CasADi matrices. The
    iterate itself is not kept, since `nlpsol` returns the last one when it is stopped.
    """

    def __init__(self, nx: int, ng: int, n_parameters: int) -> None:
        super().__init__()
        self._rows = {"x": nx, "f": 1, "g": ng, "lam_x": nx, "lam_g": ng, "lam_p": n_parameters}
        self.run: _Run | None = None
        self.construct("monitor")

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> Any:
        return ca.Sparsity.dense(self._rows[ca.nlpsol_out(i)], 1)

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arg: Any, res: Any) -> int:
        run = self.run
        if run is not None:
            x, f, g = (_view(arg[i], self._rows[name]) for i, name in enumerate(("x", "f", "g")))
            run.see(x, float(f[0]), g)
            _view(res[0], 1)[0] = float(run.stop)
        return 0


def _joined(first: NlpResult, second: NlpResult) -> NlpResult:
    """The better of two attempts, with the cost of both."""
    better = first if second.status in _GAVE_UP else second
    return replace(
        better,
        iterations=first.iterations + second.iterations,
        wall_time=first.wall_time + second.wall_time,
        function_time=first.function_time + second.function_time,
        linear_solver_time=first.linear_solver_time + second.linear_solver_time,
    )


def _nlpsol_options(problem: NlpProblem, options: SolverOptions, start: _Start) -> dict[str, Any]:
    """Everything for `nlpsol` but the callback; plugin options in their dotted form."""
    quiet = {
        "print_time": options.verbose,
        "show_eval_warnings": options.verbose,
        "error_on_fail": False,
    }
    if options.solver in _WITHOUT_NLP_GRAD:
        quiet |= {"calc_lam_p": False, "no_nlp_grad": True}
    size = problem.n_variables + problem.n_constraints
    plugin = _ipopt_options(options, start, size) if options.solver == "ipopt" else _other_options(options)
    return (
        quiet
        | plugin
        | _derivative_options(problem, options.solver)
        | _flatten(options.extra, options.solver)
    )


def _ipopt_options(options: SolverOptions, start: _Start, size: int) -> dict[str, Any]:
    chosen: dict[str, Any] = {
        "print_level": 5 if options.verbose else 0,
        "sb": "yes",
        "linear_solver": options.linear_solver,
        "tol": float(options.tolerance),
        "compl_inf_tol": _complementarity(options.tolerance),
        "max_iter": int(options.max_iterations),
        "bound_relax_factor": float(options.bound_relax),
        "diverging_iterates_tol": DIVERGED,
    }
    if options.max_wall_time is not None:
        chosen["max_wall_time"] = float(options.max_wall_time)
    if options.linear_solver == "mumps":
        chosen |= _MUMPS if size < _LARGE else _MUMPS | _MUMPS_LARGE
        chosen |= _MUMPS_CAREFUL if options.careful_pivoting or start == "careful" else {}
    if options.mu_init is not None or start in ("warm", "careful"):
        chosen["mu_init"] = WARM_MU if options.mu_init is None else float(options.mu_init)
    if start == "adaptive":
        chosen["mu_strategy"] = "adaptive"
    if start in ("warm", "careful"):
        chosen["warm_start_init_point"] = "yes"
        for name in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push"):
            chosen[f"warm_start_{name}"] = WARM_PUSH
    return {f"ipopt.{name}": value for name, value in chosen.items()}


def _complementarity(tolerance: float) -> float:
    """Return IPOPT's `compl_inf_tol`, which also ends the barrier parameter's descent.

    The barrier keeps every bounded variable off its bound: at mu = tolerance a bang-bang time of 240 nodes is 1e-8
    too long, and multipliers per unit of time are off by mu over the quadrature weight. Two digits more cost about
    one iteration in a hundred; below 1e-11 rounding of slacks sets in.
    """
    return min(tolerance, max(1e-2 * tolerance, 1e-11))


def _other_options(options: SolverOptions) -> dict[str, Any]:
    """The same wishes for another plugin, as far as it has options for them."""
    quiet_qp = {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False}
    wishes: dict[str, Any] = {
        "max_iter": int(options.max_iterations),
        "tol_pr": float(options.tolerance),
        "tol_du": float(options.tolerance),
        "print_header": options.verbose,
        "print_iteration": options.verbose,
        "print_status": options.verbose,
        "qpsol": "qrqp",
        "qpsol_options": {} if options.verbose else quiet_qp,
    }
    accepted = set(ca.nlpsol_options(options.solver))
    return {name: value for name, value in wishes.items() if name in accepted}


def _derivative_options(problem: NlpProblem, solver: str) -> dict[str, Any]:
    """The problem's own derivatives in the form that the plugin takes; {} if it takes none."""
    if solver in ("ipopt", "bonmin"):
        given = {name: getattr(problem, name) for name in ("grad_f", "jac_g", "hess_lag")}
    elif solver == "sqpmethod":
        given = {"jac_fg": _joint_jacobian(problem), "hess_lag": _full_hessian(problem)}
    else:
        given = {}
    return {name: function for name, function in given.items() if function is not None}


def _joint_jacobian(problem: NlpProblem) -> Any:
    """`(x, p) -> (f, grad_f_x, g, jac_g_x)`, the `jac_fg` of sqpmethod; None without derivatives."""
    if problem.grad_f is None or problem.jac_g is None:
        return None
    x, p = _symbols(problem, "x", "p")
    return ca.Function("nlp_jac_fg", [x, p], [*problem.grad_f(x, p), *problem.jac_g(x, p)])


def _full_hessian(problem: NlpProblem) -> Any:
    """`(x, p, lam_f, lam_g) -> (hess_gamma_x_x)`, both triangles, as sqpmethod wants it; or None."""
    if problem.hess_lag is None:
        return None
    inputs = _symbols(problem, "x", "p", "lam_f", "lam_g")
    return ca.Function("nlp_hess_l", inputs, [ca.triu2symm(problem.hess_lag(*inputs))])


def _symbols(problem: NlpProblem, *names: str) -> list[Any]:
    rows = {"x": problem.n_variables, "p": problem.n_parameters, "lam_f": 1, "lam_g": problem.n_constraints}
    return [ca.MX.sym(name, rows[name]) for name in names]


def _flatten(extra: Mapping[str, object], solver: str) -> dict[str, object]:
    """Write a nested `{solver: {name: value}}` as `{"solver.name": value}`."""
    flat: dict[str, object] = {}
    for name, value in extra.items():
        if name == solver and isinstance(value, Mapping):
            flat.update({f"{solver}.{key}": inner for key, inner in value.items()})
        else:
            flat[name] = value
    return flat


@contextlib.contextmanager
def _sigint_stops(run: _Run) -> Iterator[None]:
    """While open, the first Ctrl-C asks the run to stop and gives the next one back to the old handler."""
    previous = signal.getsignal(signal.SIGINT)
    ignored = previous in (None, signal.SIG_IGN)
    if ignored or threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(signum: int, frame: FrameType | None) -> None:
        run.stop = True
        signal.signal(signal.SIGINT, previous)

    signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


@contextlib.contextmanager
def _swallow_stderr(active: bool) -> Iterator[None]:
    """Hide CasADi's warning about overdetermined problems, which no option turns off."""
    if not active:
        yield
        return
    with contextlib.redirect_stderr(io.StringIO()):
        yield


def _stopped_status(status: Status, run: _Run) -> Status:
    """INTERRUPTED if the run asked for a stop, whatever the plugin calls that, unless it had finished."""
    return Status.INTERRUPTED if run.stop and not status.solved else status


def _diverged(x: FloatArray, f: float, limit: float) -> bool:
    return bool(np.max(np.abs(x), initial=0.0) >= limit) or f <= -limit


def _time_in(stats: Mapping[str, Any], prefix: str) -> float:
    return float(sum(value for name, value in stats.items() if name.startswith(prefix)))


def _view(buffer: Any, size: int) -> FloatArray:
    """View of a CasADi buffer, (size,); NaN for what the plugin does not tell."""
    if size == 0 or buffer is None:
        return np.full(size, np.nan)
    return np.frombuffer(buffer, dtype=np.float64)


def _flat(matrix: Any) -> FloatArray:
    return np.asarray(matrix.full(), dtype=np.float64).ravel()


def _vector(name: str, value: npt.ArrayLike, size: int) -> FloatArray:
    """A fresh vector (size,) from a vector or a scalar."""
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0:
        return np.full(size, float(array))
    if array.shape != (size,):
        raise ArgumentError(f"{name} must have shape ({size},), got {array.shape}")
    return array.copy()


def _check_function(name: str, function: Any, n_in: int, shapes: tuple[tuple[int, int], ...]) -> None:
    if function is None:
        return
    found = tuple(tuple(function.size_out(i)) for i in range(function.n_out()))
    if function.n_in() != n_in or found != shapes:
        raise ArgumentError(
            f"{name} must map {n_in} inputs to outputs of shapes {shapes}, "
            f"got {function.n_in()} inputs and {found}"
        )


def _installed_solvers() -> list[str]:
    plugins = (entry.partition("::") for entry in ca.CasadiMeta.plugins().split(";"))
    return sorted(name for kind, _, name in plugins if kind == "Nlpsol" and ca.has_nlpsol(name))
