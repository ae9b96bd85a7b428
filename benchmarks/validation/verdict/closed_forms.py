"""More closed forms and, beside each, an answer that looks like it: regulators, budgets, turnpikes, shared work."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

import gnc_opt as go
from benchmarks.validation.verdict.pairs import Answer, Pair, _arcs, _phase


def closed_forms() -> Iterator[Pair]:
    """Yield all of them."""
    loses = "something else nearby costs less"
    yield Pair("work shared by two", "both do the same, though one is dearer", 0.5, True, _shared)
    yield Pair("bang, coast, bang", "it pushes longer and with less, which costs more", 0.01, True, _coast)
    yield Pair("regulator", "it has the gain of a horizon without end", 0.01, True, _regulator)
    yield Pair("turnpike", "it swings about the stock that grows most", 0.02, True, _turnpike)
    yield Pair("first order lag in least time", "it uses 80 % of what it has", 0.5, True, _lag)
    yield Pair("decay to save", "it spends evenly, though money loses its worth", 0.02, True, _spending)
    yield Pair("damped transfer", "its effort is that of a body without damping", 0.02, True, _damped)
    yield Pair("spring at its end", "it ignores what the end costs", 0.2, True, _end_cost)
    yield Pair("price of time", "it arrives later than is worth it", 0.05, True, _price_of_time)
    yield Pair("start in a range", "it begins at the far end of the range", 1.0, True, _start_in_range)
    yield Pair("waypoint between phases", loses, 0.05, True, _waypoint)
    yield Pair("best of a parameter", "the parameter is 10 % off its best", 0.01, True, _parameter)
    yield Pair("largest final speed", "it brakes in the middle", 0.1, True, _largest)
    yield Pair(
        "saddle of a start", "the start is where the cost is largest over it", 0.1, False, _saddle_start
    )


def _shared(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = u + w over 1 in 1 s for u^2 + 4 w^2: one does four times as much as the other."""
    problem = go.Problem("work shared by two")
    leg, _, (u, w) = _phase(problem, "leg", "x", "u w", lambda x, u, w: [u + w], (0.0, 1.0))
    leg.initial(x=0.0)
    leg.final(x=unit)
    problem.minimize(cost * leg.integral(u**2 + 4.0 * w**2) / unit**2)
    t, share = np.linspace(0.0, 1.0, 11), 0.5 if wrong else 0.8
    return Answer(problem, t, [unit * t], unit * np.array([share + 0 * t, 1.0 - share + 0 * t]))


