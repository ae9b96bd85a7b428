"""Closed forms and, beside each, an answer that looks like it and is none: in several units and scales of the cost."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import scipy

import gnc_opt as go
from benchmarks.validation.verdict.statements import Array

SCALES = ((1.0, 1.0), (1e4, 1e-6), (1e-4, 1e6))
"""Unit of the states, and factor of the cost."""

Rates = Callable[..., list[Any]]


@dataclass(frozen=True)
class Answer:
    """A trajectory as samples and the problem that it is an answer of; several phases as mappings."""

    problem: go.Problem
    t: Any
    x: Any
    u: Any
    p: Any = None

    def judge(self) -> go.Verdict:
        """By `go.verify_trajectory`."""
        return go.verify_trajectory(self.problem, self.t, self.x, self.u, self.p)


@dataclass(frozen=True)
class Pair:
    """A right answer and a wrong one.

    Attributes
    ----------
    name, why : str
        Why the wrong one is wrong.
    off : float
        What it loses, relative to the cost, or a relative distance.
    first_order : bool
        Whether the first order tells.
    make : callable
        (unit of the states, factor of the cost, whether wrong) -> Answer.
    kind : str
        Of the wrong one.
    """

    name: str
    why: str
    off: float
    first_order: bool
    make: Callable[[float, float, bool], Answer]
    kind: str = "beside a closed form"


def pairs() -> Iterator[Pair]:
    """Yield all of them."""
    loses = "something else nearby costs less"
    yield Pair(
        "mirror", "a mirror that bends more than the ellipse is nearer beside its middle", 0.1, False, _mirror
    )
    yield Pair("refraction", "the law of sines does not hold", 0.02, True, _refraction)
    yield Pair("loss of speed between phases", loses, 0.1, True, _loss_of_speed)
    yield Pair("three phases of u^2 - x^2", "beyond pi there is no least cost", np.inf, False, _three_phases)
    yield Pair("end in a disc", "it crosses the disc to its far side", 3.0, True, _end_in_disc)
    yield Pair("end on a circle", "it ends on the far side", 3.0, False, _end_on_circle)
    yield Pair("free parameter", "the cost is largest over the parameter", 0.5, False, _free_parameter)
    yield Pair("parameter on its bound", "the cost falls away from the bound", 1.0, True, _bounded_parameter)
    yield Pair("free time", "the cost is largest over the time", 0.5, False, _free_time)
    yield Pair("budget", "less than all of it costs less", 1.0, True, _budget)
    yield Pair("Dido", "the rope hangs on the wrong side", 2.0, True, _dido)
    yield Pair("mixed constraint", "it stays below a limit that is best used", 0.1, True, _mixed)
    yield Pair("speed limit", "it rides on a limit that it need not reach", 0.05, True, _speed_limit)
    yield Pair("least time below a speed limit", "it stays below the limit", 0.05, True, _fast)
    yield Pair("height limit, order 2", "it keeps below a limit that is higher", 0.5, True, _height_limit)
    yield Pair("strong current", "it swims upstream", 1.0, True, _current)
    yield Pair("periodic", "swinging with the free plant costs less than nothing", np.inf, False, _periodic)
    yield Pair("thin keep-out", "it goes through a disc between two samples", 1.0, True, _keep_out)
    yield Pair("limit that dips", "it crosses a limit that is low for an instant", 0.1, True, _dip)
    yield Pair(
        "cross terms", "right without the product of state and control in the cost", 0.05, True, _cross_terms
    )
    yield Pair("free end", "it ends at rest, which nothing asks for", 3.0, True, _free_end)
    yield Pair("soap film", "the deep catenary has more area", 0.1, False, _soap_film)


def _phase(
    problem: go.Problem, name: str, states: str, controls: str, rates: Rates, time: Any
) -> tuple[go.Phase, list[Any], list[Any]]:
    """Return a phase of a model of its own, its states and its controls."""
    model = go.Model(name)
    x, u = [model.state(n) for n in states.split()], [model.control(n) for n in controls.split()]
    model.ode(dict(zip(x, rates(*x, *u), strict=True)))
    leg = problem.phase(name, model)
    leg.time(*time)
    return leg, x, u


def _arcs(*durations: float) -> tuple[Array, Array]:
    """Times of arcs one after the other, both ends of each included, and which arc each is of."""
    ends = np.cumsum([0.0, *durations])
    times = np.concatenate([np.linspace(a, b, 21) for a, b in pairwise(ends)])
    return times, np.repeat(np.arange(len(durations)), 21)


# --- several phases ----------------------------------------------------------------------------------------


def _mirror(unit: float, cost: float, wrong: bool) -> Answer:
    """From (-1, 0) to (1, 0) over the middle of y = 1 - bend x^2; the ellipse bends by 1/4."""
    problem, legs = go.Problem("mirror"), []
    for name, time in (("towards", (0.0, (0.5, 5.0))), ("away", ((0.5, 5.0), (1.0, 10.0)))):
        rates: Rates = lambda x, y, h: [unit * ca.cos(h), unit * ca.sin(h)]  # noqa: E731
        legs.append(_phase(problem, name, "x y", "h", rates, time)[0])
    legs[0].initial(x=-unit, y=0.0)
    legs[1].final(x=unit, y=0.0)
    problem.link(*legs)
    x, y = (legs[0].final_state(n) / unit for n in ("x", "y"))
    problem.constrain("mirror", y + (0.6 if wrong else 0.1) * x**2, equals=1.0)
    problem.minimize(cost * legs[1].final_time)
    t, none = np.linspace(0.0, np.sqrt(2), 11), np.zeros(11)
    way = unit * t / np.sqrt(2)
    states = {"towards": [way - unit, way], "away": [way, unit - way]}
    headings = {"towards": none + np.pi / 4, "away": none - np.pi / 4}
    return Answer(problem, {"towards": t, "away": np.sqrt(2) + t}, states, headings)


def _refraction(unit: float, cost: float, wrong: bool) -> Answer:
    """From (0, -1) to (1, 1); above y = 0 half as fast."""
    problem, legs = go.Problem("refraction"), []
    for name, speed, time in (("below", 1.0, (0.0, (0.1, 5.0))), ("above", 0.5, ((0.1, 5.0), (0.2, 10.0)))):
        rates: Rates = lambda x, y, h, c=speed: [unit * c * ca.cos(h), unit * c * ca.sin(h)]  # noqa: E731
        legs.append(_phase(problem, name, "x y", "h", rates, time)[0])
    legs[0].initial(x=0.0, y=-unit)
    legs[0].final(y=0.0)
    legs[1].final(x=unit, y=unit)
    problem.link(*legs)
    problem.minimize(cost * legs[1].final_time)
    sines = lambda x: x / np.hypot(x, 1) - 2 * (1 - x) / np.hypot(1 - x, 1)  # noqa: E731
    x = 0.95 * scipy.optimize.brentq(sines, 0.0, 1.0) if wrong else scipy.optimize.brentq(sines, 0.0, 1.0)
    last, share = np.array([np.hypot(x, 1), 2 * np.hypot(1 - x, 1)]), np.linspace(0.0, 1.0, 11)
    return Answer(
        problem,
        {"below": share * last[0], "above": last[0] + share * last[1]},
        {
            "below": [unit * x * share, unit * (share - 1)],
            "above": [unit * (x + (1 - x) * share), unit * share],
        },
        {"below": 0 * share + np.arctan2(1, x), "above": 0 * share + np.arctan2(1, 1 - x)},
    )


def _loss_of_speed(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest in 1 s; half-way in time the speed is halved."""
    problem, legs, effort = go.Problem("loss of speed"), [], 0.0
    for name, time in (("before", (0.0, 0.5)), ("after", (0.5, 1.0))):
        leg, _, (a,) = _phase(problem, name, "q v", "a", lambda q, v, a: [v, a], time)
        legs.append(leg)
        effort = effort + leg.integral((a / unit) ** 2)
    (q, v), (later, slower) = (
        [end(n) for n in ("q", "v")] for end in (legs[0].final_state, legs[1].initial_state)
    )
    legs[0].initial(q=0.0, v=0.0)
    legs[1].final(q=unit, v=0.0)
    problem.constrain("place", later - q, equals=0.0)
    problem.constrain("speed", slower - 0.5 * v, equals=0.0)
    problem.minimize(cost * effort)
    # Linear forces a + b s from (0, 0), and c + d s up to (1, 0): stationary in the place and speed between them.
    places = np.array([[1 / 8, 1 / 48], [1 / 2, 1 / 8]])  # what a and b make of place and speed after 1/2 s
    squares = np.array([[1 / 2, 1 / 8], [1 / 8, 1 / 24]])  # of the integral of their square
    first, second = np.linalg.inv(places), np.linalg.inv(places)
    back = second @ np.array([[-1.0, -0.25], [0.0, -0.5]])  # what the middle adds to c and d
    hessian = first.T @ squares @ first + back.T @ squares @ back
    middle = np.linalg.solve(hessian, -back.T @ squares @ second @ np.array([1.0, 0.0]))
    middle = middle * np.array([1.0, 1.3]) if wrong else middle
    forces = first @ middle, second @ np.array([1.0, 0.0]) + back @ middle
    s, starts = np.linspace(0.0, 0.5, 21), ((0.0, 0.0), (middle[0], 0.5 * middle[1]))
    x, u = {}, {}
    for name, (a, b), (q0, v0) in zip(("before", "after"), forces, starts, strict=True):
        x[name] = [unit * (q0 + v0 * s + a * s**2 / 2 + b * s**3 / 6), unit * (v0 + a * s + b * s**2 / 2)]
        u[name] = unit * (a + b * s)
    return Answer(problem, {"before": s, "after": 0.5 + s}, x, u)


