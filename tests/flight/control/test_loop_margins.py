"""Margins of loops whose responses are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize_scalar
from testing.internals import compute_spectral_radius, compute_stability_margins, discretize_zero_order_hold

NAN, INF = np.nan, np.inf


def test_margins_of_an_integrator_with_gain():
    """L = k / s: phase margin 90 deg at k rad/s, delay pi / (2 k), any gain up; sensitivity gives the disk 2."""
    found = compute_stability_margins(np.zeros((1, 1)), np.ones((1, 1)), np.array([[3.0]]))
    assert found.gain_up.tolist() == [INF] and found.gain_down.tolist() == [0.0]
    assert found.phase == pytest.approx([np.pi / 2]) and found.delay == pytest.approx([np.pi / 6])
    assert found.disk == pytest.approx(2.0, rel=1e-4)
    held = compute_stability_margins(np.ones((1, 1)), np.array([[0.1]]), np.array([[3.0]]), 0.1)
    assert held.gain_up == pytest.approx([2 / 0.3])  # z = -1: 1 - 0.1 k g = -1
    unstable = compute_stability_margins(np.ones((1, 1)), np.ones((1, 1)), np.array([[4.0]]))
    assert unstable.gain_down == pytest.approx([0.25]) and unstable.gain_up.tolist() == [INF]


@pytest.mark.parametrize("c", [1.0, 1.9, 1.9999999])
def test_a_sampled_integrator_has_the_phase_margin_of_its_crossing(c):
    """L = c / (z - 1) has the size one at w dt = 2 asin(c / 2), also just below the last frequency there is."""
    dt = 0.1
    found = compute_stability_margins(np.ones((1, 1)), np.array([[dt]]), np.array([[c / dt]]), dt)
    crossing = 2 * np.arcsin(c / 2) / dt
    phase = np.pi / 2 - np.arcsin(c / 2)
    assert found.phase == pytest.approx([phase], abs=1e-9) and found.delay == pytest.approx(
        [phase / crossing], abs=1e-9
    )
    assert found.gain_up == pytest.approx([2 / c])


def test_the_disk_margin_is_that_of_the_highest_peak():
    """Of S - 1/2 = (1 - L) / (2 (1 + L)) over all frequencies, not only those of a grid."""
    a, b, k = np.array([[0.0, 1.0], [0.0, -0.7]]), np.array([[0.0], [1.0]]), np.array([[3.0, 0.2]])

    def height(log_w):
        s = 1j * np.exp(log_w)
        loop = (3.0 + 0.2 * s) / (s * (s + 0.7))
        return -abs((1 - loop) / (2 * (1 + loop)))

    best = minimize_scalar(height, bounds=(0.0, 2.0), method="bounded", options={"xatol": 1e-10})
    assert compute_stability_margins(a, b, k).disk == pytest.approx(-1 / best.fun, rel=1e-9)


def test_a_loop_that_meets_the_positive_axis_alone_bears_any_gain():
    """L = 0.5 s / (s^2 + 0.1 s + 1) is 5 at 1 rad/s: no gain is lost there; |L| = 1 where |1 - w^2| = w sqrt(0.24)."""
    found = compute_stability_margins(
        np.array([[0.0, 1.0], [-1.0, -0.1]]), np.array([[0.0], [1.0]]), np.array([[0.0, 0.5]])
    )
    assert found.gain_up.tolist() == [INF] and found.gain_down.tolist() == [0.0]
    w = (np.sqrt(0.24) + np.sqrt(4.24)) / 2  # above the resonance, where L lags
    loop = 0.5j * w / (1 - w**2 + 0.1j * w)
    assert abs(loop) == pytest.approx(1.0) and found.phase == pytest.approx([np.pi + np.angle(loop)])
    assert found.delay == pytest.approx([(np.pi + np.angle(loop)) / w])


@pytest.mark.parametrize(("rate", "dt"), [(0.5, 0.01), (2.0, 0.005), (2.0, 0.02), (2.0, 0.5)])
def test_loops_that_go_through_infinity_need_no_gain(rate, dt):
    """At an undamped mode of the plant L changes its sign through infinity; any small gain damps it."""
    a, b = discretize_zero_order_hold(
        np.array([[0.0, 1.0], [-(rate**2), 0.0]]), np.array([[0.0], [2e-3]]), dt
    )
    x = solve_discrete_are(a, b, np.eye(2), np.eye(1))
    k = np.linalg.solve(1 + b.T @ x @ b, b.T @ x @ a)
    assert compute_spectral_radius(a - 1e-3 * b @ k) < 1
    assert compute_stability_margins(a, b, k, dt).gain_down.tolist() == [0.0]
