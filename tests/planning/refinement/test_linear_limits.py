"""Path constraints that limit controls in which H is linear, thrust per mass above all, in closed form."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import ArcKind

MASS, FULL, MOST, EXHAUST, SPEED = 6.0, 40.0, 10.0, 30.0, 40.0
"""kg; N; m/s^2; m/s; m/s: of a sled that is thrust to that speed, and may not be accelerated by more than that."""

Limit = Callable[[Any, Any], dict[str, Any]]

LIMITS: dict[str, Limit] = {
    "at most": lambda T, m: {"expression": T / m, "upper": MOST},
    "at least": lambda T, m: {"expression": MOST * m - T, "lower": 0.0},
}


def sled(limit: Limit) -> go.Problem:
    """Up to a speed in the least time: full thrust until it is the most that the mass left bears, then that."""
    model, _v, m, T = dynamics("sled", "v m", "T", lambda v, m, T: {v: T / m, m: -T / EXHAUST})
    problem, leg = one_phase("sled", model, initial=0.0, final=(0.5, 20.0))
    leg.initial(v=0.0, m=MASS)
    leg.final(v=SPEED)
    leg.bounds(T=(0.0, FULL), m=(0.5, MASS))
    leg.path("acceleration", **limit(T, m))
    problem.minimize(leg.final_time)
    return problem


@pytest.mark.parametrize("limit", LIMITS.values(), ids=LIMITS)
def test_a_path_constraint_takes_over_from_the_bound_of_a_control(limit: Limit) -> None:
    """At m_1 = F / a after (m_0 - m_1) c / F, with v_1 = c ln(m_0 / m_1), and (v - v_1) / a to go."""
    left = FULL / MOST
    over = (MASS - left) * EXHAUST / FULL
    time = over + (SPEED - EXHAUST * np.log(MASS / left)) / MOST
    solution = go.solve(sled(limit), mesh="8x4")
    assert solution.converged and go.verify(solution).ok
    assert solution.objective == pytest.approx(time, abs=1e-9)
    thrust, limited = ([a for a in solution.structure if a.channel == name] for name in ("T", "acceleration"))
    assert thrust[0].end == limited[0].start == pytest.approx(over, abs=1e-6)
    found = solution.phase().control("T")(np.array([0.5 * over, time - 0.1]))
    mass = left * np.exp(-MOST / EXHAUST * (time - 0.1 - over))
    np.testing.assert_allclose(found, [FULL, MOST * mass], rtol=1e-8)


@pytest.mark.slow
def test_a_limit_of_thrust_per_mass_is_switched_on_and_off() -> None:
    r"""Rest to rest over 1 m in 3 s: a burn of |a| = 1 each, so that the mass is left that exp(-k \\Delta v) leaves."""
    model = go.Model("cart")
    r, v, m = model.state("r", 2), model.state("v", 2), model.state("m")
    T = model.control("T", 2)
    model.ode({r: v, v: T / m, m: -0.05 * ca.norm_2(T)})
    problem, leg = one_phase("p", model, initial=0.0, final=3.0)
    leg.initial(r=[0.0, 0.0], v=[0.0, 0.0], m=40.0)
    leg.final(r=[0.6, -0.8], v=[0.0, 0.0])
    leg.bounds(m=(1.0, 40.0))
    leg.path("acceleration", ca.sumsqr(T / m), upper=1.0)
    problem.maximize(leg.final_state("m"))
    solution = go.solve(problem, mesh="10x4")
    burn = 0.5 * (3.0 - np.sqrt(5.0))
    assert solution.converged and go.verify(solution).ok
    assert solution.objective == pytest.approx(40 * np.exp(-0.05 * 2 * burn), rel=1e-10)
    size = [a for a in solution.structure if a.channel == "T_magnitude"]
    assert [a.kind for a in size] == [ArcKind.CONSTRAINED, ArcKind.LOWER, ArcKind.CONSTRAINED]
    assert [a.end for a in size] == pytest.approx([burn, 3.0 - burn, 3.0], abs=1e-8)
    assert solution.phase().path_multiplier(0.0)[0] >= 0
