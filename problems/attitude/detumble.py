r"""Detumbling: a satellite stops its rotation in minimum time.

This example shows a minimum time in closed form: a torque opposed to the angular momentum lowers its magnitude at the
highest rate for any inertia, so that the time is :math:`\|J \omega_0\| / T`. The components of the torque in the body
follow a tumbling momentum.

States: ``w`` (body rates, rad/s). Control: vector ``u`` (N m).

.. math:: J \dot\omega = -\omega \times J \omega + u, \qquad \|u\| \le T

Source: M. Athans, P. L. Falb and R. T. Lacoss, Time-, fuel-, and energy-optimal control of nonlinear norm-invariant
systems, IEEE Trans. Automatic Control 8 (1963) 196-202.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

INERTIA = np.array([1200.0, 900.0, 600.0])
"""kg m^2."""
FIRST_RATES = np.radians([4.0, -3.0, 8.0])
"""rad/s."""
MAX_TORQUE = 2.0
"""N m."""


def build(max_torque: float = MAX_TORQUE) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    max_torque : float
        Largest magnitude of the torque vector, N m.
    """
    satellite = go.Model("satellite")
    w = satellite.state("w", 3, unit="rad/s")
    u, _ = satellite.vector_control("u", 3, unit="N m")
    inertia = ca.DM(INERTIA)
    satellite.ode({w: (u - ca.cross(w, inertia * w)) / inertia})

    problem = go.Problem("detumbling")
    stop = problem.phase("stop", satellite)
    stop.time(initial=0.0, final=(5.0, 500.0))
    stop.initial(w=FIRST_RATES)
    stop.final(w=np.zeros(3))
    stop.norm_bounds(u=(0.0, max_torque))
    problem.minimize(stop.final_time)
    return problem


REFERENCE = Reference(
    float(np.linalg.norm(INERTIA * FIRST_RATES)) / MAX_TORQUE, "closed form: momentum over torque", 5e-5, "s"
)


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
