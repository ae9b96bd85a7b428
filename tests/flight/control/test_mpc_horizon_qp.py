"""The quadratic program of a horizon: its optimality residual."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.internals import QuadraticProgram

INF = np.inf


def test_a_solution_has_no_residual_and_anything_else_has_one():
    """min |omega|^2 / 2 within omega_1 + omega_2 >= 1: omega = 1/2, multiplier -1/2 at the lower limit."""

    def task_of(g, a, low, high):
        return QuadraticProgram(ca.DM(g), ca.DM(a), ca.DM(low), ca.DM(high), free=2)

    task = task_of([0.0] * 3, [[1.0, 1.0, 0.0]], [1.0], [INF])
    right = (ca.DM([0.5, 0.5, 0.0]), ca.DM([-0.5]), ca.DM([0.0, 0.0, 0.0]))

    def residual(omega=right[0], lam_a=right[1], lam_x=right[2], task=task):
        return float(task.compute_kkt_residual(omega, lam_a, lam_x))

    assert residual() == 0.0
    assert residual(omega=ca.DM([0.6, 0.6, 0.0])) == pytest.approx(0.1 + 0.2 * 0.5)
    assert residual(omega=ca.DM([0.4, 0.4, 0.0])) == pytest.approx(0.1 + 0.2 + 0.2 * 0.5)
    assert residual(lam_a=ca.DM([0.5])) > 1.0
    assert residual(omega=ca.DM([0.5, 0.5, -0.1])) == pytest.approx(0.1 + 0.1)
    assert residual(lam_x=ca.DM([0.0, 0.0, 0.2])) == pytest.approx(0.2 + 0.2)
    priced = task_of([0.0, 0.0, 4.0], [[1.0, 1.0, 0.0]], [1.0], [INF])
    assert residual(lam_x=ca.DM([0.0, 0.0, -4.0]), task=priced) == 0.0
    assert residual(lam_x=ca.DM([0.0, 0.0, -2.0]), task=priced) == pytest.approx(2 / 4)
    assert not residual(omega=ca.DM([np.nan, 0.5, 0.0])) < 1.0
    hard = task_of([0.0] * 2, [[1.0, 1.0]], [-9.0], [-1.0])
    assert float(hard.compute_kkt_residual(ca.DM([-0.5, -0.5]), ca.DM([0.5]), ca.DM([0.0, 0.0]))) == 0.0
