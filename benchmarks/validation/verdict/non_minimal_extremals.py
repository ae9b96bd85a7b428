"""Cases that are no minima, and answers that go past a limit, as default calls or given arrays yield them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
import scipy

import gnc_opt as go
from benchmarks.validation.verdict.answers import Case, Rates, integrator, one_phase, plane
from benchmarks.validation.verdict.statements import Array


def extremals() -> Iterator[Case]:
    """Yield all of them; ``off`` is what is lost at least."""
    yield from _conjugate_points()
    yield from _switch_maxima()
    yield from _narrow_wells()
    yield from _singular_maxima()
    yield from _keep_outs()


def _default(problem: go.Problem, tol: float | None = None) -> go.Verdict:
    return go.verify(go.solve(problem, tol=tol))


def _second_order(kind: str, name: str, why: str, off: float, check: Callable[..., Any], *given: Any) -> Case:
    """Return an extremal of which only sufficient conditions fail."""
    return Case(kind, name, partial(check, *given), why, off, first_order=False)


# --- conjugate points --------------------------------------------------------------------------------------


def _conjugate_points() -> Iterator[Case]:
    case = partial(_second_order, "conjugate point")
    for degrees in (190, 225, 270, 320, 350):
        arc = np.radians(degrees)
        name, why = f"great circle, {degrees} degrees", "over a pole it is never more than 180 degrees"
        yield case(name, why, 1 - (np.pi / arc) ** 2, lambda a=arc: _default(great_circle(a)))
        yield case(f"{name}, as samples", why, 1 - (np.pi / arc) ** 2, _equator, arc)
    for last, end in ((3.3, 0.0), (4.0, 0.2), (5.0, 0.5), (6.0, -0.3), (7.0, 0.3)):
        name = f"u^2 - x^2 over {last} s to {end}"
        yield case(name, "beyond pi there is no least cost", np.inf, _swung, last, end)
    for depth in (0.7, 0.8, 0.9):
        name, saved = f"straight through a disc {100 * depth:.0f} % slower", _saved_round_the_disc(depth)
        yield case(name, "round it is faster", saved, _straight_through, depth)
    for last in (3.3, 4.0, 5.0):
        why = "beyond pi the first one has no least cost"
        yield case(f"two oscillators over {last} s", why, np.inf, _two_oscillators, last)
    for stiffness, last in ((2.0, 2.0), (1.0, 4.0), (3.0, 1.5), (4.0, 2.5)):
        name = f"on the ridge of a double well, {stiffness} for {last} s"
        saved = -_well_cost(stiffness, last, 0.3 * np.sqrt(stiffness))
        yield case(name, "down and back costs less", saved, _on_the_ridge, stiffness, last)


def great_circle(arc: float) -> go.Problem:
    """The shortest path along the equator of a unit sphere, over an arc (rad)."""
    problem, leg, (theta, _), (a, b) = plane(1.0, start=(np.pi / 2, 0.0), end=(np.pi / 2, arc))
    problem.minimize(leg.integral(0.5 * (a**2 + ca.sin(theta) ** 2 * b**2)))
    return problem


def repelled(last: float, end: float) -> go.Problem:
    """min of the integral of (u^2 - x^2) / 2: a minimum up to pi."""
    problem, leg, x, u = integrator(1.0, (0.0, last), start=0.2, end=end)
    problem.minimize(leg.integral(0.5 * (u**2 - x**2)))
    return problem


def _equator(arc: float) -> go.Verdict:
    t = np.linspace(0.0, 1.0, 41)
    level, rate = 0 * t + np.pi / 2, 0 * t + arc
    return go.verify_trajectory(great_circle(arc), t, [level, arc * t], [0 * t, rate])


def _swung(last: float, end: float) -> go.Verdict:
    t = np.linspace(0.0, last, 121)
    x, u = _swing(t, 0.2, end)
    return go.verify_trajectory(repelled(last, end), t, x, u)


def _swing(t: Array, start: float, end: float) -> tuple[Array, Array]:
    """The extremal of u^2 - x^2 between two values, and its rate."""
    b = (end - start * np.cos(t[-1])) / np.sin(t[-1])
    return start * np.cos(t) + b * np.sin(t), -start * np.sin(t) + b * np.cos(t)


def _two_oscillators(last: float) -> go.Verdict:
    problem, leg, (x, y), (u, w) = plane(1.0, (0.0, last), (0.1, 1.0), (0.1, 0.5))
    problem.minimize(leg.integral(0.5 * (u**2 + w**2 - x**2 + y**2)))
    t = np.linspace(0.0, last, 121)
    swing, b = _swing(t, 0.1, 0.1), (0.5 - np.cosh(last)) / np.sinh(last)
    falls = np.cosh(t) + b * np.sinh(t), np.sinh(t) + b * np.cosh(t)
    return go.verify_trajectory(problem, t, [swing[0], falls[0]], [swing[1], falls[1]])


def slow_disc(depth: float) -> go.Problem:
    """Least time from (-1, 0) to (1, 0) through a disc at the origin where speed is lost."""

    def rates(x: Any, y: Any, h: Any) -> list[Any]:
        speed = 1 - depth * ca.exp(-4 * (x**2 + y**2))
        return [speed * ca.cos(h), speed * ca.sin(h)]

    problem, leg, _, _ = one_phase("slow disc", "x y", "h", rates, (0.0, (0.1, 20.0)))
    leg.initial(x=-1.0, y=0.0)
    leg.final(x=1.0, y=0.0)
    leg.bounds(h=(-1.5, 1.5))
    problem.minimize(leg.final_time)
    return problem


def _saved_round_the_disc(depth: float) -> float:
    """Share of the time that a parabola past the disc saves; integrated."""
    around = min(_duration(depth, h, 1.0) for h in np.linspace(0.1, 1.2, 23))
    return 1 - around / _duration(depth, 0.0, 1.0)


def _duration(depth: float, height: float, end: float) -> float:
    """Time from (-1, 0) to x = end along a parabola."""

    def slowness(x: float) -> float:
        y, slope = height * (1 - x**2), -2 * height * x
        return float(np.sqrt(1 + slope**2) / (1 - depth * np.exp(-4 * (x**2 + y**2))))

    return float(scipy.integrate.quad(slowness, -1.0, end, epsabs=1e-12, epsrel=1e-12)[0])


def _straight_through(depth: float) -> go.Verdict:
    x = np.linspace(-1.0, 1.0, 161)
    t = np.array([_duration(depth, 0.0, end) for end in x])
    return go.verify_trajectory(slow_disc(depth), t, [x, 0 * x], 0 * x)


def double_well(stiffness: float, last: float) -> go.Problem:
    """min of the integral of u^2 / 2 - (k x)^2 / 2 + x^4 / 4 from 0 to 0: x = 0 is no minimum beyond pi / k."""
    problem, leg, x, u = integrator(1.0, (0.0, last), end=0.0)
    problem.minimize(leg.integral(0.5 * u**2 - 0.5 * (stiffness * x) ** 2 + 0.25 * x**4))
    return problem


def _on_the_ridge(stiffness: float, last: float) -> go.Verdict:
    t = np.linspace(0.0, last, 61)
    return go.verify_trajectory(double_well(stiffness, last), t, 0 * t, 0 * t)


def _well_cost(k: float, last: float, height: float) -> float:
    t = np.linspace(0.0, last, 4001)
    best = 0.0
    for h in height * np.linspace(0.2, 3.0, 29):
        x, u = h * np.sin(np.pi * t / last), h * np.pi / last * np.cos(np.pi * t / last)
        best = min(best, float(np.trapezoid(0.5 * u**2 - 0.5 * (k * x) ** 2 + 0.25 * x**4, t)))
    return best


# --- maxima and saddles of switch times --------------------------------------------------------------------


def _switch_maxima() -> Iterator[Case]:
    case = partial(_second_order, "switch times")
    for bend in (1.2, 1.5, 2.5):
        for what, more in (
            ("alone", None), ("with an idle constraint", "constraint"), ("with an idle end bound", "bound"),
        ):  # fmt: skip
            name, why = f"one switch, bend {bend}, {what}", "the cost has a maximum over the switch time"
            yield case(name, why, _bent_by(bend), _one_switch, bend, more)
    for weight in (0.5, 2.0):
        name = f"a parameter at a maximum, weight {weight}"
        yield case(name, "any other value costs less", weight * 0.25, _one_switch, 0.5, "parameter", weight)
    for kappa in (1.5, 2.0, 3.0):
        name, why = f"two switches at once, kappa {kappa}", "one earlier and the other later costs less"
        yield case(name, why, _split_pair(kappa), _pair, kappa)


def one_switch(bend: float, more: str | None = None, weight: float = 1.0) -> go.Problem:
    """Over 2 s, |u| <= 1, x = 0 at the start; u = 1 up to 1 s, then -1, is a minimum for bend < 1 only."""
    problem, leg, x, _ = integrator(1.0, (0.0, 2.0))
    parameter = problem.parameter("k", lower=-1.0, upper=1.0, guess=0.0) if more == "parameter" else 0.0
    leg.bounds(u=(-1.0, 1.0))
    end = leg.final_state("x")
    problem.minimize(leg.integral((bend / 3 - 1) * x - bend / 3 * x**2) + end - weight * parameter**2)
    if more == "constraint":
        problem.constrain("far", end, upper=100.0)
    elif more == "bound":
        leg.final(x=(-50.0, 50.0))
    return problem


def _switch_cost(bend: float, switch: float) -> float:
    t = np.linspace(0.0, 2.0, 20001)
    x = np.where(t < switch, t, 2 * switch - t)
    return float(np.trapezoid((bend / 3 - 1) * x - bend / 3 * x**2, t) + x[-1])


def _bent_by(bend: float) -> float:
    at = _switch_cost(bend, 1.0)
    return (at - min(_switch_cost(bend, s) for s in (0.8, 0.9, 1.1, 1.2))) / abs(at)


def _one_switch(bend: float, more: str | None, weight: float = 1.0) -> go.Verdict:
    t = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.0, 1.25, 1.5, 1.75, 2.0])
    u = np.where(np.arange(t.size) < 5, 1.0, -1.0)
    p = [0.0] if more == "parameter" else None
    return go.verify_trajectory(one_switch(bend, more, weight), t, np.minimum(t, 2 - t), u, p)


def pair(kappa: float) -> go.Problem:
    """Two integrators that gain by switching at 1 s, and by ending far from each other: a minimum for kappa < 1."""
    problem, leg, (x, y), _ = plane(1.0, (0.0, 2.0))
    leg.bounds(u=(-1.0, 1.0), w=(-1.0, 1.0))
    ends = leg.final_state("x"), leg.final_state("y")
    problem.minimize(ends[0] + ends[1] - leg.integral(x + y) - kappa / 8 * (ends[0] - ends[1]) ** 2)
    return problem


def _split_pair(kappa: float) -> float:
    def cost(a: float, b: float) -> float:
        t = np.linspace(0.0, 2.0, 20001)
        x, y = (np.where(t < s, t, 2 * s - t) for s in (a, b))
        return float(x[-1] + y[-1] - np.trapezoid(x + y, t) - kappa / 8 * (x[-1] - y[-1]) ** 2)

    return (cost(1.0, 1.0) - cost(0.8, 1.2)) / abs(cost(1.0, 1.0))


def _pair(kappa: float) -> go.Verdict:
    t = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.0, 1.25, 1.5, 1.75, 2.0])
    x, u = np.minimum(t, 2 - t), np.where(np.arange(t.size) < 5, 1.0, -1.0)
    return go.verify_trajectory(pair(kappa), t, [x, x], [u, u])


# --- wells of H --------------------------------------------------------------------------------------------


def _narrow_wells() -> Iterator[Case]:
    t = np.linspace(0.0, 1.0, 21)
    centers, widths = (
        (0.73, -0.41, 0.613, 0.333, -0.87, 0.05, 0.21),
        (0.05, 0.02, 0.01, 5e-3, 3e-3, 2e-3, 5e-4),
    )
    for center, width in zip(centers, widths, strict=True):
        problem, leg, _, u = integrator(1.0)
        leg.bounds(u=(-1.0, 1.0))
        problem.minimize(leg.integral(1 + (u + 0.5) ** 2 - 3 * ca.exp(-(((u - center) / width) ** 2))))
        name, why = f"{width} wide at {center}", "u in the narrow well costs less than u = -0.5"
        check = partial(go.verify_trajectory, problem, t, -0.5 * t, 0 * t - 0.5)
        yield Case("well of H", name, check, why, 3 - (center + 0.5) ** 2)
    for stiffness in (1e2, 1e4, 1e6):
        problem, leg, _, (u, w) = plane(1.0)
        leg.bounds(u=(-2.0, 2.0), w=(-2.0, 2.0))
        d = u - w
        problem.minimize(leg.integral(1 + stiffness * (u + w) ** 2 + (d**2 - 1) ** 2 + 0.2 * d))
        high = float(np.max(np.roots([4.0, 0.0, -4.0, 0.2]).real))
        name, why = f"coupled actuators, stiffness {stiffness:g}", "the other valley of u - w is deeper"
        x, u = [t * high / 2, -t * high / 2], [0 * t + high / 2, 0 * t - high / 2]
        yield Case("well of H", name, partial(go.verify_trajectory, problem, t, x, u), why, 0.39)


# --- singular maxima ---------------------------------------------------------------------------------------


def _singular_maxima() -> Iterator[Case]:
    case = partial(_second_order, "singular arc")
    t = np.linspace(0.0, 2.0, 41)
    for weight in (0.1, 1.0, 10.0):
        problem, leg, x, _ = integrator(1.0, (0.0, 2.0), end=0.0)
        leg.bounds(u=(-1.0, 1.0))
        problem.minimize(leg.integral(1 - weight * x**2))
        name, why = f"x = 0 with -{weight} x^2", "Kelley's condition has the wrong sign"
        yield case(name, why, weight / 6, go.verify_trajectory, problem, t, 0 * t, 0 * t)
    for skew in (0.5, 2.0):
        rates: Rates = lambda x, y, z, u, w: [u, w, x * w - y * u]  # noqa: E731
        problem, leg, (x, y, _), _ = one_phase("Goh", "x y z", "u w", rates, (0.0, 2.0))
        leg.initial(x=0.0, y=0.0, z=0.0)
        leg.final(x=0.0, y=0.0)
        leg.bounds(u=(-1.0, 1.0), w=(-1.0, 1.0))
        problem.minimize(leg.integral(1 + x**2 + y**2) + skew * 20 * leg.final_state("z"))
        name, why = f"at rest though turning gains, {skew}", "Goh's condition fails: a small loop lowers z"
        rest = np.zeros((3, 41)), np.zeros((2, 41))
        yield case(name, why, skew * 0.05, go.verify_trajectory, problem, t, *rest)
    for power in (1.0, 3.0):
        problem, leg, _, (u,) = one_phase("abnormal", "x", "u", lambda x, u: [u**2], (0.0, 1.0))
        leg.initial(x=0.0)
        leg.final(x=0.0)
        problem.minimize(leg.integral((u - power) ** 2))
        name, why = f"x' = u^2 back to 0, u = {power:g} wanted", "no finite multiplier explains it"
        samples = np.linspace(0, 1, 21), np.zeros(21), np.zeros(21)
        yield _second_order("abnormal", name, why, 1.0, go.verify_trajectory, problem, *samples)


# --- limits crossed between samples ------------------------------------------------------------------------


def _keep_outs() -> Iterator[Case]:
    why = "it goes through what it must keep out of"
    for radius, way, unit in ((10.0, 5000.0, 1.0), (1.0, 1000.0, 1.0), (10.0, 5000.0, 1e3), (50.0, 2e4, 1.0)):
        name = f"through the middle of {radius:g} m on {2 * way:g} m, unit {unit:g} m"
        check = partial(_fly_by, radius / unit, way / unit)
        yield Case("keep-out crossed", name, check, why, 1.0)
    for radius, way in ((10.0, 5000.0), (2.0, 3000.0)):
        name = f"through {radius:g} m on {2 * way:g} m, distance stated as a root"
        yield Case("keep-out crossed", name, partial(_fly_by, radius, way, root=True), why, 1.0)


def _fly_by(radius: float, way: float, *, root: bool = False) -> go.Verdict:
    return _default(fly_by(radius, way, root=root))


def fly_by(radius: float, way: float, *, root: bool = False) -> go.Problem:
    """Least effort from rest to rest past a sphere on the straight line between them."""
    model = go.Model("chaser")
    r, v, a = model.state("r", 3), model.state("v", 3), model.control("a", 3)
    model.ode({r: v, v: a})
    problem = go.Problem("fly-by")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1000.0)
    leg.initial(r=[-way, 0, 0], v=0.0)
    leg.final(r=[way, 0, 0], v=0.0)
    square = r[0] ** 2 + r[1] ** 2 + r[2] ** 2
    distance, least = (ca.sqrt(square + 1e-12), radius) if root else (square, radius**2)
    leg.path("keep_out", distance, lower=least)
    problem.minimize(leg.integral(a[0] ** 2 + a[1] ** 2 + a[2] ** 2))
    return problem
