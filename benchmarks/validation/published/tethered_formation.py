"""Swing control of a tethered pair: the published structure, and the optima beside it.

Jia and Meng, J. Astronautics 43 (10), 1361-1367, 2022. Its own numbers are three: "within 150 s", "about 16.1 degrees",
"after about 70 s"; its equations and data are lost in the text that is available. The independent numbers were
calculated with other code, for the data and gains that are used here. All runs are on the plant with exact gravity.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

import gnc_opt as go
from benchmarks.validation.published.comparison import (
    FlightMeasures,
    Value,
    flight_values,
    last_beyond,
    outcome_value,
    verdict_value,
)
from gnc_opt.array_types import Array
from gnc_opt.control import SuperTwistingObserver
from gnc_opt.simulation import Noise, Saturation
from problems.tethered_formation import control, model, optimal, tether


def values() -> Iterator[Value]:
    """Yield every computed quantity of the table."""
    yield from _data()
    yield from _plant()
    yield from _parts()
    yield from _results()
    yield from _limits()
    yield from _observer()
    yield from _mismatches()
    yield from _first_swings()
    yield from _tuning()
    yield from _optima()
    for name in ("time", "effort"):
        yield from _flown(name)


# --- runs of the published structure --------------------------------------------------------------------


class Manoeuvre:
    """One run; pair and thrust (N) are the true ones.

    Errors of the swing theta (degrees), the height r (m), its rate (``climb``, m/s) and the place along the orbit
    (``lead``, m), thrust angle (degrees), commands of its rate (rad/s, one fewer than times), tension (N).
    """

    def __init__(
        self, run: go.Run, pair: tether.TetheredPair = model.PAIR, force: float = model.FORCE
    ) -> None:
        self.run, self.pair, self.force, self.times = run, pair, force, np.asarray(run.times)
        state = {name: run.state(name).values[0] for name in run.layouts["state"].names}
        error = {name: run.error(name).values[0] for name in ("theta", "height", "climb", "lead")}
        self.swing, self.height, self.climb = np.degrees(error["theta"]), error["height"], error["climb"]
        self.lead = error["lead"] * (1 + state["height"] / model.RADIUS)
        self.angle, self.rate = np.degrees(state["gamma"]), np.asarray(run.commands[0])
        radius, alpha_rate = model.RADIUS + state["height"], model.RATE + state["drift"] / model.RADIUS
        motion = tether.TetherMotion(radius, state["climb"], alpha_rate, state["theta"], state["theta_rate"])
        self.tension = np.asarray(pair.tension(motion, force, state["gamma"]))

    @property
    def overshoot(self) -> float:
        """Largest swing to the other side of the first, degrees."""
        return float(np.max(-np.sign(self.swing[0]) * self.swing))

    def last_beyond(self, band: float) -> float:
        """Return the last time (s) at which the swing is beyond a band (degrees); inf if it still is at the end."""
        return last_beyond(self.times, np.abs(self.swing), band)

    def late_swing(self, begin: float = 150.0) -> float:
        """Return the largest swing from ``begin`` (s) on, degrees."""
        return float(np.max(np.abs(self.swing[self.times >= begin - 1e-9])))

    def variation(self, begin: float = 0.0) -> float:
        """Return the sum of the changes of the commanded rate from ``begin`` (s) on, rad/s."""
        return float(np.sum(np.abs(np.diff(self.rate[self.times[:-1] >= begin - 1e-9]))))

    @property
    def effort(self) -> float:
        """Integral of the squared rate, rad^2/s."""
        return float(self.run.control_energy("gamma_rate")[0])

    @property
    def loss(self) -> float:
        """Speed along the orbit that deflection costs, m/s: F/m (1 - cos gamma) integrated (trapezoidal rule)."""
        lost = self.force / self.pair.mass * (1 - np.cos(np.radians(self.angle)))
        return float(np.trapezoid(lost, self.times))

    def at(self, t: float) -> Array:
        """Return swing (degrees), height (m), climb (m/s), lead (m) and gamma (degrees) at a control step's t (s)."""
        k = int(np.argmin(np.abs(self.times - t)))
        return np.array([self.swing[k], self.height[k], self.climb[k], self.lead[k], self.angle[k]])


