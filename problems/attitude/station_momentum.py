r"""Momentum dumping of a space station: unloading of gyros without thrusters.

Gravity and gyroscopic torques unload the gyros. This example shows boundary conditions that are equations, with poor
scaling: at the end all torques are in equilibrium. The norm of the gyros' momentum is limited.

States: ``omega`` (rad/s), ``r``, Euler-Rodrigues vector of the attitude relative to the local horizontal, ``h`` (ft
lbf s), the momentum of the gyros. Control: ``u`` = dh/dt (ft lbf), within 150. Inertia in slug ft^2.

.. math::
   J \dot\omega = 3 n^2\, C_3 \times J C_3 - \omega \times (J \omega + h) - u, \quad
   \dot r = \tfrac12 (r r^T + 1 + [r\times]) (\omega + n C_2), \quad \dot h = u, \quad J = \tfrac12 \int \|u\|^2 dt

Source: Pietz, Pseudospectral collocation methods for the direct transcription of optimal control problems, thesis,
Rice University, 2003; Betts, 2010, section 6.7 (3.586751e6 for twice the cost).
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

INERTIA = np.array(
    [
        [2.80701911616e7, 4.822509936e5, -1.71675094448e7],
        [4.822509936e5, 9.5144639344e7, 6.02604448e4],
        [-1.71675094448e7, 6.02604448e4, 7.6594401336e7],
    ]
)
"""slug ft^2."""
RATE = np.radians(0.06511)
"""Of the orbit, rad/s."""
START = {
    "omega": [-9.5380685844896e-6, -1.1363312657036e-3, 5.3472801108427e-6],
    "r": [2.9963689649816e-3, 1.5334477761054e-1, 3.8359805613992e-3],
    "h": [5000.0, 5000.0, 5000.0],
}


def rates(omega: Any, r: Any, h: Any, u: Any) -> tuple[Any, Any]:
    """Return the time derivatives of ``omega`` and ``r``."""
    cross = ca.skew(r)
    attitude = ca.SX.eye(3) + 2 / (1 + ca.sumsqr(r)) * (cross @ cross - cross)
    across, down = attitude[:, 1], attitude[:, 2]
    torque = 3 * RATE**2 * ca.cross(down, INERTIA @ down) - ca.cross(omega, INERTIA @ omega + h) - u
    return np.linalg.inv(INERTIA) @ torque, 0.5 * (r @ r.T + ca.SX.eye(3) + cross) @ (omega + RATE * across)


def build() -> go.Problem:
    """Return the problem."""
    station = go.Model("space station")
    omega = station.state("omega", 3, unit="rad/s")
    r = station.state("r", 3)
    h = station.state("h", 3, unit="ft lbf s")
    u = station.control("u", 3, unit="ft lbf")
    omega_rate, r_rate = rates(omega, r, h, u)
    station.ode({omega: omega_rate, r: r_rate, h: u})

    problem = go.Problem("momentum dumping of a space station")
    turn = problem.phase("turn", station)
    turn.time(initial=0.0, final=1800.0)
    turn.initial(**START)
    turn.final(h=[0.0, 0.0, 0.0])
    turn.bounds(omega=(-2e-3, 2e-3), r=(-1.0, 1.0), h=(-15000.0, 15000.0), u=(-150.0, 150.0))
    turn.path("momentum", ca.sumsqr(h) / 1e8, upper=1.0)
    at_rest = rates(turn.final_state("omega"), turn.final_state("r"), turn.final_state("h"), ca.SX.zeros(3))
    problem.constrain("torques in equilibrium", at_rest[0] * 1e6, equals=[0.0, 0.0, 0.0])
    problem.constrain("attitude at rest", at_rest[1] * 1e3, equals=[0.0, 0.0, 0.0])
    problem.minimize(0.5 * turn.integral(ca.sumsqr(u)), unit="ft^2 lbf^2 s")
    return problem


REFERENCE = Reference(1793441.1, "independent: Radau points on 200 segments", 0.5, "ft^2 lbf^2 s")


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
