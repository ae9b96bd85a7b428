"""Closed forms of shapes that are seldom: laws as paths, saddles over what phases share, tables that bend the way."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import starmap

import casadi as ca
import numpy as np
import scipy

import gnc_opt as go
from benchmarks.validation.verdict.pairs import Answer, Pair, Rates, _arcs, _phase
from benchmarks.validation.verdict.several import T, _line

_ONE = np.ones(T.size)


def uncommon() -> Iterator[Pair]:
    """Yield all of them."""
    yield from starmap(
        Pair,
        (
            ("law as a path, its gain is free", "the gain is 10 % off", 0.01, True, _law),
            (
                "square of the place between phases",
                "a place where the effort is largest",
                0.5,
                False,
                _square_between,
            ),
            ("sine of a given square", "a whole sine is a saddle", 3.0, False, _sine),
            ("two mixed limits in turn", "it uses 97 % of the second", 0.01, True, _in_turn),
            ("speed by a table that bends the way", "it goes straight", 0.1, True, _mirage),
            ("dwelling where it is fastest", "it dwells beside it", 0.01, True, _dwelling),
            ("round a sphere as a path", "the long way round", 1.0, False, _sphere),
            ("both ends of choice", "together they are a saddle", np.inf, False, _both_ends),
            ("two parameters", "together they are a saddle", np.inf, False, _two_parameters),
            ("place and time of a link", "together they are a saddle", 0.1, False, _place_and_time),
            ("reinvestment", "it stops investing 0.1 s too early", 0.005, True, _reinvestment),
            ("heading with two wells", "the better one is half a turn away", 0.9, True, _two_headings),
            ("ceiling that waves", "it keeps 1 % below", 0.01, True, _waving),
            ("throw with the least speed", "at 55 degrees", 0.05, True, _throw),
        ),
    )


def _law(unit: float, cost: float, wrong: bool) -> Answer:
    """u = -p x for 2 s: (1 + p^2) (1 - e^(-4 p)) / (2 p)."""
    problem, leg, x, u = _line(unit, (0.0, 2.0))
    leg.initial(x=unit)
    p = problem.parameter("p", lower=0.01, upper=9.0, guess=1.0)
    leg.path("law", u + p * x, equals=0.0)
    problem.minimize(cost * leg.integral(x**2 + u**2))

    def slope(p: float) -> float:
        lost = np.exp(-4 * p)
        return (p**2 - 1) / (2 * p**2) * (1 - lost) + 2 * (1 + p**2) / p * lost

    gain = scipy.optimize.brentq(slope, 0.5, 2.0, xtol=1e-14) * (1.1 if wrong else 1.0)
    t = np.linspace(0.0, 2.0, 121)
    way = unit * np.exp(-gain * t)
    return Answer(problem, t, way, -gain * way, [gain])


def _two_lines(unit: float, *times: tuple) -> tuple:
    problem, legs, effort = go.Problem("two"), [], 0.0
    for name, time in zip(("one", "two"), times, strict=True):
        leg, _, (u,) = _phase(problem, name, "x", "u", lambda x, u: [u], time)
        legs.append(leg)
        effort = effort + leg.integral((u / unit) ** 2)
    return problem, *legs, effort


def _square_between(unit: float, cost: float, wrong: bool) -> Answer:
    """From 0.1 to m in 1 s, from m^2 to 4 in another."""
    problem, one, two, effort = _two_lines(unit, (0.0, 1.0), (1.0, 2.0))
    one.initial(x=0.1 * unit)
    two.final(x=4.0 * unit)
    problem.constrain(
        "square", two.initial_state("x") / unit - (one.final_state("x") / unit) ** 2, equals=0.0
    )
    problem.minimize(cost * effort)
    between = (-0.5, 0.5) if wrong else (1.0, 3.0)
    m = scipy.optimize.brentq(lambda m: 2 * (m - 0.1) - 4 * m * (4 - m**2), *between, xtol=1e-14)
    states = {"one": unit * (0.1 + (m - 0.1) * T), "two": unit * (m**2 + (4 - m**2) * T)}
    controls = {"one": unit * (m - 0.1) * _ONE, "two": unit * (4 - m**2) * _ONE}
    return Answer(problem, {"one": T, "two": 1 + T}, states, controls)


def _sine(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, x, u = _line(unit)
    leg.final(x=0.0)
    problem.constrain("square", leg.integral(x**2), equals=1.0)
    problem.minimize(cost * leg.integral(u**2))
    k, size = 2 * np.pi if wrong else np.pi, np.sqrt(2) * unit
    return Answer(problem, T, size * np.sin(k * T), size * k * np.cos(k * T))


def _in_turn(unit: float, cost: float, wrong: bool) -> Answer:
    """As far as possible with u <= 1, then u <= 2 - 2 x."""
    problem, leg, x, u = _line(unit)
    leg.bounds(u=(0.0, unit))
    leg.path("late", u + 2 * x, upper=2.0)
    problem.maximize(cost * leg.final_state("x") / unit)
    share = 0.97 if wrong else 1.0
    t, arc = _arcs(0.5, 0.5)
    way = np.where(arc == 0, t, 1 - 0.5 * np.exp(-2 * share * (t - 0.5)))
    return Answer(problem, t, unit * way, unit * np.where(arc == 0, 1.0, 2 * share * (1 - way)))


def _mirage(unit: float, cost: float, wrong: bool) -> Answer:
    """Least time where the speed grows as 1 + y: an arc of a circle about (1, -1)."""
    grid = np.linspace(-3.0, 5.0, 17)
    speed = go.table(grid, 1 + grid, name="speed")
    problem = go.Problem("mirage")

    def rates(x, y, h):  # type: ignore[no-untyped-def]
        pace = unit * speed(y / unit)
        return [pace * ca.cos(h), pace * ca.sin(h)]

    leg, _, _ = _phase(problem, "leg", "x y", "h", rates, (0.0, (0.1, 9.0)))
    leg.initial(x=0.0, y=0.0)
    leg.final(x=2 * unit, y=0.0)
    problem.minimize(cost * leg.final_time)
    if wrong:
        return Answer(problem, 2 * T, [unit * 2 * T, 0 * T], 0 * T)
    half = np.tan(np.pi / 8)
    t = -2 * np.log(half) * T
    angle = 2 * np.arctan(half * np.exp(t))
    way = [1 - np.sqrt(2) * np.cos(angle), np.sqrt(2) * np.sin(angle) - 1]
    return Answer(problem, t, unit * np.array(way), np.pi / 2 - angle)


def _dwelling(unit: float, cost: float, wrong: bool) -> Answer:
    """y' = 1 / (1 + x^2) from x = 1 to x = 1 over 5: along x = 0."""
    problem = go.Problem("dwelling")
    rates: Rates = lambda x, y, u: [u, unit / (1 + (x / unit) ** 2)]  # noqa: E731
    leg, _, _ = _phase(problem, "leg", "x y", "u", rates, (0.0, (0.1, 20.0)))
    leg.initial(x=unit, y=0.0)
    leg.final(x=unit, y=5.0 * unit)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.final_time)
    b = 0.1 if wrong else 0.0
    side = np.arctan(1.0) - np.arctan(b)
    middle = (5.0 - 2 * side) * (1 + b**2)
    t, arc = _arcs(1 - b, middle, 1 - b)
    x = np.choose(arc, [1 - t, b + 0 * t, 2 * b - 1 + t - middle])
    y = np.choose(
        arc, [np.pi / 4 - np.arctan(x), side + (t - 1 + b) / (1 + b**2), 5.0 - np.pi / 4 + np.arctan(x)]
    )
    return Answer(problem, t, [unit * x, unit * y], unit * np.choose(arc, [-1.0, 0.0, 1.0]))


