"""The parts of the condition "second order", whatever the first order says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import gnc_opt as go
from testing.internals import (
    CONDITION_TOLERANCE,
    EndPoints,
    SampledPhase,
    _build_sampled_solution,
    check_second_order_conditions,
    get_endpoint_gradients,
    recompute_stored_data,
)

Array = NDArray[np.float64]


def second_order_of(solution: go.Solution, tol: float = CONDITION_TOLERANCE) -> dict[str, go.Condition]:
    """The second variation, Legendre-Clebsch, singular arcs and generalised Legendre-Clebsch by name."""
    solution = recompute_stored_data(solution)
    samples = list(solution.samples().values())
    magnitude = EndPoints.from_solution(solution, samples).compute_endpoint_changes()[-1]
    samples = [s.with_cost_scale(magnitude, s.feature_edges) for s in samples]
    return {
        c.name: c
        for c in check_second_order_conditions(solution, samples, get_endpoint_gradients(solution), tol)
    }


def of_samples(problem: go.Problem, t: Array, x: Array, u: Array) -> go.Solution:
    """The solution of a problem with one phase whose costates explain samples (n_times,), (n, n_times) best."""
    return _build_sampled_solution(problem, {next(iter(problem.phases)): SampledPhase(t, x, u)}, np.zeros(0))
