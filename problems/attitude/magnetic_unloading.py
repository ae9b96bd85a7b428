r"""Magnetic unloading: magnetic coils unload the momentum of the wheels over one orbit with minimum energy.

This example shows controls whose effect depends on the orbit: a magnetic moment has no torque along the field, so
that all three components of the momentum are removed only because the field changes direction. The problem is
linear-quadratic.

States: momentum ``h`` (N m s) in the orbit frame. Control: magnetic moment ``m`` (A m^2).

.. math:: \dot h = -\omega_0 \times h + m \times B(t), \qquad J = \tfrac12 \int m^T m \, dt

The field is that of a dipole along an orbit of given inclination.

Source: own statement; the dipole as in J. R. Wertz (editor), Spacecraft Attitude Determination and Control, 1978.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

import gnc_opt as go
from problems._example import Array, Reference, example_main

ORBIT_RATE, INCLINATION = 1.0e-3, np.radians(60.0)
"""rad/s, rad."""
DIPOLE = 2.3e-5
"""Field at the equator of the orbit, T."""
START = np.array([1.0, -2.0, 1.5])
"""N m s."""
DURATION = 2 * np.pi / ORBIT_RATE
"""s."""


def field(t: Any) -> Any:
    """Return the field along the orbit (along track, cross track, towards the Earth), T."""
    angle = ORBIT_RATE * t
    return DIPOLE * ca.vertcat(
        np.sin(INCLINATION) * ca.cos(angle), -np.cos(INCLINATION), 2 * np.sin(INCLINATION) * ca.sin(angle)
    )


def build() -> go.Problem:
    """Return the problem."""
    satellite = go.Model("satellite with coils")
    h = satellite.state("h", 3, unit="N m s")
    m = satellite.control("m", 3, unit="A m^2")
    frame = ca.DM([0.0, -ORBIT_RATE, 0.0])
    satellite.ode({h: -ca.cross(frame, h) + ca.cross(m, field(satellite.time))})

    problem = go.Problem("magnetic unloading")
    orbit = problem.phase("orbit", satellite)
    orbit.time(initial=0.0, final=DURATION)
    orbit.initial(h=START)
    orbit.final(h=np.zeros(3))
    problem.minimize(0.5 * orbit.integral(ca.dot(m, m)), unit="A^2 m^4 s")
    return problem


def least_energy() -> float:
    """Return half of z W^-1 z for the momentum z without coils and the Gramian W of their torques."""

    def slope(t: float, values: Array) -> Array:
        matrix = -_cross([0.0, -ORBIT_RATE, 0.0])
        torque = -_cross(np.asarray(field(t)).ravel())
        gramian = values[3:].reshape(3, 3)
        change = matrix @ gramian + gramian @ matrix.T + torque @ torque.T
        return np.concatenate([matrix @ values[:3], change.ravel()])

    start = np.concatenate([START, np.zeros(9)])
    end = solve_ivp(slope, (0.0, DURATION), start, "DOP853", rtol=1e-11, atol=1e-14).y[:, -1]
    return float(0.5 * end[:3] @ np.linalg.solve(end[3:].reshape(3, 3), end[:3]))


def _cross(vector: Any) -> Array:
    """Return the matrix of the cross product with a vector."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


REFERENCE = Reference(least_energy(), "Gramian of the transition matrix, integrated", 0.05, "A^2 m^4 s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