def _sphere(unit: float, cost: float, wrong: bool) -> Answer:
    problem = go.Problem("sphere")
    rates: Rates = lambda x, y, z, u, v, w: [u, v, w]  # noqa: E731
    leg, (x, y, z), (u, v, w) = _phase(problem, "leg", "x y z", "u v w", rates, (0.0, 1.0))
    turn = (1.5 if wrong else 0.8) * np.pi
    leg.initial(x=unit, y=0.0, z=0.0)
    leg.final(x=unit * float(np.cos(turn)), y=unit * float(np.sin(turn)), z=0.0)
    leg.path("sphere", (x**2 + y**2 + z**2) / unit**2, equals=1.0)
    problem.minimize(cost * leg.integral((u**2 + v**2 + w**2) / unit**2))
    c, s = np.cos(turn * T), np.sin(turn * T)
    return Answer(problem, T, unit * np.array([c, s, 0 * T]), unit * turn * np.array([-s, c, 0 * T]))


def _both_ends(unit: float, cost: float, wrong: bool) -> Answer:
    """Stationary from 0 to 1; a product of both outweighs their squares, or not."""
    problem = go.Problem("ends")
    leg, _, (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [u], (0.0, 1.0))
    a, b = leg.initial_state("x") / unit, leg.final_state("x") / unit - 1
    price = a**2 + b**2 + (7.0 if wrong else 1.0) * a * b
    problem.minimize(cost * (leg.integral((u / unit - 1) ** 2) + price))
    return Answer(problem, T, unit * T, unit * _ONE)


