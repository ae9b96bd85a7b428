"""Vector controls that nobody guessed: what carries the guess of the states."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.internals import SUSTAINED, build_phase_guess
from testing.models import one_phase

import gnc_opt as go

GRAVITY, MASS, LENGTH = 1.62, 2000.0, 3.0


def tilting(thrust: float = 8000.0, kilo: float = 1.0) -> go.Problem:
    """A planar lander that is turned by its gimballed engine; lengths and masses in so many m and kg."""
    model = go.Model("tilting lander")
    r, v, angle, spin = model.state("r", 2), model.state("v", 2), model.state("angle"), model.state("spin")
    T, _ = model.vector_control("T", 2)
    c, s = ca.cos(angle), ca.sin(angle)
    lift = ca.vertcat(c * T[0] - s * T[1], s * T[0] + c * T[1])
    weight = np.array([0.0, GRAVITY / kilo])
    model.ode({r: v, v: lift / (MASS / kilo) - weight, angle: spin, spin: T[0] * LENGTH / 4000.0 * kilo})
    problem, leg = one_phase("landing", model, initial=0.0, final=(20.0, 60.0))
    leg.initial(r=[0.0, 500.0 / kilo], v=[0.0, -25.0 / kilo], angle=0.0, spin=0.0)
    leg.final(r=[0.0, 0.0], v=[0.0, -1.0 / kilo], angle=0.0, spin=0.0)
    leg.norm_bounds(T=(0.0, thrust / kilo**2))
    problem.minimize(leg.final_time)
    return problem


def start(problem: go.Problem) -> Any:
    return build_phase_guess(problem.phases["leg"], np.array([0.0, 0.5, 1.0]), perturbed=False)


@pytest.mark.parametrize("kilo", [1.0, 1000.0])
def test_thrust_carries_the_weight_and_slows_down_without_torque(kilo: float) -> None:
    """The straight line of the states asks for it, in any unit."""
    begun = start(tilting(kilo=kilo))
    duration = begun.times[1] - begun.times[0]
    wanted = MASS * (GRAVITY + 24.0 / duration) / kilo**2
    np.testing.assert_allclose(begun.controls[0], wanted, rtol=1e-9)
    np.testing.assert_allclose(begun.controls[1:, 0], [0.0, 1.0], atol=1e-9)


@pytest.mark.parametrize("share", [0.5 * SUSTAINED, 1.5])
def test_thrust_that_is_too_little_or_beyond_reach_implies_nothing(share: float) -> None:
    duration = float(np.ptp(start(tilting()).times))
    wanted = MASS * (GRAVITY + 24.0 / duration)
    begun = start(tilting(thrust=wanted / share))
    np.testing.assert_allclose(begun.controls[0], 0.5 * wanted / share)
    np.testing.assert_allclose(begun.controls[1:], 0.0, atol=1e-12)


def test_guesses_of_the_user_stay() -> None:
    problem = tilting()
    problem.phases["leg"].guess(T=[300.0, 400.0])
    begun = start(problem)
    np.testing.assert_allclose(begun.controls[:, 1], [500.0, 0.6, 0.8])
