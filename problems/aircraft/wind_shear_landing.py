r"""Abort landing in a wind shear: the largest minimum altitude in a downburst.

This example shows a minimax objective: the parameter ``lowest``, a lower limit of the altitude, is maximised, so that
the trajectory touches it several times. The limit is of third order (altitude, climb rate, flight path, rate of the
angle of attack), and tables of wind and thrust have kinks.

States: ``x``, ``h`` (ft), airspeed ``v`` (ft/s), ``gamma``, ``alpha`` (rad). Control: ``rate`` of alpha (rad/s).

.. math::
   \dot x = v \cos\gamma + W_x, \quad \dot h = v \sin\gamma + W_h, \quad
   \dot v = \frac{T \cos(\alpha + \delta) - D}{m} - g \sin\gamma - \dot W_x \cos\gamma - \dot W_h \sin\gamma

.. math::
   \dot\gamma = \frac{T \sin(\alpha + \delta) + L}{m v} - \frac{g \cos\gamma}{v}
   + \frac{\dot W_x \sin\gamma - \dot W_h \cos\gamma}{v}, \qquad \dot\alpha = u, \qquad \max \min_t h(t)

The thrust rises from 38 % to full in 3 s. The wind turns from head to tail wind between 500 and 4100 ft, with a
downdraught between.

Source: R. Bulirsch, F. Montrone and H. J. Pesch, Abort landing in the presence of windshear as a minimax optimal
control problem, J. Optimization Theory and Applications 70 (1991) 1-23 and 223-254; numbers as in ICLOCS2 and in
J. T. Betts, Practical Methods for Optimal Control, 2010, example 6.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

GRAVITY = 32.172
"""ft/s^2."""
MASS = 150000.0 / GRAVITY
"""slug."""
DENSITY, AREA = 2.203e-3, 1560.0
"""slug/ft^3, ft^2."""
ENGINE_TILT, STALL = np.radians(2.0), np.radians(12.0)
"""delta, and the angle of attack above which lift grows more slowly; rad."""
FULL_THRUST = (44560.0, -23.98, 0.01442)
"""Coefficients of 1, v, v^2; lb."""
SHEAR_BEGINS, SHEAR_ENDS, EDGE = 500.0, 4100.0, 500.0
"""Of the linear part of the horizontal wind, and the length of the smooth parts before and after; ft."""
DOWNDRAUGHT_WIDTH = np.log(30.6 / 25.0) * 1e-12
"""1/ft^4."""
DURATION = 40.0
"""s."""


def wind(x: Any, h: Any) -> tuple[Any, Any]:
    """Return the horizontal and the vertical wind, ft/s."""

    def edge(cubic: float, quartic: float, distance: Any) -> Any:
        return cubic * distance**3 + quartic * distance**4

    after = SHEAR_ENDS + EDGE - x
    outside = x >= SHEAR_ENDS + EDGE
    horizontal = ca.if_else(
        x < SHEAR_BEGINS,
        -50.0 + edge(6e-8, -4e-11, x),
        ca.if_else(
            x < SHEAR_ENDS, (x - 2300.0) / 40.0, ca.if_else(outside, 50.0, 50.0 - edge(6e-8, -4e-11, after))
        ),
    )
    cubic, quartic = -8.02881e-8, 6.28083e-11
    down = ca.if_else(
        x < SHEAR_BEGINS,
        edge(cubic, quartic, x),
        ca.if_else(
            x < SHEAR_ENDS,
            -51.0 * ca.exp(-DOWNDRAUGHT_WIDTH * (x - 2300.0) ** 4),
            ca.if_else(outside, 0.0, edge(cubic, quartic, after)),
        ),
    )
    return horizontal, down * h / 1000.0


def build() -> go.Problem:
    """Return the problem."""
    airliner = go.Model("B-727")
    x = airliner.state("x", unit="ft")
    h = airliner.state("h", unit="ft")
    v = airliner.state("v", unit="ft/s")
    gamma = airliner.state("gamma", unit="rad")
    alpha = airliner.state("alpha", unit="rad")
    rate = airliner.control("rate", unit="rad/s")

    lever = ca.fmin(0.3825 + 0.2 * airliner.time, 1.0)
    thrust = lever * sum(c * v**k for k, c in enumerate(FULL_THRUST))
    pressure_area = 0.5 * DENSITY * AREA * v**2
    drag = pressure_area * (0.1552 + 0.12369 * alpha + 2.4203 * alpha**2)
    lift = pressure_area * (0.7125 + 6.0877 * alpha - 9.0277 * ca.fmax(alpha - STALL, 0.0) ** 2)
    wind_x, wind_h = wind(x, h)
    x_rate, h_rate = v * ca.cos(gamma) + wind_x, v * ca.sin(gamma) + wind_h
    wind_x_rate = ca.jacobian(wind_x, x) * x_rate
    wind_h_rate = ca.jacobian(wind_h, x) * x_rate + ca.jacobian(wind_h, h) * h_rate
    airliner.ode(
        {
            x: x_rate,
            h: h_rate,
            v: (thrust * ca.cos(alpha + ENGINE_TILT) - drag) / MASS
            - GRAVITY * ca.sin(gamma)
            - wind_x_rate * ca.cos(gamma)
            - wind_h_rate * ca.sin(gamma),
            gamma: (thrust * ca.sin(alpha + ENGINE_TILT) + lift) / (MASS * v)
            - GRAVITY * ca.cos(gamma) / v
            + (wind_x_rate * ca.sin(gamma) - wind_h_rate * ca.cos(gamma)) / v,
            alpha: rate,
        }
    )

    problem = go.Problem("abort landing in a wind shear")
    lowest = problem.parameter("lowest", lower=300.0, upper=1000.0, guess=500.0, unit="ft")
    leg = problem.phase("go_around", airliner)
    leg.time(initial=0.0, final=DURATION)
    leg.initial(x=0.0, h=600.0, v=239.7, gamma=-0.03925, alpha=0.1283)
    leg.final(gamma=0.12969)
    leg.bounds(x=(0.0, 12000.0), h=(100.0, 2000.0), v=(100.0, 400.0), gamma=(-0.5, 0.5))
    leg.bounds(alpha=(-0.3002, 0.3002), rate=(-0.05236, 0.05236))
    leg.path("clearance", h - lowest, lower=0.0)
    leg.guess(x=(0.0, 9000.0), h=(600.0, 850.0), v=239.7, gamma=(-0.03925, 0.12969), alpha=0.1283)
    problem.maximize(lowest)
    return problem


REFERENCE = Reference(502.21577, "independent Radau collocation, finest mesh 300 x 4", 2.5e-3, "ft")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
