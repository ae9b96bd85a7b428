"""Attitude slews with four reaction wheels: the published controllers, where they end, and the optima beside them.

Navabi and Hosseini, Modares Mechanical Engineering 18 (1), 51-61, 2018. The published controllers are continuous in
time, so `fly` integrates them as such; the runs at the wheels' speed limit, and those beside the optima, are sampled.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp, trapezoid
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import gnc_opt as go
from benchmarks.validation.published.comparison import (
    FlightMeasures,
    Value,
    flight_values,
    last_beyond,
    outcome_value,
    small_turn,
    verdict_value,
)
from gnc_opt.array_types import Array
from gnc_opt.simulation import ConstantDisturbance, Noise, Saturation, WheelArray
from gnc_opt.simulation.simulation_run_results import compute_settling_time
from gnc_opt.spacecraft import quaternion_angle
from problems.reaction_wheels import control, model, optimal

LAWS: tuple[control.Law, ...] = ("FLC", "LQR")
STEP = 0.005
"""Of the grid of the results, s."""
SETTLED = 0.02
"""A slew has settled when the angle to the target stays below this share of the first one."""
BREAKDOWNS = (148, 150, 160, 175, 179)
"""Slews about z (degrees) that the feedback linearisation with the absolute output cannot make."""


def values() -> Iterator[Value]:
    """Yield every computed quantity of the table."""
    yield from _data()
    yield from _gains()
    yield from _slews()
    yield from _singularity()
    yield from _statements()
    yield from _optima()
    for name in FLOWN:
        yield from _flown(name)


# --- the published slews --------------------------------------------------------------------------------


class Slew:
    """A slew on a fine grid: times (n,), states (11, n) as in the model, torques (4, n) of the motors on the body.

    Momenta (N m s) and speeds (rpm) of the wheels, power of every motor (W); rates (rad/s) and torque (N m) of the body
    and the angle to the target about the eigenaxis (degrees). Integrals of that angle (``eulerint``, deg s) and of the
    sums of |T| (``effort``, N m s), T^2 (``energy``, N^2 m^2 s) and powers (``work``, J).
    """

    def __init__(self, target: Array, times: Array, states: Array, torques: Array) -> None:
        self.target, self.times, self.states, self.torques = target, times, states, torques
        self.angle = np.asarray(np.degrees(quaternion_angle(states[:4], target[:, None])))
        self.rates, self.momenta, self.body_torque = states[4:7], states[7:11], model.AXES @ torques
        self.speeds = self.momenta / model.WHEEL_INERTIA / model.RPM
        # |V i|: with K_V of the speed and K_T of the current it is |speed times torque|
        self.power = np.abs(model.VOLTAGE_CONSTANT * self.speeds * torques / model.TORQUE_CONSTANT)
        self.peak_speed = float(np.max(np.abs(self.speeds)))
        self.eulerint, self.effort, self.energy, self.work = (
            float(trapezoid(values, times))
            for values in (
                self.angle,
                *(np.sum(v, axis=0) for v in (np.abs(torques), torques**2, self.power)),
            )
        )

    @property
    def balanced_speed(self) -> float:
        """Of the fastest wheel if null momentum kept the largest speed as low as possible at all times, rpm.

        Wheel i turns with n_i h_i + lambda in the null direction's signs; the shift is -(max + min) / 2.
        """
        signed = model.NULL[:, None] * self.speeds
        return float(np.max(np.ptp(signed, axis=0)) / 2)

    @property
    def settling_time(self) -> float:
        """s, to `SETTLED` of the first angle."""
        return compute_settling_time(self.times, self.angle, SETTLED * float(self.angle[0]))


def fly(controller: go.Controller, target: ArrayLike, duration: float = model.DURATION) -> Slew:
    """Integrate the model from rest under a controller that is evaluated continuously.

    Its memory keeps its first value, so that it must not depend on it (as long as no alarm is raised).
    """
    craft = model.wheel_model()
    x = ca.SX.sym("x", craft.states.size)
    row = controller.schedule_row(0.0, STEP)
    memory = controller.initial_memory(0.0, model.REST, STEP)
    torques = ca.DM(model.INVERSE) @ controller.step(0.0, x, row, memory)[0]
    command = ca.Function("command", [x], [torques])
    rate = ca.Function("rate", [x], [craft.function(0.0, x, torques, craft.parameter_values)])
    times = STEP * np.arange(round(duration / STEP) + 1)
    rates = lambda _, state: rate(state).full()[:, 0]  # noqa: E731
    flown = solve_ivp(rates, (0.0, times[-1]), model.REST, "DOP853", times, rtol=1e-10, atol=1e-12)
    if not flown.success:
        raise go.GncOptError(f"the slew cannot be integrated ({flown.message}): give the controller a guard.")
    return Slew(np.asarray(target, dtype=float), flown.t, flown.y, np.asarray(command(flown.y).full()))


@cache
def published_slew(manoeuvre: int, name: control.Law) -> Slew:
    """Return the slew of a manoeuvre under a controller with the printed gains."""
    target = model.target_quaternion(manoeuvre)
    design = control.design_flc if name == "FLC" else control.design_quaternion_lqr
    return fly(design(target), target)


# --- the wheels' speed limit, and the singularity of feedback linearisation ------------------------------


def allocated_run(
    balance: Literal["none", "momentum"], *, limited: bool = False, duration: float = model.DURATION
) -> go.Run:
    """Return manoeuvre 3 under the FLC, sampled every 0.02 s, with a wheel array.

    ``balance`` asks for least torques, or for null torques that keep the largest speed as small as possible (min-max);
    ``limited`` wheels stop at the design limit of their speed.
    """
    wheels = WheelArray(
        "wheels",
        model.AXES,
        balance=balance,
        momenta="h",
        to="T",
        max_momentum=model.MAX_MOMENTUM if limited else np.inf,
    )
    loop = go.ClosedLoop(
        model.wheel_model(), control.design_flc(model.target_quaternion(3)), actuators=[wheels], dt=0.02
    )
    return loop.simulate(model.REST, tf=duration)


def about_z(angle: float) -> Array:
    """Return the quaternion (4,), scalar part first, of a turn about z (degrees)."""
    half = np.radians(angle) / 2
    return np.array([np.cos(half), 0.0, 0.0, np.sin(half)])


def breakdown_time(angle: float) -> float:
    """Return when the absolute output of a slew (degrees) reaches the singularity, s: the first q_0 = 0.

    In closed form the vector part has then the length one: (1 - e(t)) sin(angle / 2) = 1.
    """
    errors = control.Linear()
    half = np.sin(np.radians(angle) / 2)
    peak = np.pi / (errors.frequency * np.sqrt(1 - errors.damping**2))
    return float(brentq(lambda t: (1 - float(errors.left(t))) * half - 1, 0.0, peak))


def unguarded_breakdown(angle: float) -> float:
    """Return the same (s) from the model under the FLC without a useful guard: the first q_0 < 0.005."""
    craft = model.wheel_model(drive="body")
    controller = control.design_flc(about_z(angle), singular=1e-3)
    row, memory = controller.schedule_row(0.0, 0.1), controller.initial_memory(0.0, model.REST, 0.1)

    def rate(t: float, x: Array) -> Array:
        torque = controller.step(t, x, row, memory)[0]
        return np.asarray(craft.function(t, x, torque, craft.parameter_values).full()[:, 0])

    def lost(t: float, x: Array) -> float:
        return float(x[0]) - 0.005

    lost.terminal = True  # type: ignore[attr-defined]
    flown = solve_ivp(rate, (0.0, 60.0), model.REST, method="DOP853", events=lost, rtol=1e-9, atol=1e-11)
    return float(flown.t_events[0][0])


def guarded_run(angle: float) -> go.Run:
    """Return a slew about z (degrees) with the paper's output, sampled: the guard hands over to quaternion feedback."""
    controller = control.design_flc(about_z(angle))
    return go.ClosedLoop(model.wheel_model(drive="body"), controller, dt=0.02).simulate(model.REST, tf=120.0)


