"""Predictive reaching: the explicit solution against a QP solver, a Riccati equation, and its limits."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from gnc_opt.errors import ArgumentError, DesignError
from problems.tethered_formation.predictive_reaching import PredictiveReaching

LIMIT = np.pi / 9


def law(steps=20, effort=1e-4, rate=0.1, travel=LIMIT, dt=0.1):
    reaching = PredictiveReaching(steps=steps, dt=dt, weight=1.0, effort=effort, rate=rate, travel=travel)
    symbols = [ca.SX.sym(name) for name in ("s", "f", "g", "y")]
    function = ca.Function("v", symbols, [reaching.command(*symbols)])
    return reaching, lambda *values: float(function(*values))


def by_solver(reaching, s, f, g, y):
    """v_0 of the quadratic program in all rates, by an active-set solver."""
    n, h = reaching.steps, reaching.dt
    summed = h * np.tril(np.ones((n, n)))
    free = s + h * f * np.arange(1, n + 1)
    cost = 2 * (g * g * reaching.weight * summed.T @ summed + reaching.effort * np.eye(n))
    slope = 2 * (g * reaching.weight * summed.T @ free + reaching.effort * f / g * np.ones(n))
    scale = reaching.rate  # rates in units of their limit: well scaled for the solver
    top = max(np.max(np.abs(cost)) * scale, np.max(np.abs(slope)))
    shape = {"h": ca.DM(cost).sparsity(), "a": ca.DM(summed).sparsity()}
    qp = ca.conic(
        "qp", "daqp", shape, {"error_on_fail": True, "daqp": {"dual_tol": 1e-12, "primal_tol": 1e-12}}
    )
    answer = qp(
        h=cost * scale / top,
        g=slope / top,
        a=summed * scale,
        lba=-reaching.travel - y,
        uba=reaching.travel - y,
        lbx=-np.ones(n),
        ubx=np.ones(n),
    )
    return float(answer["x"][0]) * scale


@pytest.mark.parametrize(
    ("steps", "effort", "travel"), [(1, 1e-4, 0.1), (5, 1e-3, 0.02), (12, 1e-6, 0.05), (20, 1e-4, LIMIT)]
)
def test_explicit_solution_is_that_of_the_program(steps, effort, travel):
    reaching, command = law(steps, effort, travel=travel)
    random = np.random.default_rng(steps)
    limited = 0
    for _ in range(40):
        s, f = random.normal(size=2) * 10 ** random.uniform([-4, -5], [0, -1.5])
        g = random.choice([-1, 1]) * 10 ** random.uniform(-2.5, 0)
        y = travel * random.uniform(-0.99, 0.99)
        v = command(s, f, g, y)
        assert v == pytest.approx(by_solver(reaching, s, f, g, y), abs=1e-6 * reaching.rate)
        limited += abs(v) == reaching.rate
    assert 0 < limited < 40 or travel < 0.05


def test_gain_away_from_limits():
    reaching, command = law()
    g = -0.0139923
    assert command(1e-6, 0.0, g, 0.0) / 1e-6 == pytest.approx(92.6008, abs=1e-4)
    assert -reaching.gain(g) == pytest.approx(92.6008, abs=1e-4)
    # infinite horizon: the positive root of the scalar Riccati equation b^2 p^2 = Q (R + b^2 p)
    b, effort = 0.1 * g, 1e-4
    p = (1 + np.sqrt(1 + 4 * effort / b**2)) / 2
    long = PredictiveReaching(steps=3000, dt=0.1, weight=1.0, effort=effort, rate=0.1, travel=LIMIT)
    assert long.gain(g) == pytest.approx(p * b / (effort + p * b * b), rel=1e-9)
    assert -long.gain(g) == pytest.approx(93.2483, abs=1e-4)


def test_limits_are_kept_and_drift_is_cancelled():
    _, command = law()
    g = -0.0139923
    assert command(0.18, 0.0, g, 0.0) == pytest.approx(0.1, abs=1e-15)
    assert command(0.18, 0.0, g, LIMIT - 0.005) == pytest.approx(0.05, abs=1e-12)
    assert command(0.18, 0.0, g, LIMIT) == pytest.approx(0.0, abs=1e-12)
    assert command(0.0, 2e-4, g, 0.0) == pytest.approx(-2e-4 / g, rel=1e-9)
    assert command(0.18, 0.0, g, LIMIT + 0.002) == pytest.approx(-0.02, abs=1e-12)  # back at once
    assert command(0.18, 0.0, g, LIMIT + 0.5) == -0.1  # and no faster than it can


def test_solution_is_odd_and_scales():
    _, command = law(8, 1e-3)
    random = np.random.default_rng(3)
    for s, f, y in random.normal(size=(10, 3)) * [0.1, 0.01, 0.1]:
        v = command(s, f, 0.05, y)
        assert command(-s, -f, 0.05, -y) == pytest.approx(-v, abs=1e-14)
        assert command(-s, -f, -0.05, y) == pytest.approx(v, abs=1e-14)
    _, small = law(8, 1e-3 * 100, rate=0.01, travel=LIMIT / 10)  # the actuator in units ten times as large
    assert small(0.003, 0.0, 0.5, 0.02) == pytest.approx(command(0.003, 0.0, 0.05, 0.2) / 10, rel=1e-9)


def test_impossible_laws_are_refused():
    with pytest.raises(DesignError, match="steps"):
        law(0)
    with pytest.raises(DesignError, match="'travel'"):
        law(travel=0.0)


def brief(**changes):
    return PredictiveReaching(
        **({"steps": 3, "dt": 0.1, "weight": 2.0, "effort": 0.05, "rate": 1.0, "travel": 0.15} | changes)
    )


@pytest.mark.parametrize(
    ("v", "position", "out"),
    [
        (5.0, 0.0, 1.0),
        (0.5, 0.0, 0.5),
        (1.0, 0.1, 0.5),
        (-1.0, -0.1, -0.5),
        (0.0, 0.2, -0.5),
        (0.0, 0.9, -1.0),
    ],
)
def test_a_rate_keeps_the_travel_and_above_all_itself(v, position, out):
    assert float(ca.evalf(brief().limit(ca.SX(v), ca.SX(position)))) == pytest.approx(out)


@pytest.mark.parametrize(
    "changes", [{"steps": 0}, {"dt": 0.0}, {"weight": -1.0}, {"effort": 0.0}, {"rate": 0.0}, {"travel": 0.0}]
)
def test_predictive_reaching_needs_positive_numbers(changes):
    with pytest.raises((ArgumentError, DesignError), match="reaching law"):
        brief(**changes)
