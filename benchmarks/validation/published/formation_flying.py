"""Formation flying with oblateness: the publication's two controllers, and the optima beside them.

Imani and Bahrami, "Robust control of spacecraft formation flying using optimal sliding mode" (in Persian), prints four
numbers. The independent ones were calculated (LSODA at 1e-11 and RK4 agree) for that phase and initial rate, which are
not printed, with which the four come out.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
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
)
from gnc_opt.array_types import Array
from gnc_opt.control import Controller
from gnc_opt.simulation import ClosedLoop, Noise, Run, Saturation
from gnc_opt.spacecraft import inertial_from_relative, j2_gravity, point_mass_gravity, relative_from_inertial
from problems.formation_flying import control, model, optimal

LAWS = {
    "SMC": control.sliding_mode,
    "optimal SMC": control.optimal_sliding_mode,
    "LQ only": control.linear_quadratic,
}
STEPS, FEW_STEPS, TRUTH_STEPS, FLOWN_STEPS = 24000, 3000, 12000, 6000
"""Control steps in a period: of the nominal runs (0.25 s), of sweeps over the phase (2 s), of runs in inertial space,
which cost four times the others (0.5 s), and of those beside the optima. The publication's controllers are continuous;
held for a step h, the sliding mode's Delta-V grows by 2.2e-3 h."""
COURSE = np.array([500.0, 1000.0, 2000.0, 3000.0, 4000.0, 5000.0, 6000.0])
"""Times at which the errors are compared, s."""


def values() -> Iterator[Value]:
    """Yield every computed quantity of the table."""
    yield from _data()
    yield from _table()
    yield from _course()
    yield from _switching()
    yield from _inertial_truth()
    yield from _sweep()
    yield from _claims()
    yield from _optima()
    yield from _flown()


# --- runs of the published controllers ------------------------------------------------------------------


def closed_loop(controller: Controller, plant: go.Model, steps: int = STEPS) -> ClosedLoop:
    """Return the loop; the plant is a thousand times slower than a control step: one integration step will do."""
    return ClosedLoop(plant, controller, dt=model.PERIOD / steps, substeps=1)


@cache
def run(law: str, oblate: bool = True, steps: int = STEPS) -> Run:
    """Return one period of a controller."""
    plant = model.build_model() if oblate else model.build_model().with_parameters(J2=0.0)
    return closed_loop(LAWS[law](model.PERIOD / steps), plant, steps).simulate(model.START, tf=model.PERIOD)


def inertial_model() -> go.Model:
    """Return leader and follower as two oblate orbits, seen from the leader's true radial frame.

    States: ``r``, ``v`` as in `build_model`, measured in the leader's true frame; ``leader_r`` (m), ``leader_v`` (m/s),
    inertial. Control: ``a``, along the axes of that frame.
    """
    dynamics = go.Model("formation flying, two inertial orbits")
    r, v = dynamics.state("r", 3, unit="m"), dynamics.state("v", 3, unit="m/s")
    leader_r = dynamics.state("leader_r", 3, unit="m")
    leader_v = dynamics.state("leader_v", 3, unit="m/s")
    a = dynamics.control("a", 3, unit="m/s^2")
    j2 = dynamics.parameter("J2", model.J2)

    def gravity(place: Any) -> Any:
        return point_mass_gravity(place, model.MU) + j2_gravity(place, model.MU, j2, model.EARTH_RADIUS)

    orbits = [ca.SX.sym(name, 3) for name in ("leader_r", "leader_v", "follower_r", "follower_v")]
    _, rho_rate = relative_from_inertial(*orbits, gravity(orbits[0]))
    rates = ca.vertcat(orbits[1], gravity(orbits[0]), orbits[3], gravity(orbits[2]))
    acceleration = ca.jtimes(rho_rate, ca.vertcat(*orbits), rates)
    seen = ca.Function("seen", [*orbits, j2], [acceleration])
    follower = inertial_from_relative(leader_r, leader_v, r, v, gravity(leader_r))
    turning = seen(leader_r, leader_v, *follower, j2) + a
    dynamics.ode({r: v, v: turning, leader_r: leader_v, leader_v: gravity(leader_r)})
    return dynamics


def leader_orbit(inclination: float = 0.0) -> tuple[Array, Array]:
    """Return the leader's inertial position (m) and velocity (m/s) at its node; inclination in rad."""
    speed = model.RATE * model.LEADER_RADIUS
    heading = np.array([0.0, np.cos(inclination), np.sin(inclination)])
    return np.array([model.LEADER_RADIUS, 0.0, 0.0]), speed * heading


