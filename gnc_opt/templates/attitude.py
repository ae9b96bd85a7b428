"""Minimum-effort rest-to-rest slew of a rigid satellite in a given time.

The attitude is described by modified Rodrigues parameters (MRP), sigma = axis * tan(angle/4),
which are singular at 360 degrees. Frames: body B, inertial I; sigma_BI is the attitude of B
relative to I, omega_BI_B the angular rate of B relative to I in B components.

Solve and verify with:   gnc-opt solve FILE --report report
Check the problem with:  gnc-opt check FILE
Options of build():      gnc-opt solve FILE --set duration=60
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.plot import View
from gnc_opt.spacecraft import angular_acceleration, mrp_from_axis_angle, mrp_rate

# Initial mesh: 8 segments of 5 points each.
MESH = "8x5"
# Animated 3-D view in the report (requires plotly: pip install "gnc_opt[report]").
VIEW = View(attitude="sigma")


def build(
    axis: Sequence[float] = (1.0, 2.0, 2.0),
    angle: float = 120.0,
    duration: float = 30.0,
    max_torque: float = 1.0,
) -> go.Problem:
    """Return the problem; rotation axis, angle in deg, duration in s, largest torque in N m."""
    # Dynamics dx/dt = f(t, x, u, p): kinematics and Euler's equations.
    satellite = go.Model("rigid satellite")
    sigma_BI = satellite.state("sigma", 3)
    omega_BI_B = satellite.state("omega", 3, unit="rad/s")
    torque_B = satellite.control("torque", 3, unit="N m")
    inertia = satellite.parameter("inertia", [10.0, 12.0, 8.0], unit="kg m^2")
    satellite.ode(
        {
            sigma_BI: mrp_rate(sigma_BI, omega_BI_B),
            omega_BI_B: angular_acceleration(inertia, omega_BI_B, torque_B),
        }
    )

    # Boundary conditions and bounds. A number or an array is a fixed value, a tuple is a range.
    unit_axis = np.asarray(axis) / np.linalg.norm(axis)
    problem = go.Problem("slew")
    slew = problem.phase("slew", satellite)
    slew.time(initial=0.0, final=duration)
    slew.initial(sigma=0.0, omega=0.0)
    slew.final(sigma=mrp_from_axis_angle(unit_axis, np.radians(angle)), omega=0.0)
    slew.bounds(torque=(-max_torque, max_torque))
    # slew.bounds(omega=(-0.1, 0.1))   # measurement range of the gyroscopes

    problem.minimize(slew.integral(ca.sumsqr(torque_B), "effort"))
    return problem


if __name__ == "__main__":
    solution = go.solve(build(), mesh=MESH, tol=1e-8)
    print(solution)
    print(go.verify(solution).explain())
