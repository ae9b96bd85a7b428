"""Phases of a solution from functions of time: what a solver would return, without one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.planning import PhaseSolution, Solution, Status
from testing.internals import (
    Interval,
    PhaseFunctions,
    PhaseSamples,
    PiecewisePolynomial,
    Scheme,
    Statistics,
    compile_phase_functions,
    get_collocation_rule,
    interpolate_point_values,
    unbounded_interval,
)
from testing.models import one_phase

fake: Any = SimpleNamespace
"""Objects with the attributes that a formula reads."""

Signal = Callable[[Array, int], Any]
"""Rows at times (m,) of a segment."""


def interval(lower: Any, upper: Any) -> Interval:
    return Interval(np.atleast_1d(np.asarray(lower, float)), np.atleast_1d(np.asarray(upper, float)))


def cart() -> go.Problem:
    """q' = v, v' = a / m, half the integral of a^2, and a path constraint on each of v + a and q."""
    model = go.Model("cart")
    q, v = model.state("q", unit="m"), model.state("v", unit="m/s")
    a, m = model.control("a", unit="N"), model.parameter("m", 1.0)
    model.ode({q: v, v: a / m})
    problem, leg = one_phase("cart", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.path("mixed", v + a, upper=100.0)
    leg.path("pure", q, lower=-50.0)
    problem.minimize(0.5 * leg.integral(a**2))
    return problem


def functions(problem: go.Problem, weights: Any = (0.5,)) -> PhaseFunctions:
    leg = problem.get_phase()
    return compile_phase_functions(
        problem, leg.name, leg.model.parameter_values, np.zeros(0), np.asarray(weights, float)
    )


def rest(t: Array, k: int) -> Array:
    return np.array([3 * t**2 - 2 * t**3, 6 * t - 6 * t**2])


def push(t: Array, k: int) -> Array:
    return np.array([6 - 12 * t])


def costates(t: Array, k: int) -> Array:
    """Of `rest` and `push`: lam_v = -a, lam_q' = 0."""
    return np.array([-12 + 0 * t, -6 + 12 * t])


def phase(
    problem: go.Problem,
    x: Signal = rest,
    u: Signal = push,
    lam: Signal = costates,
    *,
    breaks: Any = (0.0, 0.5, 1.0),
    degree: int = 4,
    scheme: Scheme = "LG",
    paths: Signal | None = None,
    states: Signal | None = None,
    **changes: Any,
) -> PhaseSolution:
    """Polynomials through signals; bounds are those of the problem, or free."""
    leg, model = problem.get_phase(), problem.get_phase().model
    edges = np.asarray(breaks, dtype=float)
    rule = get_collocation_rule(scheme, degree)
    n, m, segments = model.states.size, model.controls.size, edges.size - 1

    def times(k: int, tau: Array) -> Array:
        return np.asarray(edges[k] + 0.5 * (edges[k + 1] - edges[k]) * (1 + tau))

    def pieces(signal: Signal, tau: Array) -> tuple[Array, ...]:
        return tuple(
            np.asarray(signal(times(k, tau), k), float).reshape(-1, tau.size) for k in range(segments)
        )

    def densities(signal: Signal | None, rows: int) -> Array:
        if signal is None:
            return np.zeros((rows, segments * degree))
        return np.hstack(pieces(signal, rule.points))

    rules = (rule,) * segments
    ends = np.append(rule.points, 1.0) if scheme in ("LG", "LGR") else rule.points
    points = np.hstack(pieces(lam, rule.points))
    lam_ends = [pieces(lam, np.array([tau])) for tau in (-1.0, 1.0)]
    values = {
        "name": leg.name,
        "scheme": scheme,
        "mesh": go.Mesh.at_times(edges, degree),
        "initial_time": float(edges[0]),
        "final_time": float(edges[-1]),
        "states": model.states,
        "controls": model.controls,
        "model_parameters": model.parameters,
        "path_labels": leg.path_labels,
        "integral_labels": tuple(leg.integrands),
        "x": PiecewisePolynomial(edges, (rule.state_nodes,) * segments, pieces(x, rule.state_nodes)),
        "u": interpolate_point_values(edges, rules, np.hstack(pieces(u, rule.points))),
        "lam": PiecewisePolynomial(edges, (ends,) * segments, pieces(lam, ends)),
        "lam_start": np.hstack(lam_ends[0]),
        "lam_end": np.hstack(lam_ends[1]),
        "point_costates": points,
        "path_multipliers": densities(paths, len(leg.path_labels)),
        "state_multipliers": densities(states, n),
        "control_multipliers": np.zeros((m, segments * degree)),
        "state_impulses": np.zeros((n, segments + 1)),
        "time_multipliers": np.zeros(2),
        "duration_multiplier": 0.0,
        "integrals": np.zeros(len(leg.integrands)),
        "integral_weights": np.ones(len(leg.integrands)),
        "parameters": model.parameter_values,
        "state_bounds": unbounded_interval(n),
        "control_bounds": unbounded_interval(m),
        "path_bounds": leg.get_path_bounds(),
        "initial_bounds": unbounded_interval(n),
        "final_bounds": unbounded_interval(n),
        "initial_time_bounds": interval(edges[0], edges[0]),
        "final_time_bounds": interval(edges[-1], edges[-1]),
        "duration_bounds": interval(-np.inf, np.inf),
    }
    return PhaseSolution(**(values | changes))


def samples(problem: go.Problem, *arguments: Any, weights: Any = (0.5,), **changes: Any) -> PhaseSamples:
    return PhaseSamples.from_phase(phase(problem, *arguments, **changes), functions(problem, weights))


def solution(problem: go.Problem, *legs: PhaseSolution, **changes: Any) -> Solution:
    values = {
        "problem_name": problem.name,
        "status": Status.OPTIMAL,
        "objective": 6.0,
        "maximised": False,
        "phases": {leg.name: leg for leg in legs},
        "free_parameters": problem.parameters,
        "parameter_values": np.zeros(problem.parameters.size),
        "parameter_multipliers": np.zeros(problem.parameters.size),
        "constraint_labels": (),
        "constraint_values": np.zeros(0),
        "constraint_multipliers": np.zeros(0),
        "violations": (),
        "statistics": Statistics(5, 0.1, 0.2, 0.1, 0.1),
        "provenance": {"fingerprint": problem.fingerprint(), "gnc_opt": "0"},
        "problem": problem.frozen(),
    }
    return replace(Solution(**values), **changes)  # type: ignore[arg-type]
