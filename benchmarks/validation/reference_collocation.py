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
    """A nonlinear program that grows variable by variable; every variable has a scale."""

    def __init__(self) -> None:
        self.variables: list[Any] = []
        self.constraints: list[Any] = []
        self.bounds: list[list[Array]] = [[], [], [], [], []]

    def variable(self, name: str, lower: Array, upper: Array, guess: Array, scale: Array) -> Any:
        """Add variables and return their values in the units of the problem."""
        symbol = ca.SX.sym(name, lower.size)
        self.variables.append(symbol)
        for kept, values in zip(self.bounds[:3], (lower, upper, np.clip(guess, lower, upper)), strict=True):
            kept.append(values / scale)
        return symbol * ca.DM(scale)

    def constrain(self, expression: Any, lower: Array, upper: Array, scale: Array) -> None:
        """Add constraints."""
        self.constraints.append(expression / ca.DM(scale))
        self.bounds[3].append(lower / scale)
        self.bounds[4].append(upper / scale)

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
        lower, upper, guess, least, most = (np.concatenate(values) for values in self.bounds)
        found = solver(x0=guess, lbx=lower, ubx=upper, lbg=least, ubg=most)
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


def typical(lower: Array, upper: Array, values: Array) -> Array:
    """Return the scale of variables from their guess (n, N) and, where that is zero, their bounds."""
    largest = np.max(np.abs(values), axis=1, initial=0.0)
    ends = np.stack([np.abs(lower), np.abs(upper)])
    bound = np.max(np.where(np.isfinite(ends), ends, 0.0), axis=0)
    scale = np.where(largest > 0, largest, bound)
    return np.asarray(np.where(scale > 0, scale, 1.0))


def collocate(
    problem: go.Problem, segments: int, degree: int, before: Collocated | None = None
) -> Collocated:
    """Solve a problem on a uniform mesh in each phase, from its guess or from the answer on another mesh."""
    begin, program = time.process_time(), Program()
    points, slopes, weights = radau(degree)
    fractions = (np.arange(segments)[:, None] + points).ravel() / segments
    parameters = _parameters(program, problem, before)
    ends, found = [], []
    for name, leg in problem.phases.items():
        (first, last), states, controls = _guess(
            leg, np.r_[0.0, fractions], None if before is None else before.phases[name]
        )
        numbers, (starts, stops) = leg.numbers, leg.time_ranges()
        clock = np.array([max(abs(first), abs(last), 1e-9)])
        t_0 = program.variable("t_0", starts.lower, starts.upper, np.array([first]), clock)
        t_f = program.variable("t_f", stops.lower, stops.upper, np.array([last]), clock)
        program.constrain(t_f - t_0, numbers.duration.lower, numbers.duration.upper, clock)
        x_scale = typical(numbers.states.lower, numbers.states.upper, states)
        u_scale = typical(numbers.controls.lower, numbers.controls.upper, controls)
        path_limits = leg.get_path_bounds()
        path_scale = typical(path_limits.lower, path_limits.upper, np.zeros((path_limits.lower.size, 1)))
        rates = _rates(problem, leg)
        x = program.variable(
            "x",
            np.maximum(numbers.states.lower, numbers.initial.lower),
            np.minimum(numbers.states.upper, numbers.initial.upper),
            states[:, 0],
            x_scale,
        )
        x_0, integrals = x, 0
        xs, us, times = [x], [], [t_0]
        step = (t_f - t_0) / segments
        for i in range(segments):
            inner = [xs[-1]]
            for j in range(degree):
                k = i * degree + j
                at_end = k == fractions.size - 1
                lower, upper = numbers.states.lower, numbers.states.upper
                if at_end:
                    lower, upper = (
                        np.maximum(lower, numbers.final.lower),
                        np.minimum(upper, numbers.final.upper),
                    )
                inner.append(program.variable("x", lower, upper, states[:, k + 1], x_scale))
            matrix = ca.horzcat(*inner)
            for j in range(degree):
                k = i * degree + j
                limits = numbers.controls
                u = program.variable("u", limits.lower, limits.upper, controls[:, k + 1], u_scale)
                t = t_0 + fractions[k] * (t_f - t_0)
                rate, path, integrand = rates(t, inner[j + 1], u, parameters)
                defect, zero = matrix @ ca.DM(slopes[j]) - step * rate, np.zeros(x_scale.size)
                program.constrain(defect, zero, zero, x_scale)
                program.constrain(path, path_limits.lower, path_limits.upper, path_scale)
                integrals = integrals + step * weights[j] * integrand
                xs.append(inner[j + 1])
                us.append(u)
                times.append(t)
        ends.append((x_0, xs[-1], t_0, t_f, integrals))
        found += [ca.vertcat(*times), ca.horzcat(*xs), ca.vertcat(*times[1:]), ca.horzcat(*us)]
    cost, constraints = _ends(problem, ends, parameters)
    limits = problem.get_boundary_constraint_bounds()
    program.constrain(
        constraints,
        limits.lower,
        limits.upper,
        typical(limits.lower, limits.upper, np.zeros((limits.lower.size, 1))),
    )
    size = abs(before.objective) if before is not None and before.objective else 1.0
    values, statistics = program.solve(problem.sense * cost / size)
    symbols = ca.vertcat(*program.variables)
    evaluated = ca.Function("answer", [symbols], [cost, parameters, *found])(values)
    arrays = [np.asarray(each.full()) for each in evaluated[2:]]
    phases = {
        name: Trajectory(
            arrays[4 * k].ravel(), arrays[4 * k + 1], arrays[4 * k + 2].ravel(), arrays[4 * k + 3]
        )
        for k, name in enumerate(problem.phases)
    }
    return Collocated(
        float(evaluated[0]),
        bool(statistics["success"]),
        str(statistics["return_status"]),
        int(statistics["iter_count"]),
        time.process_time() - begin,
        phases,
        np.asarray(evaluated[1].full()).ravel(),
    )


