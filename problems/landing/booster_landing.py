r"""Booster landing: a first stage lands upright with drag and engine limits.

The stage burns as late as possible. This example shows an optimised ignition time: before ignition drag brakes
without propellant. Coast and burn are phases; the thrust has a lower limit.

States: ``x``, ``z`` (m), ``vx``, ``vz`` (m/s), ``m`` (kg). Control in the burn: vector ``T`` (N).

.. math::
   m \dot v = T - \tfrac12 \rho(z) C_D A \|v\| v - m g e_z, \qquad \dot m = -\frac{\|T\|}{g_0 I_{sp}}, \qquad
   T_z \ge \|T\| \cos 20°

Source: own statement with numbers of the size of a Falcon 9 (L. Blackmore, Autonomous precision landing of space
rockets, The Bridge 46 (2016) 15-20).
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

GRAVITY, G0, ISP = 9.81, 9.80665, 282.0
"""m/s^2, m/s^2, s."""
THRUST = (340e3, 845e3)
"""Of one engine, N."""
DRAG_AREA, DENSITY, SCALE_HEIGHT = 10.0, 1.225, 8000.0
"""C_D A, m^2; kg/m^3; m."""
START = {"x": -450.0, "z": 4500.0, "vx": 40.0, "vz": -290.0, "m": 30000.0}
TILT = float(np.radians(20.0))
"""rad."""


def booster(name: str) -> tuple[go.Model, Any]:
    """Return the model of a phase and the constraint of the tilt, None without an engine."""
    model = go.Model(name)
    x, z = model.state("x", unit="m"), model.state("z", unit="m")
    vx, vz = model.state("vx", unit="m/s"), model.state("vz", unit="m/s")
    m = model.state("m", unit="kg")
    drag = 0.5 * DENSITY * ca.exp(-z / SCALE_HEIGHT) * DRAG_AREA * ca.sqrt(vx**2 + vz**2 + 0.01)
    push_x, push_z, flow, tilt = 0.0, 0.0, 0.0, None
    if name == "burn":
        thrust, size = model.vector_control("T", 2, unit="N")
        push_x, push_z, flow = thrust[0], thrust[1], size / (G0 * ISP)
        tilt = thrust[1] - size * np.cos(TILT)
    model.ode({x: vx, z: vz, vx: (push_x - drag * vx) / m, vz: (push_z - drag * vz) / m - GRAVITY, m: -flow})
    return model, tilt


def build() -> go.Problem:
    """Return the problem."""
    problem = go.Problem("booster landing")
    (falling, _), (burning, tilt) = booster("fall"), booster("burn")
    fall, burn = problem.phase("fall", falling), problem.phase("burn", burning)
    problem.sequence(fall, burn, durations={"fall": (0.1, 20.0), "burn": (5.0, 60.0)})
    fall.initial(**START)
    burn.final(x=0.0, z=0.0, vx=0.0, vz=-1.0)
    for leg in (fall, burn):
        leg.bounds(
            x=(-2000.0, 2000.0), z=(0.0, 5000.0), vx=(-200.0, 200.0), vz=(-400.0, 50.0), m=(20e3, 30e3)
        )
    burn.norm_bounds(T=THRUST)
    burn.path("tilt", tilt, lower=0.0)
    problem.maximize(burn.final_state("m"))
    return problem


REFERENCE = Reference(26583.286, "independent Radau collocation, converges to it", 0.026, "kg")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
