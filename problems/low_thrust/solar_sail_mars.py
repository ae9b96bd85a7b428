r"""Solar sail to Mars: the fastest flight without propellant.

This example shows an angle as control, without active bounds: the acceleration by the sail falls with the square of
the cosine of its cone angle and cannot point towards the Sun.

States: ``r``, ``theta`` (rad), ``v_r``, ``v_t``; astronomical units and mu = 1. Control: cone angle ``alpha`` (rad).

.. math::
   \dot v_r = \frac{v_t^2}{r} - \frac{1}{r^2} + \beta \frac{\cos^3 \alpha}{r^2}, \qquad
   \dot v_t = -\frac{v_r v_t}{r} + \beta \frac{\cos^2 \alpha \sin\alpha}{r^2}

Source: A. N. Zhukov and V. N. Lebedev, Variational problem of transfer between heliocentric circular orbits by means of
a solar sail, Cosmic Research 2 (1964) 41-44; C. R. McInnes, Solar Sailing, Springer 1999, chapter 4.
"""

from __future__ import annotations

import casadi as ca

import gnc_opt as go
from problems._example import Reference, example_main

ACCELERATION = 1e-3
"""Characteristic acceleration at 1 AU, m/s^2."""
SUN_GRAVITY = 5.930e-3
"""Of the Sun at 1 AU, m/s^2."""
TARGET = 1.52368
"""AU."""
DAY = 58.132441
"""Days per unit of time."""


def build(acceleration: float = ACCELERATION) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    acceleration : float
        Characteristic acceleration, m/s^2.
    """
    sail = go.Model("solar sail")
    r, theta = sail.state("r", unit="AU"), sail.state("theta", unit="rad")
    v_r, v_t = sail.state("v_r"), sail.state("v_t")
    alpha = sail.control("alpha", unit="rad")
    push = acceleration / SUN_GRAVITY * ca.cos(alpha) ** 2 / r**2
    sail.ode(
        {
            r: v_r,
            theta: v_t / r,
            v_r: v_t**2 / r - 1 / r**2 + push * ca.cos(alpha),
            v_t: -v_r * v_t / r + push * ca.sin(alpha),
        }
    )

    problem = go.Problem("solar sail to Mars")
    transfer = problem.phase("transfer", sail)
    transfer.time(initial=0.0, final=(2.0, 20.0))
    transfer.initial(r=1.0, theta=0.0, v_r=0.0, v_t=1.0)
    transfer.final(r=TARGET, v_r=0.0, v_t=TARGET**-0.5)
    transfer.bounds(r=(0.5, 2.0), alpha=(-1.2, 1.2))
    transfer.guess(alpha=0.6)
    problem.minimize(transfer.final_time * DAY, unit="days")
    return problem


REFERENCE = Reference(407.709105, "independent Radau collocation, best of several meshes", 4e-4, "days")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
