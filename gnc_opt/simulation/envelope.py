"""Envelope: between which values a quantity of all runs stays over time, with bands of order statistics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.simulation.statistics import percentile


@dataclass(frozen=True, eq=False)
class Envelope:
    """Percentiles of a quantity over time, each time by itself.

    Attributes
    ----------
    name, unit : str
    times : array (n_times,)
        s.
    levels : tuple of float
    values : array (n_levels, n_times)
        That a share ``level`` of the runs still flying does not exceed.
    low, high : array (n_levels, n_times)
        Intervals of order statistics that hold the true percentile with ``confidence``, at each time; infinite where
        the runs are too few.
    runs : int array (n_times,)
        That are still flying.
    confidence : float

    Examples
    --------
    >>> envelope = campaign.envelope("overshoot", levels=(0.5, 0.9))
    >>> print(envelope.times.shape, envelope.values.shape, f"{envelope.values[1].max():.3f} {envelope.unit}")
    (81,) (2, 81) 0.005 m
    """

    name: str
    unit: str
    times: Array
    levels: tuple[float, ...]
    values: Array
    low: Array
    high: Array
    runs: Array
    confidence: float


def envelope(
    name: str, unit: str, times: Array, samples: Array, levels: Sequence[float], confidence: float
) -> Envelope:
    """Return the envelope of samples (n_times, n_runs), not-a-number where a run is over; see `Envelope`."""
    shape = (len(levels), times.size)
    values, low, high = (np.full(shape, np.nan) for _ in range(3))
    flying = np.sum(~np.isnan(samples), axis=1)
    for k in np.flatnonzero(flying):
        some = samples[k][~np.isnan(samples[k])]
        for j, level in enumerate(levels):
            found = percentile(some, level, confidence)
            values[j, k], low[j, k], high[j, k] = found.value, found.low, found.high
    return Envelope(name, unit, times, tuple(map(float, levels)), values, low, high, flying, confidence)
