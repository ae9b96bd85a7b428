r"""Zermelo's navigation problem: steer a boat home in minimum time through a current that shears.

This example shows the meaning of the costates: they are antiparallel to the heading, so that the steering law
:math:`d(\tan\theta)/dt = k` is the adjoint equation :math:`\dot\lambda_y = k \lambda_x`. The boat first climbs 1 m
past the target in y, where the current runs towards it, and drops back at the end.

States: ``x``, ``y`` (m). Control: ``theta``, the heading (rad). The boat makes V = 1 m/s through water that flows with
-k y in x, k = 1/s.

.. math::
   \dot x = V \cos\theta - k y, \qquad \dot y = V \sin\theta

In closed form, with :math:`s = 1 / \cos\theta`, :math:`T = \tan\theta` and the heading :math:`\theta_f` at home
(V = k = 1):

.. math::
   y = s - s_f, \quad x = F(\theta) - F(\theta_f), \quad F = \tfrac12 (\ln|s + T| - s T) + s_f T, \quad t = T - T_0

Source: Zermelo, 1931; Bryson and Ho, Applied Optimal Control, 1975, section 2.7 (5.46 s, 105 to 240 degrees).
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import fsolve

import gnc_opt as go
from problems._example import Array, Extremal, Reference, example_main

START = (3.66, -1.86)
"""x and y, m."""


def build(start: Sequence[float] = START, speed: float = 1.0, shear: float = 1.0) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    start : (x, y)
        m.
    speed : float
        Of the boat through the water, m/s.
    shear : float
        Of the current, 1/s.
    """
    boat = go.Model("boat")
    x = boat.state("x", unit="m")
    y = boat.state("y", unit="m")
    theta = boat.control("theta", unit="rad")
    v = boat.parameter("speed", speed, unit="m/s")
    k = boat.parameter("shear", shear, unit="1/s")
    boat.ode({x: v * ca.cos(theta) - k * y, y: v * ca.sin(theta)})

    problem = go.Problem("Zermelo navigation")
    passage = problem.phase("passage", boat)
    passage.time(initial=0.0, final=(0.5, 20.0))
    passage.initial(x=start[0], y=start[1])
    passage.final(x=0.0, y=0.0)
    passage.bounds(theta=(-2 * np.pi, 2 * np.pi))
    passage.guess([0.0, 5.0], theta=3 * np.pi / 4)
    problem.minimize(passage.final_time)
    return problem


def _sec(theta: ArrayLike) -> Array:
    return np.asarray(1 / np.cos(theta))


def _offset(theta: ArrayLike, theta_f: float) -> Array:
    """Return x as a function of the heading, m."""

    def primitive(angle: ArrayLike) -> Array:
        s, tan = _sec(angle), np.tan(angle)
        return np.asarray((np.log(np.abs(s + tan)) - s * tan) / 2 + _sec(theta_f) * tan)

    return primitive(theta) - primitive(theta_f)


def headings() -> tuple[float, float]:
    """Return the optimal headings at the start and at home, rad."""

    def miss(angles: Array) -> list[float]:
        first, last = angles
        return [float(_offset(first, last) - START[0]), float(_sec(first) - _sec(last) - START[1])]

    first, last = fsolve(miss, np.radians([105.0, 240.0]), xtol=1e-13)
    return float(first), float(last)


def closed_form(t: Array) -> Extremal:
    """Return the optimal passage and its costates at times t (s)."""
    first, last = headings()
    # The heading turns from the second to the third quadrant, where the tangent is monotonous.
    theta = np.pi + np.arctan(np.tan(first) + t)
    y = _sec(theta) - _sec(last)
    size = 1 / (1 - y * np.cos(theta))
    return Extremal(
        states={"x": _offset(theta, last), "y": y},
        controls={"theta": theta},
        costates={"x": -size * np.cos(theta), "y": -size * np.sin(theta)},
    )


def _least_time() -> float:
    first, last = headings()
    return float(np.tan(last) - np.tan(first))


REFERENCE = Reference(_least_time(), "closed form: tan(theta) grows linearly", 1e-8, "s")


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
