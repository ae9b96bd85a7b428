"""The flexible spacecraft's flown comparison against a program of its own."""

from __future__ import annotations

import numpy as np
import pytest
from dispersed import told
from flexible import TRUE, angle, integrated, rest, vibration

from benchmarks.validation.published.comparison import known
from benchmarks.validation.published.flexible_spacecraft import FLOWN, flight, measures, plan, rivals
from benchmarks.validation.published.tracked import CompiledLoop
from gnc_opt.spacecraft import quaternion_angle

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


@pytest.mark.slow
def test_dispersed_runs_are_what_another_program_makes_of_the_applied_torques() -> None:
    """From their own starts and under their own pushes, for the plans and for the published law."""
    campaigns = rivals().fly(3, executor="serial")
    runs = [campaign.rerun(i) for campaign in campaigns.values() for i in range(3)]
    torques = np.stack([run.applied for run in runs], axis=-1)
    starts = np.stack([run.states[:, 0] for run in runs], axis=-1)
    wave, level = (
        told(campaigns, lambda c, name=name: c.parameter(name)) for name in ("wave.amplitude", "push.level")
    )
    ends = integrated(torques, TRUE, starts, wave, level)[-1]
    turned = np.degrees(quaternion_angle(starts[:4], rest()[:4, None]))
    assert np.all((turned > 0) & (turned <= 2.0)) and np.ptp(turned) > 0.1
    effort = np.sum(np.abs(torques), axis=(0, 1)) * 0.05
    np.testing.assert_allclose(told(campaigns, lambda c: c.measure("effort(torque)")), effort, rtol=1e-3)
    miss = np.radians([angle(q) for q in ends[:4].T])
    np.testing.assert_allclose(told(campaigns, lambda c: c.measure("angle(q_BO)")), miss, rtol=1e-3)
