r"""Soft landing on the Moon with minimum fuel: free fall, then full thrust.

The cost and the dynamics are linear in the control, so the optimum has one unknown, the ignition time. Collocation
alone finds it to the width of a segment; with switching times as variables it is exact to machine precision. The
final time is free and does not enter the cost, so H = 0.

States: ``h`` (m), ``v`` (m/s, upwards). Control: ``thrust`` per mass (m/s²), 0 to 3; gravity is 1.5 m/s².

.. math::
   \dot h = v, \qquad \dot v = u - g, \qquad J = \int_0^{t_f} u\,dt

Closed form: the control is 0 until the switch at :math:`t_s`, then 3 until :math:`t_f`:

.. math::
   t_s = \frac{2 \sqrt{17} - 4}{3}, \quad t_f = 2 t_s + \tfrac43, \quad J = 2 \sqrt{17}, \quad
   \lambda_h = \frac{3}{2 \sqrt{17}}, \quad \lambda_v = -1 + \lambda_h (t_s - t)

Source: Meditch, On the problem of optimal thrust programming for a lunar soft landing, IEEE Trans. Automatic
Control 9 (4), 1964.
"""

from __future__ import annotations

import numpy as np

import gnc_opt as go
from problems._example import Array, Extremal, Reference, example_main

GRAVITY = 1.5
"""m/s^2."""
MAX_THRUST = 3.0
"""Per mass, m/s^2."""
ALTITUDE, SPEED = 10.0, -2.0
"""At the start, m and m/s."""
IGNITION = (2 * np.sqrt(17) - 4) / 3
"""s, for the data above."""
TOUCHDOWN = 2 * IGNITION + 4 / 3
"""s, for the data above."""


def build(altitude: float = ALTITUDE, speed: float = SPEED) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    altitude, speed : float
        Initial altitude, m, and vertical speed, m/s (upwards).
    """
    lander = go.Model("lander")
    h = lander.state("h", unit="m")
    v = lander.state("v", unit="m/s")
    thrust = lander.control("thrust", unit="m/s^2")
    g = lander.parameter("gravity", GRAVITY, unit="m/s^2")
    lander.ode({h: v, v: thrust - g})

    problem = go.Problem("soft landing on the Moon")
    descent = problem.phase("descent", lander)
    descent.time(initial=0.0, final=(0.1, 20.0))
    descent.initial(h=altitude, v=speed)
    descent.final(h=0.0, v=0.0)
    descent.bounds(thrust=(0.0, MAX_THRUST))
    problem.minimize(descent.integral(thrust, "fuel"), unit="m/s")
    return problem


def closed_form(t: Array) -> Extremal:
    """Return the optimal descent and its costates at times t (s)."""
    falling, left = t < IGNITION, TOUCHDOWN - t
    brake = MAX_THRUST - GRAVITY
    lam_h = 3 / (2 * np.sqrt(17))
    return Extremal(
        states={
            "h": np.where(falling, ALTITUDE + SPEED * t - GRAVITY * t**2 / 2, brake * left**2 / 2),
            "v": np.where(falling, SPEED - GRAVITY * t, -brake * left),
        },
        controls={"thrust": np.where(falling, 0.0, MAX_THRUST)},
        costates={"h": np.full_like(t, lam_h), "v": -1 + lam_h * (IGNITION - t)},
    )


REFERENCE = Reference(float(2 * np.sqrt(17)), "closed form: 2 sqrt(17)", 1e-8, "m/s")


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
