"""Independent integration of the dynamics under a solution's control."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import scipy
from numpy.polynomial import legendre

from gnc_opt.arrays import Array
from gnc_opt.problem.functions import PhaseFunctions
from gnc_opt.solution.phase_solution import PhaseSolution
from gnc_opt.tolerances import magnitude

Rate: TypeAlias = Callable[[float, Array], Array]
"""dx/dt as a function of t and x."""

DIVERGED = 1e8
"""Growth beyond the trajectory's own magnitude at which propagation is given up."""

MOST_NOT_FINITE = 1000
"""Rates that are not finite, after which propagation is given up: an integrator that meets the edge of the dynamics'
domain shortens its step without end."""

MOST_RATES = 500_000
"""Evaluations of the dynamics over a phase; stiff dynamics would take an explicit integrator any number of them."""


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


def propagate(
    leg: PhaseSolution,
    functions: PhaseFunctions,
    *,
    control: Literal["flown", "polynomial"] = "flown",
    rtol: float = 1e-11,
) -> Propagation:
    """Integrate the dynamics over a phase by DOP853, restarting at every discontinuity of the control.

    Parameters
    ----------
    leg : PhaseSolution
    functions : PhaseFunctions
        Of the same phase.
    control : {"flown", "polynomial"}
        The bounded signal that can be flown, or the collocation polynomial as it is.
    rtol : float
        Relative tolerance; the absolute one is ``rtol`` times each state's magnitude.
    """
    edges = leg.flown.jumps if control == "flown" else leg.breaks
    signal = leg.flown if control == "flown" else leg.u
    magnitude = state_magnitudes(leg)
    states = [leg.x(leg.breaks[0])]
    degree = max(leg.mesh.degrees)
    fast, budget, ended = functions.fast_rates(), _Budget(leg.states.labels), ""
    for left, right in itertools.pairwise(edges):
        rate = budget.watched(_right_hand_side(fast, signal, left, right, degree))
        try:
            states.append(_integrate(rate, states[-1], left, right, rtol, magnitude))
        except _EndedError as why:
            ended = budget.edge or str(why)
            break
    columns = np.full((states[0].size, edges.size), np.nan)
    columns[:, : len(states)] = np.stack(states, axis=1)
    error = columns[:, -1] - leg.x(leg.breaks[-1], "left")
    return Propagation(edges, columns, np.where(np.isfinite(error), error, np.inf), ended)


def state_magnitudes(leg: PhaseSolution) -> Array:
    """Return the largest magnitude of each state along the phase (n,), shared by the components of a vector."""
    largest = np.max(np.abs(leg.x(leg.sample_times())), axis=1)
    for variable in leg.states.variables:
        rows = leg.states.slice(variable.name)
        largest[rows] = np.max(largest[rows])
    return magnitude(largest)


class _EndedError(Exception):
    """Propagation cannot go on."""


class _Budget:
    """Counts evaluations of the dynamics, and remembers the earliest time at which they are not finite."""

    def __init__(self, labels: tuple[str, ...]) -> None:
        self.labels = labels
        self.count = self.not_finite = 0
        self.earliest, self.edge = np.inf, ""

    def watched(self, rate: Rate) -> Rate:
        """Return the rate, which raises `_EndedError` when the budget is spent."""

        def counted(t: float, x: Array) -> Array:
            values = rate(t, x)
            self.count += 1
            if not np.isfinite(values).all() and np.isfinite(x).all():
                self._note(t, values)
            if self.count > MOST_RATES:
                raise _EndedError(f"{MOST_RATES:,} evaluations of the dynamics led to t = {t:.4g} s only")
            return values

        return counted

    def _note(self, t: float, values: Array) -> None:
        self.not_finite += 1
        if t < self.earliest:
            i = int(np.argmin(np.isfinite(values)))
            self.earliest = t
            self.edge = f"the rate of state '{self.labels[i]}' is {values[i]} at t = {round(t, 15):.4g} s"
        if self.not_finite > MOST_NOT_FINITE:
            raise _EndedError(self.edge)


def _integrate(rate: Rate, x: Array, left: float, right: float, rtol: float, magnitude: Array) -> Array:
    def diverged(_: float, state: Array) -> float:
        return float(DIVERGED - np.max(np.abs(state) / magnitude))

    diverged.terminal = True  # type: ignore[attr-defined]
    with np.errstate(all="ignore"):
        run = scipy.integrate.solve_ivp(
            rate, (left, right), x, method="DOP853", rtol=rtol, atol=rtol * magnitude, events=diverged
        )
    if run.status == 1:
        raise _EndedError(f"the states diverge at t = {run.t[-1]:.4g} s")
    if run.status != 0 or not np.all(np.isfinite(run.y[:, -1])):
        raise _EndedError(f"the integrator finds no step at t = {run.t[-1]:.4g} s")
    return np.asarray(run.y[:, -1])


def _right_hand_side(
    fast: Callable[[float, Array, Array], Array],
    signal: Callable[..., Array],
    left: float,
    right: float,
    degree: int,
) -> Rate:
    """Return dx/dt on an interval where the control is a polynomial of at most the given degree."""
    tau = np.asarray(legendre.leggauss(degree + 1)[0])
    half, middle = 0.5 * (right - left), 0.5 * (right + left)
    coefficients = legendre.legfit(tau, signal(middle + half * tau).T, degree)

    def rate(t: float, x: Array) -> Array:
        return fast(t, x, np.asarray(legendre.legval((t - middle) / half, coefficients)))

    return rate
