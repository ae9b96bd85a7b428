"""Files of runs and campaigns: every field comes back, also from campaigns of version 2."""

import dataclasses
import errno
import json
import math

import numpy as np
import pytest
from testing.loops import double_integrator, feedback

from gnc_opt.errors import GncOptError
from gnc_opt.simulation import Campaign, ClosedLoop, Noise, Outcome, Run, RunStatus, monte_carlo


def loop():
    cart = double_integrator(2)
    gain = np.hstack([np.eye(2), 1.6 * np.eye(2)])
    return ClosedLoop(cart, feedback(cart, gain), sensors=[Noise("radar", 0.01, on="q")], dt=0.1)


def test_a_full_disk_names_the_file_and_leaves_the_old_one(tmp_path, monkeypatch):
    run = loop().simulate([1.0, 0.5, 0.0, 0.0], tf=0.3)
    path = run.save(tmp_path / "run.npz")
    before = path.read_bytes()

    def full(stream, **arrays):
        stream.write(b"PK")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*run\.npz'") as refused:
        run.save(path)
    assert refused.value.errno == errno.ENOSPC and refused.value.filename == str(path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


@pytest.fixture(scope="module")
def campaign():
    flown = monte_carlo(
        loop(), 12, x0=[1.0, 0.5, 0.0, 0.0], tf=1.0, seed=5, target={"q": 0.0},
        limits={"q": 0.8, "half/effort": 3.0},
        measures={"half/effort": lambda c: 0.5 * c.measure("effort(a)")}, executor="serial",
    )  # fmt: skip
    lost = Outcome(RunStatus.LOST, "its process died")
    alarm = Outcome(RunStatus.CONTROLLER_ALARM, "'limit'", 0.1 + 0.2)
    return dataclasses.replace(flown, outcomes=(*flown.outcomes[:-2], lost, alarm))


@pytest.fixture(scope="module")
def run():
    return loop().simulate([1.0, 0.5, 0.0, 0.0], tf=1.0, seed=[5, 3])


def assert_same(a, b, left_out=()):
    """Every field is equal to the last bit, and of the same type."""
    assert type(a) is type(b)
    for f in dataclasses.fields(a):
        if f.name not in left_out:
            here, there = getattr(a, f.name), getattr(b, f.name)
            if isinstance(here, np.ndarray):
                assert (here.dtype, here.shape, here.tobytes()) == (there.dtype, there.shape, there.tobytes())
            elif f.name == "measured":
                assert list(here) == list(there)
                assert all(here[n].tobytes() == there[n].tobytes() for n in here)
            else:
                assert type(here) is type(there) and repr(here) == repr(there), f.name


def test_every_field_of_a_run_comes_back(run, tmp_path):
    assert_same(Run.load(run.save(tmp_path / "run")), run)
    failed = dataclasses.replace(
        run, integration_error=math.nan, outcome=Outcome(RunStatus.NOT_FINITE, "measured 'q'", 0.3)
    )
    assert_same(Run.load(failed.save(tmp_path / "failed")), failed)


def test_every_field_of_a_campaign_comes_back(campaign, tmp_path):
    loaded = Campaign.load(campaign.save(tmp_path / "campaign"))
    assert_same(loaded, campaign, left_out=("compiled_loop",))
    assert loaded.compiled_loop is None


def test_a_compiled_loop_of_another_loop_is_refused(campaign, tmp_path):
    path = campaign.save(tmp_path / "campaign")
    cart = double_integrator(2)
    other = ClosedLoop(cart, feedback(cart, np.hstack([np.eye(2), np.eye(2)])), dt=0.1)
    with pytest.raises(GncOptError, match="flew another loop"):
        Campaign.load(path, compiled_loop=other.compile([1.0, 0.5, 0.0, 0.0], tf=1.0))


def test_a_run_is_no_campaign(run, tmp_path):
    with pytest.raises(GncOptError, match="is an archive, but not a campaign"):
        Campaign.load(run.save(tmp_path / "run"))


def write(path, header, arrays):
    np.savez_compressed(path, header=np.array(json.dumps(header)), **arrays)
    return path


def test_a_campaign_of_version_2_is_read(campaign, tmp_path):
    """It is the third without the fingerprint of the loop."""
    with np.load(campaign.save(tmp_path / "third")) as entries:
        arrays = {name: entries[name] for name in entries.files if name != "header"}
        header = json.loads(str(entries["header"]))
    del header["campaign"]["fields"]["fingerprint"]
    header["version"] = 2
    loaded = Campaign.load(write(tmp_path / "second.npz", header, arrays))
    assert_same(loaded, campaign, left_out=("compiled_loop", "fingerprint"))
    assert loaded.fingerprint == ""
