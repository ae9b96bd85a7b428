"""On-off thrusters: pulse-width modulation, Schmitt trigger, pulse-width pulse-frequency modulation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import casadi as ca
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_positive_number
from gnc_opt.control.sampled_data_discretization import (
    advance_step_counter,
    count_steps_in_duration,
    is_step_counter_zero,
)
from gnc_opt.errors import ArgumentError
from gnc_opt.numerical_tolerances import TINY
from gnc_opt.simulation.actuators.actuator_dynamics import MIN_TIME_CONSTANT_S
from gnc_opt.simulation.sensor_and_actuator_block import (
    Block,
    Defaults,
    Parameters,
    Step,
    StepContext,
    clip_and_propagate_nan,
    read_block_scalar,
    read_block_values,
)


@dataclass(frozen=True)
class Pwm(Block):
    """Pulse-width modulation: full ``thrust`` (unit of the command) for a fraction of every period.

    The command at the start of a period sets the on-time, ``|u| / thrust`` of the period, rounded to minor steps. The
    pulse is at the start of the period. Pulses shorter than ``minimum_on`` (s) are omitted.

    Parameters
    ----------
    thrust : float or one per component
    period : float, optional
        A multiple of the minor step, s; default the control step.
    minimum_on : float

    Examples
    --------
    >>> block = Pwm("on-off", 1.0, period=1.0, minimum_on=0.05, on="a")
    """

    thrust: ArrayLike
    period: float | None = None
    minimum_on: float = 0.0

    def parameters(self, size: int, unit: str) -> Defaults:
        return {
            "thrust": (read_block_values(self.thrust, size, f"the thrust of '{self.name}'"), unit),
            "minimum_on": (read_block_scalar(self.minimum_on, f"the minimum on-time of '{self.name}'"), "s"),
        }

    def parameter_limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"thrust": (TINY, math.inf), "minimum_on": (0.0, math.inf)}

    def check_sizes(self, size: int, h: float, dt: float) -> None:
        if self._count_steps_per_period(h, dt) < 2:
            raise ArgumentError(
                f"the period of '{self.name}' is one minor step of {h:g} s, too short to modulate: give "
                "the loop more minor_steps."
            )

    def _count_steps_per_period(self, h: float, dt: float) -> int:
        return count_steps_in_duration(
            dt if self.period is None else self.period, h, f"the period of '{self.name}'"
        )

    def initial_memory(self, signal: Any, p: Parameters, tick: StepContext) -> Any:
        return ca.vertcat(ca.SX.zeros(signal.shape[0]), 0.0)

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        size, count = signal.shape[0], self._count_steps_per_period(tick.h, tick.dt)
        previous, phase = state[:size], state[size]
        command = ca.if_else(is_step_counter_zero(phase), signal, previous)
        on_steps = ca.floor(clip_and_propagate_nan(ca.fabs(command) / p["thrust"], 0.0, 1.0) * count + 0.5)
        on_steps = ca.if_else(on_steps * tick.h < p["minimum_on"], 0.0, on_steps)
        pulse = ca.if_else(phase + 0.5 < on_steps, ca.sign(command) * p["thrust"], 0.0)
        saturated = ca.if_else(ca.fabs(command) > p["thrust"], 1.0, 0.0)
        after = ca.vertcat(command, advance_step_counter(phase, count))
        return Step(pulse + _build_nan_propagation_term(command), after, saturated)


def _build_nan_propagation_term(signal: Any) -> Any:
    """Return 0 for numbers and NaN for NaN, in a form that compilers do not simplify."""
    return ca.if_else(ca.fabs(signal) < math.inf, 0.0, math.nan)


@dataclass(frozen=True)
class SchmittTrigger(Block):
    """Schmitt trigger: on above ``on_level``, off below ``off_level``, output +-``thrust``.

    All values have the unit of the command; the trigger acts once per minor step.

    Parameters
    ----------
    thrust, on_level, off_level : float or one per component
        Unit of the command.

    Examples
    --------
    >>> block = SchmittTrigger("relay", 1.0, on_level=0.4, off_level=0.1, on="a")
    """

    thrust: ArrayLike
    on_level: ArrayLike
    off_level: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        on = read_block_values(self.on_level, size, f"the on-level of '{self.name}'")
        off = read_block_values(self.off_level, size, f"the off-level of '{self.name}'")
        if not ((off > 0) & (off <= on)).all():
            raise ArgumentError(
                f"'{self.name}' switches on at {on} and off at {off}: give 0 < off_level <= on_level."
            )
        return {
            "thrust": (read_block_values(self.thrust, size, f"the thrust of '{self.name}'"), unit),
            "on_level": (on, unit),
            "off_level": (off, unit),
        }

    def initial_memory(self, signal: Any, p: Parameters, tick: StepContext) -> Any:
        return ca.SX.zeros(signal.shape[0])

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        polarity = update_schmitt_trigger(signal, state, p["on_level"], p["off_level"])
        return Step(p["thrust"] * polarity + _build_nan_propagation_term(signal), polarity)


def update_schmitt_trigger(signal: Any, polarity: Any, on: Any, off: Any) -> Any:
    """Return the new polarity (-1, 0, 1) of a Schmitt trigger, from a signal and the previous polarity (SX)."""
    switched = ca.if_else(signal > on, 1.0, ca.if_else(signal < -on, -1.0, 0.0))
    holds = ca.logic_and(ca.fabs(signal) >= off, polarity * signal > 0)
    return ca.if_else(holds, polarity, switched)


@dataclass(frozen=True)
class Pwpf(Block):
    r"""Pulse-width pulse-frequency modulation: a lag and a Schmitt trigger in a feedback loop.

    :math:`\tau \dot y = K (u - F) - y`; the thruster gives :math:`F = \pm` ``thrust`` from ``|y| > on_level`` until
    ``|y| < off_level``. The lag is exact over each minor step; the trigger acts once per minor step.

    Parameters
    ----------
    thrust, on_level, off_level : float or one per component
        In the unit of the command.
    tau : float
        s, > 0.
    gain : float
        Static gain K; ``on_level`` must be reachable.

    Examples
    --------
    >>> block = Pwpf("modulator", 1.0, on_level=0.45, off_level=0.15, tau=0.1, gain=2.0, on="a")
    """

    thrust: ArrayLike
    on_level: ArrayLike
    off_level: ArrayLike
    tau: float
    gain: float = 1.0

    def parameters(self, size: int, unit: str) -> Defaults:
        levels = SchmittTrigger(self.name, self.thrust, self.on_level, self.off_level).parameters(size, unit)
        tau = read_positive_number(self.tau, f"the time constant of '{self.name}'")
        return {
            **levels,
            "tau": (read_block_scalar(tau, self.name), "s"),
            "gain": (read_block_scalar(self.gain, f"the gain of '{self.name}'"), ""),
        }

    def parameter_limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"tau": (MIN_TIME_CONSTANT_S, math.inf)}

    def initial_memory(self, signal: Any, p: Parameters, tick: StepContext) -> Any:
        return ca.SX.zeros(2 * signal.shape[0])

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        size = signal.shape[0]
        y, polarity = (
            state[:size],
            update_schmitt_trigger(state[:size], state[size:], p["on_level"], p["off_level"]),
        )
        target = p["gain"] * (signal - p["thrust"] * polarity)
        after = target + (y - target) * ca.exp(-tick.h / p["tau"])
        return Step(p["thrust"] * polarity + _build_nan_propagation_term(signal), ca.vertcat(after, polarity))
