"""The Runge-Kutta pair: order, error estimate, exactness."""

import casadi as ca
import numpy as np
import pytest

from gnc_opt.simulation.integrate import ERROR_WEIGHTS, NODES, STAGES, dormand_prince


def _advance(f, x0, length, steps):
    x = ca.SX.sym("x", len(x0))
    end, error = dormand_prince(f, 0.0, x, length, steps)
    after, estimate = ca.Function("F", [x], [end, error])(x0)
    return after.full()[:, 0], float(estimate)


def _pendulum(t, x, u):
    return ca.vertcat(x[1], -ca.sin(x[0]) + 0.3 * ca.cos(2 * t))


def test_tableau_is_consistent():
    for node, row in zip(NODES, STAGES, strict=True):
        assert sum(row) == pytest.approx(node, abs=1e-15)
    assert sum(ERROR_WEIGHTS) == pytest.approx(0.0, abs=1e-16)


@pytest.mark.parametrize("power", range(1, 5))
def test_quadrature_of_polynomials_is_exact_to_fourth_degree(power):
    after, estimate = _advance(lambda t, x, u: ca.SX(t) ** power + 0 * x, [0.0], 2.0, 1)
    assert after[0] == pytest.approx(2.0 ** (power + 1) / (power + 1), rel=1e-14)
    assert power == 4 or estimate < 1e-14


def test_order_of_convergence_is_five():
    exact, _ = _advance(_pendulum, [1.0, 0.0], 2.0, 400)
    errors = [np.max(np.abs(_advance(_pendulum, [1.0, 0.0], 2.0, n)[0] - exact)) for n in (8, 16, 32)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 4.7) and np.all(orders < 5.6)


def test_estimate_falls_with_the_fourth_power():
    estimates = [_advance(_pendulum, [1.0, 0.0], 2.0, n)[1] for n in (16, 32, 64)]
    assert np.log2(np.divide(estimates[:-1], estimates[1:])) == pytest.approx(4.0, abs=0.3)


@pytest.mark.parametrize("steps", [4, 8, 16, 32])
def test_estimate_bounds_the_true_error(steps):
    exact, _ = _advance(_pendulum, [1.0, 0.0], 2.0, 400)
    after, estimate = _advance(_pendulum, [1.0, 0.0], 2.0, steps)
    assert np.max(np.abs(after - exact)) < estimate
