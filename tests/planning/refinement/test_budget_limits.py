"""The budget: no solve goes on when it is spent, and the answer is then the best of what was found."""

from __future__ import annotations

import math
import time
from functools import cache
from typing import Any

import pytest

import gnc_opt as go
from gnc_opt.planning.direct.solve_mesh import SolveLimits, solve_mesh
from gnc_opt.planning.nlp import Status
from gnc_opt.planning.refinement.budget import WORK_PER_SECOND, WorkBudget, variables_per_point
from gnc_opt.planning.refinement.candidates import CANDIDATE_ERROR_MARGIN
from gnc_opt.planning.refinement.iterations import PassLimits
from gnc_opt.planning.refinement.stages import Stages
from gnc_opt.planning.solution.history import work_of
from problems.classics import double_oscillator, van_der_pol

OSCILLATOR = double_oscillator.REFERENCE.value
OSCILLATOR_WORK = 1.05
"""Objective, and what its search costs, s of the reference processor."""


@cache
def first_solve() -> go.Solution:
    return go.solve(van_der_pol.build(), tol=None)


def test_no_iteration_begins_after_the_cpu_time() -> None:
    now = time.thread_time()
    stopped = solve_mesh(van_der_pol.build(), "20x4", limits=SolveLimits(cpu_deadline=now))
    assert stopped.status is Status.ITERATION_LIMIT and stopped.statistics.iterations <= 1
    later = SolveLimits(cpu_deadline=now + 100.0)
    assert solve_mesh(van_der_pol.build(), "20x4", limits=later).status.solved


def test_passes_end_with_the_budget_whatever_they_promise() -> None:
    """A share may be exceeded where a pass is promising, the whole budget never."""
    mesh = first_solve().phase().mesh
    limits = PassLimits(work=4000.0, most=4800.0)
    assert limits.of_solve([mesh]).iterations == math.ceil(4000.0 / mesh.size) - 15
    assert limits.of_solve([mesh], spent=4700.0).iterations == 1
    assert limits.are_spent((), 4800.0, 4.0) and not limits.are_spent((), 4799.0, 4.0)
    assert PassLimits(cpu_deadline=time.thread_time()).are_spent((), 0.0)


def test_work_is_counted_in_iterations_of_variables_at_points() -> None:
    first = first_solve()
    budget = WorkBudget(1.0)
    budget.charge(first)
    work = work_of(first.phase().mesh.size, first.statistics.iterations) * variables_per_point(first.phases)
    assert budget.left == pytest.approx(1.0 - work / WORK_PER_SECOND)
    assert budget.iterations_left(first, 10**9) == 1
    assert WorkBudget(math.inf).iterations_left(first, 100) is None


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_an_answer_that_is_stopped_is_no_worse_than_one_before(
    share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[tuple[float, float]] = []
    real: Any = Stages._add

    def noted(self: Stages, candidate: Any) -> None:
        real(self, candidate)
        found.append((self.budget.spent, candidate.cost if candidate.solved else math.inf))

    monkeypatch.setattr(Stages, "_add", noted)
    limit = share * OSCILLATOR_WORK
    stopped = go.solve(double_oscillator.build(), limits=go.RefinementLimits(max_work=limit))
    # A solve that fits into the rest has the fixed cost of 15 iterations, at 180 points, besides.
    fixed = 15 * 180 * variables_per_point(stopped.phases) / WORK_PER_SECOND
    assert found[-1][0] <= limit + fixed
    errors = [abs(cost - OSCILLATOR) for _, cost in found]
    assert abs(stopped.objective - OSCILLATOR) <= CANDIDATE_ERROR_MARGIN * min(errors) + 1e-6 * OSCILLATOR
