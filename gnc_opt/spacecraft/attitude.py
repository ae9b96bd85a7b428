r"""Attitude: modified Rodrigues parameters (MRP), direction cosine matrices, quaternions, Euler angles.

Frame B results from rotating frame L through the angle :math:`\Phi` about the unit axis e.

**Direction cosine matrix.** ``dcm_BL`` maps the L components of a vector to its B components (passive):
:math:`v_B = C_{BL}\, v_L`; its columns are the axes of L in B components. `scipy.spatial.transform.Rotation` uses
the transpose (active): ``Rotation.from_mrp(sigma).as_matrix() == dcm_BL.T``.

**Modified Rodrigues parameters** (three, no constraint; singular at one full turn)

.. math:: \sigma = e \tan(\Phi / 4), \qquad
   C_{BL} = I + \frac{8 [\sigma\times]^2 - 4 (1 - \sigma^2) [\sigma\times]}{(1 + \sigma^2)^2} .

**Kinematics**, with ``omega_BL_B`` the rate of B relative to L in B components,

.. math:: \dot\sigma = \tfrac14 [ (1 - \sigma^2) I + 2 [\sigma\times] + 2 \sigma \sigma^T ]\, \omega_{BL,B} .

**Shadow set.** :math:`\sigma_s = -\sigma / \sigma^2` is the same attitude with the angle :math:`\Phi - 2\pi`; one of
both has :math:`|\sigma| \le 1`. Limit :math:`\sigma` in trajectories with rotations of less than 180 degrees.

**Quaternion**, scalar part first:

.. math:: q = (\cos(\Phi/2),\; e \sin(\Phi/2)) = (1 - \sigma^2,\; 2 \sigma) / (1 + \sigma^2) .

Functions accept CasADi columns or arrays (3,) and (3, n_times) with time as last axis, except those marked "numeric".

References
----------
H. Schaub, J. L. Junkins, Analytical Mechanics of Space Systems, AIAA, chapter 3.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, quote_value
from gnc_opt.spacecraft.quaternion import quaternion_angle, quaternion_difference, quaternion_retraction
from gnc_opt.spacecraft.vector_algebra import (
    Matrix,
    Vector,
    cross,
    dot,
    is_symbolic,
    scale_vector,
    stack_matrix_rows,
    stack_vector,
)


def mrp_to_dcm(sigma_BL: Vector) -> Matrix:
    """Return ``dcm_BL``, which maps L components to B components.

    Parameters
    ----------
    sigma_BL : casadi (3, 1), array (3,) or (3, n_times)

    Examples
    --------
    >>> dcm_BL = mrp_to_dcm(mrp_from_axis_angle([0, 0, 1], np.pi / 2))
    >>> print(np.round(dcm_BL @ [1, 0, 0], 6) + 0)  # the x axis of L in B
    [ 0. -1.  0.]
    """
    x, y, z = sigma_BL[0], sigma_BL[1], sigma_BL[2]
    square = x * x + y * y + z * z
    denominator = (1 + square) * (1 + square)
    # [s x]^2 = s s^T - s^2 I
    a, b = 8 / denominator, 4 * (1 - square) / denominator
    diagonal = 1 - a * square
    return stack_matrix_rows(
        [
            [diagonal + a * x * x, a * x * y + b * z, a * x * z - b * y],
            [a * x * y - b * z, diagonal + a * y * y, a * y * z + b * x],
            [a * x * z + b * y, a * y * z - b * x, diagonal + a * z * z],
        ]
    )


def mrp_rate(sigma_BL: Vector, omega_BL_B: Vector) -> Vector:
    """Return the time derivative of the MRP, 1/s.

    Parameters
    ----------
    sigma_BL : casadi (3, 1), array (3,) or (3, n_times)
    omega_BL_B : like sigma_BL
        Angular rate of B relative to L in B components, rad/s.

    Examples
    --------
    >>> print(mrp_rate([0.0, 0.0, 0.0], [0.4, 0.0, 0.0]))
    [0.1 0.  0. ]
    """
    square, along, across = dot(sigma_BL, sigma_BL), dot(sigma_BL, omega_BL_B), cross(sigma_BL, omega_BL_B)
    return stack_vector(
        [0.25 * ((1 - square) * omega_BL_B[i] + 2 * across[i] + 2 * along * sigma_BL[i]) for i in range(3)]
    )


def mrp_difference(sigma: Vector, sigma_ref: Vector) -> Vector:
    r"""Return four times the MRP from the reference to sigma, to first order the rotation vector (rad) between them.

    For `Model.difference`. It describes the shorter rotation, has equal components in R and B, and a length <= 4:
    .. math:: \delta\sigma = \frac{(1 - \sigma_r^2)\, \sigma - (1 - \sigma^2)\, \sigma_r + 2\, \sigma \times \sigma_r}
       {1 + \sigma^2 \sigma_r^2 + 2\, \sigma \cdot \sigma_r}

    or its shadow.

    Parameters
    ----------
    sigma, sigma_ref : casadi (3, 1), array (3,) or (3, n_times)
        MRP of B and of the reference R relative to the same frame; either of the two sets.

    Examples
    --------
    >>> print(mrp_difference([0.1, 0.0, 0.0], [0.1, 0.0, 0.0]))
    [0. 0. 0.]
    """
    square, square_ref = dot(sigma, sigma), dot(sigma_ref, sigma_ref)
    across = cross(sigma, sigma_ref)
    numerator = stack_vector(
        [(1 - square_ref) * sigma[i] - (1 - square) * sigma_ref[i] + 2 * across[i] for i in range(3)]
    )
    cosine = (1 - square) * (1 - square_ref) + 4 * dot(sigma, sigma_ref)
    length = (1 + square) * (1 + square_ref)
    if is_symbolic(numerator):
        factor = ca.if_else(cosine < 0, -8 / (length - cosine), 8 / (length + cosine))
    else:
        factor = np.where(cosine < 0, -8 / (length + np.abs(cosine)), 8 / (length + np.abs(cosine)))
    return scale_vector(factor, numerator)


def mrp_retraction(sigma_ref: Vector, error: Vector) -> Vector:
    """Return the MRP, of length <= 1, whose `mrp_difference` from the reference is ``error``.

    Parameters
    ----------
    sigma_ref : casadi (3, 1), array (3,) or (3, n_times)
        Either of the two sets.
    error : casadi (3, 1), array (3,) or (3, n_times)
        Rotation vector to first order, rad, in components of the rotated frame.

    Examples
    --------
    >>> print(mrp_retraction([0.1, 0.0, 0.0], [0.0, 0.0, 0.0]))
    [0.1 0.  0. ]
    """
    return scale_vector(0.25, mrp_difference(scale_vector(0.25, error), scale_vector(-1, sigma_ref)))


for _function in (mrp_difference, mrp_retraction, quaternion_difference, quaternion_retraction):
    vars(_function)["error_unit"] = "rad"


def mrp_to_quaternion(sigma_BL: Vector) -> Vector:
    """Return the unit quaternion, scalar part first: casadi (4, 1), array (4,) or (4, n_times).

    Parameters
    ----------
    sigma_BL : casadi (3, 1), array (3,) or (3, n_times)

    Examples
    --------
    >>> print(mrp_to_quaternion([1.0, 0.0, 0.0]))  # half a turn about x
    [0. 1. 0. 0.]
    """
    square = dot(sigma_BL, sigma_BL)
    return stack_vector([(1 - square) / (1 + square), *(2 * sigma_BL[i] / (1 + square) for i in range(3))])


def mrp_from_axis_angle(axis: ArrayLike, angle: float) -> Array:
    """Return the MRP (3,) of a rotation through ``angle`` (rad) about ``axis`` (3,), of any length; numeric.

    Parameters
    ----------
    axis : array (3,)
    angle : float
        rad.

    Raises
    ------
    ArgumentError
        The axis has length zero.

    Examples
    --------
    >>> print(np.round(mrp_from_axis_angle([0, 0, 1], np.pi / 2), 6))
    [0.       0.       0.414214]
    """
    direction = np.asarray(axis, dtype=float)
    length = np.linalg.norm(direction)
    if not length > 0:
        raise ArgumentError(
            f"the axis of a rotation is {quote_value(axis)}, without a direction: give one that is not zero."
        )
    return np.asarray(direction / length * np.tan(angle / 4))


def compute_attitude_angle(attitude: Array, reference: Array) -> Any:
    """Return the angle (rad, 0 to pi) between two attitudes: quaternions (4, ...) or MRP (3, ...); numeric."""
    if len(attitude) not in (3, 4):
        raise ArgumentError(
            f"an attitude of {len(attitude)} components is neither a quaternion nor modified Rodrigues parameters."
        )
    pair = (attitude, reference)
    if len(attitude) == 3:
        pair = (mrp_to_quaternion(attitude), mrp_to_quaternion(reference))
    return quaternion_angle(*(q / np.linalg.norm(q, axis=0) for q in pair))
