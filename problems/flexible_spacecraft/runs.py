"""The closed loop of the publication's manoeuvre, the runs that tables and figures share, and their measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

import gnc_opt as go
from gnc_opt.arrays import Array
from gnc_opt.control import Controller
from gnc_opt.errors import GncOptError
from gnc_opt.simulation import ClosedLoop, Constant, Disturbance, Run, Saturation, Sinusoid
from gnc_opt.simulation.block import Defaults, Parameters, Tick, scalar
from gnc_opt.spacecraft import FlexibleBody, quaternion_angle, quaternion_to_dcm
from problems.flexible_spacecraft.laws import (
    INERTIAL,
    INERTIAL_ROBUST,
    UNIT,
    UNIT_ROBUST,
    QuasiSlidingMode,
    quasi_sliding_mode,
)
from problems.flexible_spacecraft.model import (
    BODY,
    DISTURBANCE,
    MAX_TORQUE,
    ORBITAL_RATE,
    build_model,
    initial_state,
    target,
)

SPAN = 200.0
"""Of a run, s."""
STEP = 0.025
"""Control step, s."""
DISTURBED_STEP = 0.1
"""Control step of the runs with disturbances, s."""

# --- the loop -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PublishedDisturbance(Disturbance):
    """``amplitude * (sin t + r)`` on every axis, r uniform in (0, 1), a new one for every axis and control step."""

    amplitude: float = DISTURBANCE

    def parameters(self, size: int, unit: str) -> Defaults:
        return {"amplitude": (scalar(self.amplitude, f"the amplitude of '{self.name}'"), unit)}

    def noise(self, size: int) -> int:
        return size

    def start(self, signal: Any, p: Parameters, tick: Tick) -> Any:
        return ca.SX.zeros(signal.shape[0])

    def update(self, tick: Tick, state: Any, p: Parameters, noise: Any) -> Any:
        return 0.5 * (
            1 + ca.erf(noise / np.sqrt(2.0))
        )  # the distribution function of a normal number is uniform

    def value(self, t: Any, x: Any, state: Any, p: Parameters) -> Any:
        return p["amplitude"] * (ca.sin(t) + state)


def mean_disturbance(amplitude: float = DISTURBANCE) -> tuple[Disturbance, ...]:
    """Return `PublishedDisturbance` with its random part at its mean: runs with it can be computed by others."""
    return (
        Sinusoid("wave", amplitude, 1.0, on="torque"),
        Constant("push", amplitude / 2, on="torque"),
    )


def loop(
    model: go.Model,
    controller: Controller,
    *,
    dt: float,
    disturbances: tuple[Disturbance, ...] = (),
    substeps: int | None = None,
) -> ClosedLoop:
    """Return the closed loop with the torque limit.

    Integration steps of up to 0.025 s are enough for modes of 2.7 rad/s; each run checks that.
    """
    limit = Saturation("limit", -MAX_TORQUE, MAX_TORQUE)
    return ClosedLoop(
        model,
        controller,
        actuators=[limit],
        disturbances=disturbances,
        dt=dt,
        accuracy=1e-7,
        substeps=substeps or int(np.ceil(dt / 0.025 - 1e-9)),
    )


def fly_loop(closed: ClosedLoop, x0: ArrayLike, tf: float) -> Run:
    """Return the run of a loop; refuse one that is not accurate or not finite.

    Raises
    ------
    GncOptError
        The run's own outcome, if it is not ok.
    """
    run = closed.simulate(x0, tf=tf)
    if not run.outcome.ok:
        raise GncOptError(f"the run of '{closed.controller.name}' is {run.outcome}: give more substeps.")
    return run


# --- runs -----------------------------------------------------------------------------------------------


def fly(
    gains: QuasiSlidingMode,
    *,
    dt: float = STEP,
    tf: float = SPAN,
    disturbances: tuple[Disturbance, ...] = (),
    body: FlexibleBody = BODY,
    believed: FlexibleBody | None = None,
    x0: Array | None = None,
    substeps: int | None = None,
) -> Run:
    """Return the run of the publication's manoeuvre; the law believes in another body, if one is given."""
    model = build_model(body)
    controller = quasi_sliding_mode(model, target(model), gains, body=believed or body)
    start = initial_state(model) if x0 is None else x0
    closed = loop(model, controller, dt=dt, disturbances=disturbances, substeps=substeps)
    return fly_loop(closed, start, tf)


