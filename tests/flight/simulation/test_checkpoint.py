"""Campaigns that are killed, resumed and extended: the same bits, and no run flown twice."""

import dataclasses
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from testing.loops import double_integrator, feedback

from gnc_opt.errors import GncOptError
from gnc_opt.simulation import Campaign, ClosedLoop, Noise, Normal, Saturation, monte_carlo
from gnc_opt.simulation import campaign_batches_and_checkpoints as mission_module

ARRAYS = tuple(field.name for field in dataclasses.fields(Campaign) if field.type in ("Array", "Any"))
"""All numbers of a campaign."""


def loop(limit=1.0, **options) -> ClosedLoop:
    plant = double_integrator()
    blocks = [Saturation("limit", -limit, limit)], [Noise("gauge", 1e-3, on="q")]
    return ClosedLoop(plant, feedback(plant, [[1.0, 1.6]]), *blocks, dt=0.1, **options)


CASE = {"x0": [1.0, 0.0], "tf": 3.0, "seed": 4, "dispersions": {"plant.m": Normal(0.1, relative=True)}}


def fly(n, closed=None, executor="serial", **changes):
    return monte_carlo(closed or loop(), n, executor=executor, target={"q": 0.0}, **(CASE | changes))


def same(a: Campaign, b: Campaign) -> bool:
    arrays = all(np.array_equal(getattr(a, n), getattr(b, n), equal_nan=True) for n in ARRAYS)
    return arrays and a.outcomes == b.outcomes and a.asked == b.asked


@pytest.fixture(scope="module")
def whole():
    return fly(60)


@pytest.fixture
def flown(monkeypatch):
    """Numbers of the runs that are flown, as they are flown."""
    numbers, fly_batch = [], mission_module.CampaignTask.simulate_runs

    def noted(self, batch):
        numbers.extend(batch)
        return fly_batch(self, batch)

    monkeypatch.setattr(mission_module.CampaignTask, "simulate_runs", noted)
    return numbers


def test_a_campaign_grows_and_flies_only_what_is_missing(tmp_path, whole, flown):
    assert same(fly(20, checkpoint=tmp_path / "a" / "b"), fly(20))
    flown.clear()
    assert same(fly(60, checkpoint=tmp_path / "a" / "b"), whole)
    assert flown == list(range(20, 60))
    flown.clear()
    assert same(fly(33, checkpoint=tmp_path / "a" / "b"), fly(33)) and flown == list(range(33))


def test_gaps_are_filled(tmp_path, whole, flown):
    fly(60, checkpoint=tmp_path)
    files = sorted(tmp_path.iterdir())
    for path in (files[0], files[7], files[8], files[-1]):
        path.unlink()
    (tmp_path / ".runs 00000000 to 00000001.npz.xyz").write_bytes(b"torn")  # left by a writer that was killed
    flown.clear()
    assert same(fly(60, checkpoint=tmp_path), whole)
    assert 4 <= len(flown) == len(set(flown)) < 12


@pytest.mark.parametrize(
    ("change", "culprit"),
    [
        ({"seed": 5}, "the seed 4, not 5"),
        ({"tf": 3.1}, "another loop or span"),
        ({"closed": loop(accuracy=1e-12)}, None),
        ({"closed": loop(substeps=3)}, "another loop or span"),
        ({"closed": loop(limit=0.5)}, "other dispersions, initial states or parameters"),
        ({"x0": [1.0, 0.1]}, "other dispersions"),
        ({"dispersions": {"plant.m": Normal(0.2, relative=True)}}, "other dispersions"),
    ],
)
def test_another_campaign_is_refused(tmp_path, change, culprit):
    fly(3, checkpoint=tmp_path)
    if culprit is None:  # the bits of the runs are the same: fine enough was fine enough before
        fly(4, checkpoint=tmp_path, **change)
        return
    with pytest.raises(GncOptError, match=culprit):
        fly(4, checkpoint=tmp_path, **change)


@pytest.mark.parametrize("content", [b"", b"torn", None])
def test_a_damaged_file_is_named_and_can_be_deleted(tmp_path, content):
    whole = fly(3, checkpoint=tmp_path)
    path = max(tmp_path.iterdir())
    bits = bytearray(path.read_bytes())
    bits[len(bits) // 3] ^= 1
    path.write_bytes(bytes(bits) if content is None else content)
    with pytest.raises(GncOptError, match=r"Delete this file") as refusal:
        fly(3, checkpoint=tmp_path)
    assert str(path) in str(refusal.value)
    path.unlink()
    assert same(fly(3, checkpoint=tmp_path), whole)


def test_a_loaded_campaign_refuses_another_loop_or_span(tmp_path, whole):
    path = whole.save(tmp_path / "campaign")
    flight = loop().compile([1.0, 0.0], tf=3.0)
    again = Campaign.load(path, compiled_loop=flight).rerun(7)
    assert np.array_equal(again.states[:, -1], whole.states[:, 7])
    with pytest.raises(GncOptError, match="from 0 s to 3 s, the given loop from 0 s to 5 s"):
        Campaign.load(path, compiled_loop=loop().compile([1.0, 0.0], tf=5.0))
    plant = double_integrator()
    other = ClosedLoop(plant, feedback(plant, [[1.0, 1.7]]), loop().actuators, loop().sensors, dt=0.1)
    with pytest.raises(GncOptError, match="another loop than the given loop: plant, controller"):
        Campaign.load(path, compiled_loop=other.compile([1.0, 0.0], tf=3.0))


KILLED = """
import sys, time
sys.path[:0] = sys.argv[2:]
from gnc_opt.simulation import campaign_batches_and_checkpoints as mission
from test_checkpoint import fly
import os
os.cpu_count = lambda: 2
fly_batch = mission.CampaignTask.simulate_runs
def slowly(self, batch):
    time.sleep(0.1)
    return fly_batch(self, batch)
slowly.__qualname__ = "CampaignTask.simulate_runs"
slowly.__module__ = mission.__name__
mission.CampaignTask.simulate_runs = slowly
fly(60, executor=None, checkpoint=sys.argv[1])
"""


@pytest.mark.skipif(os.name != "posix", reason="kills processes")
def test_a_killed_campaign_resumes_with_what_had_ended(tmp_path, whole, flown):
    folders = [str(Path(__file__).parent), str(Path(__file__).parents[2])]
    main = subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path), *folders])
    end = time.monotonic() + 60
    while len(list(tmp_path.glob("runs *"))) < 8 and time.monotonic() < end and main.poll() is None:
        time.sleep(0.01)
    main.send_signal(signal.SIGKILL)
    main.wait()
    stored = sum(len(Campaign.load(path)) for path in tmp_path.glob("runs *"))
    assert 8 <= stored < 60
    assert same(fly(60, checkpoint=tmp_path), whole)
    assert len(flown) == 60 - stored


def test_a_broken_executor_of_the_users_loses_no_run(whole):
    with ProcessPoolExecutor(1) as given:
        given.submit(os._exit, 1).exception()  # broken before the first run
        assert same(fly(60, executor=given), whole)
