"""The plan, the plant with its dispersions, the controllers, and the evaluation of their runs.

**Plan.** The problem of `problems.rendezvous` ("exact" equation) with 85 % of the torques and forces, refined until
the switch times are exact. The controllers have the rest of the authority.

**Plant.** Every run differs from the plan by `DISPERSIONS`. Commands are rounded, limited to the full torques and
forces, and follow with a first-order lag. Measurements, every 0.1 s, have white noise (`NOISE`). It
corresponds to relative navigation by lidar or camera at about 10 m and a gyro, and is at most a fifth of the limits.

**Evaluation.** 20 s after the planned arrival the chaser has to be within 5 cm, 5 mm/s, 0.5 deg and 0.05 deg/s
(Euclidean norms; the attitude error is an angle of rotation).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np

import gnc_opt as go
from gnc_opt import control, simulation
from gnc_opt.array_types import Array
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

CONTROLLERS = ("open loop", "TVLQR", "integral sliding mode", "MPC")


@cache
def plan(case: int = 1, reserve: float = RESERVE, *, refined: bool = True) -> go.Solution:
    """Return the time-optimal rendezvous with a share of the torques and forces, refined: with exact switch times."""
    if not 0 < reserve <= 1:
        raise go.ProblemError(f"a share of {reserve!r} of the authority is none: give a number in (0, 1].")
    torque, force = reserve * MAX_TORQUE, reserve * MAX_FORCE
    problem = build(case, "exact").with_bounds(T_B=(-torque, torque), F_B=(-force, force))
    solution = go.solve(problem, mesh=PAPER_MESH, tol=None)
    return go.refine(solution) if refined else solution


DISPERSIONS: dict[str, Dispersion] = {
    "plant.mass": simulation.Normal(0.01, relative=True, truncate=3.0),
    "plant.inertia": simulation.Uniform(-0.05, 0.05, relative=True),
    "initial.r_L": simulation.UniformInBall(0.2),
    "initial.sigma": simulation.RandomRotation(simulation.Uniform(0.0, float(np.deg2rad(2.0)))),
    "torque lag.tau": simulation.Uniform(-0.2, 0.2, relative=True),
    "force lag.tau": simulation.Uniform(-0.2, 0.2, relative=True),
    "differential force.level": simulation.RandomDirection(DIFFERENTIAL_FORCE / MASS),
}
"""In what the runs differ."""


@dataclass(frozen=True)
class Tracking:
    """A planned rendezvous and the loops that follow it."""

    solution: go.Solution

    @cached_property
    def reference(self) -> control.Reference:
        """The plan, and rest at its end."""
        return control.Reference(self.solution)

    @property
    def end(self) -> float:
        """When the runs are evaluated, s."""
        return self.reference.final_time + SETTLING

    def arrivals(self, campaign: simulation.Campaign) -> Array:
        """Return when each run arrives by its last plan (m,), s."""
        return np.full(len(campaign), self.reference.final_time)

    @property
    def initial(self) -> Array:
        """Planned initial state (n_states,)."""
        return self.reference.x(self.reference.initial_time)

    @cached_property
    def tvlqr(self) -> control.Controller:
        """The regulator, sampled; also the nominal law of the sliding mode."""
        return control.design_tvlqr(
            self.reference.model, self.reference, **self.weights, dt=DT, limits=AUTHORITY
        )

    @property
    def weights(self) -> dict[str, Any]:
        """Q and R of the regulators, by Bryson's rule."""
        errors, controls = self.reference.model.errors, self.reference.model.controls
        return {"Q": control.bryson(errors, **ACCEPTED), "R": control.bryson(controls, **CORRECTIONS)}

    def controller(self, name: str) -> control.Controller:
        """Return one of `CONTROLLERS`."""
        model, reference = self.reference.model, self.reference
        if name == "open loop":
            return control.feedforward(reference)
        if name == "TVLQR":
            return self.tvlqr
        if name == "MPC":
            return control.design_mpc(
                model, reference, **self.weights, horizon=HORIZON, dt=DT, limits=AUTHORITY
            )
        return control.design_integral_sliding_mode(
            model,
            reference,
            nominal=self.tvlqr,
            reaching=control.ConstantRate(REACHING),
            boundary=control.SaturationLayer(LAYER),
            dt=DT,
            limits=AUTHORITY,
        )

    @property
    def actuators(self) -> list[simulation.Block]:
        """The thrusters."""
        return [
            simulation.Quantisation("torque steps", TORQUE_STEP, on="T_B"),
            simulation.Quantisation("force steps", FORCE_STEP, on="F_B"),
            simulation.Saturation("torque limit", -MAX_TORQUE, MAX_TORQUE, on="T_B"),
            simulation.Saturation("force limit", -MAX_FORCE, MAX_FORCE, on="F_B"),
            simulation.Lag("torque lag", LAG, on="T_B"),
            simulation.Lag("force lag", LAG, on="F_B"),
        ]

    @property
    def disturbances(self) -> list[simulation.Disturbance]:
        """Differential force, dispersed by direction."""
        return [simulation.ConstantDisturbance("differential force", np.zeros(3), on="v_L")]

    def loop(self, controller: control.Controller) -> simulation.ClosedLoop:
        """Return the closed loop with all effects, before they are dispersed."""
        return simulation.ClosedLoop(
            chaser_model("exact"),
            controller,
            self.actuators,
            [
                simulation.Noise("gyro", NOISE["omega"], on="omega"),
                simulation.Noise("attitude sensor", np.full(3, NOISE["sigma"]), turned, on="sigma"),
                simulation.Noise("velocity filter", NOISE["v_L"], on="v_L"),
                simulation.Noise("position filter", NOISE["r_L"], on="r_L"),
            ],
            self.disturbances,
            dt=DT,
            accuracy=ACCURACY,
        )

    def simulate_campaign(self, name: str, runs: int, seed: int, **options: Any) -> simulation.Campaign:
        """Simulate one of `CONTROLLERS`; the same seed gives all the same plants; options as of `monte_carlo`."""
        return simulation.monte_carlo(
            self.loop(self.controller(name)),
            runs,
            x0=self.initial,
            tf=self.end,
            seed=seed,
            dispersions=DISPERSIONS,
            limits=LIMITS,
            **options,
        )


AUTHORITY = (np.repeat([-MAX_TORQUE, -MAX_FORCE], 3), np.repeat([MAX_TORQUE, MAX_FORCE], 3))
"""Of all controls, N m and N."""


def example_run() -> simulation.Run:
    """Return one undispersed run of the plan under TVLQR, with sensors, actuators and their noise."""
    tracking = Tracking(plan())
    return tracking.loop(tracking.tvlqr).simulate(x0=tracking.initial, tf=tracking.end, seed=1)


def turned(sigma: object, angle: object) -> object:
    """Return an attitude turned by a small rotation vector (rad) in its own axes, to first order."""
    return sigma + mrp_rate(sigma, angle)  # type: ignore[operator,arg-type]


vars(turned)["error_unit"] = "rad"  # shown in reports
