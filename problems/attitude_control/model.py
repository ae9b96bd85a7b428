r"""The simulated spacecraft, data of its sensors and wheels, and the slew.

Body, wheels and manoeuvre are those of `problems.reaction_wheels.model` (Navabi and Hosseini, 2018). The plant adds
motors that follow their command with a lag, and an external torque: with M the motor torques on the
body,

.. math:: J \dot\omega = -\omega \times (J \omega + A h) + A M + T_{ext}, \qquad \dot h = -M, \qquad
   \tau \dot M = T - M .

The slew has minimum energy and stays below the limits of torque and speed, which leaves a margin for feedback.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.spacecraft import (
    quaternion_difference,
    quaternion_rate,
    quaternion_retraction,
    wheel_body_acceleration,
)
from problems.reaction_wheels.model import AXES, INERTIA, MAX_MOMENTUM, RPM, WHEEL_INERTIA, target_quaternion
from problems.reaction_wheels.optimal import build as build_slew

__all__ = ["MAX_MOMENTUM", "RPM", "WHEEL_INERTIA", "build", "plant", "slew"]

MANOEUVRE = 3
TARGET = target_quaternion(MANOEUVRE)
DURATION = 30.0
"""Of the slew, s."""
MAX_TORQUE = 0.08
"""Of a wheel's motor, N m."""
PLANNED = 0.9
"""Share of the wheels' speed that the slew may use."""
LAG = 0.05
"""Of the motors, s."""
MESH = "16x4"

TRACKER_NOISE = (5e-5, 5e-5, 3e-4)
"""Of the star tracker, about the axes of the body; its boresight is z. rad, 1 sigma."""
TRACKER_PERIOD, TRACKER_DELAY = 0.5, 0.1
"""s."""
TRACKER_RATE = float(np.radians(1.5))
"""The star tracker sees no stars while the body turns faster, rad/s."""
GYRO_NOISE, GYRO_BIAS, GYRO_WALK = 1.4e-4, float(np.radians(0.05)), 1e-6
"""White noise of a sample and constant error, rad/s; drift, rad/s^1.5. 1 sigma."""
TACHOMETER_NOISE = 0.5 * WHEEL_INERTIA * RPM
"""Of half a revolution per minute, N m s."""


def build() -> go.Problem:
    """Return the problem of the slew: least energy in `DURATION`."""
    return build_slew("energy", MANOEUVRE, DURATION, torque=PLANNED * MAX_TORQUE, speed=PLANNED * 5000.0)


@cache
def slew() -> go.Solution:
    """Return the slew."""
    return go.solve(build(), mesh=MESH, tol=None)


def plant() -> go.Model:
    """Return the spacecraft as it flies."""
    craft = go.Model("spacecraft with motors")
    q_BN = craft.state("q", 4)
    omega_BN_B = craft.state("omega", 3, unit="rad/s")
    momenta = craft.state("h", 4, unit="N m s")
    motors = craft.state("motor", 4, unit="N m")
    torques = craft.control("T", 4, unit="N m")
    moments = craft.parameter("inertia", INERTIA, unit="kg m^2")
    lag = craft.parameter("lag", LAG, unit="s")
    external_B = craft.parameter("external", np.zeros(3), unit="N m")
    craft.ode(
        {
            q_BN: quaternion_rate(q_BN, omega_BN_B),
            omega_BN_B: wheel_body_acceleration(moments, AXES, omega_BN_B, momenta, motors, external_B),
            momenta: -motors,
            motors: (torques - motors) / lag,
        }
    )
    craft.difference(q_BN, quaternion_difference, quaternion_retraction)
    return craft


def off_target(q: ca.SX) -> Any:
    """Return the angle from the attitude q (SX) to the target, rad."""
    return 2 * ca.asin(ca.fmin(1, 0.5 * ca.norm_2(quaternion_difference(q, ca.DM(TARGET)))))