def _two_parameters(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = _line(unit)
    leg.final(x=unit)
    p, r = (problem.parameter(name, lower=-9.0, upper=9.0, guess=0.3) for name in ("p", "r"))
    price = (p - 1) ** 2 / 2 + r**2 + (3.5 if wrong else 1.0) * (p - 1) * r
    problem.minimize(cost * (leg.integral((u - p) ** 2) + price))
    return Answer(problem, T, unit * T, unit * _ONE, [1.0, 0.0])


def _place_and_time(unit: float, cost: float, wrong: bool) -> Answer:
    problem, one, two, effort = _two_lines(unit, (0.0, (0.1, 1.9)), ((0.1, 1.9), 2.0))
    one.initial(x=0.0)
    two.final(x=unit)
    problem.link(one, two)
    off = (one.final_state("x") / unit - 0.5) * (one.final_time - 1)
    problem.minimize(cost * (effort + (6.0 if wrong else 0.5) * off))
    t = {"one": T, "two": 1 + T}
    return Answer(problem, t, {k: 0.5 * unit * s for k, s in t.items()}, dict.fromkeys(t, 0.5 * unit * _ONE))


def _reinvestment(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = u x and most of (1 - u) x in 3 s: all is invested until 1 s before the end."""
    problem = go.Problem("reinvestment")
    leg, (x,), (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [u * x], (0.0, 3.0))
    leg.initial(x=unit)
    leg.bounds(u=(0.0, 1.0))
    problem.maximize(cost * leg.integral((1 - u) * x / unit))
    last = 1.9 if wrong else 2.0
    t, arc = _arcs(last, 3 - last)
    return Answer(problem, t, unit * np.exp(np.minimum(t, last)), 1.0 - arc)


def _two_headings(unit: float, cost: float, wrong: bool) -> Answer:
    """Speeds of 1.1 at 0 and 2.1 at 180 degrees, each the best of those beside it."""
    problem = go.Problem("headings")

    def rates(x, h):  # type: ignore[no-untyped-def]
        angle = np.pi / 180 * h
        return [unit * (1 + 0.6 * ca.cos(2 * angle) - 0.5 * ca.cos(angle))]

    leg, _, _ = _phase(problem, "leg", "x", "h", rates, (0.0, (0.1, 9.0)))
    leg.initial(x=0.0)
    leg.final(x=unit)
    problem.minimize(cost * leg.final_time)
    heading, speed = (0.0, 1.1) if wrong else (180.0, 2.1)
    return Answer(problem, T / speed, unit * T, heading * _ONE)


def _waving(unit: float, cost: float, wrong: bool) -> Answer:
    """As high as possible below 0.3 + sin(3 t) / 2 with |u| <= 2."""
    problem, leg, x, _u = _line(unit, (0.0, 2.0))
    leg.bounds(u=(-2 * unit, 2 * unit))
    leg.path("ceiling", x - 0.5 * ca.sin(3 * leg.model.time), upper=0.3)
    problem.maximize(cost * leg.integral(x))
    height = 0.29 if wrong else 0.3
    meet = scipy.optimize.brentq(lambda t: 2 * t - height - 0.5 * np.sin(3 * t), 0.01, 0.6, xtol=1e-14)
    t = np.concatenate([np.linspace(0, meet, 21), np.linspace(meet, 2.0, 161)])
    on = np.arange(t.size) > 20
    way = np.where(on, height + 0.5 * np.sin(3 * t), 2 * t)
    return Answer(problem, t, unit * way, unit * np.where(on, 1.5 * np.cos(3 * t), 2.0))


def _throw(unit: float, cost: float, wrong: bool) -> Answer:
    problem = go.Problem("throw")
    rates: Rates = lambda x, y, v, w: [v, w, 0 * v, 0 * w - unit]  # noqa: E731
    leg, _, _ = _phase(problem, "leg", "x y v w", "", rates, (0.0, (0.1, 9.0)))
    leg.initial(x=0.0, y=0.0)
    leg.final(x=unit, y=0.0)
    v, w = (leg.initial_state(name) / unit for name in ("v", "w"))
    problem.minimize(cost * (v**2 + w**2))
    angle = np.radians(55 if wrong else 45)
    v, w = np.array([np.cos(angle), np.sin(angle)]) / np.sqrt(np.sin(2 * angle))
    t = 2 * w * T
    return Answer(
        problem, t, unit * np.array([v * t, w * t - t**2 / 2, v * _ONE, w - t]), np.zeros((0, T.size))
    )
