"""Closed forms with free parameters, and with sets of controls: cones, annuli, unit vectors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import scipy

import gnc_opt as go
from benchmarks.validation.verdict.answers import (
    ONE,
    Answer,
    Pairs,
    T,
    arcs,
    line,
    one_phase,
    one_push_each_way,
    plane,
    rest_to_rest,
)

PAIRS = Pairs()


def _with_parameter(
    unit: float, cost: float, lower: float, upper: float, price: Callable[[Any], Any], k: float
) -> Answer:
    """From 0 to 1 in 1 s with x' = u + k."""
    problem = go.Problem("parameter")
    free = problem.parameter("k", lower=lower * unit, upper=upper * unit, guess=0.0)
    model = go.Model("drift")
    x, u, drift = model.state("x"), model.control("u"), model.parameter("k", 0.0)
    model.ode({x: u + drift})
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=unit)
    problem.minimize(cost * (leg.integral(0.5 * (u / unit) ** 2) + price(free / unit)))
    t = np.linspace(0.0, 1.0, 21)
    return Answer(problem, t, unit * t, 0 * t + unit * (1 - k), [k * unit])


@PAIRS.add("free parameter", "the cost is largest over the parameter", 0.5, first_order=False)
def _free_parameter(unit: float, cost: float, wrong: bool) -> Answer:
    """(1 - k)^2 / 2 + bend (k - 1/2)^2 + k / 2 is stationary at k = 1/2."""
    bend = -2.0 if wrong else 2.0
    return _with_parameter(unit, cost, -3.0, 3.0, lambda k: bend * (k - 0.5) ** 2 + 0.5 * k, 0.5)


@PAIRS.add("parameter on its bound", "the cost falls away from the bound", 1.0)
def _bounded_parameter(unit: float, cost: float, wrong: bool) -> Answer:
    return _with_parameter(unit, cost, 0.0, 2.0 if wrong else 0.5, lambda k: 0 * k, 2.0 if wrong else 0.5)


@PAIRS.add("best of a parameter", "the parameter is 10 % off its best", 0.01)
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


