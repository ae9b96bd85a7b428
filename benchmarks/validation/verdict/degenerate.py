"""Closed forms where something vanishes: costs, multipliers, second variations."""

from __future__ import annotations

import casadi as ca
import numpy as np

from benchmarks.validation.verdict.answers import (
    Answer,
    Pairs,
    T,
    arcs,
    cart,
    line,
    one_phase,
    one_push_each_way,
    plane,
    rest_to_rest,
)

PAIRS = Pairs("where something vanishes")


@PAIRS.add("perfect tracking", "it drifts off what it follows", 0.001)
def _tracking(unit: float, cost: float, wrong: bool) -> Answer:
    """Follows sin t, which it can."""
    problem, leg, x, _ = line(unit, (0.0, 3.0))
    leg.bounds(u=(-2.0 * unit, 2.0 * unit))
    problem.minimize(cost * (7.0 + leg.integral((x - ca.sin(leg.model.time)) ** 2)))
    t, drift = np.linspace(0.0, 3.0, 81), 1e-3 if wrong else 0.0
    return Answer(problem, t, [unit * (np.sin(t) + drift * t)], unit * (np.cos(t) + drift))


@PAIRS.add("stiff terms", "a soft term is left as it is", 1.0)
def _stiff(unit: float, cost: float, wrong: bool) -> Answer:
    """Two pushes that a weight of a million holds against each other, and a difference of 1 that costs nothing."""
    problem, leg, _, (u, w) = one_phase("stiff", "x", "u w", lambda x, u, w: [u], (0.0, 1.0))
    leg.initial(x=0.0)
    leg.bounds(u=(-5.0 * unit, 5.0 * unit), w=(-5.0 * unit, 5.0 * unit))
    u, w = u / unit, w / unit
    problem.minimize(cost * leg.integral(1e6 * (u + w) ** 2 + (u - w - 1.0) ** 2 + (u - 0.5) ** 2))
    t, push = np.linspace(0.0, 1.0, 11), 0.0 if wrong else 0.5
    return Answer(problem, t, [unit * push * t], [unit * push + 0 * t, -unit * push + 0 * t])


@PAIRS.add("bang to a free end", "it turns round before the end", 0.01)
def _last_bang(unit: float, cost: float, wrong: bool) -> Answer:
    """As far back as possible on average: full push to the end, where costates vanish."""
    problem, leg, (q, _), _ = cart(unit, (0.0, 1.0))
    leg.bounds(a=(-unit, unit))
    problem.minimize(cost * leg.integral(q) / unit)
    t, part = arcs(0.7, 0.3)
    late = np.maximum(t - 0.7, 0.0) if wrong else 0 * t
    push = np.where((part == 1) & wrong, 1.0, -1.0)
    return Answer(problem, t, [unit * (late**2 - t**2 / 2.0), unit * (2.0 * late - t)], unit * push)


@PAIRS.add("price that touches zero", "it pushes the wrong way while the price is low", 0.001)
def _touching(unit: float, cost: float, wrong: bool) -> Answer:
    """Pushes earn (t - 1)^2: full push backwards, at 1 s for nothing."""
    problem, leg, _, u = line(unit, (0.0, 2.0))
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.integral((leg.model.time - 1.0) ** 2 * u))
    t, part = arcs(0.8, 0.4, 0.8)
    push = np.where((part == 1) & wrong, 1.0, -1.0)
    way = np.choose(part, [-t, t - 1.6, -0.4 - (t - 1.2)]) if wrong else -t
    return Answer(problem, t, [unit * way], unit * push)


