r"""Acquisition of the formation with minimum Delta-V and in minimum time.

**Least Delta-V** in one period, with at most `LIMIT` of thrust acceleration on every axis: coast, thrust
and coast again. Delta-V is the publication's, the sum over the axes (equation 39), so every axis gets a
thruster each way (``push``, ``pull``), which makes the cost linear and the optimum bang-off-bang.

**Least time** with at most `LIMIT` of thrust acceleration in any direction: the end is any point of the
circle, at the time at which the formation is there.

Plans to be tracked keep `RESERVE` of the thrust and neglect the oblateness.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.array_types import Array
from problems._example import Reference
from problems.formation_flying.model import PERIOD, START, build_model, circle, circle_state

LIMIT = 3e-3
"""Thrust acceleration, m/s^2: near the largest that the optimal sliding mode asks for, 3.1e-3."""
RESERVE = 0.2
"""Share of the limit that plans leave to the controller: its switching gain, 5e-4 m/s^2, and a little more."""
FAR, FAST = 5000.0, 10.0
"""Bounds on the states (m, m/s), far from the optimum: without, the first iterates run away."""


def build(limit: float = LIMIT, j2: bool = True, duration: float = PERIOD) -> go.Problem:
    """Return the acquisition of the formation with least Delta-V.

    Parameters
    ----------
    limit : float
        Thrust acceleration on every axis, m/s^2.
    j2 : bool
        With differential oblateness.
    duration : float
        s; the end is the circle's point at that time.
    """
    model = build_model(one_sided=True)
    problem = go.Problem("formation, least Delta-V")
    leg = problem.phase("acquisition", model if j2 else model.with_parameters(J2=0.0))
    end = circle_state(duration)
    leg.time(initial=0.0, final=duration)
    leg.initial(r=START[:3], v=START[3:])
    leg.final(r=end[:3], v=end[3:])
    leg.bounds(push=(0.0, limit), pull=(0.0, limit), r=(-FAR, FAR), v=(-FAST, FAST))
    leg.guess(r=(START[:3], end[:3]), v=(START[3:], end[3:]))
    problem.minimize(leg.integral(ca.sum1(model.symbols("control")), "delta_v"), unit="m/s")
    return problem


def build_fast(limit: float = LIMIT, j2: bool = True) -> go.Problem:
    """Return the acquisition in least time; ``limit`` (m/s^2) is that of the thrust's magnitude."""
    model = build_model()
    problem = go.Problem("formation, least time")
    leg = problem.phase("acquisition", model if j2 else model.with_parameters(J2=0.0))
    leg.time(initial=0.0, final=(100.0, PERIOD))
    leg.initial(r=START[:3], v=START[3:])
    position, velocity, _ = circle(leg.final_time)
    arrival = ca.vertcat(leg.final_state("r") - position, leg.final_state("v") - velocity)
    problem.constrain("on the circle", arrival, equals=np.zeros(6))
    thrust = model.symbols("control")
    leg.bounds(a=(-limit, limit), r=(-FAR, FAR), v=(-FAST, FAST))
    leg.path("thrust", ca.sumsqr(thrust) / limit**2, upper=1.0)
    problem.minimize(leg.final_time)
    return problem


REFERENCE = Reference(
    1.184250594, "own structure-exact solution, all conditions of optimality pass", 1e-6, "m/s"
)


LEAST_TIME = 738.51683269
"""Of `build_fast`, s: solutions from meshes of 12x4 and 20x4 agree, and the linear theory to 0.02 s."""


@dataclass(frozen=True, eq=False)
class Plan:
    """An optimal acquisition."""

    name: str
    solution: go.Solution

    @cached_property
    def verdict(self) -> go.Verdict:
        """Of the minimum principle."""
        return go.verify(self.solution)

    @property
    def final_time(self) -> float:
        """When the formation is reached, s."""
        return self.solution.phase().final_time

    def thrust(self, t: Any) -> Array:
        """Return the thrust acceleration (m/s^2), (3,) or (3, n_times)."""
        leg = self.solution.phase()
        if "a" in leg.controls:
            return np.asarray(leg.saturated_control("a")(t))
        return np.asarray(leg.saturated_control("push")(t)) - np.asarray(leg.saturated_control("pull")(t))

    def states(self, t: Any) -> Array:
        """Return r and v, (6,) or (6, n_times)."""
        return self.solution.phase().x(t)


@cache
def plan(name: str, reserve: float = 0.0, j2: bool = True) -> Plan:
    """Return the plan "least Delta-V" or "least time", with a share of the thrust in reserve."""
    builder = {"least Delta-V": build, "least time": build_fast}[name]
    solution = go.solve(builder((1 - reserve) * LIMIT, j2), tol=1e-8)
    return Plan(name, solution)
