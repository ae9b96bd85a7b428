r"""Mountain car: a car with a weak engine gains energy by swinging.

This example shows a guess that oscillates: from a straight line, the solve on the first mesh finds no solution that
swings. The solution has as many swings as the guess, and the control switches between its bounds at the turning
points.

States: ``x``, ``v``. Control: ``u``.

.. math:: \dot x = v, \qquad \dot v = 0.001 u - 0.0025 \cos 3 x, \qquad -1 \le u \le 1

Source: A. W. Moore, Efficient memory-based learning for robot control, Cambridge 1990; the example ``mountain_car`` of
the Dymos documentation, which gives 102.479.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

SWINGS = 2.25
"""Of the guess."""


def build() -> go.Problem:
    """Return the problem."""
    car = go.Model("car")
    x, v, u = car.state("x"), car.state("v"), car.control("u")
    car.ode({x: v, v: 0.001 * u - 0.0025 * ca.cos(3 * x)})

    problem = go.Problem("mountain car")
    ride = problem.phase("ride", car)
    ride.time(initial=0.0, final=(5.0, 500.0))
    ride.initial(x=-0.5, v=0.0)
    ride.final(x=0.5, v=(0.0, None))
    ride.bounds(x=(-1.2, 0.5), v=(-0.07, 0.07), u=(-1.0, 1.0))
    share = np.linspace(0.0, 1.0, 60)
    swing = 2 * np.pi * SWINGS * share
    ride.guess(
        100.0 * share, x=0.5 * share * np.sin(swing) - 0.5, v=0.05 * share * np.cos(swing), u=np.sin(swing)
    )
    problem.minimize(ride.final_time)
    return problem


REFERENCE = Reference(102.3675, "independent Radau collocation, finest mesh 500 x 4", 2e-4, "s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
