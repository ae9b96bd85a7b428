r"""Brachistochrone: the curve of fastest descent between two points.

A bead slides from (0, 0) to (2 m, 2 m) without friction. This is the smallest problem with a free final time, a free
final state and a control, and its costates are known at every instant. It shows two signs, :math:`H = -1` throughout
and :math:`\lambda(t_0) = dJ^*/dx_0`, and a false extremal: if the angle may go from 0 to :math:`2 \pi`, a solver may
stop at a stationary point with a time of 0.8642 s, where the angle is :math:`2 \pi` at some points. The range below is
therefore 0 to :math:`\pi`.

States: ``x``, ``y`` (m, y downwards), ``v`` (m/s). Control: ``theta``, the angle of the path from the vertical (rad).

.. math::
   \dot x = v \sin\theta, \qquad \dot y = v \cos\theta, \qquad \dot v = g \cos\theta

The optimum is a cycloid of radius R, with :math:`a = t \sqrt{g / R}`:

.. math:: x = R (a - \sin a), \qquad y = R (1 - \cos a), \qquad \theta = a / 2

Source: Johann Bernoulli, 1696; Bryson and Ho, Applied Optimal Control, 1975.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from scipy.optimize import brentq

import gnc_opt as go
from problems._example import Array, Extremal, Reference, example_main

GRAVITY = 9.8
"""m/s^2."""
TARGET = (2.0, 2.0)
"""x and y, m."""


def build(target: Sequence[float] = TARGET, gravity: float = GRAVITY) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    target : (x, y)
        End point of the wire, m; y points down.
    gravity : float
        Gravitational acceleration, m/s^2.
    """
    bead = go.Model("bead")
    x = bead.state("x", unit="m")
    y = bead.state("y", unit="m")
    v = bead.state("v", unit="m/s")
    theta = bead.control("theta", unit="rad")
    g = bead.parameter("gravity", gravity, unit="m/s^2")
    bead.ode({x: v * ca.sin(theta), y: v * ca.cos(theta), v: g * ca.cos(theta)})

    problem = go.Problem("brachistochrone")
    slide = problem.phase("slide", bead)
    slide.time(initial=0.0, final=(0.1, 10.0))
    slide.initial(x=0.0, y=0.0, v=0.0)
    slide.final(x=target[0], y=target[1])
    slide.bounds(theta=(0.0, np.pi))
    problem.minimize(slide.final_time)
    return problem


def _cycloid() -> tuple[float, float]:
    """Return the final angle a (rad) and the radius R (m) of the cycloid through the target."""
    x, y = TARGET
    angle = brentq(lambda a: (a - np.sin(a)) / (1 - np.cos(a)) - x / y, 0.1, 6.0, xtol=1e-15)
    return angle, y / (1 - np.cos(angle))


def closed_form(t: Array) -> Extremal:
    """Return the cycloid and its costates at times t (s).

    Stationarity and H = -1 say lam_x v = -sin(theta) and lam_y v + lam_v g = -cos(theta); lam_x and lam_y are
    constant, and lam_v vanishes at the end.
    """
    angle, radius = _cycloid()
    a = t * np.sqrt(GRAVITY / radius)
    fastest = np.sqrt(4 * GRAVITY * radius)
    v, theta = fastest * np.sin(a / 2), a / 2
    lam_y = -np.cos(angle / 2) / (fastest * np.sin(angle / 2))
    return Extremal(
        states={"x": radius * (a - np.sin(a)), "y": radius * (1 - np.cos(a)), "v": v},
        controls={"theta": theta},
        costates={
            "x": np.full_like(t, -1 / fastest),
            "y": np.full_like(t, lam_y),
            "v": (-np.cos(theta) - lam_y * v) / GRAVITY,
        },
    )


def _least_time() -> float:
    angle, radius = _cycloid()
    return float(angle * np.sqrt(radius / GRAVITY))


REFERENCE = Reference(_least_time(), "closed form: cycloid", 1e-9, "s")


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
