"""Actuators: what becomes of a command on its way to the plant.

A command is held over a minor step. `Delay`, `RateLimit` and `Lag`, in this order, are followed within it
(`gnc_opt.simulation.wave`), blocks without memory act at every time, and all others are devices that work once per
minor step, with the mean of what they get.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_integer, read_positive
from gnc_opt.control.steps import is_first, next_phase, started_steps, whole_steps
from gnc_opt.errors import ArgumentError
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
from gnc_opt.simulation.wave import Part, Wave
from gnc_opt.tolerances import ROUNDING, SAME_TIME

_INSTANT = 1e-12
"""A time constant below this (s) is none."""

_TRIM = "trim"
"""What an actuator is told that begins with the feedforward."""


@dataclass(frozen=True)
class Saturation(Block):
    """Limits ``lower <= u <= upper`` (units of the command; one for all components, or one each).

    Parameters
    ----------
    lower, upper : float or one per component
        Default: none.

    Examples
    --------
    >>> from gnc_opt.simulation import Saturation
    >>> block = Saturation("limit", -1.0, 1.0, on="a")
    """

    lower: ArrayLike = -math.inf
    upper: ArrayLike = math.inf

    @property
    def memoryless(self) -> bool:
        return True

    def parameters(self, size: int, unit: str) -> Defaults:
        lower = values(self.lower, size, f"the lower limit of '{self.name}'")
        upper = values(self.upper, size, f"the upper limit of '{self.name}'")
        if not (lower <= upper).all():
            raise ArgumentError(
                f"'{self.name}' has lower limits {lower} above the upper ones {upper}: swap them."
            )
        return {"lower": (lower, unit), "upper": (upper, unit)}

    def step(self, tick: Tick, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        limited = clip(signal, p["lower"], p["upper"])
        return Step(limited, state, differs(limited, signal))


@dataclass(frozen=True)
class ScaleFactor(Block):
    """Output ``factor * u + bias``: calibration errors, a weak thruster, a dead one (factor 0).

    Parameters
    ----------
    factor : float or one per component
    bias : float or one per component
        Unit of the command.

    Examples
    --------
    >>> from gnc_opt.simulation import ScaleFactor
    >>> block = ScaleFactor("weak motor", 0.9, bias=0.01, on="a")
    """

    factor: ArrayLike = 1.0
    bias: ArrayLike = 0.0

    @property
    def memoryless(self) -> bool:
        return True

    def parameters(self, size: int, unit: str) -> Defaults:
        return {
            "factor": (values(self.factor, size, f"the factor of '{self.name}'"), ""),
            "bias": (values(self.bias, size, f"the bias of '{self.name}'"), unit),
        }

    def step(self, tick: Tick, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        return Step(p["factor"] * signal + p["bias"], state)


@dataclass(frozen=True)
class Deadband(Block):
    """Commands smaller than ``width`` (units of the command) are dropped; larger ones pass unchanged.

    Parameters
    ----------
    width : float or one per component
        Unit of the command, >= 0.

    Examples
    --------
    >>> from gnc_opt.simulation import Deadband
    >>> block = Deadband("valve", 0.01, on="a")
    """

    width: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        return {"width": (values(self.width, size, f"the width of '{self.name}'"), unit)}

    def limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"width": (0.0, math.inf)}

    def step(self, tick: Tick, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        return Step(ca.if_else(ca.fabs(signal) < p["width"], 0.0, signal), state)


@dataclass(frozen=True)
class Quantisation(Block):
    """Commands are rounded to multiples of ``step_size`` (units of the command, > 0).

    Parameters
    ----------
    step_size : float or one per component
        Unit of the command, > 0.

    Examples
    --------
    >>> from gnc_opt.simulation import Quantisation
    >>> block = Quantisation("steps", 0.01, on="a")
    """

    step_size: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        return {"step_size": (values(self.step_size, size, f"the step size of '{self.name}'"), unit)}

    def limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"step_size": (POSITIVE, math.inf)}

    def step(self, tick: Tick, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        return Step(p["step_size"] * ca.floor(signal / p["step_size"] + 0.5), state)


@dataclass(frozen=True)
class MinimumImpulse(Block):
    """Commands whose impulse over a control step, ``|u| dt``, is below ``impulse`` (unit of u times s) are dropped.

    Parameters
    ----------
    impulse : float or one per component
        Unit of the command times s, >= 0.

    Examples
    --------
    >>> from gnc_opt.simulation import MinimumImpulse
    >>> block = MinimumImpulse("least pulse", 0.02, on="a")
    """

    impulse: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        return {"impulse": (values(self.impulse, size, f"the impulse of '{self.name}'"), f"{unit} s".strip())}

    def limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"impulse": (0.0, math.inf)}

    def step(self, tick: Tick, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        return Step(ca.if_else(ca.fabs(signal) * tick.dt < p["impulse"], 0.0, signal), state)


@dataclass(frozen=True)
class _Following(Block):
    """An actuator whose output follows the command from somewhere.

    Attributes
    ----------
    initial : float, one per component or "trim"; optional
        First output, unit of the command; default zero. ``"trim"``: what arrives of the controller's feedforward, so
        that a vehicle that rests under it stays at rest.
    """

    initial: ArrayLike | None = field(default=None, kw_only=True)

    @property
    def in_trim(self) -> bool:
        """Whether it begins with the feedforward."""
        return isinstance(self.initial, str) and self.initial == _TRIM

    def _first(self, size: int, unit: str) -> Defaults:
        """Return the parameter that says where it begins, if a number does."""
        if self.initial is None or self.in_trim:
            return {}
        return {"initial": (values(self.initial, size, f"the first output of '{self.name}'"), unit)}

    def start(self, signal: Any, p: Parameters, tick: Tick) -> Any:
        if self.in_trim:
            return signal
        return p["initial"] if "initial" in p else ca.SX.zeros(signal.shape[0])


@dataclass(frozen=True)
class Lag(_Following):
    r"""First-order lag :math:`\tau \dot y = u - y`, from ``initial``; ``tau`` in s (0: none).

    Solved in closed form for held commands and what `Delay` and `RateLimit` make of them; of other waves it takes
    the mean.

    Parameters
    ----------
    tau : float or one per component
        s, >= 0.
    initial : float, one per component or "trim"; optional
        First output, unit of the command; default zero. ``"trim"``: the feedforward that arrives.

    Examples
    --------
    >>> from gnc_opt.simulation import Lag
    >>> block = Lag("valve", 0.05, on="a")
    """

    tau: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        tau = values(self.tau, size, f"the time constant of '{self.name}'")
        return {"tau": (tau, "s"), **self._first(size, unit)}

    def limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"tau": (0.0, math.inf)}

    def flow(self, tick: Tick, wave: Wave, state: Any, p: Parameters, noise: Any) -> tuple[Wave, Step]:
        wave = wave if wave.straight else wave.averaged(tick.h)
        tau, y = ca.fmax(p["tau"], _INSTANT), state
        parts, impulse = [], ca.SX.zeros(state.shape[0])
        for part, end in wave.pieces(tick.h):
            length, settled = end - part.begin, part.value - part.slope * tau
            gap = y - settled
            parts.append(Part(part.begin, settled, part.slope, gap))
            impulse += (settled + 0.5 * part.slope * length) * length - gap * tau * ca.expm1(-length / tau)
            y = settled + part.slope * length + gap * ca.exp(-length / tau)
        step = Step(impulse / tick.h, y)
        return Wave(step.signal, tuple(parts), tau, wave.breaks, blur=wave.blur), step


@dataclass(frozen=True)
class RateLimit(_Following):
    """The output follows the command with at most ``rate`` (unit of the command per s), from ``initial``.

    Ramp and plateau begin where they do, for held commands and what `Delay` makes of them; of other waves it takes the
    mean.

    Parameters
    ----------
    rate : float or one per component
        Unit of the command per s, > 0.
    initial : float, one per component or "trim"; optional
        First output, unit of the command; default zero. ``"trim"``: the feedforward that arrives.

    Examples
    --------
    >>> from gnc_opt.simulation import RateLimit
    >>> block = RateLimit("slew", 2.0, on="a")
    """

    rate: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        rate = values(self.rate, size, f"the rate of '{self.name}'")
        return {"rate": (rate, f"{unit}/s"), **self._first(size, unit)}

    def limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"rate": (POSITIVE, math.inf)}

    def flow(self, tick: Tick, wave: Wave, state: Any, p: Parameters, noise: Any) -> tuple[Wave, Step]:
        wave = wave if wave.stepped else wave.averaged(tick.h)
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
        return Wave(step.signal, tuple(parts), None, tuple(breaks), blur=wave.blur), step


@dataclass(frozen=True)
class Delay(_Following):
    """The command arrives ``delay`` (s) later, ``initial`` before; any delay up to ``maximum`` (default: itself).

    Commands held over minor steps arrive when they do, also within a minor step; of waves the mean is taken. As delays,
    rate limits and lags are the same in any order, put the delay first.

    Parameters
    ----------
    delay : float
        s, >= 0.
    maximum : float, optional
        Longest delay that a run may have, s; default the delay itself.
    initial : float, one per component or "trim"; optional
        First output, unit of the command; default zero. ``"trim"``: the feedforward that arrives.

    Examples
    --------
    >>> from gnc_opt.simulation import Delay
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
        wave = wave.averaged(tick.h)
        size = wave.mean.shape[0]
        line = ca.vertcat(wave.mean, state)  # newest first
        steps = p["delay"] / tick.h
        whole = ca.floor(steps + SAME_TIME)
        share = ca.fmax(
            0.0, steps - whole
        )  # of the minor step, at its beginning, that belongs to the older command
        newer, older = ca.SX.zeros(size), ca.SX.zeros(size)
        for i in range(line.shape[0] // size):
            # chosen, not weighed: a command that is not a number must not arrive early
            newer += ca.if_else(whole == i, line[i * size : (i + 1) * size], 0.0)
            older += ca.if_else(whole == i - 1, line[i * size : (i + 1) * size], 0.0)
        older = ca.if_else(share > 0, older, newer)
        begin, zero = share * tick.h, ca.SX.zeros(size)
        parts = (Part(zero, older, zero, zero), Part(zero + begin, newer, zero, zero))
        step = Step(share * older + (1 - share) * newer, rows(line, 0, state.shape[0]))
        return Wave(step.signal, parts, None, (begin,), blur=wave.blur), step


@dataclass(frozen=True)
class Pwm(Block):
    """On-off thrusters by pulse width: full ``thrust`` (unit of the command) for a share of every period.

    The command at the beginning of a period sets the on-time, ``|u| / thrust`` of the period, rounded to minor steps
    (with m of them per period the mean is right to ``thrust / (2 m)``); the pulse comes first. Pulses shorter than
    ``minimum_on`` (s) are dropped.

    Parameters
    ----------
    thrust : float or one per component
    period : float, optional
        A multiple of the minor step, s; default the control step.
    minimum_on : float

    Examples
    --------
    >>> from gnc_opt.simulation import Pwm
    >>> block = Pwm("on-off", 1.0, period=1.0, minimum_on=0.05, on="a")
    """

    thrust: ArrayLike
    period: float | None = None
    minimum_on: float = 0.0

    def parameters(self, size: int, unit: str) -> Defaults:
        return {
            "thrust": (values(self.thrust, size, f"the thrust of '{self.name}'"), unit),
            "minimum_on": (scalar(self.minimum_on, f"the minimum on-time of '{self.name}'"), "s"),
        }

    def limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"thrust": (POSITIVE, math.inf), "minimum_on": (0.0, math.inf)}

    def check(self, size: int, h: float, dt: float) -> None:
        if self._steps(h, dt) < 2:
            raise ArgumentError(
                f"the period of '{self.name}' is one minor step of {h:g} s, which leaves nothing to modulate: give "
                "the loop more minor_steps."
            )

    def _steps(self, h: float, dt: float) -> int:
        return whole_steps(dt if self.period is None else self.period, h, f"the period of '{self.name}'")

    def start(self, signal: Any, p: Parameters, tick: Tick) -> Any:
        return ca.vertcat(ca.SX.zeros(signal.shape[0]), 0.0)

    def step(self, tick: Tick, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        size, count = signal.shape[0], self._steps(tick.h, tick.dt)
        held, phase = state[:size], state[size]
        command = ca.if_else(is_first(phase), signal, held)
        on_steps = ca.floor(clip(ca.fabs(command) / p["thrust"], 0.0, 1.0) * count + 0.5)
        on_steps = ca.if_else(on_steps * tick.h < p["minimum_on"], 0.0, on_steps)
        pulse = ca.if_else(phase + 0.5 < on_steps, ca.sign(command) * p["thrust"], 0.0)
        saturated = ca.if_else(ca.fabs(command) > p["thrust"], 1.0, 0.0)
        # a command that is not a number goes on into the plant, where it is reported
        after = ca.vertcat(command, next_phase(phase, count))
        return Step(pulse + _finite_or_nan(command), after, saturated)


def _finite_or_nan(signal: Any) -> Any:
    """0 for numbers, not-a-number for others; written so that it is not simplified away."""
    return ca.if_else(ca.fabs(signal) < math.inf, 0.0, math.nan)


@dataclass(frozen=True)
class SchmittTrigger(Block):
    """On-off thrusters with hysteresis: on above ``on_level``, off below ``off_level``, output +-``thrust``.

    All in the unit of the command; works once per minor step.

    Parameters
    ----------
    thrust, on_level, off_level : float or one per component
        Unit of the command.

    Examples
    --------
    >>> from gnc_opt.simulation import SchmittTrigger
    >>> block = SchmittTrigger("relay", 1.0, on_level=0.4, off_level=0.1, on="a")
    """

    thrust: ArrayLike
    on_level: ArrayLike
    off_level: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        on = values(self.on_level, size, f"the on-level of '{self.name}'")
        off = values(self.off_level, size, f"the off-level of '{self.name}'")
        if not ((off > 0) & (off <= on)).all():
            raise ArgumentError(
                f"'{self.name}' switches on at {on} and off at {off}: give 0 < off_level <= on_level."
            )
        return {
            "thrust": (values(self.thrust, size, f"the thrust of '{self.name}'"), unit),
            "on_level": (on, unit),
            "off_level": (off, unit),
        }

    def start(self, signal: Any, p: Parameters, tick: Tick) -> Any:
        return ca.SX.zeros(signal.shape[0])

    def step(self, tick: Tick, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        polarity = trigger(signal, state, p["on_level"], p["off_level"])
        return Step(p["thrust"] * polarity + _finite_or_nan(signal), polarity)


def trigger(signal: Any, polarity: Any, on: Any, off: Any) -> Any:
    """Return the polarity (-1, 0, 1) of a Schmitt trigger after a signal, from the polarity before (SX)."""
    fresh = ca.if_else(signal > on, 1.0, ca.if_else(signal < -on, -1.0, 0.0))
    holds = ca.logic_and(ca.fabs(signal) >= off, polarity * signal > 0)
    return ca.if_else(holds, polarity, fresh)


@dataclass(frozen=True)
class Pwpf(Block):
    r"""Pulse-width pulse-frequency modulation: a lag and a Schmitt trigger with the output fed back.

    :math:`\tau \dot y = K (u - F) - y`; the thruster gives :math:`F = \pm` ``thrust`` from ``|y| > on_level`` until
    ``|y| < off_level``. The lag is solved exactly over each minor step, the trigger acts once per minor step.

    Parameters
    ----------
    thrust, on_level, off_level : float or one per component
        In the unit of the command.
    tau : float
        s, > 0.
    gain : float
        K; must be enough to reach ``on_level``.

    Examples
    --------
    >>> from gnc_opt.simulation import Pwpf
    >>> block = Pwpf("modulator", 1.0, on_level=0.45, off_level=0.15, tau=0.1, gain=2.0, on="a")
    """

    thrust: ArrayLike
    on_level: ArrayLike
    off_level: ArrayLike
    tau: float
    gain: float = 1.0

    def parameters(self, size: int, unit: str) -> Defaults:
        levels = SchmittTrigger(self.name, self.thrust, self.on_level, self.off_level).parameters(size, unit)
        tau = read_positive(self.tau, f"the time constant of '{self.name}'")
        return {
            **levels,
            "tau": (scalar(tau, self.name), "s"),
            "gain": (scalar(self.gain, f"the gain of '{self.name}'"), ""),
        }

    def limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"tau": (_INSTANT, math.inf)}

    def start(self, signal: Any, p: Parameters, tick: Tick) -> Any:
        return ca.SX.zeros(2 * signal.shape[0])

    def step(self, tick: Tick, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        size = signal.shape[0]
        y, polarity = state[:size], trigger(state[:size], state[size:], p["on_level"], p["off_level"])
        target = p["gain"] * (signal - p["thrust"] * polarity)
        after = target + (y - target) * ca.exp(-tick.h / p["tau"])
        return Step(p["thrust"] * polarity + _finite_or_nan(signal), ca.vertcat(after, polarity))


@dataclass(frozen=True)
class Hold(Block):
    """The actuator takes a new command only every ``period`` (s, a multiple of the minor step).

    Parameters
    ----------
    period : float
        A multiple of the minor step, s.

    Examples
    --------
    >>> from gnc_opt.simulation import Hold
    >>> block = Hold("slow valve", 0.5, on="a")
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
