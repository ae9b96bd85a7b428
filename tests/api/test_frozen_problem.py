"""A solution keeps the problem that was solved: what the user does to his own afterwards changes no answer."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go


def rest_to_rest() -> tuple[go.Problem, go.Phase]:
    cart, *_ = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("rest to rest", cart, initial=0.0, final=(0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    return problem, leg


def test_other_bounds_afterwards_leave_the_solution_alone() -> None:
    """With |a| <= 1 the minimum time is 2, with |a| <= 2 it would be sqrt(2)."""
    problem, leg = rest_to_rest()
    solution = go.solve(problem, tol=None)
    leg.bounds(a=(-2.0, 2.0))
    assert go.refine(solution).objective == pytest.approx(2.0, abs=1e-9)
    assert go.multistart(solution.problem, n=2, executor="serial").best.objective == pytest.approx(
        2.0, abs=1e-8
    )
    assert go.solve(problem, guess=solution).objective == pytest.approx(2**0.5, abs=1e-3)


def test_other_end_values_afterwards_leave_verdict_and_reference_alone() -> None:
    problem, leg = rest_to_rest()
    solution = go.refine(go.solve(problem, tol=None))
    leg.final(q=0.5)
    problem.parameter("late")
    assert go.verify(solution).ok
    # dt_f/dq0 = 1/sqrt(q0)
    assert go.sensitivity(solution, initial="q").objective == pytest.approx(1.0, abs=1e-6)
    assert go.Reference(solution).final_time == pytest.approx(2.0, abs=1e-9)


def test_a_loaded_solution_keeps_its_own_problem_too(tmp_path) -> None:  # type: ignore[no-untyped-def]
    problem, leg = rest_to_rest()
    path = go.solve(problem, tol=None).save(tmp_path / "plan.npz")
    loaded = go.load(path, problem=problem)
    leg.bounds(a=(-2.0, 2.0))
    assert go.refine(loaded).objective == pytest.approx(2.0, abs=1e-9)


CHANGES: dict[str, Callable[[go.Problem], object]] = {
    "bounds": lambda p: p.get_phase().bounds(a=(-2.0, 2.0)),
    "initial": lambda p: p.get_phase().initial(q=2.0), "final": lambda p: p.get_phase().final(q=2.0),
    "time": lambda p: p.get_phase().time(final=3.0), "guess": lambda p: p.get_phase().guess(q=0.0),
    "scale": lambda p: p.get_phase().scale(q=2.0), "hold": lambda p: p.get_phase().hold([[1] * 20]),
    "path": lambda p: p.get_phase().path("limit", p.get_phase().model.symbol("v"), upper=1.0),
    "integral": lambda p: p.get_phase().integral(p.get_phase().model.symbol("v")),
    "phase": lambda p: p.phase("other", p.get_phase().model), "parameter": lambda p: p.parameter("k"),
    "constrain": lambda p: p.constrain("late", p.get_phase().final_time, lower=1.0),
    "minimize": lambda p: p.minimize(p.get_phase().final_time),
    "link": lambda p: p.link("leg", "leg", time=False),
}  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_the_problem_of_a_solution_refuses_every_declaration(change: str) -> None:
    solution = go.solve(rest_to_rest()[0], tol=None)
    assert solution.problem is not None
    before = solution.problem.fingerprint()
    with pytest.raises(go.ProblemError, match="cannot be changed: create a variation"):
        CHANGES[change](solution.problem)
    assert solution.problem.fingerprint() == before


def test_variations_of_the_problem_of_a_solution_are_open_again() -> None:
    solution = go.solve(rest_to_rest()[0], tol=None)
    assert solution.problem is not None
    varied = solution.problem.with_bounds(a=(-2.0, 2.0))
    varied.get_phase().final(q=0.5)
    # 2 sqrt(0.5 / 2).
    assert go.solve(varied, tol=1e-8, check=False).objective == pytest.approx(1.0, abs=1e-8)
