"""The plan, the plant and what it differs by, the controllers, and how their runs are evaluated.

**Plan.** The problem of `problems.rendezvous` ("exact" equation) with 85 % of the torques and forces, refined until
the switch times are exact. The controllers have the rest of the authority.

**Plant.** Every run differs from the plan in

* mass: normal, 1 sigma 1 %, truncated at 3 %; each moment of inertia: uniform within 5 %;
* initial position: uniform in a ball of 0.2 m; initial attitude: turned about a random axis (all directions equally
  probable) by an angle uniform in [0, 2 deg];
* thrusters: commands rounded to 1 N and 0.1 N m, limited to the full 320 N and 50 N m, first-order lag of 50 ms
  (uniform within 20 %);
* a constant differential force of 1 N in a random direction of L, as the acceleration of the nominal mass;
* measurements, every 0.1 s, with white noise (1 sigma, per axis): 5 mm, 1 mm/s, 0.02 deg, 0.002 deg/s. This is what
  the filter of a relative navigation by lidar or camera at about 10 m and a gyro deliver. It is consistent with the
  limits: every standard deviation is at most a fifth of what is permitted at the end.

**Judgement.** 20 s after the planned arrival the chaser has to be within 5 cm, 5 mm/s, 0.5 deg and 0.05 deg/s
(Euclidean norms; the attitude error is an angle of rotation).
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Literal

import numpy as np

import gnc_opt as go
from gnc_opt.arrays import Array
from gnc_opt.control import (
    ConstantRate,
    Controller,
    Reference,
    SaturationLayer,
    bryson,
    design_integral_sliding_mode,
    design_mpc,
    design_tvlqr,
    feedforward,
)
from gnc_opt.simulation import (
    Block,
    Campaign,
    ClosedLoop,
    ConstantDisturbance,
    Disturbance,
    Lag,
    Noise,
    Normal,
    Quantisation,
    RandomDirection,
    RandomRotation,
    Run,
    Saturation,
    Uniform,
    UniformInBall,
    monte_carlo,
)
from gnc_opt.simulation.dispersions import Dispersion
from gnc_opt.spacecraft import mrp_rate
from problems.rendezvous import MASS, MAX_FORCE, MAX_TORQUE, PAPER_MESH, build, chaser_model

RESERVE = 0.85
"""Share of the authority that the plan uses."""
DT = 0.1
"""Control step, s."""
SETTLING = 20.0
"""Time after the planned arrival, s."""
ACCURACY = 1e-4
"""Of the integration, a fiftieth of the noise of measurements: errors of 1e-8 may turn a quantum of thrust, which sets
two flights apart by up to 5e-5."""

LIMITS = {"r_L": 0.05, "v_L": 0.005, "angle(sigma)": float(np.deg2rad(0.5)), "omega": float(np.deg2rad(0.05))}
"""Of the errors at the end: m, m/s, rad, rad/s."""

SHOWN = {
    "r_L": ("position", 100.0, "cm"),
    "v_L": ("velocity", 1000.0, "mm/s"),
    "angle(sigma)": ("attitude", float(np.degrees(1)), "deg"),
    "omega": ("rate", float(np.degrees(1)), "deg/s"),
}
"""Label, factor and unit in which a measure is shown."""

NOISE = {"omega": np.deg2rad(0.002), "sigma": np.deg2rad(0.02), "v_L": 1e-3, "r_L": 5e-3}
"""1 sigma per axis: rad/s, rad, m/s, m."""
TORQUE_STEP, FORCE_STEP = 0.1, 1.0
"""Of the commands, N m and N."""
LAG = 0.05
"""Of the thrusters, s."""
DIFFERENTIAL_FORCE = 1.0
"""N."""

ACCEPTED = {"omega": np.deg2rad(0.1), "sigma": np.deg2rad(0.5), "v_L": 0.01, "r_L": 0.05}
"""Errors that weigh alike in the regulators: rad/s, rad, m/s, m."""
CORRECTIONS = {"T_B": 5.0, "F_B": 30.0}
"""Corrections that weigh as much: N m, N."""
REACHING, LAYER = 7.0, 14.0
"""Gain of the sliding mode (N, N m) and half width of its layer (N s, N m s). The gain is what the reserve of the
torques, 7.5 N m, permits."""
HORIZON = 1.5
"""Of the MPC, s."""

MPC_RUNS = 100
"""Runs of the MPC at most, unless asked otherwise: each solves some 480 quadratic programmes."""

CONTROLLERS = ("open loop", "TVLQR", "integral sliding mode", "MPC")


@cache
def plan(case: int = 1, reserve: float = RESERVE, *, refined: bool = True) -> go.Solution:
    """Return the time-optimal rendezvous with a share of the torques and forces.

    Parameters
    ----------
    case : int
    reserve : float
        In (0, 1]; 1 plans with all there is.
    refined : bool
        With exact switch times.
    """
    if not 0 < reserve <= 1:
        raise go.ProblemError(f"a share of {reserve!r} of the authority is none: give a number in (0, 1].")
    torque, force = reserve * MAX_TORQUE, reserve * MAX_FORCE
    problem = build(case, "exact").with_bounds(T_B=(-torque, torque), F_B=(-force, force))
    solution = go.solve(problem, mesh=PAPER_MESH, tol=None)
    return go.refine(solution) if refined else solution


@dataclass(frozen=True)
class Conditions:
    """Laws that are simulated, dispersions, noise and actuators.

    Attributes
    ----------
    law : str
        One of `CONTROLLERS`, or "all" of them.
    share : float
        Of the authority, for the plan.
    feedback : float
        Corrections that the regulators permit, over `CORRECTIONS`.
    reaching, layer : float
        Gain (N, N m) and half width of the layer (N s, N m s) of the sliding mode.
    horizon : float
        Of the MPC, s.
    mass, inertia : float
        1 sigma of the mass, truncated at three of them, and half the range of the moments, relative.
    position, attitude : float
        Largest errors at the start, m and deg.
    lag, lag_range : float
        Of the thrusters, s, and half its range, relative.
    push : float
        Differential force in a random direction, N.
    noise : float
        Of the measurements, over `NOISE`.
    """

    law: str = "all"
    share: float = RESERVE
    feedback: float = 1.0
    reaching: float = REACHING
    layer: float = LAYER
    horizon: float = HORIZON
    mass: float = 0.01
    inertia: float = 0.05
    position: float = 0.2
    attitude: float = 2.0
    lag: float = LAG
    lag_range: float = 0.2
    push: float = DIFFERENTIAL_FORCE
    noise: float = 1.0

    def __post_init__(self) -> None:
        if self.law not in ("all", *CONTROLLERS):
            raise go.GncOptError(
                f"there is no law {self.law!r} to fly: give {', '.join(CONTROLLERS)} or all."
            )
        for name, value in asdict(self).items():
            if name != "law" and value < 0:
                raise go.GncOptError(
                    f"the condition '{name}' is {value!r}: give a number that is not negative."
                )

    @property
    def laws(self) -> tuple[str, ...]:
        """Which of `CONTROLLERS` are flown."""
        return CONTROLLERS if self.law == "all" else (self.law,)

    @property
    def dispersions(self) -> dict[str, Dispersion]:
        """In what the runs differ."""
        return {
            "plant.mass": Normal(self.mass, relative=True, truncate=3.0),
            "plant.inertia": Uniform(-self.inertia, self.inertia, relative=True),
            "initial.r_L": UniformInBall(self.position),
            "initial.sigma": RandomRotation(Uniform(0.0, float(np.deg2rad(self.attitude)))),
            "torque lag.tau": Uniform(-self.lag_range, self.lag_range, relative=True),
            "force lag.tau": Uniform(-self.lag_range, self.lag_range, relative=True),
            "differential force.level": RandomDirection(self.push / MASS),
        }


DISPERSIONS = Conditions().dispersions
"""In what the runs differ by default."""


@dataclass(frozen=True)
class Tracking:
    """A planned rendezvous and the loops that follow it.

    Attributes
    ----------
    solution : Solution
        The plan.
    conditions : Conditions
    """

    solution: go.Solution
    conditions: Conditions = Conditions()

    @cached_property
    def reference(self) -> Reference:
        """The plan, and rest at its end."""
        return Reference(self.solution)

    @property
    def end(self) -> float:
        """When the runs are evaluated, s."""
        return self.reference.final_time + SETTLING

    @property
    def initial(self) -> Array:
        """Planned initial state (n_states,)."""
        return self.reference.x(self.reference.initial_time)

    @cached_property
    def tvlqr(self) -> Controller:
        """The regulator, sampled; also the nominal law of the sliding mode."""
        return design_tvlqr(self.reference.model, self.reference, **self._weights, dt=DT, limits=AUTHORITY)

    def controller(self, name: str) -> Controller:
        """Return one of `CONTROLLERS`."""
        return self._designs[name]()

    @property
    def _weights(self) -> dict[str, dict[str, Array]]:
        model = self.reference.model
        permitted = {name: self.conditions.feedback * most for name, most in CORRECTIONS.items()}
        return {"Q": bryson(model.errors, **ACCEPTED), "R": bryson(model.controls, **permitted)}

    @property
    def _designs(self) -> dict[str, Callable[[], Controller]]:
        model, reference = self.reference.model, self.reference
        return {
            "open loop": lambda: feedforward(reference),
            "TVLQR": lambda: self.tvlqr,
            "integral sliding mode": lambda: design_integral_sliding_mode(
                model,
                reference,
                nominal=self.tvlqr,
                reaching=ConstantRate(self.conditions.reaching),
                boundary=SaturationLayer(self.conditions.layer),
                dt=DT,
                limits=AUTHORITY,
            ),
            "MPC": lambda: design_mpc(
                model, reference, **self._weights, horizon=self.conditions.horizon, dt=DT, limits=AUTHORITY
            ),
        }

    @property
    def actuators(self) -> list[Block]:
        """The thrusters."""
        lag = self.conditions.lag
        return [
            Quantisation("torque steps", TORQUE_STEP, on="T_B"),
            Quantisation("force steps", FORCE_STEP, on="F_B"),
            Saturation("torque limit", -MAX_TORQUE, MAX_TORQUE, on="T_B"),
            Saturation("force limit", -MAX_FORCE, MAX_FORCE, on="F_B"),
            Lag("torque lag", lag, on="T_B"),
            Lag("force lag", lag, on="F_B"),
        ]

    @property
    def disturbances(self) -> list[Disturbance]:
        """What pushes."""
        return [ConstantDisturbance("differential force", np.zeros(3), on="v_L")]

    def loop(self, controller: Controller) -> ClosedLoop:
        """Return the closed loop with all effects, before they are dispersed."""
        noise = self.conditions.noise
        return ClosedLoop(
            chaser_model("exact"),
            controller,
            self.actuators,
            [
                Noise("gyro", noise * NOISE["omega"], on="omega"),
                Noise("attitude sensor", np.full(3, noise * NOISE["sigma"]), turned, on="sigma"),
                Noise("velocity filter", noise * NOISE["v_L"], on="v_L"),
                Noise("position filter", noise * NOISE["r_L"], on="r_L"),
            ],
            self.disturbances,
            dt=DT,
            accuracy=ACCURACY,
        )

    def campaign(
        self,
        name: str,
        runs: int,
        seed: int,
        executor: Executor | Literal["serial"] | None = None,
        *,
        progress: bool = False,
        checkpoint: Path | None = None,
    ) -> Campaign:
        """Fly one of `CONTROLLERS`; the same seed gives all of them the same plants and starts.

        Runs that are in the folder of the checkpoint are not flown again.
        """
        return monte_carlo(
            self.loop(self.controller(name)),
            runs,
            x0=self.initial,
            tf=self.end,
            seed=seed,
            dispersions=self.conditions.dispersions,
            limits=LIMITS,
            executor=executor,
            progress=progress,
            checkpoint=checkpoint,
        )


AUTHORITY = (np.repeat([-MAX_TORQUE, -MAX_FORCE], 3), np.repeat([MAX_TORQUE, MAX_FORCE], 3))
"""Of all controls, N m and N."""


def example_run() -> Run:
    """Return one undispersed run of the plan under TVLQR, with sensors, actuators and their noise."""
    tracking = Tracking(plan())
    return tracking.loop(tracking.tvlqr).simulate(x0=tracking.initial, tf=tracking.end, seed=1)


def turned(sigma: object, angle: object) -> object:
    """Return an attitude turned by a small rotation vector (rad) in its own axes, to first order."""
    return sigma + mrp_rate(sigma, angle)  # type: ignore[operator,arg-type]
