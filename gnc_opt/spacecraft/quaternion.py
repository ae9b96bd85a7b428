r"""Unit quaternions, scalar part first: :math:`q = (\cos(\Phi/2),\; e \sin(\Phi/2))`.

Frame B is frame A rotated through :math:`\Phi` about the unit axis e; ``q_BA`` and ``-q_BA`` are the same attitude.

**Product.** With Hamilton's product

.. math:: p \otimes q = (p_0 q_0 - p_v \cdot q_v,\; p_0 q_v + q_0 p_v + p_v \times q_v)

rotations about the axes of the *moving* frame compose from left to right: ``q_CA = product(q_BA, q_CB)``.

**Direction cosine matrix** (passive, A components to B components, see `gnc_opt.spacecraft.attitude`)

.. math:: C_{BA} = (q_0^2 - q_v \cdot q_v)\, I + 2 q_v q_v^T - 2 q_0 [q_v \times] .

**Kinematics**, with ``omega_BA_B`` the rate of B relative to A in B components,

.. math:: \dot q_0 = -\tfrac12 q_v \cdot \omega, \qquad \dot q_v = \tfrac12 (q_0\, \omega + q_v \times \omega) .

**Error** of q relative to a reference in the same frame: :math:`\delta q = q_r^{-1} \otimes q`, with equal components
in R and B; the sign :math:`\delta q_0 \ge 0` selects the shorter rotation.

Functions accept CasADi columns or arrays (n,) and (n, n_times) with time as last axis, except those marked "numeric".
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.spacecraft.vector_algebra import (
    Matrix,
    Vector,
    cross,
    dot,
    is_symbolic,
    stack_matrix_rows,
    stack_vector,
)

Quaternion = Any
"""CasADi (4, 1), or an array (4,) or (4, n_times), scalar part first."""


def quaternion_product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return Hamilton's product of two quaternions.

    Parameters
    ----------
    p, q : casadi (4, 1), array (4,) or (4, n_times)

    Examples
    --------
    >>> quarter = np.array([np.sqrt(0.5), np.sqrt(0.5), 0, 0])  # 90 degrees about x, twice:
    >>> print(np.round(quaternion_product(quarter, quarter), 6))
    [0. 1. 0. 0.]
    """
    pv, qv = _get_quaternion_vector_part(p), _get_quaternion_vector_part(q)
    across = cross(pv, qv)
    scalar = p[0] * q[0] - dot(pv, qv)
    return stack_vector([scalar, *(p[0] * qv[i] + q[0] * pv[i] + across[i] for i in range(3))])


def quaternion_conjugate(q: Quaternion) -> Quaternion:
    """Return the conjugate quaternion (the inverse of a unit quaternion).

    Parameters
    ----------
    q : casadi (4, 1), array (4,) or (4, n_times)

    Examples
    --------
    >>> print(quaternion_conjugate([0.6, 0.8, 0.0, 0.0]) + 0.0)
    [ 0.6 -0.8  0.   0. ]
    """
    return stack_vector([q[0], -q[1], -q[2], -q[3]])


def quaternion_to_dcm(q_BA: Quaternion) -> Matrix:
    """Return ``dcm_BA``, which maps A components to B components: (3, 3) or (3, 3, n_times).

    Parameters
    ----------
    q_BA : casadi (4, 1), array (4,) or (4, n_times)

    Examples
    --------
    >>> print(quaternion_to_dcm([1.0, 0.0, 0.0, 0.0]))
    [[1. 0. 0.]
     [0. 1. 0.]
     [0. 0. 1.]]
    """
    s, x, y, z = q_BA[0], q_BA[1], q_BA[2], q_BA[3]
    return stack_matrix_rows(
        [
            [s * s + x * x - y * y - z * z, 2 * (x * y + s * z), 2 * (x * z - s * y)],
            [2 * (x * y - s * z), s * s - x * x + y * y - z * z, 2 * (y * z + s * x)],
            [2 * (x * z + s * y), 2 * (y * z - s * x), s * s - x * x - y * y + z * z],
        ]
    )


