r"""The least time and the least effort flown beside the published structure: same plant, errors of measurement, limits.

A plan is followed to its end and held there: from its end on the reference is the orbit on which the pair is pulled
without swing from *where the plan ends*. The first reference would not do, since deflected thrust is missing along the
orbit: with that deficit swing and height cannot both be on it, and the swing drifts off again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import gnc_opt as go
from gnc_opt.simulation import Noise, Saturation, Uniform
from gnc_opt.spacecraft import TetheredPair
from problems._example import Array
from problems.comparison import Row, at_most, compare, remark, require
from problems.dispersed import Rivals
from problems.flown import Flight, flight_rows, with_settings
from problems.kept import kept
from problems.tethered_formation.laws import (
    STEP,
    Gains,
    Linear,
    Reaching,
    Switching,
    design_swing_law,
    predictive,
)
from problems.tethered_formation.model import (
    DURATION,
    MAX_ANGLE,
    MAX_RATE,
    PAIR,
    Orbit,
    first_state,
    reference,
    tether_model,
)
from problems.tethered_formation.optimal import Goal, optimum
from problems.tethered_formation.runs import Manoeuvre

BAND = 1.0
"""A swing counts as taken out below this, degrees."""
MEASURES = (
    "last time beyond 1 deg (s)",
    "integral of the squared rate (rad^2/s)",
    "largest swing in the last 20 s (deg)",
)
LAWS: dict[str, Reaching] = {
    "MPC": predictive(),
    "linear": Linear(0.5),
    "switching": Switching(0.01),
}


@dataclass(frozen=True)
class Conditions:
    """What all are flown with; ``python -m problems.tethered_formation --set`` changes it.

    Attributes
    ----------
    law : {"MPC", "linear", "switching"}
        The published reaching law, or one of its rivals.
    k1, k2, k3, k4, k5, k6 : float
        Gains of the surface.
    swing : float
        True first one, degrees; the plans believe in 30.
    follower_mass, force : float
        True ones, kg and N; laws and plans believe in 200 and 100.
    swing_noise, swing_rate_noise : float
        1 sigma of every measurement, deg and deg/s.
    position_noise, velocity_noise : float
        Of height and lead, m and m/s.
    seed : int
    """

    law: str = "MPC"
    k1: float = 0.35
    k2: float = 0.01
    k3: float = 0.01
    k4: float = -0.06
    k5: float = 500.0
    k6: float = 1.0
    swing: float = 31.5
    follower_mass: float = 204.0
    force: float = 100.0
    swing_noise: float = 0.01
    swing_rate_noise: float = 0.003
    position_noise: float = 0.05
    velocity_noise: float = 1e-3
    seed: int = 1

    def __post_init__(self) -> None:
        if self.law not in LAWS:
            raise go.GncOptError(f"there is no law {self.law!r} to fly: give one of {', '.join(LAWS)}.")

    @property
    def gains(self) -> Gains:
        """Of the surface."""
        return Gains(self.k1, self.k2, self.k3, self.k4, self.k5, self.k6)

    @property
    def pair(self) -> TetheredPair:
        """The true one."""
        return TetheredPair(PAIR.leader_mass, self.follower_mass, PAIR.tether_mass, PAIR.length)


KNOWN = {
    "published": Flight(135.7, 0.231337, 0.253402),
    "time": Flight(106.2, 0.226691, 0.190534),
    "effort": Flight(177.3, 0.0707368, 0.676310),
}
"""By name, for the default conditions: the rates that were applied, integrated by another program on its own plant."""
KNOWN_HEIGHT = {"published": -7.3721, "time": -5.9875, "effort": -1.6423}
"""The same: error of r at 200 s, m."""


def held(solution: go.Solution, duration: float = DURATION) -> go.Reference:
    """Return a plan, and after its end the orbit without swing from where it ends."""
    leg = solution.phase()
    end = leg.final_time
    after = Orbit.of(duration=max(duration - end, 1.0), start=leg.x(end)[:4])

    def states(t: Array) -> Array:
        return np.where(t <= end, leg.x(np.minimum(t, end)), after.state(np.maximum(t - end, 0.0)))

    def control(t: Array) -> Array:
        return np.where(t <= end, leg.flown_control("gamma_rate")(np.minimum(t, end)), 0.0).reshape(1, -1)

    jumps = [float(t) for t in leg.breaks if 0 < t < end]
    return go.Reference.from_functions(
        tether_model(), states, control, 0.0, max(duration, end), jumps=[*jumps, end], vectorized=True
    )


def planned(goal: Goal) -> go.Solution:
    """Return the plan that is flown; the least time keeps a reserve of angle and rate."""
    return optimum("planned" if goal == "time" else goal).solution


def closed(name: str, conditions: Conditions = Conditions()) -> tuple[go.ClosedLoop, Array]:
    """Return the loop of the "published" structure, or of a plan, "time" or "effort", and its first state."""
    law = LAWS[conditions.law]
    if name == "published":
        controller = design_swing_law(reference(), law, gains=conditions.gains)
    else:
        goal: Goal = "time" if name == "time" else "effort"
        # the model's Gamma contains the plan's own steering, which no observer has to find then
        controller = design_swing_law(held(planned(goal)), gains=conditions.gains, unknown="modelled")
    turn, place = np.radians([conditions.swing_noise, conditions.swing_rate_noise]), conditions.position_noise
    loop = go.ClosedLoop(
        tether_model(conditions.pair, conditions.force, "exact"),
        controller,
        actuators=[Saturation("drive", -MAX_RATE, MAX_RATE)],
        sensors=[
            Noise("swing", float(turn[0]), on="theta"),
            Noise("swing rate", float(turn[1]), on="theta_rate"),
            Noise("height", place, on="height"),
            Noise("lead", place, on="lead"),
            Noise("climb", conditions.velocity_noise, on="climb"),
            Noise("drift", conditions.velocity_noise, on="drift"),
        ],
        dt=controller.dt or STEP,
        substeps=1,
    )
    return loop, first_state(float(np.radians(conditions.swing)))


@kept
def flight(name: str, conditions: Conditions = Conditions()) -> Manoeuvre:
    """Return the flight of `closed`."""
    loop, start = closed(name, conditions)
    run = loop.simulate(start, tf=DURATION, seed=conditions.seed)
    return Manoeuvre(run, conditions.pair, conditions.force)


def rivals(conditions: Conditions = Conditions()) -> Rivals:
    """Return both plans and the published structure, the first swing and its rate up to 1 degree and 0.05 deg/s off."""
    names = {"least time": "time", "least effort": "effort", conditions.law: "published"}
    turn = float(np.radians(1.0))
    return Rivals(
        {who: closed(name, conditions) for who, name in names.items()},
        DURATION,
        {"initial.theta": Uniform(-turn, turn), "initial.theta_rate": Uniform(-0.05 * turn, 0.05 * turn)},
        {"theta": np.zeros(1), "height": np.array([Orbit.of()(DURATION)[0]])},
        {
            "energy(gamma_rate)": ("integral of the squared rate (rad^2/s)", 1.0),
            "theta": ("swing at 200 s (deg)", 1 / turn),
            "height": ("error of r at 200 s (m)", 1.0),
        },
    )


def swing_and_height(m: Manoeuvre) -> tuple[Array, Array]:
    """Return swing (degrees) and error of r (m) over time, both against the first reference."""
    orbit = Orbit.of()
    height, swing = (m.run.state(name).values[0] for name in ("height", "theta"))
    return np.degrees(swing), height - orbit(m.times)[0]


def worth(m: Manoeuvre) -> Flight:
    """Return what a flight is worth."""
    swing = np.abs(swing_and_height(m)[0])
    late = np.flatnonzero(swing > BAND)
    settled = float("inf") if late[-1] == swing.size - 1 else float(m.times[late[-1]])
    return Flight(settled, m.effort, float(np.max(swing[m.times >= DURATION - 20.0 - 1e-9])))


def flown_rows(conditions: Conditions = Conditions()) -> list[Row]:
    """Return the rows of the flown comparison."""
    law, rows = flight("published", conditions), []
    default = conditions == Conditions()
    for name in ("time", "effort"):
        m, what = flight(name, conditions), f"least {name}"
        known = (KNOWN[name], KNOWN["published"]) if default else None
        rows += flight_rows(what, MEASURES, worth(m), worth(law), known, note=conditions.law)
        heights = [float(swing_and_height(flown)[1][-1]) for flown in (m, law)]
        quantity = f"{what}, flown: error of r at 200 s (m); published law"
        if default:
            expected = [KNOWN_HEIGHT[name], KNOWN_HEIGHT["published"]]
            rows.append(compare(quantity, expected, heights, relative=0.01))
        else:
            rows.append(remark(quantity, heights))
        rows.append(require(f"{what}, flown: outcome", "ok", float(m.run.outcome.ok), m.run.outcome.ok))
        most = float(np.max(np.abs(m.angle)))
        rows.append(at_most(f"{what}, flown: largest angle (deg)", np.degrees(MAX_ANGLE) + 1e-9, most))
        rows.append(
            at_most(f"{what}, flown: largest rate (rad/s)", MAX_RATE + 1e-12, float(np.max(np.abs(m.rate))))
        )
    return rows


def flown(settings: Sequence[str]) -> list[Row]:
    """Return the rows under other conditions, given as ``NAME=VALUE``."""
    return flown_rows(with_settings(Conditions(), settings))
