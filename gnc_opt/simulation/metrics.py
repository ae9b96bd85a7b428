"""Metrics of runs, from samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_positive
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.model.layout import as_vector


def as_column(value: ArrayLike, size: int, what: str) -> Array:
    """Return a value as a column (size, 1)."""
    return as_vector(value, size, what, ArgumentError)[:, None]


def settling_time(times: Array, distance: Array, band: float) -> float:
    """Return the time from ``times[0]`` (s) from which on ``distance`` (n_times,) stays within ``band``.

    Infinite if the last sample is outside, or not a number.
    """
    band = read_positive(band, "the band of a settling time")
    outside = np.flatnonzero(~(distance <= band))
    if not outside.size:
        return 0.0
    last = int(outside[-1])
    return float("inf") if last == times.size - 1 else float(times[last + 1] - times[0])


def rotation_angle(attitude: Array, reference: Array) -> float:
    """Return the angle (rad, 0 to pi) between two attitudes: quaternions (4,) or modified Rodrigues parameters (3,)."""
    if attitude.size == 4:
        a, b = (q / np.linalg.norm(q) for q in (attitude, reference))
    elif attitude.size == 3:
        a, b = (_quaternion(s) for s in (attitude, reference))
    else:
        raise ArgumentError(
            f"an attitude of {attitude.size} components is neither a quaternion nor modified Rodrigues parameters."
        )
    # the half angle by its tangent: exact for small angles, where the arc cosine loses half the digits
    apart, together = sorted([float(np.linalg.norm(a - b)), float(np.linalg.norm(a + b))])
    return float(4 * np.arctan2(apart, together))


def _quaternion(sigma: Array) -> Array:
    """Return the quaternion (scalar last) of modified Rodrigues parameters."""
    square = float(sigma @ sigma)
    return np.append(2 * sigma, 1 - square) / (1 + square)
