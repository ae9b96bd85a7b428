"""The work of a refinement: counted in iterations, bounded, and the best answer when it is spent."""

from __future__ import annotations

import math
import sys
import time
from functools import cache
from typing import Any

import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import Mesh, Status
from gnc_opt.planning.direct.computation_budget import WORK_PER_SECOND, WorkBudget
from gnc_opt.planning.direct.fixed_mesh_solve import solve_problem_on_mesh
from gnc_opt.planning.refinement.best_solution_selection import CANDIDATE_ERROR_MARGIN
from gnc_opt.planning.refinement.hp_refinement import refine_mesh
from gnc_opt.planning.refinement.staged_refinement import StagedRefinement
from problems.classics import double_oscillator, van_der_pol

# What refining costs where programs do not converge: counted in iterations at one point, the same on every
# machine.


CRAWLING = go.SolverOptions(
    mu_init=1e-2,
    extra={
        "ipopt.mu_linear_decrease_factor": 0.99,
        "ipopt.mu_superlinear_decrease_power": 1.001,
        "ipopt.mu_allow_fast_monotone_decrease": "no",
    },
)
"""The barrier falls by a hundredth per iteration: no program converges in less than a thousand."""

UNREACHABLE = go.SolverOptions(tolerance=1e-30, extra={"ipopt.acceptable_iter": 0})
"""A tolerance below rounding: every try fails, and others follow it."""


@pytest.fixture(scope="module")
def cart() -> go.Solution:
    """Rest to rest in 1 s with the least effort and a limit that binds at both ends, from a coarse mesh."""
    model, _x, _v, u = dynamics("cart", "x v", "u", lambda x, v, u: {x: v, v: u})
    problem, leg = one_phase("cart", model, 0.0, 1.0)
    leg.bounds(u=(-5.0, 5.0), x=(-1.0, 2.0), v=(-1.0, 3.0))
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    problem.minimize(leg.integral(u**2))
    return go.solve(problem, mesh="7x3", tol=None)


@pytest.mark.parametrize("allowed", [2500.0, 6000.0])
def test_programs_that_do_not_converge_cost_no_more_than_what_is_allowed(
    cart: go.Solution, allowed: float
) -> None:
    budget = WorkBudget(3 * allowed / WORK_PER_SECOND)  # two states and a control
    _, history = refine_mesh(cart, tol=1e-10, budget=budget, options=CRAWLING)
    tried = [p for p in history.passes if not p.solved]
    assert tried and not history.converged
    # A solve is charged for as many iterations as its derivatives take, and makes one at least.
    assert abs(sum(p.work for p in tried) - allowed) <= 16 * max(p.n_points for p in tried)


@pytest.mark.parametrize("most", [3, 8])
def test_all_tries_of_a_solve_share_its_iterations(cart: go.Solution, most: int) -> None:
    """Warm, with care, and cold."""
    found = solve_problem_on_mesh(
        cart.need_problem("refine"),
        guess=cart,
        options=UNREACHABLE,
        budget=WorkBudget(max_iterations=most, warm_iterations=150),
    )
    assert found.status is Status.ITERATION_LIMIT and found.statistics.iterations == most


def test_a_solve_may_cost_what_is_left_and_makes_one_iteration_at_least(cart: go.Solution) -> None:
    problem, meshes = cart.need_problem("solve"), {"leg": Mesh.uniform(10, 4)}
    budget = WorkBudget(12000.0 / WORK_PER_SECOND)
    for spent, iterations in ((0.0, 100 - 15), (6000.0, 50 - 15), (5900.0, 1)):  # 40 points of 3 variables
        budget.record_work(spent / WORK_PER_SECOND)
        assert budget.count_remaining_iterations(problem, meshes) == iterations
    assert budget.remaining_work == pytest.approx(100.0 / WORK_PER_SECOND)
    assert WorkBudget().count_remaining_iterations(problem, meshes) is None
    assert WorkBudget(cpu_deadline=time.thread_time()).remaining_work == 0.0


def test_work_of_a_share_counts_in_the_whole() -> None:
    whole = WorkBudget(8.0, spent=1.0)
    part = whole.allot_work_budget_share(0.25)
    part.record_work(0.5)
    assert (part.total, part.remaining_work, whole.spent) == (2.0, 1.5, 1.5)
    assert whole.allot_work_budget_share(1.0).total == 6.5


