"""Guidance of the rendezvous: a plan with full control authority whose switching times are corrected on board.

The plan takes 25.87 s. `design_neighbouring_optimal` updates it from the measured state; for the last 10 s it lowers
the planned torques and forces by 8 %, and a regulator tracks the end of the plan. Plant, dispersions and limits are
those of `control`. The runs are evaluated the same time after their arrival, which is earlier.

`Measured` does so by range, bearing, star tracker and gyro, every 0.1 s and with white noise (1 sigma): the distance to
the target, 2 cm; its direction in the chaser's axes B, a unit vector, 0.5 mrad per component; the chaser's own attitude
and rates as in `control`. An extended Kalman filter, multiplicative for the attitude, estimates rates, attitude,
velocity and position. Its process noise represents lag, quantisation, differential force and the dispersed mass and
inertia. No run may come within `KEEP_OUT` of the target.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.control import Controller, design_lqr
from gnc_opt.estimation import Estimator, FilterOptions, Measurement, design_ekf, output_feedback
from gnc_opt.guidance import design_neighbouring_optimal
from gnc_opt.simulation import Campaign, ClosedLoop, Event, Noise, Run
from gnc_opt.spacecraft import apply, mrp_to_dcm
from problems.rendezvous import chaser_model
from problems.rendezvous_tracking import control

LAST = 10.0
"""Of the flight, s, in which the regulator follows."""
REGULATED = 0.08
"""Share of the planned torques and forces that it has there."""


@dataclass(frozen=True)
class Guided(control.Tracking):
    """A plan with the whole authority, and the loop that guides it."""

    @cached_property
    def guidance(self) -> Controller:
        """The guidance, with the regulator about the end."""
        model, reference = self.reference.model, self.reference
        final = reference.x(reference.final_time)
        regulator = design_lqr(model, final, **self.weights, dt=control.DT, limits=control.AUTHORITY)
        return design_neighbouring_optimal(
            self.solution, regulator, Q=self.weights["Q"], last=LAST, reserve=REGULATED, delay=control.LAG
        )

    def controller(self, name: str = "neighbouring-optimal") -> Controller:
        """Return the guidance."""
        return self.guidance

    @property
    def end(self) -> float:
        """When the runs are evaluated, s."""
        first = self.guidance.initial_memory(0.0, self.initial)
        return float(first[self.guidance.memory.slice("final_time")][0]) + control.SETTLING

    def arrivals(self, campaign: Campaign) -> Array:
        """Return when each run arrives by its last plan (m,), s."""
        return np.asarray(campaign.memory[campaign.layouts["memory"].slice("final_time")][0])


def settled(run: Run, target: Array) -> float:
    """Return when a run came within all limits of its target (n_states,) for good, s; infinite if it did not."""
    states = run.layouts["state"]
    goal = {name: target[states.slice(name)] for name in states.names}
    # of small turns the parameters change by a quarter of the angle times 1 + sigma^2
    turn = 0.25 * (1 + float(goal["sigma"] @ goal["sigma"]))
    bands = {name: control.LIMITS[name] for name in ("r_L", "v_L", "omega")}
    bands["sigma"] = turn * control.LIMITS["angle(sigma)"]
    return max(run.settling_time(name, band, target=goal[name]) for name, band in bands.items())


RANGE_NOISE, BEARING_NOISE = 0.02, 5e-4
"""m, and the components of a unit vector."""
KEEP_OUT = 6.5
"""Radius of the sphere about the target, m."""
FIRST = {"omega": 1e-4, "sigma": 0.02, "v_L": 1e-3, "r_L": 0.1}
"""Errors of the planned start (1 sigma), rad/s, rad, m/s, m."""
UNKNOWN = {"omega": 3e-4, "v_L": 1e-3}
"""Process noise: what wrong mass, inertia, lag and force do to rates and velocity, rad/s^1.5 and m/s^1.5."""
KNOWN: dict[str, Any] = {
    "sigma0": FIRST,
    "process_noise": UNKNOWN,
    "dt": control.DT,
    "options": FilterOptions(limits=control.AUTHORITY),
}
"""What the filters assume."""


def observed_chaser() -> go.Model:
    """Return the chaser with what it sees of its target."""
    chaser = chaser_model("exact")
    r, sigma = chaser.symbol("r_L"), chaser.symbol("sigma")
    distance = ca.norm_2(r)
    chaser.output("range", distance, unit="m")
    chaser.output("bearing", -apply(mrp_to_dcm(sigma), r) / distance)
    return chaser


SENSORS = (
    Measurement("omega", control.NOISE["omega"]),
    Measurement("sigma", control.NOISE["sigma"]),
    Measurement("range", RANGE_NOISE),
    Measurement("bearing", BEARING_NOISE),
)
"""As the filters see them."""


@cache
def kalman_filter(start: tuple[float, ...]) -> Estimator:
    """Return the extended Kalman filter for a planned start; all plans of a case have the same."""
    return design_ekf(observed_chaser(), np.array(start), SENSORS, **KNOWN)


def sensed(flown: control.Tracking, controller: Controller, *, keep_out: bool = False) -> ClosedLoop:
    """Return the loop of `control` with these sensors, a controller of them and, if wanted, the keep-out sphere."""
    chaser = observed_chaser()
    r = chaser.symbol("r_L")
    sensors = [
        Noise("gyro", control.NOISE["omega"], on="omega"),
        Noise("attitude sensor", np.full(3, control.NOISE["sigma"]), control.turned, on="sigma"),
        Noise("range finder", RANGE_NOISE, on="range"),
        Noise("camera", BEARING_NOISE, on="bearing"),
    ]
    return ClosedLoop(
        chaser,
        controller,
        flown.actuators,
        sensors,
        flown.disturbances,
        events=[Event("too close", r.T @ r - KEEP_OUT**2, "falling", failure=True)] if keep_out else [],
        dt=control.DT,
        accuracy=control.ACCURACY,
    )


@dataclass(frozen=True)
class Filtered(control.Tracking):
    """The plan with reserve, followed by the TVLQR behind the extended Kalman filter."""

    @property
    def filter(self) -> Estimator:
        """The extended Kalman filter."""
        return kalman_filter(tuple(self.initial))

    def controller(self, name: str = "TVLQR") -> Controller:
        """Return the TVLQR fed by the filter."""
        return output_feedback(self.tvlqr, self.filter)

    def loop(self, controller: Controller) -> ClosedLoop:
        """Return the loop of `control` with these sensors."""
        return sensed(self, controller)


@dataclass(frozen=True)
class Measured(Guided):
    """The guidance behind a filter."""

    @property
    def filter(self) -> Estimator:
        """The extended Kalman filter."""
        return kalman_filter(tuple(self.initial))

    def controller(self, name: str = "neighbouring-optimal") -> Controller:
        """Return the guidance fed by the filter."""
        return output_feedback(self.guidance, self.filter)

    def loop(self, controller: Controller) -> ClosedLoop:
        """Return the loop of `control` with these sensors and the keep-out sphere."""
        return sensed(self, controller, keep_out=True)
