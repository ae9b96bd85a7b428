r"""Gravity of an oblate planet, and gravity gradient torque.

Point mass and second zonal harmonic at the inertial position :math:`r = (X, Y, Z)`, Z along the planet's axis:

.. math::
   a = -\frac{\mu}{|r|^3} r + \frac{3 \mu J_2 R^2}{2 |r|^5}
   \begin{pmatrix} (5 Z^2/|r|^2 - 1)\, X \\ (5 Z^2/|r|^2 - 1)\, Y \\ (5 Z^2/|r|^2 - 3)\, Z \end{pmatrix} .

Both have a potential, :math:`a = -\nabla U`,

.. math:: U = -\frac{\mu}{|r|} \left[ 1 - \frac{J_2 R^2}{2 |r|^2} \left( \frac{3 Z^2}{|r|^2} - 1 \right) \right],

so the energy :math:`\tfrac12 |v|^2 + U` and the component of :math:`r \times v` along Z are constant.

**Gravity gradient** torque on a body at ``r_B`` from the planet's centre (B components), to first order in
size over distance: :math:`T = 3 \mu\, |r|^{-5}\, r \times J r`.

SI units. Vectors are CasADi columns or arrays (3,) and (3, n_times), time last.

References
----------
D. A. Vallado, Fundamentals of Astrodynamics and Applications, chapter 8.
"""

from __future__ import annotations

from typing import Any

from gnc_opt.spacecraft.rigid_body import angular_momentum
from gnc_opt.spacecraft.vector_algebra import Vector, cross, dot, scale_vector, stack_vector

MU_EARTH = 398600.4418e9
"""Gravitational parameter of the Earth, m^3/s^2 (WGS 84)."""

RADIUS_EARTH = 6378.137e3
"""Equatorial radius of the Earth, m (WGS 84)."""

J2_EARTH = 0.0010826
"""Second zonal harmonic of the Earth, not normalised."""


def point_mass_gravity(r: Vector, mu: Any = MU_EARTH) -> Vector:
    """Return the acceleration at the inertial position r (m) by a point mass, m/s^2.

    Parameters
    ----------
    r : casadi (3, 1), array (3,) or (3, n_times)
    mu : float or casadi scalar
        m^3/s^2.

    Examples
    --------
    >>> print(np.round(point_mass_gravity([6378137.0, 0.0, 0.0]), 4) + 0.0)
    [-9.7983  0.      0.    ]
    """
    square = dot(r, r)
    return scale_vector(-mu / (square * square**0.5), r)


def j2_gravity(r: Vector, mu: Any = MU_EARTH, j2: Any = J2_EARTH, radius: Any = RADIUS_EARTH) -> Vector:
    """Return the acceleration at the inertial position r (m) by the oblateness alone, m/s^2.

    Parameters
    ----------
    r : casadi (3, 1), array (3,) or (3, n_times)
    mu, j2, radius : float or casadi scalar
        Gravitational parameter (m^3/s^2), second zonal harmonic, equatorial radius (m).

    Examples
    --------
    >>> print(np.round(j2_gravity([0.0, 0.0, 6378137.0]), 4) + 0.0)  # above a pole
    [0.     0.     0.0318]
    """
    square = dot(r, r)
    ratio = 5 * r[2] * r[2] / square
    factor = 1.5 * mu * j2 * radius**2 / (square * square * square**0.5)
    return stack_vector(
        [factor * (ratio - 1) * r[0], factor * (ratio - 1) * r[1], factor * (ratio - 3) * r[2]]
    )


def gravity_gradient_torque(inertia: Any, r_B: Vector, mu: Any = MU_EARTH) -> Vector:
    """Return the gravity gradient torque on an extended body, N m.

    Parameters
    ----------
    inertia : casadi or array, (3,) principal moments or (3, 3)
        kg m^2.
    r_B : casadi (3, 1), array (3,) or (3, n_times)
        Position of the body relative to the planet's centre in body components, m.
    mu : float or casadi scalar
        m^3/s^2.

    Examples
    --------
    >>> print(np.round(gravity_gradient_torque(np.diag([1.0, 2.0, 4.0]), [7e6, 0.0, 0.0]), 9) + 0.0)
    [0. 0. 0.]
    """
    square = dot(r_B, r_B)
    factor = 3 * mu / (square * square * square**0.5)
    return scale_vector(factor, cross(r_B, angular_momentum(inertia, r_B)))
