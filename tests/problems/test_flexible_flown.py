"""The flexible spacecraft's flown comparison against a program of its own."""

from __future__ import annotations

import numpy as np
import pytest
from flexible import TRUE, angle, integrated, vibration

from benchmarks.validation.published.comparison import known
from benchmarks.validation.published.flexible_spacecraft import FLOWN, flight, measures, plan
from benchmarks.validation.published.tracked import CompiledLoop

NAMES = ("published", *FLOWN)
FLOWN_TITLES = {name: f"{name}, {share}" for name, share in FLOWN.items()}
FLOWN_TITLES["published"] = FLOWN_TITLES["least vibration"]


@pytest.mark.slow
def test_flights_are_what_another_program_makes_of_the_applied_torques() -> None:
    """Attitude by its angle to the orbital frame."""
    runs = [flight(name) for name in NAMES]
    torques = np.stack([run.applied for run in runs], axis=-1)
    states = integrated(torques, TRUE)
    times = 0.05 * np.arange(len(states))
    for i, name in enumerate(NAMES):
        np.testing.assert_allclose(runs[i].states.T, states[:, :, i], atol=1e-6)
        late = np.flatnonzero(np.max(np.abs(states[:, 1:4, i]), axis=1) > 1e-3)[-1]
        found = CompiledLoop(
            float(times[late]),
            float(np.sum(np.abs(torques[:, :, i])) * 0.05),
            angle(states[-1, :4, i]),
        )
        time, effort, miss, energy = (
            row["independent"][name == "published"]
            for row in known("flexible_spacecraft")
            if row["quantity"].startswith(f"{FLOWN_TITLES[name]}, flown") and "independent" in row
        )
        for one in (measures(runs[i]), CompiledLoop(time, effort, miss)):
            assert [one.time, one.effort] == pytest.approx([found.time, found.effort], rel=1e-4)
            assert one.miss == pytest.approx(found.miss, rel=1e-3)
        assert energy == pytest.approx(vibration(states[1200, :, i], TRUE), rel=1e-3)
        noise = runs[i].measured[4:7] - runs[i].states[4:7, :-1]
        np.testing.assert_allclose(np.degrees(np.std(noise, axis=1)), 0.001, rtol=0.06)
        assert np.max(np.abs(torques[:, :, i])) <= 0.3 * (1 + 1e-12)
    # a tenth of the torque is the feedback's, and the second plan spends what the law does
    for name in FLOWN:
        leg = plan(name).phase()
        torque = leg.saturated_control("torque")(np.linspace(0.0, leg.final_time, 500))
        assert np.max(np.abs(torque)) == pytest.approx(0.27, rel=1e-6)
    assert measures(runs[2]).effort == pytest.approx(measures(runs[0]).effort, rel=0.02)
