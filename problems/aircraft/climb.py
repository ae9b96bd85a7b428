r"""Minimum time to climb of a supersonic interceptor: the F-4 of Bryson, Desai and Hoffman.

This example shows dynamics from tables. Thrust is a table of Mach number and altitude; lift slope and drag are tables
of the Mach number, and the atmosphere is a table of altitude. `table` returns smooth expressions, which extrapolate
the data for the solver's iterates. The optimum consists of level acceleration, a dive through Mach 1, a climb at
rising energy, and a zoom.

States: ``h`` (ft), ``v`` (ft/s), ``gamma`` (rad), ``w`` (lb). Control: angle of attack ``alpha`` (rad).

.. math::
   \dot h = v \sin\gamma, \quad
   \dot v = \frac{T \cos\alpha - D}{m} - \frac{\mu \sin\gamma}{(R + h)^2}, \quad
   \dot\gamma = \frac{T \sin\alpha + L}{m v} + \cos\gamma \Big(\frac{v}{R + h} - \frac{\mu}{v (R + h)^2}\Big), \quad
   \dot w = -\frac{T}{I_{sp}}

.. math:: L = q S C_{L\alpha} \alpha, \qquad D = q S (C_{D0} + \eta C_{L\alpha} \alpha^2)

Source: A. E. Bryson, M. N. Desai and W. C. Hoffman, Energy-state approximation in performance optimization of
supersonic aircraft, J. Aircraft 6 (1969) 481-488; numbers of J. T. Betts, Practical Methods for Optimal Control and
Estimation Using Nonlinear Programming, SIAM 2010, section 6.2, whose own smoothing of the data gives 324.975 s.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.model.piecewise_polynomial_interpolation import Method
from problems._example import Reference, example_main

MACH = np.array([0.0, 0.4, 0.8, 0.9, 1.0, 1.2, 1.4, 1.6, 1.8])
LIFT_SLOPE = np.array([3.44, 3.44, 3.44, 3.58, 4.44, 3.44, 3.01, 2.86, 2.44])
ZERO_LIFT_DRAG = np.array([0.013, 0.013, 0.013, 0.014, 0.031, 0.041, 0.039, 0.036, 0.035])
EFFICIENCY = np.array([0.54, 0.54, 0.54, 0.75, 0.79, 0.78, 0.89, 0.93, 0.93])
"""Of the drag due to lift."""
THRUST_MACH = np.linspace(0.0, 1.8, 10)
THRUST_ALTITUDE = 1e3 * np.array([0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 70.0])
"""ft."""
THRUST = 1e3 * np.array(
    [
        [24.2, 24.0, 20.3, 17.3, 14.5, 12.2, 10.2, 5.7, 3.4, 0.1],
        [28.0, 24.6, 21.1, 18.1, 15.2, 12.8, 10.7, 6.5, 3.9, 0.2],
        [28.3, 25.2, 21.9, 18.7, 15.9, 13.4, 11.2, 7.3, 4.4, 0.4],
        [30.8, 27.2, 23.8, 20.5, 17.3, 14.7, 12.3, 8.1, 4.9, 0.8],
        [34.5, 30.3, 26.6, 23.2, 19.8, 16.8, 14.1, 9.4, 5.6, 1.1],
        [37.9, 34.3, 30.4, 26.8, 23.3, 19.8, 16.8, 11.2, 6.8, 1.4],
        [36.1, 38.0, 34.9, 31.3, 27.3, 23.6, 20.1, 13.4, 8.3, 1.7],
        [34.3, 36.6, 38.5, 36.1, 31.6, 28.1, 24.2, 16.2, 10.0, 2.2],
        [32.5, 35.2, 42.1, 38.7, 35.7, 32.0, 28.1, 19.3, 11.9, 2.9],
        [30.7, 33.8, 45.7, 41.3, 39.8, 34.6, 31.1, 21.7, 13.3, 3.1],
    ]
)
"""lb, by Mach number and altitude."""
ALTITUDE = 5e3 * np.arange(17)
"""ft."""
DENSITY = 1e-4 * np.array(
    [
        23.77,
        20.48,
        17.56,
        14.96,
        12.67,
        10.66,
        8.907,
        7.382,
        5.873,
        4.623,
        3.639,
        2.865,
        2.256,
        1.777,
        1.392,
        1.091,
        0.8571,
    ]
)
"""slug/ft^3, 1962 standard atmosphere."""
SOUND = np.array(
    [1116.5, 1097.1, 1077.4, 1057.4, 1036.9, 1016.1, 994.8, 973.1, *[968.1] * 6, 970.9, 974.3, 977.6]
)
"""Speed of sound, ft/s."""
AREA, G0, RADIUS, MU, ISP = 530.0, 32.174, 20902900.0, 0.14076539e17, 1600.0
"""ft^2, ft/s^2, ft, ft^3/s^2, s."""


def build(method: Method = "bspline") -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    method : {"bspline", "pchip", "linear"}
        Interpolation method of all tables.
    """
    lift_slope, zero_lift_drag, efficiency = (
        go.table(MACH, values, method=method, name=name)
        for name, values in (("CLa", LIFT_SLOPE), ("CD0", ZERO_LIFT_DRAG), ("eta", EFFICIENCY))
    )
    thrust = go.table([THRUST_MACH, THRUST_ALTITUDE], THRUST, method=method, name="thrust")
    log_density = go.table(ALTITUDE, np.log(DENSITY), method=method, name="log density")
    sound = go.table(ALTITUDE, SOUND, method=method, name="speed of sound")

    aircraft = go.Model("F-4")
    h = aircraft.state("h", unit="ft")
    v = aircraft.state("v", unit="ft/s")
    gamma = aircraft.state("gamma", unit="rad")
    w = aircraft.state("w", unit="lb")
    alpha = aircraft.control("alpha", unit="rad")
    mach = v / sound(h)
    pressure = 0.5 * ca.exp(log_density(h)) * v**2 * AREA
    lift = pressure * lift_slope(mach) * alpha
    drag = pressure * (zero_lift_drag(mach) + efficiency(mach) * lift_slope(mach) * alpha**2)
    T, m, r = thrust(mach, h), w / G0, RADIUS + h
    aircraft.ode(
        {
            h: v * ca.sin(gamma),
            v: (T * ca.cos(alpha) - drag) / m - MU / r**2 * ca.sin(gamma),
            gamma: (T * ca.sin(alpha) + lift) / (m * v) + ca.cos(gamma) * (v / r - MU / (v * r**2)),
            w: -T / ISP,
        }
    )
    aircraft.output("mach", mach)

    problem = go.Problem("minimum time to climb")
    climb = problem.phase("climb", aircraft)
    climb.time(initial=0.0, final=(200.0, 500.0))
    climb.initial(h=0.0, v=424.26, gamma=0.0, w=42000.0)
    climb.final(h=65600.0, v=968.148, gamma=0.0)
    climb.bounds(
        h=(0.0, 69000.0), v=(1.0, 2000.0), gamma=(-1.55, 1.55), w=(0.0, 45000.0), alpha=(-0.349, 0.349)
    )
    problem.minimize(climb.final_time)
    return problem


REFERENCE = Reference(319.877591, "Gauss and Radau points on 120 segments agree to 1e-6 s", 1e-5, "s")


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
