"""Orbits and attitudes as CCSDS messages in key-value notation, which flight dynamics systems exchange.

OEM: orbit ephemeris message, CCSDS 502.0-B (version 2.0); km and km/s. AEM: attitude ephemeris message, CCSDS
504.0-B (version 1.0); ``q_BA``, scalar part last. In UTC no leap second may lie within a file.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_numbers
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError, shown

_UNIT = 1e-6
"""How far the length of a quaternion may be from 1; it is made 1."""


def write_oem(
    path: str | Path, times: ArrayLike, r: ArrayLike, v: ArrayLike, *, epoch: str, **metadata: str
) -> Path:
    """Return the path of an orbit ephemeris message that is written.

    Parameters
    ----------
    path : str or Path
    times : array (n,)
        s since the epoch, increasing by a nanosecond at least.
    r, v : array (3, n)
        Position (m) and velocity (m/s) relative to the centre in the frame.
    epoch : str
        Date and time of day of t = 0 in the time system, without a zone.
    **metadata : str
        ``originator``, ``object_name``, ``object_id`` (``"2027-001A"``), ``time_system``, ``center_name`` and
        ``ref_frame`` by their CCSDS names (``"UTC"``, ``"EARTH"``, ``"EME2000"``).

    Raises
    ------
    ArgumentError
        Arrays that do not fit or hold no numbers, times that do not increase, metadata that are missing.

    Examples
    --------
    >>> from gnc_opt.report import write_oem
    >>> t = np.linspace(0.0, 600.0, 11)
    >>> r = 7e6 * np.array([np.cos(1.078e-3 * t), np.sin(1.078e-3 * t), 0 * t])
    >>> v = 1.078e-3 * np.array([-r[1], r[0], r[2]])
    >>> about = {"originator": "EXAMPLE", "object_name": "CHASER", "object_id": "2027-001A", "time_system": "UTC"}
    >>> about |= {"epoch": "2027-03-01T12:00:00", "center_name": "EARTH", "ref_frame": "EME2000"}
    >>> print(write_oem("orbit.oem", t, r, v, **about).read_text().splitlines()[0])
    CCSDS_OEM_VERS = 2.0
    """
    stamps = _stamps(times, epoch)
    rows = np.vstack([_vectors(r, 3, stamps.size, "r"), _vectors(v, 3, stamps.size, "v")]) / 1e3
    entries = _metadata_entries(metadata, "center_name", "ref_frame") | _span(metadata, stamps)
    return _written(path, ("OEM", "2.0", metadata["originator"]), entries, _data(stamps, rows))


def write_aem(path: str | Path, times: ArrayLike, q_BA: ArrayLike, *, epoch: str, **metadata: str) -> Path:
    """Return the path of an attitude ephemeris message that is written.

    Parameters
    ----------
    path : str or Path
    times : array (n,)
        s since the epoch, increasing by a nanosecond at least.
    q_BA : array (4, n)
        Unit quaternion of frame B relative to frame A, scalar part first.
    epoch : str
    **metadata : str
        As in `write_oem`, with ``ref_frame_a`` and ``ref_frame_b`` (``"EME2000"``, ``"SC_BODY_1"``) in place of
        centre and frame.

    Raises
    ------
    ArgumentError
        As for `write_oem`; quaternions whose length is not 1.

    Examples
    --------
    >>> from gnc_opt.report import write_aem
    >>> t = np.linspace(0.0, 60.0, 7)
    >>> q_BA = np.array([np.cos(0.01 * t), 0 * t, 0 * t, np.sin(0.01 * t)])  # a turn about z
    >>> about = {"originator": "EXAMPLE", "object_name": "CHASER", "object_id": "2027-001A", "time_system": "UTC"}
    >>> about |= {"epoch": "2027-03-01T12:00:00", "ref_frame_a": "EME2000", "ref_frame_b": "SC_BODY_1"}
    >>> print(write_aem("attitude.aem", t, q_BA, **about).read_text().splitlines()[0])
    CCSDS_AEM_VERS = 1.0
    """
    stamps = _stamps(times, epoch)
    q = _vectors(q_BA, 4, stamps.size, "q_BA")
    size = np.linalg.norm(q, axis=0)
    if np.max(np.abs(size - 1.0)) > _UNIT:
        raise ArgumentError(
            f"q_BA has a column of length {size[np.argmax(np.abs(size - 1.0))]:.6g}: give unit quaternions."
        )
    entries = (
        _metadata_entries(metadata, "ref_frame_a", "ref_frame_b")
        | {"ATTITUDE_DIR": "A2B"}
        | _span(metadata, stamps)
    )
    entries |= {"ATTITUDE_TYPE": "QUATERNION", "QUATERNION_TYPE": "LAST"}
    data = ["DATA_START", *_data(stamps, np.roll(q / size, -1, axis=0)), "DATA_STOP"]
    return _written(path, ("AEM", "1.0", metadata["originator"]), entries, data)


def _metadata_entries(metadata: dict[str, str], *frames: str) -> dict[str, str]:
    """Return the lines of the object and its frames; refuse metadata that are missing, unknown or no line of text."""
    names = ("originator", "object_name", "object_id", "time_system", *frames)
    for name in sorted({*names} ^ {*metadata}):
        raise ArgumentError(
            f"the metadata of a message are {', '.join(names)}: '{name}' is missing or none of them."
        )
    for name, text in metadata.items():
        if not isinstance(text, str) or not text.strip() or not text.isprintable():
            raise ArgumentError(f"{name} of a message is {shown(text)}: state it in one line of text.")
    return {name.upper(): metadata[name] for name in ("object_name", "object_id", *frames)}


def _span(metadata: dict[str, str], stamps: Any) -> dict[str, str]:
    return {"TIME_SYSTEM": metadata["time_system"], "START_TIME": stamps[0], "STOP_TIME": stamps[-1]}


def _stamps(times: ArrayLike, epoch: str) -> Any:
    """Return the times of day as text, to the nanosecond."""
    t = np.atleast_1d(read_numbers(times, "the times"))
    if t.ndim != 1 or not np.all(np.isfinite(t)):
        raise ArgumentError(f"the times have the shape {t.shape} or are not finite: give (n,) numbers, s.")
    nanoseconds = np.round(t * 1e9).astype("timedelta64[ns]")
    if np.any(np.diff(nanoseconds) <= np.timedelta64(0, "ns")):
        raise ArgumentError(
            "the times do not increase by a nanosecond at least: leave out those that are given twice."
        )
    return np.datetime_as_string(_date(epoch) + nanoseconds, unit="ns")


def _date(epoch: str) -> Any:
    if isinstance(epoch, str) and "T" in epoch and epoch[-1] in "0123456789" and "+" not in epoch:
        with contextlib.suppress(ValueError):
            return np.datetime64(epoch, "ns")
    raise ArgumentError(
        f"the epoch is {shown(epoch)}: give date and time of day, '2027-03-01T12:00:00', without a zone."
    )


def _vectors(values: ArrayLike, size: int, n: int, name: str) -> Array:
    numbers = read_numbers(values, name)
    if numbers.shape != (size, n) or not np.all(np.isfinite(numbers)):
        raise ArgumentError(
            f"{name} has the shape {numbers.shape} or is not finite: with {n} times give ({size}, {n})."
        )
    return numbers


def _data(stamps: Any, rows: Array) -> list[str]:
    columns = zip(stamps, rows.T.tolist(), strict=True)
    return [" ".join([stamp, *map(repr, column)]) for stamp, column in columns]


def _written(path: str | Path, about: tuple[str, str, str], entries: dict[str, str], data: list[str]) -> Path:
    """Write a message; ``about`` is its kind, version and originator."""
    kind, version, originator = about
    head = {"CREATION_DATE": str(np.datetime64("now", "s")), "ORIGINATOR": originator}
    lines = [f"CCSDS_{kind}_VERS = {version}", *(f"{key} = {text}" for key, text in head.items())]
    lines += ["", "META_START", *(f"{key} = {text}" for key, text in entries.items()), "META_STOP", "", *data]
    target = Path(path)
    target.write_text("\n".join(lines) + "\n", encoding="ascii", errors="strict")
    return target
