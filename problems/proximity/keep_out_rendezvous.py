r"""Rendezvous past a keep-out sphere: a minimum-energy flight around a station.

An inspector flies from behind the station to ahead of it. This example shows an obstacle on the straight line: the
two sides of the sphere are two minima, and a curved guess selects one.

States: ``r`` (m), ``v`` (m/s) in radial, along-track and cross-track direction. Control: ``a`` (mm/s^2).

.. math::
   \ddot x = 3 n^2 x + 2 n \dot y + a_x, \quad \ddot y = -2 n \dot x + a_y, \quad \ddot z = -n^2 z + a_z, \qquad
   \|r\| \ge 200\,\mathrm{m}, \quad J = \int a^T a \, dt

Source: own statement; the keep-out sphere of 200 m is that of the International Space Station.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MEAN_MOTION, RADIUS, DURATION = 0.00113, 200.0, 2400.0
"""rad/s, m, s."""
MILLI = 1e-3
START, END = np.array([0.0, -600.0, 20.0]), np.array([0.0, 400.0, 0.0])
"""m."""


def build(radius: float = RADIUS) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    radius : float
        Radius of the keep-out sphere, m.
    """
    inspector = go.Model("inspector")
    r, v = inspector.state("r", 3, unit="m"), inspector.state("v", 3, unit="m/s")
    a = inspector.control("a", 3, unit="mm/s^2")
    n = MEAN_MOTION
    gravity = ca.vertcat(3 * n**2 * r[0] + 2 * n * v[1], -2 * n * v[0], -(n**2) * r[2])
    inspector.ode({r: v, v: gravity + MILLI * a})

    problem = go.Problem("rendezvous past a keep-out sphere")
    leg = problem.phase("transfer", inspector)
    leg.time(initial=0.0, final=DURATION)
    leg.initial(r=START, v=np.zeros(3))
    leg.final(r=END, v=np.zeros(3))
    leg.path("keep-out sphere", ca.dot(r, r), lower=radius**2)
    past = np.array([300.0, 0.0, 0.0])
    leg.guess([0.0, DURATION / 2, DURATION], r=np.array([START, past, END]).T)
    problem.minimize(leg.integral(ca.dot(a, a)), unit="mm^2/s^3")
    return problem


REFERENCE = Reference(815.7547078, "independent Radau collocation, two meshes agree", 0.0008, "mm^2/s^3")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
