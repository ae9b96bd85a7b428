"""Actuator dynamics: lag, rate limit, delay and zero-order hold."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_integer, read_positive_number
from gnc_opt.control.sampled_data_discretization import (
    advance_step_counter,
    count_steps_in_duration,
    count_steps_started_within_duration,
    is_step_counter_zero,
)
from gnc_opt.numerical_tolerances import ROUNDING, SAME_TIME, TINY
from gnc_opt.simulation.intersample_actuator_output import ActuatorWaveform
from gnc_opt.simulation.sensor_and_actuator_block import (
    Block,
    Defaults,
    Parameters,
    Step,
    StepContext,
    clip_and_propagate_nan,
    is_changed_by_clipping,
    read_block_scalar,
    read_block_values,
    slice_symbolic_rows,
)

MIN_TIME_CONSTANT_S = 1e-12
"""Smallest time constant (s); below it a lag is omitted."""


@dataclass(frozen=True)
class _InitializedActuator(Block):
    initial: ArrayLike | None = field(default=None, kw_only=True)

    @property
    def starts_at_trim(self) -> bool:
        """Whether the initial output is the feedforward."""
        return isinstance(self.initial, str) and self.initial == "trim"

    def _initial_actuator_output_setting(self, size: int, unit: str) -> Defaults:
        if self.initial is None or self.starts_at_trim:
            return {}
        return {
            "initial": (read_block_values(self.initial, size, f"the first output of '{self.name}'"), unit)
        }

    def initial_memory(self, signal: Any, p: Parameters, tick: StepContext) -> Any:
        return p.get("initial", signal)


@dataclass(frozen=True)
class Lag(_InitializedActuator):
    r"""First-order lag :math:`\tau \dot y = u - y` with initial output ``initial`` and time constant ``tau`` (s).

    The solution is exact for constant inputs. After another lag the input is its mean over the minor step.

    Parameters
    ----------
    tau : float or one per component
        s, >= 0.
    initial : float, one per component or "trim"; optional
        Initial output, unit of the command; default 0; ``"trim"``: the feedforward.

    Examples
    --------
    >>> block = Lag("valve", 0.05, on="a")
    """

    tau: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        tau = read_block_values(self.tau, size, f"the time constant of '{self.name}'")
        return {"tau": (tau, "s"), **self._initial_actuator_output_setting(size, unit)}

    def parameter_limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"tau": (0.0, math.inf)}

    def propagate_wave(
        self, tick: StepContext, wave: ActuatorWaveform, state: Any, p: Parameters, noise: Any
    ) -> tuple[ActuatorWaveform, Step]:
        tau, target = ca.fmax(p["tau"], MIN_TIME_CONSTANT_S), wave.mean
        gap, faded = state - target, ca.expm1(-tick.h / tau)
        step = Step(target - gap * tau / tick.h * faded, state + gap * faded)
        return ActuatorWaveform(step.signal, lambda decay: target + gap * decay(tau)), step


@dataclass(frozen=True)
class RateLimit(_InitializedActuator):
    """Rate limit: the output follows the command with at most ``rate`` (unit of the command per s), from ``initial``.

    The output is constant over a minor step and equals the exact mean.

    Parameters
    ----------
    rate : float or one per component
        Unit of the command per s, > 0.
    initial : float, one per component or "trim"; optional
        As in `Lag`.

    Examples
    --------
    >>> block = RateLimit("slew", 2.0, on="a")
    """

    rate: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        rate = read_block_values(self.rate, size, f"the rate of '{self.name}'")
        return {"rate": (rate, f"{unit}/s"), **self._initial_actuator_output_setting(size, unit)}

    def parameter_limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"rate": (TINY, math.inf)}

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        requested, limit = signal - state, p["rate"] * tick.h
        change = clip_and_propagate_nan(requested, -limit, limit)
        mean = state + change * (1 - 0.5 * ca.fabs(change) / limit)
        return Step(mean, state + change, is_changed_by_clipping(change, requested))


@dataclass(frozen=True)
class Delay(_InitializedActuator):
    """Time delay of a command or sample by ``delay`` (s), at most ``maximum`` (default: ``delay``).

    The output is constant over a minor step and equals the exact mean; samples of sensors are interpolated linearly.
    Before the delay has passed, the output is ``initial``, or a sensor's first sample.

    Parameters
    ----------
    delay : float
        s, >= 0.
    maximum : float, optional
        Largest delay in any run, s; default: the delay itself.
    initial : float, one per component or "trim"; optional
        As in `Lag`.

    Examples
    --------
    >>> block = Delay("bus", 0.02, on="a")
    """

    delay: float
    maximum: float | None = None

    def parameters(self, size: int, unit: str) -> Defaults:
        return {
            "delay": (read_block_scalar(self.delay, f"the delay of '{self.name}'"), "s"),
            **self._initial_actuator_output_setting(size, unit),
        }

    def parameter_limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"delay": (0.0, self._count_delay_steps(h) * h * (1 + ROUNDING))}

    def _count_delay_steps(self, h: float) -> int:
        longest = self.delay if self.maximum is None else self.maximum
        longest = read_positive_number(longest, f"the longest delay of '{self.name}'", or_zero=True)
        return count_steps_started_within_duration(longest, h)

    def initial_memory(self, signal: Any, p: Parameters, tick: StepContext) -> Any:
        return ca.repmat(super().initial_memory(signal, p, tick), self._count_delay_steps(tick.h), 1)

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        size = signal.shape[0]
        line = ca.vertcat(signal, state)  # newest value first
        steps = p["delay"] / tick.h
        full_steps = ca.floor(steps + SAME_TIME)
        share = ca.fmax(0.0, steps - full_steps)  # share of the step in which the older value acts
        newer, older = ca.SX.zeros(size), ca.SX.zeros(size)
        for i in range(line.shape[0] // size):
            newer += ca.if_else(full_steps == i, line[i * size : (i + 1) * size], 0.0)
            older += ca.if_else(full_steps == i - 1, line[i * size : (i + 1) * size], 0.0)
        older = ca.if_else(share > 0, older, newer)
        return Step(share * older + (1 - share) * newer, slice_symbolic_rows(line, 0, state.shape[0]))


@dataclass(frozen=True)
class ZeroOrderHold(Block):
    """Sample and hold: the command or sample is updated every ``period`` (s) and constant in between.

    Parameters
    ----------
    period : float
        A multiple of the minor step (of sensors: the control step), s.

    Examples
    --------
    >>> block = ZeroOrderHold("slow valve", 0.5, on="a")
    """

    period: float

    def check_sizes(self, size: int, h: float, dt: float) -> None:
        self._count_steps_per_period(h)

    def _count_steps_per_period(self, h: float) -> int:
        count = count_steps_in_duration(self.period, h, f"the period of '{self.name}'")
        return read_integer(count, f"the number of minor steps in the period of '{self.name}'", 1)

    def initial_memory(self, signal: Any, p: Parameters, tick: StepContext) -> Any:
        return ca.vertcat(signal, 0.0)

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        size = signal.shape[0]
        output = ca.if_else(is_step_counter_zero(state[size]), signal, state[:size])
        return Step(
            output,
            ca.vertcat(output, advance_step_counter(state[size], self._count_steps_per_period(tick.h))),
        )
