r"""Station keeping: two weeks within 0.03 degrees with minimum velocity change.

This example shows a periodic problem with many short burns: the Earth's ellipticity pulls the satellite westwards,
the pressure of sunlight turns its eccentricity, and both must repeat after 14 days. Thrust is limited to 1e-6 m/s^2,
so that a burn takes hours.

States: mean longitude ``lam`` (degrees from the station), drift ``D`` (degrees/day), eccentricity vector ``ex``,
``ey`` (1e-4). Control: ``a``, tangential thrust in shares of the largest.

.. math::
   \dot\lambda = D, \quad \dot D = K - c_D a, \quad \dot e_x = c_e a \cos\omega t, \quad
   \dot e_y = s + c_e a \sin\omega t, \qquad J = a_{max} \int |a| \, dt

.. math:: |\lambda + 2 (e_x \sin\omega t - e_y \cos\omega t)| \le 0.03°

Source: own statement; equations as in E. M. Soop, Handbook of Geostationary Orbits, Kluwer 1994, chapters 6 and 7.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

PULL = 0.0017
"""Drift acceleration by the Earth's ellipticity, degrees/day^2."""
MAX_ACCELERATION = 1e-6
"""m/s^2."""
DRIFT_GAIN, ECCENTRICITY_GAIN = 30431.0, 56.2
"""Of tangential thrust; degrees/day^2 and 1/day per m/s^2."""
SUNLIGHT = 3.4e-6
"""Rate of the eccentricity by radiation pressure, 1/day."""
OMEGA = 2 * np.pi / 0.99727
"""Rotation of the Earth, rad/day."""
BOX, CYCLE, DAY = 0.03, 14.0, 86400.0
"""degrees, days, s."""
SCALE = 1e-4
"""Unit of the eccentricity."""


def build() -> go.Problem:
    """Return the problem."""
    satellite = go.Model("satellite")
    lam = satellite.state("lam", unit="deg")
    drift = satellite.state("D", unit="deg/day")
    ex, ey = satellite.state("ex"), satellite.state("ey")
    a = satellite.control("a")
    angle = OMEGA * satellite.time
    push = ECCENTRICITY_GAIN * MAX_ACCELERATION / SCALE * a
    satellite.ode(
        {
            lam: drift,
            drift: PULL - DRIFT_GAIN * MAX_ACCELERATION * a,
            ex: push * ca.cos(angle),
            ey: SUNLIGHT / SCALE + push * ca.sin(angle),
        }
    )

    problem = go.Problem("station keeping", time_unit="days")
    cycle = problem.phase("cycle", satellite)
    cycle.time(initial=0.0, final=CYCLE)
    cycle.bounds(a=(-1.0, 1.0), lam=(-0.1, 0.1), D=(-0.1, 0.1), ex=(-5.0, 5.0), ey=(-5.0, 5.0))
    daily = np.degrees(2 * SCALE) * (ex * ca.sin(angle) - ey * ca.cos(angle))
    cycle.path("longitude", lam + daily, lower=-BOX, upper=BOX)
    for name in satellite.states.names:
        change = cycle.final_state(name) - cycle.initial_state(name)
        problem.constrain(f"{name} repeats", change, equals=0.0)
    problem.minimize(cycle.integral(ca.fabs(a)) * MAX_ACCELERATION * DAY, unit="m/s")
    return problem


REFERENCE = Reference(0.073575, "independent Radau collocation, 980 x 3 points", 4.4e-7, "m/s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
