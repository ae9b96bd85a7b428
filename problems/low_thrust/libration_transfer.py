r"""Libration transfer: minimum-energy low thrust from L1 to L2.

This example shows the restricted three-body problem in rotating coordinates. The motion is unstable, so that small
thrust has a large effect. Several ways past the Moon are local minima; the guess passes it slowly on the far side of
L1.

States: ``x``, ``y``, ``vx``, ``vy`` in the rotating frame; units of the Earth-Moon distance and month. Control:
``ax``, ``ay``.

.. math::
   \ddot x = 2 \dot y + \partial_x \Omega + a_x, \quad \ddot y = -2 \dot x + \partial_y \Omega + a_y, \qquad
   \Omega = \tfrac12 (x^2 + y^2) + \frac{1 - \mu}{r_1} + \frac{\mu}{r_2}, \quad J = \tfrac12 \int a^T a \, dt

Source: own statement; equations as in V. Szebehely, Theory of Orbits, Academic Press 1967.
"""

from __future__ import annotations

import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MU = 0.0121505856
"""Mass of the Moon over that of both."""
L1, L2 = 0.8369151, 1.1556825
"""Places of the libration points on the line through Earth and Moon."""
DURATION = 6.0
"""About 26 days."""


def build(duration: float = DURATION) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    duration : float
    """
    probe = go.Model("probe")
    x, y, vx, vy = (probe.state(name) for name in ("x", "y", "vx", "vy"))
    ax, ay = probe.control("ax"), probe.control("ay")
    earth = ((x + MU) ** 2 + y**2) ** 1.5
    moon = ((x - 1 + MU) ** 2 + y**2) ** 1.5
    probe.ode(
        {
            x: vx,
            y: vy,
            vx: 2 * vy + x - (1 - MU) * (x + MU) / earth - MU * (x - 1 + MU) / moon + ax,
            vy: -2 * vx + y - (1 - MU) * y / earth - MU * y / moon + ay,
        }
    )

    problem = go.Problem("libration transfer", time_unit="month/2π")
    transfer = problem.phase("transfer", probe)
    transfer.time(initial=0.0, final=duration)
    transfer.initial(x=L1, y=0.0, vx=0.0, vy=0.0)
    transfer.final(x=L2, y=0.0, vx=0.0, vy=0.0)
    transfer.bounds(x=(0.5, 1.5), y=(-0.5, 0.5))
    transfer.guess(
        duration * np.array([0.0, 0.3, 0.5, 0.7, 1.0]),
        x=[L1, L1, 0.88, L2, L2],
        y=[0.0, 0.0, 0.03, 0.02, 0.0],
        vx=[0.0, 0.0, 0.1, 0.0, 0.0],
        vy=[0.0, 0.1, -0.2, 0.1, 0.0],
    )
    problem.minimize(0.5 * transfer.integral(ax**2 + ay**2))
    return problem


REFERENCE = Reference(0.01358875, "independent Radau collocation from nearby", 2e-8)


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