def inertial_run(law: str, oblate: bool) -> Run:
    """Return one period of a controller with leader and follower as two inertial orbits."""
    plant = inertial_model() if oblate else inertial_model().with_parameters(J2=0.0)
    loop = closed_loop(LAWS[law](model.PERIOD / TRUTH_STEPS), plant, TRUTH_STEPS)
    return loop.simulate(np.concatenate([model.START, *leader_orbit()]), tf=model.PERIOD)


@cache
def phase_sweep(law: str) -> tuple[Array, Array]:
    """Return |e(T)| (m) and Delta-V (m/s) for 120 phases of the circle.

    Nothing but the circle depends on time: another phase is a later start.
    """
    loop = closed_loop(LAWS[law](model.PERIOD / FEW_STEPS), model.build_model(), FEW_STEPS)
    starts = np.mod(np.radians(np.arange(0, 360, 3)) - 0.5 * np.pi, 2 * np.pi) / (2 * np.pi) * model.PERIOD
    runs = [loop.simulate(model.START, t0=t0, tf=t0 + model.PERIOD) for t0 in starts.tolist()]
    return np.array([r.miss("r") for r in runs]), np.array([control.delta_v(r) for r in runs])


# --- values of the publication --------------------------------------------------------------------------


def _data() -> Iterator[Value]:
    place, _, _ = model.circle(np.array([0.0]))
    yield Value("data: first place of the follower (m)", model.START[:3])
    yield Value("data: radius of the formation (m)", np.linalg.norm(place))
    yield Value("data: z over x in the formation's plane", place[2] / place[0])
    weights = (control.WEIGHTS["r"], control.WEIGHTS["v"], control.CONTROL_WEIGHT)
    yield Value("data: weights of optimal SMC: position, rate, thrust", weights)


def _outcome(name: str, found: Run) -> Iterator[Value]:
    yield Value(f"{name}: |e(T)| (m)", found.miss("r"))
    yield Value(f"{name}: Delta-V (m/s)", control.delta_v(found))


def _table() -> Iterator[Value]:
    yield from _outcome("SMC", run("SMC"))
    yield from _outcome("optimal SMC", run("optimal SMC"))
    yield from _outcome("SMC, no J2", run("SMC", False))
    yield from _outcome("optimal SMC, no J2", run("optimal SMC", False))
    yield from _outcome("LQ only, J2", run("LQ only"))
    yield from _outcome("LQ only, no J2", run("LQ only", False))


def _course() -> Iterator[Value]:
    both = {law: run(law) for law in ("SMC", "optimal SMC")}
    smc, osmc, gain = *both.values(), control.regulator()
    yield Value("LQ gain (1/s^2, 1/s)", gain[np.abs(gain) > 1e-12])
    for what, measured in (
        ("|e| at 500, 1000 ... 6000 s (m)", lambda flown: np.linalg.norm(flown.error("r")(COURSE), axis=0)),
        ("e(T) (m)", lambda flown: flown.error("r").values[:, -1]),
        ("first thrust (m/s^2)", lambda flown: flown.command("a").values[:, 0]),
        ("last time |e| > 10 m (s)", lambda flown: flown.settling_time("r", 10.0)),
    ):
        yield from (Value(f"{law}: {what}", measured(flown)) for law, flown in both.items())
    yield Value("optimal SMC: last time |e| > 1 m (s)", osmc.settling_time("r", 1.0))
    steady = np.max(np.abs(model.differential_oblateness(osmc.states[:3])), axis=1)
    yield Value("largest disturbance per axis (m/s^2)", steady)
    yield Value("the publication's bounds 1e-4 over the largest disturbance", 1e-4 / np.max(steady))
    peaks = [np.max(np.abs(flown.commands)) for flown in (smc, osmc)]
    yield Value("peak thrust, SMC / optimal SMC", peaks[0] / peaks[1])


def _switching() -> Iterator[Value]:
    """Ideal switching, sgn() instead of sat(), held for 1 s."""
    steps = round(model.PERIOD)
    laws = [control.optimal_sliding_mode(model.PERIOD / steps, layer=layer) for layer in (None, control.PHI)]
    ideal, smooth = (
        closed_loop(law, model.build_model(), steps).simulate(model.START, tf=model.PERIOD) for law in laws
    )
    yield from _outcome("optimal SMC, sgn, 1 s hold", ideal)
    yield Value("optimal SMC, sgn, 1 s hold: TV per axis (m/s^2)", ideal.total_variation("a"))
    ratio = np.sum(ideal.total_variation("a")) / np.sum(smooth.total_variation("a"))
    yield Value("chattering, sgn over sat", ratio)


