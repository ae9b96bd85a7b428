"""Orbits and attitudes as CCSDS messages: an independent reader finds the numbers, the frames and the times."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import gnc_opt as go
from gnc_opt.report import write_aem, write_oem
from gnc_opt.spacecraft import MU_EARTH, mrp_to_quaternion

ABOUT = {
    "epoch": "2027-03-01T23:59:59.5",
    "time_system": "TDB",
    "object_name": "CHASER",
    "object_id": "2027-001A",
    "originator": "TEST",
}
ORBIT: dict[str, Any] = {**ABOUT, "ref_frame": "EME2000", "center_name": "EARTH"}
ATTITUDE: dict[str, Any] = {**ABOUT, "ref_frame_a": "EME2000", "ref_frame_b": "SC_BODY_1"}
TIMES = np.array([0.0, 0.25, 1.0 / 3.0, 5400.123456789])


def circular(t: Any) -> tuple[Any, Any]:
    """Position (m) and velocity (m/s) on a circular orbit of 7000 km."""
    a = 7.0e6
    n = np.sqrt(MU_EARTH / a**3)
    angle = n * np.asarray(t)
    zero = np.zeros_like(angle)
    return a * np.stack([np.cos(angle), np.sin(angle), zero]), a * n * np.stack(
        [-np.sin(angle), np.cos(angle), zero]
    )


def seconds(stamps: list[str]) -> Any:
    """Seconds since the epoch."""
    since = np.array(stamps, dtype="datetime64[ns]") - np.datetime64(ABOUT["epoch"], "ns")
    return since / np.timedelta64(1, "ns") / 1e9


def read(path: Path) -> Any:
    """The message as a reader of another maker sees it."""
    return pytest.importorskip("ccsds_ndm.ndm_io").NdmIo().from_path(path).body.segment


def test_an_orbit_is_read_back(tmp_path: Path) -> None:
    r, v = circular(TIMES)
    (segment,) = read(write_oem(tmp_path / "chaser.oem", TIMES, r, v, **ORBIT))
    told = segment.metadata
    assert (told.object_name, told.object_id, told.center_name) == ("CHASER", "2027-001A", "EARTH")
    assert (told.ref_frame, told.time_system) == ("EME2000", "TDB")
    states = segment.data.state_vector
    np.testing.assert_allclose(seconds([s.epoch for s in states]), TIMES, atol=0.6e-9)
    assert told.start_time == states[0].epoch and told.stop_time == states[-1].epoch
    position = np.array([[s.x.value, s.y.value, s.z.value] for s in states]).T
    velocity = np.array([[s.x_dot.value, s.y_dot.value, s.z_dot.value] for s in states]).T
    np.testing.assert_allclose(1e3 * position, r, rtol=3e-16, atol=0)
    np.testing.assert_allclose(1e3 * velocity, v, rtol=3e-16, atol=0)


def test_an_attitude_is_read_back_as_the_same_rotation(tmp_path: Path) -> None:
    sigma = np.array([[0.1, 0.2, -0.3, 0.0], [0.0, 0.1, 0.2, 0.0], [0.05, 0.0, 0.0, 0.4]])
    path = write_aem(tmp_path / "chaser.aem", TIMES, mrp_to_quaternion(sigma), **ATTITUDE)
    (segment,) = read(path)
    assert (segment.metadata.ref_frame_a, segment.metadata.ref_frame_b) == ("EME2000", "SC_BODY_1")
    states = [state.quaternion_state for state in segment.data.attitude_state]
    np.testing.assert_allclose(seconds([s.epoch for s in states]), TIMES, atol=0.6e-9)
    last = np.array([[s.quaternion.q1, s.quaternion.q2, s.quaternion.q3, s.quaternion.qc] for s in states])
    # SciPy's quaternions have their scalar part last, too, and from_mrp is an independent conversion.
    turn = Rotation.from_quat(last) * Rotation.from_mrp(sigma.T).inv()
    np.testing.assert_allclose(turn.magnitude(), 0.0, atol=1e-15)


def test_lines_are_as_the_standard_says(tmp_path: Path) -> None:
    """Without a reader: the order of keywords, and days that begin at midnight."""
    r, v = circular(TIMES)
    lines = write_oem(tmp_path / "a.oem", TIMES, r, v, **ORBIT).read_text().splitlines()
    assert lines[0] == "CCSDS_OEM_VERS = 2.0"
    keys = [line.partition(" = ")[0] for line in lines if " = " in line]
    assert keys[3:] == [
        *("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "REF_FRAME"),
        *("TIME_SYSTEM", "START_TIME", "STOP_TIME"),
    ]
    assert lines[-2].startswith("2027-03-01T23:59:59.833333333 6999")
    assert lines[-1].startswith("2027-03-02T01:29:59.623456789 ")
    lines = (
        write_aem(tmp_path / "a.aem", [0.0], [[1.0], [0.0], [0.0], [0.0]], **ATTITUDE)
        .read_text()
        .splitlines()
    )
    assert lines[-3:] == ["DATA_START", "2027-03-01T23:59:59.500000000 0.0 0.0 0.0 1.0", "DATA_STOP"]
    assert {"ATTITUDE_DIR = A2B", "ATTITUDE_TYPE = QUATERNION", "QUATERNION_TYPE = LAST"} <= set(lines)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"times": [0.0, 1.0, 1.0 + 1e-10, 2.0]}, "nanosecond"),
        ({"times": [0.0, np.nan, 1.0, 2.0]}, "not finite"),
        ({"r": np.zeros((4, 3))}, r"\(4, 3\).*give \(3, 4\)"),
        ({"v": np.full((3, 4), np.inf)}, "v .*not finite"),
        ({"ref_frame": ""}, "ref_frame of a message"),
        ({"center_name": "A\nB"}, "center_name of a message"),
        ({"frame": "EME2000"}, "'frame' is missing or none of them"),
        ({"epoch": "1 March 2027"}, "epoch"),
        ({"epoch": "2027-03-01T12:00:00Z"}, "without a zone"),
        ({"epoch": "2027-13-01T12:00:00"}, "epoch"),
        ({"time_system": 3}, "time_system"),
    ],
)
def test_what_cannot_be_meant_is_refused(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    r, v = circular(TIMES)
    given: dict[str, Any] = {"times": TIMES, "r": r, "v": v, **ORBIT, **change}
    with pytest.raises(go.ArgumentError, match=message):
        write_oem(tmp_path / "a.oem", **given)
    assert not list(tmp_path.iterdir())


def test_quaternions_have_the_length_one(tmp_path: Path) -> None:
    with pytest.raises(go.ArgumentError, match=r"length 1\.1"):
        write_aem(tmp_path / "a.aem", [0.0], [[1.1], [0.0], [0.0], [0.0]], **ATTITUDE)