@pytest.mark.parametrize("lost", [300, 3])
def test_a_start_from_lines_and_what_follows_it_take_no_more_iterations_either(
    cart: go.Solution, lost: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for limit in ("WARM_MAX_ITERATIONS", "TRY_MAX_ITERATIONS"):
        monkeypatch.setattr(sys.modules[solve_problem_on_mesh.__module__], limit, lost)
    problem = cart.need_problem("solve")
    found = solve_problem_on_mesh(problem, "7x3", options=CRAWLING, budget=WorkBudget(max_iterations=12))
    tries = 9  # from lines, with the other barrier, from a simulation, from five points, from lines
    assert found.status is Status.ITERATION_LIMIT
    assert 12 <= found.statistics.iterations <= 12 + tries


@pytest.fixture(scope="module")
def corner_turn() -> go.Solution:
    """Half a turn in least time, the load factor limited by structure and by lift: held where both limits meet.

    There the costate of the speed is no multiplier of either limit alone, which no order of arcs shows.
    """
    model = go.Model("aircraft")
    v, course = model.state("v"), model.state("course")
    load, throttle = model.control("load"), model.control("throttle")
    model.ode({v: 12 * throttle - 2 - 1e-4 * v**2 - 40 * load**2 / v, course: 9.81 * load / v})
    problem, leg = one_phase("turn", model, initial=0.0, final=(2.0, 80.0), name="turn")
    leg.initial(v=250.0, course=0.0)
    leg.final(course=np.pi)
    leg.bounds(load=(0.0, 5.0), throttle=(0.0, 1.0), v=(60.0, 400.0))
    leg.path("lift", load - (v / 95) ** 2, upper=0.0)
    problem.minimize(leg.final_time)
    return go.solve(problem, tol=None)


@pytest.mark.parametrize("seconds", [0.05])
def test_all_solves_share_one_budget(corner_turn: go.Solution, seconds: float) -> None:
    """No solve begins after it is spent, and the answer is the one with the least estimated error or loss."""
    refined = go.refine(corner_turn, tol=1e-12, limits=go.RefinementLimits(max_work=seconds))
    assert refined.history is not None and refined.history.status is go.RefinementStatus.BUDGET_LIMIT
    variables = 4
    spent = [p.work * variables / WORK_PER_SECOND for p in refined.history.passes]
    assert sum(spent[:-1]) <= 2.0 * seconds + max(spent)
    assert refined.objective_error.absolute_error <= corner_turn.objective_error.absolute_error


# The budget: no solve goes on when it is spent, and the answer is then the best of what was found.


OSCILLATOR = double_oscillator.REFERENCE.value
OSCILLATOR_WORK = 0.53
"""Objective, and what its search costs, s of the reference processor."""


@cache
def first_solve() -> go.Solution:
    return go.solve(van_der_pol.build(), tol=None)


def test_no_iteration_begins_after_the_cpu_time() -> None:
    now = time.thread_time()
    stopped = solve_problem_on_mesh(van_der_pol.build(), "20x4", budget=WorkBudget(cpu_deadline=now))
    assert stopped.status is Status.ITERATION_LIMIT and stopped.statistics.iterations <= 1
    later = WorkBudget(cpu_deadline=now + 100.0)
    assert solve_problem_on_mesh(van_der_pol.build(), "20x4", budget=later).status.solved


def test_work_is_counted_in_iterations_of_variables_at_points() -> None:
    first = first_solve()
    budget = WorkBudget(1.0)
    budget.record_solve_work(first)
    variables = 3 * first.phase().mesh.size
    work = variables * (first.statistics.iterations + 15) / WORK_PER_SECOND
    assert budget.remaining_work == pytest.approx(1.0 - work)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.25])
def test_an_answer_that_is_stopped_is_no_worse_than_one_before(
    share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[tuple[float, float]] = []
    real: Any = StagedRefinement._record_candidate_solution

    def noted(self: StagedRefinement, candidate: Any) -> None:
        real(self, candidate)
        found.append((self.budget.spent, candidate.minimised_cost if candidate.is_solved else math.inf))

    monkeypatch.setattr(StagedRefinement, "_record_candidate_solution", noted)
    limit = share * OSCILLATOR_WORK
    stopped = go.solve(double_oscillator.build(), limits=go.RefinementLimits(max_work=limit))
    # A solve that begins within the limit has the fixed cost of 15 iterations, at 600 points at most, besides.
    leg = stopped.phase()
    fixed = 16 * 600 * (leg.states.size + leg.controls.size) / WORK_PER_SECOND
    assert found[-1][0] <= limit + fixed
    errors = [abs(cost - OSCILLATOR) for _, cost in found]
    assert abs(stopped.objective - OSCILLATOR) <= CANDIDATE_ERROR_MARGIN * min(errors) + 1e-6 * OSCILLATOR
