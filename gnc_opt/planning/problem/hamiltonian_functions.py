r"""Numerical functions of a problem: dynamics, Hamiltonian and its derivatives, end-point functions.

This module defines the sign convention of the Hamiltonian. For the minimised functional J,

.. math:: H = \sum_i w_i L_i + \lambda^T f, \qquad H_a = H + \mu^T c,

with integrands L_i and their weights w_i = dJ/dI_i (1 for a plain Lagrange cost), path constraints c and
multipliers mu. Along a minimum :math:`\dot\lambda = -\partial H_a / \partial x`, the control minimises H, and
:math:`\lambda(t_0) = \partial J^* / \partial x_0`. The transcription does not use these functions, so that the
optimality check is independent of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy
from numpy.typing import ArrayLike

from gnc_opt.array_types import Array, Indices, Mask
from gnc_opt.errors import ProblemError
from gnc_opt.model.casadi_expression_graph import JUMPS
from gnc_opt.model.casadi_function_evaluation import (
    VectorizedFunction,
    build_single_point_evaluator,
    evaluate_casadi_function,
)
from gnc_opt.model.model_variables import convert_to_sx_column
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.symbolic_expressions import (
    build_function_along_phase,
    list_endpoint_arguments,
    list_endpoint_symbols,
    substitute_parameters,
)

_ARGUMENTS = ("t", "x", "u", "lam", "mu", "weights", "p", "q")


@dataclass(frozen=True)
class PhaseFunctions:
    """Functions of one phase; methods accept one time or many (time as the last axis).

    Attributes
    ----------
    p : array (n_model_parameters,)
        Model parameter values.
    q : array (n_free_parameters,)
        Free parameter values.
    weights : array (n_integrals,)
        dJ/dI of each integral.
    time_unit : str
        Unit of times in the output.
    """

    functions: dict[str, Any]
    p: Array
    q: Array
    weights: Array
    time_unit: str = "s"

    def state_rates(self, t: ArrayLike, x: ArrayLike, u: ArrayLike) -> Array:
        """dx/dt, shape of x."""
        return self._evaluate_function_by_name("rates", t, x, u)

    def buffered_state_rates(self) -> Callable[[float, Array, Array], Array]:
        """Return dx/dt as a function of (t, x, u) at one time, without conversion overhead."""
        function = self.functions["rates"]
        costates, multipliers = (np.zeros(function.size1_in(i)) for i in (3, 4))
        return build_single_point_evaluator(function, costates, multipliers, self.weights, self.p, self.q)

    def path_constraints(self, t: ArrayLike, x: ArrayLike, u: ArrayLike) -> Array:
        """Path constraint values, shape (n_paths, ...)."""
        return self._evaluate_function_by_name("paths", t, x, u)

    def integrands(self, t: ArrayLike, x: ArrayLike, u: ArrayLike) -> Array:
        """Integrand values, shape (n_integrals, ...)."""
        return self._evaluate_function_by_name("integrands", t, x, u)

    def evaluate_rates_paths_and_integrands(self, t: ArrayLike, x: ArrayLike, u: ArrayLike) -> Array:
        """Return rates, path constraints and integrands, (n + n_paths + n_integrals, ...)."""
        return self._evaluate_function_by_name("stacked", t, x, u)

    def hamiltonian(self, t: ArrayLike, x: ArrayLike, u: ArrayLike, lam: ArrayLike) -> Array:
        """H = w.L + lam.f, shape (...)."""
        return np.asarray(self._evaluate_function_by_name("hamiltonian", t, x, u, lam)[0])

    def switching_functions(self, t: ArrayLike, x: ArrayLike, u: ArrayLike, lam: ArrayLike) -> Array:
        """Switching functions dH/du, without path multipliers, shape of u."""
        return self._evaluate_function_by_name("switching", t, x, u, lam)

    def control_gradient(
        self, t: ArrayLike, x: ArrayLike, u: ArrayLike, lam: ArrayLike, mu: ArrayLike
    ) -> Array:
        """d(H + mu.c)/du, shape of u."""
        return self._evaluate_function_by_name("control_gradient", t, x, u, lam, mu)

    def state_gradient(
        self, t: ArrayLike, x: ArrayLike, u: ArrayLike, lam: ArrayLike, mu: ArrayLike
    ) -> Array:
        """d(H + mu.c)/dx, shape of x."""
        return self._evaluate_function_by_name("state_gradient", t, x, u, lam, mu)

    def parameter_gradient(
        self, t: ArrayLike, x: ArrayLike, u: ArrayLike, lam: ArrayLike, mu: ArrayLike
    ) -> Array:
        """d(H + mu.c)/dq, shape (n_free_parameters, ...)."""
        return self._evaluate_function_by_name("parameter_gradient", t, x, u, lam, mu)

    def control_hessian(
        self, t: ArrayLike, x: ArrayLike, u: ArrayLike, lam: ArrayLike, mu: ArrayLike
    ) -> Array:
        """d2(H + mu.c)/du2, shape (n_controls, n_controls, ...)."""
        flat = self._evaluate_function_by_name("control_hessian", t, x, u, lam, mu)
        m = np.shape(u)[0]
        return flat.reshape(m, m, *flat.shape[1:])

    @property
    def separable_controls(self) -> Mask:
        """Controls u_i with H = a u_i + b, b independent of u_i and a of all controls, and in no path constraint."""
        coupled = np.zeros(self.functions["switching"].size1_out(0), dtype=bool)
        for name in ("switching", "paths"):
            coupled[self.functions[name].jac_sparsity(0, 2).get_col()] = True
        return ~coupled

    @property
    def has_discontinuous_rates(self) -> bool:
        """Whether dx/dt contains a discontinuous operation."""
        function = self.functions["rates"]
        return any(function.instruction_id(i) in JUMPS for i in range(function.n_instructions()))

    @property
    def coupled_controls(self) -> list[Indices]:
        """Groups of non-separable controls that are coupled by H or a path constraint."""
        by_slope, by_path = (self.functions[name].jac_sparsity(0, 2) for name in ("switching", "paths"))
        rows, columns = np.array(by_slope.row(), dtype=int), np.array(by_slope.get_col(), dtype=int)
        constraints, controls = np.array(by_path.row(), dtype=int), np.array(by_path.get_col(), dtype=int)
        m = by_slope.size1()
        rows, columns = np.append(rows, m + constraints), np.append(columns, controls)
        size = m + by_path.size1()
        graph = scipy.sparse.csr_matrix((np.ones(rows.size), (rows, columns)), (size, size))
        labels = scipy.sparse.csgraph.connected_components(graph, directed=False)[1][:m]
        coupled = ~self.separable_controls
        return [np.flatnonzero(labels == label) for label in np.unique(labels[coupled])]

    def is_hamiltonian_quadratic_in(self, controls: Indices) -> bool:
        """Return whether H has constant second derivatives, and path constraints constant slopes, in some controls."""
        m = self.functions["switching"].size1_out(0)
        curved = self.functions["control_hessian"].jac_sparsity(0, 2).row()
        slopes = self.functions["path_control_jacobian"].jac_sparsity(0, 2).row()
        return not np.any(np.isin(np.array([*curved, *slopes], dtype=int) % m, controls))

    @property
    def mixed_path_constraints(self) -> Mask:
        """Path constraints that contain a control, even if its derivative vanishes somewhere (n_paths,)."""
        paths = self.functions["paths"]
        mixed = np.zeros(paths.size1_out(0), dtype=bool)
        mixed[paths.jac_sparsity(0, 2).row()] = True
        return mixed

    def state_jacobian(self, t: ArrayLike, x: ArrayLike, u: ArrayLike) -> Array:
        """df/dx, shape (n_states, n_states, ...)."""
        flat = self._evaluate_function_by_name("state_jacobian", t, x, u)
        n = np.shape(x)[0]
        return flat.reshape(n, n, *flat.shape[1:])

    def dynamics_control_jacobian(self, t: ArrayLike, x: ArrayLike, u: ArrayLike) -> Array:
        """df/du, shape (n_states, n_controls, ...)."""
        flat = self._evaluate_function_by_name("dynamics_control_jacobian", t, x, u)
        return flat.reshape(np.shape(x)[0], np.shape(u)[0], *flat.shape[1:])

    def path_control_jacobian(self, t: ArrayLike, x: ArrayLike, u: ArrayLike) -> Array:
        """dc/du, shape (n_paths, n_controls, ...)."""
        flat = self._evaluate_function_by_name("path_control_jacobian", t, x, u)
        m = np.shape(u)[0]
        return flat.reshape(self.functions["paths"].size1_out(0), m, *flat.shape[1:])

    def path_state_jacobian(self, t: ArrayLike, x: ArrayLike, u: ArrayLike) -> Array:
        """dc/dx, shape (n_paths, n_states, ...)."""
        flat = self._evaluate_function_by_name("path_state_jacobian", t, x, u)
        n = np.shape(x)[0]
        return flat.reshape(self.functions["paths"].size1_out(0), n, *flat.shape[1:])

    def path_gradients(self, t: ArrayLike, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array, Array]:
        """dc/dt (n_paths, ...), dc/dx (n_states, n_paths, ...) and dc/dq (n_free_parameters, n_paths, ...)."""
        flat, n = self._evaluate_function_by_name("path_gradients", t, x, u), np.shape(x)[0]
        size = 1 + n + self.q.size, self.functions["paths"].size1_out(0)
        gradients = flat.reshape(*size, *flat.shape[1:])
        return gradients[0], gradients[1 : n + 1], gradients[n + 1 :]

    def _evaluate_function_by_name(
        self, name: str, t: ArrayLike, x: ArrayLike, u: ArrayLike, *multipliers: ArrayLike
    ) -> Array:
        """Return the values (n_values, N) of one of ``functions``; multipliers that are not given are zero."""
        function = self.functions[name]
        zeros = [np.zeros(function.size1_in(i)) for i in range(3 + len(multipliers), 5)]
        arguments = *multipliers, *zeros, self.weights, self.p, self.q
        return evaluate_casadi_function(
            function, t, x, u, *arguments, programme=lambda: self._get_compiled_function(name)
        )

    def _get_compiled_function(self, name: str) -> VectorizedFunction | None:
        key = f"{name} by NumPy"
        if key not in self.functions:
            self.functions[key] = VectorizedFunction.from_casadi_function(self.functions[name])
        function: VectorizedFunction | None = self.functions[key]
        return function


def compile_phase_functions(
    problem: Problem, phase: str, p: Array, q: Array, weights: Array
) -> PhaseFunctions:
    """Return the functions of a phase for given parameter values and integral weights."""
    selected = problem.get_phase(phase)
    functions = problem.memoize(
        ("functions", phase), lambda: _build_hamiltonian_and_rate_functions(problem, selected)
    )
    return PhaseFunctions(functions, p, q, weights, problem.time_unit)


def _build_hamiltonian_and_rate_functions(problem: Problem, phase: Phase) -> dict[str, Any]:
    """Return the Functions of (t, x, u, lam, mu, weights, p, q) by name; matrices are stacked row by row."""
    t, x, u, p = phase.model.symbolic_arguments()
    q = problem.parameter_symbols()
    lam = ca.SX.sym("lam", x.shape[0])
    mu = ca.SX.sym("mu", len(phase.path_labels))
    weights = ca.SX.sym("weights", len(phase.integrands))
    f, c, integrands = (
        problem.substitute_parameters(phase, e)
        for e in (phase.model.state_derivative(), phase.path_expression(), phase.integrand_expression())
    )
    hamiltonian = ca.dot(lam, f) + ca.dot(weights, integrands)
    augmented = hamiltonian + ca.dot(mu, c)
    expressions = {
        "rates": f,
        "paths": c,
        "integrands": integrands,
        "stacked": ca.vertcat(f, c, integrands),
        "hamiltonian": hamiltonian,
        "switching": ca.gradient(hamiltonian, u),
        "control_gradient": ca.gradient(augmented, u),
        "state_gradient": ca.gradient(augmented, x),
        "parameter_gradient": ca.gradient(augmented, q),
        "control_hessian": ca.vec(ca.hessian(augmented, u)[0].T),
        "state_jacobian": ca.vec(ca.jacobian(f, x).T),
        "dynamics_control_jacobian": ca.vec(ca.jacobian(f, u).T),
        "path_control_jacobian": ca.vec(ca.jacobian(c, u).T),
        "path_state_jacobian": ca.vec(ca.jacobian(c, x).T),
        "path_gradients": ca.vec(ca.jacobian(c, ca.vertcat(t, x, q))),
    }
    arguments = [t, x, u, lam, mu, weights, p, q]
    return {
        name: ca.Function(name, arguments, [ca.densify(e)], list(_ARGUMENTS), [name])
        for name, e in expressions.items()
    }


@dataclass(frozen=True)
class EndGradients:
    r"""Gradients of :math:`\Phi + \nu^T \psi` (minimised cost and boundary constraints) at the end points.

    Attributes
    ----------
    initial_state, final_state : dict of array (n_states,)
        By phase.
    initial_time, final_time : dict of float
        By phase.
    integrals : dict of array (n_integrals,)
        By phase: the weights of the integrals in the Hamiltonian.
    parameters : array (n_free_parameters,)
    cost : float
        Value of the cost as stated by the user.
    constraints : array (n_constraints,)
        Values of the boundary constraints psi.
    """

    initial_state: dict[str, Array]
    final_state: dict[str, Array]
    initial_time: dict[str, float]
    final_time: dict[str, float]
    integrals: dict[str, Array]
    parameters: Array
    cost: float
    constraints: Array


def evaluate_endpoint_gradients(
    problem: Problem, ends: dict[str, list[Any]], q: Array, nu: Array
) -> EndGradients:
    """Return cost, boundary constraints and their gradients.

    Parameters
    ----------
    ends : mapping from phase to [x_initial, x_final, t_initial, t_final, integrals, model parameters]
    q : array (n_free_parameters,)
    nu : array (n_constraints,)
        Multipliers of the boundary constraints.
    """
    arguments = [value for phase in problem.phases for value in ends[phase]]
    outputs = [np.asarray(v.full()).ravel() for v in get_endpoint_function(problem)(*arguments, q, nu)]
    cost, constraints, gradients = outputs[0], outputs[1], outputs[2:]
    per_phase = {name: gradients[5 * k :] for k, name in enumerate(problem.phases)}
    return EndGradients(
        {name: g[0] for name, g in per_phase.items()},
        {name: g[1] for name, g in per_phase.items()},
        {name: float(g[2][0]) for name, g in per_phase.items()},
        {name: float(g[3][0]) for name, g in per_phase.items()},
        {name: g[4] for name, g in per_phase.items()},
        gradients[-1],
        float(cost[0]),
        constraints,
    )


def get_endpoint_function(problem: Problem) -> Any:
    """Return the CasADi Function of `evaluate_endpoint_gradients`.

    Its inputs are the six of ``ends`` per phase, q and nu. Its outputs are the cost as stated, the boundary
    constraints, and the gradients of their Lagrangian in the order of `EndGradients`.
    """
    return problem.memoize("ends", lambda: _build_endpoint_function(problem))


def _build_endpoint_function(problem: Problem) -> Any:
    cost, constraints = (
        substitute_parameters(problem, e) for e in (problem.cost, problem.constraint_expression())
    )
    nu = ca.SX.sym("nu", constraints.shape[0])
    lagrangian = problem.sense * cost + ca.dot(nu, constraints)
    ends = [symbol for phase in problem.phases.values() for symbol in list_endpoint_symbols(phase)]
    gradients = [ca.densify(ca.gradient(lagrangian, s)) for s in (*ends, problem.parameter_symbols())]
    return ca.Function(
        "ends", [*list_endpoint_arguments(problem), nu], [cost, ca.densify(constraints), *gradients]
    )


def get_endpoint_value_function(problem: Problem) -> Any:
    """Return the CasADi Function of boundary constraints and cost, in a column; inputs: `get_endpoint_function`."""

    def build_endpoint_value_function() -> Any:
        ends = get_endpoint_function(problem)
        arguments = [ca.SX.sym(ends.name_in(i), ends.size1_in(i)) for i in range(ends.n_in())]
        cost, constraints, *_ = ends(*arguments)
        return ca.Function("end_values", arguments, [ca.densify(ca.vertcat(constraints, cost))])

    return problem.memoize("end values", build_endpoint_value_function)


def compile_expression(problem: Problem, phase: str, expression: Any) -> Callable[..., Array]:
    """Return ``g(t, x, u, p, q)`` for an expression in the phase's symbols, or for an output given by name."""
    selected = problem.get_phase(phase)
    if isinstance(expression, str):
        expression = selected.model.output_expression(expression)
    value = convert_to_sx_column(expression, "the expression to evaluate", None, ProblemError)
    value = (
        value
        if selected.control_map is None
        else selected.control_map.express_by_reformulated_controls(value)
    )
    problem.check_foreign_symbols(selected, value, "the expression to evaluate")
    function = build_function_along_phase(problem, selected, "evaluate", value)
    return lambda *arguments: evaluate_casadi_function(function, *arguments)
