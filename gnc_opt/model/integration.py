"""Integration of dynamics with guaranteed termination, and the time and reason of an early end.

Dormand and Prince's method of order 8, a step in one call of CasADi, with the step control of SciPy's DOP853
(Hairer, Nørsett & Wanner, Solving Ordinary Differential Equations I, II.4 and II.5).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
import scipy

from gnc_opt.arrays import Array

STAGES = 12
"""Evaluations of the dynamics per step: the last one is the next step's first."""

ORDER = 8

STEP_SAFETY_FACTOR, STEP_MIN_FACTOR, STEP_MAX_FACTOR = 0.9, 0.2, 10.0
"""A step is this share of what its error allows, and at least and at most so many times as long as the last one."""


Controls = Callable[[Array], Array]
"""Controls (m, n_times) at times (n_times,)."""


def step_function(rates: Any) -> Any:
    """Return (t, h, x, dx/dt, later controls, ...) -> (x, dx/dt, errors of order 5 and 3 per second)."""
    method = scipy.integrate.DOP853
    size, channels = rates.size1_in(1), rates.size1_in(2)
    t, h, x, first = (
        ca.MX.sym(name, rows) for name, rows in (("t", 1), ("h", 1), ("x", size), ("rate", size))
    )
    column = ca.MX.sym("u", channels * (STAGES - 1))
    u = ca.horzsplit(ca.reshape(column, channels, STAGES - 1))
    others = [ca.MX.sym(rates.name_in(i), rates.size1_in(i)) for i in range(3, rates.n_in())]
    stages = [first]
    for shares, place, control in zip(method.A[1:STAGES], method.C[1:STAGES], u, strict=True):
        moved = x + h * (ca.horzcat(*stages) @ ca.DM(shares[: len(stages)]))
        stages.append(rates(t + place * h, moved, control, *others))
    last = x + h * (ca.horzcat(*stages) @ ca.DM(method.B))
    stages.append(rates(t + h, last, u[-1], *others))
    errors = [ca.horzcat(*stages) @ ca.DM(method.E5), ca.horzcat(*stages) @ ca.DM(method.E3)]
    result = ca.densify(ca.vertcat(last, stages[-1], *errors))
    return ca.Function("step", [t, h, x, first, column, *others], [result])


def carried(
    step: Callable[..., Array],
    rate: Rate,
    controls: Controls,
    x: Array,
    span: tuple[float, float],
    tolerance: Tolerance,
    budget: Budget,
) -> Array | None:
    """Return the state (n,) at the end of a span, or None where numbers or steps do not stay ordinary."""
    t, end = span
    places = np.asarray(scipy.integrate.DOP853.C[1:STAGES])
    smallest, largest = tolerance.relative * tolerance.magnitude, GROWTH_LIMIT * tolerance.magnitude
    with np.errstate(all="ignore"):
        slope = rate(t, x)
        h, grows = _first_step(rate, x, slope, span, tolerance), True
        while t < end:
            shortest = 10 * np.spacing(abs(t))
            width = min(max(h, shortest), end - t)
            found = step(t, width, x, slope, controls(t + width * places).ravel("F"))
            budget.spend(t, STAGES)
            new, new_slope, *errors = found.reshape(4, -1)
            scale = smallest + tolerance.relative * np.maximum(np.abs(x), np.abs(new))
            error = width * _norm(errors[0] / scale, errors[1] / scale)
            if not np.isfinite(error) or not np.all(np.abs(new) < largest):
                return None
            growth = STEP_SAFETY_FACTOR * error ** (-1.0 / ORDER) if error > 0 else STEP_MAX_FACTOR
            if error >= 1.0:
                if width <= shortest:
                    return None
                h, grows = width * max(STEP_MIN_FACTOR, growth), False
                continue
            h, grows = width * min(STEP_MAX_FACTOR if grows else 1.0, max(STEP_MIN_FACTOR, growth)), True
            t, x, slope = (end if width == end - t else t + width), new, new_slope
    return x if np.all(np.isfinite(slope)) else None


def _norm(fifth: Array, third: Array) -> float:
    """The error of a step per second, from its estimates of two orders in units of the tolerance."""
    square = float(fifth @ fifth)
    both = square + 0.01 * float(third @ third)
    return square / float(np.sqrt(both * fifth.size)) if both != 0 else 0.0


def _first_step(rate: Rate, x: Array, slope: Array, span: tuple[float, float], tolerance: Tolerance) -> float:
    """A first step from the sizes of the state along the trajectory and of its first two derivatives (ibid., II.4)."""
    length = span[1] - span[0]
    scale = tolerance.relative * (tolerance.magnitude + np.abs(x))

    def size(values: Array) -> float:
        return float(np.linalg.norm(values / scale) / np.sqrt(x.size))

    state, speed = size(np.maximum(np.abs(x), tolerance.magnitude)), size(slope)
    trial = min(0.01 * state / speed if speed > 0 else length, length)
    bend = size(rate(span[0] + trial, x + trial * slope) - slope) / trial
    steepest = max(speed, bend)
    wanted = max(1e-6, 1e-3 * trial) if steepest <= 1e-15 else (0.01 / steepest) ** (1.0 / ORDER)
    return min(100.0 * trial, wanted, length)


