r"""Cannonball: size of the ball and elevation for the longest range.

The energy of the powder is given. This example shows a static parameter that is optimised together with the flight,
through dynamics and a boundary constraint, and phases that end at an event, here the top of the trajectory. A large
ball is slow because of its mass, and a small one because of its drag.

States: ``r``, ``h`` (m), ``v`` (m/s), ``gamma`` (rad). Parameter: ``radius`` (m) of the iron ball. No control.

.. math::
   \dot r = v \cos\gamma, \quad \dot h = v \sin\gamma, \quad \dot v = -\frac{D}{m} - g \sin\gamma, \quad
   \dot\gamma = -\frac{g \cos\gamma}{v}, \qquad \tfrac12 m v(0)^2 \le 400\,\mathrm{kJ}

Source: the two-phase cannonball of the Dymos documentation (3183.25 m, of another table of the air).
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

GRAVITY, IRON, DRAG_COEFFICIENT = 9.80665, 7870.0, 0.5
"""m/s^2, kg/m^3, -."""
ENERGY = 4e5
"""Of the powder, J."""


def mass_of(radius: Any) -> Any:
    """Return the mass of an iron ball, kg."""
    return 4 / 3 * np.pi * IRON * radius**3


def build(energy: float = ENERGY) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    energy : float
        Kinetic energy at the muzzle, J.
    """
    ball = go.Model("cannonball")
    r, h = ball.state("r", unit="m"), ball.state("h", unit="m")
    v, gamma = ball.state("v", unit="m/s"), ball.state("gamma", unit="rad")
    radius = ball.parameter("radius", 0.05, unit="m")
    density = 1.225 * (1 - 2.25577e-5 * h) ** 4.2558797
    drag = 0.5 * density * v**2 * DRAG_COEFFICIENT * np.pi * radius**2
    ball.ode(
        {
            r: v * ca.cos(gamma),
            h: v * ca.sin(gamma),
            v: -drag / mass_of(radius) - GRAVITY * ca.sin(gamma),
            gamma: -GRAVITY * ca.cos(gamma) / v,
        }
    )

    problem = go.Problem("cannonball")
    chosen = problem.parameter("radius", lower=0.01, upper=0.10, guess=0.05, unit="m")
    ascent, descent = (problem.phase(name, ball) for name in ("ascent", "descent"))
    ascent.time(initial=0.0, final=(1.0, 100.0))
    descent.time(initial=(0.5, 100.0), final=(0.5, 100.0))
    ascent.initial(r=0.0, h=0.0)
    ascent.final(gamma=0.0)
    descent.final(h=0.0)
    for leg in (ascent, descent):
        leg.bounds(v=(1.0, 2000.0), gamma=(-1.6, 1.6), h=(0.0, 20000.0))
    problem.link(ascent, descent)
    problem.constrain("energy", 0.5 * mass_of(chosen) * ascent.initial_state("v") ** 2, upper=energy)
    problem.maximize(descent.final_state("r"))
    return problem


REFERENCE = Reference(
    3183.37582219, "independent: flights integrated, best of all radii and angles", 1e-6, "m"
)


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
