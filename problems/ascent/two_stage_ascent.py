r"""Two stages to orbit: a small launcher within limits of dynamic pressure and axial acceleration.

This example shows path limits that determine a control: first the dynamic pressure, then the axial acceleration
throttles the engine. The lower stage is dropped between the phases; the upper stage coasts between two burns.

States: altitude ``h`` (m), range angle ``theta`` (rad), ``v_r``, ``v_t`` (m/s), ``m`` (kg). Control: vector ``T`` (N),
radial and tangential.

.. math::
   \dot v_r = \frac{T_r - d v_r}{m} - g_0 \frac{R^2}{r^2} + \frac{v_t^2}{r}, \quad
   \dot v_t = \frac{T_t - d v_t}{m} - \frac{v_r v_t}{r}, \quad
   \dot m = -\frac{\|T\|}{g_0 I_{sp}}, \quad d = \tfrac12 \rho v C_D A

.. math:: \tfrac12 \rho v^2 \le 14\,\mathrm{kPa}, \qquad \|T\| / m \le 4 g_0

Source: after the examples 09 and 11 of OpenGoddard (I. Takahara), restated with other numbers: one problem of two
stages.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

G0, EARTH_RADIUS, MU = 9.80665, 6371e3, 3.986004418e14
"""m/s^2, m, m^3/s^2."""
ISP = {"first": 300.0, "second": 350.0}
"""s."""
THRUST = {"first": 1.5 * 20000.0 * G0, "second": 1.5 * 1000.0 * G0}
"""Largest, N."""
START_MASS, CUT_OFF, DROPPED = 20000.0, 3500.0, 2500.0
"""At lift-off, when the lower stage is empty, and of the empty lower stage; kg."""
MAX_PRESSURE, MAX_ACCELERATION = 14000.0, 4 * G0
"""Pa, m/s^2."""
DRAG_AREA, SEA_LEVEL_DENSITY, SCALE_HEIGHT = 0.2 * 3.14, 1.225, 8500.0
"""m^2, kg/m^3, m."""
ALTITUDE = 500e3
"""Of the orbit, m."""
ORBITAL_SPEED = float(np.sqrt(MU / (EARTH_RADIUS + ALTITUDE)))
"""m/s."""


def stage(name: str) -> tuple[go.Model, Any, Any]:
    """Return the model of a stage, its dynamic pressure and its axial acceleration."""
    model = go.Model(name)
    h = model.state("h", unit="m")
    theta = model.state("theta", unit="rad")
    v_r, v_t = model.state("v_r", unit="m/s"), model.state("v_t", unit="m/s")
    m = model.state("m", unit="kg")
    thrust, size = model.vector_control("T", 2, unit="N")
    r = EARTH_RADIUS + h
    density = SEA_LEVEL_DENSITY * ca.exp(-h / SCALE_HEIGHT)
    speed = ca.sqrt(v_r**2 + v_t**2 + 1e-6)  # differentiable at rest
    drag = 0.5 * density * speed * DRAG_AREA
    model.ode(
        {
            h: v_r,
            theta: v_t / r,
            v_r: (thrust[0] - drag * v_r) / m - G0 * (EARTH_RADIUS / r) ** 2 + v_t**2 / r,
            v_t: (thrust[1] - drag * v_t) / m - v_r * v_t / r,
            m: -size / (G0 * ISP[name]),
        }
    )
    return model, 0.5 * density * (v_r**2 + v_t**2), size / m


def build() -> go.Problem:
    """Return the problem."""
    problem = go.Problem("two stages to orbit")
    legs = []
    masses = {"first": (CUT_OFF, START_MASS), "second": (200.0, CUT_OFF - DROPPED)}
    for name, limits in masses.items():
        model, pressure, acceleration = stage(name)
        leg = problem.phase(name, model)
        leg.bounds(h=(0.0, 600e3), v_r=(-1000.0, 4000.0), v_t=(-100.0, 9000.0), m=limits)
        leg.norm_bounds(T=(0.0, THRUST[name]))
        leg.path("dynamic pressure", pressure, upper=MAX_PRESSURE, unit="Pa")
        leg.path("axial acceleration", acceleration, upper=MAX_ACCELERATION, unit="m/s^2")
        legs.append(leg)
    first, second = legs
    durations = {"first": (50.0, 600.0), "second": (50.0, 1200.0)}
    problem.sequence(first, second, durations=durations, drops={"first": {"m": DROPPED}})
    first.initial(h=0.0, theta=0.0, v_r=0.0, v_t=0.0, m=START_MASS)
    first.final(m=CUT_OFF)
    second.final(h=ALTITUDE, v_r=0.0, v_t=ORBITAL_SPEED)
    problem.maximize(second.final_state("m"))
    return problem


REFERENCE = Reference(271.325, "independent Radau collocation, 80 x 4 and 600 x 4 points", 3.3e-3, "kg")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
