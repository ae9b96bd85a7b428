"""Errors travel between processes."""

from __future__ import annotations

import pickle
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go


def impossible() -> go.Problem:
    """Rest to rest over 1 m within 1 s, half of what the acceleration allows."""
    model, _q, _v, a = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("too little time", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.integral(a**2))
    return problem


def fail() -> None:
    go.solve(impossible(), mesh="4x3", tol=None)


def test_a_failed_solve_arrives_with_its_last_iterate() -> None:
    """What a process raises is pickled; symbols cannot be, so the iterate comes without its problem."""
    with pytest.raises(go.SolveError) as at_home:
        fail()
    with ProcessPoolExecutor(1) as pool, pytest.raises(go.SolveError) as arrived:
        pool.submit(fail).result(timeout=60)
    assert str(arrived.value) == str(at_home.value)
    iterate, original = arrived.value.solution, at_home.value.solution
    assert iterate.problem is None and original.problem is not None
    assert iterate.status is original.status
    assert iterate.violations == original.violations
    times = np.linspace(0.0, 1.0, 7)
    assert np.array_equal(iterate.state("q")(times), original.state("q")(times))
    joined = iterate.with_problem(impossible())
    np.testing.assert_allclose(joined.hamiltonian(times), original.hamiltonian(times), rtol=1e-14)


@pytest.mark.parametrize("kind", [go.GncOptError, go.ModelError, go.ProblemError, go.UnknownNameError])
def test_other_errors_arrive_as_they_are(kind: type[go.GncOptError]) -> None:
    arrived = pickle.loads(pickle.dumps(kind("state 'x' is missing.")))
    assert type(arrived) is kind
    assert str(arrived) == "state 'x' is missing."
