r"""Missile with a seeker: an intercept at a given angle within a limited field of view.

This example shows a limit of first order on the angle between velocity and line of sight, with a terminal impact
angle. The control energy is minimised.

States: missile ``x``, ``y`` (km), course ``gamma`` (rad). Control: ``a``, lateral acceleration (g).

.. math::
   \dot x = V \cos\gamma, \quad \dot y = V \sin\gamma, \quad \dot\gamma = \frac{a g}{V}, \qquad
   \Big| \operatorname{atan2}(y_T - y, x_T - x) - \gamma \Big| \le 30°, \qquad J = \int a^2 \, dt

The target moves along x; the intercept time is free.

Source: own statement; the setting of B. G. Park, T. H. Kim and M. J. Tahk, Optimal impact angle control guidance law
considering the seeker's field-of-view limits, Proc. IMechE G 227 (2013) 1347-1364.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

SPEED, TARGET_SPEED, GRAVITY = 0.3, 0.02, 9.81e-3
"""km/s, km/s, km/s^2."""
TARGET, IMPACT = (9.0, 0.0), float(np.radians(-90.0))
"""First place of the target, km; course at the hit, rad."""
FIELD_OF_VIEW, MAX_ACCELERATION = float(np.radians(30.0)), 10.0
"""rad, g."""
RANGE_SCALE = 0.02
"""The angle is limited as long as the target is farther than this, km: its cosine is compared."""


def build(field_of_view: float = FIELD_OF_VIEW) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    field_of_view : float
        Half angle of the field of view, rad.
    """
    missile = go.Model("missile")
    x, y = missile.state("x", unit="km"), missile.state("y", unit="km")
    gamma = missile.state("gamma", unit="rad")
    a = missile.control("a", unit="g")
    missile.ode({x: SPEED * ca.cos(gamma), y: SPEED * ca.sin(gamma), gamma: a * GRAVITY / SPEED})
    to_x, to_y = TARGET[0] + TARGET_SPEED * missile.time - x, TARGET[1] - y
    distance = ca.sqrt(to_x**2 + to_y**2 + RANGE_SCALE**2)
    ahead = to_x * ca.cos(gamma) + to_y * ca.sin(gamma)

    problem = go.Problem("missile with a seeker")
    flight = problem.phase("flight", missile)
    flight.time(initial=0.0, final=(25.0, 80.0))
    flight.initial(x=0.0, y=3.0, gamma=0.0)
    flight.final(gamma=IMPACT)
    flight.bounds(x=(-1.0, 14.0), y=(-1.0, 8.0), gamma=(-2.5, 1.5), a=(-MAX_ACCELERATION, MAX_ACCELERATION))
    flight.path("field of view", ahead - distance * np.cos(field_of_view), lower=-RANGE_SCALE)
    hit = flight.final_state("x") - TARGET[0] - TARGET_SPEED * flight.final_time
    problem.constrain("hit along", hit, equals=0.0)
    problem.constrain("hit across", flight.final_state("y") - TARGET[1], equals=0.0)
    problem.minimize(flight.integral(a**2), unit="g^2 s")
    return problem


REFERENCE = Reference(136.02461, "independent Radau collocation, converges to it", 0.00014, "g^2 s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
