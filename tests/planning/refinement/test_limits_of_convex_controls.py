"""Two limits of a control that H is convex in, one after the other, and another control beside it.

A level turn in the least time, begun above the corner speed: the load factor is at most 7, and at most what lift gives.
A moment of idling brings the aircraft to the corner sooner; from there on it is held up by thrust.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.array_types import Array

MASS, G, WING, THRUST, MOST = 12e3, 9.81, 28.0, 80e3, 7.0
WEIGHT = MASS * G


def most_lift(v: float) -> float:
    return 1.2 * 0.5 * v**2 * WING / WEIGHT


def level_turn(speed: float) -> go.Problem:
    model = go.Model("fighter")
    v, psi, n, throttle = model.state("v"), model.state("psi"), model.control("n"), model.control("throttle")
    wing = 0.5 * v**2 * WING
    drag = 0.022 * wing + 0.14 * (n * WEIGHT) ** 2 / wing
    model.ode({v: (throttle * THRUST - drag) / MASS, psi: G / v * (n**2 - 1) ** 0.5})
    problem, turn = one_phase("level turn", model, initial=0.0, final=(1.0, 80.0), name="turn")
    turn.initial(v=speed, psi=0.0)
    turn.final(psi=np.pi)
    turn.bounds(n=(1.05, MOST), throttle=(0.0, 1.0), v=(70.0, 400.0))
    turn.path("lift", n - most_lift(v), upper=0.0)
    problem.minimize(turn.final_time)
    return problem


def flown(speed: float, idle: float) -> float:
    """Time of the turn at the most load factor, first idle for so long."""

    def rates(t: float, x: Array, throttle: float) -> list[float]:
        v, wing = float(x[0]), 0.5 * float(x[0]) ** 2 * WING
        n = min(MOST, most_lift(v))
        drag = 0.022 * wing + 0.14 * (n * WEIGHT) ** 2 / wing
        return [(throttle * THRUST - drag) / MASS, G / v * np.sqrt(n**2 - 1)]

    def turned(t: float, x: Array, throttle: float) -> float:
        return float(x[1]) - np.pi

    turned.terminal = True  # type: ignore[attr-defined]
    exact = {"rtol": 1e-10, "atol": 1e-12, "max_step": 0.1}
    start = solve_ivp(rates, (0.0, idle), [speed, 0.0], args=(0.0,), **exact).y[:, -1]
    return float(solve_ivp(rates, (idle, 80.0), start, args=(1.0,), events=turned, **exact).t[-1])


@pytest.mark.slow
def test_the_corner_moves_with_what_another_control_does_to_the_speed() -> None:
    solution = go.solve(level_turn(255.0), mesh="10x4")
    best = minimize_scalar(lambda idle: flown(255.0, idle), bounds=(0.0, 2.0), method="bounded")
    assert solution.objective == pytest.approx(best.fun, rel=1e-7)
