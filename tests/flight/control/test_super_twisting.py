"""Super-twisting: sharp conditions on gains, the observer."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.internals import check_super_twisting_gains

from gnc_opt.control import SuperTwistingObserver
from gnc_opt.errors import DesignError


def settle(k1, k2, s, z, disturbance_rate=lambda s, z: 0.0, *, dt=1e-4, tf=30.0, near=1e-3):
    """Integrate the ideal equation by small Euler steps; return the last time at which |s| > near, and the end."""
    last = 0.0
    for i in range(round(tf / dt)):
        if abs(s) > near:
            last = i * dt
        sign = np.sign(s)
        s, z = s + dt * (-k1 * np.sqrt(abs(s)) * sign + z), z + dt * (-k2 * sign + disturbance_rate(s, z))
    return last, abs(s)


def test_gains_below_the_condition_fail_where_it_says():
    """k2 below the rate of the disturbance: s runs away; the classical 1.5, 1.1 holds against the worst one."""
    _, end = settle(1.5, 0.9, 0.1, 0.0, lambda s, z: 1.0, dt=1e-3, tf=60.0)
    assert end > 1.0
    _, end = settle(1.5, 1.1, 1.0, 0.0, lambda s, z: np.sign(z), dt=1e-3, tf=60.0)
    assert end < 1e-4
    check_super_twisting_gains(1.5, 1.1, 1.0, "it")
    with pytest.raises(DesignError, match=r"k2 = 1: raise k2"):
        check_super_twisting_gains(1.5, 1.0, 1.0, "it")
    with pytest.raises(DesignError, match=r"k1 = 1.4 .* = 1.4491"):
        check_super_twisting_gains(1.4, 1.1, 1.0, "it")


def observe(observer, unknown, dt, tf):
    """Return times and estimates of an observer of ds/dt = u + unknown(t), s exact, u a command of its own."""
    s, s_hat, q, known = ca.SX.sym("s"), ca.SX.sym("s_hat"), ca.SX.sym("q"), ca.SX.sym("known")
    block = ca.Function(
        "block",
        [s, s_hat, q, known],
        [observer.estimate(s, s_hat, q), *observer.update(s, s_hat, q, known, dt)],
    )
    times = dt * np.arange(round(tf / dt))
    integral, (a, b) = 0.3, (0.3, 0.0)
    estimates = []
    for t in times:
        command = np.sin(3 * t)
        value, a, b = (float(v) for v in block(integral, a, b, command))
        estimates.append(value)
        integral += dt * (command + unknown(t + dt / 2))
    return times, np.array(estimates)


def test_observer_finds_the_unknown_in_finite_time():
    """Its error obeys the super-twisting equation with z = -unknown(0) at first."""
    observer = SuperTwistingObserver(3.0, 4.0, bound=1.0)

    def unknown(t):
        return 0.8 + np.sin(t)

    times, estimates = observe(observer, unknown, 1e-3, 8.0)
    errors = np.abs(estimates - unknown(times))
    assert errors[0] > 0.7
    assert np.max(errors[times > 3.0]) < 0.03


def test_observer_refuses_gains_that_cannot_follow():
    with pytest.raises(DesignError, match="raise k2"):
        SuperTwistingObserver(3.0, 1.0, bound=2.0)
