"""Slew of a flexible spacecraft: the published quasi-sliding mode (QSMC, RQSMC), and the optima beside it.

Taei and Moradi, J. Aerospace Mechanics 19 (3), 97-108, 2023. Two sets of gains come near its tables: "U" (G = 1) near
the QSMC column, "J" (G = J, retuned) near some of the RQSMC column. Independent numbers are those of the controller in
continuous time; here commands are held, for 0.025 s unless a function says otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

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
from gnc_opt.control import Controller, Reference, feedforward
from gnc_opt.simulation import ClosedLoop, Disturbance, Noise, Run, Saturation, SinusoidalDisturbance
from gnc_opt.simulation.sensor_and_actuator_block import Defaults, Parameters, StepContext, read_block_scalar
from gnc_opt.spacecraft import FlexibleBody, quaternion_angle, quaternion_to_dcm
from problems.flexible_spacecraft import control, model, optimal

SPAN = 200.0
"""Of a run, s."""
DISTURBED_STEP = 0.1
"""Control step of the runs with disturbances, s."""
FULL = model.flexible_body(model.COUPLING, (0.7681, 1.1038, 1.8733, 2.5496), (0.0056, 0.0086, 0.013, 0.025))
"""With the published modal data before rounding."""
ONE_DIGIT = ((6.4, -1.2, 1.1, 1.2), (1.2, 0.9, 2.5, -2.6), (2.2, -1.7, -0.8, -1.1))
"""The coupling as printed; its first entry may also be 7."""
TORQUE = (0.3, -0.2, 0.1)
"""Of the open-loop manoeuvre, N m."""
VIBRATING = np.array([1.0, 0, 0, 0, 0.02, -0.03, 0.04, 0.05, -0.02, 0.01, 0.02, 0.01, 0.02, -0.03, 0.01])
"""Start of the runs without torque."""


def values() -> Iterator[Value]:
    """Yield every computed quantity of the table."""
    yield from _plant()
    yield from _configurations()
    yield from _data()
    yield from _texts()
    yield from _gain()
    yield from _chattering()
    yield from _disturbances()
    yield from _printed_sign()
    yield from _sensitivity()
    yield from _least_time()
    yield from _least_vibration()
    yield from _tracking()
    for name in FLOWN:
        yield from _flown(name)


# --- the plant ------------------------------------------------------------------------------------------


def _plant() -> Iterator[Value]:
    masses = np.linalg.eigvalsh(model.BODY.mass_matrix)
    yield Value("J - C C^T, eigenvalues (kg m^2)", np.linalg.eigvalsh(model.BODY.rigid_inertia))
    for corner in (6.4, 7.0):
        coupling = np.array(ONE_DIGIT)
        coupling[0, 0] = corner
        cut = model.flexible_body(coupling, model.FREQUENCIES, model.DAMPING)
        quantity = f"the same, C cut to one digit, C11 = {corner:g}"
        yield Value(quantity, np.linalg.eigvalsh(cut.rigid_inertia))
    yield Value("mass matrix, extreme eigenvalues", (masses[0], masses[-1]))
    effect = np.diag(np.linalg.inv(model.BODY.rigid_inertia)) * np.array(model.INERTIA)
    yield Value("fast torques: effect relative to 1/J_i", effect)
    for body, name in ((model.BODY, "rounded"), (FULL, "full")):
        yield Value(f"frequencies, free body, {name} data (rad/s)", body.free_frequencies())
        yield Value(f"damping ratios, free body, {name} data", body.free_damping())
    turning = np.array(TORQUE) / np.array(model.INERTIA)
    deflection = -(np.array(model.COUPLING).T @ turning) / np.square(model.FREQUENCIES)
    yield Value("quasi-static deflection under (.3, -.2, .1) N m (kg^.5 m)", deflection)
    # the model agrees: with that deflection no mode is accelerated
    bending = model.BODY.accelerations(np.zeros(3), deflection, np.zeros(4), np.array(TORQUE))[1]
    yield Value("modal accelerations there", np.max(np.abs(bending)))
    yield from _energy()
    start = np.zeros(15)
    start[0] = 1.0
    run = open_loop(model.BODY, start, TORQUE, 20.0)
    for t in (10.0, 20.0):
        for name in ("q_BO", "omega", "eta", "eta_rate"):
            yield Value(f"open loop, {name} at {t:g} s", run.state(name)(t))


def _energy() -> Iterator[Value]:
    still = model.flexible_body(model.COUPLING, model.FREQUENCIES, np.zeros(4))
    free, damped = (open_loop(body, VIBRATING, (0.0, 0.0, 0.0), SPAN) for body in (still, model.BODY))
    motions = [[run.state(n).values for n in ("omega", "eta", "eta_rate")] for run in (free, damped)]
    energy, lost = (model.BODY.energy(*motion) for motion in motions)
    momenta = [np.linalg.norm(model.BODY.momentum(turn, rate), axis=0) for turn, _, rate in motions]
    yield Value("energy at the start (J)", energy[0])
    yield Value("momentum at the start (N m s)", momenta[0][0])
    yield Value("energy drift in 200 s, undamped", np.max(np.abs(energy / energy[0] - 1)))
    drift = max(float(np.max(np.abs(h / h[0] - 1))) for h in momenta)
    yield Value("momentum drift in 200 s, undamped and damped", drift)
    yield Value("energy after 200 s, damped (J)", lost[-1])
    yield Value("largest gain of energy in a step, damped (J)", np.max(np.diff(lost)))


def open_loop(body: FlexibleBody, x0: Array, torque: tuple[float, ...], tf: float) -> Run:
    """Return the run under a constant torque (N m) in inertial space."""
    dynamics = model.build_model(body, 0.0)
    hold = feedforward(Reference.constant(dynamics, x0, torque))
    return ClosedLoop(dynamics, hold, dt=0.1, accuracy=1e-8).simulate(x0, tf=tf)


# --- runs of the published controller -------------------------------------------------------------------


@dataclass(frozen=True)
class PublishedDisturbance(Disturbance):
    """``amplitude * (sin t + r)`` on every axis, r uniform in (0, 1), a new one for every axis and control step."""

    amplitude: float = model.DISTURBANCE

    def parameters(self, size: int, unit: str) -> Defaults:
        return {"amplitude": (read_block_scalar(self.amplitude, f"the amplitude of '{self.name}'"), unit)}

    def noise_size(self, size: int) -> int:
        return size

    def initial_memory(self, signal: Any, p: Parameters, tick: StepContext) -> Any:
        return ca.SX.zeros(signal.shape[0])

    def update(self, tick: StepContext, state: Any, p: Parameters, noise: Any) -> Any:
        # the distribution function of a normal number is uniform
        return 0.5 * (1 + ca.erf(noise / np.sqrt(2.0)))

    def value(self, t: Any, x: Any, state: Any, p: Parameters) -> Any:
        return p["amplitude"] * (ca.sin(t) + state)


def fly(
    gains: control.QuasiSlidingMode,
    *,
    dt: float = 0.025,
    tf: float = SPAN,
    disturbances: tuple[Disturbance, ...] = (),
    body: FlexibleBody = model.BODY,
    believed: FlexibleBody | None = None,
    x0: Array | None = None,
) -> Run:
    """Return the run of the publication's manoeuvre; the controller assumes another body, if one is given."""
    dynamics = model.build_model(body)
    controller = control.quasi_sliding_mode(dynamics, model.target(dynamics), gains, body=believed or body)
    start = model.initial_state(dynamics) if x0 is None else x0
    return simulated(control.loop(dynamics, controller, dt=dt, disturbances=disturbances), start, tf)


