"""Independent integration of the dynamics under a solution's control."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.polynomial import chebyshev

from gnc_opt.arrays import Array, Indices
from gnc_opt.model.integration import Budget, Controls, EndedError, Tolerance, integrate
from gnc_opt.planning.problem.functions import PhaseFunctions
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.tolerances import magnitude


@dataclass(frozen=True)
class Propagation:
    """States that follow from the initial state and the control alone.

    Attributes
    ----------
    times : array (n_times,)
    states : array (n_states, n_times)
        NaN after the propagation ended.
    error : array (n_states,)
        Final state minus the solution's final state, or the largest such difference of the parts; infinite if the
        propagation ended early.
    ended : str
        Why and where it ended early, e.g. ``"the rate of state 'h' is nan at t = 2.5 s"``; else empty.
    """

    times: Array
    states: Array
    error: Array
    ended: str = ""


def propagate(
    leg: PhaseSolution,
    functions: PhaseFunctions,
    *,
    control: Literal["flown", "polynomial"] = "flown",
    rtol: float = 1e-11,
    anew: Sequence[float] = (),
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
    anew : sequence of float, s
        Times at which the propagation restarts from the solution's states.
    """
    edges = leg.flown.jumps if control == "flown" else leg.breaks
    edges = np.union1d(edges, anew)
    error = np.zeros(leg.states.size)
    signal = leg.flown if control == "flown" else leg.u
    tolerance = Tolerance(rtol, state_magnitudes(leg))
    states = [leg.x(leg.breaks[0])]
    flight, ended = _Flight(functions, tolerance, Budget(leg.states.labels)), ""
    for left, right in itertools.pairwise(edges):
        controls = _control_polynomials(signal, left, right, _largest_degree(leg, left, right))
        try:
            states.append(flight.end(controls, states[-1], (left, right)))
        except EndedError as why:
            ended = str(why)
            break
        if right in anew:
            gap, states[-1] = states[-1] - leg.x(right, "left"), leg.x(right)
            error = _larger_error(error, gap)
    columns = np.full((states[0].size, edges.size), np.nan)
    columns[:, : len(states)] = np.stack(states, axis=1)
    gap = columns[:, -1] - leg.x(leg.breaks[-1], "left")
    error = _larger_error(error, gap)
    return Propagation(edges, columns, np.where(np.isfinite(error), error, np.inf), ended)


def integrate_to(leg: PhaseSolution, functions: PhaseFunctions, times: Array) -> Array:
    """Return the states (n_states, n_times) to which the applied control leads from the start of a phase.

    Times do not decrease; NaN from where the trajectory ends early.
    """
    tolerance = Tolerance(1e-11, state_magnitudes(leg))
    flight = _Flight(functions, tolerance, Budget(leg.states.labels))
    edges = np.union1d(leg.flown.jumps, times)
    states = np.full((leg.states.size, edges.size), np.nan)
    states[:, 0] = leg.x(leg.breaks[0])
    try:
        for k, (left, right) in enumerate(itertools.pairwise(edges)):
            controls = _control_polynomials(leg.flown, left, right, _largest_degree(leg, left, right))
            states[:, k + 1] = flight.end(controls, states[:, k], (left, right))
    except EndedError:
        pass
    return np.asarray(states[:, np.searchsorted(edges, times)])


def segment_misses(leg: PhaseSolution, functions: PhaseFunctions, segments: Indices) -> Array:
    """Return by how much segments miss the end to which the applied control leads from their start (n_states, n).

    Infinite where there is no such trajectory.
    """
    tolerance = Tolerance(1e-11, state_magnitudes(leg))
    flight = _Flight(functions, tolerance, Budget(leg.states.labels))
    misses = np.full((leg.states.size, segments.size), np.inf)
    jumps = leg.flown.jumps
    for column, k in enumerate(segments):
        left, right = leg.breaks[k : k + 2]
        edges = [left, *jumps[(jumps > left) & (jumps < right)], right]
        x = leg.x(left)
        try:
            for a, b in itertools.pairwise(edges):
                x = flight.end(_control_polynomials(leg.flown, a, b, _largest_degree(leg, a, b)), x, (a, b))
        except EndedError:
            continue
        misses[:, column] = leg.x(right, "left") - x
    return misses


def _larger_error(first: Array, second: Array) -> Array:
    """Return the larger of two errors; NaN counts as larger."""
    return np.asarray(np.where(np.abs(second) <= np.abs(first), first, second))


def state_magnitudes(leg: PhaseSolution) -> Array:
    """Return the largest magnitude of each state along the phase (n,), shared by the components of a vector."""
    largest = np.max(np.abs(leg.x(leg.sample_times())), axis=1)
    for variable in leg.states.variables:
        rows = leg.states.slice(variable.name)
        largest[rows] = np.max(largest[rows])
    return magnitude(largest)


def _largest_degree(leg: PhaseSolution, left: float, right: float) -> int:
    """The largest number of points of the segments that a time span has a part in: more than their controls' degree."""
    inside = (leg.breaks[:-1] < right) & (leg.breaks[1:] > left)
    return int(np.max(np.asarray(leg.mesh.degrees)[inside], initial=1))


class _Flight:
    """The dynamics, integrated from one discontinuity of the control to the next."""

    def __init__(self, functions: PhaseFunctions, tolerance: Tolerance, budget: Budget) -> None:
        self._rates = functions.fast_rates()
        self._tolerance, self._budget = tolerance, budget

    def end(self, controls: Controls, x: Array, span: tuple[float, float]) -> Array:
        """Return the state (n,) at the end of a span; raise `EndedError` where there is none."""

        def rate(t: float, x: Array) -> Array:
            return self._rates(t, x, controls(np.array([t]))[:, 0])

        run = integrate(rate, x, span, tolerance=self._tolerance, budget=self._budget)
        return run.states[:, -1]


def _control_polynomials(signal: Callable[..., Array], left: float, right: float, degree: int) -> Controls:
    """Return the controls on an interval where they are polynomials of at most the given degree."""
    tau, to_coefficients = _chebyshev_fit(degree)
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
def _chebyshev_fit(degree: int) -> tuple[Array, Array]:
    """Chebyshev's points on [-1, 1], and what makes coefficients of the values there: exact up to a degree."""
    tau = chebyshev.chebpts1(degree + 1)
    sizes = np.where(np.arange(degree + 1) > 0, 2.0, 1.0) / (degree + 1)
    return tau, chebyshev.chebvander(tau, degree) * sizes