def _coast(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest over 1 in 3 s with the least fuel."""
    problem = go.Problem("bang, coast, bang")
    leg, _, (p, m) = _phase(problem, "leg", "q v", "p m", lambda q, v, p, m: [v, p - m], (0.0, 3.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=unit, v=0.0)
    leg.bounds(p=(0.0, unit), m=(0.0, unit))
    problem.minimize(cost * leg.integral(p + m) / unit)
    push = 0.8 if wrong else 1.0
    top = 0.5 * push * (3.0 - np.sqrt(9.0 - 4.0 / push))
    t, arc = _arcs(top / push, 3.0 - 2.0 * top / push, top / push)
    speed = np.minimum(np.minimum(push * t, top), push * (3.0 - t))
    way = np.where(arc == 0, 0.5 * push * t**2, np.where(arc == 2, 1.0 - 0.5 * push * (3.0 - t) ** 2, 0.0))
    way = np.where(arc == 1, 0.5 * top**2 / push + top * (t - top / push), way)
    forth, back = push * (arc == 0), push * (arc == 2)
    return Answer(problem, t, [unit * way, unit * speed], unit * np.array([forth, back]))


def _regulator(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = x + u for x^2 + u^2 over 1 s, the end free."""
    problem = go.Problem("regulator")
    leg, (x,), (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [x + u], (0.0, 1.0))
    leg.initial(x=unit)
    problem.minimize(cost * leg.integral(x**2 + u**2) / unit**2)
    t, rate = np.linspace(0.0, 1.0, 81), np.sqrt(2.0)
    if wrong:
        return Answer(problem, t, [unit * np.exp(-rate * t)], -unit * (1 + rate) * np.exp(-rate * t))
    # lambda = 2 p x with p(1) = 0: x and p x solve x' = x - y, y' = -x - y.
    left = 1.0 - t
    scale = np.cosh(rate) - np.sinh(rate) / rate
    states = (np.cosh(rate * left) - np.sinh(rate * left) / rate) / scale
    return Answer(problem, t, [unit * states], -unit * np.sinh(rate * left) / rate / scale)


def _turnpike(unit: float, cost: float, wrong: bool) -> Answer:
    """Harvest u of a stock x' = x (1 - x) - u from a half to a half: kept there, it grows most."""
    problem = go.Problem("turnpike")
    rates = lambda x, u: [x * (1.0 - x / unit) - u]  # noqa: E731
    leg, _, (u,) = _phase(problem, "leg", "x", "u", rates, (0.0, 4.0))
    leg.initial(x=0.5 * unit)
    leg.final(x=0.5 * unit)
    leg.bounds(u=(0.0, unit))
    problem.maximize(cost * leg.integral(u) / unit)
    t = np.linspace(0.0, 4.0, 161)
    swing = 0.15 * np.sin(np.pi * t / 2.0) if wrong else 0.0 * t
    slope = 0.15 * np.pi / 2.0 * np.cos(np.pi * t / 2.0) if wrong else 0.0 * t
    stock = 0.5 + swing
    return Answer(problem, t, [unit * stock], unit * (stock * (1.0 - stock) - slope))


def _lag(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = -x + u from 0 to 0.5 in the least time, |u| <= 1."""
    problem = go.Problem("lag")
    leg, _, _ = _phase(problem, "leg", "x", "u", lambda x, u: [-x + u], (0.0, (0.01, 10.0)))
    leg.initial(x=0.0)
    leg.final(x=0.5 * unit)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.final_time)
    push = 0.8 if wrong else 1.0
    t = np.linspace(0.0, np.log(push / (push - 0.5)), 41)
    return Answer(problem, t, [unit * push * (1.0 - np.exp(-t))], unit * push + 0.0 * t)


def _spending(unit: float, cost: float, wrong: bool) -> Answer:
    """Spend 1 in 2 s for the most of exp(-t) sqrt(u): u falls as exp(-2 t)."""
    problem = go.Problem("decay to save")
    leg, _, (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [-u], (0.0, 2.0))
    leg.initial(x=unit)
    leg.final(x=0.0)
    leg.bounds(u=(1e-3 * unit, 10.0 * unit))
    problem.maximize(cost * leg.integral(ca.exp(-leg.model.time) * ca.sqrt(u / unit)))
    t = np.linspace(0.0, 2.0, 81)
    rate = 2.0 * np.exp(-2.0 * t) / (1.0 - np.exp(-4.0))
    left = 1.0 - (1.0 - np.exp(-2.0 * t)) / (1.0 - np.exp(-4.0))
    if wrong:
        rate, left = 0.5 + 0.0 * t, 1.0 - 0.5 * t
    return Answer(problem, t, [unit * left], unit * rate)


def _damped(unit: float, cost: float, wrong: bool) -> Answer:
    """v' = -v + a from rest to speed 1 in 2 s: the effort grows as exp(t), not evenly."""
    problem = go.Problem("damped")
    leg, _, (a,) = _phase(problem, "leg", "v", "a", lambda v, a: [-v + a], (0.0, 2.0))
    leg.initial(v=0.0)
    leg.final(v=unit)
    problem.minimize(cost * leg.integral(a**2) / unit**2)
    t = np.linspace(0.0, 2.0, 81)
    if wrong:
        top = 1.0 / (1.0 - np.exp(-2.0))
        return Answer(problem, t, [unit * top * (1.0 - np.exp(-t))], unit * top + 0.0 * t)
    return Answer(problem, t, [unit * np.sinh(t) / np.sinh(2.0)], unit * np.exp(t) / np.sinh(2.0))


def _end_cost(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = u from 1 for u^2 over 1 s and 3 x(1)^2: it moves by 3/4."""
    problem = go.Problem("end cost")
    leg, _, (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [u], (0.0, 1.0))
    leg.initial(x=unit)
    problem.minimize(cost * (leg.integral(u**2) + 3.0 * leg.final_state("x") ** 2) / unit**2)
    t, way = np.linspace(0.0, 1.0, 11), 0.4 if wrong else 0.75
    return Answer(problem, t, [unit * (1.0 - way * t)], -unit * way + 0.0 * t)


def _price_of_time(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = u over 1 for u^2 + 1: T = 1."""
    problem = go.Problem("price of time")
    leg, _, (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [u], (0.0, (0.1, 9.0)))
    leg.initial(x=0.0)
    leg.final(x=unit)
    problem.minimize(cost * (leg.integral(u**2) / unit**2 + leg.final_time))
    last = 1.5 if wrong else 1.0
    t = np.linspace(0.0, last, 21)
    return Answer(problem, t, [unit * t / last], unit / last + 0.0 * t)


def _start_in_range(unit: float, cost: float, wrong: bool) -> Answer:
    """From anywhere between 1 and 2 to 0 in 1 s: from 1."""
    problem = go.Problem("start in a range")
    leg, _, (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [u], (0.0, 1.0))
    leg.initial(x=(unit, 2.0 * unit))
    leg.final(x=0.0)
    problem.minimize(cost * leg.integral(u**2) / unit**2)
    t, start = np.linspace(0.0, 1.0, 11), 2.0 if wrong else 1.0
    return Answer(problem, t, [unit * start * (1.0 - t)], -unit * start + 0.0 * t)


def _waypoint(unit: float, cost: float, wrong: bool) -> Answer:
    """Over 1 in 2 s, twice as dear after the linkage at 1 s: two thirds of the way before it."""
    problem, legs = go.Problem("waypoint"), []
    for name, time, price in (("cheap", (0.0, 1.0), 1.0), ("dear", (1.0, 2.0), 2.0)):
        leg, _, (u,) = _phase(problem, name, "x", "u", lambda x, u: [u], time)
        legs.append((leg, price * leg.integral(u**2)))
    (first, early), (second, late) = legs
    first.initial(x=0.0)
    second.final(x=unit)
    problem.link(first, second)
    problem.minimize(cost * (early + late) / unit**2)
    way, t = 0.5 if wrong else 2.0 / 3.0, np.linspace(0.0, 1.0, 11)
    states = {"cheap": [unit * way * t], "dear": [unit * (way + (1.0 - way) * t)]}
    controls = {"cheap": unit * way + 0.0 * t, "dear": unit * (1.0 - way) + 0.0 * t}
    return Answer(problem, {"cheap": t, "dear": 1.0 + t}, states, controls)


def _parameter(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = k u over 1 in 1 s for u^2 + k^2: u = 1 / k, k = 1."""
    problem = go.Problem("best of a parameter")
    k = problem.parameter("k", lower=0.1, upper=10.0, guess=1.0)
    model = go.Model("geared")
    x, u, gear = model.state("x"), model.control("u"), model.parameter("k", 1.0)
    model.ode({x: gear * u})
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=unit)
    problem.minimize(cost * (leg.integral(u**2) / unit**2 + k**2))
    t, best = np.linspace(0.0, 1.0, 11), 1.1 if wrong else 1.0
    return Answer(problem, t, [unit * t], unit / best + 0.0 * t, {"k": best})


def _largest(unit: float, cost: float, wrong: bool) -> Answer:
    """The largest speed after 2 s with a push of at most 1."""
    problem = go.Problem("largest final speed")
    leg, _, _ = _phase(problem, "leg", "q v", "a", lambda q, v, a: [v, a], (0.0, 2.0))
    leg.initial(q=0.0, v=0.0)
    leg.bounds(a=(-unit, unit))
    problem.maximize(cost * leg.final_state("v") / unit)
    t, arc = _arcs(0.9, 0.2, 0.9)
    push = np.where((arc == 1) & wrong, -1.0, 1.0)
    ends = np.array([0.9, 1.1])
    speed = np.where(arc == 0, t, np.where(arc == 1, 1.8 - t, t - 0.4)) if wrong else t
    way = 0.5 * t**2
    if wrong:
        at = 0.5 * ends[0] ** 2
        dip = at + 0.9 * (t - 0.9) - 0.5 * (t - 0.9) ** 2
        last = at + 0.9 * 0.2 - 0.5 * 0.04 + 0.7 * (t - 1.1) + 0.5 * (t - 1.1) ** 2
        way = np.where(arc == 0, way, np.where(arc == 1, dip, last))
    return Answer(problem, t, [unit * way, unit * speed], unit * push)


def _saddle_start(unit: float, cost: float, wrong: bool) -> Answer:
    """From anywhere between -2 and 2 to 1 in 1 s, where the start costs by its place: a hill at 0 or a hollow."""
    problem = go.Problem("saddle of a start")
    leg, _, (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [u], (0.0, 1.0))
    leg.initial(x=(-2.0 * unit, 2.0 * unit))
    leg.final(x=unit)
    bend = -1.5 if wrong else 0.5
    start = leg.initial_state("x") / unit
    # (1 - x0)^2 + bend x0^2 + 2 x0 is stationary at 0.
    problem.minimize(cost * (leg.integral(u**2) / unit**2 + bend * start**2 + 2.0 * start))
    t = np.linspace(0.0, 1.0, 11)
    return Answer(problem, t, [unit * t], unit + 0.0 * t)
