r"""Finite burns: an orbit transfer with two burns and the least velocity change.

The radius of the circular orbit grows to three times its value. This example shows phases with different states: the
acceleration of the thrust grows as propellant burns. It is not a state of the coasts, and a constraint between the
burns makes it continuous.

States: ``r``, ``theta``, ``v_r``, ``v_t``, thrust acceleration ``a`` (not while coasting) and velocity change
``spent``; canonical units. Control: angle ``u`` of the thrust above the local horizontal (rad). Exhaust speed c = 1.5.

.. math::
   \dot r = v_r, \quad \dot\theta = \frac{v_t}{r}, \quad \dot v_r = \frac{v_t^2}{r} - \frac{1}{r^2} + a \sin u, \quad
   \dot v_t = -\frac{v_r v_t}{r} + a \cos u, \quad \dot a = \frac{a^2}{c}, \quad \dot s = a

Source: the example ``finite_burn_orbit_raise`` of the Dymos documentation, after P. J. Enright and B. A. Conway,
Optimal finite-thrust spacecraft trajectories using collocation and nonlinear programming, J. Guidance 14 (1991)
981-985; 0.3995 published.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

EXHAUST_SPEED, FIRST_ACCELERATION, TARGET_RADIUS = 1.5, 0.1, 3.0
ANGLES = {"first_burn": np.radians(30.0), "coast": None, "second_burn": np.radians(90.0)}
"""Largest thrust angle by phase, rad; None without thrust."""


def spacecraft(name: str, thrusting: bool) -> go.Model:
    """Return the model of a phase."""
    model = go.Model(name)
    r = model.state("r")
    theta = model.state("theta", unit="rad")
    v_r, v_t = model.state("v_r"), model.state("v_t")
    spent = model.state("spent")
    rates = {r: v_r, theta: v_t / r, v_r: v_t**2 / r - 1 / r**2, v_t: -v_r * v_t / r, spent: 0.0}
    if thrusting:
        a, u = model.state("a"), model.control("u", unit="rad")
        rates[v_r] += a * ca.sin(u)
        rates[v_t] += a * ca.cos(u)
        rates |= {spent: a, a: a**2 / EXHAUST_SPEED}
    model.ode(rates)
    return model


def build() -> go.Problem:
    """Return the problem."""
    problem = go.Problem("orbit raising by finite burns", time_unit="√(r³/μ)")
    legs = []
    for name, angle in ANGLES.items():
        leg = problem.phase(name, spacecraft(name, angle is not None))
        leg.bounds(r=(0.5, 5.0))
        if angle is not None:
            leg.bounds(u=(-angle, angle))
        legs.append(leg)
    first, coast, second = legs
    first.time(initial=0.0, duration=(0.5, 10.0))
    coast.time(initial=None, duration=(0.5, 50.0))
    second.time(initial=None, duration=(0.5, 10.0))
    problem.link(first, coast)
    problem.link(coast, second)
    problem.constrain("same acceleration", second.initial_state("a") - first.final_state("a"), equals=0.0)
    first.initial(r=1.0, theta=0.0, v_r=0.0, v_t=1.0, a=FIRST_ACCELERATION, spent=0.0)
    second.final(r=TARGET_RADIUS, v_r=0.0, v_t=np.sqrt(1 / TARGET_RADIUS))
    problem.minimize(second.final_state("spent"))
    return problem


REFERENCE = Reference(0.39948783, "independent Radau collocation, two meshes agree; 0.3995 published", 8e-7)


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
