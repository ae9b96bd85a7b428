"""Closed-loop runs of the published structure on the exact plant, and what is read off them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

import gnc_opt as go
from gnc_opt.spacecraft import TetheredPair, TetherMotion
from problems._example import Array
from problems.tethered_formation.laws import (
    STEP,
    Gains,
    Linear,
    Reaching,
    Switching,
    Unknown,
    design_swing_law,
    predictive,
)
from problems.tethered_formation.model import (
    DURATION,
    FORCE,
    MAX_ANGLE,
    MAX_RATE,
    PAIR,
    RADIUS,
    RATE,
    first_state,
    reference,
    tether_model,
)


@dataclass(frozen=True)
class Manoeuvre:
    """One run, in degrees where it is called an angle.

    Attributes
    ----------
    run : Run
    pair : TetheredPair
        The true one.
    force : float
        The true one, N.
    """

    run: go.Run
    pair: TetheredPair = PAIR
    force: float = FORCE

    @property
    def times(self) -> Array:
        """s."""
        return np.asarray(self.run.times)

    @cached_property
    def swing(self) -> Array:
        """Error of theta, degrees."""
        return np.asarray(np.degrees(self.run.error("theta").values[0]))

    @cached_property
    def height(self) -> Array:
        """Error of r, m."""
        return np.asarray(self.run.error("height").values[0])

    @cached_property
    def climb(self) -> Array:
        """Error of the rate of r, m/s."""
        return np.asarray(self.run.error("climb").values[0])

    @cached_property
    def lead(self) -> Array:
        """Error along the orbit, r e_alpha, m."""
        ahead, above = self.run.error("lead").values[0], self.run.state("height").values[0]
        return np.asarray(ahead * (1 + above / RADIUS))

    @cached_property
    def angle(self) -> Array:
        """Gamma, degrees."""
        return np.asarray(np.degrees(self.run.state("gamma").values[0]))

    @cached_property
    def rate(self) -> Array:
        """Commands of the rate of gamma, rad/s, one fewer than times."""
        return np.asarray(self.run.commands[0])

    @cached_property
    def tension(self) -> Array:
        """N."""
        state = {n: self.run.state(n).values[0] for n in self.run.layouts["state"].names}
        motion = TetherMotion(
            RADIUS + state["height"],
            state["climb"],
            RATE + state["drift"] / RADIUS,
            state["theta"],
            state["theta_rate"],
        )
        return np.asarray(self.pair.tension(motion, self.force, state["gamma"]))

    @property
    def overshoot(self) -> float:
        """Largest swing to the other side of the first, degrees."""
        return float(np.max(-np.sign(self.swing[0]) * self.swing))

    def last_beyond(self, band: float) -> float:
        """Return the last time (s) at which the swing is beyond a band (degrees); inf if it still is at the end."""
        beyond = np.flatnonzero(np.abs(self.swing) > band)
        if beyond.size == 0:
            return 0.0
        return float("inf") if beyond[-1] == self.times.size - 1 else float(self.times[beyond[-1]])

    def late_swing(self, begin: float = 150.0) -> float:
        """Return the largest swing from ``begin`` (s) on, degrees."""
        return float(np.max(np.abs(self.swing[self.times >= begin - 1e-9])))

    def variation(self, begin: float = 0.0) -> float:
        """Return the sum of the changes of the commanded rate from ``begin`` (s) on, rad/s."""
        return float(np.sum(np.abs(np.diff(self.rate[self.times[:-1] >= begin - 1e-9]))))

    @property
    def at_angle_limit(self) -> Array:
        """Times (s) of the states that are on the limit of the angle."""
        return np.asarray(self.times[np.abs(self.angle) >= np.degrees(MAX_ANGLE) * (1 - 1e-9)])

    @property
    def at_rate_limit(self) -> Array:
        """Times (s) of the commands that are on the limit of the rate."""
        return self.times[:-1][np.abs(self.rate) >= MAX_RATE * (1 - 1e-9)]

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
    reaching: Reaching | None = None,
    *,
    gains: Gains | None = None,
    unknown: Unknown = "observed",
    swing: float = np.radians(30.0),
    swing_rate: float = 0.0,
    pair: TetheredPair = PAIR,
    force: float = FORCE,
    duration: float = DURATION,
    dt: float = STEP,
) -> Manoeuvre:
    """Fly the published structure on the exact plant.

    Parameters
    ----------
    reaching, gains, unknown, dt
        See `design_swing_law`.
    swing, swing_rate : float
        At the start, rad and rad/s.
    pair, force
        The true pair and thrust (N); controller and reference believe in `PAIR` and `FORCE`.
    duration : float
        s.
    """
    law = design_swing_law(reference(duration=duration), reaching, gains=gains, unknown=unknown, dt=dt)
    return fly_law(law, first_state(swing, swing_rate), duration, pair, force)


def fly_without_control(duration: float = DURATION) -> Manoeuvre:
    """Fly with the thrust along the orbit."""
    return fly_law(go.feedforward(reference(duration=duration)), first_state(), duration)


def fly_law(
    law: go.Controller, start: Array, duration: float, pair: TetheredPair = PAIR, force: float = FORCE
) -> Manoeuvre:
    """Fly a law on the exact plant from a state (7,), for ``duration`` (s); pair and thrust (N) are the true ones."""
    # One step of the fifth-order method per 0.1 s leaves 1e-11, see run.integration_error.
    loop = go.ClosedLoop(tether_model(pair, force, "exact"), law, dt=law.dt or STEP, substeps=1)
    return Manoeuvre(loop.simulate(start, tf=duration), pair, force)


def comparison() -> dict[str, Manoeuvre]:
    """Return the six manoeuvres of the results table, by name."""
    return {
        "no control": fly_without_control(),
        "MPC": fly(predictive()),
        "linear": fly(Linear(0.5)),
        "switching 0.01": fly(Switching(0.01)),
        "switching 0.003": fly(Switching(0.003)),
        "MPC, no observer": fly(predictive(), unknown="ignored"),
    }
