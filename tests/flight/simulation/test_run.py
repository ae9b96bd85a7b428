"""Metrics of a run against closed forms, for commands that do not begin with zero."""

import numpy as np
import pytest
from testing.internals import compute_settling_time, estimate_pass_rate
from testing.loops import memory_of_impulse, scheduled

from gnc_opt.simulation import ClosedLoop, Saturation

DT = 0.25
COMMANDS = np.array([3.0, 3.0, -1.0, 2.0, 2.0, 0.5, -4.0, 0.0])


def flight(actuators=(), dt=DT):
    plant = memory_of_impulse()
    chosen = scheduled(plant, lambda t: COMMANDS[np.minimum(np.round(t / DT), 7).astype(int)])
    return ClosedLoop(plant, chosen, list(actuators), dt=dt).simulate([0.0], tf=8 * DT)


def test_chattering_counts_changes_and_not_the_first_command():
    """|3 - 3| + |-1 - 3| + |2 + 1| + 0 + 1.5 + 4.5 + 4 = 17, not 20: switching the controller on is no chattering."""
    assert flight().total_variation("a")[0] == pytest.approx(17.0, rel=1e-14)


def test_effort_energy_and_saturation_are_integrals_over_the_steps():
    run = flight()
    assert run.states[0, -1] == pytest.approx(DT * COMMANDS.sum(), rel=1e-14)
    assert run.control_effort("a")[0] == pytest.approx(DT * 15.5, rel=1e-14)
    assert run.control_energy("a")[0] == pytest.approx(DT * 43.25, rel=1e-14)
    assert run.delta_v("a", 5.0) == pytest.approx(DT * 15.5 / 5.0, rel=1e-14)
    assert run.saturation_time("a")[0] == 0.0
    limited = flight([Saturation("limit", -3.5, 2.5)])
    assert limited.saturation_time("a")[0] == pytest.approx(3 * DT, rel=1e-14)
    assert limited.control_effort("a")[0] == pytest.approx(DT * (15.5 - 0.5 - 0.5 - 0.5), rel=1e-14)
    assert limited.total_variation("a")[0] == pytest.approx(
        17.0, rel=1e-14
    )  # of the command, not of what is applied


def test_settling_is_for_good():
    times = np.array([2.0, 3.0, 4.0, 5.0, 6.0])
    assert compute_settling_time(times, np.array([2.0, 0.5, 2.0, 0.5, 0.1]), 1.0) == 3.0
    assert (
        compute_settling_time(times, np.array([2.0, 1.0, 1.0, 1.0, 1.0]), 1.0) == 1.0
    )  # the band itself is inside
    assert compute_settling_time(times, np.array([0.0, 0.5, 0.2, 0.5, 0.1]), 1.0) == 0.0
    assert compute_settling_time(times, np.array([0.0, 0.0, 0.0, 0.0, 2.0]), 1.0) == np.inf
    assert compute_settling_time(times, np.array([0.0, 0.0, 0.0, 0.0, np.nan]), 1.0) == np.inf


@pytest.mark.parametrize(
    ("passed", "shown"),
    [(1, "0.10 %"), (500, "50.0 %"), (994, "99.40 %"), (9997, "99.970 %"), (1000, "100.0 %"), (0, "0.0 %")],
)
def test_shares_are_shown_with_the_digits_of_what_is_missing(passed, shown):
    """99.97 % must not be printed as 100 %; 9997 of 10000, the others of 1000."""
    runs = 10000 if passed > 1000 else 1000
    assert str(estimate_pass_rate(passed, runs)).startswith(shown)
