"""Dispersions: random variation of parameters and initial states between runs.

All classes except `Choice` are deviations from the nominal value, or shares of it with ``relative=True``. Components of
a vector are independent, except with a random direction (`RandomDirection`, `UniformInBall`, `RandomRotation`).
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array, read_positive_number, require_type
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, quote_value, unknown_name_error
from gnc_opt.model.model_variables import Layout, read_vector
from gnc_opt.spacecraft.attitude import mrp_to_quaternion
from gnc_opt.spacecraft.quaternion import quaternion_product

_UNIT = 1e-6
"""Largest deviation of a quaternion's squared norm from 1; accepts inputs with six digits."""


@dataclass(frozen=True)
class Dispersion:
    """Base class of dispersions."""

    def check_nominal_value(self, name: str, nominal: Array) -> None:
        """Raise `ArgumentError` if the dispersion is invalid for this nominal value (size,)."""

    def draw(self, generator: np.random.Generator, nominal: Array) -> Array:
        """Return a dispersed value (size,)."""
        raise NotImplementedError

    def moments(self, nominal: Array) -> tuple[Array, Array]:
        """Return mean (size,) and covariance (size, size) of the deviation from the nominal value."""
        raise ArgumentError(
            f"{type(self).__name__}() does not define its mean and covariance: give it a method moments(nominal)."
        )


@dataclass(frozen=True)
class Normal(Dispersion):
    """Normally distributed deviation.

    Parameters
    ----------
    std : float or one per component
        Standard deviation (1 sigma), >= 0.
    mean : float or one per component
        Mean of the deviation.
    relative : bool
        Whether mean and standard deviation are shares of the nominal value (0.01 is 1 %).
    truncate : float, optional
        Largest deviation from the mean in standard deviations, > 0; the variance decreases.

    Examples
    --------
    >>> spread = Normal(0.05)
    """

    std: ArrayLike
    mean: ArrayLike = 0.0
    relative: bool = False
    truncate: float | None = None

    def __post_init__(self) -> None:
        _read_distribution_parameters(self.mean, "the mean of Normal()")
        if np.any(_read_distribution_parameters(self.std, "the standard deviation of Normal()") < 0):
            raise ArgumentError(
                f"the standard deviation of Normal() is {quote_value(self.std)}: give numbers >= 0."
            )
        if self.truncate is not None:
            read_positive_number(self.truncate, "truncate of Normal()")

    def check_nominal_value(self, name: str, nominal: Array) -> None:
        _require_size_of_nominal(self.std, nominal, f"the standard deviation of '{name}'")
        _require_size_of_nominal(self.mean, nominal, f"the mean deviation of '{name}'")
        _require_nonzero_nominal(self.relative, name, nominal)

    def draw(self, generator: np.random.Generator, nominal: Array) -> Array:
        if self.truncate is None:
            z = generator.standard_normal(nominal.size)
        else:  # inverse transform: one number per component, no rejection
            tail = scipy.special.ndtr(-self.truncate)
            z = scipy.special.ndtri(tail + generator.random(nominal.size) * (1 - 2 * tail))
        return _add_deviation_to_nominal_value(
            nominal, np.asarray(self.mean) + np.asarray(self.std) * z, self.relative
        )

    def moments(self, nominal: Array) -> tuple[Array, Array]:
        share = 1.0
        if self.truncate is not None:  # variance of a standard normal number between -b and b
            b = self.truncate
            share = 1 - 2 * b * np.exp(-0.5 * b * b) / np.sqrt(2 * np.pi) / (1 - 2 * scipy.special.ndtr(-b))
        unit = nominal if self.relative else np.ones(nominal.size)
        std = np.asarray(self.std, dtype=float) * unit
        return np.asarray(self.mean, dtype=float) * unit, np.diag(share * std**2)


@dataclass(frozen=True)
class Uniform(Dispersion):
    """Uniformly distributed deviation between ``low`` and ``high``; ``relative`` as in `Normal`.

    Parameters
    ----------
    low, high : float or one per component
    relative : bool
        Whether the limits are shares of the nominal value.

    Examples
    --------
    >>> spread = Uniform(0.9, 1.1)
    """

    low: ArrayLike
    high: ArrayLike
    relative: bool = False

    def __post_init__(self) -> None:
        if np.any(
            _read_distribution_parameters(self.low, "low of Uniform()")
            > _read_distribution_parameters(self.high, "high of Uniform()")
        ):
            raise ArgumentError(
                f"Uniform() has the range {quote_value(self.low)} to {quote_value(self.high)}: "
                "give the lower end first."
            )

    def check_nominal_value(self, name: str, nominal: Array) -> None:
        _require_size_of_nominal(self.low, nominal, f"the lower end of '{name}'")
        _require_size_of_nominal(self.high, nominal, f"the upper end of '{name}'")
        _require_nonzero_nominal(self.relative, name, nominal)

    def draw(self, generator: np.random.Generator, nominal: Array) -> Array:
        low = np.asarray(self.low, dtype=float)
        deviation = low + (np.asarray(self.high) - low) * generator.random(nominal.size)
        return _add_deviation_to_nominal_value(nominal, deviation, self.relative)

    def moments(self, nominal: Array) -> tuple[Array, Array]:
        unit = nominal if self.relative else np.ones(nominal.size)
        low, high = (np.asarray(end, dtype=float) * unit for end in (self.low, self.high))
        return 0.5 * (low + high), np.diag((high - low) ** 2 / 12)


