"""How many integration steps modes ask for: the method itself flies them."""

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.internals import MAX_SUBSTEPS, dormand_prince, steps_for_modes, steps_for_run


@pytest.mark.parametrize(
    ("modes", "length"), [([20j, -20j], 0.1), ([-30.0], 0.1), ([3.0], 0.5), ([-1 + 5j], 0.2)]
)
def test_steps_for_modes_are_those_that_an_integration_needs(modes, length):
    """As accurate as asked with as many steps, and not with half of them."""
    asked, x = 1e-9, ca.SX.sym("x", 2)
    n = steps_for_modes(np.array(modes), length, asked)
    a = np.array([[modes[0].real, -modes[0].imag], [modes[0].imag, modes[0].real]])
    truth = scipy.linalg.expm(a * length)

    def error(steps):
        flown = dormand_prince(lambda t, x, u: a @ x, 0.0, x, length, steps)
        found = ca.Function("flown", [x], [ca.jacobian(flown, x)])(0).full()
        return np.abs(found - truth).max() / max(1.0, np.linalg.norm(truth, 2))

    assert n > 1 and error(n) <= asked * 1.01 and error(n // 2) > asked


@pytest.mark.parametrize("mode", [4j, -0.3 + 4j, -2.0, -20.0])
def test_steps_for_a_run_keep_the_sum_of_its_errors(mode):
    """Of a mode of size 1 that is let go for 12 s: with as many steps in 0.5 s, and not with one less."""
    asked, length, duration, x = 1e-5, 0.5, 12.0, ca.SX.sym("x", 2)
    a = np.array([[mode.real, -mode.imag], [mode.imag, mode.real]])

    def error(steps):
        h = length / steps
        one = ca.Function("one", [x], [dormand_prince(lambda t, x, u: a @ x, 0.0, x, h)])
        state, total = np.array([1.0, 0.0]), 0.0
        for _ in range(round(duration / h)):
            after = np.ravel(one(state).full())
            total += np.linalg.norm(after - scipy.linalg.expm(a * h) @ state)
            state = scipy.linalg.expm(a * h) @ state
        return total

    n = steps_for_run(np.array([mode]), length, duration, asked)
    assert 1 < n < MAX_SUBSTEPS
    assert error(n) <= asked * 1.001 < error(n - 1)
    assert steps_for_run(np.array([mode]), length, duration, 1e-30) == 1
