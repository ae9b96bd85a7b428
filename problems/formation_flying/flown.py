r"""Both plans and the published law flown on the same oblate plant, with the same measurement errors and thrusters.

The plans are followed by the publication's optimal sliding mode, on the circle after their end. All are judged alike
by the distance from the circle's point: the last time beyond `BAND`, the Delta-V of the period, and the distance at
its end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

import gnc_opt as go
from gnc_opt.arrays import Array
from gnc_opt.control import Controller
from gnc_opt.simulation import Ball, ClosedLoop, Noise, Run, Saturation
from problems.comparison import Row, at_most, require
from problems.dispersed import Rivals
from problems.flown import Flight, flight_rows, with_settings
from problems.formation_flying.laws import ETA, PHI, integral_law, sliding_mode
from problems.formation_flying.model import (
    J2,
    PERIOD,
    START,
    build_model,
    circle,
    circle_state,
    formation,
    hill_model,
)
from problems.formation_flying.optimal import LIMIT, RESERVE, Plan, plan
from problems.kept import kept

Law: TypeAlias = Literal["optimal SMC", "SMC"]

BAND = 1.0
"""m."""
MEASURES = ("last time beyond 1 m of the circle's point (s)", "Delta-V in one period (m/s)", "|e(T)| (m)")


@dataclass(frozen=True)
class Conditions:
    """What all are flown with; ``python -m problems.formation_flying --set`` changes it.

    Attributes
    ----------
    law : {"optimal SMC", "SMC"}
        The published law beside the plans.
    eta, phi : float
        Gain (m/s^2) and layer (m/s) of the optimal sliding mode, which follows the plans, too.
    limit : float
        Of the thrusters on every axis, m/s^2.
    reserve : float
        Share of `LIMIT` that the plans leave.
    oblateness : float
        J2 of the plant; no law and no plan knows it.
    position_noise, velocity_noise : float
        1 sigma per axis and measurement, m and m/s.
    steps : int
        Of the controller in a period.
    seed : int
    """

    law: str = "optimal SMC"
    eta: float = ETA
    phi: float = PHI
    limit: float = LIMIT
    reserve: float = RESERVE
    oblateness: float = J2
    position_noise: float = 0.01
    velocity_noise: float = 2e-5
    steps: int = 6000
    seed: int = 1

    def __post_init__(self) -> None:
        if self.law not in ("optimal SMC", "SMC"):
            raise go.GncOptError(f"there is no law {self.law!r} to fly: give 'optimal SMC' or 'SMC'.")


KNOWN = {
    "published": Flight(3857.70, 1.88696, 0.060060),
    "least Delta-V": Flight(4542.62, 1.38551, 0.0019066),
    "least time": Flight(809.81, 3.18589, 0.0019292),
}
"""By name, for the default conditions: the thrust that was applied, integrated by another program on its own plant."""


def follow(flown: Plan, conditions: Conditions, duration: float = PERIOD) -> Run:
    """Fly a plan, and the circle after its end, by the optimal sliding mode for ``duration`` (s)."""
    loop = _loop(_following(flown, conditions, duration), conditions)
    return loop.simulate(START, tf=duration, seed=conditions.seed)


def _following(flown: Plan, conditions: Conditions, duration: float = PERIOD) -> Controller:
    model, end = build_model().with_parameters(J2=0.0), flown.final_time
    circling = formation(model, max(duration, end))

    def states(t: Array) -> Array:
        return np.where(t <= end, flown.states(np.minimum(t, end)), circling.x(t))

    def thrust(t: Array) -> Array:
        return np.where(t <= end, flown.thrust(np.minimum(t, end)), circling.u(t))

    jumps = [float(t) for t in flown.solution.phase().breaks if 0 < t < end]
    reference = go.Reference.from_functions(
        model, states, thrust, 0.0, max(duration, end), jumps=[*jumps, end], vectorized=True
    )
    dt, limits = PERIOD / conditions.steps, (-conditions.limit, conditions.limit)
    return integral_law(model, reference, dt, gain=conditions.eta, layer=conditions.phi, limits=limits)


def closed(name: str, conditions: Conditions = Conditions()) -> ClosedLoop:
    """Return the loop of the "published" law, or of a plan, "least Delta-V" or "least time"."""
    if name != "published":
        return _loop(_following(plan(name, conditions.reserve, False), conditions), conditions)
    dt = PERIOD / conditions.steps
    if conditions.law == "SMC":
        return _loop(sliding_mode(dt), conditions)
    model = hill_model()
    circling = formation(model, feedforward=False)
    law = integral_law(model, circling, dt, gain=conditions.eta, layer=conditions.phi)
    return _loop(law, conditions)


@kept
def flight(name: str, conditions: Conditions = Conditions()) -> Run:
    """Return the run of `closed` over a period."""
    return closed(name, conditions).simulate(START, tf=PERIOD, seed=conditions.seed)


def _loop(law: Controller, conditions: Conditions) -> ClosedLoop:
    return ClosedLoop(
        build_model().with_parameters(J2=conditions.oblateness),
        law,
        actuators=[Saturation("thrusters", -conditions.limit, conditions.limit)],
        sensors=[
            Noise("position", conditions.position_noise, on="r"),
            Noise("velocity", conditions.velocity_noise, on="v"),
        ],
        dt=PERIOD / conditions.steps,
        substeps=1,
    )


def rivals(conditions: Conditions = Conditions(steps=2000)) -> Rivals:
    """Return both plans and the published law, started up to 20 m and 2 cm/s off."""
    names = {"least Delta-V": "least Delta-V", "least time": "least time", conditions.law: "published"}
    end = circle_state(PERIOD)
    return Rivals(
        {who: (closed(name, conditions), START) for who, name in names.items()},
        PERIOD,
        {"initial.r": Ball(20.0), "initial.v": Ball(0.02)},
        {"r": end[:3]},
        {"effort(a)": ("Delta-V (m/s)", 1.0), "r": ("|e(T)| (m)", 1.0)},
    )


def away(run: Run) -> Array:
    """Return the distance (n_times,) from the circle's point, m."""
    return np.asarray(np.linalg.norm(run.states[:3] - circle(run.times)[0], axis=0))


def worth(run: Run) -> Flight:
    """Return what a run of one period is worth."""
    distance = away(run)
    late = np.flatnonzero(distance > BAND)
    settled = float("inf") if late[-1] == run.times.size - 1 else float(run.times[late[-1]])
    return Flight(settled, float(np.sum(run.control_effort("a"))), float(distance[-1]))


def flown_rows(conditions: Conditions = Conditions()) -> list[Row]:
    """Return the rows of the flown comparison."""
    law, rows = flight("published", conditions), []
    for name in ("least Delta-V", "least time"):
        flown = flight(name, conditions)
        default = conditions == Conditions()
        known = (KNOWN[name], KNOWN["published"]) if default else None
        rows += flight_rows(name, MEASURES, worth(flown), worth(law), known, note=conditions.law)
        rows.append(require(f"{name}, flown: outcome", "ok", float(flown.outcome.ok), flown.outcome.ok))
        most = float(np.max(np.abs(flown.applied)))
        rows.append(
            at_most(f"{name}, flown: largest thrust per axis (m/s^2)", conditions.limit * (1 + 1e-12), most)
        )
    return rows


def flown(settings: Sequence[str]) -> list[Row]:
    """Return the rows under other conditions, given as ``NAME=VALUE``."""
    return flown_rows(with_settings(Conditions(), settings))