def fly(
    reaching: control.Reaching | None = None,
    *,
    gains: control.Gains | None = None,
    unknown: control.Unknown = "observed",
    swing: float = np.radians(30.0),
    swing_rate: float = 0.0,
    pair: tether.TetheredPair = model.PAIR,
    force: float = model.FORCE,
    duration: float = model.DURATION,
    dt: float = control.STEP,
) -> Manoeuvre:
    """Fly the published structure (see `design_swing_law`) from a swing (rad, rad/s) on the exact plant.

    Controller and reference believe in `PAIR` and `FORCE`, whatever the true pair and thrust (N) are.
    """
    law = control.design_swing_law(
        model.reference(duration=duration), reaching, gains=gains, unknown=unknown, dt=dt
    )
    return fly_law(law, model.first_state(swing, swing_rate), duration, pair, force)


def fly_law(
    law: go.Controller,
    start: Array,
    duration: float,
    pair: tether.TetheredPair = model.PAIR,
    force: float = model.FORCE,
) -> Manoeuvre:
    """Fly a law on the exact plant from a state (7,), for ``duration`` (s); pair and thrust (N) are the true ones."""
    # One step of the fifth-order method per 0.1 s leaves 1e-11, see run.integration_error.
    loop = go.ClosedLoop(model.tether_model(pair, force, "exact"), law, dt=law.dt or control.STEP, substeps=1)
    return Manoeuvre(loop.simulate(start, tf=duration), pair, force)


@cache
def results() -> dict[str, Manoeuvre]:
    """Return the six manoeuvres of the results table, by name."""
    return {
        "no control": fly_law(go.feedforward(model.reference()), model.first_state(), model.DURATION),
        "MPC": fly(control.predictive()),
        "linear": fly(control.Linear(0.5)),
        "switching 0.01": fly(control.Switching(0.01)),
        "switching 0.003": fly(control.Switching(0.003)),
        "MPC, no observer": fly(control.predictive(), unknown="ignored"),
    }


# --- data, plant, reference, surface, reaching law -------------------------------------------------------


def _data() -> Iterator[Value]:
    yield Value("data: limit of the angle (rad)", model.MAX_ANGLE, np.pi / 9 == model.MAX_ANGLE)


def _plant() -> Iterator[Value]:
    """Derived data, sample values of the accelerations, drifts of what a free pair conserves."""
    here = tether.TetherMotion(model.RADIUS, 0.0, model.RATE, np.radians(30.0), 0.0)
    sample = model.PAIR.accelerations(here, model.FORCE, 0.1)
    yield Value("kappa", model.PAIR.kappa)
    yield Value("m*, kg", model.PAIR.reduced_mass)
    frequency = model.PAIR.kappa * model.FORCE / (model.PAIR.reduced_mass * model.PAIR.length)
    yield Value("swing frequency squared, 1/s^2", frequency)
    yield Value("sample r'', m/s^2", sample.r)
    yield Value("sample alpha'', rad/s^2", sample.alpha)
    yield Value("sample theta'', rad/s^2", sample.theta)
    yield Value("sample tension, N", model.PAIR.tension(here, model.FORCE, 0.1))
    for length, exact in ((100.0, True), (1000.0, True), (100.0, False)):
        energy, momentum, theta = free_drift(tether.TetheredPair(500.0, 200.0, 1.0, length), exact)
        name = f"{'exact' if exact else 'first-order'} gravity, {length:g} m"
        yield Value(f"{name}: drift of energy", energy)
        yield Value(f"{name}: drift of momentum", momentum)
        yield Value(f"{name}: swing after 6000 s, deg", theta)