def rerouted_slew(angle: float) -> Slew:
    """Return a slew about z (degrees) with the output chosen for it: the error quaternion if need be."""
    target = about_z(angle)
    return fly(control.design_flc(target, output=control.flc_output(target)), target, 120.0)


# --- values of the publication --------------------------------------------------------------------------


def _data() -> Iterator[Value]:
    tilt = np.degrees(np.arctan2(model.AXES[2, 0], np.hypot(*model.AXES[:2, 0])))
    turn = np.degrees(np.arctan2(model.AXES[1, 0], model.AXES[0, 0]))
    yield Value("data: beta and theta of the pyramid (deg)", (tilt, turn))
    for manoeuvre in model.MANOEUVRES:
        turned = Rotation.from_quat(model.paper_quaternion(model.target_quaternion(manoeuvre)))
        angles = turned.as_euler("ZYX", degrees=True)[::-1]
        yield Value(f"data: target of manoeuvre {manoeuvre} about x, y, z (deg)", angles)
    a = np.array([[0.0, 1.0], [-control.PRINTED_FLC[0], -control.PRINTED_FLC[1]]])
    p = solve_continuous_lyapunov(a.T, -np.eye(2))
    yield Value("P of equation 50 (1, 1; 1, 2; 2, 2)", (p[0, 0], p[0, 1], p[1, 1]))
    yield Value("eigenvalues of P of equation 50", np.linalg.eigvalsh(p))
    # E = 1/2 (q4 I + [q x]) J^-1: dq_v/dt of a turn about z has the second component in its first row
    target = model.paper_quaternion(model.target_quaternion(1))
    turned = Rotation.from_quat(target) * Rotation.from_rotvec([0, 0, 1e-6])
    entry = 2e6 * (turned.as_quat()[0] - target[0])
    yield Value("entry (1, 3) of equation 26 times 2 J_z, at target 1", entry)


