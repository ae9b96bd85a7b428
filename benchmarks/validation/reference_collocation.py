r"""Reference values of objectives by plain Radau collocation on uniform meshes, in CasADi and IPOPT alone.

    python -m benchmarks.validation.reference_collocation NAME [--mesh 50x4 100x4 200x4] [--variant NAME]

The program takes the expressions, bounds and the guess of a stated problem and nothing else of gnc_opt: transcription,
quadrature, scaling and the sequence of meshes are its own. On each segment of length h the states are polynomials of
degree K through the end of the segment before and K Radau points,

.. math::
   \sum_{j=0}^{K} D_{ij} x_j = h f(t_i, x_i, u_i, p), \qquad \int L \, dt = h \sum_i b_i L_i,

with controls and path constraints at the K points. Each mesh starts from the trajectory of the one before. An error in
the statement itself is not found; the 26 problems of the group "flagship" were stated a second time for that.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

import gnc_opt as go
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.guess.initial_guess import build_phase_guess
from gnc_opt.problem_files_and_examples import find_example

Array = NDArray[np.float64]

MESHES = ("50x4", "100x4", "200x4")
TOLERANCE, MAX_ITERATIONS, CPU_LIMIT_S = 1e-11, 2000, 300.0
"""Of IPOPT. The barrier raises the relative objective by about the tolerance times the number of active limits."""
ACCEPTABLE_TOLERANCE = 1e-9
"""With this an answer that makes no more progress counts as solved."""


@dataclass(frozen=True)
class Trajectory:
    """A phase on its mesh: times (n,) of states (n_states, n), times (m,) of controls (n_controls, m)."""

    times: Array
    states: Array
    control_times: Array
    controls: Array


@dataclass(frozen=True)
class Collocated:
    """The answer on one mesh."""

    objective: float
    solved: bool
    status: str
    iterations: int
    cpu_s: float
    phases: dict[str, Trajectory]
    parameters: Array


class Program:
    """A nonlinear program that grows by matrices of variables and constraints; every row has a scale."""

    def __init__(self) -> None:
        self.variables: list[Any] = []
        self.constraints: list[Any] = []
        self.numbers: dict[str, list[Array]] = {name: [] for name in ("lbx", "ubx", "x0", "lbg", "ubg")}

    def _add(self, scale: Array, **numbers: Array) -> None:
        for name, values in numbers.items():
            self.numbers[name].append((values / scale[:, None]).ravel("F"))

    def variable(self, lower: Array, upper: Array, guess: Array, scale: Array) -> Any:
        """Add variables (rows, columns) and return their values in the units of the problem."""
        symbol = ca.MX.sym("v", *guess.shape)
        self.variables.append(ca.vec(symbol))
        self._add(scale, lbx=lower, ubx=upper, x0=np.clip(guess, lower, upper))
        return ca.repmat(ca.DM(scale), 1, guess.shape[1]) * symbol

    def constrain(self, expression: Any, limits: Any, scale: Array | None = None) -> None:
        """Add constraints with the same limits in every column."""
        columns = expression.shape[1]
        lower, upper = repeated(limits, columns)
        scale = typical(limits, np.zeros(lower.shape)) if scale is None else scale
        self.constraints.append(ca.vec(expression / ca.repmat(ca.DM(scale), 1, columns)))
        self._add(scale, lbg=lower, ubg=upper)

    def solve(self, cost: Any) -> tuple[Any, dict[str, Any]]:
        """Return the vector of variables and IPOPT's statistics."""
        options = {
            "ipopt.max_iter": MAX_ITERATIONS,
            "ipopt.tol": TOLERANCE,
            "ipopt.acceptable_tol": ACCEPTABLE_TOLERANCE,
            "ipopt.max_cpu_time": CPU_LIMIT_S,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "print_time": False,
            "error_on_fail": False,
        }
        program = {"x": ca.vertcat(*self.variables), "f": cost, "g": ca.vertcat(*self.constraints)}
        solver = ca.nlpsol("solver", "ipopt", program, options)
        found = solver(**{name: np.concatenate(values) for name, values in self.numbers.items()})
        return found["x"], solver.stats()


