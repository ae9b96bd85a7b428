"""Independent integration of the dynamics under a solution's control."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.polynomial import chebyshev

from gnc_opt.arrays import Array, Indices
from gnc_opt.model.integration import Budget, Controls, EndedError, Tolerance, integrate
from gnc_opt.planning.problem.functions import PhaseFunctions
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.tolerances import nonzero_magnitude

RELATIVE_TOLERANCE = 1e-11
"""Of integrations that check a solution."""


@dataclass(frozen=True)
class Propagation:
    """States that follow from the initial state and the control alone.

    Attributes
    ----------
    times : array (n_times,)
    states : array (n_states, n_times)
        NaN after the propagation ended.
    error : array (n_states,)
        Final state minus the solution's final state; infinite if the propagation ended early.
    ended : str
        Why and where it ended early, e.g. ``"the rate of state 'h' is nan at t = 2.5 s"``; else empty.
    """

    times: Array
    states: Array
    error: Array
    ended: str = ""


def integrate_dynamics(
    leg: PhaseSolution,
    functions: PhaseFunctions,
    *,
    control: Literal["flown", "polynomial"] = "flown",
    rtol: float = RELATIVE_TOLERANCE,
) -> Propagation:
    """Integrate the dynamics over a phase by DOP853, restarting at every discontinuity of the control.

    Parameters
    ----------
    functions : PhaseFunctions
        Of the same phase.
    control : {"flown", "polynomial"}
        The applied control within its bounds, or the unmodified collocation polynomial.
    rtol : float
        Relative tolerance; the absolute one is ``rtol`` times each state's magnitude.
    """
    signal, edges = (leg.applied, leg.applied.jump_times) if control == "flown" else (leg.u, leg.breaks)
    states, ended = _integrate_pieces(leg, functions, edges, signal, rtol)
    error = states[:, -1] - leg.x(leg.breaks[-1], "left")
    return Propagation(edges, states, np.where(np.isfinite(error), error, np.inf), ended)


def integrate_to_times(leg: PhaseSolution, functions: PhaseFunctions, times: Array) -> Array:
    """Return the states (n_states, n_times) to which the applied control leads from the start of a phase.

    Times do not decrease; NaN from where the trajectory ends early.
    """
    edges = np.union1d(leg.applied.jump_times, times)
    states, _ = _integrate_pieces(leg, functions, edges, leg.applied)
    return np.asarray(states[:, np.searchsorted(edges, times)])


def compute_segment_errors(leg: PhaseSolution, functions: PhaseFunctions, segments: Indices) -> Array:
    """Return by how much segments miss the end to which the applied control leads from their start (n_states, n).

    Infinite where there is no such trajectory.
    """
    misses, jumps = np.empty((leg.states.size, segments.size)), leg.applied.jump_times
    for column, k in enumerate(segments):
        left, right = leg.breaks[k : k + 2]
        edges = np.array([left, *jumps[(jumps > left) & (jumps < right)], right])
        states, _ = _integrate_pieces(leg, functions, edges, leg.applied)
        misses[:, column] = leg.x(right, "left") - states[:, -1]
    return np.where(np.isfinite(misses), misses, np.inf)


def _integrate_pieces(
    leg: PhaseSolution,
    functions: PhaseFunctions,
    edges: Array,
    signal: Callable[..., Array],
    rtol: float = RELATIVE_TOLERANCE,
) -> tuple[Array, str]:
    """Return the states at the edges of pieces on which the control is smooth, and why the integration ended early.

    It starts from the trajectory's state at the first edge; states (n_states, n_edges) are NaN after it ended.
    """
    tolerance, budget = Tolerance(rtol, compute_state_magnitudes(leg)), Budget(leg.states.labels)
    states = np.full((leg.states.size, edges.size), np.nan)
    states[:, 0] = leg.x(edges[0])
    for k, (left, right) in enumerate(itertools.pairwise(edges)):
        controls = _interpolate_controls(signal, left, right, _find_largest_degree(leg, left, right))
        rate = _build_controlled_rates(functions, controls)
        try:
            run = integrate(rate, states[:, k], (left, right), tolerance=tolerance, budget=budget)
        except EndedError as why:
            return states, str(why)
        states[:, k + 1] = run.states[:, -1]
    return states, ""


def _build_controlled_rates(functions: PhaseFunctions, controls: Controls) -> Callable[[float, Array], Array]:
    """Return dx/dt (n,) as a function of time and state under some controls."""
    rates = functions.fast_rates()
    return lambda t, x: rates(t, x, controls(np.array([t]))[:, 0])


def compute_state_magnitudes(leg: PhaseSolution) -> Array:
    """Return the largest magnitude of each state along the phase (n,), shared by the components of a vector."""
    largest = np.max(np.abs(leg.x(leg.sample_times())), axis=1)
    for variable in leg.states.variables:
        rows = leg.states.slice(variable.name)
        largest[rows] = np.max(largest[rows])
    return nonzero_magnitude(largest)


def _find_largest_degree(leg: PhaseSolution, left: float, right: float) -> int:
    """The largest number of points of the segments that a time span has a part in: more than their controls' degree."""
    inside = (leg.breaks[:-1] < right) & (leg.breaks[1:] > left)
    return int(np.max(np.asarray(leg.mesh.degrees)[inside], initial=1))


def _interpolate_controls(signal: Callable[..., Array], left: float, right: float, degree: int) -> Controls:
    """Return the controls on an interval where they are polynomials of at most the given degree."""
    tau, to_coefficients = _chebyshev_fit_matrix(degree)
    half, middle = 0.5 * (right - left), 0.5 * (right + left)
    values = signal(middle + half * tau)
    if np.all(values == values[:, :1]):  # on a bound, say: no polynomial to evaluate
        return lambda times: np.broadcast_to(values[:, :1], (values.shape[0], times.size))
    coefficients = values @ to_coefficients
    orders = np.arange(degree + 1.0)[:, None]

    def controls(times: Array) -> Array:
        # Chebyshev's polynomials in one call; Runge-Kutta stages may round beyond the ends.
        angles = np.arccos(np.minimum(np.maximum((times - middle) / half, -1.0), 1.0))
        return np.asarray(coefficients @ np.cos(orders * angles))

    return controls


@cache
def _chebyshev_fit_matrix(degree: int) -> tuple[Array, Array]:
    """Chebyshev's points on [-1, 1], and what makes coefficients of the values there: exact up to a degree."""
    tau = chebyshev.chebpts1(degree + 1)
    sizes = np.where(np.arange(degree + 1) > 0, 2.0, 1.0) / (degree + 1)
    return tau, chebyshev.chebvander(tau, degree) * sizes
