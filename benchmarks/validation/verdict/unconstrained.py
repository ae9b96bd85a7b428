"""Closed forms without limits on the way: smooth transfers, regulators, geodesics, ends and times of choice."""

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
    integrator,
    line,
    one_phase,
    phase_of,
    rest_to_rest,
)

PAIRS = Pairs()


@PAIRS.add("free time", "the cost is largest over the time", 0.5, first_order=False)
def _free_time(unit: float, cost: float, wrong: bool) -> Answer:
    """1 / T + T + bend (T - 1)^2 is stationary at T = 1."""
    problem, leg, _, u = line(unit, (0.0, (0.2, 3.0)), end=1.0)
    last = leg.final_time
    problem.minimize(cost * (leg.integral(u**2) + last + (-3.0 if wrong else 1.0) * (last - 1) ** 2))
    t = np.linspace(0.0, 1.0, 21)
    return Answer(problem, t, unit * t, 0 * t + unit)


@PAIRS.add("free end", "it ends at rest, which nothing asks for", 3.0)
def _free_end(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _, a = cart(unit, (0.0, 1.0), end=(1.0, None))
    problem.minimize(cost * leg.integral((a / unit) ** 2))
    free = (3 * T**2 - T**3) / 2, (6 * T - 3 * T**2) / 2, 3 - 3 * T
    way, speed, force = rest_to_rest() if wrong else free
    return Answer(problem, T, [unit * way, unit * speed], unit * force)


@PAIRS.add("strong current", "it swims upstream", 1.0)
def _current(unit: float, cost: float, wrong: bool) -> Answer:
    """To (3, 0) in a current of 2, along or against it."""
    rates: Rates = lambda x, y, h: [unit * (ca.cos(h) + 2), unit * ca.sin(h)]  # noqa: E731
    problem, leg, _, _ = one_phase("current", "x y", "h", rates, (0.0, (0.1, 9.0)))
    leg.initial(x=0.0, y=0.0)
    leg.final(x=3 * unit, y=0.0)
    problem.minimize(cost * leg.final_time)
    speed, heading = (1.0, np.pi) if wrong else (3.0, 0.0)
    t = np.linspace(0.0, 3 / speed, 21)
    return Answer(problem, t, [unit * speed * t, 0 * t], 0 * t + heading)


@PAIRS.add("periodic", "swinging with the free plant costs less than nothing", np.inf, first_order=False)
def _periodic(unit: float, cost: float, wrong: bool) -> Answer:
    """At rest; a swing in one period of the free plant needs no force."""
    problem, leg, (_, v), (u,) = one_phase("swing", "x v", "u", lambda x, v, u: [v, u - x], (0.0, 2 * np.pi))
    problem.link(leg, leg, time=False)
    problem.minimize(cost * leg.integral((u**2 + (-0.5 if wrong else 0.5) * v**2) / unit**2))
    t = np.linspace(0.0, 2 * np.pi, 61)
    return Answer(problem, t, np.zeros((2, t.size)), 0 * t)


@PAIRS.add("cross terms", "right without the product of state and control in the cost", 0.05)
def _cross_terms(unit: float, cost: float, wrong: bool) -> Answer:
    """x^2 + u^2 + x u with a free end: lambda' = -2 x - u, u = -(lambda + x) / 2."""
    problem, leg, x, u = line(unit, (0.0, 1.5), start=1.0)
    problem.minimize(cost * leg.integral(x**2 + u**2 + x * u))
    cross = 0.0 if wrong else 1.0
    matrix = np.array([[-cross / 2, -0.5], [cross**2 / 2 - 2, cross / 2]])
    end = scipy.linalg.expm(1.5 * matrix)
    start = np.array([1.0, -end[1, 0] / end[1, 1]])
    t = np.linspace(0.0, 1.5, 61)
    way, costate = np.array([scipy.linalg.expm(s * matrix) @ start for s in t]).T
    return Answer(problem, t, unit * way, -unit * (costate + cross * way) / 2)


@PAIRS.add("soap film", "the deep catenary has more area", 0.1, first_order=False)
def _soap_film(unit: float, cost: float, wrong: bool) -> Answer:
    """y = c cosh(t / c) between rings of radius 1, 0.8 apart: two values of c."""
    problem, leg, y, u = line(unit, (0.0, 0.8), start=1.0, end=1.0)
    problem.minimize(cost * leg.integral(y * ca.sqrt(1 + u**2)))
    least, most = (0.05, 0.3) if wrong else (0.5, 1.0)
    c = float(scipy.optimize.brentq(lambda c: c * np.cosh(0.4 / c) - 1, least, most))
    slope = np.sinh(0.4 / c)
    t = 0.4 + c * np.arcsinh(np.linspace(-slope, slope, 161))
    t[[0, -1]] = 0.0, 0.8
    return Answer(problem, t, unit * c * np.cosh((t - 0.4) / c), unit * np.sinh((t - 0.4) / c))


@PAIRS.add("work shared by two", "both do the same, though one is dearer", 0.5)
def _shared(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = u + w over 1 in 1 s for u^2 + 4 w^2: one does four times as much as the other."""
    problem, leg, _, (u, w) = one_phase("work shared by two", "x", "u w", lambda x, u, w: [u + w], (0.0, 1.0))
    leg.initial(x=0.0)
    leg.final(x=unit)
    problem.minimize(cost * leg.integral(u**2 + 4.0 * w**2) / unit**2)
    t, share = np.linspace(0.0, 1.0, 11), 0.5 if wrong else 0.8
    return Answer(problem, t, [unit * t], unit * np.array([share + 0 * t, 1.0 - share + 0 * t]))


@PAIRS.add("regulator", "it has the gain of a horizon without end", 0.01)
def _regulator(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = x + u for x^2 + u^2 over 1 s, the end free."""
    problem, leg, (x,), (u,) = one_phase("regulator", "x", "u", lambda x, u: [x + u], (0.0, 1.0))
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


@PAIRS.add("damped transfer", "its effort is that of a body without damping", 0.02)
def _damped(unit: float, cost: float, wrong: bool) -> Answer:
    """v' = -v + a from rest to speed 1 in 2 s: the effort grows as exp(t), not evenly."""
    problem, leg, _, (a,) = one_phase("damped", "v", "a", lambda v, a: [-v + a], (0.0, 2.0))
    leg.initial(v=0.0)
    leg.final(v=unit)
    problem.minimize(cost * leg.integral(a**2) / unit**2)
    t = np.linspace(0.0, 2.0, 81)
    if wrong:
        top = 1.0 / (1.0 - np.exp(-2.0))
        return Answer(problem, t, [unit * top * (1.0 - np.exp(-t))], unit * top + 0.0 * t)
    return Answer(problem, t, [unit * np.sinh(t) / np.sinh(2.0)], unit * np.exp(t) / np.sinh(2.0))


@PAIRS.add("spring at its end", "it ignores what the end costs", 0.2)
def _end_cost(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = u from 1 for u^2 over 1 s and 3 x(1)^2: it moves by 3/4."""
    problem, leg, _, u = integrator(unit, (0.0, 1.0), start=1.0)
    problem.minimize(cost * (leg.integral(u**2) + 3.0 * leg.final_state("x") ** 2) / unit**2)
    t, way = np.linspace(0.0, 1.0, 11), 0.4 if wrong else 0.75
    return Answer(problem, t, [unit * (1.0 - way * t)], -unit * way + 0.0 * t)


@PAIRS.add("price of time", "it arrives later than is worth it", 0.05)
def _price_of_time(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = u over 1 for u^2 + 1: T = 1."""
    problem, leg, _, u = integrator(unit, (0.0, (0.1, 9.0)), end=1.0)
    problem.minimize(cost * (leg.integral(u**2) / unit**2 + leg.final_time))
    last = 1.5 if wrong else 1.0
    t = np.linspace(0.0, last, 21)
    return Answer(problem, t, [unit * t / last], unit / last + 0.0 * t)


@PAIRS.add("start in a range", "it begins at the far end of the range", 1.0)
def _start_in_range(unit: float, cost: float, wrong: bool) -> Answer:
    """From anywhere between 1 and 2 to 0 in 1 s: from 1."""
    problem, leg, _, u = integrator(unit, (0.0, 1.0), start=(1.0, 2.0), end=0.0)
    problem.minimize(cost * leg.integral(u**2) / unit**2)
    t, start = np.linspace(0.0, 1.0, 11), 2.0 if wrong else 1.0
    return Answer(problem, t, [unit * start * (1.0 - t)], -unit * start + 0.0 * t)


@PAIRS.add("saddle of a start", "the start is where the cost is largest over it", 0.1, first_order=False)
def _saddle_start(unit: float, cost: float, wrong: bool) -> Answer:
    """From anywhere between -2 and 2 to 1 in 1 s, where the start costs by its place: a hill at 0 or a hollow."""
    problem, leg, _, u = integrator(unit, (0.0, 1.0), start=(-2.0, 2.0), end=1.0)
    bend = -1.5 if wrong else 0.5
    start = leg.initial_state("x") / unit
    # (1 - x0)^2 + bend x0^2 + 2 x0 is stationary at 0.
    problem.minimize(cost * (leg.integral(u**2) / unit**2 + bend * start**2 + 2.0 * start))
    t = np.linspace(0.0, 1.0, 11)
    return Answer(problem, t, [unit * t], unit + 0.0 * t)


@PAIRS.add("end in a range", "it goes farther than it must", 0.01, kind="at a limit")
def _end_in_range(unit: float, cost: float, wrong: bool) -> Answer:
    """In 1 s to anywhere between 1 and 2: to 1."""
    problem, leg, _, u = line(unit, end=(1.0, 2.0))
    problem.minimize(cost * leg.integral(u**2))
    t, end = np.linspace(0.0, 1.0, 11), 1.01 if wrong else 1.0
    return Answer(problem, t, [unit * end * t], 0 * t + unit * end)


@PAIRS.add("free start", "it begins too early", 0.05, kind="at a limit")
def _free_start(unit: float, cost: float, wrong: bool) -> Answer:
    """Over 1 up to 5 s, where beginning later earns 1/4 a second: it takes 2 s."""
    problem, leg, _, u = integrator(unit, ((0.0, 4.5), 5.0), end=1.0)
    problem.minimize(cost * (leg.integral(u**2) / unit**2 - 0.25 * leg.initial_time))
    takes = 2.5 if wrong else 2.0
    t = np.linspace(5.0 - takes, 5.0, 21)
    return Answer(problem, t, [unit * (t - t[0]) / takes], 0 * t + unit / takes)


@PAIRS.add("periodic tracking", "it swings too far", 0.1)
def _periodic_tracking(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, x, u = line(unit, start=None)
    problem.link(leg, leg, time=False)
    w = 2 * np.pi
    problem.minimize(cost * leg.integral((x - ca.sin(w * leg.model.time)) ** 2 + u**2))
    height = (1.5 if wrong else 1.0) / (1 + w**2)
    return Answer(problem, T, unit * height * np.sin(w * T), unit * height * w * np.cos(w * T))


@PAIRS.add("wavy end cost", "a crest of the end cost", 0.5, first_order=False)
def _wavy_end(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = line(unit)
    end = leg.final_state("x") / unit
    problem.minimize(cost * (leg.integral(0.1 * u**2) + ca.cos(4 * end)))
    between = (1.3, 1.8) if wrong else (2.0, 2.7)  # a crest, and a dale that is not the deepest
    c = scipy.optimize.brentq(lambda c: 0.2 * c - 4 * np.sin(4 * c), *between)
    return Answer(problem, T, unit * c * T, unit * c + 0 * T)


@PAIRS.add("time window around 5 s", "it is too early", 0.05)
def _window(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = line(unit, ((0.0, 20.0), (0.0, 20.0)), end=1.0)
    problem.minimize(cost * leg.integral(u**2 + (leg.model.time - 5) ** 2))
    # u^2 = v^2 on the way: lam = -2u constant, H = (t-5)^2 - u^2 + ... at ends 0: (t0-5)^2 = u^2
    last = np.sqrt(2)
    t = 5 - (0.3 if wrong else 0.0) - last / 2 + last * T
    return Answer(problem, t, unit * T, unit / last + 0 * T)


@PAIRS.add("cost over gain", "it goes too slowly", 0.02)
def _ratio(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = line(unit)
    problem.minimize(cost * (1 + leg.integral(u**2)) / (leg.final_state("x") / unit))
    c = 0.8 if wrong else 1.0
    return Answer(problem, T, unit * c * T, unit * c + 0 * T)


@PAIRS.add("two wells of the control", "it stands between the wells", 1.0)
def _two_wells(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = line(unit, end=0.5)
    problem.minimize(cost * leg.integral((u**2 - 1) ** 2))
    if wrong:
        return Answer(problem, T, unit * 0.5 * T, unit * 0.5 + 0 * T)
    t, arc = arcs(0.75, 0.25)
    return Answer(problem, t, unit * np.where(arc == 0, t, 1.5 - t), unit * np.where(arc == 0, 1.0, -1.0))


@PAIRS.add("two ends of a range", "it ends where the cost is largest", 0.5, first_order=False)
def _range(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = line(unit, end=(-1.0, 1.0))
    end = leg.final_state("x") / unit
    problem.minimize(cost * (leg.integral(u**2) - 3 * end**2 + 0.1 * end))
    c = 0.1 / 4 if wrong else 1.0
    return Answer(problem, T, unit * c * T, unit * c + 0 * T)


@PAIRS.add("constant as a state", "the cost is largest over the constant", 0.5, first_order=False)
def _constant_state(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = u + k and k' = 0: (1 - k)^2 + bend (k - 1/2)^2 + k is stationary at k = 1/2."""
    rates: Rates = lambda x, k, u: [u + k, 0 * k]  # noqa: E731
    problem, leg, _, (u,) = one_phase("constant state", "x k", "u", rates, (0.0, 1.0))
    leg.initial(x=0.0)
    leg.final(x=unit)
    k, bend = leg.final_state("k") / unit, -3.0 if wrong else 0.5
    problem.minimize(cost * (leg.integral((u / unit) ** 2) + bend * (k - 0.5) ** 2 + k))
    return Answer(problem, T, [unit * T, unit * 0.5 + 0 * T], unit * 0.5 + 0 * T)


@PAIRS.add("gain as a state", "its gain is 10 % off", 0.01)
def _gain_state(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = -k x with k' = 0 and no control: from 1 to e^-k; 3 (x - 1/2)^2 + k^2 / 10 over the constant k."""
    problem, leg, _, _ = one_phase("gain", "x k", "", lambda x, k: [-k * x, 0 * k], (0.0, 1.0))
    leg.initial(x=unit)
    x, k = leg.final_state("x") / unit, leg.final_state("k")
    problem.minimize(cost * (3 * (x - 0.5) ** 2 + k**2 / 10))
    value = scipy.optimize.brentq(lambda k: -6 * (np.exp(-k) - 0.5) * np.exp(-k) + k / 5, 0.1, 1.0)
    value = value * (1.1 if wrong else 1.0)
    return Answer(problem, T, [unit * np.exp(-value * T), value + 0 * T], np.zeros((0, T.size)))


@PAIRS.add("time before a turning point", "it is the dearest arrival", 0.1, first_order=False)
def _late_arrival(unit: float, cost: float, wrong: bool) -> Answer:
    """u^2 - x^2 + 2 over any time to 1: x = sqrt(2) sin t; 1 is passed on the way up and on the way down."""
    problem, leg, x, u = line(unit, (0.0, (0.1, 3.0)), end=1.0)
    problem.minimize(cost * leg.integral(u**2 - x**2 + 2))
    t = (0.75 if wrong else 0.25) * np.pi * T
    return Answer(problem, t, unit * np.sqrt(2) * np.sin(t), unit * np.sqrt(2) * np.cos(t))


@PAIRS.add("moved by 1e8", "it is 1 % off", 0.01)
def _far_origin(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest over 1 in 1 s, 1e8 away from the origin, where a float ends at 1e-8."""
    problem, leg, _, a = cart(unit, (0.0, 1.0), start=(1e8, 0.0), end=(1e8 + 1.0, 0.0))
    problem.minimize(cost * leg.integral((a / unit) ** 2))
    q, v, force = rest_to_rest(bend=0.3 if wrong else 0.0)
    return Answer(problem, T, [unit * (1e8 + q), unit * v], unit * force)


@PAIRS.add("clock at 1e6 s", "it pushes unevenly", 0.01)
def _late_clock(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _, a = cart(unit, (1e6, (1e6 + 0.1, 1e6 + 9)), end=(1.0, 0.0))
    # 12 / T^3 + 36 T is least for T = 1
    problem.minimize(cost * (leg.integral((a / unit) ** 2) + 36 * leg.duration))
    q, v, force = rest_to_rest(bend=0.3 if wrong else 0.0)
    return Answer(problem, 1e6 + T, [unit * q, unit * v], unit * force)


@PAIRS.add("cost as a state", "it pushes unevenly", 0.05)
def _mayer(unit: float, cost: float, wrong: bool) -> Answer:
    rates: Rates = lambda x, y, u: [u, u**2 / unit]  # noqa: E731
    problem, leg, _, _ = one_phase("cost as a state", "x y", "u", rates, (0.0, 1.0))
    leg.initial(x=0.0, y=0.0)
    leg.final(x=unit)
    problem.minimize(cost * leg.final_state("y") / unit)
    bend = 0.3 if wrong else 0.0
    u = 1 + bend * (1 - 2 * T)
    spent = T if not wrong else ((1 + bend) ** 3 - u**3) / (6 * bend)
    return Answer(problem, T, [unit * (T + bend * T * (1 - T)), unit * spent], unit * u)


@PAIRS.add("edge of a table", "it pushes unevenly", 0.02)
def _table_edge(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = k(x) u with k from a table, 1 + x, up to the table's last entry: u^2 is even, so is log(1 + x)."""
    problem = go.Problem("table")
    axis = np.linspace(0.0, 1.0, 6)
    lookup = go.table(axis, 1 + axis, name="gain")
    leg, _, (u,) = phase_of(problem, "leg", "x", "u", lambda x, u: [lookup(x / unit) * u], (0.0, 1.0))
    leg.initial(x=0.0)
    leg.final(x=unit)
    problem.minimize(cost * leg.integral((u / unit) ** 2))
    log = np.log(2)
    if wrong:
        return Answer(problem, T, unit * T, unit / (1 + T))
    return Answer(problem, T, unit * np.expm1(log * T), unit * log * ONE)


@PAIRS.add("soft end on its kink", "it ends beside the kink", 0.05)
def _soft_end(unit: float, cost: float, wrong: bool) -> Answer:
    """c^2 + 3 |c - 1| is least at its kink."""
    problem, leg, _x, u = line(unit)
    problem.minimize(cost * (leg.integral(u**2) + 3 * ca.fabs(leg.final_state("x") / unit - 1)))
    c = 0.95 if wrong else 1.0
    return Answer(problem, T, unit * c * T, unit * c * ONE)


@PAIRS.add("focal point moved by a weight", "the weight is too small", np.inf, first_order=False)
def _focal_point(unit: float, cost: float, wrong: bool) -> Answer:
    """u^2 - x^2 for 2 s and c x^2 at the end: at rest a minimum for c > -cot 2 = 0.4577."""
    problem, leg, x, u = line(unit, (0.0, 2.0))
    weight = 0.45 if wrong else 0.47
    problem.minimize(cost * (leg.integral(u**2 - x**2) + weight * (leg.final_state("x") / unit) ** 2))
    return Answer(problem, 2 * T, 0 * T, 0 * T)


@PAIRS.add("speed by a table that bends the way", "it goes straight", 0.1)
def _mirage(unit: float, cost: float, wrong: bool) -> Answer:
    """Least time where the speed grows as 1 + y: an arc of a circle about (1, -1)."""
    grid = np.linspace(-3.0, 5.0, 17)
    speed = go.table(grid, 1 + grid, name="speed")
    problem = go.Problem("mirage")
    rates: Rates = lambda x, y, h: [unit * speed(y / unit) * f(h) for f in (ca.cos, ca.sin)]  # noqa: E731
    leg, _, _ = phase_of(problem, "leg", "x y", "h", rates, (0.0, (0.1, 9.0)))
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


@PAIRS.add("both ends of choice", "together they are a saddle", np.inf, first_order=False)
def _both_ends(unit: float, cost: float, wrong: bool) -> Answer:
    """Stationary from 0 to 1; a product of both outweighs their squares, or not."""
    problem, leg, _, u = line(unit, start=None)
    a, b = leg.initial_state("x") / unit, leg.final_state("x") / unit - 1
    price = a**2 + b**2 + (7.0 if wrong else 1.0) * a * b
    problem.minimize(cost * (leg.integral((u - 1) ** 2) + price))
    return Answer(problem, T, unit * T, unit * ONE)


@PAIRS.add("heading with two wells", "the better one is half a turn away", 0.9)
def _two_headings(unit: float, cost: float, wrong: bool) -> Answer:
    """Speeds of 1.1 at 0 and 2.1 at 180 degrees, each the best of those beside it."""
    problem = go.Problem("headings")

    def rates(x, h):  # type: ignore[no-untyped-def]
        angle = np.pi / 180 * h
        return [unit * (1 + 0.6 * ca.cos(2 * angle) - 0.5 * ca.cos(angle))]

    leg, _, _ = phase_of(problem, "leg", "x", "h", rates, (0.0, (0.1, 9.0)))
    leg.initial(x=0.0)
    leg.final(x=unit)
    problem.minimize(cost * leg.final_time)
    heading, speed = (0.0, 1.1) if wrong else (180.0, 2.1)
    return Answer(problem, T / speed, unit * T, heading * ONE)


@PAIRS.add("throw with the least speed", "at 55 degrees", 0.05)
def _throw(unit: float, cost: float, wrong: bool) -> Answer:
    rates: Rates = lambda x, y, v, w: [v, w, 0 * v, 0 * w - unit]  # noqa: E731
    problem, leg, _, _ = one_phase("throw", "x y v w", "", rates, (0.0, (0.1, 9.0)))
    leg.initial(x=0.0, y=0.0)
    leg.final(x=unit, y=0.0)
    v, w = (leg.initial_state(name) / unit for name in ("v", "w"))
    problem.minimize(cost * (v**2 + w**2))
    angle = np.radians(55 if wrong else 45)
    v, w = np.array([np.cos(angle), np.sin(angle)]) / np.sqrt(np.sin(2 * angle))
    t = 2 * w * T
    states = [v * t, w * t - t**2 / 2, v * ONE, w - t]
    return Answer(problem, t, unit * np.array(states), np.zeros((0, T.size)))