def _gains() -> Iterator[Value]:
    k1, k2 = control.flc_gains()
    k_q, k_w = control.lqr_gains()
    yield Value("FLC K1 (1/s^2)", k1)
    yield Value("FLC K2 (1/s)", k2)
    yield Value("LQR K_q (N m)", k_q[0, 0])
    yield Value("LQR K_omega, x and y (N m s)", k_w[0, 0])
    yield Value("LQR K_omega, z (N m s)", k_w[2, 2])
    yield Value("FLC overshoot", control.Linear().overshoot)


def _slews() -> Iterator[Value]:
    for manoeuvre in model.MANOEUVRES:
        for law in LAWS:
            slew = published_slew(manoeuvre, law)
            yield Value(f"EULERINT {manoeuvre} {law} (deg s)", slew.eulerint)
            yield Value(f"integral of sum |T| {manoeuvre} {law} (N m s)", slew.effort)
            yield Value(f"integral of sum T^2 {manoeuvre} {law} (N^2 m^2 s)", slew.energy)
            yield Value(f"integral of sum |P| {manoeuvre} {law} (J)", slew.work)
            yield Value(f"peak speed {manoeuvre} {law} (rpm)", slew.peak_speed)
            yield Value(f"settling time {manoeuvre} {law} (s)", slew.settling_time)
    for law in LAWS:
        slew = published_slew(1, law)
        rates, torques = np.max(np.abs(slew.rates), axis=1), np.max(np.abs(slew.body_torque), axis=1)
        for axis, rate in zip("xyz", np.degrees(rates), strict=True):
            yield Value(f"peak rate {axis}, 1 {law} (deg/s)", rate)
        for axis, torque in zip("xyz", torques, strict=True):
            yield Value(f"peak torque {axis}, 1 {law} (N m)", torque)
        yield Value(f"peak wheel torque, 1 {law} (N m)", np.max(np.abs(slew.torques)))
        yield Value(f"angle after 60 s, 1 {law} (deg)", slew.angle[-1])
        yield Value(f"wheel speed after 60 s, 1 {law} (rpm)", np.max(np.abs(slew.speeds[:, -1])))
    for manoeuvre in (1, 2, 3):
        for law in LAWS:
            speed = published_slew(manoeuvre, law).balanced_speed
            yield Value(f"peak speed, min-max, {manoeuvre} {law} (rpm)", speed)
    sampled = control.peak_speed(allocated_run("momentum", limited=True, duration=40.0))
    yield Value("peak speed, min-max, 3 FLC, sampled (rpm)", sampled)


