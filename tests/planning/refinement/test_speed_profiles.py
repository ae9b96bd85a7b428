"""Speeds at limits that controls reach in turn: closed forms, and the largest speed profile of a track."""

from __future__ import annotations

import math
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq
from testing.models import dynamics, one_phase

import gnc_opt as go

FORCE, BRAKE, POWER, FASTEST, WAY = 5.0, 8.0, 80.0, 40.0, 800.0
"""Per unit of mass: m/s^2, m/s^2, W/kg; m/s, m."""

DRAG, LENGTH, SLOW = 0.1, 5.0, 0.1
"""Of a train: per km, km, speed at its ends."""


def allowed(x: float) -> float:
    """Half the square of the largest speed at a place."""
    return 0.5 * (2.1 + math.cos(1.2 * x))


def least_time(cells: int = 100_000) -> float:
    """By the largest e = v^2 / 2 with e' = u - 2 DRAG e, |u| <= 1 that nowhere exceeds what is allowed."""
    step, rate = LENGTH / cells, 2 * DRAG
    decay = math.exp(-rate * step)
    gain = (1 - decay) / rate
    e = [allowed(k * step) for k in range(cells + 1)]
    e[0] = e[-1] = SLOW**2 / 2
    for k in range(cells):
        e[k + 1] = min(e[k + 1], e[k] * decay + gain)
    for k in range(cells, 0, -1):
        e[k - 1] = min(e[k - 1], (e[k] + gain) / decay)
    # e is nearly straight along a cell: dx / v integrates exactly.
    return sum(2 * step / (math.sqrt(2 * a) + math.sqrt(2 * b)) for a, b in pairwise(e))


@pytest.mark.slow
def test_a_limit_that_depends_on_the_place_is_held_with_drag() -> None:
    model, x, v, _u = dynamics("train", "x v", "u", lambda x, v, u: {x: v, v: u - DRAG * v**2})
    problem, leg = one_phase("speed limit by place", model, initial=0.0, final=(2.0, 60.0))
    leg.initial(x=0.0, v=SLOW)
    leg.final(x=LENGTH, v=SLOW)
    leg.bounds(u=(-1.0, 1.0))
    leg.path("limit", v**2 - ca.cos(1.2 * x), upper=2.1)
    problem.minimize(leg.final_time)

    solution = go.solve(problem)
    verdict = go.verify(solution)
    assert solution.converged and verdict.ok
    assert math.isclose(solution.objective, least_time(), rel_tol=1e-8)


@pytest.mark.slow
def test_another_control_helps_where_the_first_one_gives_out() -> None:
    """v - m(t) <= 1/2 with v' = a + b, |a| <= 1: b pays b^2/2 and acts on the limit only where m' > 1.

    There a comes to its bound, and leaves it, as continuously as b begins and ends: b = m' - 1 between.
    """
    model, v, _a, b = dynamics("two engines", "v", "a b", lambda v, a, b: {v: a + b})
    problem, leg = one_phase("moving limit", model, initial=0.0, final=3.5)
    leg.initial(v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    leg.path("limit", v - 0.8 * model.time + 0.25 * ca.cos(2 * (model.time - 1)), upper=0.5)
    problem.minimize(leg.integral(b**2 / 2 - v, "cost"))

    solution = go.solve(problem)

    assert solution.converged and go.verify(solution).ok
    # m' = 0.8 + sin(2 (t - 1)) / 2; before the limit, which a jumps to, b = t1 - t
    t1 = brentq(lambda t: t + t**2 / 2 - 0.5 - 0.8 * t + 0.25 * math.cos(2 * (t - 1)), 0.5, 1.0)
    steep = 0.5 * math.asin(0.4)
    ends = [arc.end for arc in solution.structure if arc.channel == "a"]
    assert np.allclose(ends, [t1, 1 + steep, 1 + 0.5 * math.pi - steep, 3.5], rtol=0.0, atol=1e-5)
    most = np.asarray(solution.phases["leg"].control("b")(1 + math.pi / 4))
    assert np.allclose(most, 0.3, rtol=0.0, atol=1e-6)