def _parameters(program: Program, problem: go.Problem, before: Collocated | None) -> Any:
    limits = problem.get_parameter_bounds()
    if limits.lower.size == 0:
        return ca.SX(0, 1)
    guess = np.concatenate(list(problem.parameter_guess.values())) if before is None else before.parameters
    return program.variable(
        "p", limits.lower, limits.upper, guess, typical(limits.lower, limits.upper, guess[:, None])
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


def _rates(problem: go.Problem, leg: Any) -> Callable[..., Any]:
    """Return rates, path constraints and integrands of a phase as a function of (t, x, u, p)."""
    model = leg.model
    t, x, u, constants = model.arguments()
    free = problem.parameter_symbols()
    expressions = [
        ca.densify(problem.substitute_parameters(leg, each))
        for each in (model.derivative(), leg.path_expression(), leg.integrand_expression())
    ]
    function = ca.Function("rates", [t, x, u, constants, free], expressions)
    values = model.parameter_values
    return lambda t, x, u, p: function(t, x, u, values, p)


def _ends(problem: go.Problem, ends: list[Any], parameters: Any) -> tuple[Any, Any]:
    """Return cost and boundary constraints for given ends of all phases."""
    symbols: list[Any] = []
    values: list[Any] = []
    cost, constraints = problem.cost, problem.constraint_expression()
    for leg, (x_0, x_f, t_0, t_f, integrals) in zip(problem.phases.values(), ends, strict=True):
        cost, constraints = (
            problem.substitute_parameters(leg, cost),
            problem.substitute_parameters(leg, constraints),
        )
        symbols += [leg.end_states("initial"), leg.end_states("final"), leg.initial_time, leg.final_time]
        values += [x_0, x_f, t_0, t_f]
        symbols.append(leg.integral_symbols())
        values.append(ca.vertcat(integrals) if leg.integrands else ca.SX(0, 1))
    function = ca.Function(
        "ends", [*symbols, problem.parameter_symbols()], [ca.densify(cost), ca.densify(constraints)]
    )
    found: tuple[Any, Any] = function(*values, parameters)
    return found


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
