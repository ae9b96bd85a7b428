"""Relative motion about a circular equatorial orbit (Imani & Bahrami), for tests of the laws, SI units."""

from __future__ import annotations

import casadi as ca
import numpy as np

from gnc_opt.control import Reference
from gnc_opt.model import Model

MU, RADIUS, J2, EARTH = 398600e9, 7171e3, 0.0010826, 6378137.0
RATE = np.sqrt(MU / RADIUS**3)
PERIOD = 2 * np.pi / RATE
START = np.array([300.0, -200.0, 500.0, 0, 0, 0])


def hill() -> Model:
    model = Model("hill")
    r, v, a = (
        model.state("r", 3, unit="m"),
        model.state("v", 3, unit="m/s"),
        model.control("a", 3, unit="m/s^2"),
    )
    model.ode({r: v, v: a - _coriolis(v) - ca.vertcat(-3 * RATE**2 * r[0], 0, RATE**2 * r[2])})
    return model


def nonlinear(*, j2: bool) -> Model:
    model = Model("relative motion")
    r, v, a = (
        model.state("r", 3, unit="m"),
        model.state("v", 3, unit="m/s"),
        model.control("a", 3, unit="m/s^2"),
    )
    follower, leader = ca.vertcat(RADIUS + r[0], r[1], r[2]), ca.DM([RADIUS, 0, 0])
    q = ca.sumsqr(follower) ** 1.5
    gravity = MU * follower / q - ca.vertcat(MU / RADIUS**2, 0, 0)
    centrifugal = RATE**2 * ca.vertcat(r[0], r[1], 0 * r[2])
    # N of the sheet has -w^2 (x, y, 0) and z without it
    drift = centrifugal - gravity - _coriolis(v)
    if j2:
        drift += _j2(follower) - _j2(leader)
    model.ode({r: v, v: drift + a})
    return model


def circle(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity, acceleration on the reference, x_d = 500 cos(w t), y_d = -1000 sin(w t)."""
    c, s = np.cos(RATE * t), np.sin(RATE * t)
    position = np.array([500 * c, -1000 * s, 500 * np.sqrt(3) * c])
    velocity = RATE * np.array([-500 * s, -1000 * c, -500 * np.sqrt(3) * s])
    return position, velocity, -(RATE**2) * position


def formation(model: Model, end: float = PERIOD) -> Reference:
    """The circle, with the control that keeps it on the model's dynamics."""

    def x(t: float) -> np.ndarray:
        return np.concatenate(circle(t)[:2])

    def u(t: float) -> np.ndarray:
        return circle(t)[2] - model.f(t, x(t), np.zeros(3))[3:]

    return Reference.from_functions(model, x, u, 0.0, end)


def _coriolis(v):
    return 2 * RATE * ca.vertcat(-v[1], v[0], 0)


def _j2(p):
    n = ca.norm_2(p)
    common = 15 * p[2] ** 2 / n**7
    k = MU * J2 * EARTH**2 / 2
    return k * ca.vertcat((common - 3 / n**5) * p[0], (common - 3 / n**5) * p[1], (common - 9 / n**5) * p[2])
