"""Closed forms of problems with several parts: phases, links, free starts and ends, integrals, shared limits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import casadi as ca
import numpy as np
import scipy

import gnc_opt as go
from benchmarks.validation.verdict.pairs import Answer, Pair, Rates, _arcs, _phase
from benchmarks.validation.verdict.statements import Array

_KIND = "beside a closed form"


def several() -> Iterator[Pair]:
    """Yield all of them."""
    for name, why, off, first_order, make in (
        ("mass dropped half-way", "it takes no notice of the mass that is dropped", 0.05, True, _mass_drop),
        ("given area", "a sine of the same area costs more", 0.01, True, _area),
        ("periodic tracking", "it swings too far", 0.1, True, _periodic_tracking),
        ("end that a parameter moves", "the parameter is 20 % off", 0.05, True, _moved_end),
        ("nearest of a circle by its angle", "it is the farthest", 1.0, False, _circle_angle),
        ("sum of controls is the state", "it goes straight", 0.01, True, _mixed_equality),
        ("unit vector", "it goes round a corner", 0.1, True, _unit_vector),
        ("limit that falls in time", "it uses 98 % of the limit", 0.01, True, _falling_limit),
        ("wavy end cost", "a crest of the end cost", 0.5, False, _wavy_end),
        ("time window around 5 s", "it is too early", 0.05, True, _window),
        ("intercept", "it is slower than it can be", 0.2, True, _intercept),
        ("three impulses", "they are not the cheapest", 0.1, True, _impulses),
        ("out of a disc", "it leaves by the far side", 1.0, False, _out_of_disc),
        ("oscillator in least time", "its three arcs take longer", 0.05, True, _oscillator),
        ("cost over gain", "it goes too slowly", 0.02, True, _ratio),
        ("cone of thrust", "it pushes more than the cone asks for", 0.2, True, _cone),
        ("two wells of the control", "it stands between the wells", 1.0, True, _two_wells),
        ("drained tank", "its valve is not open", 0.1, True, _tank),
        ("phase that must last", "it lasts longer", 0.1, True, _must_last),
        ("round a disc with a bounded vector", "it keeps away by 1 %", 0.01, True, _vector_round_disc),
        ("only one way", "it goes at full speed and waits", 0.1, True, _only_way),
        ("chatter", "it comes to rest as fast as it can", 0.001, True, _fuller),
        ("end on a parabola", "it ends at its top, which is no nearest point", 0.1, False, _parabola),
        ("constant as a state", "the cost is largest over the constant", 0.5, False, _constant_state),
        ("constant as a state, bang", "the cost is largest over the constant", 0.1, False, _constant_bang),
        ("gain as a state", "its gain is 10 % off", 0.01, True, _gain_state),
        ("two ends of a range", "it ends where the cost is largest", 0.5, False, _range),
    ):
        yield Pair(name, why, off, first_order, make, _KIND)


def _line(unit: float, time: Any = (0.0, 1.0)) -> tuple[go.Problem, go.Phase, Any, Any]:
    """A point on a line that starts at 0, and its speed, both in units."""
    problem = go.Problem("line")
    leg, (x,), (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [u], time)
    leg.initial(x=0.0)
    return problem, leg, x / unit, u / unit


def _plane(
    unit: float, time: Any = (0.0, 1.0), **start: float
) -> tuple[go.Problem, go.Phase, tuple[Any, Any], tuple[Any, Any]]:
    """A point in the plane, and its velocity, both in units."""
    problem = go.Problem("plane")
    leg, (x, y), (u, w) = _phase(problem, "leg", "x y", "u w", lambda x, y, u, w: [u, w], time)
    leg.initial(**{name: unit * start.get(name, 0.0) for name in "xy"})
    return problem, leg, (x / unit, y / unit), (u / unit, w / unit)


T = np.linspace(0.0, 1.0, 61)
"""Samples of a second, or of a share of the way."""


def _mass_drop(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest in 2 s with a mass of 2, then of 1/2: the costate of v is linear, a = (c + d t) / m^2."""
    problem, legs, effort = go.Problem("mass drop"), [], 0.0
    for name, mass, time in (("heavy", 2.0, (0.0, 1.0)), ("light", 0.5, (1.0, 2.0))):
        rates: Rates = lambda q, v, f, m=mass: [v, f / m]  # noqa: E731
        leg, _, (f,) = _phase(problem, name, "q v", "f", rates, time)
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


