"""Closed forms with a number that decides: on one side of its threshold a minimum, beyond it none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from benchmarks.validation.verdict.answers import Case, cart, integrator, one_phase, plane
from benchmarks.validation.verdict.statements import Array

Wall = Callable[[Any], Any]


def members() -> Iterator[Case]:
    """Yield the members of all families, on either side of their thresholds."""
    for name, check, below, beyond, why in (
        ("same area below, times", _area, (3.5, 5.0, 6.1), (6.4, 7.0, 9.5), "a wave of halves costs less"),
        ("round a torus, rad", _torus, (1.0, 1.7), (1.9, 2.5, 3.1), "the outer equator is no shortest path"),
        ("charge in a field, s", _charge, (3.0, 6.0), (6.6, 9.0), "beyond 2 pi a loop costs less"),
        ("clamped column, load", _column, (20.0, 38.0), (41.0, 60.0), "it buckles at 4 pi^2"),
        ("end that bends, by", _end, (-3.0, 0.5, 0.95), (1.05, 2.0, 10.0), "away from 0 it costs less"),
        ("free time, bend", _time, (-5.0, 0.3, 0.48), (0.52, 1.0, 5.0), "any other time costs less"),
        ("three switches at once", _switches, (-0.2, -0.4, -0.48), (-0.52, -0.6, -2.0), "a saddle"),
        ("totally singular, times", _singular, (0.8, 1.5), (1.7, 2.5), "beyond pi / 2 swinging costs less"),
        ("axis of an ellipsoid", _ellipsoid, (0,), (1, 2), "a shorter axis is nearer"),
    ):
        for value in (*below, *beyond):
            text = why if value in beyond else ""
            yield _member(f"{name} {value}", text, partial(check, value), first_order=False)
    for limit, height, wrong in (
        *((h, h, False) for h in (0.1, 0.15, 0.18, 0.22)), (0.12, 0.1, True), (0.21, 0.2, True), (0.3, 0.3, True),
        (0.099, 0.1, True), (0.199, 0.2, True),
    ):  # fmt: skip
        why = "it is beyond the limit, or the limit does not push" if wrong else ""
        yield _member(f"ceiling {limit}, flown {height}", why, partial(_ceiling, limit, height))
    for word, lengths, wrong in (
        ("RSL", (1.2, 1.5, 0.9), False), ("RLR", (1.0, 4.0, 0.8), False), ("LRL", (0.5, 5.0, 1.2), False),
        ("RLR", (1.0, 2.0, 0.8), True), ("LRL", (0.5, 3.0, 0.5), True), ("LSLS", (0.5, 2.0, 0.3, 1.0), True),
        ("LRLR", (0.5, 4.0, 4.0, 0.5), True),
    ):  # fmt: skip
        why = "no shortest path of bounded curvature has this word with these lengths" if wrong else ""
        check = partial(_bounded_curvature, word, lengths)
        yield _member(f"{word} {lengths}", why, check, first_order=len(word) < 4)
    for name, wall in _walls().items():
        why = "it goes through the wall between samples"
        yield _member(f"narrow {name}", why, partial(_narrow, wall, 0.5187))
        yield _member(f"narrow {name}, beside the way", "", partial(_narrow, wall, 1.1))


def _member(name: str, why: str, check: Callable[[], go.Verdict], *, first_order: bool = True) -> Case:
    kind = "beyond a threshold" if why else "right: before a threshold"
    return Case(kind, name, check, why, 1.0 if why else 0.0, first_order)


# --- smooth ------------------------------------------------------------------------------------------------


def _area(k: float) -> go.Verdict:
    """u^2 - k^2 x^2 over 1 s from 0 to 0 with an area of 1: a minimum up to 2 pi, not pi (a wave keeps the area)."""
    problem, leg, x, u = integrator(1.0, (0.0, 1.0), end=0.0)
    problem.constrain("area", leg.integral(x), equals=1.0)
    problem.minimize(leg.integral(u**2 - (k * x) ** 2))
    t = np.linspace(0.0, 1.0, 61)
    height = 1 / (2 * np.sin(k / 2) / k - np.cos(k / 2))
    shape, slope = np.cos(k * (t - 0.5)) - np.cos(k / 2), -k * np.sin(k * (t - 0.5))
    return go.verify_trajectory(problem, t, height * shape, height * slope)


def _torus(arc: float) -> go.Verdict:
    """Along the outer equator, radii 2 and 1: conjugate after pi / sqrt(3), the curvature being 1 / 3."""
    problem, leg, (theta, _), (a, b) = plane(1.0, end=(0.0, arc))
    problem.minimize(leg.integral(a**2 + (2 + ca.cos(theta)) ** 2 * b**2))
    t = np.linspace(0.0, 1.0, 41)
    return go.verify_trajectory(problem, t, [0 * t, arc * t], [0 * t, 0 * t + arc])


def _charge(last: float) -> go.Verdict:
    """At rest in a magnetic field of strength 1: conjugate after one turn."""
    problem, leg, (x, y), (u, w) = plane(1.0, (0.0, last), end=(0.0, 0.0))
    problem.minimize(leg.integral((u**2 + w**2 + x * w - y * u) / 2))
    t = np.linspace(0.0, last, 81)
    return go.verify_trajectory(problem, t, np.zeros((2, 81)), np.zeros((2, 81)))


def _column(load: float) -> go.Verdict:
    """a^2 - load v^2 over 1, clamped at both ends, one of them displaced by 0.3: q is a sine, a line and a constant."""
    problem, leg, (_, v), a = cart(1.0, (0.0, 1.0), end=(0.3, 0.0))
    problem.minimize(leg.integral(a**2 - load * v**2))
    t, k = np.linspace(0.0, 1.0, 81), np.sqrt(load)
    ends = [[np.cos(k) - 1, np.sin(k) - k], [-np.sin(k), np.cos(k) - 1]]
    even, odd = np.linalg.solve(ends, [0.3, 0.0])
    q = even * (np.cos(k * t) - 1) + odd * (np.sin(k * t) - k * t)
    speed = k * (-even * np.sin(k * t) + odd * (np.cos(k * t) - 1))
    bend = -(k**2) * (even * np.cos(k * t) + odd * np.sin(k * t))
    return go.verify_trajectory(problem, t, [q, speed], bend)


def _end(bend: float) -> go.Verdict:
    """u^2 / 2 over 1 s, and an end that is best at 1 but for its curvature."""
    problem, leg, _, u = integrator(1.0, (0.0, 1.0))
    end = leg.final_state("x")
    problem.minimize(leg.integral(u**2 / 2) - end - bend / 2 * (end - 1) ** 2)
    t = np.linspace(0.0, 1.0, 21)
    return go.verify_trajectory(problem, t, t, 0 * t + 1)


def _time(bend: float) -> go.Verdict:
    """1 / (2 T) + T / 2 - bend (T - 1)^2 is stationary at T = 1, where its curvature is 1 - 2 bend."""
    problem, leg, _, u = integrator(1.0, (0.0, (0.2, 5.0)), end=1.0)
    last = leg.final_time
    problem.minimize(leg.integral(u**2 / 2) + last / 2 - bend * (last - 1) ** 2)
    t = np.linspace(0.0, 1.0, 21)
    return go.verify_trajectory(problem, t, t, 0 * t + 1)


def _ellipsoid(axis: int) -> go.Verdict:
    """From the middle of an ellipsoid of semi-axes 1, 1.5, 2 to its surface."""
    problem, leg, _, u = one_phase("family", "x y z", "u v w", lambda x, y, z, u, v, w: [u, v, w], (0.0, 1.0))
    leg.initial(x=0.0, y=0.0, z=0.0)
    lengths = np.array([1.0, 1.5, 2.0])
    ends = [leg.final_state(name) for name in "xyz"]
    problem.constrain("surface", sum((e / n) ** 2 for e, n in zip(ends, lengths, strict=True)), equals=1.0)
    problem.minimize(leg.integral(sum(component**2 for component in u)))
    t, way = np.linspace(0.0, 1.0, 11), np.where(np.arange(3) == axis, lengths, 0.0)
    return go.verify_trajectory(problem, t, np.outer(way, t), np.outer(way, 1 + 0 * t))


# --- switches and singular arcs ----------------------------------------------------------------------------


def _switches(least: float) -> go.Verdict:
    """Three integrators that switch at 1 s: the Hessian is 2 + 4 M, M with this least eigenvalue, in skew axes."""
    limits = dict.fromkeys("uvw", (-1.0, 1.0))
    problem, leg, x, _ = one_phase("family", "x y z", "u v w", lambda x, y, z, u, v, w: [u, v, w], (0.0, 2.0))
    leg.bounds(**limits)
    leg.initial(x=0.0, y=0.0, z=0.0)
    ends = ca.vertcat(*(leg.final_state(name) for name in "xyz"))
    axes = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    matrix = axes @ np.diag([least, 1.0, 2.0]) @ axes.T
    problem.minimize(ca.sum1(ends) - leg.integral(sum(x)) + 0.5 * ca.bilin(ca.DM(matrix), ends, ends))
    t = np.concatenate([np.linspace(0.0, 1.0, 6), np.linspace(1.0, 2.0, 6)])
    return go.verify_trajectory(problem, t, [np.minimum(t, 2 - t)] * 3, [np.repeat([1.0, -1.0], 6)] * 3)


def _singular(k: float) -> go.Verdict:
    """x^2 - k^2 y^2 over 2 s at rest, x the rate of y, u that of x: with x for a control, y is conjugate at pi / k."""
    problem, leg, (y, x), _ = cart(1.0, (0.0, 2.0), end=(0.0, 0.0))
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.integral(1 + x**2 - (k * y) ** 2))
    t = np.linspace(0.0, 2.0, 61)
    return go.verify_trajectory(problem, t, np.zeros((2, 61)), 0 * t)


def _bounded_curvature(word: str, lengths: tuple[float, ...]) -> go.Verdict:
    """Shortest path of curvature 1 (Dubins, Amer. J. Math. 79, 1957): CSC, or CCC with more than half a turn."""
    rates = lambda x, y, h, u: [ca.cos(h), ca.sin(h), u]  # noqa: E731
    problem, leg, _, _ = one_phase("family", "x y h", "u", rates, (0.0, (0.1, 30.0)))
    leg.bounds(u=(-1.0, 1.0))
    times: list[Array] = []
    states: list[Array] = []
    turns: list[Array] = []
    x, y, h, begin = 0.0, 0.0, 0.0, 0.0
    for letter, length in zip(word, lengths, strict=True):
        turn, s = {"L": 1.0, "S": 0.0, "R": -1.0}[letter], np.linspace(0.0, length, 41)
        heading = h + turn * s
        if turn:
            way = [x + (np.sin(heading) - np.sin(h)) / turn, y - (np.cos(heading) - np.cos(h)) / turn]
        else:
            way = [x + np.cos(h) * s, y + np.sin(h) * s]
        times.append(begin + s)
        states.append(np.array([*way, heading]))
        turns.append(0 * s + turn)
        (x, y, h), begin = states[-1][:, -1], begin + length
    leg.initial(x=0.0, y=0.0, h=0.0)
    leg.final(x=x, y=y, h=h)
    problem.minimize(leg.final_time)
    return go.verify_trajectory(problem, *(np.concatenate(part, axis=-1) for part in (times, states, turns)))


# --- limits ------------------------------------------------------------------------------------------------


def _ceiling(limit: float, height: float) -> go.Verdict:
    """Thrown up and back in 1 s below a ceiling, as a path constraint: an arc up to 1/6, a touch up to 1/4."""
    problem, leg, (q, _), a = cart(1.0, (0.0, 1.0), start=(0.0, 1.0), end=(0.0, -1.0))
    leg.path("ceiling", q, upper=limit)
    problem.minimize(leg.integral(a**2))
    rise = min(3 * height, 0.5)
    pieces = [(0.0, rise), (rise, 1 - rise), (1 - rise, 1.0)] if rise < 0.5 else [(0.0, 0.5), (0.5, 1.0)]
    t = np.concatenate([np.linspace(first, last, 21) for first, last in pieces])
    arc = np.repeat([0, 1, 2] if rise < 0.5 else [0, 2], 21)
    tau, sign = np.where(arc == 1, rise, np.minimum(t, 1 - t)), np.choose(arc, [1.0, 0.0, -1.0])
    b, c = np.linalg.solve([[rise**2, rise**3], [2 * rise, 3 * rise**2]], [height - rise, -1.0])
    states = [tau + b * tau**2 + c * tau**3, sign * (1 + 2 * b * tau + 3 * c * tau**2)]
    return go.verify_trajectory(problem, t, states, np.where(arc == 1, 0.0, 2 * b + 6 * c * tau))


def _walls() -> dict[str, Wall]:
    """Functions of the distance that are flat but for a ten-thousandth of the way."""
    return {
        "bell": lambda d: 1 - ca.exp(-((d / 1e-4) ** 2)),
        "inverse": lambda d: -1 / ca.sqrt(d**2 + 1e-10),
        "tangent": lambda d: ca.tanh((d**2 - 1e-8) / 1e-8),
        "cut-off": lambda d: ca.fmin(d**2 / 1e-8, 4.0),
        "power": lambda d: (d / 1e-4) ** 8,
    }


def _narrow(wall: Wall, at: float) -> go.Verdict:
    """Rest to rest over 1 m in 1 s, and a wall somewhere."""
    problem, leg, (q, _), a = cart(1.0, (0.0, 1.0), end=(1.0, 0.0))
    leg.path("wall", wall(q - at), lower=float(ca.DM(wall(ca.DM(1e-4)))))
    problem.minimize(leg.integral(a**2))
    t = np.linspace(0.0, 1.0, 41)
    return go.verify_trajectory(problem, t, [3 * t**2 - 2 * t**3, 6 * t - 6 * t**2], 6 - 12 * t)