@PAIRS.add("end that a parameter moves", "the parameter is 20 % off", 0.05)
def _moved_end(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = line(unit)
    s = problem.parameter("s", lower=-9.0, upper=9.0, guess=0.5)
    problem.constrain("end", leg.final_state("x") / unit - s, equals=0.0)
    problem.minimize(cost * (leg.integral(u**2) + (s - 2) ** 2))
    value = 0.8 if wrong else 1.0
    return Answer(problem, T, unit * value * T, unit * value + 0 * T, [value])


@PAIRS.add("nearest of a circle by its angle", "it is the farthest", 1.0, first_order=False)
def _circle_angle(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _, (u, w) = plane(unit)
    angle = problem.parameter("angle", lower=-9.0, upper=9.0, guess=0.5)
    problem.constrain("x", leg.final_state("x") / unit - 3 - ca.cos(angle), equals=0.0)
    problem.constrain("y", leg.final_state("y") / unit - 1 - ca.sin(angle), equals=0.0)
    problem.minimize(cost * leg.integral(u**2 + w**2))
    value = np.arctan2(1, 3) + (0.0 if wrong else np.pi)
    end = np.array([3 + np.cos(value), 1 + np.sin(value)]) * unit
    return Answer(problem, T, np.outer(end, T), np.outer(end, 1 + 0 * T), [value])


@PAIRS.add("unit vector", "it goes round a corner", 0.1)
def _unit_vector(unit: float, cost: float, wrong: bool) -> Answer:
    rates = lambda x, y, c, s: [unit * c, unit * s]  # noqa: E731
    problem, leg, _, (c, s) = one_phase("unit vector", "x y", "c s", rates, (0.0, (0.1, 20.0)))
    leg.initial(x=0.0, y=0.0)
    leg.final(x=3 * unit, y=4 * unit)
    leg.path("unit", c**2 + s**2, equals=1.0)
    problem.minimize(cost * leg.final_time)
    if wrong:
        t, arc = arcs(3.0, 4.0)
        way = [unit * np.minimum(t, 3.0), unit * np.maximum(t - 3, 0)]
        return Answer(problem, t, way, [1.0 - arc, 1.0 * arc])
    t = 5 * T
    return Answer(problem, t, [unit * 0.6 * t, unit * 0.8 * t], [0.6 + 0 * t, 0.8 + 0 * t])


@PAIRS.add("limit that falls in time", "it uses 98 % of the limit", 0.01)
def _falling_limit(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = line(unit)
    leg.path("limit", u + ca.tanh(20 * (leg.model.time - 0.5)), upper=2.0)
    problem.maximize(cost * leg.final_state("x") / unit)
    t = np.linspace(0.0, 1.0, 401)
    share = 0.98 if wrong else 1.0
    log = lambda s: np.logaddexp(s, -s)  # noqa: E731
    way = 2 * t - (log(20 * (t - 0.5)) - log(-10.0)) / 20
    return Answer(problem, t, unit * share * way, unit * share * (2 - np.tanh(20 * (t - 0.5))))


@PAIRS.add("cone of thrust", "it pushes more than the cone asks for", 0.2)
def _cone(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _, (w, u) = one_phase("cone", "x z", "w u", lambda x, z, w, u: [w, u - unit], (0.0, 1.0))
    leg.initial(x=0.0, z=0.0)
    leg.final(x=unit)
    leg.path("right", (w - 0.5 * u) / unit, upper=0.0)
    leg.path("left", (-w - 0.5 * u) / unit, upper=0.0)
    problem.minimize(cost * leg.integral((u / unit) ** 2))
    push = 2.3 if wrong else 2.0
    return Answer(problem, T, [unit * T, unit * (push - 1) * T], [unit + 0 * T, unit * push + 0 * T])


@PAIRS.add("parameter in a path limit", "the limit is bought too high", 0.05)
def _bought_limit(unit: float, cost: float, wrong: bool) -> Answer:
    """Over 1 with u <= p for p^2 + 2 T: p = 1."""
    return _at_bought_speed(unit, cost, (0.0, 9.0), 1.2 if wrong else 1.0)


def _at_bought_speed(unit: float, cost: float, bounds: tuple[float, float], speed: float) -> Answer:
    problem, leg, _x, u = line(unit, (0.0, (0.1, 9.0)), end=1.0)
    p = problem.parameter("p", lower=bounds[0], upper=bounds[1], guess=0.5)
    leg.path("speed", u - p, upper=0.0)
    problem.minimize(cost * (p**2 + 2 * leg.final_time))
    return Answer(problem, T / speed, unit * T, unit * speed * ONE, [speed])


@PAIRS.add("parameter in a state limit", "the ceiling is bought too low", 0.04)
def _bought_ceiling(unit: float, cost: float, wrong: bool) -> Answer:
    """The most of int x in 2 s less p^2 / 2, where |u| <= 1 and x <= p: 2 p - p^2."""
    problem, leg, x, _u = line(unit, (0.0, 2.0))
    p = problem.parameter("p", lower=0.0, upper=1.9, guess=0.5)
    leg.bounds(u=(-unit, unit))
    leg.path("ceiling", x - p, upper=0.0)
    problem.maximize(cost * (leg.integral(x) - p**2 / 2))
    height = 0.8 if wrong else 1.0
    t, arc = arcs(height, 2 - height)
    return Answer(problem, t, unit * np.minimum(t, height), unit * (1.0 - arc), [height])


@PAIRS.add("control set of two pieces", "the two pieces come in the wrong order", 0.05)
def _two_pieces(unit: float, cost: float, wrong: bool) -> Answer:
    """|u| >= 1 to 1/2 in 1 s, as low as possible on the way: first down, then up."""
    problem, leg, x, u = line(unit, end=0.5)
    leg.bounds(u=(-2 * unit, 2 * unit))
    leg.path("pieces", u**2, lower=1.0)
    problem.minimize(cost * leg.integral(u**2 + 0.1 * x))
    if wrong:
        t, arc = arcs(0.75, 0.25)
        return Answer(problem, t, unit * np.where(arc == 0, t, 1.5 - t), unit * np.where(arc == 0, 1.0, -1.0))
    t, arc = arcs(0.25, 0.75)
    return Answer(problem, t, unit * np.where(arc == 0, -t, t - 0.5), unit * np.where(arc == 0, -1.0, 1.0))


def _in_annulus(unit: float, cost: float, price: float, speed: float) -> Answer:
    problem, leg, _, (u, w) = plane(unit, (0.0, (0.1, 9.0)), end=(3.0, 0.0))
    leg.path("annulus", u**2 + w**2, lower=1.0, upper=4.0)
    problem.minimize(cost * (leg.integral(u**2 + w**2) + price * leg.final_time))
    return Answer(problem, 3 / speed * T, [unit * 3 * T, 0 * T], [unit * speed * ONE, 0 * T])


@PAIRS.add("annulus of controls", "it rides on the inner edge", 0.05)
def _annulus(unit: float, cost: float, wrong: bool) -> Answer:
    return _in_annulus(unit, cost, 2.25, 1.0 if wrong else 1.5)


@PAIRS.add("inner edge of an annulus", "it is faster than need be", 0.05)
def _inner_edge(unit: float, cost: float, wrong: bool) -> Answer:
    return _in_annulus(unit, cost, 0.25, 1.2 if wrong else 1.0)


@PAIRS.add("limit with a kink in time", "it uses 98 % of the limit", 0.01)
def _kinked_limit(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = line(unit)
    leg.path("limit", u - ca.fabs(leg.model.time - 0.5), upper=1.0)
    problem.maximize(cost * leg.final_state("x") / unit)
    t, share = np.linspace(0.0, 1.0, 61), 0.98 if wrong else 1.0
    s = t - 0.5
    return Answer(problem, t, unit * share * (t + s * np.abs(s) / 2 + 0.125), unit * share * (1 + np.abs(s)))


@PAIRS.add("parameter below its best", "the cost falls beyond where it stays", 0.05)
def _parameter_too_low(unit: float, cost: float, wrong: bool) -> Answer:
    """As the bought limit, with p up to 0.8, where it stays, or up to 1.3, with p at 0.8."""
    return _at_bought_speed(unit, cost, (0.8, 1.3) if wrong else (0.0, 0.8), 0.8)


@PAIRS.add("thrust through zero below a norm", "it pushes as hard as it may", 0.1)
def _through_zero(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest over 1 in 1 s for int a^2, |a| <= 10, as a root: the push passes through zero half-way."""
    rates = lambda x, y, v, w, a, b: [v, w, a, b]  # noqa: E731
    problem, leg, _, (a, b) = one_phase("through zero", "x y v w", "a b", rates, (0.0, 1.0))
    leg.initial(x=0.0, y=0.0, v=0.0, w=0.0)
    leg.final(x=unit, y=0.0, v=0.0, w=0.0)
    leg.path("norm", ca.sqrt(a**2 + b**2) / unit, upper=10.0)
    problem.minimize(cost * leg.integral((a**2 + b**2) / unit**2))
    t, x, v, push = one_push_each_way() if wrong else (T, *rest_to_rest())
    return Answer(problem, t, [unit * x, 0 * t, unit * v, 0 * t], [unit * push, 0 * t])


@PAIRS.add("nothing to do, two prices", "one price is paid for nothing", 0.5)
def _idle_prices(unit: float, cost: float, wrong: bool) -> Answer:
    """Nothing need be done: the control is zero, and both parameters are at limits."""
    problem, leg, _x, u = line(unit)
    p, q = (problem.parameter(n, lower=0.0, upper=1.0, guess=0.5) for n in "pq")
    leg.final(x=0.0)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * (leg.integral(u**2) + p - q + p * q))
    return Answer(problem, T, 0 * T, 0 * T, [1.0, 0.0] if wrong else [0.0, 1.0])


@PAIRS.add("law as a path, its gain is free", "the gain is 10 % off", 0.01)
def _law(unit: float, cost: float, wrong: bool) -> Answer:
    """u = -p x for 2 s: (1 + p^2) (1 - e^(-4 p)) / (2 p)."""
    problem, leg, x, u = line(unit, (0.0, 2.0), start=1.0)
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


@PAIRS.add("two parameters", "together they are a saddle", np.inf, first_order=False)
def _two_parameters(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = line(unit, end=1.0)
    p, r = (problem.parameter(name, lower=-9.0, upper=9.0, guess=0.3) for name in ("p", "r"))
    price = (p - 1) ** 2 / 2 + r**2 + (3.5 if wrong else 1.0) * (p - 1) * r
    problem.minimize(cost * (leg.integral((u - p) ** 2) + price))
    return Answer(problem, T, unit * T, unit * ONE, [1.0, 0.0])
