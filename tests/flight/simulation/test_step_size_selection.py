"""How many integration steps modes ask for: the method itself flies them."""

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.internals import MAX_SUBSTEPS, count_steps_for_accuracy, integrate_dormand_prince


@pytest.mark.parametrize("mode", [4j, -0.3 + 4j, -2.0, -20.0])
def test_steps_for_a_run_keep_the_sum_of_its_errors(mode):
    """Of a mode of size 1 that is let go for 12 s: with as many steps in 0.5 s, and not with one less."""
    asked, length, duration, x = 1e-5, 0.5, 12.0, ca.SX.sym("x", 2)
    a = np.array([[mode.real, -mode.imag], [mode.imag, mode.real]])

    def error(steps):
        h = length / steps
        one = ca.Function("one", [x], [integrate_dormand_prince(lambda t, x, u: a @ x, 0.0, x, h)])
        state, total = np.array([1.0, 0.0]), 0.0
        for _ in range(round(duration / h)):
            after = np.ravel(one(state).full())
            total += np.linalg.norm(after - scipy.linalg.expm(a * h) @ state)
            state = scipy.linalg.expm(a * h) @ state
        return total

    n = count_steps_for_accuracy(np.array([mode]), length, duration, asked)
    assert 1 < n < MAX_SUBSTEPS
    assert error(n) <= asked * 1.001 < error(n - 1)
    assert count_steps_for_accuracy(np.array([mode]), length, duration, 1e-30) >= n  # for 1e-6
