"""The verdict's figures are shares: they do not depend on the units of states, controls, time and cost."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from wrong import with_leg

import gnc_opt as go
from gnc_opt.solution.polynomial import PiecewisePolynomial


@dataclass(frozen=True)
class Units:
    """How many of the new units one old unit is."""

    q: float = 1.0
    v: float = 1.0
    a: float = 1.0
    t: float = 1.0
    cost: float = 1.0
    limits: float = 1.0
    k: float = 1.0


OTHERS = {
    "position": Units(q=50.0),
    "speed": Units(v=0.04),
    "control": Units(a=30.0),
    "time": Units(t=20.0),
    "cost": Units(cost=0.03),
    "path constraints": Units(limits=40.0),
    "parameter": Units(k=25.0),
    "all": Units(30.0, 0.2, 7.0, 0.1, 8.0, 0.3, 0.5),
    "mirrored": Units(q=-1.0, v=-1.0, a=-1.0),
    "mirrored limits": Units(limits=-1.0),
}


def limits(lower: float | None, upper: float | None, unit: float) -> tuple[float | None, float | None]:
    """A range in other units; in negative ones its ends change places."""
    low, high = (None if value is None else value * unit for value in (lower, upper))
    return (low, high) if unit > 0 else (high, low)


def pendulum(units: Units) -> go.Problem:
    """Swing up a little in free time, with every kind of limit; on few nodes, so that every condition is offended."""
    model = go.Model("pendulum")
    q, v = model.state("q"), model.state("v")
    a = model.control("a")
    angle, rate, torque, t = q / units.q, v / units.v, a / units.a, model.time / units.t
    push = 0.2 * ca.sin(3 * t)
    model.ode({q: rate * units.q / units.t, v: (torque - ca.sin(angle) + push) * units.v / units.t})
    problem = go.Problem("swing up")
    k = problem.parameter("k", lower=limits(0.0, 3.0, units.k)[0], upper=limits(0.0, 3.0, units.k)[1])
    leg = problem.phase("leg", model)
    leg.time(0.0, (1.0 * units.t, 9.0 * units.t))
    leg.initial(q=0.0, v=0.0)
    leg.final(v=0.0)
    leg.bounds(a=limits(-0.25, 1.2, units.a), v=limits(None, 0.75, units.v))
    for name, value, most in (("power", torque * rate, 0.42), ("height", 1 - ca.cos(angle), 0.8)):
        lower, upper = limits(None, most, units.limits)
        leg.path(name, value * units.limits, lower=lower, upper=upper)
    leg.guess(q=(0.0, 1.8 * units.q), v=0.5 * units.v)
    running = leg.integral((torque**2 / 2 + angle**2 / 10) * units.cost / units.t)
    off = (leg.final_state("q") / units.q - k / units.k) ** 2
    price = 0.4 * leg.final_time / units.t + 8 * off + (k / units.k - 1.9) ** 2
    problem.minimize(running + price * units.cost)
    return problem


@cache
def solved(units: Units) -> go.Solution:
    options = go.SolverOptions(tolerance=1e-11)
    return go.solve(pendulum(units), mesh="6x3", options=options)


@cache
def offended(units: Units) -> go.Solution:
    """Everything off by a little: a verdict without zeros."""
    solution = solved(units)
    leg = solution.phase()
    tilted = tuple(v * (1 + 0.01 * np.linspace(0, 1, v.shape[1])) for v in leg.lam.values)
    wrong = with_leg(
        solution,
        lam=PiecewisePolynomial(leg.lam.breaks, leg.lam.nodes, tilted),
        control_multipliers=1.01 * leg.control_multipliers + 0.01 * np.mean(leg.control_multipliers),
        path_multipliers=leg.path_multipliers + 0.02 * largest(leg.path_multipliers),
        state_multipliers=leg.state_multipliers + 0.02 * largest(leg.state_multipliers),
    )
    return replace(wrong, parameter_values=wrong.parameter_values + 0.01 * units.k)


def largest(values: np.ndarray) -> np.ndarray:
    """The entry of the largest magnitude in each row, with its sign (n, 1)."""
    return np.take_along_axis(values, np.argmax(np.abs(values), axis=1)[:, None], axis=1)


RELATIVE_TO_ONE = {"propagation", "boundary conditions", "cost", "second order"}
"""These are measured against max(1, value), or have a unit: their figures are not shares."""


@pytest.mark.parametrize("units", OTHERS.values(), ids=OTHERS)
def test_figures_and_places_do_not_depend_on_units(units: Units) -> None:
    usual, other = (go.verify(offended(u)) for u in (Units(), units))
    assert solved(units).objective == pytest.approx(units.cost * solved(Units()).objective, rel=1e-8)
    for condition in usual.conditions:
        twin = other[condition.name]
        assert twin.result is condition.result
        if condition.name not in RELATIVE_TO_ONE:
            assert twin.value == pytest.approx(condition.value, rel=1e-3, abs=1e-9), condition.name


def test_every_figure_is_worth_comparing() -> None:
    figures = {c.name: abs(c.value) for c in go.verify(offended(Units())).conditions}
    silent = {name for name, value in figures.items() if not value > 1e-6}
    none = {"singular arcs", "stored numbers", "generalised Legendre-Clebsch", "normality"}
    assert silent <= RELATIVE_TO_ONE | none
