"""The rendezvous in another maker's plant, Basilisk: the same flight, under the law in Python and in C."""

import shutil

import numpy as np
import pytest

import gnc_opt as go
from benchmarks.validation import basilisk
from problems.rendezvous import chaser_model
from problems.rendezvous_tracking.control import DT, Tracking, plan

pytest.importorskip("Basilisk.simulation.spacecraft", reason="Basilisk (extra peers) is not installed")

STEPS = 150
"""15 s: three of the plan's switches and the fastest turn."""


@pytest.fixture(scope="module")
def tracking():
    return Tracking(plan(refined=False))


@pytest.fixture(scope="module")
def flown(tracking):
    law = basilisk.python_law(tracking.tvlqr)
    return basilisk.fly(law, basilisk.start(tracking), STEPS)


def ours(tracking, **parameters):
    loop = go.ClosedLoop(chaser_model("exact"), tracking.tvlqr, dt=DT, accuracy=1e-12)
    return loop.simulate(x0=basilisk.start(tracking), tf=STEPS * DT, parameters=parameters).states


def apart(a, b):
    return {name: np.max(np.abs(a[part] - b[part])) for name, (part, _) in basilisk.PARTS.items()}


def test_both_fly_the_same(tracking, flown):
    assert np.max(np.abs(flown[9:12, -1] - flown[9:12, 0])) > 5.0  # m
    difference = apart(flown, ours(tracking))
    assert difference["omega"] < 1e-11
    assert difference["sigma"] < 1e-11
    assert difference["v_L"] < 5e-9
    # Hill's equations leave out 1.6e-10 m/s^2: at most 2e-8 m in 15 s, and it is there to be seen
    assert 1e-10 < difference["r_L"] < 3e-8


def test_a_wrong_plant_would_show(tracking, flown):
    assert apart(flown, ours(tracking, **{"plant.mass": 3200.0 * (1 + 1e-4)}))["r_L"] > 1e-5
    assert (
        apart(flown, ours(tracking, **{"plant.mean_motion": 1.01 * basilisk.mean_motion(basilisk.ORBIT)}))[
            "r_L"
        ]
        > 1e-6
    )


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc) on this machine")
def test_flight_code_flies_as_the_law_in_python(tracking, flown, tmp_path):
    law = basilisk.compiled_law(tracking.tvlqr, tmp_path)
    again = basilisk.fly(law, basilisk.start(tracking), STEPS)
    assert np.allclose(again, flown, rtol=1e-11, atol=1e-11)


def test_axes_there_and_back():
    x = np.random.default_rng(2).normal(size=12) * np.repeat([0.1, 0.2, 1.0, 20.0], 3)
    for t in (0.0, 700.0):
        assert np.allclose(basilisk.to_relative(t, *basilisk.to_inertial(t, x)), x, rtol=1e-8, atol=1e-8)
    # at rest in the target's axes, 10 m below it: slower by n r than the target
    below = np.concatenate([np.zeros(9), [0.0, 0.0, 10.0]])
    r, v, _, omega = basilisk.to_inertial(0.0, below)
    n = basilisk.mean_motion(basilisk.ORBIT)
    assert np.isclose(np.linalg.norm(r), basilisk.ORBIT - 10.0, rtol=1e-14)
    assert np.isclose(np.linalg.norm(v), n * (basilisk.ORBIT - 10.0), rtol=1e-14)
    assert np.isclose(np.linalg.norm(omega), n)
