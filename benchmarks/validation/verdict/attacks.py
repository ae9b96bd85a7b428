"""Closed forms of what strangers would try: free junctions, parameters in limits, holes in control sets."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import casadi as ca
import numpy as np
import scipy

import gnc_opt as go
from benchmarks.validation.verdict.pairs import Answer, Pair, _arcs, _phase
from benchmarks.validation.verdict.several import T, _line, _plane
from benchmarks.validation.verdict.statements import Array

_ONE = 1 + 0 * T


def attacks() -> Iterator[Pair]:
    """Yield all of them."""
    yield from itertools.starmap(
        Pair,
        (
            ("kick at a free time", "the kick comes too early", 0.1, True, _kick),
            ("junction with a price on its time", "the price is largest there", 0.5, False, _priced_junction),
            ("dearer after a free junction", "the junction is half-way in time", 0.05, True, _dearer),
            ("parameter in a path limit", "the limit is bought too high", 0.05, True, _bought_limit),
            ("parameter in a state limit", "the ceiling is bought too low", 0.04, True, _bought_ceiling),
            (
                "two budgets, one of them idle",
                "it keeps within a budget that it need not",
                0.01,
                True,
                _idle_budget,
            ),
            ("two budgets, both used", "a budget pulls instead of pushing", 0.01, True, _two_budgets),
            ("time before a turning point", "it is the dearest arrival", 0.1, False, _late_arrival),
            (
                "target that runs away",
                "the target bends away, any other time is better",
                0.1,
                False,
                _moving_target,
            ),
            ("limit of order 3 touched", "the limit pulls the flight up", 0.01, True, _third_order),
            ("control set of two pieces", "the two pieces come in the wrong order", 0.05, True, _two_pieces),
            ("annulus of controls", "it rides on the inner edge", 0.05, True, _annulus),
            ("inner edge of an annulus", "it is faster than need be", 0.05, True, _inner_edge),
            ("far away in two controls", "both reversed push twice as hard", 0.5, True, _far_away),
            ("limit with a kink in time", "it uses 98 % of the limit", 0.01, True, _kinked_limit),
            ("limit with a kink in place", "it uses 97 % of the limit", 0.02, True, _kinked_place),
            ("obstacle that flies through", "both meet between two samples", 1.0, True, _crossing),
            (
                "parameter below its best",
                "the cost falls beyond where it stays",
                0.05,
                True,
                _parameter_too_low,
            ),
            ("moved by 1e8", "it is 1 % off", 0.01, True, _far_origin),
            ("clock at 1e6 s", "it pushes unevenly", 0.01, True, _late_clock),
        ),
    )


def _kick(unit: float, cost: float, wrong: bool) -> Answer:
    """A speed of 1 is given for nothing at a time of choice: a is constant at best."""
    problem, legs, effort = go.Problem("kick"), [], 0.0
    for name, time in (("before", (0.0, (0.01, 0.99))), ("after", ((0.01, 0.99), 1.0))):
        leg, _, (a,) = _phase(problem, name, "q v", "a", lambda q, v, a: [v, a], time)
        legs.append(leg)
        effort = effort + leg.integral((a / unit) ** 2)
    one, two = legs
    one.initial(q=0.0, v=0.0)
    two.final(q=0.75 * unit, v=1.5 * unit)
    problem.constrain("time", two.initial_time - one.final_time, equals=0.0)
    problem.constrain("place", (two.initial_state("q") - one.final_state("q")) / unit, equals=0.0)
    problem.constrain("kick", (two.initial_state("v") - one.final_state("v")) / unit, equals=1.0)
    problem.minimize(cost * effort)
    when = 0.4 if wrong else 0.5
    # a = c + d t: v(1) = c + d / 2 + 1 = 3/2, q(1) = c / 2 + d / 6 + 1 - when = 3/4
    c, d = np.linalg.solve([[1.0, 0.5], [0.5, 1 / 6]], [0.5, when - 0.25])
    t, x, u = {}, {}, {}
    for name, s, kicked in (("before", when * T, 0.0), ("after", when + (1 - when) * T, 1.0)):
        t[name], u[name] = s, unit * (c + d * s)
        way = c * s**2 / 2 + d * s**3 / 6 + kicked * (s - when)
        x[name] = [unit * way, unit * (c * s + d * s**2 / 2 + kicked)]
    return Answer(problem, t, x, u)


def _priced_junction(unit: float, cost: float, wrong: bool) -> Answer:
    problem, legs, effort = go.Problem("priced junction"), [], 0.0
    for name, time in (("before", (0.0, (0.1, 0.9))), ("after", ((0.1, 0.9), 1.0))):
        leg, _, (u,) = _phase(problem, name, "x", "u", lambda x, u: [u], time)
        legs.append(leg)
        effort = effort + leg.integral((u / unit) ** 2)
    legs[0].initial(x=0.0)
    legs[1].final(x=unit)
    problem.link(*legs)
    problem.minimize(cost * (effort + (-1.0 if wrong else 1.0) * (legs[0].final_time - 0.5) ** 2))
    t = {"before": 0.5 * T, "after": 0.5 + 0.5 * T}
    return Answer(problem, t, {k: [unit * s] for k, s in t.items()}, dict.fromkeys(t, unit * _ONE))


def _dearer(unit: float, cost: float, wrong: bool) -> Answer:
    """Half of the way before a free junction, the other half four times as dear: a third of the time."""
    problem, legs, effort = go.Problem("dearer"), [], 0.0
    for name, price, time in (("before", 1.0, (0.0, (0.1, 0.9))), ("after", 4.0, ((0.1, 0.9), 1.0))):
        leg, _, (u,) = _phase(problem, name, "x", "u", lambda x, u: [u], time)
        legs.append(leg)
        effort = effort + price * leg.integral((u / unit) ** 2)
    legs[0].initial(x=0.0)
    legs[0].final(x=0.5 * unit)
    legs[1].final(x=unit)
    problem.link(*legs)
    problem.minimize(cost * effort)
    when = 0.5 if wrong else 1 / 3
    t = {"before": when * T, "after": when + (1 - when) * T}
    x = {"before": [unit * 0.5 * T], "after": [unit * (0.5 + 0.5 * T)]}
    return Answer(
        problem, t, x, {"before": unit * 0.5 / when * _ONE, "after": unit * 0.5 / (1 - when) * _ONE}
    )


def _bought_limit(unit: float, cost: float, wrong: bool) -> Answer:
    """Over 1 with u <= p for p^2 + 2 T: p = 1."""
    problem, leg, _x, u = _line(unit, (0.0, (0.1, 9.0)))
    p = problem.parameter("p", lower=0.0, upper=9.0, guess=0.5)
    leg.final(x=unit)
    leg.path("speed", u - p, upper=0.0)
    problem.minimize(cost * (p**2 + 2 * leg.final_time))
    speed = 1.2 if wrong else 1.0
    return Answer(problem, T / speed, unit * T, unit * speed * _ONE, [speed])


def _bought_ceiling(unit: float, cost: float, wrong: bool) -> Answer:
    """The most of int x in 2 s less p^2 / 2, where |u| <= 1 and x <= p: 2 p - p^2."""
    problem, leg, x, _u = _line(unit, (0.0, 2.0))
    p = problem.parameter("p", lower=0.0, upper=1.9, guess=0.5)
    leg.bounds(u=(-unit, unit))
    leg.path("ceiling", x - p, upper=0.0)
    problem.maximize(cost * (leg.integral(x) - p**2 / 2))
    height = 0.8 if wrong else 1.0
    t, arc = _arcs(height, 2 - height)
    return Answer(problem, t, unit * np.minimum(t, height), unit * (1.0 - arc), [height])


def _budgets(unit: float, cost: float, late: float) -> tuple[go.Problem, Any]:
    problem, leg, _x, u = _line(unit)
    problem.constrain("all", leg.integral(u**2), upper=1.0)
    problem.constrain("late", leg.integral(leg.model.time * u**2), upper=late)
    problem.maximize(cost * leg.final_state("x") / unit)
    return problem, leg


def _spent(late: float) -> tuple[float, float]:
    """a and b of u = 1 / (a + b t) such that int u^2 = 1 and int t u^2 = late."""

    def missed(z: Array) -> list[float]:
        a, b = z
        return [
            scipy.integrate.quad(lambda t: (a + b * t) ** -2, 0, 1)[0] - 1,
            scipy.integrate.quad(lambda t: t * (a + b * t) ** -2, 0, 1)[0] - late,
        ]

    guess = [0.8, 0.5] if late < 0.5 else [1.3, -0.5]
    a, b = scipy.optimize.fsolve(missed, guess, xtol=1e-13)
    return float(a), float(b)


def _idle_budget(unit: float, cost: float, wrong: bool) -> Answer:
    problem, _ = _budgets(unit, cost, 0.6)
    if not wrong:
        return Answer(problem, T, unit * T, unit * _ONE)
    a, b = _spent(0.4)
    return Answer(problem, T, unit * np.log1p(b / a * T) / b, unit / (a + b * T))


def _two_budgets(unit: float, cost: float, wrong: bool) -> Answer:
    late = 0.6 if wrong else 0.4
    problem, _ = _budgets(unit, cost, late)
    a, b = _spent(late)
    return Answer(problem, T, unit * np.log1p(b / a * T) / b, unit / (a + b * T))


def _late_arrival(unit: float, cost: float, wrong: bool) -> Answer:
    """u^2 - x^2 + 2 over any time to 1: x = sqrt(2) sin t; 1 is passed on the way up and on the way down."""
    problem, leg, x, u = _line(unit, (0.0, (0.1, 3.0)))
    leg.final(x=unit)
    problem.minimize(cost * leg.integral(u**2 - x**2 + 2))
    t = (0.75 if wrong else 0.25) * np.pi * T
    return Answer(problem, t, unit * np.sqrt(2) * np.sin(t), unit * np.sqrt(2) * np.cos(t))


def _moving_target(unit: float, cost: float, wrong: bool) -> Answer:
    """A target at 2 + s + bend s^2, s = T - 1: its square over T is stationary at 1, bend -1/4 decides."""
    problem, leg, _x, u = _line(unit, (0.0, (0.2, 3.0)))
    s = leg.final_time - 1
    bend = -0.6 if wrong else 0.1
    problem.constrain("met", leg.final_state("x") / unit - (2 + s + bend * s**2), equals=0.0)
    problem.minimize(cost * leg.integral(u**2))
    return Answer(problem, T, unit * 2 * T, unit * 2 * _ONE)


def _third_order(unit: float, cost: float, wrong: bool) -> Answer:
    """x''' = u from x = 0, v = 1 back to x = 0, v = -1, curvature 0 at both ends, below a ceiling: touched at 1/2."""
    t, _ = _arcs(0.5, 0.5)
    late = np.maximum(t - 0.5, 0.0)
    # u = c0 + c1 t + c2 t^2 + e (t - 1/2)^2: a, v, x at 1, and x at 1/2
    rows = np.array(
        [[1, 1 / 2, 1 / 3, 1 / 24], [1 / 2, 1 / 6, 1 / 12, 1 / 192], [1 / 6, 1 / 24, 1 / 60, 1 / 1920]]
    )
    middle = [1 / 48, 1 / 384, 1 / 1920, 0.0]
    free = np.linalg.solve(rows[:, :3], [0.0, -2.0, -1.0])
    height = 0.5 + np.dot(middle[:3], free) + (0.02 if wrong else -0.02)
    c0, c1, c2, e = np.linalg.solve(np.vstack([rows, middle]), [0.0, -2.0, -1.0, height - 0.5])
    u = c0 + c1 * t + c2 * t**2 + e * late**2
    a = c0 * t + c1 * t**2 / 2 + c2 * t**3 / 3 + e * late**3 / 3
    v = 1 + c0 * t**2 / 2 + c1 * t**3 / 6 + c2 * t**4 / 12 + e * late**4 / 12
    x = t + c0 * t**3 / 6 + c1 * t**4 / 24 + c2 * t**5 / 60 + e * late**5 / 60
    problem = go.Problem("third order")
    leg, _, (push,) = _phase(problem, "leg", "x v a", "u", lambda x, v, a, u: [v, a, u], (0.0, 1.0))
    leg.initial(x=0.0, v=unit, a=0.0)
    leg.final(x=0.0, v=-unit, a=0.0)
    leg.bounds(x=(None, unit * height))
    problem.minimize(cost * leg.integral((push / unit) ** 2))
    return Answer(problem, t, [unit * x, unit * v, unit * a], unit * u)


def _two_pieces(unit: float, cost: float, wrong: bool) -> Answer:
    """|u| >= 1 to 1/2 in 1 s, as low as possible on the way: first down, then up."""
    problem, leg, x, u = _line(unit)
    leg.final(x=0.5 * unit)
    leg.bounds(u=(-2 * unit, 2 * unit))
    leg.path("pieces", u**2, lower=1.0)
    problem.minimize(cost * leg.integral(u**2 + 0.1 * x))
    if wrong:
        t, arc = _arcs(0.75, 0.25)
        return Answer(problem, t, unit * np.where(arc == 0, t, 1.5 - t), unit * np.where(arc == 0, 1.0, -1.0))
    t, arc = _arcs(0.25, 0.75)
    return Answer(problem, t, unit * np.where(arc == 0, -t, t - 0.5), unit * np.where(arc == 0, -1.0, 1.0))


def _in_annulus(unit: float, cost: float, price: float, speed: float) -> Answer:
    problem, leg, _, (u, w) = _plane(unit, (0.0, (0.1, 9.0)))
    leg.final(x=3 * unit, y=0.0)
    leg.path("annulus", u**2 + w**2, lower=1.0, upper=4.0)
    problem.minimize(cost * (leg.integral(u**2 + w**2) + price * leg.final_time))
    return Answer(problem, 3 / speed * T, [unit * 3 * T, 0 * T], [unit * speed * _ONE, 0 * T])


def _annulus(unit: float, cost: float, wrong: bool) -> Answer:
    return _in_annulus(unit, cost, 2.25, 1.0 if wrong else 1.5)


def _inner_edge(unit: float, cost: float, wrong: bool) -> Answer:
    return _in_annulus(unit, cost, 0.25, 1.2 if wrong else 1.0)


def _far_away(unit: float, cost: float, wrong: bool) -> Answer:
    """As far as possible with r cos h, -2 <= r <= 1: backwards and turned round."""
    problem = go.Problem("far away")
    leg, _, (_r, h) = _phase(problem, "leg", "x", "r h", lambda x, r, h: [r * ca.cos(h)], (0.0, 1.0))
    leg.initial(x=0.0)
    leg.bounds(r=(-2 * unit, unit), h=(-4.0, 4.0))
    problem.maximize(cost * (leg.final_state("x") / unit - leg.integral(0.001 * h)))
    sin = 0.001 / (1.0 if wrong else 2.0)
    turn = -np.arcsin(sin) if wrong else -np.pi + 0.0
    if not wrong:  # -2 cos h - 0.001 h is largest near -pi: 2 sin h = 0.001
        turn = -np.pi - np.arcsin(sin)
    r = 1.0 if wrong else -2.0
    return Answer(problem, T, unit * r * np.cos(turn) * T, [unit * r * _ONE, turn * _ONE])


def _kinked_limit(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = _line(unit)
    leg.path("limit", u - ca.fabs(leg.model.time - 0.5), upper=1.0)
    problem.maximize(cost * leg.final_state("x") / unit)
    t, share = np.linspace(0.0, 1.0, 61), 0.98 if wrong else 1.0
    s = t - 0.5
    return Answer(problem, t, unit * share * (t + s * np.abs(s) / 2 + 0.125), unit * share * (1 + np.abs(s)))


def _kinked_place(unit: float, cost: float, wrong: bool) -> Answer:
    """From 0 to 1 with u <= 1 - |x - 1/2| in the least time: 2 log 2."""
    problem, leg, x, u = _line(unit, (0.0, (0.1, 9.0)))
    leg.final(x=unit)
    leg.path("limit", u + ca.fabs(x - 0.5), upper=1.0)
    problem.minimize(cost * leg.final_time)
    share = 0.97 if wrong else 1.0
    t, arc = _arcs(np.log(2) / share, np.log(2) / share)
    x = np.where(arc == 0, (np.exp(share * t) - 1) / 2, 1.5 - np.exp(2 * np.log(2) - share * t) / 2)
    return Answer(problem, t, unit * x, unit * share * (1 - np.abs(x - 0.5)))


def _crossing(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, (x, y), (u, w) = _plane(unit)
    leg.final(x=unit, y=0.0)
    when = 0.5085 if wrong else 0.7085
    leg.path("apart", (x - 0.5) ** 2 + (y - 400 * (leg.model.time - when)) ** 2, lower=0.01)
    problem.minimize(cost * leg.integral(u**2 + w**2))
    return Answer(problem, T, [unit * T, 0 * T], [unit * _ONE, 0 * T])


def _parameter_too_low(unit: float, cost: float, wrong: bool) -> Answer:
    """As the bought limit, with p up to 0.8, where it stays, or up to 1.3, with p at 0.8."""
    problem, leg, _x, u = _line(unit, (0.0, (0.1, 9.0)))
    p = problem.parameter("p", lower=0.8 if wrong else 0.0, upper=1.3 if wrong else 0.8, guess=0.5)
    leg.final(x=unit)
    leg.path("speed", u - p, upper=0.0)
    problem.minimize(cost * (p**2 + 2 * leg.final_time))
    return Answer(problem, T / 0.8, unit * T, unit * 0.8 * _ONE, [0.8])


def _far_origin(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest over 1 in 1 s, 1e8 away from the origin, where a float ends at 1e-8."""
    problem, far = go.Problem("far origin"), 1e8 * unit
    leg, _, (a,) = _phase(problem, "leg", "q v", "a", lambda q, v, a: [v, a], (0.0, 1.0))
    leg.initial(q=far, v=0.0)
    leg.final(q=far + unit, v=0.0)
    problem.minimize(cost * leg.integral((a / unit) ** 2))
    bend = 0.3 if wrong else 0.0
    q = 3 * T**2 - 2 * T**3 + bend * T**2 * (1 - T) ** 2
    v = 6 * T - 6 * T**2 + bend * (2 * T - 6 * T**2 + 4 * T**3)
    return Answer(
        problem, T, [far + unit * q, unit * v], unit * (6 - 12 * T + bend * (2 - 12 * T + 12 * T**2))
    )


def _late_clock(unit: float, cost: float, wrong: bool) -> Answer:
    problem = go.Problem("late clock")
    leg, _, (a,) = _phase(problem, "leg", "q v", "a", lambda q, v, a: [v, a], (1e6, (1e6 + 0.1, 1e6 + 9)))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=unit, v=0.0)
    # 12 / T^3 + 36 T is least for T = 1
    problem.minimize(cost * (leg.integral((a / unit) ** 2) + 36 * leg.duration))
    bend = 0.3 if wrong else 0.0
    q = 3 * T**2 - 2 * T**3 + bend * T**2 * (1 - T) ** 2
    v = 6 * T - 6 * T**2 + bend * (2 * T - 6 * T**2 + 4 * T**3)
    return Answer(
        problem, 1e6 + T, [unit * q, unit * v], unit * (6 - 12 * T + bend * (2 - 12 * T + 12 * T**2))
    )
