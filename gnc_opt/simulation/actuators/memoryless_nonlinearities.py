"""Memoryless actuator effects: saturation, scale factor, dead band, quantisation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import casadi as ca
from numpy.typing import ArrayLike

from gnc_opt.errors import ArgumentError
from gnc_opt.numerical_tolerances import TINY
from gnc_opt.simulation.sensor_and_actuator_block import (
    Block,
    Defaults,
    Parameters,
    Step,
    StepContext,
    clip_and_propagate_nan,
    is_changed_by_clipping,
    read_block_values,
)


@dataclass(frozen=True)
class Saturation(Block):
    """Saturation ``lower <= u <= upper`` (unit of the command; one number for all components, or one each).

    Parameters
    ----------
    lower, upper : float or one per component
        Limits; default: none.

    Examples
    --------
    >>> block = Saturation("limit", -1.0, 1.0, on="a")
    """

    lower: ArrayLike = -math.inf
    upper: ArrayLike = math.inf

    @property
    def is_memoryless(self) -> bool:
        return True

    def parameters(self, size: int, unit: str) -> Defaults:
        lower = read_block_values(self.lower, size, f"the lower limit of '{self.name}'")
        upper = read_block_values(self.upper, size, f"the upper limit of '{self.name}'")
        if not (lower <= upper).all():
            raise ArgumentError(
                f"'{self.name}' has lower limits {lower} above the upper ones {upper}: swap them."
            )
        return {"lower": (lower, unit), "upper": (upper, unit)}

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        limited = clip_and_propagate_nan(signal, p["lower"], p["upper"])
        return Step(limited, state, is_changed_by_clipping(limited, signal))


@dataclass(frozen=True)
class ScaleFactor(Block):
    """Output ``factor * u + bias`` of an actuator or sensor: calibration errors; factor 0 is a failed actuator.

    Parameters
    ----------
    factor : float or one per component
    bias : float or one per component
        Unit of the command.

    Examples
    --------
    >>> block = ScaleFactor("weak motor", 0.9, bias=0.01, on="a")
    """

    factor: ArrayLike = 1.0
    bias: ArrayLike = 0.0

    @property
    def is_memoryless(self) -> bool:
        return True

    def parameters(self, size: int, unit: str) -> Defaults:
        return {
            "factor": (read_block_values(self.factor, size, f"the factor of '{self.name}'"), ""),
            "bias": (read_block_values(self.bias, size, f"the bias of '{self.name}'"), unit),
        }

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        return Step(p["factor"] * signal + p["bias"], state)


@dataclass(frozen=True)
class Deadband(Block):
    """Dead band: commands smaller than ``width`` (unit of the command) become 0, larger ones are unchanged.

    For a minimum impulse bit over a control step ``dt``, use the width ``impulse / dt``.

    Parameters
    ----------
    width : float or one per component
        Unit of the command, >= 0.

    Examples
    --------
    >>> block = Deadband("valve", 0.01, on="a")
    """

    width: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        return {"width": (read_block_values(self.width, size, f"the width of '{self.name}'"), unit)}

    def parameter_limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"width": (0.0, math.inf)}

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        return Step(ca.if_else(ca.fabs(signal) < p["width"], 0.0, signal), state)


@dataclass(frozen=True)
class Quantisation(Block):
    """Quantisation: commands are rounded to multiples of ``step_size`` (unit of the command, > 0).

    Parameters
    ----------
    step_size : float or one per component
        Unit of the command, > 0.

    Examples
    --------
    >>> block = Quantisation("steps", 0.01, on="a")
    """

    step_size: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        return {
            "step_size": (read_block_values(self.step_size, size, f"the step size of '{self.name}'"), unit)
        }

    def parameter_limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"step_size": (TINY, math.inf)}

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        return Step(p["step_size"] * ca.floor(signal / p["step_size"] + 0.5), state)
