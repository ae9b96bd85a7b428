r"""Optimal slews of the wheel pyramid within its torque and speed limits, judged and tracked.

Least energy is smooth; one wheel rests on the speed limit for a while if time is short. Least time is bang-bang,
with arcs on the speed limit where the wheel's torque is zero and its multiplier positive. Two things make it regular:

* The momentum in the null direction is free at the end. With all wheels at rest, every wheel that switches once has to
  switch at half time, so that switches coincide and the multipliers are not unique.
* Where the speed limit acts, the wheels begin with a bias in the null direction, as wheels in orbit do to stay away
  from standstill. From standstill, all wheels have the same speed until the first of them switches, and reach the
  limit at the same instant: two constraints, one time, and again multipliers that are not unique.

The structure of the slews on the speed limit (which wheel is on which limit, in which order) was read off solutions on
a plain mesh; held there, the switch times are what is optimised, and the verdict judges the result without knowing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Literal, TypeAlias

import casadi as ca
import numpy as np
from scipy.linalg import block_diag

import gnc_opt as go
from gnc_opt.control.deviation import Deviation
from gnc_opt.control.linear.riccati import steady
from gnc_opt.errors import did_you_mean
from gnc_opt.simulation import Constant, Saturation
from problems.reaction_wheels.laws import PRINTED_FLC
from problems.reaction_wheels.model import (
    AXES,
    INERTIA,
    INVERSE,
    MAX_MOMENTUM,
    NULL,
    REST,
    RPM,
    WHEEL_INERTIA,
    resting,
    target_quaternion,
    wheel_model,
)
from problems.reference import Array, Reference

Goal: TypeAlias = Literal["energy", "time"]
Name: TypeAlias = Literal["energy", "energy, half the time", "time, small", "time, speed limit"]

HALF = 17.0
"""Duration of the slew of least energy that needs the speed limit, s."""
RESERVE_TORQUE = 0.05
"""Torque limit of the tracked time-optimal slew, N m: below what the wheels have, for the feedback."""
BIAS = 300.0
"""Speed in the null direction at the start of the slew of least time on the speed limit, rpm."""
_TOLERANCE = 1e-8


# --- the problem ----------------------------------------------------------------------------------------


def published_peak_torque(manoeuvre: int) -> float:
    """Return the largest wheel torque (N m) of the published feedback linearisation in a manoeuvre.

    It is the first one: from rest the law asks for the body torque 2 K1 J q_v, q_v the target's vector part.
    """
    body = 2 * PRINTED_FLC[0] * np.asarray(INERTIA) * target_quaternion(manoeuvre)[1:]
    return float(np.max(np.abs(INVERSE @ body)))


def build(
    goal: Goal = "energy",
    manoeuvre: int = 3,
    duration: float = 34.6,
    torque: float | None = None,
    bias: float = 0.0,
) -> go.Problem:
    """Return the problem of an optimal slew of the body from rest to rest.

    Parameters
    ----------
    goal : {"energy", "time"}
        Least integral of the squared wheel torques (N^2 m^2 s; the loss in the motors' windings is proportional to it)
        in a given time, wheels at rest in the end; or least time (s). In least time the momentum in the null direction
        is free in the end: it does not move the body, and the wheels get rid of it later.
    manoeuvre : int
        See `MANOEUVRES`.
    duration : float
        s; for "energy". By default as long as the published feedback linearisation takes to settle to 2 %.
    torque : float, optional
        Limit of every wheel's torque, N m; default `published_peak_torque`.
    bias : float
        Speed in the null direction with which the wheels begin, rpm; keeps them away from standstill.

    Raises
    ------
    ProblemError
        There is no such goal or manoeuvre.
    """
    if goal not in ("energy", "time"):
        raise go.ProblemError(f"a slew has no goal {goal!r}: {did_you_mean(str(goal), ('energy', 'time'))}")
    target = target_quaternion(manoeuvre)
    limit = published_peak_torque(manoeuvre) if torque is None else torque
    craft = wheel_model()
    problem = go.Problem(f"{goal}-optimal slew {manoeuvre}")
    slew = problem.phase("slew", craft)
    slew.time(initial=0.0, final=(1.0, 100.0) if goal == "time" else duration)
    slew.initial(q=REST[:4], omega=0.0, h=WHEEL_INERTIA * RPM * bias * NULL)
    # What is conserved (unit length, zero momentum) is not stated twice: the quaternion's vector part is enough, and
    # with the body at rest one wheel stands for all four
    null = MAX_MOMENTUM if goal == "time" else 0.0
    slew.final(
        q=([0.0, *target[1:]], [1.0, *target[1:]]),
        omega=0.0,
        h=([-MAX_MOMENTUM] * 3 + [-null], [MAX_MOMENTUM] * 3 + [null]),
    )
    # The rates that the wheels' momenta can give at most: it excludes nothing, but keeps the iterates where they belong
    rates = np.sum(np.abs(AXES), axis=1) * MAX_MOMENTUM / np.asarray(INERTIA)
    slew.bounds(T=(-limit, limit), h=(-MAX_MOMENTUM, MAX_MOMENTUM), omega=(-rates, rates))
    if goal == "time":
        problem.minimize(slew.final_time)
    else:
        torques = craft.symbol("T")
        problem.minimize(slew.integral(ca.sumsqr(torques), "energy"))
    return problem


REFERENCE = Reference(
    0.0053685521495051,
    "independent: two-point boundary value problem of the minimum principle, residual 1e-11",
    1e-11,
    "N^2 m^2 s",
)
"""Of `build` with its default arguments."""


# --- its solutions --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Structure:
    """Who is on which limit: segment boundaries (s) to begin with, controls (4, K), momenta (4, K), and points."""

    times: tuple[float, ...]
    torques: tuple[tuple[int, ...], ...]
    momenta: tuple[tuple[int, ...], ...]
    points: int

    def solve(self, problem: go.Problem) -> go.Solution:
        """Return the solution whose switch times are optimal."""
        states = np.zeros((11, len(self.times) - 1), dtype=int)
        states[7:11] = self.momenta
        plain = go.solve(problem, mesh="40x4", tol=None)
        held = problem.with_arcs(arcs=np.array(self.torques), states=states)
        mesh = go.Mesh.at_times(self.times, self.points, movable=True)
        return go.solve(held, mesh=mesh, guess=plain)


_NOWHERE = (0, 0, 0)

ONE_WHEEL = Structure(
    times=(0.0, 6.65, 10.42, HALF),
    torques=(_NOWHERE,) * 4,
    momenta=((0, 1, 0), _NOWHERE, _NOWHERE, _NOWHERE),
    points=14,
)
"""Least energy in half the time: the first wheel waits on its speed limit."""

TWO_WHEELS = Structure(
    times=(0.0, 1.18, 3.8, 4.92, 5.55, 6.7365, 6.797, 7.05, 9.9, 12.0028),
    torques=(
        (-1, -1, -1, 0, 0, 0, 1, 1, 1),
        (-1, -1, -1, -1, 0, 1, 1, 1, 1),
        (-1, -1, 1, 1, 1, 1, 1, 1, -1),
        (-1, 1, 1, 1, 1, 1, 1, -1, -1),
    ),
    momenta=((0, 0, 0, 1, 1, 1, 0, 0, 0), (0, 0, 0, 0, 1, 0, 0, 0, 0), (0,) * 9, (0,) * 9),
    points=8,
)
"""Least time with the speed limit: two wheels wait on it, one after the other."""


def _automatic(problem: go.Problem) -> go.Solution:
    return go.solve(problem, tol=_TOLERANCE)


SLEWS: dict[Name, tuple[Callable[[], go.Problem], Callable[[go.Problem], go.Solution]]] = {
    "energy": (build, _automatic),
    "energy, half the time": (lambda: build(duration=HALF), ONE_WHEEL.solve),
    "time, small": (lambda: build("time", 5), _automatic),
    "time, speed limit": (lambda: build("time", 1, torque=RESERVE_TORQUE, bias=BIAS), TWO_WHEELS.solve),
}
"""The optimal slews: what is asked, and how it is solved."""
MANOEUVRE: dict[Name, int] = {
    "energy": 3,
    "energy, half the time": 3,
    "time, small": 5,
    "time, speed limit": 1,
}


TRACKED: tuple[Name, ...] = ("energy", "energy, half the time", "time, speed limit")
"""Those that leave torque for feedback; the small slew of least time uses all that the published law does."""


@cache
def optimal_slew(name: Name) -> go.Solution:
    """Return an optimal slew."""
    problem, solve = SLEWS[name]
    return solve(problem())


# --- tracking -------------------------------------------------------------------------------------------

ATTITUDE_ERROR, RATE_ERROR, NULL_ERROR = np.radians(0.1), np.radians(0.1), 0.02
"""Acceptable errors by Bryson's rule: rad, rad/s, and N m s of momentum in the null direction."""
ACCEPTED_TORQUE = 0.02
"""Acceptable feedback torque of a wheel, N m."""
OFF_START = (0.3, -0.4, 0.2)
"""Attitude error at the start about x, y, z, degrees."""
INERTIA_ERROR = (1.05, 0.97, 1.04)
"""True moments over those of the model."""
DISTURBANCE = (2e-4, -1e-4, 1e-4)
"""Constant torque on the body, N m. (The publication has no disturbance.)"""
CONTROL_STEP = 0.05
"""s."""


def design_tracker(solution: go.Solution, reserve: float) -> go.Controller:
    """Return the time-varying linear-quadratic regulator along an optimal slew.

    All four wheels are commanded, so that their momentum in the null direction is tracked as well. The total momentum
    cannot be controlled and is not weighed; the terminal weight is the steady cost to go at rest.

    Parameters
    ----------
    solution : Solution
    reserve : float
        Torque limit of the wheels (N m), for the statement of what is left to the feedback.
    """
    craft = wheel_model()
    reference = go.Reference(solution)
    effort = np.eye(4) / ACCEPTED_TORQUE**2
    body = np.diag([1 / ATTITUDE_ERROR**2] * 3 + [1 / RATE_ERROR**2] * 3)
    null = np.outer(NULL, NULL) / (2 * NULL_ERROR) ** 2  # of the component along the unit null vector
    a, b = Deviation(craft).linearize(0.0, resting(reference.x(reference.final_time)[:4]), np.zeros(4))
    labels = tuple(f"e[{i}]" for i in range(6))
    rest = steady(a[:6, :6], b[:6], body, effort, np.zeros((6, 4)), labels)
    # of z' = -u with weights w and r the cost to go is (w r)^(1/2) z^2
    waiting = np.outer(NULL, NULL) / 4 / (NULL_ERROR * ACCEPTED_TORQUE)
    return go.design_tvlqr(
        craft,
        reference,
        Q=block_diag(body, null),
        R=effort,
        terminal=block_diag(rest.cost, waiting),
        limits=(-reserve, reserve),
    )


@cache
def track(name: Name) -> tuple[go.Run, float]:
    """Fly an optimal slew in closed loop with errors of start and inertia and a disturbance; return its final time too.

    The wheels have the published law's peak torque; the run goes on for 30 s after the end of the slew.
    """
    solution = optimal_slew(name)
    limit = published_peak_torque(MANOEUVRE[name])
    end = float(solution.phase().final_time)
    true = np.asarray(INERTIA) * INERTIA_ERROR
    loop = go.ClosedLoop(
        wheel_model(true),
        design_tracker(solution, limit),
        actuators=[Saturation("motors", -limit, limit)],
        disturbances=[Constant("push", np.asarray(DISTURBANCE) / true, on="omega")],
        dt=CONTROL_STEP,
    )
    return loop.simulate(_start(solution), tf=end + 30.0), end


def _start(solution: go.Solution) -> Array:
    turn = np.radians(OFF_START) / 2
    first = np.array([np.sqrt(1 - turn @ turn), *turn])
    return np.concatenate([first, np.zeros(3), np.asarray(solution.state("h")(0.0))])


def eigenaxis_energy(inertia: float, angle: float, duration: float) -> float:
    """Return the least energy (N^2 m^2 s) of a body with equal moments (kg m^2): a turn about one axis, in closed form.

    The least integral of the squared torque on a double integrator is 12 (J angle)^2 / duration^3, and the wheels of
    this pyramid need 3/4 of it.
    """
    return 0.75 * 12 * (inertia * angle) ** 2 / duration**3


def fastest_wheel(solution: go.Solution) -> float:
    """Return the largest speed of a wheel, rpm."""
    times = solution.phase().sample_times(24)
    return float(np.max(np.abs(solution.state("h")(times)))) / WHEEL_INERTIA / RPM