def _area(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, x, u = _line(unit)
    leg.final(x=0.0)
    problem.constrain("area", leg.integral(x), lower=1.0)
    problem.minimize(cost * leg.integral(u**2))
    if wrong:
        return Answer(
            problem, T, unit * np.pi / 2 * np.sin(np.pi * T), unit * np.pi**2 / 2 * np.cos(np.pi * T)
        )
    return Answer(problem, T, unit * 6 * T * (1 - T), unit * 6 * (1 - 2 * T))


def _periodic_tracking(unit: float, cost: float, wrong: bool) -> Answer:
    problem = go.Problem("periodic")
    leg, (x,), (u,) = _phase(problem, "leg", "x", "u", lambda x, u: [u], (0.0, 1.0))
    problem.link(leg, leg, time=False)
    w = 2 * np.pi
    problem.minimize(cost * leg.integral((x / unit - ca.sin(w * leg.model.time)) ** 2 + (u / unit) ** 2))
    height = (1.5 if wrong else 1.0) / (1 + w**2)
    return Answer(problem, T, unit * height * np.sin(w * T), unit * height * w * np.cos(w * T))


def _moved_end(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = _line(unit)
    s = problem.parameter("s", lower=-9.0, upper=9.0, guess=0.5)
    problem.constrain("end", leg.final_state("x") / unit - s, equals=0.0)
    problem.minimize(cost * (leg.integral(u**2) + (s - 2) ** 2))
    value = 0.8 if wrong else 1.0
    return Answer(problem, T, unit * value * T, unit * value + 0 * T, [value])


def _circle_angle(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _, (u, w) = _plane(unit)
    angle = problem.parameter("angle", lower=-9.0, upper=9.0, guess=0.5)
    problem.constrain("x", leg.final_state("x") / unit - 3 - ca.cos(angle), equals=0.0)
    problem.constrain("y", leg.final_state("y") / unit - 1 - ca.sin(angle), equals=0.0)
    problem.minimize(cost * leg.integral(u**2 + w**2))
    value = np.arctan2(1, 3) + (0.0 if wrong else np.pi)
    end = np.array([3 + np.cos(value), 1 + np.sin(value)]) * unit
    return Answer(problem, T, np.outer(end, T), np.outer(end, 1 + 0 * T), [value])


def _mixed_equality(unit: float, cost: float, wrong: bool) -> Answer:
    problem = go.Problem("sum")
    leg, (x,), (u, w) = _phase(problem, "leg", "x", "u w", lambda x, u, w: [u - w], (0.0, 1.0))
    leg.initial(x=0.0)
    leg.final(x=unit)
    leg.path("sum", (u + w - x) / unit, equals=0.0)
    problem.minimize(cost * leg.integral((u**2 + w**2) / unit**2))
    way, speed = (T, 1 + 0 * T) if wrong else (np.sinh(T) / np.sinh(1), np.cosh(T) / np.sinh(1))
    return Answer(problem, T, unit * way, [unit * (way + speed) / 2, unit * (way - speed) / 2])


def _unit_vector(unit: float, cost: float, wrong: bool) -> Answer:
    problem = go.Problem("unit vector")
    leg, _, (c, s) = _phase(
        problem, "leg", "x y", "c s", lambda x, y, c, s: [unit * c, unit * s], (0.0, (0.1, 20.0))
    )
    leg.initial(x=0.0, y=0.0)
    leg.final(x=3 * unit, y=4 * unit)
    leg.path("unit", c**2 + s**2, equals=1.0)
    problem.minimize(cost * leg.final_time)
    if wrong:
        t, arc = _arcs(3.0, 4.0)
        return Answer(
            problem, t, [unit * np.minimum(t, 3.0), unit * np.maximum(t - 3, 0)], [1.0 - arc, 1.0 * arc]
        )
    t = 5 * T
    return Answer(problem, t, [unit * 0.6 * t, unit * 0.8 * t], [0.6 + 0 * t, 0.8 + 0 * t])


def _falling_limit(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = _line(unit)
    leg.path("limit", u + ca.tanh(20 * (leg.model.time - 0.5)), upper=2.0)
    problem.maximize(cost * leg.final_state("x") / unit)
    t = np.linspace(0.0, 1.0, 401)
    share = 0.98 if wrong else 1.0

    def log(s):
        return np.logaddexp(s, -s) - np.log(2)

    way = 2 * t - (log(20 * (t - 0.5)) - log(-10.0)) / 20
    return Answer(problem, t, unit * share * way, unit * share * (2 - np.tanh(20 * (t - 0.5))))


def _wavy_end(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = _line(unit)
    end = leg.final_state("x") / unit
    problem.minimize(cost * (leg.integral(0.1 * u**2) + ca.cos(4 * end)))

    def slope(c):
        return 0.2 * c - 4 * np.sin(4 * c)

    low, high = (1.3, 1.8) if wrong else (2.0, 2.7)  # a crest, and a dale that is not the deepest
    c = scipy.optimize.brentq(slope, low, high)
    return Answer(problem, T, unit * c * T, unit * c + 0 * T)


def _window(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = _line(unit, ((0.0, 20.0), (0.0, 20.0)))
    leg.final(x=unit)
    problem.minimize(cost * leg.integral(u**2 + (leg.model.time - 5) ** 2))
    # u^2 = v^2 on the way: lam = -2u constant, H = (t-5)^2 - u^2 + ... at ends 0: (t0-5)^2 = u^2
    last = np.sqrt(2)
    t = 5 - (0.3 if wrong else 0.0) - last / 2 + last * T
    return Answer(problem, t, unit * T, unit / last + 0 * T)


def _intercept(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, _u = _line(unit, (0.0, (0.1, 9.0)))
    leg.bounds(u=(-3 * unit, 3 * unit))
    problem.constrain("met", leg.final_state("x") / unit - 2 - leg.final_time, equals=0.0)
    problem.minimize(cost * leg.final_time)
    speed = 2.5 if wrong else 3.0
    t = 2 / (speed - 1) * T
    return Answer(problem, t, unit * speed * t, unit * speed + 0 * t)


def _impulses(unit: float, cost: float, wrong: bool) -> Answer:
    problem, legs = go.Problem("impulses"), []
    for name, time in (("one", (0.0, 1.0)), ("two", (1.0, 2.0))):
        legs.append(_phase(problem, name, "q v", "", lambda q, v: [v, 0 * v], time)[0])
    p = [problem.parameter(n, lower=-9.0, upper=9.0, guess=0.1) for n in ("p1", "p2", "p3")]
    one, two = legs
    one.initial(q=0.0)
    two.final(q=unit)
    problem.constrain("first", one.initial_state("v") / unit - p[0], equals=0.0)
    problem.constrain("place", (two.initial_state("q") - one.final_state("q")) / unit, equals=0.0)
    problem.constrain("second", (two.initial_state("v") - one.final_state("v")) / unit - p[1], equals=0.0)
    problem.constrain("third", -two.final_state("v") / unit - p[2], equals=0.0)
    problem.minimize(cost * (p[0] ** 2 + p[1] ** 2 + p[2] ** 2))
    v = 0.3 if wrong else 0.5
    none = np.zeros((0, T.size))
    return Answer(
        problem,
        {"one": T, "two": 1 + T},
        {"one": [unit * v * T, unit * v + 0 * T], "two": [unit * (v + (1 - v) * T), unit * (1 - v) + 0 * T]},
        {"one": none, "two": none},
        [v, 1 - 2 * v, v - 1],
    )


def _out_of_disc(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _, (u, w) = _plane(unit, x=0.5, y=0.0)
    x, y = (leg.final_state(n) / unit for n in "xy")
    problem.constrain("out", x**2 + y**2, lower=4.0)
    problem.minimize(cost * leg.integral(u**2 + w**2))
    end = -2.0 if wrong else 2.0
    return Answer(problem, T, [unit * (0.5 + (end - 0.5) * T), 0 * T], [unit * (end - 0.5) + 0 * T, 0 * T])


def _swing(z: Array, u: float, t: Any) -> Array:
    """Place and speed of x'' = u - x after a time."""
    c, s = np.cos(t), np.sin(t)
    return np.array([u + (z[0] - u) * c + z[1] * s, z[1] * c - (z[0] - u) * s])


def _oscillator(unit: float, cost: float, wrong: bool) -> Answer:
    """To rest by +1 for 1 s and -1 for 0.8 s; pushing the wrong way for 0.2 s first, it takes longer."""
    problem = go.Problem("oscillator")
    leg, _, _ = _phase(problem, "leg", "x v", "u", lambda x, v, u: [v, u - x], (0.0, (0.1, 9.0)))
    start = _swing(_swing(np.zeros(2), -1.0, -0.8), 1.0, -1.0)
    leg.initial(x=unit * start[0], v=unit * start[1])
    leg.final(x=0.0, v=0.0)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.final_time)

    def left(s: Array) -> Array:
        return _swing(_swing(_swing(start, -1.0, 0.2), 1.0, s[0]), -1.0, s[1])

    signs, durations = (1.0, -1.0), (1.0, 0.8)
    if wrong:
        signs, durations = (-1.0, 1.0, -1.0), (0.2, *scipy.optimize.fsolve(left, [1.2, 1.0], xtol=1e-13))
    t, arc = _arcs(*durations)
    states, z = [], start
    for sign, duration in zip(signs, durations, strict=True):
        states.append(_swing(z, sign, np.linspace(0.0, duration, 21)))
        z = states[-1][:, -1]
    return Answer(problem, t, unit * np.hstack(states), unit * np.array(signs)[arc])


def _ratio(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = _line(unit)
    problem.minimize(cost * (1 + leg.integral(u**2)) / (leg.final_state("x") / unit))
    c = 0.8 if wrong else 1.0
    return Answer(problem, T, unit * c * T, unit * c + 0 * T)


def _cone(unit: float, cost: float, wrong: bool) -> Answer:
    problem = go.Problem("cone")
    leg, _, (w, u) = _phase(problem, "leg", "x z", "w u", lambda x, z, w, u: [w, u - unit], (0.0, 1.0))
    leg.initial(x=0.0, z=0.0)
    leg.final(x=unit)
    leg.path("right", (w - 0.5 * u) / unit, upper=0.0)
    leg.path("left", (-w - 0.5 * u) / unit, upper=0.0)
    problem.minimize(cost * leg.integral((u / unit) ** 2))
    push = 2.3 if wrong else 2.0
    return Answer(problem, T, [unit * T, unit * (push - 1) * T], [unit + 0 * T, unit * push + 0 * T])


def _two_wells(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = _line(unit)
    leg.final(x=0.5 * unit)
    problem.minimize(cost * leg.integral((u**2 - 1) ** 2))
    if wrong:
        return Answer(problem, T, unit * 0.5 * T, unit * 0.5 + 0 * T)
    t, arc = _arcs(0.75, 0.25)
    return Answer(problem, t, unit * np.where(arc == 0, t, 1.5 - t), unit * np.where(arc == 0, 1.0, -1.0))


def _tank(unit: float, cost: float, wrong: bool) -> Answer:
    problem = go.Problem("tank")
    leg, _, _ = _phase(problem, "leg", "x", "u", lambda x, u: [-u * ca.sqrt(x * unit)], (0.0, (0.1, 50.0)))
    leg.initial(x=unit)
    leg.final(x=0.01 * unit)
    leg.bounds(u=(0.0, 1.0))
    problem.minimize(cost * leg.final_time)
    u = 0.9 if wrong else 1.0
    t = 1.8 / u * T
    return Answer(problem, t, unit * (1 - u * t / 2) ** 2, u + 0 * t)


def _must_last(unit: float, cost: float, wrong: bool) -> Answer:
    problem = go.Problem("must last")
    go_, _, (u,) = _phase(problem, "go", "x", "u", lambda x, u: [u], (0.0, (0.1, 2.0)))
    stay, _, _ = _phase(problem, "stay", "x", "", lambda x: [0 * x], ((0.1, 2.0), 2.0))
    problem.constrain("rest", stay.final_time - stay.initial_time, lower=0.5)
    go_.initial(x=0.0)
    stay.final(x=unit)
    problem.link(go_, stay)
    problem.minimize(cost * go_.integral((u / unit) ** 2))
    last = 1.2 if wrong else 1.5
    return Answer(
        problem,
        {"go": last * T, "stay": last + (2 - last) * T},
        {"go": [unit * T], "stay": [unit + 0 * T]},
        {"go": [unit / last + 0 * T], "stay": np.zeros((0, T.size))},
    )


def _vector_round_disc(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, (x, y), (u, w) = _plane(unit, (0.0, (0.1, 9.0)), x=-2.0, y=0.0)
    leg.final(x=2 * unit, y=0.0)
    leg.path("speed", u**2 + w**2, upper=1.0)
    leg.path("disc", x**2 + y**2, lower=1.0)
    problem.minimize(cost * leg.final_time)
    r = 1.01 if wrong else 1.0
    straight, beta = np.sqrt(4 - r**2), np.arccos(r / 2)
    turn = (np.pi - 2 * beta) * r
    t, arc = _arcs(straight, turn, straight)
    a0 = np.pi - beta
    touch = r * np.array([np.cos(a0), np.sin(a0)])
    d = (touch - [-2, 0]) / straight
    ang = a0 - (t - straight) / r
    back = t[-1] - t
    px = np.choose(arc, [-2 + d[0] * t, r * np.cos(ang), 2 - d[0] * back])
    py = np.choose(arc, [d[1] * t, r * np.sin(ang), d[1] * back])
    vx = np.choose(arc, [d[0] + 0 * t, np.sin(ang), d[0] + 0 * t])
    vy = np.choose(arc, [d[1] + 0 * t, -np.cos(ang), -d[1] + 0 * t])
    return Answer(problem, t, [unit * px, unit * py], [unit * vx, unit * vy])


def _only_way(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, x, u = _line(unit, (0.0, 1.2 if wrong else 1.0))
    leg.final(x=unit)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.integral(u**2 + 0.3 * x))
    if wrong:
        t, arc = _arcs(1.0, 0.2)
        return Answer(problem, t, unit * np.minimum(t, 1.0), unit * (1.0 - arc))
    return Answer(problem, T, unit * T, unit + 0 * T)


def _fuller(unit: float, cost: float, wrong: bool) -> Answer:
    """Least int x^2 from (1, 0) to rest (Fuller 1961): ever faster switches on x = -c v |v|, cut off after nine."""
    problem = go.Problem("Fuller")
    leg, (x, _), _ = _phase(problem, "leg", "x v", "u", lambda x, v, u: [v, u], (0.0, 4.0))
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
    t, arc = _arcs(*durations, *rest)
    states, z = [], np.array([1.0, 0.0])
    for k, duration in enumerate([*durations, *rest]):
        states.append(after(z, -((-1.0) ** k), np.linspace(0.0, duration, 21)))
        z = states[-1][:, -1]
    still = np.linspace(t[-1], 4.0, 21)
    x = np.hstack([*states, np.zeros((2, 21))])
    return Answer(problem, np.append(t, still), unit * x, unit * np.append(-((-1.0) ** arc), 0 * still))


def _parabola(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _, (u, w) = _plane(unit)
    x, y = (leg.final_state(n) / unit for n in "xy")
    problem.constrain("parabola", y - (2 - x**2), equals=0.0)
    problem.minimize(cost * leg.integral(u**2 + w**2))
    end = np.array([0.0, 2.0]) if wrong else np.array([np.sqrt(1.5), 0.5])
    return Answer(problem, T, unit * np.outer(end, T), unit * np.outer(end, 1 + 0 * T))


def _range(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = _line(unit)
    leg.final(x=(-unit, unit))
    end = leg.final_state("x") / unit
    problem.minimize(cost * (leg.integral(u**2) - 3 * end**2 + 0.1 * end))
    c = 0.1 / 4 if wrong else 1.0
    return Answer(problem, T, unit * c * T, unit * c + 0 * T)


def _constant_state(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = u + k and k' = 0: (1 - k)^2 + bend (k - 1/2)^2 + k is stationary at k = 1/2."""
    problem = go.Problem("constant state")
    leg, _, (u,) = _phase(problem, "leg", "x k", "u", lambda x, k, u: [u + k, 0 * k], (0.0, 1.0))
    leg.initial(x=0.0)
    leg.final(x=unit)
    k, bend = leg.final_state("k") / unit, -3.0 if wrong else 0.5
    problem.minimize(cost * (leg.integral((u / unit) ** 2) + bend * (k - 0.5) ** 2 + k))
    return Answer(problem, T, [unit * T, unit * 0.5 + 0 * T], unit * 0.5 + 0 * T)


def _constant_bang(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest in least time with the push k, |u| <= 1; T = 2 / sqrt(k), and the price of k bends either way."""
    problem = go.Problem("constant state")
    leg, _, (_u,) = _phase(
        problem, "leg", "q v k", "u", lambda q, v, k, u: [v, k * u, 0 * k], (0.0, (0.1, 20.0))
    )
    leg.initial(q=0.0, v=0.0)
    leg.final(q=unit, v=0.0)
    leg.bounds(u=(-1.0, 1.0), k=(0.1 * unit, None))
    k = leg.final_state("k") / unit
    bend = -3.0 if wrong else 2.0
    problem.minimize(cost * (leg.final_time + (k - 1) + bend * (k - 1) ** 2))
    t, arc = _arcs(1.0, 1.0)
    way = np.where(arc == 0, t**2 / 2, 1 - (2 - t) ** 2 / 2)
    speed = np.where(arc == 0, t, 2 - t)
    return Answer(problem, t, [unit * way, unit * speed, unit + 0 * t], np.where(arc == 0, 1.0, -1.0))


def _gain_state(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = -k x with k' = 0 and no control: from 1 to e^-k; 3 (x - 1/2)^2 + k^2 / 10 over the constant k."""
    problem = go.Problem("gain")
    leg, _, _ = _phase(problem, "leg", "x k", "", lambda x, k: [-k * x, 0 * k], (0.0, 1.0))
    leg.initial(x=unit)
    x, k = leg.final_state("x") / unit, leg.final_state("k")
    problem.minimize(cost * (3 * (x - 0.5) ** 2 + k**2 / 10))
    value = scipy.optimize.brentq(lambda k: -6 * (np.exp(-k) - 0.5) * np.exp(-k) + k / 5, 0.1, 1.0)
    value = value * (1.1 if wrong else 1.0)
    return Answer(problem, T, [unit * np.exp(-value * T), value + 0 * T], np.zeros((0, T.size)))
