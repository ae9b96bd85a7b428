r"""Orbit raising with eclipses: the fastest planar spiral with solar-electric thrust outside the Earth's shadow.

This example shows a control that has no effect over part of the flight: in the shadow any direction of thrust is
optimal. The shadow is a cylinder whose edge is smoothed over a twentieth of a radius.

States: ``r``, ``theta`` (rad), ``v_r``, ``v_t``; units of the Earth's radius and mu = 1. Control: vector ``u`` of
length at most 1, radial and tangential.

.. math::
   \dot v_r = \frac{v_t^2}{r} - \frac{1}{r^2} + A \sigma(r, \theta) u_r, \quad
   \dot v_t = -\frac{v_r v_t}{r} + A \sigma(r, \theta) u_t

.. math::
   \sigma = 1 - \tfrac14 \Big( 1 - \tanh\frac{r \cos\theta}{0.1} \Big)
   \Big( 1 + \tanh\frac{1 - r^2 \sin^2\theta}{0.1} \Big)

Source: own statement.
"""

from __future__ import annotations

import casadi as ca

import gnc_opt as go
from problems._example import Reference, example_main

ACCELERATION = 0.015
"""In units of gravity at the surface."""
START, TARGET = 1.8, 2.6
"""Radii, in radii of the Earth."""
EDGE = 0.1
"""Width of the edge of the shadow."""


def build() -> go.Problem:
    """Return the problem."""
    tug = go.Model("tug")
    r, theta = tug.state("r"), tug.state("theta", unit="rad")
    v_r, v_t = tug.state("v_r"), tug.state("v_t")
    u, _ = tug.vector_control("u", 2)
    behind = 0.5 * (1 - ca.tanh(r * ca.cos(theta) / EDGE))
    inside = 0.5 * (1 + ca.tanh((1 - (r * ca.sin(theta)) ** 2) / EDGE))
    push = ACCELERATION * (1 - behind * inside)
    tug.ode(
        {r: v_r, theta: v_t / r, v_r: v_t**2 / r - 1 / r**2 + push * u[0], v_t: -v_r * v_t / r + push * u[1]}
    )

    problem = go.Problem("orbit raising with eclipses", time_unit="√(R³/μ)")
    leg = problem.phase("transfer", tug)
    leg.time(initial=0.0, final=(5.0, 100.0))
    first, last = START**-0.5, TARGET**-0.5
    leg.initial(r=START, theta=0.0, v_r=0.0, v_t=first)
    leg.final(r=TARGET, v_r=0.0, v_t=last)
    leg.bounds(r=(1.2, 4.0))
    leg.norm_bounds(u=(0.0, 1.0))
    leg.guess(r=(START, TARGET), theta=(0.0, 4.0), v_t=(first, last), u=[0.0, 1.0])
    problem.minimize(leg.final_time)
    return problem


REFERENCE = Reference(13.782865, "independent Radau collocation, two meshes agree", 2.8e-5)


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
