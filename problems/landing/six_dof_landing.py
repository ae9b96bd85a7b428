r"""Powered descent in six degrees of freedom: a rocket of 30 t lands upright with minimum propellant.

This example shows rotation and translation in one problem: the engine is gimballed at the tail, so that every change
of course begins with an acceleration to the opposite side. Thrust (40 % to full), gimbal, tilt, body rates and glide
slope are limited.

States: ``m`` (kg), ``r``, ``v`` (m, m/s; z up), ``q`` (attitude, scalar first), ``w`` (body rates, rad/s). Control:
vector ``T`` (N) in the body frame.

.. math::
   \dot m = -\frac{\|T\|}{I_{sp} g}, \quad \dot r = v, \quad \dot v = \frac{C(q) T}{m} - g e_z, \quad
   \dot q = \tfrac12 \, q \otimes \omega, \quad J \dot\omega = d \times T - \omega \times J \omega

.. math:: T_z \ge \cos 7° \, \|T\|, \qquad q_1^2 + q_2^2 \le \sin^2 35°, \qquad
   \sqrt{r_x^2 + r_y^2} \le r_z / \tan 20°

Source: M. Szmuk and B. Acikmese, Successive convexification for 6-DoF Mars rocket powered landing with free-final-time,
AIAA 2018-0617; the numbers of the model ``rocket_landing_3d`` of the repository EmbersArc/SCvx with a fixed start.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

GRAVITY = 9.81
"""m/s^2."""
EXHAUST_SPEED = 282.0 * GRAVITY
"""m/s."""
THRUST = (0.4 * 800e3, 800e3)
"""N."""
INERTIA = np.array([4.0e6, 4.0e6, 1.0e5])
"""kg m^2."""
ENGINE = np.array([0.0, 0.0, -14.0])
"""Position of the engine in the body, m."""
GIMBAL, TILT, GLIDE_SLOPE, BODY_RATE = np.radians([7.0, 70.0, 20.0, 90.0])
"""Largest angle of the thrust and of the body axis, least elevation seen from the target, rad; rad/s."""
WET, DRY = 30000.0, 22000.0
"""kg."""


def rotated(q: Any, vector: Any) -> Any:
    """Return a vector of the body frame in the frame of the landing site."""
    axis = q[1:]
    crossed = ca.cross(axis, vector)
    return vector + 2 * (q[0] * crossed + ca.cross(axis, crossed))


def quaternion_rate(q: Any, w: Any) -> Any:
    """Return dq/dt for body rates w."""
    return 0.5 * ca.vertcat(-ca.dot(q[1:], w), q[0] * w + ca.cross(q[1:], w))


def build() -> go.Problem:
    """Return the problem."""
    rocket = go.Model("rocket")
    m = rocket.state("m", unit="kg")
    r = rocket.state("r", 3, unit="m")
    v = rocket.state("v", 3, unit="m/s")
    q = rocket.state("q", 4)
    w = rocket.state("w", 3, unit="rad/s")
    thrust, size = rocket.vector_control("T", 3, unit="N")
    inertia = ca.DM(INERTIA)
    rocket.ode(
        {
            m: -size / EXHAUST_SPEED,
            r: v,
            v: rotated(q, thrust) / m - ca.DM([0.0, 0.0, GRAVITY]),
            q: quaternion_rate(q, w),
            w: (ca.cross(ca.DM(ENGINE), thrust) - ca.cross(w, inertia * w)) / inertia,
        }
    )

    problem = go.Problem("powered descent in six degrees of freedom")
    descent = problem.phase("descent", rocket)
    descent.time(initial=0.0, final=(5.0, 30.0))
    upright = [1.0, 0.0, 0.0, 0.0]
    descent.initial(m=WET, r=[200.0, 100.0, 500.0], v=[-50.0, 20.0, -80.0], q=upright, w=np.zeros(3))
    descent.final(r=np.zeros(3), v=[0.0, 0.0, -5.0], q=upright, w=np.zeros(3))
    descent.bounds(m=(DRY, WET), w=(-BODY_RATE, BODY_RATE))
    descent.norm_bounds(T=THRUST)
    descent.path("glide slope", (r[2] / np.tan(GLIDE_SLOPE)) ** 2 - r[0] ** 2 - r[1] ** 2, lower=0.0)
    descent.path("tilt", q[1] ** 2 + q[2] ** 2, upper=np.sin(TILT / 2) ** 2)
    descent.path("gimbal", thrust[2] - size * np.cos(GIMBAL), lower=0.0)
    problem.maximize(descent.final_state("m"))
    return problem


REFERENCE = Reference(27581.2575, "independent Radau collocation, three meshes extrapolated", 0.03, "kg")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
