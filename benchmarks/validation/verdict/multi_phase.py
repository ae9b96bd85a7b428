"""Closed forms of several phases: links, jumps, junctions of choice, vehicles that meet."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
import scipy

import gnc_opt as go
from benchmarks.validation.verdict.answers import ONE, Answer, Pairs, Rates, T, phase_of
from benchmarks.validation.verdict.statements import Array

Kind: TypeAlias = tuple[str, str, Rates]
"""States, controls, rates."""

PAIRS = Pairs()
_LINE: Kind = ("x", "u", lambda x, u: [u])
_CART: Kind = ("q v", "a", lambda q, v, a: [v, a])


def _moves(
    unit: float,
    *,
    kind: Kind = _LINE,
    prices: tuple[float, ...] = (1.0, 1.0),
    linked: bool = True,
    **times: Any,
) -> tuple[go.Problem, list[go.Phase], Any]:
    """Return phases of a system, by their times, and the integral of the squared control in units, times prices.

    Two phases that are linked lead from x = 0 to x = 1.
    """
    problem, legs, effort = go.Problem("phases"), [], 0.0
    for (name, time), price in zip(times.items(), prices, strict=True):
        leg, _, (u,) = phase_of(problem, name, *kind, time)
        legs.append(leg)
        effort = effort + price * leg.integral((u / unit) ** 2)
    if linked:
        problem.link(*legs)
        legs[0].initial(x=0.0)
        legs[1].final(x=unit)
    return problem, legs, effort


@PAIRS.add(
    "mirror", "a mirror that bends more than the ellipse is nearer beside its middle", 0.1, first_order=False
)
def _mirror(unit: float, cost: float, wrong: bool) -> Answer:
    """From (-1, 0) to (1, 0) over the middle of y = 1 - bend x^2; the ellipse bends by 1/4."""
    problem, rates = go.Problem("mirror"), lambda x, y, h: [unit * ca.cos(h), unit * ca.sin(h)]
    times = {"towards": (0.0, (0.5, 5.0)), "away": ((0.5, 5.0), (1.0, 10.0))}
    legs = [phase_of(problem, name, "x y", "h", rates, time)[0] for name, time in times.items()]
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


@PAIRS.add("refraction", "the law of sines does not hold", 0.02)
def _refraction(unit: float, cost: float, wrong: bool) -> Answer:
    """From (0, -1) to (1, 1); above y = 0 half as fast."""
    problem, legs = go.Problem("refraction"), []
    for name, speed, time in (("below", 1.0, (0.0, (0.1, 5.0))), ("above", 0.5, ((0.1, 5.0), (0.2, 10.0)))):
        rates: Rates = lambda x, y, h, c=speed: [unit * c * ca.cos(h), unit * c * ca.sin(h)]  # noqa: E731
        legs.append(phase_of(problem, name, "x y", "h", rates, time)[0])
    legs[0].initial(x=0.0, y=-unit)
    legs[0].final(y=0.0)
    legs[1].final(x=unit, y=unit)
    problem.link(*legs)
    problem.minimize(cost * legs[1].final_time)
    sines = lambda x: x / np.hypot(x, 1) - 2 * (1 - x) / np.hypot(1 - x, 1)  # noqa: E731
    x = 0.95 * scipy.optimize.brentq(sines, 0.0, 1.0) if wrong else scipy.optimize.brentq(sines, 0.0, 1.0)
    below, above, share = np.hypot(x, 1), 2 * np.hypot(1 - x, 1), np.linspace(0.0, 1.0, 11)
    way = {"below": [x * share, share - 1], "above": [x + (1 - x) * share, share]}
    headings = {"below": 0 * share + np.arctan2(1, x), "above": 0 * share + np.arctan2(1, 1 - x)}
    times = {"below": share * below, "above": below + share * above}
    return Answer(problem, times, {name: unit * np.array(x) for name, x in way.items()}, headings)


@PAIRS.add("loss of speed between phases", "something else nearby costs less", 0.1)
def _loss_of_speed(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest in 1 s; half-way in time the speed is halved."""
    problem, legs, effort = _moves(unit, before=(0.0, 0.5), after=(0.5, 1.0), kind=_CART, linked=False)
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


