"""Four-wheel attitude control: slew, gaps of sensors, limits of wheels, the filter, runs integrated by SciPy."""

from __future__ import annotations

import numpy as np
import pytest
import scipy
from flexible import cross

from gnc_opt.analysis import consistency
from gnc_opt.array_types import Array
from gnc_opt.simulation import Campaign, Run
from gnc_opt.spacecraft import quaternion_angle
from problems.attitude_control import (
    DISPERSIONS,
    LAWS,
    LIMITS,
    MAX_MOMENTUM,
    MAX_TORQUE,
    START,
    TARGET,
    loop,
    simulate_campaign,
    slew,
)
from problems.attitude_control import __main__ as table
from problems.attitude_control.__main__ import WITHOUT, main
from problems.attitude_control.control import CLOSING, DT, SETTLED, SHARE, estimator, within_limits
from problems.attitude_control.model import (
    DURATION,
    GYRO_BIAS,
    LAG,
    PLANNED,
    TRACKER_DELAY,
    TRACKER_PERIOD,
    TRACKER_RATE,
)
from problems.reaction_wheels import AXES, INERTIA, REFERENCE, REST
from problems.reaction_wheels.control import design_flc

SEED = 3


@pytest.fixture(scope="module")
def campaigns() -> dict[str, Campaign]:
    return {
        name: simulate_campaign(name, runs, SEED, executor="serial")
        for name, runs in (("least energy", 3), ("FLC", 1))
    }


@pytest.fixture(scope="module")
def run(campaigns) -> Run:
    return campaigns["least energy"].rerun(0)


def test_the_slew_is_the_known_one_in_another_time():
    """From rest nothing is gyroscopic: in time c t the torques are 1 / c^2 as large, their squared integral 1 / c^3."""
    assert slew().objective == pytest.approx(REFERENCE.value * (34.6 / DURATION) ** 3, rel=1e-6)
    times = np.linspace(0.0, DURATION, 301)
    assert np.max(np.abs(slew().control("T")(times))) < PLANNED * MAX_TORQUE
    assert np.max(np.abs(slew().state("h")(times))) < PLANNED * MAX_MOMENTUM


def test_every_run_meets_its_limits(campaigns):
    for name, flown in campaigns.items():
        assert flown.passed().all(), name
        assert all(outcome.ok for outcome in flown.outcomes), name
    for number in DISPERSIONS:
        assert np.ptp(campaigns["least energy"].parameter(number), axis=1)[-1] > 0, number


def test_the_wheels_limits_are_at_work(campaigns):
    """The published law brings a wheel to the speed that it may have, and no further."""
    allowed = SHARE * LIMITS["max(speed)"]
    fastest = campaigns["FLC"].measure("max(speed)")
    assert fastest == pytest.approx(allowed, rel=2e-3) and np.all(fastest < LIMITS["max(speed)"])
    assert np.all(campaigns["FLC"].measure("max(torque)") > 0.9 * MAX_TORQUE)


def test_a_wheel_is_braked_before_its_limit():
    bare, kept = design_flc(TARGET), within_limits(design_flc(TARGET))
    asked, most = np.linalg.pinv(AXES) @ bare(0.0, REST, dt=DT)[0], SHARE * MAX_MOMENTUM
    allowed = SHARE * MAX_TORQUE
    assert np.max(np.abs(asked)) > allowed  # the published law asks for more than the motors have
    assert kept(0.0, REST)[0] == pytest.approx(np.clip(asked, -allowed, allowed), abs=1e-15)
    i, fast = int(np.argmin(asked)), REST.copy()
    fast[7 + i] = most + 0.1 * CLOSING * asked[i]  # it would get faster: only by a tenth of that
    assert kept(0.0, fast)[0][i] == pytest.approx(0.1 * asked[i], rel=1e-9)
    fast[7 + i] = 2 * most  # back, with all that the motor has
    assert kept(0.0, fast)[0][i] == pytest.approx(allowed, rel=1e-12)


