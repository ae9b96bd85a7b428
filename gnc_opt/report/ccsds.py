"""Orbits and attitudes as CCSDS messages in key-value notation, which flight dynamics systems exchange.

OEM: orbit ephemeris message, CCSDS 502.0-B (version 2.0); km and km/s. AEM: attitude ephemeris message, CCSDS
504.0-B (version 1.0); ``q_BA``, scalar part last. In UTC no leap second may lie within a file.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import expect, read_numbers
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError, shown

_UNIT = 1e-6
"""How far the length of a quaternion may be from 1; it is made 1."""


@dataclass(frozen=True)
class MessageMetadata:
    """Object and clock of a CCSDS message.

    Parameters
    ----------
    epoch : str
        Date and time of day of t = 0 in the time system.
    time_system : str
        By its CCSDS name, ``"UTC"``.
    object_name, object_id, originator : str
        The id is the international designator, ``"2027-001A"``.

    Examples
    --------
    >>> from gnc_opt.report import MessageMetadata
    >>> about = MessageMetadata("2027-03-01T12:00:00", "UTC", "CHASER", "2027-001A", "EXAMPLE")
    """

    epoch: str
    time_system: str
    object_name: str
    object_id: str
    originator: str

    def __post_init__(self) -> None:
        _date(self.epoch)
        for key in ("time_system", "object_name", "object_id", "originator"):
            _line(key, getattr(self, key))

    @property
    def object(self) -> dict[str, str]:
        """Keywords of the object."""
        return {"OBJECT_NAME": self.object_name, "OBJECT_ID": self.object_id}


def write_oem(
    path: str | Path,
    times: ArrayLike,
    r: ArrayLike,
    v: ArrayLike,
    *,
    frame: str,
    center: str,
    metadata: MessageMetadata,
) -> Path:
    """Return the path of an orbit ephemeris message that is written.

    Parameters
    ----------
    path : str or Path
    times : array (n,)
        s since the epoch, increasing by a nanosecond at least.
    r, v : array (3, n)
        Position (m) and velocity (m/s) relative to the centre in the frame.
    frame, center : str
        By their CCSDS names: ``"EME2000"``, ``"EARTH"``.
    metadata : MessageMetadata

    Raises
    ------
    ArgumentError
        Arrays that do not fit or hold no numbers, times that do not increase, empty texts.

    Examples
    --------
    >>> from gnc_opt.report import MessageMetadata, write_oem
    >>> t = np.linspace(0.0, 600.0, 11)
    >>> r = 7e6 * np.array([np.cos(1.078e-3 * t), np.sin(1.078e-3 * t), 0 * t])
    >>> v = 1.078e-3 * np.array([-r[1], r[0], r[2]])
    >>> about = MessageMetadata("2027-03-01T12:00:00", "UTC", "CHASER", "2027-001A", "EXAMPLE")
    >>> message = write_oem("orbit.oem", t, r, v, frame="EME2000", center="EARTH", metadata=about)
    >>> print(message.read_text().splitlines()[0])
    CCSDS_OEM_VERS = 2.0
    """
    expect(metadata, MessageMetadata, "the metadata of a message", "write MessageMetadata(epoch, ...)")
    stamps = _stamps(times, metadata.epoch)
    rows = np.vstack([_vectors(r, 3, stamps.size, "r"), _vectors(v, 3, stamps.size, "v")]) / 1e3
    about = metadata.object | {"CENTER_NAME": center, "REF_FRAME": frame}
    lines = _message("OEM", "2.0", metadata, about | _span(metadata, stamps))
    return _written(path, [*lines, "", *_data(stamps, rows)])


def write_aem(
    path: str | Path,
    times: ArrayLike,
    q_BA: ArrayLike,
    *,
    frame_a: str,
    frame_b: str,
    metadata: MessageMetadata,
) -> Path:
    """Return the path of an attitude ephemeris message that is written.

    Parameters
    ----------
    path : str or Path
    times : array (n,)
        s since the epoch, increasing by a nanosecond at least.
    q_BA : array (4, n)
        Unit quaternion of frame B relative to frame A, scalar part first.
    frame_a, frame_b : str
        By their CCSDS names: ``"EME2000"``, ``"SC_BODY_1"``.
    metadata : MessageMetadata

    Raises
    ------
    ArgumentError
        As for `write_oem`; quaternions whose length is not 1.

    Examples
    --------
    >>> from gnc_opt.report import MessageMetadata, write_aem
    >>> t = np.linspace(0.0, 60.0, 7)
    >>> q_BA = np.array([np.cos(0.01 * t), 0 * t, 0 * t, np.sin(0.01 * t)])  # a turn about z
    >>> about = MessageMetadata("2027-03-01T12:00:00", "UTC", "CHASER", "2027-001A", "EXAMPLE")
    >>> frames = {"frame_a": "EME2000", "frame_b": "SC_BODY_1"}
    >>> message = write_aem("attitude.aem", t, q_BA, **frames, metadata=about)
    >>> print(message.read_text().splitlines()[0])
    CCSDS_AEM_VERS = 1.0
    """
    expect(metadata, MessageMetadata, "the metadata of a message", "write MessageMetadata(epoch, ...)")
    stamps = _stamps(times, metadata.epoch)
    q = _vectors(q_BA, 4, stamps.size, "q_BA")
    size = np.linalg.norm(q, axis=0)
    if np.max(np.abs(size - 1.0)) > _UNIT:
        raise ArgumentError(
            f"q_BA has a column of length {size[np.argmax(np.abs(size - 1.0))]:.6g}: give unit quaternions."
        )
    about = metadata.object | {"REF_FRAME_A": frame_a, "REF_FRAME_B": frame_b, "ATTITUDE_DIR": "A2B"}
    form = {"ATTITUDE_TYPE": "QUATERNION", "QUATERNION_TYPE": "LAST"}
    lines = _message("AEM", "1.0", metadata, about | _span(metadata, stamps) | form)
    scalar_last = np.roll(q / size, -1, axis=0)
    return _written(path, [*lines, "", "DATA_START", *_data(stamps, scalar_last), "DATA_STOP"])


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


def _span(metadata: MessageMetadata, stamps: Any) -> dict[str, str]:
    return {"TIME_SYSTEM": metadata.time_system, "START_TIME": stamps[0], "STOP_TIME": stamps[-1]}


def _line(key: str, text: str) -> None:
    if not isinstance(text, str) or not text.strip() or not text.isprintable():
        raise ArgumentError(
            f"{key.lower().replace('_', ' ')} is {shown(text)}: state it in one line of text."
        )


def _message(kind: str, version: str, metadata: MessageMetadata, told: Mapping[str, str]) -> Iterator[str]:
    head = {"CREATION_DATE": str(np.datetime64("now", "s")), "ORIGINATOR": metadata.originator}
    for key, text in told.items():
        _line(key, text)
    yield f"CCSDS_{kind}_VERS = {version}"
    yield from (f"{key} = {text}" for key, text in head.items())
    yield from ("", "META_START", *(f"{key} = {text}" for key, text in told.items()), "META_STOP")


def _data(stamps: Any, rows: Array) -> Iterator[str]:
    for stamp, column in zip(stamps, rows.T, strict=True):
        yield " ".join([stamp, *(repr(float(value)) for value in column)])


def _written(path: str | Path, lines: list[str]) -> Path:
    target = Path(path)
    target.write_text("\n".join(lines) + "\n", encoding="ascii", errors="strict")
    return target
