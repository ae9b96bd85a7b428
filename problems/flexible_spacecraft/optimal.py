r"""Optimal slews: minimum time, minimum time and effort, minimum vibration, each without modal energy at the end.

Both start and end at rest in the orbital frame, with :math:`\eta = \dot\eta = 0` and \|torque\| <= 0.5 N m per axis.

* **Least time** needs 15 switches: 3 about x, 1 about y and 11 about z.
* **Least time and effort** minimises :math:`t_f + w \int |T / T_{max}|^2 dt` with a small weight w. The controllers
  track this slew. With 0.475 N m the minimum-time torque about z has a singular arc from 32.8 to 33.3 s, which bang
  arcs only approximate. The weight w makes the torque unique everywhere.
* **Least vibration** in a given time minimises :math:`\int E_m + w |T|^2 \, dt` with the modal energy
  :math:`E_m = \frac12 (|\dot\eta|^2 + |\Lambda\eta|^2)`. The weight w makes the control unique between its bounds; at
  1e-4 J/(N m)^2 it raises the integral of E_m by 1 % over what a tenth of it gives.
"""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference
from problems.flexible_spacecraft import model

MESH = go.Mesh.uniform(60, 3)
"""For the time-optimal slew: modes of 2 s and arcs of 0.3 s in 33 s."""
RESERVED = 0.95
"""Share of the torque limit that the tracked slew of least time and effort uses."""
PRICE = 0.05
"""Of its effort: s for every second of the whole torque about one axis."""
DURATION, WEIGHT = 60.0, 1e-4
"""Of the slew with the least vibration: s, J/(N m)^2."""
REFERENCE = Reference(
    33.0137090760, "refined from four meshes; fourteen random starts end in no other optimum", 1e-8, "s"
)


def build(limit: float = model.MAX_TORQUE) -> go.Problem:
    """Return the time-optimal slew, with torques up to the limit (N m)."""
    problem, slew = _slew("time-optimal slew", limit)
    problem.minimize(slew.final_time)
    return problem


def build_prompt(limit: float = RESERVED * model.MAX_TORQUE, price: float = PRICE) -> go.Problem:
    """Return the slew of least time and effort, with torques up to the limit (N m)."""
    problem, slew = _slew("slew of least time and effort", limit)
    share = slew.model.symbol("torque") / limit
    problem.minimize(slew.final_time + slew.integral(price * ca.sumsqr(share), "effort"))
    return problem


def build_gentle(
    duration: float = DURATION, weight: float = WEIGHT, limit: float = model.MAX_TORQUE
) -> go.Problem:
    """Return the slew of a given duration (s) with the least vibration, with torques up to the limit (N m)."""
    problem, slew = _slew("minimum-vibration slew", limit, duration)
    eta, eta_rate, torque = (slew.model.symbol(name) for name in ("eta", "eta_rate", "torque"))
    energy = 0.5 * (ca.sumsqr(eta_rate) + ca.sumsqr(ca.DM(model.FREQUENCIES) * eta))
    problem.minimize(slew.integral(energy + weight * ca.sumsqr(torque), "vibration"))
    return problem


def _slew(name: str, limit: float, duration: float | None = None) -> tuple[go.Problem, go.Phase]:
    dynamics = model.build_model()
    start, end = model.initial_state(dynamics), model.rest(dynamics, (1.0, 0.0, 0.0, 0.0))
    place = dynamics.states.slice
    problem = go.Problem(name)
    slew = problem.phase("slew", dynamics)
    slew.time(initial=0.0, final=duration or (20.0, 80.0))
    if duration is None:
        slew.guess([0.0, 40.0])
    slew.initial(q_BO=start[place("q_BO")], omega=start[place("omega")], eta=0.0, eta_rate=0.0)
    # the norm is conserved: the scalar part follows from the others
    slew.final(
        q_BO=([0.5, 0.0, 0.0, 0.0], [1.1, 0.0, 0.0, 0.0]), omega=end[place("omega")], eta=0.0, eta_rate=0.0
    )
    slew.bounds(
        q_BO=(-1.1, 1.1), omega=(-0.5, 0.5), eta=(-2.0, 2.0), eta_rate=(-2.0, 2.0), torque=(-limit, limit)
    )
    return problem, slew


def eigenaxis_time() -> float:
    """Return the time (s) of the turn about the eigenaxis of a rigid body, gyroscopic torques for free."""
    vector = np.array(model.INITIAL_ATTITUDE[1:])
    angle, axis = 2 * np.arccos(model.INITIAL_ATTITUDE[0]), vector / np.linalg.norm(vector)
    return float(2 * np.sqrt(angle * np.max(np.array(model.INERTIA) * np.abs(axis)) / model.MAX_TORQUE))


@cache
def solved(name: str) -> go.Solution:
    """Return the solution of "fast" (least time), "prompt" (least time and effort) or "gentle" (least vibration)."""
    if name == "gentle":
        return go.solve(build_gentle(), mesh="40x4", tol=1e-8)
    if name == "fast":
        return go.solve(build(), mesh=MESH, tol=1e-8)
    return go.solve(build_prompt(), mesh=MESH, tol=1e-8)