def simulated(closed: ClosedLoop, x0: Array, tf: float) -> Run:
    """Return the run of a loop; raise `GncOptError` if it is not accurate or not finite."""
    run = closed.simulate(x0, tf=tf)
    if not run.outcome.ok:
        raise go.GncOptError(f"the run of '{closed.controller.name}' is {run.outcome}: give more substeps.")
    return run


RUNS: dict[str, tuple[control.QuasiSlidingMode, float]] = {
    # the last ripple of this one reaches 0.00996 where 0.01 counts: commands held for 0.025 s lift it above
    "U": (control.UNIT, 0.01),
    "U robust": (control.UNIT_ROBUST, 0.025),
    "J": (control.INERTIAL, 0.025),
    "J robust": (control.INERTIAL_ROBUST, 0.025),
    "J k=0.01": (replace(control.INERTIAL, k=0.01), 0.05),
    "J k=0.02": (replace(control.INERTIAL, k=0.02), 0.05),
    "J tanh": (control.INERTIAL, 0.1),
    "J sign": (replace(control.INERTIAL, switching=True), 0.1),
    "printed sign": (replace(control.INERTIAL, printed_sign=True), 0.1),
}
"""Gains and control step (s) by name."""


@cache
def standard(name: str) -> Run:
    """Return one of `RUNS`."""
    gains, dt = RUNS[name]
    return fly(gains, dt=dt)