def _three_phases(unit: float, cost: float, wrong: bool) -> Answer:
    problem, legs, total = go.Problem("three phases"), [], 0.0
    last = 4.0 if wrong else 2.8
    for k in range(3):
        time = k * last / 3, (k + 1) * last / 3
        leg, (x,), (u,) = _phase(problem, f"leg_{k}", "x", "u", lambda x, u: [u], time)
        legs.append(leg)
        total = total + leg.integral((u / unit) ** 2 - (x / unit) ** 2)
    legs[0].initial(x=0.2 * unit)
    legs[2].final(x=0.3 * unit)
    for before, after in pairwise(legs):
        problem.link(before, after)
    problem.minimize(cost * total)
    b = (0.3 - 0.2 * np.cos(last)) / np.sin(last)
    t = {f"leg_{k}": np.linspace(k * last / 3, (k + 1) * last / 3, 41) for k in range(3)}
    x = {name: unit * (0.2 * np.cos(s) + b * np.sin(s)) for name, s in t.items()}
    return Answer(problem, t, x, {name: unit * (b * np.cos(s) - 0.2 * np.sin(s)) for name, s in t.items()})


# --- ends, times, parameters, integrals --------------------------------------------------------------------


def _moved(unit: float, time: Any = (0.0, 1.0)) -> tuple[go.Problem, go.Phase, Any, Any]:
    """A point on a line that starts at 0, and its speed, both in units."""
    problem = go.Problem("line")
    leg, (x,), (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [u], time)
    leg.initial(x=0.0)
    return problem, leg, x / unit, u / unit


