r"""Mars entry: the highest altitude for opening a parachute.

The parachute opens over a given place. This example shows bank-angle steering: lift is constant and only its
direction turns, with a limited rate, while heat flux and load limit the first deep pass. The bank rate is singular
for most of the flight.

States: ``h`` (m), ``lon``, ``lat`` (rad), ``v`` (m/s), ``gamma``, heading ``psi`` from north (rad), bank ``sigma``
(rad). Control: ``rate`` of the bank angle (rad/s).

.. math::
   \dot h = v \sin\gamma, \quad \dot\lambda = \frac{v \cos\gamma \sin\psi}{r \cos\varphi}, \quad
   \dot\varphi = \frac{v \cos\gamma \cos\psi}{r}, \quad \dot v = -D - g \sin\gamma

.. math::
   \dot\gamma = \frac{L \cos\sigma}{v} + \cos\gamma \Big( \frac{v}{r} - \frac{g}{v} \Big), \quad
   \dot\psi = \frac{L \sin\sigma}{v \cos\gamma} + \frac{v}{r} \cos\gamma \sin\psi \tan\varphi, \quad \dot\sigma = u

.. math:: k \sqrt{\rho} \, v^3 \le 83\,\mathrm{W/cm^2}, \qquad \sqrt{L^2 + D^2} \le 9.7\,\mathrm{g}

Source: own statement with the vehicle of the Mars Science Laboratory (G. F. Mendeck and L. Craig McGrew, Entry guidance
design and postflight performance for 2011 Mars Science Laboratory mission, J. Spacecraft and Rockets 51, 2014).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MU, RADIUS = 4.282829e13, 3396e3
"""m^3/s^2, m."""
MASS, AREA, LIFT, DRAG = 2804.0, 15.9, 0.357, 1.488
"""kg, m^2, coefficients."""
DENSITY, SCALE_HEIGHT = 0.02, 9354.0
"""At the surface, kg/m^3; m."""
HEATING = 1.9027e-8 / np.sqrt(0.6)
"""W/cm^2 per (kg/m^3)^(1/2) (m/s)^3: Sutton and Graves, nose radius 0.6 m."""
MAX_HEATING, MAX_LOAD, EARTH_GRAVITY = 83.0, 9.7, 9.81
"""W/cm^2; in units of the third, m/s^2."""
DEGREE = np.pi / 180
START = {
    "h": 125e3,
    "lon": 0.0,
    "lat": 0.0,
    "v": 5900.0,
    "gamma": -14.5 * DEGREE,
    "psi": np.pi / 2,
    "sigma": 0.0,
}
UNITS = dict(zip(START, ("m", "rad", "rad", "m/s", "rad", "rad", "rad"), strict=True))


def build() -> go.Problem:
    """Return the problem."""
    capsule = go.Model("capsule")
    h, lon, lat, v, gamma, psi, sigma = (capsule.state(name, unit=UNITS[name]) for name in START)
    rate = capsule.control("rate", unit="rad/s")
    r = RADIUS + h
    density = DENSITY * ca.exp(-h / SCALE_HEIGHT)
    pressure = 0.5 * density * v**2 * AREA / MASS
    lift, drag, g = pressure * LIFT, pressure * DRAG, MU / r**2
    capsule.ode(
        {
            h: v * ca.sin(gamma),
            lon: v * ca.cos(gamma) * ca.sin(psi) / (r * ca.cos(lat)),
            lat: v * ca.cos(gamma) * ca.cos(psi) / r,
            v: -drag - g * ca.sin(gamma),
            gamma: lift * ca.cos(sigma) / v + ca.cos(gamma) * (v / r - g / v),
            psi: lift * ca.sin(sigma) / (v * ca.cos(gamma))
            + v / r * ca.cos(gamma) * ca.sin(psi) * ca.tan(lat),
            sigma: rate,
        }
    )

    problem = go.Problem("Mars entry")
    entry = problem.phase("entry", capsule)
    entry.time(initial=0.0, final=(100.0, 600.0))
    entry.initial(**START)
    entry.final(v=500.0, lon=12.5 * DEGREE, lat=-0.3 * DEGREE)
    entry.bounds(h=(0.0, 130e3), lon=(-0.1, 0.5), lat=(-0.2, 0.2), v=(300.0, 6500.0))
    entry.bounds(gamma=(-60 * DEGREE, 30 * DEGREE), psi=(0.0, np.pi), sigma=(-np.pi, np.pi))
    entry.bounds(rate=(-20 * DEGREE, 20 * DEGREE))
    entry.path("heat flux", HEATING * ca.sqrt(density) * v**3, upper=MAX_HEATING, unit="W/cm^2")
    entry.path("load", ca.sqrt(lift**2 + drag**2) / EARTH_GRAVITY, upper=MAX_LOAD)
    problem.maximize(entry.final_state("h"))
    return problem


REFERENCE = Reference(13659.2484, "independent Radau collocation, two meshes agree", 0.02, "m")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