def radau(degree: int) -> tuple[Array, Array, Array]:
    """Return points (K,), differentiation matrix (K, K + 1) with the point 0 before them, and weights (K,)."""
    points = np.array(ca.collocation_points(degree, "radau"))
    nodes = np.r_[0.0, points]
    slopes = np.zeros((degree, degree + 1))
    for j, node in enumerate(nodes):
        others = np.delete(nodes, j)
        basis = np.poly1d(others, r=True) / np.prod(node - others)
        slopes[:, j] = basis.deriv()(points)
    moments = np.vander(points, degree, increasing=True).T
    return points, slopes, np.linalg.solve(moments, 1.0 / np.arange(1, degree + 1))


def typical(limits: Any, values: Array) -> Array:
    """Return the scale of rows from their guess (n, N) and, where that is zero, their bounds."""
    largest = np.max(np.abs(values), axis=1, initial=0.0)
    ends = np.stack([np.abs(limits.lower), np.abs(limits.upper)])
    bound = np.max(np.where(np.isfinite(ends), ends, 0.0), axis=0)
    scale = np.where(largest > 0, largest, bound)
    return np.asarray(np.where(scale > 0, scale, 1.0))


def repeated(limits: Any, columns: int) -> tuple[Array, ...]:
    """Return lower and upper limits (rows, columns) of rows."""
    return tuple(np.repeat(each[:, None], columns, axis=1) for each in (limits.lower, limits.upper))


def collocate(
    problem: go.Problem, segments: int, degree: int, before: Collocated | None = None
) -> Collocated:
    """Solve a problem on a uniform mesh in each phase, from its guess or from the answer on another mesh."""
    begin, program = time.process_time(), Program()
    points, slopes, weights = radau(degree)
    fractions = np.r_[0.0, (np.arange(segments)[:, None] + points).ravel() / segments]
    n = fractions.size - 1
    differences = np.zeros((n + 1, n))
    for k in range(0, n, degree):
        differences[k : k + degree + 1, k : k + degree] = slopes.T
    limits = problem.get_parameter_bounds()
    guess = (problem.get_parameter_guess() if before is None else before.parameters)[:, None]
    parameters = program.variable(*repeated(limits, 1), guess, typical(limits, guess))
    ends, found = [], []
    for name, leg in problem.phases.items():
        times, states, controls = _guess(leg, fractions, None if before is None else before.phases[name])
        clock = np.array([max(*np.abs(times), 1e-9)])
        t_0, t_f = (
            program.variable(*repeated(limits, 1), np.array([[value]]), clock)
            for limits, value in zip(leg.time_ranges(), times, strict=True)
        )
        program.constrain(t_f - t_0, leg.numbers.duration, clock)
        box, scale = leg.numbers.states, typical(leg.numbers.states, states)
        lower, upper = repeated(box, n + 1)
        for k, end in ((0, leg.numbers.initial), (-1, leg.numbers.final)):
            lower[:, k], upper[:, k] = np.maximum(lower[:, k], end.lower), np.minimum(upper[:, k], end.upper)
        x = program.variable(lower, upper, states, scale)
        box = leg.numbers.controls
        u = program.variable(*repeated(box, n), controls[:, 1:], typical(box, controls))
        t = t_0 + ca.DM(fractions).T * (t_f - t_0)
        rates, path, integrands = _along(problem, leg, n)(t[1:], x[:, 1:], u, parameters)
        defects = x @ ca.sparsify(ca.DM(differences)) - (t_f - t_0) / segments * rates
        program.constrain(defects, Interval(0 * scale, 0 * scale), scale)
        program.constrain(path, leg.get_path_bounds())
        integrals = (t_f - t_0) / segments * integrands @ np.tile(weights, segments)
        ends += [x[:, 0], x[:, -1], t_0, t_f, integrals]
        found += [t, x, t[1:], u]
    cost, constraints = _ends(problem)(*ends, parameters)
    program.constrain(constraints, problem.get_boundary_constraint_bounds())
    size = abs(before.objective) if before is not None and before.objective else 1.0
    values, statistics = program.solve(problem.sense * cost / size)
    symbols = ca.vertcat(*program.variables)
    outputs = ca.Function("answer", [symbols], [cost, parameters, *found])(values)
    objective, parameter_values, *arrays = (np.asarray(each.full()) for each in outputs)
    return Collocated(
        float(objective[0, 0]),
        bool(statistics["success"]),
        str(statistics["return_status"]),
        int(statistics["iter_count"]),
        time.process_time() - begin,
        {
            name: Trajectory(t.ravel(), x, t_u.ravel(), u)
            for name, t, x, t_u, u in zip(problem.phases, *(arrays[k::4] for k in range(4)), strict=True)
        },
        parameter_values.ravel(),
    )


