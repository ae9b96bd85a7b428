r"""Aerocapture: a pass through the atmosphere of Mars with the cheapest capture.

This example shows an end condition that is an orbit: after the pass the apoapsis is 500 km high, and the burn there
that makes the orbit circular is minimised. Full lift up or down is optimal except at one switch.

States: ``h`` (m), ``v`` (m/s), ``gamma`` (rad). Control: ``u``, cosine of the bank angle.

.. math::
   \dot h = v \sin\gamma, \quad \dot v = -D - g \sin\gamma, \quad
   \dot\gamma = \frac{L u}{v} + \cos\gamma \Big( \frac{v}{r} - \frac{g}{v} \Big), \qquad
   J = \sqrt{\tfrac{\mu}{r_a}} - v_a

Source: own statement; the bang-bang law is that of P. Lu, C. J. Cerimele, M. A. Tigges and D. A. Matz, Optimal
aerocapture guidance, J. Guidance, Control, and Dynamics 38 (2015) 553-565.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MU, RADIUS = 4.282829e13, 3396.2e3
"""m^3/s^2, m."""
BALLISTIC, LIFT_TO_DRAG = 130.0, 0.25
"""m / (C_D A), kg/m^2; -."""
DENSITY, SCALE_HEIGHT = 0.02, 10000.0
"""kg/m^3, m."""
EDGE, ENTRY_SPEED, ENTRY_ANGLE, APOAPSIS = 125e3, 5800.0, float(np.radians(-10.6)), 500e3
"""m, m/s, rad, m."""


def build() -> go.Problem:
    """Return the problem."""
    probe = go.Model("probe")
    h, v = probe.state("h", unit="m"), probe.state("v", unit="m/s")
    gamma = probe.state("gamma", unit="rad")
    u = probe.control("u")
    r = RADIUS + h
    g = MU / r**2
    drag = 0.5 * DENSITY * ca.exp(-h / SCALE_HEIGHT) * v**2 / BALLISTIC
    probe.ode(
        {
            h: v * ca.sin(gamma),
            v: -drag - g * ca.sin(gamma),
            gamma: LIFT_TO_DRAG * drag * u / v + ca.cos(gamma) * (v / r - g / v),
        }
    )

    problem = go.Problem("aerocapture")
    leg = problem.phase("flight", probe)
    leg.time(initial=0.0, final=(100.0, 1500.0))
    leg.initial(h=EDGE, v=ENTRY_SPEED, gamma=ENTRY_ANGLE)
    leg.final(h=EDGE, gamma=(0.0, 0.5))
    leg.bounds(h=(20e3, 130e3), v=(2500.0, 6500.0), gamma=(-0.4, 0.4), u=(-1.0, 1.0))
    leg.guess(
        [0.0, 150.0, 450.0],
        h=[EDGE, 45e3, EDGE],
        v=[ENTRY_SPEED, 4700.0, 3600.0],
        gamma=[ENTRY_ANGLE, 0.0, 0.08],
    )
    far, near = RADIUS + APOAPSIS, RADIUS + EDGE
    speed, slope = leg.final_state("v"), leg.final_state("gamma")
    tangential = near * speed * ca.cos(slope) / far  # at the apoapsis, by the angular momentum
    energy = (speed**2 - tangential**2) / 2 - MU / near + MU / far
    problem.constrain("apoapsis", energy / (MU / far), equals=0.0)
    problem.minimize(np.sqrt(MU / far) - tangential, unit="m/s")
    return problem


REFERENCE = Reference(113.95016, "independent Radau collocation, converges to it", 0.0002, "m/s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
