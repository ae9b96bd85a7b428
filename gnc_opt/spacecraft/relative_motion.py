r"""Relative motion of spacecraft: Hill's equations, nonlinear motion in the radial frame, inertial motion.

**Frame L** (local vertical, local horizontal) has its origin in the target: z points to the planet's centre, x along
the target's velocity, y completes the triad. It rotates about the orbit normal,

.. math:: \omega_{LI,L} = (0, -n, 0), \qquad n = \sqrt{\mu / a^3} .

**Hill's equations** (Clohessy-Wiltshire) for the position r of the chaser relative to the target on a circular orbit,
both in L, with :math:`|r| \ll a` and a force per mass :math:`f` beyond gravity:

.. math::
   \ddot x &= \phantom{-}2 n \dot z + f_x \\
   \ddot y &= -n^2 y + f_y \\
   \ddot z &= -2 n \dot x + 3 n^2 z + f_z ,

with an error of the order :math:`3 n^2 |r|^2 / a`.

**Frame R** has its origin in the leader: x radial outward, y along the motion, z along the orbit normal:
:math:`(x, y, z)_L = (y, -z, -x)_R`.

**Circular Keplerian leader** at radius :math:`r_l`, mean motion n. For the follower at
:math:`\rho = (x, y, z)` in R, with :math:`q = ((r_l + x)^2 + y^2 + z^2)^{3/2}`, exactly,

.. math::
   \ddot x &= \phantom{-}2 n \dot y + n^2 x - \mu \left( \frac{r_l + x}{q} - \frac{1}{r_l^2} \right) + f_x \\
   \ddot y &= -2 n \dot x + n^2 y - \mu\, y / q + f_y \\
   \ddot z &= -\mu\, z / q + f_z .

**Inertial motion** of leader and follower: the leader's radial frame rotates at :math:`h/r^2` about z and, if a force
accelerates the leader out of its plane by :math:`a_h`, at :math:`r\, a_h/h` about x.

SI units. Vectors are CasADi columns or arrays (3,) and (3, n_times), time last.

References
----------
K. T. Alfriend et al., Spacecraft Formation Flying, Elsevier 2010, chapters 4 and 7.
W. H. Clohessy, R. S. Wiltshire, Terminal guidance system for satellite rendezvous, J. Aerospace Sci. 27 (1960).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gnc_opt.errors import ArgumentError
from gnc_opt.spacecraft.gravity import J2_EARTH, MU_EARTH, RADIUS_EARTH, j2_gravity
from gnc_opt.spacecraft.vector_algebra import (
    Matrix,
    Vector,
    apply,
    cross,
    dot,
    scale_vector,
    stack_matrix_rows,
    stack_vector,
    transpose,
)


def mean_motion(semi_major_axis: float, mu: float = MU_EARTH) -> float:
    """Return the mean motion n, rad/s.

    Parameters
    ----------
    semi_major_axis : float
        Semi-major axis of the target's orbit, m.
    mu : float
        Gravitational parameter, m^3/s^2.

    Raises
    ------
    ArgumentError
        An argument is not positive.

    Examples
    --------
    >>> print(f"{2 * np.pi / mean_motion(6.778e6) / 60:.2f} min")
    92.56 min
    """
    if not (semi_major_axis > 0 and mu > 0):
        raise ArgumentError(
            f"semi-major axis and mu must be positive: {semi_major_axis} m and {mu} m^3/s^2 are given, correct them."
        )
    return float(np.sqrt(mu / semi_major_axis**3))


def lvlh_rate(n: Any) -> Vector:
    """Return ``omega_LI_L``, the rate of the LVLH frame in its own axes, rad/s.

    Parameters
    ----------
    n : float or casadi scalar
        Mean motion, rad/s.

    Examples
    --------
    >>> print(lvlh_rate(0.001))
    [ 0.    -0.001  0.   ]
    """
    return stack_vector([0.0, -n, 0.0])


def hill_acceleration(r_L: Vector, v_L: Vector, n: Any) -> Vector:
    """Return the relative acceleration without thrust in L, m/s^2.

    Parameters
    ----------
    r_L, v_L : casadi (3, 1), array (3,) or (3, n_times)
        Position (m) relative to the target and its rate of change (m/s) seen in L.
    n : float or casadi scalar
        Mean motion of the target, rad/s.

    Examples
    --------
    >>> print(hill_acceleration([0.0, 10.0, 0.0], [0.0, 0.0, 0.0], 0.001))
    [ 0.e+00 -1.e-05  0.e+00]
    """
    return stack_vector([2 * n * v_L[2], -(n**2) * r_L[1], -2 * n * v_L[0] + 3 * n**2 * r_L[2]])


def relative_acceleration(
    rho_R: Vector, rho_rate_R: Vector, leader_radius: Any, n: Any, mu: Any = MU_EARTH
) -> Vector:
    """Return the follower's acceleration without thrust, as observed in R, m/s^2, for a circular Keplerian leader.

    Parameters
    ----------
    rho_R, rho_rate_R : casadi (3, 1), array (3,) or (3, n_times)
        Position (m) relative to the leader and its rate of change seen in R (m/s).
    leader_radius, n, mu : float or casadi scalar
        Radius of the leader (m), mean motion (rad/s), gravitational parameter (m^3/s^2).

    Examples
    --------
    >>> print(np.round(relative_acceleration([0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 7e6, 0.001), 6)[0])  # Coriolis
    0.002
    """
    radial = leader_radius + rho_R[0]
    square = radial * radial + rho_R[1] * rho_R[1] + rho_R[2] * rho_R[2]
    pull = mu / (square * square**0.5)
    return stack_vector(
        [
            2 * n * rho_rate_R[1] + n * n * rho_R[0] - (pull * radial - mu / leader_radius**2),
            -2 * n * rho_rate_R[0] + n * n * rho_R[1] - pull * rho_R[1],
            -pull * rho_R[2],
        ]
    )


def differential_j2(
    rho_R: Vector,
    leader_radius: Any,
    dcm_RI: Matrix,
    mu: Any = MU_EARTH,
    j2: Any = J2_EARTH,
    radius: Any = RADIUS_EARTH,
) -> Vector:
    """Return the difference of the J2 accelerations of follower and leader, in R, m/s^2.

    Parameters
    ----------
    rho_R : casadi (3, 1), array (3,) or (3, n_times)
        Position relative to the leader, m.
    leader_radius : float or casadi scalar
        Orbital radius of the leader, m.
    dcm_RI : casadi (3, 3), array (3, 3) or (3, 3, n_times)
        Maps inertial components (z along the planet's axis) to R.
    mu, j2, radius : float or casadi scalar
        Gravitational parameter (m^3/s^2), second zonal harmonic, equatorial radius (m).

    Examples
    --------
    >>> print(differential_j2([0.0, 0.0, 0.0], 7e6, np.eye(3)))  # at the leader itself
    [0. 0. 0.]
    """
    dcm_IR = transpose(dcm_RI)
    leader = apply(dcm_IR, stack_vector([leader_radius, 0.0 * leader_radius, 0.0 * leader_radius]))
    follower = apply(dcm_IR, stack_vector([leader_radius + rho_R[0], rho_R[1], rho_R[2]]))
    own, base = j2_gravity(follower, mu, j2, radius), j2_gravity(leader, mu, j2, radius)
    return apply(dcm_RI, stack_vector([own[i] - base[i] for i in range(3)]))


def radial_frame(r: Vector, v: Vector) -> Matrix:
    """Return ``dcm_RI`` of the radial frame of an orbit.

    Parameters
    ----------
    r, v : casadi (3, 1), array (3,) or (3, n_times)
        Inertial position (m) and velocity (m/s).

    Examples
    --------
    >>> print(radial_frame([7e6, 0.0, 0.0], [0.0, 7500.0, 0.0]))
    [[1. 0. 0.]
     [0. 1. 0.]
     [0. 0. 1.]]
    """
    normal = cross(r, v)
    x = scale_vector(1 / dot(r, r) ** 0.5, r)
    z = scale_vector(1 / dot(normal, normal) ** 0.5, normal)
    y = cross(z, x)
    return stack_matrix_rows([[e[0], e[1], e[2]] for e in (x, y, z)])


def radial_frame_rate(r: Vector, v: Vector, acceleration: Vector) -> Vector:
    """Return ``omega_RI_R``, the rate of the radial frame in its own axes, rad/s.

    Parameters
    ----------
    r, v, acceleration : casadi (3, 1), array (3,) or (3, n_times)
        Inertial position (m), velocity (m/s) and total acceleration (m/s^2) of the leader.

    Examples
    --------
    >>> print(radial_frame_rate([7e6, 0.0, 0.0], [0.0, 7000.0, 0.0], [-8.1, 0.0, 0.0]))
    [0.    0.    0.001]
    """
    normal = cross(r, v)
    h = dot(normal, normal) ** 0.5
    distance = dot(r, r) ** 0.5
    return stack_vector([distance * dot(acceleration, normal) / (h * h), 0.0 * h, h / dot(r, r)])


def relative_from_inertial(
    r_leader: Vector, v_leader: Vector, r_follower: Vector, v_follower: Vector, acceleration: Vector
) -> tuple[Vector, Vector]:
    """Return position (m) and rate (m/s) of the follower as observed in the leader's radial frame.

    Parameters
    ----------
    r_leader, v_leader, r_follower, v_follower : casadi (3, 1), array (3,) or (3, n_times)
        Inertial states, m and m/s.
    acceleration : like the others
        Total acceleration of the leader, m/s^2.

    Examples
    --------
    >>> r, speed = 7e6, np.sqrt(MU_EARTH / 7e6)
    >>> down = np.array([-MU_EARTH / r**2, 0.0, 0.0])
    >>> leader = np.array([r, 0, 0]), np.array([0, speed, 0])
    >>> follower = np.array([r + 100, 0, 0]), np.array([0, speed, 0])  # 100 m above, as fast
    >>> rho, rate = relative_from_inertial(*leader, *follower, down)
    >>> print(rho, np.round(rate, 4))  # seen in the frame that turns, it falls behind
    [100.   0.   0.] [ 0.     -0.1078  0.    ]
    """
    dcm_RI = radial_frame(r_leader, v_leader)
    rho = apply(dcm_RI, stack_vector([r_follower[i] - r_leader[i] for i in range(3)]))
    velocity = apply(dcm_RI, stack_vector([v_follower[i] - v_leader[i] for i in range(3)]))
    turning = cross(radial_frame_rate(r_leader, v_leader, acceleration), rho)
    return rho, stack_vector([velocity[i] - turning[i] for i in range(3)])


def inertial_from_relative(
    r_leader: Vector, v_leader: Vector, rho_R: Vector, rho_rate_R: Vector, acceleration: Vector
) -> tuple[Vector, Vector]:
    """Return the follower's inertial position (m) and velocity (m/s): the inverse of `relative_from_inertial`.

    Parameters
    ----------
    r_leader, v_leader, rho_R, rho_rate_R, acceleration : casadi (3, 1), array (3,) or (3, n_times)
        Inertial state of the leader, follower state observed in its radial frame (m, m/s), acceleration (m/s^2).

    Examples
    --------
    >>> r, speed = 7e6, np.sqrt(MU_EARTH / 7e6)
    >>> down = np.array([-MU_EARTH / r**2, 0.0, 0.0])
    >>> leader = np.array([r, 0, 0]), np.array([0, speed, 0])
    >>> position, velocity = inertial_from_relative(*leader, np.array([100.0, 0, 0]), np.zeros(3), down)
    >>> print(position, np.round(velocity - leader[1], 4))  # 100 m above, at rest in the frame that turns
    [7000100.       0.       0.] [0.     0.1078 0.    ]
    """
    dcm_IR = transpose(radial_frame(r_leader, v_leader))
    turning = cross(radial_frame_rate(r_leader, v_leader, acceleration), rho_R)
    away = apply(dcm_IR, rho_R)
    faster = apply(dcm_IR, stack_vector([rho_rate_R[i] + turning[i] for i in range(3)]))
    position = stack_vector([r_leader[i] + away[i] for i in range(3)])
    return position, stack_vector([v_leader[i] + faster[i] for i in range(3)])
