"""Closed forms at limits of states and of states with controls: floors, ceilings, obstacles, mixed limits."""

from __future__ import annotations

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
    phase_of,
    plane,
    rest_to_rest,
    trapezium,
)
from benchmarks.validation.verdict.statements import Array

PAIRS = Pairs()


@PAIRS.add("speed limit", "it rides on a limit that it need not reach", 0.05)
def _speed_limit(unit: float, cost: float, wrong: bool) -> Answer:
    """The least effort in 1 s; without a limit the speed reaches 1.5."""
    problem, leg, _, a = cart(unit, (0.0, 1.0), end=(1.0, 0.0))
    leg.bounds(v=(None, (1.6 if wrong else 1.3) * unit))
    problem.minimize(cost * leg.integral((a / unit) ** 2))
    if wrong:
        t, way, speed, force = trapezium(1.6, 1.6 / 0.375)
    else:
        rise = 1.5 * (1 - 1 / 1.3)
        t, arc = arcs(rise, 1 - 2 * rise, rise)
        left = np.choose(arc, [1 - t / rise, 0 * t, 1 - (1 - t) / rise])
        way = 1.3 * (t + rise / 3 * np.choose(arc, [left**3 - 1, 0 * t - 1, -1 - left**3]))
        speed, force = 1.3 * (1 - left**2), 2.6 / rise * left * np.choose(arc, [1, 0, -1])
    return Answer(problem, t, [unit * way, unit * speed], unit * force)


