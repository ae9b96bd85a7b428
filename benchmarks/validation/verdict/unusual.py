"""More closed forms of what strangers would try: idle and repeated limits, cones, budgets of several phases, loops."""

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


def unusual() -> Iterator[Pair]:
    """Yield all of them."""
    yield from itertools.starmap(
        Pair,
        (
            ("jump of limited size", "it does without the jump", 0.2, True, _limited_jump),
            ("vertex with an idle side", "it ends beside the vertex", 0.1, True, _vertex),
            ("limit stated twice", "it uses 97 % of the limit", 0.02, True, _stated_twice),
            ("integral that says what the end says", "it pushes unevenly", 0.05, True, _redundant),
            ("thrust through zero below a norm", "it pushes as hard as it may", 0.1, True, _through_zero),
            ("two vehicles meet", "they meet half-way though one is dearer", 0.1, True, _meeting),
            ("time shared by two phases", "both take the same time", 0.1, True, _shared_time),
            ("power and grip", "it uses 97 % of the power", 0.01, True, _power),
            ("cost as a state", "it pushes unevenly", 0.05, True, _mayer),
            ("nothing to do, two prices", "one price is paid for nothing", 0.5, True, _idle_prices),
            ("loop of given area over a point", "its two arcs are unlike", 0.01, True, _lens),
            ("edge of a table", "it pushes unevenly", 0.02, True, _table_edge),
            ("coast priced by fabs", "it pushes with 99 %", 0.003, True, _coast_by_fabs),
            ("coast priced by a norm", "it pushes with 99 %", 0.003, True, _coast_by_norm),
            ("coast, dearer forth than back", "it pushes with 99 %", 0.003, True, _coast_by_cases),
            ("soft end on its kink", "it ends beside the kink", 0.05, True, _soft_end),
            ("delay as a second copy", "it takes no notice of the delay", 0.1, True, _delay),
            ("link that doubles", "costates go on without a jump", 0.1, True, _doubling_link),
            ("jerk and acceleration", "it uses 96 % of the acceleration", 0.01, True, _jerk),
            ("focal point moved by a weight", "the weight is too small", np.inf, False, _focal_point),
            ("steep enough to be straight", "steps of 0 and 1 cost less", 0.004, True, _newtons_body),
        ),
    )


def _limited_jump(unit: float, cost: float, wrong: bool) -> Answer:
    """To 1 in 1 s, 0.2 of it by a jump half-way that costs nothing."""
    problem, legs, effort = go.Problem("limited jump"), [], 0.0
    for name, time in (("before", (0.0, 0.5)), ("after", (0.5, 1.0))):
        leg, _, (u,) = _phase(problem, name, "x", "u", lambda x, u: [u], time)
        legs.append(leg)
        effort = effort + leg.integral((u / unit) ** 2)
    legs[0].initial(x=0.0)
    legs[1].final(x=unit)
    jump = (legs[1].initial_state("x") - legs[0].final_state("x")) / unit
    problem.constrain("jump", jump, lower=-0.2, upper=0.2)
    problem.minimize(cost * effort)
    size = 0.0 if wrong else 0.2
    t = {"before": 0.5 * T, "after": 0.5 + 0.5 * T}
    x = {"before": [unit * (1 - size) * t["before"]], "after": [unit * (size + (1 - size) * t["after"])]}
    return Answer(problem, t, x, dict.fromkeys(t, unit * (1 - size) * _ONE))