def free_drift(pair: tether.TetheredPair, exact: bool) -> tuple[float, float, float]:
    """Return relative drifts of energy and momentum over 6000 s without thrust, and the last swing (degrees)."""
    law = pair.true_accelerations if exact else pair.accelerations

    def rate(_: float, y: Array) -> list[float]:
        a = law(tether.TetherMotion(y[0], y[2], y[3], y[1], y[4]), 0.0, 0.0)
        return [y[2], y[4], a.r, a.alpha, a.theta]

    start = [model.RADIUS, np.radians(60.0), 0.0, model.RATE, 1e-3]
    y = solve_ivp(rate, (0.0, 6000.0), start, "DOP853", rtol=3e-14, atol=1e-15).y
    motion = tether.TetherMotion(y[0], y[2], y[3], y[1], y[4])
    energy, momentum = pair.energy(motion), pair.angular_momentum(motion)
    drifts = [float(np.max(np.abs(v / v[0] - 1))) for v in (energy, momentum)]
    return drifts[0], drifts[1], float(np.degrees(y[1, -1]))


def _parts() -> Iterator[Value]:
    """The reference, the surface at the start, and single commands of the reaching law."""
    orbit, plan = model.Orbit.of(), model.reference()
    height, climb, lead, _ = orbit(model.DURATION)
    yield Value("reference r at 200 s - r0, m", height)
    yield Value("reference rate of r, m/s", climb)
    yield Value("reference alpha, rad", model.RATE * model.DURATION + lead / model.RADIUS)
    errors = control.surface(plan, control.Gains())
    parts = errors.pair.build_function_of_plant_and_reference(
        errors.chains[0][0], errors.chains[0][1], errors.decoupling[0]
    )
    s, rate, effect = (float(v) for v in parts(0.0, model.first_state(), [0.0], plan.x(0.0), [0.0]))
    yield Value("S(0)", s)
    yield Value("S_v(0)", rate)
    yield Value("G(0)", effect)
    yield Value("sigma(0)", s + rate)
    symbols = [ca.SX.sym(n) for n in ("s", "f", "g", "y")]
    v = ca.Function("v", symbols, [control.predictive().command(*symbols)])
    g = -0.0139923
    yield Value("v0 / sigma without limits", float(v(1e-6, 0.0, g, 0.0)) / 1e-6)
    yield Value("... infinite horizon", -control.predictive(2000).gain(g))
    yield Value("v0 at sigma = 0.18", float(v(0.18, 0.0, g, 0.0)))
    yield Value("... 0.005 from the angle's limit", float(v(0.18, 0.0, g, model.MAX_ANGLE - 0.005)))
    yield Value("... on the limit", float(v(0.18, 0.0, g, model.MAX_ANGLE)))
    for t in (0.0, 100.0, 200.0):
        h, c, _, d = orbit(t)
        yield Value(f"equilibrium swing at {t:g} s, rad", model.equilibrium(model.PAIR, model.FORCE, h, c, d))


# --- the results table ----------------------------------------------------------------------------------


def _results() -> Iterator[Value]:
    for name, m in results().items():
        yield Value(f"{name}: overshoot, deg", m.overshoot)
        yield Value(f"{name}: last time beyond 2 deg, s", m.last_beyond(2.0))
        yield Value(f"{name}: last time beyond 1 deg, s", m.last_beyond(1.0))
        yield Value(f"{name}: largest swing after 150 s, deg", m.late_swing())
        yield Value(f"{name}: largest error of r, m", np.max(np.abs(m.height)))
        yield Value(f"{name}: error of r at 200 s, m", m.height[-1])
        yield Value(f"{name}: variation of the rate, rad/s", m.variation())
        yield Value(f"{name}: ... after 150 s, rad/s", m.variation(150.0))
        yield Value(f"{name}: largest angle, deg", np.max(np.abs(m.angle)))
        yield Value(f"{name}: least tension, N", m.tension.min())
        yield Value(f"{name}: largest tension, N", m.tension.max())
    labels = ("swing, deg", "r, m", "rate of r, m/s", "r alpha, m", "gamma, deg")
    for t in (20.0, 50.0, 100.0, 150.0, 200.0):
        for label, value in zip(labels, results()["MPC"].at(t), strict=True):
            yield Value(f"MPC at {t:g} s: {label}", value)


