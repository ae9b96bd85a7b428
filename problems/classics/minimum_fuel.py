r"""Minimum fuel, rest to rest: a cart moves 1 m in 3 s.

This example shows an absolute value in the cost and the bang-off-bang optimum. The absolute value is written as two
one-sided controls, each with its own jet, so that no function has a kink. If the time is longer than the 2 s that
full thrust needs, the optimum coasts. The primer :math:`\lambda_v` selects the jet: forwards below -1, backwards
above +1, none between.

States: ``x`` (m), ``v`` (m/s). Controls: ``forward``, ``backward`` (m/s^2), 0 to 1.

.. math::
   \dot x = v, \qquad \dot v = u^+ - u^-, \qquad J = \int_0^T (u^+ + u^-)\,dt

Closed form: switches at s and T - s, with

.. math::
   s = \frac{T - \sqrt{T^2 - 4}}{2}, \qquad J = 2 s, \qquad \lambda_x = -\frac{2}{\sqrt{T^2 - 4}}, \qquad
   \lambda_v = \lambda_x (T / 2 - t)
"""

from __future__ import annotations

import numpy as np

import gnc_opt as go
from problems._example import Array, Extremal, Reference, example_main

DURATION = 3.0
"""T, s; at least 2."""
SWITCH = (DURATION - np.sqrt(DURATION**2 - 4)) / 2
"""End of the first burn, s."""


def build(duration: float = DURATION) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    duration : float
        s; less than 2 cannot be done.
    """
    cart = go.Model("double integrator with two jets")
    x = cart.state("x", unit="m")
    v = cart.state("v", unit="m/s")
    forward = cart.control("forward", unit="m/s^2")
    backward = cart.control("backward", unit="m/s^2")
    cart.ode({x: v, v: forward - backward})

    problem = go.Problem("minimum fuel, rest to rest")
    move = problem.phase("move", cart)
    move.time(initial=0.0, final=duration)
    move.initial(x=0.0, v=0.0)
    move.final(x=1.0, v=0.0)
    move.bounds(forward=(0.0, 1.0), backward=(0.0, 1.0))
    problem.minimize(move.integral(forward + backward, "impulse"), unit="m/s")
    return problem


def closed_form(t: Array) -> Extremal:
    """Return the optimal move and its costates at times t (s)."""
    left = DURATION - t
    burns = [t < SWITCH, left < SWITCH]
    lam_x = -2 / np.sqrt(DURATION**2 - 4)
    return Extremal(
        states={
            "x": np.select(burns, [t**2 / 2, 1 - left**2 / 2], SWITCH**2 / 2 + SWITCH * (t - SWITCH)),
            "v": np.select(burns, [t, left], SWITCH),
        },
        controls={"forward": np.where(burns[0], 1.0, 0.0), "backward": np.where(burns[1], 1.0, 0.0)},
        costates={"x": np.full_like(t, lam_x), "v": lam_x * (DURATION / 2 - t)},
    )


REFERENCE = Reference(float(2 * SWITCH), "closed form: 3 - sqrt(5)", 1e-9, "m/s")


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
