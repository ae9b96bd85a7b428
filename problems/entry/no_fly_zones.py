r"""Hypersonic glide past no-fly zones: the fastest hypersonic flight around two zones.

This example shows many limits together (heat flux, dynamic pressure, load, two zones) and a straight-line guess that
violates most of them. Every choice of sides of the zones is a local minimum.

States: ``h`` (m), ``lon``, ``lat`` (rad), ``v`` (m/s), ``gamma``, heading ``psi`` from north (rad). Controls: lift
coefficient ``C_L``, ``bank`` (rad). The drag polar is :math:`C_D = 0.03 + 0.65 C_L^2`.

.. math::
   \dot\gamma = \frac{L \cos\sigma}{v} + \cos\gamma \Big( \frac{v}{r} - \frac{g}{v} \Big), \qquad
   \dot\psi = \frac{L \sin\sigma}{v \cos\gamma} + \frac{v}{r} \cos\gamma \sin\psi \tan\varphi, \qquad
   (\lambda - \lambda_i)^2 + (\varphi - \varphi_i)^2 \ge \rho_i^2

The other equations are those of `problems.entry.mars_entry`.

Source: after T. R. Jorris and R. G. Cobb, Three-dimensional trajectory optimization satisfying waypoint and no-fly
zone constraints, J. Guidance, Control, and Dynamics 32 (2009) 551-572, with own numbers.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MU, RADIUS = 3.986004418e14, 6371e3
"""m^3/s^2, m."""
MASS, AREA = 907.2, 0.4839
"""kg, m^2."""
DENSITY, SCALE_HEIGHT = 1.225, 7200.0
"""kg/m^3, m."""
HEATING = 1.7415e-8 / np.sqrt(0.03)
"""W/cm^2 per (kg/m^3)^(1/2) (m/s)^3: nose radius 3 cm."""
MAX_HEATING, MAX_PRESSURE, MAX_LOAD, GRAVITY = 900.0, 60e3, 3.0, 9.81
"""W/cm^2, Pa, multiples of ``GRAVITY``, m/s^2."""
DEGREE = np.pi / 180
ZONES = ((22.0, -2.2, 3.0), (38.0, 4.2, 3.0))
"""Longitude, latitude and radius, degrees."""
START = {"h": 60e3, "lon": 0.0, "lat": 0.0, "v": 6500.0, "gamma": -0.2 * DEGREE, "psi": np.pi / 2}
UNITS = dict(zip(START, ("m", "rad", "rad", "m/s", "rad", "rad"), strict=True))


def build() -> go.Problem:
    """Return the problem."""
    glider = go.Model("glider")
    h, lon, lat, v, gamma, psi = (glider.state(name, unit=UNITS[name]) for name in START)
    c_l, bank = glider.control("C_L"), glider.control("bank", unit="rad")
    r, g = RADIUS + h, MU / (RADIUS + h) ** 2
    density = DENSITY * ca.exp(-h / SCALE_HEIGHT)
    pressure = 0.5 * density * v**2
    lift, drag = pressure * AREA * c_l / MASS, pressure * AREA * (0.03 + 0.65 * c_l**2) / MASS
    glider.ode(
        {
            h: v * ca.sin(gamma),
            lon: v * ca.cos(gamma) * ca.sin(psi) / (r * ca.cos(lat)),
            lat: v * ca.cos(gamma) * ca.cos(psi) / r,
            v: -drag - g * ca.sin(gamma),
            gamma: lift * ca.cos(bank) / v + ca.cos(gamma) * (v / r - g / v),
            psi: lift * ca.sin(bank) / (v * ca.cos(gamma))
            + v / r * ca.cos(gamma) * ca.sin(psi) * ca.tan(lat),
        }
    )

    problem = go.Problem("glide past no-fly zones")
    glide = problem.phase("glide", glider)
    glide.time(initial=0.0, final=(300.0, 3000.0))
    glide.initial(**START)
    glide.final(lon=50 * DEGREE, lat=2 * DEGREE, h=30e3, v=(1500.0, None))
    glide.bounds(h=(20e3, 90e3), lon=(-0.1, 1.2), lat=(-0.5, 0.5), v=(1000.0, 7000.0))
    glide.bounds(gamma=(-0.5, 0.5), psi=(0.0, np.pi), C_L=(0.0, 0.5), bank=(-80 * DEGREE, 80 * DEGREE))
    glide.path("heat flux", HEATING * ca.sqrt(density) * v**3, upper=MAX_HEATING, unit="W/cm^2")
    glide.path("dynamic pressure", pressure, upper=MAX_PRESSURE, unit="Pa")
    glide.path("load", ca.sqrt(lift**2 + drag**2) / GRAVITY, upper=MAX_LOAD)
    for i, (east, north, size) in enumerate(ZONES, 1):
        distance2 = (lon - east * DEGREE) ** 2 + (lat - north * DEGREE) ** 2
        glide.path(f"zone {i}", distance2 - (size * DEGREE) ** 2, lower=0.0)
    problem.minimize(glide.final_time)
    return problem


REFERENCE = Reference(1084.74, "independent Radau collocation, limits tightened step by step", 0.03, "s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
