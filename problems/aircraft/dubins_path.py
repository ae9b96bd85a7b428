r"""Dubins path: the shortest path with a limited turn rate.

This example shows a bang-singular turn rate: circles of the least radius joined by a straight line, on which the
switching function vanishes. The length has a closed form. A path with the opposite turn is another minimum.

States: ``x``, ``y`` (km), heading ``psi`` (rad). Control: turn rate ``u`` (rad/s).

.. math:: \dot x = V \cos\psi, \qquad \dot y = V \sin\psi, \qquad \dot\psi = u, \qquad |u| \le V / R

Source: L. E. Dubins, On curves of minimal length with a constraint on average curvature, American J. Mathematics 79
(1957) 497-516.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

SPEED, RADIUS = 0.2, 1.5
"""km/s, km."""
START, END = (0.0, 0.0, np.pi / 2), (9.0, -3.0, np.pi / 6)
"""x, y (km) and heading (rad)."""


def build() -> go.Problem:
    """Return the problem."""
    aircraft = go.Model("aircraft")
    x, y = aircraft.state("x", unit="km"), aircraft.state("y", unit="km")
    psi = aircraft.state("psi", unit="rad")
    u = aircraft.control("u", unit="rad/s")
    aircraft.ode({x: SPEED * ca.cos(psi), y: SPEED * ca.sin(psi), psi: u})

    problem = go.Problem("Dubins path")
    path = problem.phase("path", aircraft)
    path.time(initial=0.0, final=(10.0, 200.0))
    path.initial(**dict(zip(("x", "y", "psi"), START, strict=True)))
    path.final(**dict(zip(("x", "y", "psi"), END, strict=True)))
    path.bounds(u=(-SPEED / RADIUS, SPEED / RADIUS), psi=(-np.pi, np.pi))
    problem.minimize(path.final_time)
    return problem


def right_straight_left() -> float:
    """Return the time along a right turn, the inner tangent of two circles, and a left turn, s."""
    centre = np.array([START[0] + RADIUS * np.sin(START[2]), START[1] - RADIUS * np.cos(START[2])])
    other = np.array([END[0] - RADIUS * np.sin(END[2]), END[1] + RADIUS * np.cos(END[2])])
    distance = float(np.hypot(*(other - centre)))
    straight = float(np.sqrt(distance**2 - 4 * RADIUS**2))
    heading = float(np.arctan2(*(other - centre)[::-1])) - float(np.arctan2(2 * RADIUS, straight))
    turned = (START[2] - heading) % (2 * np.pi) + (END[2] - heading) % (2 * np.pi)
    return (straight + RADIUS * turned) / SPEED


REFERENCE = Reference(right_straight_left(), "closed form: right turn, straight line, left turn", 3e-5, "s")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
