r"""Rigid-body rotation: Euler's equations relative to an inertial or a uniformly rotating frame; reaction wheels.

With the inertia matrix J in body axes about the centre of mass, ``omega_BI_B`` the rate of body B relative to
inertial space I, and the torque T, all in B components:

.. math:: J \dot\omega_{BI} = T - \omega_{BI} \times (J \omega_{BI}) .

**Relative to a frame L** that rotates at ``omega_LI`` (constant in L, as for the LVLH frame of a circular
orbit): write :math:`\omega = \omega_{BL}` and :math:`w = C_{BL}\,\omega_{LI}`, so that :math:`\omega_{BI} =
\omega + w`. With :math:`\dot w = -\omega \times w`,

.. math:: J \dot\omega = T - (\omega + w) \times J (\omega + w) + J (\omega \times w) .

The kinetic energy :math:`\tfrac12 \omega_{BI}^T J\, \omega_{BI}` and the length of the angular momentum
:math:`J \omega_{BI}` are constant without torque.

**Reaction wheels**, spin axes in the columns of ``axes`` (3, n), body components; inertia :math:`I_w` about
the axis each, spin rate :math:`\Omega` relative to the body, motor torque T on the *body* (-T on the wheels):

.. math::
   J \dot\omega &= -\omega \times (J \omega + A h) + A T + T_{ext} \\
   \dot h &= -T, \qquad h = I_w \Omega .

J is the inertia with locked wheels. The wheel momentum due to the body rate is neglected (:math:`I_w \ll J`). The shaft
power of wheel i is :math:`-T_i \Omega_i`, positive if the motor accelerates the wheel.

The inertia is three principal moments, (3,), or a symmetric matrix, (3, 3).
SI units. Vectors are CasADi columns or arrays (n,) and (n, n_times), time last.

References
----------
F. L. Markley, J. L. Crassidis, Fundamentals of Spacecraft Attitude Determination and Control, Springer
2014, section 7.5.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.spacecraft.vector_algebra import Matrix, Vector, apply, cross, is_symbolic, stack_vector

PYRAMID_ELEVATION = float(np.arctan(1 / np.sqrt(2)))
"""Elevation of the axes above the base (rad) with equal capability about all body axes, 35.264 degrees."""


def wheel_pyramid(elevation: float = PYRAMID_ELEVATION, azimuth: float = np.pi / 4, wheels: int = 4) -> Array:
    """Return the spin axes (3, wheels) of a pyramid about z.

    Parameters
    ----------
    elevation : float
        Elevation of the axes above the x-y plane, rad.
    azimuth : float
        Azimuth of the first wheel from x towards y, rad; the wheels have equal angular spacing.
    wheels : int
        Number of wheels, at least 3.

    Raises
    ------
    ArgumentError
        Fewer than three wheels.

    Examples
    --------
    >>> print(np.round(np.linalg.norm(wheel_pyramid(), axis=0), 12))  # a unit vector per wheel
    [1. 1. 1. 1.]
    """
    if wheels < 3:
        raise ArgumentError(
            f"a pyramid of {wheels} wheels cannot turn a body about all axes: give at least 3."
        )
    angles = azimuth + 2 * np.pi * np.arange(wheels) / wheels
    level = np.cos(elevation)
    return np.stack([level * np.cos(angles), level * np.sin(angles), np.full(wheels, np.sin(elevation))])


def array_momentum(axes: ArrayLike, momenta: Vector) -> Vector:
    """Return the total wheel momentum in body components, N m s.

    Parameters
    ----------
    axes : array (3, n)
        Spin axes as columns.
    momenta : casadi (n, 1), array (n,) or (n, n_times)
        Momentum of each wheel about its axis, N m s.

    Examples
    --------
    >>> print(np.round(array_momentum(wheel_pyramid(), [1.0, 1.0, 1.0, 1.0]), 4) + 0.0)
    [0.     0.     2.3094]
    """
    return _multiply_inertia(axes, momenta)


def wheel_body_acceleration(
    inertia: Any, axes: ArrayLike, omega_BI_B: Vector, momenta: Vector, torques: Vector, external_B: Vector
) -> Vector:
    """Return the time derivative of ``omega_BI_B``, rad/s^2.

    Parameters
    ----------
    inertia : casadi or array, (3,) principal moments or (3, 3)
        kg m^2.
    axes : array (3, n)
        Spin axes as columns.
    omega_BI_B, external_B : casadi (3, 1), array (3,) or (3, n_times)
        Rate relative to inertial space (rad/s) and external torque (N m) in B components.
    momenta, torques : casadi (n, 1), array (n,) or (n, n_times)
        Momentum of each wheel about its axis (N m s), and motor torques on the body (N m).

    Examples
    --------
    >>> inertia, axes = [10.0, 8.0, 6.0], np.eye(3)
    >>> spinning = {"momenta": np.array([0.0, 0.0, 2.0]), "torques": np.zeros(3)}
    >>> rate = np.array([0.01, 0.0, 0.0])
    >>> print(wheel_body_acceleration(inertia, axes, rate, **spinning, external_B=np.zeros(3)))
    [0.     0.0025 0.    ]
    """
    total = total_momentum(inertia, axes, omega_BI_B, momenta)
    gyroscopic, driving = cross(omega_BI_B, total), _multiply_inertia(axes, torques)
    return divide_by_inertia(
        inertia, stack_vector([driving[i] + external_B[i] - gyroscopic[i] for i in range(3)])
    )


def total_momentum(inertia: Any, axes: ArrayLike, omega_BI_B: Vector, momenta: Vector) -> Vector:
    """Return the total momentum of body and wheels in body components, N m s; without torque inertially constant.

    Parameters
    ----------
    inertia : casadi or array, (3,) principal moments or (3, 3)
        kg m^2.
    axes : array (3, n)
        Spin axes as columns.
    omega_BI_B : casadi (3, 1), array (3,) or (3, n_times)
        rad/s.
    momenta : casadi (n, 1), array (n,) or (n, n_times)
        Momentum of each wheel about its axis, N m s.

    Examples
    --------
    >>> print(np.round(total_momentum(np.eye(3), wheel_pyramid(), [0.0, 0.0, 0.1], [0.0] * 4), 4))
    [0.  0.  0.1]
    """
    body, wheels = angular_momentum(inertia, omega_BI_B), _multiply_inertia(axes, momenta)
    return stack_vector([body[i] + wheels[i] for i in range(3)])


def _multiply_inertia(matrix: ArrayLike | Matrix, vector: Vector) -> Vector:
    if is_symbolic(matrix, vector):
        return ca.mtimes(ca.DM(np.asarray(matrix)) if not is_symbolic(matrix) else matrix, vector)
    return np.asarray(matrix, dtype=float) @ np.asarray(vector, dtype=float)


def angular_acceleration(inertia: Any, omega_BI_B: Vector, torque_B: Vector) -> Vector:
    """Return the time derivative of ``omega_BI_B``, rad/s^2.

    Parameters
    ----------
    inertia : casadi or array, (3,) principal moments or (3, 3)
        kg m^2.
    omega_BI_B, torque_B : casadi (3, 1), array (3,) or (3, n_times)
        Rate relative to inertial space (rad/s) and torque (N m) in B components.

    Examples
    --------
    >>> print(angular_acceleration(np.eye(3), [0.1, 0.2, 0.0], [1.0, 0.0, 0.0]) + 0.0)
    [1. 0. 0.]
    """
    gyroscopic = cross(omega_BI_B, angular_momentum(inertia, omega_BI_B))
    return divide_by_inertia(inertia, stack_vector([torque_B[i] - gyroscopic[i] for i in range(3)]))


def relative_angular_acceleration(
    inertia: Any, omega_BL_B: Vector, omega_LI_B: Vector, torque_B: Vector
) -> Vector:
    """Return the time derivative of ``omega_BL_B``, rad/s^2, for a frame L of constant rate.

    Parameters
    ----------
    inertia : casadi or array, (3,) principal moments or (3, 3)
        kg m^2.
    omega_BL_B, omega_LI_B, torque_B : casadi (3, 1), array (3,) or (3, n_times)
        Rate of B relative to L, of L relative to inertial space (rad/s), and torque (N m), all in B components.

    Examples
    --------
    >>> print(relative_angular_acceleration(np.eye(3), [0.0] * 3, [0.0, 0.001, 0.0], [1.0, 2.0, 3.0]))
    [1. 2. 3.]
    """
    omega_BI_B = stack_vector([omega_BL_B[i] + omega_LI_B[i] for i in range(3)])
    inertial = angular_acceleration(inertia, omega_BI_B, torque_B)
    turning = cross(omega_BL_B, omega_LI_B)
    return stack_vector([inertial[i] + turning[i] for i in range(3)])


def angular_momentum(inertia: Any, omega_B: Vector) -> Vector:
    """Return inertia times rate, N m s.

    Parameters
    ----------
    inertia : casadi or array, (3,) principal moments or (3, 3)
        kg m^2.
    omega_B : casadi (3, 1), array (3,) or (3, n_times)
        rad/s.

    Examples
    --------
    >>> print(angular_momentum(np.diag([1.0, 2.0, 4.0]), [0.1, 0.2, 0.3]))
    [0.1 0.4 1.2]
    """
    if _is_full_inertia_matrix(inertia):
        return apply(inertia, omega_B)
    return stack_vector([inertia[i] * omega_B[i] for i in range(3)])


def divide_by_inertia(inertia: Any, torque_B: Vector) -> Vector:
    """Return the inverse of the inertia times a torque, rad/s^2.

    Parameters
    ----------
    inertia : casadi or array, (3,) principal moments or (3, 3)
        kg m^2.
    torque_B : casadi (3, 1), array (3,) or (3, n_times)
        N m.

    Examples
    --------
    >>> print(divide_by_inertia(np.diag([1.0, 2.0, 4.0]), [1.0, 1.0, 1.0]))
    [1.   0.5  0.25]
    """
    if not _is_full_inertia_matrix(inertia):
        return stack_vector([torque_B[i] / inertia[i] for i in range(3)])
    if is_symbolic(inertia, torque_B):
        return ca.mtimes(ca.inv(inertia), torque_B)
    return np.linalg.solve(np.asarray(inertia, dtype=float), torque_B)


def _is_full_inertia_matrix(inertia: Any) -> bool:
    shape = np.shape(inertia) if not is_symbolic(inertia) else inertia.shape
    return bool(shape == (3, 3))
