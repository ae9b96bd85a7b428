r"""Turn back after engine failure: a glide back to the runway with minimum loss of height.

The engine has failed after take-off. This example shows a glide in which speed, bank and position are optimised
together: a steep turn loses height quickly but is short. The lift coefficient is limited, and the end must lie on the
runway's line in the opposite direction.

States: ``x``, ``y``, ``h`` (m), ``v`` (m/s), ``gamma``, ``chi`` (rad). Controls: ``C_L``, bank ``mu`` (rad).

.. math::
   \dot v = -\frac{D}{m} - g \sin\gamma, \quad v \dot\gamma = \frac{L \cos\mu}{m} - g \cos\gamma, \quad
   v \cos\gamma \, \dot\chi = \frac{L \sin\mu}{m}

Source: own statement; the manoeuvre of D. F. Rogers, The possible "impossible" turn, J. Aircraft 32 (1995) 392-397.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MASS, AREA, GRAVITY, DENSITY = 1100.0, 16.2, 9.81, 1.225
"""kg, m^2, m/s^2, kg/m^3."""
ZERO_LIFT_DRAG, INDUCED_DRAG, MAX_LIFT, MAX_BANK = 0.035, 0.054, 1.3, float(np.radians(60.0))
"""-, -, -, rad."""
START_HEIGHT, START_SPEED, START_DISTANCE = 300.0, 38.0, 1200.0
"""m, m/s, m from the runway's near end."""


def build() -> go.Problem:
    """Return the problem."""
    aircraft = go.Model("light aircraft")
    x, y, h = (aircraft.state(name, unit="m") for name in ("x", "y", "h"))
    v = aircraft.state("v", unit="m/s")
    gamma, chi = aircraft.state("gamma", unit="rad"), aircraft.state("chi", unit="rad")
    c_l, mu = aircraft.control("C_L"), aircraft.control("mu", unit="rad")
    pressure = 0.5 * DENSITY * AREA * v**2 / MASS
    lift, drag = pressure * c_l, pressure * (ZERO_LIFT_DRAG + INDUCED_DRAG * c_l**2)
    aircraft.ode(
        {
            x: v * ca.cos(gamma) * ca.cos(chi),
            y: v * ca.cos(gamma) * ca.sin(chi),
            h: v * ca.sin(gamma),
            v: -drag - GRAVITY * ca.sin(gamma),
            gamma: (lift * ca.cos(mu) - GRAVITY * ca.cos(gamma)) / v,
            chi: lift * ca.sin(mu) / (v * ca.cos(gamma)),
        }
    )

    problem = go.Problem("turn back after engine failure")
    turn = problem.phase("turn", aircraft)
    turn.time(initial=0.0, final=(20.0, 120.0))
    turn.initial(x=START_DISTANCE, y=0.0, h=START_HEIGHT, v=START_SPEED, gamma=0.08, chi=0.0)
    turn.final(x=0.0, y=0.0, chi=np.pi, gamma=(-0.15, 0.0), v=(33.0, None))
    turn.bounds(x=(-500.0, 3000.0), y=(-1500.0, 1500.0), v=(25.0, 60.0), gamma=(-0.6, 0.4), chi=(-1.0, 5.0))
    turn.bounds(C_L=(0.0, MAX_LIFT), mu=(-MAX_BANK, MAX_BANK))
    turn.guess(
        [0.0, 20.0, 60.0],
        x=[START_DISTANCE, 1300.0, 0.0],
        y=[0.0, 250.0, 0.0],
        h=[START_HEIGHT, 200.0, 100.0],
        chi=[0.0, 2.5, np.pi],
        gamma=-0.1,
        C_L=0.9,
        mu=[0.7, 0.5, 0.0],
    )
    problem.maximize(turn.final_state("h"))
    return problem


REFERENCE = Reference(165.28537, "independent Radau collocation, converges to it", 0.00017, "m")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
