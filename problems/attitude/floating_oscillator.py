r"""Floating oscillator: two masses joined by a spring move in minimum time.

Both masses move by one unit and stop at the same time. This example shows how a flexible mode lengthens a bang-bang
manoeuvre: a rigid body of the same mass needs :math:`2 \sqrt 2` with one switch, the flexible one has three switches,
symmetric about the middle. It models a slew with one mode.

States: ``x1``, ``x2``, ``v1``, ``v2``. Control: force ``u`` on the first mass.

.. math:: \ddot x_1 = -(x_1 - x_2) + u, \qquad \ddot x_2 = x_1 - x_2, \qquad |u| \le 1

Source: J. Ben-Asher, J. A. Burns and E. M. Cliff, Time-optimal slewing of flexible spacecraft, J. Guidance 15 (1992)
360-367; T. Singh and S. R. Vadali, Robust time-optimal control, J. Guidance 17 (1994) 346-353, with 4.2182.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

import gnc_opt as go
from problems._example import Reference, example_main


def build(distance: float = 1.0) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    distance : float
    """
    masses = go.Model("two masses and a spring")
    x1, x2, v1, v2 = (masses.state(name) for name in ("x1", "x2", "v1", "v2"))
    u = masses.control("u")
    masses.ode({x1: v1, x2: v2, v1: u - (x1 - x2), v2: x1 - x2})

    problem = go.Problem("floating oscillator")
    move = problem.phase("move", masses)
    move.time(initial=0.0, final=(0.5, 20.0))
    move.initial(x1=0.0, x2=0.0, v1=0.0, v2=0.0)
    move.final(x1=distance, x2=distance, v1=0.0, v2=0.0)
    move.bounds(u=(-1.0, 1.0))
    problem.minimize(move.final_time)
    return problem


def least_time(distance: float = 1.0) -> float:
    r"""Return the least time of a control that switches at the middle and a before and after it.

    The centre of mass moves by :math:`T^2 / 8 - a^2`, and the mode of frequency :math:`\sqrt 2` comes to rest if
    :math:`2 \cos \sqrt 2 a = 1 + \cos \sqrt 2 T / 2`.
    """

    def residual(a: float) -> float:
        half = np.sqrt(2 * distance + 2 * a**2)
        return float(2 * np.cos(np.sqrt(2) * a) - 1 - np.cos(np.sqrt(2) * half))

    middle = brentq(residual, 0.5, 1.5, xtol=1e-14)
    return float(2 * np.sqrt(2 * distance + 2 * middle**2))


REFERENCE = Reference(least_time(), "closed form: symmetric switches; 4.2182 published", 2e-6)


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
