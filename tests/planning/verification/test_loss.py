"""The loss of cost of a wrong control, in units of the cost."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from testing import constructed_solutions as by_hand
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.report import summary_dict


def farthest(sign: float = 1.0) -> go.Problem:
    """As far as possible in 2 s from rest at |a| <= 1 m/s^2: 2 m; with another sign, the same by minimising."""
    model = go.Model("cart")
    q, v, a = model.state("q", unit="m"), model.state("v", unit="m/s"), model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    problem, leg = one_phase("farthest", model, 0.0, 2.0)
    leg.initial(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    if sign > 0:
        problem.maximize(leg.final_state("q"))
    else:
        problem.minimize(-leg.final_state("q"))
    return problem


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("off", [0.0, 0.25])
def test_the_loss_is_what_the_flight_falls_short(sign: float, off: float) -> None:
    """With a = 1 - off until 1 s it ends at 2 - 1.5 off: exact, as the dynamics and the end are linear."""
    a = 1.0 - off, 1.0

    def x(t: Any, k: int) -> Any:
        v = a[0] * t if k == 0 else t - off
        return np.array([0.5 * a[0] * t**2 if k == 0 else 0.5 * t**2 - off * (t - 0.5), v])

    problem = farthest(sign)
    leg = by_hand.phase(
        problem,
        x,
        lambda t, k: np.array([a[k] + 0 * t]),
        lambda t, k: np.array([-1 + 0 * t, t - 2]),
        breaks=(0.0, 1.0, 2.0),
    )
    verdict = go.verify(by_hand.solution(problem, leg))
    condition = verdict["minimum principle"]
    assert condition.loss == pytest.approx(1.5 * off, abs=1e-9) and condition.unit == "m"
    assert condition.result is (go.ConditionResult.FAIL if off else go.ConditionResult.PASS)
    assert all(c.loss is None for c in verdict.conditions if c.name != "minimum principle")
    if off:
        assert condition.location_text.endswith("; costs 0.38 m")
        for text in (verdict.explain(), verdict.table()):
            assert "costs 0.38 m" in text


def test_no_loss_without_costates() -> None:
    solution = go.solve(farthest(), mesh="2x3", tol=None)
    verdict = go.verify(solution)
    told = summary_dict(solution, verdict)["verdict"]["conditions"]
    by_name = {c["name"]: (c["loss"], c["unit"]) for c in told}
    assert by_name["minimum principle"] == (pytest.approx(0.0, abs=1e-6), "m")
    assert by_name["dynamics"] == (None, "") and json.dumps(told, allow_nan=False)


@pytest.mark.parametrize(
    ("cost", "unit"),
    [
        (lambda leg, wait, u: leg.final_time, "s"),
        (lambda leg, wait, u: leg.final_time - leg.initial_time + wait, "s"),
        (lambda leg, wait, u: leg.initial_state("m") - leg.final_state("m"), "kg"),
        (lambda leg, wait, u: leg.final_state("s"), "m"),
        (lambda leg, wait, u: 2 * leg.final_time, ""),
        (lambda leg, wait, u: leg.final_state("m") + leg.final_time, ""),
        (lambda leg, wait, u: leg.final_state("m") ** 2, ""),
        (lambda leg, wait, u: leg.integral(u), ""),
    ],
)
def test_unit_of_a_cost(cost: Any, unit: str) -> None:
    model = go.Model("rocket")
    m, s, u = model.state("m", unit="kg"), model.state("s", unit="m"), model.control("u", unit="kg/s")
    model.ode({m: -u, s: 1.0})
    problem, leg = one_phase("units", model, 0.0, (1.0, 2.0))
    wait = problem.parameter("wait", lower=0.0, upper=1.0, unit="s")
    problem.minimize(cost(leg, wait, u))
    assert problem.cost_unit == unit
