r"""Belly flop: a rocket that falls on its side turns upright and lands with minimum propellant.

This example shows rotation under a gimbal in the plane: the engine that turns the vehicle also accelerates it
sideways, and the thrust has a lower limit.

States: ``x``, ``z`` (m), ``vx``, ``vz`` (m/s), tilt ``theta`` from the vertical (rad), ``q`` (rad/s), ``m`` (kg).
Controls: thrust ``T`` (N), gimbal ``delta`` (rad).

.. math::
   m \ddot x = -T \sin(\theta + \delta) - D v_x, \quad m \ddot z = T \cos(\theta + \delta) - D v_z - m g, \quad
   J \dot q = -l T \sin\delta, \qquad D = k (1 + c \sin^2 \theta) \|v\|

Source: own statement with numbers of the size of a Starship test vehicle.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

GRAVITY, EXHAUST_SPEED = 9.81, 330.0 * 9.80665
"""m/s^2, m/s."""
THRUST, GIMBAL, ARM = (880e3, 4400e3), float(np.radians(15.0)), 20.0
"""N, rad, m."""
START_MASS, INERTIA = 120e3, 120e3 * 50.0**2 / 12
"""kg, kg m^2."""
SLENDER_DRAG, SIDE = 40.0, 7.0
"""Drag per speed squared along the axis (kg/m), and what is added across it over that."""


def build() -> go.Problem:
    """Return the problem."""
    ship = go.Model("ship")
    x, z = ship.state("x", unit="m"), ship.state("z", unit="m")
    vx, vz = ship.state("vx", unit="m/s"), ship.state("vz", unit="m/s")
    theta, q = ship.state("theta", unit="rad"), ship.state("q", unit="rad/s")
    m = ship.state("m", unit="kg")
    thrust, delta = ship.control("T", unit="N"), ship.control("delta", unit="rad")
    drag = SLENDER_DRAG * (1 + SIDE * ca.sin(theta) ** 2) * ca.sqrt(vx**2 + vz**2 + 0.01)
    ship.ode(
        {
            x: vx,
            z: vz,
            vx: (-thrust * ca.sin(theta + delta) - drag * vx) / m,
            vz: (thrust * ca.cos(theta + delta) - drag * vz) / m - GRAVITY,
            theta: q,
            q: -ARM * thrust * ca.sin(delta) / INERTIA,
            m: -thrust / EXHAUST_SPEED,
        }
    )

    problem = go.Problem("belly flop")
    landing = problem.phase("landing", ship)
    landing.time(initial=0.0, final=(5.0, 30.0))
    landing.initial(x=0.0, z=700.0, vx=0.0, vz=-75.0, theta=np.pi / 2, q=0.0, m=START_MASS)
    landing.final(z=0.0, vx=0.0, vz=-1.0, theta=0.0, q=0.0)
    landing.bounds(x=(-500.0, 500.0), z=(0.0, 800.0), vx=(-100.0, 100.0), vz=(-120.0, 20.0))
    landing.bounds(theta=(-1.0, 2.0), q=(-1.0, 1.0), m=(90e3, START_MASS), T=THRUST, delta=(-GIMBAL, GIMBAL))
    problem.maximize(landing.final_state("m"))
    return problem


REFERENCE = Reference(114332.19, "independent Radau collocation, converges to it", 0.1, "kg")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
