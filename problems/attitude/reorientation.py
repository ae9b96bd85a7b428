r"""Reorientation of an asymmetric body: a minimum-time turn by 150 degrees with an optional keep-out cone.

This example shows attitude by a quaternion, whose conserved norm is redundant, and a pointing constraint: an
instrument along the second axis of the body must stay at least 70 degrees away from the Sun.

States: ``omega`` (rad/s), ``q``, quaternion with the scalar part last. Control: ``u`` (N m), within 50 per axis.
Inertia 5621, 4547, 2364 kg m^2.

.. math::
   I \dot\omega = u - \omega \times I \omega, \qquad
   \dot q_v = \tfrac12 (q_4 \omega + q_v \times \omega), \qquad \dot q_4 = -\tfrac12 q_v^T \omega

Source: Betts, Practical Methods for Optimal Control and Estimation Using Nonlinear Programming, 2010, section 6.8
(28.630408 s).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.plot import View
from problems._example import Reference, example_main

INERTIA = np.array([5621.0, 4547.0, 2364.0])
"""kg m^2."""
ANGLE = np.radians(150.0)
TORQUE = 50.0
"""Of each axis, N m."""
SUN = np.array([0.0, np.cos(np.radians(75.0)), np.sin(np.radians(75.0))])
"""Where not to look, in inertial axes."""


def build(cone: float | None = None) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    cone : float, optional
        Half angle of the cone about `SUN` that the second axis must avoid, degrees; None: no cone.
    """
    body = go.Model("rigid body")
    omega = body.state("omega", 3, unit="rad/s")
    q = body.state("q", 4)
    u = body.control("u", 3, unit="N m")
    q_v, q_4 = q[:3], q[3]
    body.ode(
        {
            omega: (u - ca.cross(omega, INERTIA * omega)) / INERTIA,
            q: 0.5 * ca.vertcat(q_4 * omega + ca.cross(q_v, omega), -ca.dot(q_v, omega)),
        }
    )

    problem = go.Problem("reorientation of an asymmetric body")
    slew = problem.phase("slew", body)
    slew.time(initial=0.0, final=(10.0, 60.0))
    slew.initial(omega=[0.0, 0.0, 0.0], q=[0.0, 0.0, 0.0, 1.0])
    slew.final(omega=[0.0, 0.0, 0.0], q=[np.sin(ANGLE / 2), 0.0, 0.0, np.cos(ANGLE / 2)])
    slew.bounds(u=(-TORQUE, TORQUE))
    if cone is not None:
        axis = ca.DM([0.0, 1.0, 0.0])
        looks = axis + 2 * ca.cross(q_v, ca.cross(q_v, axis) + q_4 * axis)
        slew.path("keep out", ca.dot(looks, SUN), upper=np.cos(np.radians(cone)))
    problem.minimize(slew.final_time)
    return problem


REFERENCE = Reference(28.6304065, "switch times optimised; 28.630408 published", 1e-6, "s")
VARIANTS = {
    "past a cone": (
        {"cone": 70.0},
        Reference(29.5732799034, "switch times and touches optimised from two meshes", 1e-8, "s"),
    )
}
"""Other data, with their references."""

VIEW = View(attitude=("q[3]", "q[0]", "q[1]", "q[2]"))
"""What a report shows moving: it turns in place; the scalar part is the last one."""


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
