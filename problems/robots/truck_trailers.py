r"""Truck with two trailers: parking by reversing, in little time and with small hitch angles.

This example shows local minima of a non-holonomic vehicle that differ in the number of reversals. The default call
from this guess may end in one 4 % worse; `gnc_opt.multistart` compares them.

States: last trailer ``x2``, ``y2`` (m), headings ``th0``, ``th1``, ``th2`` of truck and trailers (rad), speed ``v0``
(m/s), steering angle ``d0`` (rad). Controls: acceleration ``a`` (m/s^2), steering rate ``dd`` (rad/s).

.. math::
   \dot\theta_0 = \frac{v_0}{L_0} \tan\delta, \quad
   \dot\theta_1 = \frac{v_0}{L_1} \sin\beta_{01} - \frac{M_0}{L_1} \cos\beta_{01} \dot\theta_0

.. math::
   v_1 = v_0 \cos\beta_{01} + M_0 \sin\beta_{01} \dot\theta_0, \qquad
   J = t_f + \int \beta_{01}^2 + \beta_{12}^2 \, dt

with hitch angles :math:`\beta_{01} = \theta_0 - \theta_1`, :math:`\beta_{12} = \theta_1 - \theta_2`, and likewise for
the second trailer.

Source: the problem ``truck_trailer`` of OptimalControlProblems.jl, from arXiv 2303.16746, with continuous controls.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

WHEELBASE, FIRST_TRAILER, SECOND_TRAILER = 0.4, 1.1, 0.8
"""L_0, L_1, L_2, m."""
FIRST_HITCH, SECOND_HITCH = 0.1, 0.2
"""M_0, M_1: hitch behind the axle, m."""
MAX_SPEED, MAX_STEERING, MAX_ACCELERATION, MAX_STEERING_RATE = 0.2, np.pi / 6, 1.0, np.pi / 10
"""m/s, rad, m/s^2, rad/s."""


def build() -> go.Problem:
    """Return the problem."""
    truck = go.Model("truck")
    x2, y2 = truck.state("x2", unit="m"), truck.state("y2", unit="m")
    th0, th1, th2 = (truck.state(f"th{i}", unit="rad") for i in range(3))
    v0, d0 = truck.state("v0", unit="m/s"), truck.state("d0", unit="rad")
    a, dd = truck.control("a", unit="m/s^2"), truck.control("dd", unit="rad/s")
    hitch_1, hitch_2 = th0 - th1, th1 - th2
    turn_0 = v0 / WHEELBASE * ca.tan(d0)
    turn_1 = (v0 * ca.sin(hitch_1) - FIRST_HITCH * ca.cos(hitch_1) * turn_0) / FIRST_TRAILER
    v1 = v0 * ca.cos(hitch_1) + FIRST_HITCH * ca.sin(hitch_1) * turn_0
    turn_2 = (v1 * ca.sin(hitch_2) - SECOND_HITCH * ca.cos(hitch_2) * turn_1) / SECOND_TRAILER
    v2 = v1 * ca.cos(hitch_2) + SECOND_HITCH * ca.sin(hitch_2) * turn_1
    truck.ode(
        {x2: v2 * ca.cos(th2), y2: v2 * ca.sin(th2), th0: turn_0, th1: turn_1, th2: turn_2, v0: a, d0: dd}
    )

    problem = go.Problem("truck with two trailers")
    park = problem.phase("park", truck)
    park.time(initial=0.0, final=(5.0, 80.0))
    quarter = np.pi / 2
    park.initial(x2=0.0, y2=0.0, th0=0.0, th1=0.0, th2=0.0)
    park.final(x2=0.0, y2=-2.0, th0=quarter, th1=quarter, th2=quarter)
    park.bounds(v0=(-MAX_SPEED, MAX_SPEED), d0=(-MAX_STEERING, MAX_STEERING))
    park.bounds(a=(-MAX_ACCELERATION, MAX_ACCELERATION), dd=(-MAX_STEERING_RATE, MAX_STEERING_RATE))
    park.bounds(th0=(-quarter, quarter + 1), th1=(-quarter, quarter + 1))
    park.path("first hitch", hitch_1, lower=-quarter, upper=quarter)
    park.path("second hitch", hitch_2, lower=-quarter, upper=quarter)
    park.guess(v0=-MAX_SPEED)
    problem.minimize(park.final_time + park.integral(hitch_1**2 + hitch_2**2), unit="s")
    return problem


REFERENCE = Reference(46.8719, "independent Radau collocation, 140 x 4 points", 1e-3, "s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
