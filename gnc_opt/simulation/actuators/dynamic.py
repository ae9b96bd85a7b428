"""Actuators with memory: lags, limited rates, delays and holds."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_integer, read_positive
from gnc_opt.control.sampled_data import is_first, next_phase, started_steps, whole_steps
from gnc_opt.simulation.block import (
    POSITIVE,
    Block,
    Defaults,
    Parameters,
    Step,
    Tick,
    clip,
    differs,
    rows,
    scalar,
    values,
)
from gnc_opt.simulation.intersample_input import Part, Wave
from gnc_opt.tolerances import ROUNDING, SAME_TIME

MIN_TIME_CONSTANT_S = 1e-12
"""A time constant below this (s) is none."""


@dataclass(frozen=True)
class _Following(Block):
    """An actuator whose output starts at ``initial``; see `Lag`."""

    initial: ArrayLike | None = field(default=None, kw_only=True)

    @property
    def starts_at_trim(self) -> bool:
        """Whether it begins with the feedforward."""
        return isinstance(self.initial, str) and self.initial == "trim"

    def _first(self, size: int, unit: str) -> Defaults:
        """Return the parameter that says where it begins, if a number does."""
        if self.initial is None or self.starts_at_trim:
            return {}
        return {"initial": (values(self.initial, size, f"the first output of '{self.name}'"), unit)}

    def start(self, signal: Any, p: Parameters, tick: Tick) -> Any:
        if self.starts_at_trim:
            return signal
        return p["initial"] if "initial" in p else ca.SX.zeros(signal.shape[0])


@dataclass(frozen=True)
class Lag(_Following):
    r"""First-order lag :math:`\tau \dot y = u - y`, from ``initial``; ``tau`` in s (0: none).

    Exact for held commands, `Delay` and `RateLimit`; of other waves it takes the mean.

    Parameters
    ----------
    tau : float or one per component
        s, >= 0.
    initial : float, one per component or "trim"; optional
        First output, unit of the command; default zero; ``"trim"``: the feedforward.

    Examples
    --------
    >>> block = Lag("valve", 0.05, on="a")
    """

    tau: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        tau = values(self.tau, size, f"the time constant of '{self.name}'")
        return {"tau": (tau, "s"), **self._first(size, unit)}

    def limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"tau": (0.0, math.inf)}

    def flow(self, tick: Tick, wave: Wave, state: Any, p: Parameters, noise: Any) -> tuple[Wave, Step]:
        wave = wave if wave.straight else wave.averaged()
        tau, y = ca.fmax(p["tau"], MIN_TIME_CONSTANT_S), state
        parts, impulse = [], ca.SX.zeros(state.shape[0])
        for part, end in wave.pieces(tick.h):
            length, settled = end - part.begin, part.value - part.slope * tau
            gap = y - settled
            parts.append(Part(part.begin, settled, part.slope, gap))
            impulse += (settled + 0.5 * part.slope * length) * length - gap * tau * ca.expm1(-length / tau)
            y = settled + part.slope * length + gap * ca.exp(-length / tau)
        step = Step(impulse / tick.h, y)
        return Wave(step.signal, tuple(parts), tau, wave.breaks), step


@dataclass(frozen=True)
class RateLimit(_Following):
    """The output follows the command with at most ``rate`` (unit of the command per s), from ``initial``.

    Exact for held commands and `Delay`; of other waves it takes the mean.

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
        rate = values(self.rate, size, f"the rate of '{self.name}'")
        return {"rate": (rate, f"{unit}/s"), **self._first(size, unit)}

    def limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"rate": (POSITIVE, math.inf)}

    def flow(self, tick: Tick, wave: Wave, state: Any, p: Parameters, noise: Any) -> tuple[Wave, Step]:
        wave = wave if wave.stepped else wave.averaged()
        y, size = state, state.shape[0]
        zero, parts, breaks = ca.SX.zeros(size), [], list(wave.breaks)
        impulse, saturated = zero, zero
        for part, end in wave.pieces(tick.h):
            length = end - part.begin
            wanted = part.value - y
            change = clip(wanted, -p["rate"] * length, p["rate"] * length)
            ramp = ca.fabs(change) / p["rate"]
            arrival = part.begin + ramp
            parts += [
                Part(part.begin, y, ca.sign(wanted) * p["rate"], zero),
                Part(arrival, y + change, zero, zero),
            ]
            breaks += ca.vertsplit(arrival)
            impulse += y * length + change * (length - 0.5 * ramp)
            saturated = ca.fmax(saturated, differs(change, wanted))
            y = y + change
        step = Step(impulse / tick.h, y, saturated)
        return Wave(step.signal, tuple(parts), None, tuple(breaks)), step


