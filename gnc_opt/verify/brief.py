"""What is too brief to matter."""

from __future__ import annotations

import numpy as np

from gnc_opt.arrays import Array, Mask

BRIEF = 1e-2
"""What lasts less than this share of a phase counts by its mean over it: loss of cost is size times duration."""

SMEARED = 1e-4
"""A control that is between its bounds for less than this share of a phase is on its way from one to the other."""


def lasting(times: Array, offence: Array) -> Array:
    """Offences (m, n_times) averaged over `BRIEF` of the phase: a kink between two nodes costs next to nothing."""
    half = 0.5 * BRIEF * (times[-1] - times[0])
    areas = 0.5 * (offence[:, 1:] + offence[:, :-1]) * np.diff(times)
    total = np.concatenate([np.zeros((offence.shape[0], 1)), np.cumsum(areas, axis=1)], axis=1)
    middle = np.clip(times, times[0] + half, times[-1] - half)
    means = [
        (np.interp(middle + half, times, row) - np.interp(middle - half, times, row)) / (2 * half)
        for row in total
    ]
    return np.asarray(np.reshape(means, offence.shape))


def without_switches(times: Array, inside: Mask) -> Mask:
    """Where controls are between their bounds (m, n_times) for longer than a switch, smeared by a polynomial, takes."""
    return lasting_longer(times, inside, SMEARED)


def lasting_longer(times: Array, here: Mask, share: float) -> Mask:
    """Where something holds (m, n_times) for longer than a share of the phase."""
    arcs = here.copy()
    for row in arcs:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
        for first, end in edges.reshape(-1, 2):
            row[first:end] &= times[end - 1] - times[first] > share * (times[-1] - times[0])
    return arcs


def least_for_long(times: Array, values: Array) -> int:
    """Return a sample at which values (n_times,) are least, of those that are not undercut for longer than `SMEARED`.

    A dip that takes less is a switch, smeared by a polynomial that wiggles on the way. ``times`` do not decrease.
    """
    length = SMEARED * (times[-1] - times[0])
    firsts = np.flatnonzero(times <= times[-1] - length)
    ends = np.searchsorted(times, times[firsts] + length, "right")
    peaks = [first + int(np.argmax(values[first:end])) for first, end in zip(firsts, ends, strict=True)]
    return int(peaks[np.argmin(values[peaks])])
