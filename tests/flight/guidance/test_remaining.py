"""The rest of a problem is asked for as the whole was: clocks go on, no budget is granted anew.

The cart has the least integral of u^2 from q = -1 at rest to the origin in 1 s; from
(q, v) in T it is 12 q^2 / T^3 + 12 q v / T^2 + 4 v^2 / T.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from testing.internals import build_remaining_problem, check_remaining_problem
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.control import Reference, feedforward
from gnc_opt.guidance import Replanner
from gnc_opt.simulation import ClosedLoop

DT = 0.01


def stated(more: Callable[[Any, Any], None] | None = None, **times: Any) -> go.Problem:
    m = go.Model("cart")
    q, v, u = m.state("q"), m.state("v"), m.control("u")
    gain = m.parameter("gain", 1.0)
    m.ode({q: v, v: gain * u})
    p, leg = one_phase("cart", m, **(times or {"initial": 0.0, "final": 1.0}))
    leg.initial(q=-1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    if more is not None:
        more(p, leg)
    if p.cost is None:
        p.minimize(leg.integral(u**2))
    return p


@functools.lru_cache
def resolver() -> go.Resolver:
    return go.Resolver(go.solve(stated(initial=0.0, duration=1.0), mesh="4x3", tol=None), cold=False)


def loop(dt: float = DT, solver: Any = resolver, **more: Any) -> ClosedLoop:
    plan = solver().solution
    options = {"every": 0.25, "latency": 0.0, "last": 0.1} | more
    law = feedforward(Reference(plan, tail="hold"))
    model = plan.need_problem("").phases["leg"].model
    return ClosedLoop(model, law, replanner=Replanner(solver, **options), dt=dt)


def test_the_end_of_a_given_duration_stays_where_it_is() -> None:
    run = loop().simulate([-1.2, 0.3], tf=1.0)
    assert [r.final_time for r in run.replans] == pytest.approx([1.0] * 3)
    for replan in run.replans:
        q, v = run.state("q")(replan.time)[0], run.state("v")(replan.time)[0]
        left = 1.0 - replan.time
        cost = 12 * q**2 / left**3 + 12 * q * v / left**2 + 4 * v**2 / left
        assert replan.objective == pytest.approx(cost, rel=1e-6)


def test_limits_of_the_duration_move_with_the_clock() -> None:
    p = stated(initial=2.0, duration=(1.0, 4.0))
    rest = (
        build_remaining_problem(p, 2.0, 3.5, {"q": np.array([-0.5]), "v": np.array([1.0])})
        .phases["leg"]
        .numbers
    )
    assert (rest.duration.lower[0], rest.duration.upper[0]) == (0.0, 2.5)
    assert rest.initial.lower == pytest.approx([-0.5, 1.0])


def test_a_start_a_little_beyond_a_limit_begins_on_it() -> None:
    """2 % of the range, of the limit where there is but one; a start farther away is left to be refused."""
    p = stated().with_bounds(q=(-1.0, 1.0), v=(None, 2.0))
    for given, used in (
        ([-1.03, 2.03], [-1.0, 2.0]),
        ([1.03, 1.9], [1.0, 1.9]),
        ([-1.05, 2.05], [-1.05, 2.05]),
    ):
        rest = build_remaining_problem(p, 0.0, 0.5, {"q": np.array(given[:1]), "v": np.array(given[1:])})
        assert rest.phases["leg"].numbers.initial.lower == pytest.approx(used, abs=1e-15)


def test_seldom_plans_come_when_they_are_due() -> None:
    """More than 1000 control steps lie between two: runs are flown in legs of so many."""
    run = loop(5e-4, every=0.6).simulate([-1.0, 0.0], tf=1.0)
    assert [r.time for r in run.replans] == pytest.approx([0.6])


def test_a_plan_that_ends_in_motion_is_followed() -> None:
    """Least integral of u^2 plus (q(1) - 1)^2 from rest at 0, the end free: u = 3 (1 - t) / 4."""

    def free_end(p: Any, leg: Any) -> None:
        leg.initial(q=0.0, v=0.0)
        leg.final(q=None, v=None)
        u = leg.model.symbol("u")
        p.minimize(leg.integral(u**2) + (leg.final_state("q") - 1.0) ** 2)

    solver = go.Resolver(go.solve(stated(free_end), mesh="4x3", tol=None), cold=False)
    run = loop(solver=lambda: solver).simulate([0.0, 0.0], tf=1.0)
    assert not any(r.failed for r in run.replans) and len(run.replans) == 3
    # u = k (1 - t), q(1) = k / 3, and 2 u = 2 (1 - q(1)) (1 - t): k = 3 / 4
    assert run.states[:, -1] == pytest.approx([0.25, 0.375], abs=1e-5)


def budget(p: Any, leg: Any) -> None:
    p.constrain("effort", leg.integral(leg.model.symbol("u") ** 2), upper=20.0)


def shift(p: Any, leg: Any) -> None:
    p.constrain("shift", leg.final_state("q") - leg.initial_state("q"), equals=1.0)


def clock(p: Any, leg: Any) -> None:
    p.constrain("clock", leg.duration, upper=2.0)


def squared(p: Any, leg: Any) -> None:
    p.minimize(leg.duration**2 + leg.integral(leg.model.symbol("u") ** 2))


def per_second(p: Any, leg: Any) -> None:
    p.minimize(leg.integral(leg.model.symbol("u") ** 2) / leg.duration)


def chosen(p: Any, leg: Any) -> None:
    p.parameter("gain", lower=0.5, upper=2.0)


@pytest.mark.parametrize(
    ("more", "what"),
    [
        (budget, "'effort' of problem 'cart' applies to the whole trajectory"),
        (shift, "'shift' of problem 'cart' applies to the whole trajectory"),
        (clock, r"give time\(duration"),
        (squared, "is not additive"),
        (per_second, "is not additive"),
        (chosen, "'gain' of model 'cart' is optimised in the plan"),
    ],
)
def test_what_would_be_granted_anew_is_refused(more: Any, what: str) -> None:
    with pytest.raises(go.ArgumentError, match=what):
        check_remaining_problem(stated(more))


def sums(p: Any, leg: Any) -> None:
    effort = leg.integral(leg.model.symbol("u") ** 2)
    p.constrain("end", leg.final_state("q") ** 2 + leg.final_time, upper=4.0)
    p.minimize(2 * leg.duration + 3 * effort + leg.final_state("v") ** 2 - leg.initial_state("q") ** 2)


def ratio(p: Any, leg: Any) -> None:
    p.maximize((leg.final_state("q") + 3) / (leg.initial_state("q") + 3))


@pytest.mark.parametrize("more", [None, sums, ratio])
def test_what_adds_up_is_not(more: Any) -> None:
    check_remaining_problem(stated(more))


class Stale:
    """A resolver that returns its old plan."""

    solution = property(lambda _: resolver().solution)

    def solve(self, problem: go.Problem, *, near: Any = None) -> go.Solution:
        return resolver().solution


class Refusing(Stale):
    def solve(self, problem: go.Problem, *, near: Any = None) -> go.Solution:
        raise go.ProblemError("no.")


class Broken(Stale):
    def solve(self, problem: go.Problem, *, near: Any = None) -> go.Solution:
        raise ValueError("out of memory slots")


def spoilt(plan: go.Solution, how: Callable[[Any], Any]) -> Any:
    """Return a schedule of a plan that is right for the first plan only."""
    schedule = feedforward(Reference(plan, tail="hold")).schedule
    if plan is resolver().solution:
        return schedule
    return lambda times, dt: how(schedule(times, dt))


@pytest.mark.parametrize(
    ("more", "what"),
    [
        ({"solver": Stale}, r"begins at 0 s, not at 0\.25 s"),
        ({"solver": Broken}, "ValueError: out of memory slots"),
        ({"follow": lambda plan: spoilt(plan, lambda rows: rows[:, :1])}, r"shape \(3, 1\) at 76 times"),
        ({"follow": lambda plan: spoilt(plan, lambda rows: np.nan * rows)}, "not finite"),
        ({"follow": lambda plan: spoilt(plan, lambda rows: rows["a"])}, "IndexError"),
    ],
)
def test_a_plan_that_cannot_be_flown_leaves_the_old_one(more: Any, what: str) -> None:
    run = loop(**more).simulate([-1.0, 0.0], tf=1.0)
    assert len(run.replans) == 3 and all(r.failed for r in run.replans)
    assert re.search(what, run.replans[0].failure)
    assert run.states[:, -1] == pytest.approx([0.0, 0.0], abs=1e-4)


def test_what_makes_no_resolver_or_schedule_is_refused() -> None:
    class Mute:
        solution = property(lambda _: resolver().solution)

    for made, what in (
        (
            lambda: loop(follow=lambda plan: 3),
            "follow= of the Replanner failed for the original plan, TypeError",
        ),
        (lambda: loop(follow=lambda plan: 1 / 0), "ZeroDivisionError: division by zero"),
        (lambda: Replanner(lambda: 3, every=0.1), "returned 3: write lambda"),  # type: ignore[arg-type,return-value]
        (lambda: Replanner(Mute, every=0.1), r"has no solve\(\)"),  # type: ignore[arg-type]
        (lambda: loop(latency=0.7), "would never re-plan: every, latency and last are 1.05 s"),
    ):
        with pytest.raises(go.ArgumentError, match=what):
            made()