def _limits() -> Iterator[Value]:
    """What the limits do to the published structure, and its chattering against switching."""
    runs = results()
    mpc, switching = runs["MPC"], runs["switching 0.01"]
    step = mpc.times[1] - mpc.times[0]
    sigma = np.abs(mpc.run.controller_state("sigma").values[0])
    rising = mpc.times[1:][(mpc.climb[1:] > 0) & (mpc.climb[:-1] <= 0) & (mpc.times[1:] > 50)]
    off, largest_angle = np.abs(mpc.height), float(np.max(np.abs(mpc.angle)))
    at_limit = mpc.times[np.abs(mpc.angle) >= np.degrees(model.MAX_ANGLE) * (1 - 1e-9)]
    at_rate_limit = np.sum(np.abs(mpc.rate) >= model.MAX_RATE * (1 - 1e-9))
    yield Value("MPC: time on the limit of the angle, s", at_limit.size * step)
    yield Value("MPC: last time on it, s", at_limit[-1])
    yield Value("MPC: time on the limit of the rate, s", at_rate_limit * step)
    yield Value("MPC: |sigma| < 1e-4 from, s", mpc.times[np.flatnonzero(sigma >= 1e-4)[-1]])
    yield Value("MPC: rate of r above its reference from, s", rising[0])
    excess = max(float(np.max(np.abs(m.angle))) for m in runs.values()) - np.degrees(model.MAX_ANGLE)
    yield Value("all: angle beyond 20 deg, deg", excess, excess <= 1e-10)
    overstep = max(float(np.max(np.abs(m.rate))) for m in runs.values()) - 0.1
    yield Value("all: rate beyond 0.1, rad/s", overstep, overstep <= 1e-12)
    ratio = switching.variation() / mpc.variation()
    yield Value("variation, switching / MPC", ratio, ratio > 10)
    yield Value("... after 150 s", switching.variation(150.0) / mpc.variation(150.0))
    yield Value("MPC: overshoot, deg", mpc.overshoot)
    yield Value("MPC: swing after 150 s, deg", mpc.late_swing(), mpc.late_swing() <= 1.0)
    grows = bool(10 * off[0] < np.max(off) > 2 * off[-1])
    yield Value("MPC: error of r, largest and at 200 s, m", (np.max(off), off[-1]), grows)
    decays = bool(abs(mpc.angle[-1]) < 0.01 * largest_angle)
    yield Value("MPC: thrust angle at 200 s, deg", mpc.angle[-1], decays)


# --- what the parts contribute, and the limits of the idea -----------------------------------------------


def observer_errors(m: Manoeuvre, begin: float = 0.0) -> tuple[float, float, float]:
    """Return rms Gamma, rms error of its estimate and the largest observer error from ``begin`` (s) on.

    Gamma from the model of the law on the true states.
    """
    plan = model.reference(duration=m.times[-1])
    errors = control.surface(plan, control.Gains())
    drift = errors.pair.build_function_of_plant_and_reference(errors.drift[0])
    kept, references = np.flatnonzero(m.times[:-1] >= begin - 1e-9), m.run.reference
    assert references is not None
    n, nothing = kept.size, np.zeros((1, kept.size))
    given = m.times[kept][None], m.run.states[:, kept], nothing, references[:, kept], nothing
    true = drift.map(n)(*given).full()[0]
    sigma, sigma_hat, estimate = (
        m.run.controller_state(k).values[0] for k in ("sigma", "sigma_hat", "estimate")
    )
    # what the memory holds at k + 1 was estimated at k
    off, xi = estimate[kept + 1] - true, sigma_hat[kept] - sigma[kept + 1]
    return float(np.sqrt(np.mean(true**2))), float(np.sqrt(np.mean(off**2))), float(np.max(np.abs(xi)))


