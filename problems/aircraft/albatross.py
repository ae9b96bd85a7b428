r"""Albatross: dynamic soaring in the weakest possible wind.

This example shows a periodic problem with a free parameter. Speed, climb, heading and height repeat after each cycle,
the position does not. The parameter, the wind at 10 m, is minimised. The bird gains energy from the wind shear over
the sea.

States: airspeed ``v`` (m/s), ``gamma``, heading ``chi`` from the wind's direction (rad), ``h`` (m). Controls: ``C_L``,
bank ``mu`` (rad). Parameter: wind ``W10`` at 10 m (m/s).

.. math::
   \dot v = -\frac{D}{m} - g \sin\gamma - \dot W \cos\gamma \cos\chi, \qquad
   v \dot\gamma = \frac{L \cos\mu}{m} - g \cos\gamma + \dot W \sin\gamma \cos\chi

.. math::
   v \cos\gamma \, \dot\chi = \frac{L \sin\mu}{m} + \dot W \sin\chi, \qquad
   W = W_{10} \frac{\ln(h / h_0)}{\ln(10\,\mathrm{m} / h_0)}, \qquad \dot h = v \sin\gamma

Source: G. Sachs, Minimum shear wind strength required for dynamic soaring of albatrosses, Ibis 147 (2005) 1-10, which
gives 8.6 m/s for a bird of 8.5 kg with 3.4 m span.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MASS, AREA, GRAVITY, DENSITY = 8.5, 0.65, 9.81, 1.225
"""kg, m^2, m/s^2, kg/m^3."""
ZERO_LIFT_DRAG, INDUCED_DRAG = 0.033, 0.019
ROUGHNESS, LOWEST = 0.03, 1.5
"""h_0 and the least height, m."""


def build() -> go.Problem:
    """Return the problem."""
    bird = go.Model("albatross")
    v = bird.state("v", unit="m/s")
    gamma = bird.state("gamma", unit="rad")
    chi = bird.state("chi", unit="rad")
    h = bird.state("h", unit="m")
    c_l, mu = bird.control("C_L"), bird.control("mu", unit="rad")
    wind = bird.parameter("W10", 9.0, unit="m/s")
    climb = v * ca.sin(gamma)
    wind_rate = wind / np.log(10.0 / ROUGHNESS) / h * climb
    pressure = 0.5 * DENSITY * AREA * v**2 / MASS
    lift, drag = pressure * c_l, pressure * (ZERO_LIFT_DRAG + INDUCED_DRAG * c_l**2)
    bird.ode(
        {
            v: -drag - GRAVITY * ca.sin(gamma) - wind_rate * ca.cos(gamma) * ca.cos(chi),
            gamma: (lift * ca.cos(mu) - GRAVITY * ca.cos(gamma) + wind_rate * ca.sin(gamma) * ca.cos(chi))
            / v,
            chi: (lift * ca.sin(mu) + wind_rate * ca.sin(chi)) / (v * ca.cos(gamma)),
            h: climb,
        }
    )

    problem = go.Problem("albatross")
    weakest = problem.parameter("W10", lower=1.0, upper=30.0, guess=10.0, unit="m/s")
    cycle = problem.phase("cycle", bird)
    cycle.time(initial=0.0, final=(3.0, 15.0))
    cycle.initial(h=LOWEST)
    cycle.bounds(v=(5.0, 40.0), gamma=(-1.2, 1.2), chi=(-np.pi, 2 * np.pi), h=(LOWEST, 40.0))
    cycle.bounds(C_L=(0.0, 1.5), mu=(-1.4, 1.4))
    for name in bird.states.names:
        change = cycle.final_state(name) - cycle.initial_state(name)
        problem.constrain(f"{name} repeats", change, equals=0.0)
    share = np.linspace(0.0, 1.0, 41)
    turn, up = 2 * np.pi * share, np.sin(np.pi * share) ** 2
    cycle.guess(
        7.0 * share,
        v=15.0 - 4.0 * up,
        gamma=0.5 * np.sin(turn),
        chi=np.pi / 2 + np.cos(turn),
        h=LOWEST + 6.0 * up,
        C_L=0.9,
        mu=-0.8 * np.sin(turn),
    )
    problem.minimize(weakest)
    return problem


REFERENCE = Reference(8.565601, "independent Radau collocation, three meshes agree", 1.7e-5, "m/s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