def test_the_star_tracker_has_the_gaps_that_it_is_said_to_have(run):
    """Samples that are late, held, and missing where the body turned too fast or the glare lasted."""
    told = np.isfinite(run.measurement("q").values[0])
    exposed = TRACKER_PERIOD * np.floor((run.times[:-1] - TRACKER_DELAY) / TRACKER_PERIOD + 1e-6)
    seen = exposed >= 0
    begin, end = (run.parameter(f"glare.{name}")[0] for name in ("begin", "end"))
    steps = np.round(exposed[seen] / DT).astype(int)
    rates = np.linalg.norm(run.state("omega").values[:, steps], axis=0)
    dark = (rates > TRACKER_RATE) | ((exposed[seen] >= begin) & (exposed[seen] < end))
    assert np.array_equal(told[seen], ~dark) and told[~seen].all()
    assert 10 < DT * np.sum(dark & (exposed[seen] < SETTLED)) < DURATION and np.sum(DT * dark) > 20


def test_the_filter_finds_the_gyros_bias(run, campaigns):
    found = run.controller_state("omega_bias_hat")(run.times[-1])
    true = run.parameter("gyro bias.bias")
    assert found == pytest.approx(true, abs=2e-5) and np.max(np.abs(true)) > 10 * 2e-5
    estimate = run.controller_state("q_hat").values
    apart = quaternion_angle(estimate, run.states[:4])
    assert np.max(apart[round(SETTLED / DT) :]) < 1e-3 and np.max(apart) < 0.03
    judged = consistency(campaigns["least energy"], estimator())
    assert judged.innovations["q"].average == pytest.approx(3.0, abs=0.35)
    assert judged.innovations["q"].refused == 0
    assert judged.average < judged.band[1]  # at rest it is better than it says: the noise is for the slew


def test_scipy_goes_the_same_way(run):
    """Body, wheels and motors of a run written down again, flown with its commands for a third of the slew."""
    runs, steps = [run], round(DURATION / 3 / DT)
    again = np.stack([run.states[:, steps] for run in runs], axis=1)
    assert flown_again(runs, steps) == pytest.approx(again, abs=1e-8)


def flown_again(runs: list[Run], steps: int) -> Array:
    """Return the states (15, n_runs) after some control steps, by SciPy from commands and parameters alone."""

    def of(name: str) -> Array:
        return np.stack([run.parameter(name) for run in runs], axis=1)

    inertia, lag, external, factor = map(
        of, ("plant.inertia", "plant.lag", "plant.external", "motors.factor")
    )
    assert not np.allclose(lag, LAG, rtol=0.05) and not np.allclose(inertia.T, INERTIA)

    def rate(t: float, flat: Array, told: Array) -> Array:
        q, omega, h, motor = np.split(flat.reshape(15, -1), [4, 7, 11])
        twist = cross(q[1:], omega)
        turn = 0.5 * np.vstack([-np.sum(q[1:] * omega, axis=0), q[0] * omega + twist])
        total = inertia * omega + AXES @ h
        spin = (AXES @ motor + external - cross(omega, total)) / inertia
        return np.vstack([turn, spin, -motor, (told - motor) / lag]).ravel()

    y = np.stack([run.states[:, 0] for run in runs], axis=1).ravel()
    for k in range(steps):
        command = factor * np.stack([run.commands[:, k] for run in runs], axis=1)
        y = scipy.integrate.solve_ivp(rate, (0.0, DT), y, "DOP853", args=(command,), rtol=1e-8, atol=1e-10).y[
            :, -1
        ]
    return np.asarray(y.reshape(15, -1))


def test_the_command_prints_its_table(campaigns, monkeypatch, capsys, tmp_path):
    def flown(name: str, *rest: object, bias: bool = True, **more: object) -> Campaign:
        return campaigns["least energy" if name == "least energy" else "FLC"]

    monkeypatch.setattr(table, "simulate_campaign", flown)
    assert main(["--runs", "1", "--json", str(tmp_path / "out.json")]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in (*LAWS, WITHOUT)) and "NIS of q" in text
    assert (tmp_path / "out.json").exists()
    monkeypatch.setattr(table, "DEMANDED", 1.01)
    monkeypatch.setitem(table.LIMITS, "max(speed)", 1000.0)
    assert main([]) == 1
    text = capsys.readouterr().out
    assert "are demanded" in text and "is the limit" in text


def test_a_gap_without_a_bias_that_is_estimated_loses_the_attitude():
    wrong = {"gyro bias.bias": 3 * [2 * GYRO_BIAS]}
    lost = loop("LQR", bias=False).simulate(START, tf=40.0, parameters=wrong)
    assert np.degrees(quaternion_angle(lost.states[:4, -1], TARGET)) > 1.0
