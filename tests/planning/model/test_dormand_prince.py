"""Runge-Kutta steps in one call: their order, SciPy's own steps, and stiffness."""

import casadi as ca
import numpy as np
import scipy

from gnc_opt.model.evaluation import fast_call
from gnc_opt.model.integration import STAGES, Budget, Tolerance, carried, step_function

PLACES = scipy.integrate.DOP853.C[1:STAGES]


def rates(expression: ca.SX, t: ca.SX, x: ca.SX, u: ca.SX) -> ca.Function:
    return ca.Function("rates", [t, x, u], [ca.densify(expression)])


def pendulum() -> ca.Function:
    """theta'' = -sin(theta) + u cos(t)."""
    t, x, u = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("u")
    return rates(ca.vertcat(x[1], -ca.sin(x[0]) + u * ca.cos(t)), t, x, u)


def control(times: np.ndarray) -> np.ndarray:
    return (0.3 + times - 0.2 * times**2)[None, :]


def test_a_step_is_scipys_and_of_order_eight() -> None:
    f = pendulum()
    rate = fast_call(f)
    step = fast_call(step_function(f))

    def right(t: float, x: np.ndarray) -> np.ndarray:
        return rate(t, x, control(np.array([t]))[:, 0])

    def stepped(t: float, h: float, x: np.ndarray) -> np.ndarray:
        return step(t, h, x, right(t, x), control(t + h * PLACES).ravel("F")).reshape(4, -1)

    start = np.array([0.4, -0.1])
    theirs = scipy.integrate.DOP853(right, 0.2, start, 5.0, rtol=1e-6, first_step=0.5)
    theirs.step()
    new, slope, *_ = stepped(0.2, theirs.t - 0.2, start)
    np.testing.assert_allclose(new, theirs.y, rtol=0, atol=1e-15)
    np.testing.assert_allclose(slope, right(theirs.t, theirs.y), rtol=0, atol=1e-14)

    exact = scipy.integrate.solve_ivp(right, (0.0, 4.0), start, method="DOP853", rtol=1e-13, atol=1e-15).y[
        :, -1
    ]
    misses = []
    for count in (4, 8):
        x = start
        for k in range(count):
            x = stepped(4.0 * k / count, 4.0 / count, x)[0]
        misses.append(np.max(np.abs(x - exact)))
    assert 7.0 < np.log2(misses[0] / misses[1]) < 10.0


def test_steps_keep_their_tolerance_and_are_as_many_as_scipys() -> None:
    """x' = -300 (x - cos t) - sin t: stiff enough for stability to set the step; x = cos t."""
    t, x, u = ca.SX.sym("t"), ca.SX.sym("x"), ca.SX.sym("u")
    f = rates(-300 * (x - ca.cos(t)) - ca.sin(t), t, x, u)
    rate, budget = fast_call(f), Budget(["x"])

    def right(t: float, x: np.ndarray) -> np.ndarray:
        return rate(t, x, 0.0)

    end = carried(
        fast_call(step_function(f)),
        right,
        lambda times: np.zeros((1, times.size)),
        np.array([1.0]),
        (0.0, 2.0),
        Tolerance(1e-10, np.ones(1)),
        budget,
    )
    assert end is not None
    np.testing.assert_allclose(end, np.cos(2.0), rtol=0, atol=1e-9)
    theirs = scipy.integrate.solve_ivp(right, (0.0, 2.0), [1.0], method="DOP853", rtol=1e-10, atol=1e-10)
    assert 0.8 * theirs.nfev < budget.count < 1.2 * theirs.nfev