def quaternion_rate(q_BA: Quaternion, omega_BA_B: Vector) -> Quaternion:
    """Return the time derivative of the quaternion, 1/s.

    Parameters
    ----------
    q_BA : casadi (4, 1), array (4,) or (4, n_times)
    omega_BA_B : casadi (3, 1), array (3,) or (3, n_times)
        Rate of B relative to A in B components, rad/s.

    Examples
    --------
    >>> print(quaternion_rate([1.0, 0.0, 0.0, 0.0], [0.2, 0.0, 0.0]) + 0.0)
    [0.  0.1 0.  0. ]
    """
    vector = _get_quaternion_vector_part(q_BA)
    across = cross(vector, omega_BA_B)
    scalar = -0.5 * dot(vector, omega_BA_B)
    return stack_vector([scalar, *(0.5 * (q_BA[0] * omega_BA_B[i] + across[i]) for i in range(3))])


def quaternion_error(q: Quaternion, q_ref: Quaternion) -> Quaternion:
    """Return the quaternion of the shorter rotation from the reference to q, scalar part >= 0.

    Parameters
    ----------
    q, q_ref : casadi (4, 1), array (4,) or (4, n_times)

    Examples
    --------
    >>> print(np.round(quaternion_error([0.6, 0.8, 0.0, 0.0], [0.6, 0.8, 0.0, 0.0]), 12) + 0.0)
    [1. 0. 0. 0.]
    """
    error = quaternion_product(quaternion_conjugate(q_ref), q)
    if is_symbolic(error):
        return ca.if_else(error[0] < 0, -error, error)
    return np.where(np.asarray(error)[0] < 0, -error, error)


def quaternion_difference(q: Quaternion, q_ref: Quaternion) -> Vector:
    """Return twice the vector part of the error, (3,): to first order the rotation vector (rad) from q_ref to q.

    Parameters
    ----------
    q, q_ref : casadi (4, 1), array (4,) or (4, n_times)

    Examples
    --------
    >>> print(np.round(quaternion_difference([0.6, 0.8, 0.0, 0.0], [0.6, 0.8, 0.0, 0.0]), 12) + 0.0)
    [0. 0. 0.]
    """
    error = quaternion_error(q, q_ref)
    return stack_vector([2 * error[i] for i in (1, 2, 3)])


def quaternion_retraction(q_ref: Quaternion, error: Vector) -> Quaternion:
    """Return the unit quaternion whose `quaternion_difference` from the reference is ``error``.

    Errors longer than 2 give a rotation of 180 degrees.

    Parameters
    ----------
    q_ref : casadi (4, 1), array (4,) or (4, n_times)
        Nonzero, not necessarily normalised.
    error : casadi (3, 1), array (3,) or (3, n_times)
        Rotation vector to first order, rad, in components of the rotated frame.

    Examples
    --------
    >>> print(quaternion_retraction([1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0]))
    [1. 0. 0. 0.]
    """
    largest, root = (ca.fmax, ca.sqrt) if is_symbolic(error) or is_symbolic(q_ref) else (np.maximum, np.sqrt)
    square = 0.25 * dot(error, error)
    turn = stack_vector(
        [root(largest(1 - square, 0)), *(0.5 * error[i] / root(largest(square, 1)) for i in range(3))]
    )
    q = quaternion_product(q_ref, turn)
    length = root(q[0] ** 2 + dot(_get_quaternion_vector_part(q), _get_quaternion_vector_part(q)))
    return stack_vector([q[i] / length for i in range(4)])


def quaternion_angle(q: ArrayLike, q_ref: ArrayLike) -> Any:
    """Return the angle between two attitudes in [0, pi], rad; numeric, exact near 0 and near pi.

    Parameters
    ----------
    q, q_ref : array (4,) or (4, n_times)

    Examples
    --------
    >>> print(np.round(np.degrees(quaternion_angle([0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])), 6))
    180.0
    """
    error = np.asarray(quaternion_error(q, q_ref), dtype=float)
    return 2 * np.arctan2(np.linalg.norm(error[1:], axis=0), np.abs(error[0]))


def _get_quaternion_vector_part(q: Quaternion) -> Vector:
    return stack_vector([q[1], q[2], q[3]])
