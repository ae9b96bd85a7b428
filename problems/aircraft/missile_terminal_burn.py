r"""Missile terminal burn: the fastest low flight that ends in a vertical dive.

This example shows a constraint that applies to part of the flight and therefore needs two phases: the missile stays
above 30 m until 7.5 km, then climbs and dives. The load factor couples angle of attack, speed and altitude in a path
constraint. Full thrust is optimal almost throughout.

States: ``gamma`` (rad), ``v`` (m/s), ``x``, ``h`` (m). Controls: thrust ``T`` (N), angle of attack ``alpha`` (rad).

.. math::
   \dot\gamma = \frac{(T - D) \sin\alpha + L \cos\alpha}{m v} - \frac{g \cos\gamma}{v}, \quad
   \dot v = \frac{(T - D) \cos\alpha - L \sin\alpha}{m} - g \sin\gamma, \quad
   \dot x = v \cos\gamma, \quad \dot h = v \sin\gamma

.. math:: -4 \le L / (m g) \le 4, \qquad h \ge 30\,\mathrm{m} \text{ for } x \le 7500\,\mathrm{m}

Source: S. Subchan and R. Zbikowski, Computational Optimal Control: Tools and Practice, Wiley 2009; the example
``missile`` of PSOPT. The step of the least altitude is stated as the end of a phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MASS, GRAVITY, AREA = 1005.0, 9.81, 0.3376
"""kg, m/s^2, m^2."""
DRAG = (0.2359, -0.1499, -1.9431)
"""Coefficients of 1, alpha, alpha^2."""
LIFT_SLOPE = 21.9
"""1/rad."""
DENSITY = (1.224, -1.142e-4, 3.312e-9)
"""Coefficients of 1, h, h^2; kg/m^3."""
THRUST = (1000.0, 6000.0)
"""N."""
LOAD = 4.0
"""Largest load factor."""
CRUISE_ALTITUDE, CRUISE_RANGE, TARGET = 30.0, 7500.0, 10000.0
"""Least altitude, where it ends, range of the target; m."""


def polynomial(coefficients: Sequence[float], x: Any) -> Any:
    """Return the sum of coefficients times powers of x."""
    return sum(c * x**k for k, c in enumerate(coefficients))


def missile(name: str) -> tuple[go.Model, Any]:
    """Return the model and its load factor."""
    model = go.Model(name)
    gamma = model.state("gamma", unit="rad")
    v = model.state("v", unit="m/s")
    x = model.state("x", unit="m")
    h = model.state("h", unit="m")
    thrust = model.control("T", unit="N")
    alpha = model.control("alpha", unit="rad")
    pressure_area = 0.5 * polynomial(DENSITY, h) * v**2 * AREA
    lift, drag = pressure_area * LIFT_SLOPE * alpha, pressure_area * polynomial(DRAG, alpha)
    along = (thrust - drag) * ca.cos(alpha) - lift * ca.sin(alpha)
    across = (thrust - drag) * ca.sin(alpha) + lift * ca.cos(alpha)
    model.ode(
        {
            gamma: across / (MASS * v) - GRAVITY * ca.cos(gamma) / v,
            v: along / MASS - GRAVITY * ca.sin(gamma),
            x: v * ca.cos(gamma),
            h: v * ca.sin(gamma),
        }
    )
    return model, lift / (MASS * GRAVITY)


def build() -> go.Problem:
    """Return the problem."""
    problem = go.Problem("missile terminal burn")
    legs = []
    for name, least_altitude in (("cruise", CRUISE_ALTITUDE), ("attack", 0.0)):
        model, load = missile(name)
        leg = problem.phase(name, model)
        leg.bounds(gamma=(-np.pi / 2, np.pi / 2), v=(200.0, 310.0), x=(0.0, TARGET))
        leg.bounds(h=(least_altitude, 1900.0), T=THRUST, alpha=(-0.3, 0.3))
        leg.path("load factor", load, lower=-LOAD, upper=LOAD)
        legs.append(leg)
    cruise, attack = legs
    problem.sequence(cruise, attack, durations={"cruise": (5.0, 60.0), "attack": (1.0, 60.0)})
    cruise.initial(gamma=0.0, v=272.0, x=0.0, h=CRUISE_ALTITUDE)
    cruise.final(x=CRUISE_RANGE)
    attack.final(gamma=-np.pi / 2, v=310.0, x=TARGET, h=0.0)
    problem.minimize(attack.final_time)
    return problem


REFERENCE = Reference(40.911939, "independent Radau collocation, two meshes agree", 8e-5, "s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
