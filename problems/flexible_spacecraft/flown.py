r"""Optimal slews flown beside the published law: at equal torque and at equal effort, on the same disturbed plant.

The published law, configuration J, asks for at most 0.3 N m, as printed for RQSMC, and that is the limit of all here.
The slew of least time and effort keeps a reserve of it for feedback. The least vibration takes as long as it may to
spend no more than the published law, the integral of the sum of \|u\|. Both are followed by the published law itself,
RQSMC around the plan; attitude and rate are measured, no mode is.

The plant is stiffer than believed, its hub has other moments, and it is pushed by the publication's disturbance with
the random part at its mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.simulation import ClosedLoop, Noise, Run, Saturation, Turn, Uniform
from gnc_opt.spacecraft import FlexibleBody, quaternion_product
from problems.comparison import Row, at_most, compare, remark, require
from problems.dispersed import Rivals
from problems.flexible_spacecraft.laws import INERTIAL, INERTIAL_ROBUST, QuasiSlidingMode, quasi_sliding_mode
from problems.flexible_spacecraft.model import (
    COUPLING,
    DAMPING,
    DISTURBANCE,
    FREQUENCIES,
    INERTIA,
    build_model,
    initial_state,
    rest,
    target,
)
from problems.flexible_spacecraft.optimal import MESH, build_gentle, build_prompt
from problems.flexible_spacecraft.runs import attitude_error, mean_disturbance, settling
from problems.flown import Flight, flight_rows, with_settings
from problems.kept import kept

BAND = 1e-3
"""Of the quaternion's vector part."""
SPAN, STEP = 120.0, 0.05
"""Of a flight and of its control, s."""
JUDGED = 60.0
"""When the vibration is judged, s: both plans are over."""
MEASURES = ("last max|q_i| > 0.001 (s)", "effort (N m s)", "angle after 120 s (deg)")
PROMPT = "least time and effort"
FLOWN = {PROMPT: "at equal torque", "least vibration": "at equal effort"}


@dataclass(frozen=True)
class Conditions:
    """What all are flown with; ``python -m problems.flexible_spacecraft --set`` changes it.

    Attributes
    ----------
    c, eps, delta, k : float
        Gains of the published law: 1/s, rad/s^2, rad/s, 1/s. ``k`` > 0 is RQSMC.
    k_follow : float
        k of the law that follows the plans.
    limit : float
        Torque on every axis, N m, of law and plans.
    share : float
        Of the limit, for the plans.
    duration : float
        Of the slew of least vibration, s.
    inertia : tuple of 3 floats
        True moments of the hub over those that are believed.
    frequency : float
        True frequencies of the modes over those that are believed.
    disturbance : float
        Amplitude, N m.
    attitude_noise, rate_noise : float
        1 sigma per axis and measurement, deg and deg/s.
    seed : int
    """

    c: float = INERTIAL.c
    eps: float = INERTIAL.eps
    delta: float = INERTIAL.delta
    k: float = INERTIAL.k
    k_follow: float = INERTIAL_ROBUST.k
    limit: float = 0.3
    share: float = 0.9
    duration: float = 58.0
    inertia: tuple[float, float, float] = (1.03, 0.97, 1.02)
    frequency: float = 1.02
    disturbance: float = DISTURBANCE
    attitude_noise: float = 0.002
    rate_noise: float = 0.001
    seed: int = 1

    @property
    def gains(self) -> QuasiSlidingMode:
        """Of the published law."""
        return replace(INERTIAL, c=self.c, eps=self.eps, delta=self.delta, k=self.k)

    @property
    def body(self) -> FlexibleBody:
        """The true one."""
        moments = np.asarray(INERTIA) * self.inertia
        return FlexibleBody(
            moments, np.asarray(COUPLING), self.frequency * np.asarray(FREQUENCIES), np.asarray(DAMPING)
        )


KNOWN = {
    "published": (Flight(109.45, 19.0750277, 0.05357954), 1.945536e-5),
    PROMPT: (Flight(66.1, 28.7785961, 0.01012205), 6.125105e-7),
    "least vibration": (Flight(69.9, 19.0918087, 0.01000490), 2.140331e-7),
}
"""By name, for the default conditions, with the modal energy (J): the torques that were applied, integrated by another
program on its own plant."""


def plan(name: str, conditions: Conditions = Conditions()) -> go.Solution:
    """Return the plan that is flown, "least time and effort" or "least vibration"."""
    return _planned(name, conditions.share * conditions.limit, conditions.duration)


@cache
def _planned(name: str, limit: float, duration: float) -> go.Solution:
    if name == PROMPT:
        return go.solve(build_prompt(limit), mesh=MESH, tol=1e-8)
    # its arcs on the limit are many and short: the mesh finds them in less than half the time of their structure
    return go.solve(build_gentle(duration, limit=limit), mesh="40x4", tol=1e-8, structure="none")