def _singularity() -> Iterator[Value]:
    yield Value("largest FLC slew (deg)", np.degrees(control.Linear().largest_slew))
    for angle in BREAKDOWNS:
        yield Value(f"breakdown of {angle} deg, closed form (s)", breakdown_time(angle))
        yield Value(f"breakdown of {angle} deg, flown (s)", unguarded_breakdown(angle))
    yield Value("150 deg, guarded: angle left (deg)", np.degrees(guarded_run(150).attitude_error("q")))
    for angle in (150, 170, 179):
        yield Value(f"{angle} deg, error output: angle left (deg)", rerouted_slew(angle).angle[-1])
    edge = fly(control.design_flc(about_z(147)), about_z(147), 120.0)
    yield Value("147 deg, FLC: smallest q4", np.min(edge.states[0]))
    yield Value("147 deg, FLC: peak torque (N m)", np.max(np.abs(edge.body_torque)))
    yield Value("147 deg, FLC: peak rate (deg/s)", np.degrees(np.max(np.abs(edge.rates))))
    yield Value("147 deg, FLC: peak speed (rpm)", edge.peak_speed)
    lqr = control.design_quaternion_lqr(about_z(179))
    yield Value("LQR at 179 deg: first torque (N m)", np.max(np.abs(lqr(0.0, model.REST, dt=1.0)[0])))
    yield Value("LQR at 179 deg: angle after 120 s (deg)", fly(lqr, about_z(179), 120.0).angle[-1])


def _statements() -> Iterator[Value]:
    for manoeuvre in model.MANOEUVRES:
        for law in LAWS:
            slew = published_slew(manoeuvre, law)
            yield Value(f"sum of |P| (J), {manoeuvre} {law}", slew.work)
            yield Value(f"sum of |T| (N m s), {manoeuvre} {law}", slew.effort)
            yield Value(f"sum of T^2 (N^2 m^2 s), {manoeuvre} {law}", slew.energy)
    for law in LAWS:
        times = [published_slew(manoeuvre, law).settling_time for manoeuvre in model.MANOEUVRES]
        note = f"{min(times):.1f} to {max(times):.1f} to 2 %"
        yield Value(f"settling, 1 to 6 {law} (s)", np.mean(times), note=note)
        yield Value(f"peak speed, 1 {law} (rpm)", published_slew(1, law).peak_speed)
    pairs = [[published_slew(manoeuvre, law) for law in LAWS] for manoeuvre in model.MANOEUVRES]
    for name, what in (
        ("eulerint", "EULERINT"),
        ("energy", "integral of sum T^2"),
        ("effort", "integral of sum |T|"),
        ("work", "integral of sum |P|"),
    ):
        smaller = sum(getattr(flc, name) < getattr(lqr, name) for flc, lqr in pairs)
        yield Value(f"manoeuvres of 6 in which {what} is smaller with FLC", smaller)
    yield Value("peak speed 3 FLC, by the design (rpm)", published_slew(3, "FLC").peak_speed)


# --- optimal slews, undisturbed and in closed loop -------------------------------------------------------


def _optima() -> Iterator[Value]:
    for name, manoeuvre in optimal.MANOEUVRE.items():
        solution, published = optimal.optimal_slew(name), published_slew(manoeuvre, "FLC")
        in_time = name.startswith("time")
        theirs = published.settling_time if in_time else published.energy
        what, unit = f"{name} (manoeuvre {manoeuvre})", "s" if in_time else "N^2 m^2 s"
        yield Value(f"{what}: least ({unit})", solution.objective)
        yield verdict_value(f"{what}: verdict", go.verify(solution))
        yield Value(f"{what}: peak speed (rpm)", optimal.fastest_wheel(solution))
        yield Value(f"{what}: least / published FLC", solution.objective / theirs)