@dataclass(frozen=True)
class Delay(_Following):
    """The command arrives ``delay`` (s) later, ``initial`` before; any delay up to ``maximum`` (default: itself).

    Exact for held commands; of waves the mean is taken. Put delays before rate limits and lags.

    Parameters
    ----------
    delay : float
        s, >= 0.
    maximum : float, optional
        Longest delay that a run may have, s; default the delay itself.
    initial : float, one per component or "trim"; optional
        As in `Lag`.

    Examples
    --------
    >>> block = Delay("bus", 0.02, on="a")
    """

    delay: float
    maximum: float | None = None

    def parameters(self, size: int, unit: str) -> Defaults:
        return {"delay": (scalar(self.delay, f"the delay of '{self.name}'"), "s"), **self._first(size, unit)}

    def limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"delay": (0.0, self._length(h) * h * (1 + ROUNDING))}

    def _length(self, h: float) -> int:
        longest = self.delay if self.maximum is None else self.maximum
        longest = read_positive(longest, f"the longest delay of '{self.name}'", or_zero=True)
        return started_steps(longest, h)

    def start(self, signal: Any, p: Parameters, tick: Tick) -> Any:
        return ca.repmat(super().start(signal, p, tick), self._length(tick.h), 1)

    def flow(self, tick: Tick, wave: Wave, state: Any, p: Parameters, noise: Any) -> tuple[Wave, Step]:
        wave = wave.averaged()
        size = wave.mean.shape[0]
        line = ca.vertcat(wave.mean, state)  # newest first
        steps = p["delay"] / tick.h
        whole = ca.floor(steps + SAME_TIME)
        share = ca.fmax(0.0, steps - whole)  # of the minor step, in which the older command still acts
        newer, older = ca.SX.zeros(size), ca.SX.zeros(size)
        for i in range(line.shape[0] // size):
            newer += ca.if_else(whole == i, line[i * size : (i + 1) * size], 0.0)
            older += ca.if_else(whole == i - 1, line[i * size : (i + 1) * size], 0.0)
        older = ca.if_else(share > 0, older, newer)
        begin, zero = share * tick.h, ca.SX.zeros(size)
        parts = (Part(zero, older, zero, zero), Part(zero + begin, newer, zero, zero))
        step = Step(share * older + (1 - share) * newer, rows(line, 0, state.shape[0]))
        return Wave(step.signal, parts, None, (begin,)), step


@dataclass(frozen=True)
class ZeroOrderHold(Block):
    """A new command or sample only every ``period`` (s), held in between.

    Parameters
    ----------
    period : float
        A multiple of the minor step (of sensors: the control step), s.

    Examples
    --------
    >>> block = ZeroOrderHold("slow valve", 0.5, on="a")
    """

    period: float

    def check(self, size: int, h: float, dt: float) -> None:
        self._steps(h)

    def _steps(self, h: float) -> int:
        count = whole_steps(self.period, h, f"the period of '{self.name}'")
        return read_integer(count, f"the number of minor steps in the period of '{self.name}'", 1)

    def start(self, signal: Any, p: Parameters, tick: Tick) -> Any:
        return ca.vertcat(signal, 0.0)

    def step(self, tick: Tick, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        size = signal.shape[0]
        output = ca.if_else(is_first(state[size]), signal, state[:size])
        return Step(output, ca.vertcat(output, next_phase(state[size], self._steps(tick.h))))
