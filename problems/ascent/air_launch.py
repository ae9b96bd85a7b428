r"""Air launch: the largest payload of a two-stage rocket dropped from an aircraft.

The aircraft flies at 12 km. This example shows a phase without a control: the coast between the stages has a free
duration. One steering law covers both burns.

States: ``h`` (m), range angle ``theta`` (rad), ``v_r``, ``v_t`` (m/s), ``m`` (kg). Control: thrust angle ``beta``
above the local horizontal (rad) while burning.

.. math::
   \dot v_r = \frac{F \sin\beta - d v_r}{m} - \frac{\mu}{r^2} + \frac{v_t^2}{r}, \qquad
   \dot v_t = \frac{F \cos\beta - d v_t}{m} - \frac{v_r v_t}{r}, \qquad d = \tfrac12 \rho v C_D A

Source: own statement; a launcher of the size of Pegasus (M. Sarigul-Klijn and N. Sarigul-Klijn, A study of air launch
methods for RLVs, AIAA 2001-4619).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

MU, EARTH_RADIUS, G0 = 3.986004418e14, 6378.137e3, 9.80665
"""m^3/s^2, m, m/s^2."""
STAGES = {"first": (500e3, 290.0), "coast": (0.0, 1.0), "second": (60e3, 310.0)}
"""Thrust (N) and specific impulse (s) by phase."""
START_MASS, FIRST_CUT_OFF, DROPPED = 18000.0, 5500.0, 1300.0
"""kg."""
DRAG_AREA, DENSITY, SCALE_HEIGHT = 0.6, 1.225, 7500.0
"""m^2, kg/m^3, m."""
START = {"h": 12e3, "theta": 0.0, "v_r": 0.0, "v_t": 240.0, "m": START_MASS}
ALTITUDE = 400e3
"""Of the orbit, m."""


def stage(name: str) -> go.Model:
    """Return the model of a phase."""
    thrust, isp = STAGES[name]
    model = go.Model(name)
    h, theta = model.state("h", unit="m"), model.state("theta", unit="rad")
    v_r, v_t = model.state("v_r", unit="m/s"), model.state("v_t", unit="m/s")
    m = model.state("m", unit="kg")
    r = EARTH_RADIUS + h
    drag = 0.5 * DENSITY * ca.exp(-h / SCALE_HEIGHT) * ca.sqrt(v_r**2 + v_t**2) * DRAG_AREA
    radial, along = -drag * v_r, -drag * v_t
    if thrust > 0:
        beta = model.control("beta", unit="rad")
        radial += thrust * ca.sin(beta)
        along += thrust * ca.cos(beta)
    model.ode(
        {
            h: v_r,
            theta: v_t / r,
            v_r: radial / m - MU / r**2 + v_t**2 / r,
            v_t: along / m - v_r * v_t / r,
            m: -thrust / (G0 * isp),
        }
    )
    return model


def build() -> go.Problem:
    """Return the problem."""
    problem = go.Problem("air launch")
    legs = [problem.phase(name, stage(name)) for name in STAGES]
    first, coast, second = legs
    for leg in legs:
        leg.bounds(h=(0.0, 600e3), v_r=(-500.0, 4000.0), v_t=(50.0, 9000.0), m=(300.0, START_MASS))
    first.bounds(beta=(-np.pi / 2, np.pi / 2))
    second.bounds(beta=(-np.pi / 2, np.pi / 2))
    durations = {"first": (20.0, 150.0), "coast": (1.0, 600.0), "second": (20.0, 300.0)}
    problem.sequence(first, coast, second, durations=durations, drops={"first": {"m": DROPPED}})
    first.initial(**START)
    first.final(m=FIRST_CUT_OFF)
    second.final(h=ALTITUDE, v_r=0.0, v_t=float(np.sqrt(MU / (EARTH_RADIUS + ALTITUDE))))
    first.guess(h=(12e3, 60e3), v_r=(0.0, 1200.0), v_t=(240.0, 2800.0), beta=0.6)
    coast.guess(h=(60e3, 300e3), v_r=(1200.0, 500.0), v_t=2800.0, m=FIRST_CUT_OFF - DROPPED)
    second.guess(h=(300e3, ALTITUDE), v_r=(500.0, 0.0), v_t=(2800.0, 7600.0), m=(4200.0, 1000.0), beta=0.2)
    problem.maximize(second.final_state("m"))
    return problem


REFERENCE = Reference(599.1893974, "independent Radau collocation, two meshes agree", 0.0006, "kg")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
