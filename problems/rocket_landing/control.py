r"""The regulator about a plan, and a published law without a plan.

**Regulator.** :math:`T = T_{ref} + m \, (k_1 (r_{ref} - r) + k_2 (v_{ref} - v))`: the errors of a point mass decay with
two poles.

**ZEM/ZEV.** With :math:`t_{go}` left, the miss and the error of velocity that a flight without thrust would end
with,

.. math:: a = \frac{6}{t_{go}^2} \mathrm{ZEM} - \frac{2}{t_{go}} \mathrm{ZEV},

minimises :math:`\int a^2 dt` without limits (Guo, Hawkins and Wie, Applications of
generalized zero-effort-miss/zero-effort-velocity feedback guidance algorithm, J. Guidance, Control, and Dynamics 36
(3), 2013), the cost of the plan. It uses the final time of the plan. Its gains are constant in the last `HELD` seconds.

Both limit the magnitude of the thrust to that of the engines.

**Loops.** Every run differs from the plan by `DISPERSIONS`: start, wind, drag area, thrust factor and lag of the
engines (in trim when they burn already), the phase of gusts, and a mass gauge that is off for the whole flight.
Positions and velocities are measured every 0.1 s with white noise of 0.1 m and 0.02 m/s (1 sigma, per axis).

A run ends where the lander meets the ground: as *touchdown*, or as *crash* if it is faster than 2.5 m/s downward; or
where the tanks are empty. It has to be within 5 m of the target, below 0.5 m/s across and below 2 m/s downward.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt import control, simulation
from gnc_opt.array_types import Array
from gnc_opt.control.discrete_time_controller import Schedule
from gnc_opt.control.feedforward_and_reference_schedule import (
    ReferenceSchedule,
    build_reference_signal_layout,
)
from gnc_opt.guidance import Replanner
from gnc_opt.model.model_variables import Layout
from gnc_opt.simulation.dispersions import Dispersion
from problems.landing.mars_landing import FULL, GRAVITY
from problems.rocket_landing.model import ENGINES, MESH, SETTLING, START, UP, build, descent, norm, plant

DT = 0.1
"""Control step, s."""
POLES = 0.8, 0.8
"""Of the regulator, 1/s."""
HELD = 2.0
"""s."""


def regulator(reference: control.Reference) -> control.Controller:
    """Return the regulator about a plan."""
    k_1, k_2 = POLES[0] * POLES[1], sum(POLES)

    def thrust(t: ca.SX, r: ca.SX, v: ca.SX, m: ca.SX, row: ca.SX) -> ca.SX:
        return row[7:] + m * (k_1 * (row[:3] - r) + k_2 * (row[3:6] - v))

    facts = (
        control.ReportEntry("gain of position", k_1, "1/s^2"),
        control.ReportEntry("gain of velocity", k_2, "1/s"),
    )
    return _controller("regulator", reference, facts, thrust)


def zem_zev(reference: control.Reference, final_time: float) -> control.Controller:
    """Return the published law that is at the ground at a time (s); the reference is to compare with."""
    gravity, target = -GRAVITY * UP, -SETTLING * UP

    def thrust(t: ca.SX, r: ca.SX, v: ca.SX, m: ca.SX, row: ca.SX) -> ca.SX:
        left = ca.fmax(final_time - t, HELD)
        goal = target * (t + left - final_time)  # the ground, and where the settling lander will be after it
        zem = goal - (r + left * v + 0.5 * left**2 * gravity)
        zev = target - (v + left * gravity)
        return m * (6 / left**2 * zem - 2 / left * zev)

    return _controller("ZEM/ZEV", reference, (control.ReportEntry("end", final_time, "s"),), thrust)


def _controller(
    name: str,
    reference: control.Reference,
    facts: tuple[control.ReportEntry, ...],
    thrust: Callable[..., ca.SX],
) -> control.Controller:
    model, signals = reference.model, build_reference_signal_layout(reference)
    t, x, row, z = ca.SX.sym("t"), ca.SX.sym("x", 7), ca.SX.sym("row", signals.size), ca.SX.sym("z", 0)
    wanted = thrust(t, x[:3], x[3:6], x[6], row)
    least, most = (share * FULL for share in ENGINES)
    u = wanted * ca.fmin(ca.fmax(norm(wanted), least), most) / norm(wanted)
    return control.with_dropout_handling(
        control.Controller(
            name=name,
            step=control.law_function(t, x, row, z, u, z),
            start=control.initial_state_function(t, x, row, z),
            states=model.states,
            commands=model.controls,
            signals=signals,
            memory=Layout("memory"),
            schedule=ReferenceSchedule(reference),
            dt=DT,
            explanation=control.DesignReport(f"{name} of '{model.name}'", facts),
        )
    )


EVERY, LATENCY, LAST = 3.0, 0.5, 3.0
"""Of the re-planning, s: how often, how long a solve takes on board, and before which end the plan stays."""
LAG = 0.15
"""Of the engines, s."""
GUST, GUST_RATE = 0.05, 0.2
"""m/s^2 and rad/s."""
HARD, EMPTY = 2.5, 1305.0
"""Speed (m/s) at which the ground is met as a crash, and mass without propellant (kg)."""
LATEST = 80.0
"""End of the runs, s, where no event has ended them."""

LIMITS = {"miss": 5.0, "speed across": 0.5, "speed downward": 2.0}
"""m, m/s, m/s."""

DISPERSIONS: dict[str, Dispersion] = {
    "initial.r": simulation.Normal(20.0),
    "initial.v": simulation.Normal(2.0),
    "initial.mass": simulation.Normal(0.005, relative=True),
    "plant.wind": simulation.Normal([0.0, 10.0, 10.0]),
    "plant.drag_area": simulation.Uniform(-0.3, 0.3, relative=True),
    "gusts.phase": simulation.Uniform(-np.pi, np.pi),
    "engines.factor": simulation.Normal(0.01),
    "engine lag.tau": simulation.Uniform(-0.3, 0.3, relative=True),
    "mass gauge.bias": simulation.Normal(0.005 * 1905.0),
}

CONTROLLERS = ("as planned", "re-planned", "ZEM/ZEV")


@cache
def resolver() -> go.Resolver:
    """Return what knows the plan; one per process."""
    return go.Resolver(go.solve(build(), mesh=MESH, tol=None), cold=False)


def follow(plan: go.Solution) -> Schedule:
    """Return the schedule of the regulator."""
    return ReferenceSchedule(descent(plan))


@dataclass(frozen=True)
class Landing:
    """The plan and the loops that fly it."""

    @property
    def plan(self) -> go.Solution:
        """The descent of `problems.rocket_landing.model`."""
        return resolver().solution

    @cached_property
    def reference(self) -> control.Reference:
        """The plan, and what follows it."""
        return descent(self.plan)

    def controller(self, name: str) -> control.Controller:
        """Return the law of one of `CONTROLLERS`."""
        if name == "ZEM/ZEV":
            return zem_zev(self.reference, self.plan.phase().final_time)
        return regulator(self.reference)

    def loop(self, name: str) -> simulation.ClosedLoop:
        """Return the loop of one of `CONTROLLERS`, before it is dispersed."""
        lander = plant()
        height, downward = lander.symbol("r")[0], -lander.symbol("v")[0]
        again = Replanner(resolver, EVERY, latency=LATENCY, last=LAST, follow=follow)
        return simulation.ClosedLoop(
            lander,
            self.controller(name),
            [
                simulation.ScaleFactor("engines", np.ones(3), on="T"),
                simulation.Lag("engine lag", LAG, on="T", initial="trim"),
            ],
            [
                simulation.Noise("radar", 0.1, on="r"),
                simulation.Noise("Doppler radar", 0.02, on="v"),
                simulation.Bias("mass gauge", 0.0, on="mass"),
            ],
            [simulation.SinusoidalDisturbance("gusts", np.full(3, GUST), GUST_RATE, np.zeros(3), on="v")],
            events=[
                simulation.Event("touchdown", height, "falling", where=downward <= HARD),
                simulation.Event("crash", height, "falling", where=downward > HARD, failure=True),
                simulation.Event("empty", lander.symbol("mass") - EMPTY, "falling", failure=True),
            ],
            replanner=again if name == "re-planned" else None,
            dt=DT,
            accuracy=1e-6,
            substeps=2,
        )

    def simulate_campaign(self, name: str, runs: int, seed: int, **options: Any) -> simulation.Campaign:
        """Simulate one of `CONTROLLERS`; the same seed gives all the same landers; options as of `monte_carlo`."""
        return simulation.monte_carlo(
            self.loop(name),
            runs,
            x0=START,
            tf=LATEST,
            seed=seed,
            dispersions=DISPERSIONS,
            target={"r": np.zeros(3), "v": np.zeros(3)},
            limits=LIMITS,
            measures={
                "miss": lambda c: _landed(c, np.linalg.norm(c.state("r")[1:], axis=0)),
                "speed across": lambda c: _landed(c, np.linalg.norm(c.state("v")[1:], axis=0)),
                "speed downward": lambda c: _landed(c, -c.state("v")[0]),
                "propellant": lambda c: _landed(c, c.parameter("initial.mass")[0] - c.state("mass")[0]),
            },
            **options,
        )


def _landed(campaign: simulation.Campaign, values: Array) -> Array:
    """Return values of runs that have met the ground, not-a-number of the others."""
    met = campaign.event_occurred("touchdown") | campaign.event_occurred("crash")
    return np.where(met, values, np.nan)
