"""Propagation: integration of the dynamics with the controls of a solution, independent of the collocation."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.polynomial import chebyshev

from gnc_opt.array_types import Array, Indices
from gnc_opt.model.ode_integration import CallLimit, Controls, OdeError, Tolerance, integrate_ode
from gnc_opt.numerical_tolerances import replace_tiny_by_one
from gnc_opt.planning.problem.hamiltonian_functions import PhaseFunctions
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.state_and_control_scales import take_largest_component

RELATIVE_TOLERANCE = 1e-11
"""Relative tolerance of integrations that check a solution."""


@dataclass(frozen=True)
class Propagation:
    """States integrated from the initial state with given controls.

    Attributes
    ----------
    times : array (n_times,)
    states : array (n_states, n_times)
        NaN after an early end.
    error : array (n_states,)
        Final state minus the final state of the solution; infinite after an early end.
    ended : str
        Cause and time of an early end, e.g. ``"the rate of state 'h' is nan at t = 2.5 s"``; else empty.
    """

    times: Array
    states: Array
    error: Array
    ended: str = ""


def integrate_dynamics(
    phase: PhaseSolution,
    functions: PhaseFunctions,
    *,
    control: Literal["flown", "polynomial"] = "flown",
    rtol: float = RELATIVE_TOLERANCE,
) -> Propagation:
    """Return the integrated states of a phase (DOP853), restarted at every discontinuity; see `Solution.propagate`.

    The absolute tolerance is ``rtol`` times the magnitude of each state.
    """
    signal, edges = (
        (phase.applied, phase.applied.jump_times) if control == "flown" else (phase.u, phase.breaks)
    )
    states, ended = _integrate_between_control_jumps(phase, functions, edges, signal, rtol)
    error = states[:, -1] - phase.x(phase.breaks[-1], "left")
    return Propagation(edges, states, np.where(np.isfinite(error), error, np.inf), ended)


def integrate_states_to_times(phase: PhaseSolution, functions: PhaseFunctions, times: Array) -> Array:
    """Return the states (n_states, n_times) of a phase integrated with the applied control.

    Times must not decrease; states are NaN after an early end.
    """
    edges = np.union1d(phase.applied.jump_times, times)
    states, _ = _integrate_between_control_jumps(phase, functions, edges, phase.applied)
    return np.asarray(states[:, np.searchsorted(edges, times)])


def compute_propagation_errors(phase: PhaseSolution, functions: PhaseFunctions, segments: Indices) -> Array:
    """Return the propagation errors of segments, integrated with the applied control (n_states, n).

    Infinite where the integration fails, and after `integration.MOST_RATES` evaluations for all segments together.
    """
    misses, jumps = np.empty((phase.states.size, segments.size)), phase.applied.jump_times
    budget = CallLimit(phase.states.labels)
    for column, k in enumerate(segments):
        left, right = phase.breaks[k : k + 2]
        edges = np.array([left, *jumps[(jumps > left) & (jumps < right)], right])
        states, _ = _integrate_between_control_jumps(phase, functions, edges, phase.applied, budget=budget)
        misses[:, column] = phase.x(right, "left") - states[:, -1]
    return np.where(np.isfinite(misses), misses, np.inf)


def _integrate_between_control_jumps(
    phase: PhaseSolution,
    functions: PhaseFunctions,
    edges: Array,
    signal: Callable[..., Array],
    rtol: float = RELATIVE_TOLERANCE,
    budget: CallLimit | None = None,
) -> tuple[Array, str]:
    """Return the states at the edges of pieces with smooth control, and the cause of an early end.

    The integration starts at the state of the first edge; states (n_states, n_edges) are NaN after an early end.
    """
    tolerance = Tolerance(rtol, compute_state_magnitudes(phase))
    budget = budget or CallLimit(phase.states.labels)
    states = np.full((phase.states.size, edges.size), np.nan)
    states[:, 0] = phase.x(edges[0])
    rates = functions.buffered_state_rates()
    for k, (left, right) in enumerate(itertools.pairwise(edges)):
        controls = _interpolate_controls(signal, left, right, max(phase.mesh.degrees))

        def evaluate_state_rates(t: float, x: Array, controls: Controls = controls) -> Array:
            return rates(t, x, controls(np.array([t]))[:, 0])

        try:
            run = integrate_ode(
                evaluate_state_rates, states[:, k], (left, right), tolerance=tolerance, budget=budget
            )
        except OdeError as why:
            return states, str(why)
        states[:, k + 1] = run.states[:, -1]
    return states, ""


def compute_state_magnitudes(phase: PhaseSolution) -> Array:
    """Return the largest magnitude of each state along the phase (n,), common to the components of a vector."""
    largest = np.max(np.abs(phase.x(phase.sample_times())), axis=1)
    return replace_tiny_by_one(take_largest_component(largest, phase.states))


def _interpolate_controls(signal: Callable[..., Array], left: float, right: float, degree: int) -> Controls:
    """Return the controls on an interval where they are polynomials of at most the given degree."""
    half, middle = 0.5 * (right - left), 0.5 * (right + left)
    tau = chebyshev.chebpts1(degree + 1)
    values = signal(middle + half * tau)
    if np.all(values == values[:, :1]):  # constant, e.g. at a bound
        return lambda times: np.broadcast_to(values[:, :1], (values.shape[0], times.size))
    coefficients = np.asarray(chebyshev.chebfit(tau, values.T, degree)).T
    orders = np.arange(degree + 1.0)[:, None]

    def evaluate_control_polynomial(times: Array) -> Array:
        # One call of Chebyshev polynomials; Runge-Kutta stages may be beyond the ends by rounding.
        angles = np.arccos(np.minimum(np.maximum((times - middle) / half, -1.0), 1.0))
        return np.asarray(coefficients @ np.cos(orders * angles))

    return evaluate_control_polynomial
