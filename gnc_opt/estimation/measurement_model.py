"""Measurement: function, noise, sampling period and delay of a sensor; options of filters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array, read_positive_number, require_type
from gnc_opt.array_types import Array
from gnc_opt.control.control_limits_and_authority import Limits
from gnc_opt.control.measurement_dropouts import DEFAULT_HOLD_STEPS
from gnc_opt.errors import ArgumentError, quote_value
from gnc_opt.model.model_variables import read_vector


@dataclass(frozen=True, eq=False, kw_only=True)
class FilterOptions:
    """Options of a filter other than its model and noise.

    Attributes
    ----------
    limits : tuple of two arrays (n_controls,) or numbers, optional
        Lower and upper limits of the actuators; the prediction uses the limited command.
    t0 : float
        Time of the first control step, s.
    substeps : int
        Runge-Kutta steps of the prediction per control step.
    hold : int
        Consecutive control steps without a sample after which the estimate is NaN.
    name : str, optional
        Default "EKF" or "UKF".

    Examples
    --------
    >>> options = FilterOptions(substeps=2, hold=10, name="navigation")
    >>> about = {"sigma0": {"q": 0.1, "v": 0.02}, "dt": 0.1}
    >>> ekf = go.design_ekf(cart, [1, 0], [Measurement("q", 1e-3)], **about, options=options)
    >>> print(ekf.name)
    navigation
    """

    limits: Limits | None = None
    t0: float = 0.0
    substeps: int = 1
    hold: int = DEFAULT_HOLD_STEPS
    name: str | None = None


def read_filter_options(options: FilterOptions | None, name: str) -> FilterOptions:
    chosen = FilterOptions() if options is None else options
    require_type(chosen, FilterOptions, f"the options of '{name}'", "give FilterOptions(...)")
    return replace(chosen, name=name) if chosen.name is None else chosen


@dataclass(frozen=True)
class Measurement:
    """Sensor model of an estimator: ``y = h(x) + bias + noise``.

    Parameters
    ----------
    of : str
        Name of the measured state or output; the sensor signal in a loop has the same name.
    sigma : float or one per component
        Standard deviation of the white noise of a sample, unit of the measurement, > 0.
    period : float, optional
        Time between new samples, s, a multiple of the control step; default: one control step.
    delay : float
        Delay of the samples, s, a multiple of the control step (`Delay`, after `ZeroOrderHold`).
    bias : float or one per component
        Standard deviation of a constant error; if > 0, the error is estimated, with initial value 0.
    bias_walk : float or one per component
        Standard deviation of the bias drift, unit per square root of a second (`RandomWalk`).
    gate : float, optional
        Probability that a valid sample passes, in (0, 1); default: no gate.
    difference : callable, optional
        ``difference(y, y_hat)`` of SX columns; default: that of the state, see `Model.difference`.

    Examples
    --------
    >>> camera = Measurement("q", 0.01, period=1.0, delay=0.2, bias=0.05, gate=0.9999)
    """

    of: str
    sigma: ArrayLike
    period: float | None = None
    delay: float = 0.0
    bias: ArrayLike = 0.0
    bias_walk: ArrayLike = 0.0
    gate: float | None = None
    difference: Callable[[Any, Any], Any] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.of, str):
            raise ArgumentError(
                f"a measurement of {quote_value(self.of)}: name a state or an output of the model."
            )
        for name in ("sigma", "bias", "bias_walk"):
            numbers = read_float_array(getattr(self, name), f"the {name} of the measurement of '{self.of}'")
            if not np.all(np.isfinite(numbers)) or not np.all(
                numbers > 0 if name == "sigma" else numbers >= 0
            ):
                condition = "> 0" if name == "sigma" else ">= 0"
                raise ArgumentError(
                    f"the {name} of the measurement of '{self.of}' is {numbers}: give finite numbers {condition}."
                )
        if self.period is not None:
            read_positive_number(self.period, f"the period of the measurement of '{self.of}'")
        read_positive_number(self.delay, f"the delay of the measurement of '{self.of}'", or_zero=True)
        if self.gate is not None and not 0 < read_positive_number(self.gate, f"the gate of '{self.of}'") < 1:
            raise ArgumentError(
                f"the gate of the measurement of '{self.of}' is {self.gate:g}: give the probability in (0, 1) that a "
                "valid sample passes."
            )

    @property
    def has_bias(self) -> bool:
        """Whether a constant or drifting bias is estimated."""
        return bool(np.any(np.asarray(self.bias) > 0) or np.any(np.asarray(self.bias_walk) > 0))

    def read_noise_per_component(self, name: str, size: int) -> Array:
        """Return ``sigma``, ``bias`` or ``bias_walk`` as an array with one number per error component, (size,)."""
        return read_vector(
            getattr(self, name), size, f"the {name} of the measurement of '{self.of}'", ArgumentError
        )