def _vertex(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _, (u, w) = _plane(unit)
    x, y = (leg.final_state(n) / unit for n in "xy")
    for name, side in (("right", x - 1), ("above", y - 1), ("beyond", x + y - 2)):
        problem.constrain(name, side, lower=0.0)
    problem.minimize(cost * leg.integral(u**2 + w**2))
    end = np.array([1.3, 1.0]) if wrong else np.array([1.0, 1.0])
    return Answer(problem, T, unit * np.outer(end, T), unit * np.outer(end, _ONE))


def _stated_twice(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, x, u = _line(unit)
    leg.bounds(u=(-unit, unit), x=(None, 0.8 * unit))
    leg.path("speed", u, upper=1.0)
    leg.path("place", x, upper=0.8)
    problem.maximize(cost * leg.integral(x))
    top, share = 0.8, 0.97 if wrong else 1.0
    t, arc = _arcs(top / share, 1 - top / share)
    return Answer(problem, t, unit * np.minimum(share * t, top), unit * share * (1.0 - arc))


def _redundant(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = _line(unit)
    leg.final(x=unit)
    problem.constrain("mean", leg.integral(u), equals=1.0)
    problem.minimize(cost * leg.integral(u**2))
    bend = 0.3 if wrong else 0.0
    return Answer(problem, T, unit * (T + bend * T * (1 - T)), unit * (1 + bend * (1 - 2 * T)))


def _through_zero(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest over 1 in 1 s for int a^2, |a| <= 10, as a root: the push passes through zero half-way."""
    problem = go.Problem("through zero")
    leg, _, (a, b) = _phase(
        problem, "leg", "x y v w", "a b", lambda x, y, v, w, a, b: [v, w, a, b], (0.0, 1.0)
    )
    leg.initial(x=0.0, y=0.0, v=0.0, w=0.0)
    leg.final(x=unit, y=0.0, v=0.0, w=0.0)
    leg.path("norm", ca.sqrt(a**2 + b**2) / unit, upper=10.0)
    problem.minimize(cost * leg.integral((a**2 + b**2) / unit**2))
    if wrong:
        t, arc = _arcs(0.5, 0.5)
        x = np.where(arc == 0, 2 * t**2, 1 - 2 * (1 - t) ** 2)
        v, push = np.where(arc == 0, 4 * t, 4 - 4 * t), np.where(arc == 0, 4.0, -4.0)
        return Answer(problem, t, [unit * x, 0 * t, unit * v, 0 * t], [unit * push, 0 * t])
    x, v = 3 * T**2 - 2 * T**3, 6 * T - 6 * T**2
    return Answer(problem, T, [unit * x, 0 * T, unit * v, 0 * T], [unit * (6 - 12 * T), 0 * T])


def _meeting(unit: float, cost: float, wrong: bool) -> Answer:
    """From 0 and from 1 in 1 s to the same place, one four times as dear: it does a fifth of the way."""
    problem, legs, effort = go.Problem("meeting"), [], 0.0
    for name, price in (("cheap", 1.0), ("dear", 4.0)):
        leg, _, (u,) = _phase(problem, name, "x", "u", lambda x, u: [u], (0.0, 1.0))
        legs.append(leg)
        effort = effort + price * leg.integral((u / unit) ** 2)
    legs[0].initial(x=0.0)
    legs[1].initial(x=unit)
    problem.constrain("met", (legs[0].final_state("x") - legs[1].final_state("x")) / unit, equals=0.0)
    problem.minimize(cost * effort)
    place = 0.5 if wrong else 0.8
    x = {"cheap": [unit * place * T], "dear": [unit * (1 - (1 - place) * T)]}
    u = {"cheap": unit * place * _ONE, "dear": -unit * (1 - place) * _ONE}
    return Answer(problem, {"cheap": T, "dear": T}, x, u)


def _shared_time(unit: float, cost: float, wrong: bool) -> Answer:
    """Ways of 1 and 2, each by a vehicle of its own, for 2 s in all: as fast as each other."""
    problem, legs, effort = go.Problem("shared time"), [], 0.0
    for name, way in (("near", 1.0), ("far", 2.0)):
        leg, _, (u,) = _phase(problem, name, "x", "u", lambda x, u: [u], (0.0, (0.1, 3.0)))
        leg.initial(x=0.0)
        leg.final(x=way * unit)
        legs.append(leg)
        effort = effort + leg.integral((u / unit) ** 2)
    problem.constrain("time", legs[0].duration + legs[1].duration, upper=2.0)
    problem.minimize(cost * effort)
    first = 1.0 if wrong else 2 / 3
    t = {"near": first * T, "far": (2 - first) * T}
    x = {"near": [unit * T], "far": [unit * 2 * T]}
    return Answer(problem, t, x, {"near": unit / first * _ONE, "far": unit * 2 / (2 - first) * _ONE})


def _power(unit: float, cost: float, wrong: bool) -> Answer:
    """The fastest after 2 s with a <= 1 and a v <= 1: grip for 1 s, then v = sqrt(2 t - 1)."""
    problem = go.Problem("power")
    leg, (v,), (a,) = _phase(problem, "leg", "v", "a", lambda v, a: [a], (0.0, 2.0))
    leg.initial(v=0.0)
    leg.bounds(a=(-unit, unit))
    leg.path("power", a * v / unit**2, upper=1.0)
    problem.maximize(cost * leg.final_state("v") / unit)
    power = 0.97 if wrong else 1.0
    t = np.append(np.linspace(0.0, power, 11), np.linspace(power, 2.0, 81))
    arc = np.repeat([0, 1], [11, 81])
    v = np.where(arc == 0, t, np.sqrt(np.maximum(power**2 + 2 * power * (t - power), power**2)))
    return Answer(problem, t, unit * v, unit * np.where(arc == 0, 1.0, power / np.maximum(v, 0.5)))


def _mayer(unit: float, cost: float, wrong: bool) -> Answer:
    problem = go.Problem("cost as a state")
    leg, _, _ = _phase(problem, "leg", "x y", "u", lambda x, y, u: [u, u**2 / unit], (0.0, 1.0))
    leg.initial(x=0.0, y=0.0)
    leg.final(x=unit)
    problem.minimize(cost * leg.final_state("y") / unit)
    bend = 0.3 if wrong else 0.0
    u = 1 + bend * (1 - 2 * T)
    spent = T if not wrong else ((1 + bend) ** 3 - u**3) / (6 * bend)
    return Answer(problem, T, [unit * (T + bend * T * (1 - T)), unit * spent], unit * u)


def _idle_prices(unit: float, cost: float, wrong: bool) -> Answer:
    """Nothing need be done: the control is zero, and both parameters are at limits."""
    problem, leg, _x, u = _line(unit)
    p, q = (problem.parameter(n, lower=0.0, upper=1.0, guess=0.5) for n in "pq")
    leg.final(x=0.0)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * (leg.integral(u**2) + p - q + p * q))
    return Answer(problem, T, 0 * T, 0 * T, [1.0, 0.0] if wrong else [0.0, 1.0])


def _lens(unit: float, cost: float, wrong: bool) -> Answer:
    """From (0, 0) over (0, 1) and back round an area: two equal arcs of 90 degrees."""
    problem, legs, effort, area = go.Problem("lens"), [], 0.0, 0.0
    for name, time in (("there", (0.0, 1.0)), ("back", (1.0, 2.0))):
        leg, (x, y), (u, w) = _phase(problem, name, "x y", "u w", lambda x, y, u, w: [u, w], time)
        legs.append(leg)
        effort = effort + leg.integral((u**2 + w**2) / unit**2)
        area = area + leg.integral((x * w - y * u) / 2 / unit**2)
    there, back = legs
    there.initial(x=0.0, y=0.0)
    there.final(x=0.0, y=unit)
    back.final(x=0.0, y=0.0)
    problem.link(there, back)

    def arc(angle: float, s: Array) -> tuple[Array, Array, float]:
        """From (0, 0) to (0, 1), to the right of the chord, turning by an angle; its area beside the chord."""
        r = 0.5 / np.sin(angle / 2)
        phi = -angle / 2 + angle * s
        z = np.array([r * (np.cos(phi) - np.cos(angle / 2)), 0.5 + r * np.sin(phi)])
        return z, r * angle * np.array([-np.sin(phi), np.cos(phi)]), r**2 * (angle - np.sin(angle)) / 2

    full = 2 * arc(np.pi / 2, T)[2]
    first = np.pi / 2
    second = first
    if wrong:
        first = 1.9
        second = scipy.optimize.brentq(lambda g: arc(first, T)[2] + arc(g, T)[2] - full, 0.1, 3.0)
    problem.constrain("area", area, equals=full)
    problem.minimize(cost * effort)
    (z1, s1, _), (z2, s2, _) = arc(first, T), arc(second, T)
    states = {"there": unit * z1, "back": unit * np.array([-z2[0], 1 - z2[1]])}
    return Answer(problem, {"there": T, "back": 1 + T}, states, {"there": unit * s1, "back": -unit * s2})


def _table_edge(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = k(x) u with k from a table, 1 + x, up to the table's last entry: u^2 is even, so is log(1 + x)."""
    problem = go.Problem("table")
    axis = np.linspace(0.0, 1.0, 6)
    lookup = go.table(axis, 1 + axis, name="gain")
    leg, _, (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [lookup(x / unit) * u], (0.0, 1.0))
    leg.initial(x=0.0)
    leg.final(x=unit)
    problem.minimize(cost * leg.integral((u / unit) ** 2))
    log = np.log(2)
    if wrong:
        return Answer(problem, T, unit * T, unit / (1 + T))
    return Answer(problem, T, unit * np.expm1(log * T), unit * log * _ONE)


def _coast(unit: float, wrong: bool, plane: bool) -> tuple[go.Problem, go.Phase, Any, tuple[Any, Any, Any]]:
    """Rest to rest over 1 in 2.5 s, a push, a coast and a push: p s (2.5 - s) = 1 for pushes p of s seconds."""
    problem, push = go.Problem("coast"), 0.99 if wrong else 1.0
    s = (2.5 - np.sqrt(2.5**2 - 4 / push)) / 2
    t, arc = _arcs(s, 2.5 - 2 * s, s)
    place = np.choose(arc, [push * t**2 / 2, push * s * (t - s / 2), 1 - push * (2.5 - t) ** 2 / 2])
    speed = np.choose(arc, [push * t, push * s + 0 * t, push * (2.5 - t)])
    a = push * np.array([1.0, 0.0, -1.0])[arc]
    if plane:
        leg, _, (u, w) = _phase(
            problem, "leg", "x y v q", "u w", lambda x, y, v, q, u, w: [v, q, u, w], (0.0, 2.5)
        )
        control, way = ca.vertcat(u, w) / unit, np.array([0.6, 0.8])[:, None]
    else:
        leg, _, (u,) = _phase(problem, "leg", "x v", "u", lambda x, v, u: [v, u], (0.0, 2.5))
        control, way = u / unit, np.ones((1, 1))
    states = [*(unit * way * place), *(unit * way * speed)]
    names = "xyvq" if plane else "xv"
    leg.initial(**dict.fromkeys(names, 0.0))
    leg.final(**{name: float(values[-1]) for name, values in zip(names, states, strict=True)})
    return problem, leg, control, (t, states, unit * way * a)


def _coast_by_fabs(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, u, flight = _coast(unit, wrong, plane=False)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.integral(ca.fabs(u)))
    return Answer(problem, *flight)


def _coast_by_norm(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, u, flight = _coast(unit, wrong, plane=True)
    leg.path("push", ca.sumsqr(u), upper=1.0)
    problem.minimize(cost * leg.integral(ca.norm_2(u)))
    return Answer(problem, *flight)


def _coast_by_cases(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, u, flight = _coast(unit, wrong, plane=False)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.integral(ca.if_else(u > 0, 2 * u, -u / 2)))
    return Answer(problem, *flight)


def _soft_end(unit: float, cost: float, wrong: bool) -> Answer:
    """c^2 + 3 |c - 1| is least at its kink."""
    problem, leg, _x, u = _line(unit)
    problem.minimize(cost * (leg.integral(u**2) + 3 * ca.fabs(leg.final_state("x") / unit - 1)))
    c = 0.95 if wrong else 1.0
    return Answer(problem, T, unit * c * T, unit * c * _ONE)


def _delay(unit: float, cost: float, wrong: bool) -> Answer:
    """z' = u - z(t - 1) for 2 s from 0 to 1, the second of them as a second state: u grows with t, then stays."""
    problem = go.Problem("delay")
    leg, _, (u, w) = _phase(problem, "leg", "x y", "u w", lambda x, y, u, w: [u, w - x], (0.0, 1.0))
    leg.initial(x=0.0)
    leg.final(y=unit)
    problem.constrain("goes on", (leg.final_state("x") - leg.initial_state("y")) / unit, equals=0.0)
    problem.minimize(cost * leg.integral((u**2 + w**2) / unit**2))
    if wrong:
        return Answer(
            problem, T, [unit * 2 / 3 * T, unit * 2 / 3 * (1 + T - T**2 / 2)], [unit * 2 / 3 * _ONE] * 2
        )
    x, y = 0.75 * T**2 / 2, 0.75 * (0.5 + T - T**3 / 6)
    return Answer(problem, T, [unit * x, unit * y], [unit * 0.75 * T, unit * 0.75 * _ONE])


def _doubling_link(unit: float, cost: float, wrong: bool) -> Answer:
    """To c in 1 s, from 2 c to 1 in 1 s: c^2 + (1 - 2 c)^2."""
    problem, legs, effort = go.Problem("doubling link"), [], 0.0
    for name, time in (("before", (0.0, 1.0)), ("after", (1.0, 2.0))):
        leg, _, (u,) = _phase(problem, name, "x", "u", lambda x, u: [u], time)
        legs.append(leg)
        effort = effort + leg.integral((u / unit) ** 2)
    legs[0].initial(x=0.0)
    legs[1].final(x=unit)
    doubled = (legs[1].initial_state("x") - 2 * legs[0].final_state("x")) / unit
    problem.constrain("doubled", doubled, equals=0.0)
    problem.minimize(cost * effort)
    c = 1 / 3 if wrong else 0.4
    x = {"before": [unit * c * T], "after": [unit * (2 * c + (1 - 2 * c) * T)]}
    return Answer(
        problem,
        {"before": T, "after": 1 + T},
        x,
        {"before": unit * c * _ONE, "after": unit * (1 - 2 * c) * _ONE},
    )


def _jerk(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest with |j| <= 1 and |a| <= 1/2: ramps of a to its peak, both held; 3/2 of way take 4 s."""
    problem, peak = go.Problem("jerk"), 0.48 if wrong else 0.5
    leg, _, _ = _phase(problem, "leg", "q v a", "j", lambda q, v, a, j: [v, a, j], (0.0, (0.5, 20.0)))
    leg.initial(q=0.0, v=0.0, a=0.0)
    leg.final(q=1.5 * unit, v=0.0, a=0.0)
    leg.bounds(j=(-unit, unit), a=(-0.5 * unit, 0.5 * unit))
    problem.minimize(cost * leg.final_time)
    hold = scipy.optimize.brentq(lambda h: peak * (peak + h) * (2 * peak + h) - 1.5, 0.0, 5.0)
    t, arc = _arcs(peak, hold, 2 * peak, hold, peak)
    j = np.array([1.0, 0.0, -1.0, 0.0, 1.0])[arc]
    states, z = np.zeros((3, t.size)), np.zeros(3)
    for k in range(5):
        at = np.flatnonzero(arc == k)
        s, push = t[at] - t[at[0]], j[at[0]]
        a = z[2] + push * s
        v = z[1] + z[2] * s + push * s**2 / 2
        states[:, at] = [z[0] + z[1] * s + z[2] * s**2 / 2 + push * s**3 / 6, v, a]
        z = states[:, at[-1]]
    return Answer(problem, t, unit * states, unit * j)


def _focal_point(unit: float, cost: float, wrong: bool) -> Answer:
    """u^2 - x^2 for 2 s and c x^2 at the end: at rest a minimum for c > -cot 2 = 0.4577."""
    problem, leg, x, u = _line(unit, (0.0, 2.0))
    weight = 0.45 if wrong else 0.47
    problem.minimize(cost * (leg.integral(u**2 - x**2) + weight * (leg.final_state("x") / unit) ** 2))
    return Answer(problem, 2 * T, 0 * T, 0 * T)


def _newtons_body(unit: float, cost: float, wrong: bool) -> Answer:
    """1 / (1 + u^2) is convex at u = 0.9 and 1.2; its hull is a line from 0 to 1."""
    problem, leg, _x, u = _line(unit)
    slope = 0.9 if wrong else 1.2
    leg.final(x=slope * unit)
    leg.bounds(u=(0.0, 3 * unit))
    problem.minimize(cost * leg.integral(1 / (1 + u**2)))
    return Answer(problem, T, unit * slope * T, unit * slope * _ONE)
