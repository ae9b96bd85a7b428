r"""Shuttle re-entry: the largest cross-range a winged vehicle reaches from orbit, without a heating limit.

This example of a reentry shows automatic scaling of SI units. Altitude falls by 55 km and speed from 7.8 to 0.76 km/s
within half an hour, density grows by three orders of magnitude, and a straight line is a sufficient guess. The
vehicle banks steeply at first and rolls level towards the end.

States: ``h`` (m), ``longitude``, ``latitude`` (rad), ``v`` (m/s), ``gamma`` (flight path angle, rad), ``psi`` (azimuth
from north, rad). Controls: ``alpha`` (angle of attack, rad), ``bank`` (rad).

.. math::
   \dot h &= v \sin\gamma, \qquad
   \dot\phi = \frac{v \cos\gamma \sin\psi}{r \cos\theta}, \qquad
   \dot\theta = \frac{v \cos\gamma \cos\psi}{r}, \qquad
   \dot v = -\frac{D}{m} - g \sin\gamma \\
   \dot\gamma &= \frac{L \cos\beta}{m v} + \cos\gamma \Bigl(\frac{v}{r} - \frac{g}{v}\Bigr), \qquad
   \dot\psi = \frac{L \sin\beta}{m v \cos\gamma} + \frac{v}{r \cos\theta} \cos\gamma \sin\psi \sin\theta

Source: Betts, Practical Methods for Optimal Control, 2010, section 6.1 (34.1412 degrees, 2008.59 s), converted from
feet and slugs.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

FOOT = 0.3048
"""m."""
SLUG = 14.593903
"""kg."""
DEGREE = np.pi / 180

MU = 1.4076539e16 * FOOT**3
"""m^3/s^2."""
RADIUS = 20902900 * FOOT
"""Of the Earth, m."""
MASS = 203000 / 32.174 * SLUG
"""kg."""
AREA = 2690 * FOOT**2
"""m^2."""
DENSITY = 0.002378 * SLUG / FOOT**3
"""At sea level, kg/m^3."""
SCALE_HEIGHT = 23800 * FOOT
"""m."""


def build() -> go.Problem:
    """Return the problem."""
    shuttle = go.Model("shuttle")
    h = shuttle.state("h", unit="m")
    longitude = shuttle.state("longitude", unit="rad")
    latitude = shuttle.state("latitude", unit="rad")
    v = shuttle.state("v", unit="m/s")
    gamma = shuttle.state("gamma", unit="rad")
    psi = shuttle.state("psi", unit="rad")
    alpha = shuttle.control("alpha", unit="rad")
    bank = shuttle.control("bank", unit="rad")
    r = RADIUS + h
    gravity = MU / r**2
    lift, drag = aerodynamic_accelerations(h, v, alpha)
    northing, easting = v * ca.cos(gamma) * ca.cos(psi) / r, v * ca.cos(gamma) * ca.sin(psi) / r
    shuttle.ode(
        {
            h: v * ca.sin(gamma),
            longitude: easting / ca.cos(latitude),
            latitude: northing,
            v: -drag - gravity * ca.sin(gamma),
            gamma: lift * ca.cos(bank) / v + ca.cos(gamma) * (v / r - gravity / v),
            psi: lift * ca.sin(bank) / (v * ca.cos(gamma)) + easting * ca.tan(latitude),
        }
    )

    problem = go.Problem("shuttle re-entry")
    entry = problem.phase("entry", shuttle)
    entry.time(initial=0.0, final=(500.0, 4000.0))
    entry.initial(
        h=260e3 * FOOT, longitude=0.0, latitude=0.0, v=25600 * FOOT, gamma=-1 * DEGREE, psi=np.pi / 2
    )
    entry.final(h=80e3 * FOOT, v=2500 * FOOT, gamma=-5 * DEGREE)
    entry.bounds(h=(0.0, 120e3), v=(1.0, 12e3), latitude=(-89 * DEGREE, 89 * DEGREE))
    entry.bounds(gamma=(-89 * DEGREE, 89 * DEGREE))
    entry.bounds(alpha=(-np.pi / 2, np.pi / 2), bank=(-89 * DEGREE, 1 * DEGREE))
    entry.guess([0.0, 2000.0], alpha=0.3, bank=-45 * DEGREE)
    problem.maximize(entry.final_state("latitude"))
    return problem


def aerodynamic_accelerations(h: Any, v: Any, alpha: Any) -> tuple[Any, Any]:
    """Return lift and drag per mass, m/s^2, at altitude h (m), speed v (m/s), angle of attack alpha (rad)."""
    a = alpha / DEGREE
    pressure = DENSITY * ca.exp(-h / SCALE_HEIGHT) * v**2 / 2
    lift = -0.20704 + 0.029244 * a
    drag = 0.07854 - 0.61592e-2 * a + 0.621408e-3 * a**2
    return pressure * AREA * lift / MASS, pressure * AREA * drag / MASS


REFERENCE = Reference(0.5958760762936, "independent collocation, two meshes agree", 1e-8, "rad")


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
