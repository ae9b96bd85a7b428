r"""Optimal manoeuvres of the tethered pair: removal of the swing in minimum time and with minimum effort.

The minimum-time control is bang-bang in the *rate* of the thrust angle, with three arcs on the limit of the angle (a
state constraint of first order). In the minimum-effort solution no limit is active. Both end at the height of the
reference orbit without swing, which the published controller only approaches.

The plan that is tracked has limits of 17 degrees and 0.08 rad/s, which leaves a margin for feedback.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal, TypeAlias

import numpy as np

import gnc_opt as go
from gnc_opt.errors import suggest_similar_name
from problems._example import Array, Reference
from problems.tethered_formation import model

Goal: TypeAlias = Literal["time", "effort"]

MESH = go.Mesh.uniform(60, 3)
"""To begin with: the least time has arcs of 3 s in 100 s, which 20 segments do not resolve."""

# --- the problem ----------------------------------------------------------------------------------------


def build(
    goal: Goal = "time",
    swing: float = model.FIRST_SWING,
    duration: float = model.DURATION,
    angle: float = model.MAX_ANGLE,
    rate: float = model.MAX_RATE,
) -> go.Problem:
    """Return the problem of taking out the swing *and* coming to rest on the height of the reference orbit.

    At the end swing, its rate and the thrust angle are those of the reference, and so are height and climb. The
    place along the orbit cannot be had as well: thrust that is deflected is missing along the orbit.

    Parameters
    ----------
    goal : {"time", "effort"}
        Least time (s), or least integral of the squared rate of the thrust angle (rad^2/s) over ``duration``.
    swing : float
        At the start, rad.
    duration : float
        s; for "effort".
    angle, rate : float
        Limits of the thrust angle (rad) and its rate (rad/s).

    Raises
    ------
    ProblemError
        There is no such goal.
    """
    if goal not in ("time", "effort"):
        raise go.ProblemError(
            f"the pair has no goal {goal!r}: {suggest_similar_name(str(goal), ('time', 'effort'))}"
        )
    dynamics, orbit = model.tether_model(), model.Orbit.of()
    problem = go.Problem(f"swing suppression, least {goal}")
    leg = problem.phase("pull", dynamics)
    leg.time(initial=0.0, final=(10.0, model.DURATION) if goal == "time" else duration)
    leg.initial(**dict(zip(dynamics.states.names, model.first_state(swing), strict=True)))
    leg.bounds(gamma=(-angle, angle), gamma_rate=(-rate, rate))
    # The equilibrium's angle, some -1e-5 rad, moves by 1e-6 rad in 200 s: taken at the end of the orbit.
    leg.final(theta=orbit.state(duration)[4], theta_rate=0.0, gamma=0.0)
    height, climb, *_ = orbit(leg.final_time)
    problem.constrain("height of the reference", leg.final_state("height") - height, equals=0.0)
    problem.constrain("climb of the reference", leg.final_state("climb") - climb, equals=0.0)
    if goal == "time":
        problem.minimize(leg.final_time)
    else:
        problem.minimize(leg.integral(dynamics.symbol("gamma_rate") ** 2, "effort"))
    return problem


def solve(goal: Goal = "time", **options: float) -> go.Solution:
    """Solve `build` to 1e-8; the least time has eight arcs, three of them on the limit of the angle."""
    return go.solve(build(goal, **options), mesh=MESH, tol=1e-8)


REFERENCE = Reference(100.16675803, "ours: 150 segments and eight arcs with free switches agree", 1e-6, "s")

# --- its solutions ---------------------------------------------------------------------------------------

RESERVE = {"angle": float(np.radians(17.0)), "rate": 0.08}
"""Limits (rad, rad/s) with which the time-optimal manoeuvre is planned that is tracked."""


@dataclass(frozen=True)
class Optimum:
    """A solved manoeuvre with its verdict."""

    goal: Goal
    solution: go.Solution

    @classmethod
    def of(cls, goal: Goal, **options: float) -> Optimum:
        """Solve; options as of `build`."""
        return cls(goal, solve(goal, **options))

    @cached_property
    def verdict(self) -> go.Verdict:
        """Of Pontryagin's principle."""
        return go.verify(self.solution)

    @property
    def leg(self) -> go.PhaseSolution:
        """Its only phase."""
        return self.solution.phases["pull"]

    @cached_property
    def effort(self) -> float:
        """Integral of the squared rate of the thrust angle, rad^2/s."""
        return self._integral(np.asarray(self.leg.saturated_control("gamma_rate")(self._grid)) ** 2)

    @cached_property
    def loss(self) -> float:
        """Speed along the orbit that deflection costs, m/s."""
        return self._integral(
            model.FORCE / model.PAIR.mass * (1 - np.cos(self.leg.state("gamma")(self._grid)))
        )

    @property
    def _grid(self) -> Array:
        return np.linspace(0.0, self.leg.final_time, 40001)

    def _integral(self, values: Array) -> float:
        return float(np.trapezoid(np.ravel(values), self._grid))


@cache
def optimum(name: str) -> Optimum:
    """Return "time", "effort", or "planned": the least time with `RESERVE`."""
    if name == "planned":
        return Optimum.of("time", **RESERVE)
    return Optimum.of("time" if name == "time" else "effort")
