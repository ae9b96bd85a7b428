r"""Heading reversal: the fastest turn of a fighter by 180 degrees.

The turn ends at its initial altitude with nearly its initial speed. This example shows the corner speed: below it the
lift limit is active, above it the load limit. The fastest turn slows down to it. The lift limit couples load factor,
speed and altitude.

States: ``v`` (m/s), ``gamma``, ``chi`` (rad), ``h`` (m). Controls: load factor ``n``, bank ``mu`` (rad). Thrust is
full, and falls with density to the power 0.7.

.. math::
   \dot v = \frac{T - D}{m} - g \sin\gamma, \quad
   \dot\gamma = \frac{g}{v} (n \cos\mu - \cos\gamma), \quad \dot\chi = \frac{g n \sin\mu}{v \cos\gamma}, \quad
   \dot h = v \sin\gamma

.. math:: n \le 7, \qquad C_L = \frac{n m g}{q S} \le 1.3, \qquad q \le 45\,\mathrm{kPa}

Source: after H. Seywald, E. M. Cliff and K. H. Well, Range optimal trajectories for an aircraft flying in the vertical
plane, J. Guidance 17 (1994) 389-398, and related turns, with own numbers.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MASS, AREA, GRAVITY = 12000.0, 28.0, 9.81
"""kg, m^2, m/s^2."""
SEA_LEVEL_DENSITY, SCALE_HEIGHT, SEA_LEVEL_THRUST = 1.225, 9000.0, 90e3
"""kg/m^3, m, N."""
ZERO_LIFT_DRAG, INDUCED_DRAG = 0.022, 0.14
MAX_LOAD, MAX_LIFT, MAX_PRESSURE = 7.0, 1.3, 45e3
"""-, -, Pa."""
ALTITUDE = 5000.0
"""m."""


def build() -> go.Problem:
    """Return the problem."""
    fighter = go.Model("fighter")
    v = fighter.state("v", unit="m/s")
    gamma = fighter.state("gamma", unit="rad")
    chi = fighter.state("chi", unit="rad")
    h = fighter.state("h", unit="m")
    n, mu = fighter.control("n"), fighter.control("mu", unit="rad")
    density = SEA_LEVEL_DENSITY * ca.exp(-h / SCALE_HEIGHT)
    pressure = 0.5 * density * v**2
    c_l = n * MASS * GRAVITY / (pressure * AREA)
    drag = pressure * AREA * (ZERO_LIFT_DRAG + INDUCED_DRAG * c_l**2)
    thrust = SEA_LEVEL_THRUST * (density / SEA_LEVEL_DENSITY) ** 0.7
    fighter.ode(
        {
            v: (thrust - drag) / MASS - GRAVITY * ca.sin(gamma),
            gamma: GRAVITY / v * (n * ca.cos(mu) - ca.cos(gamma)),
            chi: GRAVITY * n * ca.sin(mu) / (v * ca.cos(gamma)),
            h: v * ca.sin(gamma),
        }
    )

    problem = go.Problem("heading reversal")
    turn = problem.phase("turn", fighter)
    turn.time(initial=0.0, final=(3.0, 60.0))
    turn.initial(v=250.0, gamma=0.0, chi=0.0, h=ALTITUDE)
    turn.final(v=230.0, gamma=0.0, chi=np.pi, h=ALTITUDE)
    turn.bounds(v=(80.0, 450.0), gamma=(-1.4, 1.4), chi=(-0.5, 4.0), h=(3000.0, 12000.0))
    turn.bounds(n=(0.0, MAX_LOAD), mu=(-np.pi, np.pi))
    turn.path("lift coefficient", c_l, upper=MAX_LIFT)
    turn.path("dynamic pressure", pressure, upper=MAX_PRESSURE)
    turn.guess(n=3.0, mu=1.2)
    problem.minimize(turn.final_time)
    return problem


REFERENCE = Reference(18.6593858, "independent Radau collocation, two meshes agree", 1.8e-5, "s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
