"""Numerical integration with SciPy: limited work, and reports of time and cause of an early end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import scipy

from gnc_opt.array_types import Array

Controls = Callable[[Array], Array]
"""Controls (m, n_times) at times (n_times,)."""


Rate: TypeAlias = Callable[[float, Array], Array]
"""dx/dt as a function of t and x."""

GROWTH_LIMIT = 1e8
"""Growth of the state, relative to its initial magnitude, at which the integration stops as divergent."""

MAX_NONFINITE_RATES = 1000
"""Number of non-finite rates at which the integration stops."""

MAX_RATES = 500_000
"""Largest number of evaluations of the dynamics; an explicit method may need any number for stiff dynamics."""


class OdeError(Exception):
    """Error: the integration cannot continue; the message contains cause and time."""


class LimitError(OdeError):
    """Error: the permitted number of evaluations is exceeded."""


class CallLimit:
    """Counter of at most ``most`` evaluations, and of the earliest time with a rate that is not finite."""

    def __init__(self, labels: Sequence[str], most: int | None = None) -> None:
        self.labels = labels
        self.most = MAX_RATES if most is None else most
        self.count = self.not_finite = 0
        self.earliest, self.edge = np.inf, ""

    def limit_rate_function_calls(self, rate: Rate) -> Rate:
        """Return the rate function with a counter; it raises `OdeError` when the limit is exceeded."""

        def count_and_evaluate_state_rate(t: float, x: Array) -> Array:
            values = rate(t, x)
            if not np.isfinite(values).all():
                self._count_non_finite_rates(t, x, values)
            self.count_state_rate_evaluation(t)
            return values

        return count_and_evaluate_state_rate

    def count_state_rate_evaluation(self, t: float) -> None:
        """Count an evaluation at time t; raise `LimitError` when the limit is exceeded."""
        self.count += 1
        if self.count > self.most:
            raise LimitError(f"{self.most:,} evaluations of the dynamics reached only t = {t:.4g} s")

    def _count_non_finite_rates(self, t: float, x: Array, values: Array) -> None:
        self.not_finite += 1
        if t < self.earliest and np.isfinite(x).all():
            i = int(np.argmin(np.isfinite(values)))
            self.earliest = t
            self.edge = f"the rate of state '{self.labels[i]}' is {values[i]} at t = {round(t, 15):.4g} s"
        if self.not_finite > MAX_NONFINITE_RATES:
            raise OdeError(self.edge or "the state is NaN")


@dataclass(frozen=True)
class Tolerance:
    """Tolerance and method of an integration.

    Attributes
    ----------
    relative : float
    magnitude : array (n_states,)
        The absolute tolerance is relative * magnitude.
    stiff : bool
        Whether to use Radau's implicit method of order 5.
    """

    relative: float
    magnitude: Array
    stiff: bool = False


@dataclass(frozen=True)
class Integration:
    """Steps of an integration: times (n,), states (n_states, n), and dense output on request."""

    times: Array
    states: Array
    dense: Callable[[Array], Array] | None


def integrate_ode(
    rate: Rate,
    x: Array,
    span: tuple[float, float],
    *,
    tolerance: Tolerance,
    budget: CallLimit,
    stop: Callable[[float, Array], float] | None = None,
    dense: bool = False,
) -> Integration:
    """Integrate dx/dt = rate(t, x) over a span by DOP853, or by Radau's implicit method.

    Parameters
    ----------
    rate : callable
    x : array (n_states,)
        Initial state.
    span : tuple of two floats
        Start and end time; the integration may run backward.
    budget : Budget
        Work limit; several calls may share it.
    stop : callable, optional
        Function of t and x; the integration ends at its zero.
    dense : bool
        Whether to return the dense output.

    Raises
    ------
    SpentError
        The number of evaluations is exceeded.
    EndedError
        The dynamics are not finite, or the states diverge.
    """

    def evaluate_divergence_event(_: float, state: Array) -> float:
        return float(GROWTH_LIMIT - np.max(np.abs(state) / tolerance.magnitude))

    def evaluate_stop_event(t: float, state: Array) -> float:
        return np.inf if stop is None else stop(t, state)

    events: list[Any] = (
        [evaluate_divergence_event, evaluate_stop_event] if stop is not None else [evaluate_divergence_event]
    )
    for event in events:
        event.terminal = True
    try:
        with np.errstate(all="ignore"):
            run = scipy.integrate.solve_ivp(
                budget.limit_rate_function_calls(rate),
                span,
                x,
                method="Radau" if tolerance.stiff else "DOP853",
                rtol=tolerance.relative,
                atol=tolerance.relative * tolerance.magnitude,
                events=events,
                dense_output=dense,
            )
    except LimitError:
        if budget.edge:
            raise OdeError(budget.edge) from None
        raise
    except OdeError as error:
        raise OdeError(budget.edge or str(error)) from None
    if run.t_events is not None and run.t_events[0].size:
        raise OdeError(f"the states diverge at t = {run.t[-1]:.4g} s")
    if run.status < 0 or not np.all(np.isfinite(run.y[:, -1])):
        raise OdeError(budget.edge or f"the integrator finds no step at t = {run.t[-1]:.4g} s")
    return Integration(run.t, run.y, run.sol)
