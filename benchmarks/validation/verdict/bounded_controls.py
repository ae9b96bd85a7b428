"""Closed forms with bounded controls: bang-bang, coasts, singular arcs."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import scipy

import gnc_opt as go
from benchmarks.validation.verdict.answers import (
    ONE,
    Answer,
    Pairs,
    Rates,
    T,
    arcs,
    cart,
    line,
    one_phase,
    trapezium,
)
from benchmarks.validation.verdict.statements import Array

PAIRS = Pairs()


@PAIRS.add("bang, coast, bang", "it pushes longer and with less, which costs more", 0.01)
def _coast(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest over 1 in 3 s with the least fuel."""
    rates: Rates = lambda q, v, p, m: [v, p - m]  # noqa: E731
    problem, leg, _, (p, m) = one_phase("bang, coast, bang", "q v", "p m", rates, (0.0, 3.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=unit, v=0.0)
    leg.bounds(p=(0.0, unit), m=(0.0, unit))
    problem.minimize(cost * leg.integral(p + m) / unit)
    push = 0.8 if wrong else 1.0
    t, way, speed, force = _coasting(push, 3.0)
    return Answer(problem, t, [unit * way, unit * speed], unit * np.maximum([force, -force], 0.0))


def _coasting(push: float, last: float) -> tuple[Array, Array, Array, Array]:
    """Times, place, speed and force from rest to rest over 1 by a push, a coast and a push."""
    return trapezium(0.5 * push * (last - np.sqrt(last**2 - 4.0 / push)), push)


@PAIRS.add("turnpike", "it swings about the stock that grows most", 0.02)
def _turnpike(unit: float, cost: float, wrong: bool) -> Answer:
    """Harvest u of a stock x' = x (1 - x) - u from a half to a half: kept there, it grows most."""
    rates = lambda x, u: [x * (1.0 - x / unit) - u]  # noqa: E731
    problem, leg, _, (u,) = one_phase("turnpike", "x", "u", rates, (0.0, 4.0))
    leg.initial(x=0.5 * unit)
    leg.final(x=0.5 * unit)
    leg.bounds(u=(0.0, unit))
    problem.maximize(cost * leg.integral(u) / unit)
    t = np.linspace(0.0, 4.0, 161)
    height = 0.15 if wrong else 0.0
    stock, slope = 0.5 + height * np.sin(np.pi * t / 2), height * np.pi / 2 * np.cos(np.pi * t / 2)
    return Answer(problem, t, [unit * stock], unit * (stock * (1.0 - stock) - slope))


@PAIRS.add("first order lag in least time", "it uses 80 % of what it has", 0.5)
def _lag(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = -x + u from 0 to 0.5 in the least time, |u| <= 1."""
    problem, leg, _, _ = one_phase("lag", "x", "u", lambda x, u: [-x + u], (0.0, (0.01, 10.0)))
    leg.initial(x=0.0)
    leg.final(x=0.5 * unit)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.final_time)
    push = 0.8 if wrong else 1.0
    t = np.linspace(0.0, np.log(push / (push - 0.5)), 41)
    return Answer(problem, t, [unit * push * (1.0 - np.exp(-t))], unit * push + 0.0 * t)


@PAIRS.add("decay to save", "it spends evenly, though money loses its worth", 0.02)
def _spending(unit: float, cost: float, wrong: bool) -> Answer:
    """Spend 1 in 2 s for the most of exp(-t) sqrt(u): u falls as exp(-2 t)."""
    problem, leg, _, (u,) = one_phase("decay to save", "x", "u", lambda x, u: [-u], (0.0, 2.0))
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


@PAIRS.add("largest final speed", "it brakes in the middle", 0.1)
def _largest(unit: float, cost: float, wrong: bool) -> Answer:
    """The largest speed after 2 s with a push of at most 1."""
    problem, leg, _, _ = cart(unit, (0.0, 2.0))
    leg.bounds(a=(-unit, unit))
    problem.maximize(cost * leg.final_state("v") / unit)
    t, arc = arcs(0.9, 0.2, 0.9)
    push = np.where((arc == 1) & wrong, -1.0, 1.0)
    less, late = (
        np.maximum(t - begin, 0.0) * wrong for begin in (0.9, 1.1)
    )  # two seconds less a second each
    states = [unit * (0.5 * t**2 - less**2 + late**2), unit * (t - 2.0 * less + 2.0 * late)]
    return Answer(problem, t, states, unit * push)


@PAIRS.add("limit that is just reached", "it keeps off a limit that does not push", 0.01, kind="at a limit")
def _just_reached(unit: float, cost: float, wrong: bool) -> Answer:
    """u^2 - 2 x(1) is least for u = 1, which is the limit."""
    problem, leg, _, u = line(unit)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * (leg.integral(u**2) - 2.0 * leg.final_state("x") / unit))
    t, push = np.linspace(0.0, 1.0, 11), 0.9 if wrong else 1.0
    return Answer(problem, t, [unit * push * t], 0 * t + unit * push)


@PAIRS.add("most height for a budget", "it keeps some of the budget", 0.02, kind="at a limit")
def _height(unit: float, cost: float, wrong: bool) -> Answer:
    """Twice the weight for 1 s takes all of the budget, and it rises to 1 in 2 s."""
    problem, leg, _, (a,) = one_phase("height", "h v", "a", lambda h, v, a: [v, a - unit], (0.0, (0.1, 20.0)))
    leg.initial(h=0.0, v=0.0)
    leg.final(v=0.0)
    leg.bounds(a=(0.0, 2.0 * unit))
    problem.constrain("budget", leg.integral(a) / unit, upper=2.0)
    problem.maximize(cost * leg.final_state("h") / unit)
    burn = 0.95 if wrong else 1.0
    t, part = arcs(burn, burn)
    rises = np.where(part == 0, t**2 / 2.0, burn**2 - (2.0 * burn - t) ** 2 / 2.0)
    speed = np.where(part == 0, t, 2.0 * burn - t)
    return Answer(problem, t, [unit * rises, unit * speed], unit * np.where(part == 0, 2.0, 0.0))


@PAIRS.add("intercept", "it is slower than it can be", 0.2)
def _intercept(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, _u = line(unit, (0.0, (0.1, 9.0)))
    leg.bounds(u=(-3 * unit, 3 * unit))
    problem.constrain("met", leg.final_state("x") / unit - 2 - leg.final_time, equals=0.0)
    problem.minimize(cost * leg.final_time)
    speed = 2.5 if wrong else 3.0
    t = 2 / (speed - 1) * T
    return Answer(problem, t, unit * speed * t, unit * speed + 0 * t)


def _swing(z: Array, u: float, t: Any) -> Array:
    """Place and speed of x'' = u - x after a time."""
    c, s = np.cos(t), np.sin(t)
    return np.array([u + (z[0] - u) * c + z[1] * s, z[1] * c - (z[0] - u) * s])


@PAIRS.add("oscillator in least time", "its three arcs take longer", 0.05)
def _oscillator(unit: float, cost: float, wrong: bool) -> Answer:
    """To rest by +1 for 1 s and -1 for 0.8 s; pushing the wrong way for 0.2 s first, it takes longer."""
    problem, leg, _, _ = one_phase("oscillator", "x v", "u", lambda x, v, u: [v, u - x], (0.0, (0.1, 9.0)))
    start = _swing(_swing(np.zeros(2), -1.0, -0.8), 1.0, -1.0)
    leg.initial(x=unit * start[0], v=unit * start[1])
    leg.final(x=0.0, v=0.0)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.final_time)

    def left(s: Array) -> Array:
        return _swing(_swing(_swing(start, -1.0, 0.2), 1.0, s[0]), -1.0, s[1])

    signs, durations = [1.0, -1.0], [1.0, 0.8]
    if wrong:
        signs, durations = [-1.0, 1.0, -1.0], [0.2, *scipy.optimize.fsolve(left, [1.2, 1.0], xtol=1e-13)]
    t, arc = arcs(*durations)
    states, z = [], start
    for sign, duration in zip(signs, durations, strict=True):
        states.append(_swing(z, sign, np.linspace(0.0, duration, 21)))
        z = states[-1][:, -1]
    return Answer(problem, t, unit * np.hstack(states), unit * np.array(signs)[arc])


@PAIRS.add("drained tank", "its valve is not open", 0.1)
def _tank(unit: float, cost: float, wrong: bool) -> Answer:
    rates: Rates = lambda x, u: [-u * ca.sqrt(x * unit)]  # noqa: E731
    problem, leg, _, _ = one_phase("tank", "x", "u", rates, (0.0, (0.1, 50.0)))
    leg.initial(x=unit)
    leg.final(x=0.01 * unit)
    leg.bounds(u=(0.0, 1.0))
    problem.minimize(cost * leg.final_time)
    u = 0.9 if wrong else 1.0
    t = 1.8 / u * T
    return Answer(problem, t, unit * (1 - u * t / 2) ** 2, u + 0 * t)


@PAIRS.add("only one way", "it goes at full speed and waits", 0.1)
def _only_way(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, x, u = line(unit, (0.0, 1.2 if wrong else 1.0), end=1.0)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.integral(u**2 + 0.3 * x))
    if wrong:
        t, arc = arcs(1.0, 0.2)
        return Answer(problem, t, unit * np.minimum(t, 1.0), unit * (1.0 - arc))
    return Answer(problem, T, unit * T, unit + 0 * T)


@PAIRS.add("chatter", "it comes to rest as fast as it can", 0.001)
def _fuller(unit: float, cost: float, wrong: bool) -> Answer:
    """Least int x^2 from (1, 0) to rest (Fuller 1961): ever faster switches on x = -c v |v|, cut off after nine."""
    problem, leg, (x, _), _ = one_phase("Fuller", "x v", "u", lambda x, v, u: [v, u], (0.0, 4.0))
    leg.initial(x=unit, v=0.0)
    leg.final(x=0.0, v=0.0)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.integral((x / unit) ** 2))
    curve, z, sign, durations = 0.5 if wrong else 0.4446235604, np.array([1.0, 0.0]), -1.0, []

    def after(z: Array, sign: float, s: Any) -> Array:
        return np.array([z[0] + z[1] * s + sign * s**2 / 2, z[1] + sign * s])

    def from_curve(s: float, z: Array, sign: float) -> float:
        place, speed = after(z, sign, s)
        return float(place + curve * speed * abs(speed))

    for _ in range(1 if wrong else 9):
        low = max(0.0, -z[1] / sign) + 1e-14
        high = low + 5 * max(np.sqrt(abs(z[0])), abs(z[1]))
        durations.append(scipy.optimize.brentq(from_curve, low, high, (z, sign), xtol=1e-15))
        z, sign = after(z, sign, durations[-1]), -sign
    rest = [abs(z[1])]  # x = -v |v| / 2 leads to rest with one push
    if not wrong:

        def left(s: Array) -> Array:
            return after(after(z, sign, s[0]), -sign, s[1])

        rest = list(scipy.optimize.fsolve(left, [1.2 * abs(z[1]), 0.2 * abs(z[1])], xtol=1e-14))
    t, arc = arcs(*durations, *rest)
    states, z = [], np.array([1.0, 0.0])
    for k, duration in enumerate([*durations, *rest]):
        states.append(after(z, -((-1.0) ** k), np.linspace(0.0, duration, 21)))
        z = states[-1][:, -1]
    still = np.linspace(t[-1], 4.0, 21)
    x = np.hstack([*states, np.zeros((2, 21))])
    return Answer(problem, np.append(t, still), unit * x, unit * np.append(-((-1.0) ** arc), 0 * still))


@PAIRS.add("far away in two controls", "both reversed push twice as hard", 0.5)
def _far_away(unit: float, cost: float, wrong: bool) -> Answer:
    """As far as possible with r cos h, -2 <= r <= 1: backwards and turned round."""
    problem, leg, _, (_r, h) = one_phase("far away", "x", "r h", lambda x, r, h: [r * ca.cos(h)], (0.0, 1.0))
    leg.initial(x=0.0)
    leg.bounds(r=(-2 * unit, unit), h=(-4.0, 4.0))
    problem.maximize(cost * (leg.final_state("x") / unit - leg.integral(0.001 * h)))
    sin = 0.001 / (1.0 if wrong else 2.0)
    # -2 cos h - 0.001 h is largest near -pi: 2 sin h = 0.001
    turn = -np.arcsin(sin) if wrong else -np.pi - np.arcsin(sin)
    r = 1.0 if wrong else -2.0
    return Answer(problem, T, unit * r * np.cos(turn) * T, [unit * r * ONE, turn * ONE])


def _coast_unusual(
    unit: float, wrong: bool, plane: bool
) -> tuple[go.Problem, go.Phase, Any, tuple[Any, Any, Any]]:
    """Rest to rest over 1 in 2.5 s by a push, a coast and a push, on a line or in a plane."""
    t, place, speed, force = _coasting(0.99 if wrong else 1.0, 2.5)
    states, controls, way = ("x y v q", "u w", [[0.6], [0.8]]) if plane else ("x v", "u", [[1.0]])
    n, way = len(way), unit * np.array(way)
    problem, leg, _, u = one_phase("coast", states, controls, lambda *x: list(x[n:]), (0.0, 2.5))
    leg.initial(**dict.fromkeys(states.split(), 0.0))
    leg.final(**dict(zip(states.split(), [*way[:, 0], *np.zeros(n)], strict=True)))
    return problem, leg, ca.vertcat(*u) / unit, (t, [*(way * place), *(way * speed)], way * force)


@PAIRS.add("coast priced by fabs", "it pushes with 99 %", 0.003)
def _coast_by_fabs(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, u, flight = _coast_unusual(unit, wrong, plane=False)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.integral(ca.fabs(u)))
    return Answer(problem, *flight)


@PAIRS.add("coast priced by a norm", "it pushes with 99 %", 0.003)
def _coast_by_norm(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, u, flight = _coast_unusual(unit, wrong, plane=True)
    leg.path("push", ca.sumsqr(u), upper=1.0)
    problem.minimize(cost * leg.integral(ca.norm_2(u)))
    return Answer(problem, *flight)


@PAIRS.add("coast, dearer forth than back", "it pushes with 99 %", 0.003)
def _coast_by_cases(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, u, flight = _coast_unusual(unit, wrong, plane=False)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.integral(ca.if_else(u > 0, 2 * u, -u / 2)))
    return Answer(problem, *flight)


@PAIRS.add("steep enough to be straight", "steps of 0 and 1 cost less", 0.004)
def _newtons_body(unit: float, cost: float, wrong: bool) -> Answer:
    """1 / (1 + u^2) is convex at u = 0.9 and 1.2; its hull is a line from 0 to 1."""
    problem, leg, _x, u = line(unit)
    slope = 0.9 if wrong else 1.2
    leg.final(x=slope * unit)
    leg.bounds(u=(0.0, 3 * unit))
    problem.minimize(cost * leg.integral(1 / (1 + u**2)))
    return Answer(problem, T, unit * slope * T, unit * slope * ONE)


@PAIRS.add("dwelling where it is fastest", "it dwells beside it", 0.01)
def _dwelling(unit: float, cost: float, wrong: bool) -> Answer:
    """y' = 1 / (1 + x^2) from x = 1 to x = 1 over 5: along x = 0."""
    rates: Rates = lambda x, y, u: [u, unit / (1 + (x / unit) ** 2)]  # noqa: E731
    problem, leg, _, _ = one_phase("dwelling", "x y", "u", rates, (0.0, (0.1, 20.0)))
    leg.initial(x=unit, y=0.0)
    leg.final(x=unit, y=5.0 * unit)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.final_time)
    b = 0.1 if wrong else 0.0
    side = np.arctan(1.0) - np.arctan(b)
    middle = (5.0 - 2 * side) * (1 + b**2)
    t, arc = arcs(1 - b, middle, 1 - b)
    x = np.choose(arc, [1 - t, b + 0 * t, 2 * b - 1 + t - middle])
    y = np.choose(
        arc, [np.pi / 4 - np.arctan(x), side + (t - 1 + b) / (1 + b**2), 5.0 - np.pi / 4 + np.arctan(x)]
    )
    return Answer(problem, t, [unit * x, unit * y], unit * np.choose(arc, [-1.0, 0.0, 1.0]))


@PAIRS.add("reinvestment", "it stops investing 0.1 s too early", 0.005)
def _reinvestment(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = u x and most of (1 - u) x in 3 s: all is invested until 1 s before the end."""
    problem, leg, (x,), (u,) = one_phase("reinvestment", "x", "u", lambda x, u: [u * x], (0.0, 3.0))
    leg.initial(x=unit)
    leg.bounds(u=(0.0, 1.0))
    problem.maximize(cost * leg.integral((1 - u) * x / unit))
    last = 1.9 if wrong else 2.0
    t, arc = arcs(last, 3 - last)
    return Answer(problem, t, unit * np.exp(np.minimum(t, last)), 1.0 - arc)
