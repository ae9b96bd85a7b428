"""A solution whose refinement does not come to rest is compared with one from another way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.planning import RefinementStatus, SolverOptions
from gnc_opt.planning.direct.second_solve import STRATEGY
from gnc_opt.planning.solver import better_of_two

TILT, EFFORT = 0.3, 0.01
COMMON: dict[str, Any] = {"mesh": "3x3", "scheme": "LG"}


def two_wells(start: float, sign: float = 1.0) -> go.Problem:
    """min (e^2 - 1)^2 + TILT e + EFFORT int u^2 for x' = u, x(0) = 0, x(1) = e: a minimum on either side."""
    model = go.Model("drift")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("two wells")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=1.0)
    leg.initial(x=0.0)
    leg.guess(x=(0.0, start), u=start)
    end = leg.final_state("x")
    cost = (end**2 - 1) ** 2 + TILT * end + EFFORT * leg.integral(u**2)
    (problem.minimize if sign > 0 else problem.maximize)(sign * cost)
    return problem


def well(side: float) -> float:
    """The least cost on one side: u = e is constant, 4 e^3 - 4 e + 2 EFFORT e + TILT = 0."""
    roots = np.roots([4.0, 0.0, 2 * EFFORT - 4.0, TILT]).real
    e = roots[np.argmin(np.abs(roots - side))]
    return float((e**2 - 1) ** 2 + TILT * e + EFFORT * e**2)


def refiner(status: RefinementStatus) -> Callable[[go.Solution], go.Solution]:
    """Return a refinement that ends with the given status."""

    def refine(solution: go.Solution) -> go.Solution:
        refined = go.refine(solution, structure="none")
        assert refined.history is not None
        return replace(refined, history=replace(refined.history, status=status))

    return refine


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_better_minimum_is_kept(sign: float) -> None:
    """The first answer is in the shallow well and does not come to rest, the second opinion starts in the deep one."""
    shallow = go.solve(two_wells(1.0, sign), tol=None, **COMMON)
    assert sign * shallow.objective == pytest.approx(well(1.0), rel=1e-8)
    restless = refiner(RefinementStatus.STALLED)(shallow)
    kept = better_of_two(two_wells(-1.0, sign), shallow, restless, go.refine, go.SolverOptions(), **COMMON)
    assert kept.converged and sign * kept.objective == pytest.approx(well(-1.0), rel=1e-8)


def test_a_worse_minimum_is_not_even_refined() -> None:
    deep = go.solve(two_wells(-1.0), tol=None, **COMMON)
    restless = refiner(RefinementStatus.STALLED)(deep)

    def refuse(_: go.Solution) -> go.Solution:
        raise AssertionError("refined for nothing")

    assert better_of_two(two_wells(1.0), deep, restless, refuse, go.SolverOptions(), **COMMON) is restless


def test_a_better_but_less_accurate_answer_is_refused() -> None:
    shallow = go.solve(two_wells(1.0), tol=None, **COMMON)
    restless = refiner(RefinementStatus.STALLED)(shallow)

    def spoil(solution: go.Solution) -> go.Solution:
        spoiled = refiner(RefinementStatus.STALLED)(solution)
        history = spoiled.history
        assert history is not None
        passes = tuple(replace(p, error=1.0) for p in history.passes)
        return replace(spoiled, history=replace(history, passes=passes))

    assert better_of_two(two_wells(-1.0), shallow, restless, spoil, go.SolverOptions(), **COMMON) is restless


@pytest.mark.parametrize(
    "options",
    [
        SolverOptions(extra={STRATEGY: "monotone"}),
        SolverOptions(extra={"ipopt": {"mu_strategy": "adaptive"}}),
        SolverOptions(solver="sqpmethod"),
    ],
)
def test_a_strategy_that_the_user_chose_is_left_alone(options: SolverOptions) -> None:
    shallow = go.solve(two_wells(1.0), tol=None, **COMMON)
    restless = refiner(RefinementStatus.STALLED)(shallow)
    assert better_of_two(two_wells(-1.0), shallow, restless, go.refine, options, **COMMON) is restless


def test_solve_asks_only_when_refinement_does_not_come_to_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib

    module = importlib.import_module("gnc_opt.planning.solver")
    asked: list[bool] = []

    def note(problem: object, first: object, refined: go.Solution, *_: object) -> go.Solution:
        asked.append(refined.converged)
        return refined

    monkeypatch.setattr(module, "better_of_two", note)
    assert go.solve(two_wells(1.0), tol=1e-8).converged and not asked
    real = module.refine
    monkeypatch.setattr(
        module,
        "refine",
        lambda s, **_: (lambda r: replace(r, history=replace(r.history, status=RefinementStatus.STALLED)))(
            real(s)
        ),
    )
    go.solve(two_wells(1.0), tol=1e-8)
    assert asked == [False]
    go.solve(two_wells(1.0), tol=1e-8, guess=go.solve(two_wells(-1.0), tol=None))
    assert asked == [False], "a given solution is the user's choice of a minimum"