@cache
def disturbed(name: str) -> Run:
    """Return the run of "U" or "J" with the publication's disturbance."""
    pushes = (PublishedDisturbance("T_d", on="torque"),)
    return fly(RUNS[name][0], dt=DISTURBED_STEP, tf=240.0, disturbances=pushes)


def attitude_error(run: Run) -> Array:
    """Return the angle (n_times,) to the target, rad."""
    return np.asarray(quaternion_angle(run.state("q_BO").values, np.array([[1.0], [0.0], [0.0], [0.0]])))


def largest_component(run: Run) -> Array:
    """Return max |q_i| of the vector part (n_times,), the publication's measure of settling."""
    return np.asarray(np.max(np.abs(run.state("q_BO").values[1:]), axis=0))


def settling(run: Run, band: float) -> float:
    """Return the last time (s) at which `largest_component` is above the band; infinite if it is so at the end."""
    return last_beyond(run.times, largest_component(run), band)


def surface(run: Run, c: float) -> Array:
    """Return S (3, n_times), rad/s, of the true attitude and rate against the target, at slope c (1/s)."""
    q, omega = run.state("q_BO").values, run.state("omega").values
    frame = np.stack([-model.ORBITAL_RATE * quaternion_to_dcm(column)[:, 1] for column in q.T], axis=1)
    sign = np.where(q[0] < 0, -1.0, 1.0)
    v, relative = sign * q[1:], omega - frame
    return -(np.abs(q[0]) * relative + np.cross(v, relative, axis=0)) - 2 * c * v


def modal_energy(run: Run) -> Array:
    """Return the modal energy (n_times,), J."""
    return np.asarray(model.BODY.modal_energy(run.state("eta").values, run.state("eta_rate").values))


def variation(run: Run) -> float:
    """Return the total variation of the applied torque, summed over the axes, N m."""
    return float(np.sum(np.abs(np.diff(run.control("torque").values, axis=1))))


