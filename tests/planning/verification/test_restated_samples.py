"""Foreign trajectories that rest on kinks of their cost: judged in the controls that a default call solves for."""

from __future__ import annotations

import itertools
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.internals import Samples, restated

import gnc_opt as go
from gnc_opt.planning.verification.verify_trajectory import restated_samples

_TIME = 2.5
_COSTS = {
    "fabs": lambda a: ca.fabs(a[0]) + ca.fabs(a[1]),
    "dear forth": lambda a: ca.if_else(a[0] > 0, 2 * a[0], -0.5 * a[0]) + ca.fabs(a[1]),
    "sqrt": lambda a: ca.sqrt(a[0] ** 2 + a[1] ** 2),
    "norm_2": ca.norm_2,
    "rounded": lambda a: ca.sqrt(ca.sumsqr(a) + 1e-12),
}


def _problem(cost: str) -> tuple[go.Problem, go.Phase]:
    """Rest to rest over (1, 0) with the least fuel."""
    model = go.Model("leg")
    q, v, a = model.state("q", 2), model.state("v", 2), model.control("a", 2)
    model.ode({q: v, v: a})
    problem = go.Problem("fuel")
    leg = problem.phase("leg", model)
    leg.time(0.0, _TIME)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=[1.0, 0.0], v=0.0)
    if cost in ("fabs", "dear forth"):
        leg.bounds(a=([-1.0, -1.0], [1.0, 1.0]))
    else:
        leg.path("thrust", ca.sumsqr(a), upper=1.0)
    problem.minimize(leg.integral(_COSTS[cost](a)))
    return problem, leg


def _flight(push: float) -> tuple[Any, Any, Any]:
    """Push, coast, push back: the stronger, the less fuel. push s (T - s) = 1."""
    s = (_TIME - np.sqrt(_TIME**2 - 4 / push)) / 2
    ends = np.array([0.0, s, _TIME - s, _TIME])
    t = np.concatenate([np.linspace(a, b, 9) for a, b in itertools.pairwise(ends)])
    arc = np.repeat(np.arange(3), 9)
    q = np.choose(arc, [push * t**2 / 2, push * s * (t - s / 2), 1 - push * (_TIME - t) ** 2 / 2])
    v = np.choose(arc, [push * t, push * s + 0 * t, push * (_TIME - t)])
    u = np.choose(arc, [push + 0 * t, 0 * t, -push + 0 * t])
    return t, np.array([q, 0 * t, v, 0 * t]), np.array([u, 0 * t])


@pytest.mark.parametrize("cost", _COSTS)
def test_a_coast_of_least_fuel_is_judged_however_its_cost_is_written(cost: str) -> None:
    problem, _ = _problem(cost)
    right, wrong = (go.verify_trajectory(problem, *_flight(push)) for push in (1.0, 0.99))
    assert right.ok, right.explain()
    assert wrong.failed
    assert right.estimated


@pytest.mark.parametrize(("price", "end", "rounding"), [(3.0, 1.0, 0.0), (3.0, 1.0, 1e-15), (1.2, 0.6, 0.0)])
def test_an_end_on_or_beside_the_kink_of_its_cost_is_a_minimum(
    price: float, end: float, rounding: float
) -> None:
    """end^2 + price |end - 1| is least at 1, or at price / 2 if that is less."""
    model = go.Model("leg")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("soft end")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    problem.minimize(leg.integral(u**2) + price * ca.fabs(leg.final_state("x") - 1))
    t = np.linspace(0.0, 1.0, 21)

    def judged(c: float) -> go.Verdict:
        return go.verify_trajectory(problem, t, c * t, c + 0 * t)

    assert judged(end + rounding).minimum
    assert judged(end + 0.05).failed
    assert judged(end - 0.05).failed


@pytest.mark.parametrize("cost", ["fabs", "dear forth", "sqrt"])
def test_samples_in_other_controls_are_those_that_were_stated(cost: str) -> None:
    """What is solved for makes up what was stated, also where nothing pushes."""
    problem, _ = _problem(cost)
    twin = restated(problem)
    u = np.random.default_rng(3).uniform(-1.0, 1.0, (2, 9))
    u[:, 4:6] = 0.0
    t = np.linspace(0.0, 1.0, 9)
    (own,) = restated_samples(problem, twin, {"leg": Samples(t, np.zeros((4, 9)), u)}, np.zeros(0)).values()
    restatement = twin.phases["leg"].restatement
    assert restatement is not None
    controls = twin.phases["leg"].model.symbols("control")
    assert np.all(np.isfinite(own.u))
    back = ca.Function("back", [controls], [restatement.solved]).map(9)(own.u)
    np.testing.assert_allclose(back.full(), u, atol=1e-14)
