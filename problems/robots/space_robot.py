r"""Space robot: a minimum-time motion of an arm on a free-floating base.

The arm moves from one pose to another, and the base ends upright. This example shows dynamics with a non-holonomic
constraint: angular momentum is zero, so that the base turns with the joints, and two joints control three angles.
Accelerations of the joints are the controls.

States: base attitude ``phi``, joint angles ``q1``, ``q2`` (rad), rates ``w1``, ``w2`` (rad/s). Controls: ``a1``, ``a2``
(rad/s^2).

.. math::
   \dot\phi = -\frac{m_1 w_1 + m_2 (w_1 + w_2)}{m_0 + m_1 + m_2}, \qquad m_j = \sum_i M_{ij}(q_1, q_2), \qquad
   \ddot q = a

with the matrix M of the kinetic energy in the rates of the absolute angles of base and links; see `base_rate`.

Source: own statement; equations as in Y. Nakamura and R. Mukherjee, Nonholonomic path planning of space robots via a
bidirectional approach, IEEE Trans. Robotics and Automation 7 (1991) 500-514.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

import gnc_opt as go
from problems._example import Reference, example_main

MASSES, INERTIAS = (40.0, 4.0, 3.0), (6.667, 0.333, 0.25)
"""Of base, first and second link; kg, kg m^2."""
JOINT, LINK = 0.5, 1.0
"""From the base's centre to the first joint, and length of each link; m."""
MAX_ACCELERATION, MAX_RATE, MAX_ANGLE = 0.2, 0.8, 2.6
"""rad/s^2, rad/s, rad."""


def base_rate(q1: Any, q2: Any, w1: Any, w2: Any) -> Any:
    """Return the rate of the base at which the angular momentum about the centre of mass is zero."""
    angles = ca.SX.sym("angles", 3)
    arms = [ca.vertcat(ca.cos(angles[i]), ca.sin(angles[i])) for i in range(3)]
    joint = JOINT * arms[0]
    elbow = joint + LINK * arms[1]
    centres = [ca.SX.zeros(2), joint + LINK / 2 * arms[1], elbow + LINK / 2 * arms[2]]
    common = sum(m * c for m, c in zip(MASSES, centres, strict=True)) / sum(MASSES)
    energy = ca.diag(ca.DM(INERTIAS))
    for mass, centre in zip(MASSES, centres, strict=True):
        slope = ca.jacobian(centre - common, angles)
        energy += mass * slope.T @ slope
    momenta = ca.Function("momenta", [angles], [ca.sum1(energy)])
    per_rate = momenta(ca.vertcat(0.0, q1, q1 + q2))  # the same at any attitude of the base
    return -(per_rate[1] * w1 + per_rate[2] * (w1 + w2)) / ca.sum2(per_rate)


def build() -> go.Problem:
    """Return the problem."""
    robot = go.Model("space robot")
    phi = robot.state("phi", unit="rad")
    q1, q2 = robot.state("q1", unit="rad"), robot.state("q2", unit="rad")
    w1, w2 = robot.state("w1", unit="rad/s"), robot.state("w2", unit="rad/s")
    a1, a2 = robot.control("a1", unit="rad/s^2"), robot.control("a2", unit="rad/s^2")
    robot.ode({phi: base_rate(q1, q2, w1, w2), q1: w1, q2: w2, w1: a1, w2: a2})

    problem = go.Problem("space robot")
    reach = problem.phase("reach", robot)
    reach.time(initial=0.0, final=(1.0, 60.0))
    reach.initial(phi=0.0, q1=0.3, q2=0.8, w1=0.0, w2=0.0)
    reach.final(phi=0.0, q1=1.5, q2=-0.9, w1=0.0, w2=0.0)
    limit = (-MAX_ACCELERATION, MAX_ACCELERATION)
    reach.bounds(a1=limit, a2=limit, q1=(-MAX_ANGLE, MAX_ANGLE), q2=(-MAX_ANGLE, MAX_ANGLE))
    reach.bounds(w1=(-MAX_RATE, MAX_RATE), w2=(-MAX_RATE, MAX_RATE))
    problem.minimize(reach.final_time)
    return problem


REFERENCE = Reference(11.97351, "independent Radau collocation, finest mesh 400 x 3", 1.2e-5, "s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