def _towards_disc(unit: float, cost: float, wrong: bool, limits: dict[str, float]) -> Answer:
    problem = go.Problem("disc")
    leg, _, (u, w) = _phase(problem, "leg", "x y", "u w", lambda x, y, u, w: [u, w], (0.0, 1.0))
    leg.initial(x=0.0, y=0.0)
    x, y = (leg.final_state(n) / unit for n in ("x", "y"))
    problem.constrain("disc", (x - 3) ** 2 + y**2, **limits)
    problem.minimize(cost * leg.integral((u**2 + w**2) / unit**2))
    t, far = np.linspace(0.0, 1.0, 21), unit * (4.0 if wrong else 2.0)
    return Answer(problem, t, [far * t, 0 * t], [0 * t + far, 0 * t])


def _end_in_disc(unit: float, cost: float, wrong: bool) -> Answer:
    return _towards_disc(unit, cost, wrong, {"upper": 1.0})


def _end_on_circle(unit: float, cost: float, wrong: bool) -> Answer:
    return _towards_disc(unit, cost, wrong, {"equals": 1.0})


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


def _free_parameter(unit: float, cost: float, wrong: bool) -> Answer:
    """(1 - k)^2 / 2 + bend (k - 1/2)^2 + k / 2 is stationary at k = 1/2."""
    bend = -2.0 if wrong else 2.0
    return _with_parameter(unit, cost, -3.0, 3.0, lambda k: bend * (k - 0.5) ** 2 + 0.5 * k, 0.5)


