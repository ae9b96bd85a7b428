"""Limits met for a moment: the inside of a bend, an acceleration hardly held."""

from __future__ import annotations

import numpy as np
import pytest
import scipy
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.array_types import Array

GRIP, INSIDE, OUTSIDE, ENTRY = 8.0, 27.0, 33.0, 12.0

UP, DOWN = 1.0, 0.35
"""m/s^2, of a lift with a jerk of 1 m/s^3."""


def lift(way: float) -> go.Problem:
    model, *_ = dynamics("lift", "x v a", "jerk", lambda x, v, a, jerk: {x: v, v: a, a: jerk})
    problem, leg = one_phase("lift", model, initial=0.0, final=(1.0, 40.0))
    leg.initial(x=0.0, v=0.0, a=0.0)
    leg.final(x=way, v=0.0, a=0.0)
    leg.bounds(jerk=(-1.0, 1.0), a=(-DOWN, UP))
    problem.minimize(leg.final_time)
    return problem


def least_time(way: float) -> float:
    """To the speed V and back, in V / A + A each at a mean of V / 2, where A is the acceleration that is reached."""
    halves = 0.5 * (UP + DOWN)
    square = 0.5 / UP + 0.5 / DOWN
    speed = (-halves + np.sqrt(halves**2 + 4.0 * square * way)) / (2.0 * square)
    return float(speed / UP + UP + speed / DOWN + DOWN)


@pytest.mark.slow
@pytest.mark.parametrize("way", [3.0], ids=["held for a moment"])
def test_a_lift_holds_either_acceleration_for_as_long_as_it_takes(way: float) -> None:
    """The arc of 0.08 s at the first one is a third of a segment of the first mesh."""
    solution = go.solve(lift(way))
    assert solution.objective == pytest.approx(least_time(way), rel=1e-10)
    assert [(a.channel, a.kind.value) for a in solution.structure if a.channel == "a"] == [
        ("a", "upper"),
        ("a", "lower"),
    ]
    assert go.verify(solution).ok


@pytest.fixture(scope="module")
def bend() -> go.Solution:
    """A car with a given grip in a half circle of road, without another limit on its speed."""
    model = go.Model("car")
    x, y, vx, vy = (model.state(name) for name in ("x", "y", "vx", "vy"))
    ax, ay = model.control("ax"), model.control("ay")
    model.ode({x: vx, y: vy, vx: ax, vy: ay})
    problem, leg = one_phase("bend", model, initial=0.0, final=(1.0, 30.0), name="bend")
    leg.initial(x=30.0, y=0.0, vx=0.0, vy=ENTRY)
    leg.final(x=-30.0, y=0.0)
    leg.path("grip", (ax**2 + ay**2) / GRIP**2, upper=1.0)
    leg.path("road", (x**2 + y**2) / 900.0, lower=(INSIDE / 30.0) ** 2, upper=(OUTSIDE / 30.0) ** 2)
    leg.bounds(ax=(-10.0, 10.0), ay=(-10.0, 10.0))
    angle = np.linspace(0.0, np.pi, 9)
    leg.guess(
        time=np.linspace(0.0, 8.0, 9),
        x=30.0 * np.cos(angle),
        y=30.0 * np.sin(angle),
        vx=-ENTRY * np.sin(angle),
        vy=ENTRY * np.cos(angle),
    )
    problem.minimize(leg.final_time)
    return go.solve(problem)


def missed(unknown: Array) -> Array:
    """By the extremal of costates at the start, two times at which the inside pushes, how hard, and the final time.

    Between pushes the costate of the place is constant, that of the velocity falls with it, and all of the grip points
    against the latter.
    """
    state = np.array([30.0, 0.0, 0.0, ENTRY])
    along = unknown[:4]
    push = unknown[6:8]
    times = unknown[[4, 5, 8]]
    found, begin = [], 0.0
    for k, end in enumerate(times):
        start, place, speed = begin, along[:2].copy(), along[2:].copy()

        def rates(
            t: float, y: Array, start: float = start, place: Array = place, speed: Array = speed
        ) -> Array:
            pull = speed - place * (t - start)
            return np.concatenate([y[2:], -GRIP * pull / np.linalg.norm(pull)])

        state = scipy.integrate.solve_ivp(rates, (begin, end), state, "DOP853", rtol=1e-11, atol=1e-11).y[
            :, -1
        ]
        along = np.concatenate([place, speed - place * (end - start)])
        if k < 2:
            found += [state[:2] @ state[:2] / INSIDE**2 - 1.0, state[:2] @ state[2:] / INSIDE**2]
            along[:2] += push[k] * state[:2]
        begin = end
    start = 1.0 + unknown[1] * ENTRY - GRIP * float(np.hypot(*unknown[2:4]))  # H at the start is -1
    return np.array([*found, state[0] / 30.0 + 1.0, state[1] / 30.0, *along[2:], start])


@pytest.mark.slow
def test_a_car_touches_the_inside_of_a_bend_where_shooting_says(bend: go.Solution) -> None:
    leg = bend.phases["bend"]
    touches = [arc.start for arc in bend.structure if arc.channel == "road"]
    assert len(touches) == 2
    pushes = [
        float(np.mean((leg.lam(t, "right")[:2] - leg.lam(t, "left")[:2]) / leg.x(t)[:2])) for t in touches
    ]
    found = np.array([*leg.lam(0.0), *touches, *pushes, bend.objective])
    exact = scipy.optimize.fsolve(missed, found, xtol=1e-11)
    assert found == pytest.approx(exact, rel=1e-5, abs=1e-7)
    assert bend.objective == pytest.approx(exact[-1], rel=1e-8)
    assert min(pushes) > 0.0


def test_the_bend_passes_the_verdict(bend: go.Solution) -> None:
    assert go.verify(bend).ok