Rate: TypeAlias = Callable[[float, Array], Array]
"""dx/dt as a function of t and x."""

GROWTH_LIMIT = 1e8
"""Growth beyond the trajectory's own magnitude at which integration is given up."""

MOST_NOT_FINITE = 1000
"""Rates that are not finite, after which integration is given up."""

MOST_RATES = 500_000
"""Evaluations of the dynamics; stiff dynamics would take an explicit integrator any number of them."""


class EndedError(Exception):
    """Integration cannot continue; the message gives the reason and the time."""


class SpentError(EndedError):
    """The evaluations that were allowed are spent."""


class Budget:
    """Counts evaluations of dynamics, ``most`` at most, and the earliest time at which they are not finite."""

    def __init__(self, labels: Sequence[str], most: int | None = None) -> None:
        self.labels = labels
        self.most = MOST_RATES if most is None else most
        self.count = self.not_finite = 0
        self.earliest, self.edge = np.inf, ""

    def watched(self, rate: Rate) -> Rate:
        """Return the rate, which raises `EndedError` when the budget is spent."""

        def counted(t: float, x: Array) -> Array:
            values = rate(t, x)
            if not np.isfinite(values).all():
                self._note(t, x, values)
            self.spend(t)
            return values

        return counted

    def spend(self, t: float, evaluations: int = 1) -> None:
        """Count evaluations that led to a time; raise `SpentError` when the budget is spent."""
        self.count += evaluations
        if self.count > self.most:
            raise SpentError(f"{self.most:,} evaluations of the dynamics led to t = {t:.4g} s only")

    def _note(self, t: float, x: Array, values: Array) -> None:
        self.not_finite += 1
        if t < self.earliest and np.isfinite(x).all():
            i = int(np.argmin(np.isfinite(values)))
            self.earliest = t
            self.edge = f"the rate of state '{self.labels[i]}' is {values[i]} at t = {round(t, 15):.4g} s"
        if self.not_finite > MOST_NOT_FINITE:
            raise EndedError(self.edge or "the state is no number")


@dataclass(frozen=True)
class Tolerance:
    """How exactly dynamics are integrated, and by which kind of method.

    Attributes
    ----------
    relative : float
    magnitude : array (n_states,)
        The absolute tolerance is their product.
    stiff : bool
        Use Radau's implicit method of order 5.
    """

    relative: float
    magnitude: Array
    stiff: bool = False


@dataclass(frozen=True)
class Integration:
    """Steps of an integrator: times (n,), states (n_states, n), and states in between if requested."""

    times: Array
    states: Array
    dense: Callable[[Array], Array] | None


def integrate(
    rate: Rate,
    x: Array,
    span: tuple[float, float],
    *,
    tolerance: Tolerance,
    budget: Budget,
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
        Where to begin and to end; the latter may be the earlier.
    budget : Budget
        May be shared by several calls.
    stop : callable, optional
        Integration ends where this function of t and x crosses zero.
    dense : bool
        Whether states between the steps are wanted.

    Raises
    ------
    SpentError
        They take too many evaluations.
    EndedError
        The dynamics are not finite, or diverge.
    """

    def diverged(_: float, state: Array) -> float:
        return float(GROWTH_LIMIT - np.max(np.abs(state) / tolerance.magnitude))

    def stopped(t: float, state: Array) -> float:
        return np.inf if stop is None else stop(t, state)

    events: list[Any] = [diverged, stopped] if stop is not None else [diverged]
    for event in events:
        event.terminal = True
    try:
        with np.errstate(all="ignore"):
            run = scipy.integrate.solve_ivp(
                budget.watched(rate),
                span,
                x,
                method="Radau" if tolerance.stiff else "DOP853",
                rtol=tolerance.relative,
                atol=tolerance.relative * tolerance.magnitude,
                events=events,
                dense_output=dense,
            )
    except SpentError:
        if budget.edge:
            raise EndedError(budget.edge) from None
        raise
    except EndedError as error:
        raise EndedError(budget.edge or str(error)) from None
    if run.t_events is not None and run.t_events[0].size:
        raise EndedError(f"the states diverge at t = {run.t[-1]:.4g} s")
    if run.status < 0 or not np.all(np.isfinite(run.y[:, -1])):
        raise EndedError(budget.edge or f"the integrator finds no step at t = {run.t[-1]:.4g} s")
    return Integration(run.t, run.y, run.sol)
