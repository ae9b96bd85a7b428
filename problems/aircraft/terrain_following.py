r"""Terrain following: an aircraft crosses two ridges in the least time with 60 m of clearance and limits of load.

Teaches a path constraint given by a function of place: the terrain is a sum of smooth ridges. The clearance is of
second order, touched or followed at the crests.

States: ``x``, ``h`` (m), ``v`` (m/s), ``gamma`` (rad). Controls: load factor ``n``, throttle ``T`` (share of the
largest).

.. math::
   \dot v = \frac{F T - D}{m} - g \sin\gamma, \qquad \dot\gamma = \frac{g}{v} (n - \cos\gamma), \qquad
   h \ge H(x) + 60\,\mathrm{m}

Source: own statement; the setting of P. Lu and B. L. Pierson, Optimal aircraft terrain-following analysis and
trajectory generation, J. Guidance 18 (1995) 555-560.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

import gnc_opt as go
from problems._example import Reference, run

MASS, AREA, GRAVITY, DENSITY, THRUST = 12000.0, 28.0, 9.81, 1.1, 70e3
"""kg, m^2, m/s^2, kg/m^3, N."""
ZERO_LIFT_DRAG, INDUCED_DRAG = 0.025, 0.12
RIDGES = ((350.0, 4000.0, 900.0), (500.0, 8500.0, 1200.0))
"""Height, place and width, m."""
CLEARANCE, LENGTH, LOAD = 60.0, 12000.0, (-1.0, 4.0)
"""m, m, -."""


def terrain(x: Any) -> Any:
    """Return the height of the ground, m."""
    return sum(height * ca.exp(-(((x - place) / width) ** 2)) for height, place, width in RIDGES)


def build() -> go.Problem:
    """Return the problem."""
    aircraft = go.Model("aircraft")
    x, h = aircraft.state("x", unit="m"), aircraft.state("h", unit="m")
    v, gamma = aircraft.state("v", unit="m/s"), aircraft.state("gamma", unit="rad")
    n, throttle = aircraft.control("n"), aircraft.control("T")
    pressure_area = 0.5 * DENSITY * AREA * v**2
    drag = ZERO_LIFT_DRAG * pressure_area + INDUCED_DRAG * (n * MASS * GRAVITY) ** 2 / pressure_area
    aircraft.ode(
        {
            x: v * ca.cos(gamma),
            h: v * ca.sin(gamma),
            v: (THRUST * throttle - drag) / MASS - GRAVITY * ca.sin(gamma),
            gamma: GRAVITY / v * (n - ca.cos(gamma)),
        }
    )

    problem = go.Problem("terrain following")
    flight = problem.phase("flight", aircraft)
    flight.time(initial=0.0, final=(20.0, 120.0))
    flight.initial(x=0.0, h=100.0, v=230.0, gamma=0.0)
    flight.final(x=LENGTH, h=100.0, gamma=0.0)
    flight.bounds(h=(0.0, 2000.0), v=(120.0, 320.0), gamma=(-0.6, 0.6), n=LOAD, T=(0.0, 1.0))
    flight.path("clearance", h - terrain(x), lower=CLEARANCE)
    problem.minimize(flight.final_time)
    return problem


REFERENCE = Reference(42.05335, "independent Radau collocation, four meshes", 1.2e-04, "s")


def main(arguments: Sequence[str] | None = None) -> int:
    """Solve, compare, check; see ``python -m problems.aircraft.terrain_following --help``."""
    return run(build, REFERENCE, arguments, tol=1e-6)


if __name__ == "__main__":
    raise SystemExit(main())