def _bounded_parameter(unit: float, cost: float, wrong: bool) -> Answer:
    return _with_parameter(unit, cost, 0.0, 2.0 if wrong else 0.5, lambda k: 0 * k, 2.0 if wrong else 0.5)


def _free_time(unit: float, cost: float, wrong: bool) -> Answer:
    """1 / T + T + bend (T - 1)^2 is stationary at T = 1."""
    problem, leg, _, u = _moved(unit, (0.0, (0.2, 3.0)))
    leg.final(x=unit)
    last = leg.final_time
    problem.minimize(cost * (leg.integral(u**2) + last + (-3.0 if wrong else 1.0) * (last - 1) ** 2))
    t = np.linspace(0.0, 1.0, 21)
    return Answer(problem, t, unit * t, 0 * t + unit)


def _budget(unit: float, cost: float, wrong: bool) -> Answer:
    """An effort of 4 leads to 2; to 3 it is too far, at 1 it would have been enough."""
    problem, leg, _, u = _moved(unit)
    problem.constrain("effort", leg.integral(u**2), upper=4.0)
    problem.minimize(cost * (leg.final_state("x") / unit - (1.0 if wrong else 3.0)) ** 2)
    t = np.linspace(0.0, 1.0, 21)
    return Answer(problem, t, 2 * unit * t, 0 * t + 2 * unit)


def _dido(unit: float, cost: float, wrong: bool) -> Answer:
    """The largest area below a rope of given length: an arc of a circle."""
    problem, leg, y, u = _moved(unit)
    leg.final(x=0.0)
    radius = 0.6
    problem.constrain("length", leg.integral(ca.sqrt(1 + u**2)), upper=2 * radius * np.arcsin(0.5 / radius))
    problem.minimize(-cost * leg.integral(y))
    t = np.linspace(0.0, 1.0, 161)
    height, side = np.sqrt(radius**2 - (t - 0.5) ** 2), unit * (-1.0 if wrong else 1.0)
    return Answer(problem, t, side * (height - height[0]), -side * (t - 0.5) / height)


def _free_end(unit: float, cost: float, wrong: bool) -> Answer:
    problem = go.Problem("free end")
    leg, _, (a,) = _phase(problem, "leg", "q v", "a", lambda q, v, a: [v, a], (0.0, 1.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=unit)
    problem.minimize(cost * leg.integral((a / unit) ** 2))
    t = np.linspace(0.0, 1.0, 31)
    if wrong:
        return Answer(
            problem, t, [unit * (3 * t**2 - 2 * t**3), unit * (6 * t - 6 * t**2)], unit * (6 - 12 * t)
        )
    return Answer(
        problem, t, [unit * (3 * t**2 - t**3) / 2, unit * (6 * t - 3 * t**2) / 2], unit * (3 - 3 * t)
    )


# --- limits along the way ----------------------------------------------------------------------------------


def _mixed(unit: float, cost: float, wrong: bool) -> Answer:
    """As far as possible with x + u <= 1."""
    problem, leg, x, u = _moved(unit)
    leg.bounds(u=(0.0, 2.0 * unit))
    leg.path("sum", x + u, upper=1.0)
    problem.maximize(cost * leg.final_state("x") / unit)
    t, share = np.linspace(0.0, 1.0, 41), 0.8 if wrong else 1.0
    return Answer(problem, t, unit * (1 - np.exp(-share * t)), unit * share * np.exp(-share * t))


def _cart(time: Any, unit: float, **bounds: Any) -> tuple[go.Problem, go.Phase, Any]:
    """From rest to rest over one unit; the force is in units."""
    problem = go.Problem("cart")
    leg, _, (a,) = _phase(problem, "leg", "q v", "a", lambda q, v, a: [v, a], (0.0, time))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=unit, v=0.0)
    leg.bounds(**bounds)
    return problem, leg, a / unit