@dataclass(frozen=True)
class Choice(Dispersion):
    """One of the given values (not deviations), with equal probability.

    Parameters
    ----------
    values : sequence of float or array
        Values of the size of the dispersed quantity.

    Examples
    --------
    >>> dispersions = {"plant.mass": Choice([90.0, 100.0, 130.0])}
    """

    values: Sequence[ArrayLike]

    def __post_init__(self) -> None:
        if len(self.values) == 0:
            raise ArgumentError("Choice() has no values: give some.")

    def check_nominal_value(self, name: str, nominal: Array) -> None:
        for value in self.values:
            read_vector(value, nominal.size, f"a choice of '{name}'", ArgumentError)

    def draw(self, generator: np.random.Generator, nominal: Array) -> Array:
        value = self.values[int(generator.integers(len(self.values)))]
        return read_vector(value, nominal.size, "a choice", ArgumentError)

    def moments(self, nominal: Array) -> tuple[Array, Array]:
        chosen = np.stack(
            [read_vector(v, nominal.size, "a choice", ArgumentError) for v in self.values], axis=1
        )
        return chosen.mean(axis=1) - nominal, np.cov(chosen, bias=True).reshape(nominal.size, nominal.size)


Magnitude: TypeAlias = float | Normal | Uniform
"""Constant, or drawn as a deviation from zero."""


@dataclass(frozen=True)
class RandomDirection(Dispersion):
    """Deviation with a uniformly distributed random direction.

    Parameters
    ----------
    radius : float, Normal or Uniform
        Length of the deviation, in the unit of the vector: constant or drawn.

    Examples
    --------
    >>> dispersions = {"initial.r": RandomDirection(10.0), "initial.v": RandomDirection(Normal(0.1))}
    """

    radius: Magnitude

    def __post_init__(self) -> None:
        _check_deviation_magnitude(self.radius, "the radius of Sphere()")

    def draw(self, generator: np.random.Generator, nominal: Array) -> Array:
        return nominal + _draw_deviation_magnitude(self.radius, generator) * _draw_random_unit_vector(
            generator, nominal.size
        )

    def moments(self, nominal: Array) -> tuple[Array, Array]:
        return np.zeros(nominal.size), _compute_mean_square_of_magnitude(self.radius) / nominal.size * np.eye(
            nominal.size
        )


@dataclass(frozen=True)
class UniformInBall(Dispersion):
    """Deviation with uniform distribution in a ball of ``radius`` (unit of the vector).

    Parameters
    ----------
    radius : float
        Unit of the vector, > 0.

    Examples
    --------
    >>> dispersions = {"initial.r": UniformInBall(10.0)}  # within 10 m
    """

    radius: float

    def __post_init__(self) -> None:
        read_positive_number(self.radius, "the radius of Ball()", or_zero=True)

    def draw(self, generator: np.random.Generator, nominal: Array) -> Array:
        direction = _draw_random_unit_vector(generator, nominal.size)
        length = self.radius * generator.random() ** (1 / nominal.size)
        return np.asarray(nominal + length * direction)

    def moments(self, nominal: Array) -> tuple[Array, Array]:
        return np.zeros(nominal.size), self.radius**2 / (nominal.size + 2) * np.eye(nominal.size)


