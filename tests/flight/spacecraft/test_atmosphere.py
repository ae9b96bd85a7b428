"""The atmosphere against the published tables, its smooth stand-ins against it."""

import casadi as ca
import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.spacecraft import (
    air_density,
    air_temperature,
    speed_of_sound,
    us76,
)

PUBLISHED = [  # U.S. Standard Atmosphere, 1976, table I: geometric altitude, T, p, density
    (0.0, 288.150, 1.01325e5, 1.2250),
    (5e3, 255.676, 5.4048e4, 7.3643e-1),
    (11e3, 216.774, 2.2700e4, 3.6480e-1),
    (20e3, 216.650, 5.5293e3, 8.8910e-2),
    (30e3, 226.509, 1.1970e3, 1.8410e-2),
    (50e3, 270.650, 7.9779e1, 1.0269e-3),
    (70e3, 219.585, 5.2209, 8.2829e-5),
    (80e3, 198.639, 1.0524, 1.8458e-5),
]


@pytest.mark.parametrize("z, T, p, rho", PUBLISHED)
def test_published_values(z: float, T: float, p: float, rho: float) -> None:
    found = us76(z)
    assert float(found[0]) == pytest.approx(T, abs=1.5e-3)
    assert float(found[1]) == pytest.approx(p, rel=1e-4)
    assert float(found[2]) == pytest.approx(rho, rel=1e-4)


def test_speed_of_sound_at_sea_level() -> None:
    assert float(us76(0.0)[3]) == pytest.approx(340.294, abs=1e-3)


def test_the_air_is_in_equilibrium() -> None:
    """dp/dz = -rho g(z) with gravity that falls as the standard says, and p = rho R T / M, everywhere."""
    z = np.linspace(-4e3, 85e3, 500)
    slope = (us76(z + 1.0)[1] - us76(z - 1.0)[1]) / 2.0
    gravity = 9.80665 * (6356766.0 / (6356766.0 + z)) ** 2
    np.testing.assert_allclose(slope, -us76(z)[2] * gravity, rtol=2e-5)


def test_smooth_stand_ins() -> None:
    z = np.linspace(0.0, 85e3, 2001)
    T, _, rho, a = us76(z)
    np.testing.assert_allclose(air_density(z), rho, rtol=3e-3)
    np.testing.assert_allclose(air_temperature(z), T, atol=0.6)
    np.testing.assert_allclose(speed_of_sound(z), a, rtol=1.5e-3)
    assert air_temperature(200e3) == pytest.approx(float(us76(86e3)[0]), abs=1e-9)


def test_upper_densities_are_consistent_with_their_scale_heights() -> None:
    """Vallado, table 8-4: 200 km has 37.105 km, 400 km 58.515 km, 800 km 124.64 km."""
    for base, height, top in ((200e3, 37.105e3, 250e3), (400e3, 58.515e3, 450e3), (800e3, 124.64e3, 900e3)):
        ratio = np.exp(-(top - base) / height)
        assert air_density(top) / air_density(base) == pytest.approx(ratio, rel=2e-3)


def test_expressions_have_the_values_and_derivatives_of_numbers() -> None:
    z = ca.SX.sym("z")
    function = ca.Function("f", [z], [air_density(z), ca.gradient(air_density(z), z), speed_of_sound(z)])
    for at in (3e3, 86e3, 350e3):
        value, slope, sound = (float(out) for out in function(at))
        assert value == pytest.approx(float(air_density(at)), rel=1e-12)
        assert slope == pytest.approx((air_density(at + 1.0) - air_density(at - 1.0)) / 2.0, rel=1e-5)
        assert sound == pytest.approx(speed_of_sound(at), rel=1e-12)


@pytest.mark.parametrize("z", [90e3, -6e3, np.nan, "high"])
def test_altitudes_outside_get_a_sentence(z: float) -> None:
    with pytest.raises(go.ArgumentError, match="the altitude of us76"):
        us76(z)
