"""Sampling times that resolve narrow features at constants of a problem's expressions.

A gust, price or window of width w is a function of (t - t_c) / w or (x - x_c) / w. Samples at log-uniform distances
from the zero of the difference resolve it for any w; equidistant samples do not.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gnc_opt.array_types import Array, Indices
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch
from gnc_opt.numerical_tolerances import EQUAL, NOTABLE
from gnc_opt.planning.problem.kink_detection import build_threshold_crossing_function
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples

MAX_CENTRES = 20
"""Largest number of feature centres per phase."""

N_DISTANCES = 40
"""Number of distances of cells from a centre, from `EQUAL` to `NOTABLE` of the phase."""


def find_zero_times(function: Callable[[Array], Array], rows: Indices, left: Array, right: Array) -> Array:
    """Return times (n,) at which rows of a function (n_rows, n_times) change sign, or the midpoints."""
    from scipy.optimize.elementwise import find_root  # loads scipy.optimize

    def evaluate_selected_function_rows(times: Array, row: Array) -> Array:
        return np.asarray(function(times)[row.astype(int), np.arange(times.size)])

    roots = find_root(evaluate_selected_function_rows, (left, right), args=(rows,))
    return np.where(roots.success, roots.x, 0.5 * (left + right))


def choose_cell_edges_at_narrow_features(problem: Problem, s: PhaseSamples) -> Array:
    """Return the edges of cells (n,) that resolve features at the constants of a phase's expressions."""
    threshold_function = build_threshold_crossing_function(problem, problem.phases[s.phase.name])
    if threshold_function is None or not s.has_duration:
        return np.zeros(0)

    def evaluate_threshold_distances(times: Array) -> Array:
        numbers = s.functions.p, s.functions.q
        x, u = s.phase.x(times), s.phase.applied(times)
        return np.asarray(evaluate_casadi_batch(threshold_function, times.size, times[None], x, u, *numbers))

    times = s.times[np.append(True, np.diff(s.times) > 0)]
    signs = np.sign(evaluate_threshold_distances(times))
    rows, intervals = np.nonzero(np.abs(np.diff(signs)) == 2)
    zeros = times[np.nonzero(signs == 0)[1]]
    rows, intervals = rows[:MAX_CENTRES], intervals[:MAX_CENTRES]
    crossings = find_zero_times(evaluate_threshold_distances, rows, times[intervals], times[intervals + 1])
    centre_times = np.concatenate([crossings, zeros[:MAX_CENTRES]])[:MAX_CENTRES]
    distances = s.span * np.geomspace(EQUAL, NOTABLE, N_DISTANCES)
    edges = np.unique(centre_times[:, None] + np.concatenate([-distances, [0.0], distances]))
    return np.asarray(edges[(edges > s.phase.breaks[0]) & (edges < s.phase.breaks[-1])])