@dataclass(frozen=True)
class RandomRotation(Dispersion):
    """Rotation of an attitude about a uniformly distributed random axis.

    The attitude is a unit quaternion (scalar first) or modified Rodrigues parameters: four or three components.

    Parameters
    ----------
    angle : float, Normal or Uniform
        Rotation angle, rad: constant or drawn.

    Examples
    --------
    >>> dispersions = {"initial.q_BL": RandomRotation(Normal(np.radians(5.0)))}
    """

    angle: Magnitude

    def __post_init__(self) -> None:
        _check_deviation_magnitude(self.angle, "the angle of Turn()")

    def check_nominal_value(self, name: str, nominal: Array) -> None:
        if nominal.size not in (3, 4):
            raise ArgumentError(
                f"'{name}' cannot be turned: {nominal.size} component(s) are neither a quaternion nor modified "
                "Rodrigues parameters."
            )
        if nominal.size == 4 and not abs(float(nominal @ nominal) - 1) < _UNIT:
            raise ArgumentError(f"'{name}' cannot be turned: {nominal} is no unit quaternion; normalise it.")

    def draw(self, generator: np.random.Generator, nominal: Array) -> Array:
        half = 0.5 * _draw_deviation_magnitude(self.angle, generator)
        rotation = np.concatenate([[np.cos(half)], np.sin(half) * _draw_random_unit_vector(generator, 3)])
        attitude = nominal if nominal.size == 4 else mrp_to_quaternion(nominal)
        rotated = np.asarray(quaternion_product(attitude, rotation), dtype=float)
        # of the two parameter sets, the one of the nominal attitude
        return rotated if nominal.size == 4 else rotated[1:] / (1 + rotated[0])

    def moments(self, nominal: Array) -> tuple[Array, Array]:
        """Return mean and covariance to first order in the angle."""
        attitude = nominal if nominal.size == 4 else mrp_to_quaternion(nominal)
        axes = np.hstack([np.zeros((3, 1)), 0.5 * np.eye(3)])  # half a radian about each axis
        change = np.stack(
            [np.asarray(quaternion_product(attitude, axis), dtype=float) for axis in axes], axis=1
        )
        if nominal.size == 3:
            change = (change[1:] - np.outer(nominal, change[0])) / (1 + attitude[0])
        return np.zeros(nominal.size), _compute_mean_square_of_magnitude(self.angle) / 3 * change @ change.T


Dispersions: TypeAlias = Mapping[str, Dispersion]
"""Dispersions by dotted name, see `ClosedLoop.layout`."""


def check_dispersions(dispersions: Dispersions, layout: Layout, nominal: Array) -> None:
    """Raise an error for values that are not dispersions, for unknown names and for wrong sizes."""
    require_type(
        dispersions,
        Mapping,
        "the dispersions of monte_carlo()",
        'write {"plant.m": Normal(0.01, relative=True)}',
    )
    for name, dispersion in dispersions.items():
        if name not in layout:
            raise unknown_name_error("parameter", name, "the closed loop", layout.names)
        require_type(
            dispersion, Dispersion, f"the dispersion of '{name}'", "give Normal(...), Uniform(...) or another"
        )
        dispersion.check_nominal_value(name, nominal[layout.slice(name)])


def draw_dispersed_parameters(
    dispersions: Dispersions, layout: Layout, nominal: Array, seed: int, index: int
) -> Array:
    """Return the parameter column P (n_parameters,) of one run.

    The random numbers of a parameter depend only on the seed, the index of the run and the name.
    """
    P = nominal.copy()
    for name, dispersion in dispersions.items():
        sequence = np.random.SeedSequence([seed, index], spawn_key=(zlib.crc32(name.encode()),))
        place = layout.slice(name)
        P[place] = dispersion.draw(np.random.Generator(np.random.Philox(sequence)), nominal[place])
    return P


def _read_distribution_parameters(value: Any, what: str) -> Array:
    numbers = read_float_array(value, what)
    if not np.all(np.isfinite(numbers)):
        raise ArgumentError(f"{what} is {quote_value(value)}: give finite numbers.")
    return numbers


def _require_size_of_nominal(value: ArrayLike, nominal: Array, what: str) -> None:
    read_vector(value, nominal.size, what, ArgumentError)


def _require_nonzero_nominal(relative: bool, name: str, nominal: Array) -> None:
    if relative and not np.any(nominal):
        raise ArgumentError(
            f"'{name}' has the nominal value 0, and every share of it is 0: drop relative=True."
        )


def _add_deviation_to_nominal_value(nominal: Array, deviation: Array, relative: bool) -> Array:
    return nominal * (1 + deviation) if relative else nominal + deviation


def _check_deviation_magnitude(value: Any, what: str) -> None:
    if isinstance(value, (Normal, Uniform)):
        value.check_nominal_value(what, np.ones(1))
        if value.relative:
            raise ArgumentError(f"{what} is relative to nothing: drop relative=True.")
    else:
        read_positive_number(value, what, or_zero=True)


def _draw_deviation_magnitude(value: Magnitude, generator: np.random.Generator) -> float:
    return float(value.draw(generator, np.zeros(1))[0]) if isinstance(value, Dispersion) else float(value)


def _compute_mean_square_of_magnitude(value: Magnitude) -> float:
    if not isinstance(value, Dispersion):
        return float(value) ** 2
    mean, variance = value.moments(np.zeros(1))
    return float(mean[0] ** 2 + variance[0, 0])


def _draw_random_unit_vector(generator: np.random.Generator, size: int) -> Array:
    while True:
        vector = generator.standard_normal(size)
        length = float(np.linalg.norm(vector))
        if length > 0:
            return np.asarray(vector / length)