FLOWN: tuple[optimal.Name, ...] = ("energy", "energy, half the time", "time, small")
"""Optima that are tracked, beside the FLC."""
MEASURES = ("to 2 % of the angle (s)", "integral of sum T^2 (N^2 m^2 s)", "angle after 60 s (deg)")
RESERVE_SPEED, RESERVE_TORQUE = 4750.0, 0.8
"""Limit of the wheels' speeds in the plans, rpm: a body that is heavier than assumed needs more. Share of the published
controller's peak torque that the plan of least time uses."""
INERTIA_RATIO = (1.05, 0.97, 1.04)
"""True moments over those that plans and controllers assume."""
DISTURBANCE = (2e-4, -1e-4, 1e-4)
"""Constant torque on the body, N m; the publication has none."""
START_ERROR = (0.3, -0.4, 0.2)
"""Of attitude about x, y, z, degrees."""
ATTITUDE_NOISE, RATE_NOISE = 0.002, 0.001
"""1 sigma per axis and measurement, deg and deg/s."""


@cache
def plan(name: optimal.Name) -> go.Solution:
    """Return the slew of `FLOWN` that is tracked, with reserves of speed and torque."""
    if name == "time, small":
        limit = RESERVE_TORQUE * optimal.published_peak_torque(optimal.MANOEUVRE[name])
        problem = optimal.build("time", optimal.MANOEUVRE[name], torque=limit, speed=RESERVE_SPEED)
    else:
        problem = optimal.build(duration=optimal.HALF if "half" in name else 34.6, speed=RESERVE_SPEED)
    return go.solve(problem, tol=1e-8)


def closed(
    name: optimal.Name, law: bool = False, start_error: ArrayLike = START_ERROR, noise: float = 1.0
) -> tuple[go.ClosedLoop, Array]:
    """Return the loop of a plan, or of the FLC in the same manoeuvre, and its first state.

    Both have the same errors of start (attitude, degrees), inertia and measurement (times ``noise``), disturbance and
    torque limit. The wheel array enforces the speed limit on the FLC; that the plans respect it is checked.
    """
    manoeuvre, true = optimal.MANOEUVRE[name], np.asarray(model.INERTIA) * INERTIA_RATIO
    limit = optimal.published_peak_torque(manoeuvre)
    if law:
        controller, momenta = control.design_flc(model.target_quaternion(manoeuvre)), model.REST[7:]
        motors: go.simulation.Block = WheelArray(
            "wheels", model.AXES, max_torque=limit, max_momentum=model.MAX_MOMENTUM, momenta="h", to="T"
        )
    else:
        controller, momenta = _tracker(name, limit), np.asarray(plan(name).state("h")(0.0))
        motors = Saturation("motors", -limit, limit)
    turn = np.radians(start_error) / 2
    start = np.concatenate([[np.sqrt(1 - turn @ turn)], turn, np.zeros(3), momenta])
    loop = go.ClosedLoop(
        model.wheel_model(true),
        controller,
        actuators=[motors],
        sensors=[
            Noise("star tracker", np.full(3, noise * np.radians(ATTITUDE_NOISE)), small_turn, on="q"),
            Noise("gyro", float(noise * np.radians(RATE_NOISE)), on="omega"),
        ],
        disturbances=[ConstantDisturbance("push", np.asarray(DISTURBANCE) / true, on="omega")],
        dt=control.CONTROL_STEP,
    )
    return loop, start


@cache
def _tracker(name: optimal.Name, limit: float) -> go.Controller:
    return control.design_tracker(plan(name), limit)


@cache
def flight(name: optimal.Name, law: bool = False, noise: float = 1.0) -> go.Run:
    """Return the run of `closed`, 60 s."""
    loop, start = closed(name, law, noise=noise)
    return loop.simulate(start, tf=model.DURATION, seed=1)


def measures(name: optimal.Name, run: go.Run) -> FlightMeasures:
    """Return the measures of a run."""
    target = model.target_quaternion(optimal.MANOEUVRE[name])
    angle = np.degrees(quaternion_angle(run.state("q").values, target[:, None]))
    band = SETTLED * float(np.degrees(quaternion_angle(model.REST[:4], target)))
    settled = last_beyond(run.times, angle, band)
    return FlightMeasures(settled, float(np.sum(run.control_energy("T"))), float(angle[-1]))


def _flown(name: optimal.Name) -> Iterator[Value]:
    ours, law, what = flight(name), flight(name, True), f"{name} ({optimal.MANOEUVRE[name]})"
    yield from flight_values(what, MEASURES, measures(name, ours), measures(name, law))
    yield outcome_value(what, ours)
    yield Value(f"{what}, flown: peak speed (rpm)", control.peak_speed(ours))