@cache
def standard(name: str) -> Run:
    """Return one of the runs that tables and figures share, by name."""
    cases: dict[str, Callable[[], Run]] = {
        # the last ripple of this one reaches 0.00996 where 0.01 counts: commands held for 0.025 s lift it above
        "U": lambda: fly(UNIT, dt=0.01),
        "U robust": lambda: fly(UNIT_ROBUST),
        "J": lambda: fly(INERTIAL),
        "J robust": lambda: fly(INERTIAL_ROBUST),
        "J k=0.01": lambda: fly(replace(INERTIAL, k=0.01), dt=0.05),
        "J k=0.02": lambda: fly(replace(INERTIAL, k=0.02), dt=0.05),
        "J tanh": lambda: fly(INERTIAL, dt=0.1),
        "J sign": lambda: fly(replace(INERTIAL, switching=True), dt=0.1),
        "printed sign": lambda: fly(replace(INERTIAL, printed_sign=True), dt=0.1),
    }
    return cases[name]()


@cache
def disturbed(name: str) -> Run:
    """Return the run of "U" or "J" with the publication's disturbance."""
    pushes = (PublishedDisturbance("T_d", on="torque"),)
    gains = {"U": UNIT, "J": INERTIAL}[name]
    return fly(gains, dt=DISTURBED_STEP, tf=240.0, disturbances=pushes)


# --- measures -------------------------------------------------------------------------------------------


def attitude_error(run: Run) -> Array:
    """Return the angle (n_times,) to the target, rad."""
    return np.asarray(quaternion_angle(run.state("q_BO").values, np.array([[1.0], [0.0], [0.0], [0.0]])))


def largest_component(run: Run) -> Array:
    """Return max |q_i| of the vector part (n_times,), the publication's measure of settling."""
    return np.asarray(np.max(np.abs(run.state("q_BO").values[1:]), axis=0))


def surface(run: Run, c: float) -> Array:
    """Return S (3, n_times), rad/s, of the true attitude and rate against the target, at slope c (1/s)."""
    q, omega = run.state("q_BO").values, run.state("omega").values
    frame = np.stack([-ORBITAL_RATE * quaternion_to_dcm(column)[:, 1] for column in q.T], axis=1)
    sign = np.where(q[0] < 0, -1.0, 1.0)
    v, relative = sign * q[1:], omega - frame
    return -(np.abs(q[0]) * relative + np.cross(v, relative, axis=0)) - 2 * c * v


def on_surface(run: Run, c: float, width: float) -> float:
    """Return the last time (s) at which a component of S is beyond ``width`` (rad/s)."""
    return float(run.times[np.flatnonzero(np.max(np.abs(surface(run, c)), axis=0) > width)[-1]])


def settling(run: Run, band: float) -> float:
    """Return the last time (s) at which `largest_component` is above the band; infinite if it is so at the end."""
    outside = np.flatnonzero(largest_component(run) > band)
    return float("inf") if outside[-1] == run.times.size - 1 else float(run.times[outside[-1]])


@dataclass(frozen=True)
class Measures:
    """What the publication's Tables 6 and 7 tell of a run; torques in N m, rates in rad/s."""

    torque: float
    rate: float
    rate_norm: float
    modes: Array
    settling: float
    settling_fine: float
    effort: float
    agility: float
    braking: Array


def measure(run: Run) -> Measures:
    """Return the measures of a run."""
    u, omega = run.control("torque").values, run.state("omega").values
    first = np.sign(u[:, :1])
    eta = run.state("eta").values
    return Measures(
        torque=float(np.max(np.abs(u))),
        rate=float(np.max(np.abs(omega))),
        rate_norm=float(np.max(np.linalg.norm(omega, axis=0))),
        modes=np.array([eta.min(), eta.max()]),
        settling=settling(run, 0.01),
        settling_fine=settling(run, 0.001),
        effort=float(np.sum(run.effort)),
        agility=float(np.trapezoid(attitude_error(run), run.times)),
        braking=np.asarray(-first[:, 0] * np.max(-first * u, axis=1)),
    )


def variation(run: Run) -> float:
    """Return the total variation of the applied torque, summed over the axes, N m."""
    return float(np.sum(np.abs(np.diff(run.control("torque").values, axis=1))))
