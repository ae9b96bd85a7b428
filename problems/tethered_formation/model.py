r"""The tethered pair: data, dynamics, the reference orbit.

A leader pulls a follower by a tether of constant length. Its thrust F is constant; the only control is the rate of
the thrust angle :math:`\gamma` above the direction of motion. The swing :math:`\theta` of the pair must vanish while
the leader follows the orbit that it would have without swing.

States: ``height`` (m) and ``lead`` (m) of the leader, above and ahead on a circle of radius R_0 = 7000 km whose point
moves at the circular rate n_0; ``climb`` and ``drift`` (m/s), their rates; ``theta`` (rad), ``theta_rate``
(rad/s); ``gamma`` (rad). Control: ``gamma_rate`` (rad/s). In the publication's coordinates

.. math:: r = R_0 + h, \qquad \alpha = n_0 t + l / R_0 ,

which avoids rounding errors of small differences. The accelerations of r, :math:`\alpha` and :math:`\theta` are
those of `problems.tethered_formation.tether`; `tether_model` is the only model: controller, optimal control, simulated
plant (with exact gravity) and flight code come from it.

Source: Jia and Meng, Orbit cooperative control for tethered satellite formation system via attitude maneuvering, J.
Astronautics 43 (10), 1361-1367, 2022, whose equations and data are lost in the text that is available: structure
theirs, derivation and numbers ours.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

import gnc_opt as go
from problems._example import Array
from problems.tethered_formation.tether import TetheredPair, TetherMotion

Gravity: TypeAlias = Literal["first order", "exact"]

PAIR = TetheredPair(leader_mass=500.0, follower_mass=200.0, tether_mass=1.0, length=100.0)
FORCE = 100.0
"""Thrust on the leader, N."""
RADIUS = 7e6
"""Of the first orbit, a circle, m."""
RATE = float(np.sqrt(PAIR.mu / RADIUS**3))
"""Circular rate on it, rad/s."""
MAX_ANGLE, MAX_RATE = np.pi / 9, 0.1
"""Limits of the thrust angle (rad) and of its rate (rad/s)."""
FIRST_SWING = float(np.radians(30.0))
"""rad."""
DURATION = 200.0
"""Of the published manoeuvre, s."""

_DEGREE = 10
"""Of the polynomials that the reference orbit is kept in: good to rounding over 200 s."""


def tether_model(
    pair: TetheredPair = PAIR, force: float = FORCE, gravity: Gravity = "first order"
) -> go.Model:
    """Return the dynamics of the pair; the thrust (N) is a parameter of the model.

    Parameters
    ----------
    pair : TetheredPair
    force : float
        N.
    gravity : {"first order", "exact"}
        In the ratio of tether length and radius, or central gravity on every part.
    """
    model = go.Model("tethered pair")
    height, climb = model.state("height", unit="m", nominal=10.0), model.state("climb", unit="m/s")
    lead, drift = model.state("lead", unit="m", nominal=10.0), model.state("drift", unit="m/s")
    theta, theta_rate = model.state("theta", unit="rad"), model.state("theta_rate", unit="rad/s")
    gamma, gamma_rate = model.state("gamma", unit="rad"), model.control("gamma_rate", unit="rad/s")
    thrust = model.parameter("force", force, unit="N")
    motion = TetherMotion(RADIUS + height, climb, RATE + drift / RADIUS, theta, theta_rate)
    law = pair.accelerations if gravity == "first order" else pair.true_accelerations
    acceleration = law(motion, thrust, gamma)
    model.ode(
        {
            height: climb,
            climb: acceleration.r,
            lead: drift,
            drift: RADIUS * acceleration.alpha,
            theta: theta_rate,
            theta_rate: acceleration.theta,
            gamma: gamma_rate,
        }
    )
    model.output("tension", pair.tension(motion, thrust, gamma), unit="N")
    return model


def first_state(swing: float = FIRST_SWING, swing_rate: float = 0.0) -> Array:
    """Return the state (7,) on the circular orbit with a swing (rad, rad/s) and the thrust along the motion."""
    return np.array([0.0, 0.0, 0.0, 0.0, swing, swing_rate, 0.0])


def equilibrium(pair: TetheredPair, force: float, height: Any, climb: Any, drift: Any) -> Any:
    """Return the swing angle (rad) at which the pair does not swing while the thrust is along the motion.

    Height (m), climb and drift (m/s) are numbers or arrays of one shape, and so is the angle.
    """
    r, alpha_rate = RADIUS + height, RATE + drift / RADIUS
    stiffness = pair.kappa * force / (pair.reduced_mass * pair.length) - 3 * pair.mu / r**3
    theta = 0.0
    for _ in range(3):  # Newton's method; the angle is some 1e-5 rad
        here = TetherMotion(r, climb, alpha_rate, theta, 0.0)
        theta += pair.accelerations(here, force, 0.0).theta / stiffness
    return theta


@dataclass(frozen=True)
class Orbit:
    """The reference: the pair pulled without swing from the first orbit, as polynomials of time.

    Attributes
    ----------
    pair : TetheredPair
    force : float
        N.
    duration : float
        s.
    coefficients : array (4, _DEGREE + 1)
        Of height, climb, lead and drift in powers of t / duration, lowest first.
    """

    pair: TetheredPair
    force: float
    duration: float
    coefficients: Array

    @classmethod
    def of(
        cls,
        pair: TetheredPair = PAIR,
        force: float = FORCE,
        duration: float = DURATION,
        start: ArrayLike = (0.0, 0.0, 0.0, 0.0),
    ) -> Orbit:
        """Return the model's motion along its swing equilibrium, from height, climb, lead and drift at the start."""
        law = tether_model(pair, force)

        def rate(t: float, y: Array) -> Array:
            return law.f(t, [*y, equilibrium(pair, force, y[0], y[1], y[3]), 0.0, 0.0], np.zeros(1))[:4]

        first = np.asarray(start, dtype=float)
        nodes = 0.5 * duration * (1 - np.cos(np.pi * (np.arange(2 * _DEGREE) + 0.5) / (2 * _DEGREE)))
        flown = solve_ivp(rate, (0.0, duration), first, "DOP853", nodes, rtol=1e-13, atol=1e-13)
        curves = [Chebyshev.fit(nodes, row, _DEGREE, [0.0, duration]) for row in flown.y]
        powers = np.zeros((4, _DEGREE + 1))  # a conversion leaves out last coefficients that are zero
        for row, curve in zip(powers, curves, strict=True):
            found = curve.convert(kind=Polynomial, domain=[0.0, duration], window=[0.0, 1.0]).coef
            row[: found.size] = found
        return cls(pair, force, duration, powers)

    def __call__(self, t: Any) -> list[Any]:
        """Return height, climb, lead and drift at a time (s), a number or a symbol, by Horner's rule."""
        values = [0.0 * t] * 4
        for column in self.coefficients.T[::-1]:
            values = [value * (t / self.duration) + c for value, c in zip(values, column, strict=True)]
        return values

    def state(self, t: ArrayLike) -> Array:
        """Return the state of the reference, (7,) at a time (s), (7, n_times) at many."""
        times = np.asarray(t, dtype=float)
        height, climb, lead, drift = self(times)
        theta = equilibrium(self.pair, self.force, height, climb, drift)
        return np.stack([height, climb, lead, drift, theta, 0.0 * times, 0.0 * times])


def reference(pair: TetheredPair = PAIR, force: float = FORCE, duration: float = DURATION) -> go.Reference:
    """Return the orbit as a reference without feedforward: the thrust angle stays zero."""
    states = Orbit.of(pair, force, duration).state
    model = tether_model(pair, force)
    with (
        warnings.catch_warnings()
    ):  # the swing is in equilibrium at every time: it leaves out that this moves
        warnings.simplefilter("ignore", go.ProblemWarning)
        return go.Reference.from_functions(
            model, states, lambda t: np.zeros((1, t.size)), 0.0, duration, vectorized=True
        )
