"""Riccati equations: scalar ones by hand, residuals, modes out of reach, balancing."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.linalg import matrix_balance
from testing.internals import (
    QuadraticCost,
    compute_riccati_residual,
    discretize_zero_order_hold,
    find_uncontrollable_modes,
    require_stabilizable,
    solve_algebraic_riccati,
)

from gnc_opt.control import riccati
from gnc_opt.errors import DesignError

A, B = np.array([[0.0, 1.0], [-2.0, -0.3]]), np.array([[0.5], [1.0]])


Q, R, N = np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([[0.7]]), np.array([[0.2], [-0.1]])


@pytest.mark.parametrize("n", [0.0, 0.3])
def test_a_scalar_regulator(n):
    """2 a p - (b p + n)^2 / r + q = 0, or its sampled form, solved by hand."""
    a, b, q, r = 0.5, 2.0, 3.0, 0.7
    found = solve_algebraic_riccati(*(np.array([[v]]) for v in (a, b, q, r, n)), ("x",))
    p = float(found.cost[0, 0])
    assert 2 * a * p - (b * p + n) ** 2 / r + q == pytest.approx(0.0, abs=1e-12) and p > 0
    assert found.gain[0, 0] == pytest.approx((b * p + n) / r) and found.poles.real == pytest.approx(
        [a - b * found.gain[0, 0]]
    )
    assert found.residual < 1e-14
    sampled = solve_algebraic_riccati(*(np.array([[v]]) for v in (1.2, b, q, r, n)), ("x",), sampled=True)
    p, k = float(sampled.cost[0, 0]), float(sampled.gain[0, 0])
    assert k == pytest.approx((1.2 * b * p + n) / (r + b * b * p))
    assert 1.44 * p - k * k * (r + b * b * p) + q == pytest.approx(p, rel=1e-12)
    assert abs(sampled.poles[0]) < 1 and sampled.poles.real == pytest.approx([1.2 - b * k])


@pytest.mark.parametrize("sampled", [False, True])
def test_a_solution_that_leaves_an_unstable_pole_is_refused(sampled, monkeypatch):
    """The other root of the scalar equation mirrors the pole: from -1.5 to 1.5, or out of the unit circle."""
    a, b = (0.5, 1.0) if not sampled else (1.2, 1.0)
    other = 0.5 - np.sqrt(0.25 + 2.0) if not sampled else None
    if sampled:  # p = q + a^2 p - a^2 b^2 p^2 / (r + b^2 p)
        other = float(np.min(np.roots([1.0, 1.0 - 2.0 - 1.44, -2.0])))
    name = "solve_discrete_are" if sampled else "solve_continuous_are"
    monkeypatch.setattr(riccati.scipy.linalg, name, lambda *_, **__: np.array([[other]]))
    with pytest.raises(DesignError, match="unstable closed-loop pole at"):
        solve_algebraic_riccati(*(np.array([[v]]) for v in (a, b, 2.0, 1.0, 0.0)), ("x",), sampled=sampled)


def test_a_residual_is_relative_and_detects_a_wrong_cost():
    cost = QuadraticCost(np.eye(2), np.eye(1), np.zeros((2, 1)))
    for is_sampled in (False, True):
        plant = discretize_zero_order_hold(A, B, 0.1) if is_sampled else (A, B)
        p = solve_algebraic_riccati(*plant, *cost, ("q", "v"), sampled=is_sampled).cost
        assert compute_riccati_residual(*plant, *cost, p, sampled=is_sampled) < 1e-13
        wrong = compute_riccati_residual(*plant, *cost, 1.001 * p, sampled=is_sampled)
        assert 1e-5 < wrong < 1e-2
        scale = np.diag([1.0, 1e3])
        back = np.linalg.inv(scale)
        scaled = (scale @ plant[0] @ back, scale @ plant[1], back @ cost.q @ back, cost.r, back @ cost.n)
        assert compute_riccati_residual(
            *scaled, back @ (1.001 * p) @ back, sampled=is_sampled
        ) == pytest.approx(wrong, rel=1e-6)
    assert compute_riccati_residual(0 * A, B, 0 * A, R, 0 * B, 0 * A, sampled=False) == 0.0


def test_a_mode_is_named_by_the_states_that_have_a_part_in_it():
    """Of three integrators with two inputs across (1, 0.4, 0.02): the third has hardly a part."""
    direction = np.array([[1.0, 0.4, 0.02]])
    across = np.linalg.svd(direction)[2][1:].T
    (mode,) = find_uncontrollable_modes(np.zeros((3, 3)), across, ("x", "y", "z"))
    assert mode.states == ("x", "y") and abs(mode.eigenvalue) < 1e-12


@pytest.mark.parametrize(
    ("value", "sampled", "ok"),
    [
        (-1.0, False, True), (0.0, False, False), (0.9, True, True), (1.0, True, False), (-0.9, True, True),
        (-1.1, True, False),
    ],
)  # fmt: skip
def test_modes_on_the_boundary_do_not_decay(value, sampled, ok):
    a, b = np.diag([value, 0.5]), np.array([[0.0], [1.0]])
    if ok:
        require_stabilizable(a, b, ("x", "y"), sampled=sampled)
        return
    with pytest.raises(DesignError, match="not stabilisable"):
        require_stabilizable(a, b, ("x", "y"), sampled=sampled)


ALMOST = np.array([[0.0, 1.0], [1e-40, 0.0]])


LABELS = ("angle", "rate")


def test_scales_beyond_the_integers_are_no_warning_and_no_obstacle() -> None:
    with pytest.warns(RuntimeWarning, match="cast"):
        matrix_balance(ALMOST, permute=False, separate=True)  # what it is about
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        require_stabilizable(ALMOST, np.array([[0.0], [1.0]]), LABELS)
        none = np.zeros((2, 1))
        regulator = solve_algebraic_riccati(
            ALMOST, np.array([[0.0], [1.0]]), np.eye(2), np.eye(1), none, LABELS
        )
    np.testing.assert_allclose(regulator.gain, [[1.0, np.sqrt(3.0)]], rtol=1e-12)