def closed(name: str, conditions: Conditions = Conditions()) -> ClosedLoop:
    """Return the loop of the "published" law, or of a plan."""
    model, gains = build_model(), conditions.gains
    if name == "published":
        controller = quasi_sliding_mode(model, target(model), gains)
    else:
        reference = go.Reference(plan(name, conditions))
        controller = quasi_sliding_mode(model, reference, replace(gains, k=conditions.k_follow))
    return ClosedLoop(
        build_model(conditions.body),
        controller,
        actuators=[Saturation("limit", -conditions.limit, conditions.limit)],
        sensors=[
            Noise("star tracker", np.full(3, np.radians(conditions.attitude_noise)), turned, on="q_BO"),
            Noise("gyro", float(np.radians(conditions.rate_noise)), on="omega"),
        ],
        disturbances=mean_disturbance(conditions.disturbance),
        dt=STEP,
        accuracy=1e-7,
        substeps=2,
    )


@kept
def flight(name: str, conditions: Conditions = Conditions()) -> Run:
    """Return the flight of `closed`."""
    return closed(name, conditions).simulate(initial_state(build_model()), tf=SPAN, seed=conditions.seed)


def rivals(conditions: Conditions = Conditions()) -> Rivals:
    """Return both plans and the published law, turned by up to 2 degrees and pushed half as much again or less."""
    model = build_model()
    end = rest(model, (1.0, 0.0, 0.0, 0.0))
    half = Uniform(-0.5, 0.5, relative=True)
    return Rivals(
        {
            who: (closed(name, conditions), initial_state(model))
            for who, name in (*((plan, plan) for plan in FLOWN), ("published law", "published"))
        },
        SPAN,
        {
            "initial.q_BO": Turn(Uniform(0.0, float(np.radians(2.0)))),
            "wave.amplitude": half,
            "push.level": half,
        },
        {"q_BO": end[:4]},
        {
            "effort(torque)": ("effort (N m s)", 1.0),
            "angle(q_BO)": ("angle after 120 s (deg)", float(np.degrees(1.0))),
        },
    )


def turned(q: object, angle: object) -> object:
    """Return an attitude turned by a small rotation vector (rad) in its own axes, to first order."""
    return quaternion_product(q, ca.vertcat(1, 0.5 * angle))  # type: ignore[operator]


def worth(run: Run) -> Flight:
    """Return what a flight is worth."""
    return Flight(settling(run, BAND), float(np.sum(run.effort)), float(np.degrees(attitude_error(run)[-1])))


def vibration(run: Run, body: FlexibleBody) -> float:
    """Return the modal energy `JUDGED` s after the start, J."""
    k = round(JUDGED / STEP)
    eta, eta_rate = (run.state(name).values[:, k] for name in ("eta", "eta_rate"))
    return float(np.squeeze(body.modal_energy(eta, eta_rate)))


def flown_rows(conditions: Conditions = Conditions()) -> list[Row]:
    """Return the rows of the flown comparison."""
    law, rows = flight("published", conditions), []
    known = KNOWN if conditions == Conditions() else None
    for name, share in FLOWN.items():
        run, what = flight(name, conditions), f"{name}, {share}"
        both = (known[name][0], known["published"][0]) if known else None
        rows += flight_rows(what, MEASURES, worth(run), worth(law), both, note=f"k = {conditions.k:g}")
        quantity = f"{what}, flown: modal energy after 60 s (J); published law"
        energies = [vibration(one, conditions.body) for one in (run, law)]
        if known:
            expected = (known[name][1], known["published"][1])
            rows.append(compare(quantity, expected, energies, relative=0.01))
        else:
            rows.append(remark(quantity, energies))
        rows.append(_verdict_row(what, go.verify(plan(name, conditions))))
        rows.append(require(f"{what}, flown: outcome", "ok", float(run.outcome.ok), run.outcome.ok))
        most = float(np.max(np.abs(run.applied)))
        rows.append(at_most(f"{what}, flown: largest torque (N m)", conditions.limit * (1 + 1e-12), most))
    return rows


def _verdict_row(what: str, verdict: go.Verdict) -> Row:
    told = ", ".join(c.name for c in (*verdict.failed, *verdict.untold))
    return require(f"{what}: verdict of the plan", "ok", float(verdict.ok), verdict.ok, note=told)


def flown(settings: Sequence[str]) -> list[Row]:
    """Return the rows under other conditions, given as ``NAME=VALUE``."""
    return flown_rows(with_settings(Conditions(), settings))
