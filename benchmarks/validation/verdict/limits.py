"""Closed forms at limits of states, of paths and of ends, along a phase, at its end and at a link."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from benchmarks.validation.verdict.pairs import Answer, Pair, _arcs, _phase

_KIND = "at a limit"


def limits() -> Iterator[Pair]:
    """Yield all of them."""
    for name, why, off, make in (
        ("moving floor at a free end", "it ends above the floor", 0.01, _floor_at_end),
        ("moving floor at a free start", "it starts above the floor", 0.01, _floor_at_start),
        ("floor at a link", "it passes the link above the floor", 0.05, _floor_at_link),
        ("floor from the start", "it stays above the floor that it starts on", 0.01, _throw),
        ("limit at a given end", "it ends beyond the limit", 0.1, _given_end),
        ("string over a hill", "it follows the hill for too long", 0.005, _string),
        ("round a disc", "it keeps away from the disc by 1 %", 0.01, _disc),
        ("share of what is left", "it uses 99 % of the limit", 0.01, _share),
        ("circle of state and control", "it uses 99 % of the limit", 0.01, _circle),
        ("end in a range", "it goes farther than it must", 0.01, _end_in_range),
        ("limit that is just reached", "it keeps off a limit that does not push", 0.01, _just_reached),
        ("free start", "it begins too early", 0.05, _free_start),
        ("most height for a budget", "it keeps some of the budget", 0.02, _height),
    ):
        yield Pair(name, why, off, True, make, _KIND)


def _moved(unit: float, time: float, *names: str) -> tuple[go.Problem, go.Phase, list[Any]]:
    problem = go.Problem("moved")
    leg, (x,), (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [u], (0.0, time))
    return problem, leg, [x / unit, u / unit]


def _floor_at_end(unit: float, cost: float, wrong: bool) -> Answer:
    """From 1 with a price of 3 on the end: it would fall by 3, and the floor has sunk to 0 at the end."""
    problem, leg, (x, u) = _moved(unit, 1.0)
    leg.initial(x=unit)
    leg.path("floor", x + 0.2 * leg.model.time, lower=0.2)
    problem.minimize(cost * (leg.integral(u**2 / 2) + 3.0 * leg.final_state("x") / unit))
    t, way = np.linspace(0.0, 1.0, 21), 0.98 if wrong else 1.0
    return Answer(problem, t, [unit * (1.0 - way * t)], 0 * t - unit * way)


def _floor_at_start(unit: float, cost: float, wrong: bool) -> Answer:
    """To 1 with a price of 3 on the start: it would begin at -2, and the floor rises from 0."""
    problem, leg, (x, u) = _moved(unit, 1.0)
    leg.final(x=unit)
    leg.path("floor", x - 0.2 * leg.model.time, lower=0.0)
    problem.minimize(cost * (leg.integral(u**2 / 2) + 3.0 * leg.initial_state("x") / unit))
    t, way = np.linspace(0.0, 1.0, 21), 0.98 if wrong else 1.0
    return Answer(problem, t, [unit * (1.0 - way + way * t)], 0 * t + unit * way)


def _floor_at_link(unit: float, cost: float, wrong: bool) -> Answer:
    """Up to 1 at a link and down again: the floor 2 t - 1 is met there only."""
    problem, legs, effort = go.Problem("floor at a link"), [], 0.0
    for name, time in (("up", (0.0, 1.0)), ("down", (1.0, 2.0))):
        leg, _, (u,) = _phase(problem, name, "x", "u", lambda x, u: [u], time)
        legs.append(leg)
        effort = effort + leg.integral((u / unit) ** 2)
    up, down = legs
    up.initial(x=0.0)
    down.final(x=0.0)
    up.path("floor", up.model.symbol("x") / unit - 2.0 * up.model.time, lower=-1.0)
    problem.link(up, down)
    problem.minimize(cost * effort)
    t, top = np.linspace(0.0, 1.0, 21), 1.05 if wrong else 1.0
    states = {"up": [unit * top * t], "down": [unit * top * (1.0 - t)]}
    return Answer(
        problem, {"up": t, "down": 1.0 + t}, states, {"up": 0 * t + unit * top, "down": 0 * t - unit * top}
    )


def _throw(unit: float, cost: float, wrong: bool) -> Answer:
    """From floor to floor in 1 s under a weight of 1: thrown by itself, whatever else it could do costs."""
    problem = go.Problem("throw")
    leg, _, (a,) = _phase(problem, "leg", "h v", "a", lambda h, v, a: [v, a - unit], (0.0, 1.0))
    leg.initial(h=0.0)
    leg.final(h=0.0)
    leg.bounds(h=(0.0, None), a=(-2.0 * unit, 2.0 * unit))
    problem.minimize(cost * leg.integral(a**2) / unit**2)
    t, weight = np.linspace(0.0, 1.0, 21), 0.99 if wrong else 1.0
    return Answer(
        problem,
        t,
        [unit * weight * t * (1.0 - t) / 2.0, unit * weight * (0.5 - t)],
        0 * t + unit * (1.0 - weight),
    )


def _given_end(unit: float, cost: float, wrong: bool) -> Answer:
    """To 1 in 1 s, where a limit is 1, or 0.9."""
    problem, leg, (x, u) = _moved(unit, 1.0)
    leg.initial(x=0.0)
    leg.final(x=unit)
    leg.path("ceiling", x, upper=0.9 if wrong else 1.0)
    problem.minimize(cost * leg.integral(u**2))
    t = np.linspace(0.0, 1.0, 21)
    return Answer(problem, t, [unit * t], 0 * t + unit)


def _string(unit: float, cost: float, wrong: bool) -> Answer:
    """A taut string over the hill 1/2 - 4 (t - 1/2)^2: its tangents from (0, 0) and (1, 0) touch at sqrt(1/8)."""
    problem, leg, (x, u) = _moved(unit, 1.0)
    leg.initial(x=0.0)
    leg.final(x=0.0)
    leg.path("hill", x + 4.0 * (leg.model.time - 0.5) ** 2, lower=0.5)
    problem.minimize(cost * leg.integral(u**2))
    touch = 0.33 if wrong else np.sqrt(0.125)
    t, part = _arcs(touch, 1.0 - 2.0 * touch, touch)
    hill, slope = 0.5 - 4.0 * (t - 0.5) ** 2, (0.5 - 4.0 * (touch - 0.5) ** 2) / touch
    heights = np.choose(part, [slope * t, hill, slope * (1.0 - t)])
    return Answer(
        problem, t, [unit * heights], unit * np.choose(part, [slope + 0 * t, 4.0 - 8.0 * t, -slope + 0 * t])
    )


def _disc(unit: float, cost: float, wrong: bool) -> Answer:
    """From (-2, 0) to (2, 0) round the unit disc: a tangent, an arc, a tangent."""
    problem = go.Problem("disc")
    leg, (x, y), _ = _phase(
        problem, "leg", "x y", "h", lambda x, y, h: [unit * ca.cos(h), unit * ca.sin(h)], (0.0, (1.0, 9.0))
    )
    leg.initial(x=-2.0 * unit, y=0.0)
    leg.final(x=2.0 * unit, y=0.0)
    leg.path("disc", (x**2 + y**2) / unit**2, lower=1.0)
    problem.minimize(cost * leg.final_time)
    radius = 1.01 if wrong else 1.0
    tangent, slope = np.sqrt(4.0 - radius**2), np.arcsin(radius / 2.0)
    last = 2.0 * tangent + 2.0 * slope * radius
    t, part = _arcs(tangent, last - 2.0 * tangent, tangent)
    angle = np.pi / 2.0 + slope - (t - tangent) / radius
    along = np.choose(
        part, [t * np.cos(slope) - 2.0, radius * np.cos(angle), 2.0 - (last - t) * np.cos(slope)]
    )
    high = np.choose(part, [t * np.sin(slope), radius * np.sin(angle), (last - t) * np.sin(slope)])
    headings = np.choose(part, [slope + 0 * t, angle - np.pi / 2.0, -slope + 0 * t])
    return Answer(problem, t, [unit * along, unit * high], headings)


def _share(unit: float, cost: float, wrong: bool) -> Answer:
    """As far as possible where u + x <= 1: x = 1 - exp(-t)."""
    problem, leg, (x, u) = _moved(unit, 2.0)
    leg.initial(x=0.0)
    leg.bounds(u=(0.0, 5.0 * unit))
    leg.path("limit", u + x, upper=1.0)
    problem.maximize(cost * leg.final_state("x") / unit)
    t, used = np.linspace(0.0, 2.0, 41), 0.99 if wrong else 1.0
    return Answer(problem, t, [unit * used * (1.0 - np.exp(-t))], unit * used * np.exp(-t))


def _circle(unit: float, cost: float, wrong: bool) -> Answer:
    """As far as possible where u^2 + x^2 <= 1: x = sin t."""
    problem, leg, (x, u) = _moved(unit, 1.0)
    leg.initial(x=0.0)
    leg.path("limit", u**2 + x**2, upper=1.0)
    problem.maximize(cost * leg.final_state("x") / unit)
    t, used = np.linspace(0.0, 1.0, 41), 0.99 if wrong else 1.0
    return Answer(problem, t, [unit * used * np.sin(t)], unit * used * np.cos(t))


def _end_in_range(unit: float, cost: float, wrong: bool) -> Answer:
    """In 1 s to anywhere between 1 and 2: to 1."""
    problem, leg, (_, u) = _moved(unit, 1.0)
    leg.initial(x=0.0)
    leg.final(x=(unit, 2.0 * unit))
    problem.minimize(cost * leg.integral(u**2))
    t, end = np.linspace(0.0, 1.0, 11), 1.01 if wrong else 1.0
    return Answer(problem, t, [unit * end * t], 0 * t + unit * end)


def _just_reached(unit: float, cost: float, wrong: bool) -> Answer:
    """u^2 - 2 x(1) is least for u = 1, which is the limit."""
    problem, leg, (_, u) = _moved(unit, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * (leg.integral(u**2) - 2.0 * leg.final_state("x") / unit))
    t, push = np.linspace(0.0, 1.0, 11), 0.9 if wrong else 1.0
    return Answer(problem, t, [unit * push * t], 0 * t + unit * push)


def _free_start(unit: float, cost: float, wrong: bool) -> Answer:
    """Over 1 up to 5 s, where beginning later earns 1/4 a second: it takes 2 s."""
    problem = go.Problem("free start")
    leg, _, (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [u], ((0.0, 4.5), 5.0))
    leg.initial(x=0.0)
    leg.final(x=unit)
    problem.minimize(cost * (leg.integral(u**2) / unit**2 - 0.25 * leg.initial_time))
    takes = 2.5 if wrong else 2.0
    t = np.linspace(5.0 - takes, 5.0, 21)
    return Answer(problem, t, [unit * (t - t[0]) / takes], 0 * t + unit / takes)


def _height(unit: float, cost: float, wrong: bool) -> Answer:
    """Twice the weight for 1 s takes all of the budget, and it rises to 1 in 2 s."""
    problem = go.Problem("height")
    leg, _, (a,) = _phase(problem, "leg", "h v", "a", lambda h, v, a: [v, a - unit], (0.0, (0.1, 20.0)))
    leg.initial(h=0.0, v=0.0)
    leg.final(v=0.0)
    leg.bounds(a=(0.0, 2.0 * unit))
    problem.constrain("budget", leg.integral(a) / unit, upper=2.0)
    problem.maximize(cost * leg.final_state("h") / unit)
    burn = 0.95 if wrong else 1.0
    t, part = _arcs(burn, burn)
    rises = np.where(part == 0, t**2 / 2.0, burn**2 - (2.0 * burn - t) ** 2 / 2.0)
    speed = np.where(part == 0, t, 2.0 * burn - t)
    return Answer(problem, t, [unit * rises, unit * speed], unit * np.where(part == 0, 2.0, 0.0))
