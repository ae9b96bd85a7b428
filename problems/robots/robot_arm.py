r"""Robot arm: swing a telescopic arm through 120 degrees in minimum time.

This example shows bang-bang control with several channels. Three controls switch at five different times, which a
fixed mesh cannot all meet. Mesh refinement converges slowly to such a solution; with switching times as variables it
is exact to ten digits. The arm slides towards its middle, where its inertia is least, and out again.

States: ``rho`` (length on one side of the pivot), ``theta`` (azimuth, rad), ``phi`` (from the vertical, rad)
and their rates ``rho_rate``, ``theta_rate``, ``phi_rate``. Controls: ``u_rho``, ``u_theta``, ``u_phi``, -1 to
1. Lengths, masses and forces are normalised; the arm is L = 5 long.

.. math::
   L \ddot\rho = u_\rho, \qquad I_\theta \ddot\theta = u_\theta, \qquad I_\phi \ddot\phi = u_\phi, \qquad
   I_\phi = \frac{(L - \rho)^3 + \rho^3}{3}, \quad I_\theta = I_\phi \sin^2\phi

Source: Dolan, More and Munson, Benchmarking optimization software with COPS 3.0, 2004 (9.14093).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

LENGTH = 5.0
"""L."""
SWITCH_TIMES = {
    "u_rho": (2.2852279365, 6.8556838094),
    "u_theta": (4.5704558730,),
    "u_phi": (2.7960432100, 6.3448685359),
}
"""From an independent calculation, s."""


def build(turn: float = 2 * np.pi / 3) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    turn : float
        Azimuth to swing through, rad.
    """
    arm = go.Model("telescopic arm")
    rho = arm.state("rho")
    rho_rate = arm.state("rho_rate")
    theta = arm.state("theta", unit="rad")
    theta_rate = arm.state("theta_rate", unit="rad/s")
    phi = arm.state("phi", unit="rad")
    phi_rate = arm.state("phi_rate", unit="rad/s")
    u_rho, u_theta, u_phi = (arm.control(name) for name in ("u_rho", "u_theta", "u_phi"))
    inertia_phi = ((LENGTH - rho) ** 3 + rho**3) / 3
    inertia_theta = inertia_phi * ca.sin(phi) ** 2
    arm.ode(
        {
            rho: rho_rate,
            rho_rate: u_rho / LENGTH,
            theta: theta_rate,
            theta_rate: u_theta / inertia_theta,
            phi: phi_rate,
            phi_rate: u_phi / inertia_phi,
        }
    )

    problem = go.Problem("robot arm")
    swing = problem.phase("swing", arm)
    swing.time(initial=0.0, final=(1.0, 30.0))
    at_rest = {"rho_rate": 0.0, "theta_rate": 0.0, "phi_rate": 0.0}
    swing.initial(rho=4.5, theta=0.0, phi=np.pi / 4, **at_rest)
    swing.final(rho=4.5, theta=turn, phi=np.pi / 4, **at_rest)
    swing.bounds(rho=(0.0, LENGTH), theta=(-np.pi, np.pi), phi=(0.0, np.pi))
    swing.bounds(u_rho=(-1.0, 1.0), u_theta=(-1.0, 1.0), u_phi=(-1.0, 1.0))
    swing.guess([0.0, 8.0])
    problem.minimize(swing.final_time)
    return problem


REFERENCE = Reference(9.1409117459, "independent, switch times optimised", 1e-8, "s")


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