def _observer() -> Iterator[Value]:
    mpc = results()["MPC"]
    for where, begin in (("", 0.0), (" after 100 s", 100.0)):
        unknown, error, _ = observer_errors(mpc, begin)
        yield Value(f"observer{where}: rms Gamma", unknown)
        yield Value(f"observer{where}: rms error", error)
    yield Value("observer after 100 s: largest xi", observer_errors(mpc, 100.0)[2])
    gentle = fly(gains=control.Gains(observer=SuperTwistingObserver(0.003, 5e-6)))
    yield Value("k7 = 0.003, k8 = 5e-6: variation after 150 s, rad/s", gentle.variation(150.0))
    yield Value("... in all, rad/s", gentle.variation())


def _mismatches() -> Iterator[Value]:
    for name, pair, force in (
        ("md + 20 %", tether.TetheredPair(500.0, 240.0, 1.0, 100.0), model.FORCE),
        ("md - 20 %", tether.TetheredPair(500.0, 160.0, 1.0, 100.0), model.FORCE),
        ("F - 10 %", model.PAIR, 0.9 * model.FORCE),
        ("mp + 20 %", tether.TetheredPair(600.0, 200.0, 1.0, 100.0), model.FORCE),
    ):
        m = fly(pair=pair, force=force)
        yield Value(f"{name}: largest swing after 150 s, deg", m.late_swing())
        yield Value(f"{name}: error along the orbit at 200 s, m", m.lead[-1])


def _first_swings() -> Iterator[Value]:
    for first in (-45.0, -30.0, 15.0, 45.0, 60.0, -60.0):
        m = fly(swing=np.radians(first))
        yield Value(f"first swing {first:g} deg: largest after 150 s, deg", m.late_swing())
        if first == 60.0:
            yield Value("... least tension, N", m.tension.min())
    rate = fly(swing=0.0, swing_rate=0.03)
    yield Value("first rate 0.03 rad/s: the same, deg", rate.late_swing())


def _tuning() -> Iterator[Value]:
    """Other gains, steps, durations and horizons."""
    flipped = fly(gains=control.Gains(k4=0.005))
    yield Value("k4 = +0.005: swing at 200 s, deg", flipped.swing[-1])
    yield Value("... rate of r against its reference, m/s", flipped.climb[-1])
    other = fly(gains=control.Gains(k1=0.30, k2=0.0015, k4=-0.022, k6=0.5))
    yield Value("other gains: overshoot, deg", other.overshoot)
    yield from _settled("... last time", other)
    yield from _settled("swing alone: last time", fly(gains=control.Gains(k4=0.0, k5=0.0)))
    fine = fly(control.predictive(40, dt=0.05), dt=0.05)
    yield Value("half the step: overshoot, deg", fine.overshoot)
    yield from _settled("... last time", fine)
    long = fly(duration=800.0)
    yield Value("800 s: error of r, m", long.height[-1])
    yield Value("... swing, deg", long.swing[-1])
    yield Value("... error along the orbit, m", long.lead[-1])
    for label, law in (
        ("Np = 5", control.predictive(5)),
        ("Np = 10", control.predictive(10)),
        ("R = 1e-5", control.predictive(effort=1e-5)),
        ("R = 1e-3", control.predictive(effort=1e-3)),
    ):
        m = fly(law)
        yield Value(f"{label}: overshoot, deg", m.overshoot)
        yield Value(f"{label}: error of r at 200 s, m", m.height[-1])


def _settled(what: str, m: Manoeuvre) -> Iterator[Value]:
    yield Value(f"{what} beyond 1 deg, s", m.last_beyond(1.0))
    yield Value("... error of r at 200 s, m", m.height[-1])


# --- the optima, undisturbed and in closed loop ----------------------------------------------------------