@PAIRS.add("least time below a speed limit", "it stays below the limit", 0.05)
def _fast(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _, _ = cart(unit, (0.0, (0.1, 9.0)), end=(1.0, 0.0))
    leg.bounds(a=(-8.0 * unit, 8.0 * unit), v=(None, 1.3 * unit))
    problem.minimize(cost * leg.final_time)
    t, way, speed, force = trapezium(1.2 if wrong else 1.3, 8.0)
    return Answer(problem, t, [unit * way, unit * speed], unit * force)


@PAIRS.add("height limit, order 2", "it keeps below a limit that is higher", 0.5)
def _height_limit(unit: float, cost: float, wrong: bool) -> Answer:
    """Thrown up, and back in 1 s with the least effort, below a ceiling (Bryson, Denham & Dreyfus 1963)."""
    problem, leg, _, a = cart(unit, (0.0, 1.0), start=(0.0, 1.0), end=(0.0, -1.0))
    leg.bounds(q=(None, (0.2 if wrong else 0.1) * unit))
    problem.minimize(cost * leg.integral((a / unit) ** 2))
    t, arc = arcs(0.3, 0.4, 0.3)
    left = np.choose(arc, [1 - t / 0.3, 0 * t, 1 - (1 - t) / 0.3])
    states = [unit * 0.1 * (1 - left**3), unit * left**2 * np.choose(arc, [1, 0, -1])]
    return Answer(problem, t, states, -unit * 2 / 0.3 * left)


@PAIRS.add("thin keep-out", "it goes through a disc between two samples", 1.0)
def _keep_out(unit: float, cost: float, wrong: bool) -> Answer:
    """Straight past a disc or through it; its diameter is a hundredth of the distance between samples."""
    rates: Rates = lambda x, y, h: [unit * ca.cos(h), unit * ca.sin(h)]  # noqa: E731
    problem, leg, (x, y), _ = one_phase("keep-out", "x y", "h", rates, (0.0, (0.1, 9.0)))
    leg.initial(x=-unit, y=0.0)
    leg.final(x=unit, y=0.0)
    beside = 0.0 if wrong else 3e-3
    leg.path("keep_out", ((x / unit - 0.333) ** 2 + (y / unit - beside) ** 2) / 1e-6, lower=1.0)
    problem.minimize(cost * leg.final_time)
    t = np.linspace(0.0, 2.0, 11)
    return Answer(problem, t, [unit * (t - 1), 0 * t], 0 * t)


@PAIRS.add("limit that dips", "it crosses a limit that is low for an instant", 0.1)
def _dip(unit: float, cost: float, wrong: bool) -> Answer:
    """The limit dips by 0.5 for a thousandth of the time; the speed there is 0.87 or 1.46."""
    problem, leg, (_, v), a = cart(unit, (0.0, 1.0), end=(1.0, 0.0))
    when = 0.4137 if wrong else 0.1763
    low = 0.5 * ca.exp(-(((leg.model.time - when) / 1e-3) ** 2))
    leg.path("speed", v / unit + low, upper=1.8)
    problem.minimize(cost * leg.integral((a / unit) ** 2))
    q, v, force = rest_to_rest()
    return Answer(problem, T, [unit * q, unit * v], unit * force)


@PAIRS.add("moving floor at a free end", "it ends above the floor", 0.01, kind="at a limit")
def _floor_at_end(unit: float, cost: float, wrong: bool) -> Answer:
    """From 1 with a price of 3 on the end: it would fall by 3, and the floor has sunk to 0 at the end."""
    problem, leg, x, u = line(unit, start=1.0)
    leg.path("floor", x + 0.2 * leg.model.time, lower=0.2)
    problem.minimize(cost * (leg.integral(u**2 / 2) + 3.0 * leg.final_state("x") / unit))
    t, way = np.linspace(0.0, 1.0, 21), 0.98 if wrong else 1.0
    return Answer(problem, t, [unit * (1.0 - way * t)], 0 * t - unit * way)


@PAIRS.add("moving floor at a free start", "it starts above the floor", 0.01, kind="at a limit")
def _floor_at_start(unit: float, cost: float, wrong: bool) -> Answer:
    """To 1 with a price of 3 on the start: it would begin at -2, and the floor rises from 0."""
    problem, leg, x, u = line(unit, start=None, end=1.0)
    leg.path("floor", x - 0.2 * leg.model.time, lower=0.0)
    problem.minimize(cost * (leg.integral(u**2 / 2) + 3.0 * leg.initial_state("x") / unit))
    t, way = np.linspace(0.0, 1.0, 21), 0.98 if wrong else 1.0
    return Answer(problem, t, [unit * (1.0 - way + way * t)], 0 * t + unit * way)


@PAIRS.add("floor from the start", "it stays above the floor that it starts on", 0.01, kind="at a limit")
def _throw(unit: float, cost: float, wrong: bool) -> Answer:
    """From floor to floor in 1 s under a weight of 1: thrown by itself, whatever else it could do costs."""
    problem, leg, _, (a,) = one_phase("throw", "h v", "a", lambda h, v, a: [v, a - unit], (0.0, 1.0))
    leg.initial(h=0.0)
    leg.final(h=0.0)
    leg.bounds(h=(0.0, None), a=(-2.0 * unit, 2.0 * unit))
    problem.minimize(cost * leg.integral(a**2) / unit**2)
    weight = 0.99 if wrong else 1.0
    states = [unit * weight * T * (1.0 - T) / 2.0, unit * weight * (0.5 - T)]
    return Answer(problem, T, states, unit * (1.0 - weight) * ONE)


@PAIRS.add("limit at a given end", "it ends beyond the limit", 0.1, kind="at a limit")
def _given_end(unit: float, cost: float, wrong: bool) -> Answer:
    """To 1 in 1 s, where a limit is 1, or 0.9."""
    problem, leg, x, u = line(unit, end=1.0)
    leg.path("ceiling", x, upper=0.9 if wrong else 1.0)
    problem.minimize(cost * leg.integral(u**2))
    t = np.linspace(0.0, 1.0, 21)
    return Answer(problem, t, [unit * t], 0 * t + unit)


@PAIRS.add("string over a hill", "it follows the hill for too long", 0.005, kind="at a limit")
def _string(unit: float, cost: float, wrong: bool) -> Answer:
    """A taut string over the hill 1/2 - 4 (t - 1/2)^2: its tangents from (0, 0) and (1, 0) touch at sqrt(1/8)."""
    problem, leg, x, u = line(unit, end=0.0)
    leg.path("hill", x + 4.0 * (leg.model.time - 0.5) ** 2, lower=0.5)
    problem.minimize(cost * leg.integral(u**2))
    touch = 0.33 if wrong else np.sqrt(0.125)
    t, part = arcs(touch, 1.0 - 2.0 * touch, touch)
    hill, slope = 0.5 - 4.0 * (t - 0.5) ** 2, (0.5 - 4.0 * (touch - 0.5) ** 2) / touch
    heights = np.choose(part, [slope * t, hill, slope * (1.0 - t)])
    return Answer(problem, t, unit * heights, unit * np.choose(part, [slope, 4.0 - 8.0 * t, -slope]))


def _round_disc(radius: float) -> tuple[Array, Array, Array]:
    """Times, place and heading from (-2, 0) to (2, 0) round a disc: a tangent, an arc, a tangent."""
    tangent, slope = np.sqrt(4.0 - radius**2), np.arcsin(radius / 2.0)
    t, part = arcs(tangent, 2.0 * slope * radius, tangent)
    heading = np.choose(part, [slope + 0 * t, slope - (t - tangent) / radius, -slope + 0 * t])
    left = t[-1] - t
    along = np.choose(part, [t * np.cos(slope) - 2.0, -radius * np.sin(heading), 2.0 - left * np.cos(slope)])
    high = np.choose(part, [t * np.sin(slope), radius * np.cos(heading), left * np.sin(slope)])
    return t, np.array([along, high]), heading


@PAIRS.add("round a disc", "it keeps away from the disc by 1 %", 0.01, kind="at a limit")
def _disc(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, (x, y), _ = one_phase(
        "disc", "x y", "h", lambda x, y, h: [unit * ca.cos(h), unit * ca.sin(h)], (0.0, (1.0, 9.0))
    )
    leg.initial(x=-2.0 * unit, y=0.0)
    leg.final(x=2.0 * unit, y=0.0)
    leg.path("disc", (x**2 + y**2) / unit**2, lower=1.0)
    problem.minimize(cost * leg.final_time)
    t, place, heading = _round_disc(1.01 if wrong else 1.0)
    return Answer(problem, t, unit * place, heading)


@PAIRS.add("share of what is left", "it uses 99 % of the limit", 0.01, kind="at a limit")
def _share(unit: float, cost: float, wrong: bool) -> Answer:
    """As far as possible where u + x <= 1: x = 1 - exp(-t)."""
    problem, leg, x, u = line(unit, (0.0, 2.0))
    leg.bounds(u=(0.0, 5.0 * unit))
    leg.path("limit", u + x, upper=1.0)
    problem.maximize(cost * leg.final_state("x") / unit)
    t, used = np.linspace(0.0, 2.0, 41), 0.99 if wrong else 1.0
    return Answer(problem, t, [unit * used * (1.0 - np.exp(-t))], unit * used * np.exp(-t))


@PAIRS.add("circle of state and control", "it uses 99 % of the limit", 0.01, kind="at a limit")
def _circle(unit: float, cost: float, wrong: bool) -> Answer:
    """As far as possible where u^2 + x^2 <= 1: x = sin t."""
    problem, leg, x, u = line(unit)
    leg.path("limit", u**2 + x**2, upper=1.0)
    problem.maximize(cost * leg.final_state("x") / unit)
    t, used = np.linspace(0.0, 1.0, 41), 0.99 if wrong else 1.0
    return Answer(problem, t, [unit * used * np.sin(t)], unit * used * np.cos(t))


@PAIRS.add("sum of controls is the state", "it goes straight", 0.01)
def _mixed_equality(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, (x,), (u, w) = one_phase("sum", "x", "u w", lambda x, u, w: [u - w], (0.0, 1.0))
    leg.initial(x=0.0)
    leg.final(x=unit)
    leg.path("sum", (u + w - x) / unit, equals=0.0)
    problem.minimize(cost * leg.integral((u**2 + w**2) / unit**2))
    way, speed = (T, 1 + 0 * T) if wrong else (np.sinh(T) / np.sinh(1), np.cosh(T) / np.sinh(1))
    return Answer(problem, T, unit * way, [unit * (way + speed) / 2, unit * (way - speed) / 2])


@PAIRS.add("round a disc with a bounded vector", "it keeps away by 1 %", 0.01)
def _vector_round_disc(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, (x, y), (u, w) = plane(unit, (0.0, (0.1, 9.0)), (-2.0, 0.0), (2.0, 0.0))
    leg.path("speed", u**2 + w**2, upper=1.0)
    leg.path("disc", x**2 + y**2, lower=1.0)
    problem.minimize(cost * leg.final_time)
    t, place, heading = _round_disc(1.01 if wrong else 1.0)
    return Answer(problem, t, unit * place, [unit * np.cos(heading), unit * np.sin(heading)])


@PAIRS.add("constant as a state, bang", "the cost is largest over the constant", 0.1, first_order=False)
def _constant_bang(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest in least time with the push k, |u| <= 1; T = 2 / sqrt(k), and the price of k bends either way."""
    problem, leg, _, (_u,) = one_phase(
        "constant state", "q v k", "u", lambda q, v, k, u: [v, k * u, 0 * k], (0.0, (0.1, 20.0))
    )
    leg.initial(q=0.0, v=0.0)
    leg.final(q=unit, v=0.0)
    leg.bounds(u=(-1.0, 1.0), k=(0.1 * unit, None))
    k = leg.final_state("k") / unit
    bend = -3.0 if wrong else 2.0
    problem.minimize(cost * (leg.final_time + (k - 1) + bend * (k - 1) ** 2))
    t, arc = arcs(1.0, 1.0)
    way = np.where(arc == 0, t**2 / 2, 1 - (2 - t) ** 2 / 2)
    speed = np.where(arc == 0, t, 2 - t)
    return Answer(problem, t, [unit * way, unit * speed, unit + 0 * t], np.where(arc == 0, 1.0, -1.0))


@PAIRS.add("limit of order 3 touched", "the limit pulls the flight up", 0.01)
def _third_order(unit: float, cost: float, wrong: bool) -> Answer:
    """x''' = u from x = 0, v = 1 back to x = 0, v = -1, curvature 0 at both ends, below a ceiling: touched at 1/2."""
    t, _ = arcs(0.5, 0.5)
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
    rates: Rates = lambda x, v, a, u: [v, a, u]  # noqa: E731
    problem, leg, _, (push,) = one_phase("third order", "x v a", "u", rates, (0.0, 1.0))
    leg.initial(x=0.0, v=unit, a=0.0)
    leg.final(x=0.0, v=-unit, a=0.0)
    leg.bounds(x=(None, unit * height))
    problem.minimize(cost * leg.integral((push / unit) ** 2))
    return Answer(problem, t, [unit * x, unit * v, unit * a], unit * u)


@PAIRS.add("limit with a kink in place", "it uses 97 % of the limit", 0.02)
def _kinked_place(unit: float, cost: float, wrong: bool) -> Answer:
    """From 0 to 1 with u <= 1 - |x - 1/2| in the least time: 2 log 2."""
    problem, leg, x, u = line(unit, (0.0, (0.1, 9.0)), end=1.0)
    leg.path("limit", u + ca.fabs(x - 0.5), upper=1.0)
    problem.minimize(cost * leg.final_time)
    share = 0.97 if wrong else 1.0
    t, arc = arcs(np.log(2) / share, np.log(2) / share)
    x = np.where(arc == 0, (np.exp(share * t) - 1) / 2, 1.5 - np.exp(2 * np.log(2) - share * t) / 2)
    return Answer(problem, t, unit * x, unit * share * (1 - np.abs(x - 0.5)))


@PAIRS.add("obstacle that flies through", "both meet between two samples", 1.0)
def _crossing(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, (x, y), (u, w) = plane(unit, end=(1.0, 0.0))
    when = 0.5085 if wrong else 0.7085
    leg.path("apart", (x - 0.5) ** 2 + (y - 400 * (leg.model.time - when)) ** 2, lower=0.01)
    problem.minimize(cost * leg.integral(u**2 + w**2))
    return Answer(problem, T, [unit * T, 0 * T], [unit * ONE, 0 * T])


@PAIRS.add("limit stated twice", "it uses 97 % of the limit", 0.02)
def _stated_twice(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, x, u = line(unit)
    leg.bounds(u=(-unit, unit), x=(None, 0.8 * unit))
    leg.path("speed", u, upper=1.0)
    leg.path("place", x, upper=0.8)
    problem.maximize(cost * leg.integral(x))
    top, share = 0.8, 0.97 if wrong else 1.0
    t, arc = arcs(top / share, 1 - top / share)
    return Answer(problem, t, unit * np.minimum(share * t, top), unit * share * (1.0 - arc))


@PAIRS.add("power and grip", "it uses 97 % of the power", 0.01)
def _power(unit: float, cost: float, wrong: bool) -> Answer:
    """The fastest after 2 s with a <= 1 and a v <= 1: grip for 1 s, then v = sqrt(2 t - 1)."""
    problem, leg, (v,), (a,) = one_phase("power", "v", "a", lambda v, a: [a], (0.0, 2.0))
    leg.initial(v=0.0)
    leg.bounds(a=(-unit, unit))
    leg.path("power", a * v / unit**2, upper=1.0)
    problem.maximize(cost * leg.final_state("v") / unit)
    power = 0.97 if wrong else 1.0
    t = np.append(np.linspace(0.0, power, 11), np.linspace(power, 2.0, 81))
    arc = np.repeat([0, 1], [11, 81])
    v = np.where(arc == 0, t, np.sqrt(np.maximum(power**2 + 2 * power * (t - power), power**2)))
    return Answer(problem, t, unit * v, unit * np.where(arc == 0, 1.0, power / np.maximum(v, 0.5)))


@PAIRS.add("jerk and acceleration", "it uses 96 % of the acceleration", 0.01)
def _jerk(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest with |j| <= 1 and |a| <= 1/2: ramps of a to its peak, both held; 3/2 of way take 4 s."""
    problem, peak = go.Problem("jerk"), 0.48 if wrong else 0.5
    leg, _, _ = phase_of(problem, "leg", "q v a", "j", lambda q, v, a, j: [v, a, j], (0.0, (0.5, 20.0)))
    leg.initial(q=0.0, v=0.0, a=0.0)
    leg.final(q=1.5 * unit, v=0.0, a=0.0)
    leg.bounds(j=(-unit, unit), a=(-0.5 * unit, 0.5 * unit))
    problem.minimize(cost * leg.final_time)
    hold = scipy.optimize.brentq(lambda h: peak * (peak + h) * (2 * peak + h) - 1.5, 0.0, 5.0)
    t, arc = arcs(peak, hold, 2 * peak, hold, peak)
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


@PAIRS.add("two mixed limits in turn", "it uses 97 % of the second", 0.01)
def _in_turn(unit: float, cost: float, wrong: bool) -> Answer:
    """As far as possible with u <= 1, then u <= 2 - 2 x."""
    problem, leg, x, u = line(unit)
    leg.bounds(u=(0.0, unit))
    leg.path("late", u + 2 * x, upper=2.0)
    problem.maximize(cost * leg.final_state("x") / unit)
    share = 0.97 if wrong else 1.0
    t, arc = arcs(0.5, 0.5)
    way = np.where(arc == 0, t, 1 - 0.5 * np.exp(-2 * share * (t - 0.5)))
    return Answer(problem, t, unit * way, unit * np.where(arc == 0, 1.0, 2 * share * (1 - way)))


@PAIRS.add("round a sphere as a path", "the long way round", 1.0, first_order=False)
def _sphere(unit: float, cost: float, wrong: bool) -> Answer:
    rates: Rates = lambda x, y, z, u, v, w: [u, v, w]  # noqa: E731
    problem, leg, (x, y, z), (u, v, w) = one_phase("sphere", "x y z", "u v w", rates, (0.0, 1.0))
    turn = (1.5 if wrong else 0.8) * np.pi
    leg.initial(x=unit, y=0.0, z=0.0)
    leg.final(x=unit * float(np.cos(turn)), y=unit * float(np.sin(turn)), z=0.0)
    leg.path("sphere", (x**2 + y**2 + z**2) / unit**2, equals=1.0)
    problem.minimize(cost * leg.integral((u**2 + v**2 + w**2) / unit**2))
    c, s = np.cos(turn * T), np.sin(turn * T)
    return Answer(problem, T, unit * np.array([c, s, 0 * T]), unit * turn * np.array([-s, c, 0 * T]))


@PAIRS.add("ceiling that waves", "it keeps 1 % below", 0.01)
def _waving(unit: float, cost: float, wrong: bool) -> Answer:
    """As high as possible below 0.3 + sin(3 t) / 2 with |u| <= 2."""
    problem, leg, x, _u = line(unit, (0.0, 2.0))
    leg.bounds(u=(-2 * unit, 2 * unit))
    leg.path("ceiling", x - 0.5 * ca.sin(3 * leg.model.time), upper=0.3)
    problem.maximize(cost * leg.integral(x))
    height = 0.29 if wrong else 0.3
    meet = scipy.optimize.brentq(lambda t: 2 * t - height - 0.5 * np.sin(3 * t), 0.01, 0.6, xtol=1e-14)
    t = np.concatenate([np.linspace(0, meet, 21), np.linspace(meet, 2.0, 161)])
    on = np.arange(t.size) > 20
    way = np.where(on, height + 0.5 * np.sin(3 * t), 2 * t)
    return Answer(problem, t, unit * way, unit * np.where(on, 1.5 * np.cos(3 * t), 2.0))