def _trapezium(top: float, push: float) -> tuple[Array, Array, Array, Array]:
    """Times, way, speed and force from rest to rest over 1, at a speed ``top``, reached and left by ``push``."""
    rise = top / push
    last = 1 / top + rise
    t, arc = _arcs(rise, last - 2 * rise, rise)
    way = np.choose(arc, [push * t**2 / 2, top * (t - rise / 2), 1 - push * (last - t) ** 2 / 2])
    speed = np.choose(arc, [push * t, top + 0 * t, push * (last - t)])
    return t, way, speed, np.choose(arc, [push, 0.0, -push])


def _speed_limit(unit: float, cost: float, wrong: bool) -> Answer:
    """The least effort in 1 s; without a limit the speed reaches 1.5."""
    problem, leg, a = _cart(1.0, unit, v=(None, (1.6 if wrong else 1.3) * unit))
    problem.minimize(cost * leg.integral(a**2))
    if wrong:
        t, way, speed, force = _trapezium(1.6, 1.6 / 0.375)
    else:
        rise = 1.5 * (1 - 1 / 1.3)
        t, arc = _arcs(rise, 1 - 2 * rise, rise)
        left = np.choose(arc, [1 - t / rise, 0 * t, 1 - (1 - t) / rise])
        way = 1.3 * (t + rise / 3 * np.choose(arc, [left**3 - 1, 0 * t - 1, -1 - left**3]))
        speed, force = 1.3 * (1 - left**2), 2.6 / rise * left * np.choose(arc, [1, 0, -1])
    return Answer(problem, t, [unit * way, unit * speed], unit * force)


