"""The verdict's figures are shares: they depend neither on units nor on origins, and not on constants in the cost."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from testing.wrong_solutions import with_leg

import gnc_opt as go
from gnc_opt.planning.solution.polynomial import PiecewisePolynomial
from gnc_opt.planning.verification.recomputed import from_problem


@dataclass(frozen=True)
class Units:
    """How many of the new units one old unit is, and where the old origin is, in old units."""

    q: float = 1.0
    v: float = 1.0
    a: float = 1.0
    t: float = 1.0
    cost: float = 1.0
    limits: float = 1.0
    k: float = 1.0
    q_origin: float = 0.0
    v_origin: float = 0.0
    a_origin: float = 0.0
    t_origin: float = 0.0
    k_origin: float = 0.0
    constant: float = 0.0

    @classmethod
    def at_random(cls, seed: int) -> Units:
        """Any units, mirrored or not, and origins up to ten thousand old units away."""
        rng = np.random.default_rng(seed)
        q, v, a, t, cost, limits, k = 10.0 ** rng.uniform(-3, 3, 7)
        signs = rng.choice([-1.0, 1.0], 3)
        return cls(q * signs[0], v * signs[1], a * signs[2], t, cost, limits, k, *rng.uniform(-1e4, 1e4, 6))


OTHERS = {
    "position": Units(q=50.0),
    "speed": Units(v=0.04),
    "control": Units(a=30.0),
    "time": Units(t=20.0),
    "cost": Units(cost=0.03),
    "limits": Units(limits=40.0),
    "parameter": Units(k=25.0),
    "all": Units(30.0, 0.2, 7.0, 0.1, 8.0, 0.3, 0.5),
    "mirrored": Units(q=-1.0, v=-1.0, a=-1.0),
    "mirrored limits": Units(limits=-1.0),
}


def limits(
    lower: float | None, upper: float | None, unit: float, origin: float = 0.0
) -> tuple[float | None, float | None]:
    """A range in other units; in negative ones its ends change places."""
    low, high = (None if value is None else (value + origin) * unit for value in (lower, upper))
    return (low, high) if unit > 0 else (high, low)


def pendulum(units: Units) -> go.Problem:
    """Swing up a little in free time, with every kind of limit; on few nodes, so that every condition is offended."""
    model = go.Model("pendulum")
    q, v = model.state("q"), model.state("v")
    a = model.control("a")
    angle, rate = q / units.q - units.q_origin, v / units.v - units.v_origin
    torque, t = a / units.a - units.a_origin, model.time / units.t - units.t_origin
    push = 0.2 * ca.sin(3 * t)
    model.ode({q: rate * units.q / units.t, v: (torque - ca.sin(angle) + push) * units.v / units.t})
    problem = go.Problem("swing up")
    low, high = limits(0.0, 3.0, units.k, units.k_origin)
    k = problem.parameter("k", lower=low, upper=high)
    leg = problem.phase("leg", model)
    leg.time(units.t_origin * units.t, limits(1.0, 9.0, units.t, units.t_origin))
    still = units.v_origin * units.v
    leg.initial(q=units.q_origin * units.q, v=still)
    leg.final(v=still)
    leg.bounds(a=limits(-0.25, 1.2, units.a, units.a_origin), v=limits(None, 0.75, units.v, units.v_origin))
    for name, value, most in (("power", torque * rate, 0.42), ("height", 1 - ca.cos(angle), 0.8)):
        lower, upper = limits(None, most, units.limits)
        leg.path(name, value * units.limits, lower=lower, upper=upper)
    leg.guess(
        q=tuple((units.q_origin + q) * units.q for q in (0.0, 1.8)),
        v=(units.v_origin + 0.5) * units.v,
        a=(units.a_origin + 0.5) * units.a,
    )
    running = leg.integral((torque**2 / 2 + angle**2 / 10) * units.cost / units.t)
    aim = k / units.k - units.k_origin
    off = (leg.final_state("q") / units.q - units.q_origin - aim) ** 2
    price = 0.4 * (leg.final_time / units.t - units.t_origin) + 8 * off + (aim - 1.9) ** 2
    problem.minimize(running + (price + units.constant) * units.cost)
    return problem


@cache
def solved(units: Units) -> go.Solution:
    options = go.SolverOptions(tolerance=1e-11)
    return go.solve(pendulum(units), mesh="6x3", options=options, tol=None)


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


def restated(units: Units) -> go.Solution:
    """The offended solution in other units and with other origins, number by number, not solved anew."""
    solution, problem = offended(Units()), pendulum(units)
    leg = solution.phase()
    cost, time = units.cost, units.t
    state, control = np.array([units.q, units.v]), np.array([units.a])

    def affine(old: PiecewisePolynomial, unit: np.ndarray, origin: np.ndarray) -> PiecewisePolynomial:
        values = tuple((v + origin[:, None]) * unit[:, None] for v in old.values)
        return PiecewisePolynomial((old.breaks + units.t_origin) * time, old.nodes, values)

    by_state, by_control = (cost / state)[:, None], (cost / time / control)[:, None]
    new = replace(
        leg,
        initial_time=(leg.initial_time + units.t_origin) * time,
        final_time=(leg.final_time + units.t_origin) * time,
        x=affine(leg.x, state, np.array([units.q_origin, units.v_origin])),
        u=affine(leg.u, control, np.array([units.a_origin])),
        lam=affine(leg.lam, cost / state, np.zeros(2)),
        lam_start=leg.lam_start * by_state,
        lam_end=leg.lam_end * by_state,
        point_costates=leg.point_costates * by_state,
        path_multipliers=leg.path_multipliers * cost / time / units.limits,
        state_multipliers=leg.state_multipliers * by_state / time,
        control_multipliers=leg.control_multipliers * by_control,
        state_impulses=leg.state_impulses * by_state,
        time_multipliers=leg.time_multipliers * cost / time,
        duration_multiplier=leg.duration_multiplier * cost / time,
        integrals=leg.integrals * cost,
    )
    return from_problem(
        replace(
            solution,
            problem=problem,
            phases={leg.name: new},
            objective=(solution.objective + units.constant) * cost,
            parameter_values=(solution.parameter_values + units.k_origin) * units.k,
            parameter_multipliers=solution.parameter_multipliers * cost / units.k,
        )
    )


def largest(values: np.ndarray) -> np.ndarray:
    """The entry of the largest magnitude in each row, with its sign (n, 1)."""
    return np.take_along_axis(values, np.argmax(np.abs(values), axis=1)[:, None], axis=1)


@pytest.mark.parametrize("units", OTHERS.values(), ids=OTHERS)
def test_figures_and_places_do_not_depend_on_units(units: Units) -> None:
    usual, other = (go.verify(offended(u)) for u in (Units(), units))
    objective = units.cost * (solved(Units()).objective + units.constant)
    assert solved(units).objective == pytest.approx(objective, rel=1e-8)
    for condition in usual.conditions:
        twin = other[condition.name]
        assert twin.result is condition.result
        if condition.name != "second order":  # whose sign counts
            assert twin.value == pytest.approx(condition.value, rel=1e-3, abs=1e-9, nan_ok=True), (
                condition.name
            )


@pytest.mark.parametrize("seed", range(12))
def test_verdict_does_not_depend_on_any_affine_change_of_variables(seed: int) -> None:
    """States, control, time, parameter, limits and cost in random units, from random origins, with a constant."""
    usual, other = go.verify(offended(Units())), go.verify(restated(Units.at_random(seed)))
    for condition in usual.conditions:
        twin = other[condition.name]
        assert twin.result is condition.result, condition.name
        if condition.name != "second order":  # whose sign counts
            assert twin.value == pytest.approx(condition.value, rel=1e-4, abs=1e-9, nan_ok=True), (
                condition.name
            )


def test_every_figure_is_worth_comparing() -> None:
    figures = {c.name: abs(c.value) for c in go.verify(offended(Units())).conditions}
    silent = {name for name, value in figures.items() if not value > 1e-6}
    feasible = {"boundary conditions", "dynamics", "cost"}
    assert silent <= feasible | {"kinks", "second order", "switching times"}
