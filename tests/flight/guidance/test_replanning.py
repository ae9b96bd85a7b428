"""Re-planning in flight: closed forms of a cart, latency, failures, estimates, campaigns, and what is refused.

The cart goes from q(0) = -1 at rest to the origin within 1 s with the least integral of u^2: u = 12 (-q0/2) (1 - 2t).
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.analysis import linear_covariance
from gnc_opt.control import Controller, Reference, feedforward
from gnc_opt.estimation import Measurement, design_ekf, output_feedback
from gnc_opt.guidance import Replanner
from gnc_opt.planning import Resolver
from gnc_opt.simulation import ClosedLoop, ConstantDisturbance, Noise, Run, Uniform, monte_carlo

DT = 0.01
LATENCY = 0.035


@functools.lru_cache
def resolver() -> Resolver:
    m = go.Model("cart")
    q, v = m.state("q", unit="m"), m.state("v", unit="m/s")
    u = m.control("u", unit="m/s^2")
    m.ode({q: v, v: u})
    p, leg = one_phase("cart", m, initial=0.0, final=1.0)
    leg.bounds(u=(-50.0, 50.0))
    leg.initial(q=-1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    p.minimize(leg.integral(u**2))
    return Resolver(go.solve(p, mesh="4x3", tol=None), cold=False)


class Spy:
    """A resolver that keeps what it was asked for and fails from a time (s) on."""

    def __init__(self, fails_from: float = np.inf) -> None:
        self.fails_from, self.asked = fails_from, []
        self.solution = resolver().solution

    def solve(self, problem: go.Problem, *, near: go.Solution | None = None) -> go.Solution:
        numbers = problem.phases["leg"].numbers
        assert numbers.initial_time is not None
        begin = float(numbers.initial_time.lower[0])
        self.asked.append((begin, np.asarray(numbers.initial.lower)))
        if begin > self.fails_from:
            raise go.ProblemError("not this time.")
        return resolver().solve(problem, near=near)


def law() -> Controller:
    return feedforward(Reference(resolver().solution))


def plant() -> go.Model:
    return resolver().solution.need_problem("").phases["leg"].model


def loop(replanner: Replanner | None = None, **more: Any) -> ClosedLoop:
    return ClosedLoop(plant(), more.pop("controller", law()), replanner=replanner, dt=DT, **more)


def every(time: float = 0.1, solver: Any = resolver, **more: Any) -> Replanner:
    return Replanner(solver, every=time, **({"latency": LATENCY, "last": 0.1} | more))


def test_a_displaced_start_is_met_in_spite_of_the_latency() -> None:
    """Without disturbance the first new plan leads to the end; without re-planning the cart misses by v0 and more."""
    run = loop(every()).simulate([-1.2, 0.3], tf=1.0)
    blind = loop().simulate([-1.2, 0.3], tf=1.0)
    # held means of a ramp displace by less than dt^2 times its slope, twice
    assert run.states[:, -1] == pytest.approx([0.0, 0.0], abs=3e-4)
    assert blind.states[:, -1] == pytest.approx([0.1, 0.3], abs=1e-4)
    assert [r.time for r in run.replans] == pytest.approx(np.arange(0.1, 0.81, 0.1))
    assert [r.effective - r.time for r in run.replans] == pytest.approx([0.04] * 8)  # whole steps
    assert not any(r.failed for r in run.replans)
    assert all(r.way == "warm start" and r.solve_s > 0 and r.final_time == 1.0 for r in run.replans)


def test_what_is_flown_is_the_solution_from_the_new_start() -> None:
    """Cost from x0 at t0 in T = 1 - t0: 12 q^2/T^3 + 12 q v/T^2 + 4 v^2/T, by hand."""
    spy = Spy()
    run = loop(every(solver=lambda: spy)).simulate([-1.2, 0.3], tf=1.0)
    for (begin, (q, v)), replan in zip(spy.asked, run.replans, strict=True):
        left = 1.0 - begin
        cost = 12 * q**2 / left**3 + 12 * q * v / left**2 + 4 * v**2 / left
        assert replan.objective == pytest.approx(cost, rel=1e-7)
        # where the old plan leads to meanwhile is where the cart is then
        assert [q, v] == pytest.approx(run.states[:, round(begin / DT)], abs=1e-9)


def test_a_constant_push_acts_since_the_last_estimate_only() -> None:
    """After the last re-planning, begun 0.2 s before the end, a push of 0.3 m/s^2 leaves 0.006 m and 0.06 m/s."""
    run = loop(every(), disturbances=[ConstantDisturbance("push", 0.3, on="v")]).simulate([-1.0, 0.0], tf=1.0)
    last = run.replans[-1].time
    assert last == pytest.approx(0.8)
    left = 1.0 - last
    assert run.states[:, -1] == pytest.approx([0.15 * left**2, 0.3 * left], abs=3e-4)


def test_a_failed_plan_leaves_the_one_before() -> None:
    spy = Spy(fails_from=0.5)
    some = loop(every(solver=lambda: spy)).simulate([-1.2, 0.3], tf=1.0)
    failed = [r for r in some.replans if r.failed]
    assert [r.effective > 0.5 for r in some.replans] == [r.failed for r in some.replans]
    assert len(failed) == 4 and "not this time" in failed[0].failure and np.isnan(failed[0].final_time)
    assert "8, 4 of them failed" in str(some)
    # What was planned before leads there, too.
    assert some.states[:, -1] == pytest.approx([0.0, 0.0], abs=3e-4)
    none = loop(every(solver=lambda: Spy(fails_from=0.0))).simulate([-1.2, 0.3], tf=1.0)
    blind = loop().simulate([-1.2, 0.3], tf=1.0)
    assert np.array_equal(none.states, blind.states)
    assert np.array_equal(none.errors, blind.errors)  # type: ignore[arg-type]


def test_errors_are_relative_to_what_is_flown() -> None:
    run = loop(every()).simulate([-1.2, 0.3], tf=1.0)
    assert run.errors is not None and run.reference is not None
    after = round(run.replans[0].effective / DT)
    assert np.max(np.abs(run.errors[:, 0])) > 0.1
    assert run.errors[:, after] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert run.errors == pytest.approx(run.states - run.reference, abs=1e-12)


def test_no_new_one_while_one_is_made() -> None:
    run = loop(every(0.05, latency=0.12)).simulate([-1.0, 0.0], tf=1.0)
    begun = [r.time for r in run.replans]
    assert np.diff(begun) == pytest.approx(
        [0.15] * (len(begun) - 1)
    )  # the first multiple of 0.05 s after 0.12 s


def test_the_plan_is_made_from_what_is_measured() -> None:
    """The noisy sample of the controller at that step, not the true state and not another sample."""
    spy = Spy()
    noisy = loop(every(solver=lambda: spy, latency=0.0), sensors=[Noise("gauge", 0.01, on="q")])
    run = noisy.simulate([-1.0, 0.0], tf=1.0, seed=3)
    for begin, start in spy.asked:
        assert start == pytest.approx(run.measured[:, round(begin / DT)], abs=1e-15)
    assert np.abs(spy.asked[0][1][0] - run.state("q")(spy.asked[0][0])[0]) > 1e-4


def test_the_plan_is_made_from_what_is_estimated() -> None:
    spy = Spy()
    filter_ = design_ekf(plant(), [-1.0, 0.0], [Measurement("q", 0.01)], sigma0={"q": 0.1, "v": 0.1}, dt=DT)
    estimated = output_feedback(law(), filter_)
    run = loop(
        every(solver=lambda: spy, latency=0.0), controller=estimated, sensors=[Noise("gauge", 0.01, on="q")]
    ).simulate([-1.1, 0.1], tf=1.0)
    for begin, start in spy.asked:
        told = [run.controller_state(f"{name}_hat")(begin)[0] for name in ("q", "v")]
        assert start == pytest.approx(told, abs=1e-12)
    assert run.states[:, -1] == pytest.approx([0.0, 0.0], abs=0.05)


def test_a_measurement_that_is_lost_leaves_the_plan() -> None:
    lost = loop(every(), sensors=[Noise("gauge", float("inf"), on="q")])
    run = lost.simulate([-1.0, 0.0], tf=0.5)
    assert run.replans and all("not a number" in r.failure for r in run.replans)


@pytest.mark.slow
def test_in_a_campaign(tmp_path: Path) -> None:
    flown = monte_carlo(
        loop(every(), disturbances=[ConstantDisturbance("push", 0.3, on="v")]), 2, x0=[-1.0, 0.0], tf=1.0,
        dispersions={"initial.q": Uniform(-0.1, 0.1)}, limits={"failed replans": 0.0}, checkpoint=tmp_path,
    )  # fmt: skip
    assert np.array_equal(flown.replans, [[8.0] * 2, [0.0] * 2])
    assert flown.pass_rate("failed replans").rate == 1.0
    assert "replans" in flown.measures and flown.unit("replans") == ""
    again = flown.rerun(1)
    assert np.array_equal(again.states[:, -1], flown.states[:, 1])
    again.save(tmp_path / "run")
    loaded = Run.load(tmp_path / "run.npz")
    assert loaded.replans == again.replans


def two_phases() -> Any:
    class Two:
        solution = go.Solution.__new__(go.Solution)

    object.__setattr__(Two.solution, "phases", {"a": None, "b": None})
    return Two


@pytest.mark.parametrize(
    ("made", "what"),
    [
        (lambda: every(-0.1), "between two re-plannings is"),
        (lambda: every(last=-1.0), "last part without"),
        (lambda: every(latency=-1.0), "latency of a Replanner"),
        (lambda: every(follow=3), "follow of a Replanner is not a function"),
        (lambda: Replanner(resolver(), every=0.1), "write lambda"),  # type: ignore[arg-type]
        (lambda: Replanner(two_phases, every=0.1), "has 2 phases"),
        (lambda: loop(every(0.015)), "multiple of the control step"),
        (lambda: linear_covariance(go.Scenario(loop(every()), x0=[-1.0, 0.0], tf=1.0)), "re-plans in flight"),
        (lambda: loop(3), "replanner of a closed loop"),  # type: ignore[arg-type]
        (lambda: loop(every(), controller=feedforward(_another_way())), "does not follow the plan"),
        (
            lambda: loop(every(follow=lambda plan: lambda t, dt: np.zeros((2, t.size)))),
            r"shape \(2, 1\) at 1 times: the controller needs \(3, 1\)",
        ),
    ],
)
def test_refused(made: Any, what: str) -> None:
    with pytest.raises(go.ArgumentError, match=what):
        made()


def _another_way() -> Reference:
    return Reference.from_functions(plant(), lambda t: [-1.0 + t, 1.0], lambda t: [0.0], 0.0, 1.0)