def _fast(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _ = _cart((0.1, 9.0), unit, a=(-8.0 * unit, 8.0 * unit), v=(None, 1.3 * unit))
    problem.minimize(cost * leg.final_time)
    t, way, speed, force = _trapezium(1.2 if wrong else 1.3, 8.0)
    return Answer(problem, t, [unit * way, unit * speed], unit * force)


def _height_limit(unit: float, cost: float, wrong: bool) -> Answer:
    """Thrown up, and back in 1 s with the least effort, below a ceiling (Bryson, Denham & Dreyfus 1963)."""
    problem = go.Problem("ceiling")
    leg, _, (a,) = _phase(problem, "leg", "q v", "a", lambda q, v, a: [v, a], (0.0, 1.0))
    leg.initial(q=0.0, v=unit)
    leg.final(q=0.0, v=-unit)
    leg.bounds(q=(None, (0.2 if wrong else 0.1) * unit))
    problem.minimize(cost * leg.integral((a / unit) ** 2))
    t, arc = _arcs(0.3, 0.4, 0.3)
    left = np.choose(arc, [1 - t / 0.3, 0 * t, 1 - (1 - t) / 0.3])
    states = [unit * 0.1 * (1 - left**3), unit * left**2 * np.choose(arc, [1, 0, -1])]
    return Answer(problem, t, states, -unit * 2 / 0.3 * left)


def _keep_out(unit: float, cost: float, wrong: bool) -> Answer:
    """Straight past a disc or through it; its diameter is a hundredth of the distance between samples."""
    problem = go.Problem("keep-out")
    rates: Rates = lambda x, y, h: [unit * ca.cos(h), unit * ca.sin(h)]  # noqa: E731
    leg, (x, y), _ = _phase(problem, "leg", "x y", "h", rates, (0.0, (0.1, 9.0)))
    leg.initial(x=-unit, y=0.0)
    leg.final(x=unit, y=0.0)
    beside = 0.0 if wrong else 3e-3
    leg.path("keep_out", ((x / unit - 0.333) ** 2 + (y / unit - beside) ** 2) / 1e-6, lower=1.0)
    problem.minimize(cost * leg.final_time)
    t = np.linspace(0.0, 2.0, 11)
    return Answer(problem, t, [unit * (t - 1), 0 * t], 0 * t)


def _dip(unit: float, cost: float, wrong: bool) -> Answer:
    """The limit dips by 0.5 for a thousandth of the time; the speed there is 0.87 or 1.46."""
    problem, leg, a = _cart(1.0, unit)
    when = 0.4137 if wrong else 0.1763
    low = 0.5 * ca.exp(-(((leg.model.time - when) / 1e-3) ** 2))
    leg.path("speed", leg.model.symbol("v") / unit + low, upper=1.8)
    problem.minimize(cost * leg.integral(a**2))
    t = np.linspace(0.0, 1.0, 41)
    return Answer(problem, t, [unit * (3 * t**2 - 2 * t**3), unit * (6 * t - 6 * t**2)], unit * (6 - 12 * t))


# --- others ------------------------------------------------------------------------------------------------


def _current(unit: float, cost: float, wrong: bool) -> Answer:
    """To (3, 0) in a current of 2, along or against it."""
    problem = go.Problem("current")
    rates: Rates = lambda x, y, h: [unit * (ca.cos(h) + 2), unit * ca.sin(h)]  # noqa: E731
    leg, _, _ = _phase(problem, "leg", "x y", "h", rates, (0.0, (0.1, 9.0)))
    leg.initial(x=0.0, y=0.0)
    leg.final(x=3 * unit, y=0.0)
    problem.minimize(cost * leg.final_time)
    speed, heading = (1.0, np.pi) if wrong else (3.0, 0.0)
    t = np.linspace(0.0, 3 / speed, 21)
    return Answer(problem, t, [unit * speed * t, 0 * t], 0 * t + heading)


def _periodic(unit: float, cost: float, wrong: bool) -> Answer:
    """At rest; a swing in one period of the free plant needs no force."""
    problem = go.Problem("swing")
    leg, (_, v), (u,) = _phase(problem, "leg", "x v", "u", lambda x, v, u: [v, u - x], (0.0, 2 * np.pi))
    problem.link(leg, leg, time=False)
    problem.minimize(cost * leg.integral((u**2 + (-0.5 if wrong else 0.5) * v**2) / unit**2))
    t = np.linspace(0.0, 2 * np.pi, 61)
    return Answer(problem, t, np.zeros((2, t.size)), 0 * t)


def _cross_terms(unit: float, cost: float, wrong: bool) -> Answer:
    """x^2 + u^2 + x u with a free end: lambda' = -2 x - u, u = -(lambda + x) / 2."""
    problem, leg, x, u = _moved(unit, (0.0, 1.5))
    leg.initial(x=unit)
    problem.minimize(cost * leg.integral(x**2 + u**2 + x * u))
    cross = 0.0 if wrong else 1.0
    matrix = np.array([[-cross / 2, -0.5], [cross**2 / 2 - 2, cross / 2]])
    end = scipy.linalg.expm(1.5 * matrix)
    start = np.array([1.0, -end[1, 0] / end[1, 1]])
    t = np.linspace(0.0, 1.5, 61)
    way, costate = np.array([scipy.linalg.expm(s * matrix) @ start for s in t]).T
    return Answer(problem, t, unit * way, -unit * (costate + cross * way) / 2)


def _soap_film(unit: float, cost: float, wrong: bool) -> Answer:
    """y = c cosh(t / c) between rings of radius 1, 0.8 apart: two values of c."""
    problem, leg, y, u = _moved(unit, (0.0, 0.8))
    leg.initial(x=unit)
    leg.final(x=unit)
    problem.minimize(cost * leg.integral(y * ca.sqrt(1 + u**2)))
    least, most = (0.05, 0.3) if wrong else (0.5, 1.0)
    c = float(scipy.optimize.brentq(lambda c: c * np.cosh(0.4 / c) - 1, least, most))
    slope = np.sinh(0.4 / c)
    t = 0.4 + c * np.arcsinh(np.linspace(-slope, slope, 161))
    t[[0, -1]] = 0.0, 0.8
    return Answer(problem, t, unit * c * np.cosh((t - 0.4) / c), unit * np.sinh((t - 0.4) / c))
