r"""Relative motion near a target on a circular orbit: Hill's equations in the LVLH frame.

**Frame L** (local vertical, local horizontal) sits in the target: z points to the planet's centre, x along
the target's velocity, y completes the triad (opposite to the orbit normal). It turns about the orbit
normal,

.. math:: \omega_{LI,L} = (0, -n, 0), \qquad n = \sqrt{\mu / a^3} .

**Hill's equations** (Clohessy-Wiltshire) for the position r of the chaser relative to the target, both in
L, with :math:`|r| \ll a` and a force per mass :math:`f` beyond gravity:

.. math::
   \ddot x &= \phantom{-}2 n \dot z + f_x \\
   \ddot y &= -n^2 y + f_y \\
   \ddot z &= -2 n \dot x + 3 n^2 z + f_z .

In the form :math:`\dot v = f - M v - N r` they have M = [[0, 0, -2n], [0, 0, 0], [2n, 0, 0]] and
N = diag(0, n^2, -3 n^2). They are the first-order difference of two Kepler orbits; the error of the
acceleration is of the order :math:`3 n^2 |r|^2 / a`.

SI units. Vectors are CasADi columns or arrays (3,) and (3, n_times), time last.

References
----------
W. H. Clohessy, R. S. Wiltshire, Terminal guidance system for satellite rendezvous, J. Aerospace Sciences 27
(1960).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gnc_opt.errors import ArgumentError
from gnc_opt.spacecraft.vector import Vector, stack

MU_EARTH = 398600.4418e9
"""Gravitational parameter of the Earth, m^3/s^2 (WGS 84)."""

RADIUS_EARTH = 6378.137e3
"""Equatorial radius of the Earth, m (WGS 84)."""


def mean_motion(semi_major_axis: float, mu: float = MU_EARTH) -> float:
    """Return the mean motion n, rad/s.

    Parameters
    ----------
    semi_major_axis : float
        Of the target's orbit, m.
    mu : float
        Gravitational parameter, m^3/s^2.

    Raises
    ------
    ArgumentError
        If either is not positive.

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
    >>> from gnc_opt.spacecraft import lvlh_rate
    >>> print(lvlh_rate(0.001))
    [ 0.    -0.001  0.   ]
    """
    return stack([0.0, -n, 0.0])


def hill_acceleration(r_L: Vector, v_L: Vector, n: Any) -> Vector:
    """Return the relative acceleration without thrust in L, m/s^2.

    Parameters
    ----------
    r_L : casadi (3, 1), array (3,) or (3, n_times)
        Position relative to the target in L, m.
    v_L : like ``r_L``
        Its rate of change seen in L, m/s.
    n : float or casadi scalar
        Mean motion of the target, rad/s.

    Examples
    --------
    >>> from gnc_opt.spacecraft import hill_acceleration
    >>> print(hill_acceleration([0.0, 10.0, 0.0], [0.0, 0.0, 0.0], 0.001))
    [ 0.e+00 -1.e-05  0.e+00]
    """
    return stack([2 * n * v_L[2], -(n**2) * r_L[1], -2 * n * v_L[0] + 3 * n**2 * r_L[2]])
