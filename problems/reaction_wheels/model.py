r"""A spacecraft with a pyramid of four reaction wheels: data, manoeuvres, dynamics.

A body at rest is turned by the motor torques of four wheels. Total momentum is zero and stays zero, so that the
gyroscopic term vanishes identically and the wheels' momenta are always those of the body, with the opposite sign.

States: ``q``, the quaternion of the body B relative to the reference frame N, scalar part *first*; ``omega``, its
rate in B (rad/s); ``h``, the momenta of the wheels about their axes (N m s). Control: ``T``, the motor torques on the
body (N m); the wheels feel -T. With the wheels' axes in the columns of A (the paper's L) and J the inertia,

.. math::
   \dot q = \tfrac12\, q \otimes (0, \omega), \qquad
   J \dot\omega = -\omega \times (J \omega + A h) + A T, \qquad \dot h = -T .

`wheel_model` is the only place where these are written (`gnc_opt.spacecraft.rigid_body` has their derivation); the
published laws, the optimal slews, the simulated plant and the flight code all use it. The publication's quaternions
have the scalar part last; `paper_quaternion` converts at the edges, where numbers are compared.

Source of data, laws and manoeuvres: Navabi and Hosseini, "Modeling and spacecraft attitude control using reaction
wheel with feedback linearization, its performance study subject to power and EULERINT", Modares Mechanical Engineering
18 (1), 51-61, 2018.
"""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

import gnc_opt as go
from gnc_opt.spacecraft import (
    array_momentum,
    quaternion_difference,
    quaternion_rate,
    quaternion_retraction,
    wheel_body_acceleration,
    wheel_pyramid,
)
from problems._example import Array

Drive: TypeAlias = Literal["wheels", "body"]

INERTIA = (4.0, 4.0, 3.0)
"""Principal moments, kg m^2."""
WHEEL_INERTIA = 5e-4
"""Of each wheel about its axis, kg m^2."""
NOMINAL_SPEED, DESIGN_SPEED = 5400.0, 5000.0
"""Limits of the wheels' speeds, rpm."""
TORQUE_CONSTANT = 12.36e-3
"""K_T, N m/A."""
VOLTAGE_CONSTANT = 1.294e-3
"""K_V, V/rpm."""
AXES = wheel_pyramid()
"""The paper's L (3, 4): elevation 35.264 degrees, azimuth 45 degrees."""
INVERSE = np.linalg.pinv(AXES)
"""The paper's equation (12): body torque to wheel torques of least length."""
NULL = np.array([1.0, -1.0, 1.0, -1.0])
"""Wheel torques without effect on the body."""

RPM = 2 * np.pi / 60
"""rad/s."""
MAX_MOMENTUM = WHEEL_INERTIA * DESIGN_SPEED * RPM
"""Of a wheel at the design limit of its speed, N m s."""

MANOEUVRES: dict[int, tuple[float, float, float]] = {
    1: (20.0, -30.0, -40.0),
    2: (-40.0, 30.0, 60.0),
    3: (-30.0, -50.0, -45.0),
    4: (5.0, 5.0, 5.0),
    5: (-5.0, 3.0, 2.0),
    6: (-3.0, 2.0, -40.0),
}
"""Angles about x, y and z of the targets, degrees; turned in the order z, y, x (3-2-1)."""
DURATION = 60.0
"""Of the published manoeuvres, s."""
REST = np.array([1.0, *np.zeros(10)])
"""The state in which every manoeuvre begins."""


def target_quaternion(manoeuvre: int) -> Array:
    """Return the target (4,) of a manoeuvre, scalar part first and positive: the short way round from the start."""
    if manoeuvre not in MANOEUVRES:
        raise go.ProblemError(f"there is no manoeuvre {manoeuvre!r}: choose one of {list(MANOEUVRES)}.")
    turn = Rotation.from_euler("ZYX", np.radians(MANOEUVRES[manoeuvre][::-1]))
    return np.asarray(turn.as_quat(canonical=True, scalar_first=True))


def paper_quaternion(q: ArrayLike) -> Array:
    """Return a quaternion (4,) or (4, n_times) with its scalar part last, as the paper has it."""
    return np.roll(np.asarray(q, dtype=float), -1, axis=0)


def resting(q: ArrayLike) -> Array:
    """Return the state (11,) at rest in the attitude q (4,), with the wheels at rest."""
    return np.concatenate([np.asarray(q, dtype=float), np.zeros(7)])


def wheel_model(inertia: ArrayLike = INERTIA, *, drive: Drive = "wheels") -> go.Model:
    """Return the dynamics of body and wheels; the body's principal moments (kg m^2) are a parameter of the model.

    Parameters
    ----------
    inertia : array (3,)
    drive : {"wheels", "body"}
        The control: the torques ``T`` (4) of the wheels, or the body torque ``T_B`` (3), which the wheels produce with
        the least torques, the paper's equation (12). Attitude laws command the latter.
    """
    craft = go.Model("spacecraft with four wheels")
    q_BN = craft.state("q", 4)
    omega_BN_B = craft.state("omega", 3, unit="rad/s")
    momenta = craft.state("h", 4, unit="N m s")
    if drive == "wheels":
        torques: Any = craft.control("T", 4, unit="N m")
    else:
        torques = ca.DM(INVERSE) @ craft.control("T_B", 3, unit="N m")
    moments = craft.parameter("inertia", inertia, unit="kg m^2")
    craft.ode(
        {
            q_BN: quaternion_rate(q_BN, omega_BN_B),
            omega_BN_B: wheel_body_acceleration(moments, AXES, omega_BN_B, momenta, torques, np.zeros(3)),
            momenta: -torques,
        }
    )
    craft.output("wheel_momentum_B", array_momentum(AXES, momenta), unit="N m s")
    craft.difference(q_BN, quaternion_difference, quaternion_retraction)
    return craft