@PAIRS.add("three phases of u^2 - x^2", "beyond pi there is no least cost", np.inf, first_order=False)
def _three_phases(unit: float, cost: float, wrong: bool) -> Answer:
    problem, legs, total = go.Problem("three phases"), [], 0.0
    last = 4.0 if wrong else 2.8
    for k in range(3):
        time = k * last / 3, (k + 1) * last / 3
        leg, (x,), (u,) = phase_of(problem, f"leg_{k}", "x", "u", lambda x, u: [u], time)
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


@PAIRS.add("waypoint between phases", "something else nearby costs less", 0.05)
def _waypoint(unit: float, cost: float, wrong: bool) -> Answer:
    """Over 1 in 2 s, twice as dear after the linkage at 1 s: two thirds of the way before it."""
    problem, _, effort = _moves(unit, cheap=(0.0, 1.0), dear=(1.0, 2.0), prices=(1.0, 2.0))
    problem.minimize(cost * effort)
    way, t = 0.5 if wrong else 2.0 / 3.0, np.linspace(0.0, 1.0, 11)
    states = {"cheap": [unit * way * t], "dear": [unit * (way + (1.0 - way) * t)]}
    controls = {"cheap": unit * way + 0.0 * t, "dear": unit * (1.0 - way) + 0.0 * t}
    return Answer(problem, {"cheap": t, "dear": 1.0 + t}, states, controls)


@PAIRS.add("floor at a link", "it passes the link above the floor", 0.05, kind="at a limit")
def _floor_at_link(unit: float, cost: float, wrong: bool) -> Answer:
    """Up to 1 at a link and down again: the floor 2 t - 1 is met there only."""
    problem, (up, down), effort = _moves(unit, up=(0.0, 1.0), down=(1.0, 2.0))
    down.final(x=0.0)
    up.path("floor", up.model.symbol("x") / unit - 2.0 * up.model.time, lower=-1.0)
    problem.minimize(cost * effort)
    t, top = np.linspace(0.0, 1.0, 21), 1.05 if wrong else 1.0
    states = {"up": [unit * top * t], "down": [unit * top * (1.0 - t)]}
    controls = {"up": 0 * t + unit * top, "down": 0 * t - unit * top}
    return Answer(problem, {"up": t, "down": 1.0 + t}, states, controls)


