"""Closed forms with constraints on ends and integrals: budgets, areas, discs, times that depend on places."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import scipy

import gnc_opt as go
from benchmarks.validation.verdict.answers import ONE, Answer, Pairs, T, line, one_phase, plane
from benchmarks.validation.verdict.statements import Array

PAIRS = Pairs()


def _towards_disc(unit: float, cost: float, wrong: bool, limits: dict[str, float]) -> Answer:
    problem, leg, _, (u, w) = plane(unit)
    x, y = (leg.final_state(n) / unit for n in ("x", "y"))
    problem.constrain("disc", (x - 3) ** 2 + y**2, **limits)
    problem.minimize(cost * leg.integral(u**2 + w**2))
    t, far = np.linspace(0.0, 1.0, 21), unit * (4.0 if wrong else 2.0)
    return Answer(problem, t, [far * t, 0 * t], [0 * t + far, 0 * t])


@PAIRS.add("end in a disc", "it crosses the disc to its far side", 3.0)
def _end_in_disc(unit: float, cost: float, wrong: bool) -> Answer:
    return _towards_disc(unit, cost, wrong, {"upper": 1.0})


@PAIRS.add("end on a circle", "it ends on the far side", 3.0, first_order=False)
def _end_on_circle(unit: float, cost: float, wrong: bool) -> Answer:
    return _towards_disc(unit, cost, wrong, {"equals": 1.0})


@PAIRS.add("budget", "less than all of it costs less", 1.0)
def _budget(unit: float, cost: float, wrong: bool) -> Answer:
    """An effort of 4 leads to 2; to 3 it is too far, at 1 it would have been enough."""
    problem, leg, _, u = line(unit)
    problem.constrain("effort", leg.integral(u**2), upper=4.0)
    problem.minimize(cost * (leg.final_state("x") / unit - (1.0 if wrong else 3.0)) ** 2)
    t = np.linspace(0.0, 1.0, 21)
    return Answer(problem, t, 2 * unit * t, 0 * t + 2 * unit)


@PAIRS.add("Dido", "the rope hangs on the wrong side", 2.0)
def _dido(unit: float, cost: float, wrong: bool) -> Answer:
    """The largest area below a rope of given length: an arc of a circle."""
    problem, leg, y, u = line(unit, end=0.0)
    radius = 0.6
    problem.constrain("length", leg.integral(ca.sqrt(1 + u**2)), upper=2 * radius * np.arcsin(0.5 / radius))
    problem.minimize(-cost * leg.integral(y))
    t = np.linspace(0.0, 1.0, 161)
    height, side = np.sqrt(radius**2 - (t - 0.5) ** 2), unit * (-1.0 if wrong else 1.0)
    return Answer(problem, t, side * (height - height[0]), -side * (t - 0.5) / height)


@PAIRS.add("given area", "a sine of the same area costs more", 0.01)
def _area(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, x, u = line(unit, end=0.0)
    problem.constrain("area", leg.integral(x), lower=1.0)
    problem.minimize(cost * leg.integral(u**2))
    sine = np.pi / 2 * np.sin(np.pi * T), np.pi**2 / 2 * np.cos(np.pi * T)
    way, speed = sine if wrong else (6 * T * (1 - T), 6 * (1 - 2 * T))
    return Answer(problem, T, unit * way, unit * speed)


@PAIRS.add("out of a disc", "it leaves by the far side", 1.0, first_order=False)
def _out_of_disc(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _, (u, w) = plane(unit, start=(0.5, 0.0))
    x, y = (leg.final_state(n) / unit for n in "xy")
    problem.constrain("out", x**2 + y**2, lower=4.0)
    problem.minimize(cost * leg.integral(u**2 + w**2))
    end = -2.0 if wrong else 2.0
    return Answer(problem, T, [unit * (0.5 + (end - 0.5) * T), 0 * T], [unit * (end - 0.5) + 0 * T, 0 * T])


@PAIRS.add("end on a parabola", "it ends at its top, which is no nearest point", 0.1, first_order=False)
def _parabola(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _, (u, w) = plane(unit)
    x, y = (leg.final_state(n) / unit for n in "xy")
    problem.constrain("parabola", y - (2 - x**2), equals=0.0)
    problem.minimize(cost * leg.integral(u**2 + w**2))
    end = np.array([0.0, 2.0]) if wrong else np.array([np.sqrt(1.5), 0.5])
    return Answer(problem, T, unit * np.outer(end, T), unit * np.outer(end, 1 + 0 * T))


def _budgets(unit: float, cost: float, late: float) -> tuple[go.Problem, Any]:
    problem, leg, _x, u = line(unit)
    problem.constrain("all", leg.integral(u**2), upper=1.0)
    problem.constrain("late", leg.integral(leg.model.time * u**2), upper=late)
    problem.maximize(cost * leg.final_state("x") / unit)
    return problem, leg


def _spent(late: float) -> tuple[float, float]:
    """a and b of u = 1 / (a + b t) such that int u^2 = 1 and int t u^2 = late."""

    def missed(z: Array) -> list[float]:
        a, b = z
        return [
            scipy.integrate.quad(lambda t: (a + b * t) ** -2, 0, 1)[0] - 1,
            scipy.integrate.quad(lambda t: t * (a + b * t) ** -2, 0, 1)[0] - late,
        ]

    guess = [0.8, 0.5] if late < 0.5 else [1.3, -0.5]
    a, b = scipy.optimize.fsolve(missed, guess, xtol=1e-13)
    return float(a), float(b)


@PAIRS.add("two budgets, one of them idle", "it keeps within a budget that it need not", 0.01)
def _idle_budget(unit: float, cost: float, wrong: bool) -> Answer:
    problem, _ = _budgets(unit, cost, 0.6)
    if not wrong:
        return Answer(problem, T, unit * T, unit * ONE)
    a, b = _spent(0.4)
    return Answer(problem, T, unit * np.log1p(b / a * T) / b, unit / (a + b * T))


@PAIRS.add("two budgets, both used", "a budget pulls instead of pushing", 0.01)
def _two_budgets(unit: float, cost: float, wrong: bool) -> Answer:
    late = 0.6 if wrong else 0.4
    problem, _ = _budgets(unit, cost, late)
    a, b = _spent(late)
    return Answer(problem, T, unit * np.log1p(b / a * T) / b, unit / (a + b * T))


@PAIRS.add("target that runs away", "the target bends away, any other time is better", 0.1, first_order=False)
def _moving_target(unit: float, cost: float, wrong: bool) -> Answer:
    """A target at 2 + s + bend s^2, s = T - 1: its square over T is stationary at 1, bend -1/4 decides."""
    problem, leg, _x, u = line(unit, (0.0, (0.2, 3.0)))
    s = leg.final_time - 1
    bend = -0.6 if wrong else 0.1
    problem.constrain("met", leg.final_state("x") / unit - (2 + s + bend * s**2), equals=0.0)
    problem.minimize(cost * leg.integral(u**2))
    return Answer(problem, T, unit * 2 * T, unit * 2 * ONE)


@PAIRS.add("vertex with an idle side", "it ends beside the vertex", 0.1)
def _vertex(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _, (u, w) = plane(unit)
    x, y = (leg.final_state(n) / unit for n in "xy")
    for name, side in (("right", x - 1), ("above", y - 1), ("beyond", x + y - 2)):
        problem.constrain(name, side, lower=0.0)
    problem.minimize(cost * leg.integral(u**2 + w**2))
    end = np.array([1.3, 1.0]) if wrong else np.array([1.0, 1.0])
    return Answer(problem, T, unit * np.outer(end, T), unit * np.outer(end, ONE))


@PAIRS.add("integral that says what the end says", "it pushes unevenly", 0.05)
def _redundant(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, _x, u = line(unit, end=1.0)
    problem.constrain("mean", leg.integral(u), equals=1.0)
    problem.minimize(cost * leg.integral(u**2))
    bend = 0.3 if wrong else 0.0
    return Answer(problem, T, unit * (T + bend * T * (1 - T)), unit * (1 + bend * (1 - 2 * T)))


@PAIRS.add("delay as a second copy", "it takes no notice of the delay", 0.1)
def _delay(unit: float, cost: float, wrong: bool) -> Answer:
    """z' = u - z(t - 1) for 2 s from 0 to 1, the second of them as a second state: u grows with t, then stays."""
    problem, leg, _, (u, w) = one_phase("delay", "x y", "u w", lambda x, y, u, w: [u, w - x], (0.0, 1.0))
    leg.initial(x=0.0)
    leg.final(y=unit)
    problem.constrain("goes on", (leg.final_state("x") - leg.initial_state("y")) / unit, equals=0.0)
    problem.minimize(cost * leg.integral((u**2 + w**2) / unit**2))
    u, x, y = (0.75 * T, 0.75 * T**2 / 2, 0.75 * (0.5 + T - T**3 / 6))
    if wrong:
        u, x, y = (2 / 3 * ONE, 2 / 3 * T, 2 / 3 * (1 + T - T**2 / 2))
    return Answer(problem, T, [unit * x, unit * y], [unit * u, unit * u[-1] * ONE])


@PAIRS.add("sine of a given square", "a whole sine is a saddle", 3.0, first_order=False)
def _sine(unit: float, cost: float, wrong: bool) -> Answer:
    problem, leg, x, u = line(unit, end=0.0)
    problem.constrain("square", leg.integral(x**2), equals=1.0)
    problem.minimize(cost * leg.integral(u**2))
    k, size = 2 * np.pi if wrong else np.pi, np.sqrt(2) * unit
    return Answer(problem, T, size * np.sin(k * T), size * k * np.cos(k * T))
