"""Budgets as bounded states, which stay at their bounds by themselves once they are used up: closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import ArcKind


def throw() -> go.Problem:
    """Reach as far as possible within 3 s, with an impulse of 1 and an acceleration of at most 1."""
    model, _x, _v, _spent, _u = dynamics(
        "thrower", "x v spent", "u", lambda x, v, spent, u: {x: v, v: u, spent: u}
    )
    problem, leg = one_phase("throw", model, initial=0.0, final=3.0)
    leg.bounds(u=(0.0, 1.0), spent=(0.0, 1.0))
    leg.initial(x=0.0, v=0.0, spent=0.0)
    problem.maximize(leg.final_state("x"))
    return problem


@pytest.mark.slow
def test_the_costate_of_a_budget_is_constant_until_the_end() -> None:
    """It is best to push at once, for 1 s: x = 1 / 2 + 2; the last bit of the impulse would be worth 3 - 1 = 2 m.

    At the bound, for two seconds, the multiplier could be spread in any way that keeps u at zero.
    """
    solution = go.solve(throw())
    assert go.verify(solution).minimum
    assert solution.objective == pytest.approx(2.5, abs=1e-9)
    np.testing.assert_allclose(solution.phase().costate("spent")(np.linspace(0.0, 3.0, 7)), 2.0, atol=1e-8)
    arcs = [(arc.kind, arc.start, arc.end) for arc in solution.structure if arc.channel == "u"]
    assert [arc[0] for arc in arcs] == [ArcKind.UPPER, ArcKind.LOWER]
    assert arcs[0][2] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("of_fuel", [False, True])
def test_a_rocket_that_burns_out(of_fuel: bool) -> None:
    """A sounding rocket is highest after 1.5 s if it burns at once: Tsiolkovsky's equation with gravity 1.

    Its tank holds 0.4 of its mass: as a mass above the dry one, or as fuel that cannot be less than none.
    """
    exhaust, thrust, dry = 2.0, 3.0, 0.6
    model = go.Model("sounding rocket")
    h, v, tank = model.state("h"), model.state("v"), model.state("tank")
    force = model.control("T")
    mass = dry + tank if of_fuel else tank
    model.ode({h: v, v: force / mass - 1.0, tank: -force / exhaust})
    problem, leg = one_phase("rocket", model, initial=0.0, final=1.5, name="up")
    empty = 0.0 if of_fuel else dry
    leg.initial(h=0.0, v=0.0, tank=empty + 0.4)
    leg.bounds(T=(0.0, thrust), tank=(empty, None))
    problem.maximize(leg.final_state("h"))
    solution = go.solve(problem)
    ratio, burn = 1.0 / dry, 0.4 * exhaust / thrust
    speed = exhaust * math.log(ratio) - burn
    height = exhaust * burn * (1.0 - math.log(ratio) / (ratio - 1.0)) - burn**2 / 2
    coast = 1.5 - burn
    assert go.verify(solution).minimum
    assert solution.objective == pytest.approx(height + speed * coast - coast**2 / 2, abs=1e-9)


def test_the_bound_of_a_budget_still_holds() -> None:
    """Loosened between the ends, it is as strict as before at the end: with a larger budget x is larger."""
    solution = go.solve(throw(), tol=None, mesh="7x3")
    spent = solution.phase().state("spent")(np.linspace(0.0, 3.0, 301))
    assert spent[-1] == pytest.approx(1.0, abs=1e-8)
    assert spent[-1] <= 1.0 + 1e-9
    assert np.max(spent) < 1.01


def test_the_costate_of_a_full_tank_during_a_fall() -> None:
    """Burn at full thrust for 1 / sqrt(3) s. The fall, which uses nothing, begins and ends at the bound of the tank."""
    problem = go.Problem("landing")
    for name in ("fall", "burn"):
        model = go.Model(name)
        h, v, tank = model.state("h"), model.state("v"), model.state("tank")
        u = model.control("u") if name == "burn" else 0.0
        model.ode({h: v, v: u - 1.0, tank: -u})
        problem.phase(name, model).bounds(tank=(0.0, 2.0))
    fall, burn = problem.phases.values()
    problem.sequence(fall, burn, durations=dict.fromkeys(("fall", "burn"), (0.1, 5.0)))
    fall.initial(h=1.0, v=0.0, tank=2.0)
    burn.final(h=0.0, v=0.0)
    burn.bounds(u=(1.0, 3.0))
    problem.maximize(burn.final_state("tank"))
    solution = go.solve(problem, tol=None)
    assert solution.objective == pytest.approx(2.0 - math.sqrt(3.0), abs=1e-8)
    np.testing.assert_allclose(solution.phase("fall").costate("tank")([0.0, 0.5]), -1.0, atol=1e-6)


def test_a_state_that_is_paid_back_keeps_its_bound() -> None:
    """A battery that recharges may be full in between: x' = u, |u| <= 1, x <= 1, and the mean of x is largest."""
    model, x, _u = dynamics("battery", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("battery", model, initial=0.0, final=4.0, name="day")
    leg.initial(x=0.0)
    leg.final(x=0.0)
    leg.bounds(u=(-1.0, 1.0), x=(None, 1.0))
    problem.maximize(leg.integral(x))
    solution = go.solve(problem)
    assert go.verify(solution).ok
    assert solution.objective == pytest.approx(3.0, abs=1e-8)
    assert solution.phase().state("x")(2.0) == pytest.approx(1.0, abs=1e-8)
