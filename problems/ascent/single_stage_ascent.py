r"""Single stage to orbit: the fastest ascent with constant thrust.

This example shows a smooth problem that needs no refinement of structure: the thrust angle alone steers, and its
tangent changes almost linearly in time.

States: ``x``, ``y`` (m), ``v_x``, ``v_y`` (m/s), ``m`` (kg). Control: thrust angle ``theta`` above the horizon (rad).

.. math::
   \dot v_x = \frac{F \cos\theta - D_0 e^{-y/h_0} v_x^2}{m}, \quad
   \dot v_y = \frac{F \sin\theta - D_0 e^{-y/h_0} v_y^2}{m} - g, \quad \dot m = -\frac{F}{g I_{sp}}

Source: the example ``ssto`` of the Dymos documentation, after J. M. Longuski, J. J. Guzman and J. E. Prussing, Optimal
Control with Aerospace Applications, Springer 2014, section 4.6.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

THRUST, ISP, GRAVITY = 2.1e6, 265.2, 9.80665
"""N, s, m/s^2."""
DRAG = 0.5 * 1.225 * 0.5 * 7.069
"""Drag at sea level per speed squared, kg/m."""
SCALE_HEIGHT = 8440.0
"""m."""
ALTITUDE, SPEED = 185e3, 7796.6961
"""Of the orbit; m, m/s."""


def build() -> go.Problem:
    """Return the problem."""
    rocket = go.Model("rocket")
    x, y = rocket.state("x", unit="m"), rocket.state("y", unit="m")
    v_x, v_y = rocket.state("v_x", unit="m/s"), rocket.state("v_y", unit="m/s")
    m = rocket.state("m", unit="kg")
    theta = rocket.control("theta", unit="rad")
    drag = DRAG * ca.exp(-y / SCALE_HEIGHT)
    rocket.ode(
        {
            x: v_x,
            y: v_y,
            v_x: (THRUST * ca.cos(theta) - drag * v_x**2) / m,
            v_y: (THRUST * ca.sin(theta) - drag * v_y**2) / m - GRAVITY,
            m: -THRUST / (GRAVITY * ISP),
        }
    )

    problem = go.Problem("single stage to orbit")
    ascent = problem.phase("ascent", rocket)
    ascent.time(initial=0.0, final=(10.0, 500.0))
    ascent.initial(x=0.0, y=0.0, v_x=0.0, v_y=0.0, m=117000.0)
    ascent.final(y=ALTITUDE, v_x=SPEED, v_y=0.0)
    ascent.bounds(theta=(-np.pi / 2, np.pi / 2), m=(1000.0, None))
    problem.minimize(ascent.final_time)
    return problem


REFERENCE = Reference(143.580538, "independent Radau collocation, three meshes agree", 1e-4, "s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