@PAIRS.add("unstable and long", "it lets go too early", 0.01)
def _unstable(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = x + u from 1 to 0 in 18 s with the least u^2: u falls as exp(-t)."""
    problem, leg, _, (u,) = one_phase("unstable", "x", "u", lambda x, u: [x + u], (0.0, 18.0))
    leg.initial(x=unit)
    leg.final(x=0.0)
    problem.minimize(cost * leg.integral((u / unit) ** 2))
    t = 18.0 * np.linspace(0.0, 1.0, 401) ** 1.5
    rate = 1.2 if wrong else 1.0  # u = -k exp(-rate t) brings x to 0 at 18 s
    strength = (1.0 + rate) / (1.0 - np.exp(-(1.0 + rate) * 18.0))
    # x = exp(t) (1 - k int exp(-(1 + rate) s)), written without the difference of large numbers
    left = strength / (1.0 + rate) * np.exp(-rate * t) * -np.expm1(-(1.0 + rate) * (18.0 - t))
    return Answer(problem, t, [unit * left], -unit * strength * np.exp(-rate * t))


@PAIRS.add("nearest meridian", "over a quarter of the sphere the pole is nearer", 0.1, first_order=False)
def _meridian(unit: float, cost: float, wrong: bool) -> Answer:
    """From the equator of a sphere to a meridian, 1 or 2 rad away."""
    arc = 2.0 if wrong else 1.0
    problem, leg, (theta, _), (a, b) = plane(unit, start=(np.pi / 2.0, 0.0), end=(None, arc))
    problem.minimize(cost * leg.integral(a**2 + ca.sin(theta) ** 2 * b**2))
    t = np.linspace(0.0, 1.0, 21)
    return Answer(problem, t, [0 * t + unit * np.pi / 2.0, unit * arc * t], [0 * t, 0 * t + unit * arc])


@PAIRS.add("parameter and end", "together they are a saddle", 1.0, first_order=False)
def _parameter_and_end(unit: float, cost: float, wrong: bool) -> Answer:
    """Beside u = 1 and k = 0: s^2 + k^2 + c k s of an end off by s and a parameter k is definite for c < 2."""
    problem, leg, _, u = line(unit)
    k = problem.parameter("k", lower=-5.0, upper=5.0, guess=0.0)
    off, coupling = leg.final_state("x") / unit - 1.0, 2.5 if wrong else 1.5
    problem.minimize(cost * (leg.integral((u - 1.0) ** 2) + k**2 + coupling * k * off))
    t = np.linspace(0.0, 1.0, 11)
    return Answer(problem, t, [unit * t], unit + 0 * t, {"k": 0.0})


@PAIRS.add("rest with a given mean", "swinging costs less than nothing", np.inf, first_order=False)
def _swing(unit: float, cost: float, wrong: bool) -> Answer:
    """u^2 - c x^2 in a period of 2 pi with a mean of zero: a minimum at rest for c < 1."""
    problem, leg, x, u = line(unit, (0.0, 2.0 * np.pi), start=None)
    problem.link(leg, leg, time=False)
    problem.constrain("mean", leg.integral(x), equals=0.0)
    bend = 1.5 if wrong else 0.9
    problem.minimize(cost * leg.integral(u**2 - bend * x**2))
    t = np.linspace(0.0, 2.0 * np.pi, 61)
    return Answer(problem, t, [0 * t], 0 * t)


@PAIRS.add("end that two states share", "the end bends more than the effort", np.inf, first_order=False)
def _shared_end(unit: float, cost: float, wrong: bool) -> Answer:
    """The effort to place and speed at 1 s is (12, -6; -6, 4): definite less 0.3 and 0.5, not less 2 and 0.8."""
    problem, leg, _, a = cart(unit, (0.0, 1.0))
    place, speed = (leg.final_state(name) / unit for name in ("q", "v"))
    less = (2.0, 0.8) if wrong else (0.3, 0.5)
    problem.minimize(cost * (leg.integral((a / unit) ** 2) - less[0] * place**2 - less[1] * speed**2))
    t = np.linspace(0.0, 1.0, 21)
    return Answer(problem, t, [0 * t, 0 * t], 0 * t)


@PAIRS.add("least peak", "smooth pushes need a higher peak", 0.1)
def _peak(unit: float, cost: float, wrong: bool) -> Answer:
    """Rest to rest over 1 in 1 s with the least peak of the push: 4, one way and the other."""
    problem, leg, _, a = cart(unit, (0.0, 1.0), end=(1.0, 0.0))
    k = problem.parameter("k", lower=0.0, upper=100.0, guess=5.0)
    leg.path("forth", a / unit - k, upper=0.0)
    leg.path("back", a / unit + k, lower=0.0)
    problem.minimize(cost * k)
    t, way, speed, push = (T, *rest_to_rest()) if wrong else one_push_each_way()
    return Answer(problem, t, [unit * way, unit * speed], unit * push, {"k": float(push[0])})


@PAIRS.add("budget of effort", "it pushes unevenly", 0.001)
def _effort(unit: float, cost: float, wrong: bool) -> Answer:
    """As far as possible in 2 s where u^2 adds up to 1: evenly."""
    problem, leg, _, u = line(unit, (0.0, 2.0))
    problem.constrain("budget", leg.integral(u**2), upper=1.0)
    problem.maximize(cost * leg.final_state("x") / unit)
    t, tilt = np.linspace(0.0, 2.0, 41), 0.1 if wrong else 0.0
    level = 1.0 / np.sqrt(2.0 * (1.0 + tilt**2 / 3.0))
    way = level * (t + tilt * ((t - 1.0) ** 2 - 1.0) / 2.0)
    return Answer(problem, t, [unit * way], unit * level * (1.0 + tilt * (t - 1.0)))


@PAIRS.add("followed wave", "it follows with another height", 0.01)
def _wave(unit: float, cost: float, wrong: bool) -> Answer:
    """(x - cos t)^2 + u^2 in a period: half of the wave."""
    problem, leg, x, u = line(unit, (0.0, 2.0 * np.pi), start=None)
    problem.link(leg, leg, time=False)
    problem.minimize(cost * leg.integral((x - ca.cos(leg.model.time)) ** 2 + u**2))
    t, height = np.linspace(0.0, 2.0 * np.pi, 121), 0.45 if wrong else 0.5
    return Answer(problem, t, [unit * height * np.cos(t)], -unit * height * np.sin(t))


@PAIRS.add("clock in the dynamics", "it pushes evenly though later pushes move more", 0.02)
def _clock(unit: float, cost: float, wrong: bool) -> Answer:
    """x' = u (1 + c), c' = 1, over 1: u grows as 1 + t."""
    problem, leg, _, (u,) = one_phase(
        "clock", "x c", "u", lambda x, c, u: [u * (1.0 + c), 1.0 + 0.0 * c], (0.0, 1.0)
    )
    leg.initial(x=0.0, c=0.0)
    leg.final(x=unit)
    problem.minimize(cost * leg.integral((u / unit) ** 2))
    t = np.linspace(0.0, 1.0, 41)
    way, push = ((1.0 + t) ** 3 - 1.0) / 7.0, 3.0 / 7.0 * (1.0 + t)
    if wrong:
        way, push = (t + t**2 / 2.0) / 1.5, 1.0 / 1.5 + 0 * t
    return Answer(problem, t, [unit * way, t], unit * push)


@PAIRS.add("singular arc that moves", "it stays beside the arc", 0.01)
def _moving_arc(unit: float, cost: float, wrong: bool) -> Answer:
    """(x - 0.3 t)^2 from 1 with |u| <= 1: down to 0.3 t at 1 / 1.3, then along it."""
    problem, leg, x, _ = line(unit, (0.0, 3.0), start=1.0)
    leg.bounds(u=(-unit, unit))
    problem.minimize(cost * leg.integral((x - 0.3 * leg.model.time) ** 2))
    reached = 0.7 if wrong else 1.0 / 1.3
    t, part = arcs(reached, 3.0 - reached)
    way = np.where(part == 0, 1.0 - t, 1.0 - reached + 0.3 * (t - reached))
    return Answer(problem, t, [unit * way], unit * np.where(part == 0, -1.0, 0.3))


@PAIRS.add("kink that is crossed", "it takes no notice of the kink", 0.01)
def _kink(unit: float, cost: float, wrong: bool) -> Answer:
    """u^2 + |x - 1/2| from 0 to 1: x'' = -1/2 below 1/2, then 1/2."""
    problem, leg, x, u = line(unit, end=1.0)
    problem.minimize(cost * leg.integral(u**2 + ca.fabs(x - 0.5)))
    t, part = arcs(0.5, 0.5)
    left = np.where(part == 0, t, 1.0 - t)
    way = 1.125 * left - 0.25 * left**2
    if wrong:
        return Answer(problem, t, [unit * t], 0 * t + unit)
    return Answer(problem, t, [unit * np.where(part == 0, way, 1.0 - way)], unit * (1.125 - 0.5 * left))
