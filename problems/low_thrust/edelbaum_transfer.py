r"""Edelbaum's transfer: a low-thrust transfer with a plane change.

This example shows averaging: over hundreds of revolutions only speed and inclination matter, and the yaw angle of the
thrust changes sign every half revolution. The optimum is a straight line in the plane of polar coordinates (speed,
:math:`\pi/2` times inclination).

States: circular speed ``V`` (km/s), inclination change ``i`` (rad). Control: ``yaw`` (rad). Time is the velocity change
spent, since the acceleration is constant.

.. math::
   V' = -\cos\beta, \qquad i' = \frac{2}{\pi} \frac{\sin\beta}{V}, \qquad
   \Delta V = \sqrt{V_0^2 + V_f^2 - 2 V_0 V_f \cos\tfrac{\pi}{2} \Delta i}

Source: T. N. Edelbaum, Propulsion requirements for controllable satellites, ARS Journal 31 (1961) 1079-1089.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MU, EARTH_RADIUS = 398600.4418, 6378.137
"""km^3/s^2, km."""
LOW, HIGH = (float(np.sqrt(MU / r)) for r in (EARTH_RADIUS + 622.0, 42164.0))
"""Speeds of both orbits, km/s."""
TURN = float(np.radians(28.5))
"""rad."""


def build(turn: float = TURN) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    turn : float
        Change of the inclination, rad.
    """
    satellite = go.Model("satellite")
    speed = satellite.state("V", unit="km/s")
    inclination = satellite.state("i", unit="rad")
    yaw = satellite.control("yaw", unit="rad")
    satellite.ode({speed: -ca.cos(yaw), inclination: 2 / np.pi * ca.sin(yaw) / speed})

    problem = go.Problem("Edelbaum's transfer")
    transfer = problem.phase("transfer", satellite)
    transfer.time(initial=0.0, final=(1.0, 20.0))
    transfer.initial(V=LOW, i=0.0)
    transfer.final(V=HIGH, i=turn)
    transfer.bounds(V=(1.0, 20.0), yaw=(0.0, np.pi))
    problem.minimize(transfer.final_time, unit="km/s")
    return problem


def velocity_change(turn: float = TURN) -> float:
    """Return Edelbaum's closed form, km/s."""
    return float(np.sqrt(LOW**2 + HIGH**2 - 2 * LOW * HIGH * np.cos(np.pi / 2 * turn)))


REFERENCE = Reference(velocity_change(), "closed form of Edelbaum", 1e-6, "km/s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