def _guess(leg: Any, fractions: Array, before: Trajectory | None) -> tuple[Array, Array, Array]:
    """Return times (2,), states and controls at fractions of a phase."""
    if before is None:
        start = build_phase_guess(leg, fractions, perturbed=False)
        return start.times, start.states, start.controls
    at = before.times[0] + fractions * (before.times[-1] - before.times[0])

    def along(times: Array, rows: Array) -> Array:
        return np.array([np.interp(at, times, row) for row in rows]).reshape(rows.shape[0], at.size)

    ends = before.times[[0, -1]]
    return ends, along(before.times, before.states), along(before.control_times, before.controls)


def _along(problem: go.Problem, leg: Any, n: int) -> Callable[..., Any]:
    """Return rates, path constraints and integrands at n points of a phase as a function of (t, x, u, p)."""
    expressions = [
        ca.densify(problem.substitute_parameters(leg, each))
        for each in (leg.model.state_derivative(), leg.path_expression(), leg.integrand_expression())
    ]
    t, x, u, constants = leg.model.symbolic_arguments()
    function = ca.Function("rates", [t, x, u, constants, problem.parameter_symbols()], expressions).map(n)
    values = leg.model.parameter_values
    return lambda t, x, u, p: function(t, x, u, ca.repmat(values, 1, n), ca.repmat(p, 1, n))


def _ends(problem: go.Problem) -> Any:
    """Return cost and boundary constraints as a function of the ends and integrals of all phases and of p."""
    symbols: list[Any] = []
    cost, constraints = problem.cost, problem.constraint_expression()
    for leg in problem.phases.values():
        cost, constraints = (problem.substitute_parameters(leg, each) for each in (cost, constraints))
        symbols += [leg.end_states("initial"), leg.end_states("final"), leg.initial_time, leg.final_time]
        symbols.append(leg.integral_symbols())
    expressions = [ca.densify(cost), ca.densify(constraints)]
    return ca.Function("ends", [*symbols, problem.parameter_symbols()], expressions)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the objective on each mesh; return 1 if the last one is not solved."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("name", metavar="NAME", help="problem file")
    parser.add_argument("--variant", default="", metavar="NAME", help="other data that the file names")
    parser.add_argument("--mesh", nargs="+", default=MESHES, metavar="SEGMENTSxDEGREE")
    given = parser.parse_args(arguments)
    module = find_example(given.name).module
    options, reference = module.VARIANTS[given.variant] if given.variant else ({}, module.REFERENCE)
    problem, found = module.build(**options), None
    for mesh in given.mesh:
        segments, degree = map(int, mesh.split("x"))
        found = collocate(problem, segments, degree, found if found is not None and found.solved else None)
        print(
            f"{given.name} {mesh:>7}: {found.objective:.12g} {found.status}, {found.iterations} iterations, "
            f"{found.cpu_s:.1f} s; difference from the reference {reference.difference(found.objective):+.2e}",
            flush=True,
        )
    return int(found is None or not found.solved)


if __name__ == "__main__":
    raise SystemExit(main())
