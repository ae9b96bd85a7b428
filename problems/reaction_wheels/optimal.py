r"""Optimal slews of the wheel pyramid within its torque and speed limits.

The minimum-energy slew is smooth; one wheel is at its speed limit for some time if the slew is short. The
minimum-time slew is bang-bang, with arcs on the speed limit where the torque of the wheel is zero and the multiplier
positive. Two measures separate its switches:

* The momentum in the null direction is free at the end. With all wheels at rest, every wheel that switches once has to
  switch at half time, so that switches coincide and the multipliers are not unique.
* If the speed limit is active, the wheels start with a bias in the null direction. From standstill, all wheels have
  the same speed until the first of them switches, and reach the limit at the same time, so that multipliers are not
  unique. (The solution without bias takes 11.9972591 s.)

All problems are solved with default settings; refinement finds the sequence of limits.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Literal, TypeAlias

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.errors import suggest_similar_name
from problems._example import Reference
from problems.reaction_wheels import control, model

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
    body = 2 * control.PRINTED_FLC[0] * np.asarray(model.INERTIA) * model.target_quaternion(manoeuvre)[1:]
    return float(np.max(np.abs(model.INVERSE @ body)))


def build(
    goal: Goal = "energy",
    manoeuvre: int = 3,
    duration: float = 34.6,
    torque: float | None = None,
    bias: float = 0.0,
    speed: float = model.DESIGN_SPEED,
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
    speed : float
        Limit of the wheels' speeds, rpm.

    Raises
    ------
    ProblemError
        There is no such goal or manoeuvre.
    """
    if goal not in ("energy", "time"):
        raise go.ProblemError(
            f"a slew has no goal {goal!r}: {suggest_similar_name(str(goal), ('energy', 'time'))}"
        )
    target = model.target_quaternion(manoeuvre)
    limit = published_peak_torque(manoeuvre) if torque is None else torque
    craft = model.wheel_model()
    problem = go.Problem(f"{goal}-optimal slew {manoeuvre}")
    slew = problem.phase("slew", craft)
    slew.time(initial=0.0, final=(1.0, 100.0) if goal == "time" else duration)
    slew.initial(q=model.REST[:4], omega=0.0, h=model.WHEEL_INERTIA * model.RPM * bias * model.NULL)
    # What is conserved (unit length, zero momentum) is not stated twice: the quaternion's vector part is enough, and
    # with the body at rest one wheel stands for all four
    most = model.WHEEL_INERTIA * model.RPM * speed
    null = most if goal == "time" else 0.0
    slew.final(
        q=([0.0, *target[1:]], [1.0, *target[1:]]), omega=0.0, h=([-most] * 3 + [-null], [most] * 3 + [null])
    )
    # The rates that the wheels' momenta can give at most: it excludes nothing, but keeps the iterates where they belong
    rates = np.sum(np.abs(model.AXES), axis=1) * most / np.asarray(model.INERTIA)
    slew.bounds(T=(-limit, limit), h=(-most, most), omega=(-rates, rates))
    if goal == "time":
        problem.minimize(slew.final_time)
    else:
        torques = craft.symbol("T")
        problem.minimize(slew.integral(ca.sumsqr(torques), "energy"), unit="N^2 m^2 s")
    return problem


REFERENCE = Reference(
    0.0053685521495051,
    "independent: two-point boundary value problem of the minimum principle, residual 1e-11",
    1e-11,
    "N^2 m^2 s",
)
"""Of `build` with its default arguments."""


# --- its solutions --------------------------------------------------------------------------------------


SLEWS: dict[Name, Callable[[], go.Problem]] = {
    "energy": build,
    "energy, half the time": lambda: build(duration=HALF),
    "time, small": lambda: build("time", 5),
    "time, speed limit": lambda: build("time", 1, torque=RESERVE_TORQUE, bias=BIAS),
}
"""The optimal slews."""
MANOEUVRE: dict[Name, int] = {
    "energy": 3,
    "energy, half the time": 3,
    "time, small": 5,
    "time, speed limit": 1,
}


@cache
def optimal_slew(name: Name) -> go.Solution:
    """Return an optimal slew."""
    return go.solve(SLEWS[name](), tol=_TOLERANCE)


def fastest_wheel(solution: go.Solution) -> float:
    """Return the largest speed of a wheel, rpm."""
    times = solution.phase().sample_times(24)
    return float(np.max(np.abs(solution.state("h")(times)))) / model.WHEEL_INERTIA / model.RPM
