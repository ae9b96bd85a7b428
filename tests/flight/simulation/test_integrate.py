"""The Runge-Kutta pair: order, error estimate, exactness."""

import casadi as ca
import numpy as np
import pytest
from testing.internals import NODES, STAGES, integrate_dormand_prince

import gnc_opt as go
from gnc_opt.simulation import Normal


def _advance(f, x0, length, steps):
    x = ca.SX.sym("x", len(x0))
    end = integrate_dormand_prince(f, 0.0, x, length, steps)
    return ca.Function("F", [x], [end])(x0).full()[:, 0]


def _pendulum(t, x, u):
    return ca.vertcat(x[1], -ca.sin(x[0]) + 0.3 * ca.cos(2 * t))


def test_tableau_is_consistent():
    for node, row in zip(NODES, STAGES, strict=True):
        assert sum(row) == pytest.approx(node, abs=1e-15)


@pytest.mark.parametrize("power", range(1, 5))
def test_quadrature_of_polynomials_is_exact_to_fourth_degree(power):
    after = _advance(lambda t, x, u: ca.SX(t) ** power + 0 * x, [0.0], 2.0, 1)
    assert after[0] == pytest.approx(2.0 ** (power + 1) / (power + 1), rel=1e-14)


def test_order_of_convergence_is_five():
    exact = _advance(_pendulum, [1.0, 0.0], 2.0, 400)
    errors = [np.max(np.abs(_advance(_pendulum, [1.0, 0.0], 2.0, n) - exact)) for n in (8, 16, 32)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 4.7) and np.all(orders < 5.6)


@pytest.mark.parametrize(
    ("rate", "damping", "step", "duration"), [(3.0, 0.01, 0.1, 20.0), (1.0, 0.0, 0.5, 60.0)]
)
def test_dispersed_runs_of_what_stands_still_are_accurate(rate, damping, step, duration):
    """A nominal run at rest shows no error: one integration step was taken, and 20 of 20 runs beside it flagged."""
    swing = go.Model("swing")
    q, v, u = swing.state("q"), swing.state("v"), swing.control("u")
    swing.ode({q: v, v: u - rate**2 * q - 2 * damping * rate * v})
    loop = go.ClosedLoop(swing, go.design_lqr(swing, [0, 0], Q=1, R=1, dt=step), dt=step)
    spread = {"initial.q": Normal(0.3), "initial.v": Normal(0.3)}
    runs = go.monte_carlo(loop, 20, x0=[0.0, 0.0], tf=duration, dispersions=spread, executor="serial")
    assert all(outcome.ok for outcome in runs.outcomes)
    assert (
        loop.compile([0.0, 0.0], tf=duration).substeps <= 3 * loop.compile([1.0, 0.0], tf=duration).substeps
    )
    held = go.ClosedLoop(
        swing, go.feedforward(go.Reference.constant(swing, [0, 0], [0])), dt=step, substeps=2
    )
    assert held.compile([0.0, 0.0], tf=duration).substeps == 2


def _within(length):
    """Return state and rate at the ends of a step of the pendulum and at 0.6 of it; its end, first and last stages."""
    seen, x = [], ca.SX.sym("x", 2)
    integrate_dormand_prince(_pendulum, 0.3, x, length, 1, None, seen.append)
    (taken,) = seen
    told = [
        *taken.interpolate_state(0.0), *taken.interpolate_state(0.6), *taken.interpolate_state(1.0),
        taken.after, taken.stages[0], taken.stages[-1],
    ]  # fmt: skip
    return [v.full()[:, 0] for v in ca.Function("within", [x], told)(_START)]


_START = [0.4, -0.2]


def test_within_a_step_the_solution_is_of_fourth_order():
    """Both ends and their rates are kept; halved steps leave 1/32 of the error between."""
    errors = []
    for length in (0.4, 0.2, 0.1):
        first, rate, middle, middle_rate, last, last_rate, *ends = _within(length)
        assert np.allclose([first, last, rate, last_rate], [_START, *ends], rtol=1e-13, atol=1e-14)
        truth = _advance(lambda t, y, u: _pendulum(t + 0.3, y, u), _START, 0.6 * length, 20)
        slope = _pendulum(0.3 + 0.6 * length, ca.DM(truth), None).full()[:, 0]
        errors.append([np.abs(middle - truth).max(), np.abs(middle_rate - slope).max()])
    ratios = np.array(errors[:-1]) / errors[1:]
    assert ratios[1, 0] > 24 and ratios[1, 1] > 12
