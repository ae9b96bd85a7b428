"""Propagation ends, whatever the dynamics are like, and says where and why."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.internals import phase_functions

import gnc_opt as go
from gnc_opt.model import integration
from gnc_opt.planning.solution.propagation import Propagation, propagate


def fall(rate_of_v: Any = lambda x, v, u: u) -> go.Problem:
    """x'' = u from rest at 0 to -1 in 1 s: x is below zero at once."""
    model = go.Model("fall")
    x, v, u = model.state("x"), model.state("v"), model.control("u")
    model.ode({x: v, v: rate_of_v(x, v, u)})
    problem = go.Problem("fall")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=-1.0)
    problem.minimize(leg.integral(u**2))
    return problem


@pytest.fixture(scope="module")
def solution() -> go.Solution:
    return go.solve(fall(), mesh="4x4", tol=None)


def flown_with(solution: go.Solution, rate_of_v: Any) -> Propagation:
    """The solution's control, flown with other dynamics."""
    empty = np.zeros(0)
    return propagate(
        solution.phase(), phase_functions(fall(rate_of_v), "leg", empty, empty, np.ones(1)), rtol=1e-8
    )


def test_it_arrives(solution: go.Solution) -> None:
    run = solution.propagate()
    assert run.ended == "" and np.max(np.abs(run.error)) < 1e-9


def test_the_edge_of_the_domain_does_not_hang_it(solution: go.Solution) -> None:
    """Rates are NaN below x = 0, where the flight begins: ever shorter steps are accepted, 1e-160 s and less."""
    run = flown_with(solution, lambda x, v, u: ca.if_else(x < 0, ca.log(-1 - x**2), -1.0))
    assert run.ended == "the rate of state 'v' is nan at t = 0 s"
    assert np.all(np.isinf(run.error))
    assert np.all(np.isnan(run.states[:, 1:])) and np.all(run.states[:, 0] == 0)


def test_a_domain_left_on_the_way_is_placed_in_time(solution: go.Solution) -> None:
    """The minimum effort answer is x = -(3 t^2 - t^3) / 2: it passes -0.5 at t = 0.6527."""
    run = flown_with(solution, lambda x, v, u: u + ca.if_else(x < -0.5, ca.log(x), 0.0))
    at = float(run.ended.split("t = ")[1].split()[0])
    assert "rate of state 'v' is nan" in run.ended and at == pytest.approx(0.6527, abs=0.05)
    assert np.all(np.isfinite(run.states[:, run.times < 0.6]))


def test_stiff_dynamics_do_not_hang_it(solution: go.Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(integration, "MOST_RATES", 2000)
    run = flown_with(solution, lambda x, v, u: -1e9 * (v + 1))
    assert run.ended.startswith("2,000 evaluations of the dynamics led to t = ")
    assert np.all(np.isinf(run.error))


def test_divergence_is_placed_in_time(solution: go.Solution) -> None:
    """v' = u - 1e3 v^2 explodes soon after the start."""
    run = flown_with(solution, lambda x, v, u: u - 1e3 * v**2)
    assert "t = 0." in run.ended and np.all(np.isinf(run.error))
