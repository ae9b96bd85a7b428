"""The flexible spacecraft in numbers alone: what another program makes of the torques that were applied."""

from __future__ import annotations

from functools import cache

import numpy as np


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def orbital(q: np.ndarray) -> np.ndarray:
    """The rate (0, -1.078e-3, 0) of the orbital axes, in body axes: the second row of the attitude matrix."""
    s, x, y, z = q
    return -1.078e-3 * np.array([2 * (x * y + s * z), s * s - x * x + y * y - z * z, 2 * (y * z - s * x)])


PUSH = 5e-4 * np.sqrt(3) / 3
COUPLING = np.array(
    [
        [6.45637, -1.25619, 1.11687, 1.23637],
        [1.27814, 0.91756, 2.48901, -2.6581],
        [2.15629, -1.67264, -0.83674, -1.12503],
    ]
)
DAMPING = np.array([0.0056, 0.0086, 0.0128, 0.0252])
BELIEVED = np.array([100.0, 75.0, 50.0]), np.array([0.7, 1.0, 1.8, 2.5])
TRUE = np.array([103.0, 72.75, 51.0]), 1.02 * np.array([0.7, 1.0, 1.8, 2.5])
Body = tuple[np.ndarray, np.ndarray]


def rate(
    t: float,
    state: np.ndarray,
    torque: np.ndarray,
    body: Body,
    wave: float | np.ndarray = PUSH,
    level: float | np.ndarray = 0.5 * PUSH,
) -> np.ndarray:
    """Hub and four modes, all in numbers, with the moments and the frequencies of a body."""
    moments, stiff = body[0], body[1][:, None]
    damped = 2 * DAMPING[:, None] * stiff
    q, w, eta, eta_rate = state[:4], state[4:7], state[7:11], state[11:]
    relative = w - orbital(q)
    turn = 0.5 * np.vstack([-np.sum(q[1:] * relative, axis=0), q[0] * relative + cross(q[1:], relative)])
    pushed = torque + wave * np.sin(t) + level
    momentum = moments[:, None] * w + COUPLING @ eta_rate
    free = -damped * eta_rate - stiff**2 * eta
    accelerations = flexibility(tuple(body[0])) @ np.vstack([pushed - cross(w, momentum), free])
    return np.vstack([turn, accelerations[:3], eta_rate, accelerations[3:]])


@cache
def flexibility(moments: tuple[float, ...]) -> np.ndarray:
    """Inverse of the mass matrix of hub and modes, which no motion changes."""
    return np.linalg.inv(np.block([[np.diag(moments), COUPLING], [COUPLING.T, np.eye(4)]]))


def rest() -> np.ndarray:
    """At rest in the orbital frame, before the slew."""
    first = np.concatenate([[np.sqrt(0.1), 0.7, -0.5, -0.4], np.zeros(11)])
    first[4:7] = orbital(first[:4])
    return first


def integrated(
    torques: np.ndarray,
    body: Body,
    starts: np.ndarray | None = None,
    wave: float | np.ndarray = PUSH,
    level: float | np.ndarray = 0.5 * PUSH,
) -> np.ndarray:
    """States (n_steps + 1, 15, n_runs) under torques (3, n_steps, n_runs), by Runge and Kutta's rule."""
    state = np.tile(rest()[:, None], torques.shape[2]) if starts is None else starts
    h, path = 0.025, []
    for k in range(torques.shape[1]):
        u = torques[:, k]
        path.append(state)
        for t in (0.05 * k, 0.05 * k + h):
            k1 = rate(t, state, u, body, wave, level)
            k2 = rate(t + h / 2, state + h / 2 * k1, u, body, wave, level)
            k3 = rate(t + h / 2, state + h / 2 * k2, u, body, wave, level)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(t + h, state + h * k3, u, body, wave, level))
    return np.array([*path, state])


def angle(q: np.ndarray) -> float:
    """To the orbital frame, degrees."""
    return float(np.degrees(2 * np.arctan2(np.linalg.norm(q[1:]), abs(q[0]))))


def vibration(state: np.ndarray, body: Body) -> float:
    """Modal energy, J."""
    return 0.5 * float(np.sum(state[11:] ** 2) + np.sum((body[1] * state[7:11]) ** 2))