def _optima() -> Iterator[Value]:
    for title in ("time, s", "planned, s", "effort, rad^2/s"):
        name = title.partition(",")[0]
        best = optimal.optimum(name)
        yield Value(f"least {title}", best.solution.objective)
        yield verdict_value(f"least {name}: verdict", best.verdict)
    published, fast, slow = results()["MPC"], optimal.optimum("time"), optimal.optimum("effort")
    settled = published.last_beyond(1.0)
    yield Value("time, published to 1 deg only / least", settled / fast.leg.final_time)
    yield Value("effort in 200 s, published / least", published.effort / slow.effort)
    yield Value("speed lost along the orbit, published / least effort", published.loss / slow.loss)


MEASURES = (
    "last time beyond 1 deg (s)",
    "integral of the squared rate (rad^2/s)",
    "largest swing in the last 20 s (deg)",
)
TRUE = tether.TetheredPair(model.PAIR.leader_mass, 204.0, model.PAIR.tether_mass, model.PAIR.length)
"""The pair that is flown; controllers and plans assume a follower of 200 kg."""
TRUE_SWING = 31.5
"""First swing, degrees; the plans assume 30."""
SWING_NOISE, SWING_RATE_NOISE, POSITION_NOISE, VELOCITY_NOISE = 0.01, 0.003, 0.05, 1e-3
"""1 sigma of every measurement: deg, deg/s, m and m/s."""


def closed(name: str, pair: tether.TetheredPair = TRUE, noise: float = 1.0) -> go.ClosedLoop:
    """Return the loop of the "published" structure, or of a plan, "time" (with a reserve) or "effort".

    ``pair`` is the true one, ``noise`` a factor of all measurement noise.
    """
    if name == "published":
        controller = control.design_swing_law(model.reference(), control.predictive())
    else:
        plan = optimal.optimum("planned" if name == "time" else name).solution
        # the model's Gamma contains the plan's own steering, which no observer has to find then
        controller = control.design_swing_law(control.held(plan), unknown="modelled")
    turn = noise * np.radians([SWING_NOISE, SWING_RATE_NOISE])
    return go.ClosedLoop(
        model.tether_model(pair, model.FORCE, "exact"),
        controller,
        actuators=[Saturation("drive", -model.MAX_RATE, model.MAX_RATE)],
        sensors=[
            Noise("swing", float(turn[0]), on="theta"),
            Noise("swing rate", float(turn[1]), on="theta_rate"),
            Noise("height", noise * POSITION_NOISE, on="height"),
            Noise("lead", noise * POSITION_NOISE, on="lead"),
            Noise("climb", noise * VELOCITY_NOISE, on="climb"),
            Noise("drift", noise * VELOCITY_NOISE, on="drift"),
        ],
        dt=controller.dt or control.STEP,
        substeps=1,
    )


@cache
def flight(
    name: str, pair: tether.TetheredPair = TRUE, swing: float = TRUE_SWING, noise: float = 1.0
) -> Manoeuvre:
    """Return the run of `closed` from a first swing (degrees)."""
    start = model.first_state(float(np.radians(swing)))
    return Manoeuvre(closed(name, pair, noise).simulate(start, tf=model.DURATION, seed=1), pair)


def measures(m: Manoeuvre) -> FlightMeasures:
    """Return the measures of a run, against the first reference."""
    swing = np.abs(np.degrees(m.run.state("theta").values[0]))
    settled = last_beyond(m.times, swing, 1.0)
    return FlightMeasures(settled, m.effort, float(np.max(swing[m.times >= model.DURATION - 20.0 - 1e-9])))


def _flown(name: str) -> Iterator[Value]:
    law, m, what = flight("published"), flight(name), f"least {name}"
    yield from flight_values(what, MEASURES, measures(m), measures(law))
    heights = [float((f.run.state("height").values[0] - model.Orbit.of()(f.times)[0])[-1]) for f in (m, law)]
    yield Value(f"{what}, flown: error of r at 200 s (m); published law", heights)
    yield outcome_value(what, m.run)
    yield Value(f"{what}, flown: largest angle (deg)", np.max(np.abs(m.angle)))
    yield Value(f"{what}, flown: largest rate (rad/s)", np.max(np.abs(m.rate)))
