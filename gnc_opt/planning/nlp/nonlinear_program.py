"""Nonlinear program in CasADi symbols, with optional derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca

from gnc_opt.errors import ArgumentError


@dataclass(frozen=True)
class NlpProblem:
    """Nonlinear program with optional derivatives, in the signatures of CasADi 3.8's IPOPT interface.

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
        `(x, p, lam_f, lam_g) -> (triu_hess_gamma_x_x)`: upper triangle, sparse (nx, nx), of the Hessian.

    Raises
    ------
    ArgumentError
        A derivative has another signature.
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
        _check_nlp_function_shape("grad_f", self.grad_f, 2, ((1, 1), (nx, 1)))
        _check_nlp_function_shape("jac_g", self.jac_g, 2, ((ng, 1), (ng, nx)))
        _check_nlp_function_shape("hess_lag", self.hess_lag, 4, ((nx, nx),))
        if self.hess_lag is not None and not self.hess_lag.sparsity_out(0).is_triu():
            raise ArgumentError("hess_lag must return only the upper triangle of the Hessian (casadi.triu)")

    @property
    def n_variables(self) -> int:
        return int(self.x.numel())

    @property
    def n_constraints(self) -> int:
        return int(self.g.numel())

    @property
    def n_parameters(self) -> int:
        return int(self.p.numel())

    @cached_property
    def lagrangian_function(self) -> Any:
        """Return the function `(x, p, lam_g) -> (f, g, gradient of f + lam_g . g)`; the gradient is (nx, 1)."""
        if self.grad_f is not None and self.jac_g is not None:
            x, p, lam_g = create_nlp_symbols(self, "x", "p", "lam_g")
            f, gradient = self.grad_f(x, p)
            g, jacobian = self.jac_g(x, p)
            total = gradient + ca.mtimes(jacobian.T, lam_g)
        else:
            x, p, f, g = self.x, self.p, self.f, self.g
            lam_g = x.sym("lam_g", self.n_constraints)  # SX or MX, as in the program
            total = ca.gradient(f + ca.dot(lam_g, g), x)
        return ca.Function("lagrangian", [x, p, lam_g], [f, g, ca.densify(total)])


def build_cost_and_constraint_jacobian(problem: NlpProblem) -> Any:
    """Return `(x, p) -> (f, grad_f_x, g, jac_g_x)`, the `jac_fg` of sqpmethod; None without derivatives."""
    if problem.grad_f is None or problem.jac_g is None:
        return None
    x, p = create_nlp_symbols(problem, "x", "p")
    return ca.Function("nlp_jac_fg", [x, p], [*problem.grad_f(x, p), *problem.jac_g(x, p)])


def build_full_hessian(problem: NlpProblem) -> Any:
    """Return `(x, p, lam_f, lam_g) -> (hess_gamma_x_x)`, both triangles, for sqpmethod; None without it."""
    if problem.hess_lag is None:
        return None
    inputs = create_nlp_symbols(problem, "x", "p", "lam_f", "lam_g")
    return ca.Function("nlp_hess_l", inputs, [ca.triu2symm(problem.hess_lag(*inputs))])


def create_nlp_symbols(problem: NlpProblem, *names: str) -> list[Any]:
    rows = {"x": problem.n_variables, "p": problem.n_parameters, "lam_f": 1, "lam_g": problem.n_constraints}
    return [ca.MX.sym(name, rows[name]) for name in names]


def _check_nlp_function_shape(
    name: str, function: Any, n_in: int, shapes: tuple[tuple[int, int], ...]
) -> None:
    if function is None:
        return
    found = tuple(tuple(function.size_out(i)) for i in range(function.n_out()))
    if function.n_in() != n_in or found != shapes:
        raise ArgumentError(
            f"{name} must map {n_in} inputs to outputs of shapes {shapes}, "
            f"got {function.n_in()} inputs and {found}"
        )
