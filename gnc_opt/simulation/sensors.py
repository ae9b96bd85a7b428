"""Sensor models, evaluated once per control step."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array
from gnc_opt.errors import ArgumentError
from gnc_opt.model.model_variables import evaluate_user_function_as_column
from gnc_opt.numerical_tolerances import SAME_TIME
from gnc_opt.simulation.sensor_and_actuator_block import (
    Block,
    Defaults,
    Parameters,
    Step,
    StepContext,
    read_block_scalar,
    read_block_values,
)


@dataclass(frozen=True)
class Noise(Block):
    """White noise: ``sigma`` (1 sigma, unit of the state) times a standard normal number is added to every sample.

    Parameters
    ----------
    sigma : float or one per component
    retraction : callable, optional
        ``retraction(x, e)`` of SX columns returns the state x perturbed by the error e (attitudes).

    Examples
    --------
    >>> block = Noise("rate gyro", 1e-4, on="v")
    """

    sigma: ArrayLike
    retraction: Callable[[Any, Any], Any] | None = None

    def parameters(self, size: int, unit: str) -> Defaults:
        values = read_block_values(self.sigma, self.noise_size(size), f"sigma of '{self.name}'")
        return {"sigma": (values, getattr(self.retraction, "error_unit", unit))}

    def parameter_limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"sigma": (0.0, math.inf)}

    def noise_size(self, size: int) -> int:
        if self.retraction is None:
            return size
        return int(np.size(read_float_array(self.sigma, f"sigma of '{self.name}'")))

    def check_sizes(self, size: int, h: float, dt: float) -> None:
        if self.retraction is not None:
            _check_state_retraction_size(
                self.retraction, size, self.noise_size(size), f"sigma of '{self.name}'"
            )

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        error = p["sigma"] * noise
        return Step(signal + error if self.retraction is None else self.retraction(signal, error), state)


@dataclass(frozen=True)
class Bias(Block):
    """Constant error ``bias`` (unit of the state), added, or applied by a ``retraction`` as in `Noise`.

    Parameters
    ----------
    bias : float or one per component
        Unit of the state.
    retraction : callable, optional
        As in `Noise`.

    Examples
    --------
    >>> block = Bias("offset", 0.01, on="q")
    """

    bias: ArrayLike
    retraction: Callable[[Any, Any], Any] | None = None

    def parameters(self, size: int, unit: str) -> Defaults:
        count = size if self.retraction is None else int(np.size(read_float_array(self.bias, self.name)))
        values = read_block_values(self.bias, count, f"the bias of '{self.name}'")
        return {"bias": (values, getattr(self.retraction, "error_unit", unit))}

    def check_sizes(self, size: int, h: float, dt: float) -> None:
        if self.retraction is not None:
            count = int(np.size(read_float_array(self.bias, self.name)))
            _check_state_retraction_size(self.retraction, size, count, f"the bias of '{self.name}'")

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        return Step(
            signal + p["bias"] if self.retraction is None else self.retraction(signal, p["bias"]), state
        )


@dataclass(frozen=True)
class RandomWalk(Block):
    """Random walk: an error that starts at 0, with standard deviation ``sigma`` (unit/s^0.5) times the root of time.

    Parameters
    ----------
    sigma : float or one per component
        Unit of the state per square root of a second, >= 0.

    Examples
    --------
    >>> block = RandomWalk("drift", 1e-4, on="q")
    """

    sigma: ArrayLike

    def parameters(self, size: int, unit: str) -> Defaults:
        return {"sigma": (read_block_values(self.sigma, size, f"sigma of '{self.name}'"), f"{unit}/s^0.5")}

    def parameter_limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        return {"sigma": (0.0, math.inf)}

    def noise_size(self, size: int) -> int:
        return size

    def initial_memory(self, signal: Any, p: Parameters, tick: StepContext) -> Any:
        return ca.SX.zeros(signal.shape[0])

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        return Step(signal + state, state + p["sigma"] * math.sqrt(tick.dt) * noise)


@dataclass(frozen=True)
class SensorOutage(Block):
    """Sensor outage: samples are NaN from ``begin`` until before ``end`` (s), if ``where`` > 0 or is not given.

    Parameters
    ----------
    begin, end : float
        Interval of the outage, s; default: the whole run.
    where : callable, optional
        ``where(t, x)`` of SX returns an SX (1, 1); the sensor fails if it is above zero or NaN.

    Examples
    --------
    >>> too_far = SensorOutage("too far", where=lambda t, x: x["q"] - 100.0, on="q")
    """

    begin: float = -math.inf
    end: float = math.inf
    where: Callable[[Any, Mapping[str, Any]], Any] | None = None

    def parameters(self, size: int, unit: str) -> Defaults:
        begin, end = (
            read_block_scalar(self.begin, f"the begin of '{self.name}'"),
            read_block_scalar(self.end, f"the end of '{self.name}'"),
        )
        if end < begin:
            raise ArgumentError(f"'{self.name}' ends at {end[0]:g} s, before it begins at {begin[0]:g} s.")
        return {"begin": (begin, "s"), "end": (end, "s")}

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        begin, end = (p[name] - SAME_TIME * tick.dt for name in ("begin", "end"))
        is_out = ca.logic_and(tick.t >= begin, tick.t < end)
        if self.where is not None:
            states = ", ".join(tick.x)
            remedy = f"write a function of the time and of the plant's states by name, {states}"
            condition = evaluate_user_function_as_column(
                self.where, (tick.t, tick.x), 1, f"where= of '{self.name}'", remedy
            )
            is_out = ca.logic_and(is_out, ca.logic_not(condition <= 0))  # NaN counts as an outage
        return Step(ca.if_else(is_out, math.nan, signal), state)


def _check_state_retraction_size(
    retraction: Callable[[Any, Any], Any], size: int, count: int, what: str
) -> None:
    arguments = ca.SX.sym("x", size), ca.SX.sym("e", count)
    remedy = (
        f"take a state and an error, of {count} component{'s' * (count > 1)} as given, and return a state"
    )
    evaluate_user_function_as_column(retraction, arguments, size, f"the retraction given with {what}", remedy)