def _inertial_truth() -> Iterator[Value]:
    """What the Keplerian leader of the publication leaves out."""
    yield from _outcome("SMC, inertial truth", inertial_run("SMC", True))
    yield from _outcome("optimal SMC, inertial truth", inertial_run("optimal SMC", True))
    relative = run("optimal SMC", False, TRUTH_STEPS).states
    same = np.max(np.abs(inertial_run("optimal SMC", False).states[:6] - relative))
    yield Value("inertial truth without J2 against relative motion (m, m/s)", same)


def _sweep() -> Iterator[Value]:
    for law in ("SMC", "optimal SMC"):
        for what, found in zip(("|e(T)| (m)", "Delta-V (m/s)"), phase_sweep(law), strict=True):
            three = (np.min(found), np.median(found), np.max(found))
            yield Value(f"{law}, 120 phases: {what}, least, median, largest", three)
    pairs = zip(phase_sweep("optimal SMC"), phase_sweep("SMC"), strict=True)
    better = all(bool(np.all(osmc < plain)) for osmc, plain in pairs)
    yield Value("optimal SMC better in both, of 120 phases", float(better), better)


def _claims() -> Iterator[Value]:
    smc, osmc = run("SMC"), run("optimal SMC")
    retuned = closed_loop(control.sliding_mode(model.PERIOD / STEPS, slope=1.6e-3), model.build_model())
    yield Value("|e(T)|, SMC over optimal SMC", smc.miss("r") / osmc.miss("r"))
    yield Value("Delta-V saved by optimal SMC", 1 - control.delta_v(osmc) / control.delta_v(smc))
    yield from _outcome("SMC with lambda = 1.6e-3", retuned.simulate(model.START, tf=model.PERIOD))


# --- the optima, undisturbed and in closed loop ----------------------------------------------------------


def _optima() -> Iterator[Value]:
    law = run("optimal SMC")
    for name, of, published in (
        ("least Delta-V", "in one period (m/s)", control.delta_v(law)),
        ("least time", "to the formation (s)", law.settling_time("r", 1.0)),
    ):
        best = optimal.plan(name)
        failed = ", ".join(c.name for c in best.verdict.failed)
        yield Value(f"{name} {of}", best.solution.objective)
        yield Value(f"{name}: conditions that fail", len(best.verdict.failed), not failed, failed)
        yield Value(f"{name} / optimal SMC, both undisturbed", best.solution.objective / published)


MEASURES = ("last time beyond 1 m of the circle's point (s)", "Delta-V in one period (m/s)", "|e(T)| (m)")
POSITION_NOISE, VELOCITY_NOISE = 0.01, 2e-5
"""1 sigma per axis and measurement, m and m/s."""


def disturbed_loop(law: Controller, steps: int = FLOWN_STEPS, noise: float = 1.0) -> ClosedLoop:
    """Return the loop of a controller with thrusters, measurement noise (times a factor) and the oblate plant."""
    return ClosedLoop(
        model.build_model(),
        law,
        actuators=[Saturation("thrusters", -optimal.LIMIT, optimal.LIMIT)],
        sensors=[
            Noise("position", noise * POSITION_NOISE, on="r"),
            Noise("velocity", noise * VELOCITY_NOISE, on="v"),
        ],
        dt=model.PERIOD / steps,
        substeps=1,
    )


def closed(name: str, steps: int = FLOWN_STEPS) -> ClosedLoop:
    """Return the loop of the "published" optimal sliding mode, or of a plan; no controller knows the oblateness."""
    dt = model.PERIOD / steps
    if name == "published":
        return disturbed_loop(control.optimal_sliding_mode(dt), steps)
    plan = optimal.plan(name, optimal.RESERVE, False)
    return disturbed_loop(control.follow_plan(plan, dt, (-optimal.LIMIT, optimal.LIMIT)), steps)


@cache
def flight(name: str) -> Run:
    """Return the run of `closed` over a period."""
    return closed(name).simulate(model.START, tf=model.PERIOD, seed=1)


def measures(flown: Run) -> FlightMeasures:
    """Return the measures of a run of one period."""
    distance = np.linalg.norm(flown.states[:3] - model.circle(flown.times)[0], axis=0)
    return FlightMeasures(
        last_beyond(flown.times, distance, 1.0), control.delta_v(flown), float(distance[-1])
    )


def _flown() -> Iterator[Value]:
    for name in ("least Delta-V", "least time"):
        ours = flight(name)
        yield from flight_values(name, MEASURES, measures(ours), measures(flight("published")))
        yield outcome_value(name, ours)
        yield Value(f"{name}, flown: largest thrust per axis (m/s^2)", np.max(np.abs(ours.applied)))
