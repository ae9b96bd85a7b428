r"""Boost glide: the longest glide from 6 km/s with limited heat flux.

A glider is released at 6 km/s. This example shows phugoids: without a heating limit the longest glide skips. The
limit flattens the first skips, and the trajectory touches it several times.

States: ``h`` (m), range angle ``theta`` (rad), ``v`` (m/s), ``gamma`` (rad). Control: lift coefficient ``C_L``.

.. math::
   \dot\theta = \frac{v \cos\gamma}{r}, \quad \dot v = -D - g \sin\gamma, \quad
   \dot\gamma = \frac{L}{v} + \cos\gamma \Big( \frac{v}{r} - \frac{g}{v} \Big), \qquad
   k \sqrt{\rho} \, v^3 \le \dot Q

Source: own statement; vehicle as in `problems.entry.no_fly_zones`.
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
MAX_HEATING = 900.0
"""W/cm^2."""
END = {"h": 25e3, "v": 1200.0}


def build(max_heating: float = MAX_HEATING) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    max_heating : float
        Largest heat flux, W/cm^2.
    """
    glider = go.Model("glider")
    h, theta = glider.state("h", unit="m"), glider.state("theta", unit="rad")
    v, gamma = glider.state("v", unit="m/s"), glider.state("gamma", unit="rad")
    c_l = glider.control("C_L")
    r, g = RADIUS + h, MU / (RADIUS + h) ** 2
    density = DENSITY * ca.exp(-h / SCALE_HEIGHT)
    pressure = 0.5 * density * v**2 * AREA / MASS
    glider.ode(
        {
            h: v * ca.sin(gamma),
            theta: v * ca.cos(gamma) / r,
            v: -pressure * (0.03 + 0.65 * c_l**2) - g * ca.sin(gamma),
            gamma: pressure * c_l / v + ca.cos(gamma) * (v / r - g / v),
        }
    )

    problem = go.Problem("boost glide")
    glide = problem.phase("glide", glider)
    glide.time(initial=0.0, final=(300.0, 4000.0))
    glide.initial(h=60e3, theta=0.0, v=6000.0, gamma=0.0)
    glide.final(**END)
    glide.bounds(h=(20e3, 90e3), theta=(0.0, 3.0), v=(800.0, 7000.0), gamma=(-0.5, 0.5), C_L=(0.0, 0.5))
    glide.path("heat flux", HEATING * ca.sqrt(density) * v**3, upper=max_heating)
    glide.guess(theta=(0.0, 1.2), C_L=0.2)
    problem.maximize(glide.final_state("theta"))
    return problem


REFERENCE = Reference(1.508502, "independent Radau collocation, two meshes", 3e-06, "rad")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
