"""Path limits that repeat bounds: stated twice, a limit has one multiplier all the same."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.planning.problem.reformulation import restated


def _cart() -> tuple[go.Problem, go.Phase, Any, Any, Any]:
    model = go.Model("cart")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    problem = go.Problem("limits twice")
    leg = problem.phase("leg", model)
    leg.bounds(a=(-1.0, 1.0), v=(None, 1.0))
    return problem, leg, q, v, a


def test_limits_stated_on_control_and_state_and_again_are_no_obstacle() -> None:
    """Rest to rest over 2 with |a| <= 1 and v <= 1: 1 s up, 1 s at the limit, 1 s down."""
    problem, leg, _q, v, a = _cart()
    leg.time(0.0, (0.1, 9.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=2.0, v=0.0)
    leg.path("speed", v, upper=1.0)
    leg.path("push", ca.vertcat(a, -2 * a), upper=[1.0, 2.0])
    problem.minimize(leg.final_time)
    solution = go.solve(problem)
    assert solution.objective == pytest.approx(3.0, abs=1e-7)
    verdict = go.verify(solution)
    assert verdict.ok, verdict.explain()


def test_only_what_bounds_say_already_is_free() -> None:
    problem, leg, q, v, a = _cart()
    leg.path("looser", 3 * v + 1, upper=5.0)
    leg.path("tighter", v, upper=0.9)
    leg.path("below", v, lower=-1.0, upper=1.0)
    leg.path("fixed", a, equals=1.0)
    leg.path("mixed", v + a, upper=9.0)
    leg.path("bent", a**2, upper=9.0)
    leg.path("free before", q, upper=1.0)
    leg.path("turned", ca.vertcat(-2 * a, a), upper=[1.0, np.inf], lower=[-np.inf, -0.5])
    paths = restated(problem).phases["leg"].paths
    limits = {name: (c.interval.lower[0], c.interval.upper[0]) for name, c in paths.items()}
    assert limits == {
        "looser": (-np.inf, np.inf),
        "tighter": (-np.inf, 0.9),
        "below": (-1.0, np.inf),
        "fixed": (1.0, 1.0),
        "mixed": (-np.inf, 9.0),
        "bent": (-np.inf, 9.0),
        "free before": (-np.inf, 1.0),
        "turned": (-np.inf, 1.0),
    }
    assert paths["turned"].interval.lower[1] == -0.5


def test_products_of_numbers_are_compared_up_to_their_rounding() -> None:
    """3 * 0.1 is 0.30000000000000004; what differs by 1e-10 is another limit. Without any the problem stays."""
    problem, leg, _q, v, _a = _cart()
    leg.bounds(v=(-0.1, 0.1))
    leg.path("same", 3 * v, lower=-0.3, upper=0.3)
    same = restated(problem).phases["leg"].paths["same"].interval
    assert (same.lower, same.upper) == ([-np.inf], [np.inf])
    problem, leg, _q, v, _a = _cart()
    leg.bounds(v=(-0.1, 0.1))
    leg.path("other", 3 * v, lower=-0.3 * (1 - 1e-10), upper=0.3 * (1 - 1e-10))
    assert restated(problem) is problem


def test_what_is_free_tells_programs_apart() -> None:
    problem, leg, _q, v, a = _cart()
    leg.path("both", ca.vertcat(v, a), upper=[1.0, 1.0])
    problem.minimize(leg.final_state("q") ** 2)
    stronger = problem.with_bounds(a=(-1.0, 2.0))
    assert restated(stronger).phases["leg"].paths["both"].interval.upper.tolist() == [np.inf, 1.0]
    assert restated(stronger).builds is not restated(problem).builds


def test_variations_are_variations_of_one_another() -> None:
    problem, leg, _q, v, _a = _cart()
    leg.path("speed", v, upper=1.0)
    problem.minimize(leg.final_state("q") ** 2)
    slower = problem.with_bounds(v=(None, 0.8))
    assert restated(slower).builds is restated(problem).builds
    assert restated(problem).fingerprint() == restated(problem).fingerprint()


@pytest.mark.parametrize("of_solution", [False, True])
def test_limits_come_back_where_other_bounds_do_not_keep_them(of_solution: bool) -> None:
    """Rest to rest over 2, |a| <= 1, and v <= 1 by a path limit that a bound of 1 has kept before: 3 s, not 2.83."""
    problem, leg, _q, v, _a = _cart()
    leg.time(0.0, (0.1, 9.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=2.0, v=0.0)
    leg.path("speed", v, upper=1.0)
    problem.minimize(leg.final_time)
    solution = go.solve(problem)
    wider = (solution.need_problem("vary") if of_solution else problem).with_bounds(v=(None, 2.0))
    assert restated(wider).phases["leg"].paths["speed"].interval.upper == [1.0]
    assert go.solve(wider).objective == pytest.approx(3.0, abs=1e-7)
    found = go.Resolver(solution).solve(wider)
    assert found.objective == pytest.approx(3.0, abs=1e-6) and go.verify(found).ok
    again = restated(wider).with_bounds(v=(None, 1.0))
    assert restated(again).phases["leg"].paths["speed"].interval.upper == [np.inf]


def test_limits_beside_a_kink_come_back_too() -> None:
    """The row of the speed shares its constraint with one that is restated."""
    problem, leg, _q, v, a = _cart()
    leg.time(0.0, 1.0)
    leg.path("both", ca.vertcat(v, ca.fabs(a)), upper=[1.0, 0.5])
    problem.minimize(leg.final_state("q") ** 2)
    for wider in (problem.with_bounds(v=(None, 2.0)), restated(problem).with_bounds(v=(None, 2.0))):
        limits = [c.interval for c in restated(wider).phases["leg"].paths.values()]
        assert any(1.0 in box.upper for box in limits)
