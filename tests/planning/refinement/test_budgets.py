"""Budgets as bounded states, which stay at their bounds by themselves once they are used up: closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import ArcKind


def throw(phases: int) -> go.Problem:
    """Reach as far as possible within 3 s, with an impulse of 1 and an acceleration of at most 1."""
    model = go.Model("thrower")
    x, v, spent = model.state("x"), model.state("v"), model.state("spent")
    u = model.control("u")
    model.ode({x: v, v: u, spent: u})
    problem = go.Problem("throw")
    legs = [problem.phase(f"leg{k}", model) for k in range(phases)]
    for k, leg in enumerate(legs):
        leg.time(initial=3.0 * k / phases, final=3.0 * (k + 1) / phases)
        leg.bounds(u=(0.0, 1.0), spent=(0.0, 1.0))
        if k:
            problem.link(legs[k - 1], leg)
    legs[0].initial(x=0.0, v=0.0, spent=0.0)
    problem.maximize(legs[-1].final_state("x"))
    return problem


@pytest.mark.slow
@pytest.mark.parametrize("phases", [1, 2])
def test_the_costate_of_a_budget_is_constant_until_the_end(phases: int) -> None:
    """It is best to push at once, for 1 s: x = 1 / 2 + 2; the last bit of the impulse would be worth 3 - 1 = 2 m.

    At the bound, for two seconds, the multiplier could be spread in any way that keeps u at zero.
    """
    solution = go.solve(throw(phases))
    assert go.verify(solution).minimum
    assert solution.objective == pytest.approx(2.5, abs=1e-9)
    for leg in solution.phases.values():
        times = np.linspace(leg.initial_time, leg.final_time, 7)
        np.testing.assert_allclose(leg.costate("spent")(times), 2.0, atol=1e-8 if phases == 1 else 1e-3)
    if phases == 1:  # of two, either may have the multiplier
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
    solution = go.solve(throw(1), tol=None, mesh="7x3")
    spent = solution.phase().state("spent")(np.linspace(0.0, 3.0, 301))
    assert spent[-1] == pytest.approx(1.0, abs=1e-8)
    assert spent[-1] <= 1.0 + 1e-9
    assert np.max(spent) < 1.01


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
