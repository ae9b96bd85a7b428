"""Disturbances of the plant, additional to its controls.

``on`` names a state (the disturbance is added to its rate) or a control (added to the applied control).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array
from gnc_opt.control.sampled_data_discretization import (
    advance_step_counter,
    count_steps_in_duration,
    is_step_counter_zero,
)
from gnc_opt.errors import ArgumentError
from gnc_opt.simulation.sensor_and_actuator_block import (
    Block,
    Defaults,
    Parameters,
    StepContext,
    read_block_scalar,
    read_block_values,
)


@dataclass(frozen=True)
class Disturbance(Block):
    """Base class of disturbances: continuous functions of time and state; their memory changes at control steps.

    Examples
    --------
    Drag proportional to the square of the speed:

    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Drag(Disturbance):
    ...     def value(self, t, x, state, p):
    ...         return -0.3 * x["v"] * abs(x["v"])
    >>> flown = go.ClosedLoop(cart, regulator, disturbances=[Drag("drag", on="v")]).simulate([1.0, 0.0], tf=8.0)
    >>> print(f"{flown.miss('q'):.4f}")
    0.0017
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.on, str):
            raise ArgumentError(f"disturbance '{self.name}' acts on nothing: give on= a state or a control.")

    def update(self, tick: StepContext, state: Any, p: Parameters, noise: Any) -> Any:
        """Return the memory for this control step, SX; arguments as in `step`."""
        return state

    def value(self, t: Any, x: Mapping[str, Any], state: Any, p: Parameters) -> Any:
        """Return the disturbance at time t (s) and the plant's state x (by name), SX column."""
        raise NotImplementedError


@dataclass(frozen=True)
class ConstantDisturbance(Disturbance):
    """Constant disturbance ``level``.

    Parameters
    ----------
    level : float or one per component
        Value, in the unit of the control or of the state's rate.

    Examples
    --------
    >>> block = ConstantDisturbance("wind", 0.1, on="v")
    """

    level: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        return {"level": (read_block_values(self.level, size, f"the level of '{self.name}'"), unit)}

    def value(self, t: Any, x: Mapping[str, Any], state: Any, p: Parameters) -> Any:
        return p["level"]


@dataclass(frozen=True)
class SinusoidalDisturbance(Disturbance):
    """Sinusoidal disturbance ``amplitude * sin(frequency * t + phase)``.

    Parameters
    ----------
    amplitude : float or one per component
        Unit of the control or of the state's rate.
    frequency : float
        rad/s.
    phase : float or one per component
        rad.

    Examples
    --------
    >>> block = SinusoidalDisturbance("flutter", 0.1, 2.0, on="v")
    """

    amplitude: ArrayLike
    frequency: float
    phase: ArrayLike = 0.0

    def parameters(self, size: int, unit: str) -> Defaults:
        return {
            "amplitude": (read_block_values(self.amplitude, size, f"the amplitude of '{self.name}'"), unit),
            "frequency": (read_block_scalar(self.frequency, f"the frequency of '{self.name}'"), "rad/s"),
            "phase": (read_block_values(self.phase, size, f"the phase of '{self.name}'"), "rad"),
        }

    def value(self, t: Any, x: Mapping[str, Any], state: Any, p: Parameters) -> Any:
        return p["amplitude"] * ca.sin(p["frequency"] * t + p["phase"])


@dataclass(frozen=True)
class PiecewiseConstantNoise(Disturbance):
    """Normal random values with standard deviation ``sigma``, each constant over ``period`` (s).

    Parameters
    ----------
    sigma : float or one per component
    period : float, optional
        A multiple of the control step, s; default one control step.

    Examples
    --------
    >>> block = PiecewiseConstantNoise("gusts", 0.1, period=0.5, on="v")
    """

    sigma: ArrayLike
    period: float | None = None

    def parameters(self, size: int, unit: str) -> Defaults:
        return {"sigma": (read_block_values(self.sigma, size, f"sigma of '{self.name}'"), unit)}

    def parameter_limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"sigma": (0.0, math.inf)}

    def noise_size(self, size: int) -> int:
        return size

    def _count_steps_per_noise_sample(self, dt: float) -> int:
        return max(
            1,
            count_steps_in_duration(
                dt if self.period is None else self.period, dt, f"the period of '{self.name}'"
            ),
        )

    def check_sizes(self, size: int, h: float, dt: float) -> None:
        self._count_steps_per_noise_sample(dt)

    def initial_memory(self, signal: Any, p: Parameters, tick: StepContext) -> Any:
        return ca.SX.zeros(signal.shape[0] + 1)

    def update(self, tick: StepContext, state: Any, p: Parameters, noise: Any) -> Any:
        size = state.shape[0] - 1
        drawn = ca.if_else(is_step_counter_zero(state[size]), noise, state[:size])
        return ca.vertcat(
            drawn, advance_step_counter(state[size], self._count_steps_per_noise_sample(tick.dt))
        )

    def value(self, t: Any, x: Mapping[str, Any], state: Any, p: Parameters) -> Any:
        return p["sigma"] * state[:-1]


@dataclass(frozen=True)
class ExpressionDisturbance(Disturbance):
    """User-defined disturbance ``function(t, x, p)`` of time (s), states and parameters of the block, by name.

    Parameters
    ----------
    function : callable
        ``function(t, x, p)`` of SX, with the states x and the parameters p by name; returns an SX column.
    constants : mapping of str to float or array
        Parameters of the block by name; they can be dispersed.

    Examples
    --------
    >>> drag = ExpressionDisturbance("drag", lambda t, x, p: -p["c"] * x["v"], {"c": 0.1}, on="v")
    """

    function: Callable[[Any, Mapping[str, Any], Mapping[str, Any]], Any]
    constants: Mapping[str, ArrayLike] = field(default_factory=dict)

    def parameters(self, size: int, unit: str) -> Defaults:
        return {
            name: (read_float_array(value, f"'{name}' of '{self.name}'").ravel(), "")
            for name, value in self.constants.items()
        }

    def value(self, t: Any, x: Mapping[str, Any], state: Any, p: Parameters) -> Any:
        return self.function(t, x, p)
