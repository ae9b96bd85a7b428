r"""Quadrotor in space: minimum-time flight with limits of tilt and attitude rates.

The quadrotor flies 5 m to the side. This example shows bang arcs shorter than a segment: thrust and two attitude
rates switch at their bounds while the tilt limit is active, and refinement finds the order of the switches.

States: ``p`` (m), ``v`` (m/s), roll ``phi``, pitch ``theta`` (rad). Controls: specific thrust ``a`` (m/s^2), rates
``dphi``, ``dtheta`` (rad/s).

.. math::
   \dot p = v, \quad
   \dot v = a \, (\sin\theta \cos\phi, \; -\sin\phi, \; \cos\theta \cos\phi)^T - g e_z, \qquad
   \cos\theta \cos\phi \ge \cos 0.55

Source: the problem ``quadrotor`` of OptimalControlProblems.jl, from A. Sathya and others, arXiv 2303.16746.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

GRAVITY = 9.81
"""m/s^2."""
MAX_THRUST, MAX_RATE, MAX_TILT = 5 * 9.18, 3.0, 0.55
"""m/s^2, rad/s, rad."""


def build() -> go.Problem:
    """Return the problem."""
    quadrotor = go.Model("quadrotor")
    p = quadrotor.state("p", 3, unit="m")
    v = quadrotor.state("v", 3, unit="m/s")
    phi = quadrotor.state("phi", unit="rad")
    theta = quadrotor.state("theta", unit="rad")
    a = quadrotor.control("a", unit="m/s^2")
    dphi = quadrotor.control("dphi", unit="rad/s")
    dtheta = quadrotor.control("dtheta", unit="rad/s")
    upright = ca.cos(theta) * ca.cos(phi)
    axis = ca.vertcat(ca.sin(theta) * ca.cos(phi), -ca.sin(phi), upright)
    quadrotor.ode({p: v, v: a * axis - ca.DM([0.0, 0.0, GRAVITY]), phi: dphi, theta: dtheta})

    problem = go.Problem("quadrotor in space")
    flight = problem.phase("flight", quadrotor)
    flight.time(initial=0.0, final=(0.5, 10.0))
    flight.initial(p=[0.0, 0.0, 2.5], v=np.zeros(3), phi=0.0, theta=0.0)
    flight.final(p=[0.01, 5.0, 2.5], v=np.zeros(3))
    flight.bounds(a=(0.0, MAX_THRUST), dphi=(-MAX_RATE, MAX_RATE), dtheta=(-MAX_RATE, MAX_RATE))
    flight.bounds(phi=(-np.pi / 2, np.pi / 2), theta=(-np.pi / 2, np.pi / 2))
    flight.path("tilt", upright, lower=np.cos(MAX_TILT))
    problem.minimize(flight.final_time)
    return problem


REFERENCE = Reference(1.4921412, "independent Radau collocation, finest mesh 700 x 3", 1.5e-6, "s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
