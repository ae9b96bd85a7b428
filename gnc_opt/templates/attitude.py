"""A rigid satellite turns from rest to rest in a given time, with the least effort.

The attitude is given by modified Rodrigues parameters (MRP), sigma = axis * tan(angle/4):
three numbers, as many as there are ways to turn, good for turns below 360 degrees.
Frames: B is the body, I is inertial; sigma_BI turns I into B, omega_BI_B is in B.

Solve and verify with:   gnc-opt solve FILE --report report
Look for mistakes with:  gnc-opt check FILE
Options of build():      gnc-opt solve FILE --set duration=60
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.plot import View
from gnc_opt.spacecraft import angular_acceleration, mrp_from_axis_angle, mrp_rate

# The mesh to begin with: 8 segments of 5 points each.
MESH = "8x5"
# What the report shows moving in three dimensions (with plotly: pip install "gnc_opt[report]").
VIEW = View(attitude="sigma")


def build(
    axis: Sequence[float] = (1.0, 2.0, 2.0),
    angle: float = 120.0,
    duration: float = 30.0,
    max_torque: float = 1.0,
) -> go.Problem:
    """Return the problem; turn about an axis by an angle (deg) in a time (s), torque in N m."""
    # The dynamics dx/dt = f(t, x, u, p), once: kinematics and Euler's equations.
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

    # What to achieve. A number or an array is a fixed value, a tuple is a range.
    unit_axis = np.asarray(axis) / np.linalg.norm(axis)
    problem = go.Problem("slew")
    slew = problem.phase("slew", satellite)
    slew.time(initial=0.0, final=duration)
    slew.initial(sigma=0.0, omega=0.0)
    slew.final(sigma=mrp_from_axis_angle(unit_axis, np.radians(angle)), omega=0.0)
    slew.bounds(torque=(-max_torque, max_torque))
    # slew.bounds(omega=(-0.1, 0.1))   # rates that the gyroscopes can measure

    problem.minimize(slew.integral(ca.sumsqr(torque_B), "effort"))
    return problem


if __name__ == "__main__":
    solution = go.solve(build(), mesh=MESH, tol=1e-8)
    print(solution)
    print(go.verify(solution).explain())
