"""Block: model of an effect between sensor and controller or between controller and plant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_display_name, read_float_array
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, quote_value
from gnc_opt.model.model_variables import read_vector
from gnc_opt.simulation.intersample_actuator_output import ActuatorWaveform

Parameters: TypeAlias = Mapping[str, Any]
"""Parameters of a block by name, SX columns."""

Defaults: TypeAlias = dict[str, tuple[Array, str]]
"""Default values and units of a block's parameters by name."""


@dataclass(frozen=True)
class StepContext:
    """Time, step lengths and plant state, as inputs of a block.

    Attributes
    ----------
    t, h, dt : SX, float, float
        Start, length of the minor step and of the control step, s; for sensors both lengths are the control step.
    x : mapping of str to SX
        State of the plant by name, SX columns.
    """

    t: Any
    h: float
    dt: float
    x: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Step:
    """Output of a block for one step.

    Attributes
    ----------
    signal : SX
        Mean over the minor step; for sensors a sample.
    state : SX
        Memory for the next step.
    saturated : SX or None
        1 where a limit acts, else 0; one per component of the input, or ``None`` for blocks without limits.
    """

    signal: Any
    state: Any = field(default_factory=lambda: ca.SX(0, 1))
    saturated: Any = None


@dataclass(frozen=True)
class Block:
    """Base class of actuators and sensors: a symbolic step with memory, parameters and random numbers.

    Attributes
    ----------
    name : str
        Unique in a loop; prefix of the parameters, ``"<name>.<parameter>"``.
    on : str or tuple of str, optional
        Commands (sensors: states) that the block acts on; default: all.

    Examples
    --------
    A user-defined actuator, a valve that opens in one direction only:

    >>> import casadi as ca
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class OneWay(Block):
    ...     def step(self, tick, signal, state, p, noise):
    ...         return Step(ca.fmax(signal, 0.0), state)
    >>> flown = go.ClosedLoop(cart, regulator, [OneWay("valve")]).simulate([1.0, 0.0], tf=1.0)
    >>> print(flown.command("a")(0.0)[0] < 0.0, flown.control("a")(0.0)[0])
    True 0.0
    """

    name: str
    on: str | tuple[str, ...] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        read_display_name(self.name, "block")
        if "." in self.name or self.name in ("plant", "initial"):
            raise ArgumentError(
                f"a block cannot be called '{self.name}': choose a name without dots that is not 'plant' or 'initial'."
            )

    @property
    def is_memoryless(self) -> bool:
        """Whether the output depends on the present input only; other blocks act once per minor step."""
        return False

    @property
    def starts_at_trim(self) -> bool:
        """Whether the initial output is the feedforward."""
        return False

    def parameters(self, size: int, unit: str) -> Defaults:
        """Return values and units of the parameters, for a signal of ``size`` components in ``unit``."""
        return {}

    def parameter_limits(self, h: float, dt: float) -> dict[str, tuple[float, float]]:
        """Return the smallest and largest permitted values of parameters by name."""
        return {}

    def noise_size(self, size: int) -> int:
        """Return the number of standard normal random numbers per step."""
        return 0

    def output_sizes(
        self, sizes: Mapping[str, int], units: Mapping[str, str]
    ) -> dict[str, tuple[int, str]] | None:
        """Return sizes and units of the signals that replace those of `on`; ``None`` if they are unchanged."""
        return None

    def check_sizes(self, size: int, h: float, dt: float) -> None:
        """Raise `ArgumentError` if the block does not support ``size`` components or these step lengths (s)."""

    def initial_memory(self, signal: Any, p: Parameters, tick: StepContext) -> Any:
        """Return the initial memory, SX.

        ``signal`` is the first sample (sensors), the feedforward (actuators that start at trim), or zero.
        """
        return ca.SX(0, 1)

    def propagate_wave(
        self, tick: StepContext, wave: ActuatorWaveform, state: Any, p: Parameters, noise: Any
    ) -> tuple[ActuatorWaveform, Step]:
        """Return an actuator's output for an input wave within a minor step, and the result of its step.

        Blocks that are `is_memoryless` act at every time; others use the mean input and have a constant output.
        """
        step = self.step(tick, wave.mean, state, p, noise)
        if self.is_memoryless:
            return wave.apply_function_to_waveform(lambda y: self.step(tick, y, state, p, noise).signal), step
        return ActuatorWaveform(step.signal), step

    def step(self, tick: StepContext, signal: Any, state: Any, p: Parameters, noise: Any) -> Step:
        """Return the output signal and the next memory.

        Parameters
        ----------
        tick : Tick
        signal, state, noise : SX column
            Input (mean over the minor step, or a sample), memory, and normal random numbers.
        p : mapping of str to SX
            The block's parameters by name.
        """
        raise NotImplementedError


def read_block_values(value: ArrayLike, size: int, what: str) -> Array:
    """Return a block's values as an array (size,); raise an error for NaN."""
    vector = read_vector(value, size, what, ArgumentError)
    if np.any(np.isnan(vector)):
        raise ArgumentError(f"{what} is {vector}: give numbers.")
    return vector


def read_block_scalar(value: ArrayLike, what: str) -> Array:
    """Return one number as an array (1,)."""
    number = read_float_array(value, what)
    if number.size != 1 or np.isnan(number).any():
        raise ArgumentError(f"{what} is {quote_value(value)}: give one number.")
    return number.reshape(1)


def slice_symbolic_rows(column: Any, begin: int, end: int) -> Any:
    """Return rows of a symbolic column; an empty selection has shape (0, 1)."""
    return column[begin:end] if end > begin else type(column)(0, 1)


def clip_and_propagate_nan(value: Any, lower: Any, upper: Any) -> Any:
    """Return the SX value clipped to its limits; NaN stays NaN, unlike with fmin and fmax of C."""
    return ca.if_else(value > upper, upper, ca.if_else(value < lower, lower, value))


def is_changed_by_clipping(a: Any, b: Any) -> Any:
    """Return 1 if a clipped SX value differs from the original, else 0."""
    return ca.if_else(a != b, 1.0, 0.0)