def measure(run: Run) -> SimpleNamespace:
    """Return what the publication's Tables 6 and 7 have of a run; torques in N m, rates in rad/s, times in s."""
    u, omega, eta = run.control("torque").values, run.state("omega").values, run.state("eta").values
    first = np.sign(u[:, :1])
    return SimpleNamespace(
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


# --- values of the publication --------------------------------------------------------------------------

_MEASURES = (
    "peak |u_i| (N m)",
    "peak |omega_i| (rad/s)",
    "peak |omega| (rad/s)",
    "modal range (kg^.5 m)",
    "last max|q_i| > 0.01 (s)",
    "last max|q_i| > 0.001 (s)",
    "effort (N m s)",
    "integral of the angle (rad s)",
    "braking torque (N m)",
)


def _configurations() -> Iterator[Value]:
    titles = {"U": "U, k = 0", "U robust": "U, k = 0.07", "J": "J, k = 0", "J robust": "J, k = 0.05"}
    for run, title in titles.items():
        for name, value in zip(_MEASURES, vars(measure(standard(run))).values(), strict=True):
            yield Value(f"{title}: {name}", value)


def _data() -> Iterator[Value]:
    yield Value("data: rate limit (rad/s)", np.radians(20.0))
    yield Value("data: initial rates (rad/s)", (0.0, 0.0, 0.0))
    yield Value("data: initial quaternion, vector part", model.INITIAL_ATTITUDE[1:])
    yield Value("sign of eps tanh S and k S in equations 34, 35, 41, 42", 1.0)


def _texts() -> Iterator[Value]:
    inertial, robust = measure(standard("J")), standard("J robust")
    yield Value("J, k = 0: peak |omega| (rad/s), printed as peak |omega_i|", inertial.rate_norm)
    yield Value("U, k = 0: peak |omega_i| (rad/s), in the text", measure(standard("U")).rate)
    yield Value("J, k = 0: peak |omega| (rad/s), in the text", inertial.rate_norm)
    late = last_beyond(robust.times, np.max(np.abs(surface(robust, control.INERTIAL_ROBUST.c)), axis=0), 1e-4)
    quantity = "RQSMC, J, k = 0.05: last time beyond 1e-4 rad/s of the surface (s)"
    yield Value(quantity, late, late <= 80.0)
    yield Value("J: effort of k = 0.05 / k = 0", measure(robust).effort / inertial.effort)


def _gain() -> Iterator[Value]:
    runs = [measure(standard(name)) for name in ("J", "J k=0.01", "J k=0.02", "J robust")]
    title = "J, k = 0, .01, .02, .05:"
    yield Value(f"{title} peak torque (N m)", [m.torque for m in runs])
    yield Value(f"{title} modal maximum (kg^.5 m)", [m.modes[1] for m in runs])
    for attribute, name, sign in (
        ("rate_norm", "peak |omega| (rad/s)", 1),
        ("effort", "effort (N m s)", 1),
        ("agility", "integral of the angle (rad s)", -1),
        ("settling", "settling to 0.01 (s)", -1),
    ):
        found = np.array([getattr(m, attribute) for m in runs])
        yield Value(f"{title} {name}", found)
        yield Value(f"{title} {name}", found, bool(np.all(sign * np.diff(found) > 0)))


def _chattering() -> Iterator[Value]:
    smooth, switching = standard("J tanh"), standard("J sign")
    yield Value("tanh, held 0.1 s: total variation of the torque (N m)", variation(smooth))
    yield Value("sign, held 0.1 s: total variation (N m)", variation(switching))
    yield Value("sign, held 0.1 s: effort (N m s)", np.sum(switching.effort))
    yield Value("sign, held 0.1 s: modal range (kg^.5 m)", measure(switching).modes)
    yield Value("chattering, sign to tanh", variation(switching) / variation(smooth))


def disturbance_change(name: str, keys: tuple[str, ...]) -> float:
    """Return the largest relative change of some measures of "U" or "J" by the publication's disturbance."""
    quiet, found = measure(fly(RUNS[name][0], dt=DISTURBED_STEP)), measure(disturbed(name))
    return max(float(np.max(np.abs(getattr(found, key) / getattr(quiet, key) - 1))) for key in keys)


def _disturbances() -> Iterator[Value]:
    # the last ripple of U grazes the band of settling: the slightest push decides, see `RUNS`
    keys = ("torque", "rate", "rate_norm", "modes")
    for name, measured in (("U", keys), ("J", (*keys, "settling"))):
        quantity = f"{name}, k = 0, with disturbance: largest change of " + ", ".join(measured)
        yield Value(quantity, disturbance_change(name, measured))
    late = disturbed("J").times >= SPAN
    steady = float(np.max(largest_component(disturbed("J"))[late]))
    yield Value("J, k = 0, with disturbance: |q_i| after 200 s", steady, steady < 2e-4)
    push = (SinusoidalDisturbance("push", 0.03, 0.2, on="torque"),)
    for gains in (control.INERTIAL, control.INERTIAL_ROBUST):
        run = fly(gains, tf=240.0, dt=DISTURBED_STEP, disturbances=push)
        steady = float(np.max(largest_component(run)[run.times > 140.0]))
        yield Value(f"J, k = {gains.k:g}, 0.03 sin(0.2 t) N m: steady |q_i|", steady)


def _printed_sign() -> Iterator[Value]:
    run = standard("printed sign")
    late = np.min(np.degrees(attitude_error(run))[run.times > 150])
    yield Value("printed sign: least error after 150 s (deg)", late)
    dynamics, half = model.build_model(), np.radians(5.7) / 2
    near = np.zeros(dynamics.states.size)
    near[:2] = np.cos(half), np.sin(half)
    near[5] = -float(dynamics.parameter_values[0])
    gains = [replace(control.INERTIAL, printed_sign=sign) for sign in (True, False)]
    wrong, right = (np.degrees(attitude_error(fly(k, dt=0.1, tf=100.0, x0=near))) for k in gains)
    yield Value("printed sign: 5.7 deg grow in 100 s to (deg)", np.max(wrong))
    yield Value("corrected sign: 5.7 deg after 100 s (deg)", right[-1])


def _sensitivity() -> Iterator[Value]:
    """Moments of the true hub 20 % off, which the effort follows; a rigid body; modes as published before rounding."""
    nominal = measure(standard("J robust"))
    for factor in (0.8, 1.2):
        hub, gains = replace(model.BODY, inertia=factor * model.BODY.inertia), control.INERTIAL_ROBUST
        found = measure(fly(gains, body=hub, believed=model.BODY, dt=DISTURBED_STEP, tf=100.0))
        what = f"RQSMC, J, k = 0.05, moments {factor:g} times those believed:"
        ratio = found.effort / nominal.effort
        yield Value(f"{what} settling to 0.01 moves by (s)", abs(found.settling - nominal.settling))
        between = min(1.0, factor) < ratio < max(1.0, factor)
        yield Value(f"{what} effort over the nominal one (1)", ratio, between)
    still = model.flexible_body(np.zeros((3, 4)), model.FREQUENCIES, model.DAMPING)
    rigid, unit, inertial = (
        measure(fly(gains, body=body, tf=100.0))
        for gains, body in ((control.INERTIAL, still), (control.UNIT, FULL), (control.INERTIAL, FULL))
    )
    yield Value("J, rigid (C = 0): braking torque (N m)", rigid.braking)
    yield Value("U, full frequencies: modal range (kg^.5 m)", unit.modes)
    yield Value("J, full frequencies: modal range (kg^.5 m)", inertial.modes)
    yield Value("J, full frequencies: braking torque about z (N m)", inertial.braking[2])


# --- the optima, and their tracking ---------------------------------------------------------------------


def _verdict(title: str, solution: go.Solution) -> Value:
    verdict = go.verify(solution)
    worst = ", ".join(f"{c.name} {c.value:.1e}" for c in verdict.failed)
    passed = len(verdict.conditions) - len(verdict.failed)
    return Value(f"{title}: conditions of the verdict that hold", passed, verdict.ok, worst)


def _least_time() -> Iterator[Value]:
    fast, prompt, inertial = optimal.solved("fast"), optimal.solved("prompt"), measure(standard("J"))
    t_f = fast.objective
    yield Value("least time, modes at rest (s)", t_f)
    yield Value("switches", sum(arc.start > 0 for arc in fast.structure))
    yield Value("least time: modal energy at the end (J)", planned_energy(fast)[1][-1])
    yield _verdict("least time", fast)
    yield Value("least time / printed settling of RQSMC, 100 s", t_f / 100.0)
    yield Value("least time / settling to 0.01 of J, k = 0", t_f / inertial.settling)
    yield Value("least time / settling to 0.001 of J, k = 0", t_f / inertial.settling_fine)
    yield Value("least time / eigenaxis turn of the rigid body", t_f / optimal.eigenaxis_time())
    title = f"least time and effort with {100 * optimal.RESERVED:.0f} % of the torque"
    yield Value(f"{title}: t_f + {optimal.PRICE:g} integral of |T/T_max|^2 (s)", prompt.objective)
    yield Value(f"{title}: duration (s)", prompt.phase().final_time)
    yield _verdict(title, prompt)


def _least_vibration() -> Iterator[Value]:
    gentle, inertial, unit = optimal.solved("gentle"), standard("J"), standard("U")
    t, energy = planned_energy(gentle)
    total = np.trapezoid(energy, t)
    theirs, others = modal_energy(inertial), modal_energy(unit)
    yield Value(f"least vibration in {optimal.DURATION:g} s: modal energy at the end (J)", energy[-1])
    yield _verdict("least vibration", gentle)
    yield Value("integral of the modal energy / J, k = 0", total / np.trapezoid(theirs, inertial.times))
    yield Value("integral of the modal energy / U, k = 0", total / np.trapezoid(others, unit.times))
    yield Value("peak modal energy / J, k = 0", np.max(energy) / np.max(theirs))
    torque = gentle.phase().control("torque")(t)
    effort = float(np.trapezoid(np.sum(np.abs(torque), axis=0), t))
    yield Value("effort (N m s)", effort, note=f"{effort / 25.26:.2f} of the 25.26 printed for RQSMC")


def planned_energy(solution: go.Solution) -> tuple[Array, Array]:
    """Return times (s) and the modal energy (J) of a plan."""
    leg = solution.phase()
    t = np.linspace(leg.initial_time, leg.final_time, 6001)
    eta, eta_rate = (np.asarray(leg.state(name)(t)) for name in ("eta", "eta_rate"))
    return t, np.asarray(model.BODY.modal_energy(eta, eta_rate))


TRACKED = {
    ("fast", "TVLQR"): "least time, no reserve, TVLQR",
    ("prompt", "TVLQR"): "least time and effort, reserve, TVLQR",
    ("prompt", "RQSMC"): "least time and effort, reserve, RQSMC",
    ("prompt", "open loop"): "least time and effort, reserve, open loop",
    ("gentle", "TVLQR"): "least vibration, TVLQR",
    ("gentle", "RQSMC"): "least vibration, RQSMC",
    ("gentle", "open loop"): "least vibration, open loop",
}
"""Titles of the tracked plans, by plan and controller."""
AFTER = 20.0
"""How long a plan's end is held, s."""


@cache
def tracked(name: str, controller: str) -> Run:
    """Return the run along a plan under "TVLQR", "RQSMC" or "open loop", with `mean_disturbance`."""
    reference = go.Reference(optimal.solved(name))
    dynamics = reference.model
    law: Controller = feedforward(reference)
    if controller == "TVLQR":
        law = control.tvlqr(reference)
    elif controller == "RQSMC":
        law = control.quasi_sliding_mode(dynamics, reference, control.INERTIAL_ROBUST)
    closed = control.loop(dynamics, law, dt=0.05, disturbances=control.mean_disturbance())
    return simulated(closed, model.initial_state(dynamics), reference.final_time + AFTER)


def ending(name: str, controller: str) -> tuple[float, float, float]:
    """Return the errors at the end of a plan and 20 s later (deg), and the modal energy then (J), of a tracked run."""
    run, t_f = tracked(name, controller), optimal.solved(name).phase().final_time
    at_end, later = (int(np.argmin(np.abs(run.times - t))) for t in (t_f, t_f + AFTER))
    angle = np.degrees(attitude_error(run))
    return float(angle[at_end]), float(angle[later]), float(modal_energy(run)[later])


def _tracking() -> Iterator[Value]:
    for case, title in TRACKED.items():
        what = f"{title}, disturbed: errors at t_f and 20 s later (deg), modal energy then (J)"
        yield Value(what, ending(*case))
    what = "settling to 0.001 tracked, least time and effort / J, k = 0, both disturbed"
    yield Value(what, settling(tracked("prompt", "TVLQR"), 0.001) / settling(disturbed("J"), 0.001))


# --- the optima beside the published controller, at equal torque and at equal effort ----------------------

FLOWN = {"least time and effort": "at equal torque", "least vibration": "at equal effort"}
MEASURES = ("last max|q_i| > 0.001 (s)", "effort (N m s)", "angle after 120 s (deg)")
LIMIT, SHARE = 0.3, 0.9
"""Torque on every axis (N m) that configuration J asks for at most, for all; share of it that the plans use."""
EQUAL_EFFORT_DURATION = 58.0
"""Of the slew of least vibration that spends as much as the published controller, s."""
TRUE = FlexibleBody(
    np.asarray(model.INERTIA) * (1.03, 0.97, 1.02),
    np.asarray(model.COUPLING),
    1.02 * np.asarray(model.FREQUENCIES),
    np.asarray(model.DAMPING),
)
"""The plant: its hub has other moments, its modes are stiffer than assumed."""
ATTITUDE_NOISE, RATE_NOISE = 0.002, 0.001
"""1 sigma per axis and measurement, deg and deg/s."""
FLIGHT_SPAN, FLIGHT_STEP = 120.0, 0.05
"""Of a flight and of its control, s."""
VIBRATION_TIME = 60.0
"""When the vibration is measured, s: both plans are over."""


@cache
def plan(name: str) -> go.Solution:
    """Return the plan of `FLOWN`."""
    if name == "least vibration":
        # its arcs on the limit are many and short: the mesh finds them in less than half the time of their structure
        problem = optimal.build_gentle(EQUAL_EFFORT_DURATION, limit=SHARE * LIMIT)
        return go.solve(problem, mesh="40x4", tol=1e-8, structure="none")
    return go.solve(optimal.build_prompt(SHARE * LIMIT), mesh=optimal.MESH, tol=1e-8)


def closed(name: str) -> ClosedLoop:
    """Return the loop of the "published" controller, or of a plan, which RQSMC follows."""
    dynamics = model.build_model()
    if name == "published":
        controller = control.quasi_sliding_mode(dynamics, model.target(dynamics), control.INERTIAL)
    else:
        controller = control.quasi_sliding_mode(dynamics, go.Reference(plan(name)), control.INERTIAL_ROBUST)
    return ClosedLoop(
        model.build_model(TRUE),
        controller,
        actuators=[Saturation("limit", -LIMIT, LIMIT)],
        sensors=[
            Noise("star tracker", np.full(3, np.radians(ATTITUDE_NOISE)), small_turn, on="q_BO"),
            Noise("gyro", float(np.radians(RATE_NOISE)), on="omega"),
        ],
        disturbances=control.mean_disturbance(),
        dt=FLIGHT_STEP,
        accuracy=1e-7,
        substeps=2,
    )


@cache
def flight(name: str) -> Run:
    """Return the run of `closed`."""
    return closed(name).simulate(model.initial_state(model.build_model()), tf=FLIGHT_SPAN, seed=1)


def measures(run: Run) -> FlightMeasures:
    """Return the measures of a run."""
    off = float(np.degrees(attitude_error(run)[-1]))
    return FlightMeasures(settling(run, 1e-3), float(np.sum(run.effort)), off)


def vibration(run: Run) -> float:
    """Return the modal energy `VIBRATION_TIME` s after the start, J."""
    k = round(VIBRATION_TIME / FLIGHT_STEP)
    eta, eta_rate = (run.state(name).values[:, k] for name in ("eta", "eta_rate"))
    return float(np.squeeze(TRUE.modal_energy(eta, eta_rate)))


def _flown(name: str) -> Iterator[Value]:
    law, run, what = flight("published"), flight(name), f"{name}, {FLOWN[name]}"
    yield from flight_values(what, MEASURES, measures(run), measures(law))
    energies = [vibration(one) for one in (run, law)]
    yield Value(f"{what}, flown: modal energy after 60 s (J); published law", energies)
    yield verdict_value(f"{what}: verdict of the plan", go.verify(plan(name)))
    yield outcome_value(what, run)
    yield Value(f"{what}, flown: largest torque (N m)", np.max(np.abs(run.applied)))
