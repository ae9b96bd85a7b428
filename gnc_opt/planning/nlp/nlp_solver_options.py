"""Solver options, and their conversion for `nlpsol` and its plugins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import casadi as ca

from gnc_opt.argument_checks import read_integer, read_positive_number, require_type
from gnc_opt.errors import unknown_name_error
from gnc_opt.numerical_tolerances import PLAUSIBLE
from gnc_opt.planning.nlp.nonlinear_program import (
    NlpProblem,
    build_cost_and_constraint_jacobian,
    build_full_hessian,
)

WARM_PUSH = 1e-9
"""Distance by which a warm start is moved from its bounds, and its multipliers from zero (IPOPT cold: 1e-2)."""

WARM_MU = 1e-6
"""Initial barrier parameter of a warm start (IPOPT cold: 0.1)."""

# No "ma97": if its library is missing, IPOPT 3.14 returns Invalid_Option and then crashes when it is freed.
_IPOPT_LINEAR_SOLVERS = (
    "mumps", "ma27", "ma57", "ma77", "ma86", "pardiso", "pardisomkl", "spral", "wsmp", "custom",
)  # fmt: skip

# By default MUMPS permutes and scales all matrices by the values of the first one, which may be untypical, and each
# factorisation allocates eleven times the estimated memory. IPOPT repeats a factorisation that needs more.
_MUMPS = {"mumps_permuting_scaling": 0, "mumps_pivtol": 1e-4, "mumps_mem_percent": 100}

# From this size on MUMPS uses METIS orderings, which are slow with a dense row (a free final time).
_LARGE_PROGRAM_VARIABLES = 10_000

_MUMPS_LARGE = {"mumps_pivot_order": 6}

# Nearly singular systems (badly scaled variables, very short segments) need larger pivots and balanced rows.
_MUMPS_CAREFUL = {"mumps_pivtol": 1e-2, "mumps_scaling": 8}

# For lam_p CasADi would differentiate the NLP again; these plugins do not need it.
_WITHOUT_NLP_GRAD = ("ipopt", "sqpmethod", "bonmin")

Start: TypeAlias = Literal["cold", "warm", "careful", "adaptive"]


@dataclass(frozen=True)
class SolverOptions:
    """Options of the NLP solver.

    Parameters
    ----------
    solver
        CasADi `nlpsol` plugin.
    linear_solver
        Linear solver of IPOPT. All except "mumps" and "spral" must be installed by the user.
    tolerance
        Tolerance of the scaled optimality conditions (IPOPT `tol`; `tol_pr` and `tol_du` of the SQP methods). Errors
        of costates and switching times may be many times as large.
    max_iterations
        Limit on the number of iterations.
    max_wall_time
        Limit in s; None: no limit. Checked once per iteration.
    bound_relax
        IPOPT's `bound_relax_factor`. Default 0, because with IPOPT's 1e-8 trajectories would exceed their limits.
    careful_pivoting
        Row and column scaling and pivot tolerance 1e-2 of MUMPS, for nearly singular systems. None: on meshes with
        movable breaks only.
    mu_init
        Initial barrier parameter of IPOPT; None: 0.1 for a cold start (IPOPT's default) and 1e-6 for a warm start.
    extra
        Options of `nlpsol` that override all others, such as `{"expand": True, "ipopt.mu_strategy": "adaptive"}`; a
        nested `{"ipopt": {...}}` is equivalent.
    verbose
        Whether the solver prints its log.

    Raises
    ------
    ArgumentError
        A value is out of range, or the name of a solver is unknown.

    Examples
    --------
    >>> careful = go.SolverOptions(tolerance=1e-12, max_iterations=200)
    >>> print(go.solve(problem, mesh="10x3", tol=None, options=careful).status.value)
    optimal
    """

    solver: str = "ipopt"
    linear_solver: str = "mumps"
    tolerance: float = 1e-11
    max_iterations: int = 1000
    max_wall_time: float | None = None
    bound_relax: float = 0.0
    mu_init: float | None = None
    careful_pivoting: bool | None = None
    extra: Mapping[str, object] = field(default_factory=dict)
    verbose: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.solver, str) or not ca.has_nlpsol(self.solver):
            raise unknown_name_error(
                "solver", self.solver, "this installation of CasADi", _list_nlp_solvers()
            )
        known = isinstance(self.linear_solver, str) and self.linear_solver in _IPOPT_LINEAR_SOLVERS
        if self.solver == "ipopt" and not known:
            raise unknown_name_error("linear_solver", self.linear_solver, "IPOPT", _IPOPT_LINEAR_SOLVERS)
        read_positive_number(self.tolerance, "the solver option tolerance")
        read_integer(self.max_iterations, "the solver option max_iterations", 0)
        if self.max_wall_time is not None:
            read_positive_number(self.max_wall_time, "the solver option max_wall_time")
        if self.mu_init is not None:
            read_positive_number(self.mu_init, "the solver option mu_init")
        read_positive_number(self.bound_relax, "the solver option bound_relax", or_zero=True)
        require_type(self.extra, Mapping, "the solver option extra", 'write extra={"ipopt.max_soc": 0}')


def build_nlpsol_options(problem: NlpProblem, options: SolverOptions, start: Start) -> dict[str, Any]:
    """Return all options of `nlpsol` except the callback; plugin options in dotted form."""
    quiet = {"print_time": options.verbose, "show_eval_warnings": options.verbose, "error_on_fail": False}
    if options.solver in _WITHOUT_NLP_GRAD:
        quiet |= {"calc_lam_p": False, "no_nlp_grad": True}
    size = problem.n_variables + problem.n_constraints
    plugin = (
        _build_ipopt_options(options, start, size)
        if options.solver == "ipopt"
        else _build_nlp_plugin_options(options)
    )
    return (
        quiet
        | plugin
        | _build_jacobian_and_hessian_options(problem, options.solver)
        | _flatten_options(options.extra, options.solver)
    )


def _build_ipopt_options(options: SolverOptions, start: Start, size: int) -> dict[str, Any]:
    chosen: dict[str, Any] = {
        "print_level": 5 if options.verbose else 0,
        "sb": "yes",
        "linear_solver": options.linear_solver,
        "tol": float(options.tolerance),
        "compl_inf_tol": _choose_complementarity_tolerance(options.tolerance),
        "max_iter": int(options.max_iterations),
        "bound_relax_factor": float(options.bound_relax),
        "diverging_iterates_tol": PLAUSIBLE,
    }
    if options.max_wall_time is not None:
        chosen["max_wall_time"] = float(options.max_wall_time)
    if options.linear_solver == "mumps":
        chosen |= _MUMPS if size < _LARGE_PROGRAM_VARIABLES else _MUMPS | _MUMPS_LARGE
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


def _choose_complementarity_tolerance(tolerance: float) -> float:
    """Return IPOPT's `compl_inf_tol`, which also limits the final barrier parameter, for accurate multipliers."""
    return min(tolerance, max(1e-2 * tolerance, 1e-11))


def compute_final_barrier_parameter(tolerance: float) -> float:
    """Return the final barrier parameter of IPOPT, with its ``barrier_tol_factor`` of 10."""
    return _choose_complementarity_tolerance(tolerance) / (10.0 + 1.0)


def _build_nlp_plugin_options(options: SolverOptions) -> dict[str, Any]:
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


def _build_jacobian_and_hessian_options(problem: NlpProblem, solver: str) -> dict[str, Any]:
    """Return the problem's derivatives in the form that the plugin accepts; {} if it accepts none."""
    if solver in ("ipopt", "bonmin"):
        given = {name: getattr(problem, name) for name in ("grad_f", "jac_g", "hess_lag")}
    elif solver == "sqpmethod":
        given = {
            "jac_fg": build_cost_and_constraint_jacobian(problem),
            "hess_lag": build_full_hessian(problem),
        }
    else:
        given = {}
    return {name: function for name, function in given.items() if function is not None}


def _flatten_options(extra: Mapping[str, object], solver: str) -> dict[str, object]:
    """Return a nested `{solver: {name: value}}` as `{"solver.name": value}`."""
    flat: dict[str, object] = {}
    for name, value in extra.items():
        if name == solver and isinstance(value, Mapping):
            flat.update({f"{solver}.{key}": inner for key, inner in value.items()})
        else:
            flat[name] = value
    return flat


def _list_nlp_solvers() -> list[str]:
    plugins = (entry.partition("::") for entry in ca.CasadiMeta.plugins().split(";"))
    return sorted(name for kind, _, name in plugins if kind == "Nlpsol" and ca.has_nlpsol(name))
