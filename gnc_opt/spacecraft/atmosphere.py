r"""The Earth's atmosphere, for ascents, re-entries and low orbits.

**US Standard Atmosphere 1976** up to 86 km, in layers of constant temperature gradient :math:`L_i` over the
geopotential height :math:`H = r_0 z / (r_0 + z)`, with :math:`T_i, p_i` at the base :math:`H_i` of a layer,

.. math::
   T = T_i + L_i (H - H_i), \qquad
   p = p_i \left(\frac{T_i}{T}\right)^{g_0 M / (R L_i)} \text{ or } p_i\, e^{-g_0 M (H - H_i) / (R T_i)}, \qquad
   \rho = \frac{p M}{R T}, \qquad a = \sqrt{\gamma R T / M}.

`us76` computes these; `air_temperature`, `air_density` and `speed_of_sound` are splines through them (within
0.3 % of the density, 0.6 K). Above 86 km: exponential model of Vallado (table 8-4), mean solar activity, to
1000 km.

SI units, altitudes geometric.

References
----------
U.S. Standard Atmosphere, 1976, NOAA-S/T 76-1562, part 1.
D. A. Vallado, Fundamentals of Astrodynamics and Applications, 4th ed., section 8.6.2.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_numbers
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.model.table import Table, table

RATE_EARTH = 7.292115e-5
"""Rotation of the Earth, rad/s (WGS 84)."""

TOP = 86e3
"""Geometric altitude up to which the standard atmosphere has layers, m."""

_RADIUS, _GRAVITY, _MOLAR, _GAS, _HEAT = 6356766.0, 9.80665, 28.9644, 8314.32, 1.4
_BASES = np.array([0.0, 11e3, 20e3, 32e3, 47e3, 51e3, 71e3])
"""Geopotential, m."""
_GRADIENTS = np.array([-6.5e-3, 0.0, 1e-3, 2.8e-3, 0.0, -2.8e-3, -2e-3])
"""K/m."""

_UPPER = np.array(
    [
        [100e3, 5.297e-7], [110e3, 9.661e-8], [120e3, 2.438e-8], [130e3, 8.484e-9], [140e3, 3.845e-9],
        [150e3, 2.070e-9], [180e3, 5.464e-10], [200e3, 2.789e-10], [250e3, 7.248e-11], [300e3, 2.418e-11],
        [350e3, 9.518e-12], [400e3, 3.725e-12], [450e3, 1.585e-12], [500e3, 6.967e-13], [600e3, 1.454e-13],
        [700e3, 3.614e-14], [800e3, 1.170e-14], [900e3, 5.245e-15], [1000e3, 3.019e-15],
    ]
)  # fmt: skip
"""Altitude (m) and density (kg/m^3), Vallado table 8-4."""


def us76(altitude: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """Return temperature (K), pressure (Pa), density (kg/m^3) and speed of sound (m/s) of the standard atmosphere.

    Parameters
    ----------
    altitude : float or array
        Geometric, -5000 to 86000 m.

    Returns
    -------
    tuple of four arrays
        Of the shape of ``altitude``.

    Raises
    ------
    ArgumentError
        An altitude outside of that range.

    Examples
    --------
    >>> print(*(np.round(value, 4) for value in us76(11000.0)))
    216.7735 22699.9607 0.3648 295.1537
    """
    z = read_numbers(altitude, "the altitude of us76()")
    if not np.all((z >= -5000.0) & (z <= TOP)):
        raise ArgumentError(f"the altitude of us76() leaves -5000 to {TOP:g} m: use air_density() for more.")
    H = _RADIUS * z / (_RADIUS + z)
    layer = np.clip(np.searchsorted(_BASES, H, "right") - 1, 0, _BASES.size - 1)
    temperatures, pressures = _layers()
    above = H - _BASES[layer]
    T = temperatures[layer] + _GRADIENTS[layer] * above
    p = pressures[layer] * _pressure_ratio(above, temperatures[layer], _GRADIENTS[layer])
    return T, p, p * _MOLAR / (_GAS * T), np.sqrt(_HEAT * _GAS * T / _MOLAR)


@cache
def _layers() -> tuple[Array, Array]:
    """Temperature and pressure at the base of each layer."""
    T, p = [288.15], [101325.0]
    for thickness, gradient in zip(np.diff(_BASES), _GRADIENTS[:-1], strict=True):
        p.append(float(p[-1] * _pressure_ratio(thickness, T[-1], gradient)))
        T.append(T[-1] + gradient * float(thickness))
    return np.array(T), np.array(p)


def _pressure_ratio(above: Any, temperature: Any, gradient: Any) -> Any:
    """Pressure above the base of a layer, as a share of that at its base."""
    weight = _GRAVITY * _MOLAR / _GAS
    safe = np.where(gradient == 0, 1.0, gradient)
    warm = (temperature / (temperature + gradient * above)) ** (weight / safe)
    return np.where(gradient == 0, np.exp(-weight * above / temperature), warm)


def air_temperature(altitude: Any) -> Any:
    """Return the temperature of the standard atmosphere, smooth, K; held at its last value above 86 km.

    Parameters
    ----------
    altitude : casadi scalar, float or array
        Geometric, m.

    Examples
    --------
    >>> print(f"{air_temperature(11000.0):.2f} K")
    216.77 K
    """
    return _temperature()(altitude)


def speed_of_sound(altitude: Any) -> Any:
    """Return the speed of sound of the standard atmosphere, smooth, m/s; held at its last value above 86 km.

    Parameters
    ----------
    altitude : casadi scalar, float or array
        Geometric, m.

    Examples
    --------
    >>> print(f"{speed_of_sound(0.0):.1f} m/s")
    340.3 m/s
    """
    return (_HEAT * _GAS / _MOLAR * air_temperature(altitude)) ** 0.5


def air_density(altitude: Any) -> Any:
    """Return the density of the air, smooth, kg/m^3; exponential above 86 km.

    Parameters
    ----------
    altitude : casadi scalar, float or array
        Geometric, m.

    Examples
    --------
    >>> print(f"{air_density(0.0):.3f} kg/m^3")
    1.225 kg/m^3
    """
    logarithm = _log_density()(altitude)
    return ca.exp(logarithm) if isinstance(logarithm, ca.SX) else np.exp(logarithm)


@cache
def _temperature() -> Table:
    z = np.linspace(-5e3, TOP, 92)
    return table(z, us76(z)[0], outside="hold", name="air temperature")


@cache
def _log_density() -> Table:
    z = np.linspace(-5e3, 85e3, 91)
    altitudes = np.concatenate([z, _UPPER[:, 0]])
    return table(altitudes, np.log(np.concatenate([us76(z)[2], _UPPER[:, 1]])), name="log air density")
