"""Linear algebra in one thread while gnc_opt computes, and in as many as before afterwards."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from testing.models import dynamics, one_phase
from threadpoolctl import threadpool_info, threadpool_limits

import gnc_opt as go
from gnc_opt.threads_and_package_versions import limit_to_one_thread


def counts() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_one_inside_and_as_many_as_before_outside() -> None:
    with threadpool_limits(2, user_api="blas"):
        with limit_to_one_thread():
            assert counts() == {1}
        assert counts() == {2}
        with pytest.raises(ZeroDivisionError), limit_to_one_thread():
            _ = 1 / 0
        assert counts() == {2}


def test_a_problem_is_solved_and_checked_in_one(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[set[int]] = []
    expm = scipy.linalg.expm

    def seen_expm(matrix: np.ndarray) -> np.ndarray:
        seen.append(counts())
        return expm(matrix)

    monkeypatch.setattr(scipy.linalg, "expm", seen_expm)
    cart, _q, _v, a = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v, v: a})
    ocp, leg = one_phase("rest to rest with least effort", cart, initial=0.0, final=1.0)
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    ocp.minimize(leg.integral(0.5 * a**2))
    with threadpool_limits(2, user_api="blas"):
        solution = go.solve(ocp)
        assert solution.objective == pytest.approx(6.0, rel=1e-9)
        assert counts() == {2}
    assert seen and all(each == {1} for each in seen)