@PAIRS.add("mass dropped half-way", "it takes no notice of the mass that is dropped", 0.05)
def _mass_drop(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest in 2 s with a mass of 2, then of 1/2: the costate of v is linear, a = (c + d t) / m^2."""
    problem, legs, effort = go.Problem("mass drop"), [], 0.0
    for name, mass, time in (("heavy", 2.0, (0.0, 1.0)), ("light", 0.5, (1.0, 2.0))):
        rates: Rates = lambda q, v, f, m=mass: [v, f / m]  # noqa: E731
        leg, _, (f,) = phase_of(problem, name, "q v", "f", rates, time)
        legs.append(leg)
        effort = effort + leg.integral((f / unit) ** 2)
    legs[0].initial(q=0.0, v=0.0)
    legs[1].final(q=unit, v=0.0)
    problem.link(*legs)
    problem.minimize(cost * effort)
    first, second = (1.0, 1.0) if wrong else (2.0, 0.5)

    def moved(m: float, begin: float, s: Any) -> Any:
        """Way and speed that c = 1 and d = 1 make in a phase that begins at a time, after s."""
        ways = np.array([s**2 / 2, begin * s**2 / 2 + s**3 / 6])
        return ways / m**2, np.array([s, begin * s + s**2 / 2]) / m**2

    way, speed = moved(first, 0.0, 1.0)
    more, faster = moved(second, 1.0, 1.0)
    c = np.linalg.solve(np.array([way + speed + more, speed + faster]), [1.0, 0.0])
    q1, v1 = (c @ part for part in moved(first, 0.0, T))
    q2, v2 = (c @ part for part in moved(second, 1.0, T))
    states = {
        "heavy": [unit * q1, unit * v1],
        "light": [unit * (q1[-1] + v1[-1] * T + q2), unit * (v1[-1] + v2)],
    }
    forces = {"heavy": 2.0 / first**2 * (c[0] + c[1] * T), "light": 0.5 / second**2 * (c[0] + c[1] * (1 + T))}
    return Answer(problem, {"heavy": T, "light": 1 + T}, states, {k: unit * f for k, f in forces.items()})


@PAIRS.add("three impulses", "they are not the cheapest", 0.1)
def _impulses(unit: float, cost: float, wrong: bool) -> Answer:
    problem, times = go.Problem("impulses"), {"one": (0.0, 1.0), "two": (1.0, 2.0)}
    one, two = (
        phase_of(problem, n, "q v", "", lambda q, v: [v, 0 * v], time)[0] for n, time in times.items()
    )
    p = [problem.parameter(n, lower=-9.0, upper=9.0, guess=0.1) for n in ("p1", "p2", "p3")]
    one.initial(q=0.0)
    two.final(q=unit)
    problem.constrain("first", one.initial_state("v") / unit - p[0], equals=0.0)
    problem.constrain("place", (two.initial_state("q") - one.final_state("q")) / unit, equals=0.0)
    problem.constrain("second", (two.initial_state("v") - one.final_state("v")) / unit - p[1], equals=0.0)
    problem.constrain("third", -two.final_state("v") / unit - p[2], equals=0.0)
    problem.minimize(cost * (p[0] ** 2 + p[1] ** 2 + p[2] ** 2))
    v = 0.3 if wrong else 0.5
    t, none = {"one": T, "two": 1 + T}, np.zeros((0, T.size))
    states = {"one": [unit * v * T, unit * v * ONE], "two": [unit * (v + (1 - v) * T), unit * (1 - v) * ONE]}
    return Answer(problem, t, states, dict.fromkeys(t, none), [v, 1 - 2 * v, v - 1])


@PAIRS.add("phase that must last", "it lasts longer", 0.1)
def _must_last(unit: float, cost: float, wrong: bool) -> Answer:
    problem = go.Problem("must last")
    go_, _, (u,) = phase_of(problem, "go", "x", "u", lambda x, u: [u], (0.0, (0.1, 2.0)))
    stay, _, _ = phase_of(problem, "stay", "x", "", lambda x: [0 * x], ((0.1, 2.0), 2.0))
    problem.constrain("rest", stay.final_time - stay.initial_time, lower=0.5)
    go_.initial(x=0.0)
    stay.final(x=unit)
    problem.link(go_, stay)
    problem.minimize(cost * go_.integral((u / unit) ** 2))
    last = 1.2 if wrong else 1.5
    times, states = {"go": last * T, "stay": last + (2 - last) * T}, {"go": unit * T, "stay": unit * ONE}
    return Answer(problem, times, states, {"go": unit / last * ONE, "stay": np.zeros((0, T.size))})


@PAIRS.add("kick at a free time", "the kick comes too early", 0.1)
def _kick(unit: float, cost: float, wrong: bool) -> Answer:
    """A speed of 1 is given for nothing at a time of choice: a is constant at best."""
    times = {"before": (0.0, (0.01, 0.99)), "after": ((0.01, 0.99), 1.0)}
    problem, (one, two), effort = _moves(unit, kind=_CART, linked=False, **times)
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


@PAIRS.add("junction with a price on its time", "the price is largest there", 0.5, first_order=False)
def _priced_junction(unit: float, cost: float, wrong: bool) -> Answer:
    problem, legs, effort = _moves(unit, before=(0.0, (0.1, 0.9)), after=((0.1, 0.9), 1.0))
    problem.minimize(cost * (effort + (-1.0 if wrong else 1.0) * (legs[0].final_time - 0.5) ** 2))
    t = {"before": 0.5 * T, "after": 0.5 + 0.5 * T}
    return Answer(problem, t, {k: [unit * s] for k, s in t.items()}, dict.fromkeys(t, unit * ONE))


@PAIRS.add("dearer after a free junction", "the junction is half-way in time", 0.05)
def _dearer(unit: float, cost: float, wrong: bool) -> Answer:
    """Half of the way before a free junction, the other half four times as dear: a third of the time."""
    problem, legs, effort = _moves(unit, before=(0.0, (0.1, 0.9)), after=((0.1, 0.9), 1.0), prices=(1.0, 4.0))
    legs[0].final(x=0.5 * unit)
    problem.minimize(cost * effort)
    when = 0.5 if wrong else 1 / 3
    t = {"before": when * T, "after": when + (1 - when) * T}
    x = {"before": [unit * 0.5 * T], "after": [unit * (0.5 + 0.5 * T)]}
    return Answer(problem, t, x, {"before": unit * 0.5 / when * ONE, "after": unit * 0.5 / (1 - when) * ONE})


@PAIRS.add("jump of limited size", "it does without the jump", 0.2)
def _limited_jump(unit: float, cost: float, wrong: bool) -> Answer:
    """To 1 in 1 s, 0.2 of it by a jump half-way that costs nothing."""
    problem, legs, effort = _moves(unit, before=(0.0, 0.5), after=(0.5, 1.0), linked=False)
    legs[0].initial(x=0.0)
    legs[1].final(x=unit)
    jump = (legs[1].initial_state("x") - legs[0].final_state("x")) / unit
    problem.constrain("jump", jump, lower=-0.2, upper=0.2)
    problem.minimize(cost * effort)
    size = 0.0 if wrong else 0.2
    t = {"before": 0.5 * T, "after": 0.5 + 0.5 * T}
    x = {"before": [unit * (1 - size) * t["before"]], "after": [unit * (size + (1 - size) * t["after"])]}
    return Answer(problem, t, x, dict.fromkeys(t, unit * (1 - size) * ONE))


@PAIRS.add("two vehicles meet", "they meet half-way though one is dearer", 0.1)
def _meeting(unit: float, cost: float, wrong: bool) -> Answer:
    """From 0 and from 1 in 1 s to the same place, one four times as dear: it does a fifth of the way."""
    problem, legs, effort = _moves(unit, cheap=(0.0, 1.0), dear=(0.0, 1.0), prices=(1.0, 4.0), linked=False)
    legs[0].initial(x=0.0)
    legs[1].initial(x=unit)
    problem.constrain("met", (legs[0].final_state("x") - legs[1].final_state("x")) / unit, equals=0.0)
    problem.minimize(cost * effort)
    place = 0.5 if wrong else 0.8
    x = {"cheap": [unit * place * T], "dear": [unit * (1 - (1 - place) * T)]}
    u = {"cheap": unit * place * ONE, "dear": -unit * (1 - place) * ONE}
    return Answer(problem, {"cheap": T, "dear": T}, x, u)


@PAIRS.add("time shared by two phases", "both take the same time", 0.1)
def _shared_time(unit: float, cost: float, wrong: bool) -> Answer:
    """Ways of 1 and 2, each by a vehicle of its own, for 2 s in all: as fast as each other."""
    problem, legs, effort = _moves(unit, near=(0.0, (0.1, 3.0)), far=(0.0, (0.1, 3.0)), linked=False)
    for leg, way in zip(legs, (1.0, 2.0), strict=True):
        leg.initial(x=0.0)
        leg.final(x=way * unit)
    problem.constrain("time", legs[0].duration + legs[1].duration, upper=2.0)
    problem.minimize(cost * effort)
    first = 1.0 if wrong else 2 / 3
    t = {"near": first * T, "far": (2 - first) * T}
    x = {"near": [unit * T], "far": [unit * 2 * T]}
    return Answer(problem, t, x, {"near": unit / first * ONE, "far": unit * 2 / (2 - first) * ONE})


@PAIRS.add("loop of given area over a point", "its two arcs are unlike", 0.01)
def _lens(unit: float, cost: float, wrong: bool) -> Answer:
    """From (0, 0) over (0, 1) and back round an area: two equal arcs of 90 degrees."""
    problem, legs, effort, area = go.Problem("lens"), [], 0.0, 0.0
    for name, time in (("there", (0.0, 1.0)), ("back", (1.0, 2.0))):
        leg, (x, y), (u, w) = phase_of(problem, name, "x y", "u w", lambda x, y, u, w: [u, w], time)
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


@PAIRS.add("link that doubles", "costates go on without a jump", 0.1)
def _doubling_link(unit: float, cost: float, wrong: bool) -> Answer:
    """To c in 1 s, from 2 c to 1 in 1 s: c^2 + (1 - 2 c)^2."""
    problem, legs, effort = _moves(unit, before=(0.0, 1.0), after=(1.0, 2.0), linked=False)
    legs[0].initial(x=0.0)
    legs[1].final(x=unit)
    doubled = (legs[1].initial_state("x") - 2 * legs[0].final_state("x")) / unit
    problem.constrain("doubled", doubled, equals=0.0)
    problem.minimize(cost * effort)
    c = 1 / 3 if wrong else 0.4
    x = {"before": [unit * c * T], "after": [unit * (2 * c + (1 - 2 * c) * T)]}
    u = {"before": unit * c * ONE, "after": unit * (1 - 2 * c) * ONE}
    return Answer(problem, {"before": T, "after": 1 + T}, x, u)


@PAIRS.add(
    "square of the place between phases", "a place where the effort is largest", 0.5, first_order=False
)
def _square_between(unit: float, cost: float, wrong: bool) -> Answer:
    """From 0.1 to m in 1 s, from m^2 to 4 in another."""
    problem, (one, two), effort = _moves(unit, one=(0.0, 1.0), two=(1.0, 2.0), linked=False)
    one.initial(x=0.1 * unit)
    two.final(x=4.0 * unit)
    before, after = one.final_state("x") / unit, two.initial_state("x") / unit
    problem.constrain("square", after - before**2, equals=0.0)
    problem.minimize(cost * effort)
    between = (-0.5, 0.5) if wrong else (1.0, 3.0)
    m = scipy.optimize.brentq(lambda m: 2 * (m - 0.1) - 4 * m * (4 - m**2), *between, xtol=1e-14)
    states = {"one": unit * (0.1 + (m - 0.1) * T), "two": unit * (m**2 + (4 - m**2) * T)}
    controls = {"one": unit * (m - 0.1) * ONE, "two": unit * (4 - m**2) * ONE}
    return Answer(problem, {"one": T, "two": 1 + T}, states, controls)


@PAIRS.add("place and time of a link", "together they are a saddle", 0.1, first_order=False)
def _place_and_time(unit: float, cost: float, wrong: bool) -> Answer:
    problem, (one, _), effort = _moves(unit, one=(0.0, (0.1, 1.9)), two=((0.1, 1.9), 2.0))
    off = (one.final_state("x") / unit - 0.5) * (one.final_time - 1)
    problem.minimize(cost * (effort + (6.0 if wrong else 0.5) * off))
    t = {"one": T, "two": 1 + T}
    return Answer(problem, t, {k: 0.5 * unit * s for k, s in t.items()}, dict.fromkeys(t, 0.5 * unit * ONE))
