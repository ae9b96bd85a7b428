"""The flexible spacecraft's flown comparison against a program of its own, and its conditions."""

from __future__ import annotations

import numpy as np
import pytest

from problems.flexible_spacecraft import flown
from problems.flexible_spacecraft.flown import FLOWN, KNOWN, Conditions, flight, flown_rows, plan, worth
from problems.flown import Flight

NAMES = ("published", *FLOWN)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.cross(a, b, axis=0)


def orbital(q: np.ndarray) -> np.ndarray:
    """The rate (0, -1.078e-3, 0) of the orbital axes, in body axes: the second row of the attitude matrix."""
    s, x, y, z = q
    return -1.078e-3 * np.array([2 * (x * y + s * z), s * s - x * x + y * y - z * z, 2 * (y * z - s * x)])


def rate(t: float, state: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Hub and four modes, all in numbers; the moments and the frequencies are the true ones."""
    moments = np.array([103.0, 72.75, 51.0])
    coupling = np.array(
        [
            [6.45637, -1.25619, 1.11687, 1.23637],
            [1.27814, 0.91756, 2.48901, -2.6581],
            [2.15629, -1.67264, -0.83674, -1.12503],
        ]
    )
    stiff = 1.02 * np.array([[0.7], [1.0], [1.8], [2.5]])
    damped = 2 * np.array([[0.0056], [0.0086], [0.0128], [0.0252]]) * stiff
    q, w, eta, eta_rate = state[:4], state[4:7], state[7:11], state[11:]
    relative = w - orbital(q)
    turn = 0.5 * np.vstack([-np.sum(q[1:] * relative, axis=0), q[0] * relative + cross(q[1:], relative)])
    pushed = torque + 5e-4 * np.sqrt(3) / 3 * (np.sin(t) + 0.5)
    momentum = moments[:, None] * w + coupling @ eta_rate
    free = -damped * eta_rate - stiff**2 * eta
    mass = np.block([[np.diag(moments), coupling], [coupling.T, np.eye(4)]])
    accelerations = np.linalg.solve(mass, np.vstack([pushed - cross(w, momentum), free]))
    return np.vstack([turn, accelerations[:3], eta_rate, accelerations[3:]])


@pytest.mark.slow
def test_flights_are_what_another_program_makes_of_the_applied_torques() -> None:
    """Runge and Kutta's rule, half a step of control at a time; attitude by its angle to the orbital frame."""
    runs = [flight(name) for name in NAMES]
    torques = np.stack([run.applied for run in runs], axis=-1)
    first = np.concatenate([[np.sqrt(0.1), 0.7, -0.5, -0.4], np.zeros(11)])
    first[4:7] = orbital(first[:4])
    state, h, path = np.tile(first[:, None], len(runs)), 0.025, []
    for k in range(torques.shape[1]):
        u = torques[:, k]
        path.append(state)
        for t in (0.05 * k, 0.05 * k + h):
            k1 = rate(t, state, u)
            k2 = rate(t + h / 2, state + h / 2 * k1, u)
            k3 = rate(t + h / 2, state + h / 2 * k2, u)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(t + h, state + h * k3, u))
    states, times = np.array([*path, state]), 0.05 * np.arange(len(path) + 1)
    stiff = 1.02 * np.array([0.7, 1.0, 1.8, 2.5])
    for i, name in enumerate(NAMES):
        np.testing.assert_allclose(runs[i].states.T, states[:, :, i], atol=1e-6)
        late = np.flatnonzero(np.max(np.abs(states[:, 1:4, i]), axis=1) > 1e-3)[-1]
        end = states[-1, :4, i]
        found = Flight(
            float(times[late]),
            float(np.sum(np.abs(torques[:, :, i])) * 0.05),
            float(np.degrees(2 * np.arctan2(np.linalg.norm(end[1:]), abs(end[0])))),
        )
        eta, eta_rate = states[1200, 7:11, i], states[1200, 11:, i]
        energy = 0.5 * float(eta_rate @ eta_rate + (stiff * eta) @ (stiff * eta))
        for told in (worth(runs[i]), KNOWN[name][0]):
            assert [told.time, told.effort] == pytest.approx([found.time, found.effort], rel=1e-4)
            assert told.miss == pytest.approx(found.miss, rel=1e-3)
        assert KNOWN[name][1] == pytest.approx(energy, rel=1e-3)
        noise = runs[i].measured[4:7] - runs[i].states[4:7, :-1]
        np.testing.assert_allclose(np.degrees(np.std(noise, axis=1)), 0.001, rtol=0.06)
        assert np.max(np.abs(torques[:, :, i])) <= 0.3 * (1 + 1e-12)
    # a tenth of the torque is the feedback's, and the second plan spends what the law does
    for name in FLOWN:
        leg = plan(name).phase()
        torque = leg.flown_control("torque")(np.linspace(0.0, leg.final_time, 500))
        assert np.max(np.abs(torque)) == pytest.approx(0.27, rel=1e-6)
    assert worth(runs[2]).effort == pytest.approx(worth(runs[0]).effort, rel=0.02)
    assert [row.quantity for row in flown_rows() if not row.passes] == []


def test_another_condition_is_flown_and_not_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    """RQSMC spends more and settles earlier, as `studies` shows; nothing is known of it here."""
    robust = Conditions(k=0.05)
    monkeypatch.setattr(flown, "FLOWN", {})
    assert flown.flown(["k=0.05"]) == []
    quick, slow = worth(flight("published", robust)), worth(flight("published"))
    assert quick.effort > 1.3 * slow.effort and quick.time < slow.time - 5.0
    still = flight("published", Conditions(attitude_noise=0.0, rate_noise=0.0, disturbance=0.0))
    np.testing.assert_allclose(still.measured, still.states[:, :-1], atol=1e-15)
