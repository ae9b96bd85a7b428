r"""Optimal slews flown beside the published law: same errors of start, inertia and measurement, disturbance, motors.

The plans keep a reserve of wheel speed, since a body that is heavier than believed needs more of it; the limit is
`problems.reaction_wheels.model.DESIGN_SPEED`. The published law's torques are allocated by an array that enforces it;
that the plans respect it is judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.simulation import Constant, Noise, Saturation, Turn, Uniform, WheelArray
from gnc_opt.spacecraft import quaternion_angle, quaternion_product
from problems._example import Array
from problems.comparison import Row, at_most, require
from problems.dispersed import Rivals
from problems.flown import Flight, flight_rows, with_settings
from problems.kept import kept
from problems.reaction_wheels.laws import PRINTED_FLC, PRINTED_LQR, design_flc, design_quaternion_lqr
from problems.reaction_wheels.limits import peak_speed
from problems.reaction_wheels.model import (
    AXES,
    DESIGN_SPEED,
    DURATION,
    INERTIA,
    MAX_MOMENTUM,
    REST,
    target_quaternion,
    wheel_model,
)
from problems.reaction_wheels.optimal import (
    CONTROL_STEP,
    HALF,
    MANOEUVRE,
    Name,
    build,
    design_tracker,
    published_peak_torque,
)
from problems.reaction_wheels.runs import SETTLED

MEASURES = ("to 2 % of the angle (s)", "integral of sum T^2 (N^2 m^2 s)", "angle after 60 s (deg)")


@dataclass(frozen=True)
class Conditions:
    """What all are flown with; ``python -m problems.reaction_wheels --set`` changes it.

    Attributes
    ----------
    law : {"FLC", "LQR"}
        The published law.
    k1, k2 : float
        Gains of the feedback linearisation, 1/s^2 and 1/s.
    k_q, k_w : float, tuple of 3 floats
        Gains of the quaternion LQR, N m and N m s.
    speed : float
        Limit of the wheels' speeds in the plans, rpm.
    torque : float
        Share of the published law's peak torque that the plan of least time uses.
    start : tuple of 3 floats
        Error of attitude at the start about x, y, z, degrees.
    inertia : tuple of 3 floats
        True moments over those that are believed.
    disturbance : tuple of 3 floats
        Constant torque on the body, N m. (The publication has none.)
    attitude_noise, rate_noise : float
        1 sigma per axis and measurement, deg and deg/s.
    seed : int
    """

    law: str = "FLC"
    k1: float = PRINTED_FLC[0]
    k2: float = PRINTED_FLC[1]
    k_q: float = PRINTED_LQR[0]
    k_w: tuple[float, float, float] = PRINTED_LQR[1]
    speed: float = 4750.0
    torque: float = 0.8
    start: tuple[float, float, float] = (0.3, -0.4, 0.2)
    inertia: tuple[float, float, float] = (1.05, 0.97, 1.04)
    disturbance: tuple[float, float, float] = (2e-4, -1e-4, 1e-4)
    attitude_noise: float = 0.002
    rate_noise: float = 0.001
    seed: int = 1

    def __post_init__(self) -> None:
        if self.law not in ("FLC", "LQR"):
            raise go.GncOptError(f"there is no law {self.law!r} to fly: give 'FLC' or 'LQR'.")


FLOWN: tuple[Name, ...] = ("energy", "energy, half the time", "time, small")
KNOWN: dict[Name, tuple[Flight, Flight]] = {
    "energy": (Flight(31.65, 0.00726657, 0.00100715), Flight(35.10, 0.0318352, 0.185161)),
    "energy, half the time": (Flight(15.60, 0.0535389, 0.00100714), Flight(35.10, 0.0318352, 0.185161)),
    "time, small": (Flight(10.40, 0.00299534, 0.00100713), Flight(56.35, 0.000304655, 0.121606)),
}
"""Plan and published law by slew, for the default conditions: the torques that were applied, integrated by another
program on its own body."""


@kept
def plan(name: Name, speed: float = Conditions.speed, torque: float = Conditions.torque) -> go.Solution:
    """Return the slew that is flown, of `FLOWN`, with reserves of speed and torque as in `Conditions`."""
    if name == "time, small":
        limit = torque * published_peak_torque(MANOEUVRE[name])
        problem = build("time", MANOEUVRE[name], torque=limit, speed=speed)
    else:
        problem = build(duration=HALF if "half" in name else 34.6, speed=speed)
    return go.solve(problem, tol=1e-8)


def turned(q: object, angle: object) -> object:
    """Return an attitude turned by a small rotation vector (rad) in its own axes, to first order."""
    return quaternion_product(q, ca.vertcat(1, 0.5 * angle))  # type: ignore[operator]


def first_state(conditions: Conditions, momenta: Array) -> Array:
    """Return the true state (11,) at the start, off by the error of attitude."""
    turn = np.radians(conditions.start) / 2
    return np.concatenate([[np.sqrt(1 - turn @ turn)], turn, np.zeros(3), momenta])


def closed(
    name: Name, law: bool = False, conditions: Conditions = Conditions()
) -> tuple[go.ClosedLoop, Array]:
    """Return the loop of a plan, or of the published law in the same manoeuvre, and its first state."""
    limit, true = published_peak_torque(MANOEUVRE[name]), np.asarray(INERTIA) * conditions.inertia
    if law:
        target = target_quaternion(MANOEUVRE[name])
        controller = (
            design_flc(target, gains=(conditions.k1, conditions.k2))
            if conditions.law == "FLC"
            else design_quaternion_lqr(target, gains=(conditions.k_q, conditions.k_w))
        )
        motors: go.simulation.Block = WheelArray(
            "wheels", AXES, max_torque=limit, max_momentum=MAX_MOMENTUM, momenta="h", to="T"
        )
        start = first_state(conditions, REST[7:])
    else:
        slew = plan(name, conditions.speed, conditions.torque)
        controller, motors = design_tracker(slew, limit), Saturation("motors", -limit, limit)
        start = first_state(conditions, np.asarray(slew.state("h")(0.0)))
    loop = go.ClosedLoop(
        wheel_model(true),
        controller,
        actuators=[motors],
        sensors=[
            Noise("star tracker", np.full(3, np.radians(conditions.attitude_noise)), turned, on="q"),
            Noise("gyro", float(np.radians(conditions.rate_noise)), on="omega"),
        ],
        disturbances=[Constant("push", np.asarray(conditions.disturbance) / true, on="omega")],
        dt=CONTROL_STEP,
    )
    return loop, start


@kept
def flight(name: Name, law: bool = False, conditions: Conditions = Conditions()) -> go.Run:
    """Return the flight of `closed`, 60 s."""
    loop, start = closed(name, law, conditions)
    return loop.simulate(start, tf=DURATION, seed=conditions.seed)


def rivals(conditions: Conditions = Conditions(start=(0.0, 0.0, 0.0))) -> Rivals:
    """Return the plan of least energy and the published law, turned by up to 1 degree and 5 % heavier or lighter."""
    target = target_quaternion(MANOEUVRE["energy"])
    return Rivals(
        {
            who: closed("energy", law, conditions)
            for who, law in (("least energy", False), (conditions.law, True))
        },
        DURATION,
        {
            "initial.q": Turn(Uniform(0.0, float(np.radians(1.0)))),
            "plant.inertia": Uniform(-0.05, 0.05, relative=True),
        },
        {"q": target},
        {
            "energy(T)": ("integral of sum T^2 (N^2 m^2 s)", 1.0),
            "angle(q)": ("angle after 60 s (deg)", float(np.degrees(1.0))),
        },
    )


def worth(name: Name, run: go.Run) -> Flight:
    """Return what a flight is worth."""
    target = target_quaternion(MANOEUVRE[name])
    angle = np.degrees(quaternion_angle(run.state("q").values, target[:, None]))
    beyond = np.flatnonzero(angle > SETTLED * np.degrees(quaternion_angle(REST[:4], target)))
    settled = float("inf") if beyond[-1] == angle.size - 1 else float(run.times[beyond[-1]])
    return Flight(settled, float(np.sum(run.control_energy("T"))), float(angle[-1]))


def flown_rows(conditions: Conditions = Conditions()) -> list[Row]:
    """Return the rows of the flown comparison."""
    rows = []
    for name in FLOWN:
        ours, law = flight(name, False, conditions), flight(name, True, conditions)
        what = f"{name} ({MANOEUVRE[name]})"
        known = KNOWN[name] if conditions == Conditions() else None
        rows += flight_rows(what, MEASURES, worth(name, ours), worth(name, law), known, note=conditions.law)
        rows.append(require(f"{what}, flown: outcome", "ok", float(ours.outcome.ok), ours.outcome.ok))
        rows.append(at_most(f"{what}, flown: peak speed (rpm)", DESIGN_SPEED, peak_speed(ours)))
    return rows


def flown(settings: Sequence[str]) -> list[Row]:
    """Return the rows under other conditions, given as ``NAME=VALUE``."""
    return flown_rows(with_settings(Conditions(), settings))
