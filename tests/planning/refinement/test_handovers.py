r"""A climbing half turn in the least time, at the most load factor and, once slow, at the most lift.

Of altitude h, speed v, path angle gamma and heading psi, with load factor n, bank and throttle as controls: n is at
most 4.5, and at most what lift at the largest coefficient gives. The largest of H over bank is known in closed form, so
that optimal flights are those of a Hamiltonian system without controls, piece by piece, which is shot here. Beside the
corner speed, where one limit of n takes over from the other, states and costates go on.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.array_types import Array

MASS, G, WING, THRUST, HEAVY = 12e3, 9.80665, 28.0, 80e3, 4.5
IDLE, FULL = 0.0, 1.0


def pressure(h: ca.SX, v: ca.SX) -> ca.SX:
    return 0.6125 * ca.exp(-h / 9e3) * v**2


def most_lift(h: ca.SX, v: ca.SX) -> ca.SX:
    return 1.2 * pressure(h, v) * WING / (MASS * G)


def acceleration(h: ca.SX, v: ca.SX, n: ca.SX, throttle: ca.SX | float) -> ca.SX:
    """Of thrust and drag along the path, m/s^2."""
    wing = pressure(h, v) * WING
    return (throttle * THRUST * ca.exp(-h / 12e3) - 0.022 * wing - 0.14 * (n * MASS * G) ** 2 / wing) / MASS


@pytest.fixture(scope="module")
def turned() -> go.Solution:
    model = go.Model("fighter")
    h, v, gamma, psi = (model.state(name) for name in ("h", "v", "gamma", "psi"))
    n, bank, throttle = (model.control(name) for name in ("n", "bank", "throttle"))
    model.ode(
        {
            h: v * ca.sin(gamma),
            v: acceleration(h, v, n, throttle) - G * ca.sin(gamma),
            gamma: G / v * (n * ca.cos(bank) - ca.cos(gamma)),
            psi: G * n * ca.sin(bank) / (v * ca.cos(gamma)),
        }
    )
    problem, leg = one_phase("half turn", model, initial=0.0, final=(2.0, 80.0), name="turn")
    leg.initial(h=3e3, v=250.0, gamma=0.0, psi=0.0)
    leg.final(h=3e3, gamma=0.0, psi=np.pi)
    leg.bounds(n=(0.0, HEAVY), bank=(-2.5, 2.5), throttle=(IDLE, FULL))
    leg.bounds(h=(500.0, 8e3), v=(80.0, 400.0), gamma=(-1.2, 1.2))
    leg.path("lift", n - most_lift(h, v), upper=0.0)
    problem.minimize(leg.final_time)
    return go.solve(problem)


def hamiltonian_flow(throttle: float, slow: bool) -> tuple[ca.Function, ca.Function]:
    """Least H over bank, and the rates of states and costates, at full lift or at the most load factor."""
    y = ca.SX.sym("y", 8)
    h, v, gamma, _ = ca.vertsplit(y[:4])
    along = y[4:]
    n = most_lift(h, v) if slow else HEAVY
    turning = G * n / v * ca.sqrt(along[2] ** 2 + (along[3] / ca.cos(gamma)) ** 2)
    value = along[0] * v * ca.sin(gamma) + along[1] * (acceleration(h, v, n, throttle) - G * ca.sin(gamma))
    value -= along[2] * G * ca.cos(gamma) / v + turning
    slope = ca.gradient(value, y)
    return ca.Function("H", [y], [value]), ca.Function("rates", [y], [ca.vertcat(slope[4:], -slope[:4])])


def shot(unknown: Array) -> Array:
    """What is missed by costates at the start and the times of the throttle, the corner and the end."""
    y = np.array([3e3, 250.0, 0.0, 0.0, *unknown[:4]])
    pieces = ((IDLE, False), (FULL, False), (FULL, True))
    times, missed = (0.0, *unknown[4:]), []
    for (throttle, slow), begin, end in zip(pieces, times[:-1], times[1:], strict=True):
        least, rates = hamiltonian_flow(throttle, slow)
        y = scipy.integrate.solve_ivp(
            lambda _, y, rates=rates: rates(y).full().ravel(),
            (begin, end),
            y,
            "DOP853",
            rtol=1e-10,
            atol=1e-12,
        ).y[:, -1]
        missed.append(float(y[5]) if throttle == IDLE else float(most_lift(y[0], y[1]) / HEAVY - 1.0))
    missed[-1] = float(least(y)) + 1.0
    return np.array([*missed, y[0] / 3e3 - 1.0, y[2], y[3] - np.pi, y[5]])


@pytest.mark.slow
def test_load_factor_hands_over_to_lift_where_shooting_says(turned: go.Solution) -> None:
    leg = turned.phases["turn"]
    ends = {(arc.channel, arc.kind.value): arc.end for arc in turned.structure}
    corner = ends["n", "upper"]
    found = np.array([*leg.lam(0.0), ends["throttle", "lower"], corner, turned.objective])
    exact = scipy.optimize.fsolve(shot, found, xtol=1e-10)
    assert found == pytest.approx(exact, rel=1e-6, abs=1e-8)
    assert turned.objective == pytest.approx(exact[-1], rel=1e-9)
    assert 0.0 < ends["throttle", "lower"] < corner < turned.objective
    assert np.any(np.isclose(leg.breaks[list(leg.mesh.movable)], corner)), "found as a variable"


def test_a_turn_past_the_corner_speed_is_a_strict_minimum(turned: go.Solution) -> None:
    """With the corner free of where both limits meet, to go over sooner would leave one of them and gain."""
    assert turned.history is not None and turned.history.converged
    assert go.verify(turned).minimum
