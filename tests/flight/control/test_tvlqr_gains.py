"""Gains along a reference that jumps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from testing.internals import QuadraticCost, compute_riccati_gains

from gnc_opt.control import ErrorDynamics, Reference
from gnc_opt.model import Model


@pytest.mark.parametrize(("start", "span"), [(0.0, 2.0), (1e6, 2.0), (0.0, 2e-4)])
def test_gains_early_late_and_brief_know_on_which_side_of_a_jump_they_are(start, span):
    """x' = w x + u about x = 0, where w jumps from 1 to -2 per unit of time: -p' = 2 w p - p^2 + 4, from p = 1."""
    model = Model("switched")
    x, u, w = model.state("x"), model.control("u"), model.control("w")
    model.ode({x: w * x + u})
    unit = span / 2
    jump = start + 0.6 * unit
    reference = Reference.from_functions(
        model, lambda t: [0.0], lambda t: [0.0, (1.0 if t < jump else -2.0) / unit], start, start + span,
        jumps=[jump],
    )  # fmt: skip
    cost = QuadraticCost(np.array([[4.0 / unit]]), unit * np.eye(2), np.zeros((1, 2)))
    gains = compute_riccati_gains(ErrorDynamics(model), reference, cost, terminal=1.0)
    p = 1.0
    for factor, left, right in ((-2.0, 0.6, 2.0), (1.0, 0.0, 0.6)):

        def rate(t, p, factor=factor):
            return -(2 * factor * p - p**2 + 4)

        p = float(solve_ivp(rate, (right, left), [p], rtol=1e-12, atol=1e-13, method="DOP853").y[0, -1])
        assert gains.P(start + left * unit)[0, 0] == pytest.approx(p, rel=2e-8)
