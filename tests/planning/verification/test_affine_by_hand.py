"""Figures of trajectories given by hand, with switches or smooth, in two phases that do not begin at zero, are shares.

Neither trajectory obeys anything: every condition has something to tell. In other units, mirrored, from other origins
and later, it tells the same of the same places.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from testing import constructed_solutions as by_hand

import gnc_opt as go
from gnc_opt.planning.verification.recomputed import from_problem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Units:
    """How many of the new units one old unit is, for q, v, a, b, time and cost; and where the old origins are."""

    unit: tuple[float, ...] = (1.0,) * 6
    origin: tuple[float, ...] = (0.0,) * 6

    def new(self, i: int, old: Any) -> Any:
        return (old + self.origin[i]) * self.unit[i]

    def old(self, i: int, new: Any) -> Any:
        return new / self.unit[i] - self.origin[i]

    def range(self, i: int, low: float, high: float) -> tuple[float, float]:
        ends = sorted((self.new(i, low), self.new(i, high)))
        return ends[0], ends[1]


Q, V, A, B, T, COST = range(6)
OTHERS = {
    "mixed": Units((50.0, 0.04, 0.2, 30.0, 1.0, 1.0)),
    "elsewhere": Units(origin=(0.0, 0.0, 0.0, 0.0, 70.0, 9.0)),
    "all": Units((-3.0, 0.2, 7.0, -0.5, 0.1, 8.0), (3.0, -7.0, 2.0, 5.0, -40.0, -200.0)),
}


def problem_in(units: Units, smooth: bool) -> go.Problem:
    """q' = v + b / 5, v' = a - sin(q) / 10 + t / 20; linked phases, one of which is limited along the way."""
    model = go.Model("cart")
    states, inputs = (model.state("q"), model.state("v")), (model.control("a"), model.control("b"))
    q, v, a, b = (units.old(i, s) for i, s in enumerate((*states, *inputs)))
    t = units.old(T, model.time)
    rates = v + b / 5, a - ca.sin(q) / 10 + t / 20
    speed = [units.unit[i] / units.unit[T] for i in (Q, V)]
    model.ode({state: rate * s for state, rate, s in zip(states, rates, speed, strict=True)})
    problem = go.Problem("by hand")
    first, second = problem.phase("first", model), problem.phase("second", model)
    first.time(units.new(T, 0.3), units.range(T, 1.0, 2.0))
    second.time(units.range(T, 1.0, 2.0), units.range(T, 2.0, 5.0))
    costs = []
    for leg in (first, second):
        leg.bounds(a=units.range(A, -1.0, 1.0), b=units.range(B, 0.0, 3.0), v=units.range(V, -0.5, 1.2))
        leg.path("sum", q + v / 2, upper=1.9)
        running = (a**2 + b**2 / 7 if smooth else 0.1 * a + b / 5) + q**2 / 3
        costs.append(leg.integral(running * units.unit[COST] / units.unit[T]))
    first.initial(q=units.new(Q, 0.1))
    second.final(v=units.range(V, -0.1, 0.2))
    meeting = [
        units.old(i, second.initial_state(n)) - units.old(i, first.final_state(n)) for i, n in enumerate("qv")
    ]
    problem.constrain("meet", ca.vertcat(*meeting), equals=np.zeros(2))
    problem.constrain(
        "one after the other", (second.initial_time - first.final_time) / units.unit[T], equals=0.0
    )
    far = units.old(Q, second.final_state("q"))
    problem.constrain("far", far**2, lower=1.0, upper=9.0)
    price = 0.7 * units.old(T, second.final_time) + (far - 1.0) ** 2 + units.origin[COST]
    problem.minimize(costs[0] + costs[1] + price * units.unit[COST])
    return problem


Signal = Callable[[Array, int], Any]
BREAKS = {"first": (0.3, 0.6, 1.3), "second": (1.3, 1.7, 2.2, 3.0)}

SIGNALS: dict[bool, dict[str, tuple[Signal, Signal, Signal]]] = {
    False: {
        "first": (
            lambda t, k: np.array([0.1 + 0.5 * t, 0.3 + 0.1 * t**2]),
            lambda t, k: np.array([[1.0, -1.0][k] + 0 * t, [0.0, 3.0][k] + 0 * t]),
            lambda t, k: np.array([-0.4 + 0.1 * t, t - 0.7]),
        ),
        "second": (
            lambda t, k: np.array([0.2 + 0.45 * t, 0.4 + 0.2 * t - 0.06 * t**2]),
            lambda t, k: np.array([[-1.0, 1.0, 1.0][k] + 0 * t, [3.0, 3.0, 0.0][k] + 0 * t]),
            lambda t, k: np.array([-3.1 + t, 1.6 - t]),
        ),
    },
    True: {
        "first": (
            lambda t, k: np.array([0.1 + 0.5 * (t - 0.3), 0.5 + 0.3 * np.sin(t)]),
            lambda t, k: np.array([0.5 - 0.3 * t, 1.0 + t / 3]),
            lambda t, k: np.array([-1.1 + 0.1 * t, -1.0 + 0.6 * t + 0.05 * k]),
        ),
        "second": (
            lambda t, k: np.array(
                [0.1 + 0.5 * (t - 0.3), [0.9 + 0.75 * (t - 1.3), 1.2 + 0 * t, 1.2 - (t - 2.2) ** 2][k]]
            ),
            lambda t, k: np.array([0.4 - 0.2 * t, 1.2 + 0.1 * t]),
            lambda t, k: np.array([-1.3 + 0.2 * t, -0.8 + 0.3 * t - 0.1 * k]),
        ),
    },
}  # fmt: skip


def solution_in(units: Units, smooth: bool) -> go.Solution:
    """The trajectory in other units; multipliers push at the limit of v in the second phase."""
    problem = problem_in(units, smooth)
    legs = [leg_in(units, problem, name, smooth) for name in BREAKS]
    constraints = np.array([0.2, -0.1, 0.3, 0.001])
    bare = by_hand.solution(
        problem, *legs, objective=units.unit[COST] * (4.0 + units.origin[COST]),
        constraint_labels=problem.constraint_labels(), constraint_values=np.zeros(4),
        constraint_multipliers=units.unit[COST] * constraints,
    )  # fmt: skip
    return from_problem(bare)


def leg_in(units: Units, problem: go.Problem, name: str, smooth: bool) -> Any:
    cost, time = units.unit[COST], units.unit[T]
    x, u, lam = SIGNALS[smooth][name]
    state = np.array(units.unit[:2])[:, None]

    def of(signal: Signal, unit: Any, origin: Any) -> Signal:
        return lambda t, k: (signal(units.old(T, t), k) + np.array(origin)[:, None]) * np.array(unit)[:, None]

    pushes = np.array([0.0, 0.6])[:, None] * (cost / time / state)

    def pushing(t: Array, k: int) -> Array:
        return pushes * (smooth and name == "second" and k == 1) + 0 * t

    edges = tuple(units.new(T, t) for t in BREAKS[name])
    single = go.Problem("one")  # `by_hand.phase` reads a problem of one phase
    leg = problem.phases[name]
    single.phases[name] = leg
    values = by_hand.phase(
        single,
        of(x, units.unit[:2], units.origin[:2]),
        of(u, units.unit[2:4], units.origin[2:4]),
        of(lam, cost / np.array(units.unit[:2]), (0.0, 0.0)),
        breaks=edges, states=pushing, paths=lambda t, k: np.array([smooth * 0.01 * cost / time + 0 * t]),
    )  # fmt: skip
    inner = np.zeros_like(values.state_impulses)
    inner[:, 1] = 0.02 * cost / np.array(units.unit[:2])
    points = values.point_times.size
    return replace(
        values,
        state_impulses=inner,
        control_multipliers=np.full((2, points), 0.03) * cost / time / np.array(units.unit[2:4])[:, None],
        duration_multiplier=0.04 * cost / time,
    )


@cache
def usual(smooth: bool) -> go.Verdict:
    return go.verify(solution_in(Units(), smooth))


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("units", OTHERS.values(), ids=OTHERS)
def test_figures_of_a_trajectory_in_other_units(units: Units, smooth: bool) -> None:
    other = go.verify(solution_in(units, smooth))
    for condition in usual(smooth).conditions:
        twin = other[condition.name]
        assert twin.result is condition.result, condition.name
        if (
            condition.name != "second order" or not smooth
        ):  # whose sign counts: its variations are shares of sizes
            same = pytest.approx(condition.value, rel=1e-6, abs=1e-9, nan_ok=True)
            assert twin.value == same, (condition, twin)


@pytest.mark.parametrize("smooth", [False, True])
def test_every_condition_has_something_to_tell(smooth: bool) -> None:
    silent = {c.name for c in usual(smooth).conditions if not abs(c.value) > 1e-6}
    never = {"limits", "cost", "kinks", "second order", "switching times"}
    assert silent <= never | ({"active set"} if smooth else {"stationarity", "second order"})
