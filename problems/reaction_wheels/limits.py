"""Where the published laws end: the wheels' speed limit and the singularity of feedback linearisation.

Runs of the sampled closed loop, with the torques allocated to the wheels, and of single-axis slews about z.
"""

from __future__ import annotations

from functools import cache
from typing import Literal, TypeAlias

import numpy as np
from scipy.integrate import solve_ivp, trapezoid
from scipy.optimize import brentq

import gnc_opt as go
from gnc_opt.simulation import WheelArray
from problems._example import Array
from problems.kept import kept
from problems.reaction_wheels.laws import Law, Linear, design_flc, design_quaternion_lqr, flc_output
from problems.reaction_wheels.model import (
    AXES,
    DURATION,
    INVERSE,
    MAX_MOMENTUM,
    REST,
    RPM,
    WHEEL_INERTIA,
    target_quaternion,
    wheel_model,
)
from problems.reaction_wheels.runs import Slew, fly

Balance: TypeAlias = Literal["none", "momentum"]

CONTROL_STEP = 0.02
"""Of the sampled runs, s."""


@kept
def allocated_run(
    manoeuvre: int, law: Law, balance: Balance, *, limited: bool = False, duration: float = DURATION
) -> go.Run:
    """Return a manoeuvre in the sampled closed loop with a wheel array.

    Parameters
    ----------
    manoeuvre : int
    law : {"FLC", "LQR"}
    balance : {"none", "momentum"}
        Least torques, or null torques that keep the largest speed as small as possible (min-max).
    limited : bool
        Whether the wheels stop at the design limit of their speed.
    duration : float
        s.
    """
    target = target_quaternion(manoeuvre)
    controller = design_flc(target) if law == "FLC" else design_quaternion_lqr(target)
    wheels = WheelArray(
        "wheels",
        AXES,
        balance=balance,
        momenta="h",
        to="T",
        max_momentum=MAX_MOMENTUM if limited else np.inf,
    )
    loop = go.ClosedLoop(wheel_model(), controller, actuators=[wheels], dt=CONTROL_STEP)
    return loop.simulate(REST, tf=duration)


def peak_speed(run: go.Run) -> float:
    """Return the speed of the fastest wheel at the control steps of a run, rpm."""
    return float(np.max(np.abs(run.state("h").values))) / WHEEL_INERTIA / RPM


def angle_left(run: go.Run) -> float:
    """Return the attitude error at the end of a run, degrees."""
    return float(np.degrees(run.attitude_error("q")))


def about_z(angle: float) -> Array:
    """Return the quaternion (4,), scalar part first, of a turn about z (degrees)."""
    half = np.radians(angle) / 2
    return np.array([np.cos(half), 0.0, 0.0, np.sin(half)])


def breakdown_time(angle: float) -> float:
    """Return when the absolute output of a slew (degrees) reaches the singularity, s: the first q_0 = 0.

    In closed form the vector part has then the length one: (1 - e(t)) sin(angle / 2) = 1.
    """
    errors = Linear()
    half = np.sin(np.radians(angle) / 2)
    peak = np.pi / (errors.frequency * np.sqrt(1 - errors.damping**2))
    return float(brentq(lambda t: (1 - float(errors.left(t))) * half - 1, 0.0, peak))


@cache
def unguarded_breakdown(angle: float) -> float:
    """Return the same (s) from the model under the law without a useful guard: the first q_0 < 0.005."""
    craft = wheel_model(drive="body")
    controller = design_flc(about_z(angle), singular=1e-3)
    row, memory = controller.signal(0.0, 0.1), controller.initial_memory(0.0, REST, 0.1)

    def rate(t: float, x: Array) -> Array:
        torque = controller.step(t, x, row, memory)[0]
        return np.asarray(craft.function(t, x, torque, craft.parameter_values).full()[:, 0])

    def lost(t: float, x: Array) -> float:
        return float(x[0]) - 0.005

    lost.terminal = True  # type: ignore[attr-defined]
    flown = solve_ivp(rate, (0.0, 60.0), REST, method="DOP853", events=lost, rtol=1e-9, atol=1e-11)
    return float(flown.t_events[0][0])


@kept
def guarded_run(angle: float, duration: float = 120.0) -> go.Run:
    """Return a slew about z (degrees) with the paper's output, sampled: the guard hands over to quaternion feedback."""
    controller = design_flc(about_z(angle))
    return go.ClosedLoop(wheel_model(drive="body"), controller, dt=CONTROL_STEP).simulate(REST, tf=duration)


@kept
def rerouted_slew(angle: float, duration: float = 120.0) -> Slew:
    """Return a slew about z (degrees) with the output chosen for it: the error quaternion if need be.

    Within 5.7 degrees of half a turn the guard lets quaternion feedback begin.
    """
    target = about_z(angle)
    return fly(design_flc(target, output=flc_output(target)), target, duration)


def solver_sums(manoeuvre: int, tolerances: tuple[float, ...]) -> list[tuple[float, float]]:
    """Return the sum of |T| over a solver's own output points and its integral (N m s), by relative tolerance.

    The first depends on the solver's steps, the second does not.
    """
    target = target_quaternion(manoeuvre)
    craft, controller = wheel_model(drive="body"), design_flc(target)
    row, memory = controller.signal(0.0, 0.1), controller.initial_memory(0.0, REST, 0.1)

    def torque(x: Array) -> Array:
        return np.asarray(controller.step(0.0, x, row, memory)[0].full()[:, 0])

    def rate(t: float, x: Array) -> Array:
        return np.asarray(craft.function(t, x, torque(x), craft.parameter_values).full()[:, 0])

    found = []
    for tolerance in tolerances:
        flown = solve_ivp(rate, (0.0, DURATION), REST, rtol=tolerance, atol=tolerance, dense_output=True)
        sizes = [float(np.sum(np.abs(INVERSE @ torque(x)))) for x in flown.y.T]
        grid = np.linspace(0.0, DURATION, 2001)
        fine = [float(np.sum(np.abs(INVERSE @ torque(x)))) for x in flown.sol(grid).T]
        found.append((float(np.sum(sizes)), float(trapezoid(fine, grid))))
    return found
