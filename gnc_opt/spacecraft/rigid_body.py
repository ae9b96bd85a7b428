r"""Rotation of a rigid body: Euler's equations, relative to an inertial or to a uniformly turning frame.

With the inertia matrix J in body axes about the centre of mass, ``omega_BI_B`` the rate of body B relative to
inertial space I, and the torque T, all in B components:

.. math:: J \dot\omega_{BI} = T - \omega_{BI} \times (J \omega_{BI}) .

**Relative to a frame L** that itself turns at ``omega_LI`` (constant in L, as for the LVLH frame of a
circular orbit): write :math:`\omega = \omega_{BL}` and :math:`w = C_{BL}\,\omega_{LI}` (L's rate in B
components), so that :math:`\omega_{BI} = \omega + w`. Seen from B the vector w turns: :math:`\dot w =
-\omega \times w`. Hence

.. math:: J \dot\omega = T - (\omega + w) \times J (\omega + w) + J (\omega \times w) .

The kinetic energy :math:`\tfrac12 \omega_{BI}^T J\, \omega_{BI}` and the length of the angular momentum
:math:`J \omega_{BI}` are constant without torque.

Rates in rad/s, inertia in kg m^2, torque in N m. The inertia is three principal moments, (3,), or a symmetric
matrix, (3, 3). Rates and torques are CasADi columns or arrays (3,) and (3, n_times), time last.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.spacecraft.vector import Vector, apply, cross, is_symbolic, stack


def angular_acceleration(inertia: Any, omega_BI_B: Vector, torque_B: Vector) -> Vector:
    """Return the time derivative of ``omega_BI_B``, rad/s^2.

    Parameters
    ----------
    inertia : casadi or array, (3,) principal moments or (3, 3)
        kg m^2.
    omega_BI_B : casadi (3, 1), array (3,) or (3, n_times)
        Rate relative to inertial space in B components, rad/s.
    torque_B : like ``omega_BI_B``
        N m.

    Examples
    --------
    >>> from gnc_opt.spacecraft import angular_acceleration
    >>> print(angular_acceleration(np.eye(3), [0.1, 0.2, 0.0], [1.0, 0.0, 0.0]) + 0.0)
    [1. 0. 0.]
    """
    gyroscopic = cross(omega_BI_B, angular_momentum(inertia, omega_BI_B))
    return divide_by_inertia(inertia, stack([torque_B[i] - gyroscopic[i] for i in range(3)]))


def relative_angular_acceleration(
    inertia: Any, omega_BL_B: Vector, omega_LI_B: Vector, torque_B: Vector
) -> Vector:
    """Return the time derivative of ``omega_BL_B``, rad/s^2, for a frame L of constant rate.

    Parameters
    ----------
    inertia : casadi or array, (3,) principal moments or (3, 3)
        kg m^2.
    omega_BL_B : casadi (3, 1), array (3,) or (3, n_times)
        Rate of the body relative to L in B components, rad/s.
    omega_LI_B : like ``omega_BL_B``
        Rate of L relative to inertial space in B components, ``dcm_BL @ omega_LI_L``, rad/s.
    torque_B : like ``omega_BL_B``
        N m.

    Examples
    --------
    >>> from gnc_opt.spacecraft import relative_angular_acceleration
    >>> print(relative_angular_acceleration(np.eye(3), [0.0] * 3, [0.0, 0.001, 0.0], [1.0, 2.0, 3.0]))
    [1. 2. 3.]
    """
    omega_BI_B = stack([omega_BL_B[i] + omega_LI_B[i] for i in range(3)])
    inertial = angular_acceleration(inertia, omega_BI_B, torque_B)
    turning = cross(omega_BL_B, omega_LI_B)
    return stack([inertial[i] + turning[i] for i in range(3)])


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
    >>> from gnc_opt.spacecraft import angular_momentum
    >>> print(angular_momentum(np.diag([1.0, 2.0, 4.0]), [0.1, 0.2, 0.3]))
    [0.1 0.4 1.2]
    """
    if _is_matrix(inertia):
        return apply(inertia, omega_B)
    return stack([inertia[i] * omega_B[i] for i in range(3)])


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
    >>> from gnc_opt.spacecraft import divide_by_inertia
    >>> print(divide_by_inertia(np.diag([1.0, 2.0, 4.0]), [1.0, 1.0, 1.0]))
    [1.   0.5  0.25]
    """
    if not _is_matrix(inertia):
        return stack([torque_B[i] / inertia[i] for i in range(3)])
    if is_symbolic(inertia, torque_B):
        return ca.mtimes(ca.inv(inertia), torque_B)
    return np.linalg.solve(np.asarray(inertia, dtype=float), torque_B)


def _is_matrix(inertia: Any) -> bool:
    shape = np.shape(inertia) if not is_symbolic(inertia) else inertia.shape
    return bool(shape == (3, 3))
