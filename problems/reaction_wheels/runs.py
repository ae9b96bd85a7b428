"""The published slews of the wheel pyramid: what the laws do, as integrals over 60 s, not as sums over solver steps.

The published laws are continuous in time, so they are integrated as such (Dormand-Prince 8(5,3) at a relative
tolerance of 1e-10, on the model itself) and looked at every 5 ms; `problems.reaction_wheels.limits` flies them
sampled.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp, trapezoid

import gnc_opt as go
from gnc_opt.simulation.run import settling_time
from gnc_opt.spacecraft import quaternion_angle, quaternion_to_rotation, total_momentum
from problems._example import Array
from problems.reaction_wheels.laws import Law, design_flc, design_quaternion_lqr
from problems.reaction_wheels.model import (
    AXES,
    DURATION,
    INERTIA,
    INVERSE,
    NULL,
    REST,
    RPM,
    TORQUE_CONSTANT,
    VOLTAGE_CONSTANT,
    WHEEL_INERTIA,
    target_quaternion,
    wheel_model,
)

STEP = 0.005
"""Of the grid of the results, s."""
SETTLED = 0.02
"""A slew has settled when the angle to the target stays below this share of the first one."""
_TOLERANCE = 1e-10


@dataclass(frozen=True)
class Slew:
    """A slew on a fine grid.

    Attributes
    ----------
    target : array (4,)
        Scalar part first.
    times : array (n,)
        s.
    states : array (11, n)
        As in the model: q, omega, h.
    torques : array (4, n)
        Of the wheels' motors on the body, N m.
    """

    target: Array
    times: Array
    states: Array
    torques: Array

    @cached_property
    def angle(self) -> Array:
        """To the target about the eigenaxis, (n,), degrees; by the arc tangent, exact near zero."""
        return np.asarray(np.degrees(quaternion_angle(self.states[:4], self.target[:, None])))

    @property
    def euler_angles(self) -> Array:
        """About x, y and z, (3, n), degrees, turned in the order z, y, x, as those of the targets."""
        return np.asarray(quaternion_to_rotation(self.states[:4]).as_euler("ZYX", degrees=True).T[::-1])

    @property
    def rates(self) -> Array:
        """Of the body, (3, n), rad/s."""
        return self.states[4:7]

    @property
    def momenta(self) -> Array:
        """Of the wheels, (4, n), N m s."""
        return self.states[7:11]

    @property
    def speeds(self) -> Array:
        """Of the wheels, (4, n), rpm."""
        return self.momenta / WHEEL_INERTIA / RPM

    @property
    def body_torque(self) -> Array:
        """(3, n), N m."""
        return AXES @ self.torques

    @property
    def power(self) -> Array:
        """|V i| of every motor, (4, n), W: with K_V of the speed and K_T of the current it is |speed times torque|."""
        return np.abs(VOLTAGE_CONSTANT * self.speeds * self.torques / TORQUE_CONSTANT)

    @property
    def mechanical_power(self) -> Array:
        """|speed times torque| of every wheel, (4, n), W."""
        return np.abs(self.momenta / WHEEL_INERTIA * self.torques)

    @property
    def eulerint(self) -> float:
        """Integral of the angle, deg s."""
        return float(trapezoid(self.angle, self.times))

    @property
    def effort(self) -> float:
        """Integral of the sum of |T|, N m s."""
        return float(trapezoid(np.sum(np.abs(self.torques), axis=0), self.times))

    @property
    def energy(self) -> float:
        """Integral of the sum of T^2, N^2 m^2 s."""
        return float(trapezoid(np.sum(self.torques**2, axis=0), self.times))

    @property
    def work(self) -> float:
        """Integral of the sum of the powers, J."""
        return float(trapezoid(np.sum(self.power, axis=0), self.times))

    @property
    def peak_speed(self) -> float:
        """Of the fastest wheel, rpm."""
        return float(np.max(np.abs(self.speeds)))

    @property
    def balanced_speed(self) -> float:
        """Of the fastest wheel if null momentum kept the largest speed as low as possible at all times, rpm.

        Wheel i turns with n_i h_i + lambda in the null direction's signs; the shift is -(max + min) / 2.
        """
        signed = NULL[:, None] * self.momenta
        return float(np.max(np.ptp(signed, axis=0)) / 2 / WHEEL_INERTIA / RPM)

    @property
    def settling_time(self) -> float:
        """s, to `SETTLED` of the first angle."""
        return settling_time(self.times, self.angle, SETTLED * float(self.angle[0]))

    @property
    def momentum_defect(self) -> float:
        """Largest component of the total momentum, which is zero, N m s."""
        return float(np.max(np.abs(total_momentum(INERTIA, AXES, self.rates, self.momenta))))


def fly(controller: go.Controller, target: ArrayLike, duration: float = DURATION) -> Slew:
    """Integrate the model from rest under a law evaluated continuously.

    The law's memory keeps its first value, so that it must not depend on it (as long as no alarm is raised).
    """
    craft = wheel_model()
    x = ca.SX.sym("x", craft.states.size)
    row = controller.signal(0.0, STEP)
    memory = controller.initial_memory(0.0, REST, STEP)
    torques = ca.DM(INVERSE) @ controller.step(0.0, x, row, memory)[0]
    command = ca.Function("command", [x], [torques])
    rate = ca.Function("rate", [x], [craft.function(0.0, x, torques, craft.parameter_values)])
    times = STEP * np.arange(round(duration / STEP) + 1)
    flown = solve_ivp(
        lambda _, state: rate(state).full()[:, 0],
        (0.0, times[-1]),
        REST,
        method="DOP853",
        t_eval=times,
        rtol=_TOLERANCE,
        atol=1e-12,
    )
    if not flown.success:
        raise go.GncOptError(f"the slew cannot be integrated ({flown.message}): give the law a guard.")
    return Slew(np.asarray(target, dtype=float), flown.t, flown.y, np.asarray(command(flown.y).full()))


@cache
def published_slew(manoeuvre: int, name: Law) -> Slew:
    """Return the slew of a manoeuvre under a law with the printed gains."""
    target = target_quaternion(manoeuvre)
    design = design_flc if name == "FLC" else design_quaternion_lqr
    return fly(design(target), target)
